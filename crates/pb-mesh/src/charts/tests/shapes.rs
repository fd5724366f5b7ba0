//! Surfaces to make charts of.

use crate::charts::ClusterSurface;

/// Positions and triangles.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    pub fn surface(&self) -> ClusterSurface<'_> {
        ClusterSurface { positions: &self.positions, triangles: &self.triangles }
    }

    /// Adds another shape, moved by `by`.
    pub fn add(&mut self, other: &Shape, by: [f32; 3]) {
        let base = self.positions.len() as u32;
        self.positions.extend(other.positions.iter().map(|p| [p[0] + by[0], p[1] + by[1], p[2] + by[2]]));
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + base)));
    }
}

/// A grid of `n[0] x n[1]` quads through `point(i, j)`; `wraps`: the last row or column is the first again.
pub fn grid(n: [u32; 2], wraps: [bool; 2], point: impl Fn(f32, f32) -> [f32; 3]) -> Shape {
    let count = [n[0] + u32::from(!wraps[0]), n[1] + u32::from(!wraps[1])];
    let mut shape = Shape::default();
    for j in 0..count[1] {
        for i in 0..count[0] {
            shape.positions.push(point(i as f32 / n[0] as f32, j as f32 / n[1] as f32));
        }
    }
    let at = |i: u32, j: u32| (j % count[1]) * count[0] + i % count[0];
    for j in 0..n[1] {
        for i in 0..n[0] {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            shape.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    shape
}

/// Numbers in 0..1 that depend on `seed` and `i` only.
pub fn noise(seed: u32, i: u32) -> f32 {
    let mut x = seed.wrapping_mul(0x9E37_79B9) ^ i.wrapping_mul(0x85EB_CA6B) ^ 0x27D4_EB2F;
    for _ in 0..2 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
        x ^= x >> 13;
    }
    (x >> 8) as f32 / (1 << 24) as f32
}

/// Hills of `height` on the unit square, with noise.
pub fn hills(n: u32, height: f32, seed: u32) -> Shape {
    let mut shape = grid([n, n], [false; 2], |u, v| {
        [u, v, height * ((5.0 * u + seed as f32).sin() * (4.0 * v).cos() + 0.2 * (23.0 * u * v).sin())]
    });
    for (i, p) in shape.positions.iter_mut().enumerate() {
        (0..3).for_each(|k| p[k] += 0.3 / n as f32 * noise(seed, 3 * i as u32 + k as u32));
    }
    shape
}

/// A closed ring.
pub fn torus(n: [u32; 2], thick: f32) -> Shape {
    use std::f32::consts::TAU;
    grid(n, [true; 2], |u, v| {
        let r = 1.0 + thick * (TAU * v).cos();
        [r * (TAU * u).cos(), r * (TAU * u).sin(), thick * (TAU * v).sin()]
    })
}

/// A pipe, open at both ends.
pub fn pipe(n: [u32; 2], length: f32) -> Shape {
    use std::f32::consts::TAU;
    grid(n, [true, false], |u, v| [(TAU * u).cos(), (TAU * u).sin(), length * v])
}

/// A flat ring.
pub fn ring(n: [u32; 2]) -> Shape {
    use std::f32::consts::TAU;
    grid(n, [true, false], |u, v| [(1.0 + v) * (TAU * u).cos(), (1.0 + v) * (TAU * u).sin(), 0.0])
}

/// A ramp that goes round `turns` times: seen from above it lies on itself.
pub fn ramp(n: [u32; 2], turns: f32) -> Shape {
    grid(n, [false; 2], |u, v| {
        let (s, c) = (std::f32::consts::TAU * turns * u).sin_cos();
        [(1.0 + v) * c, (1.0 + v) * s, 0.5 * turns * u]
    })
}

/// A closed ball of eight bent triangles, each cut `n` times per side.
pub fn ball(n: u32) -> Shape {
    let mut shape = Shape::default();
    let mut known = std::collections::BTreeMap::new();
    let mut vertex = |shape: &mut Shape, p: [i32; 3]| {
        *known.entry(p).or_insert_with(|| {
            let q = p.map(|c| c as f32);
            let r = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]).sqrt();
            shape.positions.push(q.map(|c| c / r));
            shape.positions.len() as u32 - 1
        })
    };
    let n = n as i32;
    for octant in 0..8 {
        let sign = [1 - 2 * (octant & 1), 1 - (octant & 2), 1 - (octant & 4) / 2];
        for i in 0..n {
            for j in 0..n - i {
                let at = |i: i32, j: i32| [sign[0] * i, sign[1] * j, sign[2] * (n - i - j)];
                let mut faces = vec![[at(i, j), at(i + 1, j), at(i, j + 1)]];
                if i + j + 1 < n {
                    faces.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
                for face in faces {
                    let mut t = face.map(|p| vertex(&mut shape, p));
                    if sign[0] * sign[1] * sign[2] < 0 {
                        t.swap(1, 2);
                    }
                    shape.triangles.push(t);
                }
            }
        }
    }
    shape
}

/// A closed surface with `holes` handles: a plate of unit boxes with every second box of its middle row missing.
pub fn plate_with_holes(holes: u32, fine: u32) -> Shape {
    let mut shape = Shape::default();
    let solid = |i: i32, j: i32| {
        let inside = i >= 0 && i < 2 * holes as i32 + 1 && (0..3).contains(&j);
        inside && !(j == 1 && i % 2 == 1)
    };
    let mut known = std::collections::BTreeMap::new();
    let mut face = |origin: [i32; 3], u: usize, v: usize| {
        let n = fine as i32;
        for a in 0..n {
            for b in 0..n {
                let mut at = |da: i32, db: i32| {
                    let mut p = origin.map(|c| c * n);
                    p[u] += a + da;
                    p[v] += b + db;
                    *known.entry(p).or_insert_with(|| {
                        shape.positions.push(p.map(|c| c as f32 / n as f32));
                        shape.positions.len() as u32 - 1
                    })
                };
                let [p, q, r, s] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                shape.triangles.extend([[p, q, r], [p, r, s]]);
            }
        }
    };
    for i in 0..2 * holes as i32 + 1 {
        for j in (0..3).filter(|&j| solid(i, j)) {
            face([i, j, 1], 0, 1);
            face([i, j, 0], 1, 0);
            for (open, origin, u, v) in [
                (!solid(i - 1, j), [i, j, 0], 2, 1),
                (!solid(i + 1, j), [i + 1, j, 0], 1, 2),
                (!solid(i, j - 1), [i, j, 0], 0, 2),
                (!solid(i, j + 1), [i, j + 1, 0], 2, 0),
            ] {
                if open {
                    face(origin, u, v);
                }
            }
        }
    }
    shape
}

/// A band with half a twist: one edge across must stay a border.
pub fn moebius(n: u32) -> Shape {
    use std::f32::consts::{PI, TAU};
    let mut shape = grid([n, 4], [false; 2], |u, v| {
        let (s, c) = (PI * u).sin_cos();
        let r = 1.0 + 0.6 * (v - 0.5) * c;
        [r * (TAU * u).cos(), r * (TAU * u).sin(), 0.6 * (v - 0.5) * s]
    });
    // The last column is the first, upside down.
    let row = n + 1;
    shape.triangles.iter_mut().flatten().filter(|v| **v % row == n).for_each(|v| *v = (4 - *v / row) * row);
    shape
}

/// Three sheets that meet in one line.
pub fn three_sheets(n: u32) -> Shape {
    let mut shape = Shape::default();
    for k in 0..3 {
        let (s, c) = (2.0 * k as f32).sin_cos();
        shape.add(&grid([n, n], [false; 2], |u, v| [u * c, u * s, v]), [0.0; 3]);
    }
    let count = (n + 1) * (n + 1);
    for v in shape.triangles.iter_mut().flatten().filter(|v| **v % (n + 1) == 0) {
        *v %= count;
    }
    shape
}

/// Triangles that have nothing in common, of any shape and some without area.
pub fn confetti(count: u32, seed: u32) -> Shape {
    let mut shape = Shape::default();
    for t in 0..count {
        for k in 0..3 {
            let flat = if t % 5 == 0 { 0.0 } else { 1.0 };
            let p = [0, 1, 2].map(|a| noise(seed, 9 * t + 3 * k + a));
            shape.positions.push([p[0], p[1] * flat, p[2] * flat]);
        }
        shape.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
    }
    shape
}
