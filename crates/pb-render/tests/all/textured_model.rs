//! Flat textured squares: one cluster each, all in the same place, so that a test chooses which one is drawn.

use crate::random_model::Random;
use bytemuck::Zeroable;
use glam::DVec3;
use pb_lod::plan::{ChunkId, CoarseDraw, Plan};
use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord, ModelRecord, Vertex};
use pb_lod::progressive_buffers::model::FLAG_CUTOUT;
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MapRecord, MipPlace, Textures, TileRecord};
use pb_render::{
    Camera, ChunkData, Coarse, ColorMode, Gpu, ModelTables, Offscreen, PictureFormat, Renderer, Samples, Scene, Style,
    grid_eye,
};

/// Side of the square, world units. It is drawn with `1 / 32` texel per unit and texel of the tile's side.
pub const SIDE: f64 = 32.0;

pub struct TexturedModel {
    pub model: ModelRecord,
    pub clusters: Vec<ClusterRecord>,
    pub levels: Vec<LevelRecord>,
    pub maps: Vec<MapRecord>,
    pub tiles: Vec<TileRecord>,
    /// Counter-clockwise from x = y = 0, where v is largest.
    pub vertices: [Vertex; 4],
    /// By texture chunk.
    pub bytes: Vec<Vec<u8>>,
}

/// The bytes of a mip of a cluster.
pub type Fill<'a> = &'a mut dyn FnMut(u32, &MipPlace) -> Vec<u8>;

impl TexturedModel {
    /// Squares that show the part `[0, extent / 65536]^2` of their tile.
    pub fn new(levels: u32, maps: &[(MapKind, MapFormat)], tiles: &[TileRecord], extent: u16, fill: Fill) -> Self {
        let clusters = tiles.len() as u32;
        let side = (SIDE * 64.0) as u16;
        let vertex = |(index, x, y): (u16, u16, u16)| {
            let uv = [if x == 0 { 0 } else { extent }, if y == 0 { extent } else { 0 }];
            Vertex {
                offset: [x, y, 0],
                parent: index,
                normal_slot: Vertex::pack_normal_slot([0.0, 0.0, 1.0], 0),
                color: Vertex::pack_uv(uv),
            }
        };
        let row = LevelRecord { vertices: 4, triangles: 2, ..LevelRecord::zeroed() };
        let mut out = Self {
            model: ModelRecord { quantum: 1.0 / 64.0, levels, clusters, ..ModelRecord::zeroed() },
            clusters: vec![ClusterRecord::zeroed(); tiles.len()],
            levels: vec![row; tiles.len() * levels as usize],
            maps: maps.iter().map(|&(kind, format)| MapRecord::new(kind, format)).collect(),
            tiles: tiles.to_vec(),
            vertices: [(0, 0, 0), (1, side, 0), (2, side, side), (3, 0, side)].map(vertex),
            bytes: Vec::new(),
        };
        let places = (0..clusters).flat_map(|c| (0..levels).map(move |l| (c, l)));
        let bytes = places.map(|(cluster, level)| {
            let mips = out.textures().mips(cluster, level).collect::<Vec<_>>();
            mips.iter().flat_map(|m| fill(cluster, m)).collect()
        });
        out.bytes = bytes.collect();
        out
    }

    pub fn textures(&self) -> Textures<'_> {
        Textures { maps: &self.maps, tiles: &self.tiles, levels: self.model.levels }
    }

    pub fn set_cutouts(&mut self, on: bool) {
        self.model.flags = if on { FLAG_CUTOUT } else { 0 };
    }

    pub fn tables(&self) -> ModelTables<'_> {
        ModelTables {
            model: &self.model,
            clusters: &self.clusters,
            levels: &self.levels,
            neighbours: &[],
            textures: Some(self.textures()),
            instances: None,
        }
    }

    /// The chunk number of a mip's chunk.
    pub fn chunk(&self, cluster: u32, level: u32) -> ChunkId {
        ChunkId((self.model.clusters + cluster) * self.model.levels + level)
    }

    pub fn renderer(&self, gpu: &Gpu, bound: u64) -> Renderer {
        let last = self.model.levels as usize - 1;
        let chunk = ChunkData { vertices: &self.vertices, indices: &[0, 1, 2, 0, 2, 3] };
        let chunks = vec![chunk; self.tiles.len()];
        let tails: Vec<&[u8]> = self.bytes.iter().skip(last).step_by(last + 1).map(|tail| tail.as_slice()).collect();
        let coarse = Coarse { chunks: &chunks, tails: &tails };
        let picture = PictureFormat { color: PICTURE, samples: Samples::One };
        Renderer::new(gpu, &self.tables(), &coarse, bound, picture).unwrap()
    }

    pub fn upload(&self, gpu: &Gpu, renderer: &mut Renderer, chunk: ChunkId) {
        let texture = (chunk.0 - self.model.clusters * self.model.levels) as usize;
        renderer.model.upload_texture(gpu, chunk, &self.bytes[texture]).unwrap();
    }

    pub fn upload_all(&self, gpu: &Gpu, renderer: &mut Renderer) {
        for chunk in 0..self.model.clusters * self.model.levels {
            self.upload(gpu, renderer, ChunkId(self.model.clusters * self.model.levels + chunk));
        }
    }
}

/// Colour format of the tests' pictures: linear light, so that mixtures can be foretold.
pub const PICTURE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// A camera in front of the square, from where it fills a picture `zoom` times.
pub fn in_front(zoom: f64) -> Camera {
    let middle = DVec3::new(SIDE / 2.0, SIDE / 2.0, 0.0);
    Camera { eye: middle + DVec3::Z * (SIDE / 2.0 / zoom), target: middle, up: DVec3::Y, fov_deg: 90.0, near: 1e-3 }
}

/// What a test looks at.
pub struct Shot<'a> {
    pub cluster: u32,
    pub camera: Camera,
    pub floors: &'a [f32],
    pub color: ColorMode,
    pub size: u32,
}

impl Shot<'_> {
    /// Pixels, rows from the top.
    pub fn take(&self, gpu: &Gpu, model: &TexturedModel, renderer: &Renderer) -> Vec<[u8; 4]> {
        let target = Offscreen::new(gpu, [self.size; 2], PICTURE, Samples::One).unwrap();
        let floors = vec![0.0; model.tiles.len()];
        let plan = Plan {
            coarse: vec![CoarseDraw { instance: 0, indices: renderer.model.coarse_range(self.cluster) }],
            floors,
            texture_floors: self.floors.to_vec(),
            ..Plan::default()
        };
        let scene = Scene {
            plan: &plan,
            camera: &self.camera,
            eye: grid_eye(&model.model, self.camera.eye),
            style: Style { color: self.color, anisotropy: 16, ..Style::default() },
        };
        renderer.draw(gpu, &target.surface(), &scene);
        bytemuck::pod_collect_to_vec(&target.read(gpu).unwrap())
    }
}

/// Bytes without an order.
pub fn noise(random: &mut Random, bytes: u32) -> Vec<u8> {
    (0..bytes).map(|_| random.below(256) as u8).collect()
}
