//! Which collapses keep the surface what it is.

use super::patch::{EPOCH, NONE, Patch};
use glam::Vec3;

/// A triangle may turn by at most about 75 degrees in one collapse.
const MIN_TURN_COSINE: f32 = 0.25;

impl Patch {
    /// Largest squared distance of `u` from the planes of the triangles around `v`.
    pub fn largest_turn(&self, v: u32, u: u32) -> f32 {
        let p = |x: u32| self.input.positions[x as usize];
        let d = p(u) - p(v);
        let height = |c: u32| {
            let (a, b) = self.spokes(c);
            let n = (p(a) - p(v)).cross(p(b) - p(v));
            let square = n.length_squared();
            if square > 0.0 { n.dot(d).powi(2) / square } else { 0.0 }
        };
        self.corners(v).map(height).fold(0.0, f32::max)
    }

    /// Does a collapse inside the cluster keep the surface a manifold with the same borders, and turn no triangle over?
    pub fn legal(&mut self, v: u32, u: u32) -> bool {
        self.keeps_topology(v, u, |_, _| false) && self.keeps_orientation(v, u)
    }

    /// Link condition (Dey et al. 1999). A new edge from `u` to a vertex that shares another cluster with it may exist
    /// there already: `free` says whether it does not.
    pub fn keeps_topology(&mut self, v: u32, u: u32, free: impl Fn(&Patch, u32) -> bool) -> bool {
        self.gather(u);
        let shared_triangles = self.edge_triangles(v);
        let epoch_u = self.epoch;
        let touches_border = !self.shared(u).is_empty();
        self.epoch += EPOCH;
        let (mut common, mut valence, mut opposite) = (0, 0, NONE);
        let mut c = self.first[v as usize];
        while c != NONE {
            let (now, living) = (c, self.input.triangles[c as usize / 3][0] != NONE);
            c = self.next[c as usize];
            if !living {
                continue;
            }
            valence += 1;
            let (a, b) = self.spokes(now);
            for x in [a, b] {
                let mark = self.marks[x as usize];
                if mark >= self.epoch || x == u {
                    continue;
                }
                self.marks[x as usize] = self.epoch;
                if mark > epoch_u {
                    (common, opposite) = (common + 1, x);
                } else if touches_border && intersects(self.shared(u), self.shared(x)) && !free(self, x) {
                    return false;
                }
            }
        }
        if common != shared_triangles || common == 0 {
            return false;
        }
        match valence {
            1 => self.edge_count(opposite, u) > 1,
            3 => !self.corners(u).any(|c| {
                let (a, b) = self.spokes(c);
                a != v && b != v && self.marks[a as usize] == self.epoch && self.marks[b as usize] == self.epoch
            }),
            _ => true,
        }
    }

    pub fn edge_count(&self, a: u32, b: u32) -> usize {
        self.corners(a).filter(|&c| self.spokes(c).0 == b || self.spokes(c).1 == b).count()
    }

    /// Does no triangle turn further than a collapse may turn it?
    pub fn keeps_orientation(&self, v: u32, u: u32) -> bool {
        let p = |x: u32| self.input.positions[x as usize];
        let (from, to) = (p(v), p(u));
        self.corners(v).all(|c| {
            let (a, b) = self.spokes(c);
            if a == u || b == u {
                return true;
            }
            let (old, new) = ((p(a) - from).cross(p(b) - from), (p(a) - to).cross(p(b) - to));
            let scale = old.length() * new.length();
            old == Vec3::ZERO || (old.dot(new) > MIN_TURN_COSINE * scale && scale > 0.0)
        })
    }
}

fn intersects(a: &[u32], b: &[u32]) -> bool {
    a.iter().any(|x| b.contains(x))
}
