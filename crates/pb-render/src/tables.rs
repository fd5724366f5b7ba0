//! Structs as the shaders see them, byte for byte; a test compares them with display.wgsl.

use bytemuck::{Pod, Zeroable};

/// `View` in display.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ViewUniform {
    /// Eye-relative world space to clip space, by columns.
    pub clip_from_eye: [[f32; 4]; 4],
    /// Grid cell of the eye.
    pub eye_cell: [i32; 3],
    /// Grid step, world units.
    pub quantum: f32,
    /// Eye relative to its cell, world units.
    pub eye_rest: [f32; 3],
    /// Number of clusters.
    pub clusters: u32,
    /// Unit vector to the sun, world space.
    pub sun: [f32; 3],
    /// [`ColorMode`](crate::ColorMode) as a number.
    pub color_mode: u32,
    /// 1 paints back faces in magenta.
    pub show_back_faces: u32,
    /// 1, or 0 to snap between levels.
    pub morph: f32,
    /// 1 where vertices carry colours; else surfaces are grey.
    pub has_colors: u32,
    /// 1 where vertices carry texture coordinates in place of colours.
    pub textured: u32,
    /// By [`MapKind`](pb_lod::progressive_buffers::textures::MapKind) eight bits: its place in the model's maps, or 255 where there is none.
    pub maps: u32,
    /// Most samples along the longer axis of a pixel's footprint, at least 1.
    pub anisotropy: f32,
    /// 1 where the picture cannot hold light brighter than 1.
    pub tone_map: u32,
    /// Where among the links the clusters of the coarse buffer's vertices begin.
    pub first_owner: u32,
    /// Where in the frame's words the draws begin.
    pub first_draw: u32,
    /// Zero.
    pub reserved: [u32; 3],
}

/// `Cluster` in display.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ClusterGpu {
    /// Grid point that vertex offsets are relative to.
    pub origin: [i32; 3],
    /// Vertex offsets are multiples of `2^shift` quanta.
    pub shift: u32,
    /// First entry in the neighbour list.
    pub neighbours_first: u32,
    /// Zero.
    pub reserved: [u32; 3],
}

/// `Level` in display.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct LevelGpu {
    /// Vertices of this level, the prefix `[0, vertices)` of the cluster.
    pub vertices: u32,
    /// Vertex `v` that dies at this level is entry `base + v` of the heap, modulo 2^32.
    pub base: u32,
}

/// Arguments of one indexed draw, as the adapter reads them.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct DrawArguments {
    /// Number of indices.
    pub index_count: u32,
    /// 1.
    pub instance_count: u32,
    /// First index, counted in u16 from the start of the heap.
    pub first_index: u32,
    /// 0: indices are local to their cluster.
    pub base_vertex: i32,
    /// `cluster * 16 + level`; where there are instances, number of the [`DrawGpu`], or of the [`StandGpu`] in draws of the
    /// coarse buffer.
    pub first_instance: u32,
}

/// How an instance stands in a frame: what `stand_of` in display.wgsl reads from five words.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct StandGpu {
    /// Grid cell of the eye, as the object has it.
    pub eye_cell: [i32; 3],
    /// What multiplies a distance in the object before it is compared with switch distances.
    pub stretch: f32,
    /// Eye relative to its cell, object units.
    pub eye_rest: [f32; 3],
    /// Zero.
    pub reserved: u32,
    /// The object's axes in the world, as long as its scale; the fourth component is zero.
    pub axes: [[f32; 4]; 3],
}

/// One draw of a cluster for an instance: a word in display.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct DrawGpu {
    /// `cluster * 16 + level`.
    pub draw: u32,
    /// Number of the [`StandGpu`].
    pub slot: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

const _: () = {
    assert!(size_of::<ViewUniform>() == 160);
    assert!(size_of::<StandGpu>() == 80 && size_of::<DrawGpu>() == 16);
    assert!(size_of::<ClusterGpu>() == 32);
    assert!(size_of::<LevelGpu>() == 8);
    assert!(size_of::<DrawArguments>() == 20);
};
