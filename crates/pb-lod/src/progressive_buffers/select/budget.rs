//! The detail that fits a byte budget (design section 4, control): the target is found afresh from the view in
//! each frame, the detail in use moves towards it slowly, so that a tight budget never makes a jump.
//!
//! It gets finer only where the data for that is there (paper section 4.4: detail grows as long as the resources allow it),
//! so that a slow disk shows as a detail that rises slowly, evenly over the picture, and not as patches. Damaged chunks are
//! not waited for; data that fits nowhere holds it up for [`PATIENCE_SECS`] per step.

use crate::plan::{Detail, Frame};

/// One step of the ladder of details.
const STEP: f64 = 1.05;
/// Rungs of the ladder: 1.05^400 is 3e8 times the error asked for.
const RUNGS: i32 = 400;
/// A search looks this many rungs below the last answer before the view is walked for finer details.
const NEAR_RUNGS: i32 = 2;
/// The detail in use changes by at most this factor per second: 3 % at 60 frames per second.
const RATE_PER_SEC: f64 = 5.9;
/// The same while the first detail is reached: as fast as floors let data fade in after a cut, a level (about 4 times the
/// error) per 0.1 s.
const FIRST_RATE_PER_SEC: f64 = 1e6;
/// The detail in use gets finer when what this many times smaller an error needs is there too: the camera moves on while
/// the rest is read.
const LEAD: f64 = 1.25;
/// A step to the next rung waits this long for its data, seconds.
const PATIENCE_SECS: f32 = 1.0;

/// What chunks are wanted for.
#[derive(PartialEq)]
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
        Target { detail: asked.coarsened(gain), nearest: (1.0 - 1.0 / gain) as f32 }
    }
}

/// The detail in use: what the caller asks for, made coarser by `gain`.
#[derive(Default)]
pub(super) struct DetailControl {
    last: Option<(Detail, f64)>,
    /// Rung of the last target: where the search for the next one begins.
    rung: i32,
    settled: bool,
    rises: bool,
    /// A finer detail was not to be drawn, though the target is one.
    bound: bool,
    /// The target was reached once.
    arrived: bool,
    /// How long the next step has waited for data, seconds.
    waited_secs: f32,
}

/// What a detail must be good for.
pub(super) struct Conditions<'a> {
    /// What it draws is resident.
    pub is_there: &'a dyn Fn(&Target) -> bool,
    /// It may be drawn in this very frame.
    pub may_be_drawn: &'a dyn Fn(Detail) -> bool,
}

impl DetailControl {
    /// The rung from which on the next search looks, if nobody says to look at finer ones: a little below the last answer.
    pub fn first_rung(&self) -> i32 {
        (self.rung - NEAR_RUNGS).max(0)
    }

    /// The rung of the last target.
    pub fn rung(&self) -> i32 {
        self.rung
    }

    /// The next search looks at all rungs.
    #[cfg(test)]
    pub fn forget_rung(&mut self) {
        self.rung = 0;
    }

    /// The finest detail that [`search`](Self::search) asks the cost of and [`step`](Self::step) returns or asks the cost of,
    /// where the search looks at `first` and coarser rungs.
    pub fn finest(&self, frame: &Frame, first: i32) -> Detail {
        frame.detail.coarsened(STEP.powi(first).min(self.start(frame.detail) * reach(frame)))
    }

    /// The rung of the finest target on the ladder that `fits`; none when rungs finer than `first` may fit, too.
    pub fn search(&self, frame: &Frame, first: i32, fits: impl Fn(&Target) -> bool) -> Option<i32> {
        let rung = first_that(first..RUNGS, self.rung, |rung| fits(&Target::new(frame.detail, STEP.powi(rung))));
        (rung > first || first == 0).then_some(rung)
    }

    /// The target on a rung, and what to use in this frame: on its way there, no finer than what `is_there`, but at once as
    /// coarse as `may_be_drawn` asks for.
    pub fn step(&mut self, frame: &Frame, rung: i32, conditions: &Conditions) -> (Target, Target) {
        let at = |gain: f64| Target::new(frame.detail, gain);
        let target = STEP.powi(rung);
        let gain = self.towards(target, frame, |gain| (conditions.is_there)(&at(gain)));
        let may_be_drawn = |gain: f64| (conditions.may_be_drawn)(frame.detail.coarsened(gain));
        let before = self.last.map(|_| self.start(frame.detail)).filter(|_| frame.dt_secs < f32::INFINITY);
        let free = may_be_drawn(gain);
        // What may not be drawn is a bound, no data that is still to come.
        self.bound &= self.rung == rung;
        self.bound |= !free;
        self.rises = !self.bound && gain > target;
        let gain = match before {
            _ if free => gain,
            // As in the last frame: else the detail would tremble.
            Some(before) if before > gain && may_be_drawn(before) => before,
            // Where nothing is few enough, the coarsest detail of the ladder.
            _ => {
                let coarser = first_that(0..RUNGS, 0, |rung| may_be_drawn(gain * STEP.powi(rung)));
                (gain * STEP.powi(coarser)).min(STEP.powi(RUNGS))
            }
        };
        self.rung = rung;
        self.last = Some((frame.detail, gain));
        self.settled = gain == target || !self.rises && before == Some(gain);
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
            return target * STEP.powi(first_that(0..RUNGS, 0, |rung| is_there(target * STEP.powi(rung))));
        };
        let start = self.start(frame.detail);
        let rate = if self.arrived { RATE_PER_SEC } else { FIRST_RATE_PER_SEC };
        if target >= start {
            self.waited_secs = 0.0;
            return target.min(start * reach(frame));
        }
        let finest = target.max(start / rate.powf(dt_secs.into()));
        let next = target.max(start / STEP);
        self.waited_secs += dt_secs;
        let gain = match () {
            _ if is_there(finest) => finest,
            _ if next > finest && is_there(next) => next,
            _ if self.waited_secs > PATIENCE_SECS && !self.bound => finest.max(next),
            _ => return start,
        };
        self.waited_secs = 0.0;
        gain
    }

    /// True when the detail in use is the one that the budget allows.
    pub fn settled(&self) -> bool {
        self.settled
    }

    /// True when a finer detail would fit, and waits for its data or for its turn.
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

/// The detail on a rung of the ladder.
pub(super) fn on_rung(asked: Detail, rung: i32) -> Detail {
    asked.coarsened(STEP.powi(rung))
}

/// The factor by which the detail in use may get coarser in a frame.
fn reach(frame: &Frame) -> f64 {
    RATE_PER_SEC.powf(frame.dt_secs.max(0.0) as f64)
}

/// Smallest of `rungs` for which `fits` holds, or their end; `fits` never turns false again. Looks near `guess` first, in
/// steps that double, so that an answer near it costs few looks; the answer does not depend on it.
fn first_that(rungs: std::ops::Range<i32>, guess: i32, fits: impl Fn(i32) -> bool) -> i32 {
    // Nothing at `below` fits, or it is no rung; `above` fits, or is the end.
    let (mut below, mut above) = (rungs.start - 1, rungs.end);
    let (mut next, mut step) = (guess, 1);
    while above - below > 1 {
        let rung = next.clamp(below + 1, above - 1);
        if fits(rung) {
            above = rung;
            next = if below < rungs.start { rung - step } else { (below + rung) / 2 };
        } else {
            below = rung;
            next = if above == rungs.end { rung + step } else { (rung + above) / 2 };
        }
        step *= 2;
    }
    above
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn the_rung_that_is_found_does_not_depend_on_the_guess_and_a_near_guess_is_cheap() {
        for answer in [0, 1, 2, 7, 99, 200, 398, 399, 400] {
            for guess in (-3..=403).step_by(7).chain([answer - 1, answer, answer + 1]) {
                let looks = Cell::new(0);
                let fits = |rung: i32| {
                    assert!((0..RUNGS).contains(&rung));
                    looks.set(looks.get() + 1);
                    rung >= answer
                };
                assert_eq!(first_that(0..RUNGS, guess, fits), answer, "guess {guess}");
                assert!(
                    looks.get() <= 2 * (guess - answer).unsigned_abs().max(1).ilog2() + 4,
                    "{answer} {guess} {looks:?}"
                );
            }
        }
    }

    #[test]
    fn a_search_that_may_have_missed_finer_rungs_says_so_and_ends_where_a_full_one_does() {
        let frame = Frame::EMPTY;
        let mut control = DetailControl { rung: 60, ..DetailControl::default() };
        let least = STEP.powi(40) as f32;
        let fits = |target: &Target| matches!(target.detail, Detail::ErrorPx(tau) if tau >= least);
        let mut first = control.first_rung();
        assert_eq!(control.search(&frame, first, fits), None);
        let rung = loop {
            first = (first - 7).max(0);
            if let Some(rung) = control.search(&frame, first, fits) {
                break rung;
            }
        };
        let found = control.step(&frame, rung, &Conditions { is_there: &|_| true, may_be_drawn: &|_| true }).0.detail;
        assert_eq!(found, Detail::ErrorPx(least));
        assert_eq!(control.first_rung(), 40 - NEAR_RUNGS);
    }
}
