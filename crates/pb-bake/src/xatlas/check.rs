//! Charts from outside are checked like a file, before anything relies on them.

use super::overlap::overlaps;
use super::wire::{Charts, doubled_area};
use thiserror::Error;

/// How far the area of a chart may be from that of its surface, as a factor.
const MAX_GROWTH: f64 = 4.0;
/// How long a chart may be, in sums of its triangles' longest edges.
const MAX_LENGTH: f64 = 4.0;
/// Charts whose surface is smaller than this share of the square of their edges need not keep its area: slivers.
const SLIVER: f64 = 1e-6;

/// What is wrong with charts.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AnswerFault {
    /// Not one entry per triangle.
    #[error("there are charts for {found} triangles of {triangles}")]
    Counts {
        /// Entries.
        found: usize,
        /// Triangles of the cluster.
        triangles: usize,
    },
    /// A triangle is in a chart beyond the last.
    #[error("triangle {triangle} is in chart {chart} of {count}")]
    NoSuchChart {
        /// The triangle.
        triangle: usize,
        /// Its chart.
        chart: u32,
        /// Number of charts.
        count: u32,
    },
    /// A chart has no triangle.
    #[error("chart {0} is empty")]
    Empty(u32),
    /// A coordinate is infinite or no number.
    #[error("a corner of triangle {0} is no number")]
    NotFinite(usize),
    /// A triangle is clockwise.
    #[error("triangle {0} is turned over")]
    Flipped(usize),
    /// A vertex has two places in one chart.
    #[error("chart {chart} is torn at triangle {triangle}")]
    Torn {
        /// The chart.
        chart: u32,
        /// A triangle at the tear.
        triangle: usize,
    },
    /// A chart lies over itself.
    #[error("chart {chart} lies over itself at the triangles {first} and {second}")]
    Overlap {
        /// The chart.
        chart: u32,
        /// One of the triangles.
        first: u32,
        /// The other.
        second: u32,
    },
    /// A chart is not as large as what it stands for.
    #[error("chart {chart} has {flat} units of area for {surface} of surface, and is {length} long")]
    Size {
        /// The chart.
        chart: u32,
        /// Its area.
        flat: f64,
        /// The area of its triangles in space.
        surface: f64,
        /// Its longer side.
        length: f64,
    },
}

/// Checks charts of a mesh whose indices are good: every triangle in one chart, no chart empty; numbers that are
/// numbers; counter-clockwise (zero area is allowed); one place per vertex and chart; sizes within a factor of the
/// surface's; no two triangles of a chart over each other.
pub fn check(positions: &[[f32; 3]], triangles: &[[u32; 3]], charts: &Charts) -> Result<(), AnswerFault> {
    let found = charts.chart_of.len().min(charts.uv.len());
    if found != triangles.len() || charts.chart_of.len() != charts.uv.len() {
        return Err(AnswerFault::Counts { found, triangles: triangles.len() });
    }
    for (triangle, (&chart, uv)) in charts.chart_of.iter().zip(&charts.uv).enumerate() {
        if chart >= charts.count {
            return Err(AnswerFault::NoSuchChart { triangle, chart, count: charts.count });
        }
        if !uv.iter().flatten().all(|x| x.is_finite()) {
            return Err(AnswerFault::NotFinite(triangle));
        }
        if doubled_area(uv) < 0.0 {
            return Err(AnswerFault::Flipped(triangle));
        }
    }
    if charts.count as usize > triangles.len() {
        return Err(AnswerFault::Empty(charts.count - 1));
    }
    let mut by_chart: Vec<u32> = (0..triangles.len() as u32).collect();
    by_chart.sort_by_key(|t| charts.chart_of[*t as usize]);
    let mut places = vec![(u32::MAX, [0.0; 2]); positions.len()];
    let mut expected = 0;
    for members in by_chart.chunk_by(|a, b| charts.chart_of[*a as usize] == charts.chart_of[*b as usize]) {
        let chart = charts.chart_of[members[0] as usize];
        if chart != expected {
            return Err(AnswerFault::Empty(expected));
        }
        expected += 1;
        check_continuity(triangles, charts, members, &mut places)?;
        check_size(positions, triangles, charts, members)?;
        let flat: Vec<_> = members.iter().map(|t| charts.uv[*t as usize]).collect();
        if let Some(&(first, second)) = overlaps(&flat).first() {
            return Err(AnswerFault::Overlap { chart, first: members[first], second: members[second] });
        }
    }
    if expected == charts.count { Ok(()) } else { Err(AnswerFault::Empty(expected)) }
}

/// `places` holds, for each vertex, the chart that saw it last and where.
fn check_continuity(
    triangles: &[[u32; 3]],
    charts: &Charts,
    members: &[u32],
    places: &mut [(u32, [f32; 2])],
) -> Result<(), AnswerFault> {
    for triangle in members.iter().map(|t| *t as usize) {
        let chart = charts.chart_of[triangle];
        for (vertex, place) in triangles[triangle].iter().zip(charts.uv[triangle]) {
            let seen = &mut places[*vertex as usize];
            if seen.0 == chart && seen.1 != place {
                return Err(AnswerFault::Torn { chart, triangle });
            }
            *seen = (chart, place);
        }
    }
    Ok(())
}

fn check_size(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    charts: &Charts,
    members: &[u32],
) -> Result<(), AnswerFault> {
    let (mut flat, mut surface, mut edges) = (0.0, 0.0, 0.0);
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for triangle in members.iter().map(|t| *t as usize) {
        let [a, b, c] = triangles[triangle].map(|i| glam::Vec3::from(positions[i as usize]).as_dvec3());
        let uv = &charts.uv[triangle];
        flat += doubled_area(uv) / 2.0;
        surface += (b - a).cross(c - a).length() / 2.0;
        edges += (b - a).length().max((c - a).length()).max((c - b).length());
        for place in uv {
            low = std::array::from_fn(|k| low[k].min(place[k].into()));
            high = std::array::from_fn(|k| high[k].max(place[k].into()));
        }
    }
    let length = (high[0] - low[0]).max(high[1] - low[1]);
    let alike = flat <= surface * MAX_GROWTH && surface <= flat * MAX_GROWTH;
    let sliver = surface <= SLIVER * edges * edges && flat <= SLIVER * edges * edges * MAX_GROWTH;
    if (alike || sliver) && length <= MAX_LENGTH * edges {
        return Ok(());
    }
    Err(AnswerFault::Size { chart: charts.chart_of[members[0] as usize], flat, surface, length })
}
