//! Packing the charts of a cluster into one square tile, and rounding their coordinates to the tile's integers.
//!
//! Charts are sets of cells; each is put to the first free place, row by row, in any of four directions. Cells are as
//! fine as it takes (a texel in small tiles). Gaps follow "No bleeding" of docs/decisions/007-textures.md.

mod mask;
mod snap;

use super::Charts;
use mask::Mask;
use std::collections::BTreeMap;

/// Tiles are at least this many texels wide: one block of a block-compressed format.
pub const MIN_TILE: u32 = 4;
/// Tiles are at most this many texels wide: the centres of their texels are integers.
pub const MAX_TILE: u32 = 32_768;
/// Charts are at least this many texels of the finest mip apart.
pub const MIN_GAP_TEXELS: u32 = 4;
/// Where it fits, charts are two texels apart at the mip in which the tile is 32 wide: a sixteenth of the tile.
const WANTED_GAP: u32 = 16;
/// Texels along the side of the square that a chart without area gets.
const POINT_TEXELS: f64 = 4.0;
/// Cells per tile side: at least this, and at least [`CELLS_PER_ROOT`] times the root of the number of charts.
const MIN_CELLS: u32 = 128;
const CELLS_PER_ROOT: f64 = 16.0;
const MAX_CELLS: u32 = 2048;
/// Charts in more directions than one only up to this many.
const MAX_TURNED: usize = 4096;
/// Trials of a density between one that fits and one that does not.
const DENSITY_TRIALS: usize = 6;
/// Halvings of the density at most.
const MAX_HALVINGS: i32 = 24;

/// How charts may be scaled and moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// By any angle and factor.
    Free,
    /// By whole texels and quarter turns, so that texels can be copied; scaled by halves only, and only where the
    /// largest tile is too small.
    WholeTexels,
}

/// How charts are packed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackOptions {
    /// Largest width of the tile in texels, a power of two from [`MIN_TILE`] to [`MAX_TILE`].
    pub max_size: u32,
    /// How charts may be scaled and moved.
    pub fit: Fit,
    /// A smaller tile is taken where its density is at least this part of what was asked ([`Fit::Free`] only).
    pub min_scale: f32,
}

impl Default for PackOptions {
    fn default() -> Self {
        PackOptions { max_size: 512, fit: Fit::Free, min_scale: 1.0 }
    }
}

/// Where a chart went: `tile texels = turn(scale * R(uv) - low) + offset`, with R a rotation by `angle`, and `turn` a
/// number of quarter turns `(x, y) -> (extent[1] - y, x)`, the extent turning with it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Texels of the tile per unit of the chart's coordinates.
    pub scale: f64,
    /// Radians, counter-clockwise from u to v; 0 for [`Fit::WholeTexels`].
    pub angle: f64,
    /// Lower corner of the scaled chart, in texels; whole for [`Fit::WholeTexels`].
    pub low: [f64; 2],
    /// Texels that the chart takes before it is turned; whole.
    pub extent: [u32; 2],
    /// Quarter turns, 0 to 3.
    pub turns: u8,
    /// In the tile; whole texels.
    pub offset: [u32; 2],
}

impl Placement {
    /// Chart coordinates to texels of the tile.
    pub fn apply(&self, uv: [f32; 2]) -> [f64; 2] {
        let mut p = self.local(uv);
        let mut extent = self.extent.map(f64::from);
        for _ in 0..self.turns {
            p = [extent[1] - p[1], p[0]];
            extent.swap(0, 1);
        }
        [p[0] + f64::from(self.offset[0]), p[1] + f64::from(self.offset[1])]
    }

    fn local(&self, uv: [f32; 2]) -> [f64; 2] {
        let p = turned_by(self.angle, uv.map(f64::from));
        [p[0] * self.scale - self.low[0], p[1] * self.scale - self.low[1]]
    }
}

/// Charts in a tile.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed {
    /// Width and height of the tile in texels, a power of two.
    pub size: u32,
    /// Per triangle corner, in 1 / 65536 of the tile; areas are positive or zero.
    pub corners: Vec<[[u16; 2]; 3]>,
    /// Chart of each triangle: those of the input, then one for each triangle that rounding would have turned over.
    pub chart_of: Vec<u32>,
    /// Number of charts.
    pub count: u32,
    /// Per chart of the input.
    pub placements: Vec<Placement>,
    /// Density reached, in parts of what was asked.
    pub scale: f64,
    /// Texels of the finest mip that charts are apart at least.
    pub gap: u32,
    /// Part of the tile that triangles cover.
    pub fill: f64,
    /// Triangles that rounding would have turned over; they have no area now.
    pub snapped_alone: u32,
}

/// Packs `charts` at `density[chart]` texels per unit of their coordinates (1 for source charts, which are in texels).
///
/// Always succeeds: where the largest tile cannot hold the charts at that density, all of them get less.
///
/// # Panics
/// If `density` does not have one positive number per chart, or `max_size` is no power of two in its range.
pub fn pack(charts: &Charts, density: &[f32], options: &PackOptions) -> Packed {
    assert_eq!(density.len(), charts.count as usize, "one density per chart");
    assert!(density.iter().all(|d| d.is_finite() && *d > 0.0), "densities are positive");
    assert!(options.max_size.is_power_of_two() && (MIN_TILE..=MAX_TILE).contains(&options.max_size));
    let packer = Packer::new(charts, density, options.fit);
    let (size, scale, placements) = packer.smallest(options);
    let mut best = (MIN_GAP_TEXELS, placements);
    let mut gap = size / WANTED_GAP;
    while gap > MIN_GAP_TEXELS {
        if let Some(placements) = packer.place(size, scale, gap) {
            best = (gap, placements);
            break;
        }
        gap /= 2;
    }
    snapped(charts, Packed { size, scale, gap: best.0, placements: best.1, ..Packed::default() })
}

/// Rounds the coordinates of placed charts.
fn snapped(charts: &Charts, mut packed: Packed) -> Packed {
    let per_texel = 65_536.0 / f64::from(packed.size);
    let round = |x: f64| (x * per_texel).round().clamp(0.0, 65_535.0) as u16;
    let chart_of = |t: usize| charts.chart_of[t] as usize;
    packed.corners = (0..charts.uv.len())
        .map(|t| charts.uv[t].map(|uv| packed.placements[chart_of(t)].apply(uv).map(round)))
        .collect();
    packed.chart_of = charts.chart_of.clone();
    packed.count = charts.count;
    let vertex_of = |t: usize, k: usize| (chart_of(t), charts.uv[t][k].map(f32::to_bits));
    for t in snap::turn_back(&mut packed.corners, vertex_of) {
        packed.chart_of[t as usize] = packed.count;
        packed.count += 1;
        packed.snapped_alone += 1;
    }
    let area2: i64 = packed.corners.iter().map(|&c| super::tile_area2(c)).sum();
    packed.fill = area2 as f64 * 0.5 / (65_536.0 * 65_536.0);
    packed
}

/// A chart before it is placed.
struct Shape {
    /// Triangles of the chart.
    faces: Vec<u32>,
    /// See [`Placement`].
    angle: f64,
    /// Box of the turned coordinates, times density.
    low: [f64; 2],
    high: [f64; 2],
    density: f64,
    area: f64,
}

struct Packer<'a> {
    charts: &'a Charts,
    fit: Fit,
    shapes: Vec<Shape>,
}

impl Packer<'_> {
    fn new<'a>(charts: &'a Charts, density: &[f32], fit: Fit) -> Packer<'a> {
        let mut faces = vec![Vec::new(); charts.count as usize];
        charts.chart_of.iter().enumerate().for_each(|(t, &c)| faces[c as usize].push(t as u32));
        let shape = |(faces, density): (Vec<u32>, &f32)| {
            let points = || faces.iter().flat_map(|&f| charts.uv[f as usize]).map(|p| p.map(f64::from));
            let angle = if fit == Fit::Free { slimmest(points().collect()) } else { 0.0 };
            let density = f64::from(*density);
            let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for p in points().map(|p| turned_by(angle, p)) {
                for k in 0..2 {
                    low[k] = low[k].min(p[k] * density);
                    high[k] = high[k].max(p[k] * density);
                }
            }
            let area2: f64 = faces.iter().map(|&f| super::signed_area2(&charts.uv[f as usize])).sum();
            Shape { faces, angle, low, high, density, area: 0.5 * area2 * density * density }
        };
        Packer { charts, fit, shapes: faces.into_iter().zip(density).map(shape).collect() }
    }

    /// The smallest tile that holds all charts with the smallest gap, and the density at which it does.
    fn smallest(&self, options: &PackOptions) -> (u32, f64, Vec<Placement>) {
        let area: f64 = self.shapes.iter().map(|s| s.area).sum();
        let least = if self.fit == Fit::Free { f64::from(options.min_scale).clamp(0.01, 1.0) } else { 1.0 };
        let mut size = MIN_TILE;
        while size < options.max_size && area * least * least > f64::from(size) * f64::from(size) {
            size *= 2;
        }
        loop {
            if let Some(placements) = self.place(size, 1.0, MIN_GAP_TEXELS) {
                return (size, 1.0, placements);
            }
            let fits = if least < 1.0 { self.place(size, least, MIN_GAP_TEXELS) } else { None };
            if let Some(placements) = fits {
                return self.densest(size, [least, 1.0], placements);
            }
            if size >= options.max_size {
                break;
            }
            size *= 2;
        }
        for halvings in 1..MAX_HALVINGS {
            let scale = 0.5f64.powi(halvings);
            if let Some(placements) = self.place(size, scale, MIN_GAP_TEXELS) {
                return match self.fit {
                    Fit::Free => self.densest(size, [scale, 2.0 * scale], placements),
                    Fit::WholeTexels => (size, scale, placements),
                };
            }
        }
        (size, 0.5f64.powi(MAX_HALVINGS), self.in_heaps(size))
    }

    /// Narrows down the density between one that fits and one that does not.
    fn densest(&self, size: u32, mut between: [f64; 2], mut placements: Vec<Placement>) -> (u32, f64, Vec<Placement>) {
        for _ in 0..DENSITY_TRIALS {
            let middle = (between[0] * between[1]).sqrt();
            match self.place(size, middle, MIN_GAP_TEXELS) {
                Some(better) => (between[0], placements) = (middle, better),
                None => between[1] = middle,
            }
        }
        (size, between[0], placements)
    }

    /// More charts than the tile has room for, however small they are: all at one place, without extent.
    fn in_heaps(&self, size: u32) -> Vec<Placement> {
        let middle = size / 2;
        let point = Placement { offset: [middle; 2], ..Placement::default() };
        vec![point; self.shapes.len()]
    }

    /// Puts all charts in a tile of `size`, `gap` texels apart; `None`: they do not fit.
    fn place(&self, size: u32, scale: f64, gap: u32) -> Option<Vec<Placement>> {
        let area: f64 = self.shapes.iter().map(|s| s.area).sum::<f64>() * scale * scale;
        if area > f64::from(size) * f64::from(size) {
            return None;
        }
        let wanted = (CELLS_PER_ROOT * (self.shapes.len() as f64).sqrt()) as u32;
        let cells = wanted.next_power_of_two().clamp(MIN_CELLS, MAX_CELLS).min(size);
        let cell = size / cells;
        let gap_cells = gap.div_ceil(cell) as usize;
        let mut placements: Vec<Placement> = self.shapes.iter().map(|s| self.unplaced(s, scale, cell)).collect();
        if placements.iter().any(|p| p.extent.iter().any(|e| *e > size)) {
            return None;
        }
        let masks: Vec<Mask> = self.shapes.iter().zip(&placements).map(|(s, p)| self.mask(s, p, cell)).collect();
        if masks.iter().map(Mask::count).sum::<usize>() > (cells * cells) as usize {
            return None;
        }
        let orders: [fn(&Mask) -> usize; 3] =
            [|m| m.width.max(m.height), |m| m.width * m.height, |m| m.width + m.height];
        for key in orders {
            let mut order: Vec<usize> = (0..masks.len()).collect();
            order.sort_by_key(|&i| (std::cmp::Reverse(key(&masks[i])), i));
            if fill_tile(&masks, &order, cells as usize, gap_cells, cell, &mut placements) {
                return Some(placements);
            }
            if masks.len() == 1 {
                break;
            }
        }
        None
    }

    /// Everything but turns and offset.
    fn unplaced(&self, shape: &Shape, scale: f64, cell: u32) -> Placement {
        let mut low = shape.low.map(|l| l * scale);
        if self.fit == Fit::WholeTexels {
            low = low.map(f64::floor);
        }
        let mut extent = [0, 1].map(|k| shape.high[k] * scale - low[k]);
        if extent[0] <= 0.0 && extent[1] <= 0.0 || shape.high == shape.low {
            // A point: in the middle of its square.
            low = shape.high.map(|h| h * scale - 0.5 * POINT_TEXELS);
            extent = [POINT_TEXELS; 2];
        }
        let cells = extent.map(|e| (e / f64::from(cell)).ceil().clamp(1.0, f64::from(2 * MAX_TILE)) as u32);
        let extent = cells.map(|c| c.saturating_mul(cell));
        Placement { scale: scale * shape.density, angle: shape.angle, low, extent, ..Placement::default() }
    }

    /// Cells that a chart touches.
    fn mask(&self, shape: &Shape, place: &Placement, cell: u32) -> Mask {
        let [width, height] = place.extent.map(|e| (e / cell) as usize);
        let mut mask = Mask::new(width, height);
        if shape.high == shape.low {
            (0..height).for_each(|y| mask.set_run(y, 0, width - 1));
            return mask;
        }
        let per_cell = 1.0 / f64::from(cell);
        for &f in &shape.faces {
            mask.set_triangle(self.charts.uv[f as usize].map(|uv| place.local(uv).map(|x| x * per_cell)));
        }
        mask
    }
}

/// Puts the masks in order to the first free place that ends in the lowest row; false where one does not fit.
fn fill_tile(
    masks: &[Mask],
    order: &[usize],
    cells: usize,
    gap: usize,
    cell: u32,
    placements: &mut [Placement],
) -> bool {
    let mut taken = Mask::new(cells, cells);
    // Where the last mask of the same extent went: the next one will not find a place above.
    let mut reached: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    let turns = if masks.len() <= MAX_TURNED { 4 } else { 1 };
    for &i in order {
        let mut mask = masks[i].clone();
        let mut best: Option<(usize, usize, [usize; 2], u8, Mask)> = None;
        for turn in 0..turns {
            if turn > 0 {
                mask = mask.turned();
            }
            let extent = [mask.width, mask.height];
            let from = if masks.len() > 64 { reached.get(&extent).copied().unwrap_or(0) } else { 0 };
            let Some(at) = taken.first_fit(&mask, from) else { continue };
            reached.insert(extent, at[1]);
            let better = best.as_ref().is_none_or(|b| (at[1] + mask.height, at[0]) < (b.0, b.1));
            if better {
                best = Some((at[1] + mask.height, at[0], at, turn, mask.clone()));
            }
        }
        let Some((_, _, at, turn, mask)) = best else { return false };
        placements[i].turns = turn;
        placements[i].offset = at.map(|a| a as u32 * cell);
        taken.unite(&mask.widened(gap), at[0] as isize - gap as isize, at[1] as isize - gap as isize);
    }
    true
}

fn turned_by(angle: f64, p: [f64; 2]) -> [f64; 2] {
    if angle == 0.0 {
        return p;
    }
    let (s, c) = angle.sin_cos();
    [c * p[0] - s * p[1], s * p[0] + c * p[1]]
}

/// The rotation after which the box around the points has the least area: one edge of their hull lies along it.
fn slimmest(points: Vec<[f64; 2]>) -> f64 {
    let hull = hull(points);
    let mut best = (f64::INFINITY, 0.0);
    for i in 0..hull.len() {
        let (a, b) = (hull[i], hull[(i + 1) % hull.len()]);
        let angle = -(b[1] - a[1]).atan2(b[0] - a[0]);
        let (s, c) = angle.sin_cos();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &hull {
            let q = [c * p[0] - s * p[1], s * p[0] + c * p[1]];
            (0..2).for_each(|k| (low[k], high[k]) = (low[k].min(q[k]), high[k].max(q[k])));
        }
        let area = (high[0] - low[0]) * (high[1] - low[1]);
        if area < best.0 * (1.0 - 1e-9) {
            best = (area, angle);
        }
    }
    best.1
}

/// Corners of the convex hull (Andrew 1979).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut around = half(&mut points.iter().copied());
    around.extend(half(&mut points.iter().rev().copied()));
    around
}
