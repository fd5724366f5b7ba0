//! Files that must not be left behind where the program ends on its own in the middle of things.
//!
//! Whoever makes such a file cleans up after itself; this is for the two ends at which nobody's destructor runs: a user
//! who interrupts the bake, and an allocation for which there is no room.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

static FILES: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Notes a file.
pub fn add(path: &Path) {
    FILES.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_owned());
}

/// Removes what was noted and is still there.
pub fn remove() {
    let files = std::mem::take(&mut *FILES.lock().unwrap_or_else(PoisonError::into_inner));
    for path in files {
        // It may have got its name since: then there is nothing to remove.
        let _ = std::fs::remove_file(path);
    }
}
