//! The image of a unit, texel by texel: each shows the surface of the chart that it lies in.

use super::{Rect, Unit};
use crate::random::mixed;
use crate::textured::paint::Paint;

/// Of colours of single texels, sRGB.
const GRAIN: f64 = 0.03;

/// A unit as an image.
pub struct Picture<'a> {
    unit: &'a Unit,
    /// Part, chart of the part, its cell, its place inside the cell.
    charts: Vec<(usize, usize, Rect, Rect)>,
}

impl Picture<'_> {
    pub fn new(unit: &Unit) -> Picture<'_> {
        let of = |(p, part): (usize, &super::Part)| {
            let rects: Vec<_> = part.cells.iter().copied().zip(part.charts.iter().copied()).collect();
            rects.into_iter().enumerate().map(move |(c, (cell, chart))| (p, c, cell, chart))
        };
        Picture { unit, charts: unit.parts.iter().enumerate().flat_map(of).collect() }
    }
}

impl Paint for Picture<'_> {
    fn size(&self) -> u32 {
        self.unit.texture
    }

    /// The margin of a chart continues its border.
    fn texel(&self, x: u32, y: u32) -> [u8; 3] {
        let at = [x, y].map(|c| (f64::from(c) + 0.5) / f64::from(self.unit.texture));
        let holds = |r: &Rect| (0..2).all(|k| (r.start[k]..r.start[k] + r.size[k]).contains(&at[k]));
        let Some(&(part, chart, _, inner)) = self.charts.iter().find(|c| holds(&c.2)) else { return [96, 90, 80] };
        let share = [0, 1].map(|k| ((at[k] - inner.start[k]) / inner.size[k]).clamp(0.0, 1.0));
        let grain = mixed(self.unit.seed ^ u64::from(y) << 32 ^ u64::from(x)) as f64 / u64::MAX as f64 - 0.5;
        let color = self.unit.parts[part].color(chart, share);
        color.map(|c| ((c * (1.0 + 2.0 * GRAIN * grain)).clamp(0.0, 1.0) * 255.0).round() as u8)
    }
}
