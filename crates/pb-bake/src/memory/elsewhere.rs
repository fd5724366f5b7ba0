//! Systems on which nothing is bounded: all blocks are the system's.

use super::Usage;
use std::alloc::{GlobalAlloc, Layout, System};
use std::io;
use std::path::Path;

/// The system's allocator.
pub struct Memory;

// SAFETY: every promise is the system's.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Memory {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(start, layout) }
    }
}

/// Runs `work`.
pub(crate) fn in_files<T>(_: &Path, work: impl FnOnce() -> T) -> T {
    work()
}

/// Nothing.
pub fn set_aside(_: &Path) {}

/// A mapped file.
#[derive(Debug)]
pub struct Watched;

impl Watched {
    /// Nothing comes of it here.
    pub fn new(_: &[u8]) -> Watched {
        Watched
    }
}

/// No bound.
#[derive(Debug)]
pub struct Bound;

impl Bound {
    /// Bounds nothing.
    ///
    /// # Errors
    /// Never.
    pub fn new(_: u64, _: &Path) -> io::Result<Bound> {
        Ok(Bound)
    }

    /// Nothing.
    pub fn usage(&self) -> Usage {
        Usage::default()
    }
}
