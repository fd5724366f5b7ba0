//! Simplification of meshes cut into charts: no level turns a triangle over in UV or tears a chart.

mod deviation;
mod generate;
mod report;

use generate::{Charted, Cut, FINE, Recipe, Shape};
use pb_mesh::simplify::Collapses;
use pb_mesh::topology::Kind;
use std::collections::{BTreeSet, HashMap};

const LEVELS: usize = 5;
/// Cuts of a grid of 48 x 48 quads.
const CUTS: [Cut; 6] =
    [Cut::Strips(6), Cut::Squares(12), Cut::Squares(5), Cut::Darts(16), Cut::Cells(9), Cut::Cells(60)];

fn recipes() -> impl Iterator<Item = Recipe> {
    let shapes = [Shape::Torus, Shape::HeightField];
    let of_shape = move |shape| {
        let of_cut = move |cut| {
            (0..3).map(move |seed| Recipe {
                shape,
                n: 48,
                cut,
                seed,
                cluster: [9999, 1200][seed as usize % 2],
                jitter: 0.2,
                units: [FINE, 1300.0, 12.0][seed as usize],
            })
        };
        CUTS.into_iter().flat_map(of_cut)
    };
    shapes.into_iter().flat_map(of_shape)
}

/// Edges whose two triangles have different wedges there, as positions.
fn seams(mesh: &Charted, triangles: &[([u32; 3], [u32; 3])]) -> BTreeSet<[u32; 2]> {
    let mut sides: HashMap<[u32; 2], [u32; 2]> = HashMap::new();
    let mut found = BTreeSet::new();
    for (at, wedges) in triangles {
        for k in 0..3 {
            let next = (k + 1) % 3;
            let (edge, side) = match at[k] < at[next] {
                true => ([at[k], at[next]], [wedges[k], wedges[next]]),
                false => ([at[next], at[k]], [wedges[next], wedges[k]]),
            };
            if sides.insert(edge, side).is_some_and(|other| other != side) {
                found.insert(edge);
            }
        }
    }
    assert!(sides.len() <= mesh.triangles.len() * 2);
    found
}

/// Checks what must hold at every level.
fn check(what: &str, mesh: &Charted, collapses: &Collapses) {
    let texture = mesh.texture();
    let whole: Vec<([u32; 3], [u32; 3])> = mesh.triangles.iter().copied().zip(mesh.corners.iter().copied()).collect();
    let first_seams = seams(mesh, &whole);
    for level in 0..LEVELS as u8 {
        let triangles = mesh.level(collapses, level);
        for &(t, at) in &triangles {
            let before = mesh.corners[t];
            let after = before.map(|w| collapses.wedge_ancestor(w, level));
            assert_eq!(after.map(|w| mesh.position_of[w as usize]), at, "{what}: a wedge left its position at {level}");
            for k in 0..3 {
                let [a, b] = [before[k], after[k]].map(|w| mesh.chart_of[w as usize]);
                assert_eq!(a, b, "{what}: triangle {t} left its chart at {level}");
            }
            let (old, new) = (texture.area(before), texture.area(after));
            assert!(new > 0 || old == 0 && new == 0, "{what}: triangle {t} at level {level}: area {old} became {new}");
        }
        let wedges = |t: usize| mesh.corners[t].map(|w| collapses.wedge_ancestor(w, level));
        let old: BTreeSet<[u32; 2]> = first_seams.iter().map(|e| e.map(|v| collapses.ancestor(v, level))).collect();
        let here: Vec<_> = triangles.iter().map(|&(t, at)| (at, wedges(t))).collect();
        for [a, b] in seams(mesh, &here) {
            assert!(old.contains(&[a, b]) || old.contains(&[b, a]), "{what}: a new seam {a} {b} at {level}");
        }
        let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
        triangles.iter().for_each(|(_, t)| (0..3).for_each(|k| *edges.entry([t[k], t[(k + 1) % 3]]).or_default() += 1));
        assert!(edges.values().all(|&n| n == 1), "{what}: level {level} is no manifold");
    }
}

#[test]
fn no_level_turns_a_triangle_over_in_uv_or_takes_it_out_of_its_chart() {
    for recipe in recipes() {
        let mesh = recipe.build();
        let collapses = mesh.simplify(LEVELS, 4.0);
        let areas = mesh.corners.iter().map(|&w| mesh.texture().area(w));
        assert!(areas.min() > Some(0), "{recipe:?} is no good input");
        println!("{recipe:?}: {} clusters: {:?}", mesh.segmentation.len(), collapses.counts);
        check(&format!("{recipe:?}"), &mesh, &collapses);
    }
}

#[test]
fn a_texture_without_area_changes_nothing() {
    let mesh = Recipe { shape: Shape::Torus, n: 48, cut: Cut::Point, seed: 1, cluster: 9999, jitter: 0.4, units: FINE }
        .build();
    assert!(mesh.simplify(LEVELS, 4.0).parent == mesh.simplify_untextured(LEVELS, 4.0).parent);
}

#[test]
fn a_checker_of_single_triangles_stays_as_it_is() {
    for shape in [Shape::Torus, Shape::HeightField] {
        let mesh =
            Recipe { shape, n: 24, cut: Cut::Triangles, seed: 1, cluster: 300, jitter: 0.4, units: FINE }.build();
        let collapses = mesh.simplify(LEVELS, 4.0);
        check("checker", &mesh, &collapses);
        for level in 0..LEVELS {
            let alive = collapses.last_level.iter().filter(|&&l| l as usize >= level).count();
            assert_eq!(collapses.counts[level], alive);
        }
        // A corner of the grid may have a single triangle, and then its chart goes with it.
        let free = |v: u32| mesh.fans.around(v).len() == 1;
        let died = (0..mesh.positions.len() as u32).filter(|&v| collapses.parent[v as usize] != v);
        assert!(died.into_iter().all(free), "{shape:?}");
    }
}

#[test]
fn charts_simplify_alike_on_any_number_of_threads() {
    let mesh =
        Recipe { shape: Shape::Torus, n: 48, cut: Cut::Cells(20), seed: 1, cluster: 600, jitter: 0.4, units: FINE }
            .build();
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        let collapses = pool.install(|| mesh.simplify(LEVELS, 4.0));
        (collapses.parent, collapses.wedge_parent)
    };
    assert!(with(1) == with(3));
}

#[test]
fn borders_of_textured_clusters_collapse_along_themselves() {
    for recipe in recipes().filter(|r| r.cluster < 9999) {
        let mesh = recipe.build();
        let collapses = mesh.simplify(LEVELS, 4.0);
        let users = |v: u32| {
            let around = mesh.fans.around(v).iter().map(|&t| mesh.cluster_of[t as usize]);
            around.collect::<std::collections::BTreeSet<u32>>()
        };
        for (v, &parent) in (0..).zip(&collapses.parent) {
            assert!(users(v).is_subset(&users(parent)), "{recipe:?}: {v} left its clusters");
            assert!(parent == v || mesh.kinds[v as usize] != Kind::Locked, "{recipe:?}: corner {v} died");
        }
    }
}
