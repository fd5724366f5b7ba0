//! Promises of charts, on generated surfaces.

mod auto;
mod divide;
mod pack;
mod shapes;
mod source;

use super::piece::{NONE, Piece, next, partners};
use super::{Charts, ClusterSurface, signed_area2};
use glam::DVec3;

/// Every triangle is in exactly one chart, and every chart has one.
fn assert_partition(charts: &Charts, triangles: usize) {
    assert_eq!((charts.chart_of.len(), charts.uv.len()), (triangles, triangles));
    let mut used = vec![false; charts.count as usize];
    charts.chart_of.iter().for_each(|&c| used[c as usize] = true);
    assert!(used.iter().all(|u| *u), "a chart without triangles");
    assert_eq!(charts.mirrored.len(), charts.count as usize);
}

/// No triangle is turned over; those with an area on the surface have one in the plane.
fn assert_upright(charts: &Charts) {
    for (t, uv) in charts.uv.iter().enumerate() {
        assert!(signed_area2(uv) >= 0.0, "triangle {t} is turned: {uv:?}");
        assert!(uv.iter().flatten().all(|c| c.is_finite() && *c >= 0.0), "triangle {t}: {uv:?}");
    }
}

/// Half-edges that join triangles of one chart at the same coordinates.
fn joined(surface: &ClusterSurface, charts: &Charts) -> Vec<u32> {
    let mut partner = partners(surface.triangles, |t| charts.chart_of[t]);
    for h in 0..partner.len() {
        let uv = |h: u32| charts.uv[h as usize / 3][h as usize % 3].map(f32::to_bits);
        let (h, g) = (h as u32, partner[h]);
        if g != NONE && (uv(h) != uv(next(g)) || uv(next(h)) != uv(g)) {
            partner[g as usize] = NONE;
            partner[h as usize] = NONE;
        }
    }
    partner
}

/// Every chart hangs together, has one border and no handle.
fn assert_discs(surface: &ClusterSurface, charts: &Charts) {
    let partner = joined(surface, charts);
    let parts = super::piece::components(&partner, |_| 0);
    assert_eq!(parts.len(), charts.count as usize, "a chart falls apart");
    let mut scratch = vec![NONE; surface.triangles.len()];
    for part in parts {
        let piece = Piece::new(&part, &partner, |_, _| DVec3::ZERO, &mut scratch);
        assert_eq!(piece.euler_characteristic(), 1, "chart of {} triangles is not a disc", part.len());
    }
}

/// No two triangles of a chart cover one point of a grid of samples.
fn assert_no_overlap(charts: &Charts) {
    const CELLS: usize = 200;
    for chart in 0..charts.count {
        let mine: Vec<_> =
            (0..charts.uv.len()).filter(|&t| charts.chart_of[t] == chart).map(|t| charts.uv[t]).collect();
        let size = mine.iter().flatten().flatten().fold(1e-30f32, |m, c| m.max(*c));
        let mut covered = vec![0u8; CELLS * CELLS];
        for uv in mine {
            let p = uv.map(|p| p.map(|c| f64::from(c / size) * CELLS as f64));
            let low = |k: usize| p.iter().fold(f64::MAX, |m, q| m.min(q[k])).max(0.0) as usize;
            let high = |k: usize| (p.iter().fold(0.0f64, |m, q| m.max(q[k])) as usize).min(CELLS - 1);
            for y in low(1)..=high(1) {
                for x in low(0)..=high(0) {
                    let at = [x as f64 + 0.4637, y as f64 + 0.5311];
                    let inside = (0..3).all(|k| {
                        let (a, b) = (p[k], p[(k + 1) % 3]);
                        (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0]) > 1e-9
                    });
                    covered[y * CELLS + x] += u8::from(inside);
                }
            }
        }
        assert!(covered.iter().all(|c| *c <= 1), "chart {chart} lies on itself");
    }
}
