//! Moving the camera by hand: around the model, or flying.
//!
//! Must never: know of windows or keys; reach a camera whose up vector is along its line of sight.

use glam::{DQuat, DVec3};

use crate::flypath::Keyframe;

/// Radians per pixel of a drag.
const TURN: f64 = 0.006;
/// Factor of the distance per notch of the wheel.
const ZOOM: f64 = 0.88;
/// Cosine of the smallest angle between up and the line of sight.
const MAX_UP_COSINE: f64 = 0.995;
/// Model radii per second of a flight by hand.
const FLY_SPEED: f64 = 0.5;
/// How much faster with the fast key.
const FAST: f64 = 5.0;

/// The model's bounding sphere and which way is up, world space.
#[derive(Clone, Copy, Debug)]
pub struct Subject {
    /// Centre of the sphere.
    pub center: DVec3,
    /// Its radius, more than 0.
    pub radius: f64,
    /// Unit vector.
    pub up: DVec3,
}

/// How the mouse and the keys are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Around the target.
    Orbit,
    /// From the eye.
    Fly,
}

/// Where the keys push while flying, -1 to 1 each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// Along the line of sight.
    pub forward: f64,
    /// To the right of the picture.
    pub right: f64,
    /// Along up.
    pub up: f64,
    /// Faster.
    pub fast: bool,
}

/// The camera in the hand.
#[derive(Clone, Debug)]
pub struct Navigator {
    /// What is looked at.
    pub subject: Subject,
    /// How input is understood.
    pub mode: Mode,
    /// Eye position.
    pub eye: DVec3,
    /// What is looked at; always away from the eye.
    pub target: DVec3,
    /// Vertical field of view, degrees.
    pub fov_deg: f64,
    /// Factor on the flying speed.
    speed: f64,
}

impl Navigator {
    /// A camera that sees the whole subject.
    pub fn new(subject: Subject, fov_deg: f64) -> Self {
        let mut out = Self { subject, mode: Mode::Orbit, eye: DVec3::ZERO, target: DVec3::ZERO, fov_deg, speed: 1.0 };
        let side = subject.up.any_orthonormal_vector();
        out.target = subject.center;
        out.eye = out.target + side * 0.9 + subject.up.cross(side) * 0.4 + subject.up * 0.35;
        out.fit(1.0);
        out
    }

    /// Moves back or forth along the line of sight, target at the centre, until the subject fills a picture that
    /// is `aspect` times as wide as high.
    pub fn fit(&mut self, aspect: f64) {
        let half = (self.fov_deg.to_radians() * 0.5).tan();
        let angle = (half * aspect.min(1.0)).atan();
        let back = (self.eye - self.target).normalize();
        self.target = self.subject.center;
        self.eye = self.target + back * self.subject.radius / angle.sin() * 1.02;
    }

    fn forward(&self) -> DVec3 {
        (self.target - self.eye).normalize()
    }

    fn right(&self) -> DVec3 {
        self.forward().cross(self.subject.up).normalize()
    }

    /// A drag of the turning button by `dx`, `dy` pixels, y down.
    pub fn turn(&mut self, dx: f64, dy: f64) {
        let offset = self.target - self.eye;
        let yaw = DQuat::from_axis_angle(self.subject.up, -dx * TURN);
        let pitch = DQuat::from_axis_angle(self.right(), -dy * TURN);
        let yawed = yaw * offset;
        let both = yaw * (pitch * offset);
        let upright = both.normalize().dot(self.subject.up).abs() < MAX_UP_COSINE;
        let turned = if upright { both } else { yawed };
        match self.mode {
            Mode::Orbit => self.eye = self.target - turned,
            Mode::Fly => self.target = self.eye + turned,
        }
    }

    /// A drag of the panning button by `dx`, `dy` pixels in a picture of `height` pixels: the target stays under
    /// the pointer.
    pub fn pan(&mut self, dx: f64, dy: f64, height: f64) {
        let distance = self.eye.distance(self.target);
        let pixel = 2.0 * (self.fov_deg.to_radians() * 0.5).tan() * distance / height;
        let up = self.right().cross(self.forward());
        let step = (up * dy - self.right() * dx) * pixel;
        self.eye += step;
        self.target += step;
    }

    /// The wheel: nearer or farther, or faster or slower when flying. Positive is away from the user.
    pub fn wheel(&mut self, notches: f64) {
        let factor = ZOOM.powf(notches.clamp(-20.0, 20.0));
        match self.mode {
            Mode::Orbit => {
                let distance = self.eye.distance(self.target) * factor;
                let limited = distance.clamp(self.subject.radius * 1e-5, self.subject.radius * 1e5);
                self.eye = self.target - self.forward() * limited;
            }
            Mode::Fly => self.speed = (self.speed / factor).clamp(1e-4, 1e4),
        }
    }

    /// Moves for `dt` seconds while flying.
    pub fn fly(&mut self, push: Push, dt_secs: f64) {
        if self.mode != Mode::Fly {
            return;
        }
        let direction = self.forward() * push.forward + self.right() * push.right + self.subject.up * push.up;
        let speed = self.subject.radius * FLY_SPEED * self.speed * if push.fast { FAST } else { 1.0 };
        let step = direction * speed * dt_secs;
        self.eye += step;
        self.target += step;
    }

    /// From orbit to flying and back; orbiting goes around what is in the middle of the picture.
    pub fn toggle(&mut self) {
        self.mode = match self.mode {
            Mode::Orbit => Mode::Fly,
            Mode::Fly => {
                let depth = (self.subject.center - self.eye).dot(self.forward());
                self.target = self.eye + self.forward() * depth.max(self.subject.radius * 0.1);
                Mode::Orbit
            }
        };
    }

    /// The camera now, as a keyframe at time `t`.
    pub fn keyframe(&self, t: f64) -> Keyframe {
        Keyframe { t, eye: self.eye, target: self.target, up: self.subject.up, fov_deg: self.fov_deg }
    }

    /// Continues by hand where a flight was.
    pub fn take(&mut self, k: &Keyframe) {
        (self.eye, self.target, self.fov_deg) = (k.eye, k.target, k.fov_deg);
        if self.forward().dot(self.subject.up).abs() >= MAX_UP_COSINE {
            let side = self.subject.up.any_orthonormal_vector() * 0.2 * self.eye.distance(self.target);
            self.eye += side;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn navigator() -> Navigator {
        let subject = Subject { center: DVec3::new(10.0, 0.0, 0.0), radius: 2.0, up: DVec3::Z };
        Navigator::new(subject, 60.0)
    }

    #[test]
    fn the_whole_subject_is_in_a_fitted_picture() {
        let mut n = navigator();
        for aspect in [0.5, 1.0, 2.0] {
            n.fit(aspect);
            let angle = (n.subject.radius / n.eye.distance(n.subject.center)).asin();
            assert!(angle.tan() <= 30f64.to_radians().tan() * aspect.min(1.0));
        }
    }

    #[test]
    fn orbiting_keeps_the_distance_and_never_looks_along_up() {
        let mut n = navigator();
        let distance = n.eye.distance(n.target);
        for (dx, dy) in [(100.0, 0.0), (0.0, 5000.0), (30.0, -300.0), (0.0, -900.0), (0.0, 333.0)] {
            for _ in 0..50 {
                n.turn(dx / 50.0, dy / 50.0);
            }
            assert!((n.eye.distance(n.target) - distance).abs() < 1e-9);
            assert!(n.forward().dot(DVec3::Z).abs() < 0.999);
        }
    }

    #[test]
    fn flying_moves_eye_and_target_together() {
        let mut n = navigator();
        n.toggle();
        let (eye, offset) = (n.eye, n.target - n.eye);
        n.fly(Push { forward: 1.0, ..Push::default() }, 2.0);
        assert!((n.target - n.eye - offset).length() < 1e-12);
        assert!(((n.eye - eye).length() - 2.0).abs() < 1e-9, "half a radius per second, for two seconds");
        n.toggle();
        assert_eq!(n.mode, Mode::Orbit);
    }
}
