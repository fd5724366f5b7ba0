//! The charts that the input's own texture coordinates make, and whether they are good enough to be kept.

use super::piece::{NONE, Piece, components, next, partners};
use super::{Charts, ClusterSurface, signed_area2};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Corners of neighbours that are this close, in texels, are one vertex of a chart.
const TOLERANCE: f32 = 1.0 / 64.0;
/// Coordinates beyond this many texels are treated as missing.
const FARTHEST: f32 = 1e7;
/// Samples per axis that overlaps are counted with, over the box of each key's coordinates.
const SAMPLES: usize = 256;

/// More charts than connected parts by this many per cluster are no reason to make new ones.
pub const FEW_EXTRA_CHARTS: u64 = 48;
/// Fewer triangles than this per extra chart are fragments: seams would keep the surface from getting simple.
pub const MIN_TRIANGLES_PER_EXTRA_CHART: u64 = 400;
/// Texels per length may vary by this factor (geometric standard deviation over the area).
pub const MAX_DENSITY_SPREAD: f64 = 8.0;
/// Texels may be this much longer than wide on the surface (geometric mean over the area).
pub const MAX_ANISOTROPY: f64 = 4.0;
/// Part of the covered texels that a chart may cover twice itself.
pub const MAX_SELF_OVERLAP: f64 = 0.05;

/// Measures of source charts. Sums, so that reports of clusters can be added: [`SourceReport::merge`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SourceReport {
    /// Clusters.
    pub clusters: u64,
    /// Triangles.
    pub triangles: u64,
    /// Charts, those without area in texels left out.
    pub charts: u64,
    /// Connected parts of the surface with one key: no method makes fewer charts.
    pub parts: u64,
    /// Charts of a single triangle.
    pub single: u64,
    /// Charts that were mirrored.
    pub mirrored: u64,
    /// Triangles with coordinates that are not finite or absurdly far out.
    pub bad: u64,
    /// Triangles with an area on the surface and none in texels.
    pub pointlike: u64,
    /// Square texels of all charts.
    pub texel_area: f64,
    /// Surface area of triangles with an area in texels.
    pub area: f64,
    sum_log_density: f64,
    sum_log_density2: f64,
    sum_log_anisotropy: f64,
    samples: u64,
    samples_again: u64,
    samples_self: u64,
}

impl SourceReport {
    /// Adds another cluster's.
    pub fn merge(&mut self, other: &SourceReport) {
        self.clusters += other.clusters;
        self.triangles += other.triangles;
        self.charts += other.charts;
        self.parts += other.parts;
        self.single += other.single;
        self.mirrored += other.mirrored;
        self.bad += other.bad;
        self.pointlike += other.pointlike;
        self.texel_area += other.texel_area;
        self.area += other.area;
        self.sum_log_density += other.sum_log_density;
        self.sum_log_density2 += other.sum_log_density2;
        self.sum_log_anisotropy += other.sum_log_anisotropy;
        self.samples += other.samples;
        self.samples_again += other.samples_again;
        self.samples_self += other.samples_self;
    }

    /// Texels per unit of length: geometric mean over the area.
    pub fn density(&self) -> f64 {
        if self.area > 0.0 { (self.sum_log_density / self.area).exp() } else { 1.0 }
    }

    /// Geometric standard deviation of texels per length over the area; 1 where all are alike.
    pub fn density_spread(&self) -> f64 {
        if self.area <= 0.0 {
            return 1.0;
        }
        let mean = self.sum_log_density / self.area;
        (self.sum_log_density2 / self.area - mean * mean).max(0.0).sqrt().exp()
    }

    /// Length of a texel on the surface through its width: geometric mean over the area; 1 where texels are square.
    pub fn anisotropy(&self) -> f64 {
        if self.area > 0.0 { (self.sum_log_anisotropy / self.area).exp() } else { 1.0 }
    }

    /// Part of the covered texels that are covered more than once inside a cluster, by any chart of the same key.
    pub fn overlap(&self) -> f64 {
        self.samples_again as f64 / self.samples.max(1) as f64
    }

    /// Part of the covered texels that one chart covers more than once.
    pub fn self_overlap(&self) -> f64 {
        self.samples_self as f64 / self.samples.max(1) as f64
    }

    /// Whether the charts should be kept; otherwise why not.
    ///
    /// Charts over each other and coordinates outside of the image are no reason: each chart gets its own copy.
    pub fn usable(&self) -> Result<(), String> {
        let extra = self.charts.saturating_sub(self.parts);
        let (spread, anisotropy, overlap) = (self.density_spread(), self.anisotropy(), self.self_overlap());
        if extra > FEW_EXTRA_CHARTS * self.clusters && extra * MIN_TRIANGLES_PER_EXTRA_CHART > self.triangles {
            let (charts, parts, triangles) = (self.charts, self.parts, self.triangles);
            return Err(format!("fragmented: {charts} charts on {parts} parts of {triangles} triangles"));
        }
        if 2 * self.bad > self.triangles {
            return Err(format!("{} of {} triangles have no coordinates", self.bad, self.triangles));
        }
        if spread > MAX_DENSITY_SPREAD {
            return Err(format!("uneven: texels per length vary by a factor of {spread:.1}"));
        }
        if anisotropy > MAX_ANISOTROPY {
            return Err(format!("stretched: texels are {anisotropy:.1} times as long as wide"));
        }
        if overlap > MAX_SELF_OVERLAP {
            return Err(format!("charts lie on themselves: {:.0} % of their texels", 100.0 * overlap));
        }
        Ok(())
    }
}

/// Finds the charts of `corner_uvs`, the coordinates of each triangle's corners in texels of its image (v downwards, as
/// many as triangles). `key_of`: per triangle, what charts must not mix, such as image or material.
///
/// Triangles belong together over edges at which their coordinates agree, where both have the same orientation.
/// Mirrored charts come out with v negated. Triangles without area in texels join a neighbour at which they agree; those
/// that are one point in texels make one chart per key and point, whether or not they touch.
///
/// # Panics
/// If the slices differ in length, or a triangle refers to a position that is not there.
pub fn source_charts(surface: &ClusterSurface, corner_uvs: &[[[f32; 2]; 3]], key_of: &[u32]) -> (Charts, SourceReport) {
    let count = surface.triangles.len();
    assert!(corner_uvs.len() == count && key_of.len() == count, "coordinates and a key per triangle");
    let mut report = SourceReport { clusters: 1, triangles: count as u64, ..SourceReport::default() };
    let mut uv = corner_uvs.to_vec();
    for corners in &mut uv {
        // A NaN is not nearer than anything.
        if !corners.iter().flatten().all(|c| c.abs() <= FARTHEST) {
            *corners = [[0.0; 2]; 3];
            report.bad += 1;
        }
    }
    let all = partners(surface.triangles, |t| key_of[t]);
    report.parts = components(&all, |_| 0).len() as u64;
    let partner = continuous(all, &uv);
    let part_of = group(&partner, &uv, key_of);
    let mut charts = Charts { chart_of: part_of.clone(), uv, ..Charts::default() };
    charts.count = part_of.iter().max().map_or(0, |m| m + 1);
    turn_upright(&mut charts);
    unify(&partner, &mut charts);
    measure(surface, &charts, &mut report);
    count_overlaps(&charts, key_of, &mut report);
    (charts, report)
}

/// Keeps the partners at which coordinates agree.
fn continuous(mut partner: Vec<u32>, uv: &[[[f32; 2]; 3]]) -> Vec<u32> {
    let at = |h: u32| uv[h as usize / 3][h as usize % 3];
    let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() <= TOLERANCE && (a[1] - b[1]).abs() <= TOLERANCE;
    for h in 0..partner.len() as u32 {
        let g = partner[h as usize];
        if g != NONE && !(near(at(h), at(next(g))) && near(at(next(h)), at(g))) {
            partner[h as usize] = NONE;
            partner[g as usize] = NONE;
        }
    }
    partner
}

/// 1 and -1 by orientation, 0 without area.
fn orientation(uv: &[[f32; 2]; 3]) -> i8 {
    let area2 = signed_area2(uv);
    i8::from(area2 > 0.0) - i8::from(area2 < 0.0)
}

fn is_point(uv: &[[f32; 2]; 3]) -> bool {
    uv[0] == uv[1] && uv[1] == uv[2]
}

/// Chart of each triangle, numbered by first triangle.
fn group(partner: &[u32], uv: &[[[f32; 2]; 3]], key_of: &[u32]) -> Vec<u32> {
    let signs: Vec<i8> = uv.iter().map(orientation).collect();
    let mut part = vec![NONE; uv.len()];
    let upright = components(partner, |t| signs[t as usize] as u32);
    let mut count = 0;
    let mut queue = Vec::new();
    for p in upright.iter().filter(|p| signs[p[0] as usize] != 0) {
        p.iter().for_each(|&t| part[t as usize] = count);
        queue.extend_from_slice(p);
        count += 1;
    }
    // Triangles without area go to a chart that they hang on.
    let mut done = 0;
    while done < queue.len() {
        let t = queue[done] as usize;
        done += 1;
        for &g in partner[3 * t..3 * t + 3].iter().filter(|&&g| g != NONE) {
            if part[g as usize / 3] == NONE {
                part[g as usize / 3] = part[t];
                queue.push(g / 3);
            }
        }
    }
    let mut points: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
    for lone in components(partner, |t| if part[t as usize] == NONE { 0 } else { 1 }) {
        if part[lone[0] as usize] != NONE {
            continue;
        }
        let first = lone[0] as usize;
        let point = lone.iter().all(|&t| is_point(&uv[t as usize]) && uv[t as usize][0] == uv[first][0]);
        let chart = match point {
            true => *points.entry((key_of[first], uv[first][0].map(f32::to_bits))).or_insert(count),
            false => count,
        };
        count += u32::from(chart == count);
        lone.iter().for_each(|&t| part[t as usize] = chart);
    }
    let mut number = vec![NONE; count as usize];
    let mut used = 0;
    for p in &mut part {
        if number[*p as usize] == NONE {
            number[*p as usize] = used;
            used += 1;
        }
        *p = number[*p as usize];
    }
    part
}

/// Negates v in the charts that are turned over.
fn turn_upright(charts: &mut Charts) {
    charts.mirrored = vec![false; charts.count as usize];
    for (uv, &c) in charts.uv.iter().zip(&charts.chart_of) {
        charts.mirrored[c as usize] |= orientation(uv) < 0;
    }
    for (uv, &c) in charts.uv.iter_mut().zip(&charts.chart_of) {
        if charts.mirrored[c as usize] {
            uv.iter_mut().for_each(|p| p[1] = -p[1]);
        }
    }
}

/// Gives the corners of one vertex of a chart the same bits; a triangle that this would turn over, or move by more than the
/// tolerance (small differences add up around a vertex), keeps its own.
fn unify(partner: &[u32], charts: &mut Charts) {
    let given = charts.uv.clone();
    let inside: Vec<u32> = (0..partner.len())
        .map(|h| match partner[h] {
            g if g != NONE && charts.chart_of[g as usize / 3] == charts.chart_of[h / 3] => g,
            _ => NONE,
        })
        .collect();
    let differs = |h: usize| {
        let (at, g) = (|h: u32| given[h as usize / 3][h as usize % 3].map(f32::to_bits), inside[h]);
        g != NONE && (at(h as u32) != at(next(g)) || at(next(h as u32)) != at(g))
    };
    if !(0..inside.len()).any(differs) {
        return;
    }
    let every: Vec<u32> = (0..given.len() as u32).collect();
    let piece = Piece::new(&every, &inside, |_, _| DVec3::ZERO, &mut vec![NONE; every.len()]);
    let mut place = vec![None; piece.points.len()];
    for (t, vertices) in piece.triangles.iter().enumerate() {
        for (k, &v) in vertices.iter().enumerate() {
            charts.uv[t][k] = *place[v as usize].get_or_insert(given[t][k]);
        }
    }
    for (uv, given) in charts.uv.iter_mut().zip(&given) {
        let near = uv.iter().flatten().zip(given.iter().flatten()).all(|(a, b)| (a - b).abs() <= TOLERANCE);
        if !near || signed_area2(uv) < 0.0 {
            *uv = *given;
        }
    }
}

/// Density and anisotropy of texels, and counts.
fn measure(surface: &ClusterSurface, charts: &Charts, report: &mut SourceReport) {
    let mut sizes = vec![(0u64, false); charts.count as usize];
    for (t, uv) in charts.uv.iter().enumerate() {
        let size = &mut sizes[charts.chart_of[t] as usize];
        let texels = 0.5 * signed_area2(uv);
        *size = (size.0 + 1, size.1 || texels > 0.0);
        let [a, b, c] = surface.triangles[t].map(|v| DVec3::from_array(surface.positions[v as usize].map(f64::from)));
        let area = 0.5 * (b - a).cross(c - a).length();
        if area <= 0.0 || texels <= 0.0 {
            report.pointlike += u64::from(area > 0.0);
            continue;
        }
        let [p, q, r] = uv.map(|p| DVec2::from_array(p.map(f64::from)));
        // Sum of the squares of the singular values of the map from surface to texels, times the area (cotangents).
        let sum = 0.25 / area
            * ((b - a).dot(c - a) * (q - r).length_squared()
                + (a - b).dot(c - b) * (r - p).length_squared()
                + (a - c).dot(b - c) * (p - q).length_squared());
        let ratio = (sum / (2.0 * texels)).max(1.0);
        let density = 0.5 * (texels / area).ln();
        report.area += area;
        report.texel_area += texels;
        report.sum_log_density += area * density;
        report.sum_log_density2 += area * density * density;
        report.sum_log_anisotropy += area * (ratio + (ratio * ratio - 1.0).sqrt()).ln();
    }
    report.charts = sizes.iter().filter(|s| s.1).count() as u64;
    report.single = sizes.iter().filter(|s| s.1 && s.0 == 1).count() as u64;
    report.mirrored = charts.mirrored.iter().filter(|m| **m).count() as u64;
}

/// Counts samples of texels that triangles cover, and those covered again.
fn count_overlaps(charts: &Charts, key_of: &[u32], report: &mut SourceReport) {
    let mut by_key: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    key_of.iter().enumerate().for_each(|(t, &k)| by_key.entry(k).or_default().push(t as u32));
    let mut covered = vec![NONE; SAMPLES * SAMPLES];
    for faces in by_key.values() {
        // Where the texels are in the image: mirrored charts lie where they came from.
        let place = |t: u32| {
            let mirrored = charts.mirrored[charts.chart_of[t as usize] as usize];
            charts.uv[t as usize].map(|p| [f64::from(p[0]), f64::from(if mirrored { -p[1] } else { p[1] })])
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in faces.iter().flat_map(|&t| place(t)) {
            (0..2).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
        }
        covered.fill(NONE);
        let scale = [0, 1].map(|k| SAMPLES as f64 / (high[k] - low[k]).max(f64::MIN_POSITIVE));
        for &t in faces {
            let p = place(t).map(|p| [0, 1].map(|k| (p[k] - low[k]) * scale[k]));
            if orientation(&charts.uv[t as usize]) != 0 {
                cover(p, charts.chart_of[t as usize], &mut covered, report);
            }
        }
    }
}

/// Counts the samples inside a triangle of either orientation.
fn cover(p: [[f64; 2]; 3], chart: u32, covered: &mut [u32], report: &mut SourceReport) {
    let low = |k: usize| p.iter().fold(f64::INFINITY, |m, q| m.min(q[k])).max(0.0) as usize;
    let high = |k: usize| (p.iter().fold(0.0f64, |m, q| m.max(q[k])) as usize).min(SAMPLES - 1);
    let side = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let turn = side(p[0], p[1], p[2]).signum();
    for y in low(1)..=high(1) {
        for x in low(0)..=high(0) {
            // Off the places where edges tend to lie.
            let at = [x as f64 + 0.463_71, y as f64 + 0.531_13];
            if (0..3).any(|k| turn * side(p[k], p[(k + 1) % 3], at) <= 0.0) {
                continue;
            }
            let cell = &mut covered[y * SAMPLES + x];
            report.samples += 1;
            report.samples_again += u64::from(*cell != NONE);
            report.samples_self += u64::from(*cell == chart);
            *cell = chart;
        }
    }
}
