//! The integer grid: every position becomes a grid point that all its clusters can store (design section 2).
//!
//! A cluster stores 16-bit offsets in steps of `2^shift` quanta. Most clusters have shift 0; one that holds long
//! triangles has coarser steps, and the positions it shares are snapped to the coarsest step among their clusters.

use pb_mesh::segment::Segmentation;
use pb_mesh::topology::Fans;
use rayon::prelude::*;
use std::collections::HashSet;

/// Largest offset of a vertex from its cluster's origin, in steps.
const MAX_OFFSET: i64 = 65_535;
/// The model spans at most this many quanta per axis, so that sums of grid coordinates fit i32.
const MAX_SPAN: f64 = (1u32 << 29) as f64;
/// The quantum lets this share of the clusters use single steps.
const FINE_SHARE: f64 = 0.75;

/// All positions on the grid.
pub(super) struct Grid {
    /// World position of grid point (0, 0, 0).
    pub origin: [f64; 3],
    /// Grid step, input units: a power of two.
    pub quantum: f64,
    /// Grid points.
    pub points: Vec<[i32; 3]>,
    /// Offset step of each cluster, as a power of two of the quantum.
    pub shifts: Vec<u32>,
    /// Largest distance that snapping moved a position of each cluster, input units.
    pub snap_errors: Vec<f64>,
    /// Sum of squared distances over all positions.
    pub snap_squares: f64,
}

/// Chooses quantum and steps, and snaps.
pub(super) fn snap(
    positions: &[[f64; 3]],
    triangles: &[[u32; 3]],
    clusters: &Segmentation,
    cluster_of: &[u32],
    fans: &Fans,
) -> Grid {
    let extents: Vec<f64> = (0..clusters.len())
        .into_par_iter()
        .map(|c| {
            let (lo, hi) =
                bounds(clusters.cluster(c).iter().flat_map(|&t| triangles[t as usize]).map(|v| positions[v as usize]));
            (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max)
        })
        .collect();
    let (lo, hi) = bounds(positions.iter().copied());
    let span = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max);
    let quantum = choose_quantum(&extents, span);
    let origin = std::array::from_fn(|k| ((lo[k] * 0.5 + hi[k] * 0.5) / quantum).round() * quantum);
    let mut shifts: Vec<u32> = extents.iter().map(|e| shift_for((e / quantum) as i64 + 2)).collect();
    loop {
        let mut points = snap_points(positions, origin, quantum, cluster_of, fans, &shifts);
        part_equal(&mut points, cluster_of, fans, &shifts);
        let needed: Vec<u32> = (0..clusters.len())
            .into_par_iter()
            .map(|c| {
                let corners = clusters.cluster(c).iter().flat_map(|&t| triangles[t as usize]);
                let (lo, hi) = bounds(corners.map(|v| points[v as usize].map(f64::from)));
                shift_for((0..3).map(|k| (hi[k] - lo[k]) as i64).max().expect("three axes")).max(shifts[c])
            })
            .collect();
        if needed == shifts {
            let (snap_errors, snap_squares) =
                errors(positions, &points, origin, quantum, cluster_of, fans, clusters.len());
            return Grid { origin, quantum, points, shifts, snap_errors, snap_squares };
        }
        shifts = needed;
    }
}

fn bounds(points: impl Iterator<Item = [f64; 3]>) -> ([f64; 3], [f64; 3]) {
    points.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(lo, hi), p| {
        (std::array::from_fn(|k| lo[k].min(p[k])), std::array::from_fn(|k| hi[k].max(p[k])))
    })
}

fn choose_quantum(extents: &[f64], span: f64) -> f64 {
    let mut sorted = extents.to_vec();
    sorted.sort_by(f64::total_cmp);
    let typical = sorted[((sorted.len() - 1) as f64 * FINE_SHARE) as usize].max(span * 1e-12);
    let wanted = (typical / (MAX_OFFSET - 2) as f64).max(span / MAX_SPAN).max(f64::MIN_POSITIVE * 1e20);
    wanted.log2().ceil().exp2()
}

/// Smallest step in which an extent of `quanta` fits 16 bits.
fn shift_for(quanta: i64) -> u32 {
    (0..31).find(|s| quanta >> s < MAX_OFFSET).unwrap_or(31)
}

fn snap_points(
    positions: &[[f64; 3]],
    origin: [f64; 3],
    quantum: f64,
    cluster_of: &[u32],
    fans: &Fans,
    shifts: &[u32],
) -> Vec<[i32; 3]> {
    let plain = shifts.iter().all(|&s| s == 0);
    positions
        .par_iter()
        .enumerate()
        .map(|(v, p)| {
            let shift = match plain {
                true => 0,
                false => coarsest_step(v as u32, cluster_of, fans, shifts),
            };
            let step = quantum * f64::from(1u32 << shift);
            std::array::from_fn(|k| (((p[k] - origin[k]) / step).round() as i32) << shift)
        })
        .collect()
}

/// The step that all clusters of a position can store.
fn coarsest_step(v: u32, cluster_of: &[u32], fans: &Fans, shifts: &[u32]) -> u32 {
    fans.around(v).iter().map(|&t| shifts[cluster_of[t as usize] as usize]).max().unwrap_or(0)
}

/// Gives positions that fell on one grid point, such as the split sheets of a non-manifold place, points of their own,
/// the nearest free ones: a grid point names one position in the whole archive.
fn part_equal(points: &mut [[i32; 3]], cluster_of: &[u32], fans: &Fans, shifts: &[u32]) {
    if all_distinct(points) {
        return;
    }
    let mut order: Vec<([i32; 3], u32)> = points.par_iter().enumerate().map(|(v, &p)| (p, v as u32)).collect();
    order.par_sort_unstable();
    let doubles: Vec<u32> = order.windows(2).filter(|w| w[0].0 == w[1].0).map(|w| w[1].1).collect();
    if doubles.is_empty() {
        return;
    }
    let mut taken: HashSet<[i32; 3]> = points.iter().copied().collect();
    for v in doubles {
        let step = 1 << coarsest_step(v, cluster_of, fans, shifts);
        let p = points[v as usize];
        let free = (1..).find_map(|radius| {
            shell(radius).map(|d| std::array::from_fn(|k| p[k] + d[k] * step)).find(|q| !taken.contains(q))
        });
        points[v as usize] = free.expect("shells grow until a point is free");
        taken.insert(points[v as usize]);
    }
}

/// Are all points different? Quick, and by hashes: may say no where they are.
fn all_distinct(points: &[[i32; 3]]) -> bool {
    // Odd multipliers of splitmix64 and its kin.
    let mixed = |p: &[i32; 3]| {
        let word = |k: usize| u64::from(p[k] as u32);
        let x =
            (word(0) | word(1) << 32).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ word(2).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ x >> 31).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ x >> 29
    };
    let mut hashes: Vec<u64> = points.par_iter().map(mixed).collect();
    hashes.par_sort_unstable();
    hashes.par_windows(2).all(|w| w[0] != w[1])
}

/// The grid offsets at Chebyshev distance `radius`, in a fixed order.
fn shell(radius: i32) -> impl Iterator<Item = [i32; 3]> {
    let line = move || -radius..=radius;
    let cube = line().flat_map(move |x| line().flat_map(move |y| line().map(move |z| [x, y, z])));
    cube.filter(move |d| d.iter().any(|c| c.abs() == radius))
}

/// Blocks that the errors are gathered in: the same sums on any number of threads.
const ERROR_BLOCKS: usize = 64;

fn errors(
    positions: &[[f64; 3]],
    points: &[[i32; 3]],
    origin: [f64; 3],
    quantum: f64,
    cluster_of: &[u32],
    fans: &Fans,
    clusters: usize,
) -> (Vec<f64>, f64) {
    let size = positions.len().div_ceil(ERROR_BLOCKS);
    let block = |(i, block): (usize, &[[f64; 3]])| {
        let (mut max, mut squares) = (vec![0f64; clusters], 0.0);
        for (v, p) in (i * size..).zip(block) {
            let g = points[v];
            let square = (0..3).map(|k| (p[k] - (origin[k] + f64::from(g[k]) * quantum)).powi(2)).sum::<f64>();
            squares += square;
            for &t in fans.around(v as u32) {
                let m = &mut max[cluster_of[t as usize] as usize];
                *m = m.max(square);
            }
        }
        (max, squares)
    };
    let blocks: Vec<(Vec<f64>, f64)> = positions.par_chunks(size).enumerate().map(block).collect();
    let largest = |c: usize| blocks.iter().map(|b| b.0[c]).fold(0.0, f64::max).sqrt();
    ((0..clusters).map(largest).collect(), blocks.iter().map(|b| b.1).sum())
}
