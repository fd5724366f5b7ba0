//! What every other crate sees of a level-of-detail scheme: a frame goes in, a plan comes out.
//!
//! `select(&Frame) -> Plan` is deterministic: no GPU, no clock, no threads. Chunks are named by the
//! archive's chunk index; what is inside a chunk is the scheme's own business.

use glam::{DVec3, Vec4};

/// Index of a chunk in the archive's chunk table: the unit of I/O and of residency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChunkId(pub u32);

/// One camera. World space is the input's space, in input units.
#[derive(Clone, Debug)]
pub struct View {
    /// Eye position, world space.
    pub eye: DVec3,
    /// Frustum planes relative to the eye: `dot(plane.xyz, p - eye) + plane.w >= 0` inside.
    pub planes: Vec<Vec4>,
    /// Angle that one pixel covers at the image centre, radians.
    pub pixel_angle: f32,
}

/// How the switch distances of the display rule are filled (design section 4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Detail {
    /// Screen-space error: a level is used where its measured error projects to at most this many pixels.
    ErrorPx(f32),
    /// The paper's bands: `D_i = (2^i - 1) k + s`, world units.
    Bands {
        /// Band size k, world units.
        k: f32,
        /// Bias s, world units.
        s: f32,
    },
}

impl Detail {
    /// With its error multiplied, or its bands divided, by `gain`.
    pub fn coarsened(self, gain: f64) -> Detail {
        match self {
            Detail::ErrorPx(tau) => Detail::ErrorPx((tau as f64 * gain) as f32),
            Detail::Bands { k, s } => Detail::Bands { k: (k as f64 / gain) as f32, s: (s as f64 / gain) as f32 },
        }
    }
}

/// What is loaded before it is drawn (paper section 4.1).
#[derive(Clone, Copy, Debug, Default)]
pub struct Prefetch<'a> {
    /// Also what the view would want from a little nearer, or turned a little: for cameras that go anywhere.
    pub around: bool,
    /// Cameras that are expected at once: what they draw is wanted in VRAM.
    pub soon: &'a [View],
    /// Cameras that are expected later: what they draw is wanted in RAM.
    pub later: &'a [View],
}

impl Prefetch<'_> {
    /// Around the view alone.
    pub const AROUND: Prefetch<'static> = Prefetch { around: true, soon: &[], later: &[] };
    /// Nothing is loaded before it is drawn.
    pub const OFF: Prefetch<'static> = Prefetch { around: false, soon: &[], later: &[] };

    /// Whether anything is wanted that the view does not draw.
    pub fn is_off(&self) -> bool {
        !self.around && self.soon.is_empty() && self.later.is_empty()
    }
}

/// Everything that selection may depend on.
#[derive(Clone, Debug)]
pub struct Frame<'a> {
    /// The cameras of this frame; a chunk is wanted at the finest level that any of them wants.
    pub views: &'a [View],
    /// Per chunk: true when it is in VRAM and may be drawn.
    pub resident: &'a [bool],
    /// Per chunk: true when the cache would like it back; its cluster's floor rises until it is free.
    pub retiring: &'a [bool],
    /// Per chunk: true when it cannot be read and never will be; nothing waits for it.
    pub failed: &'a [bool],
    /// Chunks of which `resident` or `retiring` may differ from the last selection's; none where any may.
    pub changed: Option<&'a [ChunkId]>,
    /// Allowed error or bands.
    pub detail: Detail,
    /// Upper bound for the bytes of all geometry chunks that this frame wants resident; the error rises until it
    /// holds.
    pub vram_budget_bytes: u64,
    /// The same for texture chunks that are not always resident: texels grow until it holds. The two lie in memory
    /// that lends nothing to the other.
    pub texture_budget_bytes: u64,
    /// Upper bound for the triangles drawn; the error rises until it holds. Clusters that hold the eye may break it
    /// until their finer data has left.
    pub max_triangles: u64,
    /// What is loaded before it is drawn.
    pub prefetch: Prefetch<'a>,
    /// These views have little in common with those of the last frame: what comes late for them may fade in faster.
    pub cut: bool,
    /// Seconds since the last frame: how far residency floors may move. `f32::INFINITY` settles them at once.
    pub dt_secs: f32,
}

#[cfg(test)]
impl Frame<'_> {
    /// No view of no model, for tests that change what they are about.
    pub(crate) const EMPTY: Frame<'static> = Frame {
        views: &[],
        resident: &[],
        retiring: &[],
        failed: &[],
        changed: None,
        detail: Detail::ErrorPx(1.0),
        vram_budget_bytes: 0,
        texture_budget_bytes: 0,
        max_triangles: 0,
        prefetch: Prefetch::OFF,
        cut: false,
        dt_secs: 0.1,
    };
}

/// Priority class of a want, the paper's section 4.1: higher is more urgent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// May be needed: RAM.
    Maybe,
    /// About to be drawn: VRAM.
    Soon,
    /// Drawn now: VRAM.
    Now,
}

/// One chunk that a plan would like to have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Want {
    /// Which chunk.
    pub chunk: ChunkId,
    /// How urgent.
    pub class: Class,
    /// Screen-space error in pixels if it is missing: the order inside a class, largest first.
    pub error_px: f32,
}

/// One indexed draw of a cluster.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Draw {
    /// Cluster index.
    pub cluster: u32,
    /// Level whose index buffer is drawn.
    pub level: u32,
    /// Instance of the cluster's object; 0 where the archive has none.
    pub instance: u32,
}

/// A part of the coarse buffer, drawn for one instance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CoarseDraw {
    /// As in [`Draw`].
    pub instance: u32,
    /// In the coarse buffer's indices.
    pub indices: std::ops::Range<u32>,
}

/// What to draw, what to load, what may go.
#[derive(Clone, Debug, Default)]
pub struct Plan {
    /// Clusters drawn on their own, finest first, then near to far.
    pub draws: Vec<Draw>,
    /// Ranges of the coarse buffer, by instance.
    pub coarse: Vec<CoarseDraw>,
    /// Chunks wanted, most urgent first, each once; includes those already resident.
    pub wants: Vec<Want>,
    /// Retiring chunks that nothing drawn depends on any more: the cache may free them now.
    pub released: Vec<ChunkId>,
    /// Wanted for this view (class Now) but not resident.
    pub missing_chunks: u32,
    /// Residency floors of all clusters for this frame (levels, float).
    pub floors: Vec<f32>,
    /// The same of texture mips; empty where the model has no textures.
    pub texture_floors: Vec<f32>,
    /// The detail after the budget was applied.
    pub detail: Option<Detail>,
    /// The same for textures: it may be coarser, because their memory has a budget of its own. None without textures.
    pub texture_detail: Option<Detail>,
    /// The detail in use is coarser than the bounds allow, because data for more is still to come.
    pub rising: bool,
    /// Largest projected error of what is drawn, pixels.
    pub error_px: f32,
    /// Triangles of all draws and coarse ranges.
    pub triangles: u64,
    /// True when every residency floor stands at its goal: nothing fades in or out.
    pub floors_stand: bool,
    /// True when floors stand still and nothing wanted is missing.
    pub settled: bool,
}
