//! What selection keeps of an archive: about 100 bytes per cluster, and nothing that needs the file again.

use glam::DVec3;

use super::super::display::lod_from;
use super::super::instances::Instances;
use super::super::layout::{ClusterRecord, LevelRecord, ModelRecord, NodeRecord};
use super::super::model::Model;
use super::super::switch::{Switch, increasing, min_step};
use super::super::textures::{Textures, TileRecord};
use super::crowd::Crowd;
use crate::plan::ChunkId;

/// The archive's tables as selection reads them once; see [`super::super::layout`] for each.
#[derive(Clone, Copy)]
pub struct SelectTables<'a> {
    /// The whole model.
    pub model: &'a ModelRecord,
    /// Clusters in the leaf order of the tree.
    pub clusters: &'a [ClusterRecord],
    /// `cluster * levels + level`.
    pub levels: &'a [LevelRecord],
    /// Concatenated neighbour lists.
    pub neighbours: &'a [u32],
    /// The coarse buffer hierarchy; node 0 is the root.
    pub nodes: &'a [NodeRecord],
    /// Maps and tiles, where the model has textures.
    pub textures: Option<Textures<'a>>,
    /// Objects and instances, where the model has them.
    pub instances: Option<Instances<'a>>,
    /// Bytes of each chunk in VRAM, `cluster * levels + level`, in the unit of the VRAM budget; those of the textures,
    /// in the unit of theirs, follow where there are any; `u64::MAX` for those that never fit and are not to be wanted.
    pub chunk_bytes: &'a [u64],
}

impl<'a> SelectTables<'a> {
    /// Those of an open archive.
    pub fn of(model: &'a Model, chunk_bytes: &'a [u64]) -> Self {
        Self {
            model: model.record(),
            clusters: model.clusters(),
            levels: model.level_records(),
            neighbours: model.neighbour_entries(),
            nodes: model.nodes(),
            textures: model.textures(),
            instances: model.instances(),
            chunk_bytes,
        }
    }
}

/// The two sequences of chunks of a cluster, each with its own level of detail
/// (docs/decisions/007-textures.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ladder {
    /// Vertices and indices: by measured error.
    Geometry,
    /// Texture mips: by texel size.
    Texture,
}

/// Off the centre of a picture pixels cover smaller angles, so texels have to be smaller than a pixel at its centre.
const TEXELS_PER_PIXEL: f32 = 1.4;

/// Largest texels, input units, that are fine enough at a reach: as small as the pixels, or as the allowed error where
/// that is larger.
fn allowed_texel(switch: &Switch, reach: f32) -> f32 {
    reach * (1.0 / switch.scale).max(1.0) / TEXELS_PER_PIXEL
}

/// Of a number that is not negative; at most -127 below the normal ones.
fn floor_log2(x: f32) -> i32 {
    (x.to_bits() >> (f32::MANTISSA_DIGITS - 1)) as i32 - (f32::MAX_EXP - 1)
}

/// A sphere in world units, relative to the model's origin.
#[derive(Clone, Copy)]
pub(super) struct Sphere {
    pub center: DVec3,
    pub radius: f64,
}

impl Sphere {
    /// From grid units.
    fn new(center: [i32; 3], radius: f32, quantum: f64) -> Sphere {
        Sphere { center: DVec3::from_array(center.map(f64::from)) * quantum, radius: f64::from(radius) * quantum }
    }
}

/// A node of the tree, reduced to what the walk needs.
#[derive(Clone, Copy)]
pub(super) struct Node {
    pub sphere: Sphere,
    pub first: u32,
    pub count: u32,
    pub children: Option<[u32; 2]>,
    /// Largest (increasing) error of the coarsest level below this node, input units.
    pub error: f32,
    /// Size of the largest texels below this node that are always resident, input units; 0 where no others exist.
    pub texel: f32,
}

/// What the walk up and down the mips of a cluster needs.
#[derive(Clone, Copy)]
struct Tile {
    /// Texel size of mip 0, input units.
    texel: f32,
    /// The finest mip that ever fits.
    finest: u32,
    /// The mip that the tail begins with.
    tail: u32,
}

impl Tile {
    fn new(record: &TileRecord, levels: u32, chunk_bytes: &[u64]) -> Tile {
        let tail = record.tail(levels);
        let fits = |l: &u32| chunk_bytes[*l as usize] < u64::MAX;
        Tile { texel: record.texel, finest: (0..tail).rev().take_while(fits).last().unwrap_or(tail), tail }
    }
}

pub(super) struct Tables {
    pub origin: DVec3,
    pub quantum: f64,
    pub levels: u32,
    /// Bytes of all coarsest chunks of geometry: always resident.
    pub coarse_bytes: u64,
    /// Bytes of all that can ever be wanted, geometry and textures.
    pub all_bytes: [u64; 2],
    pub nodes: Vec<Node>,
    spheres: Vec<Sphere>,
    /// `cluster * levels + level`, increasing in level, 0 at level 0.
    errors: Vec<f32>,
    triangles: Vec<u32>,
    /// Bytes of the chunks `level .. levels - 1` of the cluster, in the order of the chunks.
    finer_bytes: Vec<u64>,
    /// Where there are textures, by cluster.
    tiles: Vec<Tile>,
    /// First index of each cluster in the coarse buffer, and the end of the last.
    coarse_first: Vec<u32>,
    /// First neighbour of each cluster, and the end of the last.
    neighbours_first: Vec<u32>,
    neighbours: Vec<u32>,
    /// Where the model has instances.
    pub crowd: Option<Crowd>,
}

impl Tables {
    pub fn new(t: &SelectTables) -> Tables {
        let (levels, count) = (t.model.levels as usize, t.clusters.len());
        let kinds = if t.textures.is_some() { 2 } else { 1 };
        assert!(levels >= 1 && t.levels.len() == count * levels && t.chunk_bytes.len() == count * levels * kinds);
        let quantum = t.model.quantum;
        let mut out = Tables {
            origin: DVec3::from_array(t.model.origin),
            quantum,
            levels: t.model.levels,
            coarse_bytes: t.chunk_bytes.iter().skip(levels - 1).step_by(levels).take(count).sum(),
            all_bytes: [0; 2],
            nodes: Vec::new(),
            spheres: t.clusters.iter().map(|c| Sphere::new(c.center, c.radius, quantum)).collect(),
            errors: Vec::with_capacity(count * levels),
            triangles: t.levels.iter().map(|l| l.triangles).collect(),
            finer_bytes: vec![0; count * levels * kinds],
            tiles: t
                .textures
                .iter()
                .flat_map(|x| x.tiles)
                .zip(t.chunk_bytes[count * levels..].chunks(levels))
                .map(|(tile, bytes)| Tile::new(tile, t.model.levels, bytes))
                .collect(),
            coarse_first: vec![0],
            neighbours_first: vec![0],
            neighbours: Vec::with_capacity(t.neighbours.len()),
            crowd: None,
        };
        for (c, cluster) in t.clusters.iter().enumerate() {
            let rows = &t.levels[c * levels..][..levels];
            let errors = increasing(rows.iter().map(|l| l.error), min_step(quantum));
            out.errors.extend_from_slice(&errors[..levels]);
            out.coarse_first.push(out.coarse_first[c] + rows[levels - 1].triangles * 3);
            let list =
                cluster.neighbours_first as usize..(cluster.neighbours_first + cluster.neighbours_count) as usize;
            out.neighbours.extend_from_slice(&t.neighbours[list]);
            out.neighbours_first.push(out.neighbours.len() as u32);
        }
        for (finer, chunks) in out.finer_bytes.chunks_mut(levels).zip(t.chunk_bytes.chunks(levels)) {
            for i in (0..levels - 1).rev() {
                finer[i] = finer[i + 1].saturating_add(chunks[i]);
            }
        }
        out.nodes = out.reduce(t.nodes);
        out.crowd = t.instances.map(|instances| Crowd::new(&instances, &out.nodes));
        let finest = |ladder, c| if ladder == Ladder::Texture { out.tiles[c as usize].finest } else { 0 };
        let all = |ladder| (0..count as u32).map(move |c| (c, ladder));
        let bytes = |(c, ladder)| out.bytes_above_coarsest(ladder, c, finest(ladder, c));
        let geometry = all(Ladder::Geometry).map(bytes).sum::<u64>() + out.coarse_bytes;
        let textures = if kinds == 2 { all(Ladder::Texture).map(bytes).sum() } else { 0 };
        out.all_bytes = [geometry, textures];
        out
    }

    /// The tree with, per node, the largest error that the display rule can use below it.
    fn reduce(&self, nodes: &[NodeRecord]) -> Vec<Node> {
        let coarsest = self.levels - 1;
        let node = |n: &NodeRecord| Node {
            // A leaf's sphere is its cluster's, so that one look at it is enough.
            sphere: match n.cluster_count {
                1 => self.spheres[n.first_cluster as usize],
                _ => Sphere::new(n.center, n.radius, self.quantum),
            },
            first: n.first_cluster,
            count: n.cluster_count,
            children: (n.left != u32::MAX).then_some([n.left, n.right]),
            error: (n.first_cluster..n.first_cluster + n.cluster_count)
                .map(|c| self.error(c, coarsest))
                .fold(0.0, f32::max),
            texel: self
                .tiles
                .iter()
                .skip(n.first_cluster as usize)
                .take(n.cluster_count as usize)
                .map(|x| if x.tail > 0 { x.texel * (1u32 << x.tail) as f32 } else { 0.0 })
                .fold(0.0, f32::max),
        };
        nodes.iter().map(node).collect()
    }

    pub fn clusters(&self) -> usize {
        self.spheres.len()
    }

    pub fn chunks(&self) -> usize {
        self.finer_bytes.len()
    }

    /// Ladder and cluster of a chunk.
    pub fn place(&self, chunk: ChunkId) -> (Ladder, u32) {
        let cluster = chunk.0 / self.levels;
        match cluster.checked_sub(self.clusters() as u32) {
            None => (Ladder::Geometry, cluster),
            Some(cluster) => (Ladder::Texture, cluster),
        }
    }

    /// Those that the model has.
    pub fn ladders(&self) -> impl Iterator<Item = Ladder> {
        [Ladder::Geometry, Ladder::Texture].into_iter().take(if self.has_textures() { 2 } else { 1 })
    }

    pub fn has_textures(&self) -> bool {
        !self.tiles.is_empty()
    }

    fn row(&self, cluster: u32, level: u32) -> usize {
        (cluster * self.levels + level) as usize
    }

    pub fn chunk(&self, ladder: Ladder, cluster: u32, level: u32) -> ChunkId {
        let first = match ladder {
            Ladder::Geometry => 0,
            Ladder::Texture => self.clusters() as u32,
        };
        ChunkId(self.row(first + cluster, level) as u32)
    }

    /// The finest level of a ladder that is always resident.
    pub fn coarsest(&self, ladder: Ladder, cluster: u32) -> u32 {
        match ladder {
            Ladder::Geometry => self.levels - 1,
            Ladder::Texture => self.tiles[cluster as usize].tail,
        }
    }

    pub fn sphere(&self, cluster: u32) -> &Sphere {
        &self.spheres[cluster as usize]
    }

    pub fn errors(&self, cluster: u32) -> &[f32] {
        &self.errors[self.row(cluster, 0)..][..self.levels as usize]
    }

    /// Of all clusters, `cluster * levels + level`.
    pub fn all_errors(&self) -> &[f32] {
        &self.errors
    }

    fn error(&self, cluster: u32, level: u32) -> f32 {
        self.errors[self.row(cluster, level)]
    }

    /// Error at a fractional level, input units.
    pub fn error_at(&self, cluster: u32, lod: f32) -> f32 {
        let level = (lod as u32).min(self.levels - 1);
        let fine = self.error(cluster, level);
        match level + 1 < self.levels {
            true => fine + (self.error(cluster, level + 1) - fine) * (lod - level as f32),
            false => fine,
        }
    }

    /// Error of what is drawn instead of `level` where its chunk is missing, input units: for textures the size of the
    /// texels.
    pub fn error_if_missing(&self, ladder: Ladder, cluster: u32, level: u32) -> f32 {
        match (ladder, level + 1 < self.levels) {
            (Ladder::Texture, _) => self.tiles[cluster as usize].texel * (2u32 << level) as f32,
            (Ladder::Geometry, true) => self.error(cluster, level + 1),
            (Ladder::Geometry, false) => (self.sphere(cluster).radius as f32).max(2.0 * self.error(cluster, level)),
        }
    }

    pub fn triangles(&self, cluster: u32, level: u32) -> u32 {
        self.triangles[self.row(cluster, level)]
    }

    /// Bytes of the chunks `level ..= L-2` of a cluster.
    pub fn bytes_above_coarsest(&self, ladder: Ladder, cluster: u32, level: u32) -> u64 {
        self.finer_bytes[self.chunk(ladder, cluster, level).0 as usize]
    }

    /// Bytes of one chunk in VRAM.
    #[cfg(test)]
    pub fn chunk_bytes(&self, chunk: ChunkId) -> u64 {
        let (at, levels) = (chunk.0 as usize, self.levels as usize);
        self.finer_bytes[at] - if at % levels == levels - 1 { 0 } else { self.finer_bytes[at + 1] }
    }

    /// Index range of a run of clusters in the coarse buffer.
    pub fn coarse_indices(&self, clusters: std::ops::Range<u32>) -> std::ops::Range<u32> {
        self.coarse_first[clusters.start as usize]..self.coarse_first[clusters.end as usize]
    }

    pub fn neighbours(&self, cluster: u32) -> &[u32] {
        let c = cluster as usize;
        &self.neighbours[self.neighbours_first[c] as usize..self.neighbours_first[c + 1] as usize]
    }

    /// Level of detail from distance alone: [`super::super::display::LodTable::lod`] without the floor, of a
    /// reach as [`super::walk::Eyes::reach`] measures it.
    pub fn lod(&self, switch: &Switch, cluster: u32, reach: f32) -> f32 {
        let errors = self.errors(cluster);
        lod_from(errors.len() - 1, |i| switch.distance(errors, i), reach)
    }

    /// The same for textures: a mip is fine enough where its texels are as small as the pixels, or as the allowed error
    /// where that is larger. With bands, textures follow the geometry. From the finest mip that fits to the first of the
    /// tail.
    pub fn texture_lod(&self, switch: &Switch, cluster: u32, reach: f32) -> f32 {
        let Tile { texel, finest, tail } = self.tiles[cluster as usize];
        if switch.bands.is_some() {
            return self.lod(switch, cluster, reach).clamp(finest as f32, tail as f32);
        }
        (allowed_texel(switch, reach) / texel).log2().clamp(finest as f32, tail as f32)
    }

    /// The whole level of detail of either kind; where rounding would reach the next level, the finer one.
    #[inline]
    pub fn ladder_level(&self, ladder: Ladder, switch: &Switch, cluster: u32, reach: f32) -> u32 {
        let level = || {
            let errors = self.errors(cluster);
            let is_nearer = |i: &usize| reach < switch.distance(errors, i + 1);
            (0..errors.len() - 1).find(is_nearer).unwrap_or(errors.len() - 1) as u32
        };
        if ladder == Ladder::Geometry {
            return level();
        }
        let Tile { texel, finest, tail } = self.tiles[cluster as usize];
        match switch.bands {
            Some(_) => level().clamp(finest, tail),
            None => floor_log2(allowed_texel(switch, reach) / texel).clamp(finest as i32, tail as i32) as u32,
        }
    }

    /// Whether all clusters below a node show only always resident mips, seen from this reach or farther.
    pub fn textures_coarse(&self, switch: &Switch, node: &Node, reach: f32) -> bool {
        match &switch.bands {
            _ if node.texel == 0.0 => true,
            Some(bands) => reach >= bands[self.levels as usize - 1],
            None => allowed_texel(switch, reach) >= node.texel,
        }
    }
}
