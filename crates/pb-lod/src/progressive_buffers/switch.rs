//! How the switch distances of the display rule are filled (design section 4; paper equation 1).
//!
//! Errors are made strictly increasing once, when an archive is opened; after that a switch distance is one
//! f32 product, so that this file, the shader and the selection agree on every bit that matters.

use super::display::LodTable;
use super::layout::MAX_LEVELS;
use crate::plan::Detail;

/// Smallest relative step between two neighbouring switch distances.
const MIN_STEP: f32 = 1.001;
/// Smallest absolute step, in grid quanta.
const MIN_STEP_QUANTA: f64 = 1e-3;

/// The absolute step that keeps switch distances apart, in input units, from the grid step.
pub fn min_step(quantum: f64) -> f32 {
    ((quantum * MIN_STEP_QUANTA) as f32).max(f32::MIN_POSITIVE)
}

/// Makes a sequence start at 0 and grow strictly: `out[i] >= max(in[i], out[i-1] * 1.001 + min_step)`.
pub fn increasing(values: impl Iterator<Item = f32>, min_step: f32) -> [f32; MAX_LEVELS] {
    let mut out = [0.0f32; MAX_LEVELS];
    for (i, value) in values.take(MAX_LEVELS).enumerate().skip(1) {
        out[i] = value.max(out[i - 1] * MIN_STEP + min_step);
    }
    out
}

/// Turns a cluster's errors into its switch distances, for one detail and one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switch {
    /// `D_i = errors[i] * scale`; 1 / (tau * pixel angle). Not used with bands.
    pub scale: f32,
    /// The distances themselves, the same for all clusters, where the paper's bands are asked for.
    pub bands: Option<[f32; MAX_LEVELS]>,
}

impl Switch {
    /// The switch for `detail` in a view whose pixels cover `pixel_angle` radians.
    pub fn new(detail: Detail, pixel_angle: f32, quantum: f64) -> Switch {
        match detail {
            Detail::ErrorPx(tau) => Switch { scale: 1.0 / (tau * pixel_angle), bands: None },
            Detail::Bands { k, s } => {
                let band = |i: i32| ((2f32.powi(i) - 1.0) * k + s).max(0.0);
                let bands = increasing((0..MAX_LEVELS as i32).map(band), min_step(quantum));
                Switch { scale: 1.0, bands: Some(bands) }
            }
        }
    }

    /// Switch distance `D_level`, world units, of a cluster with these (increasing) errors.
    pub fn distance(&self, errors: &[f32], level: usize) -> f32 {
        match &self.bands {
            Some(bands) => bands[level],
            None => errors[level] * self.scale,
        }
    }

    /// The whole table of a cluster with these (increasing) errors, one per level.
    pub fn table(&self, errors: &[f32], floor: f32) -> LodTable {
        let mut distances = [0.0; MAX_LEVELS];
        for (level, distance) in distances.iter_mut().enumerate().take(errors.len()) {
            *distance = self.distance(errors, level);
        }
        LodTable { levels: errors.len() as u32, floor, distances }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_clusters_still_get_strictly_increasing_distances() {
        let errors = increasing([0.0; 5].into_iter(), min_step(1.0));
        let table = Switch::new(Detail::ErrorPx(1.0), 1e-3, 1.0).table(&errors[..5], 0.0);
        assert_eq!(table.distances[0], 0.0);
        assert!(table.distances[..5].windows(2).all(|w| w[0] < w[1]), "{:?}", table.distances);
    }

    #[test]
    fn a_level_is_used_where_its_error_projects_to_tau_pixels() {
        let table = Switch::new(Detail::ErrorPx(2.0), 1e-3, 1e-6).table(&[0.0, 0.5, 3.0], 0.0);
        assert!((table.distances[1] - 250.0).abs() < 1e-3 && (table.distances[2] - 1500.0).abs() < 1e-2);
    }

    #[test]
    fn bands_follow_equation_1_and_ignore_errors() {
        let table = Switch::new(Detail::Bands { k: 2.0, s: 1.0 }, 1e-3, 1e-6).table(&[0.0, 9.0, 99.0], 0.0);
        assert_eq!(table.distances[..3], [0.0, 3.0, 7.0]);
        let narrow = Switch::new(Detail::Bands { k: 1.0, s: -5.0 }, 1e-3, 1.0).table(&[0.0; 4], 0.0);
        assert!(narrow.distances[..4].windows(2).all(|w| w[0] < w[1]));
    }
}
