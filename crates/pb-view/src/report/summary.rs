//! A flight in a few numbers, all from the table that the CSV file holds.

use serde::{Deserialize, Serialize};

use super::runs::Bounds;
use crate::stats::Table;

/// What comes before counts as opening the model, seconds of flight.
const START_SECS: f64 = 1.0;

/// Mean, percentiles (nearest rank: the smallest value that so many are not above) and maximum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Spread {
    pub mean: f64,
    pub p50: f64,
    pub p90: f64,
    pub p99: f64,
    pub max: f64,
}

impl Spread {
    /// Of any values; zeros of none.
    pub fn of(values: &[f64]) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = |p: f64| sorted[((sorted.len() as f64 * p).ceil() as usize).clamp(1, sorted.len()) - 1];
        Self { mean: mean(values), p50: rank(0.5), p90: rank(0.9), p99: rank(0.99), max: rank(1.0) }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn most(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

/// Use of a tier beside its bound, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Use {
    /// The bound.
    pub bound_bytes: u64,
    /// Most in use at the end of a frame.
    pub peak_bytes: u64,
    /// On average.
    pub mean_bytes: u64,
    /// Peak over bound.
    pub peak_share: f64,
    /// Mean over bound.
    pub mean_share: f64,
    /// Frames with more than the bound in use.
    pub frames_above: u32,
}

impl Use {
    fn new(bytes: &[f64], bound_bytes: u64) -> Self {
        let (peak, mean, bound) = (most(bytes), mean(bytes), bound_bytes as f64);
        Self {
            bound_bytes,
            peak_bytes: peak as u64,
            mean_bytes: mean as u64,
            peak_share: peak / bound,
            mean_share: mean / bound,
            frames_above: bytes.iter().filter(|b| **b > bound).count() as u32,
        }
    }
}

/// Chunks that views wanted and did not have (the paper's figure 8).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Missing {
    /// Over all frames.
    pub chunks: Spread,
    /// Share of frames with nothing missing.
    pub complete_share: f64,
    /// The same without the first second of the flight; of all frames where the flight is no longer than that.
    pub complete_share_after_start: f64,
    /// Frames with something missing after the first second.
    pub incomplete_frames_after_start: u32,
    /// Most missing after the first second.
    pub max_after_start: u32,
}

/// Bytes between the tiers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bytes {
    /// Stored bytes read from disk during the flight.
    pub disk_bytes: u64,
    /// Asked for before a view needed them.
    pub prefetch_bytes: u64,
    /// Needed by a view sooner or later.
    pub needed_bytes: u64,
    /// All that was read, with what lies between chunks.
    #[serde(default)]
    pub read_bytes: u64,
    /// How many reads that took.
    #[serde(default)]
    pub reads: u64,
    /// What was read and not needed, over what was needed.
    pub extra_share: f64,
    /// Decoded bytes copied to the adapter.
    pub upload_bytes: u64,
}

/// How long a cut took to reach full detail: nothing is missing, all that fits is drawn, what came late has faded in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// First frame after the jump.
    pub frame: u32,
    /// Its time on the flypath.
    pub t_secs: f64,
    /// Frames until nothing was missing; none where the flight or the next cut came first.
    pub frames_to_complete: Option<u32>,
    /// Wall clock until then, that frame included.
    pub ms_to_complete: Option<f64>,
    /// Frames until full detail.
    pub frames_to_full: Option<u32>,
    /// Wall clock until then, that frame included.
    pub ms_to_full: Option<f64>,
    /// Time on the flypath until then.
    pub flight_secs_to_full: Option<f64>,
}

/// A flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of frames.
    pub frames: u32,
    /// Time on the flypath from the first to the last frame.
    pub flight_secs: f64,
    /// Sum of the frames' times.
    pub wall_secs: f64,
    /// Frames over that sum.
    pub fps_mean: f64,
    /// Wall clock per frame.
    pub frame_ms: Spread,
    /// Selection, cache, carrying out and draw commands together.
    pub cpu_ms: Spread,
    /// Drawn.
    pub triangles: Spread,
    /// Draws.
    pub draws: Spread,
    /// Largest projected error of what is drawn.
    pub error_px: Spread,
    /// Error that selection allowed.
    pub allowed_error_px: Spread,
    /// Adapter memory.
    pub vram: Use,
    /// Decoded chunks.
    pub ram: Use,
    /// Most memory of the process, mapped files included; 0 where the system does not say.
    pub rss_peak_bytes: u64,
    /// The same without files.
    pub rss_private_peak_bytes: u64,
    /// Missing chunks.
    pub missing: Missing,
    /// Bytes between the tiers.
    pub bytes: Bytes,
    /// Cuts in order; the start is the first.
    pub cuts: Vec<Cut>,
}

impl Summary {
    /// Of a table with at least one line.
    pub fn new(table: &Table, bounds: &Bounds) -> Self {
        let column = |name: &str| table.column(name);
        let (t, frame_ms) = (column("t_secs"), column("frame_ms"));
        let wall_secs = frame_ms.iter().sum::<f64>() / 1e3;
        Self {
            frames: table.lines() as u32,
            flight_secs: t.last().unwrap_or(&0.0) - t.first().unwrap_or(&0.0),
            wall_secs,
            fps_mean: if wall_secs > 0.0 { table.lines() as f64 / wall_secs } else { 0.0 },
            frame_ms: Spread::of(frame_ms),
            cpu_ms: Spread::of(&cpu_ms(table)),
            triangles: Spread::of(column("triangles")),
            draws: Spread::of(column("draws")),
            error_px: Spread::of(column("error_px")),
            allowed_error_px: Spread::of(column("allowed_error_px")),
            vram: Use::new(column("vram_bytes"), bounds.vram_bytes),
            ram: Use::new(column("ram_bytes"), bounds.ram_bytes),
            rss_peak_bytes: most(column("rss_bytes")) as u64,
            rss_private_peak_bytes: most(column("rss_private_bytes")) as u64,
            missing: missing(table),
            bytes: bytes(table),
            cuts: cuts(table),
        }
    }
}

/// Time of the drawing thread per frame that is no waiting.
pub fn cpu_ms(table: &Table) -> Vec<f64> {
    let parts = ["select_ms", "carry_out_ms", "draw_ms"].map(|name| table.column(name));
    (0..table.lines()).map(|i| parts.iter().filter_map(|p| p.get(i)).sum()).collect()
}

/// The first line past the first second; 0 where there is none.
pub fn after_start(table: &Table) -> usize {
    let t = table.column("t_secs");
    let start = t.first().copied().unwrap_or(0.0);
    t.iter().position(|t| t - start >= START_SECS).unwrap_or(0)
}

fn missing(table: &Table) -> Missing {
    let all = table.column("missing_chunks");
    let after = &all[after_start(table).min(all.len())..];
    let incomplete = |of: &[f64]| of.iter().filter(|m| **m > 0.0).count();
    let complete_share = |of: &[f64]| 1.0 - incomplete(of) as f64 / of.len().max(1) as f64;
    Missing {
        chunks: Spread::of(all),
        complete_share: complete_share(all),
        complete_share_after_start: complete_share(after),
        incomplete_frames_after_start: incomplete(after) as u32,
        max_after_start: most(after) as u32,
    }
}

fn bytes(table: &Table) -> Bytes {
    let sum = |name: &str| table.column(name).iter().sum::<f64>() as u64;
    let (disk_bytes, needed_bytes) = (sum("disk_bytes"), sum("needed_bytes"));
    let read_bytes = sum("read_bytes");
    Bytes {
        disk_bytes,
        prefetch_bytes: sum("prefetch_bytes"),
        needed_bytes,
        read_bytes,
        reads: sum("reads"),
        extra_share: read_bytes.saturating_sub(needed_bytes) as f64 / needed_bytes.max(1) as f64,
        upload_bytes: sum("upload_bytes"),
    }
}

fn cuts(table: &Table) -> Vec<Cut> {
    let column = |name: &str| table.column(name);
    let (t, frame_ms) = (column("t_secs"), column("frame_ms"));
    let begins: Vec<usize> = (0..table.lines()).filter(|&i| column("cut")[i] > 0.0).collect();
    let ends = begins.iter().skip(1).copied().chain([table.lines()]);
    let cut = |(begin, end): (&usize, usize)| {
        let begin = *begin;
        let complete = |i: &usize| column("missing_chunks")[*i] == 0.0;
        let full = |i: &usize| complete(i) && column("fading")[*i] == 0.0 && column("rising")[*i] == 0.0;
        let ms = |to: usize| frame_ms[begin..=to].iter().sum::<f64>();
        let (complete, full) = ((begin..end).find(complete), (begin..end).find(full));
        Cut {
            frame: column("frame")[begin] as u32,
            t_secs: t[begin],
            frames_to_complete: complete.map(|i| (i - begin) as u32),
            ms_to_complete: complete.map(ms),
            frames_to_full: full.map(|i| (i - begin) as u32),
            ms_to_full: full.map(ms),
            flight_secs_to_full: full.map(|i| t[i] - t[begin]),
        }
    };
    begins.iter().zip(ends).map(cut).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meter::Traffic;
    use crate::stats::{FrameStats, Line};

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
        let hundred: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let spread = Spread::of(&hundred);
        assert_eq!(spread, Spread { mean: 50.5, p50: 50.0, p90: 90.0, p99: 99.0, max: 100.0 });
        assert_eq!(Spread::of(&[7.0]), Spread { mean: 7.0, p50: 7.0, p90: 7.0, p99: 7.0, max: 7.0 });
        let three = Spread::of(&[3.0, 1.0, 2.0]);
        assert_eq!((three.p50, three.p90, three.max), (2.0, 3.0, 3.0));
        assert_eq!(Spread::of(&[]), Spread::default());
    }

    /// Ten frames a tenth of a second apart, then ten more a second later, each 20 ms long. A cut at 0 and at 12.
    fn table() -> Table {
        let mut table = Table::new();
        for i in 0..20u32 {
            let stats = FrameStats {
                vram_bytes: 100 + i as u64,
                missing_chunks: if i < 3 || (12..14).contains(&i) { 5 } else { 0 },
                fading: i < 4 || (12..20).contains(&i),
                traffic: Traffic { disk_bytes: 120, read_bytes: 130, needed_bytes: 100, ..Traffic::default() },
                rising: i == 4,
                ..FrameStats::default()
            };
            let t_secs = i as f64 * 0.1 + if i < 10 { 0.0 } else { 1.0 };
            table.add(&Line { frame: i, t_secs, frame_ms: 20.0, cut: i == 0 || i == 12, stats, ..Line::default() });
        }
        table
    }

    #[test]
    fn a_flight_is_summed_up() {
        let bounds = Bounds { vram_bytes: 110, ram_bytes: 1, ..Bounds::default() };
        let s = Summary::new(&table(), &bounds);
        assert_eq!((s.frames, s.flight_secs, s.fps_mean.round()), (20, 2.9, 50.0));
        assert_eq!((s.vram.peak_bytes, s.vram.mean_bytes, s.vram.frames_above), (119, 109, 9));
        assert_eq!(s.missing.complete_share, 0.75);
        assert_eq!((s.missing.complete_share_after_start, s.missing.incomplete_frames_after_start), (0.8, 2));
        assert_eq!((s.bytes.disk_bytes, s.bytes.needed_bytes, s.bytes.extra_share), (2400, 2000, 0.3));
    }

    #[test]
    fn full_detail_comes_after_what_is_late_has_faded_in() {
        let cuts = Summary::new(&table(), &Bounds { vram_bytes: 1, ram_bytes: 1, ..Bounds::default() }).cuts;
        assert_eq!(cuts.iter().map(|c| c.frame).collect::<Vec<_>>(), [0, 12]);
        assert_eq!((cuts[0].frames_to_complete, cuts[0].ms_to_complete), (Some(3), Some(80.0)));
        assert_eq!((cuts[0].frames_to_full, cuts[0].ms_to_full), (Some(5), Some(120.0)));
        assert_eq!((cuts[1].frames_to_complete, cuts[1].ms_to_full), (Some(2), None));
    }
}
