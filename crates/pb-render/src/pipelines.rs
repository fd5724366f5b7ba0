//! The pipelines of the cluster drawable: two vertex stages, one fragment stage, filled or as lines.

use crate::gpu::Gpu;
use crate::gpu_model::GpuModel;
use crate::target::{DEPTH_FORMAT, Samples};

/// The display rule: functions and bindings without entry points.
pub const DISPLAY_WGSL: &str = include_str!("shaders/display.wgsl");
const CLUSTERS_WGSL: &str = include_str!("shaders/clusters.wgsl");
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
}

impl Default for Style {
    fn default() -> Self {
        Self { color: ColorMode::Shaded, wireframe: false, show_back_faces: false, morph: true }
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

/// The whole text of the shader module.
pub fn shader_source(primitive_index: bool) -> String {
    let (enable, fragment) = match primitive_index {
        true => ("enable primitive_index;\n", FRAGMENT_PRIMITIVE_WGSL),
        false => ("", FRAGMENT_PLAIN_WGSL),
    };
    [enable, DISPLAY_WGSL, CLUSTERS_WGSL, SHADE_WGSL, fragment].concat()
}

/// `[filled, lines]` of each vertex stage.
pub(crate) struct Pipelines {
    pub layout: wgpu::BindGroupLayout,
    clusters: [Option<wgpu::RenderPipeline>; 2],
    coarse: [Option<wgpu::RenderPipeline>; 2],
}

impl Pipelines {
    pub fn new(gpu: &Gpu, picture: PictureFormat) -> Self {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("clusters"),
            source: wgpu::ShaderSource::Wgsl(shader_source(gpu.primitive_index).into()),
        });
        let layout = bind_group_layout(gpu);
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("clusters"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let make = |entry: &str, mode: wgpu::PolygonMode| {
            let wanted = mode == wgpu::PolygonMode::Fill || gpu.wireframe;
            wanted.then(|| pipeline(gpu, &pipeline_layout, &module, entry, (picture, mode)))
        };
        let modes = [wgpu::PolygonMode::Fill, wgpu::PolygonMode::Line];
        Self {
            clusters: modes.map(|mode| make("vs_cluster", mode)),
            coarse: modes.map(|mode| make("vs_coarse", mode)),
            layout,
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
        let buffers = [
            view,
            &model.heap_buffer,
            &model.cluster_buffer,
            &model.level_buffer,
            &model.distance_buffer,
            &model.floor_buffer,
            &model.neighbour_buffer,
            &model.coarse_cluster_buffer,
        ];
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
}

/// Lines where they are asked for and there, else filled.
fn pick(pair: &[Option<wgpu::RenderPipeline>; 2], style: Style) -> &wgpu::RenderPipeline {
    let lines = if style.wireframe { pair[1].as_ref() } else { None };
    lines.or(pair[0].as_ref()).expect("filled pipelines are always made")
}

fn bind_group_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
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
    let entries: Vec<_> = (0..8).map(entry).collect();
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("model"), entries: &entries })
}

fn pipeline(
    gpu: &Gpu,
    layout: &wgpu::PipelineLayout,
    module: &wgpu::ShaderModule,
    entry: &str,
    (picture, polygon_mode): (PictureFormat, wgpu::PolygonMode),
) -> wgpu::RenderPipeline {
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(entry),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
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
            module,
            entry_point: Some("fs_main"),
            compilation_options: Default::default(),
            targets: &[Some(picture.color.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
