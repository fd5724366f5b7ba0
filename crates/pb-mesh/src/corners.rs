//! Which triangle corners use each vertex, as one flat list; and what the edges and fans around a vertex say about
//! the surface there: open borders, non-manifold edges and vertices.
//!
//! Counts only; what to do about a non-manifold place is decided by whoever simplifies.

use crate::topology::group;
use rayon::prelude::*;
use std::ops::AddAssign;

/// Vertices per parallel job; fixed, so that the work is cut the same way on any number of threads.
pub const VERTEX_CHUNK: usize = 1 << 14;

/// Incident corners per vertex. Corner `3 t + k` is the k-th of triangle `t`.
pub struct Corners {
    /// Where each vertex' corners begin in `corners`, and the end.
    offsets: Vec<u32>,
    /// Ascending within a vertex.
    corners: Vec<u32>,
    /// Vertices whose triangles do not form one closed disc, ascending: borders and whatever is broken.
    rough: Vec<u32>,
}

impl Corners {
    /// Takes triangles with indices below `vertex_count`, at most `u32::MAX / 3` of them.
    pub fn new(triangles: &[[u32; 3]], vertex_count: usize) -> Corners {
        assert!(triangles.len() <= (u32::MAX / 3) as usize, "corner indices are 32 bits wide");
        let (offsets, corners) = group(vertex_count, triangles.as_flattened().as_chunks::<1>().0);
        let mut all = Corners { offsets, corners, rough: Vec::new() };
        let rough = |vertices: std::ops::Range<usize>| {
            vertices.filter(|&v| !is_disc(triangles, all.of(v))).map(|v| v as u32).collect::<Vec<_>>()
        };
        let rough: Vec<Vec<u32>> = all.chunks().map(rough).collect();
        all.rough = rough.concat();
        all
    }

    /// The corners at a vertex, ascending.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.corners[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Ranges of vertices for parallel jobs, in order.
    pub fn chunks(&self) -> impl IndexedParallelIterator<Item = std::ops::Range<usize>> {
        let count = self.vertex_count();
        (0..count.div_ceil(VERTEX_CHUNK))
            .into_par_iter()
            .map(move |c| c * VERTEX_CHUNK..count.min((c + 1) * VERTEX_CHUNK))
    }
}

/// The vertices that follow and precede a corner's own in its triangle.
pub fn next_and_previous(triangles: &[[u32; 3]], corner: u32) -> (u32, u32) {
    let triangle = &triangles[corner as usize / 3];
    match corner % 3 {
        0 => (triangle[1], triangle[2]),
        1 => (triangle[2], triangle[0]),
        _ => (triangle[0], triangle[1]),
    }
}

/// Fans up to this size are looked at on the stack.
const SMALL_FAN: usize = 16;

/// Do the triangles of these corners, all at one vertex, form one closed disc around it, each edge with one triangle on
/// either side? Quick, and may say no of large ones. Of no triangles it says yes: nothing is wrong there.
fn is_disc(triangles: &[[u32; 3]], incident: &[u32]) -> bool {
    let count = incident.len();
    if count == 0 {
        return true;
    }
    if !(3..=SMALL_FAN).contains(&count) {
        return false;
    }
    let (mut next, mut previous) = ([0; SMALL_FAN], [0; SMALL_FAN]);
    for (slot, &corner) in incident.iter().enumerate() {
        (next[slot], previous[slot]) = next_and_previous(triangles, corner);
    }
    let (next, mut at) = (&next[..count], 0);
    for step in 1..=count {
        let mut following = (0..count).filter(|&slot| next[slot] == previous[at]);
        match (following.next(), following.next()) {
            (Some(slot), None) if (slot == 0) == (step == count) => at = slot,
            _ => return false,
        }
    }
    true
}

/// Triangles with the same three vertices as an earlier one, whatever their rotation and orientation; ascending.
pub fn duplicate_triangles(triangles: &[[u32; 3]], corners: &Corners) -> Vec<u32> {
    // The corners of two such triangles are no discs.
    let mut found: Vec<u32> = corners
        .rough
        .par_chunks(VERTEX_CHUNK)
        .flat_map_iter(|vertices| {
            let mut others: Vec<(u32, u32, u32)> = Vec::new();
            let mut repeats = Vec::new();
            for &v in vertices {
                others.clear();
                others.extend(corners.of(v as usize).iter().filter_map(|&corner| {
                    let (a, b) = next_and_previous(triangles, corner);
                    (v <= a.min(b)).then_some((a.min(b), a.max(b), corner / 3))
                }));
                others.sort_unstable();
                repeats.extend(others.windows(2).filter(|w| (w[0].0, w[0].1) == (w[1].0, w[1].1)).map(|w| w[1].2));
            }
            repeats
        })
        .collect();
    found.par_sort_unstable();
    found
}

/// How the triangles of a mesh hang together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Edges of one triangle.
    pub boundary_edges: u64,
    /// Edges of more than two triangles, or of two that run along it in the same direction.
    pub nonmanifold_edges: u64,
    /// Vertices where the incident triangles form more than one fan.
    pub nonmanifold_vertices: u64,
}

impl AddAssign for Topology {
    fn add_assign(&mut self, other: Topology) {
        self.boundary_edges += other.boundary_edges;
        self.nonmanifold_edges += other.nonmanifold_edges;
        self.nonmanifold_vertices += other.nonmanifold_vertices;
    }
}

/// Counts borders and non-manifold places. No triangle may have a vertex twice.
pub fn topology(triangles: &[[u32; 3]], corners: &Corners) -> Topology {
    let parts: Vec<Topology> = corners
        .rough
        .par_chunks(VERTEX_CHUNK)
        .map(|vertices| {
            let mut total = Topology::default();
            let mut star = Star::default();
            for &v in vertices {
                total += star.examine(triangles, v, corners.of(v as usize));
            }
            total
        })
        .collect();
    parts.into_iter().fold(Topology::default(), |mut sum, part| {
        sum += part;
        sum
    })
}

/// An edge at a vertex, seen from one corner: other end, slot among the vertex' corners, whether the triangle runs
/// along it away from the vertex. One number, so that sorting is quick.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Spoke(u64);

impl Spoke {
    fn new(end: u32, slot: usize, leaves: bool) -> Spoke {
        Spoke(u64::from(end) << 32 | (slot as u64) << 1 | u64::from(leaves))
    }

    fn end(self) -> u32 {
        (self.0 >> 32) as u32
    }

    fn slot(self) -> usize {
        (self.0 as u32 >> 1) as usize
    }

    fn leaves(self) -> bool {
        self.0 & 1 == 1
    }
}

/// The edges around one vertex; kept between vertices for its buffers.
#[derive(Default)]
pub struct Star {
    /// Both edges of each corner, in order of their other ends.
    spokes: Vec<Spoke>,
    fan: Vec<u32>,
}

impl Star {
    /// Collects the edges around `vertex`, whose corners are `incident`.
    pub fn gather(&mut self, triangles: &[[u32; 3]], incident: &[u32]) {
        self.spokes.clear();
        for (slot, &corner) in incident.iter().enumerate() {
            let (next, previous) = next_and_previous(triangles, corner);
            self.spokes.push(Spoke::new(next, slot, true));
            self.spokes.push(Spoke::new(previous, slot, false));
        }
        self.spokes.sort_unstable();
    }

    /// Joins corners that share an edge into fans where `smooth(slot, slot)` says so; the answer is one fan name per
    /// slot, the lowest slot of the fan.
    pub fn fans(&mut self, count: usize, mut smooth: impl FnMut(usize, usize) -> bool) -> &[u32] {
        self.fan.clear();
        self.fan.extend(0..count as u32);
        for pair in self.spokes.windows(2) {
            let (a, b) = (pair[0].slot(), pair[1].slot());
            if pair[0].end() == pair[1].end() && smooth(a, b) {
                let (a, b) = (root(&mut self.fan, a as u32), root(&mut self.fan, b as u32));
                self.fan[a.max(b) as usize] = a.min(b);
            }
        }
        for slot in 0..count as u32 {
            self.fan[slot as usize] = root(&mut self.fan, slot);
        }
        &self.fan
    }

    /// Edges are counted at their lower end.
    fn examine(&mut self, triangles: &[[u32; 3]], vertex: u32, incident: &[u32]) -> Topology {
        self.gather(triangles, incident);
        let mut found = Topology::default();
        for edge in self.spokes.chunk_by(|a, b| a.end() == b.end()).filter(|edge| edge[0].end() > vertex) {
            let leaving = edge.iter().filter(|spoke| spoke.leaves()).count();
            match (edge.len(), leaving) {
                (1, _) => found.boundary_edges += 1,
                (2, 1) => {}
                _ => found.nonmanifold_edges += 1,
            }
        }
        let fans = self.fans(incident.len(), |_, _| true);
        found.nonmanifold_vertices += u64::from(fans.iter().any(|&fan| fan != 0));
        found
    }
}

fn root(fan: &mut [u32], mut slot: u32) -> u32 {
    while fan[slot as usize] != slot {
        fan[slot as usize] = fan[fan[slot as usize] as usize];
        slot = fan[slot as usize];
    }
    slot
}

#[cfg(test)]
mod tests {
    use super::*;

    fn examined(triangles: &[[u32; 3]], vertex_count: usize) -> (u64, u64, u64) {
        let t = topology(triangles, &Corners::new(triangles, vertex_count));
        (t.boundary_edges, t.nonmanifold_edges, t.nonmanifold_vertices)
    }

    #[test]
    fn counts_borders_and_nonmanifold_places() {
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(examined(&tetrahedron, 4), (0, 0, 0));
        assert_eq!(examined(&tetrahedron[..3], 4), (3, 0, 0));
        assert_eq!(examined(&[[0, 1, 2], [0, 1, 3]], 4), (4, 1, 0), "two triangles of opposite orientation");
        assert_eq!(examined(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]], 5), (6, 1, 0), "three triangles at an edge");
        assert_eq!(examined(&[[0, 1, 2], [0, 3, 4]], 5), (6, 0, 1), "two fans at a vertex");
    }

    #[test]
    fn finds_duplicates_of_any_rotation_and_orientation() {
        let triangles = [[0, 1, 2], [3, 2, 1], [2, 0, 1], [1, 0, 2], [0, 1, 3]];
        assert_eq!(duplicate_triangles(&triangles, &Corners::new(&triangles, 4)), [2, 3]);
    }
}
