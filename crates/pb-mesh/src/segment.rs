//! Segmentation: clusters are the leaves of a k-d tree over triangle centroids.
//!
//! A triangle is never cut: its centroid decides. A small connected component goes to one cluster as a
//! whole (the component's centroid decides), so that it can simplify down to a point without borders.
//! After Sander and Mitchell 2005, section 5.1, with a k-d tree instead of a fixed voxel grid: densities
//! that differ by orders of magnitude still give clusters of like size.

use crate::mesh::bounds;
use rayon::prelude::*;

/// A component of at most `max_triangles / SMALL_COMPONENT` triangles is kept in one cluster.
const SMALL_COMPONENT: usize = 4;
/// Clusters are to hold this share of the triangles that they may: what stays together (components, equal keys) makes some
/// larger than planned, and those that become too large are halved.
const FILL: f64 = 0.95;
/// Items that the axis of a cut is chosen from, and the width of the band around it, in extents of all, on either side.
const CUT_SAMPLES: usize = 2048;
const BAND: f32 = 1.0 / 32.0;
/// Below this many triangles a subtree is split without forking.
const PARALLEL_MIN: usize = 1 << 15;
/// More positions than this do not fit the 16-bit indices of a cluster.
pub const MAX_CLUSTER_VERTICES: usize = 65_535;

/// Clusters as runs of triangle indices: cluster `c` holds `order[starts[c]..starts[c + 1]]`.
#[derive(Clone, Debug)]
pub struct Segmentation {
    /// Triangle indices, cluster by cluster, ascending inside a cluster.
    pub order: Vec<u32>,
    /// First entry of each cluster in `order`, and one past the last.
    pub starts: Vec<u32>,
    /// Connected component of each position: the smallest position it hangs together with.
    pub components: Vec<u32>,
}

impl Segmentation {
    /// Number of clusters.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// True when there is no cluster.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Triangles of one cluster.
    pub fn cluster(&self, c: usize) -> &[u32] {
        &self.order[self.starts[c] as usize..self.starts[c + 1] as usize]
    }
}

#[derive(Clone, Copy)]
struct Item {
    key: [f32; 3],
    triangle: u32,
}

/// Splits `triangles` (position indices) into clusters of at most `max_triangles` triangles and at most
/// [`MAX_CLUSTER_VERTICES`] distinct `vertex_of` corners. `positions` may be in any unit and anywhere.
/// `corners` are the vertex records of the triangles, as many as `triangles`.
pub fn segment(
    positions: &[[f64; 3]],
    triangles: &[[u32; 3]],
    corners: &[[u32; 3]],
    max_triangles: usize,
) -> Segmentation {
    segment_objects(positions, &[], triangles, corners, max_triangles)
}

/// The same where positions belong to objects ([`Objects::of`](crate::objects::Objects::of), empty where there is one): no
/// cluster has triangles of two objects, and the clusters of lower objects come first.
pub fn segment_objects(
    positions: &[[f64; 3]],
    object_of: &[u32],
    triangles: &[[u32; 3]],
    corners: &[[u32; 3]],
    max_triangles: usize,
) -> Segmentation {
    assert!(max_triangles > 0 && corners.len() == triangles.len());
    let components = components(positions.len(), triangles);
    let mut items = keys(positions, triangles, &components, max_triangles / SMALL_COMPONENT);
    let mut sizes = Vec::new();
    if object_of.is_empty() {
        split(&mut items, 1, max_triangles, corners, &mut sizes);
    } else {
        let object = |i: &Item| object_of[triangles[i.triangle as usize][0] as usize];
        items.par_sort_by_key(object);
        for run in items.chunk_by_mut(|a, b| object(a) == object(b)) {
            split(run, 1, max_triangles, corners, &mut sizes);
        }
    }
    let mut order: Vec<u32> = items.par_iter().map(|i| i.triangle).collect();
    drop(items);
    let (mut starts, mut runs, mut rest) = (vec![0], Vec::with_capacity(sizes.len()), order.as_mut_slice());
    for size in sizes {
        starts.push(starts[starts.len() - 1] + size);
        let (run, after) = rest.split_at_mut(size as usize);
        runs.push(run);
        rest = after;
    }
    // Inputs mostly have neighbours near each other: whoever walks over a cluster gains from that.
    runs.into_par_iter().for_each(|run| run.sort_unstable());
    Segmentation { order, starts, components }
}

/// Sort keys: the centroid of the triangle, or of its whole component where that is small.
fn keys(positions: &[[f64; 3]], triangles: &[[u32; 3]], component: &[u32], small: usize) -> Vec<Item> {
    let (lo, _) = bounds(positions);
    let centroid = |t: &[u32; 3]| -> [f64; 3] {
        std::array::from_fn(|k| t.iter().map(|&v| positions[v as usize][k] - lo[k]).sum::<f64>() / 3.0)
    };
    let mut sums: Vec<([f64; 3], u32)> = vec![([0.0; 3], 0); positions.len()];
    for t in triangles {
        sums[component[t[0] as usize] as usize].1 += 1;
    }
    for t in triangles {
        let s = &mut sums[component[t[0] as usize] as usize];
        if s.1 as usize <= small {
            let c = centroid(t);
            (0..3).for_each(|k| s.0[k] += c[k]);
        }
    }
    triangles
        .par_iter()
        .enumerate()
        .map(|(i, t)| {
            let (sum, count) = sums[component[t[0] as usize] as usize];
            let key = if count as usize <= small {
                sum.map(|s| (s / count as f64) as f32)
            } else {
                centroid(t).map(|c| c as f32)
            };
            Item { key, triangle: i as u32 }
        })
        .collect()
}

/// Connected components over shared positions: for every position the smallest position it hangs together with.
pub(crate) fn components(positions: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..positions as u32).collect();
    fn find(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for t in triangles {
        let mut a = find(&mut parent, t[0]);
        for &v in &t[1..] {
            let b = find(&mut parent, v);
            let (low, high) = (a.min(b), a.max(b));
            parent[high as usize] = low;
            a = low;
        }
    }
    for v in 0..positions {
        parent[v] = parent[parent[v] as usize];
    }
    parent
}

/// Splits into `parts` clusters of about the same size, or more where those would be too large. Few clusters have short
/// borders, and borders are where quality is lost: so their number is not rounded to a power of two.
fn split(items: &mut [Item], parts: usize, max: usize, corners: &[[u32; 3]], sizes: &mut Vec<u32>) {
    if items.len() <= max && fits_indices(items, corners) {
        sizes.push(items.len() as u32);
        return;
    }
    let parts = match parts {
        1 => ((items.len() as f64 / (max as f64 * FILL)).ceil() as usize).max(2),
        more => more,
    };
    let share = (parts / 2) as f64 / parts as f64;
    let middle = partition(items, ((items.len() as f64 * share) as usize).max(1));
    let (left, right) = items.split_at_mut(middle);
    let parts = [parts / 2, parts - parts / 2];
    if left.len() + right.len() < PARALLEL_MIN {
        split(left, parts[0], max, corners, sizes);
        split(right, parts[1], max, corners, sizes);
    } else {
        let mut right_sizes = Vec::new();
        rayon::join(
            || split(left, parts[0], max, corners, sizes),
            || split(right, parts[1], max, corners, &mut right_sizes),
        );
        sizes.append(&mut right_sizes);
    }
}

fn fits_indices(items: &[Item], corners: &[[u32; 3]]) -> bool {
    if items.len() * 3 <= MAX_CLUSTER_VERTICES {
        return true;
    }
    let mut used: Vec<u32> = items.iter().flat_map(|i| corners[i.triangle as usize]).collect();
    used.sort_unstable();
    used.dedup();
    used.len() <= MAX_CLUSTER_VERTICES
}

/// Reorders `items` around a plane along the [`shortest_cut`]; returns how many are below. The plane has `wanted` of them
/// below, moved to the nearest place where keys differ, so that equal keys stay together.
fn partition(items: &mut [Item], wanted: usize) -> usize {
    let (lo, hi) = key_bounds(items);
    let extent = |k: usize| hi[k] - lo[k];
    let longest = (0..3).max_by(|&a, &b| extent(a).total_cmp(&extent(b))).expect("three axes");
    let axis = shortest_cut(items, wanted, extent(longest) * BAND, longest);
    // Keys are not negative, so that their bits are in the order of their values.
    items.select_nth_unstable_by_key(wanted, |i| u64::from(i.key[axis].to_bits()) << 32 | u64::from(i.triangle));
    let value = items[wanted].key[axis];
    if lo[axis] == hi[axis] {
        return wanted;
    }
    // Nothing before the item at `wanted` is above it, nothing after it below.
    let (before, after) = items.split_at_mut(wanted);
    let below = before.iter().filter(|i| i.key[axis] < value).count();
    let not_above = wanted + after.iter().filter(|i| i.key[axis] == value).count();
    let cut_low = below > 0 && wanted - below <= not_above - wanted || not_above == wanted + after.len();
    match cut_low {
        true if below == wanted => {}
        true => bring_forward(before, |i| i.key[axis] < value),
        false => bring_forward(after, |i| i.key[axis] == value),
    }
    if cut_low { below } else { not_above }
}

/// The axis along which a cut at `wanted` has the fewest items within `band` of it, estimated from samples: about the same as the
/// shortest border.
fn shortest_cut(items: &[Item], wanted: usize, band: f32, longest: usize) -> usize {
    let step = (items.len() / CUT_SAMPLES).max(1);
    let near = |k: usize| {
        let mut keys: Vec<f32> = items.iter().step_by(step).map(|i| i.key[k]).collect();
        let at = (wanted / step).min(keys.len() - 1);
        let cut = *keys.select_nth_unstable_by(at, f32::total_cmp).1;
        keys.iter().filter(|x| (**x - cut).abs() <= band).count()
    };
    let counts: [usize; 3] = std::array::from_fn(near);
    (0..3).min_by_key(|&k| (counts[k], k != longest)).expect("three axes")
}

/// Smallest and largest key per axis.
fn key_bounds(items: &[Item]) -> ([f32; 3], [f32; 3]) {
    if items.len() > PARALLEL_MIN {
        let (left, right) = items.split_at(items.len() / 2);
        let (a, b) = rayon::join(|| key_bounds(left), || key_bounds(right));
        return (std::array::from_fn(|k| a.0[k].min(b.0[k])), std::array::from_fn(|k| a.1[k].max(b.1[k])));
    }
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for i in items {
        for k in 0..3 {
            lo[k] = lo[k].min(i.key[k]);
            hi[k] = hi[k].max(i.key[k]);
        }
    }
    (lo, hi)
}

/// Puts the items that are `wanted` before the others.
fn bring_forward(items: &mut [Item], wanted: impl Fn(&Item) -> bool) {
    let mut at = 0;
    for i in 0..items.len() {
        if wanted(&items[i]) {
            items.swap(at, i);
            at += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// A grid of unit squares, two triangles each, where there is a square.
    fn plate(width: u32, height: u32, there: impl Fn(u32, u32) -> bool) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let at = |x: u32, y: u32| y * (width + 1) + x;
        let positions =
            (0..=height).flat_map(|y| (0..=width).map(move |x| [f64::from(x), f64::from(y), 0.0])).collect();
        let squares = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).filter(|&(x, y)| there(x, y));
        let halves = |(x, y)| [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]];
        (positions, squares.flat_map(halves).collect())
    }

    fn sizes(s: &Segmentation) -> Vec<usize> {
        (0..s.len()).map(|c| s.cluster(c).len()).collect()
    }

    #[test]
    fn clusters_are_as_few_as_their_size_allows() {
        let (positions, triangles) = plate(100, 51, |_, _| true);
        for (max, wanted) in [(10_800, 1), (10_000, 2), (3_600, 3), (2_200, 5), (1_000, 11), (400, 27)] {
            let found = sizes(&segment(&positions, &triangles, &triangles, max));
            assert_eq!(found.iter().sum::<usize>(), triangles.len());
            assert!(found.iter().all(|&n| n <= max), "{found:?} of at most {max}");
            assert_eq!(found.len(), wanted, "{found:?} of at most {max}");
        }
    }

    #[test]
    fn a_cut_goes_where_the_border_is_short() {
        // Two plates, wider than both are high, and a bridge between them.
        let bridge = |x, y| !(24..36).contains(&y) || (30..34).contains(&x);
        let (positions, triangles) = plate(64, 60, bridge);
        let s = segment(&positions, &triangles, &triangles, triangles.len() - 1);
        let used = |c| s.cluster(c).iter().flat_map(|&t| triangles[t as usize]).collect::<BTreeSet<u32>>();
        assert_eq!(s.len(), 2);
        assert!(used(0).intersection(&used(1)).count() <= 6);
    }
}
