//! A city of clusters: the tables that selection and cache see of a model, of any size, without a file.
//!
//! Ground everywhere and pillars of some clusters on half of it, on a square grid; errors, triangles and texels are as
//! bakes of scans have them. The same number of clusters, the same city.

use bytemuck::Zeroable;
use glam::DVec3;
use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord, ModelRecord, NodeRecord};
use pb_lod::progressive_buffers::model::FLAG_TEXTURES;
use pb_lod::progressive_buffers::select::{SelectTables, Selector};
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MapRecord, Textures, TileRecord};
use pb_stream::ChunkId;
use pb_stream::cache::ChunkInfo;

pub const LEVELS: u32 = 5;
const QUANTUM: f64 = 1.0 / 1024.0;
/// Distance between neighbouring places of the grid, and the radius of a cluster, world units: metres.
const STEP: f64 = 4.0;
const RADIUS: f64 = 2.7;
/// Most clusters of a pillar.
const STOREYS: u32 = 4;

/// Tables of one city.
pub struct City {
    pub model: ModelRecord,
    pub clusters: Vec<ClusterRecord>,
    pub levels: Vec<LevelRecord>,
    pub neighbours: Vec<u32>,
    pub nodes: Vec<NodeRecord>,
    pub maps: Vec<MapRecord>,
    pub tiles: Vec<TileRecord>,
    /// Per chunk: bytes in RAM and in VRAM.
    pub chunk_bytes: Vec<u64>,
    /// Half the width, world units.
    pub half_width: f64,
}

/// A number in `[0, 1)` from two others.
fn noise(a: u32, b: u32) -> f64 {
    let mut x = u64::from(a).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(b).wrapping_mul(0xd134_2543_de82_ef95);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// A cluster's place on the grid.
type Place = [i32; 3];

impl City {
    pub fn new(clusters: u32) -> City {
        let mut places = places(clusters);
        let side = places.iter().map(|p| p[0]).max().unwrap_or(0) + 1;
        let mut city = City {
            model: ModelRecord::zeroed(),
            clusters: Vec::new(),
            levels: Vec::new(),
            neighbours: Vec::new(),
            nodes: Vec::new(),
            maps: vec![MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb)],
            tiles: Vec::new(),
            chunk_bytes: Vec::new(),
            half_width: f64::from(side) * STEP * 0.5,
        };
        (city.model.quantum, city.model.levels, city.model.clusters) = (QUANTUM, LEVELS, clusters);
        city.model.flags |= FLAG_TEXTURES;
        city.split(&mut places, 0);
        places.iter().for_each(|p| city.add_cluster(p, side));
        city.add_neighbours(&places);
        city.fill_nodes();
        let textures = city.textures();
        let places = (0..clusters).flat_map(|c| (0..LEVELS).map(move |i| (c, i)));
        let bytes: Vec<u64> = places.map(|(c, i)| u64::from(textures.chunk_bytes(c, i))).collect();
        city.chunk_bytes.extend(bytes);
        city
    }

    /// Halves the clusters across their longer side until each is a leaf of the tree; their order is the tree's.
    fn split(&mut self, places: &mut [Place], first: u32) -> u32 {
        let node = self.nodes.len();
        let count = places.len() as u32;
        let leaf = NodeRecord { left: u32::MAX, right: u32::MAX, first_cluster: first, ..Zeroable::zeroed() };
        self.nodes.push(NodeRecord { cluster_count: count, ..leaf });
        if count > 1 {
            let width = |axis: usize| {
                let of = |p: &Place| p[axis];
                places.iter().map(of).max().unwrap_or(0) - places.iter().map(of).min().unwrap_or(0)
            };
            let axis = (0..3).max_by_key(|&axis| width(axis)).unwrap_or(0);
            places.sort_unstable_by_key(|p| (p[axis], *p));
            let (left, right) = places.split_at_mut(count as usize / 2);
            let middle = first + left.len() as u32;
            let children = (self.split(left, first), self.split(right, middle));
            (self.nodes[node].left, self.nodes[node].right) = children;
        }
        node as u32
    }

    fn add_cluster(&mut self, place: &Place, side: i32) {
        let c = self.clusters.len() as u32;
        let world = DVec3::from(place.map(f64::from)) * STEP - DVec3::new(1.0, 0.0, 1.0) * f64::from(side) * STEP * 0.5;
        let jitter = DVec3::new(noise(c, 0), noise(c, 1), noise(c, 2)) - 0.5;
        let mut record = ClusterRecord::zeroed();
        record.center = ((world + jitter) / QUANTUM).round().as_ivec3().to_array();
        record.origin = record.center;
        record.radius = ((RADIUS + noise(c, 3)) / QUANTUM) as f32;
        self.clusters.push(record);
        let finest = 2000.0 + 6000.0 * noise(c, 4);
        let error = RADIUS * 2e-4 * 10f64.powf(noise(c, 5));
        let level = |i: u32| {
            let vertices = (finest / 4f64.powi(i as i32)) as u32 + 3;
            let error = if i == 0 { 0.0 } else { (error * 4f64.powi(i as i32 - 1)) as f32 };
            LevelRecord { vertices, triangles: vertices * 2, error, acmr: 0.7 }
        };
        self.levels.extend((0..LEVELS).map(level));
        for i in 0..LEVELS {
            let coarser = if i + 1 < LEVELS { level(i + 1).vertices } else { 0 };
            let bytes = 16 * u64::from(level(i).vertices - coarser) + 6 * u64::from(level(i).triangles);
            self.chunk_bytes.push(bytes.next_multiple_of(16));
        }
        let size_log2 = if noise(c, 6) < 0.5 { 8 } else { 9 };
        let texel = (2.0 * RADIUS / f64::from(1 << size_log2)) as f32;
        self.tiles.push(TileRecord { size_log2, first: [0; 4], reserved: [0; 3], texel });
    }

    /// Those beside, above and below.
    fn add_neighbours(&mut self, places: &[Place]) {
        let mut by_place: Vec<(Place, u32)> = places.iter().copied().zip(0..).collect();
        by_place.sort_unstable();
        for (place, cluster) in places.iter().zip(&mut self.clusters) {
            cluster.neighbours_first = self.neighbours.len() as u32;
            for (axis, step) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
                let mut beside = *place;
                beside[axis] += step;
                if let Ok(found) = by_place.binary_search_by_key(&beside, |(p, _)| *p) {
                    self.neighbours.push(by_place[found].1);
                }
            }
            cluster.neighbours_count = self.neighbours.len() as u32 - cluster.neighbours_first;
        }
    }

    /// Spheres around the children's, from the leaves up.
    fn fill_nodes(&mut self) {
        for i in (0..self.nodes.len()).rev() {
            let node = self.nodes[i];
            let sphere = |n: &NodeRecord| (DVec3::from(n.center.map(f64::from)), f64::from(n.radius));
            let parts: Vec<(DVec3, f64)> = match node.cluster_count {
                1 => {
                    let c = &self.clusters[node.first_cluster as usize];
                    vec![(DVec3::from(c.center.map(f64::from)), f64::from(c.radius))]
                }
                _ => [node.left, node.right].iter().map(|&n| sphere(&self.nodes[n as usize])).collect(),
            };
            let center = (parts.iter().map(|p| p.0).sum::<DVec3>() / parts.len() as f64).round();
            let radius = parts.iter().map(|p| p.0.distance(center) + p.1).fold(0.0, f64::max);
            self.nodes[i].center = center.as_ivec3().to_array();
            self.nodes[i].radius = (radius as f32).next_up();
        }
    }

    pub fn textures(&self) -> Textures<'_> {
        Textures { maps: &self.maps, tiles: &self.tiles, levels: LEVELS }
    }

    pub fn selector(&self) -> Selector {
        Selector::new(&SelectTables {
            instances: None,
            model: &self.model,
            clusters: &self.clusters,
            levels: &self.levels,
            neighbours: &self.neighbours,
            nodes: &self.nodes,
            textures: Some(self.textures()),
            chunk_bytes: &self.chunk_bytes,
        })
    }

    pub fn is_texture(&self, chunk: usize) -> bool {
        chunk >= self.clusters.len() * LEVELS as usize
    }

    /// Per chunk: it never leaves.
    pub fn always(&self) -> Vec<bool> {
        let last = |c: usize| c % LEVELS as usize == LEVELS as usize - 1;
        let always = |(c, &bytes): (usize, &u64)| last(c) || self.is_texture(c) && bytes == 0;
        self.chunk_bytes.iter().enumerate().map(always).collect()
    }

    /// The chunks as the cache sees them.
    pub fn infos(&self) -> Vec<ChunkInfo> {
        let always = self.always();
        let info = |chunk: usize| {
            let bytes = if always[chunk] { 0 } else { self.chunk_bytes[chunk] };
            let coarser = !always[chunk] && !always[chunk + 1];
            ChunkInfo {
                ram_bytes: bytes as u32,
                vram_bytes: bytes,
                pool: self.is_texture(chunk).into(),
                coarser: coarser.then_some(ChunkId(chunk as u32 + 1)),
                pinned: false,
            }
        };
        (0..self.chunk_bytes.len()).map(info).collect()
    }

    /// Bytes of the geometry that never leaves.
    pub fn coarse_bytes(&self) -> u64 {
        let levels = LEVELS as usize;
        self.chunk_bytes.iter().skip(levels - 1).step_by(levels).take(self.clusters.len()).sum()
    }
}

/// On a square of the grid: ground, and here and there a pillar on it.
fn places(clusters: u32) -> Vec<Place> {
    let storeys = |x: u32, z: u32| match noise(x, z) {
        r if r < 0.5 => 1,
        r => 2 + (2.0 * (r - 0.5) * f64::from(STOREYS)) as u32,
    };
    // Squares around the corner, so that the city grows with the number.
    let mut out = Vec::with_capacity(clusters as usize);
    let mut ring = 0;
    while out.len() < clusters as usize {
        let ring_places = (0..=ring).map(|i| (ring, i)).chain((0..ring).map(|i| (i, ring)));
        for (x, z) in ring_places {
            out.extend((0..storeys(x, z)).map(|y| [x as i32, y as i32, z as i32]));
        }
        ring += 1;
    }
    out.truncate(clusters as usize);
    out
}
