//! Room for what image decoders hold of their own: large blocks lie in mapped files without names, as the texels do
//! that come out, so that the system may write them out and take their pages back at any time.
//!
//! Decoders are somebody else's and ask for memory as they like: a TIFF is decoded whole before it is handed out, a
//! progressive JPEG has 6 bytes of coefficients per texel. So the allocator of the program, [`Memory`], looks at who asks.
//! It is the system's for all blocks but large ones that are asked for inside of [`in_files`]. Where there is no room for a
//! file, these are the system's too.
//!
//! Must never: panic, or ask itself for a large block.

use super::store::map_new_file;
use memmap2::MmapMut;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Blocks from so many bytes on.
const LARGE_BYTES: usize = 16 << 20;

/// The allocator of a program that decodes large images.
///
/// ```
/// #[global_allocator]
/// static MEMORY: pb_bake::images::Memory = pb_bake::images::Memory;
/// ```
pub struct Memory;

thread_local! {
    /// Where large blocks of this thread go; const and without a destructor, so it may be asked at any time.
    static FOLDER: Cell<Option<&'static Path>> = const { Cell::new(None) };
}

/// The blocks that lie in files, in no order; few, as they are large.
static BLOCKS: Mutex<Vec<MmapMut>> = Mutex::new(Vec::new());

#[cfg(test)]
thread_local! {
    /// Blocks in files that this thread ever got.
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

/// Runs `work` with the large blocks that this thread asks for in files in `folder`.
pub(super) fn in_files<T>(folder: &Path, work: impl FnOnce() -> T) -> T {
    /// Puts back what was, also after a panic.
    struct Before(Option<&'static Path>);
    impl Drop for Before {
        fn drop(&mut self) {
            FOLDER.set(self.0);
        }
    }
    let _before = Before(FOLDER.replace(Some(kept(folder))));
    work()
}

/// The same path for ever. A program has few such folders.
fn kept(folder: &Path) -> &'static Path {
    static KEPT: Mutex<BTreeSet<&'static Path>> = Mutex::new(BTreeSet::new());
    let mut all = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    match all.get(folder) {
        Some(known) => known,
        None => {
            let path: &'static Path = Box::leak(folder.to_owned().into_boxed_path());
            all.insert(path);
            path
        }
    }
}

/// A block of zeros in a file; `None` where it is not wanted there, or there is no room.
fn in_file(layout: Layout) -> Option<*mut u8> {
    if layout.size() < LARGE_BYTES {
        return None;
    }
    let folder = FOLDER.get()?;
    let mut map = map_new_file(folder, layout.size() as u64).ok()?;
    #[cfg(test)]
    COUNT.set(COUNT.get() + 1);
    let start = map.as_mut_ptr();
    let mut blocks = BLOCKS.lock().unwrap_or_else(PoisonError::into_inner);
    (start as usize).is_multiple_of(layout.align()).then(|| blocks.push(map)).map(|()| start)
}

/// Which of the blocks begins there.
fn place_of(start: *const u8, blocks: &[MmapMut]) -> Option<usize> {
    blocks.iter().position(|b| std::ptr::eq(b.as_ptr(), start))
}

/// Whether a block lies in a file.
fn is_in_file(start: *const u8, layout: Layout) -> bool {
    let blocks = || BLOCKS.lock().unwrap_or_else(PoisonError::into_inner);
    layout.size() >= LARGE_BYTES && place_of(start, &blocks()).is_some()
}

/// Ends a block that lies in a file; false where it does not.
fn end_in_file(start: *mut u8, layout: Layout) -> bool {
    if layout.size() < LARGE_BYTES {
        return false;
    }
    let mut blocks = BLOCKS.lock().unwrap_or_else(PoisonError::into_inner);
    let block = place_of(start, &blocks).map(|i| blocks.swap_remove(i));
    drop(blocks);
    block.is_some()
}

// SAFETY: blocks are the system's, or mapped files of the layout's size at addresses of its alignment, which stay mapped
// until they are given back; each is known by its start. Nothing here panics.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Memory {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise.
        in_file(layout).unwrap_or_else(|| unsafe { System.alloc(layout) })
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise; new files are of zeros.
        in_file(layout).unwrap_or_else(|| unsafe { System.alloc_zeroed(layout) })
    }

    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        if !end_in_file(start, layout) {
            // SAFETY: the caller's promise, and the block is the system's.
            unsafe { System.dealloc(start, layout) }
        }
    }

    unsafe fn realloc(&self, start: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let wanted_in_file = size >= LARGE_BYTES && FOLDER.get().is_some();
        if !wanted_in_file && !is_in_file(start, layout) {
            // SAFETY: the caller's promise, and the block is the system's.
            return unsafe { System.realloc(start, layout, size) };
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

    fn is_in_file(bytes: &[u8]) -> bool {
        place_of(bytes.as_ptr(), &BLOCKS.lock().unwrap()).is_some()
    }

    #[test]
    fn large_blocks_of_a_decoder_lie_in_files_until_they_end_and_others_do_not() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!is_in_file(&vec![0; LARGE_BYTES]), "nobody asked for files");
        let mut bytes = in_files(folder.path(), || {
            assert!(!is_in_file(&vec![0; LARGE_BYTES - 1]), "a small one");
            vec![0u8; LARGE_BYTES]
        });
        assert!(is_in_file(&bytes) && bytes.iter().all(|&b| b == 0));
        assert!(!is_in_file(&vec![0; LARGE_BYTES]), "no longer");
        bytes.iter_mut().enumerate().for_each(|(i, b)| *b = i as u8);
        in_files(folder.path(), || bytes.reserve_exact(1 << 20));
        assert!(is_in_file(&bytes) && bytes.iter().enumerate().all(|(i, &b)| b == i as u8), "it grows");
        bytes.truncate(1000);
        bytes.shrink_to_fit();
        assert!(!is_in_file(&bytes) && bytes.iter().enumerate().all(|(i, &b)| b == i as u8), "it shrinks");
        let large = in_files(folder.path(), || vec![7u8; LARGE_BYTES]);
        let start = large.as_ptr() as usize;
        std::thread::spawn(move || drop(large)).join().unwrap();
        assert!(BLOCKS.lock().unwrap().iter().all(|b| b.as_ptr() as usize != start), "ended by another thread");
    }

    #[test]
    fn what_decoders_hold_of_large_images_lies_in_files() {
        use super::super::{DecodeOptions, ImageContent, ImageSource, decode};
        let mut tiff = std::io::Cursor::new(Vec::new());
        image::RgbImage::new(4096, 2048).write_to(&mut tiff, image::ImageFormat::Tiff).unwrap();
        let content = ImageContent::Bytes(tiff.into_inner().into());
        let before = COUNT.get();
        decode(&ImageSource { name: "a.tif".into(), content }, &DecodeOptions::default()).unwrap();
        assert!(COUNT.get() > before);
    }

    #[test]
    fn without_room_for_files_blocks_are_the_systems() {
        let bytes = in_files(Path::new("/no/such/folder"), || vec![3u8; LARGE_BYTES]);
        assert!(!is_in_file(&bytes) && bytes.iter().all(|&b| b == 3));
    }

    #[test]
    fn a_panic_ends_the_use_of_files() {
        let folder = tempfile::tempdir().unwrap();
        let _ = std::panic::catch_unwind(|| in_files(folder.path(), || std::panic::panic_any(())));
        assert!(!is_in_file(&vec![0; LARGE_BYTES]));
    }
}
