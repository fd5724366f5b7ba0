//! The display rule on the adapter gives what its Rust twin gives.

use crate::random_model::{PICTURE, Random, RandomModel};
use glam::DVec3;
use pb_lod::plan::{ChunkId, Plan};
use pb_lod::progressive_buffers::display::{ClusterView, Displayed, GridEye, LodTable};
use pb_render::{Camera, DISPLAY_WGSL, Gpu, Offscreen, Renderer, Scene, Style, grid_eye};

/// Runs `display` of display.wgsl for vertices `[0, count)` of a cluster.
const PROBE_WGSL: &str = "
struct Probe { cluster: u32, count: u32 }
@group(1) @binding(0) var<uniform> probe: Probe;
@group(1) @binding(1) var<storage, read_write> shown: array<array<f32, 12>>;
@compute @workgroup_size(64)
fn probe_display(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= probe.count { return; }
    let d = display(at_home(), probe.cluster, id.x);
    shown[id.x] = array<f32, 12>(
        d.position.x, d.position.y, d.position.z, d.normal.x, d.normal.y, d.normal.z,
        d.color.x, d.color.y, d.color.z, d.color.w, 0.0, 0.0);
}
";

struct Probe<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

fn layout_entry(binding: u32, ty: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

impl<'a> Probe<'a> {
    fn new(gpu: &'a Gpu, renderer: &Renderer, levels: u32) -> Self {
        let constants = [("level_count", levels as f64)];
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("probe"),
            source: wgpu::ShaderSource::Wgsl([DISPLAY_WGSL, PROBE_WGSL].concat().into()),
        });
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: None,
            entries: &[
                layout_entry(0, wgpu::BufferBindingType::Uniform),
                layout_entry(1, wgpu::BufferBindingType::Storage { read_only: false }),
            ],
        });
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(renderer.bindings().0), Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("probe_display"),
            compilation_options: wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() },
            cache: None,
        });
        Self { gpu, pipeline, layout }
    }

    fn run(&self, renderer: &Renderer, cluster: u32, count: u32) -> Vec<[f32; 12]> {
        let device = &self.gpu.device;
        let buffer = |size: u64, usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
        };
        let uniform = buffer(8, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST);
        self.gpu.queue.write_buffer(&uniform, 0, bytemuck::bytes_of(&[cluster, count]));
        let out = buffer(count as u64 * 48, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: uniform.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: out.as_entire_binding() },
            ],
        });
        let mut encoder = device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, renderer.bindings().1, &[]);
            pass.set_bind_group(1, &group, &[]);
            pass.dispatch_workgroups(count.div_ceil(64), 1, 1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        bytemuck::pod_collect_to_vec(&self.gpu.read_buffer(&out).unwrap())
    }
}

fn close(shown: &[f32; 12], twin: &Displayed, reach: f32) -> bool {
    let pairs = |a: &[f32], b: &[f32], limit: f32| a.iter().zip(b).all(|(x, y)| (x - y).abs() <= limit);
    pairs(&shown[..3], &twin.position, reach * 4e-6)
        && pairs(&shown[3..6], &twin.normal, 1e-4)
        && pairs(&shown[6..10], &twin.color, 1e-4)
}

fn check_model(gpu: &Gpu, model: &RandomModel, eye: DVec3, random: &mut Random) {
    let (levels, clusters) = (model.model.levels, model.model.clusters);
    let mut renderer = model.renderer(gpu, 1 << 30);
    // In a random order, so that the heap's order says nothing.
    let mut chunks: Vec<u32> = (0..clusters * levels).collect();
    for i in (1..chunks.len()).rev() {
        chunks.swap(i, random.below(i as u32 + 1) as usize);
    }
    for c in chunks {
        renderer.model.upload(gpu, ChunkId(c), model.chunk(ChunkId(c))).unwrap();
    }
    let camera = Camera { eye, target: eye + DVec3::X, up: DVec3::Y, fov_deg: 60.0, near: 1e-3 };
    let eye = grid_eye(&model.model, camera.eye);
    let target = Offscreen::new(gpu, [16, 16], PICTURE.color, PICTURE.samples).unwrap();
    // An empty frame: leaves the view and the floors on the adapter.
    let plan = Plan { floors: model.floors(), ..Plan::default() };
    renderer.draw(gpu, &target.surface(), &Scene { plan: &plan, camera: &camera, eye, style: Style::default() });
    let probe = Probe::new(gpu, &renderer, levels);
    for cluster in 0..clusters {
        compare_cluster(model, cluster, &eye, &probe.run(&renderer, cluster, model.counts(cluster)[0]));
    }
}

fn compare_cluster(model: &RandomModel, cluster: u32, eye: &GridEye, shown: &[[f32; 12]]) {
    let record = &model.clusters[cluster as usize];
    let list = &model.neighbours[record.neighbours_first as usize..][..record.neighbours_count as usize];
    let neighbours: Vec<(u32, LodTable)> = list.iter().map(|&n| (n, model.tables[n as usize])).collect();
    let counts = model.counts(cluster);
    let view = ClusterView {
        origin: record.origin,
        shift: record.shift,
        counts: &counts,
        vertices: &model.vertices[cluster as usize],
        cluster,
        table: &model.tables[cluster as usize],
        neighbours: &neighbours,
    };
    for level in 0..model.model.levels {
        for index in 0..counts[level as usize] {
            let twin = view.display(index, level, eye);
            let got = &shown[index as usize];
            let reach = 300.0;
            assert!(close(got, &twin, reach), "cluster {cluster} vertex {index} level {level}: {got:?} {twin:?}");
        }
    }
}

#[test]
fn the_shader_displays_every_vertex_where_its_rust_twin_does() {
    let Some(gpu) = crate::adapter("the display rule against its twin") else { return };
    let mut random = Random(11);
    for (seed, clusters, levels) in [(1, 12, 5), (2, 5, 1), (3, 9, 12), (4, 20, 3)] {
        let model = RandomModel::new(seed, clusters, levels);
        let eye = DVec3::new(random.unit() as f64, random.unit() as f64, random.unit() as f64) * 100.0 - 50.0;
        check_model(&gpu, &model, eye, &mut random);
    }
}
