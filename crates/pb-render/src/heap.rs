//! One GPU buffer for all chunks: vertices and indices of a chunk lie together in one range.
//!
//! A single heap leaves no split between vertices and indices to get wrong. Free space that is scattered over
//! too small holes is brought together by sliding the ranges down ([`Heap::allocate`] asks for it by itself), so
//! an allocation fails only when the bytes are not there, give or take an eighth of itself
//! ([`plannable_units`] leaves that out, so whoever keeps to it never fails).
//! Must never: hand out a range that is in use; know what is inside a range.

use offset_allocator::{Allocation, Allocator};

/// Unit of allocation, bytes: one vertex.
pub const UNIT_BYTES: u64 = 16;

/// A range of the heap, in units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range {
    /// First unit.
    pub first: u32,
    /// Number of units.
    pub units: u32,
}

/// A move that compaction wants: `units` units from unit `from` down to unit `to`; in order of address, and a
/// move never reaches into what a later one still has to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// Where the units lie.
    pub from: u32,
    /// Where they go.
    pub to: u32,
    /// How many.
    pub units: u32,
}

/// Who uses what in the heap; the buffer itself belongs to the caller. Slots are the caller's chunk indices.
pub struct Heap {
    allocator: Allocator,
    /// By slot.
    ranges: Vec<Option<(Range, Allocation)>>,
    /// Units before this one belong to the coarse buffer and never move.
    pinned_units: u32,
    capacity_units: u32,
    used_units: u32,
}

/// The heap has not enough free units for this chunk, wherever they lie.
#[derive(Debug, thiserror::Error)]
#[error("the heap is full: {wanted} units wanted, {free} free")]
pub struct HeapFull {
    wanted: u32,
    free: u32,
}

/// Units, of so many that are not pinned, that a caller may plan with when no chunk has more than `largest_units`:
/// the allocator rounds a hole down by up to an eighth, so that much of one chunk stays unplanned.
pub fn plannable_units(units: u32, largest_units: u32) -> u32 {
    units.saturating_sub(largest_units / 8 + 16)
}

impl Heap {
    /// A heap of `capacity_units` units, of which the first `pinned_units` are in use for ever.
    pub fn new(capacity_units: u32, pinned_units: u32, slots: usize) -> Self {
        assert!(pinned_units <= capacity_units, "the coarse buffer fits the heap");
        let allocator = Allocator::with_max_allocs(capacity_units - pinned_units, allocations(slots));
        Self { allocator, ranges: vec![None; slots], pinned_units, capacity_units, used_units: 0 }
    }

    /// Units in use, pinned ones included.
    pub fn used_units(&self) -> u32 {
        self.pinned_units + self.used_units
    }

    /// Where a slot's units lie, if it has any.
    pub fn range(&self, slot: usize) -> Option<Range> {
        self.ranges[slot].map(|(range, _)| range)
    }

    /// Gives a slot `units` units. The moves have to be carried out before the range is written; ranges of
    /// other slots have changed when there are any.
    pub fn allocate(&mut self, slot: usize, units: u32) -> Result<(Range, Vec<Move>), HeapFull> {
        assert!(self.ranges[slot].is_none(), "a slot is filled once");
        if let Some(range) = self.try_allocate(slot, units) {
            return Ok((range, Vec::new()));
        }
        let free = self.capacity_units - self.used_units();
        if free < units {
            return Err(HeapFull { wanted: units, free });
        }
        let moves = self.compact();
        let range = self.try_allocate(slot, units).ok_or(HeapFull { wanted: units, free })?;
        Ok((range, moves))
    }

    fn try_allocate(&mut self, slot: usize, units: u32) -> Option<Range> {
        let allocation = self.allocator.allocate(units)?;
        let range = Range { first: self.pinned_units + allocation.offset, units };
        self.ranges[slot] = Some((range, allocation));
        self.used_units += units;
        Some(range)
    }

    /// Takes a slot's units back. True when it had any.
    pub fn free(&mut self, slot: usize) -> bool {
        let Some((range, allocation)) = self.ranges[slot].take() else { return false };
        self.allocator.free(allocation);
        self.used_units -= range.units;
        true
    }

    /// Slides all ranges down, in order of address.
    fn compact(&mut self) -> Vec<Move> {
        let mut order: Vec<usize> = (0..self.ranges.len()).filter(|&s| self.ranges[s].is_some()).collect();
        order.sort_by_key(|&s| self.range(s).map(|r| r.first));
        self.allocator.reset();
        self.used_units = 0;
        let mut moves = Vec::new();
        for slot in order {
            let (old, _) = self.ranges[slot].take().expect("filtered above");
            let new = self.try_allocate(slot, old.units).expect("an empty allocator hands out ranges in a row");
            assert!(new.first <= old.first, "an empty allocator hands out ranges in a row");
            if new.first != old.first {
                moves.push(Move { from: old.first, to: new.first, units: old.units });
            }
        }
        moves
    }
}

/// Allocations that the allocator must have room for: every slot, and a hole before each.
fn allocations(slots: usize) -> u32 {
    u32::try_from(slots * 2 + 16).expect("chunk ids are u32 and archives hold far fewer than 2^31 chunks")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattered_holes_are_joined_when_a_chunk_needs_them() {
        let mut heap = Heap::new(1040, 100, 20);
        for slot in 0..9 {
            heap.allocate(slot, 100).unwrap();
        }
        for slot in [1, 3, 5, 7] {
            assert!(heap.free(slot));
        }
        let (range, moves) = heap.allocate(10, 300).unwrap();
        assert_eq!(range, Range { first: 600, units: 300 });
        assert_eq!(moves[0], Move { from: 300, to: 200, units: 100 });
        assert_eq!(heap.used_units(), 900);
        assert!(heap.allocate(11, 200).is_err(), "only 140 units are left");
    }

    /// A simple random number, the same on every run.
    fn next(state: &mut u64) -> u32 {
        *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*state >> 33) as u32
    }

    #[test]
    fn ranges_never_overlap_and_what_is_plannable_always_fits() {
        let (mut heap, mut state) = (Heap::new(5000, 40, 200), 7);
        let mut content = vec![u32::MAX; 5000];
        let (largest, mut used) = (300, 0);
        for _ in 0..4000 {
            let slot = next(&mut state) as usize % 200;
            if let Some(range) = heap.range(slot) {
                heap.free(slot);
                used -= range.units;
                continue;
            }
            let units = 1 + next(&mut state) % largest;
            if used + units > plannable_units(heap.capacity_units - heap.pinned_units, largest) {
                continue;
            }
            let (range, moves) = heap.allocate(slot, units).expect("within what may be planned");
            for m in moves {
                assert!(m.to < m.from);
                content.copy_within(m.from as usize..(m.from + m.units) as usize, m.to as usize);
            }
            used += units;
            content[range.first as usize..][..units as usize].fill(slot as u32);
            for slot in 0..200 {
                let Some(range) = heap.range(slot) else { continue };
                assert!(content[range.first as usize..][..range.units as usize].iter().all(|&c| c == slot as u32));
            }
        }
    }
}
