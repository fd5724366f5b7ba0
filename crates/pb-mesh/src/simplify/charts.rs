//! The texture coordinates of a cluster while it simplifies, and which collapses its charts allow.
//!
//! A collapse takes every UV wedge of the vertex to the wedge that a triangle on the edge joins it with. Where a wedge has
//! no such triangle, or two that disagree, the collapse would tear a chart. So seams collapse along themselves, both
//! sides together, and corners of charts stay. Orientation in UV is decided in integers.

use super::corner_lists::{CornerLists, NONE};
use super::fan::Spoke;
use super::slide::UvWitness;
use super::stretch::{UvQuadric, offset, sum};
use crate::charts::tile_area2;
use glam::{Vec2, Vec3};

/// Units of texture coordinates per tile.
const UV_UNITS: f32 = 65_536.0;

/// Texture coordinates of a mesh cut into charts. A UV wedge is a distinct (cluster, position, chart corner).
#[derive(Clone, Copy)]
pub struct UvInput<'a> {
    /// Per triangle corner: UV wedge. Wedges of different clusters are distinct.
    pub corners: &'a [[u32; 3]],
    /// Position of each UV wedge.
    pub position_of: &'a [u32],
    /// Tile coordinates of each UV wedge, units of 1/65536 tile. No triangle may have negative area.
    pub uv: &'a [[u16; 2]],
    /// Per cluster: length of the tile's side on the surface, grid quanta.
    pub tile_side: &'a [f32],
}

impl UvInput<'_> {
    /// Length on the surface of one unit of a cluster's tile coordinates, grid quanta.
    pub fn unit(&self, cluster: usize) -> f32 {
        self.tile_side[cluster] / UV_UNITS
    }

    /// Twice the area of a triangle of wedges in its tile, exact.
    pub fn area(&self, wedges: [u32; 3]) -> i64 {
        tile_area2(wedges.map(|w| self.uv[w as usize]))
    }
}

/// Twice the area of a triangle in UV, exact.
fn area([p, q, r]: [[i32; 2]; 3]) -> i64 {
    let d = |x: [i32; 2], k: usize| i64::from(x[k] - p[k]);
    d(q, 0) * d(r, 1) - d(q, 1) * d(r, 0)
}

/// The charts of a cluster. Wedges have local numbers here, those of a vertex next to each other.
#[derive(Clone)]
pub(super) struct Charts {
    /// Wedges of vertex `v`: `starts[v]` to `starts[v + 1]`.
    starts: Vec<u32>,
    /// Number of each wedge in the input.
    global: Vec<u32>,
    uv: Vec<[i32; 2]>,
    parent: Vec<u32>,
    /// Wedge of each corner of the corner lists.
    of_corner: Vec<u32>,
    /// The wedges of each spoke of the fan: at its centre, at `a`, at `b`.
    pub fan: Vec<[u32; 3]>,
    /// Length on the surface of one UV unit, quanta.
    pub unit: f32,
    /// Stretch and seams; per wedge.
    pub quadrics: Vec<UvQuadric>,
    /// See [`UvWitness`]; per wedge.
    pub witness: Vec<UvWitness>,
    /// The witnesses to keep at the targets of the collapse whose slide was asked for last.
    pub farthest: [UvWitness; 2],
}

/// The wedges of a vertex and those that they become when it collapses onto another: one or two.
pub(super) type Joined = [[u32; 2]; 2];

impl Charts {
    /// The charts of cluster `c` with triangles `members` in the mesh, which are `triangles` in local numbers.
    pub fn new(uv: &UvInput, c: u32, members: &[u32], triangles: &[[u32; 3]], positions: &[Vec3]) -> Self {
        let mut corners: Vec<(u32, u32, u32)> = Vec::with_capacity(triangles.len() * 3);
        for (i, (&t, tri)) in members.iter().zip(triangles).enumerate() {
            let wedges = uv.corners[t as usize];
            corners.extend((0..3).map(|k| (tri[k], wedges[k], (i * 3 + k) as u32)));
        }
        corners.sort_unstable();
        let mut of_corner = vec![0; corners.len()];
        let (mut starts, mut global) = (Vec::with_capacity(positions.len() + 1), Vec::new());
        for (i, &(v, wedge, corner)) in corners.iter().enumerate() {
            if i == 0 || corners[i - 1].0 != v {
                starts.push(global.len() as u32);
            }
            if i == 0 || (corners[i - 1].0, corners[i - 1].1) != (v, wedge) {
                global.push(wedge);
            }
            of_corner[corner as usize] = global.len() as u32 - 1;
        }
        debug_assert_eq!(starts.len(), positions.len(), "a cluster's vertices are those of its triangles");
        starts.push(global.len() as u32);
        let at: Vec<[i32; 2]> = global.iter().map(|&w| uv.uv[w as usize].map(i32::from)).collect();
        let place = |v: usize| (starts[v]..starts[v + 1]).map(move |w| (w, v));
        let witness = (0..positions.len())
            .flat_map(place)
            .map(|(w, v)| UvWitness { uv: to_f32(at[w as usize]), at: positions[v] })
            .collect();
        let mut charts = Charts {
            quadrics: Vec::new(),
            parent: (0..global.len() as u32).collect(),
            unit: uv.unit(c as usize),
            fan: Vec::new(),
            farthest: [UvWitness::default(); 2],
            uv: at,
            starts,
            global,
            of_corner,
            witness,
        };
        charts.quadrics = sum(&charts, triangles, positions);
        charts
    }

    /// Number of wedges.
    pub fn count(&self) -> usize {
        self.global.len()
    }

    /// The offset between two wedges whose positions are `d` apart.
    pub fn offset(&self, [from, to]: [u32; 2], d: Vec3) -> [f32; 5] {
        offset(d, (self.uv(to) - self.uv(from)) * self.unit)
    }

    /// Texture coordinates of a wedge, UV units.
    pub fn uv(&self, w: u32) -> Vec2 {
        to_f32(self.uv[w as usize])
    }

    /// Twice the area of a triangle of wedges in UV.
    pub fn area(&self, wedges: [u32; 3]) -> i64 {
        area(wedges.map(|w| self.uv[w as usize]))
    }

    /// Notes the wedges of the fan of `v`, in the order of its spokes.
    pub fn spread(&mut self, corners: &CornerLists, v: u32) {
        self.fan.clear();
        let of_corner = &self.of_corner;
        self.fan.extend(corners.numbered_around(v).map(|(i, _)| triangle_of(of_corner, i)));
    }

    /// Wedges of a triangle, from one of its corners on.
    pub fn of_triangle(&self, corner: usize) -> [u32; 3] {
        triangle_of(&self.of_corner, corner)
    }

    /// What the wedges at the fan's centre become when it collapses onto `u`; `None` when a chart would be torn. The
    /// second pair repeats the first where there is only one.
    pub fn joined(&self, spokes: &[Spoke], u: u32) -> Option<Joined> {
        let (mut pairs, mut count) = ([[NONE; 2]; 2], 0);
        for (s, w) in spokes.iter().zip(&self.fan) {
            if s.a == u || s.b == u {
                *pairs.get_mut(count)? = [w[0], if s.a == u { w[1] } else { w[2] }];
                count += 1;
            }
        }
        if count == 1 {
            pairs[1] = pairs[0];
        }
        let agree = pairs[0][0] != pairs[1][0] || pairs[0][1] == pairs[1][1];
        let all = self.fan.iter().all(|w| pairs.iter().any(|p| p[0] == w[0]));
        (count > 0 && agree && all).then_some(pairs)
    }

    /// May the fan's centre collapse onto `u`? No triangle may turn over in UV or lose its area.
    pub fn allow(&self, spokes: &[Spoke], u: u32) -> bool {
        let Some(joined) = self.joined(spokes, u) else { return false };
        let mut kept = spokes.iter().zip(&self.fan).filter(|(s, _)| s.a != u && s.b != u);
        kept.all(|(_, &[own, a, b])| match self.area([target(&joined, own), a, b]) {
            0 => self.area([own, a, b]) <= 0,
            after => after > 0,
        })
    }

    /// Carries the collapse of the fan's centre `v` onto `u` out, which is allowed; `d` is the way.
    pub fn collapse(&mut self, spokes: &[Spoke], corners: &CornerLists, [v, u]: [u32; 2], d: Vec3) {
        let joined = self.joined(spokes, u).expect("the collapse is allowed");
        for w in self.starts[v as usize]..self.starts[v as usize + 1] {
            // A wedge without triangles may become any.
            let any = joined[0][1];
            self.parent[w as usize] = joined.iter().find(|p| p[0] == w).map_or(any, |p| p[1]);
        }
        for (i, _) in corners.numbered_around(v) {
            self.of_corner[i] = target(&joined, self.of_corner[i]);
        }
        for pair in &joined[..if joined[0] == joined[1] { 1 } else { 2 }] {
            let (moved, x) = (self.quadrics[pair[0] as usize], self.offset(*pair, d));
            self.quadrics[pair[1] as usize].add_moved(&moved, x);
        }
    }

    /// Keeps the witnesses of the collapse whose slide was asked for last.
    pub fn keep_witnesses(&mut self, spokes: &[Spoke], u: u32) {
        let joined = self.joined(spokes, u).expect("the collapse is allowed");
        for (pair, witness) in joined.iter().zip(self.farthest) {
            self.witness[pair[1] as usize] = witness;
        }
    }

    /// The wedges of `v`, which no triangle uses any more, become one of `heir`.
    pub fn bury(&mut self, v: u32, heir: u32) {
        let one = self.starts[heir as usize];
        (self.starts[v as usize]..self.starts[v as usize + 1]).for_each(|w| self.parent[w as usize] = one);
    }

    /// Writes the parents of this cluster's wedges.
    pub fn hand_over(&self, parents: &mut [u32]) {
        for (w, &g) in self.global.iter().enumerate() {
            parents[g as usize] = self.global[self.parent[w] as usize];
        }
    }
}

fn triangle_of(of_corner: &[u32], corner: usize) -> [u32; 3] {
    let (base, k) = (corner / 3 * 3, corner % 3);
    [0, 1, 2].map(|i| of_corner[base + (k + i) % 3])
}

fn to_f32(uv: [i32; 2]) -> Vec2 {
    Vec2::new(uv[0] as f32, uv[1] as f32)
}

/// What wedge `w` becomes.
pub(super) fn target(joined: &Joined, w: u32) -> u32 {
    if joined[0][0] == w { joined[0][1] } else { joined[1][1] }
}
