//! The residency state machine: which chunk is loaded, uploaded, retired, freed and dropped, and when.
//!
//! Events in, commands out; no clock, no thread, no GPU, so it can be simulated, recorded and replayed. Decisions are
//! made once per [`frame`](Cache::frame), from two greedy sets in order of priority (class, then error): the chunks
//! that shall be in VRAM, closed under "coarser first" (I5), and those that shall be in RAM for it.
//!
//! Safety: bytes never exceed a bound, everything in flight counted; nothing is freed before the view released it;
//! a chunk is never in VRAM without its coarser one. Liveness: a chunk that is wanted, with its coarser ones, and
//! fits, becomes resident.
//!
//! Leaving VRAM is a dialogue, because what is drawn must not vanish: the cache says [`Command::Retire`], the view
//! stops depending on the chunk over some frames and reports it in `released`, then the cache says
//! [`Command::Free`]. If the chunk is wanted again before that, it says [`Command::Keep`].

mod plan;
mod state;

use crate::{ChunkId, Want};
use plan::Goals;
use state::{Mark, Members, Ram, Vram};

/// VRAM comes in pools that lend nothing to one another: a buffer for geometry, pages for textures.
pub const POOLS: usize = 2;

/// Bounds of the cache. Bytes are those of decoded chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Limits {
    /// Decoded chunks in RAM and on their way there.
    pub ram_bytes: u64,
    /// Chunks in VRAM and on their way there, by pool.
    pub vram_bytes: [u64; POOLS],
    /// Most loads that are asked for and not answered. Many, because neighbours in the file are read together only where
    /// both are asked for; what is less urgent than what would come in its stead is [withdrawn](Command::Withdraw).
    pub loads_in_flight: u32,
    /// Most bytes that one frame begins to upload (at least one chunk, though).
    pub upload_bytes_per_frame: u64,
}

impl Limits {
    /// Loads enough to read whole views in few pieces; uploads that keep a frame short.
    pub fn new(ram_bytes: u64, vram_bytes: [u64; POOLS]) -> Self {
        Self { ram_bytes, vram_bytes, loads_in_flight: 4096, upload_bytes_per_frame: 32 << 20 }
    }
}

/// What the cache knows of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ChunkInfo {
    /// Size in RAM.
    pub ram_bytes: u32,
    /// Size in VRAM, or what it counts for in its pool.
    pub vram_bytes: u64,
    /// Which pool of VRAM it belongs to, below [`POOLS`].
    pub pool: usize,
    /// The chunk of the same pool without which this one cannot be drawn; chains end.
    pub coarser: Option<ChunkId>,
    /// Always wanted, before all else, and never retired.
    pub pinned: bool,
}

/// Bounds that cannot work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitsError {
    /// The pinned chunks alone do not fit.
    #[error("the VRAM bound of {bound} bytes is too small: the coarsest level alone needs {needed}; raise it")]
    Vram {
        /// The bound.
        bound: u64,
        /// Bytes of all pinned chunks.
        needed: u64,
    },
    /// The largest chunk does not fit.
    #[error("the RAM bound of {bound} bytes is too small: the largest chunk needs {needed}; raise it")]
    Ram {
        /// The bound.
        bound: u64,
        /// Bytes of the largest chunk.
        needed: u64,
    },
}

/// What the cache asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Command {
    /// Read and decode from disk; answer with [`Cache::loaded`] or [`Cache::load_failed`].
    Load(ChunkId),
    /// Give up a load, if it was not begun; answer with [`Cache::load_withdrawn`], or, if it was, as to [`Command::Load`].
    /// May be said again while there is no answer.
    Withdraw(ChunkId),
    /// Copy from RAM to VRAM; answer with [`Cache::uploaded`] or [`Cache::upload_failed`].
    Upload(ChunkId),
    /// Forget the copy in RAM.
    DropRam(ChunkId),
    /// Stop depending on the copy in VRAM; answer by listing it in `released` of a later frame.
    Retire(ChunkId),
    /// A retired chunk is wanted again: depend on it as before.
    Keep(ChunkId),
    /// Forget the copy in VRAM. It was released.
    Free(ChunkId),
}

/// Bytes and counts for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// In RAM and on the way there.
    pub ram_bytes: u64,
    /// In VRAM and on the way there.
    pub vram_bytes: u64,
    /// Loads asked for and not answered.
    pub loads_in_flight: u32,
    /// Uploads asked for and not answered.
    pub uploads_in_flight: u32,
    /// Retired and not yet freed.
    pub retiring: u32,
    /// Chunks that could not be loaded and are not asked for again.
    pub failed: u32,
}

/// The state machine.
pub struct Cache {
    limits: Limits,
    info: Vec<ChunkInfo>,
    pinned: Vec<ChunkId>,
    ram: Vec<Ram>,
    vram: Vec<Vram>,
    failed: Vec<bool>,
    /// Loads that were asked for; those that were answered since are still among them.
    loading: Vec<ChunkId>,
    /// Per chunk: length of its chain of coarser ones, itself included.
    depth: Vec<u8>,
    marks: Vec<Mark>,
    goals: Goals,
    /// In RAM and loaded.
    loaded: Members<1>,
    /// In VRAM, by what [`Vram::list`] says.
    in_vram: Members<{ state::LISTS }>,
    /// Per chunk: finer chunks that are in VRAM in any state.
    finer_in_vram: Vec<u32>,
    /// Per chunk: those of them that were not asked back.
    finer_staying: Vec<u32>,
    resident: Vec<bool>,
    retiring: Vec<bool>,
    /// Chunks of which `resident` or `retiring` changed since the last frame began.
    changes: Vec<ChunkId>,
    stats: CacheStats,
    /// Two years of them at 60 per second.
    frame: u32,
    /// By pool: in VRAM and on the way there.
    vram_bytes: [u64; POOLS],
    /// By pool: the part of them that stands in VRAM and was not asked back.
    standing_bytes: [u64; POOLS],
    /// By pool: the part that uploads were refused for (a fragmented heap); shrinks again with time.
    lost_bytes: [u64; POOLS],
    /// Uploads that failed since one worked.
    failures_in_a_row: u32,
    idle: bool,
}

/// After so many refused uploads in a row, what lies in VRAM counts as all that fits.
const MAX_FAILURES: u32 = 8;

impl Cache {
    /// A cache with nothing in it.
    ///
    /// # Panics
    /// If a chain of coarser chunks names a chunk that does not exist or of another pool, or is longer than 255, or a
    /// pinned chunk has a coarser one that is not pinned.
    pub fn new(info: Vec<ChunkInfo>, limits: Limits) -> Result<Self, LimitsError> {
        let coarser = |c: &ChunkInfo| c.coarser.map(|c| info[c.0 as usize]);
        assert!(info.iter().all(|c| !c.pinned || coarser(c).is_none_or(|c| c.pinned)), "pinned chunks stand on others");
        assert!(info.iter().all(|c| coarser(c).is_none_or(|k| k.pool == c.pool)), "a chain lies in one pool");
        let pinned: Vec<ChunkId> = (0..info.len() as u32).map(ChunkId).filter(|c| info[c.0 as usize].pinned).collect();
        for (pool, &bound) in limits.vram_bytes.iter().enumerate() {
            let here = pinned.iter().map(|c| &info[c.0 as usize]).filter(|c| c.pool == pool);
            let needed = here.map(|c| c.vram_bytes).sum();
            if needed > bound {
                return Err(LimitsError::Vram { bound, needed });
            }
        }
        let largest = info.iter().map(|c| c.ram_bytes as u64).max().unwrap_or(0);
        if largest > limits.ram_bytes {
            return Err(LimitsError::Ram { bound: limits.ram_bytes, needed: largest });
        }
        let n = info.len();
        let chain = |c: usize| std::iter::successors(Some(c), |&c| info[c].coarser.map(|c| c.0 as usize));
        let depth = |c| u8::try_from(chain(c).take(256).count()).expect("a chain has 255 chunks at most");
        Ok(Self {
            depth: (0..n).map(depth).collect(),
            marks: vec![Mark::default(); n],
            goals: Goals::default(),
            loaded: Members::new(n),
            in_vram: Members::new(n),
            limits,
            info,
            pinned,
            ram: vec![Ram::Absent; n],
            vram: vec![Vram::Absent; n],
            failed: vec![false; n],
            loading: Vec::new(),
            finer_in_vram: vec![0; n],
            finer_staying: vec![0; n],
            resident: vec![false; n],
            retiring: vec![false; n],
            changes: Vec::new(),
            stats: CacheStats::default(),
            frame: 0,
            vram_bytes: [0; POOLS],
            standing_bytes: [0; POOLS],
            lost_bytes: [0; POOLS],
            failures_in_a_row: 0,
            idle: false,
        })
    }

    /// One frame of the view: what it wants, and which retiring chunks it no longer depends on.
    /// Wants may come in any order and repeat chunks. Commands are to be carried out in their order.
    pub fn frame(&mut self, wants: &[Want], released: &[ChunkId]) -> Vec<Command> {
        self.frame += 1;
        self.changes.clear();
        let mut commands = Vec::new();
        let mut goals = std::mem::take(&mut self.goals);
        self.set_goals(wants, &mut goals);
        self.keep_and_free(released, &mut commands);
        self.retire(&goals, &mut commands);
        self.upload(&goals, &mut commands);
        self.withdraw(&mut commands);
        self.load(&goals, &mut commands);
        self.goals = goals;
        self.lost_bytes = self.lost_bytes.map(|lost| lost - lost.div_ceil(64));
        let s = &self.stats;
        let still = commands.is_empty() && s.loads_in_flight + s.uploads_in_flight + s.retiring == 0;
        self.idle = still && (self.lost_bytes == [0; POOLS] || self.failures_in_a_row >= MAX_FAILURES);
        commands
    }

    /// The chunk was read and decoded, and is in RAM.
    pub fn loaded(&mut self, chunk: ChunkId) {
        self.idle = false;
        self.set_ram(chunk, Ram::Loading, Ram::Loaded);
    }

    /// The chunk cannot be read (damaged, gone): it is not asked for again.
    pub fn load_failed(&mut self, chunk: ChunkId) {
        self.idle = false;
        self.set_ram(chunk, Ram::Loading, Ram::Absent);
        self.failed[chunk.0 as usize] = true;
        self.stats.failed += 1;
    }

    /// The chunk was asked for and will not be read, as [`Command::Withdraw`] said.
    pub fn load_withdrawn(&mut self, chunk: ChunkId) {
        self.idle = false;
        self.set_ram(chunk, Ram::Loading, Ram::Absent);
    }

    /// The chunk is in VRAM and may be drawn.
    pub fn uploaded(&mut self, chunk: ChunkId) {
        self.idle = false;
        self.failures_in_a_row = 0;
        self.set_vram(chunk, Vram::Uploading, Vram::Resident);
    }

    /// The chunk found no place in VRAM although the bound has room (a fragmented heap). The cache makes more room
    /// and tries again.
    pub fn upload_failed(&mut self, chunk: ChunkId) {
        self.idle = false;
        self.failures_in_a_row += 1;
        self.set_vram(chunk, Vram::Uploading, Vram::Absent);
        let info = &self.info[chunk.0 as usize];
        let lost = &mut self.lost_bytes[info.pool];
        *lost = (*lost + 2 * info.vram_bytes).min(self.limits.vram_bytes[info.pool] / 2);
    }

    /// From now on a frame begins to upload at most so many bytes (at least one chunk, though).
    pub fn limit_uploads(&mut self, bytes_per_frame: u64) {
        self.limits.upload_bytes_per_frame = bytes_per_frame;
    }

    /// Per chunk: in VRAM, may be drawn (retiring ones included).
    pub fn resident(&self) -> &[bool] {
        &self.resident
    }

    /// Per chunk: in VRAM, and the cache would like it back.
    pub fn retiring(&self) -> &[bool] {
        &self.retiring
    }

    /// Chunks of which [`resident`](Cache::resident) or [`retiring`](Cache::retiring) changed since the last frame began,
    /// some of them more than once.
    pub fn changes(&self) -> &[ChunkId] {
        &self.changes
    }

    /// True when the copy in RAM may be read.
    pub fn in_ram(&self, chunk: ChunkId) -> bool {
        self.ram[chunk.0 as usize] == Ram::Loaded
    }

    /// Per chunk: could not be loaded and never will be.
    pub fn failed(&self) -> &[bool] {
        &self.failed
    }

    /// True when the chunk could not be loaded and never will be.
    pub fn has_failed(&self, chunk: ChunkId) -> bool {
        self.failed[chunk.0 as usize]
    }

    /// The chunks, as they were given.
    pub fn chunks(&self) -> &[ChunkInfo] {
        &self.info
    }

    /// The bounds.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Bytes and counts now.
    pub fn stats(&self) -> CacheStats {
        self.stats
    }

    /// True when the last frame asked for nothing and nothing is under way: all that is wanted and fits is there.
    pub fn is_idle(&self) -> bool {
        self.idle
    }
}

#[cfg(test)]
mod tests;
