//! The first collapses of every cluster, right after it was set up.
//!
//! More than half of all vertices die on the way to the first level, at costs far below what anybody sees. That happens to
//! one cluster after the other while it is in the processor's cache, and only what is left of it is kept: a mesh never lies
//! in memory as patches with all its vertices. How far the clusters go is found by rounds over a few of them.

use super::build::patch_input;
use super::compact::Forest;
use super::patch::Patch;
use super::{Search, UnisonInput, WATCHED_COUNT, lock};
use crate::numbering::Numbering;
use glam::IVec3;
use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Clusters that the limit is found with, at least; every so many-th.
const SAMPLED: usize = 8;
/// The limit leaves this share of what is to die at the first level: the borders, which wait meanwhile, are to take part.
const LEFT: f64 = 0.07;
/// Rounds over the sampled clusters at most.
const MAX_ROUNDS: usize = 16;
/// The sampled clusters are ahead far enough within this factor.
const TOLERANCE: f64 = 1.05;

/// Sets up all clusters, and collapses their insides under one limit, which `search` has afterwards. No cluster goes below the
/// first level's share of what moves in it, so all of them together stay above that level wherever the samples mislead.
/// Also returns how many positions died.
pub(super) fn patches(
    input: &UnisonInput,
    search: &mut Search,
    forest: &Forest,
    ratio: f64,
    progress: &(dyn Fn(f32) + Sync),
) -> (Vec<Mutex<Patch>>, usize) {
    let count = input.segmentation.len();
    let (area, built) = (mean_area(input), AtomicUsize::new(0));
    let numbering = || Numbering::new(input.positions.len());
    let set_up = |numbering: &mut Numbering, c: usize| {
        progress((built.fetch_add(1, Ordering::Relaxed) + 1) as f32 / count as f32);
        let watchful = input.positions.len() <= WATCHED_COUNT;
        Patch::new(patch_input(input, numbering, area, c as u32), watchful)
    };
    let step = (count / SAMPLED).max(1);
    let samples: Vec<usize> = (0..count).step_by(step).collect();
    let samples: Vec<Mutex<Patch>> =
        samples.into_par_iter().map_init(numbering, |n, c| Mutex::new(set_up(n, c))).collect();
    let died = AtomicUsize::new(find_limit(&samples, search, ratio));
    samples.par_iter().for_each(|p| {
        lock(p).hand_over(forest, 0);
    });
    let others: Vec<usize> = (0..count).filter(|c| c % step > 0).collect();
    let mut others = others
        .into_par_iter()
        .map_init(numbering, |n, c| {
            let mut patch = set_up(n, c);
            died.fetch_add(run_ahead(&mut patch, search, ratio), Ordering::Relaxed);
            patch.hand_over(forest, 0);
            Mutex::new(patch)
        })
        .collect::<Vec<Mutex<Patch>>>()
        .into_iter();
    let with_others = |sample| std::iter::once(sample).chain(others.by_ref().take(step - 1)).collect::<Vec<_>>();
    (samples.into_iter().flat_map(with_others).collect(), died.into_inner())
}

/// Raises the limit until the sampled clusters are ahead; returns how many of their positions died.
fn find_limit(samples: &[Mutex<Patch>], search: &mut Search, ratio: f64) -> usize {
    let count = |of: fn(&Patch) -> usize| samples.iter().map(|p| of(&lock(p))).sum::<usize>() as f64;
    let (all, movable) = (count(Patch::alive), count(Patch::movable));
    let target = all - movable * (1.0 - 1.0 / ratio) * (1.0 - LEFT);
    search.begin(samples, (movable / ratio) as usize);
    search.start_level(0, ratio, all);
    let (mut died, mut useful) = (0, search.limit);
    for round in 0..MAX_ROUNDS {
        let alive = all - died as f64;
        if alive <= target * TOLERANCE || search.exhausted() {
            break;
        }
        if round > 0 {
            search.advance(samples, alive, target);
        }
        let more: usize = samples.par_iter().map(|p| run_ahead(&mut lock(p), search, ratio)).sum();
        died += more;
        search.record(all - died as f64);
        if more == 0 {
            // Higher limits are no use, and would only let others go too far.
            search.limit = useful;
            break;
        }
        useful = search.limit;
    }
    died
}

/// Collapses inside a cluster, and lets its small components vanish; returns how many vertices died.
fn run_ahead(patch: &mut Patch, search: &Search, ratio: f64) -> usize {
    let floor = patch.size() - (patch.movable() as f64 * (1.0 - 1.0 / ratio)) as usize;
    let quota = (patch.alive() - patch.point_count()).saturating_sub(floor);
    let collapsed = patch.collapse_interior(search.collapse_limit(), quota);
    collapsed + patch.vanish(search.limit, quota - collapsed)
}

/// Mean area of the triangles around a position, doubled: what its quadric starts with. At least one quantum.
fn mean_area(input: &UnisonInput) -> f32 {
    const BLOCK: usize = 1 << 14;
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| IVec3::from_array(input.positions[v as usize]).as_dvec3());
        (b - a).cross(c - a).length()
    };
    let blocks: Vec<f64> = input.triangles.par_chunks(BLOCK).map(|b| b.iter().map(area).sum()).collect();
    (blocks.iter().sum::<f64>() * 3.0 / input.positions.len() as f64).max(1.0) as f32
}
