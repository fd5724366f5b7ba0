//! Which collapses keep the surface a manifold.

use super::corner_lists::NONE;
use super::patch::{EPOCH, Patch};
use crate::topology::Kind;

impl Patch {
    /// Does the collapse of the fan's centre onto `u` keep the surface a manifold with the same borders? Link condition
    /// (Dey et al. 1999). A new edge from `u` to a vertex that shares another cluster with it may exist there already:
    /// `free` says whether it does not.
    pub fn keeps_topology(&mut self, u: u32, free: impl Fn(&Patch, u32) -> bool) -> bool {
        let v = self.fan.center;
        self.gather(u);
        let shared_triangles = self.edge_triangles(v);
        let epoch_u = self.epoch;
        let touches_border = !self.shared(u).is_empty();
        self.epoch += EPOCH;
        let (mut common, mut opposite) = (0, NONE);
        for i in 0..self.fan.spokes.len() {
            let s = &self.fan.spokes[i];
            for x in [s.a, s.b] {
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
        if shared_triangles == 0 || common != shared_triangles {
            return shared_triangles == 1 && common == 2 && self.closed_hole(u).is_some();
        }
        match self.fan.spokes.len() {
            1 => self.corners.edge_count(opposite, u) > 1,
            3 => !self
                .corners
                .around(u)
                .iter()
                .any(|c| c.a != v && c.b != v && [c.a, c.b].iter().all(|&x| self.marks[x as usize] == self.epoch)),
            _ => true,
        }
    }
}

impl Patch {
    /// The third corner of a triangular hole that the collapse of the fan's centre onto `u` closes, if it does. Where scans
    /// have thousands of small holes, these could not simplify any further otherwise.
    pub fn closed_hole(&self, u: u32) -> Option<u32> {
        let open = |v: u32| self.input.kinds[v as usize] == Kind::Open;
        let [start, end] = if open(self.fan.center) && open(u) { self.fan.ends()? } else { return None };
        let third = if u == start { end } else { start };
        let mut beside = self.corners.around(u).iter().filter(|c| c.a == third || c.b == third);
        let only = beside.next().filter(|_| beside.next().is_none())?;
        // The border runs on from `u` to the third corner in the same sense.
        (open(third) && start != end && third == if u == start { only.a } else { only.b }).then_some(third)
    }
}

fn intersects(a: &[u32], b: &[u32]) -> bool {
    a.iter().any(|x| b.contains(x))
}
