//! Packing.

use super::shapes::{self, Shape};
use super::*;
use crate::charts::{AutoOptions, Fit, MIN_GAP_TEXELS, PackOptions, Packed, auto_charts, pack};
use proptest::prelude::*;

fn area2(c: &[[u16; 2]; 3]) -> i64 {
    let [a, b, c] = c.map(|p| p.map(i64::from));
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Least distance (maximum norm, in texels) that two charts may have by their samples; every chart is sampled along its
/// triangles' edges at most half a texel apart.
fn assert_apart(packed: &Packed, gap: f64) {
    let texels = |c: u16| f64::from(c) * f64::from(packed.size) / 65_536.0;
    let size = packed.size as usize;
    let mut owner = vec![u32::MAX; size * size];
    let mut samples = Vec::new();
    for (t, corners) in packed.corners.iter().enumerate().filter(|(_, c)| area2(c) > 0) {
        for k in 0..3 {
            let (a, b) = (corners[k].map(texels), corners[(k + 1) % 3].map(texels));
            let steps = (2.0 * (a[0] - b[0]).abs().max((a[1] - b[1]).abs())).ceil().max(1.0);
            for i in 0..=steps as usize {
                let f = i as f64 / steps;
                let p = [0, 1].map(|d| (a[d] + f * (b[d] - a[d])) as usize);
                samples.push((p, packed.chart_of[t]));
            }
        }
    }
    samples.iter().for_each(|&(p, c)| owner[p[1].min(size - 1) * size + p[0].min(size - 1)] = c);
    let reach = gap as usize;
    for &(p, c) in &samples {
        for y in p[1].saturating_sub(reach)..(p[1] + reach).min(size - 1) {
            for x in p[0].saturating_sub(reach)..(p[0] + reach).min(size - 1) {
                let other = owner[y * size + x];
                assert!(
                    other == c || other == u32::MAX,
                    "charts {c} and {other} are nearer than {gap} texels at {p:?}"
                );
            }
        }
    }
}

fn checked(charts: &Charts, density: f32, options: &PackOptions) -> Packed {
    let densities = vec![density; charts.count as usize];
    let packed = pack(charts, &densities, options);
    assert!(packed.size.is_power_of_two() && packed.size <= options.max_size);
    assert!(packed.gap >= MIN_GAP_TEXELS && packed.fill <= 1.0);
    assert_eq!((packed.corners.len(), packed.chart_of.len()), (charts.uv.len(), charts.uv.len()));
    assert!(packed.corners.iter().all(|c| area2(c) >= 0));
    assert!(packed.chart_of.iter().all(|c| *c < packed.count));
    assert_eq!(packed.count, charts.count + packed.snapped_alone);
    if packed.scale > 1e-4 {
        // Samples are rounded down to texels, which may bring them one texel nearer.
        assert_apart(&packed, f64::from(packed.gap) - 1.0);
    }
    assert_eq!(packed, pack(charts, &densities, options));
    packed
}

fn squares(sides: &[f32]) -> Charts {
    let mut charts = Charts::default();
    for (i, &s) in sides.iter().enumerate() {
        charts.uv.extend([
            [[0.25, 0.5], [0.25 + s, 0.5], [0.25 + s, 0.5 + s]],
            [[0.25, 0.5], [0.25 + s, 0.5 + s], [0.25, 0.5 + s]],
        ]);
        charts.chart_of.extend([i as u32; 2]);
        charts.count += 1;
        charts.mirrored.push(false);
    }
    charts
}

const WHOLE: PackOptions = PackOptions { max_size: 512, fit: Fit::WholeTexels, min_scale: 1.0 };

#[test]
fn the_smallest_tile_that_fits_is_taken() {
    for (sides, size) in
        [(vec![3.0], 4), (vec![60.0], 64), (vec![64.0], 128), (vec![28.0; 4], 64), (vec![31.0; 4], 128)]
    {
        assert_eq!(checked(&squares(&sides), 1.0, &WHOLE).size, size, "{sides:?}");
    }
}

#[test]
fn gaps_are_as_wide_as_the_tile_allows() {
    assert_eq!(checked(&squares(&[90.0, 20.0]), 1.0, &WHOLE).gap, 8);
    assert_eq!(checked(&squares(&[120.0, 120.0, 120.0, 120.0]), 1.0, &WHOLE).gap, 8);
    assert_eq!(checked(&squares(&[124.0, 124.0, 124.0, 124.0]), 1.0, &WHOLE).gap, 4);
}

#[test]
fn source_charts_move_by_whole_texels() {
    let charts = squares(&[40.0, 17.0, 30.5, 8.25]);
    let packed = checked(&charts, 1.0, &WHOLE);
    let per_texel = 65_536 / packed.size;
    for (uv, corners) in charts.uv.iter().zip(&packed.corners) {
        for (uv, c) in uv.iter().zip(corners) {
            // Multiples of a quarter texel stay what they are, in one of four directions.
            let phase = |x: f32| (x.fract() * 4.0) as u32;
            let got = c.map(|c| u32::from(c) % per_texel * 4 / per_texel);
            let [u, v] = uv.map(phase);
            let back = |x: u32| (4 - x) % 4;
            assert!([[u, v], [back(v), u], [back(u), back(v)], [v, back(u)]].contains(&got), "{uv:?} {c:?}");
        }
    }
}

#[test]
fn too_large_source_charts_are_halved_and_others_scaled_to_fit() {
    let charts = squares(&[600.0, 500.0]);
    assert_eq!(checked(&charts, 1.0, &WHOLE).scale, 0.25);
    let free = checked(&charts, 1.0, &PackOptions::default());
    assert!(free.size == 512 && free.scale > 0.42, "{} {}", free.scale, free.fill);
}

#[test]
fn charts_without_area_take_one_block() {
    let mut charts = squares(&[]);
    charts.uv = vec![[[7.5, 7.5]; 3]; 5];
    charts.chart_of = vec![0; 5];
    (charts.count, charts.mirrored) = (1, vec![false]);
    let packed = checked(&charts, 1.0, &WHOLE);
    assert_eq!((packed.size, packed.corners[3]), (4, [[32_768; 2]; 3]));
}

#[test]
fn more_charts_than_texels_are_still_packed() {
    let charts = squares(&vec![1.0; 300]);
    let packed = checked(&charts, 1.0, &PackOptions { max_size: 16, ..WHOLE });
    assert_eq!(packed.size, 16);
}

#[test]
fn automatic_charts_fill_much_of_the_tile() {
    let (charts, _) = auto_charts(&shapes::ball(16).surface(), &AutoOptions::default(), None);
    let packed = checked(&charts, 1000.0, &PackOptions::default());
    assert!(packed.fill > 0.45, "{}", packed.fill);
    let (charts, _) = auto_charts(&shapes::hills(40, 0.05, 3).surface(), &AutoOptions::default(), None);
    let packed = checked(&charts, 10_000.0, &PackOptions::default());
    assert!(packed.fill > 0.9, "{}", packed.fill);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn any_charts_are_packed(
        sides in prop::collection::vec(0.1f32..80.0, 1..40),
        density in 0.05f32..4.0,
        power in 3u32..10,
        whole in any::<bool>(),
    ) {
        let fit = if whole { Fit::WholeTexels } else { Fit::Free };
        checked(&squares(&sides), density, &PackOptions { max_size: 1 << power, fit, min_scale: 0.7 });
    }

    #[test]
    fn small_triangles_survive_rounding(seed in 0u32..1000, power in 2u32..9) {
        let mut shape = Shape::default();
        shape.add(&shapes::hills(24, 0.3, seed), [0.0; 3]);
        shape.add(&shapes::confetti(10, seed), [3.0, 0.0, 0.0]);
        let (charts, _) = auto_charts(&shape.surface(), &AutoOptions::default(), None);
        checked(&charts, 300.0, &PackOptions { max_size: 1 << power, ..PackOptions::default() });
    }
}
