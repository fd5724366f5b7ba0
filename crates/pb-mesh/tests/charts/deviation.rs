//! The texture deviation against a search through all triangles, and on a plane where it is known.

use crate::generate::{Charted, Cut, FINE, Recipe, Shape};
use glam::{DVec2, DVec3};
use pb_mesh::deviation::{TextureDeviation, texture_deviation};
use pb_mesh::segment::Segmentation;
use pb_mesh::simplify::{Collapses, UvInput};

fn deviations(mesh: &Charted, collapses: &Collapses) -> Vec<TextureDeviation> {
    texture_deviation(&mesh.positions, &mesh.triangles, &mesh.segmentation, &mesh.texture(), collapses, &|_| ())
}

/// Where a triangle of wedges has texture coordinates `p`, if it has.
fn point_at(mesh: &Charted, t: [u32; 3], p: DVec2) -> Option<DVec3> {
    let [a, b, c] = t.map(|w| DVec2::from(mesh.uv[w as usize].map(f64::from)));
    let area = (b - a).perp_dot(c - a);
    let weights = [(b - p).perp_dot(c - p) / area, (c - p).perp_dot(a - p) / area, (a - p).perp_dot(b - p) / area];
    let at = |k: usize| mesh.at(mesh.position_of[t[k] as usize]) * weights[k];
    weights.iter().all(|&w| w > -1e-9).then(|| at(0) + at(1) + at(2))
}

#[test]
fn wedges_inside_their_charts_slide_as_far_as_a_search_through_all_triangles_says() {
    let mesh =
        Recipe { shape: Shape::Torus, n: 24, cut: Cut::Squares(8), seed: 3, cluster: 9999, jitter: 0.2, units: FINE }
            .build();
    let collapses = mesh.simplify(4, 4.0);
    let found = deviations(&mesh, &collapses);
    assert_eq!(found[0].max, [0.0]);
    for level in 1..4u8 {
        let coarse = mesh.level(&collapses, level);
        let wedges: Vec<[u32; 3]> =
            coarse.iter().map(|&(t, _)| mesh.corners[t].map(|w| collapses.wedge_ancestor(w, level))).collect();
        let (mut worst, mut located) = (0.0, 0);
        for w in 0..mesh.uv.len() {
            let chart = mesh.chart_of[w];
            let own = wedges.iter().filter(|t| mesh.chart_of[t[0] as usize] == chart);
            let uv = DVec2::from(mesh.uv[w].map(f64::from));
            if let Some(at) = own.copied().find_map(|t| point_at(&mesh, t, uv)) {
                worst = f64::max(worst, at.distance(mesh.at(mesh.position_of[w])));
                located += 1;
            }
        }
        assert!(located * 3 > mesh.uv.len() * 2, "{located} of {} wedges", mesh.uv.len());
        let max = f64::from(found[level as usize].max[0]);
        // Wedges that left their chart may have slid further.
        assert!(worst > 0.0 && max > worst * 0.9999, "level {level}: {max}, searched {worst}");
        assert!(max < worst * 4.0, "level {level}: {max}, searched {worst}");
    }
}

#[test]
fn texture_that_lies_evenly_on_a_plane_does_not_slide_inside_of_it() {
    let recipe =
        Recipe { shape: Shape::Plane, n: 24, cut: Cut::Squares(24), seed: 0, cluster: 300, jitter: 0.0, units: FINE };
    let mesh = recipe.build();
    let collapses = mesh.simplify(3, 4.0);
    let found = deviations(&mesh, &collapses);
    assert!(collapses.counts[2] * 8 < collapses.counts[0]);
    // Texture coordinates and positions are rounded.
    for level in found {
        assert!(level.max.iter().all(|&d| d < 40.0), "{:?}", level.max);
    }
}

#[test]
fn a_seam_that_moves_counts_on_both_of_its_sides() {
    // A square in two clusters, split along a seam whose middle, 0, is 10 off its line. When it goes, the
    // upper chart covers texture beyond its seam and the lower one loses some; on the plane nothing else slides.
    let positions = [[0, 10, 0], [-100, 0, 0], [100, 0, 0], [0, 100, 0], [0, -100, 0]];
    let triangles = [[0, 2, 3], [0, 3, 1], [0, 1, 4], [0, 4, 2]];
    let corners = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6]];
    let position_of = [0, 1, 2, 3, 0, 1, 2, 4];
    let uv = position_of.map(|v: u32| [0, 1].map(|k| (300 + positions[v as usize][k] * 2) as u16));
    let texture = UvInput { corners: &corners, position_of: &position_of, uv: &uv, tile_side: &[32768.0; 2] };
    let segmentation = Segmentation { order: vec![0, 1, 2, 3], starts: vec![0, 2, 4], components: vec![0; 5] };
    let collapses = Collapses {
        parent: vec![1, 1, 2, 3, 4],
        last_level: vec![0, 1, 1, 1, 1],
        counts: vec![5, 4],
        wedge_parent: vec![1, 1, 2, 3, 5, 5, 6, 7],
        wedge_last_level: vec![0, 1, 1, 1, 0, 1, 1, 1],
    };
    let found = texture_deviation(&positions, &triangles, &segmentation, &texture, &collapses, &|_| ());
    // The lost texture is where its nearest point is: 10 away in the tile, and 10 in space.
    assert_eq!(found[1].max.iter().map(|d| d.round()).collect::<Vec<_>>(), [10.0, 20.0]);
}

#[test]
fn costs_of_texture_keep_it_in_place() {
    // At level 2, in terms of what it is without the costs: what 95 % of the wedges slide at most, in each of five meshes, and the root
    // mean square, in the median of them: corners that leave their chart and charts that vanish count in it as they happen to.
    for cut in [Cut::Strips(16), Cut::Cells(12), Cut::Darts(24)] {
        let ratios = (1..=5).map(|seed| {
            let mesh =
                Recipe { shape: Shape::Torus, n: 96, cut, seed, cluster: 9999, jitter: 0.02, units: FINE }.build();
            let slides = |collapses: Collapses| {
                let level = deviations(&mesh, &collapses).remove(2);
                let rms = (level.squares.0 / level.squares.1 as f64).sqrt();
                [f64::from(level.most.into_iter().fold(0.0, f32::max)), rms]
            };
            let (with, without) = (slides(mesh.simplify(3, 4.0)), slides(mesh.simplify_carelessly(3, 4.0)));
            [with[0] / without[0], with[1] / without[1]]
        });
        let ratios: Vec<[f64; 2]> = ratios.collect();
        let mut rms: Vec<f64> = ratios.iter().map(|r| r[1]).collect();
        rms.sort_by(f64::total_cmp);
        assert!(ratios.iter().all(|r| r[0] < 0.85) && rms[rms.len() / 2] < 0.85, "{cut:?}: {ratios:?}");
    }
}
