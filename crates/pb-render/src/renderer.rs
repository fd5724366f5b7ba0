//! Draws a plan: clusters with one indirect call, then ranges of the coarse buffer.
//!
//! Must never: decide what to draw; know of windows. The caller hands in a plan, a camera and where to draw.

use glam::Vec3;
use pb_lod::plan::Plan;
use pb_lod::progressive_buffers::display::GridEye;
use pb_lod::progressive_buffers::textures::MapKind;

use crate::camera::Camera;
use crate::crowd::Batch;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu_model::{Coarse, GpuModel, ModelTables};
use crate::pipelines::{PictureFormat, Pipelines, Style};
use crate::tables::{DrawArguments, ViewUniform};
use crate::target::{FramePass, Surface};
use crate::tiles::GpuTiles;

/// Most samples along the longer axis of a pixel's footprint.
const MAX_ANISOTROPY: u32 = 16;

/// Behind everything, sRGB encoded: what a fragment that nothing covers shows.
pub const BACKGROUND_SRGB: [u8; 3] = [38, 42, 48];

/// What is drawn in one frame.
pub struct Scene<'a> {
    /// Draws, coarse ranges and floors.
    pub plan: &'a Plan,
    /// Where from.
    pub camera: &'a Camera,
    /// The same eye on the model's grid.
    pub eye: GridEye,
    /// Colours and debug switches.
    pub style: Style,
}

/// A model and the pipelines that draw it.
pub struct Renderer {
    /// The model's buffers; chunks are uploaded and freed through it.
    pub model: GpuModel,
    pipelines: Pipelines,
    view_buffer: wgpu::Buffer,
    bind_group: wgpu::BindGroup,
    texture_group: Option<wgpu::BindGroup>,
    picture: PictureFormat,
    /// What `distance_buffer` holds.
    distances: Vec<f32>,
    multi_draw: bool,
}

impl Renderer {
    /// Everything on the adapter for one model, inside `vram_bound` bytes, drawing pictures of one format.
    pub fn new(
        gpu: &Gpu,
        tables: &ModelTables,
        coarse: &Coarse,
        vram_bound: u64,
        picture: PictureFormat,
    ) -> Result<Self, RenderError> {
        let model = GpuModel::new(gpu, tables, coarse, vram_bound)?;
        let pipelines = Pipelines::new(gpu, &model, picture);
        let view_buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("view"),
            size: size_of::<ViewUniform>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bind_group = pipelines.bind(gpu, &model, &view_buffer);
        let texture_group = model.tiles.as_ref().and_then(|tiles| pipelines.bind_textures(gpu, tiles));
        Ok(Self {
            model,
            pipelines,
            view_buffer,
            bind_group,
            texture_group,
            picture,
            distances: Vec::new(),
            multi_draw: gpu.multi_draw,
        })
    }

    /// Switches multi-draw off or, where the adapter has it, on. Pictures are the same.
    pub fn set_multi_draw(&mut self, gpu: &Gpu, on: bool) {
        self.multi_draw = on && gpu.multi_draw;
    }

    /// Sets the switch distances of the display rule: `cluster * levels + level`, world units.
    pub fn set_distances(&mut self, gpu: &Gpu, distances: Vec<f32>) {
        assert_eq!(distances.len(), (self.model.clusters * self.model.levels) as usize);
        if distances != self.distances {
            gpu.queue.write_buffer(&self.model.distance_buffer, 0, bytemuck::cast_slice(&distances));
            self.distances = distances;
        }
    }

    /// Draws a frame over the background. Every chunk that the plan draws, and all coarser ones of its
    /// cluster, must be resident (I5).
    pub fn draw(&self, gpu: &Gpu, surface: &Surface, scene: &Scene) {
        self.write_view(gpu, surface.canvas.size, scene);
        gpu.queue.write_buffer(&self.model.floor_buffer, 0, bytemuck::cast_slice(&scene.plan.floors));
        if let Some(tiles) = &self.model.tiles {
            tiles.write_floors(gpu, &scene.plan.texture_floors);
        }
        let Some(crowd) = &self.model.crowd else {
            let arguments = self.model.draws.arguments(&scene.plan.draws);
            let whole = FramePass { is_first: true, is_last: true };
            self.pass(gpu, surface, whole, |pass| {
                self.draw_clusters(gpu, pass, &arguments, scene.style);
                self.draw_coarse(pass, scene);
            });
            return;
        };
        let batches = crowd.batches(scene.plan, scene.camera.eye, &self.model.draws);
        for (i, batch) in batches.iter().enumerate() {
            let part = FramePass { is_first: i == 0, is_last: i + 1 == batches.len() };
            gpu.queue.write_buffer(&self.model.frame_buffer, 0, bytemuck::cast_slice(&batch.stands));
            let draws = crowd.first_draw() as u64 * 16;
            gpu.queue.write_buffer(&self.model.frame_buffer, draws, bytemuck::cast_slice(&batch.draws));
            self.pass(gpu, surface, part, |pass| self.draw_batch(gpu, pass, batch, scene.style));
        }
    }

    /// One pass with everything bound.
    fn pass(&self, gpu: &Gpu, surface: &Surface, part: FramePass, draw: impl FnOnce(&mut wgpu::RenderPass)) {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let [r, g, b] = BACKGROUND_SRGB.map(|c| linear(c as f64 / 255.0));
            let mut pass = surface.canvas.begin(&mut encoder, surface.color, wgpu::Color { r, g, b, a: 1.0 }, part);
            pass.set_bind_group(0, &self.bind_group, &[]);
            if let Some(group) = &self.texture_group {
                pass.set_bind_group(1, group, &[]);
            }
            draw(&mut pass);
        }
        gpu.queue.submit([encoder.finish()]);
    }

    fn draw_clusters(&self, gpu: &Gpu, pass: &mut wgpu::RenderPass, arguments: &[DrawArguments], style: Style) {
        if arguments.is_empty() {
            return;
        }
        pass.set_pipeline(self.pipelines.clusters(style));
        pass.set_index_buffer(self.model.heap_buffer.slice(..), wgpu::IndexFormat::Uint16);
        self.draw_all(gpu, pass, arguments, 0);
    }

    fn draw_batch(&self, gpu: &Gpu, pass: &mut wgpu::RenderPass, batch: &Batch, style: Style) {
        self.draw_clusters(gpu, pass, &batch.arguments, style);
        if !batch.coarse.is_empty() {
            pass.set_pipeline(self.pipelines.coarse(style));
            pass.set_index_buffer(self.model.coarse_index_buffer.slice(..), wgpu::IndexFormat::Uint32);
            self.draw_all(gpu, pass, &batch.coarse, batch.arguments.len());
        }
    }

    /// With one call where that can be; the arguments go behind `before` others.
    fn draw_all(&self, gpu: &Gpu, pass: &mut wgpu::RenderPass, arguments: &[DrawArguments], before: usize) {
        if self.multi_draw {
            let offset = (before * size_of::<DrawArguments>()) as u64;
            gpu.queue.write_buffer(&self.model.argument_buffer, offset, bytemuck::cast_slice(arguments));
            pass.multi_draw_indexed_indirect(&self.model.argument_buffer, offset, arguments.len() as u32);
            return;
        }
        for a in arguments {
            pass.draw_indexed(
                a.first_index..a.first_index + a.index_count,
                a.base_vertex,
                a.first_instance..a.first_instance + 1,
            );
        }
    }

    fn draw_coarse(&self, pass: &mut wgpu::RenderPass, scene: &Scene) {
        if scene.plan.coarse.is_empty() {
            return;
        }
        pass.set_pipeline(self.pipelines.coarse(scene.style));
        pass.set_index_buffer(self.model.coarse_index_buffer.slice(..), wgpu::IndexFormat::Uint32);
        for range in &scene.plan.coarse {
            pass.draw_indexed(range.indices.clone(), 0, 0..1);
        }
    }

    fn write_view(&self, gpu: &Gpu, size: [u32; 2], scene: &Scene) {
        let view = ViewUniform {
            clip_from_eye: scene.camera.clip_from_eye(size).to_cols_array_2d(),
            eye_cell: scene.eye.cell,
            quantum: scene.eye.quantum,
            eye_rest: scene.eye.rest,
            clusters: self.model.clusters,
            sun: sun(scene.camera).to_array(),
            color_mode: scene.style.color as u32,
            show_back_faces: scene.style.show_back_faces as u32,
            morph: if scene.style.morph { 1.0 } else { 0.0 },
            has_colors: self.model.has_colors as u32,
            textured: self.model.tiles.is_some() as u32,
            maps: self.model.tiles.as_ref().map_or(u32::MAX, map_places),
            anisotropy: scene.style.anisotropy.clamp(1, MAX_ANISOTROPY) as f32,
            tone_map: (self.picture.color != wgpu::TextureFormat::Rgba16Float) as u32,
            first_owner: self.model.first_owner,
            first_draw: self.model.crowd.as_ref().map_or(0, |c| c.first_draw()),
            reserved: [0; 3],
        };
        gpu.queue.write_buffer(&self.view_buffer, 0, bytemuck::bytes_of(&view));
    }

    /// The tables' layout and the frame's bind group, for a pass of the caller's own over the same data. display.wgsl's
    /// constant `level_count` is the model's number of levels.
    pub fn bindings(&self) -> (&wgpu::BindGroupLayout, &wgpu::BindGroup) {
        (&self.pipelines.layout, &self.bind_group)
    }
}

/// By kind of map eight bits: its place in the model's maps, or 255.
fn map_places(tiles: &GpuTiles) -> u32 {
    let place = |kind| tiles.map(kind).map_or(255, |(place, _)| place as u8);
    u32::from_le_bytes(MapKind::ALL.map(place))
}

/// The sun stands high, and to the left of somebody who looks along -z with `up` above.
fn sun(camera: &Camera) -> Vec3 {
    let up = camera.up.normalize_or(glam::DVec3::Y).as_vec3();
    let side = up.any_orthonormal_vector();
    (up * 1.2 + side * 0.7 + up.cross(side) * 0.5).normalize()
}

fn linear(srgb: f64) -> f64 {
    if srgb <= 0.04045 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}
