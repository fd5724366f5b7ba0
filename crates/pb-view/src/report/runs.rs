//! The JSON file of a report: what was run, on what, its summary, and every column; written, and read again to
//! compare runs.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::path::Path;
use std::time::Duration;

use super::summary::Summary;
use crate::stats::{COLUMNS, Table};

/// Says that a JSON file is a report's.
pub const SCHEMA: &str = "pb-view-report";
/// The version that this program reads and writes; it changes when a field changes its meaning or goes.
pub const VERSION: u64 = 1;
/// Largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// What a run was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// The run's name: that of the report's file.
    pub label: String,
    /// Program and version.
    pub program: String,
    /// The command line, word by word.
    pub command: Vec<String>,
    /// What was flown through.
    pub archive: ArchiveFacts,
    /// What drew it.
    pub adapter: AdapterFacts,
    /// How.
    pub run: RunFacts,
    /// Within what.
    pub bounds: Bounds,
    /// How it began.
    #[serde(default)]
    pub start: StartTimes,
}

/// From the start of the program to its first picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StartTimes {
    /// Finding the graphics adapter and making a device of it.
    pub adapter_ms: f64,
    /// All else until the first picture is there.
    pub first_picture_ms: f64,
}

impl StartTimes {
    /// Of the time until the first picture, and the part of it that the adapter took.
    pub fn new(all: Duration, adapter: Duration) -> Self {
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        Self { adapter_ms: ms(adapter), first_picture_ms: ms(all.saturating_sub(adapter)) }
    }
}

/// An archive.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ArchiveFacts {
    /// File name.
    pub name: String,
    /// File size.
    pub bytes: u64,
    /// Triangles of the input.
    pub triangles_in: u64,
    /// Triangles per level, finest first.
    pub level_triangles: Vec<u64>,
    /// Number of clusters.
    pub clusters: u32,
    /// Number of chunks.
    pub chunks: u32,
    /// True with textures.
    pub textures: bool,
    /// Stored bytes that are read when the archive is opened: the coarsest level.
    pub start_bytes: u64,
    /// All chunks decoded.
    pub decoded_bytes: u64,
}

/// A graphics adapter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AdapterFacts {
    /// As the driver calls it.
    pub name: String,
    /// The driver and its version.
    pub driver: String,
    /// Vulkan, Metal, DirectX 12.
    pub backend: String,
    /// True where the processor draws.
    pub software: bool,
}

/// Pictures and pace.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunFacts {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Samples per pixel.
    pub samples: u32,
    /// Frames of the flight.
    pub frames: u32,
    /// Frames per second of the flypath.
    pub fps: f64,
    /// True when every frame waited for all it wants.
    pub settle: bool,
}

/// Bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// `--vram`.
    pub vram_bytes: u64,
    /// Buffers and textures that were made under it: less where the model is smaller.
    pub vram_planned_bytes: u64,
    /// The textures' part of them.
    pub texture_vram_bytes: u64,
    /// `--ram`.
    pub ram_bytes: u64,
    /// `--max-triangles`.
    pub max_triangles: Option<u64>,
    /// `--target-fps`.
    #[serde(default)]
    pub target_fps: Option<f64>,
}

/// The text of a JSON file.
pub fn to_json(facts: &Facts, summary: &Summary, table: &Table) -> String {
    let decimals = |name: &str| COLUMNS.iter().find(|c| c.name == name).map_or(0, |c| c.decimals());
    let column = |(name, values): &(String, Vec<f64>)| {
        let number = |v: &f64| if decimals(name) == 0 { json!(*v as u64) } else { json!(v) };
        (name.clone(), Value::Array(values.iter().map(number).collect()))
    };
    let columns: Map<String, Value> = table.columns().iter().map(column).collect();
    let mut out = json!({ "schema": SCHEMA, "version": VERSION });
    for part in [json!(facts), json!({ "summary": summary, "columns": columns })] {
        if let (Value::Object(out), Value::Object(part)) = (&mut out, part) {
            out.extend(part);
        }
    }
    out.to_string() + "\n"
}

/// A run that was reported before.
#[derive(Clone, Debug)]
pub struct OtherRun {
    /// What it was.
    pub facts: Facts,
    /// In a few numbers.
    pub summary: Summary,
    /// Frame by frame.
    pub table: Table,
}

#[derive(Deserialize)]
struct File {
    #[serde(flatten)]
    facts: Facts,
    summary: Summary,
    columns: Map<String, Value>,
}

impl OtherRun {
    /// Reads a report's JSON file.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display();
        let bytes = std::fs::metadata(path).with_context(|| format!("{name}: cannot read the run to compare with"))?;
        if bytes.len() > MAX_FILE_BYTES {
            bail!("{name}: {} bytes are more than a report has; at most {MAX_FILE_BYTES} are read", bytes.len());
        }
        let text = std::fs::read_to_string(path).with_context(|| format!("{name}: cannot read the run"))?;
        Self::parse(&text)
            .with_context(|| format!("{name}: no run that can be compared with; name the JSON file of a --report"))
    }

    fn parse(text: &str) -> Result<Self> {
        let value: Value = serde_json::from_str(text)?;
        if value["schema"] != SCHEMA {
            bail!("it does not say \"schema\": \"{SCHEMA}\"");
        }
        if value["version"] != VERSION {
            bail!("it has version {}, and this program reads version {VERSION}; fly again", value["version"]);
        }
        let File { facts, summary, columns } = serde_json::from_value(value)?;
        let columns: Vec<(String, Vec<f64>)> =
            columns.into_iter().map(|(name, v)| Ok((name, serde_json::from_value(v)?))).collect::<Result<_>>()?;
        let table = Table::from_columns(columns).context("its columns are not of one length")?;
        Ok(Self { facts, summary, table })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::Line;

    fn text() -> String {
        let mut table = Table::new();
        table.add(&Line { frame_ms: 12.3456, cut: true, ..Line::default() });
        let facts = Facts { label: "a".into(), ..Facts::default() };
        let bounds = Bounds { vram_bytes: 1, ram_bytes: 1, ..Bounds::default() };
        to_json(&facts, &Summary::new(&table, &bounds), &table)
    }

    #[test]
    fn a_run_is_read_as_it_was_written() {
        let run = OtherRun::parse(&text()).unwrap();
        assert_eq!((run.facts.label.as_str(), run.table.column("frame_ms")), ("a", &[12.346][..]));
        assert_eq!((run.summary.frames, run.summary.cuts.len()), (1, 1));
    }

    #[test]
    fn what_is_no_run_is_refused_with_a_reason() {
        for (text, reason) in [
            ("[1]".to_owned(), "schema"),
            (text().replace("\"version\":1", "\"version\":9"), "version 9"),
            (text().replace("\"cut\":[1]", "\"cut\":[1,0]"), "one length"),
            (text().replace("\"cut\":[1]", "\"cut\":[\"x\"]"), "invalid type"),
        ] {
            let error = format!("{:#}", OtherRun::parse(&text).expect_err(reason));
            assert!(error.contains(reason), "{error}");
        }
    }
}
