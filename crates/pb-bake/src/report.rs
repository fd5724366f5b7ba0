//! What the programs say at their end, for people and for machines.

use crate::failure::{Failure, blame_machine};
use crate::progress::StageTime;
use crate::scene::TextureSummary;
use pb_archive::FORMAT_VERSION;
use pb_bake::import::{InputReport, InstanceCounts};
use pb_bake::memory::Usage;
use pb_lod::progressive_buffers::bake::BakeReport;
use pb_lod::progressive_buffers::instances::{InstanceRecord, Instances, ObjectRecord};
use pb_lod::progressive_buffers::layout::{LevelRecord, ModelLevelRecord, ModelRecord};
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
    /// Those of triangles and vertices.
    pub geometry_bytes: u64,
    /// Those of texels.
    pub texture_bytes: u64,
}

/// Bytes that a level adds.
#[derive(Clone, Copy, Debug, Default)]
pub struct LevelBytes {
    geometry: u64,
    textures: u64,
}

impl LevelBytes {
    /// From the sizes of all chunks, in their order.
    pub fn new(chunks: impl Iterator<Item = usize>, level: usize, model: &ModelRecord) -> Self {
        let mut bytes = LevelBytes::default();
        let geometry = (model.clusters * model.levels) as usize;
        for (i, stored) in chunks.enumerate().skip(level).step_by(model.levels as usize) {
            *(if i < geometry { &mut bytes.geometry } else { &mut bytes.textures }) += stored as u64;
        }
        bytes
    }
}

impl LevelSummary {
    /// From a model's record and sums over its clusters.
    pub fn new(level: usize, record: &ModelLevelRecord, acmr: f64, bytes: LevelBytes) -> Self {
        let &ModelLevelRecord { vertices, triangles, max_error, rms_error } = record;
        let LevelBytes { geometry: geometry_bytes, textures: texture_bytes } = bytes;
        let bytes = geometry_bytes + texture_bytes;
        Self { level, vertices, triangles, max_error, rms_error, acmr, bytes, geometry_bytes, texture_bytes }
    }
}

/// The levels as a table with a heading; bytes in two columns where there are textures.
pub fn level_table(levels: &[LevelSummary]) -> String {
    let textured = levels.iter().any(|l| l.texture_bytes > 0);
    let bytes =
        if textured { format!("{:>14} {:>13}", "geometry bytes", "texture bytes") } else { format!("{:>13}", "bytes") };
    let mut text = format!(
        "{:>5} {:>12} {:>12} {:>12} {:>12} {:>6} {bytes}\n",
        "level", "triangles", "vertices", "max error", "rms error", "acmr"
    );
    for l in levels {
        let bytes = match textured {
            true => format!("{:>14} {:>13}", l.geometry_bytes, l.texture_bytes),
            false => format!("{:>13}", l.bytes),
        };
        let _ = writeln!(
            text,
            "{:>5} {:>12} {:>12} {:>12.4e} {:>12.4e} {:>6.3} {bytes}",
            l.level, l.triangles, l.vertices, l.max_error, l.rms_error, l.acmr
        );
    }
    text
}

/// One stage of a bake.
#[derive(Clone, Debug, Serialize)]
struct StageSummary {
    name: &'static str,
    seconds: f64,
    /// Millions of input triangles per second.
    triangle_rate: f64,
    /// Millions of texels per second, for stages of textures: of the images where they are read, else of the tiles.
    texel_rate: Option<f64>,
}

impl StageSummary {
    fn new(stage: &StageTime, triangles: u64) -> Self {
        let &StageTime { name, seconds } = stage;
        Self { name, seconds, triangle_rate: rate(triangles, seconds), texel_rate: None }
    }

    fn text(&self) -> String {
        let texels = self.texel_rate.map(|r| format!(" {r:>9.3} M texels/s")).unwrap_or_default();
        format!("{:>10} {:>8.2} s {:>9.3} M triangles/s{texels}", self.name, self.seconds, self.triangle_rate)
    }
}

/// Millions per second.
fn rate(count: u64, seconds: f64) -> f64 {
    count as f64 / seconds.max(1e-9) / 1e6
}

/// One input in a report.
#[derive(Clone, Debug, Serialize)]
struct InputSummary {
    path: String,
    bytes: u64,
    triangles: usize,
    vertices: usize,
    instances: InstanceCounts,
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
    nonmanifold_edges_split: u64,
    nonmanifold_positions_locked: u64,
    facet_normals_replaced: bool,
    sorted_along_curve: bool,
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
            (self.nonmanifold_edges_split, "positions added in the middle of non-manifold edges"),
            (self.nonmanifold_positions_locked, "non-manifold positions locked"),
        ];
        let flags = [
            (self.facet_normals_replaced, "normals of facets replaced by smooth ones"),
            (self.sorted_along_curve, "sorted along a curve, because neighbours are far apart in the file"),
        ];
        let counted = parts.iter().filter(|p| p.0 > 0).map(|(n, what)| format!("{n} {what}"));
        let parts: Vec<String> = counted.chain(flags.iter().filter(|f| f.0).map(|f| f.1.to_owned())).collect();
        if parts.is_empty() { "none".into() } else { parts.join(", ") }
    }
}

/// Objects that stand in several places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlacedSummary {
    /// Parts that are turned and moved as a whole; what stands once is one of them.
    objects: usize,
    instances: usize,
    /// Triangles of all instances at level 0.
    triangles: u64,
}

impl PlacedSummary {
    /// From the tables of an archive with so many levels; none where there are no objects.
    pub fn new(
        objects: &[ObjectRecord],
        instances: &[InstanceRecord],
        levels: &[LevelRecord],
        level_count: u32,
    ) -> Option<Self> {
        let triangles = |o: &ObjectRecord| {
            let first = (o.first_cluster * level_count) as usize;
            let of = levels[first..].iter().step_by(level_count as usize).take(o.cluster_count as usize);
            of.map(|l| u64::from(l.triangles)).sum()
        };
        let all = Instances { objects, instances };
        (!objects.is_empty()).then(|| Self {
            objects: objects.len(),
            instances: instances.len(),
            triangles: all.placed(triangles),
        })
    }

    /// For people.
    pub fn text(&self) -> String {
        let Self { objects, instances, triangles } = self;
        format!("instances: {instances} of {objects} objects, {triangles} triangles where all stand")
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
    /// Where meshes stand in several places.
    placed: Option<PlacedSummary>,
    levels: Vec<LevelSummary>,
    repairs: Repairs,
    inputs: Vec<InputSummary>,
    textures: Option<TextureSummary>,
    stages: Vec<StageSummary>,
    seconds: f64,
    /// Steps that a bake before had finished, at least in parts.
    resumed: Vec<&'static str>,
    peak_memory_bytes: Option<u64>,
    memory_bound_bytes: Option<u64>,
    /// Most bytes of temporary files that stood in for memory.
    spilled_bytes: u64,
}

impl BakeSummary {
    /// What the bake itself knows.
    pub fn new(output: &Path, bytes: u64, model: &BakedModel, baked: &BakeReport) -> Self {
        let stored = |level: usize| LevelBytes::new(model.chunks.iter().map(|c| c.bytes.len()), level, &model.record);
        let acmr = |level: usize| baked.acmr.get(level).copied().unwrap_or(0.0) as f64;
        let levels = model.model_levels.iter().enumerate();
        Self {
            format_version: FORMAT_VERSION,
            output: output.display().to_string(),
            bytes,
            triangles_in: model.record.triangles_in,
            bytes_per_input_triangle: bytes as f64 / model.record.triangles_in.max(1) as f64,
            clusters: model.record.clusters,
            placed: PlacedSummary::new(&model.objects, &model.instances, &model.levels, model.record.levels),
            levels: levels.map(|(i, record)| LevelSummary::new(i, record, acmr(i), stored(i))).collect(),
            repairs: Repairs { nonmanifold_positions_locked: baked.non_manifold_positions, ..Repairs::default() },
            inputs: Vec::new(),
            textures: None,
            stages: Vec::new(),
            seconds: 0.0,
            resumed: Vec::new(),
            peak_memory_bytes: peak_memory_bytes(),
            memory_bound_bytes: None,
            spilled_bytes: 0,
        }
    }

    /// Adds how long it took, and what was there already from a bake that was cut short.
    pub fn with_stages(mut self, stages: Vec<StageTime>, resumed: &[&'static str]) -> Self {
        self.seconds = stages.iter().map(|s| s.seconds).sum();
        let summary = |stage: &StageTime| StageSummary {
            texel_rate: self.textures.as_ref().and_then(|t| Some(rate(t.texels_of(stage.name)?, stage.seconds))),
            ..StageSummary::new(stage, self.triangles_in)
        };
        self.stages = stages.iter().map(summary).collect();
        self.resumed = resumed.to_vec();
        self
    }

    /// Adds the bound on memory, and what lay beyond it.
    pub fn with_memory(mut self, bound: Option<u64>, usage: Option<Usage>) -> Self {
        self.memory_bound_bytes = bound.filter(|_| usage.is_some());
        self.spilled_bytes = usage.unwrap_or_default().spilled_bytes;
        self
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
            instances: i.instances,
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
            nonmanifold_positions_split: repairs.split.copies,
            nonmanifold_edges_split: repairs.split.middles,
            facet_normals_replaced: repairs.facet_normals_replaced,
            sorted_along_curve: repairs.sorted_along_curve,
            ..self.repairs
        };
        self
    }

    /// For people.
    pub fn text(&self) -> String {
        let mut text = level_table(&self.levels);
        let _ = writeln!(text, "repairs: {}", self.repairs.text());
        if let Some(placed) = &self.placed {
            let apart: u64 = self.inputs.iter().map(|i| i.instances.apart).sum();
            let _ = writeln!(text, "{}, {apart} places written out as geometry", placed.text());
        }
        if let Some(textures) = &self.textures {
            let _ = writeln!(text, "{}", textures.text());
        }
        if !self.resumed.is_empty() {
            let _ = writeln!(text, "resumed: {} were there", self.resumed.join(", "));
        }
        let all = rate(self.triangles_in, self.seconds);
        let _ = writeln!(text, "time: {:.2} s, {all:.3} M triangles/s", self.seconds);
        self.stages.iter().for_each(|s| text += &(s.text() + "\n"));
        if let Some(bytes) = self.peak_memory_bytes {
            let _ = write!(text, "peak memory: {} MiB", bytes >> 20);
            let _ = match self.memory_bound_bytes {
                Some(bound) => {
                    let moved = self.spilled_bytes >> 20;
                    writeln!(text, " of {} MiB; {moved} MiB moved to a temporary file", bound >> 20)
                }
                None => writeln!(text),
            };
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
