//! Flypaths and cameras as docs/user-guide.md and the plan of a pinhole camera define them, written a second time.

use anyhow::{Context, Result, ensure};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A flypath file.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Flypath {
    version: u32,
    pub fps: f64,
    pub fov_deg: f64,
    pub keyframes: Vec<Keyframe>,
}

/// Where the camera is at a time.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub struct Keyframe {
    /// Seconds.
    pub t: f64,
    pub eye: DVec3,
    pub target: DVec3,
    pub up: DVec3,
    /// Vertical.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<f64>,
}

/// A pinhole camera: eye, and how far right, up and ahead the ray of a place of the picture goes.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    pub eye: DVec3,
    /// Per unit of x, -1 to 1 from left to right.
    right: DVec3,
    /// Per unit of y, -1 to 1 from bottom to top.
    up: DVec3,
    ahead: DVec3,
    extent: [f64; 2],
}

impl Camera {
    pub fn new(eye: DVec3, target: DVec3, up: DVec3, fov_deg: f64, size: [usize; 2]) -> Camera {
        let ahead = (target - eye).normalize();
        let right = ahead.cross(up).normalize();
        let high = (fov_deg.to_radians() / 2.0).tan();
        let extent = [high * size[0] as f64 / size[1] as f64, high];
        Camera { eye, right, up: right.cross(ahead), ahead, extent }
    }

    /// A point of the world as (x, y, 1) times its depth: x and y are -1 to 1 inside the picture.
    pub fn project(&self, p: DVec3) -> DVec3 {
        let p = p - self.eye;
        DVec3::new(p.dot(self.right) / self.extent[0], p.dot(self.up) / self.extent[1], p.dot(self.ahead))
    }

    /// Direction of the ray through a place of the picture.
    pub fn ray(&self, x: f64, y: f64) -> DVec3 {
        self.ahead + self.right * (x * self.extent[0]) + self.up * (y * self.extent[1])
    }
}

impl Flypath {
    /// One frame per camera, a second apart, so that frames are the cameras themselves.
    pub fn stills(fov_deg: f64, cameras: impl Iterator<Item = (DVec3, DVec3, DVec3)>) -> Flypath {
        let key = |(i, (eye, target, up))| Keyframe { t: i as f64, eye, target, up, fov_deg: None };
        Flypath::new(1.0, fov_deg, cameras.enumerate().map(key).collect())
    }

    pub fn new(fps: f64, fov_deg: f64, keyframes: Vec<Keyframe>) -> Flypath {
        Flypath { version: 1, fps, fov_deg, keyframes }
    }

    pub fn open(path: &Path) -> Result<Flypath> {
        let text = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let flight: Flypath = serde_json::from_slice(&text).with_context(|| path.display().to_string())?;
        ensure!(flight.version == 1 && !flight.keyframes.is_empty(), "{}: no flypath of version 1", path.display());
        Ok(flight)
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        std::fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
    }

    pub fn frames(&self) -> usize {
        let last = self.keyframes[self.keyframes.len() - 1].t;
        ((last - self.keyframes[0].t) * self.fps + 1e-6).floor() as usize + 1
    }

    pub fn camera(&self, frame: usize, size: [usize; 2]) -> Camera {
        let keys = &self.keyframes;
        let t = keys[0].t + frame as f64 / self.fps;
        let fov = |k: &Keyframe| k.fov_deg.unwrap_or(self.fov_deg);
        let after = keys.partition_point(|k| k.t <= t);
        if after == 0 || after == keys.len() {
            let k = &keys[after.saturating_sub(1)];
            return Camera::new(k.eye, k.target, k.up, fov(k), size);
        }
        let (a, b) = (after - 1, after);
        let curve = |value: &dyn Fn(&Keyframe) -> DVec3| {
            let slope = |i: usize| {
                let (p, q) = (&keys[i.saturating_sub(1)], &keys[(i + 1).min(keys.len() - 1)]);
                (value(q) - value(p)) / (q.t - p.t) * (keys[b].t - keys[a].t)
            };
            let s = (t - keys[a].t) / (keys[b].t - keys[a].t);
            let (p, q, m, n) = (value(&keys[a]), value(&keys[b]), slope(a), slope(b));
            p + m * s + (3.0 * (q - p) - 2.0 * m - n) * s * s + (2.0 * (p - q) + m + n) * s * s * s
        };
        let (low, high) = (fov(&keys[a]).min(fov(&keys[b])), fov(&keys[a]).max(fov(&keys[b])));
        let fov_deg = curve(&|k| DVec3::splat(fov(k))).x.clamp(low, high);
        Camera::new(curve(&|k| k.eye), curve(&|k| k.target), curve(&|k| k.up.normalize()), fov_deg, size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_goes_through_its_keyframes_and_is_straight_between_two() {
        let key = |t: f64, x: f64| Keyframe {
            t,
            eye: DVec3::new(x, 0.0, 5.0),
            target: DVec3::new(x, 0.0, 0.0),
            up: DVec3::Y,
            fov_deg: None,
        };
        let two = Flypath { version: 1, fps: 4.0, fov_deg: 50.0, keyframes: vec![key(1.0, 0.0), key(2.0, 8.0)] };
        assert_eq!(two.frames(), 5);
        let x: Vec<f64> = (0..5).map(|f| two.camera(f, [4, 4]).eye.x).collect();
        assert_eq!(x, [0.0, 2.0, 4.0, 6.0, 8.0]);
        let keyframes = vec![key(0.0, 0.0), key(1.0, 1.0), key(2.0, 0.0)];
        let turn = Flypath { version: 1, fps: 2.0, fov_deg: 50.0, keyframes };
        let x: Vec<f64> = (0..5).map(|f| turn.camera(f, [4, 4]).eye.x).collect();
        assert_eq!(x, [0.0, 0.625, 1.0, 0.625, 0.0]);
    }

    #[test]
    fn the_edge_of_the_picture_is_half_the_field_of_view_away() {
        let camera = Camera::new(DVec3::ZERO, -DVec3::Z, DVec3::Y, 90.0, [200, 100]);
        assert!((camera.project(DVec3::new(2.0, 1.0, -1.0)) - DVec3::ONE).length() < 1e-12);
        assert!((camera.ray(1.0, 1.0) - DVec3::new(2.0, 1.0, -1.0)).length() < 1e-12);
    }
}
