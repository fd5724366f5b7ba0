//! How many bytes a frame may upload, so that uploads take it no longer than they should on this adapter.
//!
//! The cache knows no clock, only a bound on the bytes of a frame's uploads; where frames follow the wall clock, that
//! bound comes from here: the rate of the last uploads times a share of the frame. Must never: be used in a flight
//! that has to be the same in every run.

use std::time::Duration;

/// What uploads may take of any frame, seconds.
const SECS: f64 = 0.002;
/// And of a long one: this part of it, so that a slow adapter does not wait for its data for ever.
const SHARE: f64 = 0.25;
/// No frame counts as longer than this, seconds.
const LONGEST_FRAME_SECS: f64 = 0.1;
/// Bound before anything was measured, bytes.
const FIRST_BYTES: u64 = 2 << 20;
/// Bound on any adapter, bytes.
const MOST_BYTES: u64 = 32 << 20;
/// What an older measurement weighs beside one that is a frame younger.
const MEMORY: f64 = 0.9;

/// The rate of the last uploads, and the length of the last frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct UploadPace {
    bytes: f64,
    secs: f64,
    frame_secs: f64,
}

impl UploadPace {
    /// A frame of `frame_secs` uploaded so many bytes in the time `took`.
    pub fn add(&mut self, frame_secs: f32, bytes: u64, took: Duration) {
        self.frame_secs += (1.0 - MEMORY) * (f64::from(frame_secs).min(LONGEST_FRAME_SECS) - self.frame_secs);
        if bytes > 0 {
            self.bytes = self.bytes * MEMORY + bytes as f64;
            self.secs = self.secs * MEMORY + took.as_secs_f64();
        }
    }

    /// What the next frame may begin to upload, bytes. The cache lets one chunk pass, whatever its size.
    pub fn limit_bytes(&self) -> u64 {
        if self.secs <= 0.0 {
            return FIRST_BYTES;
        }
        let rate = self.bytes / self.secs;
        ((rate * SECS.max(SHARE * self.frame_secs)) as u64).min(MOST_BYTES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(frames: u32, frame_secs: f32, bytes: u64, took_ms: u64) -> u64 {
        let mut pace = UploadPace::default();
        for _ in 0..frames {
            pace.add(frame_secs, bytes, Duration::from_millis(took_ms));
        }
        pace.limit_bytes()
    }

    #[test]
    fn the_limit_is_what_the_adapter_uploads_in_two_milliseconds_or_a_quarter_of_a_long_frame() {
        assert_eq!(after(0, 0.01, 0, 0), FIRST_BYTES);
        // 1 MB/ms and frames of 8 ms, then 0.1 MB/ms and frames of 80 ms.
        let (fast, slow) = (after(100, 0.008, 10_000_000, 10), after(100, 0.08, 1_000_000, 10));
        assert!((1_990_000..2_010_000).contains(&fast), "{fast}");
        assert!((1_990_000..2_010_000).contains(&slow), "{slow}");
        assert_eq!(after(100, 10.0, 1 << 40, 1), MOST_BYTES);
        assert_eq!(after(100, 10.0, 1_000_000, 10), after(100, 0.1, 1_000_000, 10), "a stall is no long frame");
    }

    #[test]
    fn one_slow_upload_slows_the_next_frames_down_and_is_forgotten() {
        let mut pace = UploadPace::default();
        let mut add = |frames: u32, took_ms: u64| {
            (0..frames).for_each(|_| pace.add(0.016, 1_000_000, Duration::from_millis(took_ms)));
            pace.limit_bytes()
        };
        let before = add(100, 1);
        assert!(add(1, 50) < before / 2);
        assert!(add(100, 1) > before * 9 / 10);
    }
}
