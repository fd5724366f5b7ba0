//! The detail that fits a byte budget (design section 4, control): the target is found afresh from the view in
//! each frame, the detail in use moves towards it slowly, so that a tight budget never makes a jump.
//!
//! It gets finer only where the data for that is there (paper section 4.4: detail grows as long as the resources allow it),
//! so that a slow disk shows as a detail that rises slowly, evenly over the picture, and not as patches. Data that never
//! comes (damaged chunks) holds it up for [`PATIENCE_SECS`] per step at most.

use crate::plan::{Detail, Frame};

/// One step of the ladder of details.
const STEP: f64 = 1.05;
/// Rungs of the ladder: 1.05^400 is 3e8 times the error asked for.
const RUNGS: i32 = 400;
/// The detail in use changes by at most this factor per second: 3 % at 60 frames per second.
const RATE_PER_SEC: f64 = 5.9;
/// The same while the first detail is reached: as fast as floors let data fade in, a level (about 4 times the error) per
/// 0.3 s.
const FIRST_RATE_PER_SEC: f64 = 100.0;
/// The detail in use gets finer when what this many times smaller an error needs is there too: the camera moves on while
/// the rest is read.
const LEAD: f64 = 1.25;
/// A step to the next rung waits this long for its data, seconds.
const PATIENCE_SECS: f32 = 1.0;

/// What chunks are wanted for.
pub(super) struct Target {
    /// The detail that the budget allows.
    pub detail: Detail,
    /// No cluster counts as nearer than this fraction of its radius. 0 while the budget holds what is asked
    /// for; else it grows to 1, because a sphere that holds the eye has distance 0, where no error is too
    /// small for the finest level.
    pub nearest: f32,
}

impl Target {
    fn new(asked: Detail, gain: f64) -> Target {
        Target { detail: coarsened(asked, gain), nearest: (1.0 - 1.0 / gain) as f32 }
    }
}

/// The detail in use: what the caller asks for, made coarser by `gain`.
#[derive(Default)]
pub(super) struct DetailControl {
    last: Option<(Detail, f64)>,
    settled: bool,
    rises: bool,
    /// The target was reached once.
    arrived: bool,
    /// How long the next step has waited for data, seconds.
    waited_secs: f32,
}

/// What a detail must be good for.
pub(super) struct Conditions<'a> {
    /// Its bytes and triangles are within the bounds.
    pub fits: &'a dyn Fn(&Target) -> bool,
    /// What it draws is resident.
    pub is_there: &'a dyn Fn(&Target) -> bool,
    /// It may be drawn in this very frame.
    pub may_be_drawn: &'a dyn Fn(Detail) -> bool,
}

impl DetailControl {
    /// The finest detail that the next step of any of them can return or ask the cost of.
    pub fn finest(controls: &[DetailControl], asked: Detail) -> Detail {
        coarsened(asked, controls.iter().map(|c| c.start(asked)).fold(1.0, f64::min))
    }

    /// The finest target on the ladder that `fits`, and what to use in this frame: on its way there, no finer than what
    /// `is_there`, but at once as coarse as `may_be_drawn` asks for.
    pub fn step(&mut self, frame: &Frame, conditions: &Conditions) -> (Target, Target) {
        let at = |gain: f64| Target::new(frame.detail, gain);
        let target = STEP.powi(first_that(RUNGS, |rung| (conditions.fits)(&at(STEP.powi(rung)))));
        let gain = self.towards(target, frame, |gain| (conditions.is_there)(&at(gain)));
        let may_be_drawn = |gain: f64| (conditions.may_be_drawn)(coarsened(frame.detail, gain));
        let gain = match may_be_drawn(gain) {
            true => gain,
            false => gain * STEP.powi(first_that(RUNGS, |rung| may_be_drawn(gain * STEP.powi(rung)))),
        };
        self.last = Some((frame.detail, gain));
        self.settled = gain == target;
        self.rises = gain > target;
        self.arrived |= gain <= target;
        (at(target), at(gain))
    }

    /// The gain of this frame, between that of the last one and the target.
    fn towards(&mut self, target: f64, frame: &Frame, is_there: impl Fn(f64) -> bool) -> f64 {
        let dt_secs = frame.dt_secs.max(0.0);
        if dt_secs == f32::INFINITY {
            return target;
        }
        let is_there = |gain: f64| is_there(target.max(gain / LEAD));
        let Some(_) = self.last else {
            return target * STEP.powi(first_that(RUNGS, |rung| is_there(target * STEP.powi(rung))));
        };
        let start = self.start(frame.detail);
        let rate = if self.arrived { RATE_PER_SEC } else { FIRST_RATE_PER_SEC };
        if target >= start {
            self.waited_secs = 0.0;
            return target.min(start * RATE_PER_SEC.powf(dt_secs.into()));
        }
        let finest = target.max(start / rate.powf(dt_secs.into()));
        let next = target.max(start / STEP);
        self.waited_secs += dt_secs;
        let gain = match () {
            _ if is_there(finest) => finest,
            _ if next > finest && is_there(next) => next,
            _ if self.waited_secs > PATIENCE_SECS => finest.max(next),
            _ => return start,
        };
        self.waited_secs = 0.0;
        gain
    }

    /// True when the detail in use is the one that the budget allows.
    pub fn settled(&self) -> bool {
        self.settled
    }

    /// True when a finer detail would fit.
    pub fn rises(&self) -> bool {
        self.rises
    }

    /// The gain over what is asked for now that continues the detail of the last frame.
    fn start(&self, asked: Detail) -> f64 {
        match (self.last, asked) {
            (Some((Detail::ErrorPx(before), gain)), Detail::ErrorPx(now)) => gain * (before / now) as f64,
            (Some((Detail::Bands { .. }, gain)), Detail::Bands { .. }) => gain,
            _ => 1.0,
        }
    }
}

/// `detail` with its error multiplied, or its bands divided, by `gain`.
fn coarsened(detail: Detail, gain: f64) -> Detail {
    match detail {
        Detail::ErrorPx(tau) => Detail::ErrorPx((tau as f64 * gain) as f32),
        Detail::Bands { k, s } => Detail::Bands { k: (k as f64 / gain) as f32, s: (s as f64 / gain) as f32 },
    }
}

/// Smallest rung in `0..last` for which `fits` holds, or `last`; `fits` never turns false again.
fn first_that(last: i32, fits: impl Fn(i32) -> bool) -> i32 {
    if fits(0) {
        return 0;
    }
    let (mut below, mut above) = (0, last);
    while above - below > 1 {
        let middle = (below + above) / 2;
        if fits(middle) { above = middle } else { below = middle }
    }
    above
}
