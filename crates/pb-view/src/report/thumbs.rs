//! Small pictures of key frames: first and last, some keyframes, the cuts, the slowest frame, and the one that missed
//! most.

use anyhow::{Context, Result};
use base64::Engine;
use exr::prelude::f16;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use std::collections::BTreeMap;

use super::cuts::is_cut;
use crate::flypath::Flypath;
use crate::picture::Format;
use crate::stats::Line;

/// Width at most, pixels.
const WIDTH: u32 = 384;
/// JPEG quality, of 100.
const QUALITY: u8 = 82;
/// Most frames that are chosen before the flight.
const MOST_CHOSEN: usize = 10;
/// Frames of the first second of a flight are neither the slowest nor the worst one: the model is being opened.
const START_SECS: f64 = 1.0;

/// Why a frame is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Why {
    First,
    Cut,
    Keyframe,
    Last,
    Slowest,
    MostMissing,
}

impl Why {
    /// A few words.
    pub fn text(self) -> &'static str {
        match self {
            Why::First => "first frame",
            Why::Cut => "after a cut",
            Why::Keyframe => "at a keyframe",
            Why::Last => "last frame",
            Why::Slowest => "slowest after the first second",
            Why::MostMissing => "most missing after the first second",
        }
    }
}

/// A small picture of a frame.
pub struct Thumb {
    /// Of which frame.
    pub line: Line,
    /// Why this one.
    pub why: Vec<Why>,
    /// As a `data:` address.
    pub address: String,
}

/// Chooses frames and keeps their pictures.
pub struct Thumbs {
    chosen: BTreeMap<u32, Why>,
    start_secs: f64,
    format: Format,
    slowest_ms: f64,
    most_missing: u32,
    /// Of the frame at hand.
    wanted: Option<(Line, Vec<Why>)>,
    kept: Vec<Thumb>,
}

impl Thumbs {
    /// For a flight whose pictures have this format.
    pub fn new(flight: &Flypath, format: Format) -> Self {
        let last = flight.frames() - 1;
        let cuts: Vec<u32> = (1..last).filter(|&f| is_cut(flight, f)).collect();
        let mut keys: Vec<u32> = flight.keyframe_frames();
        keys.retain(|f| (1..last).contains(f));
        let mut chosen = BTreeMap::new();
        for (frames, why, most) in [(keys, Why::Keyframe, MOST_CHOSEN / 2), (cuts, Why::Cut, MOST_CHOSEN / 2 - 2)] {
            chosen.extend(spread(&frames, most).map(|f| (f, why)));
        }
        chosen.extend([(last, Why::Last), (0, Why::First)]);
        let (slowest_ms, most_missing) = (0.0, 0);
        let start_secs = flight.time(0) + START_SECS;
        Self { chosen, start_secs, format, slowest_ms, most_missing, wanted: None, kept: Vec::new() }
    }

    /// True when the picture of this frame is wanted.
    pub fn wants(&mut self, line: &Line) -> bool {
        let mut why: Vec<Why> = self.chosen.get(&line.frame).copied().into_iter().collect();
        if line.t_secs >= self.start_secs {
            if line.frame_ms > self.slowest_ms {
                self.slowest_ms = line.frame_ms;
                why.push(Why::Slowest);
            }
            if line.stats.missing_chunks > self.most_missing {
                self.most_missing = line.stats.missing_chunks;
                why.push(Why::MostMissing);
            }
        }
        self.wanted = (!why.is_empty()).then_some((*line, why));
        self.wanted.is_some()
    }

    /// The picture of the frame that was wanted last.
    pub fn take(&mut self, size: [u32; 2], pixels: &[u8]) -> Result<()> {
        let Some((line, why)) = self.wanted.take() else { return Ok(()) };
        // Whatever was the slowest or the worst until now is so no longer.
        for old in &mut self.kept {
            old.why.retain(|w| !why.contains(w) || !matches!(w, Why::Slowest | Why::MostMissing));
        }
        self.kept.retain(|old| !old.why.is_empty());
        let address = encode(size, pixels, self.format).context("a thumbnail cannot be encoded")?;
        self.kept.push(Thumb { line, why, address });
        Ok(())
    }

    /// The pictures in order of time.
    pub fn finish(self) -> Vec<Thumb> {
        self.kept
    }
}

/// At most `most` of these, evenly.
fn spread(frames: &[u32], most: usize) -> impl Iterator<Item = u32> {
    let n = frames.len().min(most);
    (0..n).map(move |i| frames[i * frames.len() / n])
}

fn encode(size: [u32; 2], pixels: &[u8], format: Format) -> Result<String> {
    let rgb: Vec<u8> = match format {
        Format::Png => pixels.chunks_exact(4).flat_map(|p| &p[..3]).copied().collect(),
        Format::Exr => {
            let bits: Vec<u16> = bytemuck::pod_collect_to_vec(pixels);
            bits.chunks_exact(4).flat_map(|p| &p[..3]).map(|&b| encoded(f16::from_bits(b).to_f32())).collect()
        }
    };
    let picture = RgbImage::from_raw(size[0], size[1], rgb).context("the picture has another size")?;
    let width = size[0].min(WIDTH);
    let height = (size[1] as u64 * width as u64 / size[0] as u64).max(1) as u32;
    let small = resize(&picture, width, height, FilterType::Triangle);
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(&small)?;
    Ok(format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// Linear light as an sRGB byte.
fn encoded(light: f32) -> u8 {
    let v = light.clamp(0.0, 1.0);
    let v = if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    (v * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flypath::default_flight;
    use crate::stats::FrameStats;
    use glam::DVec3;

    #[test]
    fn the_slowest_and_the_worst_frame_stay_until_there_are_others() {
        let mut thumbs = Thumbs::new(&default_flight(DVec3::ZERO, 1.0, DVec3::Y, 50.0), Format::Png);
        for frame in 0..301u32 {
            // A slow and incomplete start does not count.
            let frame_ms = if frame == 140 || frame == 3 { 90.0 } else { 10.0 + (frame % 50) as f64 };
            let missing_chunks =
                if frame < 30 { 50 } else { [60, 70].contains(&frame) as u32 * frame.saturating_sub(50) };
            let stats = FrameStats { missing_chunks, ..FrameStats::default() };
            let line = Line { frame, t_secs: frame as f64 / 30.0, frame_ms, stats, ..Line::default() };
            if thumbs.wants(&line) {
                thumbs.take([2, 2], &[128; 16]).unwrap();
            }
        }
        let kept = thumbs.finish();
        let frame_of =
            |why: Why| kept.iter().filter(|t| t.why.contains(&why)).map(|t| t.line.frame).collect::<Vec<_>>();
        assert_eq!((frame_of(Why::First), frame_of(Why::Last)), (vec![0], vec![300]));
        assert_eq!((frame_of(Why::Slowest), frame_of(Why::MostMissing)), (vec![140], vec![70]));
        assert_eq!(frame_of(Why::Keyframe).len(), MOST_CHOSEN / 2);
        assert!(kept.iter().all(|t| !t.why.is_empty()), "frames that are special no more go");
        assert!(kept.len() <= MOST_CHOSEN + 2 && kept.windows(2).all(|k| k[0].line.frame < k[1].line.frame));
    }

    #[test]
    fn linear_pictures_look_like_encoded_ones() {
        let half = |v: f32| f16::from_f32(v).to_bits().to_le_bytes();
        let linear: Vec<u8> = (0..16).flat_map(|i| half(if i % 4 == 3 { 1.0 } else { 0.2159 })).collect();
        assert_eq!(encode([2, 2], &linear, Format::Exr).unwrap(), encode([2, 2], &[128; 16], Format::Png).unwrap());
    }
}
