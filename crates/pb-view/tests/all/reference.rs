//! The plainest way to draw a model: all of level 0 in one vertex buffer and one index buffer, one draw call, a
//! shader of a few lines that shares nothing with the program's.

use pb_lod::progressive_buffers::model::{Model, Placed};
use pb_render::{BACKGROUND_SRGB, Camera, DEPTH_FORMAT, Gpu, Offscreen, Samples};
use std::path::Path;

const WGSL: &str = "
struct View { clip_from_eye: mat4x4<f32>, sun: vec3<f32>, look: u32, has_colors: u32 }
@group(0) @binding(0) var<uniform> view: View;
struct Fragment {
    @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(perspective, centroid) position: vec3<f32>,
    @location(1) @interpolate(perspective, centroid) normal: vec3<f32>,
    @location(2) @interpolate(perspective, centroid) color: vec4<f32>,
}
@vertex
fn vs(@location(0) p: vec3<f32>, @location(1) n: vec3<f32>, @location(2) c: vec4<f32>) -> Fragment {
    return Fragment(view.clip_from_eye * vec4<f32>(p, 1.0), p, n, c);
}
fn linear(c: f32) -> f32 {
    if c <= 0.04045 { return c / 12.92; }
    return pow((c + 0.055) / 1.055, 2.4);
}
@fragment
fn fs(f: Fragment, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    if !front && view.look == 1u { return vec4<f32>(1.0, 0.0, 1.0, 1.0); }
    if view.look == 2u { return vec4<f32>(vec3<f32>(1.0 / (1.0 + length(f.position))), 1.0); }
    let to_eye = normalize(-f.position);
    let flip = !front && dot(f.normal, to_eye) < 0.0;
    let n = normalize(f.normal) * select(1.0, -1.0, flip);
    let up = dot(n, view.sun);
    let light = mix(vec3<f32>(0.14, 0.13, 0.12), vec3<f32>(0.27, 0.28, 0.31), up * 0.5 + 0.5)
        + max(up, 0.0) * vec3<f32>(0.52, 0.51, 0.49)
        + max(dot(n, to_eye), 0.0) * 0.19;
    var albedo = vec3<f32>(0.58, 0.56, 0.53);
    if view.has_colors == 1u { albedo = vec3<f32>(linear(f.color.r), linear(f.color.g), linear(f.color.b)); }
    return vec4<f32>(albedo * light, 1.0);
}
";

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Vertex {
    position: [f32; 3],
    normal: [f32; 3],
    color: [u8; 4],
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct View {
    clip_from_eye: [[f32; 4]; 4],
    sun: [f32; 3],
    look: u32,
    has_colors: u32,
    reserved: [u32; 3],
}

/// What a picture shows.
#[derive(Clone, Copy)]
pub enum Look {
    /// Light and colours.
    Shaded = 0,
    /// The same, with back faces in magenta.
    BackFaces = 1,
    /// 1 / (1 + distance) as a grey.
    Nearness = 2,
}

/// A model at full resolution on the adapter.
pub struct Reference<'a> {
    gpu: &'a Gpu,
    /// World space.
    positions: Vec<glam::DVec3>,
    vertices: Vec<Vertex>,
    triangles: u32,
    has_colors: bool,
    vertex_buffer: wgpu::Buffer,
    index_buffer: wgpu::Buffer,
    view_buffer: wgpu::Buffer,
    group: wgpu::BindGroup,
    pipeline: wgpu::RenderPipeline,
    target: Offscreen,
    /// Colour samples, where there are several, and depth.
    samples_view: Option<wgpu::TextureView>,
    depth: wgpu::TextureView,
}

impl<'a> Reference<'a> {
    pub fn new(gpu: &'a Gpu, archive: &Path, size: [u32; 2], samples: Samples) -> Self {
        let model = Model::open(archive).unwrap();
        let (mut positions, mut vertices, mut indices) = (Vec::new(), Vec::new(), Vec::<u32>::new());
        for Placed { clusters, placements } in model.placed() {
            for (cluster, placement) in clusters.flat_map(|c| placements.iter().map(move |p| (c, p))) {
                let prefix = model.read_prefix(cluster, 0).unwrap();
                indices.extend(prefix.indices.iter().map(|&i| positions.len() as u32 + i as u32));
                for v in &prefix.vertices {
                    positions.push(model.world_of(model.grid(cluster, v), placement));
                    let normal = placement.rotation * glam::DVec3::from(v.normal().map(f64::from));
                    let normal = normal.as_vec3().to_array();
                    vertices.push(Vertex { position: [0.0; 3], normal, color: v.color });
                }
            }
        }
        let buffer = |bytes: usize, usage| {
            let size = (bytes as u64).next_multiple_of(4);
            let usage = usage | wgpu::BufferUsages::COPY_DST;
            gpu.device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
        };
        let index_buffer = buffer(indices.len() * 4, wgpu::BufferUsages::INDEX);
        gpu.queue.write_buffer(&index_buffer, 0, bytemuck::cast_slice(&indices));
        let view_buffer = buffer(size_of::<View>(), wgpu::BufferUsages::UNIFORM);
        let target = Offscreen::new(gpu, size, wgpu::TextureFormat::Rgba8UnormSrgb, Samples::One).unwrap();
        let pipeline = pipeline(gpu, target.format, samples);
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: view_buffer.as_entire_binding() }],
        });
        Self {
            gpu,
            vertex_buffer: buffer(vertices.len() * size_of::<Vertex>(), wgpu::BufferUsages::VERTEX),
            positions,
            vertices,
            triangles: indices.len() as u32 / 3,
            has_colors: model.has_colors(),
            index_buffer,
            view_buffer,
            group,
            pipeline,
            samples_view: (samples != Samples::One).then(|| image(gpu, size, target.format, samples)),
            depth: image(gpu, size, DEPTH_FORMAT, samples),
            target,
        }
    }

    /// The picture from `camera`, RGBA8, rows from the top.
    pub fn picture(&mut self, camera: &Camera, look: Look) -> Vec<u8> {
        for (vertex, position) in self.vertices.iter_mut().zip(&self.positions) {
            vertex.position = (*position - camera.eye).as_vec3().to_array();
        }
        let up = camera.up.normalize().as_vec3();
        let side = up.any_orthonormal_vector();
        let view = View {
            clip_from_eye: camera.clip_from_eye(self.target.size).to_cols_array_2d(),
            sun: (up * 1.2 + side * 0.7 + up.cross(side) * 0.5).normalize().to_array(),
            look: look as u32,
            has_colors: self.has_colors as u32,
            reserved: [0; 3],
        };
        let queue = &self.gpu.queue;
        queue.write_buffer(&self.vertex_buffer, 0, bytemuck::cast_slice(&self.vertices));
        queue.write_buffer(&self.view_buffer, 0, bytemuck::bytes_of(&view));
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = self.begin(&mut encoder);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.set_vertex_buffer(0, self.vertex_buffer.slice(..));
            pass.set_index_buffer(self.index_buffer.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..self.triangles * 3, 0, 0..1);
        }
        queue.submit([encoder.finish()]);
        self.target.read(self.gpu).unwrap()
    }

    fn begin<'b>(&self, encoder: &'b mut wgpu::CommandEncoder) -> wgpu::RenderPass<'b> {
        let [r, g, b] = BACKGROUND_SRGB.map(|c| ((c as f64 / 255.0 + 0.055) / 1.055).powf(2.4));
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: self.samples_view.as_ref().unwrap_or(&self.target.color),
                depth_slice: None,
                resolve_target: self.samples_view.as_ref().map(|_| &self.target.color),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color { r, g, b, a: 1.0 }),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}

fn image(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat, samples: Samples) -> wgpu::TextureView {
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: samples as u32,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    texture.create_view(&Default::default())
}

fn pipeline(gpu: &Gpu, format: wgpu::TextureFormat, samples: Samples) -> wgpu::RenderPipeline {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("reference"),
        source: wgpu::ShaderSource::Wgsl(WGSL.into()),
    });
    let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Unorm8x4];
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("reference"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs"),
            compilation_options: Default::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<Vertex>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &attributes,
            })],
        },
        primitive: Default::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: samples as u32, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fs"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
