//! Large ranges of addresses whose pages come from the system's memory, or from a file without a name.
//!
//! A range is reserved once and is as long as anybody may need; extents of it are handed out. In the anonymous range
//! the system is asked for huge pages: a bake walks over hundreds of megabytes in every stage, and small pages cost it a
//! quarter of its time. In the file's range every extent has its blocks on the disk before it is used, so that a full disk
//! is an answer and no fault.
//!
//! What the anonymous range holds can be moved to a file of its own without changing its address: for data that nobody is
//! going to touch for a while.

use super::extents::{Extents, PAGE};
use super::moved::Moved;
use rustix::fs::FallocateFlags;
use rustix::io::Errno;
use rustix::mm::{Advice, MapFlags, ProtFlags, madvise, mmap, mmap_anonymous};
use std::fs::File;
use std::ptr::null_mut;

/// Lengths of a range that are tried: some systems have fewer addresses.
const CAPACITIES: [usize; 4] = [1 << 42, 1 << 40, 1 << 38, 1 << 35];

/// One range.
pub(super) struct Region {
    base: usize,
    capacity: usize,
    extents: Extents,
    /// None: the system's memory.
    file: Option<File>,
    /// Parts of the anonymous range whose pages are a file's for now.
    moved: Option<Moved>,
}

impl Region {
    /// Memory of the system, in huge pages where it has them.
    #[allow(unsafe_code)]
    pub(super) fn anonymous() -> Option<Region> {
        CAPACITIES.into_iter().find_map(|capacity| {
            let (access, flags) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE | MapFlags::NORESERVE);
            // SAFETY: a new mapping at a place of the system's choice changes nothing that is there.
            let base = unsafe { mmap_anonymous(null_mut(), capacity, access, flags) }.ok()?;
            // SAFETY: the advice concerns the range that was just mapped; it changes no content.
            let _ = unsafe { madvise(base, capacity, Advice::LinuxHugepage) };
            Some(Region { base: base as usize, capacity, extents: Extents::new(capacity), file: None, moved: None })
        })
    }

    /// Pages of `file`, which is new and has no name.
    #[allow(unsafe_code)]
    pub(super) fn of_file(file: File) -> Option<Region> {
        CAPACITIES.into_iter().find_map(|capacity| {
            let access = ProtFlags::READ | ProtFlags::WRITE;
            // SAFETY: a new mapping at a place of the system's choice; nobody else has the file, and only parts of it that
            // were allocated are handed out.
            let base = unsafe { mmap(null_mut(), capacity, access, MapFlags::SHARED, &file, 0) }.ok()?;
            let file = file.try_clone().ok()?;
            let extents = Extents::new(capacity);
            Some(Region { base: base as usize, capacity, extents, file: Some(file), moved: None })
        })
    }

    /// Does the block begin in this range?
    pub(super) fn contains(&self, start: *const u8) -> bool {
        (self.base..self.base + self.capacity).contains(&(start as usize))
    }

    /// First address and length.
    pub(super) fn range(&self) -> (usize, usize) {
        (self.base, self.capacity)
    }

    /// Bytes that are handed out.
    pub(super) fn held(&self) -> usize {
        self.extents.held()
    }

    /// Where the part that was ever used ends, bytes from the first address.
    pub(super) fn end(&self) -> usize {
        self.extents.end()
    }

    /// A block of whole pages; what is in it is undefined in an anonymous range, zero in a file's.
    pub(super) fn take(&mut self, size: usize) -> Option<*mut u8> {
        let offset = self.extents.take(size)?;
        if !self.allocate(offset, size) {
            self.extents.give_back(offset, size);
            return None;
        }
        Some((self.base + offset) as *mut u8)
    }

    /// Makes a block larger in place where it can be.
    pub(super) fn grow(&mut self, start: *mut u8, size: usize, wanted: usize) -> bool {
        let offset = start as usize - self.base;
        if !self.extents.grow(offset, size, wanted) {
            return false;
        }
        if self.allocate(offset + size, wanted - size) {
            return true;
        }
        self.extents.give_back(offset + size, wanted - size);
        false
    }

    /// Ends a block, or the end of one; how much of it was in the system's memory. A file gives its blocks back to the disk.
    pub(super) fn give_back(&mut self, start: *mut u8, size: usize) -> usize {
        let offset = start as usize - self.base;
        let in_file = self.moved.as_mut().map_or(0, |moved| moved.give_back(self.base, offset, size));
        self.file.iter().for_each(|file| punch_hole(file, offset, size));
        self.extents.give_back(offset, size);
        if self.file.is_some() { 0 } else { size - in_file }
    }

    /// Moves all of the anonymous range that is handed out to `file`, which is new; how many bytes. Where the disk has no room
    /// some of it stays. Nobody may write to large blocks meanwhile; reading is no harm.
    pub(super) fn move_out(&mut self, file: File) -> usize {
        let moved = self.moved.get_or_insert_with(|| Moved::to(file));
        self.extents.taken().map(|(offset, size)| moved.take(self.base, offset, size)).sum()
    }

    /// Lets go of the pages of what was moved: they stay in the file, and come back when they are touched.
    pub(super) fn let_go_moved(&self) {
        self.moved.iter().for_each(|moved| moved.let_go(self.base));
    }

    /// Bytes that are moved.
    pub(super) fn moved(&self) -> usize {
        self.moved.as_ref().map_or(0, Moved::held)
    }

    /// Gives the pages of free extents back to the system.
    #[allow(unsafe_code)]
    pub(super) fn release_free(&self) {
        for (offset, size) in self.extents.free().filter(|_| self.file.is_none()) {
            // SAFETY: nobody has a block there, and the lock on this region is held; the pages read as zeros from now on.
            let _ = unsafe { madvise((self.base + offset) as *mut _, size, Advice::LinuxDontNeed) };
        }
    }

    /// Gives a part of the file its blocks.
    fn allocate(&self, offset: usize, size: usize) -> bool {
        self.file.as_ref().is_none_or(|file| allocate(file, offset, size))
    }
}

/// Gives a part of a file its blocks on the disk; no: there is no room.
pub(super) fn allocate(file: &File, offset: usize, size: usize) -> bool {
    match rustix::fs::fallocate(file, FallocateFlags::empty(), offset as u64, size as u64) {
        Ok(()) => true,
        Err(Errno::OPNOTSUPP | Errno::NOSYS) => write_zeros(file, offset, size),
        Err(_) => false,
    }
}

/// Gives blocks of a file back to the disk; it reads as zeros there.
pub(super) fn punch_hole(file: &File, offset: usize, size: usize) {
    let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
    if rustix::fs::fallocate(file, flags, offset as u64, size as u64).is_err() {
        write_zeros(file, offset, size);
    }
}

/// For file systems that cannot allocate.
fn write_zeros(file: &File, offset: usize, size: usize) -> bool {
    use std::os::unix::fs::FileExt;
    const ZEROS: [u8; PAGE] = [0; PAGE];
    (offset..offset + size).step_by(PAGE).all(|at| file.write_all_at(&ZEROS, at as u64).is_ok())
}
