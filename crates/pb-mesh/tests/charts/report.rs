//! Tables of what charts do to levels, for people.

use crate::generate::{Charted, Cut, FINE, Recipe, Shape};
use pb_mesh::deviation::{LevelPair, measure, texture_deviation};
use pb_mesh::simplify::Collapses;
use pb_mesh::topology::Fans;

/// Largest and root mean square distance of the surface of a level, quanta.
fn geometry(mesh: &Charted, collapses: &Collapses, level: u8) -> (f32, f64) {
    let (numbers, coarse): (Vec<usize>, Vec<[u32; 3]>) = mesh.level(collapses, level).into_iter().unzip();
    let count = mesh.positions.len() as u32;
    let pair = LevelPair {
        positions: &mesh.positions,
        triangles: &mesh.triangles,
        fine: &Fans::new(count as usize, &mesh.triangles),
        cluster_of: &mesh.cluster_of,
        coarse: &coarse,
        fans: &Fans::new(count as usize, &coarse),
        coarse_cluster_of: &numbers.iter().map(|&t| mesh.cluster_of[t]).collect::<Vec<_>>(),
        ancestors: &(0..count).map(|v| collapses.ancestor(v, level)).collect::<Vec<_>>(),
        open: &(0..count).map(|v| mesh.kinds[v as usize] == pb_mesh::topology::Kind::Open).collect::<Vec<_>>(),
    };
    let deviation = measure(&pair, mesh.segmentation.len(), &|_| ());
    (deviation.max.into_iter().fold(0.0, f32::max), (deviation.squares.0 / deviation.squares.1).sqrt())
}

fn print(what: &str, recipe: Recipe, careful: bool) {
    let mesh = recipe.build();
    let start = std::time::Instant::now();
    let collapses = if careful { mesh.simplify(5, 4.0) } else { mesh.simplify_carelessly(5, 4.0) };
    let simplified = start.elapsed();
    let start = std::time::Instant::now();
    let slides =
        texture_deviation(&mesh.positions, &mesh.triangles, &mesh.segmentation, &mesh.texture(), &collapses, &|_| ());
    let measured = start.elapsed();
    println!("{what}: {} triangles; simplified in {simplified:.0?}, measured in {measured:.0?}", mesh.triangles.len());
    for (level, slide) in slides.iter().enumerate().skip(1) {
        let (max, rms) = geometry(&mesh, &collapses, level as u8);
        let slide_rms = (slide.squares.0 / slide.squares.1 as f64).sqrt();
        let slide_max = slide.max.iter().copied().fold(0.0, f32::max);
        let kept = collapses.counts[level] as f64 / collapses.counts[0] as f64;
        println!(
            "  level {level}: {:6} = 1/{:<6.1} surface {rms:8.1} {max:8.0}   texture {slide_rms:8.1} {slide_max:8.0}",
            collapses.counts[level],
            1.0 / kept
        );
    }
}

#[test]
#[ignore = "prints tables: cargo test --release -p pb-mesh --test charts report -- --ignored --nocapture"]
fn report_of_levels_and_charts() {
    for per_side in [1, 2, 4, 8, 16] {
        let cut = Cut::Squares(90u32.div_ceil(per_side));
        let recipe =
            Recipe { shape: Shape::HeightField, n: 90, cut, seed: 1, cluster: 16_384, jitter: 0.02, units: FINE };
        print(&format!("height field, {} charts", per_side * per_side), recipe, true);
    }
    for cut in [Cut::Cells(40), Cut::Darts(45), Cut::Strips(15)] {
        let recipe = Recipe { shape: Shape::Torus, n: 180, cut, seed: 2, cluster: 16_384, jitter: 0.02, units: FINE };
        print(&format!("torus, {cut:?}"), recipe, true);
        print("the same without costs of texture", recipe, false);
    }
}
