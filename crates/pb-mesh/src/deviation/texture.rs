//! How far the texture of a level slides over the surface: the distance between the points of the input and of the level
//! that have the same (u, v) in the same chart (the texture deviation of Cohen, Olano and Manocha 1998).
//!
//! Sampled at the input's UV wedges. Both surfaces are linear in (u, v) in between, so the largest slide is at a wedge
//! or where an edge of one crosses an edge of the other; the latter are left out, as are the level's own vertices,
//! which do not slide.

use super::relative;
use crate::closest::{closest_in_uv, closest_on_segment};
use crate::progress::share_of;
use crate::segment::Segmentation;
use crate::simplify::{Collapses, UvInput};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Cells along a side of a chart's grid at most.
const MAX_CELLS: usize = 256;
/// See [`TextureDeviation::most`].
const MOST_PERCENT: usize = 95;

/// Slides of a level, grid quanta.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TextureDeviation {
    /// Largest slide per cluster. Outside of the level's chart: the distance from the chart in the tile, on the scale of
    /// its side, is added. Where a chart has vanished: the way to the place that its point has collapsed to.
    pub max: Vec<f32>,
    /// Per cluster: 95 % of its wedges slide at most this far. A chart that vanishes, or a corner that leaves its chart,
    /// counts in the maximum with lengths that nobody sees.
    pub most: Vec<f32>,
    /// Sum of squared slides over the input's UV wedges, and how many they are.
    pub squares: (f64, u64),
}

/// Measures every level of a textured mesh, the finest first. `triangles` are the input's, in positions; `progress` gets the
/// share that is done.
pub fn texture_deviation(
    positions: &[[i32; 3]],
    triangles: &[[u32; 3]],
    segmentation: &Segmentation,
    uv: &UvInput,
    collapses: &Collapses,
    progress: &(dyn Fn(f32) + Sync),
) -> Vec<TextureDeviation> {
    let levels = collapses.counts.len();
    let counted = share_of(segmentation.len(), progress);
    let measure = |c: usize| {
        let charts = ClusterCharts::new(positions, triangles, segmentation.cluster(c), uv, uv.unit(c));
        counted((0..levels as u8).map(|level| charts.slides(collapses, level)).collect())
    };
    let clusters: Vec<Vec<Slides>> = (0..segmentation.len()).into_par_iter().map(measure).collect();
    let of_level = |level: usize| {
        let each = || clusters.iter().map(move |c| c[level]);
        let squares = each().fold((0.0, 0), |sum, c| (sum.0 + c.squares, sum.1 + c.count));
        TextureDeviation { max: each().map(|c| c.max).collect(), most: each().map(|c| c.most).collect(), squares }
    };
    (0..levels).map(of_level).collect()
}

/// Slides of one level of one cluster.
#[derive(Clone, Copy)]
struct Slides {
    max: f32,
    most: f32,
    squares: f64,
    count: u64,
}

impl Slides {
    fn of(mut slides: Vec<f32>) -> Slides {
        let (count, squares) = (slides.len(), slides.iter().map(|&s| f64::from(s).powi(2)).sum());
        let most = match count {
            0 => 0.0,
            n => *slides.select_nth_unstable_by((n - 1) * MOST_PERCENT / 100, f32::total_cmp).1,
        };
        Slides { max: slides.iter().copied().fold(0.0, f32::max), most, squares, count: count as u64 }
    }
}

/// The charts of a cluster in local wedges, those of a chart next to each other.
struct ClusterCharts {
    /// Wedge of the input, per local wedge.
    global: Vec<u32>,
    /// Local wedges by wedge of the input.
    by_global: Vec<(u32, u32)>,
    at: Vec<Vec3>,
    position: Vec<u32>,
    uv: Vec<Vec2>,
    triangles: Vec<[u32; 3]>,
    /// Wedges of chart `k`: `starts[k]` to `starts[k + 1]`.
    starts: Vec<u32>,
    /// Chart of each local wedge.
    chart: Vec<u32>,
    /// On triangles with texture?
    textured: Vec<bool>,
    /// On the border of its chart?
    seam: Vec<bool>,
    /// Length of a UV unit on the surface, quanta.
    unit: f32,
}

impl ClusterCharts {
    fn new(positions: &[[i32; 3]], mesh: &[[u32; 3]], members: &[u32], uv: &UvInput, unit: f32) -> Self {
        let corners: Vec<[u32; 3]> = members.iter().map(|&t| uv.corners[t as usize]).collect();
        let mut wedges: Vec<u32> = corners.as_flattened().to_vec();
        wedges.sort_unstable();
        wedges.dedup();
        let find = |w: u32| wedges.binary_search(&w).expect("collected above") as u32;
        let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(find)).collect();
        let roots = crate::segment::components(wedges.len(), &triangles);
        let mut order: Vec<u32> = (0..wedges.len() as u32).collect();
        order.sort_by_key(|&w| roots[w as usize]);
        let (mut place, mut chart, mut starts) = (vec![0; wedges.len()], Vec::new(), Vec::new());
        for (i, &w) in order.iter().enumerate() {
            if i == 0 || roots[w as usize] != roots[order[i - 1] as usize] {
                starts.push(i as u32);
            }
            chart.push(starts.len() as u32 - 1);
            place[w as usize] = i as u32;
        }
        starts.push(wedges.len() as u32);
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|w| place[w as usize])).collect();
        let mut textured = vec![false; wedges.len()];
        for (t, _) in triangles.iter().zip(&corners).filter(|(_, c)| uv.area(**c) > 0) {
            t.iter().for_each(|&w| textured[w as usize] = true);
        }
        let mut seam = vec![false; wedges.len()];
        seam_edges(&triangles).iter().for_each(|e| seam[e[0] as usize] = true);
        let global: Vec<u32> = order.iter().map(|&w| wedges[w as usize]).collect();
        let position: Vec<u32> = global.iter().map(|&w| uv.position_of[w as usize]).collect();
        let origin = mesh[members[0] as usize][0];
        ClusterCharts {
            by_global: wedges.iter().map(|&w| (w, place[find(w) as usize])).collect(),
            at: position.iter().map(|&v| relative(positions, origin, v)).collect(),
            uv: global.iter().map(|&w| Vec2::from(uv.uv[w as usize].map(f32::from))).collect(),
            global,
            position,
            triangles,
            starts,
            chart,
            textured,
            seam,
            unit,
        }
    }

    /// The slides of a level.
    fn slides(&self, collapses: &Collapses, level: u8) -> Slides {
        let local = |g: u32| {
            let i = self.by_global.binary_search_by_key(&g, |e| e.0).expect("a wedge of the cluster");
            self.by_global[i].1
        };
        let ancestor = |&g: &u32| local(collapses.wedge_ancestor(g, level));
        let ancestors: Vec<u32> = self.global.iter().map(ancestor).collect();
        let coarse = self.triangles.iter().map(|t| t.map(|w| ancestors[w as usize]));
        let at = |w: u32| self.position[w as usize];
        let mut coarse: Vec<[u32; 3]> =
            coarse.filter(|t| at(t[0]) != at(t[1]) && at(t[1]) != at(t[2]) && at(t[2]) != at(t[0])).collect();
        coarse.sort_by_key(|t| self.chart[t[0] as usize]);
        let seams = seam_edges(&coarse);
        let (mut all, mut from) = (Vec::with_capacity(self.global.len()), 0);
        for (k, wedges) in self.starts.windows(2).enumerate() {
            let end = from + coarse[from..].partition_point(|t| self.chart[t[0] as usize] == k as u32);
            let area = |t: &&[u32; 3]| signed_area(t.map(|w| self.uv[w as usize])) > 0.0;
            let located = Grid::new(self, coarse[from..end].iter().filter(area).copied().collect());
            for w in (wedges[0]..wedges[1]).filter(|&w| self.textured[w as usize]) {
                all.push(self.slide(w, ancestors[w as usize], &located).max(self.shift(w, &ancestors, &seams)));
            }
            from = end;
        }
        Slides::of(all)
    }

    /// Distance of a wedge from the level's point with its (u, v).
    fn slide(&self, w: u32, ancestor: u32, level: &Grid) -> f32 {
        match level.locate(self.uv[w as usize]) {
            Some((t, weights, square)) => {
                let [a, b, c] = t.map(|x| self.at[x as usize]);
                let at = a * weights[0] + b * weights[1] + c * weights[2];
                at.distance(self.at[w as usize]) + square.sqrt() * self.unit
            }
            None => self.at[w as usize].distance(self.at[ancestor as usize]),
        }
    }

    /// Distance of a wedge of a seam from that seam at the level, in the tile: what lies on its other side shows there.
    fn shift(&self, w: u32, ancestors: &[u32], seams: &[[u32; 2]]) -> f32 {
        let a = ancestors[w as usize];
        if a == w || !self.seam[w as usize] {
            return 0.0;
        }
        let uv = |x: u32| self.uv[x as usize].extend(0.0);
        let from = seams.partition_point(|e| e[0] < a);
        let along = seams[from..].iter().take_while(|e| e[0] == a);
        let distances = along.map(|e| closest_on_segment(uv(w), uv(a), uv(e[1])).distance(uv(w)));
        distances.min_by(f32::total_cmp).map_or(0.0, |d| d * self.unit)
    }
}

/// Edges that one triangle has, from both ends, ascending.
fn seam_edges(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let ends = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]].map(|[a, b]| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(ends).collect();
    edges.sort_unstable();
    let single = edges.chunk_by(|a, b| a == b).filter(|e| e.len() == 1);
    let mut list: Vec<[u32; 2]> = single.flat_map(|e| [e[0], [e[0][1], e[0][0]]]).collect();
    list.sort_unstable();
    list
}

/// Twice the area, exact enough to tell zero: the products are below 2^33, the coordinates integers.
fn signed_area(t: [Vec2; 3]) -> f64 {
    (t[1] - t[0]).as_dvec2().perp_dot((t[2] - t[0]).as_dvec2())
}

/// The triangles of a chart at a level, found by their (u, v).
struct Grid<'a> {
    charts: &'a ClusterCharts,
    triangles: Vec<[u32; 3]>,
    low: Vec2,
    cell: Vec2,
    cells: usize,
    /// Triangles that touch cell `i`: `list[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl<'a> Grid<'a> {
    fn new(charts: &'a ClusterCharts, triangles: Vec<[u32; 3]>) -> Self {
        let cells = ((triangles.len() as f32).sqrt().ceil() as usize).clamp(1, MAX_CELLS);
        let points = || triangles.iter().flatten().map(|&w| charts.uv[w as usize]);
        let low = points().fold(Vec2::INFINITY, Vec2::min);
        let high = points().fold(Vec2::NEG_INFINITY, Vec2::max);
        let cell = ((high - low) / cells as f32).max(Vec2::splat(1.0));
        let mut grid = Grid { charts, triangles, low, cell, cells, starts: Vec::new(), list: Vec::new() };
        let mut entries: Vec<(u32, u32)> = Vec::with_capacity(grid.triangles.len() * 2);
        for i in 0..grid.triangles.len() {
            grid.touched(i, |cell| entries.push((cell as u32, i as u32)));
        }
        entries.sort_unstable();
        grid.starts = vec![0; cells * cells + 1];
        entries.iter().for_each(|e| grid.starts[e.0 as usize + 1] += 1);
        (0..cells * cells).for_each(|c| grid.starts[c + 1] += grid.starts[c]);
        grid.list = entries.into_iter().map(|e| e.1).collect();
        grid
    }

    fn corners(&self, t: [u32; 3]) -> [Vec2; 3] {
        t.map(|w| self.charts.uv[w as usize])
    }

    /// Column or row of a coordinate in cells.
    fn index(&self, x: f32) -> usize {
        (x.max(0.0) as usize).min(self.cells - 1)
    }

    /// Calls `f` with the cells that triangle `i` touches: per row, those under the part of it in that row.
    fn touched(&self, i: usize, mut f: impl FnMut(usize)) {
        let p = self.corners(self.triangles[i]).map(|p| (p - self.low) / self.cell);
        let (low, high) = (p[0].y.min(p[1].y).min(p[2].y), p[0].y.max(p[1].y).max(p[2].y));
        for row in self.index(low)..=self.index(high) {
            // A little wider than the row, for rounding.
            let (bottom, top) = (row as f32 - 1e-3, row as f32 + 1.001);
            let (mut left, mut right) = (f32::INFINITY, f32::NEG_INFINITY);
            for k in 0..3 {
                let (a, b) = (p[k], p[(k + 1) % 3]);
                if a.y.max(b.y) < bottom || a.y.min(b.y) > top {
                    continue;
                }
                let slope = if a.y == b.y { 0.0 } else { (b.x - a.x) / (b.y - a.y) };
                for end in [a, b] {
                    let x = end.x + (end.y.clamp(bottom, top) - end.y) * slope;
                    (left, right) = (left.min(x - 1e-3), right.max(x + 1e-3));
                }
            }
            if left <= right {
                (self.index(left)..=self.index(right)).for_each(|column| f(row * self.cells + column));
            }
        }
    }

    /// The triangle nearest to `p` in UV, the weights of its corners there, and the squared distance, zero inside.
    fn locate(&self, p: Vec2) -> Option<([u32; 3], [f32; 3], f32)> {
        let at = (p - self.low) / self.cell;
        let (x, y) = (self.index(at.x) as isize, self.index(at.y) as isize);
        let mut best: Option<([u32; 3], [f32; 3], f32)> = None;
        for ring in 0..self.cells as isize {
            for row in y - ring..=y + ring {
                let whole = (row - y).abs() == ring;
                let step = if whole { 1 } else { (2 * ring).max(1) };
                for column in (x - ring..=x + ring).step_by(step as usize) {
                    self.look_into(row, column, p, &mut best);
                }
            }
            let reach = ring as f32 * self.cell.min_element();
            if best.is_some_and(|b| b.2 <= reach * reach) {
                break;
            }
        }
        best
    }

    fn look_into(&self, row: isize, column: isize, p: Vec2, best: &mut Option<([u32; 3], [f32; 3], f32)>) {
        let inside = 0..self.cells as isize;
        if !inside.contains(&row) || !inside.contains(&column) {
            return;
        }
        let cell = row as usize * self.cells + column as usize;
        for &i in &self.list[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
            let t = self.triangles[i as usize];
            let (weights, square) = closest_in_uv(p, self.corners(t));
            if best.is_none_or(|b| square < b.2) {
                *best = Some((t, weights, square));
            }
        }
    }
}
