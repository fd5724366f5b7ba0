//! The thread that keeps what is resident below the bound.

use super::linux::{BUDGET, HELD, Place, SPILLED, file_range, lock, open_file};
use super::{Usage, anonymous_share, high_share};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// How often the resident set is looked at. Two cores touch at most some tens of megabytes of new pages in this time.
const INTERVAL: Duration = Duration::from_millis(2);
/// Pages are let go from [`high_share`] of the bound on down to so much below.
const LET_GO_SHARE: f64 = 0.13;
/// Share that pages of files have at least, and large blocks at least.
const FILE_SHARE: f64 = 0.15;
const LEAST_SHARE: f64 = 0.2;
/// Pages are let go in steps of so many bytes.
const STEP: usize = 32 << 20;

/// Mapped files that others read: (first address, bytes).
static WATCHED: Mutex<Vec<(usize, usize)>> = Mutex::new(Vec::new());
/// Where the temporary file lies, for a message; and its bound.
static FOLDER: Mutex<Option<PathBuf>> = Mutex::new(None);

/// A mapped file whose pages may be let go at any time, until this ends. Keep it in front of the map in a struct, so that it
/// ends first.
#[derive(Debug)]
pub struct Watched {
    start: usize,
    bytes: usize,
}

impl Watched {
    /// Of a read-only or shared mapping of a file: one whose pages can be read from it again.
    pub fn new(mapped: &[u8]) -> Watched {
        let (start, bytes) = (mapped.as_ptr() as usize, mapped.len());
        WATCHED.lock().unwrap_or_else(PoisonError::into_inner).push((start, bytes));
        Watched { start, bytes }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        let mut all = WATCHED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = all.iter().position(|w| *w == (self.start, self.bytes)) {
            all.swap_remove(at);
        }
    }
}

/// The bound on a bake's memory, while this lives.
#[derive(Debug)]
pub struct Bound {
    ended: Arc<AtomicBool>,
}

impl Bound {
    /// Keeps this process within `bytes` of resident memory, as far as large blocks and mapped files make it up; what does not
    /// fit lies in `folder`.
    ///
    /// # Errors
    /// Where no file can be made in `folder`, or the thread cannot be started.
    pub fn new(bytes: u64, folder: &Path) -> io::Result<Bound> {
        open_file(folder)?;
        *FOLDER.lock().unwrap_or_else(PoisonError::into_inner) = Some(folder.to_owned());
        BUDGET.store((bytes as f64 * anonymous_share(bytes)) as usize, Ordering::Relaxed);
        let ended = Arc::new(AtomicBool::new(false));
        let (flag, statm) = (ended.clone(), File::open("/proc/self/statm")?);
        let watch = move || {
            let mut hand = 0;
            while !flag.load(Ordering::Relaxed) {
                std::thread::sleep(INTERVAL);
                relieve(&statm, bytes as f64, &mut hand);
            }
        };
        std::thread::Builder::new().name("memory".into()).spawn(watch)?;
        Ok(Bound { ended })
    }

    /// What was used so far.
    pub fn usage(&self) -> Usage {
        Usage { spilled_bytes: SPILLED.load(Ordering::Relaxed) as u64 }
    }
}

impl Drop for Bound {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        BUDGET.store(usize::MAX, Ordering::Relaxed);
    }
}

/// Resident bytes of this process: all, and those of files.
fn resident(statm: &File) -> Option<(f64, f64)> {
    let mut text = [0u8; 128];
    let length = statm.read_at(&mut text, 0).ok()?;
    let mut words = std::str::from_utf8(&text[..length]).ok()?.split(' ').skip(1);
    let mut bytes = || words.next()?.parse::<f64>().ok().map(|pages| pages * rustix::param::page_size() as f64);
    Some((bytes()?, bytes()?))
}

/// What large blocks may hold is less by what small ones have.
fn set_budget(bound: f64, all: f64, of_files: f64) {
    let small = (all - of_files - HELD.load(Ordering::Relaxed) as f64).max(0.0);
    let most = bound * anonymous_share(bound as u64);
    let budget = (bound * (high_share(bound) - FILE_SHARE) - small).clamp(most.min(bound * LEAST_SHARE), most);
    BUDGET.store(budget as usize, Ordering::Relaxed);
}

/// Lets pages go where too many are resident: first those that nobody uses or that were set aside, then those of the
/// temporary file, one part after the other all around, then those of mapped files.
fn relieve(statm: &File, bound: f64, hand: &mut usize) {
    let above = |share: f64| resident(statm).is_some_and(|(all, _)| all > bound * share);
    let Some((all, of_files)) = resident(statm) else { return };
    set_budget(bound, all, of_files);
    let high = high_share(bound);
    if all <= bound * high {
        return;
    }
    if let Some(region) = &*lock(Place::Anonymous) {
        region.release_free();
        region.let_go_moved();
    }
    let (base, length) = file_range();
    for _ in 0..=length / STEP {
        if !above(high - LET_GO_SHARE) {
            return;
        }
        let start = if *hand < length { *hand } else { 0 };
        *hand = start + STEP;
        let_go_file(base + start, STEP.min(length - start));
    }
    let all = WATCHED.lock().unwrap_or_else(PoisonError::into_inner);
    all.iter().for_each(|&(start, bytes)| let_go_map(start, bytes));
}

/// Lets go of the pages of a part of the temporary file: they stay in the file, and come back when they are touched.
#[allow(unsafe_code)]
fn let_go_file(start: usize, bytes: usize) {
    // SAFETY: the range is mapped until the process ends, and shared: what was written stays in the file, and readers and
    // writers on other threads see the same bytes before and after.
    let _ = unsafe { rustix::mm::madvise(start as *mut _, bytes, rustix::mm::Advice::LinuxDontNeed) };
}

#[allow(unsafe_code)]
fn let_go_map(start: usize, bytes: usize) {
    // SAFETY: a `Watched` stands for the mapping, which therefore is still there while the lock on the list is held; its pages
    // are those of a file, and are read from it again.
    let _ = unsafe { rustix::mm::madvise(start as *mut _, bytes, rustix::mm::Advice::LinuxDontNeed) };
}

/// Ends the program: memory is at its bound and the disk is full. There is no way back from inside of an allocation.
pub(super) fn end_without_room() -> ! {
    let folder = FOLDER.lock().unwrap_or_else(PoisonError::into_inner).take();
    let folder = folder.as_deref().unwrap_or(Path::new(".")).display();
    eprintln!(
        "pb-bake: {folder}: no room for temporary files; free some, or name a folder with more room with --temp-dir, \
         or allow more memory with --memory"
    );
    crate::traces::remove();
    std::process::exit(2)
}
