//! The detail that fits a byte budget (design section 4, control): the target is found afresh from the view in
//! each frame, the detail in use moves towards it slowly, so that a tight budget never makes a jump.

use crate::plan::{Detail, Frame};

/// One step of the ladder of details.
const STEP: f64 = 1.05;
/// Rungs of the ladder: 1.05^400 is 3e8 times the error asked for.
const RUNGS: i32 = 400;
/// The detail in use changes by at most this factor per second: 3 % at 60 frames per second.
const RATE_PER_SEC: f64 = 5.9;

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
}

impl DetailControl {
    /// The finest detail that the next step of any of them can return or ask the cost of.
    pub fn finest(controls: &[DetailControl], asked: Detail) -> Detail {
        coarsened(asked, controls.iter().map(|c| c.start(asked)).fold(1.0, f64::min))
    }

    /// The finest target on the ladder that `fits`, and the detail to use in this frame: on its way there, but at once as
    /// coarse as `may_be_drawn` asks for.
    pub fn step(
        &mut self,
        frame: &Frame,
        fits: impl Fn(&Target) -> bool,
        may_be_drawn: impl Fn(Detail) -> bool,
    ) -> (Target, Detail) {
        let target = STEP.powi(first_that(RUNGS, |rung| fits(&Target::new(frame.detail, STEP.powi(rung)))));
        let reach = RATE_PER_SEC.powf(frame.dt_secs.max(0.0) as f64);
        let start = self.start(frame.detail);
        let gain = match self.last {
            Some(_) => target.clamp(start / reach, start * reach),
            None => target,
        };
        let gain = match may_be_drawn(coarsened(frame.detail, gain)) {
            true => gain,
            false => {
                gain * STEP.powi(first_that(RUNGS, |r| may_be_drawn(coarsened(frame.detail, gain * STEP.powi(r)))))
            }
        };
        self.last = Some((frame.detail, gain));
        self.settled = gain == target;
        (Target::new(frame.detail, target), coarsened(frame.detail, gain))
    }

    /// True when the detail in use is the one that the budget allows.
    pub fn settled(&self) -> bool {
        self.settled
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
