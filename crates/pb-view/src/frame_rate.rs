//! `--target-fps`: how much coarser than asked for the detail has to be for frames to take no longer than they may (paper
//! section 4.4, design section 4).
//!
//! An integral control of the logarithm of the detail: above the budget it gets coarser quickly, far below finer slowly,
//! and between the two it stands, so that it does not swing. Must never: read a clock; times are handed in.

use pb_lod::plan::Detail;

/// The part of a frame's time that it aims at; the rest is for what differs from frame to frame.
const AIM: f64 = 0.9;
/// Frames that take this part of the aim and more are left alone.
const STAND_FROM: f64 = 0.8;
/// Frame times are means over about this time, seconds.
const SMOOTH_SECS: f64 = 0.1;
/// How fast the detail follows, per second: a share of the (logarithmic) distance to the aim.
const COARSER_PER_SEC: f64 = 5.0;
const FINER_PER_SEC: f64 = 2.0;
/// The detail asked for is at most this many times that which is drawn, or its inverse: what waits for data, or for
/// another bound, does not pile up here.
const LEASH: f64 = 1.5;
/// No picture becomes coarser than this many times what was asked for.
const MOST: f64 = 64.0;

/// Watches frame times.
#[derive(Clone, Debug)]
pub struct FrameRate {
    /// Longest time of a frame, seconds; none where nobody asks.
    budget_secs: Option<f64>,
    /// Mean of what frames took, seconds.
    mean_secs: Option<f64>,
    /// How many times the error asked for.
    gain: f64,
}

impl FrameRate {
    /// Frames shall take at most one `fps`th of a second each; without a target they may take what they take.
    pub fn new(fps: Option<f64>) -> Self {
        Self { budget_secs: fps.map(|fps| 1.0 / fps), mean_secs: None, gain: 1.0 }
    }

    /// Whether there is a target.
    pub fn is_on(&self) -> bool {
        self.budget_secs.is_some()
    }

    /// A frame took so many seconds, `dt_secs` after the one before, and was drawn at `drawn` where `asked` had been asked
    /// for before this control.
    pub fn add(&mut self, frame_secs: f64, dt_secs: f64, asked: Detail, drawn: Detail) {
        let Some(budget) = self.budget_secs else { return };
        let dt_secs = dt_secs.clamp(0.0, 1.0);
        let mean = self.mean_secs.unwrap_or(frame_secs);
        let mean = mean + (frame_secs - mean) * (1.0 - (-dt_secs / SMOOTH_SECS).exp());
        self.mean_secs = Some(mean);
        let over = (mean / (budget * AIM)).max(1e-9).ln();
        let step = match over {
            o if o > 0.0 => o.min(2.0) * COARSER_PER_SEC,
            o if o < STAND_FROM.ln() => (o - STAND_FROM.ln()).max(-2.0) * FINER_PER_SEC,
            _ => 0.0,
        };
        let drawn = coarseness(asked, drawn).max(1.0);
        let gain = self.gain * (step * dt_secs).exp();
        self.gain = gain.clamp(drawn / LEASH, drawn * LEASH).clamp(1.0, MOST);
    }

    /// The detail to ask for instead.
    pub fn detail(&self, asked: Detail) -> Detail {
        asked.coarsened(self.gain)
    }
}

/// How many times coarser one detail is than another.
fn coarseness(fine: Detail, coarse: Detail) -> f64 {
    match (fine, coarse) {
        (Detail::ErrorPx(fine), Detail::ErrorPx(coarse)) => f64::from(coarse / fine),
        (Detail::Bands { k: fine, .. }, Detail::Bands { k: coarse, .. }) => f64::from(fine / coarse),
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASKED: Detail = Detail::ErrorPx(1.0);
    const FPS: f64 = 60.0;

    /// An adapter whose frames take `fixed` seconds and `part` more at the detail asked for, less the coarser it is, with
    /// noise; the errors that are allowed and the times of all frames.
    fn fly(control: &mut FrameRate, secs: f64, fixed: f64, part: f64) -> Vec<(f64, f64)> {
        let frames = 0..(secs * FPS) as u32;
        let frame = |i: u32| {
            let Detail::ErrorPx(tau) = control.detail(ASKED) else { unreachable!() };
            let noise = 1.0 + 0.05 * f64::from(i * 7919 % 13) / 6.0 - 0.05;
            let took = (fixed + part * f64::from(tau).powf(-1.2)) * noise;
            control.add(took, (1.0 / FPS).max(took), ASKED, Detail::ErrorPx(tau));
            (f64::from(tau), took)
        };
        frames.map(frame).collect()
    }

    #[test]
    fn frames_come_under_their_time_and_the_detail_stands_there() {
        let mut control = FrameRate::new(Some(FPS));
        let budget = 1.0 / FPS;
        // Five times too slow, then nearly free, then too slow again.
        for part in [5.0 * budget, 1.2 * budget, 8.0 * budget] {
            let flown = fly(&mut control, 10.0, 0.1 * budget, part);
            let late = &flown[300..];
            assert!(late.iter().all(|f| f.1 < budget), "{part}");
            assert!(late.iter().all(|f| f.1 > 0.6 * budget), "{part}: finer was possible");
            let most = late.iter().fold(0.0, |m, f| f64::max(m, f.0));
            let least = late.iter().fold(f64::MAX, |m, f| f.0.min(m));
            assert!(most / least < 1.05, "{part}: it swings from {least} to {most}");
        }
        let flown = fly(&mut control, 20.0, 0.1 * budget, 0.2 * budget);
        assert_eq!(flown.last().unwrap().0, 1.0, "never finer than asked for");
    }

    #[test]
    fn what_another_bound_holds_back_does_not_pile_up() {
        let mut control = FrameRate::new(Some(FPS));
        // Data for no more than 8 pixels; frames are quick.
        (0..600).for_each(|_| control.add(0.001, 0.016, ASKED, Detail::ErrorPx(8.0)));
        let Detail::ErrorPx(tau) = control.detail(ASKED) else { unreachable!() };
        assert!((5.0..6.0).contains(&tau), "{tau}");
        // A frame of minutes is one frame.
        control.add(1000.0, 0.016, ASKED, Detail::ErrorPx(8.0));
        let Detail::ErrorPx(tau) = control.detail(ASKED) else { unreachable!() };
        assert!(tau < 12.5, "{tau}");
    }

    #[test]
    fn without_a_target_nothing_changes() {
        let mut control = FrameRate::new(None);
        control.add(10.0, 10.0, ASKED, ASKED);
        assert_eq!(control.detail(ASKED), ASKED);
        assert!(!control.is_on());
    }

    #[test]
    fn bands_shrink_as_errors_grow() {
        let mut control = FrameRate::new(Some(FPS));
        let bands = Detail::Bands { k: 4.0, s: 1.0 };
        control.add(1.0, 0.1, bands, bands);
        let Detail::Bands { k, s } = control.detail(bands) else { unreachable!() };
        assert!(k < 4.0 && (k / s - 4.0).abs() < 1e-6, "{k} {s}");
    }
}
