//! Does a layout lie on itself? A map that turns no triangle is one to one exactly if its outline does not cross itself.

use super::piece::{Piece, next};
use glam::DVec2;

/// Most cells per axis of the grid that finds pairs of edges.
const MAX_CELLS: f64 = 256.0;

/// True when two edges of the outline of `disc` at `uv` that are not neighbours meet.
pub(super) fn overlaps(disc: &Piece, uv: &[DVec2]) -> bool {
    let edges: Vec<[u32; 2]> = disc.outline().iter().map(|&h| [disc.start(h), disc.start(next(h))]).collect();
    let ends = |e: u32| edges[e as usize].map(|v| uv[v as usize]);
    let low = uv.iter().fold(DVec2::INFINITY, |m, p| m.min(*p));
    let high = uv.iter().fold(DVec2::NEG_INFINITY, |m, p| m.max(*p));
    let per_axis = (edges.len() as f64 / 4.0).ceil().clamp(1.0, MAX_CELLS);
    let cell = ((high - low).max_element() / per_axis).max(f64::MIN_POSITIVE);
    let mut entries: Vec<(u32, u32)> = Vec::with_capacity(edges.len() * 4);
    for e in 0..edges.len() as u32 {
        let [a, b] = ends(e);
        let (from, to) = ((a.min(b) - low) / cell, (a.max(b) - low) / cell);
        for y in from.y as u32..=to.y as u32 {
            for x in from.x as u32..=to.x as u32 {
                entries.push(((y << 16) | x, e));
            }
        }
    }
    entries.sort_unstable();
    entries.chunk_by(|a, b| a.0 == b.0).any(|cell| {
        cell.iter().enumerate().any(|(i, &(_, e))| {
            cell[i + 1..].iter().any(|&(_, f)| {
                let ([a, b], [c, d]) = (edges[e as usize], edges[f as usize]);
                a != c && a != d && b != c && b != d && meet(ends(e), ends(f))
            })
        })
    })
}

/// True when two segments have a point in common.
fn meet([a, b]: [DVec2; 2], [c, d]: [DVec2; 2]) -> bool {
    let side = |p: DVec2, q: DVec2, r: DVec2| (q - p).perp_dot(r - p);
    let apart = |p: [DVec2; 2], q: [DVec2; 2]| {
        let (s, t) = (side(p[0], p[1], q[0]), side(p[0], p[1], q[1]));
        (s > 0.0 && t > 0.0) || (s < 0.0 && t < 0.0)
    };
    let boxes = a.min(b).cmple(c.max(d)).all() && c.min(d).cmple(a.max(b)).all();
    boxes && !apart([a, b], [c, d]) && !apart([c, d], [a, b])
}
