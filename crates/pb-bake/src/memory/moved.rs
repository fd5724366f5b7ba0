//! Parts of an anonymous range whose pages are a file's for now, at the same addresses.

use super::region::{allocate, punch_hole};
use rustix::mm::{Advice, MapFlags, ProtFlags, madvise, mmap, mmap_anonymous};
use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;

/// Parts smaller than this stay where they are.
const LEAST: usize = 1 << 20;
/// Bytes that are moved at a time.
const STEP: usize = 64 << 20;

/// What was moved. Its place in the file is its place in the range.
pub(super) struct Moved {
    file: File,
    /// Offset to size; no two overlap.
    parts: BTreeMap<usize, usize>,
}

impl Moved {
    /// Nothing yet; `file` is new and has no name.
    pub(super) fn to(file: File) -> Moved {
        Moved { file, parts: BTreeMap::new() }
    }

    /// Bytes that are moved.
    pub(super) fn held(&self) -> usize {
        self.parts.values().sum()
    }

    /// Moves what is in a part of the range at `base`, as far as it is not moved yet and the disk has room; how many bytes.
    /// The part is handed out, and nobody writes to it meanwhile.
    pub(super) fn take(&mut self, base: usize, offset: usize, size: usize) -> usize {
        let (mut at, end, mut moved) = (offset, offset + size, 0);
        while at < end {
            let next = self.parts.range(..=at).next_back().map(|(&o, &s)| o + s).filter(|&next| next > at);
            if let Some(next) = next {
                at = next;
                continue;
            }
            let until = self.parts.range(at..end).next().map_or(end, |(&o, _)| o).min(at + STEP);
            if until - at >= LEAST {
                if !self.take_step(base, at, until - at) {
                    return moved;
                }
                moved += until - at;
            }
            at = until;
        }
        moved
    }

    #[allow(unsafe_code)]
    fn take_step(&mut self, base: usize, offset: usize, size: usize) -> bool {
        let start = (base + offset) as *mut u8;
        // SAFETY: the pages are mapped, and nobody writes to them; what they hold is only copied. Bytes that their owner has
        // not written yet are whatever the system put there.
        let bytes = unsafe { std::slice::from_raw_parts(start, size) };
        if !allocate(&self.file, offset, size) || self.file.write_all_at(bytes, offset as u64).is_err() {
            return false;
        }
        let (access, flags) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED | MapFlags::FIXED);
        // SAFETY: the new pages have the same bytes at the same addresses, the range is this region's own, and its lock is
        // held.
        let mapped = unsafe { mmap(start.cast(), size, access, flags, &self.file, offset as u64) };
        if mapped.is_ok() {
            self.parts.insert(offset, size);
        }
        mapped.is_ok()
    }

    /// A part of the range is free again: its pages are the system's; how many bytes of it were moved.
    pub(super) fn give_back(&mut self, base: usize, offset: usize, size: usize) -> usize {
        let end = offset + size;
        let mut returned = 0;
        while let Some((part, length)) = self.parts.range(..end).next_back().map(|(&o, &s)| (o, s))
            && part + length > offset
        {
            let (from, to) = (part.max(offset), (part + length).min(end));
            if !self.give_back_part(base, from, to - from) {
                // It stays a file's, and works as well.
                break;
            }
            returned += to - from;
            self.parts.remove(&part);
            let rest = [(part, from), (to, part + length)];
            self.parts.extend(rest.into_iter().filter(|(from, to)| to > from).map(|(from, to)| (from, to - from)));
        }
        returned
    }

    #[allow(unsafe_code)]
    fn give_back_part(&self, base: usize, offset: usize, size: usize) -> bool {
        let start = (base + offset) as *mut core::ffi::c_void;
        let (access, flags) =
            (ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE | MapFlags::NORESERVE | MapFlags::FIXED);
        // SAFETY: nobody has a block there, and the lock on the region is held.
        let mapped = unsafe { mmap_anonymous(start, size, access, flags) };
        if mapped.is_ok() {
            // SAFETY: the advice concerns the range that was just mapped; it changes no content.
            let _ = unsafe { madvise(start, size, Advice::LinuxHugepage) };
            punch_hole(&self.file, offset, size);
        }
        mapped.is_ok()
    }

    /// Lets go of the pages: they stay in the file, and come back when they are touched.
    #[allow(unsafe_code)]
    pub(super) fn let_go(&self, base: usize) {
        for (&offset, &size) in &self.parts {
            // SAFETY: the pages are a shared file's as long as the lock on the region is held: what was written stays there.
            let _ = unsafe { madvise((base + offset) as *mut _, size, Advice::LinuxDontNeed) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::region::Region;
    use super::*;

    /// The bytes of a block of a region.
    #[allow(unsafe_code)]
    fn bytes<'a>(start: *mut u8, size: usize) -> &'a mut [u8] {
        // SAFETY: the tests ask for one block at a time, and for none that was given back.
        unsafe { std::slice::from_raw_parts_mut(start, size) }
    }

    fn pattern(i: usize) -> u8 {
        (i * 7 / 4096) as u8 ^ i as u8
    }

    #[test]
    fn blocks_that_are_moved_keep_their_addresses_and_bytes() {
        let mut region = Region::anonymous().unwrap();
        let sizes = [5 << 20, LEAST / 2, (STEP + LEAST) & !4095, 3 << 20];
        let blocks = sizes.map(|size| region.take(size).unwrap());
        for (&start, &size) in blocks.iter().zip(&sizes) {
            bytes(start, size).iter_mut().enumerate().for_each(|(i, b)| *b = pattern(i));
        }
        assert_eq!(region.give_back(blocks[1], sizes[1]), sizes[1]);
        let file = || tempfile::tempfile().unwrap();
        let moved = region.move_out(file());
        assert_eq!(moved, sizes[0] + sizes[2] + sizes[3]);
        assert_eq!((region.moved(), region.move_out(file())), (moved, 0), "all is moved");
        region.let_go_moved();
        let same = |start, size| bytes(start, size).iter().enumerate().all(|(i, b)| *b == pattern(i));
        assert!([0, 2, 3].into_iter().all(|k| same(blocks[k], sizes[k])));

        // What is written afterwards stays, too; the end of one block and the middle of the range are given back.
        bytes(blocks[2], 10).fill(9);
        region.let_go_moved();
        assert_eq!(bytes(blocks[2], 11)[..], [[9; 10].as_slice(), &[pattern(10)]].concat());
        let tail = 1 << 20;
        assert_eq!(region.give_back(blocks[0].wrapping_add(sizes[0] - tail), tail), 0, "nothing in memory");
        assert_eq!(region.give_back(blocks[2], sizes[2]), 0);
        assert_eq!(region.moved(), sizes[0] - tail + sizes[3]);
        assert!(same(blocks[0], sizes[0] - tail) && same(blocks[3], sizes[3]));
        let again = region.take(STEP).unwrap();
        bytes(again, STEP).fill(1);
        assert!(same(blocks[0], sizes[0] - tail) && same(blocks[3], sizes[3]));
        assert_eq!(region.give_back(again, STEP), STEP);
    }

    #[test]
    fn only_what_is_not_moved_yet_is_moved() {
        let mut region = Region::anonymous().unwrap();
        let first = region.take(2 << 20).unwrap();
        bytes(first, 2 << 20).fill(1);
        assert_eq!(region.move_out(tempfile::tempfile().unwrap()), 2 << 20);
        assert!(region.grow(first, 2 << 20, 6 << 20), "in place, behind what was moved");
        bytes(first, 6 << 20)[2 << 20..].fill(2);
        assert_eq!(region.move_out(tempfile::tempfile().unwrap()), 4 << 20);
        region.let_go_moved();
        let (before, after) = bytes(first, 6 << 20).split_at(2 << 20);
        assert!(before.iter().all(|&b| b == 1) && after.iter().all(|&b| b == 2));
        assert_eq!((region.give_back(first, 6 << 20), region.moved()), (0, 0));
    }
}
