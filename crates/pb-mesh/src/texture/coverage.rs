//! Which chart owns which texel of a tile, at every mip (docs/decisions/007-textures.md, "No bleeding").
//!
//! Bilinear sampling inside a chart touches the texels whose centres are at most one texel away in the maximum norm.
//! So a texel belongs to the chart that is nearest in that norm, if one is that near; the others are copies of the
//! nearest such texel. Every mip is asked anew, of the integer corners.

use super::raster::Grid;
use crate::charts::tile_area2;
use std::collections::HashMap;

/// Smallest side of a tile and of a mip, texels: one compressed block.
pub const MIN_SIZE: u32 = 4;
/// Largest side of a tile, texels.
pub const MAX_SIZE: u32 = 32768;
/// How far from a chart its texels reach, in texels; a little more than one, as viewers interpolate in floats.
const REACH: f64 = 1.0 + 1.0 / 64.0;
/// How far from a closed edge texels are sampled with care, in texels: half of one, and a source texel that is two wide.
const CARE: f64 = 2.5;
/// No chart, no triangle, no texel.
pub(super) const NONE: u32 = u32::MAX;
/// The same in lists per texel, where every byte counts.
pub(super) const NOBODY: u16 = u16::MAX;

/// Where the triangles of a cluster lie in its tile.
#[derive(Clone, Copy, Debug)]
pub struct TileLayout<'a> {
    /// Texels per side: a power of two from 4 to 32768.
    pub size: u32,
    /// Per triangle, per corner: u and v in units of 1 / 65536 of the tile, v downwards.
    pub corners: &'a [[[u16; 2]; 3]],
    /// Per triangle; `u32::MAX`: the triangle has no place in the tile.
    pub chart_of: &'a [u32],
    /// Empty, or per triangle: bit k is set where the source image goes on beyond the edge from corner k to corner
    /// `(k + 1) % 3`, as at a cut through a source chart. Border texels there are samples of what lies beyond; at
    /// other edges they repeat the chart.
    pub open_edges: &'a [u8],
}

/// Who owns the texels of one mip.
pub(super) struct Level {
    /// Texels per side.
    pub size: u32,
    /// Per texel: a chart, or [`NOBODY`].
    pub owner: Vec<u16>,
    /// What the texels without an owner are copies of, in their order: the nearest texel with one. Empty where no texel
    /// has an owner.
    copied: Vec<u32>,
}

impl Level {
    /// Texels without an owner, and the nearest ones with one: (from, to).
    pub fn copies(&self) -> impl Iterator<Item = (u32, u32)> {
        let free = (0..).zip(&self.owner).filter(|o| *o.1 == NOBODY).map(|o| o.0);
        self.copied.iter().copied().zip(free)
    }
}

/// A texel of mip 0 whose centre is not in its chart, but near.
#[derive(Clone, Copy)]
pub(super) struct BorderTexel {
    pub texel: u32,
    pub triangle: u32,
    /// The edge of the triangle that is near.
    pub edge: u8,
}

/// Which chart owns which texel of a tile, for all maps of the tile.
pub struct Coverage {
    /// Finest first, down to 4 texels.
    pub(super) levels: Vec<Level>,
    /// Per texel of mip 0: the triangle that holds its centre, or [`NOBODY`].
    pub(super) triangles: Vec<u16>,
    /// Ordered by triangle, then texel.
    pub(super) border: Vec<BorderTexel>,
    /// Texels of mip 0 near closed edges of their own chart, with these; ordered by texel.
    rims: Vec<(u32, Edge)>,
    /// Where the rows of the tile begin in these, and the end.
    rim_rows: Vec<usize>,
}

impl Coverage {
    /// Rasterizes a layout. Charts should be two texels apart where the tile is 32 wide; nearer ones share.
    ///
    /// # Panics
    /// When the size is no power of two from 4 to 32768, the lists differ in length, or there are 65,535 triangles or
    /// charts.
    pub fn new(layout: &TileLayout) -> Coverage {
        assert!(
            layout.size.is_power_of_two() && (MIN_SIZE..=MAX_SIZE).contains(&layout.size),
            "tile of {}",
            layout.size
        );
        assert_eq!(layout.corners.len(), layout.chart_of.len(), "a chart per triangle");
        assert!(layout.open_edges.is_empty() || layout.open_edges.len() == layout.corners.len(), "edges per triangle");
        let short = |chart: u32| chart == NONE || chart < u32::from(NOBODY);
        assert!(layout.corners.len() < usize::from(NOBODY) && layout.chart_of.iter().all(|&c| short(c)), "16 bits");
        let edges = chart_borders(layout);
        let (finest, triangles, border) = finest_level(layout, &edges);
        let rims = rims(layout, &edges, &finest.owner);
        let rim_rows = (0..=layout.size).map(|y| rims.partition_point(|r| r.0 < y * layout.size)).collect();
        let mut levels = vec![finest];
        let mut size = layout.size / 2;
        while size >= MIN_SIZE {
            levels.push(coarser_level(layout, &edges, size));
            size /= 2;
        }
        Coverage { levels, triangles, border, rims, rim_rows }
    }

    /// Texels per side of mip 0.
    pub fn size(&self) -> u32 {
        self.levels[0].size
    }

    /// The closed edges near a texel of mip 0.
    pub(super) fn rim(&self, texel: u32) -> &[(u32, Edge)] {
        let row = &self.rims
            [self.rim_rows[(texel / self.size()) as usize]..self.rim_rows[(texel / self.size()) as usize + 1]];
        let first = row.partition_point(|r| r.0 < texel);
        &row[first..first + row[first..].iter().take_while(|r| r.0 == texel).count()]
    }

    /// Which blocks of 4 x 4 texels of a mip sampling may touch: those with a texel of a chart, and those around them.
    pub fn shown_blocks(&self, mip: usize) -> Vec<bool> {
        let Level { size, owner, .. } = &self.levels[mip];
        let (size, across) = (*size as usize, *size as usize / 4);
        let mut shown = vec![false; across * across];
        for (i, _) in owner.iter().enumerate().filter(|o| *o.1 != NOBODY) {
            let (x, y) = (i % size / 4, i / size / 4);
            for y in y.saturating_sub(1)..(y + 2).min(across) {
                shown[y * across + x.saturating_sub(1)..y * across + (x + 2).min(across)].fill(true);
            }
        }
        shown
    }

    /// Charts of the texels of a mip, rows from the top; [`NOBODY`] more than one texel from every chart.
    pub(super) fn owners(&self, mip: usize) -> &[u16] {
        &self.levels[mip].owner
    }
}

/// Edge k of a triangle, from corner k to corner k + 1.
pub(super) type Edge = (u32, u8);

/// Edges that one triangle of their chart uses, in the order of triangles.
fn chart_borders(layout: &TileLayout) -> Vec<Edge> {
    let corners = |(t, k): Edge| {
        let c = layout.corners[t as usize];
        (c[usize::from(k)], c[(usize::from(k) + 1) % 3])
    };
    let key = |edge: Edge| {
        let (a, b) = corners(edge);
        (layout.chart_of[edge.0 as usize], a.min(b), a.max(b))
    };
    let placed = (0..layout.corners.len() as u32).filter(|&t| layout.chart_of[t as usize] != NONE);
    let all: Vec<Edge> = placed.flat_map(|t| (0..3).map(move |k| (t, k))).collect();
    let mut uses: HashMap<_, u32> = HashMap::with_capacity(all.len());
    all.iter().for_each(|&e| *uses.entry(key(e)).or_default() += 1);
    // flat triangles may fold onto their neighbours' edges, so their edges always count
    all.into_iter().filter(|&e| uses[&key(e)] == 1 || tile_area2(layout.corners[e.0 as usize]) == 0).collect()
}

fn finest_level(layout: &TileLayout, edges: &[Edge]) -> (Level, Vec<u16>, Vec<BorderTexel>) {
    let grid = Grid { size: layout.size };
    let count = (layout.size * layout.size) as usize;
    let mut triangles = vec![NOBODY; count];
    let mut owner = vec![NOBODY; count];
    for_each_inside(layout, grid, |texel, triangle| {
        if triangles[texel] == NOBODY {
            triangles[texel] = triangle as u16;
            owner[texel] = layout.chart_of[triangle as usize] as u16;
        }
    });
    let mut nearest: HashMap<u32, (f32, u32, u32, u8)> = HashMap::new();
    for_each_near(layout, grid, REACH, edges, |texel, distance, (triangle, edge)| {
        if triangles[texel] == NOBODY {
            let here = (distance, layout.chart_of[triangle as usize], triangle, edge);
            let best = nearest.entry(texel as u32).or_insert(here);
            if here < *best {
                *best = here;
            }
        }
    });
    let mut border: Vec<BorderTexel> =
        nearest.into_iter().map(|(texel, (_, _, triangle, edge))| BorderTexel { texel, triangle, edge }).collect();
    border.sort_unstable_by_key(|b| (b.triangle, b.texel));
    border.iter().for_each(|b| owner[b.texel as usize] = layout.chart_of[b.triangle as usize] as u16);
    let copied = copied(layout.size, &owner);
    (Level { size: layout.size, owner, copied }, triangles, border)
}

fn rims(layout: &TileLayout, edges: &[Edge], owner: &[u16]) -> Vec<(u32, Edge)> {
    let open = |(t, k): Edge| layout.open_edges.get(t as usize).is_some_and(|open| open & (1 << k) != 0);
    let flat = |(t, _): Edge| tile_area2(layout.corners[t as usize]) == 0;
    let closed: Vec<Edge> = edges.iter().copied().filter(|&e| !open(e) && !flat(e)).collect();
    let mut rims = Vec::new();
    for_each_near(layout, Grid { size: layout.size }, CARE, &closed, |texel, _, edge| {
        if u32::from(owner[texel]) == layout.chart_of[edge.0 as usize] {
            rims.push((texel as u32, edge));
        }
    });
    rims.sort_unstable();
    rims
}

fn coarser_level(layout: &TileLayout, edges: &[Edge], size: u32) -> Level {
    let grid = Grid { size };
    let count = (size * size) as usize;
    let mut best = vec![(f32::INFINITY, NONE); count];
    for_each_inside(layout, grid, |texel, triangle| {
        if best[texel].0 > 0.0 {
            best[texel] = (0.0, layout.chart_of[triangle as usize]);
        }
    });
    for_each_near(layout, grid, REACH, edges, |texel, distance, (triangle, _)| {
        let here = (distance, layout.chart_of[triangle as usize]);
        if best[texel].0 > 0.0 && here < best[texel] {
            best[texel] = here;
        }
    });
    let owner: Vec<u16> = best.into_iter().map(|(_, chart)| chart as u16).collect();
    let copied = copied(size, &owner);
    Level { size, owner, copied }
}

fn for_each_inside(layout: &TileLayout, grid: Grid, mut hit: impl FnMut(usize, u32)) {
    for (triangle, corners) in layout.corners.iter().enumerate().filter(|(t, _)| layout.chart_of[*t] != NONE) {
        grid.inside(*corners, |x, y| hit((y * grid.size + x) as usize, triangle as u32));
    }
}

fn for_each_near(layout: &TileLayout, grid: Grid, reach: f64, edges: &[Edge], mut hit: impl FnMut(usize, f32, Edge)) {
    for &(triangle, k) in edges {
        let corners = layout.corners[triangle as usize];
        let (a, b) = (corners[usize::from(k)], corners[(usize::from(k) + 1) % 3]);
        grid.near_edge(a, b, reach, |x, y, d| hit((y * grid.size + x) as usize, d, (triangle, k)));
    }
}

/// Rings around the owned texels, each texel a copy of the owned one that it was reached from: [`Level::copied`].
fn copied(size: u32, owner: &[u16]) -> Vec<u32> {
    let mut origin: Vec<u32> = (0..).zip(owner).map(|(i, &chart)| if chart == NOBODY { NONE } else { i }).collect();
    let free = |texel: u32| owner[texel as usize] == NOBODY;
    let mut ring: Vec<u32> = (0..origin.len() as u32).filter(|&i| !free(i) && neighbours(size, i).any(free)).collect();
    while !ring.is_empty() {
        let mut next = Vec::new();
        for &texel in &ring {
            for neighbour in neighbours(size, texel) {
                if origin[neighbour as usize] == NONE {
                    origin[neighbour as usize] = origin[texel as usize];
                    next.push(neighbour);
                }
            }
        }
        ring = next;
    }
    let mut texels = 0..;
    origin.retain(|&from| texels.next().is_some_and(free) && from != NONE);
    origin.shrink_to_fit();
    origin
}

/// The up to eight texels around a texel, those that share an edge first.
pub(super) fn neighbours(size: u32, texel: u32) -> impl Iterator<Item = u32> {
    const AROUND: [(i64, i64); 8] = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];
    let (x, y, size) = (i64::from(texel % size), i64::from(texel / size), i64::from(size));
    AROUND.iter().filter_map(move |&(dx, dy)| {
        let (x, y) = (x + dx, y + dy);
        ((0..size).contains(&x) && (0..size).contains(&y)).then_some((y * size + x) as u32)
    })
}
