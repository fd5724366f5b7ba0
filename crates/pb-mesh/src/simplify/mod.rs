//! Simplification in unison: all clusters of a mesh at once, level by level (design I2).
//!
//! Rounds of rising cost limits. In a round every cluster collapses its inside on its own, in parallel;
//! then the borders move, in groups of borders that share no cluster. The limit is the same everywhere, so
//! detail goes where it costs least in the whole model; the result does not depend on the number of threads.
//! Sander and Mitchell 2005, section 5.4, with one global limit instead of passes per cluster.

mod border;
mod charts;
mod compact;
mod corner_lists;
mod fan;
mod legal;
mod patch;
mod quadric;
mod slide;
mod stretch;
mod vanish;

pub use charts::UvInput;

use crate::segment::Segmentation;
use crate::topology::{Fans, Kind, border_pair};
use border::Seam;
use charts::Charts;
use compact::Forest;
use glam::Vec3;
use patch::{Patch, PatchInput};
use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

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
const MAX_RISE: f64 = 16.0;
/// Error that the first level may always reach, in diagonals; later levels `ratio` times more each.
const FREE_ERROR: f64 = 2e-2;
/// Collapses that a rank among all of them is estimated from.
const RANK_SAMPLES: usize = 1 << 16;
/// A component vanishes when the cost limit reaches this share of its squared diameter.
const VANISH_SHARE: f32 = 0.25;

/// Share of the time that goes by before the first vertex collapses, for progress displays; the rest goes with those that do.
const SET_UP_SHARE: f32 = 0.3;

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
    let members = Members::new(input);
    let forest = Forest::new(input.positions.len(), (levels - 1) as u8);
    let area = mean_area(input);
    let built = AtomicUsize::new(0);
    let patch = |c| {
        let patch = Patch::new(patch_input(input, &members, area, c as u32));
        let share = (built.fetch_add(1, Ordering::Relaxed) + 1) as f32 / input.segmentation.len() as f32;
        progress(share * SET_UP_SHARE);
        Mutex::new(patch)
    };
    let patches: Vec<Mutex<Patch>> = (0..input.segmentation.len()).into_par_iter().map(patch).collect();
    let mut seams = color_seams(build_seams(input, &members));
    drop(members);
    let mut counts = vec![input.positions.len()];
    let mut search = Search::new(&patches, input.positions);
    // But for points that vanished components leave.
    let mut alive = input.positions.len();
    for level in 0..levels - 1 {
        patches.par_iter().for_each(|p| lock(p).bury_points());
        // Towards the first level most vertices go and errors are small: witnesses would cost more than they tell.
        patches.iter().for_each(|p| lock(p).watchful = level > 0);
        let target = input.positions.len() as f64 / ratio.powi(level as i32 + 1);
        search.start_level(level, ratio, alive as f64);
        for round in 0..MAX_ROUNDS {
            let small = (alive as f64) < SMALL_COUNT;
            let enough = if small { target.round() } else { target * TARGET_TOLERANCE };
            if alive as f64 <= enough || search.exhausted() {
                break;
            }
            if round > 0 || level > 0 {
                search.advance(&patches, alive as f64, target);
            }
            let quota = if small { alive - target.round() as usize } else { usize::MAX };
            alive -= run_round(&patches, &mut seams, search.limit, target / alive as f64, quota);
            search.record(alive as f64);
            let all = 1.0 - ratio.powi(1 - levels as i32);
            let dead = ((1.0 - alive as f64 / input.positions.len() as f64) / all).min(1.0) as f32;
            progress(SET_UP_SHARE + dead * (1.0 - SET_UP_SHARE));
        }
        hand_over(&patches, &mut seams, &forest, level as u8);
        counts.push(alive + patches.iter().map(|p| lock(p).point_count()).sum::<usize>());
    }
    collect(&patches, input, forest, counts)
}

/// Mean area of the triangles around a position, doubled: what its quadric starts with. At least one quantum.
fn mean_area(input: &UnisonInput) -> f32 {
    const BLOCK: usize = 1 << 14;
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| glam::IVec3::from_array(input.positions[v as usize]).as_dvec3());
        (b - a).cross(c - a).length()
    };
    let blocks: Vec<f64> = input.triangles.par_chunks(BLOCK).map(|b| b.iter().map(area).sum()).collect();
    (blocks.iter().sum::<f64>() * 3.0 / input.positions.len() as f64).max(1.0) as f32
}

fn lock(p: &Mutex<Patch>) -> std::sync::MutexGuard<'_, Patch> {
    p.lock().expect("no thread panics while it holds a patch")
}

/// One round under one cost limit; returns how many positions died. Where there is a quota, the patches take from it one
/// after the other; only a part that vanishes as a whole may exceed it.
fn run_round(patches: &[Mutex<Patch>], seams: &mut [Vec<Seam>], limit: f32, keep: f64, quota: usize) -> usize {
    let inside = |p: &Mutex<Patch>, quota: usize| {
        let mut p = lock(p);
        let vanishing = ((p.alive() - p.point_count()) as f64 * (1.0 - keep)).ceil().max(0.0) as usize;
        let collapsed = p.collapse_interior(limit, quota);
        collapsed + p.vanish(limit, vanishing.min(quota - collapsed))
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
struct Search {
    limit: f32,
    /// Limit of this level: a mesh whose shape does not allow the target keeps more vertices instead of its worst.
    end: f32,
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
    /// Starts at the cost that a fifth of the movable vertices stay below.
    fn new(patches: &[Mutex<Patch>], positions: &[[i32; 3]]) -> Self {
        let limit = cost_of_rank(patches, positions.len() / 5).unwrap_or(0.0);
        let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
        for p in positions {
            for k in 0..3 {
                lo[k] = lo[k].min(p[k]);
                hi[k] = hi[k].max(p[k]);
            }
        }
        let diagonal: f32 = (0..3).map(|k| (hi[k] as f32 - lo[k] as f32).powi(2)).sum();
        Search {
            limit: limit.max(diagonal * FIRST_LIMIT).max(f32::MIN_POSITIVE),
            end: diagonal,
            diagonal,
            last: None,
            slope: -0.5,
            idle: false,
            start: 0.0,
            progress: (0.0, f64::INFINITY),
            stalled: false,
        }
    }

    /// Sets how far the limit may rise at a level. On smooth surfaces it rises by the squared ratio.
    fn start_level(&mut self, level: usize, ratio: f64, count: f64) {
        let natural = match level {
            0 => 0.0,
            _ => f64::from(self.limit) * ratio * ratio * MAX_RISE,
        };
        let always = f64::from(self.diagonal) * (FREE_ERROR * ratio.powi(level as i32)).powi(2);
        (self.start, self.progress, self.stalled) = (count, (self.limit, f64::INFINITY), false);
        self.end = (natural.max(always) as f32).min(self.diagonal);
    }

    fn exhausted(&self) -> bool {
        self.stalled || self.limit >= self.end
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
        self.limit = (self.limit * factor).min(queued.max(self.limit * least as f32)).min(self.end);
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

/// The positions of every cluster, ascending, and where to find one among them.
struct Members {
    clusters: Vec<Vec<u32>>,
    /// Place of each position that only one cluster uses; of others, in the last one.
    place: Vec<u32>,
}

impl Members {
    fn new(input: &UnisonInput) -> Self {
        let mut clusters = vec![Vec::new(); input.segmentation.len()];
        let mut place = vec![0; input.positions.len()];
        for v in 0..input.positions.len() as u32 {
            let around = input.fans.around(v).iter().map(|&t| input.cluster_of[t as usize]);
            let alone = matches!(input.kinds[v as usize], Kind::Inner | Kind::Open);
            for c in around.take(if alone { 1 } else { usize::MAX }) {
                let list: &mut Vec<u32> = &mut clusters[c as usize];
                if list.last() != Some(&v) {
                    place[v as usize] = list.len() as u32;
                    list.push(v);
                }
            }
        }
        Members { clusters, place }
    }

    /// Local index of position `v` in cluster `c`, which uses it.
    fn local(&self, c: u32, v: u32) -> u32 {
        let list = &self.clusters[c as usize];
        match self.place[v as usize] {
            guess if list.get(guess as usize) == Some(&v) => guess,
            _ => list.binary_search(&v).expect("a position of the cluster") as u32,
        }
    }
}

fn patch_input(input: &UnisonInput, members: &Members, mean_area: f32, c: u32) -> PatchInput {
    let triangles = input.segmentation.cluster(c as usize);
    let global = members.clusters[c as usize].clone();
    let origin = input.positions[global[0] as usize];
    let positions = global.iter().map(|&v| {
        let p = input.positions[v as usize];
        Vec3::from_array(std::array::from_fn(|k| (i64::from(p[k]) - i64::from(origin[k])) as f32))
    });
    let (mut shared_start, mut shared) = (vec![0], Vec::new());
    for &v in &global {
        if matches!(input.kinds[v as usize], Kind::Border | Kind::Locked) {
            let mut others: Vec<u32> = input.fans.around(v).iter().map(|&t| input.cluster_of[t as usize]).collect();
            others.retain(|&o| o != c);
            others.sort_unstable();
            others.dedup();
            shared.extend(others);
        }
        shared_start.push(shared.len() as u32);
    }
    let positions: Vec<Vec3> = positions.collect();
    let local: Vec<[u32; 3]> =
        triangles.iter().map(|&t| input.triangles[t as usize].map(|v| members.local(c, v))).collect();
    PatchInput {
        charts: input.texture.as_ref().map(|uv| Charts::new(uv, c, triangles, &local, &positions)),
        triangles: local,
        kinds: global.iter().map(|&v| input.kinds[v as usize]).collect(),
        normals: global.iter().map(|&v| input.normals[v as usize]).collect(),
        components: small_components(&global, &input.segmentation.components, &positions, &shared_start),
        positions,
        mean_area,
        shared_start,
        shared,
        global,
    }
}

/// Components that no other cluster touches, largest first, with the cost at which they vanish. The largest
/// one of a cluster stays.
fn small_components(
    global: &[u32],
    component: &[u32],
    positions: &[Vec3],
    shared_start: &[u32],
) -> Vec<(f32, Vec<u32>)> {
    if global.iter().all(|&v| component[v as usize] == component[global[0] as usize]) {
        return Vec::new();
    }
    let mut members: Vec<(u32, u32)> =
        global.iter().enumerate().map(|(i, &v)| (component[v as usize], i as u32)).collect();
    members.sort_unstable();
    let mut list: Vec<(f32, Vec<u32>)> = members
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.iter().all(|m| shared_start[m.1 as usize] == shared_start[m.1 as usize + 1]))
        .map(|group| {
            let points = || group.iter().map(|m| positions[m.1 as usize]);
            let (lo, hi) = points().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| (b.0.min(p), b.1.max(p)));
            ((hi - lo).length_squared() * VANISH_SHARE, group.iter().map(|m| m.1).collect())
        })
        .collect();
    list.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1[0].cmp(&b.1[0])));
    list.drain(..usize::from(!list.is_empty()));
    list
}

/// The borders between two clusters, ascending by clusters.
fn build_seams(input: &UnisonInput, members: &Members) -> Vec<Seam> {
    let mut ends: Vec<([u32; 2], u32)> = (0..input.positions.len() as u32)
        .into_par_iter()
        .filter(|&v| input.kinds[v as usize] == Kind::Border)
        .map(|v| (border_pair(v, input.cluster_of, input.fans), v))
        .collect();
    ends.par_sort_unstable();
    ends.chunk_by(|a, b| a.0 == b.0)
        .map(|group| {
            let clusters = group[0].0;
            let local = |k: usize, v: u32| members.local(clusters[k], v);
            Seam::new(clusters, group.iter().map(|&(_, v)| [local(0, v), local(1, v)]).collect())
        })
        .collect()
}

/// Groups in which no cluster occurs twice (greedy edge colouring): these may move at the same time.
fn color_seams(seams: Vec<Seam>) -> Vec<Vec<Seam>> {
    let mut groups: Vec<(std::collections::BTreeSet<u32>, Vec<Seam>)> = Vec::new();
    for s in seams {
        let [a, b] = s.clusters;
        let free = groups.iter().position(|g| !g.0.contains(&a) && !g.0.contains(&b));
        let at = free.unwrap_or_else(|| {
            groups.push(Default::default());
            groups.len() - 1
        });
        groups[at].0.extend([a, b]);
        groups[at].1.push(s);
    }
    groups.into_iter().map(|g| g.1).collect()
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
