//! The memory of a bake: a bound on it, and where large blocks lie.
//!
//! [`Memory`] is the program's allocator. Small blocks are the system's. Large ones come from a range of huge pages, as long
//! as all of them together stay below most of the bound; from then on they lie in a file without a name in the folder for
//! temporary files, mapped like any memory. A thread watches how much of it is resident, and lets go of mapped pages, those
//! of inputs and of images too, before the bound is reached. So every stage of a bake works on plain slices, whatever the
//! size of the model, and where things fit nothing is ever written (docs/decisions/013-memory.md).
//!
//! Decoders of images are somebody else's and ask for memory as they like: a TIFF is decoded whole before it is handed out,
//! a progressive JPEG has 6 bytes of coefficients per texel. Inside of [`in_files`] large blocks lie in the file anyway.
//!
//! Elsewhere than on Linux all blocks are the system's, and nothing is bounded.
//!
//! Must never: panic, or ask itself for a large block.

#[cfg(target_os = "linux")]
mod extents;
#[cfg(target_os = "linux")]
mod linux;
#[cfg(target_os = "linux")]
mod moved;
#[cfg(target_os = "linux")]
mod region;
#[cfg(target_os = "linux")]
mod watch;

#[cfg(target_os = "linux")]
pub(crate) use linux::in_files;
#[cfg(target_os = "linux")]
pub use linux::{Memory, set_aside};
#[cfg(target_os = "linux")]
pub use watch::{Bound, Watched};

#[cfg(not(target_os = "linux"))]
mod elsewhere;
#[cfg(not(target_os = "linux"))]
pub(crate) use elsewhere::in_files;
#[cfg(not(target_os = "linux"))]
pub use elsewhere::{Bound, Memory, Watched, set_aside};

/// Pages that come faster than they are let go may take so many bytes for a moment.
const BURST_BYTES: f64 = 360e6;

/// Share of the bound from where on pages are let go: room for a burst is left, which is a small part of large bounds and a
/// third of the smallest.
fn high_share(bound: f64) -> f64 {
    1.0 - (BURST_BYTES / bound).clamp(0.12, 0.35)
}

/// Share of the bound that large blocks in the system's memory may hold together. The rest is for small blocks, mapped files,
/// those pages of the temporary file that are in use, and bursts.
pub fn anonymous_share(bound: u64) -> f64 {
    high_share(bound as f64) - 0.23
}

/// What a bake held and wrote for want of memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Most bytes of the temporary file at a time.
    pub spilled_bytes: u64,
}

/// Memory of the machine, or of the control group that this process is in: all of it, and what is available. Where the
/// system tells: of Linux.
pub fn of_machine() -> Option<(u64, u64)> {
    let table = std::fs::read_to_string("/proc/meminfo").ok()?;
    let field = |name: &str| {
        let line = table.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(':'))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
    };
    let folder = std::path::Path::new("/sys/fs/cgroup");
    let number = |file: &str| std::fs::read_to_string(folder.join(file)).ok()?.trim().parse().ok();
    let (mut total, mut available) = (field("MemTotal")?, field("MemAvailable")?);
    if let Some(limit) = number("memory.max").filter(|limit| *limit < total) {
        total = limit;
        available = available.min(limit.saturating_sub(number("memory.current").unwrap_or(0)));
    }
    Some((total, available))
}

/// Room for this user on the disk of a folder, bytes.
#[cfg(unix)]
pub fn free_bytes(folder: &std::path::Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    disk.f_bavail.checked_mul(disk.f_frsize)
}

/// Not known here.
#[cfg(not(unix))]
pub fn free_bytes(_: &std::path::Path) -> Option<u64> {
    None
}
