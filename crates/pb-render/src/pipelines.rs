//! The pipelines of the cluster drawable: two vertex stages, one fragment stage, filled or as lines.

use pb_lod::progressive_buffers::textures::MapKind;

use crate::gpu::Gpu;
use crate::gpu_model::GpuModel;
use crate::target::{DEPTH_FORMAT, Samples};
use crate::tiles::GpuTiles;

/// The display rule: functions and bindings without entry points.
pub const DISPLAY_WGSL: &str = include_str!("shaders/display.wgsl");
const CLUSTERS_WGSL: &str = include_str!("shaders/clusters.wgsl");
const SURFACE_WGSL: &str = include_str!("shaders/surface.wgsl");
const SURFACE_PLAIN_WGSL: &str = include_str!("shaders/surface_plain.wgsl");
const TEXTURES_WGSL: &str = include_str!("shaders/textures.wgsl");
const SURFACE_TEXTURED_WGSL: &str = include_str!("shaders/surface_textured.wgsl");
const SHADE_WGSL: &str = include_str!("shaders/shade.wgsl");
const FRAGMENT_PLAIN_WGSL: &str = include_str!("shaders/fragment_plain.wgsl");
const FRAGMENT_PRIMITIVE_WGSL: &str = include_str!("shaders/fragment_primitive.wgsl");

/// What surfaces are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ColorMode {
    /// Their own colours.
    #[default]
    Shaded = 0,
    /// The level whose index buffer draws them.
    Level = 1,
    /// Their cluster.
    Cluster = 2,
    /// Their triangle.
    Triangle = 3,
    /// Their own colours without any light, exactly as in the texture.
    Albedo = 4,
    /// Their normals, after normal mapping: `128 + 127 n` in an 8-bit picture.
    Normals = 5,
    /// The mip that is shown, over the texture.
    Mips = 6,
    /// How many texels there are per pixel, over the texture: blue too few, green enough, red more than needed.
    Texels = 7,
    /// Squares of 8 texels and of an eighth of the tile.
    Checker = 8,
}

/// How a frame looks, and debug switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Style {
    /// What surfaces are coloured by.
    pub color: ColorMode,
    /// Triangles as lines, where the adapter can ([`Gpu::wireframe`]).
    pub wireframe: bool,
    /// Paint back faces (clockwise ones) in pure magenta.
    pub show_back_faces: bool,
    /// The geomorph; without it vertices jump from level to level.
    pub morph: bool,
    /// Most samples along the longer axis of a pixel's footprint in a texture, 1 to 16.
    pub anisotropy: u32,
}

impl Default for Style {
    fn default() -> Self {
        Self { color: ColorMode::Shaded, wireframe: false, show_back_faces: false, morph: true, anisotropy: 8 }
    }
}

/// What a pipeline draws to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureFormat {
    /// Colour format.
    pub color: wgpu::TextureFormat,
    /// Samples per pixel.
    pub samples: Samples,
}

/// Which shader text is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShaderKind {
    /// Fragments know their triangle's number.
    pub primitive_index: bool,
    /// The model has textures.
    pub textured: bool,
}

/// The whole text of the shader module.
pub fn shader_source(kind: ShaderKind) -> String {
    let (enable, fragment) = match kind.primitive_index {
        true => ("enable primitive_index;\n", FRAGMENT_PRIMITIVE_WGSL),
        false => ("", FRAGMENT_PLAIN_WGSL),
    };
    let surface = match kind.textured {
        true => [TEXTURES_WGSL, SURFACE_TEXTURED_WGSL].concat(),
        false => SURFACE_PLAIN_WGSL.to_string(),
    };
    [enable, DISPLAY_WGSL, CLUSTERS_WGSL, SURFACE_WGSL, &surface, SHADE_WGSL, fragment].concat()
}

/// `[filled, lines]` of each vertex stage.
pub(crate) struct Pipelines {
    pub layout: wgpu::BindGroupLayout,
    /// Of the pages, where the model has textures.
    texture_layout: Option<wgpu::BindGroupLayout>,
    clusters: [Option<wgpu::RenderPipeline>; 2],
    coarse: [Option<wgpu::RenderPipeline>; 2],
}

impl Pipelines {
    pub fn new(gpu: &Gpu, model: &GpuModel, picture: PictureFormat) -> Self {
        let tiles = model.tiles.as_ref();
        let kind = ShaderKind { primitive_index: gpu.primitive_index, textured: tiles.is_some() };
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("clusters"),
            source: wgpu::ShaderSource::Wgsl(shader_source(kind).into()),
        });
        let layout = bind_group_layout(gpu, kind);
        let texture_layout = tiles.map(|_| texture_layout(gpu));
        let layouts = [Some(&layout), texture_layout.as_ref()];
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("clusters"),
            bind_group_layouts: if kind.textured { &layouts } else { &layouts[..1] },
            immediate_size: 0,
        });
        let instanced = ("instanced", model.crowd.is_some() as u32 as f64);
        let vertex_constants = [("level_count", model.levels as f64), instanced];
        let mut constants = vec![("cutouts", tiles.is_some_and(|t| t.cutouts) as u32 as f64)];
        constants.push(("samples", picture.samples as u32 as f64));
        constants.extend(tiles.map(|t| ("object_normals", t.object_normals() as u32 as f64)));
        constants.extend(tiles.map(|_| instanced));
        let make = |entry: &str, mode: wgpu::PolygonMode| {
            let wanted = mode == wgpu::PolygonMode::Fill || gpu.wireframe;
            let stages = (&vertex_constants[..], &constants[..]);
            let shader = Shader { layout: &pipeline_layout, module: &module, entry, constants: stages };
            wanted.then(|| pipeline(gpu, &shader, picture, mode))
        };
        let modes = [wgpu::PolygonMode::Fill, wgpu::PolygonMode::Line];
        Self {
            clusters: modes.map(|mode| make("vs_cluster", mode)),
            coarse: modes.map(|mode| make("vs_coarse", mode)),
            layout,
            texture_layout,
        }
    }

    pub fn clusters(&self, style: Style) -> &wgpu::RenderPipeline {
        pick(&self.clusters, style)
    }

    pub fn coarse(&self, style: Style) -> &wgpu::RenderPipeline {
        pick(&self.coarse, style)
    }

    /// Bindings of display.wgsl, in its order.
    pub fn bind(&self, gpu: &Gpu, model: &GpuModel, view: &wgpu::Buffer) -> wgpu::BindGroup {
        let mut buffers = vec![
            view,
            &model.heap_buffer,
            &model.cluster_buffer,
            &model.level_buffer,
            &model.distance_buffer,
            &model.floor_buffer,
            &model.link_buffer,
            &model.frame_buffer,
        ];
        buffers.extend(model.tiles.as_ref().map(|t| &t.table_buffer));
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, b)| wgpu::BindGroupEntry { binding, resource: b.as_entire_binding() })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("model"),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Bindings of textures.wgsl: a sampler, then the pages by kind of map. A map that the model has not got gets
    /// some other's pages, which nobody reads.
    pub fn bind_textures(&self, gpu: &Gpu, tiles: &GpuTiles) -> Option<wgpu::BindGroup> {
        let layout = self.texture_layout.as_ref()?;
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("bilinear"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let views = MapKind::ALL.map(|kind| tiles.map(kind).map(|(_, view)| view));
        let some = views.iter().flatten().next()?;
        let pages = views.iter().map(|v| wgpu::BindingResource::TextureView(v.as_ref().unwrap_or(some)));
        let resources = [wgpu::BindingResource::Sampler(&sampler)].into_iter().chain(pages);
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        let descriptor = wgpu::BindGroupDescriptor { label: Some("pages"), layout, entries: &entries };
        Some(gpu.device.create_bind_group(&descriptor))
    }
}

/// Lines where they are asked for and there, else filled.
fn pick(pair: &[Option<wgpu::RenderPipeline>; 2], style: Style) -> &wgpu::RenderPipeline {
    let lines = if style.wireframe { pair[1].as_ref() } else { None };
    lines.or(pair[0].as_ref()).expect("filled pipelines are always made")
}

fn bind_group_layout(gpu: &Gpu, kind: ShaderKind) -> wgpu::BindGroupLayout {
    let entry = |binding: u32| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: match binding {
                0 => wgpu::BufferBindingType::Uniform,
                _ => wgpu::BufferBindingType::Storage { read_only: true },
            },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    let entries: Vec<_> = (0..8 + kind.textured as u32).map(entry).collect();
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("model"), entries: &entries })
}

fn texture_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let pages = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    let entry = |binding: u32| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty: if binding == 0 { sampler } else { pages },
        count: None,
    };
    let entries: Vec<_> = (0..1 + MapKind::ALL.len() as u32).map(entry).collect();
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("pages"), entries: &entries })
}

/// What a pipeline runs.
struct Shader<'a> {
    layout: &'a wgpu::PipelineLayout,
    module: &'a wgpu::ShaderModule,
    /// Of the vertex stage.
    entry: &'a str,
    /// Of the vertex stage and of the fragment stage.
    constants: (Constants<'a>, Constants<'a>),
}

type Constants<'a> = &'a [(&'static str, f64)];

fn pipeline(
    gpu: &Gpu,
    shader: &Shader,
    picture: PictureFormat,
    polygon_mode: wgpu::PolygonMode,
) -> wgpu::RenderPipeline {
    let options = |constants| wgpu::PipelineCompilationOptions { constants, ..Default::default() };
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(shader.entry),
        layout: Some(shader.layout),
        vertex: wgpu::VertexState {
            module: shader.module,
            entry_point: Some(shader.entry),
            compilation_options: options(shader.constants.0),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState { polygon_mode, ..Default::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: picture.samples as u32, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: shader.module,
            entry_point: Some("fs_main"),
            compilation_options: options(shader.constants.1),
            targets: &[Some(picture.color.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
