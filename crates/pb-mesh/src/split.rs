//! Splitting: a mesh that is no manifold becomes one by giving its sheets positions of their own.
//!
//! At an edge with more than two triangles, opposite half-edges are paired, the pair with the narrowest solid
//! between them first, so that touching solids part; what is left over becomes an open border (after Gueziec et al. 2001, "Cutting and stitching"). Then every position whose
//! triangles form several fans gets one copy per fan. The surface does not move; sheets that only touched may part by
//! a level's error when they are simplified.

use crate::mesh::{Mesh, Wedge};
use crate::topology::{Fans, Kind, classify};
use glam::DVec3;
use std::collections::BTreeMap;

/// Gives every fan of every position its own position. Returns how many positions were added.
///
/// Afterwards `mesh.positions` may hold equal positions; all else that [`Mesh`] promises stays true.
pub fn split_non_manifold(mesh: &mut Mesh) -> u64 {
    let triangles: Vec<[u32; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t)).collect();
    let fans = Fans::new(mesh.positions.len(), &triangles);
    let (kinds, broken) = classify(&triangles, &vec![0; triangles.len()], &fans, mesh.positions.len());
    if broken == 0 {
        return 0;
    }
    let broken: Vec<u32> = (0..mesh.positions.len() as u32).filter(|&v| kinds[v as usize] == Kind::Locked).collect();
    let links = pair_half_edges(mesh, &triangles, &fans, &broken);
    let before = mesh.positions.len();
    let mut moved: Vec<(u32, u32, u32)> = Vec::new();
    for &v in &broken {
        for fan in fans_of(v, fans.around(v), &triangles, &links).into_iter().skip(1) {
            let copy = mesh.positions.len() as u32;
            mesh.positions.push(mesh.positions[v as usize]);
            if !mesh.objects.of.is_empty() {
                mesh.objects.of.push(mesh.objects.of[v as usize]);
            }
            moved.extend(fan.into_iter().map(|t| (copy, t, v)));
        }
    }
    move_corners(mesh, &moved);
    (mesh.positions.len() - before) as u64
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
    /// Which corner of `triangle` lies at position `v`, by the growing list of (position, original wedge).
    fn corner_positions_of(&self, triangle: u32, records: &[(u32, u32)], v: u32) -> usize {
        let corners = self.triangles[triangle as usize];
        corners.iter().position(|&w| records[w as usize].0 == v).expect("the fan's triangles use the position")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!((broken(&m), split_non_manifold(&mut m), broken(&m)), (1, 1, 0));
        assert_eq!(m.positions[7], m.positions[3]);
        assert_eq!(m.wedges.len(), 8);
    }

    #[test]
    fn solids_that_share_an_edge_part_along_it() {
        let positions: Vec<[f64; 3]> = (0..6).map(|i| [i as f64, (i * i) as f64, (i * i * i) as f64]).collect();
        let mut m = mesh(&positions, &two_tetrahedra([0, 1, 2, 3], [2, 3, 4, 5]));
        assert_eq!(broken(&m), 2);
        assert!(split_non_manifold(&mut m) > 0);
        assert_eq!(broken(&m), 0);
    }

    #[test]
    fn a_third_sheet_at_an_edge_becomes_an_open_border() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut m = mesh(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!((split_non_manifold(&mut m), broken(&m)), (2, 0));
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let positions: Vec<[f64; 3]> = (0..4).map(|i| [i as f64, (i * i) as f64, (i * i * i) as f64]).collect();
        let mut m = mesh(&positions, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
        let before = m.clone();
        assert_eq!(split_non_manifold(&mut m), 0);
        assert_eq!(m, before);
    }
}
