//! What a simulation flies through: the tables that selection and cache see of a model, random ones or an archive's.

use bytemuck::Zeroable;
use glam::DVec3;
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::hierarchy;
use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord, ModelRecord, NodeRecord};
use pb_lod::progressive_buffers::model::{FLAG_TEXTURES, Model};
use pb_lod::progressive_buffers::select::{SelectTables, Selector};
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MapRecord, Textures, TileRecord};
use pb_stream::cache::{ChunkInfo, POOLS};
use pb_stream::merge::Extent;

use super::random::Random;

/// Half the width of random models, quanta.
const HALF_WIDTH: f64 = 1e6;

/// Tables of one model.
pub struct SimScene {
    pub model: ModelRecord,
    clusters: Vec<ClusterRecord>,
    levels: Vec<LevelRecord>,
    neighbours: Vec<u32>,
    nodes: Vec<NodeRecord>,
    textures: Option<(Vec<MapRecord>, Vec<TileRecord>)>,
    /// Per chunk: decoded bytes.
    pub chunk_bytes: Vec<u64>,
    /// Per chunk: where it lies in the file.
    pub extents: Vec<Extent>,
    /// Per chunk: never leaves, and is none of the cache's.
    pub always: Vec<bool>,
}

impl SimScene {
    /// Some clusters in space, of any size, half of them textured.
    pub fn random(random: &mut Random) -> Self {
        let (clusters, levels) = (random.magnitude(1.0, 150.0) as u32 + 1, random.whole(1, 7));
        let spheres: Vec<(DVec3, f64)> = (0..clusters)
            .map(|_| {
                let radius = random.magnitude(0.002, 0.3) * HALF_WIDTH;
                ((random.direction() * random.real(0.0, HALF_WIDTH)).round(), radius.ceil())
            })
            .collect();
        let mut hierarchy = hierarchy::build(&spheres);
        let mut scene = Self::empty(clusters, levels);
        for &old in &hierarchy.order {
            scene.add_cluster(spheres[old as usize], random);
        }
        let coarsest = scene.levels.iter().skip(levels as usize - 1).step_by(levels as usize);
        hierarchy.set_errors(&coarsest.map(|l| l.error).collect::<Vec<f32>>());
        scene.nodes = hierarchy.nodes;
        if random.chance(0.5) {
            scene.add_textures(random);
        }
        scene.lay_out();
        scene
    }

    fn empty(clusters: u32, levels: u32) -> Self {
        let mut model = ModelRecord::zeroed();
        (model.quantum, model.levels, model.clusters) = (1.0 / 1024.0, levels, clusters);
        (model.bounds_min, model.bounds_max) = ([-2 * HALF_WIDTH as i32; 3], [2 * HALF_WIDTH as i32; 3]);
        Self {
            model,
            clusters: Vec::new(),
            levels: Vec::new(),
            neighbours: Vec::new(),
            nodes: Vec::new(),
            textures: None,
            chunk_bytes: Vec::new(),
            extents: Vec::new(),
            always: Vec::new(),
        }
    }

    /// A cluster whose levels have a quarter of the vertices each, and about four times the error.
    fn add_cluster(&mut self, (center, radius): (DVec3, f64), random: &mut Random) {
        let mut record = ClusterRecord::zeroed();
        record.center = center.as_ivec3().to_array();
        record.origin = record.center;
        record.radius = radius as f32;
        self.clusters.push(record);
        let finest = random.magnitude(50.0, 20_000.0);
        let error = radius * self.model.quantum * random.magnitude(3e-4, 3e-2);
        let level = |i: u32| {
            let vertices = (finest / 4f64.powi(i as i32)) as u32 + 3;
            let error = if i == 0 { 0.0 } else { (error * 4f64.powi(i as i32 - 1)) as f32 };
            LevelRecord { vertices, triangles: vertices * 2, error, acmr: 0.7 }
        };
        self.levels.extend((0..self.model.levels).map(level));
        for i in 0..self.model.levels {
            let coarser = if i + 1 < self.model.levels { level(i + 1).vertices } else { 0 };
            self.chunk_bytes.push(16 * u64::from(level(i).vertices - coarser) + 6 * u64::from(level(i).triangles));
        }
    }

    fn add_textures(&mut self, random: &mut Random) {
        let maps = vec![MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb)];
        let tile = |cluster: &ClusterRecord, random: &mut Random| {
            let size_log2 = random.whole(2, 10) as u8;
            let width = cluster.radius * 2.0 * self.model.quantum as f32;
            TileRecord { size_log2, first: [0; 4], reserved: [0; 3], texel: width / (1u32 << size_log2) as f32 }
        };
        let tiles: Vec<TileRecord> = self.clusters.iter().map(|c| tile(c, random)).collect();
        self.model.flags |= FLAG_TEXTURES;
        let textures = Textures { maps: &maps, tiles: &tiles, levels: self.model.levels };
        let places = (0..self.model.clusters).flat_map(|c| (0..self.model.levels).map(move |i| (c, i)));
        self.chunk_bytes.extend(places.map(|(c, i)| u64::from(textures.chunk_bytes(c, i))));
        self.textures = Some((maps, tiles));
    }

    /// As in an archive: coarsest level first, chunks packed to about a third.
    fn lay_out(&mut self) {
        let levels = self.model.levels as usize;
        let textures = self.chunk_bytes.len() / 2 * usize::from(self.textures.is_some());
        let is_texture = |c: usize| self.textures.is_some() && c >= textures;
        let always = |(c, &bytes): (usize, &u64)| c % levels == levels - 1 || is_texture(c) && bytes == 0;
        self.always = self.chunk_bytes.iter().enumerate().map(always).collect();
        let mut offset = 128;
        self.extents = vec![Extent::default(); self.chunk_bytes.len()];
        for level in (0..levels).rev() {
            for chunk in (level..self.chunk_bytes.len()).step_by(levels) {
                let bytes = self.chunk_bytes[chunk].div_ceil(3);
                self.extents[chunk] = Extent { offset, bytes };
                offset += bytes;
            }
        }
    }

    /// An archive's tables.
    pub fn of(model: &Model) -> Self {
        let chunks = || (0..model.chunk_count()).map(ChunkId);
        Self {
            model: *model.record(),
            clusters: model.clusters().to_vec(),
            levels: model.level_records().to_vec(),
            neighbours: model.neighbour_entries().to_vec(),
            nodes: model.nodes().to_vec(),
            textures: model.textures().map(|t| (t.maps.to_vec(), t.tiles.to_vec())),
            chunk_bytes: chunks().map(|c| model.decoded_bytes(c).into()).collect(),
            extents: chunks().map(|c| model.extent(c)).map(|(offset, n)| Extent { offset, bytes: n.into() }).collect(),
            always: chunks().map(|c| model.always_resident(c)).collect(),
        }
    }

    /// A new selector for these tables.
    pub fn selector(&self) -> Selector {
        let levels = self.model.levels;
        Selector::new(&SelectTables {
            instances: None,
            model: &self.model,
            clusters: &self.clusters,
            levels: &self.levels,
            neighbours: &self.neighbours,
            nodes: &self.nodes,
            textures: self.textures.as_ref().map(|(maps, tiles)| Textures { maps, tiles, levels }),
            chunk_bytes: &self.chunk_bytes,
        })
    }

    /// The chunks as the cache sees them: those that are always there have no size.
    pub fn infos(&self) -> Vec<ChunkInfo> {
        let info = |chunk: usize| {
            let bytes = if self.always[chunk] { 0 } else { self.chunk_bytes[chunk] };
            ChunkInfo {
                ram_bytes: bytes as u32,
                vram_bytes: bytes,
                pool: self.pool(chunk),
                coarser: self.coarser(chunk).map(|c| pb_stream::ChunkId(c as u32)),
                pinned: false,
            }
        };
        (0..self.chunk_bytes.len()).map(info).collect()
    }

    /// 0 geometry, 1 textures.
    pub fn pool(&self, chunk: usize) -> usize {
        usize::from(chunk >= (self.model.clusters * self.model.levels) as usize)
    }

    /// The chunk that has to be in VRAM before this one, where that is not always so.
    pub fn coarser(&self, chunk: usize) -> Option<usize> {
        let last = chunk as u32 % self.model.levels + 1 == self.model.levels;
        (!last && !self.always[chunk + 1]).then_some(chunk + 1)
    }

    /// Bytes of all chunks that come and go, by pool.
    pub fn bytes(&self) -> [u64; POOLS] {
        let mut sums = [0; POOLS];
        for chunk in (0..self.chunk_bytes.len()).filter(|&c| !self.always[c]) {
            sums[self.pool(chunk)] += self.chunk_bytes[chunk];
        }
        sums
    }

    /// Bytes of the geometry that never leaves.
    pub fn coarse_bytes(&self) -> u64 {
        (0..self.chunk_bytes.len()).filter(|&c| self.always[c] && self.pool(c) == 0).map(|c| self.chunk_bytes[c]).sum()
    }
}
