//! Simplification in unison on generated closed meshes: promises of design I2 and I6.

use glam::{DVec3, Vec3};
use pb_mesh::segment::{Segmentation, segment};
use pb_mesh::simplify::{Collapses, UnisonInput, simplify};
use pb_mesh::topology::{Fans, Kind, classify};
use std::collections::HashMap;

/// A bumpy closed surface: a cube's six `n` x `n` grids pushed onto a sphere with waves.
fn bumpy_sphere(n: u32) -> (Vec<[i32; 3]>, Vec<[u32; 3]>) {
    let mut index = HashMap::new();
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut vertex = |p: [i64; 3]| {
        *index.entry(p).or_insert_with(|| {
            let d = DVec3::from_array(p.map(|x| (x as f64 / n as f64 * 2.0 - 1.0) * std::f64::consts::FRAC_PI_4))
                .to_array()
                .map(f64::tan);
            let d = DVec3::from_array(d).normalize();
            let r = 1.0 + 0.1 * (d.x * 7.0).sin() * (d.y * 5.0).cos() + 0.02 * (d.z * 31.0 + d.x * 17.0).sin();
            positions.push((d * r * 1e6).to_array().map(|x| x.round() as i32));
            positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, n as i64] {
            for i in 0..n as i64 {
                for j in 0..n as i64 {
                    let mut corner = |a: i64, b: i64| {
                        let mut p = [0; 3];
                        (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (side, a, b);
                        vertex(p)
                    };
                    let q = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                    let q = if side == 0 { [q[3], q[2], q[1], q[0]] } else { q };
                    triangles.push([q[0], q[1], q[2]]);
                    triangles.push([q[0], q[2], q[3]]);
                }
            }
        }
    }
    (positions, triangles)
}

struct Baked {
    triangles: Vec<[u32; 3]>,
    cluster_of: Vec<u32>,
    kinds: Vec<Kind>,
    collapses: Collapses,
}

fn run(positions: &[[i32; 3]], triangles: &[[u32; 3]], cluster: usize, levels: usize, ratio: f64) -> Baked {
    let doubles: Vec<[f64; 3]> = positions.iter().map(|p| p.map(f64::from)).collect();
    let segmentation = segment(&doubles, triangles, triangles, cluster);
    let mut cluster_of = vec![0; triangles.len()];
    for c in 0..segmentation.len() {
        segmentation.cluster(c).iter().for_each(|&t| cluster_of[t as usize] = c as u32);
    }
    let fans = Fans::new(positions.len(), triangles);
    let (kinds, _) = classify(triangles, &cluster_of, &fans, positions.len());
    let normals = vec![Vec3::ZERO; positions.len()];
    let input = UnisonInput {
        positions,
        normals: &normals,
        triangles,
        segmentation: &segmentation,
        cluster_of: &cluster_of,
        fans: &fans,
        kinds: &kinds,
        texture: None,
    };
    let start = std::time::Instant::now();
    let collapses = simplify(&input, levels, ratio, &|_| ());
    println!(
        "{} triangles, {} clusters: {:?} in {:?}",
        triangles.len(),
        segmentation.len(),
        collapses.counts,
        start.elapsed()
    );
    Baked { triangles: triangles.to_vec(), cluster_of, kinds, collapses }
}

/// Triangles of a level and their clusters.
fn level(b: &Baked, level: u8) -> Vec<([u32; 3], u32)> {
    let at = |t: &[u32; 3]| t.map(|v| b.collapses.ancestor(v, level));
    b.triangles
        .iter()
        .zip(&b.cluster_of)
        .map(|(t, &c)| (at(t), c))
        .filter(|(t, _)| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
        .collect()
}

/// How often each directed edge of a level is used.
fn edge_counts(b: &Baked, l: u8) -> HashMap<[u32; 2], i32> {
    let mut edges = HashMap::new();
    for (t, _) in level(b, l) {
        (0..3).for_each(|k| *edges.entry([t[k], t[(k + 1) % 3]]).or_default() += 1);
    }
    edges
}

#[test]
fn every_level_is_closed_and_four_times_smaller() {
    let (positions, triangles) = bumpy_sphere(70);
    let b = run(&positions, &triangles, 6000, 5, 4.0);
    for l in 0..5u8 {
        let edges = edge_counts(&b, l);
        assert!(edges.iter().all(|(e, n)| *n == 1 && edges.get(&[e[1], e[0]]) == Some(&1)), "level {l} is not closed");
        let count = b.collapses.counts[l as usize] as f64;
        let target = positions.len() as f64 / 4f64.powi(l as i32);
        assert!((count / target - 1.0).abs() < 0.02, "level {l}: {count} of {target}");
    }
}

#[test]
fn border_vertices_collapse_only_along_their_border() {
    let (positions, triangles) = bumpy_sphere(50);
    let b = run(&positions, &triangles, 2000, 6, 2.0);
    let mut users = vec![Vec::new(); positions.len()];
    for (t, c) in b.triangles.iter().zip(&b.cluster_of) {
        t.iter().for_each(|&v| users[v as usize].push(*c));
    }
    users.iter_mut().for_each(|u| {
        u.sort_unstable();
        u.dedup();
    });
    for v in 0..positions.len() {
        let p = b.collapses.parent[v] as usize;
        if p != v {
            assert!(users[v].len() < 3 && b.kinds[v] != Kind::Locked, "a corner died");
            assert!(users[v].iter().all(|c| users[p].contains(c)), "{v} left its clusters");
        }
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let (positions, triangles) = bumpy_sphere(40);
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        pool.install(|| run(&positions, &triangles, 1500, 5, 4.0)).collapses.parent
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn triangular_holes_close_instead_of_stopping_the_simplification() {
    let (positions, mut triangles) = bumpy_sphere(40);
    let mut near_hole = vec![false; positions.len()];
    triangles.retain(|t| {
        let hole = t.iter().all(|&v| !near_hole[v as usize]) && t[0] % 5 == 0;
        if hole {
            t.iter().for_each(|&v| near_hole[v as usize] = true);
        }
        !hole
    });
    let holes = near_hole.iter().filter(|&&n| n).count() / 3;
    assert!(holes > 300, "{holes} holes");
    // Clusters that are one, and borders of clusters through many of the holes: their corners there never move.
    for (cluster_triangles, levels, tolerance) in [(100_000, 5, 1.02), (2000, 3, 1.15)] {
        let b = run(&positions, &triangles, cluster_triangles, 5, 4.0);
        for l in 0..levels {
            assert!(edge_counts(&b, l).values().all(|n| *n == 1), "level {l} is no manifold");
            let count = b.collapses.counts[l as usize] as f64;
            let target = positions.len() as f64 / 4f64.powi(l as i32);
            assert!(count / target < tolerance, "level {l}: {count} of {target}");
        }
    }
}

#[test]
fn thin_spikes_keep_their_tips() {
    // Spikes a fifth of the radius high that rise from gentle feet: planes hardly resist their tips.
    let (mut positions, triangles) = bumpy_sphere(70);
    let feet: Vec<DVec3> = (0..12).map(|i| spread_direction(i, 12)).collect();
    for p in &mut positions {
        let at = DVec3::from_array(p.map(f64::from));
        let d = at.normalize();
        let near = feet.iter().map(|f| f.angle_between(d)).fold(f64::INFINITY, f64::min);
        let height = (1.0 - near / 0.3).max(0.0).powi(6) * 0.2e6;
        *p = (at + d * height).to_array().map(|x| x.round() as i32);
    }
    let b = run(&positions, &triangles, 6000, 4, 4.0);
    for foot in &feet {
        let far = |v: &u32| DVec3::from_array(positions[*v as usize].map(f64::from)).dot(*foot);
        let tip = (0..positions.len() as u32).max_by(|x, y| far(x).total_cmp(&far(y))).expect("positions");
        let left = level(&b, 3).into_iter().flat_map(|(t, _)| t).map(|v| far(&v)).fold(0.0, f64::max);
        assert!(far(&tip) - left < 0.02e6, "the tip at {foot} lost {} of 200000", far(&tip) - left);
    }
}

/// Point `i` of `n` spread over the unit sphere (Fibonacci).
fn spread_direction(i: u32, n: u32) -> DVec3 {
    let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n);
    let angle = f64::from(i) * 2.399_963_229_728_653;
    DVec3::new(angle.cos() * (1.0 - z * z).sqrt(), angle.sin() * (1.0 - z * z).sqrt(), z)
}

#[test]
fn no_two_clusters_get_the_same_edge() {
    // A flat pentagon with a front and a back, each a cluster: chords from 0 in front, from 1 in the back. The shortest edge
    // joins 0 and 1, but then both sides would have a chord from there to 3. Of the others only 4 is nearly straight.
    let positions = [[1000, 0, 0], [1000, 14, 0], [309, 951, 0], [-809, 588, 0], [92, 283, 0]];
    let triangles = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [1, 3, 2], [1, 4, 3], [1, 0, 4]];
    let cluster_of = [0, 0, 0, 1, 1, 1];
    let segmentation = Segmentation { order: (0..6).collect(), starts: vec![0, 3, 6], components: vec![0; 5] };
    let fans = Fans::new(positions.len(), &triangles);
    let (kinds, _) = classify(&triangles, &cluster_of, &fans, positions.len());
    assert_eq!(kinds, [Kind::Border; 5]);
    let input = UnisonInput {
        positions: &positions,
        normals: &[Vec3::Z; 5],
        triangles: &triangles,
        segmentation: &segmentation,
        cluster_of: &cluster_of,
        fans: &fans,
        kinds: &kinds,
        texture: None,
    };
    let collapses = simplify(&input, 2, 1.25, &|_| ());
    assert!(collapses.counts[1] < 5);
    let b = Baked { triangles: triangles.to_vec(), cluster_of: cluster_of.to_vec(), kinds, collapses };
    let edges = edge_counts(&b, 1);
    assert!(edges.iter().all(|(e, n)| *n == 1 && edges.contains_key(&[e[1], e[0]])), "{edges:?}");
}

/// A component that vanishes shrinks to a point of its own first: it must not be drawn out to another on its way.
#[test]
fn what_vanishes_at_a_level_stays_where_it_is_until_the_next() {
    let (mut positions, mut triangles) = bumpy_sphere(20);
    let body = positions.len() as u32;
    for i in 0..800 {
        let at = spread_direction(i, 800) * (1.3e6 + f64::from(i % 7) * 2e4);
        let first = positions.len() as u32;
        for corner in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let p = at + DVec3::from_array(corner) * (500.0 + f64::from(i));
            positions.push(p.to_array().map(|x| x as i32));
        }
        triangles.extend([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]].map(|t| t.map(|k| first + k)));
    }
    let b = run(&positions, &triangles, 500, 5, 4.0);
    let component = |v: u32| if v < body { 0 } else { 1 + (v - body) / 4 };
    let mut vanished = 0;
    for v in 0..positions.len() as u32 {
        let level = b.collapses.last_level[v as usize];
        if level == 0 {
            let next = b.collapses.ancestor(v, 1);
            assert_eq!(component(next), component(v), "{v} went to {next}");
            vanished += usize::from(v >= body);
        }
    }
    assert!(vanished > 1000, "{vanished} vertices of loose parts died at the first level");
}
