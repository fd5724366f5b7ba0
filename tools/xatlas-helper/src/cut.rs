//! A cluster in, charts out, as pb-bake demands them: as large as the surface they stand for, counter-clockwise, every
//! triangle in one. What xatlas leaves out, turns over or lays over others becomes a chart of its own; charts that stretch
//! too much or lie over themselves in many places are cut again.

use crate::overlap::overlaps;
use crate::wire::{Charts, Options, Request, doubled_area};
use crate::xatlas;

/// How often a chart is cut again, each time at half the cost.
const ROUNDS: u32 = 4;
/// Area of a triangle in its chart below which it counts as lost, as a share of its area on the surface.
const LOST: f64 = 1e-4;
/// How far the area of a chart may be from that of its surface, as a factor.
const MAX_GROWTH: f64 = 2.0;

/// A chart with more than one in so many triangles over others is cut again.
const MANY: usize = 16;

/// One chart: triangles of the cluster, and where their corners are.
struct Chart {
    triangles: Vec<u32>,
    uv: Vec<[[f32; 2]; 3]>,
}

/// The cluster in units in which the mean triangle has about area 1.
struct Cluster<'a> {
    /// As pb-bake measures them.
    positions: Vec<[f64; 3]>,
    /// Around the origin, for xatlas.
    centred: Vec<[f32; 3]>,
    triangles: &'a [[u32; 3]],
    options: Options,
}

/// Cuts a checked request. The charts are numbered by their first triangles. Fails where xatlas refuses.
pub fn cut(request: &Request) -> Result<Charts, String> {
    let (cluster, unit) = Cluster::new(request);
    let all: Vec<u32> = (0..request.triangles.len() as u32).collect();
    let mut charts = Vec::new();
    cluster.cut(all, request.options.max_cost, ROUNDS, &mut charts)?;
    charts.sort_by_key(|c| c.triangles[0]);
    let mut answer = Charts {
        chart_of: vec![0; request.triangles.len()],
        count: charts.len() as u32,
        uv: vec![[[0.0; 2]; 3]; request.triangles.len()],
    };
    for (number, chart) in charts.iter().enumerate() {
        for (&t, uv) in chart.triangles.iter().zip(&chart.uv) {
            answer.chart_of[t as usize] = number as u32;
            // A power of two: no rounding, so nothing turns over.
            answer.uv[t as usize] = uv.map(|c| c.map(|x| x * unit));
        }
    }
    Ok(answer)
}

impl<'a> Cluster<'a> {
    /// Also returns the input's unit of length, a power of two, per unit of the cluster here.
    fn new(request: &'a Request) -> (Self, f32) {
        let axis = |k: usize| request.positions.iter().map(move |p| p[k] as f64);
        let middle: [f64; 3] =
            std::array::from_fn(|k| (axis(k).fold(f64::MAX, f64::min) + axis(k).fold(f64::MIN, f64::max)) / 2.0);
        let area = |t: &[u32; 3]| triangle_area(&t.map(|i| request.positions[i as usize].map(f64::from))).1;
        let mean = request.triangles.iter().map(area).sum::<f64>() / request.triangles.len() as f64;
        let unit = if mean > 0.0 { mean.sqrt().log2().round().clamp(-120.0, 120.0).exp2() } else { 1.0 };
        let centre = |p: &[f32; 3]| std::array::from_fn(|k| ((p[k] as f64 - middle[k]) / unit) as f32);
        let centred = request.positions.iter().map(centre).collect();
        let positions = request.positions.iter().map(|p| p.map(|x| x as f64 / unit)).collect();
        (Self { positions, centred, triangles: &request.triangles, options: request.options }, unit as f32)
    }

    fn corners(&self, triangle: u32) -> [[f64; 3]; 3] {
        self.triangles[triangle as usize].map(|i| self.positions[i as usize])
    }

    /// Cuts some of the triangles and appends their charts, none of them empty.
    fn cut(&self, some: Vec<u32>, cost: f32, rounds: u32, charts: &mut Vec<Chart>) -> Result<(), String> {
        let (positions, triangles) = self.compacted(&some);
        let raw = xatlas::charts(&positions, &triangles, cost, self.options.max_iterations)?;
        let mut found: Vec<Chart> = (0..raw.count).map(|_| Chart { triangles: Vec::new(), uv: Vec::new() }).collect();
        for ((&t, &chart), &uv) in some.iter().zip(&raw.chart_of).zip(&raw.uv) {
            match found.get_mut(chart as usize) {
                Some(chart) => {
                    chart.triangles.push(t);
                    chart.uv.push(uv);
                }
                None => charts.push(self.alone(t)),
            }
        }
        for chart in found.into_iter().filter(|c| !c.triangles.is_empty()) {
            let settled = self.settle(chart, charts);
            let Some((chart, stretch)) = settled else { continue };
            let over = self.over_others(&chart);
            let bad = stretch > self.options.max_stretch as f64 || over.len() > chart.triangles.len() / MANY;
            if bad && rounds > 0 && chart.triangles.len() > 1 {
                self.cut(chart.triangles, cost / 2.0, rounds - 1, charts)?;
                continue;
            }
            let mut kept = Chart { triangles: Vec::new(), uv: Vec::new() };
            for (i, (&t, &uv)) in chart.triangles.iter().zip(&chart.uv).enumerate() {
                if over.binary_search(&i).is_ok() {
                    charts.push(self.alone(t));
                } else {
                    kept.triangles.push(t);
                    kept.uv.push(uv);
                }
            }
            charts.push(kept);
        }
        Ok(())
    }

    /// Vertices and triangles of a part of the cluster, as a mesh of its own.
    fn compacted(&self, some: &[u32]) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        if some.len() == self.triangles.len() {
            return (self.centred.clone(), self.triangles.to_vec());
        }
        let of = |t: &u32| self.triangles[*t as usize];
        let mut used: Vec<u32> = some.iter().flat_map(of).collect();
        used.sort_unstable();
        used.dedup();
        let place = |i: u32| used.binary_search(&i).expect("it was listed") as u32;
        (used.iter().map(|i| self.centred[*i as usize]).collect(), some.iter().map(|t| of(t).map(place)).collect())
    }

    /// Brings a chart to the size and the orientation of its surface; triangles that it turns over, loses or holds as
    /// no number become charts of their own. Returns what is left with its L2 stretch, if anything is.
    fn settle(&self, mut chart: Chart, charts: &mut Vec<Chart>) -> Option<(Chart, f64)> {
        let surface = |c: &Chart| c.triangles.iter().map(|t| triangle_area(&self.corners(*t)).1).sum::<f64>();
        let flat: f64 = chart.uv.iter().map(|uv| doubled_area(uv) / 2.0).sum();
        let scale = (surface(&chart) / flat.abs()).sqrt();
        let corner = |k: usize| chart.uv.iter().flatten().map(|c| c[k]).fold(f32::MAX, f32::min) as f64;
        let (low, mirror) = ([corner(0), corner(1)], if flat < 0.0 { -1.0 } else { 1.0 });
        for c in chart.uv.iter_mut().flatten() {
            *c = [((c[0] as f64 - low[0]) * scale * mirror) as f32, ((c[1] as f64 - low[1]) * scale) as f32];
        }
        let (mut kept, mut stretch) = (Chart { triangles: Vec::new(), uv: Vec::new() }, 0.0);
        for (&t, &uv) in chart.triangles.iter().zip(&chart.uv) {
            let squared = self.squared_stretch(t, &uv);
            match squared {
                Some(squared) => {
                    kept.triangles.push(t);
                    kept.uv.push(uv);
                    stretch += squared;
                }
                None => charts.push(self.alone(t)),
            }
        }
        let (area, flat) = (surface(&kept), kept.uv.iter().map(|uv| doubled_area(uv) / 2.0).sum::<f64>());
        if kept.triangles.is_empty() {
            return None;
        }
        if !(area <= flat * MAX_GROWTH && flat <= area * MAX_GROWTH) {
            charts.extend(kept.triangles.iter().map(|t| self.alone(*t)));
            return None;
        }
        Some((kept, (stretch / area * flat / area).sqrt()))
    }

    /// Squared L2 stretch of a triangle (Sander et al. 2001, section 3) times its area; nothing where the triangle is
    /// turned over or lost.
    fn squared_stretch(&self, triangle: u32, uv: &[[f32; 2]; 3]) -> Option<f64> {
        let (edges, area) = triangle_area(&self.corners(triangle));
        let flat = doubled_area(uv) / 2.0;
        if !(flat >= 0.0 && flat >= LOST * area && uv.iter().flatten().all(|x| x.is_finite())) {
            return None;
        }
        let [a, b, c] = uv.map(|p| p.map(f64::from));
        let weights = [(b, c), (c, a), (a, b)];
        let slope = |k: usize, axis: usize| -> f64 {
            // Positions relative to the first corner, so that only the other two count.
            let [w1, w2] = [weights[1], weights[2]].map(|(p, q)| p[axis] - q[axis]);
            (edges[0][k] * w1 + edges[1][k] * w2) / (2.0 * flat)
        };
        let sum: f64 = (0..3).map(|k| slope(k, 0).powi(2) + slope(k, 1).powi(2)).sum();
        if area == 0.0 { Some(0.0) } else { Some(sum / 2.0 * area).filter(|s| s.is_finite()) }
    }

    /// Members of a chart without which it would not lie over itself, ascending; never all of them.
    fn over_others(&self, chart: &Chart) -> Vec<usize> {
        let mut out = vec![false; chart.triangles.len()];
        for (a, b) in overlaps(&chart.uv) {
            if !out[a] && !out[b] {
                let smaller = if doubled_area(&chart.uv[a]) < doubled_area(&chart.uv[b]) { a } else { b };
                out[smaller] = true;
            }
        }
        (0..out.len()).filter(|i| out[*i]).collect()
    }

    /// A triangle by itself, as it is.
    fn alone(&self, triangle: u32) -> Chart {
        let ([ab, ac], area) = triangle_area(&self.corners(triangle));
        let length = dot(ab, ab).sqrt();
        let along = if length > 0.0 { [dot(ab, ac) / length, 2.0 * area / length] } else { [dot(ac, ac).sqrt(), 0.0] };
        let uv = [[0.0, 0.0], [length as f32, 0.0], along.map(|x| x as f32)];
        Chart { triangles: vec![triangle], uv: vec![uv] }
    }
}

/// The edges from a triangle's first corner, and its area.
fn triangle_area([a, b, c]: &[[f64; 3]; 3]) -> ([[f64; 3]; 2], f64) {
    let (ab, ac): ([f64; 3], [f64; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    let normal: [f64; 3] =
        std::array::from_fn(|k| ab[(k + 1) % 3] * ac[(k + 2) % 3] - ab[(k + 2) % 3] * ac[(k + 1) % 3]);
    ([ab, ac], dot(normal, normal).sqrt() / 2.0)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
