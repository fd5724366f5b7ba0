//! Which pages of a reserved range are taken. Best fit, whole pages; neighbours that are free are one extent.
//!
//! Must never: ask for a large block, as the allocator keeps its books here.

use std::collections::{BTreeMap, BTreeSet};

/// What extents are multiples of, bytes.
pub(super) const PAGE: usize = 4096;

/// The extents of one range. Offsets and sizes are multiples of [`PAGE`].
pub(super) struct Extents {
    capacity: usize,
    /// Nothing was ever taken from here on.
    end: usize,
    held: usize,
    /// Free extents before `end`: offset to size.
    free: BTreeMap<usize, usize>,
    /// The same as (size, offset).
    by_size: BTreeSet<(usize, usize)>,
}

impl Extents {
    pub(super) const fn new(capacity: usize) -> Extents {
        Extents { capacity, end: 0, held: 0, free: BTreeMap::new(), by_size: BTreeSet::new() }
    }

    /// Bytes that are taken.
    pub(super) fn held(&self) -> usize {
        self.held
    }

    /// Where the part of the range that was ever used ends.
    pub(super) fn end(&self) -> usize {
        self.end
    }

    /// Free extents that were used before, as (offset, size).
    pub(super) fn free(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.free.iter().map(|(&offset, &size)| (offset, size))
    }

    /// Runs of extents that are taken, as (offset, size).
    pub(super) fn taken(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let starts = std::iter::once(0).chain(self.free.iter().map(|(&offset, &size)| offset + size));
        let ends = self.free.keys().copied().chain([self.end]);
        starts.zip(ends).filter(|(start, end)| end > start).map(|(start, end)| (start, end - start))
    }

    /// Takes the smallest free extent that holds `size` bytes; its offset.
    pub(super) fn take(&mut self, size: usize) -> Option<usize> {
        let found = self.by_size.range((size, 0)..).next().copied();
        let offset = match found {
            Some((whole, offset)) => {
                self.remove(offset, whole);
                self.insert(offset + size, whole - size);
                offset
            }
            None => {
                let last = self.free.last_key_value().map(|(&offset, &whole)| (offset, whole));
                let last = last.filter(|(offset, whole)| offset + whole == self.end);
                let offset = last.map_or(self.end, |l| l.0);
                if self.capacity - offset < size {
                    return None;
                }
                last.into_iter().for_each(|(offset, whole)| self.remove(offset, whole));
                self.end = offset + size;
                offset
            }
        };
        self.held += size;
        Some(offset)
    }

    /// Makes an extent larger in place, where what follows it is free.
    pub(super) fn grow(&mut self, offset: usize, size: usize, wanted: usize) -> bool {
        let (after, more) = (offset + size, wanted - size);
        match self.free.get(&after).copied() {
            Some(whole) if whole >= more => {
                self.remove(after, whole);
                self.insert(after + more, whole - more);
            }
            _ if after == self.end && self.capacity - self.end >= more => self.end += more,
            _ => return false,
        }
        self.held += more;
        true
    }

    /// Ends an extent, or the end of one.
    pub(super) fn give_back(&mut self, mut offset: usize, mut size: usize) {
        self.held -= size;
        if let Some((&before, &length)) = self.free.range(..offset).next_back()
            && before + length == offset
        {
            self.remove(before, length);
            (offset, size) = (before, size + length);
        }
        if let Some(&length) = self.free.get(&(offset + size)) {
            self.remove(offset + size, length);
            size += length;
        }
        self.insert(offset, size);
    }

    fn insert(&mut self, offset: usize, size: usize) {
        if size > 0 {
            self.free.insert(offset, size);
            self.by_size.insert((size, offset));
        }
    }

    fn remove(&mut self, offset: usize, size: usize) {
        self.free.remove(&offset);
        self.by_size.remove(&(size, offset));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// What is taken never overlaps, and all of it can be had again.
        #[test]
        fn extents_never_overlap_and_come_back_whole(steps in prop::collection::vec((0..4u8, 1..20usize), 1..200)) {
            let mut extents = Extents::new(64 * PAGE);
            let mut taken: Vec<(usize, usize)> = Vec::new();
            for (what, pages) in steps {
                let size = pages * PAGE;
                match what {
                    0 | 1 => taken.extend(extents.take(size).map(|offset| (offset, size))),
                    2 if !taken.is_empty() => {
                        let (offset, size) = taken.swap_remove(pages % taken.len());
                        extents.give_back(offset, size);
                    }
                    3 if !taken.is_empty() => {
                        let at = pages % taken.len();
                        let (offset, old) = taken[at];
                        if extents.grow(offset, old, old + size) {
                            taken[at].1 = old + size;
                        }
                    }
                    _ => {}
                }
                let mut sorted = taken.clone();
                sorted.sort_unstable();
                prop_assert!(sorted.windows(2).all(|w| w[0].0 + w[0].1 <= w[1].0));
                prop_assert!(sorted.last().is_none_or(|l| l.0 + l.1 <= 64 * PAGE));
                prop_assert_eq!(extents.held(), taken.iter().map(|t| t.1).sum::<usize>());
            }
            for (offset, size) in taken {
                extents.give_back(offset, size);
            }
            prop_assert_eq!(extents.held(), 0);
            prop_assert!(extents.free().count() <= 1);
            prop_assert_eq!(extents.take(64 * PAGE), Some(0));
        }
    }
}
