//! Views that suit a model: made from its surface alone, so the same for everyone who draws it.

use anyhow::{Result, ensure};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::PathBuf;

use crate::random::Random;
use crate::reference::camera::{Camera, Flypath, Keyframe};
use crate::reference::parse_size;
use crate::reference::scene::Scene;

/// Vertical field of view, degrees.
const FOV_DEG: f64 = 40.0;
/// Views of each kind of stills.
pub const STILLS: usize = 4;
/// What a close-up shows is this much of what a near view shows.
const CLOSE_SHARE: f64 = 0.25;
/// Height of the model in a far view, over the picture's.
const FAR_SHARE: f64 = 0.25;
/// Distance from frame to frame of a slow flight, over the one before.
const SLOW_STEP: f64 = 0.998;

/// Kinds of flypaths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// The model fills the picture.
    Near,
    /// A quarter of that, at a place on the surface.
    Close,
    /// The model is a quarter of the picture high.
    Far,
    /// From far to close, each frame 0.2 % nearer.
    Slow,
}

#[derive(clap::Args)]
pub struct Arguments {
    /// The source: .obj, .gltf, .glb or .ply.
    model: PathBuf,
    kind: Kind,
    out: PathBuf,
    /// Pixels of the pictures: their shape says what fills them.
    #[arg(long, default_value = "640x360", value_parser = parse_size)]
    size: [usize; 2],
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Writes what the command line asks for.
pub fn run(arguments: &Arguments) -> Result<Value> {
    let flight = flight(&Scene::read(&arguments.model)?, arguments.kind, arguments.size, arguments.seed)?;
    flight.write(&arguments.out)?;
    Ok(json!({ "frames": flight.frames() }))
}

/// A flypath for a model; the same for the same seed.
pub fn flight(scene: &Scene, kind: Kind, size: [usize; 2], seed: u64) -> Result<Flypath> {
    ensure!(!scene.triangles.is_empty(), "a model without triangles cannot be looked at");
    let mut random = Random::new(seed);
    let directions = (0..STILLS).map(direction);
    Ok(match kind {
        Kind::Near => Flypath::stills(FOV_DEG, directions.map(|d| around(scene, d, fit(scene, d, size)))),
        Kind::Far => Flypath::stills(FOV_DEG, directions.map(|d| around(scene, d, fit(scene, d, size) / FAR_SHARE))),
        Kind::Close => Flypath::stills(FOV_DEG, directions.map(|d| close(scene, d, size, &mut random))),
        Kind::Slow => slow(scene, size, &mut random),
    })
}

/// From all sides, from above and below.
fn direction(i: usize) -> DVec3 {
    let (angle, height) = (0.6 + 1.7 * i as f64, [0.4, -0.3, 0.8, 0.1][i % 4]);
    DVec3::new(angle.cos(), height, angle.sin()).normalize()
}

fn center(scene: &Scene) -> DVec3 {
    let (low, high) = scene.bounds();
    low.midpoint(high)
}

fn around(scene: &Scene, direction: DVec3, distance: f64) -> (DVec3, DVec3, DVec3) {
    (center(scene) + direction * distance, center(scene), DVec3::Y)
}

/// Distance from which the bounding box just fills the picture.
fn fit(scene: &Scene, direction: DVec3, size: [usize; 2]) -> f64 {
    let (low, high) = scene.bounds();
    let radius = (high - low).length() / 2.0;
    let corner = |i: u32| DVec3::from_array(std::array::from_fn(|k| if i >> k & 1 == 1 { high[k] } else { low[k] }));
    let fills = |distance: f64| {
        let (eye, target, up) = around(scene, direction, distance);
        let camera = Camera::new(eye, target, up, FOV_DEG, size);
        (0..8).any(|i| {
            let p = camera.project(corner(i));
            p.z <= 0.0 || p.x.abs() > p.z || p.y.abs() > p.z
        })
    };
    let (mut near, mut far) = (0.0f64, radius * 20.0);
    for _ in 0..60 {
        let middle = near.midpoint(far);
        (near, far) = if fills(middle) { (middle, far) } else { (near, middle) };
    }
    far
}

/// Where a ray from outside first meets the surface.
fn first_hit(scene: &Scene, eye: DVec3, ray: DVec3) -> Option<DVec3> {
    let depth = |t: &crate::reference::scene::Triangle| {
        let [a, b, c] = scene.corners(t).map(|p| p - eye);
        let w = [b.cross(c), c.cross(a), a.cross(b)].map(|n| n.dot(ray));
        let hit = w.iter().all(|w| *w > 0.0) || w.iter().all(|w| *w < 0.0);
        let depth = a.dot(b.cross(c)) / (w[0] + w[1] + w[2]);
        (hit && depth > 0.0).then_some(depth)
    };
    scene.triangles.iter().filter_map(depth).min_by(f64::total_cmp).map(|d| eye + ray * d)
}

/// Somewhere on the surface that the near view shows.
fn close(scene: &Scene, direction: DVec3, size: [usize; 2], random: &mut Random) -> (DVec3, DVec3, DVec3) {
    let distance = fit(scene, direction, size);
    let (eye, target, up) = around(scene, direction, distance);
    let camera = Camera::new(eye, target, up, FOV_DEG, size);
    let mut place = || {
        let [x, y] = [random.unit(), random.unit()].map(|u| u * 1.2 - 0.6);
        first_hit(scene, eye, camera.ray(x, y).normalize())
    };
    let target = (0..32).find_map(|_| place()).unwrap_or(target);
    (target + direction * distance * CLOSE_SHARE, target, up)
}

fn slow(scene: &Scene, size: [usize; 2], random: &mut Random) -> Flypath {
    let (eye, target, up) = close(scene, direction(0), size, random);
    let away = eye - target;
    let steps_per_key = 20;
    let keys = ((1.0 / FAR_SHARE / CLOSE_SHARE).ln() / -SLOW_STEP.ln() / f64::from(steps_per_key)).ceil() as i32;
    let key = |i: i32| Keyframe {
        t: f64::from(i * steps_per_key) / 60.0,
        eye: target + away * SLOW_STEP.powi((i - keys) * steps_per_key),
        target,
        up,
        fov_deg: None,
    };
    Flypath::new(60.0, FOV_DEG, (0..=keys).map(key).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Kind as Shape, generate};
    use crate::reference::{Filter, Options, draw};

    #[test]
    fn near_views_are_filled_and_far_ones_show_a_quarter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sphere.ply");
        generate(Shape::Sphere, 2_000, 1).write(&path).unwrap();
        let scene = Scene::read(&path).unwrap();
        let size = [96, 54];
        let rows = |kind| {
            let camera = flight(&scene, kind, size, 1).unwrap().camera(0, size);
            let picture = draw(&scene, &camera, &Options { size, filter: Filter::Exact, grid: Some(1) });
            picture.coverage.chunks(size[0]).filter(|row| row.iter().any(|c| *c > 0)).count()
        };
        let (near, far, close) = (rows(Kind::Near), rows(Kind::Far), rows(Kind::Close));
        assert!((30..54).contains(&near), "{near}");
        assert!((7..14).contains(&far), "{far}");
        assert!(close > near, "{close}");
    }

    #[test]
    fn a_slow_flight_comes_nearer_by_a_little_in_every_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sphere.ply");
        generate(Shape::Sphere, 500, 1).write(&path).unwrap();
        let flight = flight(&Scene::read(&path).unwrap(), Kind::Slow, [96, 54], 1).unwrap();
        let target = flight.keyframes[0].target;
        let distance: Vec<f64> =
            (0..flight.frames()).map(|f| (flight.camera(f, [96, 54]).eye - target).length()).collect();
        assert!(distance.windows(2).all(|d| (0.99..1.0).contains(&(d[1] / d[0]))));
        assert!(distance[0] / distance[distance.len() - 1] > 15.0);
    }
}
