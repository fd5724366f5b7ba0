//! Generated grids cut into charts.

use pb_mesh::segment::{Segmentation, segment};
use pb_mesh::simplify::{Collapses, UnisonInput, UvInput, simplify};
use pb_mesh::topology::{Fans, Kind, classify};
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Of the torus, over its large radius.
const SMALL_RADIUS: f64 = 0.3;

/// How a grid of `n` x `n` quads is cut into charts.
#[derive(Clone, Copy, Debug)]
pub enum Cut {
    /// Strips of so many quads once around, each cut open where it meets itself.
    Strips(u32),
    /// Squares of so many quads.
    Squares(u32),
    /// The same, with a cut from one side to the middle that opens by a third of a quad.
    Darts(u32),
    /// The triangles nearest to each of so many points.
    Cells(u32),
    /// One per triangle.
    Triangles,
    /// No texture: all in one point of the tile.
    Point,
}

/// The surface over the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    Torus,
    HeightField,
    Plane,
}

#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    pub shape: Shape,
    pub n: u32,
    pub cut: Cut,
    pub seed: u32,
    pub cluster: usize,
    /// How far texture coordinates leave the grid at most, quads.
    pub jitter: f64,
    /// Units of texture coordinates per quad.
    pub units: f64,
}

/// As many as the tile allows for grids of up to 180 quads.
pub const FINE: f64 = 350.0;

/// A mesh in clusters and charts.
pub struct Charted {
    pub positions: Vec<[i32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub segmentation: Segmentation,
    pub cluster_of: Vec<u32>,
    pub fans: Fans,
    pub kinds: Vec<Kind>,
    /// Wedges of triangle corners.
    pub corners: Vec<[u32; 3]>,
    pub position_of: Vec<u32>,
    pub uv: Vec<[u16; 2]>,
    pub tile_side: Vec<f32>,
    /// Chart of each wedge, distinct between clusters.
    pub chart_of: Vec<(u32, u32)>,
}

/// A number that looks random, 0 to 1.
pub fn noise(seed: u32, a: u32, b: u32) -> f64 {
    let mut x = seed.wrapping_mul(0x9e37_79b9) ^ a.wrapping_mul(0x85eb_ca6b) ^ b.wrapping_mul(0xc2b2_ae35);
    for _ in 0..3 {
        x = (x ^ x >> 15).wrapping_mul(0x2c1b_3c6d);
    }
    f64::from(x ^ x >> 16) / f64::from(u32::MAX)
}

impl Recipe {
    fn side(&self) -> u32 {
        if self.shape == Shape::Torus { self.n } else { self.n + 1 }
    }

    fn position(&self, i: u32, j: u32) -> [i32; 3] {
        let (x, y) = (f64::from(i) / f64::from(self.n), f64::from(j) / f64::from(self.n));
        let bump =
            (x * TAU * 5.0).sin() * (y * TAU * 3.0).cos() * 0.03 + noise(self.seed, i, j) * 0.2 / f64::from(self.n);
        let p = match self.shape {
            Shape::HeightField => [x, y, bump],
            Shape::Plane => [x, y, 0.0],
            Shape::Torus => {
                let r = SMALL_RADIUS + bump;
                let out = 1.0 + r * (y * TAU).cos();
                [out * (x * TAU).cos(), out * (x * TAU).sin(), r * (y * TAU).sin()]
            }
        };
        p.map(|c| (c * 1e6).round() as i32)
    }

    /// Chart of a triangle of quad (i, j), and the grid point that its texture coordinates are relative to.
    fn chart(&self, i: u32, j: u32, upper: bool) -> (u32, [u32; 2]) {
        match self.cut {
            Cut::Point => (0, [0, 0]),
            Cut::Strips(w) => (j / w, [0, j / w * w]),
            Cut::Squares(w) | Cut::Darts(w) => (i / w * self.n + j / w, [i / w * w, j / w * w]),
            Cut::Triangles => ((i * self.n + j) * 2 + u32::from(upper), [i, j]),
            Cut::Cells(count) => {
                let at = |k: u32, axis: u32| (noise(self.seed + 7, k, axis) * f64::from(self.n)) as u32;
                let (x, y) = (i * 3 + 1 + u32::from(!upper), j * 3 + 1 + u32::from(upper));
                let far = |k: &u32| (at(*k, 0) * 3).abs_diff(x).pow(2) + (at(*k, 1) * 3).abs_diff(y).pow(2);
                ((0..count).min_by_key(far).expect("some cells"), [0, 0])
            }
        }
    }

    /// Tile coordinates of grid point (i, j) in the chart with this origin; `above` a dart or not.
    fn uv(&self, [i, j]: [u32; 2], origin: [u32; 2], above: bool) -> [u16; 2] {
        if matches!(self.cut, Cut::Point) {
            return [77, 99];
        }
        let side = self.side();
        let mut at = [f64::from(i - origin[0]), f64::from(j - origin[1])];
        (0..2).for_each(|k| at[k] += self.jitter * noise(self.seed, i % side, j % side + k as u32 * 999));
        if let Cut::Darts(w) = self.cut
            && above
        {
            at[1] += (f64::from(w / 2) - at[0]).max(0.0) / f64::from(w);
        }
        if self.shape == Shape::Torus {
            at[1] *= SMALL_RADIUS;
        }
        at.map(|c| (c * self.units).round() as u16)
    }

    pub fn build(&self) -> Charted {
        let side = self.side();
        let positions: Vec<[i32; 3]> = (0..side * side).map(|v| self.position(v / side, v % side)).collect();
        let (mut triangles, mut charts) = (Vec::new(), Vec::new());
        for (i, j) in (0..self.n * self.n).map(|q| (q / self.n, q % self.n)) {
            let q = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
            let split = if noise(self.seed + 1, i, j) < 0.5 { [[0, 1, 2], [0, 2, 3]] } else { [[1, 2, 3], [1, 3, 0]] };
            for (k, t) in split.into_iter().enumerate() {
                let (chart, origin) = self.chart(i, j, k == 1);
                triangles.push(t.map(|c| q[c][0] % side * side + q[c][1] % side));
                charts.push(t.map(|c| {
                    let above = matches!(self.cut, Cut::Darts(w) if j - origin[1] >= w / 2);
                    (chart, self.uv(q[c], origin, above))
                }));
            }
        }
        self.assemble(positions, triangles, &charts)
    }

    fn assemble(&self, positions: Vec<[i32; 3]>, triangles: Vec<[u32; 3]>, charts: &[[(u32, [u16; 2]); 3]]) -> Charted {
        let doubles: Vec<[f64; 3]> = positions.iter().map(|p| p.map(f64::from)).collect();
        let segmentation = segment(&doubles, &triangles, &triangles, self.cluster);
        let mut cluster_of = vec![0; triangles.len()];
        for c in 0..segmentation.len() {
            segmentation.cluster(c).iter().for_each(|&t| cluster_of[t as usize] = c as u32);
        }
        let fans = Fans::new(positions.len(), &triangles);
        let kinds = classify(&triangles, &cluster_of, &fans, positions.len()).0;
        let (mut index, mut corners) = (HashMap::new(), Vec::new());
        let (mut position_of, mut uv, mut chart_of) = (Vec::new(), Vec::new(), Vec::new());
        for (t, (tri, chart)) in triangles.iter().zip(charts).enumerate() {
            corners.push(std::array::from_fn(|k| {
                *index.entry((cluster_of[t], tri[k], chart[k])).or_insert_with(|| {
                    position_of.push(tri[k]);
                    uv.push(chart[k].1);
                    chart_of.push((cluster_of[t], chart[k].0));
                    position_of.len() as u32 - 1
                })
            }));
        }
        let around = if self.shape == Shape::Torus { TAU * 1e6 } else { 1e6 };
        let tile_side = vec![(around / f64::from(self.n) / self.units * 65_536.0) as f32; segmentation.len()];
        Charted {
            positions,
            triangles,
            segmentation,
            cluster_of,
            fans,
            kinds,
            corners,
            position_of,
            uv,
            tile_side,
            chart_of,
        }
    }
}

impl Charted {
    pub fn texture(&self) -> UvInput<'_> {
        UvInput { corners: &self.corners, position_of: &self.position_of, uv: &self.uv, tile_side: &self.tile_side }
    }

    pub fn simplify(&self, levels: usize, ratio: f64) -> Collapses {
        self.simplify_with(Some(self.texture()), levels, ratio)
    }

    /// With the texture's charts but not its costs.
    pub fn simplify_carelessly(&self, levels: usize, ratio: f64) -> Collapses {
        let no_size = vec![0.0; self.tile_side.len()];
        self.simplify_with(Some(UvInput { tile_side: &no_size, ..self.texture() }), levels, ratio)
    }

    pub fn simplify_untextured(&self, levels: usize, ratio: f64) -> Collapses {
        self.simplify_with(None, levels, ratio)
    }

    fn simplify_with(&self, texture: Option<UvInput>, levels: usize, ratio: f64) -> Collapses {
        let normals = vec![glam::Vec3::ZERO; self.positions.len()];
        let input = UnisonInput {
            positions: &self.positions,
            normals: &normals,
            triangles: &self.triangles,
            segmentation: &self.segmentation,
            cluster_of: &self.cluster_of,
            fans: &self.fans,
            kinds: &self.kinds,
            texture,
        };
        simplify(&input, levels, ratio, &|_| ())
    }

    pub fn at(&self, v: u32) -> glam::DVec3 {
        glam::DVec3::from(self.positions[v as usize].map(f64::from))
    }

    /// Numbers of the triangles that a level has, and their positions.
    pub fn level(&self, collapses: &Collapses, level: u8) -> Vec<(usize, [u32; 3])> {
        let at = |t: &[u32; 3]| t.map(|v| collapses.ancestor(v, level));
        let living = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        self.triangles.iter().map(at).enumerate().filter(|(_, t)| living(t)).collect()
    }
}
