//! Measured bounds of the distance between the input and each simplified level.
//!
//! Every input position is mapped to a near point of the coarse surface, found by walking over the triangles
//! around its ancestor. Inside an input triangle whose corners land on one coarse triangle, the distance is
//! convex, so its corners bound it. Where corners land on different coarse triangles, the straight image of
//! the triangle leaves the surface by its sag over the edges in between, which is added; triangles that would
//! raise the bound are subdivided until the sag no longer matters. The map is continuous up to that sag, so
//! the same bound holds from the coarse surface back to the input (cf. Cohen et al. 1998, section 4;
//! Guthe et al. 2005 for the pruning by the largest distance known so far).

use crate::topology::Fans;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Rounds of walking to better triangles from the first guess.
const MAX_WALK: usize = 4;
/// Subdivisions of an input triangle at most.
const MAX_DEPTH: u32 = 3;
/// A bound this close above the largest distance known is not refined.
const GOOD_ENOUGH: f32 = 1.05;
/// No coarse triangle: the component has vanished.
const NONE: u32 = u32::MAX;

/// Input surface and one level of it.
pub struct LevelPair<'a> {
    /// Grid points.
    pub positions: &'a [[i32; 3]],
    /// Input triangles.
    pub triangles: &'a [[u32; 3]],
    /// Cluster of each input triangle.
    pub cluster_of: &'a [u32],
    /// Coarse triangles over the same positions.
    pub coarse: &'a [[u32; 3]],
    /// Cluster of each coarse triangle.
    pub coarse_cluster_of: &'a [u32],
    /// What each position collapsed into at this level.
    pub ancestors: &'a [u32],
    /// True for positions on an open border of the mesh.
    pub open: &'a [bool],
    /// Connected component of each position.
    pub components: &'a [u32],
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

/// Measures one level. `clusters` is the number of clusters.
pub fn measure(pair: &LevelPair, clusters: usize) -> Deviation {
    let fans = Fans::new(pair.positions.len(), pair.coarse);
    let field = Field { pair, fans: &fans };
    let nearest: Vec<(f32, u32)> =
        (0..pair.positions.len() as u32).into_par_iter().map(|v| field.nearest_of(v)).collect();
    let max: Vec<AtomicU32> = (0..clusters).map(|_| AtomicU32::new(0)).collect();
    let raise = |c: u32, d: f32| max[c as usize].fetch_max(d.to_bits(), Ordering::Relaxed);
    pair.triangles.par_iter().zip(pair.cluster_of).for_each(|(t, &c)| {
        let d = t.iter().map(|&v| nearest[v as usize].0.max(field.border_distance(v))).fold(0.0, f32::max);
        if d > 0.0 {
            raise(c, d);
            for &v in t {
                if nearest[v as usize].1 != NONE {
                    raise(pair.coarse_cluster_of[nearest[v as usize].1 as usize], d);
                }
            }
        }
    });
    let floor: Vec<f32> = max.iter().map(|m| f32::from_bits(m.load(Ordering::Relaxed))).collect();
    pair.triangles.par_iter().zip(pair.cluster_of).for_each(|(t, &c)| {
        let bound = field.triangle_bound(*t, &nearest, floor[c as usize]);
        if bound > floor[c as usize] {
            raise(c, bound);
            t.iter().filter(|&&v| nearest[v as usize].1 != NONE).for_each(|&v| {
                raise(pair.coarse_cluster_of[nearest[v as usize].1 as usize], bound);
            });
        }
    });
    let squares = squares(pair, &nearest);
    Deviation { max: max.into_iter().map(|m| f32::from_bits(m.into_inner())).collect(), squares }
}

/// Fixed blocks keep the order of the sums the same on any number of threads.
fn squares(pair: &LevelPair, nearest: &[(f32, u32)]) -> (f64, f64) {
    const BLOCK: usize = 1 << 14;
    let parts: Vec<(f64, f64)> = pair
        .triangles
        .par_chunks(BLOCK)
        .map(|block| {
            block.iter().fold((0.0, 0.0), |sum, t| {
                let [a, b, c] = t.map(|v| relative(pair.positions, t[0], v));
                let area = f64::from((b - a).cross(c - a).length()) * 0.5;
                let mean = t.iter().map(|&v| f64::from(nearest[v as usize].0).powi(2)).sum::<f64>() / 3.0;
                (sum.0 + mean * area, sum.1 + area)
            })
        })
        .collect();
    parts.into_iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1))
}

/// Position of `v` relative to position `origin`, quanta: the difference is exact before it is rounded.
fn relative(positions: &[[i32; 3]], origin: u32, v: u32) -> Vec3 {
    let (o, p) = (positions[origin as usize], positions[v as usize]);
    Vec3::from_array(std::array::from_fn(|k| (i64::from(p[k]) - i64::from(o[k])) as f32))
}

/// Nearest points on a level, searched locally.
struct Field<'a> {
    pair: &'a LevelPair<'a>,
    fans: &'a Fans,
}

impl Field<'_> {
    /// Distance of input position `v` to the coarse surface, and the triangle it is nearest to.
    fn nearest_of(&self, v: u32) -> (f32, u32) {
        let a = self.pair.ancestors[v as usize];
        if self.pair.components[a as usize] != self.pair.components[v as usize] {
            return (0.0, NONE);
        }
        match self.fans.around(a) {
            [] => (relative(self.pair.positions, v, a).length(), NONE),
            around if a == v => (0.0, around[0]),
            around => {
                let m = self.walk(v, Vec3::ZERO, around);
                (m.distance, m.triangle)
            }
        }
    }

    /// Walks from `start` triangles to the one nearest to `at`, which is relative to position `origin`.
    fn walk(&self, origin: u32, at: Vec3, start: &[u32]) -> Mapped {
        let mut best = Mapped { at, image: at, distance: f32::INFINITY, triangle: NONE };
        let mut around = start;
        let mut seen = [NONE; 3 * MAX_WALK];
        let mut seen_count = 0;
        self.improve(origin, around, &mut best);
        for _ in 0..MAX_WALK {
            let from = best.triangle;
            for v in self.pair.coarse[from as usize] {
                if seen[..seen_count].contains(&v) || seen_count == seen.len() {
                    continue;
                }
                seen[seen_count] = v;
                seen_count += 1;
                around = self.fans.around(v);
                self.improve(origin, around, &mut best);
            }
            if best.triangle == from {
                break;
            }
        }
        best
    }

    fn improve(&self, origin: u32, triangles: &[u32], best: &mut Mapped) {
        for &t in triangles {
            let p = self.corners(origin, t);
            let q = closest_on_triangle(best.at, p);
            let d = q.distance(best.at);
            if d < best.distance {
                *best = Mapped { at: best.at, image: q, distance: d, triangle: t };
            }
        }
    }

    fn corners(&self, origin: u32, t: u32) -> [Vec3; 3] {
        self.pair.coarse[t as usize].map(|v| relative(self.pair.positions, origin, v))
    }

    /// Distance of a position on an open border to the border of the level; 0 for others.
    fn border_distance(&self, v: u32) -> f32 {
        let a = self.pair.ancestors[v as usize];
        if !self.pair.open[v as usize] || a == v || self.pair.components[a as usize] != self.pair.components[v as usize]
        {
            return 0.0;
        }
        let from = relative(self.pair.positions, v, a);
        let around = self.fans.around(a);
        let others = |t: u32| self.pair.coarse[t as usize].into_iter().filter(|&x| x != a);
        let mut best = f32::INFINITY;
        for &t in around {
            for x in others(t) {
                if around.iter().filter(|&&o| others(o).any(|y| y == x)).count() == 1 {
                    let q = closest_on_segment(Vec3::ZERO, from, relative(self.pair.positions, v, x));
                    best = best.min(q.length());
                }
            }
        }
        if best.is_finite() { best } else { from.length() }
    }

    /// Bound over a whole input triangle; exact enough once it is no more than `floor`.
    fn triangle_bound(&self, t: [u32; 3], nearest: &[(f32, u32)], floor: f32) -> f32 {
        let images = t.map(|v| nearest[v as usize]);
        let most = images.iter().map(|i| i.0).fold(0.0, f32::max);
        if images.iter().any(|i| i.1 == NONE) || self.common_triangle(t, images.map(|i| i.1)) {
            return most;
        }
        let corners = std::array::from_fn(|k| {
            let at = relative(self.pair.positions, t[0], t[k]);
            let image = closest_on_triangle(at, self.corners(t[0], images[k].1));
            Mapped { at, image, distance: images[k].0, triangle: images[k].1 }
        });
        self.refine(t[0], corners, floor, 0)
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

    fn refine(&self, origin: u32, corners: [Mapped; 3], floor: f32, depth: u32) -> f32 {
        let most = corners.iter().map(|c| c.distance).fold(0.0, f32::max);
        let bound = most + self.sag(origin, &corners);
        if bound <= floor * GOOD_ENOUGH || depth == MAX_DEPTH || bound <= most * GOOD_ENOUGH {
            return bound;
        }
        let [a, b, c] = corners;
        let middle = |p: &Mapped, q: &Mapped| self.walk(origin, (p.at + q.at) * 0.5, &[p.triangle, q.triangle]);
        let (ab, bc, ca) = (middle(&a, &b), middle(&b, &c), middle(&c, &a));
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            .into_iter()
            .map(|part| self.refine(origin, part, floor, depth + 1))
            .fold(0.0, f32::max)
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

    fn edge_sag(&self, origin: u32, p: &Mapped, q: &Mapped) -> f32 {
        let (s, t) = (self.pair.coarse[p.triangle as usize], self.pair.coarse[q.triangle as usize]);
        let mut common = s.into_iter().filter(|v| t.contains(v)).map(|v| relative(self.pair.positions, origin, v));
        match (common.next(), common.next()) {
            (Some(a), Some(b)) => segment_distance(p.image, q.image, a, b),
            (Some(a), None) => closest_on_segment(a, p.image, q.image).distance(a),
            _ => p.image.distance(q.image) * 0.5,
        }
    }
}

/// Point of triangle `t` nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5).
pub fn closest_on_triangle(p: Vec3, t: [Vec3; 3]) -> Vec3 {
    let [a, b, c] = t;
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3).max(f32::MIN_POSITIVE));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6).max(f32::MIN_POSITIVE));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f32::MIN_POSITIVE));
    }
    let denominator = 1.0 / (va + vb + vc);
    a + ab * (vb * denominator) + ac * (vc * denominator)
}

fn closest_on_segment(p: Vec3, a: Vec3, b: Vec3) -> Vec3 {
    let d = b - a;
    let l = d.length_squared();
    if l > 0.0 { a + d * ((p - a).dot(d) / l).clamp(0.0, 1.0) } else { a }
}

/// Distance between two segments, by alternating projection from the crossing of their lines.
fn segment_distance(p: Vec3, q: Vec3, a: Vec3, b: Vec3) -> f32 {
    let (d1, d2, r) = (q - p, b - a, p - a);
    let (l1, l2, f, c, m) = (d1.length_squared(), d2.length_squared(), d2.dot(r), d1.dot(r), d1.dot(d2));
    let denominator = l1 * l2 - m * m;
    let s = if denominator > 0.0 { ((m * f - c * l2) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let on_b = closest_on_segment(p + d1 * s, a, b);
    let on_a = closest_on_segment(on_b, p, q);
    closest_on_segment(on_a, a, b).distance(on_a)
}

/// Height of `p` over a triangle if its foot lies inside.
fn height_over(p: Vec3, t: [Vec3; 3]) -> Option<f32> {
    let n = (t[1] - t[0]).cross(t[2] - t[0]).try_normalize()?;
    let inside = (0..3).all(|k| (t[(k + 1) % 3] - t[k]).cross(p - t[k]).dot(n) >= 0.0);
    inside.then(|| (p - t[0]).dot(n).abs())
}
