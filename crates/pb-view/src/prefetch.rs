//! Which cameras to expect, so that data is there before it is drawn (paper section 4.1): those of the flight that is
//! played, else those that the camera's motion leads to.
//!
//! Must never: read a clock; times are those of the frames.

use glam::{DQuat, DVec3};

use crate::flypath::{Flypath, Keyframe};
use crate::report::cuts::jumps;

/// Cameras of a flight that come within this time are wanted in VRAM, later ones in RAM; seconds.
const SOON_SECS: f64 = 0.5;
/// Between cameras that are looked at ahead on a flight, seconds: soon ones and later ones.
const PATH_STEPS: [f64; 2] = [0.125, 0.5];
/// Motion is a mean over about this time, seconds: shorter than a turn of the hand, longer than its trembling.
const SMOOTH_SECS: f64 = 0.1;
/// Motion is foreseen at least so far, because many loads may come at once, and at most so far, because nobody knows where
/// a hand steers later; seconds.
const MOTION_SECS: [f64; 2] = [0.5, 1.0];
/// Loads are expected to take this long until some were measured, seconds.
const FIRST_LATENCY_SECS: f64 = 0.1;
/// Each load that was quicker than expected takes the expectation down by this share of the difference.
const LATENCY_DECAY: f64 = 0.02;
/// Rotation is foreseen up to this angle, radians.
const MAX_TURN: f64 = 1.5;

/// Cameras that are expected, and whether the view's surroundings are wanted too.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expected {
    /// This camera has little in common with the last one.
    pub cut: bool,
    /// See [`pb_lod::plan::Prefetch`].
    pub around: bool,
    /// What they draw is wanted in VRAM.
    pub soon: Vec<Keyframe>,
    /// What they draw is wanted in RAM.
    pub later: Vec<Keyframe>,
}

/// The cameras of a flight after `t`, `lookahead` seconds far.
pub fn along(flight: &Flypath, t: f64, lookahead: f64) -> Expected {
    let end = (t + lookahead).min(flight.time(0) + flight.duration_secs());
    // Times on a grid of their own, so that the same cameras are asked for by many frames.
    let times = |from: f64, to: f64, step: f64| {
        let first = (from / step).floor() as i64 + 1;
        (first..).map(move |k| k as f64 * step).take_while(move |t| *t < to)
    };
    let middle = end.min(t + SOON_SECS);
    let mut soon: Vec<Keyframe> = times(t, middle, PATH_STEPS[0]).map(|t| flight.at(t)).collect();
    soon.push(flight.at(middle));
    let mut later: Vec<Keyframe> = times(middle, end, PATH_STEPS[1]).map(|t| flight.at(t)).collect();
    if end > middle {
        later.push(flight.at(end));
    }
    Expected { soon, later, ..Expected::default() }
}

/// How the camera moves.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    last: Option<Keyframe>,
    /// Units per second.
    velocity: DVec3,
    /// Axis times radians per second.
    spin: DVec3,
}

impl Motion {
    /// The camera of the next frame, `dt_secs` after the last one. A standing clock says nothing. True at a cut, and at the
    /// start.
    pub fn add(&mut self, key: &Keyframe, dt_secs: f64) -> bool {
        let cut = self.last.is_none_or(|last| jumps(&last, key));
        if cut {
            *self = Motion::default(); // what it did before says nothing
        }
        if let Some(last) = self.last.filter(|_| dt_secs > 0.0 && dt_secs.is_finite()) {
            let share = 1.0 - (-dt_secs / SMOOTH_SECS).exp();
            let turn = turn(direction(&last), direction(key)) / dt_secs;
            self.velocity = self.velocity.lerp((key.eye - last.eye) / dt_secs, share);
            self.spin = self.spin.lerp(turn, share);
        }
        self.last = Some(*key);
        cut
    }

    /// The cameras that this motion leads to until data that is asked for now is here.
    pub fn expected(&self, latency_secs: f64) -> Expected {
        let Some(key) = &self.last else { return Expected { around: true, ..Expected::default() } };
        let horizon = (2.0 * latency_secs).clamp(MOTION_SECS[0], MOTION_SECS[1]);
        let still = self.velocity == DVec3::ZERO && self.spin == DVec3::ZERO;
        let at = |share: f64| self.after(key, horizon * share);
        match still {
            true => Expected { around: true, ..Expected::default() },
            false => Expected { soon: vec![at(0.5), at(1.0)], later: vec![at(2.0)], ..Expected::default() },
        }
    }

    fn after(&self, key: &Keyframe, secs: f64) -> Keyframe {
        let turn = DQuat::from_scaled_axis((self.spin * secs).clamp_length_max(MAX_TURN));
        let eye = key.eye + self.velocity * secs;
        Keyframe { t: key.t + secs, eye, target: eye + turn * (key.target - key.eye), up: turn * key.up, ..*key }
    }
}

fn direction(key: &Keyframe) -> DVec3 {
    (key.target - key.eye).normalize_or_zero()
}

/// The rotation from one direction to another: axis times radians.
fn turn(from: DVec3, to: DVec3) -> DVec3 {
    let axis = from.cross(to);
    axis.normalize_or_zero() * axis.length().atan2(from.dot(to))
}

/// What to expect in each frame of a run.
#[derive(Clone, Debug)]
pub struct Prefetcher {
    off: bool,
    lookahead: f64,
    motion: Motion,
}

impl Prefetcher {
    /// Flights are looked ahead along for so many seconds; with 0, and by hand, motion says what comes.
    pub fn new(lookahead: f64) -> Self {
        Self { off: false, lookahead, motion: Motion::default() }
    }

    /// Expects nothing.
    pub fn off() -> Self {
        Self { off: true, lookahead: 0.0, motion: Motion::default() }
    }

    /// The next frame has camera `key`, `dt_secs` after the last one; a flight that is played is at its time in `flight`.
    pub fn expect(
        &mut self,
        key: &Keyframe,
        dt_secs: f64,
        flight: Option<(&Flypath, f64)>,
        latency: &Latency,
    ) -> Expected {
        let cut = self.motion.add(key, dt_secs);
        let expected = match flight {
            _ if self.off => Expected::default(),
            Some((flight, t)) if self.lookahead > 0.0 => along(flight, t, self.lookahead),
            _ => self.motion.expected(latency.secs()),
        };
        Expected { cut, ..expected }
    }
}

/// How long loads take: rises at once, falls slowly.
#[derive(Clone, Copy, Debug)]
pub struct Latency(f64);

impl Default for Latency {
    fn default() -> Self {
        Latency(FIRST_LATENCY_SECS)
    }
}

impl Latency {
    /// A load was answered this long after it was asked for.
    pub fn add(&mut self, secs: f64) {
        self.0 = if secs > self.0 { secs } else { self.0 + (secs - self.0) * LATENCY_DECAY };
    }

    /// What to expect, seconds.
    pub fn secs(&self) -> f64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(t: f64, eye: DVec3, forward: DVec3) -> Keyframe {
        Keyframe { t, eye, target: eye + forward, up: DVec3::Y, fov_deg: 50.0 }
    }

    #[test]
    fn a_steady_motion_leads_on_along_its_line_and_its_turn() {
        let mut motion = Motion::default();
        let at = |t: f64| {
            let angle = 0.5 * t;
            key(t, DVec3::new(3.0 * t, 0.0, 1.0), DVec3::new(angle.sin(), 0.0, -angle.cos()))
        };
        (0..120).for_each(|i| assert_eq!(motion.add(&at(i as f64 / 60.0), 1.0 / 60.0), i == 0));
        let expected = motion.expected(0.3);
        let now = 119.0 / 60.0;
        assert!(!expected.around);
        for (found, ahead) in expected.soon.iter().zip([0.3, 0.6]).chain(expected.later.iter().zip([1.2])) {
            let truth = at(now + ahead);
            assert!(found.eye.distance(truth.eye) < 0.01, "{found:?} {truth:?}");
            assert!(direction(found).distance(direction(&truth)) < 0.01, "{found:?} {truth:?}");
        }
        assert!(motion.add(&key(3.0, DVec3::Y * 1e3, DVec3::X), 1.0 / 60.0), "a cut");
        assert_eq!(motion.expected(0.2), Expected { around: true, ..Expected::default() });
    }

    #[test]
    fn a_camera_at_rest_expects_nothing_but_its_surroundings() {
        let mut motion = Motion::default();
        (0..10).for_each(|i| assert_eq!(motion.add(&key(0.0, DVec3::Z, -DVec3::Z), 0.1), i == 0));
        assert_eq!(motion.expected(1.0), Expected { around: true, ..Expected::default() });
    }

    #[test]
    fn a_flight_is_looked_ahead_to_its_end_and_no_further() {
        let keys = (0..5).map(|i| key(i as f64, DVec3::X * i as f64, -DVec3::Z)).collect();
        let flight = Flypath::new(60.0, keys).unwrap();
        let found = along(&flight, 1.03, 2.0);
        assert!(!found.around);
        let times = |keys: &[Keyframe]| keys.iter().map(|k| k.eye.x).collect::<Vec<_>>();
        let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(&times(&found.soon), &[1.125, 1.25, 1.375, 1.5, 1.53]), "{:?}", times(&found.soon));
        assert!(near(&times(&found.later), &[2.0, 2.5, 3.0, 3.03]), "{:?}", times(&found.later));
        let last = along(&flight, 3.9, 2.0);
        assert!((times(&last.soon).last().unwrap() - 4.0).abs() < 1e-9 && last.later.is_empty(), "{last:?}");
    }

    #[test]
    fn latency_rises_at_once_and_falls_slowly() {
        let mut latency = Latency::default();
        latency.add(0.4);
        assert_eq!(latency.secs(), 0.4);
        (0..10).for_each(|_| latency.add(0.0));
        assert!((0.3..0.4).contains(&latency.secs()), "{}", latency.secs());
        (0..300).for_each(|_| latency.add(0.01));
        assert!((0.01..0.02).contains(&latency.secs()), "{}", latency.secs());
    }
}
