//! The errors of every level: distances to the input, per cluster and for the whole model.

use super::Clusters;
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
}

impl LevelSurface<'_> {
    /// The next coarser level.
    fn coarser(&self, collapses: &Collapses, level: u8) -> LevelSurface<'static> {
        let at = |t: &[u32; 3]| t.map(|v| collapses.ancestor(v, level));
        let kept = self.triangles.par_iter().zip(&*self.cluster_of).map(|(t, &c)| (at(t), c));
        let (triangles, cluster_of): (Vec<_>, Vec<_>) =
            kept.filter(|(t, _)| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).unzip();
        LevelSurface { triangles: triangles.into(), cluster_of: cluster_of.into() }
    }
}

/// Measures all levels; bounds never fall from a level to the next coarser one.
///
/// Levels 1 and 2 are measured against the input. Level i above is measured against level i - 2, which is several
/// times smaller, and by the triangle inequality the bound of that level is added: a few percent of its own.
pub(super) fn measure_levels(
    triangles: &[[u32; 3]],
    clusters: &Clusters,
    collapses: &Collapses,
    levels: usize,
    progress: &dyn Fn(f32),
) -> Vec<LevelErrors> {
    let (grid, count) = (&clusters.grid, clusters.segmentation.len());
    let components = &clusters.segmentation.components;
    let open = open_positions(triangles, clusters);
    let mut ancestors: Vec<u32> = (0..grid.points.len() as u32).collect();
    let round_up = |x: f64| (x as f32).next_up();
    let mut surfaces =
        vec![LevelSurface { triangles: triangles.into(), cluster_of: clusters.cluster_of.as_slice().into() }];
    let mut list = vec![LevelErrors {
        max: grid.snap_errors.iter().map(|&e| round_up(e)).collect(),
        rms: (grid.snap_squares / grid.points.len() as f64).sqrt(),
        vertices: grid.points.len() as u64,
    }];
    for level in 1..levels as u8 {
        // A component that has vanished is measured against the point that it shrank to.
        ancestors.par_iter_mut().for_each(|v| {
            let a = collapses.ancestor(*v, level);
            if components[a as usize] == components[*v as usize] {
                *v = a;
            }
        });
        surfaces.push(surfaces[level as usize - 1].coarser(collapses, level));
        let base = (level as usize).saturating_sub(MEASURE_STEP);
        let (fine, coarse) = (&surfaces[base], &surfaces[level as usize]);
        let fans = (base > 0).then(|| Fans::new(grid.points.len(), &fine.triangles));
        let pair = LevelPair {
            positions: &grid.points,
            triangles: &fine.triangles,
            fine: fans.as_ref().unwrap_or(&clusters.fans),
            cluster_of: &fine.cluster_of,
            coarse: &coarse.triangles,
            coarse_cluster_of: &coarse.cluster_of,
            ancestors: &ancestors,
            open: &open,
        };
        let deviation = measure(&pair, count);
        let (finer, base) = (list.last().expect("level 0 is there"), &list[base]);
        let bound = |c: usize| {
            let distance = f64::from(deviation.max[c]) * grid.quantum * (1.0 + 1e-5) + f64::from(base.max[c]);
            round_up(distance).max(finer.max[c])
        };
        let square = deviation.squares.0 / deviation.squares.1.max(f64::MIN_POSITIVE) * grid.quantum * grid.quantum;
        let next = LevelErrors {
            max: (0..count).map(bound).collect(),
            rms: (square + base.rms * base.rms).sqrt().max(finer.rms),
            vertices: used_positions(&coarse.triangles, grid.points.len()),
        };
        list.push(next);
        progress(f32::from(level) / (levels - 1) as f32);
    }
    list
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
fn used_positions(triangles: &[[u32; 3]], positions: usize) -> u64 {
    let mut used = vec![false; positions];
    triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
    used.iter().filter(|u| **u).count() as u64
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
