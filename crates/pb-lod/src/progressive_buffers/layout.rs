//! Tables and chunks of a progressive-buffers archive; docs/format.md gives the same byte by byte.
//!
//! Chunk `cluster * levels + level` holds what `level` adds to `level + 1` in one cluster: vertices
//! `[n_{level+1}, n_level)` and the index buffer of `level`. Clusters are stored in the leaf order of the
//! coarse buffer hierarchy, so a subtree is a range of clusters.

use bytemuck::{Pod, Zeroable};

/// Most levels an archive may have.
pub const MAX_LEVELS: usize = 12;
/// Scheme tag in the archive header.
pub const SCHEME: [u8; 4] = *b"PBUF";
/// Section tag of the one [`ModelRecord`].
pub const MODEL: [u8; 4] = *b"MODL";
/// Section tag of the [`ClusterRecord`]s.
pub const CLUSTERS: [u8; 4] = *b"CLUS";
/// Section tag of the [`LevelRecord`]s, `cluster * levels + level`.
pub const LEVELS: [u8; 4] = *b"LEVL";
/// Section tag of the neighbour lists, u32 cluster indices.
pub const NEIGHBOURS: [u8; 4] = *b"NEIG";
/// Section tag of the [`NodeRecord`]s of the coarse buffer hierarchy; node 0 is the root.
pub const NODES: [u8; 4] = *b"TREE";
/// Section tag of the [`ModelLevelRecord`]s, one per level.
pub const MODEL_LEVELS: [u8; 4] = *b"MLEV";

/// Border slot of a vertex that no other cluster uses, or that never moves (corners, locked vertices).
pub const SLOT_NONE: u8 = 0;

/// The whole model. 96 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ModelRecord {
    /// World position (input units) of grid point (0, 0, 0).
    pub origin: [f64; 3],
    /// Grid step in input units, a power of two.
    pub quantum: f64,
    /// Smallest grid coordinates of the model.
    pub bounds_min: [i32; 3],
    /// Largest grid coordinates of the model.
    pub bounds_max: [i32; 3],
    /// Number of levels L, 1 to [`MAX_LEVELS`]; 0 is the finest.
    pub levels: u32,
    /// Number of clusters.
    pub clusters: u32,
    /// Triangles in the input files, before repair.
    pub triangles_in: u64,
    /// Bit 0: vertices carry colours; bit 1: textures; bit 2: textures with cut-outs.
    pub flags: u32,
    /// Zero.
    pub reserved: [u32; 5],
}

/// One cluster. 48 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ClusterRecord {
    /// Grid point that vertex offsets are relative to.
    pub origin: [i32; 3],
    /// Vertex offsets are multiples of `2^shift` quanta.
    pub shift: u32,
    /// Centre of the bounding sphere, grid space.
    pub center: [i32; 3],
    /// Radius of the bounding sphere, quanta, rounded up: holds every level-0 position (I4).
    pub radius: f32,
    /// First entry of this cluster in the neighbour section.
    pub neighbours_first: u32,
    /// Number of neighbours, at most 255; border slot `k` of a vertex names neighbour `k - 1`.
    pub neighbours_count: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// One level of one cluster. 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LevelRecord {
    /// Vertices of this level: the prefix `[0, vertices)` of the cluster, at most 65535.
    pub vertices: u32,
    /// Triangles of this level.
    pub triangles: u32,
    /// Bound of the distance between this level and the input surface, input units.
    pub error: f32,
    /// Average cache misses per triangle (ACMR, 16-entry FIFO) of this level's index buffer.
    pub acmr: f32,
}

/// One level of the whole model. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ModelLevelRecord {
    /// Distinct positions.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Largest bound over all clusters, input units.
    pub max_error: f64,
    /// Root mean square distance of the input's vertices to this level, input units.
    pub rms_error: f64,
}

/// A node of the coarse buffer hierarchy over the clusters `[first_cluster, first_cluster + cluster_count)`.
/// Children of an inner node: `left` and `right`; a leaf has one cluster and both are `u32::MAX`. 40 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct NodeRecord {
    /// Centre of a sphere that holds all clusters' spheres, grid space.
    pub center: [i32; 3],
    /// Its radius, quanta.
    pub radius: f32,
    /// First cluster below this node.
    pub first_cluster: u32,
    /// Number of clusters below this node.
    pub cluster_count: u32,
    /// Index of the left child or `u32::MAX`.
    pub left: u32,
    /// Index of the right child or `u32::MAX`.
    pub right: u32,
    /// Largest error of level L-1 below this node, input units.
    pub error: f32,
    /// Zero.
    pub reserved: u32,
}

/// A vertex as stored and as the shader pulls it. 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Vertex {
    /// Offset from the cluster's origin in `2^shift` quanta.
    pub offset: [u16; 3],
    /// Index of the parent in the same cluster (I3); itself when it lives at the coarsest level.
    pub parent: u16,
    /// Octahedral normal: x in bits 0-11, y in bits 12-23; border slot in bits 24-31.
    pub normal_slot: u32,
    /// RGBA8, sRGB; white where the input has no colours. In a textured model see [`Vertex::uv`].
    pub color: [u8; 4],
}

impl Vertex {
    /// Border slot: 0, or 1 + index into the cluster's neighbour list.
    pub fn slot(&self) -> u8 {
        (self.normal_slot >> 24) as u8
    }

    /// Texture coordinates in a textured model: units of 1 / 65536 of the tile, v downwards.
    pub fn uv(&self) -> [u16; 2] {
        let [a, b, c, d] = self.color;
        [u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])]
    }

    /// Texture coordinates as they lie in the place of the colour.
    pub fn pack_uv([u, v]: [u16; 2]) -> [u8; 4] {
        let ([a, b], [c, d]) = (u.to_le_bytes(), v.to_le_bytes());
        [a, b, c, d]
    }

    /// Packs a unit normal (object space, any length but zero) and a border slot.
    pub fn pack_normal_slot(normal: [f32; 3], slot: u8) -> u32 {
        let s = normal[0].abs() + normal[1].abs() + normal[2].abs();
        let (mut x, mut y) = if s > 0.0 { (normal[0] / s, normal[1] / s) } else { (0.0, 0.0) };
        if normal[2] < 0.0 {
            (x, y) = ((1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y));
        }
        let q = |v: f32| ((v.clamp(-1.0, 1.0) * 2047.0).round() as i32 + 2047) as u32;
        q(x) | q(y) << 12 | (slot as u32) << 24
    }

    /// Unit normal, object space.
    pub fn normal(&self) -> [f32; 3] {
        let d = |v: u32| (v & 0xfff) as f32 * (1.0 / 2047.0) - 1.0;
        let (mut x, mut y) = (d(self.normal_slot), d(self.normal_slot >> 12));
        let z = 1.0 - x.abs() - y.abs();
        if z < 0.0 {
            (x, y) = ((1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y));
        }
        let l = (x * x + y * y + z * z).sqrt();
        [x / l, y / l, z / l]
    }
}

const _: () = {
    assert!(size_of::<ModelRecord>() == 96);
    assert!(size_of::<ClusterRecord>() == 48);
    assert!(size_of::<LevelRecord>() == 16);
    assert!(size_of::<ModelLevelRecord>() == 32);
    assert!(size_of::<NodeRecord>() == 40);
    assert!(size_of::<Vertex>() == 16);
};
