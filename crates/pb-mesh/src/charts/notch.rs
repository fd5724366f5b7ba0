//! Filling the notches of a border with triangles of air, so that a layout cannot close them: a jagged border would cross
//! itself otherwise (after the scaffold of Jiang, Schaefer, Panozzo 2017).

use super::piece::{Piece, next};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// Borders of this many vertices are left.
const SHORTEST: usize = 6;

/// A disc whose last triangles may be air.
pub(super) struct Disc {
    /// Triangles of the surface, then those of air.
    pub triangles: Vec<[u32; 3]>,
    /// How many triangles are of the surface.
    pub real: usize,
    /// Per vertex.
    pub points: Vec<DVec3>,
    /// Vertices on the outer border.
    pub on_border: Vec<bool>,
}

/// Adds air to `piece`, which is a disc, where the angle inside a border vertex is above `wide` radians.
pub(super) fn fill_notches(piece: &Piece, wide: f64) -> Disc {
    let outline: Vec<u32> = piece.outline().iter().map(|&h| piece.start(h)).collect();
    let mut disc = Disc {
        triangles: piece.triangles.clone(),
        real: piece.triangles.len(),
        points: piece.points.clone(),
        on_border: piece.on_border.clone(),
    };
    let n = outline.len();
    let mut slot = vec![u32::MAX; piece.points.len()];
    outline.iter().enumerate().for_each(|(i, &v)| slot[v as usize] = i as u32);
    let mut angles = vec![0.0; n];
    let mut edges: BTreeSet<(u32, u32)> = BTreeSet::new();
    for (h, &t) in piece.triangles.iter().flat_map(|t| [t; 3]).enumerate() {
        let h = h as u32;
        let (a, b) = (piece.start(h), piece.start(next(h)));
        let (sa, sb) = (slot[a as usize], slot[b as usize]);
        if sa != u32::MAX {
            angles[sa as usize] += angle_at(&disc.points, t, h as usize % 3);
            if sb != u32::MAX {
                edges.insert((sa.min(sb), sa.max(sb)));
            }
        }
    }
    let mut before: Vec<usize> = (0..n).map(|i| (i + n - 1) % n).collect();
    let mut after: Vec<usize> = (0..n).map(|i| (i + 1) % n).collect();
    let mut left = n;
    // Angles are positive, so their bits sort as they do. An entry is stale where the angle has grown.
    let mut queue: BinaryHeap<(u64, Reverse<usize>)> =
        (0..n).filter(|&i| angles[i] > wide).map(|i| (angles[i].to_bits(), Reverse(i))).collect();
    while let Some((bits, Reverse(i))) = queue.pop() {
        let (p, q) = (before[i], after[i]);
        let stale = angles[i].to_bits() != bits || !disc.on_border[outline[i] as usize];
        if stale || left <= SHORTEST || !edges.insert((p.min(q) as u32, p.max(q) as u32)) {
            continue;
        }
        // The border runs p, i, q with the surface on its left; the air is on its right.
        let air = [outline[p], outline[q], outline[i]];
        disc.triangles.push(air);
        disc.on_border[outline[i] as usize] = false;
        left -= 1;
        (after[p], before[q]) = (q, p);
        for (j, k) in [(p, 0), (q, 1)] {
            angles[j] += angle_at(&disc.points, air, k);
            if angles[j] > wide {
                queue.push((angles[j].to_bits(), Reverse(j)));
            }
        }
    }
    disc
}

/// Angle of a triangle at its corner `k`, in radians; a positive number.
fn angle_at(points: &[DVec3], t: [u32; 3], k: usize) -> f64 {
    let [a, b, c] = [0, 1, 2].map(|j| points[t[(k + j) % 3] as usize]);
    let (x, y) = ((b - a).dot(c - a), (b - a).cross(c - a).length());
    y.atan2(x).max(0.0)
}
