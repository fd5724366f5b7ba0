//! A slow disk to try things on: one arm, a latency per read, a rate.
//!
//! [`DiskModel`] says how long a read takes; [`Disk`] serves a queue of requests on a clock that the caller turns, with
//! the same merging as the real one, so that a flight on virtual time meets the same disk on every machine.
//!
//! Must never: read a clock; serve a request before it was made.

use crate::ChunkId;
use crate::merge::{Batch, Company, Extent, Waiting};
use std::str::FromStr;
use std::time::Duration;

/// How slow a disk is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiskModel {
    latency: Duration,
    bytes_per_sec: f64,
}

/// A text that names no disk.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is no disk; write milliseconds per read, up to 60000, and megabytes (10^6 bytes) per second, more than 0, \
     for example 8,60"
)]
pub struct DiskModelError(String);

impl Default for DiskModel {
    /// Reads all at once.
    fn default() -> Self {
        Self { latency: Duration::ZERO, bytes_per_sec: f64::INFINITY }
    }
}

impl FromStr for DiskModel {
    type Err = DiskModelError;

    /// `LATENCY_MS,MB_PER_S`.
    fn from_str(text: &str) -> Result<Self, DiskModelError> {
        let bad = || DiskModelError(text.into());
        let (latency, rate) = text.split_once(',').ok_or_else(bad)?;
        let number = |t: &str| t.trim().parse::<f64>().ok();
        let latency_ms = number(latency).filter(|l| (0.0..=60_000.0).contains(l)).ok_or_else(bad)?;
        let mb_per_sec = number(rate).filter(|r| (1e-3..=1e6).contains(r)).ok_or_else(bad)?;
        Ok(Self { latency: Duration::from_secs_f64(latency_ms * 1e-3), bytes_per_sec: mb_per_sec * 1e6 })
    }
}

impl DiskModel {
    /// How long one read of so many bytes takes.
    pub fn read_time(&self, bytes: u64) -> Duration {
        self.latency + Duration::from_secs_f64(bytes as f64 / self.bytes_per_sec)
    }
}

/// A disk that serves one read after the other on virtual time.
#[derive(Clone, Debug)]
pub struct Disk {
    model: DiskModel,
    /// Up to when all was decided.
    now: Duration,
    waiting: Waiting<ChunkId>,
    serving: Option<(Duration, Batch<ChunkId>)>,
    reads: u64,
    bytes_read: u64,
}

impl Disk {
    /// An idle disk at time 0.
    pub fn new(model: DiskModel) -> Self {
        Self { model, now: Duration::ZERO, waiting: Waiting::default(), serving: None, reads: 0, bytes_read: 0 }
    }

    /// Asks, at the time that the disk has, for a chunk.
    pub fn ask(&mut self, chunk: ChunkId, extent: Extent) {
        self.waiting.push(extent, Company::Any, chunk);
    }

    /// Gives each chunk that waits a new rank; the lowest is read first.
    pub fn reorder(&mut self, rank: impl Fn(ChunkId) -> u64) {
        self.waiting.reorder(|&chunk| rank(chunk));
    }

    /// Takes chunks out that are not to be read, where that was not begun. They come back here, and nowhere else.
    pub fn withdraw(&mut self, unwanted: impl Fn(ChunkId) -> bool) -> Vec<ChunkId> {
        self.waiting.withdraw(|&chunk| unwanted(chunk))
    }

    /// Reads that were begun, and their bytes.
    pub fn reads(&self) -> (u64, u64) {
        (self.reads, self.bytes_read)
    }

    /// Turns the clock to `to` and returns what was read by then, in the order in which it was.
    /// A clock that is turned back stands still.
    pub fn advance(&mut self, to: Duration) -> Vec<ChunkId> {
        let mut done = Vec::new();
        loop {
            let (end, batch) = match self.serving.take() {
                Some(serving) => serving,
                // Whoever waits for an idle disk asked just now.
                None => match self.start(self.now) {
                    Some(serving) => serving,
                    None => break,
                },
            };
            if end > to {
                self.serving = Some((end, batch));
                break;
            }
            done.extend(batch.parts.into_iter().map(|(_, chunk)| chunk));
            self.serving = self.start(end);
        }
        self.now = self.now.max(to);
        done
    }

    /// Turns the clock until nothing is left to do.
    pub fn finish(&mut self) -> Vec<ChunkId> {
        let mut done = Vec::new();
        while self.serving.is_some() || !self.waiting.is_empty() {
            let next = self.serving.as_ref().map_or(self.now, |s| s.0);
            done.extend(self.advance(next));
        }
        done
    }

    fn start(&mut self, at: Duration) -> Option<(Duration, Batch<ChunkId>)> {
        let batch = self.waiting.take()?;
        self.reads += 1;
        self.bytes_read += batch.extent.bytes;
        Some((at.saturating_add(self.model.read_time(batch.extent.bytes)), batch))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAR: u64 = 10 << 20;

    fn disk(text: &str) -> Disk {
        Disk::new(text.parse().unwrap())
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// 100 kB chunks far apart.
    fn ask(disk: &mut Disk, chunks: impl IntoIterator<Item = u32>) {
        for c in chunks {
            disk.ask(ChunkId(c), Extent { offset: u64::from(c) * FAR, bytes: 100_000 });
        }
    }

    #[test]
    fn reads_are_served_one_after_the_other() {
        let mut disk = disk("10,10"); // 10 ms and 10 ms for 100 kB
        ask(&mut disk, [3, 1, 2]);
        assert_eq!(disk.advance(ms(19)), []);
        assert_eq!(disk.advance(ms(20)), [ChunkId(3)]);
        assert_eq!(disk.advance(ms(60)), [ChunkId(1), ChunkId(2)]);
        assert_eq!(disk.advance(ms(500)), []);
    }

    #[test]
    fn nothing_is_read_before_it_was_asked_for() {
        let mut disk = disk("10,10");
        assert_eq!(disk.advance(ms(100)), []);
        ask(&mut disk, [0]);
        assert_eq!(disk.advance(ms(119)), []);
        assert_eq!(disk.advance(ms(120)), [ChunkId(0)]);
        // One that comes while the arm is busy waits for it.
        ask(&mut disk, [1]);
        disk.advance(ms(130));
        ask(&mut disk, [2]);
        assert_eq!(disk.advance(ms(159)), [ChunkId(1)]);
        assert_eq!(disk.advance(ms(160)), [ChunkId(2)]);
    }

    #[test]
    fn neighbours_cost_one_latency() {
        let mut disk = disk("10,10");
        (0..3).for_each(|c| disk.ask(ChunkId(c), Extent { offset: u64::from(c) * 100_000, bytes: 100_000 }));
        assert_eq!(disk.advance(ms(39)), []);
        assert_eq!(disk.advance(ms(40)), [0, 1, 2].map(ChunkId));
        assert_eq!(disk.reads(), (1, 300_000));
    }

    #[test]
    fn what_became_urgent_is_read_next() {
        let mut disk = disk("10,10");
        ask(&mut disk, [0, 1, 2, 3]);
        assert_eq!(disk.advance(ms(5)), []);
        disk.reorder(|c| u64::from(10 - c.0));
        assert_eq!(disk.advance(ms(100)), [0, 3, 2, 1].map(ChunkId), "the first was being read already");
    }

    #[test]
    fn the_step_of_the_clock_changes_nothing() {
        let arrivals = |step: u64| {
            let mut disk = disk("8,60");
            ask(&mut disk, 0..20);
            let times = (0..=1200).step_by(step as usize).map(|t| (t, disk.advance(ms(t))));
            times.flat_map(|(t, done)| done.into_iter().map(move |c| (c, t / 60))).collect::<Vec<_>>()
        };
        assert_eq!(
            arrivals(1).iter().map(|a| a.0).collect::<Vec<_>>(),
            arrivals(60).iter().map(|a| a.0).collect::<Vec<_>>()
        );
        let mut disk = disk("8,60");
        ask(&mut disk, 0..20);
        assert_eq!(disk.finish().len(), 20);
        assert!(disk.finish().is_empty());
    }

    #[test]
    fn what_is_no_disk_is_refused_with_an_example() {
        for text in ["", "8", "8;60", "-1,60", "8,0", "8,x", "1e9,60", "8,nan", "inf,60"] {
            let message = text.parse::<DiskModel>().unwrap_err().to_string();
            assert!(message.contains("8,60") && message.contains(text), "{message}");
        }
        let model: DiskModel = "8, 60".parse().unwrap();
        assert_eq!(model.read_time(60_000_000), Duration::from_millis(1008));
    }
}
