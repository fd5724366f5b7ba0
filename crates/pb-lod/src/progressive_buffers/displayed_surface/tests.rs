use super::*;
use crate::progressive_buffers::grid_torus::GridTorus;
use crate::progressive_buffers::layout::MAX_LEVELS;
use glam::DVec3;

fn tables(torus: &GridTorus, floor: f32, scale: f32) -> Vec<LodTable> {
    let mut distances = [0.0; MAX_LEVELS];
    (1..MAX_LEVELS).for_each(|i| distances[i] = 2f32.powi(i as i32) * scale);
    vec![LodTable { levels: torus.model.levels, floor, distances }; torus.clusters.len()]
}

fn shown(torus: &GridTorus, tables: &[LodTable], level: u32, eye: DVec3) -> Surface {
    let drawn: Vec<_> = (0..torus.clusters.len() as u32).map(|c| torus.drawn(c, level)).collect();
    displayed_surface(&drawn, tables, &GridEye::new(torus.model.origin, torus.model.quantum, eye))
}

/// Triangles as sorted lists of position bits, so that two index buffers can be compared as surfaces.
fn faces(surface: &Surface) -> Vec<[[u32; 3]; 3]> {
    let corner = |i: u32| surface.positions[i as usize].map(f32::to_bits);
    let face = |t: &[u32; 3]| {
        let mut f = t.map(corner);
        let first = (0..3).min_by_key(|&k| f[k]).unwrap();
        f.rotate_left(first);
        f
    };
    let mut all: Vec<_> = surface.triangles.iter().map(face).collect();
    all.sort();
    all
}

#[test]
fn the_index_buffers_of_two_levels_show_the_same_surface_where_the_rule_switches() {
    let torus = GridTorus::new(3, 4);
    for level in 0..3 {
        let tables = tables(&torus, (level + 1) as f32, 1e9);
        let eye = DVec3::new(40.0, 3.0, 20.0);
        let (fine, coarse) = (shown(&torus, &tables, level, eye), shown(&torus, &tables, level + 1, eye));
        assert!(!fine.triangles.is_empty() && faces(&fine) == faces(&coarse), "level {level}");
    }
}

#[test]
fn vertices_move_continuously_with_distance_and_with_the_floor() {
    let torus = GridTorus::new(3, 4);
    let place = |floor: f32, x: f64| -> Vec<[f64; 3]> {
        let tables = tables(&torus, floor, 4.0);
        let eye = GridEye::new(torus.model.origin, torus.model.quantum, DVec3::new(x, 1.0, 2.0));
        let mut out = Vec::new();
        for c in 0..9u32 {
            let drawn = torus.drawn(c, 0);
            let neighbours: Vec<_> = drawn.neighbours.iter().map(|&n| (n, tables[n as usize])).collect();
            let view = ClusterView {
                origin: drawn.origin,
                shift: drawn.shift,
                counts: &drawn.counts,
                vertices: &drawn.vertices,
                cluster: c,
                table: &tables[c as usize],
                neighbours: &neighbours,
            };
            // World positions: relative to the eye they would move with it.
            out.extend((0..drawn.counts[0]).map(|v| {
                let p = view.display(v, 0, &eye).position;
                [p[0] as f64 + x, p[1] as f64, p[2] as f64]
            }));
        }
        out
    };
    let largest_move = |a: &[[f64; 3]], b: &[[f64; 3]]| {
        a.iter().zip(b).flat_map(|(p, q)| (0..3).map(move |k| (p[k] - q[k]).abs())).fold(0.0, f64::max)
    };
    // An edge of the coarsest level is about 20 long; a jump would be of that order.
    let mut last = place(0.0, 60.0);
    for step in 1..3000 {
        let next = place(0.0, 60.0 - step as f64 * 0.02);
        assert!(largest_move(&last, &next) < 0.25, "pop at x = {}", 60.0 - step as f64 * 0.02);
        last = next;
    }
    let mut last = place(0.0, 60.0);
    for step in 1..=3000 {
        let next = place(step as f32 * 0.001, 60.0);
        assert!(largest_move(&last, &next) < 0.1, "pop at floor {}", step as f32 * 0.001);
        last = next;
    }
}

#[test]
fn unmatched_edges_count_what_is_open() {
    let triangles = vec![[0, 1, 2], [2, 1, 3], [0, 2, 3], [0, 3, 1]];
    let mut surface = Surface { triangles, ..Surface::default() };
    assert_eq!(surface.unmatched_edges(), 0);
    surface.triangles.pop();
    assert_eq!(surface.unmatched_edges(), 3);
    surface.triangles.push([0, 1, 3]);
    assert_eq!(surface.unmatched_edges(), 6, "a flipped triangle matches nothing");
}
