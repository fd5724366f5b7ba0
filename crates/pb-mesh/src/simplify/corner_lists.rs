//! The triangles of a patch as lists of corners, one list per vertex, that merge as vertices collapse.
//!
//! A list lies in one piece, so that a walk around a vertex touches one or two lines of the cache. Merged lists go to the
//! end of one common store; when that is full, all are moved together.

/// No vertex.
pub(super) const NONE: u32 = u32::MAX;

/// A corner of a triangle: the two other vertices in the triangle's order.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Corner {
    pub a: u32,
    pub b: u32,
}

impl Corner {
    fn has(self, v: u32) -> bool {
        self.a == v || self.b == v
    }
}

/// Place of a list in the store.
#[derive(Clone, Copy, Default)]
struct Span {
    start: u32,
    len: u32,
}

impl Span {
    fn range(self) -> std::ops::Range<usize> {
        self.start as usize..(self.start + self.len) as usize
    }
}

/// Lists of the corners of living triangles.
#[derive(Clone, Default)]
pub(super) struct CornerLists {
    spans: Vec<Span>,
    corners: Vec<Corner>,
    /// Of every corner in the store its number: those of triangle `t` are `3 t` to `3 t + 2`. Empty if nobody asks.
    numbers: Vec<u32>,
}

impl CornerLists {
    /// Triangles over `vertices` vertices; each list is in the order of the triangles.
    pub fn new(vertices: usize, triangles: &[[u32; 3]], numbered: bool) -> Self {
        let mut spans = vec![Span::default(); vertices];
        triangles.iter().flatten().for_each(|&v| spans[v as usize].len += 1);
        let mut start = 0;
        for s in &mut spans {
            (s.start, start, s.len) = (start, start + s.len, 0);
        }
        let mut corners = Vec::with_capacity(store_size(start as usize));
        corners.resize(start as usize, Corner { a: NONE, b: NONE });
        let mut numbers = vec![0; if numbered { corners.len() } else { 0 }];
        for (t, &[x, y, z]) in triangles.iter().enumerate() {
            for (k, (v, a, b)) in [(x, y, z), (y, z, x), (z, x, y)].into_iter().enumerate() {
                let span = &mut spans[v as usize];
                let at = span.range().end;
                corners[at] = Corner { a, b };
                if numbered {
                    numbers[at] = (t * 3 + k) as u32;
                }
                span.len += 1;
            }
        }
        CornerLists { spans, corners, numbers }
    }

    /// Corners of living triangles at `v`.
    pub fn around(&self, v: u32) -> &[Corner] {
        &self.corners[self.spans[v as usize].range()]
    }

    /// The same with the number of each corner.
    pub fn numbered_around(&self, v: u32) -> impl Iterator<Item = (usize, Corner)> + '_ {
        let range = self.spans[v as usize].range();
        self.numbers[range.clone()].iter().map(|&n| n as usize).zip(self.corners[range].iter().copied())
    }

    /// Living triangles on the edge between `v` and `w`.
    pub fn edge_count(&self, v: u32, w: u32) -> usize {
        self.around(v).iter().filter(|c| c.has(w)).count()
    }

    /// Drops all triangles around `v`.
    pub fn drop_around(&mut self, v: u32) {
        for i in self.spans[v as usize].range() {
            let Corner { a, b } = self.corners[i];
            self.remove(a, Corner { a: b, b: v });
            self.remove(b, Corner { a: v, b: a });
        }
        self.spans[v as usize].len = 0;
    }

    fn place_of(&self, v: u32, corner: Corner) -> usize {
        let span = self.spans[v as usize];
        let at =
            self.around(v).iter().position(|c| *c == corner).expect("each triangle is in the lists of its corners");
        span.start as usize + at
    }

    fn remove(&mut self, v: u32, corner: Corner) {
        let at = self.place_of(v, corner);
        let span = &mut self.spans[v as usize];
        span.len -= 1;
        let last = span.range().end;
        self.corners[at] = self.corners[last];
        if !self.numbers.is_empty() {
            self.numbers[at] = self.numbers[last];
        }
    }

    /// Puts `u` where `v` was: triangles on the edge between them go, the others of `v` come to `u`'s list.
    pub fn merge(&mut self, v: u32, u: u32) {
        let most = (self.spans[v as usize].len + self.spans[u as usize].len) as usize;
        if self.corners.len() + most > self.corners.capacity() {
            self.move_together(most);
        }
        let start = self.corners.len();
        for i in self.spans[u as usize].range() {
            if !self.corners[i].has(v) {
                self.push_copy(i);
            }
        }
        for i in self.spans[v as usize].range() {
            let Corner { a, b } = self.corners[i];
            match (a == u, b == u) {
                (true, _) => self.remove(b, Corner { a: v, b: u }),
                (_, true) => self.remove(a, Corner { a: u, b: v }),
                _ => {
                    let (at_a, at_b) =
                        (self.place_of(a, Corner { a: b, b: v }), self.place_of(b, Corner { a: v, b: a }));
                    self.corners[at_a].b = u;
                    self.corners[at_b].a = u;
                    self.push_copy(i);
                }
            }
        }
        self.spans[v as usize].len = 0;
        self.spans[u as usize] = Span { start: start as u32, len: (self.corners.len() - start) as u32 };
    }

    fn push_copy(&mut self, i: usize) {
        self.corners.push(self.corners[i]);
        if !self.numbers.is_empty() {
            self.numbers.push(self.numbers[i]);
        }
    }

    /// Moves all lists to the front of a new store with room for at least `more` corners.
    fn move_together(&mut self, more: usize) {
        let old = std::mem::take(self);
        let living: usize = old.spans.iter().map(|s| s.len as usize).sum();
        self.corners.reserve_exact(store_size(living).max(living + more));
        for &span in &old.spans {
            self.spans.push(Span { start: self.corners.len() as u32, len: span.len });
            self.corners.extend_from_slice(&old.corners[span.range()]);
            if !old.numbers.is_empty() {
                self.numbers.extend_from_slice(&old.numbers[span.range()]);
            }
        }
    }

    /// Reads everything once; the answer has no meaning.
    pub fn warm_up(&self) -> u32 {
        let spans = self.spans.iter().step_by(8).fold(0, |sum: u32, s| sum.wrapping_add(s.start));
        self.corners.iter().step_by(8).fold(spans, |sum, c| sum.wrapping_add(c.a))
    }

    /// Forgets the vertices that do not live, which have no triangles; the others get the number that `of` says.
    pub fn keep(&mut self, living: &[bool], of: impl Fn(u32) -> u32) {
        let mut alive = living.iter();
        self.spans.retain(|_| *alive.next().expect("one of each vertex"));
        self.move_together(0);
        self.corners.iter_mut().for_each(|c| *c = Corner { a: of(c.a), b: of(c.b) });
    }
}

/// Room for merged lists beside so many corners.
fn store_size(corners: usize) -> usize {
    corners + corners / 4
}

#[cfg(test)]
mod tests {
    use super::*;

    fn neighbours(lists: &CornerLists, v: u32) -> Vec<(u32, u32)> {
        let mut list: Vec<(u32, u32)> = lists.around(v).iter().map(|c| (c.a, c.b)).collect();
        list.sort_unstable();
        list
    }

    #[test]
    fn a_merged_vertex_hands_its_triangles_over() {
        // A fan of four triangles around 0.
        let mut lists = CornerLists::new(5, &[[0, 1, 2], [0, 2, 3], [3, 4, 0], [1, 0, 4]], false);
        assert_eq!(neighbours(&lists, 0), [(1, 2), (2, 3), (3, 4), (4, 1)]);
        lists.merge(0, 1);
        assert_eq!(neighbours(&lists, 1), [(2, 3), (3, 4)]);
        assert_eq!(neighbours(&lists, 3), [(1, 2), (4, 1)]);
        assert_eq!((neighbours(&lists, 0).len(), lists.edge_count(1, 3)), (0, 2));
        lists.drop_around(3);
        assert!((0..5).all(|v| neighbours(&lists, v).is_empty()));
    }
}
