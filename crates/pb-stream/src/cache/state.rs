//! The tiers' states and the only places where they change, with the sums that go with them.

use super::Cache;
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

impl Cache {
    /// # Panics
    /// If the chunk is not in state `from`: the caller answered a command that was not given.
    pub(super) fn set_ram(&mut self, chunk: ChunkId, from: Ram, to: Ram) {
        let bytes = self.info[chunk.0 as usize].ram_bytes as u64;
        let state = &mut self.ram[chunk.0 as usize];
        assert_eq!(*state, from, "{chunk:?} in RAM");
        *state = to;
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
        let leaves = |s: Vram| matches!(s, Vram::Retiring | Vram::Released);
        self.resident[place] = to == Vram::Resident || leaves(to);
        self.retiring[place] = leaves(to);
        self.stats.uploads_in_flight += (to == Vram::Uploading) as u32;
        self.stats.uploads_in_flight -= (from == Vram::Uploading) as u32;
        self.stats.retiring += leaves(to) as u32;
        self.stats.retiring -= leaves(from) as u32;
        let (was, is) = (from != Vram::Absent, to != Vram::Absent);
        self.vram_bytes[pool] += if is { bytes } else { 0 };
        self.vram_bytes[pool] -= if was { bytes } else { 0 };
        self.stats.vram_bytes = self.vram_bytes.iter().sum();
        if let Some(coarser) = self.info[place].coarser {
            self.finer_in_vram[coarser.0 as usize] += is as u32;
            self.finer_in_vram[coarser.0 as usize] -= was as u32;
            self.finer_staying[coarser.0 as usize] += (is && !leaves(to)) as u32;
            self.finer_staying[coarser.0 as usize] -= (was && !leaves(from)) as u32;
        }
    }
}
