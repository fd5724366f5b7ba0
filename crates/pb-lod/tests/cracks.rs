//! No view of a closed model shows a gap (design section 3): random views, random switch distances per cluster,
//! random residency and floors, on baked models. Positions are joined only where all bits are equal.

mod common;

use common::{Decoded, Random, baked, fixture, read_obj, torus};
use pb_lod::progressive_buffers::bake::BakeOptions;
use pb_lod::progressive_buffers::display::LodTable;
use pb_lod::progressive_buffers::displayed_surface::{DrawnCluster, displayed_surface};
use pb_lod::progressive_buffers::layout::MAX_LEVELS;

const VIEWS: u32 = 200;

/// Small clusters, so that there are many borders and corners.
fn options(levels: u32, ratio: f64, cluster_triangles: usize) -> BakeOptions {
    BakeOptions { levels, ratio, cluster_triangles: Some(cluster_triangles) }
}

fn assert_closed_in_all_views(name: &str, model: &Decoded) {
    let mut random = Random(0x1234_5678_9abc_def1);
    let (mut shown, mut levels) = (0, [0u32; MAX_LEVELS]);
    for view in 0..VIEWS {
        let eye = model.random_eye(&mut random);
        let tables = model.random_tables(&mut random);
        tables.iter().zip(0..).for_each(|(t, c)| levels[model.level(c, t, eye) as usize] += 1);
        let surface = model.surface(&tables, eye);
        assert_eq!(surface.unmatched_edges(), 0, "{name}, view {view}, {} triangles", surface.triangles.len());
        shown += surface.triangles.len();
    }
    let used = &levels[..model.model.levels() as usize];
    assert!(model.clusters() > 3 && used.iter().all(|&n| n > 10), "{name}: too tame a test: {used:?}");
    eprintln!("{name}: {} clusters, {VIEWS} views, {shown} triangles, levels {used:?}", model.clusters());
}

#[test]
fn a_torus_shows_no_crack_in_200_random_views() {
    let model = Decoded::new(baked(torus(40), &options(5, 4.0, 300)));
    assert_closed_in_all_views("torus", &model);
}

#[test]
fn many_fine_levels_show_no_crack_in_200_random_views() {
    let model = Decoded::new(baked(torus(40), &options(9, 2.0, 500)));
    assert_closed_in_all_views("torus, ratio 2", &model);
}

#[test]
fn a_model_far_from_the_origin_shows_no_crack() {
    let mut soup = torus(30);
    soup.positions.iter_mut().for_each(|p| *p = [p[0] + 500_000.0, p[1] + 4_500_000.0, p[2] - 30.0]);
    let model = Decoded::new(baked(soup, &options(5, 4.0, 300)));
    assert_closed_in_all_views("torus at UTM coordinates", &model);
}

/// Closed scans and CAD models of the shared fixtures.
const CLOSED: [&str; 8] = [
    "scan_hammer/hammer.obj",
    "scan_sword_quads/sword-quad-dominant.obj",
    "scan_ycb_chain/textured.obj",
    "scan_stapler_vcolor/textured.obj",
    "scan_gso_frypan/chefmate_8_frypan.obj",
    "obj_spot/spot_triangulated.obj",
    "cad_trimesh/quadknot.obj",
    "manifold_tests/self_intersectA.obj",
];

#[test]
fn closed_fixtures_show_no_crack_in_200_random_views_each() {
    for name in CLOSED {
        let Some(path) = fixture(name) else { continue };
        let soup = read_obj(&path);
        let cluster_triangles = (soup.triangles.len() / 12).clamp(64, 1500);
        let model = Decoded::new(baked(soup, &options(5, 4.0, cluster_triangles)));
        assert_closed_in_all_views(name, &model);
    }
}

#[test]
fn both_index_buffers_show_the_same_surface_where_a_cluster_switches() {
    let model = Decoded::new(baked(torus(40), &options(5, 4.0, 500)));
    let eye = model.extent().0 + glam::DVec3::new(3.0, 1.0, 2.0);
    for level in 0..4 {
        let mut distances = [0.0; MAX_LEVELS];
        (1..MAX_LEVELS).for_each(|i| distances[i] = 1e6 * i as f32);
        let table = LodTable { levels: 5, floor: (level + 1) as f32, distances };
        let tables = vec![table; model.clusters() as usize];
        let shown = |level: u32| {
            let drawn: Vec<DrawnCluster> = (0..model.clusters()).map(|c| model.drawn(c, level)).collect();
            let surface = displayed_surface(&drawn, &tables, &model.eye(eye));
            let mut faces: Vec<[[u32; 3]; 3]> = surface
                .triangles
                .iter()
                .map(|t| {
                    let mut f = t.map(|i| surface.positions[i as usize].map(f32::to_bits));
                    let first = (0..3).min_by_key(|&k| f[k]).expect("three corners");
                    f.rotate_left(first);
                    f
                })
                .collect();
            faces.sort();
            faces
        };
        assert!(shown(level) == shown(level + 1), "level {level} pops into {}", level + 1);
    }
}

#[test]
fn one_wrong_parent_on_a_border_is_seen_as_a_crack() {
    let mut model = Decoded::new(baked(torus(40), &options(5, 4.0, 500)));
    let eye = model.extent().0 + glam::DVec3::new(0.7, 0.1, 0.2);
    let mut distances = [0.0; MAX_LEVELS];
    (1..MAX_LEVELS).for_each(|i| distances[i] = 1e6 * i as f32);
    // Every vertex that dies at level 0 is shown half way to its parent.
    let tables = vec![LodTable { levels: 5, floor: 0.5, distances }; model.clusters() as usize];
    assert_eq!(model.surface(&tables, eye).unmatched_edges(), 0);
    let coarser = model.model.level(0, 1).vertices;
    let vertices = &mut model.prefixes[0].vertices;
    let border = vertices[coarser as usize..].iter_mut().find(|v| v.slot() != 0).expect("cluster 0 has a border");
    border.parent = (border.parent as u32 + 1).rem_euclid(coarser) as u16;
    assert!(model.surface(&tables, eye).unmatched_edges() > 0);
}
