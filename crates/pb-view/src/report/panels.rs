//! Which plots a report has: figure 6 of the paper (speed, faces, draw calls, memory by tier, detail), figure 8
//! (missing chunks), and what explains them.

use super::page::Content;
use super::summary::{after_start, cpu_ms};
use super::svg::{LINES, Line, OTHERS, Plot};
use crate::stats::Table;

/// A plot with the name that the page and scripts find it by.
pub struct Panel {
    /// Name in the page: letters and dashes.
    pub id: &'static str,
    /// What it shows.
    pub plot: Plot,
}

/// A way from a table to values, one per frame.
type Values = fn(&Table) -> Vec<f64>;

const MIB: f64 = 1024.0 * 1024.0;
/// A spike at the start may be this many times higher than all after it before it is cut off.
const START_SPIKE: f64 = 3.0;

/// What fits a legend of the names of other runs.
const MOST_LETTERS: usize = 16;

/// Title, unit (none for counts), and lines of a plot.
struct Design {
    id: &'static str,
    title: &'static str,
    unit: &'static str,
    /// The first one is drawn of other runs too.
    lines: &'static [(&'static str, Values)],
    /// Drawn with factors as steps; cut off where the start is far above the rest.
    shape: Shape,
}

#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Plain,
    Log,
    ClipStart,
}

const FRAME_TIME: Design = Design {
    id: "frame-time",
    title: "Frame time",
    unit: "ms",
    lines: &[("whole frame", |t| t.column("frame_ms").to_vec()), ("selection, cache, commands", cpu_ms)],
    shape: Shape::ClipStart,
};
const DETAIL_ERROR: Design = Design {
    id: "detail",
    title: "Projected error",
    unit: "pixels",
    lines: &[
        ("allowed (tau)", |t| t.column("allowed_error_px").to_vec()),
        ("largest shown", |t| t.column("error_px").to_vec()),
    ],
    shape: Shape::Log,
};
const DETAIL_BAND: Design = Design {
    id: "detail",
    title: "Band size k",
    unit: "input units",
    lines: &[("k", |t| t.column("band_k").to_vec())],
    shape: Shape::Plain,
};

const DESIGNS: [Design; 10] = [
    Design {
        id: "fps",
        title: "Frames per second",
        unit: "1/s",
        lines: &[("1 / frame time", |t| t.column("frame_ms").iter().map(|ms| 1e3 / ms.max(1e-3)).collect())],
        shape: Shape::Plain,
    },
    Design {
        id: "triangles",
        title: "Triangles drawn",
        unit: "",
        lines: &[("triangles", |t| t.column("triangles").to_vec())],
        shape: Shape::Plain,
    },
    Design {
        id: "draws",
        title: "Draws",
        unit: "",
        lines: &[
            ("clusters and coarse ranges", |t| t.column("draws").to_vec()),
            ("coarse ranges", |t| t.column("coarse_draws").to_vec()),
        ],
        shape: Shape::Plain,
    },
    Design {
        id: "vram",
        title: "Video memory in use",
        unit: "MiB",
        lines: &[("all", |t| mib(t.column("vram_bytes"))), ("textures", |t| mib(t.column("texture_vram_bytes")))],
        shape: Shape::Plain,
    },
    Design {
        id: "ram",
        title: "Decoded chunks in memory",
        unit: "MiB",
        lines: &[("all", |t| mib(t.column("ram_bytes")))],
        shape: Shape::Plain,
    },
    Design {
        id: "missing",
        title: "Chunks wanted but missing",
        unit: "",
        lines: &[
            ("all", |t| t.column("missing_chunks").to_vec()),
            ("textures", |t| t.column("missing_textures").to_vec()),
        ],
        shape: Shape::ClipStart,
    },
    Design {
        id: "bytes",
        title: "Bytes so far",
        unit: "MiB",
        lines: &[
            ("read from disk", |t| summed(t.column("disk_bytes"))),
            ("of them needed", |t| summed(t.column("needed_bytes"))),
            ("uploaded (decoded)", |t| summed(t.column("upload_bytes"))),
        ],
        shape: Shape::Plain,
    },
    Design {
        id: "loads",
        title: "Loads in flight",
        unit: "",
        lines: &[("loads", |t| t.column("loads_in_flight").to_vec())],
        shape: Shape::Plain,
    },
    Design {
        id: "processor",
        title: "Time on the processor",
        unit: "ms",
        lines: &[
            ("selection, cache", |t| t.column("select_ms").to_vec()),
            ("carrying out, uploads", |t| t.column("carry_out_ms").to_vec()),
            ("draw commands", |t| t.column("draw_ms").to_vec()),
        ],
        shape: Shape::ClipStart,
    },
    Design {
        id: "process",
        title: "Memory of the process",
        unit: "MiB",
        lines: &[
            ("resident", |t| mib(t.column("rss_bytes"))),
            ("without mapped files", |t| mib(t.column("rss_private_bytes"))),
        ],
        shape: Shape::Plain,
    },
];

fn mib(bytes: &[f64]) -> Vec<f64> {
    bytes.iter().map(|b| b / MIB).collect()
}

fn summed(bytes: &[f64]) -> Vec<f64> {
    let sums = bytes.iter().scan(0.0, |sum, b| {
        *sum += b / MIB;
        Some(*sum)
    });
    sums.collect()
}

/// All plots, in the order of the page.
pub fn panels(content: &Content) -> Vec<Panel> {
    let bands = content.table.column("band_k").iter().any(|k| *k > 0.0);
    let detail = if bands { &DETAIL_BAND } else { &DETAIL_ERROR };
    let (before, after) = DESIGNS.split_at(5);
    let designs = [&FRAME_TIME].into_iter().chain(before).chain([detail]).chain(after);
    designs.map(|design| Panel { id: design.id, plot: plot(design, content) }).collect()
}

fn plot(design: &Design, content: &Content) -> Plot {
    let mut lines = Vec::new();
    for (other, &color) in content.others.iter().zip(&OTHERS) {
        let (_, values) = design.lines[0];
        let label = other.facts.label.chars().take(MOST_LETTERS).collect();
        lines.push(Line { label, color, points: points(&other.table, values) });
    }
    // The first line is the one to see, so it is drawn last.
    for (&(label, values), &color) in design.lines.iter().zip(&LINES).rev() {
        lines.push(Line { label: label.to_owned(), color, points: points(content.table, values) });
    }
    Plot {
        title: design.title,
        unit: design.unit,
        log: design.shape == Shape::Log,
        lines,
        bounds: bounds(design.id, content),
        clip: (design.shape == Shape::ClipStart).then(|| clip(design, content)).flatten(),
    }
}

fn points(table: &Table, values: Values) -> Vec<(f64, f64)> {
    let t = table.column("t_secs");
    let start = t.first().copied().unwrap_or(0.0);
    t.iter().map(|t| t - start).zip(values(table)).collect()
}

/// The dashed lines of a plot.
fn bounds(id: &str, content: &Content) -> Vec<(String, f64)> {
    let bounds = &content.facts.bounds;
    match id {
        "vram" => vec![("bound".to_owned(), bounds.vram_bytes as f64 / MIB)],
        "ram" => vec![("bound".to_owned(), bounds.ram_bytes as f64 / MIB)],
        "frame-time" => bounds.target_fps.map(|fps| ("bound".to_owned(), 1e3 / fps)).into_iter().collect(),
        "fps" => bounds.target_fps.map(|fps| ("bound".to_owned(), fps)).into_iter().collect(),
        "triangles" => bounds.max_triangles.map(|n| ("bound".to_owned(), n as f64)).into_iter().collect(),
        _ => Vec::new(),
    }
}

/// Where to cut off, if the first second stands far above all that follows.
fn clip(design: &Design, content: &Content) -> Option<f64> {
    let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let (mut whole, mut rest) = (0.0, 0.0);
    let tables = content.others.iter().map(|o| &o.table).chain([content.table]);
    for table in tables {
        for (_, values) in design.lines {
            let values = values(table);
            whole = f64::max(whole, most(&values));
            rest = f64::max(rest, most(&values[after_start(table).min(values.len())..]));
        }
    }
    (rest > 0.0 && whole > START_SPIKE * rest).then_some(START_SPIKE * rest)
}
