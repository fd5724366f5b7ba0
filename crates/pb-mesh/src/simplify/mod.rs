//! Simplification in unison: all clusters of a mesh at once, level by level (design I2).
//!
//! Rounds of rising cost limits. In a round every cluster collapses its inside on its own, in parallel;
//! then the borders move, in groups of borders that share no cluster. The limit is the same everywhere, so
//! detail goes where it costs least in the whole model; the result does not depend on the number of threads.
//! Sander and Mitchell 2005, section 5.4, with one global limit instead of passes per cluster.

mod border;
mod build;
mod charts;
mod compact;
mod corner_lists;
mod fan;
mod head_start;
mod legal;
mod patch;
mod quadric;
mod queue;
mod slide;
mod stretch;
mod tries;
mod vanish;
mod weights;

pub use charts::UvInput;

use crate::segment::Segmentation;
use crate::topology::{Fans, Kind};
use border::Seam;
use build::{build_seams, group_seams};
use compact::Forest;
use glam::Vec3;
use patch::Patch;
use rayon::prelude::*;
use std::sync::Mutex;
use tries::Tries;
use weights::{COARSE_LEVEL, Weights};

/// A level is reached when the vertex count is within this factor of its target.
const TARGET_TOLERANCE: f64 = 1.01;
/// Rounds per level; reached only by meshes that cannot be simplified that far.
const MAX_ROUNDS: usize = 64;
/// Share of the remaining way (in log counts) that one round aims for while far from the target.
const FAR_STEP: f64 = 0.75;
/// Below this many vertices single collapses matter: the limit rises in small steps to the end.
const SMALL_COUNT: f64 = 4096.0;
/// The same share there.
const SMALL_STEP: f64 = 0.4;
/// Factor by which the limit rises at least, and there.
const MIN_FACTORS: [f64; 2] = [1.01, 1.002];
/// And at most.
const MAX_FACTOR: f64 = 6.0;
/// Lowest limit to start with, in squared diagonals.
const FIRST_LIMIT: f32 = 1e-14;
/// Where a rise of the limit by this factor leaves more than this share of the vertices, a level ends: the shape does not
/// allow less, and higher limits would only cost quality.
const STALL_RISE: f32 = 4.0;
const STALL_SHARE: f64 = 0.97;
/// How much faster than the squared ratio a level's cost limit may rise above the one before.
const MAX_RISE: f64 = 2.0;
/// Costs change by at most this factor as they are weighed anew: where they were nothing before, that says nothing.
const MAX_RESCALE: f32 = 10.0;
/// Error that every level may reach, in diagonals. Where components vanish later levels may reach `ratio` times more each:
/// scenes of loose parts have nothing else to give.
const FREE_ERROR: f64 = 2e-2;
/// Witnesses are asked from the second level on: towards the first most vertices go and errors are small, so that they cost more
/// than they tell. Models of up to so many positions can afford them from the start.
const WATCHED_COUNT: usize = 1 << 17;
/// Collapses that a rank among all of them is estimated from.
const RANK_SAMPLES: usize = 1 << 16;
/// Share of the time that goes by until every cluster had its head start, for progress displays; and what is left of the first
/// level then, in terms of the second.
const HEAD_START_SHARE: f64 = 0.6;
const FIRST_LEVEL: f64 = 0.6;

/// The mesh to simplify. Positions are grid points; the cost unit is the squared grid quantum.
pub struct UnisonInput<'a> {
    /// Grid points.
    pub positions: &'a [[i32; 3]],
    /// Unit normals per position, zero where there is none.
    pub normals: &'a [Vec3],
    /// Position indices.
    pub triangles: &'a [[u32; 3]],
    /// Clusters.
    pub segmentation: &'a Segmentation,
    /// Cluster of each triangle.
    pub cluster_of: &'a [u32],
    /// Triangles around positions.
    pub fans: &'a Fans,
    /// What each position may do.
    pub kinds: &'a [Kind],
    /// Texture coordinates, if there are any.
    pub texture: Option<UvInput<'a>>,
}

/// The collapses, as one forest over the positions.
#[derive(Clone, Debug)]
pub struct Collapses {
    /// What each position collapsed onto; itself for survivors.
    pub parent: Vec<u32>,
    /// Last level at which each position lives, `levels - 1` for survivors.
    pub last_level: Vec<u8>,
    /// Positions alive per level.
    pub counts: Vec<usize>,
    /// The UV wedge that each UV wedge becomes when its position collapses: one of the same cluster at the parent
    /// position, and of the same chart as long as triangles use it. Itself for survivors and for wedges that no triangle
    /// of the input uses; empty without textures.
    pub wedge_parent: Vec<u32>,
    /// Last level of each UV wedge: its position's.
    pub wedge_last_level: Vec<u8>,
}

impl Collapses {
    /// The position that stands for `v` at `level`: its closest ancestor that lives there.
    pub fn ancestor(&self, mut v: u32, level: u8) -> u32 {
        while self.last_level[v as usize] < level {
            v = self.parent[v as usize];
        }
        v
    }

    /// The UV wedge that stands for `w` at `level`.
    pub fn wedge_ancestor(&self, mut w: u32, level: u8) -> u32 {
        while self.wedge_last_level[w as usize] < level && self.wedge_parent[w as usize] != w {
            w = self.wedge_parent[w as usize];
        }
        w
    }
}

/// Simplifies to `levels` levels, each with `1 / ratio` of the positions of the one before.
pub fn simplify(input: &UnisonInput, levels: usize, ratio: f64, progress: &(dyn Fn(f32) + Sync)) -> Collapses {
    let forest = Forest::new(input.positions.len(), (levels - 1) as u8);
    let mut counts = vec![input.positions.len()];
    if levels == 1 {
        return collect(&[], input, forest, counts);
    }
    let mut search = Search::new(input.positions);
    let early = |share| progress(share * HEAD_START_SHARE as f32);
    let (patches, died) = head_start::patches(input, &mut search, &forest, ratio, &early);
    let seams = group_seams(build_seams(input, &patches));
    let steps = Steps { positions: input.positions.len(), ratio, count: levels - 1 };
    let mut tries = Tries::new(input, steps);
    let mut state = State { patches, seams, search, alive: input.positions.len() - died };
    for level in 0..levels - 1 {
        let target = steps.target(level);
        state.start_level(level, ratio);
        let report = |way| progress(share_done(levels - 1, ratio, level, way));
        if level == COARSE_LEVEL {
            state.reweigh(Weights::COARSE, target);
        }
        if level == 0 || !tries.run_level(&mut state, level) {
            state.run_level(target, level > 0, &report);
        }
        report(1.0);
        hand_over(&state.patches, &mut state.seams, &forest, level as u8);
        tries.end_level(&state, &forest, level as u8 + 1);
        counts.push(state.alive + state.patches.iter().map(|p| lock(p).point_count()).sum::<usize>());
    }
    collect(&state.patches, input, forest, counts)
}

/// The ways between levels: step `i` goes from level `i` to the next coarser one.
#[derive(Clone, Copy)]
struct Steps {
    /// Of the input.
    positions: usize,
    ratio: f64,
    count: usize,
}

impl Steps {
    /// How many positions a step is to leave.
    fn target(&self, step: usize) -> f64 {
        self.positions as f64 / self.ratio.powi(step as i32 + 1)
    }
}

impl Clone for State {
    fn clone(&self) -> Self {
        let (seams, search) = (self.seams.clone(), self.search.clone());
        let patches = self.patches.iter().map(|p| Mutex::new(lock(p).clone())).collect();
        State { patches, seams, search, alive: self.alive }
    }
}

/// A mesh in the middle of its simplification.
struct State {
    patches: Vec<Mutex<Patch>>,
    /// In groups that share no cluster.
    seams: Vec<Vec<Seam>>,
    search: Search,
    /// Positions that live, but for points that vanished components leave.
    alive: usize,
}

impl State {
    /// Gets ready for the collapses of a level.
    fn start_level(&mut self, level: usize, ratio: f64) {
        if level > 0 {
            self.patches.par_iter().for_each(|p| {
                let mut p = lock(p);
                p.bury_points();
                p.watchful = true;
            });
        }
        self.search.start_level(level, ratio, self.alive as f64);
    }

    /// Goes on with other weights. The limits stay where they are in terms of the costs that the way to `target` begins with.
    fn reweigh(&mut self, weights: Weights, target: f64) {
        let rank = (self.alive as f64 - target) as usize / 2;
        let before = cost_of_rank(&self.patches, rank);
        self.patches.par_iter().for_each(|p| lock(p).reweigh(weights));
        self.seams.iter_mut().flatten().for_each(Seam::reweigh);
        if let (Some(before), Some(after)) = (before.filter(|b| *b > 0.0), cost_of_rank(&self.patches, rank)) {
            self.search.rescale((after / before).clamp(1.0 / MAX_RESCALE, MAX_RESCALE));
        }
    }

    /// Rounds until so many positions are left, or the shape allows no less. `raise` says that the limit is to rise before the first
    /// one; `report` gets the share of the way that is behind.
    fn run_level(&mut self, target: f64, raise: bool, report: &dyn Fn(f64)) {
        for round in 0..MAX_ROUNDS {
            let count = self.alive as f64;
            let small = count < SMALL_COUNT;
            let enough = if small { target.round() } else { target * TARGET_TOLERANCE };
            if count <= enough || self.search.exhausted() {
                break;
            }
            if round > 0 || raise {
                self.search.advance(&self.patches, count, target);
            }
            let quota = if small { self.alive - target.round() as usize } else { usize::MAX };
            self.alive -= run_round(&self.patches, &mut self.seams, &self.search, target / count, quota);
            self.search.record(self.alive as f64);
            report(((self.search.start / self.alive as f64).ln() / (self.search.start / target).ln()).clamp(0.0, 1.0));
        }
    }
}

/// Share of the time that has gone by when so much of the way to a level is behind: each takes half as long as the one before
/// where it has a quarter of its vertices.
fn share_done(steps: usize, ratio: f64, step: usize, way: f64) -> f32 {
    let weight = |step: usize| if step == 0 { FIRST_LEVEL } else { ratio.powf((1.0 - step as f64) / 2.0) };
    let before: f64 = (0..step).map(weight).sum();
    let all: f64 = (0..steps).map(weight).sum();
    (HEAD_START_SHARE + (1.0 - HEAD_START_SHARE) * (before + way * weight(step)) / all) as f32
}

fn lock(p: &Mutex<Patch>) -> std::sync::MutexGuard<'_, Patch> {
    p.lock().expect("no thread panics while it holds a patch")
}

/// One round under the limits of the search; returns how many positions died. Where there is a quota, the patches take from
/// it one after the other; only a part that vanishes as a whole may exceed it.
fn run_round(patches: &[Mutex<Patch>], seams: &mut [Vec<Seam>], search: &Search, keep: f64, quota: usize) -> usize {
    let limit = search.collapse_limit();
    let inside = |p: &Mutex<Patch>, quota: usize| {
        let mut p = lock(p);
        let vanishing = ((p.alive() - p.point_count()) as f64 * (1.0 - keep)).ceil().max(0.0) as usize;
        let collapsed = p.collapse_interior(limit, quota);
        collapsed + p.vanish(search.limit, vanishing.min(quota - collapsed))
    };
    let along = |s: &mut Seam, quota: usize| {
        let (mut a, mut b) = (lock(&patches[s.clusters[0] as usize]), lock(&patches[s.clusters[1] as usize]));
        s.collapse(&mut a, &mut b, limit, quota)
    };
    if quota == usize::MAX {
        let inside: usize = patches.par_iter().map(|p| inside(p, quota)).sum();
        let along = |group: &mut Vec<Seam>| group.par_iter_mut().map(|s| along(s, quota)).sum::<usize>();
        return inside + seams.iter_mut().map(along).sum::<usize>();
    }
    let mut died = 0;
    patches.iter().for_each(|p| died += inside(p, quota.saturating_sub(died)));
    seams.iter_mut().flatten().for_each(|s| died += along(s, quota.saturating_sub(died)));
    died
}

/// The cost limit of the rounds, steered so that counts come down on their targets from above.
#[derive(Clone)]
struct Search {
    limit: f32,
    /// Limit of this level: a mesh whose shape does not allow the target keeps more vertices instead of its worst. Of
    /// collapses, and of components that vanish.
    ends: [f32; 2],
    /// Squared diagonal of the model.
    diagonal: f32,
    last: Option<(f64, f64)>,
    slope: f64,
    /// Did the last round leave all as it was?
    idle: bool,
    /// Count at the start of the level.
    start: f64,
    /// Limit and count where it was last seen that raising the limit helps; `true` when it no longer does.
    progress: (f32, f64),
    stalled: bool,
}

impl Search {
    fn new(positions: &[[i32; 3]]) -> Self {
        let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
        for p in positions {
            for k in 0..3 {
                lo[k] = lo[k].min(p[k]);
                hi[k] = hi[k].max(p[k]);
            }
        }
        let diagonal: f32 = (0..3).map(|k| (hi[k] as f32 - lo[k] as f32).powi(2)).sum();
        Search {
            limit: (diagonal * FIRST_LIMIT).max(f32::MIN_POSITIVE),
            ends: [diagonal; 2],
            diagonal,
            last: None,
            slope: -0.5,
            idle: false,
            start: 0.0,
            progress: (0.0, f64::INFINITY),
            stalled: false,
        }
    }

    /// Starts at the cost that `rank` collapses stay below.
    fn begin(&mut self, patches: &[Mutex<Patch>], rank: usize) {
        self.limit = cost_of_rank(patches, rank).unwrap_or(0.0).max(self.limit);
    }

    /// Sets how far the limit may rise at a level. On smooth surfaces it rises by the squared ratio.
    fn start_level(&mut self, level: usize, ratio: f64, count: f64) {
        let natural = match level {
            0 => 0.0,
            _ if self.stalled || self.limit >= self.ends[0] => f64::from(self.limit),
            _ => f64::from(self.limit) * ratio * ratio * MAX_RISE,
        };
        let end = |free: f64| (natural.max(f64::from(self.diagonal) * free * free) as f32).min(self.diagonal);
        self.ends = [end(FREE_ERROR), end(FREE_ERROR * ratio.powi(level as i32))];
        (self.start, self.progress, self.stalled) = (count, (self.limit, f64::INFINITY), false);
        if level == 0 {
            (self.last, self.idle) = (None, false);
        }
    }

    fn exhausted(&self) -> bool {
        self.stalled || self.limit >= self.ends[1]
    }

    /// Costs are weighed anew, and come to so many times what they were.
    fn rescale(&mut self, factor: f32) {
        self.limit *= factor;
        self.progress.0 *= factor;
        self.ends = self.ends.map(|e| (e * factor).min(self.diagonal));
    }

    /// What collapses may cost now.
    fn collapse_limit(&self) -> f32 {
        self.limit.min(self.ends[0])
    }

    fn record(&mut self, count: f64) {
        let now = (f64::from(self.limit).ln(), count.ln());
        self.idle = self.last.is_some_and(|l| l.1 == now.1);
        if let Some(last) = self.last.filter(|l| now.0 - l.0 > 1e-3) {
            self.slope = ((now.1 - last.1) / (now.0 - last.0)).clamp(-2.0, -0.1);
        }
        self.last = Some(now);
        if count < self.start && self.limit >= self.progress.0 * STALL_RISE {
            self.stalled = count > self.progress.1 * STALL_SHARE;
            self.progress = (self.limit, count);
        }
    }

    /// Raises the limit by what the last rounds' slope says is needed, but no further than to where as many
    /// collapses are queued as positions are to die: collapses rarely make others cheaper.
    fn advance(&mut self, patches: &[Mutex<Patch>], count: f64, target: f64) {
        let gap = (target / count).ln();
        let aim = match gap {
            _ if count < SMALL_COUNT => gap * SMALL_STEP,
            far if far < -0.1 => far * FAR_STEP,
            near => near,
        };
        let least = MIN_FACTORS[usize::from(count < SMALL_COUNT)];
        let factor = match self.idle {
            true => MAX_FACTOR,
            false => (aim / self.slope).exp().clamp(least, MAX_FACTOR),
        } as f32;
        let queued = cost_of_rank(patches, (count - target) as usize).unwrap_or(f32::INFINITY);
        self.limit = (self.limit * factor).min(queued.max(self.limit * least as f32)).min(self.ends[1]);
    }
}

/// The cost that about `rank` queued collapses stay below, estimated from samples; `None` when fewer are queued.
fn cost_of_rank(patches: &[Mutex<Patch>], rank: usize) -> Option<f32> {
    let alive: usize = patches.iter().map(|p| lock(p).alive()).sum();
    let step = (alive / RANK_SAMPLES).max(1);
    let sampled = |p: &Mutex<Patch>| lock(p).queued_costs(step);
    let mut costs: Vec<f32> = patches.par_iter().flat_map_iter(sampled).collect();
    let rank = rank / step;
    (rank < costs.len()).then(|| *costs.select_nth_unstable_by(rank, f32::total_cmp).1)
}

/// Hands the collapses of a level over to the forest; what is left of patches and seams is moved together.
fn hand_over(patches: &[Mutex<Patch>], seams: &mut [Vec<Seam>], forest: &Forest, level: u8) {
    let numbers: Vec<Option<Vec<u32>>> = patches.par_iter().map(|p| lock(p).hand_over(forest, level)).collect();
    seams.par_iter_mut().flatten().for_each(|s| {
        let [a, b] = s.clusters.map(|c| numbers[c as usize].as_deref());
        s.renumber(a, b);
    });
}

fn collect(patches: &[Mutex<Patch>], input: &UnisonInput, forest: Forest, counts: Vec<usize>) -> Collapses {
    let (parent, last_level) = forest.into_inner();
    let position_of = input.texture.as_ref().map_or(&[][..], |t| t.position_of);
    let mut wedge_parent: Vec<u32> = (0..position_of.len() as u32).collect();
    patches.iter().for_each(|p| lock(p).input.charts.iter().for_each(|c| c.hand_over(&mut wedge_parent)));
    let wedge_last_level = position_of.iter().map(|&v| last_level[v as usize]).collect();
    Collapses { parent, last_level, counts, wedge_parent, wedge_last_level }
}
