//! How far loops are, for progress displays.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts what passes through, from any thread, and tells which share of `count` that is.
pub fn share_of<T>(count: usize, progress: &(dyn Fn(f32) + Sync)) -> impl Fn(T) -> T + Sync {
    let done = AtomicUsize::new(0);
    move |result| {
        progress((done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / count as f32);
        result
    }
}
