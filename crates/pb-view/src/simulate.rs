//! `pb-view simulate`: selection and cache flown through random models on virtual time, without GPU and without clock.
//!
//! Each scene is a random model (or an archive) with random bounds, a random slow disk, chunks that cannot be read and
//! uploads that are refused; each flight ends with a rest. The promises are checked at every command:
//!
//! - safety: no byte over a bound with everything under way counted, nothing freed that is drawn, coarser before finer;
//! - liveness: after a bounded number of frames of rest all that the view wants and can be had is resident;
//! - a run that was recorded is the same when it is replayed.
//!
//! Must never: depend on threads, or on anything but the seed.

mod random;
mod scene;
mod world;

use anyhow::{Context, Result, bail};
use clap::Parser;
use rayon::prelude::*;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::failure::Outcome;
use crate::streaming::open_model;
use random::Random;
use scene::SimScene;
use world::{Tally, World};

/// Scenes between two looks at the clock of the simulation: also how many may run at once.
const SCENES_AT_ONCE: u64 = 16;
/// Flights through one scene.
const FLIGHTS: u32 = 3;
/// One scene of so many is recorded and replayed.
const REPLAY_EVERY: u64 = 8;

/// Fly through random models without a GPU and check that the cache keeps its promises.
#[derive(Parser, Clone, Debug)]
#[command(name = "pb-view simulate")]
pub struct SimulateArgs {
    /// Hours of simulated flying.
    #[arg(long, value_name = "H", default_value_t = 1.0)]
    pub hours: f64,

    /// What all randomness comes from: the same seed, the same flights.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,

    /// Fly through this archive's tables instead of random ones.
    #[arg(long, value_name = "A.pb")]
    pub archive: Option<PathBuf>,

    /// Run the cache once more through a run that pb-view --record-cache wrote, and compare every command.
    #[arg(long, value_name = "R.jsonl", conflicts_with_all = ["hours", "seed", "archive"])]
    pub replay: Option<PathBuf>,
}

/// Simulates, and prints what was flown. A broken promise is an error that names the seed and the place.
pub fn run(args: &SimulateArgs) -> Result<Outcome> {
    if let Some(path) = &args.replay {
        replay(path)?;
        return Ok(Outcome::Done);
    }
    if !(args.hours.is_finite() && args.hours > 0.0) {
        bail!("--hours {}: give a number of hours more than 0", args.hours);
    }
    let start = Instant::now();
    let fixed = args.archive.as_deref().map(open_model).transpose()?.map(|model| SimScene::of(&model));
    let (tally, memory) = simulate(args.seed, args.hours, fixed.as_ref())?;
    println!("{}", tally.report(start.elapsed().as_secs_f64()));
    if let [Some(early), Some(late)] = memory {
        println!("memory of the process: {early} KiB after a tenth of the time, {late} KiB at the end");
    }
    println!("no bound was exceeded, nothing drawn was freed, every view came to rest");
    Ok(Outcome::Done)
}

fn replay(path: &Path) -> Result<()> {
    let file = File::open(path).with_context(|| format!("{}: cannot open it", path.display()))?;
    let done = pb_stream::journal::replay(BufReader::new(file)).with_context(|| path.display().to_string())?;
    println!("{} frames, {} commands: all as recorded", done.frames, done.commands);
    Ok(())
}

/// Flies until `hours` are over; sums, and the process's memory after a tenth of them and at the end, KiB.
fn simulate(seed: u64, hours: f64, fixed: Option<&SimScene>) -> Result<(Tally, [Option<u64>; 2])> {
    let mut tally = Tally::default();
    let (mut scenes, mut early) = (0, None);
    while tally.secs < hours * 3600.0 {
        let some: Vec<Result<Tally>> =
            (scenes..scenes + SCENES_AT_ONCE).into_par_iter().map(|scene| fly_scene(seed, scene, fixed)).collect();
        for one in some {
            tally.add(&one?);
        }
        scenes += SCENES_AT_ONCE;
        if early.is_none() && tally.secs > hours * 360.0 {
            early = resident_kib();
        }
    }
    Ok((tally, [early, resident_kib()]))
}

/// A scene and its flights, from the seed alone.
fn fly_scene(seed: u64, number: u64, fixed: Option<&SimScene>) -> Result<Tally> {
    let mut random = Random::new(seed, number);
    let own;
    let scene = match fixed {
        Some(scene) => scene,
        None => {
            own = SimScene::random(&mut random);
            &own
        }
    };
    let mut world = World::new(scene, &mut random, number.is_multiple_of(REPLAY_EVERY))?;
    for flight in 0..FLIGHTS {
        world.fly(&mut random).with_context(|| format!("seed {seed}, scene {number}, flight {flight}"))?;
    }
    world.finish().with_context(|| format!("seed {seed}, scene {number}"))
}

/// Memory of the process that is resident, where the system tells.
fn resident_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests;
