//! Charts of a cluster: parts of its surface laid out flat, without overlap and without turned triangles.
//!
//! [`auto_charts`] makes few large charts: a part is laid out as one disc where its stretch allows, and is cut in two
//! otherwise. [`source_charts`] takes the charts of the input's own texture coordinates. [`pack`] places either in one
//! square tile and rounds the coordinates to the integers of docs/decisions/007-textures.md.
//!
//! Every function works on one cluster, is deterministic, and always succeeds: the last resort is a chart per triangle.

mod auto;
mod cut;
mod divide;
mod flatten;
mod halve;
mod hierarchy;
mod notch;
mod outline;
mod pack;
mod piece;
mod relax;
mod source;
mod stretch;
#[cfg(test)]
mod tests;

pub use auto::{AutoOptions, ChartReport, auto_charts};
pub use pack::{Fit, MAX_TILE, MIN_GAP_TEXELS, MIN_TILE, PackOptions, Packed, Placement, pack};
pub use source::{
    FEW_EXTRA_CHARTS, MAX_ANISOTROPY, MAX_DENSITY_SPREAD, MAX_SELF_OVERLAP, MIN_TRIANGLES_PER_EXTRA_CHART,
    SourceReport, source_charts,
};

/// One cluster's triangles in local indices.
#[derive(Clone, Copy, Debug)]
pub struct ClusterSurface<'a> {
    /// In any unit of length. Several may be equal.
    pub positions: &'a [[f32; 3]],
    /// Indices into `positions`. Neighbours that run along their common edge in opposite directions are connected;
    /// anything else (open borders, edges of three triangles, turned neighbours) is a border.
    pub triangles: &'a [[u32; 3]],
}

/// The charts of a cluster's triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Charts {
    /// Chart of each triangle, below `count`.
    pub chart_of: Vec<u32>,
    /// Number of charts; every one has a triangle.
    pub count: u32,
    /// Coordinates of each triangle's corners within its chart: in units of length for automatic charts, in texels of
    /// the source for source charts. Areas `cross(b - a, c - a)` are positive or zero. Corners of one chart that are
    /// one vertex of it have the same bits.
    pub uv: Vec<[[f32; 2]; 3]>,
    /// Per chart: whether v was negated to make its areas positive (source charts only).
    pub mirrored: Vec<bool>,
}

/// Twice the signed area of a triangle, exact up to one rounding of each product and difference.
pub(crate) fn signed_area2(uv: &[[f32; 2]; 3]) -> f64 {
    let [a, b, c] = uv.map(|p| p.map(f64::from));
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Twice the signed area of a triangle in its tile, in squares of 1 / 65536 of the side, exact; positive where u towards v
/// turns as in the list.
pub fn tile_area2(corners: [[u16; 2]; 3]) -> i64 {
    let [a, b, c] = corners.map(|p| p.map(i64::from));
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
