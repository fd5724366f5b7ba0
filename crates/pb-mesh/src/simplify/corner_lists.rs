//! The triangles of a patch as lists of corners, one list per vertex, that merge as vertices collapse.

/// No vertex, no corner.
pub(super) const NONE: u32 = u32::MAX;

/// A corner of a triangle: the two other vertices in the triangle's order, and the next corner at its vertex. All that a
/// walk around a vertex needs, in one place.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    /// [`NONE`] once the triangle is gone.
    pub a: u32,
    pub b: u32,
    next: u32,
}

/// Corners of triangle `t` are `3 t` to `3 t + 2`.
#[derive(Default)]
pub(super) struct CornerLists {
    first: Vec<u32>,
    corners: Vec<Corner>,
}

impl CornerLists {
    /// Triangles over `vertices` vertices; each list is in the order of the triangles.
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut first = vec![NONE; vertices];
        let mut corners = vec![Corner { a: NONE, b: NONE, next: NONE }; triangles.len() * 3];
        for (t, &[x, y, z]) in triangles.iter().enumerate().rev() {
            for (k, (v, a, b)) in [(x, y, z), (y, z, x), (z, x, y)].into_iter().enumerate() {
                let head = &mut first[v as usize];
                corners[t * 3 + k] = Corner { a, b, next: *head };
                *head = (t * 3 + k) as u32;
            }
        }
        CornerLists { first, corners }
    }

    /// Corners of living triangles at `v`.
    pub fn around(&self, v: u32) -> impl Iterator<Item = Corner> + '_ {
        let mut at = self.first[v as usize];
        std::iter::from_fn(move || {
            while at != NONE {
                let corner = self.corners[at as usize];
                at = corner.next;
                if corner.a != NONE {
                    return Some(corner);
                }
            }
            None
        })
    }

    /// The same with the number of each corner.
    pub fn numbered_around(&self, v: u32) -> impl Iterator<Item = (usize, Corner)> + '_ {
        let mut at = self.first[v as usize];
        std::iter::from_fn(move || {
            while at != NONE {
                let (number, corner) = (at as usize, self.corners[at as usize]);
                at = corner.next;
                if corner.a != NONE {
                    return Some((number, corner));
                }
            }
            None
        })
    }

    /// Living triangles on the edge between `v` and `w`.
    pub fn edge_count(&self, v: u32, w: u32) -> usize {
        self.around(v).filter(|c| c.a == w || c.b == w).count()
    }

    /// Drops all triangles around `v`.
    pub fn drop_around(&mut self, v: u32) {
        let mut at = self.first[v as usize];
        while at != NONE {
            self.drop_triangle(at);
            at = self.corners[at as usize].next;
        }
        self.first[v as usize] = NONE;
    }

    fn drop_triangle(&mut self, corner: u32) {
        let from = corner as usize / 3 * 3;
        self.corners[from..from + 3].iter_mut().for_each(|c| c.a = NONE);
    }

    /// Puts `u` where `v` was: triangles on the edge between them go, the others of `v` come to `u`'s list.
    pub fn merge(&mut self, v: u32, u: u32) {
        let mut kept = NONE;
        for from in [v, u] {
            let mut at = self.first[from as usize];
            while at != NONE {
                let Corner { a, b, next } = self.corners[at as usize];
                if from == v && a != NONE {
                    if a == u || b == u {
                        self.drop_triangle(at);
                    } else {
                        let (base, k) = (at as usize / 3 * 3, at as usize % 3);
                        self.corners[base + (k + 1) % 3].b = u;
                        self.corners[base + (k + 2) % 3].a = u;
                    }
                }
                if self.corners[at as usize].a != NONE {
                    self.corners[at as usize].next = kept;
                    kept = at;
                }
                at = next;
            }
        }
        self.first[v as usize] = NONE;
        self.first[u as usize] = kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn neighbours(lists: &CornerLists, v: u32) -> Vec<(u32, u32)> {
        let mut list: Vec<(u32, u32)> = lists.around(v).map(|c| (c.a, c.b)).collect();
        list.sort_unstable();
        list
    }

    #[test]
    fn a_merged_vertex_hands_its_triangles_over() {
        // A fan of four triangles around 0.
        let mut lists = CornerLists::new(5, &[[0, 1, 2], [0, 2, 3], [3, 4, 0], [1, 0, 4]]);
        assert_eq!(neighbours(&lists, 0), [(1, 2), (2, 3), (3, 4), (4, 1)]);
        lists.merge(0, 1);
        assert_eq!(neighbours(&lists, 1), [(2, 3), (3, 4)]);
        assert_eq!(neighbours(&lists, 3), [(1, 2), (4, 1)]);
        assert_eq!((neighbours(&lists, 0).len(), lists.edge_count(1, 3)), (0, 2));
        lists.drop_around(3);
        assert!((0..5).all(|v| neighbours(&lists, v).is_empty()));
    }
}
