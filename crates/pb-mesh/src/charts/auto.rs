//! Automatic charts: each connected part is laid out as one disc if its stretch allows, and is cut in two otherwise.

use super::cut::open_to_disc;
use super::divide::{Division, divide};
use super::flatten::{Failure, flatten};
use super::halve::{ROUNDS, halve};
use super::notch::fill_notches;
use super::outline::overlaps;
use super::piece::{NONE, Piece, components, partners};
use super::stretch::Stretch;
use super::{Charts, ClusterSurface, signed_area2};
use glam::{DVec2, DVec3};

/// What automatic charts may be like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoOptions {
    /// Most L2 stretch of a chart (Sander et al. 2001): 1 is an isometry.
    pub max_stretch: f64,
}

impl Default for AutoOptions {
    fn default() -> Self {
        AutoOptions { max_stretch: 1.25 }
    }
}

/// What became of a cluster.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChartReport {
    /// Charts.
    pub charts: u32,
    /// Charts of a single triangle.
    pub single: u32,
    /// L2 stretch over the whole cluster, by area; 1 is an isometry.
    pub stretch: f64,
    /// The largest L2 stretch of a chart.
    pub worst_stretch: f64,
    /// Parts that were cut in two because they would be stretched too much,
    pub split_stretched: u32,
    /// because they would lie on themselves,
    pub split_overlapping: u32,
    /// because triangles would be turned over,
    pub split_turned: u32,
    /// and because they were closed.
    pub split_closed: u32,
    /// Charts that were cut open along seams: both sides of a seam belong to one chart.
    pub cut_open: u32,
}

/// Weight of place against normals where a part is cut for its stretch.
const PLACE: f64 = 0.3;

/// Notches of the border above this angle inside, in radians, are filled.
const WIDE: f64 = 3.9;

/// Makes charts for a cluster. `key_of`: per triangle what charts must not mix. Coordinates are in the unit of the
/// positions; the area of each chart is that of its triangles.
///
/// # Panics
/// If a triangle refers to a position that is not there, or `key_of` has another length than the triangles.
pub fn auto_charts(surface: &ClusterSurface, options: &AutoOptions, key_of: Option<&[u32]>) -> (Charts, ChartReport) {
    let count = surface.triangles.len();
    assert!(key_of.is_none_or(|k| k.len() == count), "one key per triangle");
    let partner = partners(surface.triangles, |t| key_of.map_or(0, |k| k[t]));
    let mut builder = Builder {
        surface,
        options,
        partner,
        scratch: vec![NONE; count],
        label: vec![0; count],
        charts: Charts { chart_of: vec![0; count], uv: vec![[[0.0; 2]; 3]; count], ..Charts::default() },
        report: ChartReport { worst_stretch: 1.0, ..ChartReport::default() },
        stretch: Stretch::default(),
    };
    let mut parts = components(&builder.partner, |_| 0);
    parts.reverse();
    while let Some(part) = parts.pop() {
        if let Some(smaller) = builder.try_part(&part) {
            parts.extend(smaller.into_iter().rev());
        }
    }
    builder.report.charts = builder.charts.count;
    builder.report.stretch = builder.stretch.l2();
    (builder.charts, builder.report)
}

struct Builder<'a> {
    surface: &'a ClusterSurface<'a>,
    options: &'a AutoOptions,
    partner: Vec<u32>,
    /// One [`NONE`] per triangle.
    scratch: Vec<u32>,
    /// Half of each triangle.
    label: Vec<u32>,
    charts: Charts,
    report: ChartReport,
    stretch: Stretch,
}

impl Builder<'_> {
    /// Makes a chart of `part`, or returns the smaller parts to try instead.
    fn try_part(&mut self, part: &[u32]) -> Option<Vec<Vec<u32>>> {
        if part.len() == 1 {
            self.single(part[0]);
            return None;
        }
        let surface = self.surface;
        let point = |f: u32, k: usize| {
            DVec3::from_array(surface.positions[surface.triangles[f as usize][k] as usize].map(f64::from))
        };
        let whole = Piece::new(part, &self.partner, point, &mut self.scratch);
        let failure = match self.try_piece(part, &whole, point) {
            Ok(rest) => return Some(rest),
            Err(failure) => failure,
        };
        *match failure {
            Failure::NoDisc => &mut self.report.split_closed,
            Failure::Stretched => &mut self.report.split_stretched,
            Failure::Turned => &mut self.report.split_turned,
            Failure::Overlap => &mut self.report.split_overlapping,
        } += 1;
        let half = halve(&whole, PLACE, ROUNDS);
        part.iter().zip(half).for_each(|(&f, half)| self.label[f as usize] = u32::from(half));
        let local = components(&whole.partner, |t| self.label[part[t as usize] as usize]);
        assert!(local.len() > 1, "each half has a triangle");
        Some(local.into_iter().map(|p| p.into_iter().map(|t| part[t as usize]).collect()).collect())
    }

    /// Makes charts of `part`; returns parts to lay out once more where it lay on itself.
    fn try_piece(
        &mut self,
        part: &[u32],
        whole: &Piece,
        point: impl Fn(u32, usize) -> DVec3,
    ) -> Result<Vec<Vec<u32>>, Failure> {
        let opened = match whole.euler_characteristic() {
            1 => None,
            2 => return Err(Failure::NoDisc),
            _ => {
                let mut piece = Piece::new(part, &self.partner, point, &mut self.scratch);
                open_to_disc(&mut piece);
                if piece.euler_characteristic() != 1 {
                    return Err(Failure::NoDisc);
                }
                Some(piece)
            }
        };
        let disc = opened.as_ref().unwrap_or(whole);
        let (uv, stretch) = flatten(&fill_notches(disc, WIDE), self.options.max_stretch)?;
        if !overlaps(disc, &uv) {
            self.report.cut_open += u32::from(opened.is_some());
            return self.accept(disc, &uv, &stretch).map(|()| Vec::new());
        }
        self.report.split_overlapping += 1;
        let (done, mut rest) = divide(disc, &uv, self.options.max_stretch);
        for Division { piece, uv, stretch } in done {
            if self.accept(&piece, &uv, &stretch).is_err() {
                rest.push(piece.faces);
            }
        }
        Ok(rest)
    }

    /// Makes a chart of a disc at `uv`, unless rounding turns a triangle or lets it lie on itself.
    fn accept(&mut self, disc: &Piece, uv: &[DVec2], stretch: &Stretch) -> Result<(), Failure> {
        let uv = to_single(uv, stretch);
        if disc.triangles.iter().any(|t| signed_area2(&t.map(|v| uv[v as usize])) <= 0.0) {
            return Err(Failure::Turned);
        }
        let exact: Vec<DVec2> = uv.iter().map(|p| DVec2::from_array(p.map(f64::from))).collect();
        if overlaps(disc, &exact) {
            return Err(Failure::Overlap);
        }
        for (&f, t) in disc.faces.iter().zip(&disc.triangles) {
            self.charts.uv[f as usize] = t.map(|v| uv[v as usize]);
            self.charts.chart_of[f as usize] = self.charts.count;
        }
        self.finish(stretch);
        Ok(())
    }

    fn finish(&mut self, stretch: &Stretch) {
        self.report.worst_stretch = self.report.worst_stretch.max(stretch.l2());
        self.stretch.merge(stretch);
        self.charts.count += 1;
        self.charts.mirrored.push(false);
    }

    /// A triangle as it is; without area where rounding would turn it over.
    fn single(&mut self, f: u32) {
        let [a, b, c] = self.surface.triangles[f as usize]
            .map(|v| DVec3::from_array(self.surface.positions[v as usize].map(f64::from)));
        let along = (b - a).normalize_or_zero();
        let x = (c - a).dot(along);
        let y = (c - a - x * along).length();
        let mut uv = [[0.0f32; 2], [(b - a).length() as f32, 0.0], [x as f32, y as f32]];
        if signed_area2(&uv) <= 0.0 {
            uv[2][1] = 0.0;
        }
        let low = uv[2][0].min(0.0);
        uv.iter_mut().for_each(|p| p[0] -= low);
        self.charts.uv[f as usize] = uv;
        self.charts.chart_of[f as usize] = self.charts.count;
        self.report.single += 1;
        let area = 0.5 * (b - a).cross(c - a).length();
        let mut stretch = Stretch::default();
        if area > 0.0 {
            stretch.add(2.0 * area, area, area * area);
        }
        self.finish(&stretch);
    }
}

/// Coordinates from 0 on, with the area of the surface.
fn to_single(uv: &[DVec2], stretch: &Stretch) -> Vec<[f32; 2]> {
    let factor = (stretch.area / stretch.plane).sqrt();
    let low = uv.iter().fold(DVec2::INFINITY, |m, p| m.min(*p));
    uv.iter().map(|p| ((*p - low) * factor).as_vec2().to_array()).collect()
}
