//! One cluster while it simplifies: its triangles, quadrics and a queue of half-edge collapses.
//!
//! Greedy half-edge collapse with accumulated quadrics (Garland and Heckbert 1997; half-edges as in Sander and
//! Mitchell 2005, section 5.4). A patch alone collapses what lies inside the cluster; border vertices are
//! moved by [`super::border`], which holds both patches.

use super::charts::Charts;
use super::corner_lists::{CornerLists, NONE};
use super::fan::{Fan, LANES, Lanes, MAX_VERTICES, Spoke, dot};
use super::quadric::Quadric;
use super::queue::Queue;
use super::weights::Weights;
use crate::closest::closest_on_segment;
use crate::topology::Kind;
use glam::{Vec3, Vec4};

/// Weight of the plane that stands on an open border edge, times the squared edge length.
const OPEN_BORDER_WEIGHT: f32 = 1.0;
/// Weight of the bend of normals along a collapse: the appearance term, in squared edge lengths.
const NORMAL_WEIGHT: f32 = 1.0 / 256.0;
/// A round that has more than this fraction (1/n) of the vertices queued is worth [`Patch::warm_up`].
const WARM_SHARE: usize = 16;
/// Marks count to this per gathering: room for the triangles on one edge.
pub(super) const EPOCH: u32 = 4;
/// Weight of plain edge length: orders collapses where the surface is flat.
const LENGTH_WEIGHT: f32 = 1e-6;

/// Input of a patch: everything in local indices.
#[derive(Clone)]
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
    /// Texture coordinates of textured meshes.
    pub charts: Option<Charts>,
}

/// A vertex that another may collapse onto.
#[derive(Clone, Copy)]
struct Candidate {
    /// What it costs at least, squared quanta.
    cost: f32,
    target: u32,
    known: Known,
}

/// What the cost of a candidate counts.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
enum Known {
    /// Planes, normals, texture.
    Planes,
    /// Also how far triangles turn.
    Turn,
    /// Also witnesses.
    All,
}

/// A cluster in the middle of its simplification.
#[derive(Clone)]
pub(super) struct Patch {
    pub input: PatchInput,
    /// Which vertices still live.
    pub(super) living: Vec<bool>,
    /// Positions that collapsed since they were last handed over, and onto which.
    pub(super) graves: Vec<[u32; 2]>,
    pub(super) quadrics: Vec<Quadric>,
    /// What makes each quadric's value a cost; see [`Weights::scale`].
    pub(super) scales: Vec<f32>,
    /// Cheapest target of each vertex and its cost, in squared quanta.
    pub(super) best: Vec<(f32, u32)>,
    /// Collapses of this round.
    queue: Queue,
    pub(super) corners: CornerLists,
    pub(super) marks: Vec<u32>,
    pub(super) epoch: u32,
    pub(super) ring: Vec<u32>,
    /// Vertices that get to know a new neighbour.
    offered: Vec<u32>,
    pub(super) fan: Fan,
    candidates: Vec<Candidate>,
    /// Points left over from vanished components, to die one level later.
    pub(super) points: Vec<u32>,
    pub(super) alive: usize,
    /// A point of the finer surface that the triangles around each vertex stand for: the one furthest from them when it
    /// was last looked at; the vertex itself at first.
    pub(super) witness: Vec<Vec3>,
    /// See [`Patch::reach`].
    pub(super) farthest: Vec3,
    /// Do costs count the distance of witnesses?
    pub(super) watchful: bool,
    /// What costs are made of.
    pub(super) weights: Weights,
}

impl Patch {
    /// Sets up quadrics, corner lists and the queue.
    pub fn new(input: PatchInput, watchful: bool) -> Self {
        let n = input.global.len();
        assert!(n <= MAX_VERTICES, "a patch of {n} vertices");
        let mut patch = Patch {
            living: vec![true; n],
            graves: Vec::new(),
            quadrics: vec![Quadric::default(); n],
            scales: Vec::new(),
            best: vec![(f32::INFINITY, NONE); n],
            queue: Queue::default(),
            corners: CornerLists::new(n, &input.triangles, input.charts.is_some()),
            marks: vec![0; n],
            epoch: 0,
            ring: Vec::new(),
            offered: Vec::new(),
            fan: Fan::default(),
            candidates: Vec::new(),
            points: Vec::new(),
            alive: n,
            witness: input.positions.clone(),
            farthest: Vec3::ZERO,
            watchful,
            weights: Weights::FINE,
            input,
        };
        patch.sum_quadrics();
        patch.input.triangles = Vec::new();
        patch.reweigh(Weights::FINE);
        patch
    }

    /// Sets all costs anew.
    pub fn reweigh(&mut self, weights: Weights) {
        self.weights = weights;
        self.scales = self.quadrics.iter().map(|q| weights.scale(q.weight, self.input.mean_area)).collect();
        for v in 0..self.living.len() as u32 {
            if self.moves_alone(v) {
                self.best[v as usize] = self.cheapest(v);
            }
        }
    }

    /// Vertices that still live here, border vertices included.
    pub fn alive(&self) -> usize {
        self.alive
    }

    /// Vertices, those that died since the last hand-over included.
    pub fn size(&self) -> usize {
        self.living.len()
    }

    /// Vertices that move without asking another patch, whether they live or not.
    pub fn movable(&self) -> usize {
        self.input.kinds.iter().filter(|k| matches!(k, Kind::Inner | Kind::Open)).count()
    }

    /// The local number of position `v`, which is one of this cluster's and was not forgotten.
    pub fn local(&self, v: u32) -> u32 {
        self.input.global.binary_search(&v).expect("a position of the cluster") as u32
    }

    /// Does the vertex still live? Not if it is none.
    pub fn is_alive(&self, v: u32) -> bool {
        self.living.get(v as usize).is_some_and(|l| *l)
    }

    /// Costs of the cheapest collapses of every `step`th vertex, if it moves alone and has one.
    pub fn queued_costs(&mut self, step: usize) -> Vec<f32> {
        let mut costs = Vec::with_capacity(self.best.len() / step + 1);
        for v in (0..self.best.len() as u32).step_by(step) {
            let (_, target) = self.best[v as usize];
            if !self.living[v as usize] {
                continue;
            }
            if target != NONE && !self.is_alive(target) {
                self.best[v as usize] = self.cheapest(v);
            }
            costs.extend((target != NONE).then_some(self.best[v as usize].0).filter(|c| *c < f32::INFINITY));
        }
        costs
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
        self.corners.around(a).iter().any(|c| c.a == b)
    }

    /// Fills `ring` with the neighbours of `v` and marks each with the number of triangles on its edge.
    pub(super) fn gather(&mut self, v: u32) {
        self.epoch += EPOCH;
        self.ring.clear();
        for c in self.corners.around(v) {
            for x in [c.a, c.b] {
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
        self.is_alive(v) && matches!(self.input.kinds[v as usize], Kind::Inner | Kind::Open)
    }

    /// Where the vertex of the fan, which moves alone, may go, into `candidates`, with their least costs. Kinds only (design
    /// I2).
    fn list_candidates(&mut self) {
        let (v, mut list) = (self.fan.center, std::mem::take(&mut self.candidates));
        list.clear();
        let mut add = |cost, target| list.push(Candidate { cost, target, known: Known::Planes });
        if self.input.kinds[v as usize] == Kind::Open {
            let may = |u: &u32| matches!(self.input.kinds[*u as usize], Kind::Open | Kind::Locked);
            if let Some(ends) = self.fan.ends() {
                let least = self.border_cost(v, ends);
                ends.into_iter().filter(may).for_each(|u| add(self.cost(v, u).max(least), u));
            }
        } else {
            // The fan of an inner vertex is closed: each neighbour starts one of its triangles.
            for (lanes, spokes) in self.fan.lanes.iter().zip(self.fan.spokes.chunks(LANES)) {
                let costs = self.costs(v, lanes, spokes);
                for (k, s) in spokes.iter().enumerate() {
                    add(costs[k] + self.stretch(s.a), s.a);
                }
            }
        }
        self.candidates = list;
    }

    /// What it costs at least that `v` leaves the open border between two neighbours: where that bends inwards, the surface gets
    /// points as far from it as `v` is from the new edge; where a hole of three edges closes, as far as its middle is from them.
    fn border_cost(&self, v: u32, ends: [u32; 2]) -> f32 {
        let [a, b, c] = [v, ends[0], ends[1]].map(|x| self.input.positions[x as usize]);
        let far = match self.corners.edge_count(ends[0], ends[1]) {
            1 => (b - a).cross(c - a).length() / (a.distance(b) + b.distance(c) + c.distance(a)).max(f32::MIN_POSITIVE),
            _ => closest_on_segment(a, b, c).distance(a),
        };
        far * far * self.weights.witness
    }

    /// Costs of moving `v` onto where four of its spokes start, without those of texture.
    fn costs(&self, v: u32, lanes: &Lanes, spokes: &[Spoke]) -> Vec4 {
        let (own, q, d) = (self.input.normals[v as usize], &self.quadrics[v as usize], lanes.at_a);
        let mut bend = Vec4::ZERO;
        for (k, s) in spokes.iter().enumerate() {
            bend[k] = 1.0 - own.dot(self.input.normals[s.a as usize]);
        }
        q.at_four(d) * self.scales[v as usize] + dot(d, d) * (bend * bend * NORMAL_WEIGHT + LENGTH_WEIGHT)
    }

    /// Cost of moving `v`, whose fan is laid out if there are charts, onto `u`, squared quanta: distance to the planes merged
    /// into `v`, the bend of normals, and the stretch of texture.
    fn cost(&self, v: u32, u: u32) -> f32 {
        let d = self.input.positions[u as usize] - self.input.positions[v as usize];
        self.quadrics[v as usize].at(d) * self.scales[v as usize] + self.appearance_cost(v, u, d) + self.stretch(u)
    }

    /// See [`Weights::scale`].
    pub fn scale_of(&self, v: u32) -> f32 {
        self.scales[v as usize]
    }

    /// Cost of the normals' bend and of plain length.
    pub fn appearance_cost(&self, v: u32, u: u32, d: Vec3) -> f32 {
        let bend = 1.0 - self.input.normals[v as usize].dot(self.input.normals[u as usize]);
        d.length_squared() * (NORMAL_WEIGHT * bend * bend + LENGTH_WEIGHT)
    }

    /// Cheapest target of `v` and its cost, raised where one triangle would turn far out of its plane, which the mean
    /// over all planes can hide.
    fn cheapest(&mut self, v: u32) -> (f32, u32) {
        self.spread(v);
        self.list_candidates();
        loop {
            match self.cheapest_candidate() {
                None => return (f32::INFINITY, NONE),
                Some((_, c)) if c.known == Known::Turn => return (c.cost, c.target),
                Some((i, c)) => self.candidates[i] = self.ask_more(c),
            }
        }
    }

    /// The candidate that seems cheapest, and its place.
    fn cheapest_candidate(&self) -> Option<(usize, Candidate)> {
        // Costs are not negative, so their bits are in the order of their values; a minimum of numbers needs no branch.
        let key = |(i, c): (usize, &Candidate)| u64::from(c.cost.to_bits()) << 32 | i as u64;
        let i = self.candidates.iter().enumerate().map(key).min()? as u32 as usize;
        let first = self.candidates[i];
        (first.cost < f32::INFINITY).then_some((i, first))
    }

    /// The candidate with what the next question adds to its cost.
    fn ask_more(&mut self, c: Candidate) -> Candidate {
        let (more, known) = match c.known {
            Known::Planes => (self.turn(c.target), Known::Turn),
            _ => (self.reach(c.target).max(self.slide(c.target)), Known::All),
        };
        Candidate { cost: c.cost.max(more), known, ..c }
    }

    fn enqueue(&mut self, v: u32, best: (f32, u32)) {
        self.best[v as usize] = best;
        self.queue.push(best.0, v);
    }

    /// Collapses inside the cluster, cheapest first, while the cost is at most `limit`; returns how many, at most `quota`.
    pub fn collapse_interior(&mut self, limit: f32, quota: usize) -> usize {
        self.queue.restart(limit);
        for v in 0..self.best.len() as u32 {
            if self.best[v as usize].0 <= limit && self.moves_alone(v) {
                self.queue.push(self.best[v as usize].0, v);
            }
        }
        if self.queue.len() * WARM_SHARE > self.living.len() {
            self.warm_up();
        }
        let mut count = 0;
        while count < quota
            && let Some((cost, v)) = self.queue.pop()
        {
            if self.moves_alone(v) && self.best[v as usize].0 == cost {
                count += self.collapse_vertex(v, limit) as usize;
            }
        }
        self.queue.stop();
        count
    }

    /// Reads what a round touches at random once from front to back, which costs a small part of that when it is not in the
    /// cache.
    fn warm_up(&self) {
        let quadrics: f32 = self.quadrics.iter().map(|q| q.weight).sum();
        let vectors = [&self.input.positions, &self.input.normals, &self.witness];
        let vectors: f32 = vectors.into_iter().map(|list| list.iter().step_by(4).map(|v| v.x).sum::<f32>()).sum();
        std::hint::black_box((quadrics, vectors, self.corners.warm_up()));
    }

    /// Collapses `v` onto its cheapest legal neighbour, or queues it again when that is not its turn yet.
    fn collapse_vertex(&mut self, v: u32, limit: f32) -> bool {
        let next = self.queue.next_cost().unwrap_or(limit);
        let (cost, u) = self.best[v as usize];
        let due = cost.max(next);
        self.spread(v);
        if self.is_alive(u)
            && self.turn(u) <= due
            && self.reach(u).max(self.slide(u)) <= due
            && self.keeps_topology(u, |_, _| false)
        {
            self.apply(v, u);
            return true;
        }
        self.best[v as usize] = (f32::INFINITY, NONE);
        self.list_candidates();
        while let Some((i, c)) = self.cheapest_candidate() {
            if c.cost > due {
                self.enqueue(v, (c.cost, c.target));
                return false;
            }
            if c.known < Known::All {
                self.candidates[i] = self.ask_more(c);
            } else if self.keeps_topology(c.target, |_, _| false) {
                // Others may have been asked since.
                let _ = self.reach(c.target).max(self.slide(c.target));
                self.apply(v, c.target);
                return true;
            } else {
                self.candidates[i].cost = f32::INFINITY;
            }
        }
        false
    }

    /// Notes the death of `v`.
    pub(super) fn bury(&mut self, v: u32, parent: u32) {
        self.living[v as usize] = false;
        self.graves.push([v, parent].map(|x| self.input.global[x as usize]));
        self.alive -= 1;
    }

    /// Other clusters that use `v`.
    pub fn shared(&self, v: u32) -> &[u32] {
        let s = &self.input.shared_start;
        &self.input.shared[s[v as usize] as usize..s[v as usize + 1] as usize]
    }

    /// Carries a legal collapse, the one whose [`Patch::reach`] and [`Patch::slide`] were asked for last, out and updates the costs around it.
    pub fn apply(&mut self, v: u32, u: u32) {
        if self.watchful {
            self.witness[u as usize] = self.farthest;
        }
        self.bury(v, u);
        let d = self.input.positions[u as usize] - self.input.positions[v as usize];
        let q = self.quadrics[v as usize].moved(d);
        self.quadrics[u as usize].add(&q);
        self.scales[u as usize] = self.weights.scale(self.quadrics[u as usize].weight, self.input.mean_area);
        if let Some(third) = self.closed_hole(u) {
            for x in [u, third] {
                if self.input.kinds[x as usize] == Kind::Open {
                    self.input.kinds[x as usize] = Kind::Inner;
                    self.best[x as usize] = (f32::INFINITY, NONE);
                }
            }
        }
        if let Some(charts) = &mut self.input.charts {
            if self.watchful {
                charts.keep_witnesses(&self.fan.spokes, u);
            }
            charts.collapse(&self.fan.spokes, &self.corners, [v, u], d);
        }
        self.corners.merge(v, u);
        self.refresh_around(u);
    }

    /// Costs around `u` after the fan's centre collapsed onto it. A cost rests on the quadric of the vertex that moves, so only
    /// those of `u` change; others may have `u` as a new target. Where the target is gone, that shows when it comes up.
    fn refresh_around(&mut self, u: u32) {
        let mut anew = std::mem::take(&mut self.ring);
        anew.clear();
        let uncertain = |x: u32| self.best[x as usize].1 == NONE || self.input.kinds[x as usize] == Kind::Open;
        for c in self.corners.around(u) {
            anew.extend([c.a, c.b].into_iter().filter(|&x| uncertain(x) && self.moves_alone(x)));
        }
        let mut offered = std::mem::take(&mut self.offered);
        offered.clear();
        offered.extend(self.fan.spokes.iter().filter(|s| s.a != u && s.b != u).map(|s| s.a));
        for &x in &offered {
            // The cost of a texture's stretch needs the whole fan.
            if self.input.charts.is_some() && self.moves_alone(x) {
                self.spread(x);
            }
            self.offer(x, u);
        }
        self.offered = offered;
        anew.sort_unstable();
        anew.dedup();
        anew.extend(self.moves_alone(u).then_some(u));
        for &x in &anew {
            let best = self.cheapest(x);
            self.enqueue(x, best);
        }
        self.ring = anew;
    }

    /// Lets `x`, if it is an inner vertex, know its neighbour `u`.
    fn offer(&mut self, x: u32, u: u32) {
        if self.input.kinds[x as usize] == Kind::Inner && self.best[x as usize].1 != NONE {
            let cost = self.cost(x, u);
            if cost < self.best[x as usize].0 {
                self.enqueue(x, (cost, u));
            }
        }
    }
}
