//! Charts of the input's own texture coordinates.

use super::shapes::{self, Shape};
use super::*;
use crate::charts::{SourceReport, source_charts};
use proptest::prelude::*;

/// Coordinates by position, `texels` per unit of x and y.
fn planar(shape: &Shape, texels: f32) -> Vec<[[f32; 2]; 3]> {
    let uv = |v: u32| [texels * shape.positions[v as usize][0], texels * shape.positions[v as usize][1]];
    shape.triangles.iter().map(|t| t.map(uv)).collect()
}

fn checked(shape: &Shape, uv: &[[[f32; 2]; 3]], key: &[u32]) -> (Charts, SourceReport) {
    let made = source_charts(&shape.surface(), uv, key);
    assert_partition(&made.0, shape.triangles.len());
    for (t, corners) in made.0.uv.iter().enumerate() {
        assert!(signed_area2(corners) >= 0.0, "triangle {t} is turned");
        let mirrored = made.0.mirrored[made.0.chart_of[t] as usize];
        for k in 0..3 {
            let back = [corners[k][0], if mirrored { -corners[k][1] } else { corners[k][1] }];
            let moved = (0..2).map(|d| (back[d] - uv[t][k][d]).abs()).fold(0.0, f32::max);
            assert!(moved <= 1.0 / 64.0, "corner {k} of triangle {t} moved by {moved} texels");
        }
    }
    made
}

fn sheet() -> Shape {
    shapes::grid([8, 8], [false; 2], |u, v| [u, v, 0.0])
}

#[test]
fn one_sheet_is_one_chart_with_square_texels() {
    let shape = sheet();
    let (charts, report) = checked(&shape, &planar(&shape, 100.0), &[0; 128]);
    assert_eq!((charts.count, report.charts, report.parts, report.mirrored), (1, 1, 1, 0));
    assert!((report.density() - 100.0).abs() < 0.01 && (report.density_spread() - 1.0).abs() < 1e-3);
    assert!((report.anisotropy() - 1.0).abs() < 1e-2, "{}", report.anisotropy());
    assert_eq!((report.overlap(), report.usable()), (0.0, Ok(())));
}

#[test]
fn a_fold_in_the_image_splits_and_mirrors() {
    let shape = sheet();
    let mut uv = planar(&shape, 64.0);
    uv.iter_mut().flatten().for_each(|p| p[0] = 32.0 - (p[0] - 32.0).abs());
    let (charts, report) = checked(&shape, &uv, &[0; 128]);
    assert_eq!((charts.count, report.mirrored), (2, 1));
    assert!((report.overlap() - 0.5).abs() < 0.02, "{}", report.overlap());
    assert_eq!(report.self_overlap(), 0.0);
}

#[test]
fn a_jump_of_coordinates_is_a_seam_and_rounding_is_not() {
    let shape = sheet();
    let mut uv = planar(&shape, 64.0);
    (0..64).for_each(|t| uv[t].iter_mut().for_each(|p| p[0] += 0.004));
    let (charts, _) = checked(&shape, &uv, &[0; 128]);
    assert_eq!(charts.count, 1);
    let joined = joined(&shape.surface(), &charts);
    assert_eq!(joined.iter().filter(|h| **h == NONE).count(), 32, "only the outer border is open");
    (0..64).for_each(|t| uv[t].iter_mut().for_each(|p| p[0] += 1.0));
    assert_eq!(checked(&shape, &uv, &[0; 128]).0.count, 2);
}

#[test]
fn small_differences_do_not_add_up_around_a_vertex() {
    // Six triangles around vertex 4 of a grid; the coordinates of that vertex drift by 0.01 texels from one to the next.
    let shape = shapes::grid([2, 2], [false; 2], |u, v| [u, v, 0.0]);
    let mut uv = planar(&shape, 64.0);
    let order = [7, 6, 3, 0, 1, 4];
    for (i, t) in order.into_iter().enumerate() {
        let k = shape.triangles[t].iter().position(|v| *v == 4).unwrap();
        uv[t][k][0] += 0.01 * i as f32;
    }
    checked(&shape, &uv, &[0; 8]);
}

#[test]
fn images_are_never_mixed() {
    let shape = sheet();
    let key: Vec<u32> = (0..128).map(|t| t / 64).collect();
    assert_eq!(checked(&shape, &planar(&shape, 64.0), &key).0.count, 2);
}

#[test]
fn palette_colours_make_one_chart_each() {
    let mut shape = sheet();
    shape.add(&sheet(), [4.0, 0.0, 0.0]);
    let uv: Vec<_> = (0..256).map(|t| [[if t % 3 == 0 { 0.5 } else { 9.5 }, 0.5]; 3]).collect();
    let (charts, report) = checked(&shape, &uv, &[0; 256]);
    assert_eq!((charts.count, report.charts, report.pointlike), (2, 0, 256));
    assert_eq!(report.usable(), Ok(()));
}

#[test]
fn needles_in_the_image_stay_with_their_chart() {
    let shape = sheet();
    let mut uv = planar(&shape, 64.0);
    // One row of quads has no height in the image.
    uv.iter_mut().flatten().for_each(|p| p[1] = if p[1] > 8.0 { p[1] - 8.0 } else { 0.0 });
    let (charts, report) = checked(&shape, &uv, &[0; 128]);
    assert_eq!((charts.count, report.pointlike), (1, 16));
}

#[test]
fn verdicts_name_the_reason() {
    let shape = shapes::grid([20, 20], [false; 2], |u, v| [u, v, 0.0]);
    let planar = planar(&shape, 64.0);
    let usable = |uv: &[[[f32; 2]; 3]]| checked(&shape, uv, &[0; 800]).1.usable();
    let changed = |change: &dyn Fn(usize, [f32; 2]) -> [f32; 2]| -> Vec<[[f32; 2]; 3]> {
        planar.iter().enumerate().map(|(t, uv)| uv.map(|p| change(t, p))).collect()
    };
    let scattered = changed(&|t, p| [p[0] + 70.0 * (t % 30) as f32, p[1]]);
    assert!(usable(&scattered).unwrap_err().starts_with("fragmented: "));
    let long = changed(&|_, p| [10.0 * p[0], p[1]]);
    assert!(usable(&long).unwrap_err().starts_with("stretched: "));
    let uneven = changed(&|_, p| [(p[0] / 5.0).exp(), p[1] * (p[1] / 10.0).exp()]);
    assert!(usable(&uneven).unwrap_err().starts_with("uneven: "));
    let tiled = changed(&|_, p| [p[0] + 1000.0, p[1] - 640.0]);
    assert_eq!(usable(&tiled), Ok(()));
    let coil = shapes::grid([200, 2], [false; 2], |u, v| [40.0 * u, v, 0.0]);
    let around: Vec<_> = coil
        .triangles
        .iter()
        .map(|t| {
            t.map(|v| {
                let [x, y, _] = coil.positions[v as usize];
                [20.0 * (1.0 + y) * (x / 2.0).cos(), 20.0 * (1.0 + y) * (x / 2.0).sin()]
            })
        })
        .collect();
    let report = checked(&coil, &around, &vec![0; coil.triangles.len()]).1;
    assert!(report.usable().unwrap_err().starts_with("charts lie on themselves"), "{report:?}");
}

#[test]
fn coordinates_that_are_no_numbers_are_counted() {
    let shape = sheet();
    let mut uv = planar(&shape, 64.0);
    uv[5][1] = [f32::NAN, 3.0];
    uv[6][0] = [1e30, f32::INFINITY];
    let (charts, report) = source_charts(&shape.surface(), &uv, &[0; 128]);
    assert_eq!(report.bad, 2);
    assert!(charts.uv.iter().flatten().flatten().all(|c| c.is_finite()));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn any_coordinates_are_grouped(seed in 0u32..1000, break_at in 1u32..20, rough in 0.0f32..3.0) {
        let shape = shapes::hills(10, 0.3, seed);
        let mut uv = planar(&shape, 50.0);
        for (t, corners) in uv.iter_mut().enumerate() {
            for (k, p) in corners.iter_mut().enumerate() {
                let i = 3 * t as u32 + k as u32;
                if i.is_multiple_of(break_at) {
                    p[0] += rough * (shapes::noise(seed, i) - 0.5);
                }
            }
        }
        let key: Vec<u32> = (0..uv.len() as u32).map(|t| t / 70).collect();
        let (charts, report) = checked(&shape, &uv, &key);
        prop_assert!(report.usable().is_ok() || report.charts > report.parts);
        let mut key_of_chart = std::collections::BTreeMap::new();
        for (t, c) in charts.chart_of.iter().enumerate() {
            prop_assert_eq!(*key_of_chart.entry(*c).or_insert(key[t]), key[t]);
        }
    }
}
