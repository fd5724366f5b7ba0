//! Open borders: how far they move. What fills a hole that a level has closed is sampled, see [`back`](super::back).

use super::{FARTHEST_FROM_CORNERS, Field, relative};
use crate::closest::closest_on_segment;
use glam::Vec3;

/// Edges of a hole that is looked at whole; larger ones hardly close.
const MAX_EDGES: usize = 256;
/// Borders that are further away than so many times the distance of the surface are not those that a position was on.
const OTHER_BORDER: f32 = 3.0;
/// Largest distance of a point inside of a flat loop from it, in lengths of the loop: a circle's.
const FARTHEST_INSIDE: f32 = 0.16;

impl Field<'_> {
    /// The largest border distance of the corners of an input triangle, see [`border_distance`](Self::border_distance).
    pub(super) fn borders_distance(&self, t: [u32; 3], distances: [f32; 3]) -> f32 {
        (0..3).map(|k| self.border_distance(t[k], distances[k])).fold(0.0, f32::max)
    }

    /// Distance of a position on an open border, `distance` away from the level, to the border of the level; 0 for others, and where the
    /// level has none. A level's border goes no further over that of a small hole than to its middle: it has no vertices there.
    fn border_distance(&self, v: u32, distance: f32) -> f32 {
        if !self.pair.open[v as usize] {
            return 0.0;
        }
        let a = self.pair.ancestors[v as usize];
        if a == v {
            return 0.0;
        }
        let from = relative(self.pair.positions, v, a);
        let around = self.fans.around(a);
        let others = |t: u32| self.pair.coarse[t as usize].into_iter().filter(|&x| x != a);
        let mut best = f32::INFINITY;
        for &t in around {
            for x in others(t) {
                if around.iter().filter(|&&o| others(o).any(|y| y == x)).count() == 1 {
                    let q = closest_on_segment(Vec3::ZERO, from, relative(self.pair.positions, v, x));
                    best = best.min(q.length());
                }
            }
        }
        if best.is_infinite() {
            return 0.0;
        }
        match best > distance * OTHER_BORDER {
            // The hole's image may be wider on both sides, and is so far away.
            true => best.min(self.depth_of_hole(v) + distance * (1.0 + 2.0 * FARTHEST_FROM_CORNERS)),
            false => best,
        }
    }

    /// How far a point inside of the hole at an input position may be from its edges; infinite for large ones, 0 where there is none.
    fn depth_of_hole(&self, v: u32) -> f32 {
        let Some(mut next) = self.border_after(v) else { return 0.0 };
        let (mut last, mut length, mut low, mut high) = (Vec3::ZERO, 0.0, Vec3::ZERO, Vec3::ZERO);
        for _ in 0..MAX_EDGES {
            let at = relative(self.pair.positions, v, next);
            length += at.distance(last);
            (last, low, high) = (at, low.min(at), high.max(at));
            if next == v {
                return (length * FARTHEST_INSIDE).min(low.distance(high) * FARTHEST_FROM_CORNERS);
            }
            match self.border_after(next) {
                Some(after) => next = after,
                None => break,
            }
        }
        f32::INFINITY
    }

    /// The end of the border edge that begins at an input position.
    fn border_after(&self, v: u32) -> Option<u32> {
        let around = self.pair.fine.around(v);
        let corner = |t: u32, k: usize| {
            let t = self.pair.triangles[t as usize];
            t[(t.iter().position(|&x| x == v).expect("in its fan") + k) % 3]
        };
        around.iter().map(|&t| corner(t, 1)).find(|&end| !around.iter().any(|&o| corner(o, 2) == end))
    }
}

#[cfg(test)]
mod tests {
    use crate::deviation::{LevelPair, measure};
    use crate::topology::Fans;

    const CELL: i32 = 1000;
    const SIDE: u32 = 12;

    fn at(x: u32, y: u32) -> u32 {
        y * (SIDE + 1) + x
    }

    fn is_rim((x, y): (u32, u32)) -> bool {
        (4..=6).contains(&x) && (4..=6).contains(&y) && (x, y) != (5, 5)
    }

    /// The bound for a flat sheet of squares without the four in the middle, whose positions become what `ancestor` says.
    fn bound(ancestor: impl Fn((u32, u32)) -> (u32, u32)) -> f32 {
        let all: Vec<(u32, u32)> = (0..=SIDE).flat_map(|y| (0..=SIDE).map(move |x| (x, y))).collect();
        let positions: Vec<[i32; 3]> = all.iter().map(|&(x, y)| [x as i32 * CELL, y as i32 * CELL, 0]).collect();
        let is_square =
            |&&(x, y): &&(u32, u32)| x < SIDE && y < SIDE && !((4..=5).contains(&x) && (4..=5).contains(&y));
        let halves = |&(x, y): &(u32, u32)| {
            [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]]
        };
        let triangles: Vec<[u32; 3]> = all.iter().filter(is_square).flat_map(halves).collect();
        let ancestors: Vec<u32> = all.iter().map(|&p| ancestor(p)).map(|(x, y)| at(x, y)).collect();
        let shrunk = triangles.iter().map(|t| t.map(|v| ancestors[v as usize]));
        let coarse: Vec<[u32; 3]> = shrunk.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).collect();
        let outer = |&(x, y): &(u32, u32)| x == 0 || y == 0 || x == SIDE || y == SIDE;
        let pair = LevelPair {
            positions: &positions,
            triangles: &triangles,
            fine: &Fans::new(positions.len(), &triangles),
            cluster_of: &vec![0; triangles.len()],
            coarse: &coarse,
            fans: &Fans::new(positions.len(), &coarse),
            coarse_cluster_of: &vec![0; coarse.len()],
            ancestors: &ancestors,
            open: &all.iter().map(|p| outer(p) || is_rim(*p)).collect::<Vec<bool>>(),
        };
        measure(&pair, 1, &|_| ()).max[0] / CELL as f32
    }

    #[test]
    fn a_hole_that_closed_counts_with_its_depth_and_not_with_the_way_of_its_rim() {
        // All of the rim goes to one of its corners: the middle is now covered, and was a cell away from the surface.
        let closed = bound(|p| if is_rim(p) { (4, 4) } else { p });
        assert!((1.0..1.5).contains(&closed), "{closed}");
    }

    #[test]
    fn a_border_that_moves_counts_with_its_way() {
        assert!(bound(|p| p) < 1e-4);
        // A side of the hole moves to the other, so that it is half covered.
        let half = bound(|p| if is_rim(p) && p.0 == 4 { (5, if p.1 == 5 { 4 } else { p.1 }) } else { p });
        assert!((0.5..2.0).contains(&half), "{half}");
        // A side of the sheet moves in by two cells.
        let outside = bound(|(x, y)| (x.min(SIDE - 2), y));
        assert!((2.0..2.6).contains(&outside), "{outside}");
    }
}
