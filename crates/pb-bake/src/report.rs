//! What the programs say at their end, for people and for machines.

use crate::failure::{Failure, blame_machine};
use crate::progress::StageTime;
use crate::scene::TextureSummary;
use pb_archive::FORMAT_VERSION;
use pb_bake::import::InputReport;
use pb_lod::progressive_buffers::bake::BakeReport;
use pb_lod::progressive_buffers::layout::ModelLevelRecord;
use pb_lod::progressive_buffers::write::BakedModel;
use pb_mesh::repair::RepairReport;
use serde::Serialize;
use std::fmt::Write as _;
use std::io::{ErrorKind, Write};
use std::path::Path;

/// One level in a report.
#[derive(Clone, Debug, Serialize)]
pub struct LevelSummary {
    /// 0 is the finest.
    pub level: usize,
    /// Distinct positions of the whole model.
    pub vertices: u64,
    /// Triangles of the whole model.
    pub triangles: u64,
    /// Bound of the distance to the input surface, input units.
    pub max_error: f64,
    /// Root mean square distance to the input surface, input units.
    pub rms_error: f64,
    /// Average cache misses per triangle.
    pub acmr: f64,
    /// Bytes in the archive that this level adds.
    pub bytes: u64,
}

impl LevelSummary {
    /// From a model's record and sums over its clusters.
    pub fn new(level: usize, record: &ModelLevelRecord, acmr: f64, bytes: u64) -> Self {
        let &ModelLevelRecord { vertices, triangles, max_error, rms_error } = record;
        Self { level, vertices, triangles, max_error, rms_error, acmr, bytes }
    }
}

/// The levels as a table with a heading.
pub fn level_table(levels: &[LevelSummary]) -> String {
    let mut text = format!(
        "{:>5} {:>12} {:>12} {:>12} {:>12} {:>6} {:>13}\n",
        "level", "triangles", "vertices", "max error", "rms error", "acmr", "bytes"
    );
    for l in levels {
        let _ = writeln!(
            text,
            "{:>5} {:>12} {:>12} {:>12.4e} {:>12.4e} {:>6.3} {:>13}",
            l.level, l.triangles, l.vertices, l.max_error, l.rms_error, l.acmr, l.bytes
        );
    }
    text
}

/// One input in a report.
#[derive(Clone, Debug, Serialize)]
struct InputSummary {
    path: String,
    bytes: u64,
    triangles: usize,
    vertices: usize,
    warnings: Vec<String>,
}

/// What was found and done to the input before the bake.
#[derive(Clone, Debug, Default, Serialize)]
struct Repairs {
    polygons_triangulated: u64,
    positions_welded: u64,
    unreferenced_dropped: u64,
    degenerate_removed: u64,
    duplicates_removed: u64,
    zero_area_kept: u64,
    normals_made: u64,
    normals_repaired: u64,
    uvs_repaired: u64,
    boundary_edges: u64,
    nonmanifold_edges: u64,
    nonmanifold_vertices: u64,
    nonmanifold_positions_split: u64,
    nonmanifold_positions_locked: u64,
}

impl Repairs {
    /// Those that happened, in words.
    fn text(&self) -> String {
        let parts = [
            (self.polygons_triangulated, "polygons triangulated"),
            (self.positions_welded, "positions welded"),
            (self.unreferenced_dropped, "unreferenced vertices dropped"),
            (self.degenerate_removed, "degenerate triangles removed"),
            (self.duplicates_removed, "duplicate triangles removed"),
            (self.zero_area_kept, "triangles without area kept"),
            (self.normals_made, "normals made"),
            (self.normals_repaired, "normals repaired"),
            (self.uvs_repaired, "texture coordinates repaired"),
            (self.boundary_edges, "open edges"),
            (self.nonmanifold_edges, "non-manifold edges"),
            (self.nonmanifold_vertices, "non-manifold vertices"),
            (self.nonmanifold_positions_split, "positions added to split non-manifold places"),
            (self.nonmanifold_positions_locked, "non-manifold positions locked"),
        ];
        let parts: Vec<String> = parts.iter().filter(|p| p.0 > 0).map(|(n, what)| format!("{n} {what}")).collect();
        if parts.is_empty() { "none".into() } else { parts.join(", ") }
    }
}

/// The end of a bake.
#[derive(Clone, Debug, Serialize)]
pub struct BakeSummary {
    format_version: u32,
    output: String,
    bytes: u64,
    triangles_in: u64,
    bytes_per_input_triangle: f64,
    clusters: u32,
    levels: Vec<LevelSummary>,
    repairs: Repairs,
    inputs: Vec<InputSummary>,
    textures: Option<TextureSummary>,
    stages: Vec<StageTime>,
    seconds: f64,
    peak_memory_bytes: Option<u64>,
}

impl BakeSummary {
    /// What the bake itself knows.
    pub fn new(output: &Path, bytes: u64, model: &BakedModel, baked: &BakeReport, stages: Vec<StageTime>) -> Self {
        let count = model.record.levels as usize;
        let stored = |level: usize| model.chunks.iter().skip(level).step_by(count).map(|c| c.bytes.len() as u64).sum();
        let acmr = |level: usize| baked.acmr.get(level).copied().unwrap_or(0.0) as f64;
        let levels = model.model_levels.iter().enumerate();
        Self {
            format_version: FORMAT_VERSION,
            output: output.display().to_string(),
            bytes,
            triangles_in: model.record.triangles_in,
            bytes_per_input_triangle: bytes as f64 / model.record.triangles_in.max(1) as f64,
            clusters: model.record.clusters,
            levels: levels.map(|(i, record)| LevelSummary::new(i, record, acmr(i), stored(i))).collect(),
            repairs: Repairs { nonmanifold_positions_locked: baked.non_manifold_positions, ..Repairs::default() },
            inputs: Vec::new(),
            textures: None,
            seconds: stages.iter().map(|s| s.seconds).sum(),
            stages,
            peak_memory_bytes: peak_memory_bytes(),
        }
    }

    /// Adds what came before the bake.
    pub fn with_input(
        mut self,
        inputs: &[InputReport],
        repairs: &RepairReport,
        textures: Option<TextureSummary>,
    ) -> Self {
        let input = |i: &InputReport| InputSummary {
            path: i.path.display().to_string(),
            bytes: i.bytes,
            triangles: i.triangles,
            vertices: i.vertices,
            warnings: i.warnings.clone(),
        };
        self.inputs = inputs.iter().map(input).collect();
        self.textures = textures;
        self.repairs = Repairs {
            polygons_triangulated: repairs.polygons_triangulated,
            positions_welded: repairs.positions_welded,
            unreferenced_dropped: repairs.unreferenced_dropped,
            degenerate_removed: repairs.degenerate_removed,
            duplicates_removed: repairs.duplicates_removed,
            zero_area_kept: repairs.zero_area_kept,
            normals_made: repairs.normals_made,
            normals_repaired: repairs.normals_repaired,
            uvs_repaired: repairs.uvs_repaired,
            boundary_edges: repairs.topology.boundary_edges,
            nonmanifold_edges: repairs.topology.nonmanifold_edges,
            nonmanifold_vertices: repairs.topology.nonmanifold_vertices,
            nonmanifold_positions_split: repairs.positions_split,
            ..self.repairs
        };
        self
    }

    /// For people.
    pub fn text(&self) -> String {
        let mut text = level_table(&self.levels);
        let stages: Vec<String> = self.stages.iter().map(|s| format!("{} {:.2} s", s.name, s.seconds)).collect();
        let rate = self.triangles_in as f64 / self.seconds.max(1e-9) / 1e6;
        let _ = writeln!(text, "repairs: {}", self.repairs.text());
        if let Some(textures) = &self.textures {
            let _ = writeln!(text, "{}", textures.text());
        }
        let _ = writeln!(text, "time: {:.2} s ({rate:.2} M triangles/s): {}", self.seconds, stages.join(", "));
        if let Some(bytes) = self.peak_memory_bytes {
            let _ = writeln!(text, "peak memory: {} MiB", bytes >> 20);
        }
        let _ = writeln!(
            text,
            "{}: {} triangles in {} clusters, {} bytes, {:.2} bytes per input triangle",
            self.output, self.triangles_in, self.clusters, self.bytes, self.bytes_per_input_triangle
        );
        text
    }
}

/// The most memory that this process ever held, where the system tells.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().trim_end_matches("kB").trim().parse().ok().map(|kib: u64| kib * 1024)
}

/// One JSON object on standard output.
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(blame_machine)?;
    print_text(&(text + "\n"))
}

/// Text on standard output. A reader that has seen enough is no failure.
pub fn print_text(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(blame_machine(format!("standard output: {e}"))),
        _ => Ok(()),
    }
}
