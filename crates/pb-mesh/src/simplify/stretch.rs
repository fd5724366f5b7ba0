//! Quadrics over position and texture coordinates (Garland and Heckbert 1998, "Simplifying surfaces with color and texture
//! using quadric error metrics", by wedges as in Hoppe 1999).
//!
//! A triangle continues its texture linearly over space; the square of the distance between that and the texture
//! coordinates of a vertex, on the scale of the surface, is how far texture is stretched or slides there. A seam is a line
//! in the tile that its wedges are to stay on.

use super::charts::Charts;
use super::patch::Patch;
use glam::{Vec2, Vec3};

/// Weight of the lines of seams, times the squared length of their edges.
const SEAM_WEIGHT: f32 = 1.0;
/// Weight of squared stretch against squared distances of the surface: most of what there is to gain
/// is gained at a quarter, for a few percent of distance instead of a sixth.
const TEXTURE_WEIGHT: f32 = 0.25;
/// Texture that changes faster over the surface than this many times its tile's scale counts as if it did not.
const MAX_SLOPE: f32 = 4.0;

/// Sum of squares of linear functions of a position and texture coordinates, both as offsets from the owner, quanta.
#[derive(Clone, Copy)]
pub(super) struct UvQuadric {
    /// Upper triangle of the 5 x 5 form, row by row.
    a: [f32; 15],
    b: [f32; 5],
    c: f32,
}

impl UvQuadric {
    pub const ZERO: Self = UvQuadric { a: [0.0; 15], b: [0.0; 5], c: 0.0 };

    /// Adds the square of `n` times the offset.
    fn add_square(&mut self, n: [f32; 5], weight: f32) {
        let mut k = 0;
        for i in 0..5 {
            for j in i..5 {
                self.a[k] += weight * n[i] * n[j];
                k += 1;
            }
        }
    }

    fn times(&self, x: [f32; 5]) -> [f32; 5] {
        let (mut y, mut k) = ([0.0; 5], 0);
        for i in 0..5 {
            y[i] += self.a[k] * x[i];
            k += 1;
            for j in i + 1..5 {
                y[i] += self.a[k] * x[j];
                y[j] += self.a[k] * x[i];
                k += 1;
            }
        }
        y
    }

    /// The sum at an offset.
    fn at(&self, x: [f32; 5]) -> f32 {
        let y = self.times(x);
        ((0..5).map(|i| x[i] * (y[i] + 2.0 * self.b[i])).sum::<f32>() + self.c).max(0.0)
    }

    /// Adds `other`, whose owner lies at `-x`.
    pub fn add_moved(&mut self, other: &Self, x: [f32; 5]) {
        let y = other.times(x);
        (0..15).for_each(|k| self.a[k] += other.a[k]);
        (0..5).for_each(|i| self.b[i] += other.b[i] + y[i]);
        self.c += other.at(x);
    }
}

/// An offset of position and texture coordinates.
pub(super) fn offset(d: Vec3, uv: Vec2) -> [f32; 5] {
    [d.x, d.y, d.z, uv.x, uv.y]
}

/// The quadrics of all wedges.
pub(super) fn sum(charts: &Charts, triangles: &[[u32; 3]], positions: &[Vec3]) -> Vec<UvQuadric> {
    let mut quadrics = vec![UvQuadric::ZERO; charts.count()];
    let mut edges: Vec<[u32; 2]> = Vec::with_capacity(triangles.len() * 3);
    for t in 0..triangles.len() {
        let wedges = charts.of_triangle(t * 3);
        (0..3).for_each(|k| edges.push([wedges[k], wedges[(k + 1) % 3]]));
    }
    edges.sort_unstable();
    for (t, tri) in triangles.iter().enumerate() {
        let wedges = charts.of_triangle(t * 3);
        let [a, b, c] = tri.map(|v| positions[v as usize]);
        let (ab, ac, area) = (b - a, c - a, (b - a).cross(c - a).length());
        if charts.area(wedges) <= 0 || area == 0.0 {
            continue;
        }
        let uv = wedges.map(|w| charts.uv(w) * charts.unit);
        let (s, t) = ((uv[1] - uv[0]) / (area * area), (uv[2] - uv[0]) / (area * area));
        let (bb, bc, cc) = (ab.dot(ab), ab.dot(ac), ac.dot(ac));
        for k in 0..2 {
            let slope = (ab * (s[k] * cc - t[k] * bc) + ac * (t[k] * bb - s[k] * bc)).clamp_length_max(MAX_SLOPE);
            let mut n = offset(slope, Vec2::ZERO);
            n[3 + k] = -1.0;
            wedges.iter().for_each(|&w| quadrics[w as usize].add_square(n, area));
        }
        for k in 0..3 {
            let (from, to) = (wedges[k], wedges[(k + 1) % 3]);
            let along = (uv[(k + 1) % 3] - uv[k]).normalize_or_zero();
            if edges.binary_search(&[to, from]).is_err() {
                let length = positions[tri[k] as usize].distance_squared(positions[tri[(k + 1) % 3] as usize]);
                for w in [from, to] {
                    quadrics[w as usize].add_square(offset(Vec3::ZERO, along.perp()), length * SEAM_WEIGHT);
                }
            }
        }
    }
    quadrics
}

impl Patch {
    /// Cost of stretch and of moved seams when the fan's centre collapses onto `u`, squared quanta; infinite when a chart
    /// would be torn, zero without textures.
    pub(super) fn stretch(&self, u: u32) -> f32 {
        let Some(charts) = &self.input.charts else { return 0.0 };
        let Some(joined) = charts.joined(&self.fan.spokes, u) else { return f32::INFINITY };
        let v = self.fan.center;
        let d = self.input.positions[u as usize] - self.input.positions[v as usize];
        let square = |p: [u32; 2]| charts.quadrics[p[0] as usize].at(charts.offset(p, d));
        let both = square(joined[0]) + if joined[1][0] == joined[0][0] { 0.0 } else { square(joined[1]) };
        both * self.scale_of(v) * TEXTURE_WEIGHT
    }
}
