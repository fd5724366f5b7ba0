//! Flypaths: keyframes of a camera, read from JSON, checked whole, interpolated smoothly.
//!
//! Between keyframes eye, target and up follow cubic Hermite curves whose tangents are the slopes between the
//! neighbouring keyframes (Catmull-Rom for unequal times), so the camera never jerks; the field of view follows
//! the same curve, kept between its two keyframes' values. docs/user-guide.md describes the file.
//!
//! Must never: read a clock; hand out a camera whose line of sight or up vector is undefined.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The version that this program reads and writes.
const VERSION: u64 = 1;
/// Most frames of one flight: four hours at 60 frames per second are less.
const MAX_FRAMES: f64 = 1_000_000.0;
/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 256 << 20;
/// Sine of the smallest angle between up and the line of sight.
const MIN_UP_SINE: f64 = 1e-4;
/// Field of view, degrees.
const FOV_RANGE: std::ops::RangeInclusive<f64> = 1.0..=170.0;

/// What is wrong with a flypath file.
#[derive(Debug, thiserror::Error)]
pub enum FlypathError {
    /// The file cannot be read.
    #[error("{}: cannot read the flypath: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{}: cannot write the flypath: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// Not JSON, or a field is missing or of the wrong type.
    #[error("{}:{line}: {reason}; see the user guide for the flypath format", path.display())]
    Syntax {
        /// Which file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the parser says.
        reason: String,
    },
    /// The fields are there, but their values make no flight.
    #[error("{}: {reason}", path.display())]
    Invalid {
        /// Which file.
        path: PathBuf,
        /// What and where, and what to do.
        reason: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: u64,
    fps: f64,
    fov_deg: f64,
    keyframes: Vec<FileKeyframe>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileKeyframe {
    t: f64,
    eye: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    #[serde(default)]
    fov_deg: Option<f64>,
}

#[derive(Serialize)]
struct Written<'a> {
    version: u64,
    fps: f64,
    fov_deg: f64,
    keyframes: Vec<WrittenKeyframe<'a>>,
}

#[derive(Serialize)]
struct WrittenKeyframe<'a> {
    t: f64,
    eye: &'a [f64; 3],
    target: &'a [f64; 3],
    up: &'a [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    fov_deg: Option<f64>,
}

/// A camera at a time. World space, seconds, degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Seconds.
    pub t: f64,
    /// Eye position.
    pub eye: DVec3,
    /// A point in the middle of the picture.
    pub target: DVec3,
    /// Which way is up, any length but zero.
    pub up: DVec3,
    /// Vertical field of view.
    pub fov_deg: f64,
}

/// A whole flight; every frame of it has a sound camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Flypath {
    fps: f64,
    keyframes: Vec<Keyframe>,
}

impl Flypath {
    /// Reads and checks a file.
    pub fn open(path: &Path) -> Result<Self, FlypathError> {
        let io = |source| FlypathError::Io { path: path.to_owned(), source };
        let bytes = std::fs::metadata(path).map_err(io)?.len();
        if bytes > MAX_FILE_BYTES {
            let reason = format!("the flypath has {bytes} bytes; at most {MAX_FILE_BYTES} are read");
            return Err(FlypathError::Invalid { path: path.to_owned(), reason });
        }
        let text = std::fs::read(path).map_err(io)?;
        Self::parse(path, &text)
    }

    /// The same from memory; `path` is for messages.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Self, FlypathError> {
        let file: File = serde_json::from_slice(text).map_err(|e| FlypathError::Syntax {
            path: path.to_owned(),
            line: e.line().max(1),
            reason: strip_place(&e),
        })?;
        let invalid = |reason| FlypathError::Invalid { path: path.to_owned(), reason };
        if file.version != VERSION {
            let found = file.version;
            return Err(invalid(format!(
                "the flypath has version {found}, this program reads version {VERSION}; use a newer program"
            )));
        }
        let keyframe = |k: FileKeyframe| Keyframe {
            t: k.t,
            eye: k.eye.into(),
            target: k.target.into(),
            up: k.up.into(),
            fov_deg: k.fov_deg.unwrap_or(file.fov_deg),
        };
        Self::new(file.fps, file.keyframes.into_iter().map(keyframe).collect()).map_err(invalid)
    }

    /// Checks a flight, down to each of its frames. The error says what is wrong and where.
    pub fn new(fps: f64, keyframes: Vec<Keyframe>) -> Result<Self, String> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(format!("fps is {fps}; it must be more than 0"));
        }
        let Some((first, last)) = keyframes.first().zip(keyframes.last()) else {
            return Err("there are no keyframes; a flight needs at least one".into());
        };
        for (i, k) in keyframes.iter().enumerate() {
            check(k).map_err(|e| format!("keyframe {i} (t = {}): {e}", k.t))?;
        }
        for (i, pair) in keyframes.windows(2).enumerate() {
            if pair[1].t <= pair[0].t {
                let (n, a, b) = (i + 1, pair[0].t, pair[1].t);
                return Err(format!("keyframe {n}: t = {b} does not come after t = {a}; times must increase"));
            }
        }
        let frames = (last.t - first.t) * fps;
        if frames > MAX_FRAMES {
            return Err(format!("the flight has {frames:.0} frames; at most {MAX_FRAMES:.0} are flown, lower fps"));
        }
        let path = Self { fps, keyframes };
        for frame in 0..path.frames() {
            let k = path.at(path.time(frame));
            check(&k).map_err(|e| format!("frame {frame} (t = {}), between keyframes: {e}", k.t))?;
        }
        Ok(path)
    }

    /// Number of frames: at `t0`, `t0 + 1/fps`, ... up to the last keyframe, which counts when it is hit to within
    /// a millionth of a frame.
    pub fn frames(&self) -> u32 {
        ((self.last().t - self.keyframes[0].t) * self.fps + 1e-6).floor() as u32 + 1
    }

    /// The frames nearest to the keyframes.
    pub fn keyframe_frames(&self) -> Vec<u32> {
        let frame = |k: &Keyframe| ((k.t - self.keyframes[0].t) * self.fps).round() as u32;
        self.keyframes.iter().map(|k| frame(k).min(self.frames() - 1)).collect()
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// Seconds between two frames.
    pub fn dt_secs(&self) -> f64 {
        1.0 / self.fps
    }

    /// Time of a frame, seconds, on the file's clock.
    pub fn time(&self, frame: u32) -> f64 {
        self.keyframes[0].t + frame as f64 / self.fps
    }

    /// Length of the flight, seconds.
    pub fn duration_secs(&self) -> f64 {
        self.last().t - self.keyframes[0].t
    }

    fn last(&self) -> &Keyframe {
        self.keyframes.last().expect("a flight has at least one keyframe")
    }

    /// The camera at time `t`; before the first and after the last keyframe it stands still.
    pub fn at(&self, t: f64) -> Keyframe {
        let keys = &self.keyframes;
        let next = keys.partition_point(|k| k.t <= t);
        if next == 0 {
            return Keyframe { t, ..keys[0] };
        }
        if next == keys.len() {
            return Keyframe { t, ..*self.last() };
        }
        let (a, b) = (keys[next - 1], keys[next]);
        let span = b.t - a.t;
        let s = (t - a.t) / span;
        let curve = |value: fn(&Keyframe) -> DVec3| {
            let (m0, m1) = (self.slope(next - 1, value), self.slope(next, value));
            hermite(s, value(&a), value(&b), m0 * span, m1 * span)
        };
        let fov = curve(|k| DVec3::splat(k.fov_deg)).x;
        Keyframe {
            t,
            eye: curve(|k| k.eye),
            target: curve(|k| k.target),
            up: curve(|k| k.up.normalize()).normalize_or_zero(),
            fov_deg: fov.clamp(a.fov_deg.min(b.fov_deg), a.fov_deg.max(b.fov_deg)),
        }
    }

    /// Slope of a value at keyframe `i`, per second: between its neighbours, one-sided at the ends.
    fn slope(&self, i: usize, value: fn(&Keyframe) -> DVec3) -> DVec3 {
        let (a, b) = (&self.keyframes[i.saturating_sub(1)], &self.keyframes[(i + 1).min(self.keyframes.len() - 1)]);
        (value(b) - value(a)) / (b.t - a.t)
    }

    /// Writes the flight as a file that [`Flypath::open`] reads back to the same flight.
    pub fn write(&self, path: &Path) -> Result<(), FlypathError> {
        let fov_deg = self.keyframes[0].fov_deg;
        let arrays: Vec<[[f64; 3]; 3]> =
            self.keyframes.iter().map(|k| [k.eye.to_array(), k.target.to_array(), k.up.to_array()]).collect();
        let keyframes = self.keyframes.iter().zip(&arrays).map(|(k, [eye, target, up])| WrittenKeyframe {
            t: k.t,
            eye,
            target,
            up,
            fov_deg: (k.fov_deg != fov_deg).then_some(k.fov_deg),
        });
        let written = Written { version: VERSION, fps: self.fps, fov_deg, keyframes: keyframes.collect() };
        let text = serde_json::to_string_pretty(&written).expect("plain numbers always become JSON");
        std::fs::write(path, text + "\n").map_err(|source| FlypathError::Write { path: path.to_owned(), source })
    }
}

fn hermite(s: f64, a: DVec3, b: DVec3, m0: DVec3, m1: DVec3) -> DVec3 {
    let (s2, s3) = (s * s, s * s * s);
    a * (2.0 * s3 - 3.0 * s2 + 1.0) + m0 * (s3 - 2.0 * s2 + s) + b * (3.0 * s2 - 2.0 * s3) + m1 * (s3 - s2)
}

/// A camera has a line of sight, an up vector that is not along it, and a sane field of view.
fn check(k: &Keyframe) -> Result<(), String> {
    let numbers = [k.eye, k.target, k.up, DVec3::new(k.t, k.fov_deg, 0.0)];
    if !numbers.iter().all(|v| v.is_finite()) {
        return Err("a number is infinite or not a number".into());
    }
    if !FOV_RANGE.contains(&k.fov_deg) {
        let (low, high) = (FOV_RANGE.start(), FOV_RANGE.end());
        return Err(format!("fov_deg is {}; it must lie between {low} and {high} degrees", k.fov_deg));
    }
    let sight = (k.target - k.eye).try_normalize();
    let sight = sight.ok_or("eye and target are the same point; move one of them")?;
    let up = k.up.try_normalize().ok_or("up is the zero vector; give it a direction")?;
    if sight.cross(up).length() < MIN_UP_SINE {
        return Err("up is parallel to the line of sight; give another up vector".into());
    }
    Ok(())
}

/// The parser's message without its own "at line x column y": the line is in front of our message already.
fn strip_place(e: &serde_json::Error) -> String {
    let text = e.to_string();
    match text.rfind(" at line ") {
        Some(at) => text[..at].to_owned(),
        None => text,
    }
}

/// A flight that suits a model in the sphere (`center`, `radius`): once around while closing in on the surface,
/// then far away, so that all levels are seen. 300 frames.
pub fn default_flight(center: DVec3, radius: f64, up: DVec3, fov_deg: f64) -> Flypath {
    const KEYS: usize = 12;
    const SECS: f64 = 10.0;
    let fit = radius / (fov_deg.to_radians() * 0.5).sin();
    let x = up.any_orthonormal_vector();
    let y = up.cross(x);
    // Distance over `fit`, by key: from where the model fills the picture to near, then far out.
    let distance = |s: f64| match s {
        s if s < 0.5 => 1.05 - (1.05 - 0.55) * (s / 0.5),
        s => 0.55 * (24f64 / 0.55).powf((s - 0.5) / 0.5),
    };
    let key = |i: usize| {
        let s = i as f64 / KEYS as f64;
        let angle = s * std::f64::consts::TAU;
        let direction = (x * angle.cos() + y * angle.sin()) * 0.92 + up * 0.39;
        let eye = center + direction.normalize() * fit * distance(s);
        Keyframe { t: s * SECS, eye, target: center, up, fov_deg }
    };
    Flypath::new(30.0, (0..=KEYS).map(key).collect()).expect("the eye circles the target at an angle to up")
}

#[cfg(test)]
mod tests;
