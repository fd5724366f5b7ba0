//! The errors of every level: distances to the input, per cluster and for the whole model.

use super::{Clusters, Outside};
use pb_mesh::deviation::{LevelPair, TextureDeviation, measure};
use pb_mesh::simplify::Collapses;
use pb_mesh::topology::{Fans, Kind};
use rayon::prelude::*;
use std::borrow::Cow;

/// Errors of one level, input units.
pub(super) struct LevelErrors {
    /// Bound per cluster (segmentation order).
    pub max: Vec<f32>,
    pub rms: f64,
    /// Positions that triangles of this level use.
    pub vertices: u64,
}

/// Levels that are this many steps apart are measured against each other.
const MEASURE_STEP: usize = 2;

/// A level as triangles over positions, with the cluster of each.
struct LevelSurface<'a> {
    triangles: Cow<'a, [[u32; 3]]>,
    cluster_of: Cow<'a, [u32]>,
    /// Triangles around positions.
    fans: Cow<'a, Fans>,
}

/// Triangles of one job.
const BLOCK: usize = 1 << 14;

impl LevelSurface<'_> {
    /// The next coarser level. `survivors` gives what each position has become there.
    fn coarser(&self, survivors: &[u32]) -> LevelSurface<'static> {
        let block = |(triangles, cluster_of): (&[[u32; 3]], &[u32])| {
            let mut kept = (Vec::with_capacity(BLOCK / 2), Vec::with_capacity(BLOCK / 2));
            for (t, &c) in triangles.iter().zip(cluster_of) {
                let t = t.map(|v| survivors[v as usize]);
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    kept.0.push(t);
                    kept.1.push(c);
                }
            }
            kept
        };
        let (triangles, cluster_of): (Vec<Vec<[u32; 3]>>, Vec<Vec<u32>>) =
            self.triangles.par_chunks(BLOCK).zip(self.cluster_of.par_chunks(BLOCK)).map(block).unzip();
        let (triangles, cluster_of) = rayon::join(|| triangles.concat(), || cluster_of.concat());
        let fans = Fans::new(survivors.len(), &triangles);
        LevelSurface { triangles: triangles.into(), cluster_of: cluster_of.into(), fans: Cow::Owned(fans) }
    }
}

/// What every position has become at a level.
struct Ancestors {
    survivors: Vec<u32>,
    /// The same, but a component that has vanished is measured against the point that it shrank to.
    inside_component: Vec<u32>,
}

impl Ancestors {
    fn new(positions: usize) -> Self {
        let survivors: Vec<u32> = (0..positions as u32).collect();
        Ancestors { inside_component: survivors.clone(), survivors }
    }

    fn advance(&mut self, collapses: &Collapses, components: &[u32], level: u8) {
        self.survivors.par_iter_mut().zip(&mut self.inside_component).for_each(|(survivor, inside)| {
            let (before, a) = (*survivor, collapses.ancestor(*survivor, level));
            *survivor = a;
            let nearer = if before == *inside { a } else { collapses.ancestor(*inside, level) };
            if components[nearer as usize] == components[*inside as usize] {
                *inside = nearer;
            }
        });
    }
}

/// Measures all levels; bounds never fall from a level to the next coarser one. `progress` gets the share that is done.
///
/// Levels 1 and 2 are measured against the input. Level i above is measured against level i - 2, which is several
/// times smaller, and by the triangle inequality the bound of that level is added: a few percent of its own.
pub(super) fn measure_levels(
    triangles: &[[u32; 3]],
    clusters: &Clusters,
    collapses: &Collapses,
    levels: usize,
    outside: &Outside,
    progress: &(dyn Fn(f32) + Sync),
) -> Vec<LevelErrors> {
    let (grid, count) = (&clusters.grid, clusters.segmentation.len());
    let components = &clusters.segmentation.components;
    let open = open_positions(triangles, clusters);
    let work = Work::new(&collapses.counts);
    let mut ancestors = Ancestors::new(grid.points.len());
    let round_up = |x: f64| (x as f32).next_up();
    let mut surfaces = vec![LevelSurface {
        triangles: triangles.into(),
        cluster_of: clusters.cluster_of.as_slice().into(),
        fans: Cow::Borrowed(&clusters.fans),
    }];
    let mut list = vec![LevelErrors {
        max: grid.snap_errors.iter().map(|&e| round_up(e)).collect(),
        rms: (grid.snap_squares / grid.points.len() as f64).sqrt(),
        vertices: grid.points.len() as u64,
    }];
    for level in 1..levels as u8 {
        ancestors.advance(collapses, components, level);
        surfaces.push(surfaces[level as usize - 1].coarser(&ancestors.survivors));
        let errors = || {
            let base = (level as usize).saturating_sub(MEASURE_STEP);
            let (fine, coarse) = (&surfaces[base], &surfaces[level as usize]);
            let pair = LevelPair {
                positions: &grid.points,
                triangles: &fine.triangles,
                fine: &fine.fans,
                cluster_of: &fine.cluster_of,
                coarse: &coarse.triangles,
                fans: &coarse.fans,
                coarse_cluster_of: &coarse.cluster_of,
                ancestors: &ancestors.inside_component,
                open: &open,
            };
            let deviation = measure(&pair, count, &|share| progress(work.share(level.into(), share)));
            let (finer, base) = (list.last().expect("level 0 is there"), &list[base]);
            let bound = |c: usize| {
                let distance = f64::from(deviation.max[c]) * grid.quantum * (1.0 + 1e-5) + f64::from(base.max[c]);
                round_up(distance).max(finer.max[c])
            };
            let square = deviation.squares.0 / deviation.squares.1.max(f64::MIN_POSITIVE) * grid.quantum * grid.quantum;
            LevelErrors {
                max: (0..count).map(bound).collect(),
                rms: (square + base.rms * base.rms).sqrt().max(finer.rms),
                vertices: used_positions(&coarse.fans, grid.points.len()),
            }
        };
        let next = outside.kept("errors", level.into(), errors);
        list.push(next);
        progress(work.share(level.into(), 1.0));
    }
    list
}

/// How much work levels are, for progress displays.
struct Work(Vec<f64>);

impl Work {
    /// By the vertices of all levels: a look from each at what it is measured against, and back.
    fn new(counts: &[usize]) -> Self {
        let of = |level: usize| counts[level.saturating_sub(MEASURE_STEP)] as f64 + 2.0 * counts[level] as f64;
        Work((1..counts.len()).map(of).collect())
    }

    /// Share of the levels before this one, and of so much of it.
    fn share(&self, level: usize, done: f32) -> f32 {
        let before: f64 = self.0[..level - 1].iter().sum();
        ((before + f64::from(done) * self.0[level - 1]) / self.0.iter().sum::<f64>()) as f32
    }
}

/// What slides on the surface is as wrong as what leaves it: errors become the larger of the two, never falling towards
/// coarse. Of slides that is what most of the surface stays below.
pub(super) fn add_slides(errors: &mut [LevelErrors], slides: &[TextureDeviation], quantum: f64) {
    for level in 1..errors.len() {
        let (finer, own) = errors.split_at_mut(level);
        let finer = &finer[level - 1].max;
        for ((max, slide), finer) in own[0].max.iter_mut().zip(&slides[level].most).zip(finer) {
            *max = max.max((f64::from(*slide) * quantum) as f32).max(*finer);
        }
    }
}

/// How many positions triangles use.
fn used_positions(fans: &Fans, positions: usize) -> u64 {
    (0..positions as u32).into_par_iter().filter(|&v| !fans.around(v).is_empty()).count() as u64
}

/// Positions on open borders of the mesh.
fn open_positions(triangles: &[[u32; 3]], clusters: &Clusters) -> Vec<bool> {
    (0..clusters.kinds.len() as u32)
        .into_par_iter()
        .map(|v| match clusters.kinds[v as usize] {
            Kind::Inner | Kind::Border => false,
            Kind::Open => true,
            Kind::Locked => {
                let around = || clusters.fans.around(v).iter().map(|&t| triangles[t as usize]);
                let at = |t: [u32; 3], k: usize| t[(t.iter().position(|&x| x == v).expect("in its fan") + k) % 3];
                around().any(|t| !around().any(|o| at(o, 2) == at(t, 1)))
            }
        })
        .collect()
}
