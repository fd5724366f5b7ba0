//! From the coarse surface back to the input, by samples.

use super::{FARTHEST_FROM_CORNERS, Field, GOOD_ENOUGH, LevelPair, NONE, UNREFINED, longest_edge, relative};
use crate::closest::closest_on_triangle;
use crate::topology::group;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Steps over the input from a corner of a coarse triangle to a point of it.
const MAX_WALK_BACK: usize = 128;

/// Below this many coarse triangles, walks that seem to be held up are checked.
const FEW_TRIANGLES: usize = 1 << 16;
/// Samples of a level, if that is not less than one per triangle.
const SAMPLES: f32 = 65_536.0;
/// Samples along the edge of a coarse triangle of common size at most.
const TYPICAL_STEPS: u32 = 6;
/// Samples along the edge of a coarse triangle at most.
const MAX_STEPS: u32 = 12;

/// Samples along the edge of a coarse triangle at a border at least.
const RIM_STEPS: u32 = 6;
/// Progress is told once per so many triangles.
const TOLD: usize = 256;

/// How many corners of the nearest triangle a walk looks around at each step.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Walk {
    /// The nearest one.
    Quick,
    /// All three.
    Thorough,
}

/// Barycentric coordinates of the points of a lattice with so many steps along each edge of a triangle, without its corners, and the
/// number of the nearest corner.
pub(super) fn inner_points(steps: u32) -> impl Iterator<Item = ([f32; 3], usize)> {
    let all = (0..=steps).flat_map(move |i| (0..=steps - i).map(move |j| [i, j, steps - i - j]));
    all.filter(move |p| p.iter().all(|&x| x < steps)).map(move |[i, j, k]| {
        let nearest = if i >= j && i >= k { 0 } else { 1 + usize::from(k > j) };
        ([i, j, k].map(|x| x as f32 / steps as f32), nearest)
    })
}

/// The positions that map onto each coarse triangle: a walk from a corner of it may end in another fold of the input, one from there
/// does not.
pub(super) struct Below {
    starts: Vec<u32>,
    positions: Vec<u32>,
}

impl Below {
    pub fn new(nearest: &[(f32, u32)], triangles: usize) -> Self {
        let keys: Vec<[u32; 1]> = nearest.iter().map(|n| [n.1.min(triangles as u32)]).collect();
        let (starts, positions) = group(triangles + 1, &keys);
        Below { starts, positions }
    }

    /// The one of them that is nearest to `at`, relative to the triangle's first corner.
    pub fn nearest(&self, field: &Field, triangle: usize, at: Vec3) -> Option<u32> {
        let own = &self.positions[self.starts[triangle] as usize..self.starts[triangle + 1] as usize];
        let origin = field.pair.coarse[triangle][0];
        let square = |v: &u32| relative(field.pair.positions, origin, *v).distance_squared(at);
        own.iter().copied().min_by(|a, b| square(a).total_cmp(&square(b)))
    }
}

impl Field<'_> {
    /// Distances of points of the coarse triangles from the input, walked to over the input from the nearest corner:
    /// where the map is torn, by a fold, coarse parts may lie outside of it. One answer per coarse triangle, only as
    /// exact as it has to be: one that is not above the cluster's bound in `floors` may be any such number, 0 at least.
    /// `covered` gives the input triangles that a cluster's bound covers, `progress` gets the share that is done.
    pub(super) fn sampled_back<'a, I: Iterator<Item = &'a u32>>(
        &self,
        floors: &[f32],
        nearest: &[(f32, u32)],
        covered: &(impl Fn(u32) -> I + Sync),
        progress: &(dyn Fn(f32) + Sync),
    ) -> Vec<f32> {
        // A coarse triangle of the first levels is hardly larger than the input's around it; some are larger than others.
        let few = self.pair.coarse.len() < FEW_TRIANGLES;
        let ratio = (self.pair.triangles.len() / self.pair.coarse.len().max(1)).max(1);
        let affordable = (2.0 * SAMPLES / self.pair.coarse.len().max(1) as f32).sqrt() as u32;
        let typical = (ratio.ilog2() / 2).max(affordable).clamp(1, TYPICAL_STEPS);
        let longest = |tri: &[u32; 3]| longest_edge(tri.map(|v| relative(self.pair.positions, tri[0], v)));
        let lengths: Vec<f32> = self.pair.coarse.par_iter().map(longest).collect();
        let mean = lengths.iter().map(|&l| f64::from(l)).sum::<f64>() as f32 / lengths.len().max(1) as f32;
        let below = few.then(|| Below::new(nearest, self.pair.coarse.len()));
        let rims = self.rims();
        let begun = AtomicUsize::new(0);
        let samples = |(i, ((tri, &cluster), &length)): (usize, ((&[u32; 3], &u32), &f32))| {
            if i % TOLD == 0 {
                let before = begun.fetch_add(TOLD, Ordering::Relaxed);
                progress(before as f32 / self.pair.coarse.len() as f32);
            }
            let floor = floors[cluster as usize];
            // The corners are points of the input, and no point of the triangle is further from them than this.
            if length * FARTHEST_FROM_CORNERS * GOOD_ENOUGH <= floor && self.on_input(tri) {
                return 0.0;
            }
            let p = tri.map(|v| relative(self.pair.positions, tri[0], v));
            let steps = typical.max((typical as f32 * length / mean) as u32).min(MAX_STEPS);
            // It may fill a hole.
            let steps = if tri.iter().any(|&v| rims[v as usize]) { steps.max(RIM_STEPS) } else { steps };
            let enough = (floor / GOOD_ENOUGH).powi(2);
            let start = |at: Vec3| below.as_ref().and_then(|b| b.nearest(self, i, at));
            let mut last = tri[0];
            let mut distance = |at: Vec3, k: usize| {
                let quick;
                (quick, last) = self.quick_distance_back(tri[0], [tri[k], last], at, enough);
                if quick * GOOD_ENOUGH <= floor {
                    return quick * GOOD_ENOUGH;
                }
                let far = |v: u32| self.distance_back([tri[0], v], at, Walk::Thorough, 0.0).0;
                let thorough = start(at).into_iter().chain(*tri).map(far).fold(f32::INFINITY, f32::min);
                if few && thorough * GOOD_ENOUGH > floor * UNREFINED {
                    // Thin parts hold walks up.
                    return thorough.min(self.distance_to_all(tri[0], at, covered(cluster))) * GOOD_ENOUGH;
                }
                thorough * GOOD_ENOUGH
            };
            let mut most = distance((p[0] + p[1] + p[2]) / 3.0, 0);
            for (weights, nearest) in inner_points(steps) {
                most = most.max(distance(p[0] * weights[0] + p[1] * weights[1] + p[2] * weights[2], nearest));
            }
            most
        };
        self.pair.coarse.par_iter().zip(self.pair.coarse_cluster_of).zip(&lengths).enumerate().map(samples).collect()
    }

    /// Per position: does one of an open border lie there at the level?
    fn rims(&self) -> Vec<bool> {
        let LevelPair { open, ancestors, .. } = self.pair;
        let on_border = (0..open.len()).into_par_iter().filter(|&v| open[v]).map(|v| ancestors[v]);
        let mut rims = vec![false; open.len()];
        on_border.collect::<Vec<u32>>().into_iter().for_each(|v| rims[v as usize] = true);
        rims
    }

    /// Distance of `at`, relative to `origin`, from some triangles of the input.
    fn distance_to_all<'a>(&self, origin: u32, at: Vec3, triangles: impl Iterator<Item = &'a u32>) -> f32 {
        let square = |&t: &u32| {
            let corners = self.pair.triangles[t as usize].map(|v| relative(self.pair.positions, origin, v));
            closest_on_triangle(at, corners).distance_squared(at)
        };
        triangles.map(square).fold(f32::INFINITY, f32::min).sqrt()
    }

    /// Walks over the input's vertices from `start` downhill to one nearest to `at`, relative to `origin`, or to one whose
    /// squared distance is not above `enough`. The answer is the vertex, its squared distance, and the triangle around it whose
    /// corners are nearest.
    fn nearest_vertex(&self, origin: u32, start: u32, at: Vec3, enough: f32) -> (u32, f32, u32) {
        let square = |v: u32| relative(self.pair.positions, origin, v).distance_squared(at);
        let (mut now, mut best) = (start, square(start));
        let mut below = NONE;
        for _ in 0..MAX_WALK_BACK {
            let (before, mut least) = (now, f32::INFINITY);
            for &t in self.pair.fine.around(before) {
                let mut sum = 0.0;
                for v in self.pair.triangles[t as usize].into_iter().filter(|&v| v != before) {
                    let d = square(v);
                    sum += d;
                    if d < best {
                        (now, best) = (v, d);
                    }
                }
                if best <= enough {
                    return (now, best, t);
                }
                if sum < least {
                    (below, least) = (t, sum);
                }
            }
            if now == before {
                break;
            }
        }
        (now, best, below)
    }

    /// Whether all three are used by the input.
    fn on_input(&self, tri: &[u32; 3]) -> bool {
        tri.iter().all(|&v| !self.pair.fine.around(v).is_empty())
    }

    /// The same as [`distance_back`](Self::distance_back) with quick walks, from the nearer of two positions.
    pub(super) fn quick_distance_back(&self, origin: u32, starts: [u32; 2], at: Vec3, enough: f32) -> (f32, u32) {
        let square = |v: u32| relative(self.pair.positions, origin, v).distance_squared(at);
        let start = if square(starts[1]) < square(starts[0]) { starts[1] } else { starts[0] };
        self.distance_back([origin, start], at, Walk::Quick, enough)
    }

    /// Walks over the input from position `start` down to `at`, relative to position `origin`; goes no further where the squared
    /// distance is not above `enough`. The answer is the distance, and the position that the walk went to.
    pub(super) fn distance_back(&self, [origin, start]: [u32; 2], at: Vec3, walk: Walk, enough: f32) -> (f32, u32) {
        let (start, square, below) = self.nearest_vertex(origin, start, at, enough);
        if square <= enough && !self.pair.fine.around(start).is_empty() {
            return (square.sqrt(), start);
        }
        let corners = |t: u32| self.pair.triangles[t as usize].map(|v| relative(self.pair.positions, origin, v));
        if enough > 0.0 && below != NONE {
            // Mostly the point is over the inside of this one.
            let square = closest_on_triangle(at, corners(below)).distance_squared(at);
            if square <= enough {
                return (square.sqrt(), start);
            }
        }
        let (mut best, mut nearest) = (f32::INFINITY, [start; 3]);
        for _ in 0..MAX_WALK_BACK {
            let before = best;
            let centers = if walk == Walk::Quick { &nearest[..1] } else { &nearest[..] };
            let mut next = nearest;
            for &center in centers {
                for &t in self.pair.fine.around(center) {
                    let fine = self.pair.triangles[t as usize];
                    let corners = corners(t);
                    let square = closest_on_triangle(at, corners).distance_squared(at);
                    if square < best {
                        best = square;
                        if best <= enough {
                            return (best.sqrt(), center);
                        }
                        next = fine;
                        let far = |c: usize| corners[c].distance_squared(at);
                        let k = (0..3).min_by(|&a, &b| far(a).total_cmp(&far(b))).expect("three corners");
                        next.swap(0, k);
                    }
                }
            }
            if best == before || walk == Walk::Quick && next[0] == nearest[0] {
                break;
            }
            nearest = next;
        }
        (best.sqrt(), nearest[0])
    }
}
