//! Measured bounds of the distance between the input and each simplified level.
//!
//! Every input position is mapped to a near point of the coarse surface, found by walking over the triangles
//! around its ancestor. Inside an input triangle whose corners land on one coarse triangle, the distance is
//! convex, so its corners bound it. Where corners land on different coarse triangles, the straight image of
//! the triangle leaves the surface by its sag over the edges in between, which is added; triangles that would
//! raise the bound are subdivided until the sag hardly matters, or until the budget for that is spent. The map is
//! continuous up to that sag, so the same bound holds from the coarse surface back to the input; where a fold tears
//! it, samples of the coarse surface that are walked back over the input catch that (cf. Cohen et al. 1998, section 4;
//! Guthe et al. 2005 for the pruning by the largest distance known so far).

mod back;
mod border;
mod estimate;
mod texture;

pub use estimate::{Estimate, estimate};
pub use texture::{TextureDeviation, texture_deviation};

use crate::closest::{Facet, closest_of_four, closest_on_triangle, height_over, segment_distance};
use crate::progress::share_of;
use crate::topology::{Fans, group};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BinaryHeap;

/// Shares of the time that have gone by when every position has its nearest triangle, and when the way back begins, for
/// progress displays.
const NEAREST_SHARE: f32 = 0.25;
const BACK_SHARE: f32 = 0.55;
/// Rounds of walking to better triangles from the first guess.
const MAX_WALK: usize = 4;
/// Subdivisions per cluster and level at most.
const MAX_SPLITS: usize = 16;
/// Input triangles whose corners are all nearer than this share of the largest distance are not looked into: it would
/// have to rise severalfold inside of them.
const PLAUSIBLE: f32 = 0.6;
/// Where subdivision stops early, the bound is at most this many times the largest distance measured: the parts with the
/// largest bounds were measured first, and none was worse.
const UNREFINED: f32 = 1.5;
/// Spokes of a fan that a line may cross before its bound becomes a crude one.
const MAX_FAN_STEPS: usize = 8;
/// Largest distance of a point of a triangle from its nearest corner, in longest edges: below `1 / sqrt(3)`.
const FARTHEST_FROM_CORNERS: f32 = 0.578;
/// Distances above this many root mean squares are searched for more thoroughly.
const LARGE: f32 = 4.0;
/// A bound this close above the largest distance known is not refined.
const GOOD_ENOUGH: f32 = 1.25;
/// Sums run over blocks of this many, the same on any number of threads.
const BLOCK: usize = 1 << 14;
/// No coarse triangle: the component has vanished.
const NONE: u32 = u32::MAX;

/// A surface, the input or a finer level, and a level of it. "Input" stands for the finer one of the two below.
pub struct LevelPair<'a> {
    /// Grid points.
    pub positions: &'a [[i32; 3]],
    /// Input triangles.
    pub triangles: &'a [[u32; 3]],
    /// Input triangles around positions.
    pub fine: &'a Fans,
    /// Cluster of each input triangle.
    pub cluster_of: &'a [u32],
    /// Coarse triangles over the same positions.
    pub coarse: &'a [[u32; 3]],
    /// Coarse triangles around positions.
    pub fans: &'a Fans,
    /// Cluster of each coarse triangle.
    pub coarse_cluster_of: &'a [u32],
    /// What each position collapsed into at this level.
    pub ancestors: &'a [u32],
    /// True for positions on an open border of the mesh.
    pub open: &'a [bool],
}

/// Distances between the input and a level, grid quanta.
#[derive(Clone, Debug)]
pub struct Deviation {
    /// Upper bound per cluster, both directions.
    pub max: Vec<f32>,
    /// Area-weighted sum of squared distances at the input's positions, and the area.
    pub squares: (f64, f64),
}

/// A point of the input and its image on the coarse surface.
#[derive(Clone, Copy)]
struct Mapped {
    at: Vec3,
    image: Vec3,
    distance: f32,
    triangle: u32,
}

/// The nearest point so far of a walk, and the corners of its triangle that it hangs on, as bits.
struct Nearest {
    at: Vec3,
    image: Vec3,
    square: f32,
    triangle: u32,
    corners: u8,
}

/// Measures one level. `clusters` is the number of clusters; `progress` gets the share that is done.
pub fn measure(pair: &LevelPair, clusters: usize, progress: &(dyn Fn(f32) + Sync)) -> Deviation {
    let facets = facets(pair);
    let field = Field { pair, fans: pair.fans, facets: &facets };
    let nearest = field.nearest();
    progress(NEAREST_SHARE);
    let (starts, own) = group(clusters, pair.cluster_of.as_chunks::<1>().0);
    let own = |c: usize| &own[starts[c] as usize..starts[c + 1] as usize];
    let way_there = |done| progress(NEAREST_SHARE + done * (BACK_SHARE - NEAREST_SHARE));
    let counted = share_of(clusters, &way_there);
    let share = |c: usize| counted(field.share(c as u32, own(c), &nearest));
    let shares: Vec<Share> = (0..clusters).into_par_iter().map(share).collect();
    let others = foreign(&shares);
    let mut max: Vec<f32> =
        (0..clusters).into_par_iter().map(|c| field.cluster_bound(&shares[c], &others[c], &nearest)).collect();
    let all = |c: u32| own(c as usize).iter().chain(&others[c as usize]);
    let way_back = |done| progress(BACK_SHARE + done * (1.0 - BACK_SHARE));
    let back = field.sampled_back(&max, &nearest, &all, &way_back);
    back.into_iter().zip(pair.coarse_cluster_of).for_each(|(d, &c)| max[c as usize] = max[c as usize].max(d));
    progress(1.0);
    let squares = shares.iter().fold((0.0, 0.0), |sum, s| (sum.0 + s.squares.0, sum.1 + s.squares.1));
    Deviation { max, squares }
}

/// The coarse triangles, each after its first corner.
fn facets(pair: &LevelPair) -> Vec<([i32; 3], Facet)> {
    let facet = |t: &[u32; 3]| {
        let [b, c] = [t[1], t[2]].map(|v| relative(pair.positions, t[0], v));
        (pair.positions[t[0] as usize], Facet::new(b, c))
    };
    pair.coarse.par_iter().map(facet).collect()
}

/// What one look at the input triangles of a cluster tells.
struct Share {
    /// Largest distance of a corner.
    floor: f32,
    /// Triangles that [`Field::whole`] may find a part in: the others' corners are too near, see [`PLAUSIBLE`].
    candidates: Vec<u32>,
    /// Those that map onto other clusters also, each with that cluster.
    abroad: Vec<(u32, u32)>,
    /// Area-weighted sum of squared distances, and the area.
    squares: (f64, f64),
}

/// The input triangles of other clusters that map onto each cluster, ascending.
fn foreign(shares: &[Share]) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); shares.len()];
    shares.iter().flat_map(|s| &s.abroad).for_each(|&(c, t)| lists[c as usize].push(t));
    lists.par_iter_mut().for_each(|list| list.sort_unstable());
    lists
}

/// Over positions.
fn root_mean_square(nearest: &[(f32, u32)]) -> f32 {
    let block = |b: &[(f32, u32)]| b.iter().map(|n| f64::from(n.0 * n.0)).sum::<f64>();
    let sums: Vec<f64> = nearest.par_chunks(BLOCK).map(block).collect();
    (sums.iter().sum::<f64>() / nearest.len() as f64).sqrt() as f32
}

/// Position of `v` relative to position `origin`, quanta: the difference is exact before it is rounded. The grid spans
/// less than 2^31 quanta, so it does not overflow.
fn relative(positions: &[[i32; 3]], origin: u32, v: u32) -> Vec3 {
    difference(positions[v as usize], positions[origin as usize])
}

/// From `o` to `p`, quanta.
fn difference(p: [i32; 3], o: [i32; 3]) -> Vec3 {
    Vec3::new((p[0] - o[0]) as f32, (p[1] - o[1]) as f32, (p[2] - o[2]) as f32)
}

/// Nearest points on a level, searched locally.
struct Field<'a> {
    pair: &'a LevelPair<'a>,
    fans: &'a Fans,
    /// The coarse triangles, each after its first corner.
    facets: &'a [([i32; 3], Facet)],
}

impl Field<'_> {
    /// Distance of every input position to the coarse surface, and the triangle it is nearest to.
    fn nearest(&self) -> Vec<(f32, u32)> {
        let positions = 0..self.pair.positions.len() as u32;
        let mut nearest: Vec<(f32, u32)> = positions.into_par_iter().map(|v| self.nearest_of(v)).collect();
        let large = root_mean_square(&nearest) * LARGE;
        nearest.par_iter_mut().enumerate().filter(|(_, n)| n.0 > large && n.1 != NONE).for_each(|(v, n)| {
            let image = closest_on_triangle(Vec3::ZERO, self.corners(v as u32, n.1));
            let from = Mapped { at: Vec3::ZERO, image, distance: n.0, triangle: n.1 };
            let better = self.walk_on(v as u32, from);
            *n = (better.distance, better.triangle);
        });
        nearest
    }

    /// Distance of input position `v` to the coarse surface, and the triangle it is nearest to.
    fn nearest_of(&self, v: u32) -> (f32, u32) {
        if self.pair.fine.around(v).is_empty() {
            return (0.0, NONE);
        }
        let a = self.pair.ancestors[v as usize];
        match self.fans.around(a) {
            [] => (relative(self.pair.positions, v, a).length(), NONE),
            around if a == v => (0.0, around[0]),
            around => {
                let m = self.walk(v, Vec3::ZERO, around, a);
                (m.distance, m.triangle)
            }
        }
    }

    /// Walks from `start` triangles downhill to the nearest point of the surface. `at` is relative to position
    /// `origin`. Done where the nearest point lies inside a triangle, or on a vertex or edge all of whose triangles
    /// were looked at. `center` is the vertex whose fan `start` is, if it is one.
    fn walk(&self, origin: u32, at: Vec3, start: &[u32], center: u32) -> Mapped {
        let mut best = Nearest { at, image: at, square: f32::INFINITY, triangle: NONE, corners: 0 };
        let mut seen = [center; MAX_WALK + 1];
        self.improve(origin, start, &mut best);
        for step in 0..MAX_WALK {
            let t = self.pair.coarse[best.triangle as usize];
            let mut touched = (0..3).filter(|k| best.corners >> k & 1 != 0).map(|k| t[k]);
            if best.corners == 7 || touched.clone().any(|v| seen.contains(&v)) {
                break;
            }
            let v = touched.next().expect("a nearest point lies on some corner, edge or face");
            seen[step + 1] = v;
            self.improve(origin, self.fans.around(v), &mut best);
        }
        Mapped { at, image: best.image, distance: best.square.sqrt(), triangle: best.triangle }
    }

    /// The same from `best`, but done only when no triangle around the current one is nearer: slower, and rarely
    /// held up by a fold.
    fn walk_on(&self, origin: u32, from: Mapped) -> Mapped {
        let square = from.distance * from.distance;
        let mut best = Nearest { at: from.at, image: from.image, square, triangle: from.triangle, corners: 7 };
        for _ in 0..MAX_WALK {
            let now = best.triangle;
            for v in self.pair.coarse[now as usize] {
                self.improve(origin, self.fans.around(v), &mut best);
            }
            if best.triangle == now {
                break;
            }
        }
        Mapped { at: best.at, image: best.image, distance: best.square.min(square).sqrt(), triangle: best.triangle }
    }

    /// Looks for a nearer point on these triangles, four at a time.
    fn improve(&self, origin: u32, triangles: &[u32], best: &mut Nearest) {
        let origin = self.pair.positions[origin as usize];
        for group in triangles.chunks(4) {
            let lane = |l: usize| &self.facets[group[l.min(group.len() - 1)] as usize];
            let facets = [0, 1, 2, 3].map(lane);
            let from = facets.map(|f| difference(f.0, origin));
            let four = closest_of_four(facets.map(|f| &f.1), from.map(|corner| best.at - corner));
            let square = four.squares.min_element();
            if square < best.square {
                let lane = (0..4).find(|&l| four.squares[l] == square).expect("the smallest is one of them");
                let (offset, corners) = four.lane(lane);
                let triangle = group[lane];
                *best = Nearest { at: best.at, image: from[lane] + offset, square, triangle, corners };
            }
        }
    }

    fn corners(&self, origin: u32, t: u32) -> [Vec3; 3] {
        self.pair.coarse[t as usize].map(|v| relative(self.pair.positions, origin, v))
    }

    /// One look at the input triangles `own` of cluster `c`.
    fn share(&self, c: u32, own: &[u32], nearest: &[(f32, u32)]) -> Share {
        let mut share = Share { floor: 0.0, candidates: Vec::new(), abroad: Vec::new(), squares: (0.0, 0.0) };
        for &t in own {
            let corners = self.pair.triangles[t as usize];
            let images = corners.map(|v| nearest[v as usize]);
            let most = images.iter().map(|i| i.0).fold(0.0, f32::max);
            share.floor = share.floor.max(most).max(self.borders_distance(corners, images.map(|i| i.0)));
            if most >= share.floor * GOOD_ENOUGH * PLAUSIBLE {
                share.candidates.push(t);
            }
            let on = images.map(|(distance, on)| match on {
                NONE => c,
                on if distance > 0.0 => self.pair.coarse_cluster_of[on as usize],
                _ => c,
            });
            (0..3).filter(|&k| on[k] != c && !on[..k].contains(&on[k])).for_each(|k| share.abroad.push((on[k], t)));
            let (square, area) = self.weighted_square(corners, images);
            share.squares = (share.squares.0 + square, share.squares.1 + area);
        }
        share
    }

    /// The mean squared distance of the corners of an input triangle times its area, and the area.
    fn weighted_square(&self, corners: [u32; 3], images: [(f32, u32); 3]) -> (f64, f64) {
        let edge = |k: usize| relative(self.pair.positions, corners[0], corners[k]);
        let area = f64::from(edge(1).cross(edge(2)).length()) * 0.5;
        (images.iter().map(|i| f64::from(i.0).powi(2)).sum::<f64>() / 3.0 * area, area)
    }

    /// Bound over the input triangles of a cluster and `others` that map onto it: branch and bound, the part with the
    /// largest bound first.
    fn cluster_bound(&self, share: &Share, others: &[u32], nearest: &[(f32, u32)]) -> f32 {
        let mut floor = share.floor;
        for t in others.iter().map(|&t| self.pair.triangles[t as usize]) {
            let distances = t.map(|v| nearest[v as usize].0);
            floor = distances.into_iter().fold(floor, f32::max).max(self.borders_distance(t, distances));
        }
        let mut parts: BinaryHeap<Part> = share
            .candidates
            .iter()
            .chain(others)
            .filter_map(|&t| self.whole(self.pair.triangles[t as usize], nearest, floor * GOOD_ENOUGH))
            .filter(|part| part.bound > floor * GOOD_ENOUGH)
            .collect();
        for _ in 0..MAX_SPLITS {
            match parts.pop() {
                Some(part) if part.bound > floor * GOOD_ENOUGH => {
                    for piece in self.split(&part) {
                        floor = piece.corners.iter().map(|c| c.distance).fold(floor, f32::max);
                        if piece.bound > floor * GOOD_ENOUGH {
                            parts.push(piece);
                        }
                    }
                }
                top => return top.map_or(floor, |part| part.bound.max(floor)).max(floor * GOOD_ENOUGH),
            }
        }
        parts.pop().map_or(floor, |part| part.bound.min(floor * UNREFINED)).max(floor * GOOD_ENOUGH)
    }

    /// An input triangle whose corners land on several coarse triangles, if its bound can be above `floor`.
    fn whole(&self, t: [u32; 3], nearest: &[(f32, u32)], floor: f32) -> Option<Part> {
        let images = t.map(|v| nearest[v as usize]);
        let most = images.iter().map(|i| i.0).fold(0.0, f32::max);
        if most < floor * PLAUSIBLE || images.iter().any(|i| i.1 == NONE) {
            return None;
        }
        let at: [Vec3; 3] = std::array::from_fn(|k| relative(self.pair.positions, t[0], t[k]));
        if most + farthest_from_corners(at) <= floor || self.common_triangle(t, images.map(|i| i.1)) {
            return None;
        }
        let corners = std::array::from_fn(|k| {
            let at = at[k];
            let image = closest_on_triangle(at, self.corners(t[0], images[k].1));
            Mapped { at, image, distance: images[k].0, triangle: images[k].1 }
        });
        Some(self.part(t[0], corners))
    }

    fn part(&self, origin: u32, corners: [Mapped; 3]) -> Part {
        let most = corners.iter().map(|c| c.distance).fold(0.0, f32::max);
        let rise = self.sag(origin, &corners).min(farthest_from_corners(corners.map(|c| c.at)));
        Part { bound: most + rise, origin, corners }
    }

    fn split(&self, part: &Part) -> [Part; 4] {
        let [a, b, c] = part.corners;
        let middle = |p: &Mapped, q: &Mapped| {
            let quick = self.walk(part.origin, (p.at + q.at) * 0.5, &[p.triangle, q.triangle], NONE);
            self.walk_on(part.origin, quick)
        };
        let (ab, bc, ca) = (middle(&a, &b), middle(&b, &c), middle(&c, &a));
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].map(|corners| self.part(part.origin, corners))
    }

    /// Do all corners land on one triangle? A survivor lies on every triangle around it.
    fn common_triangle(&self, t: [u32; 3], on: [u32; 3]) -> bool {
        on.iter().any(|&c| {
            let holds = |k: usize| {
                on[k] == c || self.pair.ancestors[t[k] as usize] == t[k] && self.pair.coarse[c as usize].contains(&t[k])
            };
            (0..3).all(holds)
        })
    }

    /// How far the straight image of a triangle leaves the coarse surface.
    fn sag(&self, origin: u32, corners: &[Mapped; 3]) -> f32 {
        let mut most = 0f32;
        for k in 0..3 {
            let (p, q) = (&corners[k], &corners[(k + 1) % 3]);
            if p.triangle != q.triangle {
                most = most.max(self.edge_sag(origin, p, q));
            }
        }
        if most > 0.0 {
            let image = corners.map(|c| c.image);
            for v in self.pair.coarse[corners[0].triangle as usize] {
                if corners[1..].iter().all(|c| self.pair.coarse[c.triangle as usize].contains(&v)) {
                    let apex = relative(self.pair.positions, origin, v);
                    if let Some(height) = height_over(apex, image) {
                        most = most.max(height);
                    }
                }
            }
        }
        most
    }

    /// How far the straight line between two images leaves the surface: its distance from the edges it crosses.
    fn edge_sag(&self, origin: u32, p: &Mapped, q: &Mapped) -> f32 {
        // No point of a short triangle is further from its corners than this, nor is one of its image.
        let crude = p.image.distance(q.image).max(p.at.distance(q.at)) * FARTHEST_FROM_CORNERS;
        let (s, t) = (self.pair.coarse[p.triangle as usize], self.pair.coarse[q.triangle as usize]);
        let mut common = s.into_iter().filter(|v| t.contains(v));
        let sag = match (common.next(), common.next()) {
            (Some(a), Some(b)) => {
                let [a, b] = [a, b].map(|v| relative(self.pair.positions, origin, v));
                segment_distance(p.image, q.image, a, b)
            }
            (Some(v), None) => self.fan_sag(origin, p, q, v),
            _ => f32::INFINITY,
        };
        sag.min(crude)
    }

    /// The same when the line stays in the fan of coarse vertex `v`: the largest distance from the spokes between the
    /// two triangles, on the better side around.
    fn fan_sag(&self, origin: u32, p: &Mapped, q: &Mapped, v: u32) -> f32 {
        let center = relative(self.pair.positions, origin, v);
        let around = self.fans.around(v);
        let mut best = f32::INFINITY;
        for side in 1..3 {
            let (mut at, mut most, mut forward) = (p.triangle, 0f32, side);
            for _ in 0..MAX_FAN_STEPS {
                let t = self.pair.coarse[at as usize];
                let k = t.iter().position(|&x| x == v).expect("triangles of the fan hold its centre");
                let spoke = t[(k + forward) % 3];
                let end = relative(self.pair.positions, origin, spoke);
                most = most.max(segment_distance(p.image, q.image, center, end));
                let Some(&next) = around.iter().find(|&&o| o != at && self.pair.coarse[o as usize].contains(&spoke))
                else {
                    break;
                };
                if next == q.triangle {
                    best = best.min(most);
                    break;
                }
                let n = self.pair.coarse[next as usize];
                let nk = n.iter().position(|&x| x == v).expect("the same");
                forward = if n[(nk + 1) % 3] == spoke { 2 } else { 1 };
                at = next;
            }
        }
        best
    }
}

/// How far a point of a triangle is from its nearest corner at most: no distance rises by more in between.
fn farthest_from_corners(t: [Vec3; 3]) -> f32 {
    longest_edge(t) * FARTHEST_FROM_CORNERS
}

fn longest_edge(t: [Vec3; 3]) -> f32 {
    (0..3).map(|k| t[k].distance_squared(t[(k + 1) % 3])).fold(0.0, f32::max).sqrt()
}

/// A part of an input triangle, its images and a bound of its distance, ordered by the bound.
struct Part {
    bound: f32,
    origin: u32,
    corners: [Mapped; 3],
}

impl PartialEq for Part {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Part {}

impl PartialOrd for Part {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Part {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.bound.total_cmp(&other.bound)
    }
}
