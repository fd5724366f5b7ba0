//! The tiers' states and the only places where they change, with the sums and the lists that go with them.

use super::{Cache, POOLS};
use crate::ChunkId;

/// Where a chunk stands in RAM. Bytes count in every state but `Absent`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ram {
    Absent,
    Loading,
    Loaded,
}

/// Where a chunk stands in VRAM. Bytes count in every state but `Absent`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Vram {
    Absent,
    /// The copy in RAM is being read: it must stay.
    Uploading,
    Resident,
    /// Still drawn, until the view releases it.
    Retiring,
    /// No longer drawn, but finer chunks are still there.
    Released,
}

/// Lists of chunks in VRAM: those that are uploaded, those that leave, those that stand in each pool.
pub(super) const LISTS: usize = 2 + POOLS;
pub(super) const UPLOADING: usize = 0;
pub(super) const LEAVING: usize = 1;

impl Vram {
    fn list(self, pool: usize) -> Option<usize> {
        match self {
            Vram::Absent => None,
            Vram::Uploading => Some(UPLOADING),
            Vram::Retiring | Vram::Released => Some(LEAVING),
            Vram::Resident => Some(resident_in(pool)),
        }
    }
}

/// The list of what stands in a pool.
pub(super) fn resident_in(pool: usize) -> usize {
    2 + pool
}

/// What the frames' goals said of a chunk: numbers of frames, the last one that did.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mark {
    pub wanted: u32,
    /// Shall be in VRAM.
    pub vram: u32,
    /// Shall be read into RAM or wait there.
    pub ram: u32,
    /// Room in RAM is kept for it.
    pub reserved: u32,
    /// Its place in order of priority, from 1, in the frame that wanted it.
    pub rank: u32,
}

/// K lists of chunks without order; a chunk is in one of them at most, and comes and goes in constant time.
#[derive(Clone, Debug)]
pub(super) struct Members<const K: usize> {
    lists: [Vec<ChunkId>; K],
    /// Per chunk: where it is in its list.
    place: Vec<u32>,
}

impl<const K: usize> Members<K> {
    pub fn new(chunks: usize) -> Self {
        Self { lists: std::array::from_fn(|_| Vec::new()), place: vec![0; chunks] }
    }

    pub fn list(&self, list: usize) -> &[ChunkId] {
        &self.lists[list]
    }

    fn change(&mut self, chunk: ChunkId, from: Option<usize>, to: Option<usize>) {
        if from == to {
            return;
        }
        if let Some(from) = from {
            let (list, place) = (&mut self.lists[from], self.place[chunk.0 as usize]);
            list.swap_remove(place as usize);
            if let Some(moved) = list.get(place as usize) {
                self.place[moved.0 as usize] = place;
            }
        }
        if let Some(to) = to {
            self.place[chunk.0 as usize] = self.lists[to].len() as u32;
            self.lists[to].push(chunk);
        }
    }
}

impl Cache {
    /// # Panics
    /// If the chunk is not in state `from`: the caller answered a command that was not given.
    pub(super) fn set_ram(&mut self, chunk: ChunkId, from: Ram, to: Ram) {
        let bytes = self.info[chunk.0 as usize].ram_bytes as u64;
        let state = &mut self.ram[chunk.0 as usize];
        assert_eq!(*state, from, "{chunk:?} in RAM");
        *state = to;
        let list = |state| (state == Ram::Loaded).then_some(0);
        self.loaded.change(chunk, list(from), list(to));
        self.stats.loads_in_flight += (to == Ram::Loading) as u32;
        self.stats.loads_in_flight -= (from == Ram::Loading) as u32;
        self.stats.ram_bytes += if to == Ram::Absent { 0 } else { bytes };
        self.stats.ram_bytes -= if from == Ram::Absent { 0 } else { bytes };
    }

    /// # Panics
    /// As [`set_ram`](Cache::set_ram).
    pub(super) fn set_vram(&mut self, chunk: ChunkId, from: Vram, to: Vram) {
        let place = chunk.0 as usize;
        let (bytes, pool) = (self.info[place].vram_bytes, self.info[place].pool);
        assert_eq!(self.vram[place], from, "{chunk:?} in VRAM");
        self.vram[place] = to;
        self.in_vram.change(chunk, from.list(pool), to.list(pool));
        let leaves = |s: Vram| matches!(s, Vram::Retiring | Vram::Released);
        let flags = (to == Vram::Resident || leaves(to), leaves(to));
        if flags != (self.resident[place], self.retiring[place]) {
            self.changes.push(chunk);
            (self.resident[place], self.retiring[place]) = flags;
        }
        self.stats.uploads_in_flight += (to == Vram::Uploading) as u32;
        self.stats.uploads_in_flight -= (from == Vram::Uploading) as u32;
        self.stats.retiring += leaves(to) as u32;
        self.stats.retiring -= leaves(from) as u32;
        let (was, is) = (from != Vram::Absent, to != Vram::Absent);
        self.vram_bytes[pool] += if is { bytes } else { 0 };
        self.vram_bytes[pool] -= if was { bytes } else { 0 };
        self.standing_bytes[pool] += if to == Vram::Resident { bytes } else { 0 };
        self.standing_bytes[pool] -= if from == Vram::Resident { bytes } else { 0 };
        self.stats.vram_bytes = self.vram_bytes.iter().sum();
        if let Some(coarser) = self.info[place].coarser {
            self.finer_in_vram[coarser.0 as usize] += is as u32;
            self.finer_in_vram[coarser.0 as usize] -= was as u32;
            self.finer_staying[coarser.0 as usize] += (is && !leaves(to)) as u32;
            self.finer_staying[coarser.0 as usize] -= (was && !leaves(from)) as u32;
        }
    }
}
