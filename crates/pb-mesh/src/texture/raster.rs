//! Which texel centres lie in a triangle, and which lie near an edge, in integers of a tile.
//!
//! Coordinates are units of 1 / 65536 of the tile. A grid of `size` texels has the centre of texel k at
//! `(2 k + 1) 32768 / size`, an integer.

use crate::charts::tile_area2;

/// A grid of square texels over a tile.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// Texels per side, a power of two from 1 to 32768.
    pub size: u32,
}

impl Grid {
    /// Units per texel.
    pub fn pitch(self) -> i64 {
        65536 / i64::from(self.size)
    }

    /// Unit coordinate of the centre of column or row k.
    pub fn centre(self, k: u32) -> i64 {
        i64::from(k) * self.pitch() + self.pitch() / 2
    }

    /// The columns whose centres lie in `[low, high]`, units.
    fn columns(self, low: i64, high: i64) -> std::ops::Range<u32> {
        let (half, pitch, last) = (self.pitch() / 2, self.pitch(), i64::from(self.size));
        let first = (low - half).div_euclid(pitch) + i64::from((low - half).rem_euclid(pitch) != 0);
        let end = (high - half).div_euclid(pitch) + 1;
        first.clamp(0, last) as u32..end.clamp(0, last) as u32
    }

    /// Calls `hit(x, y)` for every texel whose centre is in the triangle or on its edge, row by row.
    pub fn inside(self, corners: [[u16; 2]; 3], mut hit: impl FnMut(u32, u32)) {
        let c = oriented(corners);
        let ys = c.map(|p| p[1]);
        let (low, high) = (ys[0].min(ys[1]).min(ys[2]), ys[0].max(ys[1]).max(ys[2]));
        let xs = c.map(|p| p[0]);
        let full = (xs[0].min(xs[1]).min(xs[2]), xs[0].max(xs[1]).max(xs[2]));
        if tile_area2(corners) == 0 {
            return;
        }
        for y in self.columns(low, high) {
            let v = self.centre(y);
            let (mut from, mut to) = full;
            for k in 0..3 {
                let (a, b) = (c[k], c[(k + 1) % 3]);
                // inside: slope * x <= limit
                let slope = b[1] - a[1];
                let limit = slope * a[0] + (b[0] - a[0]) * (v - a[1]);
                match slope.signum() {
                    1 => to = to.min(limit.div_euclid(slope)),
                    -1 => from = from.max(-limit.div_euclid(-slope)),
                    _ if limit < 0 => to = from - 1,
                    _ => {}
                }
            }
            if from <= to {
                self.columns(from, to).for_each(|x| hit(x, y));
            }
        }
    }

    /// Calls `hit(x, y, distance)` for every texel whose centre is at most `reach` texels from the edge; maximum
    /// norm, distances in texels.
    pub fn near_edge(self, a: [u16; 2], b: [u16; 2], reach: f64, mut hit: impl FnMut(u32, u32, f32)) {
        let (a, b) = (a.map(f64::from), b.map(f64::from));
        let radius = reach * self.pitch() as f64;
        let (low, high) = (a[1].min(b[1]) - radius, a[1].max(b[1]) + radius);
        for y in self.columns(low.ceil() as i64, high.floor() as i64) {
            let v = self.centre(y) as f64;
            let Some((from, to)) = span(a, b, v - radius, v + radius) else { continue };
            for x in self.columns((from - radius).ceil() as i64, (to + radius).floor() as i64) {
                let distance = chebyshev([self.centre(x) as f64, v], a, b) / self.pitch() as f64;
                if distance <= reach {
                    hit(x, y, distance as f32);
                }
            }
        }
    }
}

fn oriented(c: [[u16; 2]; 3]) -> [[i64; 2]; 3] {
    let order = if tile_area2(c) < 0 { [c[0], c[2], c[1]] } else { c };
    order.map(|p| p.map(i64::from))
}

/// Smallest and largest x of the part of a segment whose y is in `[low, high]`.
fn span(a: [f64; 2], b: [f64; 2], low: f64, high: f64) -> Option<(f64, f64)> {
    let (top, bottom) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    if bottom[1] < low || top[1] > high {
        return None;
    }
    let height = bottom[1] - top[1];
    let at = |y: f64| if height > 0.0 { top[0] + (bottom[0] - top[0]) * ((y - top[1]) / height) } else { top[0] };
    let (p, q) = if height > 0.0 { (at(low.max(top[1])), at(high.min(bottom[1]))) } else { (top[0], bottom[0]) };
    Some((p.min(q), p.max(q)))
}

/// Distance of a point to a segment in the maximum norm.
fn chebyshev(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (x, y, dx, dy) = (a[0] - p[0], a[1] - p[1], b[0] - a[0], b[1] - a[1]);
    // |x + t dx| and |y + t dy| cross, or are zero, at these t; their maximum is least at one of them or at an end
    let turns = [(-x, dx), (-y, dy), (y - x, dx - dy), (-x - y, dx + dy)];
    let at = |t: f64| (x + t * dx).abs().max((y + t * dy).abs());
    let ends = at(0.0).min(at(1.0));
    turns.iter().filter(|(_, d)| *d != 0.0).map(|(n, d)| at((n / d).clamp(0.0, 1.0))).fold(ends, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covered(size: u32, corners: [[u16; 2]; 3]) -> Vec<(u32, u32)> {
        let mut texels = Vec::new();
        Grid { size }.inside(corners, |x, y| texels.push((x, y)));
        texels
    }

    #[test]
    fn a_triangle_covers_exactly_the_centres_that_its_edges_hold() {
        let corners = [[3000, 2000], [60000, 9000], [20000, 65535]];
        for corners in [corners, [corners[0], corners[2], corners[1]]] {
            let grid = Grid { size: 64 };
            let c = oriented(corners);
            let inside = |x: u32, y: u32| {
                (0..3).all(|k| {
                    let (a, b) = (c[k], c[(k + 1) % 3]);
                    (b[0] - a[0]) * (grid.centre(y) - a[1]) - (b[1] - a[1]) * (grid.centre(x) - a[0]) >= 0
                })
            };
            let expected: Vec<_> =
                (0..64).flat_map(|y| (0..64).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y)).collect();
            assert!(expected.len() > 500);
            assert_eq!(covered(64, corners), expected);
        }
    }

    #[test]
    fn flat_triangles_cover_nothing() {
        assert!(covered(8, [[0, 4096], [30000, 4096], [60000, 4096]]).is_empty());
    }

    #[test]
    fn texels_near_an_edge_are_those_within_reach() {
        let (a, b) = ([10000, 50000], [47000, 8000]);
        let grid = Grid { size: 32 };
        let mut found = Vec::new();
        grid.near_edge(a, b, 1.0, |x, y, d| found.push((x, y, d)));
        let (fa, fb) = (a.map(f64::from), b.map(f64::from));
        let mut expected = Vec::new();
        for y in 0..32 {
            for x in 0..32 {
                let p = [grid.centre(x) as f64, grid.centre(y) as f64];
                let at = |t: f64| (0..2).map(|k| (fa[k] + (fb[k] - fa[k]) * t - p[k]).abs()).fold(0.0, f64::max);
                let d = (0..=20_000).map(|i| at(f64::from(i) / 20_000.0)).fold(f64::MAX, f64::min) / 2048.0;
                if d <= 1.0 {
                    expected.push((x, y, d as f32));
                }
            }
        }
        assert_eq!(found.len(), expected.len());
        assert!(found.iter().zip(&expected).all(|(f, e)| (f.0, f.1) == (e.0, e.1) && (f.2 - e.2).abs() < 1e-3));
    }
}
