//! The display rule (design section 3): the Rust twin of the vertex shader.
//!
//! All arithmetic is f32 in the order that the shader uses, so that both agree to rounding and so that two
//! clusters that share a position compute the same bits for it.

use glam::DVec3;

use super::layout::{MAX_LEVELS, Vertex};

/// Switch distances and residency floor of one cluster: `lod` is continuous and never falls with distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LodTable {
    /// Number of levels L.
    pub levels: u32,
    /// Residency floor m_c, levels.
    pub floor: f32,
    /// `distances[i] = D_i`, world units; `D_0 = 0`, strictly increasing.
    pub distances: [f32; MAX_LEVELS],
}

impl LodTable {
    /// The table of an object whose distances are `stretch` times as long in the world: for bands.
    pub fn at_scale(self, stretch: f32) -> LodTable {
        LodTable { distances: self.distances.map(|d| d / stretch), ..self }
    }

    /// Level of detail at distance `d` (world units): `max(m, i + (d - D_i) / (D_{i+1} - D_i))`.
    pub fn lod(&self, d: f32) -> f32 {
        lod_from(self.levels as usize - 1, |i| self.distances[i], d).max(self.floor)
    }
}

/// Level of detail from distance alone, 0 to `last`; `distance(i)` is `D_i`.
pub(super) fn lod_from(last: usize, distance: impl Fn(usize) -> f32, d: f32) -> f32 {
    for i in 0..last {
        let far = distance(i + 1);
        if d < far {
            let near = distance(i);
            let w = (d - near) * (1.0 / (far - near));
            return i as f32 + w.clamp(0.0, 1.0);
        }
    }
    last as f32
}

/// Eye in grid space: an integer cell and the rest, so that differences are exact far from the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridEye {
    /// Grid cell of the eye.
    pub cell: [i32; 3],
    /// Rest, in world units, `eye = origin + cell * quantum + rest`.
    pub rest: [f32; 3],
    /// Grid step, world units.
    pub quantum: f32,
}

impl GridEye {
    /// The eye (world space) in the grid of a model with this origin and grid step. Farther than 2^30 quanta
    /// the cell stops, so that differences of cells never overflow, and the rest takes what is left.
    pub fn new(origin: [f64; 3], quantum: f64, eye: DVec3) -> GridEye {
        const FARTHEST: f64 = (1u32 << 30) as f64;
        let local = eye - DVec3::from_array(origin);
        let cell = (local / quantum).floor().clamp(DVec3::splat(-FARTHEST), DVec3::splat(FARTHEST));
        let rest = local - cell * quantum;
        GridEye { cell: cell.as_ivec3().to_array(), rest: rest.as_vec3().to_array(), quantum: quantum as f32 }
    }
}

/// One cluster as the display rule sees it: its resident vertices and who its neighbours are.
pub struct ClusterView<'a> {
    /// Grid origin.
    pub origin: [i32; 3],
    /// Offsets are multiples of `2^shift` quanta.
    pub shift: u32,
    /// `n_i` per level.
    pub counts: &'a [u32],
    /// Vertices `[0, n_i)` of the finest resident level.
    pub vertices: &'a [Vertex],
    /// This cluster's index, which orders the two tables of a border position.
    pub cluster: u32,
    /// This cluster's table.
    pub table: &'a LodTable,
    /// Neighbours' indices and tables, by slot - 1.
    pub neighbours: &'a [(u32, LodTable)],
}

/// A displayed vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displayed {
    /// Position relative to the eye, world units.
    pub position: [f32; 3],
    /// Normal, not normalised.
    pub normal: [f32; 3],
    /// RGBA in 0..=1, sRGB encoded as stored.
    pub color: [f32; 4],
}

impl ClusterView<'_> {
    /// Position of `v` relative to the eye, world units.
    pub fn position(&self, v: &Vertex, eye: &GridEye) -> [f32; 3] {
        std::array::from_fn(|k| {
            let grid = self.origin[k] + ((v.offset[k] as i32) << self.shift);
            (grid - eye.cell[k]) as f32 * eye.quantum - eye.rest[k]
        })
    }

    /// Level of detail of the position of `v`: the larger of this cluster's and the bordering cluster's.
    /// The two tables are read in the order of their cluster indices, so both clusters run the same sums.
    pub fn lod(&self, v: &Vertex, eye: &GridEye) -> f32 {
        let p = self.position(v, eye);
        let d = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        match v.slot() {
            0 => self.table.lod(d),
            s => self.table.lod(d).max(self.neighbours[s as usize - 1].1.lod(d)),
        }
    }

    fn plain(&self, v: &Vertex, eye: &GridEye) -> Displayed {
        Displayed { position: self.position(v, eye), normal: v.normal(), color: v.color.map(|c| c as f32 / 255.0) }
    }

    /// The parent of `v` at the step `level -> level + 1`; `v` itself if it survives.
    fn parent(&self, v: u32, level: u32) -> u32 {
        if v < self.counts[level as usize + 1] { v } else { self.vertices[v as usize].parent as u32 }
    }

    /// Where vertex `index`, drawn by the index buffer of `level`, is shown: past the levels that its own
    /// ancestors have left behind, then a mix of the ancestors that follow, each weighed by its own lod:
    ///
    /// `display(v, i) = v + w_v (display(a, i + 1) - v)`, `w_v = clamp(lod(v) - i, 0, 1)`, `a` the parent of v.
    ///
    /// Mixing with where the parent is *shown*, not with the parent, is what keeps the place continuous when v
    /// reaches the next level before or after its parent does. A weight of 1 is passed without arithmetic, so
    /// that a finer cluster arrives at the very bits from which a coarser neighbour starts.
    pub fn display(&self, index: u32, level: u32, eye: &GridEye) -> Displayed {
        let last = self.counts.len() as u32 - 1;
        let (mut v, mut i) = (index, level);
        let mut t = self.lod(&self.vertices[v as usize], eye);
        while i < last && t >= (i + 1) as f32 {
            v = self.parent(v, i);
            t = self.lod(&self.vertices[v as usize], eye);
            i += 1;
        }
        let mut here = self.plain(&self.vertices[v as usize], eye);
        let (mut shown, mut weight) = (here, 1.0);
        while i < last && t > i as f32 {
            weight *= (t - i as f32).min(1.0);
            v = self.parent(v, i);
            let next = self.plain(&self.vertices[v as usize], eye);
            shown = shown.moved(&here, &next, weight);
            here = next;
            t = self.lod(&self.vertices[v as usize], eye);
            i += 1;
        }
        shown
    }
}

impl Displayed {
    /// `self + (b - a) * w`, component by component.
    fn moved(&self, a: &Displayed, b: &Displayed, w: f32) -> Displayed {
        let m = |s: f32, x: f32, y: f32| s + (y - x) * w;
        Displayed {
            position: std::array::from_fn(|k| m(self.position[k], a.position[k], b.position[k])),
            normal: std::array::from_fn(|k| m(self.normal[k], a.normal[k], b.normal[k])),
            color: std::array::from_fn(|k| m(self.color[k], a.color[k], b.color[k])),
        }
    }
}
