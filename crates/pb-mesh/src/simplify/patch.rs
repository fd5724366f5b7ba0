//! One cluster while it simplifies: its triangles, quadrics and a queue of half-edge collapses.
//!
//! Greedy half-edge collapse with accumulated quadrics (Garland and Heckbert 1997; half-edges as in Sander and
//! Mitchell 2005, section 5.4). A patch alone collapses what lies inside the cluster; border vertices are
//! moved by [`super::border`], which holds both patches.

use super::quadric::Quadric;
use crate::topology::Kind;
use glam::Vec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// No vertex, no corner.
pub(super) const NONE: u32 = u32::MAX;
/// Weight of the plane that stands on an open border edge, times the squared edge length.
const OPEN_BORDER_WEIGHT: f32 = 10.0;
/// Weight of the bend of normals along a collapse: the appearance term, in squared edge lengths.
const NORMAL_WEIGHT: f32 = 1.0 / 256.0;
/// Marks count to this per gathering: room for the triangles on one edge.
pub(super) const EPOCH: u32 = 4;
/// Weight of plain edge length: orders collapses where the surface is flat.
const LENGTH_WEIGHT: f32 = 1e-6;

/// Input of a patch: everything in local indices.
pub(super) struct PatchInput {
    /// Position index of each local vertex, ascending.
    pub global: Vec<u32>,
    /// Local coordinates, grid quanta relative to the patch.
    pub positions: Vec<Vec3>,
    /// Unit normals or zero.
    pub normals: Vec<Vec3>,
    pub kinds: Vec<Kind>,
    pub triangles: Vec<[u32; 3]>,
    /// Other clusters that use a vertex: `shared[shared_start[v]..shared_start[v + 1]]`, ascending.
    pub shared_start: Vec<u32>,
    pub shared: Vec<u32>,
    /// Mean area that a position's quadric starts with, in the whole mesh.
    pub mean_area: f32,
    /// Vertices of small components that may vanish as a whole, with their squared diameter.
    pub components: Vec<(f32, Vec<u32>)>,
}

/// A cluster in the middle of its simplification.
pub(super) struct Patch {
    pub input: PatchInput,
    pub parent: Vec<u32>,
    /// Level of death; `u8::MAX` while alive.
    pub death: Vec<u8>,
    pub(super) quadrics: Vec<Quadric>,
    /// Cheapest target of each vertex and its cost, in squared quanta.
    pub(super) best: Vec<(f32, u32)>,
    pub(super) queue: BinaryHeap<Reverse<(u32, u32)>>,
    /// Corner lists: first corner of a vertex, next corner in its list.
    pub(super) first: Vec<u32>,
    pub(super) next: Vec<u32>,
    pub(super) marks: Vec<u32>,
    pub(super) epoch: u32,
    pub(super) ring: Vec<u32>,
    pub(super) candidates: Vec<(f32, u32)>,
    /// Points left over from vanished components, to die one level later.
    pub(super) points: Vec<u32>,
    pub(super) alive: usize,
}

impl Patch {
    /// Sets up quadrics, corner lists and the queue.
    pub fn new(input: PatchInput) -> Self {
        let n = input.global.len();
        let mut patch = Patch {
            parent: (0..n as u32).collect(),
            death: vec![u8::MAX; n],
            quadrics: vec![Quadric::default(); n],
            best: vec![(f32::INFINITY, NONE); n],
            queue: BinaryHeap::new(),
            first: vec![NONE; n],
            next: vec![NONE; input.triangles.len() * 3],
            marks: vec![0; n],
            epoch: 0,
            ring: Vec::new(),
            candidates: Vec::new(),
            points: Vec::new(),
            alive: n,
            input,
        };
        patch.link_corners();
        patch.sum_quadrics();
        let mut entries = Vec::with_capacity(n);
        for v in 0..n as u32 {
            if patch.moves_alone(v) {
                patch.best[v as usize] = patch.cheapest(v);
                entries.push(Reverse((patch.best[v as usize].0.to_bits(), v)));
            }
        }
        patch.queue = BinaryHeap::from(entries);
        patch
    }

    /// Vertices that still live here, border vertices included.
    pub fn alive(&self) -> usize {
        self.alive
    }

    /// Costs of the cheapest collapses of all vertices that move alone and have one.
    pub fn queued_costs(&self) -> Vec<f32> {
        let costs = self.best.iter().zip(&self.death).filter(|(b, d)| b.1 != NONE && **d == u8::MAX);
        costs.map(|(b, _)| b.0).collect()
    }

    fn link_corners(&mut self) {
        for c in (0..self.next.len()).rev() {
            let v = self.input.triangles[c / 3][c % 3] as usize;
            self.next[c] = self.first[v];
            self.first[v] = c as u32;
        }
    }

    fn sum_quadrics(&mut self) {
        for t in 0..self.input.triangles.len() {
            let tri = self.input.triangles[t];
            let normal = self.area_normal(tri);
            let area = normal.length();
            let Some(unit) = normal.try_normalize() else { continue };
            let q = Quadric::plane(unit, area);
            for k in 0..3 {
                self.quadrics[tri[k] as usize].add(&q);
                let (a, b) = (tri[k], tri[(k + 1) % 3]);
                let open = |v: u32| self.input.kinds[v as usize] == Kind::Open;
                if (open(a) || open(b)) && !self.has_half_edge(b, a) {
                    let edge = self.input.positions[b as usize] - self.input.positions[a as usize];
                    if let Some(side) = edge.cross(unit).try_normalize() {
                        let wall = Quadric::plane(side, edge.length_squared() * OPEN_BORDER_WEIGHT);
                        self.quadrics[a as usize].add(&wall);
                        self.quadrics[b as usize].add(&wall);
                    }
                }
            }
        }
    }

    fn area_normal(&self, tri: [u32; 3]) -> Vec3 {
        let [a, b, c] = tri.map(|v| self.input.positions[v as usize]);
        (b - a).cross(c - a)
    }

    fn has_half_edge(&self, a: u32, b: u32) -> bool {
        self.corners(a).any(|c| self.spokes(c).0 == b)
    }

    /// Corners of living triangles at `v`.
    pub(super) fn corners(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let mut c = self.first[v as usize];
        std::iter::from_fn(move || {
            while c != NONE {
                let now = c;
                c = self.next[c as usize];
                if self.input.triangles[now as usize / 3][0] != NONE {
                    return Some(now);
                }
            }
            None
        })
    }

    /// The two other vertices of a corner's triangle, in its order.
    pub(super) fn spokes(&self, corner: u32) -> (u32, u32) {
        let t = self.input.triangles[corner as usize / 3];
        match corner % 3 {
            0 => (t[1], t[2]),
            1 => (t[2], t[0]),
            _ => (t[0], t[1]),
        }
    }

    /// Fills `ring` with the neighbours of `v` and marks each with the number of triangles on its edge.
    pub(super) fn gather(&mut self, v: u32) {
        self.epoch += EPOCH;
        self.ring.clear();
        let mut c = self.first[v as usize];
        while c != NONE {
            let now = c;
            c = self.next[c as usize];
            if self.input.triangles[now as usize / 3][0] == NONE {
                continue;
            }
            let (a, b) = self.spokes(now);
            for x in [a, b] {
                let m = &mut self.marks[x as usize];
                if *m < self.epoch {
                    *m = self.epoch;
                    self.ring.push(x);
                }
                *m = (*m + 1).min(self.epoch + EPOCH - 1);
            }
        }
    }

    /// Triangles on the edge from the last gathered vertex to `x`.
    pub(super) fn edge_triangles(&self, x: u32) -> u32 {
        self.marks[x as usize].saturating_sub(self.epoch)
    }

    /// True for vertices that this patch may collapse without asking a neighbour.
    fn moves_alone(&self, v: u32) -> bool {
        self.death[v as usize] == u8::MAX && matches!(self.input.kinds[v as usize], Kind::Inner | Kind::Open)
    }

    /// May `v`, just gathered, collapse onto its neighbour `u`? Kinds only (design I2).
    fn allowed(&self, v: u32, u: u32) -> bool {
        match self.input.kinds[v as usize] {
            Kind::Inner => true,
            Kind::Open => {
                self.edge_triangles(u) == 1 && matches!(self.input.kinds[u as usize], Kind::Open | Kind::Locked)
            }
            Kind::Border | Kind::Locked => false,
        }
    }

    /// Cost of moving `v` onto `u`, squared quanta: distance to the planes merged into `v`, and the bend of normals.
    pub fn cost(&self, v: u32, u: u32) -> f32 {
        let d = self.input.positions[u as usize] - self.input.positions[v as usize];
        self.geometric_cost(v, d).0 + self.appearance_cost(v, u, d)
    }

    /// Squared distance at offset `d` from `v`, and the area of the planes behind it. Between the mean over those planes,
    /// which keeps the largest distance down, and their sum, which keeps the mean over the whole surface down.
    pub fn geometric_cost(&self, v: u32, d: Vec3) -> (f32, f32) {
        let q = &self.quadrics[v as usize];
        if q.weight > 0.0 {
            (q.at(d) / q.weight * (1.0 + (q.weight / self.input.mean_area).sqrt()), q.weight)
        } else {
            (0.0, 0.0)
        }
    }

    /// Cost of the normals' bend and of plain length.
    pub fn appearance_cost(&self, v: u32, u: u32, d: Vec3) -> f32 {
        let bend = 1.0 - self.input.normals[v as usize].dot(self.input.normals[u as usize]);
        d.length_squared() * (NORMAL_WEIGHT * bend * bend + LENGTH_WEIGHT)
    }

    fn cheapest(&mut self, v: u32) -> (f32, u32) {
        self.gather(v);
        let mut best = (f32::INFINITY, NONE);
        for &u in &self.ring {
            if self.allowed(v, u) {
                let c = self.cost(v, u);
                if c < best.0 {
                    best = (c, u);
                }
            }
        }
        best
    }

    fn enqueue(&mut self, v: u32, best: (f32, u32)) {
        self.best[v as usize] = best;
        if best.1 != NONE {
            self.queue.push(Reverse((best.0.to_bits(), v)));
        }
    }

    /// Collapses inside the cluster, cheapest first, while the cost is at most `limit`; returns how many.
    pub fn collapse_interior(&mut self, limit: f32, level: u8) -> usize {
        let mut count = 0;
        while let Some(&Reverse((bits, v))) = self.queue.peek() {
            if f32::from_bits(bits) > limit {
                break;
            }
            self.queue.pop();
            if self.moves_alone(v) && self.best[v as usize].0.to_bits() == bits {
                count += self.collapse_vertex(v, level) as usize;
            }
        }
        count
    }

    /// Collapses `v` onto its cheapest legal neighbour, or queues it again when that is not its turn yet. The cost is
    /// raised here where one triangle would turn far out of its plane, which the mean over all planes can hide.
    fn collapse_vertex(&mut self, v: u32, level: u8) -> bool {
        let turn = self.best[v as usize].0.max(self.queue.peek().map_or(f32::INFINITY, |t| f32::from_bits(t.0.0)));
        let (cost, u) = self.best[v as usize];
        if cost.max(self.largest_turn(v, u)) <= turn && self.legal(v, u) {
            self.apply(v, u, level);
            return true;
        }
        self.gather(v);
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        candidates.extend(self.ring.iter().filter(|&&u| self.allowed(v, u)).map(|&u| (self.cost(v, u), u)));
        candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut best = (f32::INFINITY, NONE);
        for &(cost, u) in &candidates {
            if cost >= best.0 || best.0 <= turn {
                break;
            }
            let raised = cost.max(self.largest_turn(v, u));
            if raised < best.0 && self.legal(v, u) {
                best = (raised, u);
            }
        }
        self.candidates = candidates;
        self.best[v as usize] = (f32::INFINITY, NONE);
        if best.1 == NONE {
            return false;
        }
        if best.0 > turn {
            self.enqueue(v, best);
            return false;
        }
        self.apply(v, best.1, level);
        true
    }

    /// The two neighbours of `v` along the border of the patch: the one its fan starts with and the one it
    /// ends with. `None` when the fan is not one open run.
    pub fn border_ends(&self, v: u32) -> Option<[u32; 2]> {
        let mut ends = [NONE; 2];
        for c in self.corners(v) {
            let (after, before) = self.spokes(c);
            if !self.corners(v).any(|o| self.spokes(o).1 == after) && std::mem::replace(&mut ends[0], after) != NONE {
                return None;
            }
            if !self.corners(v).any(|o| self.spokes(o).0 == before) && std::mem::replace(&mut ends[1], before) != NONE {
                return None;
            }
        }
        (ends[0] != NONE && ends[1] != NONE).then_some(ends)
    }

    /// Other clusters that use `v`.
    pub fn shared(&self, v: u32) -> &[u32] {
        let s = &self.input.shared_start;
        &self.input.shared[s[v as usize] as usize..s[v as usize + 1] as usize]
    }

    /// Carries a legal collapse out and updates the costs around it.
    pub fn apply(&mut self, v: u32, u: u32, level: u8) {
        self.parent[v as usize] = u;
        self.death[v as usize] = level;
        self.alive -= 1;
        let d = self.input.positions[u as usize] - self.input.positions[v as usize];
        let q = self.quadrics[v as usize].moved(d);
        self.quadrics[u as usize].add(&q);
        self.move_corners(v, u);
        self.refresh_around(u, v);
    }

    fn move_corners(&mut self, v: u32, u: u32) {
        let mut kept = NONE;
        for from in [v, u] {
            let mut c = self.first[from as usize];
            while c != NONE {
                let next = self.next[c as usize];
                let t = &mut self.input.triangles[c as usize / 3];
                if t[0] != NONE && from == v {
                    if t.contains(&u) {
                        t[0] = NONE;
                    } else {
                        t[c as usize % 3] = u;
                    }
                }
                if t[0] != NONE {
                    self.next[c as usize] = kept;
                    kept = c;
                }
                c = next;
            }
        }
        self.first[v as usize] = NONE;
        self.first[u as usize] = kept;
    }

    /// Costs of `u` and its ring after something (`gone`) collapsed onto `u`.
    fn refresh_around(&mut self, u: u32, gone: u32) {
        self.gather(u);
        let ring = std::mem::take(&mut self.ring);
        for &x in &ring {
            if !self.moves_alone(x) {
                continue;
            }
            let (cost, target) = self.best[x as usize];
            if target == gone || target == NONE || self.input.kinds[x as usize] == Kind::Open {
                let best = self.cheapest(x);
                if best != (cost, target) {
                    self.enqueue(x, best);
                }
            } else {
                let c = self.cost(x, u);
                if c < cost {
                    self.enqueue(x, (c, u));
                }
            }
        }
        self.ring = ring;
        if self.moves_alone(u) {
            let best = self.cheapest(u);
            self.enqueue(u, best);
        }
    }
}
