//! Collapses along the border of two clusters, on both sides at once (design I2).

use super::patch::Patch;
use crate::topology::Kind;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The border between two patches: matching local vertices that belong to exactly these two.
pub(super) struct Seam {
    /// The two clusters, ascending.
    pub clusters: [u32; 2],
    /// Local indices in both patches.
    pub vertices: Vec<[u32; 2]>,
}

/// A border vertex, where it would go in both patches, and what that costs.
#[derive(Clone, Copy)]
struct Move {
    cost: f32,
    to: [u32; 2],
    /// The border neighbour on the other side of the vertex, which becomes a neighbour of `to`.
    along: [u32; 2],
}

/// Collapses border vertices, cheapest first, while the cost is at most `limit`; returns how many.
pub(super) fn collapse_seam(seam: &Seam, a: &mut Patch, b: &mut Patch, limit: f32, level: u8) -> usize {
    let mut queue = BinaryHeap::new();
    let living = |a: &Patch, v: [u32; 2]| a.death[v[0] as usize] == u8::MAX;
    for (i, &v) in seam.vertices.iter().enumerate() {
        if let Some(first) = moves(a, b, v).first().filter(|_| living(a, v)) {
            queue.push(Reverse((first.cost.to_bits(), i as u32)));
        }
    }
    let mut count = 0;
    while let Some(Reverse((bits, i))) = queue.pop() {
        if f32::from_bits(bits) > limit {
            break;
        }
        let v = seam.vertices[i as usize];
        if !living(a, v) {
            continue;
        }
        for m in moves(a, b, v) {
            // Costs only change by collapses next door, which bring this vertex back with its new cost.
            if m.cost.to_bits() > bits && queue.peek().is_some_and(|t| m.cost.to_bits() > t.0.0) || m.cost > limit {
                queue.push(Reverse((m.cost.to_bits(), i)));
                break;
            }
            if legal(seam.clusters, a, b, v, &m) {
                a.apply(v[0], m.to[0], level);
                b.apply(v[1], m.to[1], level);
                count += 1;
                break;
            }
        }
    }
    count
}

/// Is the move legal in both patches?
fn legal(clusters: [u32; 2], a: &mut Patch, b: &mut Patch, v: [u32; 2], m: &Move) -> bool {
    a.keeps_topology(v[0], m.to[0], |a, x| edge_is_free(a, b, clusters[1], [v[1], m.to[1]], m.to[0], x, m.along[0]))
        && b.keeps_topology(v[1], m.to[1], |b, x| edge_is_free(b, a, clusters[0], [v[0], m.to[0]], m.to[1], x, m.along[1]))
        && a.keeps_orientation(v[0], m.to[0])
        && b.keeps_orientation(v[1], m.to[1])
}

/// May `here` get an edge from `u` to `x`? Not when another cluster may have it, or `there` (the cluster on the other
/// side, where `gone` collapses) has it before or after the collapse. The edge to `along` becomes the border of both.
fn edge_is_free(here: &Patch, there: &Patch, other: u32, gone: [u32; 2], u: u32, x: u32, along: u32) -> bool {
    if here.shared(u).iter().any(|c| *c != other && here.shared(x).contains(c)) {
        return false;
    }
    let twin = || there.input.global.binary_search(&here.input.global[x as usize]).expect("shared by both") as u32;
    x == along || gone.iter().all(|&g| there.edge_count(twin(), g) == 0)
}

/// The one or two moves of a border vertex along its border, cheapest first.
fn moves(a: &Patch, b: &Patch, v: [u32; 2]) -> Vec<Move> {
    let (Some(ends_a), Some(ends_b)) = (a.border_ends(v[0]), b.border_ends(v[1])) else { return Vec::new() };
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
            list.push(Move { cost: joint_cost(a, b, v, to), to, along: [ends_a[1 - k], ends_b[1 - k]] });
        }
    }
    list.sort_by(|x, y| x.cost.total_cmp(&y.cost));
    list
}

/// Mean squared distance over the planes of both sides, and the appearance term of the worse one.
fn joint_cost(a: &Patch, b: &Patch, v: [u32; 2], to: [u32; 2]) -> f32 {
    let side = |p: &Patch, v: u32, u: u32| {
        let d = p.input.positions[u as usize] - p.input.positions[v as usize];
        (p.geometric_cost(v, d), p.appearance_cost(v, u, d))
    };
    let ((mean_a, area_a), bend_a) = side(a, v[0], to[0]);
    let ((mean_b, area_b), bend_b) = side(b, v[1], to[1]);
    let area = area_a + area_b;
    let mean = if area > 0.0 { (mean_a * area_a + mean_b * area_b) / area } else { 0.0 };
    mean + bend_a.max(bend_b)
}
