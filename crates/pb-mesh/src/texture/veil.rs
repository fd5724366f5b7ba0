//! Blended transparency as a screen door: a surface covers none, one, two, three or all of a pixel's four samples.
//!
//! Nothing has to be sorted so, and what is seen through is right in any order. The shader (pb-render's shade.wgsl) tells
//! by alpha how many: from one half on, where cut-outs begin, in steps of [`STEP`]. Between a hole and an opaque texel these
//! values are passed within a fraction of a texel, so edges of cut-outs stay sharp.

/// Alpha from which on one sample of four is covered.
pub const FIRST: f32 = 0.5;
/// And another from each of these steps on.
pub const STEP: f32 = 0.06;
/// Less than this is nothing at all; the rest covers a sample at least.
const INVISIBLE: f32 = 1.0 / 16.0;

/// How an alpha is stored: amid its step.
pub(super) fn stored(alpha: f32) -> f32 {
    match (alpha * 4.0).round() as u32 {
        _ if alpha < INVISIBLE => 0.0,
        quarters @ 0..=3 => FIRST + STEP * (quarters.max(1) as f32 - 0.5),
        _ => 1.0,
    }
}

/// Whether a stored alpha stands for some of a pixel's samples.
pub(super) fn is_partial(stored: f32) -> bool {
    (1..=3).any(|quarters| (stored - FIRST - STEP * (quarters as f32 - 0.5)).abs() < 0.25 * STEP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alphas_are_stored_as_quarters_of_a_pixel() {
        let quarters = |alpha: f32| match stored(alpha) {
            s if s < FIRST => 0,
            s => (((s - FIRST) / STEP) as u32).min(3) + 1,
        };
        let found = [0.0, 0.05, 0.07, 0.3, 0.5, 0.7, 0.9, 1.0].map(quarters);
        assert_eq!(found, [0, 0, 1, 1, 2, 3, 4, 4]);
        assert_eq!([0.0, 0.3, 0.5, 0.7, 1.0].map(|a| is_partial(stored(a))), [false, true, true, true, false]);
    }
}
