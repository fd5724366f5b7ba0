//! Splitting: a mesh that is no manifold becomes one by giving its sheets positions of their own.
//!
//! At an edge with more than two triangles, opposite half-edges are paired, the pair with the narrowest solid
//! between them first, so that touching solids part; what is left over becomes an open border (after Gueziec et al. 2001,
//! "Cutting and stitching"). Then every position whose triangles form several fans gets one copy per fan. Where one fan
//! comes by the same edge twice, copies do not help: the sheets that come later get a position in the middle of the edge.
//! The surface does not move; sheets that only touched may part by a level's error when they are simplified.

use crate::mesh::{Mesh, Wedge};
use crate::topology::{Fans, Kind, classify};
use glam::DVec3;
use std::collections::BTreeMap;

/// What was added to a mesh that is no manifold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Added {
    /// Copies of positions, one per further fan.
    pub copies: u64,
    /// Positions in the middle of edges, one per further sheet.
    pub middles: u64,
    /// Triangles, where others were cut at such a position.
    pub triangles: u64,
}

/// Makes every position's triangles one disc or half disc.
///
/// Afterwards `mesh.positions` may hold equal positions, and there may be more triangles; all else that [`Mesh`] promises
/// stays true.
pub fn split_non_manifold(mesh: &mut Mesh) -> Added {
    let broken = Broken::of(mesh);
    if broken.positions.is_empty() {
        return Added::default();
    }
    let counts = |mesh: &Mesh| [mesh.positions.len() as u64, mesh.triangles.len() as u64];
    let [positions, triangles] = counts(mesh);
    part_fans(mesh, &broken);
    let [parted, _] = counts(mesh);
    part_edges(mesh, &Broken::of(mesh));
    let [all, cut] = counts(mesh);
    Added { copies: parted - positions, middles: all - parted, triangles: cut - triangles }
}

/// The places where a mesh is no manifold.
struct Broken {
    /// Position indices of all triangles.
    triangles: Vec<[u32; 3]>,
    fans: Fans,
    positions: Vec<u32>,
    links: Links,
}

impl Broken {
    fn of(mesh: &Mesh) -> Broken {
        let triangles: Vec<[u32; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t)).collect();
        let fans = Fans::new(mesh.positions.len(), &triangles);
        let (kinds, count) = classify(&triangles, &vec![0; triangles.len()], &fans, mesh.positions.len());
        let used = |v: u32| !fans.around(v).is_empty();
        let positions: Vec<u32> = match count {
            0 => Vec::new(),
            _ => (0..kinds.len() as u32).filter(|&v| kinds[v as usize] == Kind::Locked && used(v)).collect(),
        };
        let links = pair_half_edges(mesh, &triangles, &fans, &positions);
        Broken { triangles, fans, positions, links }
    }
}

/// Gives every fan of every position its own position.
fn part_fans(mesh: &mut Mesh, broken: &Broken) {
    let mut moved: Vec<(u32, u32, u32)> = Vec::new();
    for &v in &broken.positions {
        for fan in fans_of(v, broken.fans.around(v), &broken.triangles, &broken.links).into_iter().skip(1) {
            let copy = mesh.add_position(v, mesh.positions[v as usize]);
            moved.extend(fan.into_iter().map(|t| (copy, t, v)));
        }
    }
    move_corners(mesh, &moved);
}

/// Gives all but the first of the sheets at an edge, pairs of triangles or single ones, a position in its middle.
fn part_edges(mesh: &mut Mesh, broken: &Broken) {
    // Where the pieces of a triangle that was cut are.
    let mut pieces: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (&[a, b], pairs) in &broken.links {
        let at_edge = broken.fans.around(a).iter().filter(|&&t| broken.triangles[t as usize].contains(&b));
        let single = at_edge.filter(|t| !pairs.iter().any(|p| p.contains(t))).map(|&t| vec![t]);
        let sheets = pairs.iter().map(|p| p.to_vec()).chain(single);
        for sheet in sheets.skip(1) {
            let ends = [a, b].map(|v| mesh.positions[v as usize]);
            let middle = mesh.add_position(a, std::array::from_fn(|k| ends[0][k] * 0.5 + ends[1][k] * 0.5));
            for t in sheet {
                let list = pieces.entry(t).or_insert_with(|| vec![t]);
                let has_edge = |&t: &u32| [a, b].iter().all(|v| mesh.corner_positions(t as usize).contains(v));
                let piece = *list.iter().find(|t| has_edge(t)).expect("cuts leave the other edges whole");
                list.push(mesh.cut_triangle(piece, [a, b], middle));
            }
        }
    }
}

/// For each (triangle, neighbour) across an edge at a broken position: the pairs of triangles that stay joined, by edge.
type Links = BTreeMap<[u32; 2], Vec<[u32; 2]>>;

fn pair_half_edges(mesh: &Mesh, triangles: &[[u32; 3]], fans: &Fans, broken: &[u32]) -> Links {
    let mut edges: Vec<([u32; 2], bool, u32)> = Vec::new();
    for &v in broken {
        for &t in fans.around(v) {
            let tri = triangles[t as usize];
            for k in 0..3 {
                let (a, b) = (tri[k], tri[(k + 1) % 3]);
                if a == v || b == v {
                    edges.push(([a.min(b), a.max(b)], a < b, t));
                }
            }
        }
    }
    edges.sort_unstable();
    edges.dedup();
    let mut links = Links::new();
    for group in edges.chunk_by(|a, b| a.0 == b.0) {
        let side = |forward: bool| group.iter().filter(move |e| e.1 == forward).map(|e| e.2);
        let turn = |s: u32, t: u32| inner_angle(mesh, group[0].0, triangles[s as usize], triangles[t as usize]);
        let mut pairs: Vec<(f64, u32, u32)> =
            side(true).flat_map(|s| side(false).map(move |t| (s, t))).map(|(s, t)| (turn(s, t), s, t)).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut joined: Vec<[u32; 2]> = Vec::new();
        for (_, s, t) in pairs {
            if !joined.iter().any(|j| j[0] == s || j[1] == t) {
                joined.push([s, t]);
            }
        }
        links.insert(group[0].0, joined);
    }
    links
}

/// Angle from triangle `s` to triangle `t` around their common edge, through the back of `s`; radians in [0, 2 pi).
fn inner_angle(mesh: &Mesh, edge: [u32; 2], s: [u32; 3], t: [u32; 3]) -> f64 {
    let at = |v: u32| DVec3::from_array(mesh.positions[v as usize]);
    let along = (at(edge[1]) - at(edge[0])).normalize_or_zero();
    let out = |t: [u32; 3]| {
        let apex = t.into_iter().find(|v| !edge.contains(v)).expect("the corners of a triangle are distinct");
        (at(apex) - at(edge[0])).reject_from_normalized(along)
    };
    // `s` runs along the edge forward, so its front is on the side of along x out.
    let back = out(s).cross(along);
    let angle = f64::atan2(out(t).dot(back), out(t).dot(out(s)));
    if angle < 0.0 { angle + std::f64::consts::TAU } else { angle }
}

/// Groups the triangles around `v` into fans, the fan of the first triangle first.
fn fans_of(v: u32, around: &[u32], triangles: &[[u32; 3]], links: &Links) -> Vec<Vec<u32>> {
    let mut left: Vec<u32> = around.to_vec();
    let mut list = Vec::new();
    while !left.is_empty() {
        let mut fan = vec![left.remove(0)];
        let mut at = 0;
        while at < fan.len() {
            let t = fan[at];
            for x in triangles[t as usize].into_iter().filter(|&x| x != v) {
                for pair in links.get(&[v.min(x), v.max(x)]).into_iter().flatten() {
                    let other = if pair[0] == t { pair[1] } else { pair[0] };
                    if pair.contains(&t) && left.contains(&other) {
                        left.retain(|&o| o != other);
                        fan.push(other);
                    }
                }
            }
            at += 1;
        }
        list.push(fan);
    }
    list
}

/// Lets corners (new position, triangle, old position) use wedges of their new positions, and orders wedges anew.
fn move_corners(mesh: &mut Mesh, moved: &[(u32, u32, u32)]) {
    let mut records: Vec<(u32, u32)> = mesh.wedges.iter().enumerate().map(|(i, w)| (w.position, i as u32)).collect();
    let mut copies: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let old = mesh.wedges.len() as u32;
    for &(copy, t, v) in moved {
        let k = mesh.corner_positions_of(t, &records, v);
        let wedge = mesh.triangles[t as usize][k];
        let original = if wedge < old { wedge } else { records[wedge as usize].1 };
        let index = *copies.entry((copy, original)).or_insert_with(|| {
            records.push((copy, original));
            records.len() as u32 - 1
        });
        mesh.triangles[t as usize][k] = index;
    }
    let mut used = vec![false; records.len()];
    mesh.triangles.as_flattened().iter().for_each(|&w| used[w as usize] = true);
    let mut order: Vec<u32> = (0..records.len() as u32).filter(|&w| used[w as usize]).collect();
    order.sort_by_key(|&w| (records[w as usize].0, w));
    let mut number = vec![0; records.len()];
    order.iter().enumerate().for_each(|(i, &w)| number[w as usize] = i as u32);
    mesh.triangles.as_flattened_mut().iter_mut().for_each(|w| *w = number[*w as usize]);
    let wedge = |&w: &u32| {
        let (position, original) = records[w as usize];
        Wedge { position, ..mesh.wedges[original as usize] }
    };
    mesh.wedges = order.iter().map(wedge).collect();
}

impl Mesh {
    /// A new position of the object that `like` belongs to.
    fn add_position(&mut self, like: u32, at: [f64; 3]) -> u32 {
        self.positions.push(at);
        if !self.objects.of.is_empty() {
            self.objects.of.push(self.objects.of[like as usize]);
        }
        self.positions.len() as u32 - 1
    }

    /// Cuts a triangle from the middle of an edge, the last position, to the opposite corner; returns the new triangle.
    fn cut_triangle(&mut self, triangle: u32, edge: [u32; 2], middle: u32) -> u32 {
        let (corners, positions) = (self.triangles[triangle as usize], self.corner_positions(triangle as usize));
        let from = (0..3).find(|&k| !edge.contains(&positions[(k + 2) % 3])).expect("an edge leaves one corner out");
        let to = (from + 1) % 3;
        let [a, b] = [from, to].map(|k| &self.wedges[corners[k] as usize]);
        let sum = glam::Vec3::from_array(a.normal) + glam::Vec3::from_array(b.normal);
        let mean = |k: usize| ((u16::from(a.color[k]) + u16::from(b.color[k])) / 2) as u8;
        let wedge = Wedge {
            position: middle,
            normal: sum.try_normalize().map_or(a.normal, |n| n.to_array()),
            color: std::array::from_fn(mean),
        };
        let known = self.wedges.iter().rposition(|w| w.position != middle).map_or(0, |last| last + 1);
        let known = (known..self.wedges.len()).find(|&w| self.wedges[w] == wedge);
        let wedge = known.unwrap_or_else(|| {
            self.wedges.push(wedge);
            self.wedges.len() - 1
        }) as u32;
        let mut second = corners;
        second[from] = wedge;
        self.triangles.push(second);
        self.triangles[triangle as usize][to] = wedge;
        if let Some(texturing) = &mut self.texturing {
            texturing.material_of.push(texturing.material_of[triangle as usize]);
            for set in &mut texturing.corner_uvs {
                let mut second = set[triangle as usize];
                let half = std::array::from_fn(|k| (second[from][k] + second[to][k]) * 0.5);
                second[from] = half;
                set[triangle as usize][to] = half;
                set.push(second);
            }
        }
        self.triangles.len() as u32 - 1
    }

    /// Which corner of `triangle` lies at position `v`, by the growing list of (position, original wedge).
    fn corner_positions_of(&self, triangle: u32, records: &[(u32, u32)], v: u32) -> usize {
        let corners = self.triangles[triangle as usize];
        corners.iter().position(|&w| records[w as usize].0 == v).expect("the fan's triangles use the position")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mesh(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Mesh {
        let wedge = |i| Wedge { position: i, normal: [0.0, 0.0, 1.0], color: [255; 4] };
        let wedges = (0..positions.len() as u32).map(wedge).collect();
        Mesh { positions: positions.to_vec(), wedges, triangles: triangles.to_vec(), ..Mesh::default() }
    }

    fn broken(mesh: &Mesh) -> u64 {
        let triangles: Vec<[u32; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t)).collect();
        let fans = Fans::new(mesh.positions.len(), &triangles);
        classify(&triangles, &vec![0; triangles.len()], &fans, mesh.positions.len()).1
    }

    /// Two tetrahedra over the corners `a` and `b`.
    fn two_tetrahedra(a: [u32; 4], b: [u32; 4]) -> Vec<[u32; 3]> {
        let faces = |t: [u32; 4]| [[t[0], t[2], t[1]], [t[0], t[1], t[3]], [t[1], t[2], t[3]], [t[2], t[0], t[3]]];
        [faces(a), faces(b)].concat()
    }

    #[test]
    fn solids_that_share_a_corner_part_there() {
        let positions: Vec<[f64; 3]> = (0..7).map(|i| [i as f64, (i * i) as f64, (i * i * i) as f64]).collect();
        let mut m = mesh(&positions, &two_tetrahedra([0, 1, 2, 3], [3, 4, 5, 6]));
        assert_eq!((broken(&m), split_non_manifold(&mut m).copies, broken(&m)), (1, 1, 0));
        assert_eq!(m.positions[7], m.positions[3]);
        assert_eq!(m.wedges.len(), 8);
    }

    #[test]
    fn solids_that_share_an_edge_part_along_it() {
        let positions: Vec<[f64; 3]> = (0..6).map(|i| [i as f64, (i * i) as f64, (i * i * i) as f64]).collect();
        let mut m = mesh(&positions, &two_tetrahedra([0, 1, 2, 3], [2, 3, 4, 5]));
        assert_eq!(broken(&m), 2);
        assert!(split_non_manifold(&mut m).copies > 0);
        assert_eq!(broken(&m), 0);
    }

    #[test]
    fn a_third_sheet_at_an_edge_becomes_an_open_border() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut m = mesh(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!((split_non_manifold(&mut m).copies, broken(&m)), (2, 0));
    }

    #[test]
    fn a_fan_that_comes_by_an_edge_twice_gets_a_position_in_its_middle() {
        // A tetrahedron, and a flap whose inside angle with one side of the edge is smaller than the tetrahedron's.
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.5, 0.1], [0.5, 1.0, 0.0], [0.5, 0.0, 1.0]];
        let mut m = mesh(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 4, 3], [1, 3, 4]]);
        let places = Broken::of(&m);
        part_fans(&mut m, &places);
        assert_eq!((broken(&m), m.triangles.len()), (2, 5), "copies do not help");
        let added = split_non_manifold(&mut m);
        assert_eq!((added, broken(&m)), (Added { copies: 0, middles: 1, triangles: 1 }, 0));
        assert_eq!(m.positions[5], [0.5, 0.0, 0.0]);
    }

    fn area(mesh: &Mesh) -> f64 {
        let triangle = |t: usize| {
            let [a, b, c] = mesh.corner_positions(t).map(|v| DVec3::from_array(mesh.positions[v as usize]));
            (b - a).cross(c - a).length() * 0.5
        };
        (0..mesh.triangles.len()).map(triangle).sum()
    }

    proptest! {
        /// Whatever meets at edges and corners, in whatever orientation.
        #[test]
        fn anything_becomes_a_manifold_of_the_same_area(
            triangles in prop::collection::vec((0..7u32, 1..6u32, 1..6u32), 1..24),
        ) {
            let mut seen = std::collections::BTreeSet::new();
            let triangles: Vec<[u32; 3]> = triangles
                .into_iter()
                .map(|(a, b, c)| [a, (a + b) % 7, (a + c) % 7])
                .filter(|t| {
                    let mut sorted = *t;
                    sorted.sort_unstable();
                    t[1] != t[2] && seen.insert(sorted)
                })
                .collect();
            let positions: Vec<[f64; 3]> =
                (0..7).map(|i| [i as f64, (i * i % 5) as f64, (i * i * i % 7) as f64]).collect();
            let mut m = mesh(&positions, &triangles);
            let before = area(&m);
            split_non_manifold(&mut m);
            prop_assert_eq!(broken(&m), 0);
            prop_assert!((area(&m) - before).abs() <= 1e-9 * before);
            prop_assert!(m.wedges.is_sorted_by_key(|w| w.position));
        }
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let positions: Vec<[f64; 3]> = (0..4).map(|i| [i as f64, (i * i) as f64, (i * i * i) as f64]).collect();
        let mut m = mesh(&positions, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        let before = m.clone();
        assert_eq!(split_non_manifold(&mut m), Added::default());
        assert_eq!(m, before);
    }
}
