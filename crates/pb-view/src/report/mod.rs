//! `--report R.html`: what a flight was like, as one page with plots (figures 6 and 8 of the paper), and the same
//! numbers beside it as `R.json` and `R.csv`. docs/user-guide.md describes all three.
//!
//! - [`cuts`]: where the camera jumps;
//! - [`summary`]: percentiles, totals, times to full detail;
//! - [`runs`]: the JSON file, and other runs to compare with;
//! - [`panels`], [`svg`]: which plots there are, and how one is drawn;
//! - [`thumbs`]: small pictures of key frames;
//! - [`page`]: the page.
//!
//! Must never: refer to anything outside the page; change what is drawn; hold a date or anything else that two equal
//! runs do not share, but for measured times.

pub mod cuts;
mod page;
mod panels;
pub mod runs;
pub mod summary;
mod svg;
mod thumbs;

use anyhow::{Context, Result, bail};
use pb_lod::progressive_buffers::model::Model;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::args::Args;
use crate::flyer::Flyer;
use crate::flypath::Flypath;
use crate::stats::{Line, Table};
use runs::{AdapterFacts, ArchiveFacts, Bounds, Facts, OtherRun, RunFacts, StartTimes};
use summary::Summary;
use thumbs::Thumbs;

/// The files of a report, opened before the flight begins.
pub struct Report {
    html: Output,
    json: Output,
    facts: Facts,
    others: Vec<OtherRun>,
    table: Table,
    thumbs: Thumbs,
}

struct Output {
    file: File,
    path: PathBuf,
}

impl Output {
    fn create(path: PathBuf) -> Result<Self> {
        let file = File::create(&path)
            .with_context(|| format!("{}: cannot write the report; choose another place for it", path.display()))?;
        Ok(Self { file, path })
    }

    fn write(&mut self, text: &str) -> Result<()> {
        self.file
            .write_all(text.as_bytes())
            .with_context(|| format!("{}: cannot write the report", self.path.display()))
    }
}

/// The CSV file of a report.
pub fn csv_path(report: &Path) -> PathBuf {
    report.with_extension("csv")
}

/// The files of a report that can be opened before there is an adapter.
pub struct Prepared {
    html: Output,
    json: Output,
    label: String,
    others: Vec<OtherRun>,
}

/// Reads the runs to compare with, and opens the report's files, so that what is wrong with them is known at once.
/// None without `--report`.
pub fn prepare(args: &Args) -> Result<Option<Prepared>> {
    let Some(path) = &args.report else { return Ok(None) };
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm")) {
        bail!("--report {}: the report is a page; let its name end in .html", path.display());
    }
    let others = args.compare.iter().map(|path| OtherRun::open(path)).collect::<Result<Vec<_>>>()?;
    let label = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (html, json) = (Output::create(path.clone())?, Output::create(path.with_extension("json"))?);
    Ok(Some(Prepared { html, json, label, others }))
}

impl Prepared {
    /// The report of a flight that is about to begin.
    pub fn begin(self, args: &Args, flyer: &Flyer, flight: &Flypath) -> Report {
        let Self { html, json, label, others } = self;
        let facts = facts(label, args, flyer, flight);
        let thumbs = Thumbs::new(flight, args.format);
        Report { html, json, facts, others, table: Table::new(), thumbs }
    }
}

fn facts(label: String, args: &Args, flyer: &Flyer, flight: &Flypath) -> Facts {
    let plan = flyer.vram_plan();
    Facts {
        label,
        program: format!("pb-view {}", env!("CARGO_PKG_VERSION")),
        command: std::env::args().collect(),
        archive: archive_facts(&flyer.streaming().model),
        adapter: adapter_facts(flyer),
        run: RunFacts {
            width: args.size[0],
            height: args.size[1],
            samples: args.samples as u32,
            frames: flight.frames(),
            fps: flight.fps(),
            settle: args.settle,
        },
        bounds: Bounds {
            vram_bytes: args.vram,
            vram_planned_bytes: plan.bytes(),
            texture_vram_bytes: plan.texture_bytes(),
            ram_bytes: args.ram,
            max_triangles: args.max_triangles,
            target_fps: args.target_fps,
        },
        start: StartTimes::default(),
    }
}

/// No adapter has no name.
fn adapter_facts(flyer: &Flyer) -> AdapterFacts {
    let Some(gpu) = flyer.gpu() else { return AdapterFacts::default() };
    let info = gpu.adapter.get_info();
    AdapterFacts {
        name: info.name,
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        backend: info.backend.to_string(),
        software: gpu.software(),
    }
}

fn archive_facts(model: &Model) -> ArchiveFacts {
    let chunks = model.archive().chunks();
    let always = |c: &usize| model.always_resident(pb_lod::plan::ChunkId(*c as u32));
    ArchiveFacts {
        name: model.archive().path().file_name().unwrap_or_default().to_string_lossy().into_owned(),
        bytes: model.archive().file_bytes(),
        triangles_in: model.record().triangles_in,
        level_triangles: model.model_levels().iter().map(|l| l.triangles).collect(),
        clusters: model.record().clusters,
        chunks: model.chunk_count(),
        textures: model.textures().is_some(),
        start_bytes: (0..chunks.len()).filter(always).map(|c| chunks[c].stored_bytes as u64).sum(),
        decoded_bytes: chunks.iter().map(|c| c.decoded_bytes as u64).sum(),
    }
}

impl Report {
    /// The first picture is there.
    pub fn started(&mut self, start: StartTimes) {
        self.facts.start = start;
    }

    /// Adds a frame. True when its picture is wanted by [`Report::picture`].
    pub fn add(&mut self, line: &Line) -> bool {
        self.table.add(line);
        self.thumbs.wants(line)
    }

    /// The picture of the frame that was added last, rows from the top, in the format of the frames.
    pub fn picture(&mut self, size: [u32; 2], pixels: &[u8]) -> Result<()> {
        self.thumbs.take(size, pixels)
    }

    /// Writes page and JSON file; what they are called.
    pub fn finish(mut self) -> Result<[PathBuf; 2]> {
        let summary = Summary::new(&self.table, &self.facts.bounds);
        self.json.write(&runs::to_json(&self.facts, &summary, &self.table))?;
        let thumbs = self.thumbs.finish();
        let page = page::page(&page::Content {
            facts: &self.facts,
            summary: &summary,
            table: &self.table,
            others: &self.others,
            thumbs: &thumbs,
        })?;
        self.html.write(&page)?;
        Ok([self.html.path, self.json.path])
    }
}
