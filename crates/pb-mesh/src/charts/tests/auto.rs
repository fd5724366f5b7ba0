//! Automatic charts.

use super::shapes::{self, Shape, noise};
use super::*;
use crate::charts::{AutoOptions, ChartReport, auto_charts};
use proptest::prelude::*;

/// Makes charts and checks all that charts always promise.
fn checked(shape: &Shape) -> (Charts, ChartReport) {
    let surface = shape.surface();
    let made = auto_charts(&surface, &AutoOptions::default(), None);
    assert_partition(&made.0, shape.triangles.len());
    assert_upright(&made.0);
    assert_discs(&surface, &made.0);
    assert_no_overlap(&made.0);
    assert!(made.1.worst_stretch <= AutoOptions::default().max_stretch, "{:?}", made.1);
    assert_eq!(made, auto_charts(&surface, &AutoOptions::default(), None));
    made
}

#[test]
fn smooth_surfaces_get_few_charts() {
    for (name, shape, most) in [
        ("hills", shapes::hills(40, 0.1, 1), 1),
        ("pipe", shapes::pipe([40, 20], 3.0), 1),
        ("ring", shapes::ring([40, 6]), 1),
        ("ball", shapes::ball(12), 3),
        ("torus", shapes::torus([48, 24], 0.4), 6),
        ("plate with two holes", shapes::plate_with_holes(2, 4), 8),
    ] {
        let (_, report) = checked(&shape);
        assert!(report.charts <= most, "{name}: {report:?}");
    }
}

#[test]
fn a_flat_sheet_and_a_pipe_stay_isometric() {
    for shape in [shapes::grid([30, 20], [false; 2], |u, v| [3.0 * u, 2.0 * v, 0.0]), shapes::pipe([64, 30], 4.0)] {
        let (_, report) = checked(&shape);
        assert!(report.stretch < 1.002, "{report:?}");
    }
}

#[test]
fn awkward_surfaces_are_charted() {
    let mut many = Shape::default();
    (0..100).for_each(|i| many.add(&shapes::ball(2), [3.0 * i as f32, 0.0, 0.0]));
    for shape in [
        many,
        shapes::moebius(30),
        shapes::three_sheets(6),
        shapes::confetti(40, 3),
        Shape { positions: vec![[1.0; 3]; 9], triangles: vec![[0, 1, 2], [2, 1, 3], [4, 4, 5], [6, 7, 8]] },
        Shape::default(),
    ] {
        checked(&shape);
    }
}

#[test]
fn a_single_triangle_keeps_its_shape() {
    let shape = Shape { positions: vec![[0.0; 3], [0.0, 3.0, 0.0], [0.0, 3.0, 4.0]], triangles: vec![[0, 1, 2]] };
    let (charts, report) = checked(&shape);
    assert_eq!((report.charts, report.single), (1, 1));
    assert_eq!(charts.uv[0], [[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]);
}

#[test]
fn keys_are_never_mixed() {
    let shape = shapes::grid([8, 8], [false; 2], |u, v| [u, v, 0.0]);
    let key: Vec<u32> = (0..128).map(|t| u32::from(t % 16 < 8)).collect();
    let (charts, _) = auto_charts(&shape.surface(), &AutoOptions::default(), Some(&key));
    assert_eq!(charts.count, 2);
    assert!((0..128).all(|t| charts.chart_of[t] == charts.chart_of[if key[t] == key[0] { 0 } else { 8 }]));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn any_surface_is_charted(kind in 0..6, seed in 0u32..1000, rough in 0.0f32..0.6, drop in 0.0f32..0.4) {
        let mut shape = match kind {
            0 => shapes::hills(14, rough, seed),
            1 => shapes::torus([20, 9], 0.2 + rough),
            2 => shapes::ball(5),
            3 => shapes::ring([16, 4]),
            4 => shapes::plate_with_holes(2, 2),
            _ => shapes::three_sheets(6),
        };
        let step = if seed % 2 == 0 { rough * 0.3 } else { 0.0 };
        for (i, p) in shape.positions.iter_mut().enumerate() {
            (0..3).for_each(|k| p[k] += step * (noise(seed, (3 * i + k) as u32) - 0.5));
        }
        let mut t = 0;
        shape.triangles.retain(|_| { t += 1; noise(seed + 7, t) >= drop });
        // Some positions become others: needles, double positions and bad joints.
        for i in (0..shape.positions.len()).step_by(17) {
            shape.positions[i] = shape.positions[i / 2];
        }
        checked(&shape);
    }
}
