//! The flypath of a colonnade: a walk at eye height between the pillars, from aisle to aisle, then away from it all.
//! No cut; a function of the size of the scene alone.

use anyhow::{Result, ensure};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};
use std::f64::consts::{PI, TAU};
use std::path::PathBuf;

use super::stone::ramp;
use super::{BAY, Layout, check_triangles};
use crate::random::Random;
use crate::reference::camera::{Flypath, Keyframe};

/// Of the flypath that is written beside a scene.
pub const SECONDS: f64 = 60.0;
pub const FPS: f64 = 30.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// Eyes above the paving, m.
const EYE: f64 = 1.7;
/// Share of the time that is spent on the way through, and until the look is back at the scene.
const THROUGH: f64 = 0.78;
const TURNED: f64 = 0.90;
/// Half of the part of the way that says where eyes look.
const GLANCE: f64 = 0.09;
/// How long a still stands.
const STILL_SECONDS: f64 = 2.0;
/// Keyframes of a flight.
const KEYS: u32 = 180;

#[derive(clap::Args)]
pub struct FlightArguments {
    out: PathBuf,
    /// Of the scene, as it was made.
    #[arg(long, default_value_t = 1_000_000)]
    triangles: u64,
    /// How long it takes.
    #[arg(long, default_value_t = SECONDS)]
    seconds: f64,
    /// Frames per second.
    #[arg(long, default_value_t = FPS)]
    fps: f64,
    /// Instead of a walk so many stills of two seconds from places along it, in random directions, with cuts between them.
    #[arg(long)]
    cuts: Option<u32>,
    /// Of the stills.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Writes what the command line asks for.
pub fn run(arguments: &FlightArguments) -> Result<Value> {
    let FlightArguments { out, triangles, seconds, fps, cuts, seed } = arguments;
    check_triangles(*triangles)?;
    ensure!((1.0..=86_400.0).contains(seconds), "--seconds must be 1 to 86400");
    ensure!((1.0..=1000.0).contains(fps), "--fps must be 1 to 1000");
    let layout = Layout::new(*triangles);
    let flight = match cuts {
        Some(cuts) => stills(&layout, (*cuts).clamp(1, 10_000), *fps, *seed),
        None => flight(&layout, *seconds, *fps),
    };
    flight.write(out)?;
    Ok(json!({ "frames": flight.frames() }))
}

/// The flypath.
pub fn flight(layout: &Layout, seconds: f64, fps: f64) -> Flypath {
    let way = way(layout);
    let key = |k: u32| {
        let share = f64::from(k) / f64::from(KEYS);
        let (eye, target) = look(&way, layout, share);
        Keyframe { t: share * seconds, eye, target, up: DVec3::Y, fov_deg: None }
    };
    Flypath::new(fps, FOV_DEG, (0..=KEYS).map(key).collect())
}

/// Stills from random places of the walk in random directions, with cuts between them.
pub fn stills(layout: &Layout, cuts: u32, fps: f64, seed: u64) -> Flypath {
    let way = way(layout);
    let mut random = Random::new(seed);
    let mut still = |k: u32| {
        let (eye, _) = look(&way, layout, THROUGH * random.unit());
        let (yaw, pitch) = (TAU * random.unit(), -0.2 + 0.7 * random.unit());
        let target = eye + 5.0 * DVec3::new(yaw.cos() * pitch.cos(), pitch.sin(), yaw.sin() * pitch.cos());
        let start = f64::from(k) * STILL_SECONDS;
        // Pairs, so that the curve swings within a millisecond only.
        [0.0, 1e-3, STILL_SECONDS - 2e-3, STILL_SECONDS - 1e-3].map(|t| Keyframe {
            t: start + t,
            eye,
            target,
            up: DVec3::Y,
            fov_deg: None,
        })
    };
    Flypath::new(fps, FOV_DEG, (0..cuts).flat_map(&mut still).collect())
}

/// Places that the walk goes through, at ground level: down the middle aisle, and again and again between two
/// pillars into the next aisle and back.
fn way(layout: &Layout) -> Vec<DVec2> {
    let [length, width] = layout.paved();
    let aisle = width / 2.0;
    let lane = |bay: u32| aisle + BAY[1] * [0.0, 0.0, 0.5, 1.0, 1.0, 0.5][bay as usize % 6];
    let mut way = vec![DVec2::new(-9.0, aisle - 1.5), DVec2::new(-3.0, aisle)];
    way.extend((0..layout.columns).map(|bay| DVec2::new(f64::from(bay) * BAY[0], lane(bay))));
    let end = lane(layout.columns.saturating_sub(1)).clamp(aisle, aisle + BAY[1]);
    let side = if end < aisle + BAY[1] / 2.0 { aisle } else { aisle + BAY[1] };
    way.extend([0.0, 4.0, 8.0].map(|x| DVec2::new(length + x, side)));
    way
}

/// A smooth curve through places, at a share of their number.
fn along(way: &[DVec2], share: f64) -> DVec2 {
    let last = way.len() - 1;
    let at = (share.clamp(0.0, 1.0) * last as f64).min(last as f64 - 1e-9);
    let (i, t) = (at.floor() as usize, at.fract());
    let [a, b, c, d] = [i.saturating_sub(1), i, i + 1, (i + 2).min(last)].map(|k| way[k]);
    0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t + (3.0 * b - a - 3.0 * c + d) * t.powi(3))
}

/// Eye and target at a share of the time.
fn look(way: &[DVec2], layout: &Layout, share: f64) -> (DVec3, DVec3) {
    let walked = (share / THROUGH).min(1.0);
    // Eyes follow the way as a whole rather than its every turn.
    let [here, ahead, behind] = [0.0, GLANCE, -GLANCE].map(|by| along(way, walked + by));
    let away = ((share - THROUGH) / (1.0 - THROUGH)).max(0.0);
    // Backwards, up, and a little to the side.
    let retreat = DVec3::new(22.0 * away.powf(1.6) + 3.0 * away, 13.0 * away.powf(1.3), -7.0 * away * away);
    let eye = DVec3::new(here.x, EYE, here.y) + retreat;
    let heading = (ahead - behind).normalize_or(DVec2::X);
    let sway = 0.42 * (share * 9.0 * TAU).sin() * ramp(0.0, 0.1, share) * ramp(THROUGH, THROUGH - 0.08, share);
    let turn = PI * ramp(THROUGH - 0.04, TURNED, share);
    let yaw = heading.y.atan2(heading.x) + sway + turn;
    let walking = 0.10 + 0.16 * (share * 5.0 * TAU).sin();
    let back = (layout.paved()[0] / 2.0 - eye.x).hypot(1.0);
    let pitch = walking + ((1.0 - eye.y) / back - walking) * ramp(THROUGH - 0.04, TURNED, share);
    (eye, eye + 5.0 * DVec3::new(yaw.cos() * pitch.cos(), pitch.sin(), yaw.sin() * pitch.cos()))
}
