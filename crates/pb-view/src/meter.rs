//! What a frame moved between the tiers, and what its parts took on the processor.
//!
//! A load is *ahead* when it was asked for before a view needed the chunk (class Now), and *needed* once a view did;
//! each load counts once. What was read and never needed is the price of prefetching (paper section 6, figure 8).
//!
//! Must never: decide anything; what it counts goes into reports only.

use pb_lod::plan::{ChunkId, Class, Want};
use pb_stream::loader::LoadStats;
use std::time::{Duration, Instant};

/// Bytes of one frame. Those from disk are stored bytes, those to the adapter are decoded ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Chunks that arrived from disk.
    pub disk_bytes: u64,
    /// The part of them that was asked for before a view needed it.
    pub prefetch_bytes: u64,
    /// Chunks that a view needed for the first time since they were read: in this frame or in an earlier one.
    pub needed_bytes: u64,
    /// Chunks copied to the adapter.
    pub upload_bytes: u64,
    /// Reads that were begun.
    pub reads: u64,
    /// Their bytes: also what lies between chunks, and what was read twice.
    pub read_bytes: u64,
}

/// Milliseconds of one frame on the thread that draws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// Selection, and the cache's decisions.
    pub select_ms: f64,
    /// Carrying these out: requests, uploads, frees.
    pub carry_out_ms: f64,
    /// The uploads' part of it.
    pub upload_ms: f64,
}

/// The last load of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Load {
    /// None, or needed and counted.
    Settled,
    Asked {
        ahead: bool,
        needed: bool,
    },
    /// Read ahead, and not needed yet.
    Ahead,
}

/// Counts of the frame at hand.
pub struct Meter {
    loads: Vec<Load>,
    /// By chunk: the step in which a view needed it last.
    needed_at: Vec<u64>,
    steps: u64,
    traffic: Traffic,
    /// Up to the last frame.
    loads_before: LoadStats,
    select: Duration,
    carry_out: Duration,
    upload: Duration,
}

impl Meter {
    /// For so many chunks.
    pub fn new(chunks: usize) -> Self {
        let (select, carry_out, upload) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
        let (loads, needed_at) = (vec![Load::Settled; chunks], vec![0; chunks]);
        Self {
            loads,
            needed_at,
            steps: 0,
            traffic: Traffic::default(),
            loads_before: LoadStats::default(),
            select,
            carry_out,
            upload,
        }
    }

    /// A frame begins: all counts are zero.
    pub fn begin_frame(&mut self) {
        (self.traffic, self.select, self.carry_out) = (Traffic::default(), Duration::ZERO, Duration::ZERO);
        self.upload = Duration::ZERO;
    }

    /// The wants of a step, most urgent first; `stored_bytes` of a chunk that is in memory or on the adapter, none of
    /// others.
    pub fn wants(&mut self, wants: &[Want], stored_bytes: impl Fn(ChunkId) -> Option<u64>) {
        self.steps += 1;
        for want in wants.iter().take_while(|w| w.class == Class::Now) {
            self.needed_at[want.chunk.0 as usize] = self.steps;
            let load = &mut self.loads[want.chunk.0 as usize];
            match load {
                Load::Ahead => {
                    self.traffic.needed_bytes += stored_bytes(want.chunk).unwrap_or(0);
                    *load = Load::Settled;
                }
                Load::Asked { needed, .. } => *needed = true,
                Load::Settled => {}
            }
        }
    }

    /// A chunk was asked for, after the wants of this step.
    pub fn asked(&mut self, chunk: ChunkId) {
        let needed = self.needed_at[chunk.0 as usize] == self.steps;
        self.loads[chunk.0 as usize] = Load::Asked { ahead: !needed, needed };
    }

    /// A chunk of so many stored bytes arrived.
    pub fn read(&mut self, chunk: ChunkId, stored_bytes: u64) {
        let load = &mut self.loads[chunk.0 as usize];
        let (ahead, needed) = match *load {
            Load::Asked { ahead, needed } => (ahead, needed),
            _ => (false, true),
        };
        self.traffic.disk_bytes += stored_bytes;
        self.traffic.prefetch_bytes += if ahead { stored_bytes } else { 0 };
        self.traffic.needed_bytes += if needed { stored_bytes } else { 0 };
        *load = if needed { Load::Settled } else { Load::Ahead };
    }

    /// What was read since the start.
    pub fn loads(&mut self, all: LoadStats) {
        self.traffic.reads += all.reads - self.loads_before.reads;
        self.traffic.read_bytes += all.bytes_read - self.loads_before.bytes_read;
        self.loads_before = all;
    }

    /// A chunk that was asked for will not be read.
    pub fn withdrawn(&mut self, chunk: ChunkId) {
        self.loads[chunk.0 as usize] = Load::Settled;
    }

    /// A chunk of so many decoded bytes went to the adapter, from `start` until now.
    pub fn uploaded(&mut self, bytes: u64, start: Instant) {
        self.traffic.upload_bytes += bytes;
        self.upload += start.elapsed();
    }

    /// What uploads took since the frame began.
    pub fn upload_time(&self) -> Duration {
        self.upload
    }

    /// A step decided from `start` to `decided`, and has carried it out now.
    pub fn step(&mut self, start: Instant, decided: Instant) {
        self.select += decided - start;
        self.carry_out += decided.elapsed();
    }

    /// Bytes since the frame began.
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Times since the frame began.
    pub fn times(&self) -> Times {
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        Times { select_ms: ms(self.select), carry_out_ms: ms(self.carry_out), upload_ms: ms(self.upload) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn want(chunk: u32, class: Class) -> Want {
        Want { chunk: ChunkId(chunk), class, error_px: 1.0 }
    }

    #[test]
    fn every_load_is_needed_once_or_never() {
        let mut meter = Meter::new(4);
        let there = |_| Some(100);
        // 0 is needed at once, 1 while it is under way, 2 after it came, 3 never.
        meter.wants(&[want(0, Class::Now), want(1, Class::Soon)], there);
        (0..4).for_each(|c| meter.asked(ChunkId(c)));
        meter.wants(&[want(1, Class::Now), want(3, Class::Soon)], there);
        (0..4).for_each(|c| meter.read(ChunkId(c), 100));
        let first = meter.traffic();
        assert_eq!((first.disk_bytes, first.prefetch_bytes, first.needed_bytes), (400, 300, 200));
        meter.begin_frame();
        for _ in 0..3 {
            meter.wants(&[want(0, Class::Now), want(1, Class::Now), want(2, Class::Now)], there);
        }
        assert_eq!(meter.traffic(), Traffic { needed_bytes: 100, ..Traffic::default() });
    }

    #[test]
    fn what_was_dropped_before_it_was_needed_does_not_count() {
        let mut meter = Meter::new(1);
        meter.wants(&[], |_| None);
        meter.asked(ChunkId(0));
        meter.read(ChunkId(0), 100);
        meter.wants(&[want(0, Class::Now)], |_| None);
        assert_eq!(meter.traffic().needed_bytes, 0);
        meter.asked(ChunkId(0));
        meter.read(ChunkId(0), 100);
        assert_eq!(meter.traffic().needed_bytes, 100);
    }
}
