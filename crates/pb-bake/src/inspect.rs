//! `inspect`, `verify` and `export`: the commands that read an archive.

mod streams;
mod textures;

use crate::cli::{ExportArgs, InspectArgs, VerifyArgs};
use crate::failure::{Failure, blame_input, blame_machine};
use crate::report::{LevelBytes, LevelSummary, PlacedSummary, level_table, print_json, print_text};
use pb_bake::export::{ExportCounts, ExportError, write_level};
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::verify::{self, MAX_BREACHES};
use serde::Serialize;
use std::fmt::Write as _;
use streams::StreamTable;
use textures::TextureInspection;

/// What `inspect --json` prints.
#[derive(Serialize)]
struct Inspection {
    format_version: u32,
    scheme: String,
    triangles_in: u64,
    bytes: u64,
    bytes_per_input_triangle: f64,
    clusters: u32,
    /// None in models whose parts all stand once.
    placed: Option<PlacedSummary>,
    levels: Vec<LevelSummary>,
    /// Bytes of all chunks when decoded: what drawing everything at full detail needs.
    decoded_bytes: u64,
    colors: bool,
    /// None in models without.
    textures: Option<TextureInspection>,
    /// Smallest and largest coordinates, input units.
    bounds_min: [f64; 3],
    bounds_max: [f64; 3],
    /// Grid step, input units.
    quantum: f64,
    /// Cluster sizes at level 0, in triangles.
    cluster_triangles_min: u32,
    cluster_triangles_max: u32,
    neighbours_max: u32,
    /// None unless asked for.
    streams: Option<StreamTable>,
}

/// Shows what the tables say. Chunks are read only for the table of streams; see `verify`.
pub fn inspect(args: &InspectArgs) -> Result<(), Failure> {
    let model = Model::open(&args.archive).map_err(blame_input)?;
    let streams = args.streams.then(|| StreamTable::new(&model)).transpose()?;
    let inspection = Inspection { streams, ..look(&model) };
    if args.json { print_json(&inspection) } else { print_text(&text(&inspection)) }
}

fn look(model: &Model) -> Inspection {
    let record = model.record();
    let levels = model.levels() as usize;
    let chunks = model.archive().chunks();
    let finest = || model.level_records().iter().step_by(levels).map(|l| l.triangles);
    let bytes = model.archive().file_bytes();
    let [low, high] = model.world_bounds();
    Inspection {
        format_version: model.archive().header().version,
        scheme: model.archive().header().scheme.escape_ascii().to_string(),
        triangles_in: record.triangles_in,
        bytes,
        bytes_per_input_triangle: bytes as f64 / record.triangles_in.max(1) as f64,
        clusters: record.clusters,
        placed: placed(model),
        levels: (0..levels).map(|level| look_at_level(model, level)).collect(),
        decoded_bytes: chunks.iter().map(|c| c.decoded_bytes as u64).sum(),
        colors: model.has_colors(),
        textures: TextureInspection::new(model),
        bounds_min: low.to_array(),
        bounds_max: high.to_array(),
        quantum: record.quantum,
        cluster_triangles_min: finest().min().unwrap_or(0),
        cluster_triangles_max: finest().max().unwrap_or(0),
        neighbours_max: model.clusters().iter().map(|c| c.neighbours_count).max().unwrap_or(0),
        streams: None,
    }
}

fn placed(model: &Model) -> Option<PlacedSummary> {
    let all = model.instances()?;
    PlacedSummary::new(all.objects, all.instances, model.level_records(), model.levels())
}

fn look_at_level(model: &Model, level: usize) -> LevelSummary {
    let levels = model.levels() as usize;
    let records = model.level_records().iter().skip(level).step_by(levels);
    let misses: f64 = records.map(|l| l.acmr as f64 * l.triangles as f64).sum();
    let stored = model.archive().chunks().iter().map(|c| c.stored_bytes as usize);
    let record = &model.model_levels()[level];
    let bytes = LevelBytes::new(stored, level, model.record());
    LevelSummary::new(level, record, misses / record.triangles.max(1) as f64, bytes)
}

fn text(i: &Inspection) -> String {
    let mut text = level_table(&i.levels);
    let _ = writeln!(text, "format: version {}, scheme {}", i.format_version, i.scheme);
    let _ = writeln!(
        text,
        "size: {} bytes, {:.2} per input triangle ({} triangles); {} bytes decoded",
        i.bytes, i.bytes_per_input_triangle, i.triangles_in, i.decoded_bytes
    );
    let _ = writeln!(
        text,
        "clusters: {} of {} to {} triangles, at most {} neighbours",
        i.clusters, i.cluster_triangles_min, i.cluster_triangles_max, i.neighbours_max
    );
    if let Some(placed) = &i.placed {
        let _ = writeln!(text, "{}", placed.text());
    }
    let _ = writeln!(text, "bounds: {:?} to {:?}, in steps of {:e}", i.bounds_min, i.bounds_max, i.quantum);
    let _ = writeln!(text, "colours: {}", if i.colors { "yes" } else { "no" });
    if let Some(textures) = &i.textures {
        text += &textures.text();
    }
    if let Some(streams) = &i.streams {
        text += &streams.text();
    }
    text
}

/// Checks everything; lists what is broken on standard error.
pub fn verify(args: &VerifyArgs) -> Result<(), Failure> {
    let model = Model::open(&args.archive).map_err(blame_input)?;
    let name = args.archive.display();
    match verify::verify(&model) {
        Ok(_) if args.quiet => Ok(()),
        Ok(s) => print_text(&format!(
            "{name}: sound: {} chunks in {} clusters{}, {}{} border and {} corner positions, {}\n",
            s.chunks,
            model.record().clusters,
            placed(&model).map(|p| format!(", {}", p.text())).unwrap_or_default(),
            textures::checked(&model),
            s.border_positions,
            s.corner_positions,
            if s.open_edges[0] == 0 {
                "closed at every level".into()
            } else {
                format!("{} open edges", s.open_edges[0])
            }
        )),
        Err(breaches) => {
            let list: Vec<String> = breaches.iter().map(|b| format!("  {b}")).collect();
            let more = if breaches.len() == MAX_BREACHES { " or more" } else { "" };
            let head = format!("{name}: {}{more} promises are broken; bake it again", breaches.len());
            Err(blame_input(format!("{head}\n{}", list.join("\n"))))
        }
    }
}

/// Writes one level as a mesh.
pub fn export(args: &ExportArgs) -> Result<(), Failure> {
    let model = Model::open(&args.archive).map_err(blame_input)?;
    if args.level >= model.levels() {
        let levels = model.levels();
        let text = format!("it has levels 0 to {}, so there is no level {}", levels - 1, args.level);
        return Err(blame_machine(format!("{}: {text}", args.archive.display())));
    }
    let counts = write_level(&args.output, &model, args.level).map_err(|e| match e {
        ExportError::Model(e) => blame_input(e),
        e => blame_machine(e),
    })?;
    if args.quiet {
        return Ok(());
    }
    let ExportCounts { vertices, triangles, images } = counts;
    let images = if images > 0 { format!(", {images} images") } else { String::new() };
    print_text(&format!("{}: {vertices} vertices, {triangles} triangles{images}\n", args.output.display()))
}
