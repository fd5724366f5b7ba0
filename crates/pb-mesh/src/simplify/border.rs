//! Collapses along the border of two clusters, on both sides at once (design I2).

use super::corner_lists::NONE;
use super::patch::Patch;
use crate::topology::Kind;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The border between two patches.
#[derive(Clone)]
pub(super) struct Seam {
    /// The two clusters, ascending.
    pub clusters: [u32; 2],
    /// Local indices in both patches of the positions that belong to exactly these two, ascending.
    vertices: Vec<[u32; 2]>,
    /// What the cheapest move of each vertex cost when it was last looked at.
    known: Vec<Known>,
}

/// The cost of a border vertex, and the weights of its quadrics at that time: it changes with them.
#[derive(Clone, Copy)]
struct Known {
    cost: f32,
    weights: [f32; 2],
}

/// Outdated as soon as it is asked for.
const UNKNOWN: Known = Known { cost: f32::INFINITY, weights: [f32::NAN; 2] };

impl Known {
    /// A vertex that charts hold may come free when triangles next to it go, which its weights do not tell.
    fn is_outdated(&self, a: &Patch, b: &Patch, v: [u32; 2]) -> bool {
        self.weights != weights(a, b, v) || self.cost == f32::INFINITY && a.input.charts.is_some()
    }
}

/// Where a border vertex would go in both patches, and what that costs.
#[derive(Clone, Copy)]
struct Move {
    cost: f32,
    to: [u32; 2],
    /// The border neighbour on the other side of the vertex, which becomes a neighbour of `to`.
    along: [u32; 2],
}

/// What a border vertex does when it comes up.
enum Choice {
    Now(Move),
    /// It costs more than thought: what lies inside changed since it was looked at.
    Later(f32),
    Never,
}

impl Seam {
    pub fn new(clusters: [u32; 2], vertices: Vec<[u32; 2]>) -> Self {
        let known = vec![UNKNOWN; vertices.len()];
        Seam { clusters, vertices, known }
    }

    /// Takes the new numbers of the vertices in both patches and forgets the dead.
    pub fn renumber(&mut self, a: Option<&[u32]>, b: Option<&[u32]>) {
        let of = |numbers: Option<&[u32]>, v: u32| numbers.map_or(v, |n| n[v as usize]);
        let (vertices, known) = self
            .vertices
            .iter()
            .zip(&self.known)
            .map(|(v, k)| ([of(a, v[0]), of(b, v[1])], *k))
            .filter(|(v, _)| !v.contains(&NONE))
            .unzip();
        (self.vertices, self.known) = (vertices, known);
    }

    /// Forgets what moves cost: they are weighed anew.
    pub fn reweigh(&mut self) {
        self.known.iter_mut().for_each(|k| *k = UNKNOWN);
    }

    /// Collapses border vertices, cheapest first, while the cost is at most `limit`; returns how many, at most `quota`.
    pub fn collapse(&mut self, a: &mut Patch, b: &mut Patch, limit: f32, quota: usize) -> usize {
        let mut queue = BinaryHeap::new();
        for i in 0..self.vertices.len() {
            let v = self.vertices[i];
            if a.is_alive(v[0]) && self.known[i].is_outdated(a, b, v) {
                self.look_at(i, a, b);
            }
            if a.is_alive(v[0]) && self.known[i].cost <= limit {
                queue.push(Reverse((self.known[i].cost.to_bits(), i as u32)));
            }
        }
        let mut count = 0;
        while let Some(Reverse((bits, i))) = queue.pop() {
            let v = self.vertices[i as usize];
            if f32::from_bits(bits) > limit || count == quota {
                break;
            }
            if !a.is_alive(v[0]) || self.known[i as usize].cost.to_bits() != bits {
                continue;
            }
            match self.choose(a, b, v, f32::from_bits(bits)) {
                Choice::Now(m) => {
                    a.apply(v[0], m.to[0]);
                    b.apply(v[1], m.to[1]);
                    count += 1;
                    for next in [m.to[0], m.along[0]] {
                        if let Ok(n) = self.vertices.binary_search_by_key(&next, |w| w[0]) {
                            self.look_at(n, a, b);
                            queue.push(Reverse((self.known[n].cost.to_bits(), n as u32)));
                        }
                    }
                }
                Choice::Later(cost) => {
                    self.known[i as usize].cost = cost;
                    queue.push(Reverse((cost.to_bits(), i)));
                }
                Choice::Never => {}
            }
        }
        count
    }

    /// The cheapest legal move of a border vertex, if it costs no more than `due`.
    fn choose(&self, a: &mut Patch, b: &mut Patch, v: [u32; 2], due: f32) -> Choice {
        for m in moves(a, b, v) {
            let cost = match m.cost {
                // What was collapsed is near the surface if one side is near it.
                low if low <= due => {
                    let far = a.reach(m.to[0]).min(b.reach(m.to[1]));
                    low.max(far).max(a.slide(m.to[0])).max(b.slide(m.to[1]))
                }
                high => high,
            };
            if cost > due {
                return Choice::Later(cost);
            }
            if legal(self.clusters, a, b, v, &m) {
                return Choice::Now(m);
            }
        }
        Choice::Never
    }

    fn look_at(&mut self, i: usize, a: &mut Patch, b: &mut Patch) {
        let v = self.vertices[i];
        let cost = moves(a, b, v).first().map_or(f32::INFINITY, |m| m.cost);
        self.known[i] = Known { cost, weights: weights(a, b, v) };
    }
}

/// Weights of the quadrics of a border vertex in both patches.
fn weights(a: &Patch, b: &Patch, v: [u32; 2]) -> [f32; 2] {
    [a.quadrics[v[0] as usize].weight, b.quadrics[v[1] as usize].weight]
}

/// Is the move of `v`, whose fans are laid out, legal in both patches?
fn legal(clusters: [u32; 2], a: &mut Patch, b: &mut Patch, v: [u32; 2], m: &Move) -> bool {
    a.keeps_topology(m.to[0], |a, x| edge_is_free(a, b, clusters[1], [v[1], m.to[1]], m.to[0], x, m.along[0]))
        && b.keeps_topology(m.to[1], |b, x| edge_is_free(b, a, clusters[0], [v[0], m.to[0]], m.to[1], x, m.along[1]))
}

/// May `here` get an edge from `u` to `x`? Not when another cluster may have it, or `there` (the cluster on the other
/// side, where `gone` collapses) has it before or after the collapse. The edge to `along` becomes the border of both.
fn edge_is_free(here: &Patch, there: &Patch, other: u32, gone: [u32; 2], u: u32, x: u32, along: u32) -> bool {
    if here.shared(u).iter().any(|c| *c != other && here.shared(x).contains(c)) {
        return false;
    }
    let twin = || there.local(here.input.global[x as usize]);
    x == along || gone.iter().all(|&g| there.corners.edge_count(twin(), g) == 0)
}

/// The one or two moves of a border vertex along its border that turn no triangle over, cheapest first. Lays out the fans
/// of `v` in both patches.
fn moves(a: &mut Patch, b: &mut Patch, v: [u32; 2]) -> Vec<Move> {
    a.spread(v[0]);
    b.spread(v[1]);
    let (Some(ends_a), Some(ends_b)) = (a.fan.ends(), b.fan.ends()) else { return Vec::new() };
    // The border runs the other way round in the other patch: its next vertex is our previous one.
    let same = |x: u32, y: u32| a.input.global[x as usize] == b.input.global[y as usize];
    let ends_b = if same(ends_a[0], ends_b[0]) { ends_b } else { [ends_b[1], ends_b[0]] };
    if !same(ends_a[0], ends_b[0]) || !same(ends_a[1], ends_b[1]) || ends_a[0] == ends_a[1] {
        return Vec::new();
    }
    let mut list = Vec::with_capacity(2);
    for k in 0..2 {
        let to = [ends_a[k], ends_b[k]];
        if matches!(a.input.kinds[to[0] as usize], Kind::Border | Kind::Locked) {
            let cost = (joint_cost(a, b, v, to) + a.stretch(to[0]).max(b.stretch(to[1])))
                .max(a.turn(to[0]))
                .max(b.turn(to[1]));
            list.push(Move { cost, to, along: [ends_a[1 - k], ends_b[1 - k]] });
        }
    }
    list.retain(|m| m.cost < f32::INFINITY);
    list.sort_by(|x, y| x.cost.total_cmp(&y.cost));
    list
}

/// What an inner vertex with the planes of both sides would cost, and the appearance term of the worse one.
fn joint_cost(a: &Patch, b: &Patch, v: [u32; 2], to: [u32; 2]) -> f32 {
    let side = |p: &Patch, v: u32, u: u32| {
        let d = p.input.positions[u as usize] - p.input.positions[v as usize];
        (p.quadrics[v as usize].at(d), p.appearance_cost(v, u, d))
    };
    let ((sum_a, bend_a), (sum_b, bend_b)) = (side(a, v[0], to[0]), side(b, v[1], to[1]));
    let weight = weights(a, b, v).iter().sum();
    (sum_a + sum_b) * a.weights.scale(weight, a.input.mean_area) + bend_a.max(bend_b)
}
