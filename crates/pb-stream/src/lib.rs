//! Residency: disk -> decoded chunks in RAM -> VRAM (paper section 4, design section 6).
//!
//! - [`cache`]: the state machine that decides; events in, commands out;
//! - [`loader`]: threads that carry out its load commands;
//! - [`merge`]: which of them one read serves;
//! - [`disk`]: a slow disk on virtual time;
//! - [`journal`]: a run of the cache on disk, and its replay.
//!
//! Must never: know what is inside a chunk, touch a GPU, or read a clock.

pub mod cache;
pub mod disk;
pub mod journal;
pub mod loader;
pub mod merge;

/// A chunk, by its index in the archive's chunk table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct ChunkId(pub u32);

/// Priority class, the paper's section 4.1; higher is more urgent. What is not wanted is on disk only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub enum Class {
    /// May be needed: into RAM.
    Maybe,
    /// About to be drawn: into VRAM.
    Soon,
    /// Drawn now: into VRAM.
    Now,
}

/// A chunk that the view would like to have.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Want {
    /// Which chunk.
    pub chunk: ChunkId,
    /// How urgent.
    pub class: Class,
    /// Screen-space error in pixels if it is missing: the order inside a class, largest first.
    #[serde(with = "journal::bits")]
    pub error_px: f32,
}
