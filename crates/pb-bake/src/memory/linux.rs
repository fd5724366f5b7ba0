//! The allocator itself.

use super::extents::PAGE;
use super::region::Region;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Blocks of so many bytes are large: they come from a region.
const LARGE_BYTES: usize = 16 << 10;
/// What the anonymous region holds is worth moving when it is more than this share of its budget.
const PRESSED_SHARE: f64 = 0.5;
/// Inside of [`in_files`], blocks of so many bytes lie in the file.
const IN_FILE_BYTES: usize = 16 << 20;

/// The allocator of a program that bakes.
///
/// ```
/// #[global_allocator]
/// static MEMORY: pb_bake::memory::Memory = pb_bake::memory::Memory;
/// ```
pub struct Memory;

/// Where blocks come from.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// The system's memory.
    Anonymous,
    /// The temporary file.
    File,
}

static REGIONS: [Mutex<Option<Region>>; 2] = [Mutex::new(None), Mutex::new(None)];
/// First address and length of each region, so that a block is told without a lock; length 0: not there.
static RANGES: [[AtomicUsize; 2]; 2] = [const { [const { AtomicUsize::new(0) }; 2] }; 2];
/// Bytes of the file's region up to the end of what was ever used, so that pages can be let go while others wait for the disk.
static FILE_END: AtomicUsize = AtomicUsize::new(0);
/// Most bytes of the anonymous region, and what it has.
pub(super) static BUDGET: AtomicUsize = AtomicUsize::new(usize::MAX);
pub(super) static HELD: AtomicUsize = AtomicUsize::new(0);
/// Most bytes that the file ever held.
pub(super) static SPILLED: AtomicUsize = AtomicUsize::new(0);
/// What length an anonymous region has that cannot be made.
const NEVER: usize = usize::MAX;

thread_local! {
    /// Do large blocks of this thread lie in the file? Const and without a destructor, so it may be asked at any time.
    static IN_FILES: Cell<bool> = const { Cell::new(false) };
}

pub(super) fn lock(place: Place) -> MutexGuard<'static, Option<Region>> {
    REGIONS[place as usize].lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs `work` with the large blocks that this thread asks for in a file in `folder`, or in the one that there is already.
pub(crate) fn in_files<T>(folder: &Path, work: impl FnOnce() -> T) -> T {
    /// Puts back what was, also after a panic.
    struct Before(bool);
    impl Drop for Before {
        fn drop(&mut self) {
            IN_FILES.set(self.0);
        }
    }
    let _before = Before(IN_FILES.replace(open_file(folder).is_ok()));
    work()
}

/// Moves what large blocks hold to a file in `folder`, at their addresses, if memory is running short: a stage begins that
/// hardly needs it, and what that stage asks for is to lie in memory. No other thread may write to a large block meanwhile.
pub fn set_aside(folder: &Path) {
    let pressed = HELD.load(Ordering::Relaxed) as f64 > BUDGET.load(Ordering::Relaxed) as f64 * PRESSED_SHARE;
    let Some(file) = pressed.then(|| tempfile::tempfile_in(folder).ok()).flatten() else { return };
    let mut region = lock(Place::Anonymous);
    let moved = region.as_mut().map_or(0, |r| r.move_out(file));
    HELD.fetch_sub(moved, Ordering::Relaxed);
    let moved = region.as_ref().map_or(0, Region::moved);
    drop(region);
    let in_file = lock(Place::File).as_ref().map_or(0, Region::held);
    SPILLED.fetch_max(moved + in_file, Ordering::Relaxed);
}

/// Makes the temporary file, unless there is one.
pub(super) fn open_file(folder: &Path) -> std::io::Result<()> {
    if RANGES[Place::File as usize][1].load(Ordering::Acquire) > 0 {
        return Ok(());
    }
    let file: File = tempfile::tempfile_in(folder)?;
    let mut region = lock(Place::File);
    if region.is_none() {
        *region = Region::of_file(file);
        note_range(Place::File, region.as_ref());
    }
    match *region {
        Some(_) => Ok(()),
        None => Err(std::io::ErrorKind::Unsupported.into()),
    }
}

fn note_range(place: Place, region: Option<&Region>) {
    let (base, length) = region.map_or((0, 0), Region::range);
    RANGES[place as usize][0].store(base, Ordering::Relaxed);
    RANGES[place as usize][1].store(length, Ordering::Release);
}

/// Notes how much of the file is used.
fn note_use(region: Option<&Region>) {
    SPILLED.fetch_max(region.map_or(0, Region::held), Ordering::Relaxed);
    FILE_END.fetch_max(region.map_or(0, Region::end), Ordering::Relaxed);
}

/// First address and length of that part of the file's range that was ever used.
pub(super) fn file_range() -> (usize, usize) {
    (RANGES[Place::File as usize][0].load(Ordering::Relaxed), FILE_END.load(Ordering::Relaxed))
}

fn pages(bytes: usize) -> usize {
    bytes.next_multiple_of(PAGE)
}

/// Where a new block of so many bytes is to lie.
fn place_for(bytes: usize) -> Place {
    let over = || HELD.load(Ordering::Relaxed).saturating_add(bytes) > BUDGET.load(Ordering::Relaxed);
    match bytes >= IN_FILE_BYTES && IN_FILES.get() || over() {
        true => Place::File,
        false => Place::Anonymous,
    }
}

/// A block of undefined content; `None`: the system is to give one.
fn take(layout: Layout) -> Option<*mut u8> {
    if layout.size() < LARGE_BYTES || layout.align() > PAGE {
        return None;
    }
    let size = pages(layout.size());
    if place_for(size) == Place::File {
        let mut region = lock(Place::File);
        match region.as_mut().and_then(|r| r.take(size)) {
            Some(start) => {
                note_use(region.as_ref());
                return Some(start);
            }
            None if region.is_some() && !IN_FILES.get() => {
                drop(region);
                super::watch::end_without_room()
            }
            None => {}
        }
    }
    let mut region = lock(Place::Anonymous);
    if region.is_none() && RANGES[Place::Anonymous as usize][1].load(Ordering::Relaxed) == 0 {
        *region = Region::anonymous();
        note_range(Place::Anonymous, region.as_ref());
        if region.is_none() {
            RANGES[Place::Anonymous as usize][1].store(NEVER, Ordering::Relaxed);
        }
    }
    let start = region.as_mut()?.take(size)?;
    HELD.fetch_add(size, Ordering::Relaxed);
    Some(start)
}

/// The region of a block; `None`: the system's.
fn place_of(start: *const u8, layout: Layout) -> Option<Place> {
    if layout.size() < LARGE_BYTES {
        return None;
    }
    [Place::Anonymous, Place::File].into_iter().find(|&place| {
        let [base, length] = &RANGES[place as usize];
        let length = length.load(Ordering::Acquire);
        length != NEVER && (start as usize).wrapping_sub(base.load(Ordering::Relaxed)) < length
    })
}

fn give_back(place: Place, start: *mut u8, size: usize) {
    if let Some(region) = lock(place).as_mut() {
        debug_assert!(region.contains(start));
        HELD.fetch_sub(region.give_back(start, size), Ordering::Relaxed);
    }
}

/// Makes a block of a region larger or smaller where it is.
fn resize(place: Place, start: *mut u8, old: usize, new: usize) -> bool {
    if new <= old {
        if new < old {
            give_back(place, start.wrapping_add(new), old - new);
        }
        return true;
    }
    let over = place == Place::Anonymous && place_for(new - old) == Place::File;
    let mut region = lock(place);
    let grown = !over && region.as_mut().is_some_and(|r| r.grow(start, old, new));
    if grown && place == Place::File {
        note_use(region.as_ref());
    }
    drop(region);
    if grown && place == Place::Anonymous {
        HELD.fetch_add(new - old, Ordering::Relaxed);
    }
    grown
}

// SAFETY: blocks are the system's, or extents of a region of the layout's size, rounded up to pages, at addresses of its
// alignment, which nobody else has until they are given back; the region of each is known by its address. Nothing here
// panics.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Memory {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise.
        take(layout).unwrap_or_else(|| unsafe { System.alloc(layout) })
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        match take(layout) {
            // A file's are zeros; to write them would bring its pages in.
            Some(start) if place_of(start, layout) == Some(Place::File) => start,
            // SAFETY: the block has as many bytes.
            Some(start) => unsafe {
                start.write_bytes(0, layout.size());
                start
            },
            // SAFETY: the caller's promise.
            None => unsafe { System.alloc_zeroed(layout) },
        }
    }

    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        match place_of(start, layout) {
            Some(place) => give_back(place, start, pages(layout.size())),
            // SAFETY: the caller's promise, and the block is the system's.
            None => unsafe { System.dealloc(start, layout) },
        }
    }

    unsafe fn realloc(&self, start: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let place = place_of(start, layout);
        if place.is_none() && size < LARGE_BYTES {
            // SAFETY: the caller's promise, and the block is the system's.
            return unsafe { System.realloc(start, layout, size) };
        }
        if let Some(place) = place
            && size >= LARGE_BYTES
            && resize(place, start, pages(layout.size()), pages(size))
        {
            return start;
        }
        // SAFETY: the caller's promise; both blocks have the bytes that are copied, and do not overlap.
        unsafe {
            let new = self.alloc(Layout::from_size_align_unchecked(size, layout.align()));
            if !new.is_null() {
                std::ptr::copy_nonoverlapping(start, new, layout.size().min(size));
                self.dealloc(start, layout);
            }
            new
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[global_allocator]
    static MEMORY: Memory = Memory;

    fn place(bytes: &[u8]) -> Option<Place> {
        place_of(bytes.as_ptr(), Layout::for_value(bytes))
    }

    fn is_in_file(bytes: &[u8]) -> bool {
        place(bytes) == Some(Place::File)
    }

    #[test]
    fn large_blocks_of_a_decoder_lie_in_files_until_they_end_and_others_do_not() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!is_in_file(&vec![0; IN_FILE_BYTES]), "nobody asked for files");
        let mut bytes = in_files(folder.path(), || {
            assert!(!is_in_file(&vec![0; IN_FILE_BYTES - PAGE]), "a small one");
            vec![0u8; IN_FILE_BYTES]
        });
        assert!(is_in_file(&bytes) && bytes.iter().all(|&b| b == 0));
        assert!(!is_in_file(&vec![0; IN_FILE_BYTES]), "no longer");
        bytes.iter_mut().enumerate().for_each(|(i, b)| *b = i as u8);
        in_files(folder.path(), || bytes.reserve_exact(1 << 20));
        assert!(is_in_file(&bytes) && bytes.iter().enumerate().all(|(i, &b)| b == i as u8), "it grows");
        bytes.truncate(1000);
        bytes.shrink_to_fit();
        assert!(!is_in_file(&bytes) && bytes.iter().enumerate().all(|(i, &b)| b == i as u8), "it shrinks");
        let large = in_files(folder.path(), || vec![7u8; IN_FILE_BYTES]);
        assert!(std::thread::spawn(move || is_in_file(&large)).join().unwrap(), "ended by another thread");
    }

    #[test]
    fn blocks_keep_their_bytes_however_they_grow_and_shrink() {
        let sizes = [10, LARGE_BYTES - 1, LARGE_BYTES, 3 * LARGE_BYTES + 7, 5 << 20, 100, 40 << 20, LARGE_BYTES];
        let mut bytes: Vec<u8> = Vec::new();
        for size in sizes {
            let kept = bytes.len().min(size);
            bytes.truncate(kept);
            bytes.shrink_to_fit();
            bytes.extend((kept..size).map(|i| i as u8));
            assert!(bytes.iter().enumerate().all(|(i, &b)| b == i as u8), "{size}");
            assert_eq!(place(&bytes).is_some(), bytes.capacity() >= LARGE_BYTES);
            assert!(vec![0u8; size].iter().all(|&b| b == 0), "zeros of {size}");
        }
    }

    #[test]
    fn what_decoders_hold_of_large_images_lies_in_files() {
        use crate::images::{DecodeOptions, ImageContent, ImageSource, decode};
        let mut tiff = std::io::Cursor::new(Vec::new());
        image::RgbImage::new(4096, 2048).write_to(&mut tiff, image::ImageFormat::Tiff).unwrap();
        let content = ImageContent::Bytes(tiff.into_inner().into());
        let before = SPILLED.load(Ordering::Relaxed);
        decode(&ImageSource { name: "a.tif".into(), content }, &DecodeOptions::default()).unwrap();
        assert!(SPILLED.load(Ordering::Relaxed).max(before) >= IN_FILE_BYTES);
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error() {
        assert!(tempfile::tempfile_in("/no/such/folder").is_err());
        let folder = Path::new("/no/such/folder");
        let opened = open_file(folder).is_ok();
        assert_eq!(opened, RANGES[Place::File as usize][1].load(Ordering::Acquire) > 0);
    }

    #[test]
    fn a_panic_ends_the_use_of_files() {
        let folder = tempfile::tempdir().unwrap();
        let _ = std::panic::catch_unwind(|| in_files(folder.path(), || std::panic::panic_any(())));
        assert!(!is_in_file(&vec![0; IN_FILE_BYTES]));
    }
}
