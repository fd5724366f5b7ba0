//! One plot as SVG: lines over the time of the flight, bounds as dashed lines.
//!
//! Colours are fixed numbers that the page's style sheet replaces where the reader prefers a dark page; alone, the
//! picture is readable on white.

use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::RGBColor;
use std::ops::Range;

/// Background.
pub const PAPER: RGBColor = RGBColor(0xff, 0xff, 0xff);
/// Text and axes.
pub const INK: RGBColor = RGBColor(0x24, 0x29, 0x2f);
/// The mesh behind the lines.
pub const MESH: RGBColor = RGBColor(0xe4, 0xe8, 0xec);
/// Bounds.
pub const BOUND: RGBColor = RGBColor(0xc6, 0x28, 0x28);
/// Lines of this run.
pub const LINES: [RGBColor; 3] = [RGBColor(0x1f, 0x6f, 0xb5), RGBColor(0xd9, 0x7a, 0x06), RGBColor(0x2e, 0x8b, 0x57)];
/// Lines of other runs.
pub const OTHERS: [RGBColor; 3] = [RGBColor(0x8e, 0x5b, 0xb0), RGBColor(0x7a, 0x86, 0x90), RGBColor(0xb0, 0x5a, 0x7a)];

/// Size of a plot in its own units; it is shown at any size.
const SIZE: (u32, u32) = (1440, 600);
/// Height of title and legend.
const HEAD: u32 = 96;
/// Room for the labels of the axes.
const LABELS: (u32, u32) = (82, 128);
/// A bound this many times above all values is named, but not drawn.
const FAR: f64 = 4.0;
const FONT: &str = "sans-serif";
const TITLE_SIZE: u32 = 36;
const TEXT_SIZE: u32 = 30;
/// Most places along the time axis; of more frames, the smallest and the largest value of each place are drawn.
const PLACES: usize = 600;

/// A line.
pub struct Line {
    /// What it shows.
    pub label: String,
    /// Its colour.
    pub color: RGBColor,
    /// Seconds and values.
    pub points: Vec<(f64, f64)>,
}

/// A plot.
pub struct Plot {
    /// Heading.
    pub title: &'static str,
    /// Unit of the values; empty for counts.
    pub unit: &'static str,
    /// Steps of the value axis are factors.
    pub log: bool,
    /// The lines; later ones lie on top, and come first in the legend.
    pub lines: Vec<Line>,
    /// Bounds: label and value.
    pub bounds: Vec<(String, f64)>,
    /// Values above this one are cut off, where the plot would be useless else.
    pub clip: Option<f64>,
}

type Fallible<T> = Result<T, DrawingAreaErrorKind<std::io::Error>>;

impl Plot {
    /// The picture. Fails only if the plotting library does.
    pub fn svg(&self) -> anyhow::Result<String> {
        let mut text = String::new();
        self.draw(SVGBackend::with_string(&mut text, SIZE)).map_err(|e| anyhow::anyhow!("{}: {e}", self.title))?;
        Ok(text)
    }

    fn draw(&self, backend: SVGBackend) -> Fallible<()> {
        let root = backend.into_drawing_area();
        root.fill(&PAPER)?;
        let (head, body) = root.split_vertically(HEAD);
        self.head(&head)?;
        let (times, values) = self.ranges();
        match self.log {
            true => self.body(&body, times, values.clone(), values.log_scale())?,
            false => self.body(&body, times, values.clone(), values)?,
        }
        root.present()
    }

    /// Title, and a legend from the left.
    fn head<B: DrawingBackend>(
        &self,
        head: &DrawingArea<B, plotters::coord::Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let cut_off = self.clip.map_or(String::new(), |clip| {
            format!(", cut off at {} (the start reaches {})", tick(clip), tick(self.peak()))
        });
        let unit = if self.unit.is_empty() { String::new() } else { format!(" [{}]", self.unit) };
        let title_text = format!("{}{unit}{cut_off}", self.title);
        let title = TextStyle::from((FONT, TITLE_SIZE, FontStyle::Bold)).color(&INK);
        head.draw(&Text::new(title_text, (24, 8), title))?;
        let style = TextStyle::from((FONT, TEXT_SIZE)).color(&INK);
        let lines = self.lines.iter().rev().map(|l| (l.label.clone(), l.color, false));
        let bounds = self.bounds.iter().map(|(label, value)| {
            let far = if self.shows(*value) { "" } else { " (far above)" };
            (format!("{label}: {}{far}", tick(*value)), BOUND, true)
        });
        let mut x = 24;
        for (label, color, dashed) in lines.chain(bounds) {
            let mark = vec![(x, 72), (x + 44, 72)];
            match dashed {
                true => head.draw(&plotters::element::DashedPathElement::new(mark, 10, 7, color.stroke_width(4)))?,
                false => head.draw(&PathElement::new(mark, color.stroke_width(6)))?,
            }
            let width = label.chars().count() as i32 * 14;
            head.draw(&Text::new(label, (x + 54, 58), style.clone()))?;
            x += 54 + width + 34;
        }
        Ok(())
    }

    /// Highest value of the lines.
    fn peak(&self) -> f64 {
        self.lines.iter().flat_map(|l| &l.points).map(|p| p.1).fold(0.0, f64::max)
    }

    /// True for a bound that leaves the lines room enough.
    fn shows(&self, bound: f64) -> bool {
        bound <= FAR * self.peak()
    }

    /// What the axes show.
    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let points = || self.lines.iter().flat_map(|l| &l.points);
        let first = points().map(|p| p.0).fold(f64::INFINITY, f64::min);
        let last = points().map(|p| p.0).fold(f64::NEG_INFINITY, f64::max);
        let times = if first < last { first..last } else { 0.0..1.0 };
        let values = points().map(|p| p.1).chain(self.bounds.iter().map(|b| b.1).filter(|b| self.shows(*b)));
        let most = values.clone().fold(0.0, f64::max);
        let most = self.clip.map_or(most, |clip| most.min(clip));
        if !self.log {
            return (times, 0.0..if most > 0.0 { most * 1.06 } else { 1.0 });
        }
        let least = values.filter(|v| *v > 0.0).fold(f64::INFINITY, f64::min);
        let least = if least < most { least } else { most.max(1e-3) * 0.5 };
        (times, least * 0.8..most.max(least) * 1.25)
    }

    fn body<B: DrawingBackend, Y>(
        &self,
        body: &DrawingArea<B, plotters::coord::Shift>,
        times: Range<f64>,
        values: Range<f64>,
        axis: Y,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>>
    where
        Y: AsRangedCoord<Value = f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(body)
            .margin_right(36)
            .margin_top(8)
            .margin_bottom(8)
            .x_label_area_size(LABELS.0)
            .y_label_area_size(LABELS.1)
            .build_cartesian_2d(times.clone(), axis)?;
        let text = TextStyle::from((FONT, TEXT_SIZE)).color(&INK);
        chart
            .configure_mesh()
            .disable_x_mesh()
            .axis_style(INK.stroke_width(2))
            .bold_line_style(MESH.stroke_width(2))
            .light_line_style(TRANSPARENT)
            .x_desc("time of the flight [s]")
            .axis_desc_style(text.clone())
            .label_style(text)
            .x_labels(12)
            .y_labels(6)
            .x_label_formatter(&|t| tick(*t))
            .y_label_formatter(&|v| tick(*v))
            .draw()?;
        for line in &self.lines {
            let inside = |&(t, v): &(f64, f64)| (t, v.clamp(values.start, values.end));
            let points = thinned(&line.points).iter().map(inside).collect::<Vec<_>>();
            chart.draw_series(LineSeries::new(points, line.color.stroke_width(3)))?;
        }
        for (_, value) in self.bounds.iter().filter(|b| self.shows(b.1)) {
            let ends = [(times.start, *value), (times.end, *value)];
            chart.draw_series(DashedLineSeries::new(ends, 16, 10, BOUND.stroke_width(3)))?;
        }
        Ok(())
    }
}

/// At most two points per place along the axis, so that no peak is lost: the smallest and the largest value of each.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= 2 * PLACES {
        return points.to_vec();
    }
    let extremes = |part: &[(f64, f64)]| {
        let by = |i: &usize, k: &usize| part[*i].1.total_cmp(&part[*k].1).then(i.cmp(k));
        let low = (0..part.len()).min_by(by).expect("a part has a point");
        let high = (0..part.len()).max_by(by).expect("a part has a point");
        [part[low.min(high)], part[low.max(high)]]
    };
    points.chunks(points.len().div_ceil(PLACES)).flat_map(extremes).collect()
}

/// A number as axes show it: `1.5M`, `20k`, `0.25`.
pub fn tick(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        v if v >= 1e9 => (value / 1e9, "G"),
        v if v >= 1e6 => (value / 1e6, "M"),
        v if v >= 1e4 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let text = match scaled.abs() {
        v if v >= 100.0 => format!("{scaled:.0}"),
        v if v >= 10.0 => format!("{scaled:.1}"),
        _ => format!("{scaled:.2}"),
    };
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 0.25, 1.0, 9.99, 60.04, 1234.0, 20_000.0, 1_500_000.0, 2e9].map(tick);
        assert_eq!(shown, ["0", "0.25", "1", "9.99", "60", "1234", "20k", "1.5M", "2G"]);
    }

    #[test]
    fn peaks_survive_thinning() {
        let mut points: Vec<(f64, f64)> = (0..50_000).map(|i| (i as f64, 1.0)).collect();
        (points[777].1, points[33_333].1) = (99.0, -5.0);
        let thin = thinned(&points);
        assert!(thin.len() <= 2 * PLACES && thin.contains(&(777.0, 99.0)) && thin.contains(&(33_333.0, -5.0)));
        assert!(thin.windows(2).all(|w| w[0].0 <= w[1].0), "in order of time");
        assert_eq!(thinned(&points[..100]), points[..100]);
    }

    fn plot(log: bool, points: Vec<(f64, f64)>) -> Plot {
        let lines = vec![Line { label: "a < b".into(), color: LINES[0], points }];
        Plot { title: "Test", unit: "px", log, lines, bounds: vec![("bound".into(), 2.0)], clip: None }
    }

    #[test]
    fn a_plot_is_well_formed_and_shows_its_bound() {
        for log in [false, true] {
            let svg = plot(log, vec![(0.0, 1.0), (1.0, 3.0), (2.0, 0.0)]).svg().unwrap();
            let tree = roxmltree::Document::parse(&svg).unwrap();
            let dashes = tree.descendants().filter(|n| n.attribute("stroke") == Some("#C62828")).count();
            assert!(dashes > 10, "{dashes}");
            assert!(svg.contains("a &lt; b") && svg.contains("bound: 2"));
        }
    }

    #[test]
    fn empty_and_flat_plots_are_drawn_too() {
        for points in [vec![], vec![(0.0, 0.0)], vec![(0.0, 0.0), (1.0, 0.0)]] {
            for log in [false, true] {
                let mut plot = plot(log, points.clone());
                plot.bounds.clear();
                assert!(plot.svg().unwrap().ends_with("</svg>\n"));
            }
        }
    }
}
