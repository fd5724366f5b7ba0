//! Models without a shape: random vertices, parents, slots and tables that keep I3 and nothing else. The display
//! rule has to be the same on the processor and on the adapter for those too.

use bytemuck::Zeroable;
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::display::LodTable;
use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord, MAX_LEVELS, ModelRecord, Vertex};
use pb_lod::progressive_buffers::model::FLAG_COLORS;
use pb_render::{ChunkData, Coarse, Gpu, ModelTables, PictureFormat, Renderer, Samples};

/// What the tests draw.
pub const PICTURE: PictureFormat = PictureFormat { color: wgpu::TextureFormat::Rgba8UnormSrgb, samples: Samples::One };

/// A simple random number, the same on every run.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, n: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) % n as u64) as u32
    }

    pub fn unit(&mut self) -> f32 {
        self.below(1 << 24) as f32 / (1 << 24) as f32
    }
}

pub struct RandomModel {
    pub model: ModelRecord,
    pub clusters: Vec<ClusterRecord>,
    pub levels: Vec<LevelRecord>,
    pub neighbours: Vec<u32>,
    /// By cluster: all vertices, coarsest first.
    pub vertices: Vec<Vec<Vertex>>,
    /// `cluster * levels + level`.
    pub indices: Vec<Vec<u16>>,
    pub tables: Vec<LodTable>,
}

impl RandomModel {
    pub fn new(seed: u64, clusters: u32, levels: u32) -> Self {
        let mut random = Random(seed);
        let mut out = Self {
            model: ModelRecord { quantum: 1.0 / 1024.0, levels, clusters, flags: FLAG_COLORS, ..ModelRecord::zeroed() },
            clusters: Vec::new(),
            levels: Vec::new(),
            neighbours: Vec::new(),
            vertices: Vec::new(),
            indices: Vec::new(),
            tables: Vec::new(),
        };
        (0..clusters).for_each(|_| out.add_cluster(&mut random));
        out
    }

    fn add_cluster(&mut self, random: &mut Random) {
        let (levels, clusters) = (self.model.levels, self.model.clusters);
        let neighbours = 1 + random.below(5);
        self.clusters.push(ClusterRecord {
            origin: std::array::from_fn(|_| random.below(1 << 16) as i32 - (1 << 15)),
            shift: random.below(3),
            neighbours_first: self.neighbours.len() as u32,
            neighbours_count: neighbours,
            ..ClusterRecord::zeroed()
        });
        self.neighbours.extend((0..neighbours).map(|_| random.below(clusters)));
        // Coarsest first; the coarsest level has 3 to 10 vertices, each finer one about twice as many.
        let mut vertices: Vec<Vertex> = Vec::new();
        let mut rows = Vec::new();
        for level in (0..levels).rev() {
            let coarser = vertices.len() as u32;
            let new = 3 + random.below(8 + coarser);
            for v in coarser..coarser + new {
                let parent = if level + 1 == levels { v } else { random.below(coarser) };
                vertices.push(random_vertex(random, parent as u16, neighbours));
            }
            let triangles = 1 + random.below(3 * vertices.len() as u32);
            let indices = (0..triangles * 3).map(|_| random.below(vertices.len() as u32) as u16).collect();
            let row = LevelRecord { vertices: vertices.len() as u32, triangles, ..LevelRecord::zeroed() };
            rows.push((row, indices));
        }
        for (row, indices) in rows.into_iter().rev() {
            self.levels.push(row);
            self.indices.push(indices);
        }
        self.vertices.push(vertices);
        self.tables.push(random_table(random, levels));
    }

    pub fn tables(&self) -> ModelTables<'_> {
        ModelTables {
            model: &self.model,
            clusters: &self.clusters,
            levels: &self.levels,
            neighbours: &self.neighbours,
            textures: None,
            instances: None,
        }
    }

    /// `n_i` of a cluster.
    pub fn counts(&self, cluster: u32) -> Vec<u32> {
        let levels = self.model.levels as usize;
        self.levels[cluster as usize * levels..][..levels].iter().map(|l| l.vertices).collect()
    }

    pub fn chunk(&self, chunk: ChunkId) -> ChunkData<'_> {
        let levels = self.model.levels;
        let (cluster, level) = (chunk.0 / levels, chunk.0 % levels);
        let first = if level + 1 == levels { 0 } else { self.levels[chunk.0 as usize + 1].vertices };
        let end = self.levels[chunk.0 as usize].vertices;
        ChunkData {
            vertices: &self.vertices[cluster as usize][first as usize..end as usize],
            indices: &self.indices[chunk.0 as usize],
        }
    }

    /// A renderer with nothing but the coarsest level resident.
    pub fn renderer(&self, gpu: &Gpu, bound: u64) -> Renderer {
        let coarsest = self.model.levels - 1;
        let coarse: Vec<ChunkData> =
            (0..self.model.clusters).map(|c| self.chunk(ChunkId(c * self.model.levels + coarsest))).collect();
        let coarse = Coarse { chunks: &coarse, tails: &[] };
        let mut renderer = Renderer::new(gpu, &self.tables(), &coarse, bound, PICTURE).unwrap();
        let levels = self.model.levels as usize;
        renderer.set_distances(gpu, self.tables.iter().flat_map(|t| t.distances[..levels].to_vec()).collect());
        renderer
    }

    pub fn floors(&self) -> Vec<f32> {
        self.tables.iter().map(|t| t.floor).collect()
    }
}

fn random_vertex(random: &mut Random, parent: u16, neighbours: u32) -> Vertex {
    let normal = std::array::from_fn(|_| random.unit() - 0.5);
    let slot = if random.below(2) == 0 { 0 } else { 1 + random.below(neighbours) };
    Vertex {
        offset: std::array::from_fn(|_| random.below(1 << 16) as u16),
        parent,
        normal_slot: Vertex::pack_normal_slot(normal, slot as u8),
        color: std::array::from_fn(|_| random.below(256) as u8),
    }
}

fn random_table(random: &mut Random, levels: u32) -> LodTable {
    let mut distances = [0.0; MAX_LEVELS];
    for i in 1..levels as usize {
        distances[i] = distances[i - 1] + 0.5 + random.unit() * 120.0;
    }
    let floor = if random.below(2) == 0 { 0.0 } else { random.unit() * levels as f32 };
    LodTable { levels, floor, distances }
}
