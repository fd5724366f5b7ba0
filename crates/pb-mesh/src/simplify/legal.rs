//! Which collapses keep the surface a manifold.

use super::corner_lists::NONE;
use super::patch::{EPOCH, Patch};
use crate::topology::Kind;

impl Patch {
    /// Does the collapse of the fan's centre onto `u` keep the surface a manifold with the same borders? Link condition
    /// (Dey et al. 1999). A new edge from `u` to a vertex that shares another cluster with it may exist there already:
    /// `free` says whether it does not. Along an open border it may as well: then it is the other side of a hole that a
    /// border of clusters runs through, and that closes so.
    pub fn keeps_topology(&mut self, u: u32, free: impl Fn(&Patch, u32) -> bool) -> bool {
        let v = self.fan.center;
        self.gather(u);
        let shared_triangles = self.edge_triangles(v);
        let epoch_u = self.epoch;
        let touches_border = !self.shared(u).is_empty();
        let behind = if touches_border { self.open_border_behind(u).map_or(NONE, |b| b.0) } else { NONE };
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
                } else if touches_border && x != behind && intersects(self.shared(u), self.shared(x)) && !free(self, x)
                {
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
    /// Where the open border that the fan's centre would go along to `u` comes from, and whether the fan starts with `u`.
    fn open_border_behind(&self, u: u32) -> Option<(u32, bool)> {
        let open = self.input.kinds[self.fan.center as usize] == Kind::Open;
        match open.then(|| self.fan.ends())?? {
            [start, end] if start == end => None,
            [start, end] if u == start => Some((end, true)),
            [start, end] if u == end => Some((start, false)),
            _ => None,
        }
    }

    /// The third corner of a triangular hole that the collapse of the fan's centre onto `u` closes, if it does. Where scans
    /// have thousands of small holes, these could not simplify any further otherwise.
    ///
    /// One of the two corners that stay may be locked, where clusters meet: the hole is this cluster's alone as long as the
    /// other is not.
    pub fn closed_hole(&self, u: u32) -> Option<u32> {
        let kind = |v: u32| self.input.kinds[v as usize];
        let (third, starts) = self.open_border_behind(u)?;
        if !matches!([kind(u), kind(third)], [Kind::Open, Kind::Open | Kind::Locked] | [Kind::Locked, Kind::Open]) {
            return None;
        }
        let mut beside = self.corners.around(u).iter().filter(|c| c.a == third || c.b == third);
        let only = beside.next().filter(|_| beside.next().is_none())?;
        // The border runs on from `u` to the third corner in the same sense.
        (third == if starts { only.a } else { only.b }).then_some(third)
    }
}

fn intersects(a: &[u32], b: &[u32]) -> bool {
    a.iter().any(|x| b.contains(x))
}
