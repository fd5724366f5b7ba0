//! Where a flight jumps: film makers call it a cut.
//!
//! A frame begins a cut when the camera turned by more than half the field of view, or moved by more than half its
//! distance to the target, and by [`JUMP`] times as much as in the frames around it. So a fast but steady flight has
//! none, nor have stills that all lie apart. The first frame of a flight counts as one.

use crate::flypath::{Flypath, Keyframe};

/// How much more than its neighbours a step is that is a jump.
const JUMP: f64 = 4.0;

/// A step of the camera from one frame to the next.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    /// World units.
    moved: f64,
    /// Half the distance to the target before it, world units.
    far: f64,
    /// Radians.
    turned: f64,
    /// Half the field of view before it, radians.
    wide: f64,
}

impl Step {
    fn new(before: &Keyframe, after: &Keyframe) -> Self {
        let (a, b) = (before.target - before.eye, after.target - after.eye);
        Self {
            moved: before.eye.distance(after.eye),
            far: a.length() * 0.5,
            turned: a.angle_between(b),
            wide: before.fov_deg.to_radians() * 0.5,
        }
    }
}

/// True when two cameras have little in common, whatever came before.
pub fn jumps(before: &Keyframe, after: &Keyframe) -> bool {
    let step = Step::new(before, after);
    step.moved > step.far || step.turned > step.wide
}

/// True when frame `frame` of a flight begins a cut.
pub fn is_cut(flight: &Flypath, frame: u32) -> bool {
    // The step that leads to a frame; none to the first one and past the end.
    let step = |to: u32| match (1..flight.frames()).contains(&to) {
        true => Step::new(&flight.at(flight.time(to - 1)), &flight.at(flight.time(to))),
        false => Step::default(),
    };
    if frame == 0 {
        return true;
    }
    let (before, here, after) = (step(frame - 1), step(frame), step(frame + 1));
    let jump = |of: fn(&Step) -> f64| of(&here) > JUMP * of(&before).max(of(&after));
    here.moved > here.far && jump(|s| s.moved) || here.turned > here.wide && jump(|s| s.turned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn flight(keys: &[(f64, DVec3, DVec3)]) -> Flypath {
        let key = |&(t, eye, target): &(f64, DVec3, DVec3)| Keyframe { t, eye, target, up: DVec3::Y, fov_deg: 50.0 };
        Flypath::new(10.0, keys.iter().map(key).collect()).unwrap()
    }

    fn cuts(flight: &Flypath) -> Vec<u32> {
        (0..flight.frames()).filter(|&f| is_cut(flight, f)).collect()
    }

    #[test]
    fn a_jump_between_two_stills_is_a_cut() {
        let (a, b) = (DVec3::new(0.0, 0.0, 9.0), DVec3::new(7.0, 1.0, 0.0));
        let moved =
            flight(&[(0.0, a, DVec3::ZERO), (1.0, a, DVec3::ZERO), (1.1, b, DVec3::ZERO), (2.0, b, DVec3::ZERO)]);
        assert_eq!(cuts(&moved), [0, 11]);
        let closer = [(0.0, a), (1.0, a), (1.1, a * 0.3), (2.0, a * 0.3)].map(|(t, eye)| (t, eye, DVec3::ZERO));
        assert_eq!(cuts(&flight(&closer)), [0, 11]);
        let turned = [(0.0, a, DVec3::ZERO), (1.0, a, DVec3::ZERO), (1.1, a, b * 5.0), (2.0, a, b * 5.0)];
        assert_eq!(cuts(&flight(&turned)), [0, 11]);
    }

    #[test]
    fn steady_flights_have_none_however_fast() {
        let key = |i: i32| (i as f64 * 0.1, DVec3::new(i as f64 * 8.0, 0.0, 9.0), DVec3::new(i as f64 * 8.0, 0.0, 0.0));
        let keys: Vec<_> = (0..9).map(key).collect();
        assert_eq!(cuts(&flight(&keys)), [0]);
        let around = crate::flypath::default_flight(DVec3::ZERO, 1.0, DVec3::Y, 50.0);
        assert_eq!(cuts(&around), [0]);
    }
}
