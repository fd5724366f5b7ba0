//! One line of numbers per frame: the columns, the CSV file, and the whole table of a flight.
//!
//! The columns are one table ([`COLUMNS`]), from which the CSV file, the report and its JSON file are written, so that
//! all three hold the same numbers.

use anyhow::{Context, Result};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::meter::{Times, Traffic};

/// What is known of a frame when it is on the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// Triangles drawn.
    pub triangles: u64,
    /// Draws: clusters and coarse ranges.
    pub draws: u32,
    /// Model data on the adapter.
    pub vram_bytes: u64,
    /// Decoded chunks in memory.
    pub ram_bytes: u64,
    /// Wanted for this view, not there.
    pub missing_chunks: u32,
    /// Largest projected error of what is drawn, pixels.
    pub error_px: f32,
    /// Coarse ranges among the draws.
    pub coarse_draws: u32,
    /// Error that selection allowed, pixels; 0 with bands.
    pub allowed_error_px: f32,
    /// Band size that selection used, input units; 0 with errors.
    pub band_k: f32,
    /// The part of the model data on the adapter that is textures.
    pub texture_vram_bytes: u64,
    /// Wanted for this view, there or not.
    pub wanted_chunks: u32,
    /// Textures among the missing chunks.
    pub missing_textures: u32,
    /// Error that selection allowed of texels, pixels; 0 with bands and without textures.
    pub allowed_texel_error_px: f32,
    /// The detail is coarser than the bounds allow: data for more is still to come.
    pub rising: bool,
    /// Late data is still fading in, or leaving data out.
    pub fading: bool,
    /// Loads asked for and not answered.
    pub loads_in_flight: u32,
    /// Bytes that moved.
    pub traffic: Traffic,
    /// What it took to decide on them and to move them.
    pub times: Times,
}

/// A frame of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// Frame number, from 0.
    pub frame: u32,
    /// Time on the flypath.
    pub t_secs: f64,
    /// Wall clock.
    pub frame_ms: f64,
    /// Building and submitting the draw commands.
    pub draw_ms: f64,
    /// True where the view has little in common with that of the frame before (and at the start).
    pub cut: bool,
    /// Memory of the process.
    pub memory: ProcessMemory,
    /// All else.
    pub stats: FrameStats,
}

/// A column: its name, the decimals that are written, where the value comes from.
pub struct Column {
    /// Name, unit last.
    pub name: &'static str,
    decimals: usize,
    value: fn(&Line) -> f64,
}

const fn column(name: &'static str, decimals: usize, value: fn(&Line) -> f64) -> Column {
    Column { name, decimals, value }
}

/// All columns, in the order of the file. New ones go to the end. docs/user-guide.md says what they mean.
pub const COLUMNS: [Column; 32] = [
    column("frame", 0, |l| l.frame.into()),
    column("t_secs", 6, |l| l.t_secs),
    column("frame_ms", 3, |l| l.frame_ms),
    column("triangles", 0, |l| l.stats.triangles as f64),
    column("draws", 0, |l| l.stats.draws.into()),
    column("vram_bytes", 0, |l| l.stats.vram_bytes as f64),
    column("ram_bytes", 0, |l| l.stats.ram_bytes as f64),
    column("missing_chunks", 0, |l| l.stats.missing_chunks.into()),
    column("error_px", 4, |l| l.stats.error_px.into()),
    column("coarse_draws", 0, |l| l.stats.coarse_draws.into()),
    column("allowed_error_px", 4, |l| l.stats.allowed_error_px.into()),
    column("band_k", 6, |l| l.stats.band_k.into()),
    column("select_ms", 3, |l| l.stats.times.select_ms),
    column("carry_out_ms", 3, |l| l.stats.times.carry_out_ms),
    column("draw_ms", 3, |l| l.draw_ms),
    column("texture_vram_bytes", 0, |l| l.stats.texture_vram_bytes as f64),
    column("wanted_chunks", 0, |l| l.stats.wanted_chunks.into()),
    column("missing_textures", 0, |l| l.stats.missing_textures.into()),
    column("fading", 0, |l| l.stats.fading.into()),
    column("loads_in_flight", 0, |l| l.stats.loads_in_flight.into()),
    column("disk_bytes", 0, |l| l.stats.traffic.disk_bytes as f64),
    column("prefetch_bytes", 0, |l| l.stats.traffic.prefetch_bytes as f64),
    column("needed_bytes", 0, |l| l.stats.traffic.needed_bytes as f64),
    column("upload_bytes", 0, |l| l.stats.traffic.upload_bytes as f64),
    column("rss_bytes", 0, |l| l.memory.rss_bytes as f64),
    column("rss_private_bytes", 0, |l| l.memory.private_bytes as f64),
    column("cut", 0, |l| l.cut.into()),
    column("upload_ms", 3, |l| l.stats.times.upload_ms),
    column("reads", 0, |l| l.stats.traffic.reads as f64),
    column("read_bytes", 0, |l| l.stats.traffic.read_bytes as f64),
    column("rising", 0, |l| l.stats.rising.into()),
    column("allowed_texel_error_px", 4, |l| l.stats.allowed_texel_error_px.into()),
];

impl Column {
    /// How many digits follow the point.
    pub fn decimals(&self) -> usize {
        self.decimals
    }

    /// The value as all files write it.
    fn text(&self, line: &Line) -> String {
        format!("{:.*}", self.decimals, (self.value)(line))
    }
}

/// Memory of this process, as the system sees it; 0 where it does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProcessMemory {
    /// Resident, with the mapped parts of the archive.
    pub rss_bytes: u64,
    /// Resident and backed by no file: what the program holds itself, and what a software adapter holds.
    pub private_bytes: u64,
}

impl ProcessMemory {
    /// Now. Read from `/proc/self/statm`.
    pub fn now() -> Self {
        let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
        let mut pages = text.split_whitespace().skip(1).map_while(|w| w.parse::<u64>().ok());
        let (resident, shared) = (pages.next().unwrap_or(0), pages.next().unwrap_or(0));
        let page = rustix::param::page_size() as u64;
        Self { rss_bytes: resident * page, private_bytes: resident.saturating_sub(shared) * page }
    }
}

/// The lines of a flight by column, rounded as they are written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    columns: Vec<(String, Vec<f64>)>,
}

impl Table {
    /// An empty table of all [`COLUMNS`].
    pub fn new() -> Self {
        Self { columns: COLUMNS.iter().map(|c| (c.name.to_owned(), Vec::new())).collect() }
    }

    /// Of another run's columns, all of the same length; the length is wrong where they are not.
    pub fn from_columns(columns: Vec<(String, Vec<f64>)>) -> Option<Self> {
        let lines = columns.first().map_or(0, |c| c.1.len());
        columns.iter().all(|c| c.1.len() == lines).then_some(Self { columns })
    }

    /// Adds a line.
    pub fn add(&mut self, line: &Line) {
        for ((_, values), column) in self.columns.iter_mut().zip(&COLUMNS) {
            values.push(column.text(line).parse().expect("a formatted number is a number"));
        }
    }

    /// Number of lines.
    pub fn lines(&self) -> usize {
        self.columns.first().map_or(0, |c| c.1.len())
    }

    /// A column by its name; empty where another version of the program did not write it.
    pub fn column(&self, name: &str) -> &[f64] {
        self.columns.iter().find(|c| c.0 == name).map_or(&[], |c| &c.1)
    }

    /// All columns with their names.
    pub fn columns(&self) -> &[(String, Vec<f64>)] {
        &self.columns
    }
}

/// A CSV file that is being written.
pub struct StatsFile {
    file: std::io::BufWriter<std::fs::File>,
    path: PathBuf,
}

impl StatsFile {
    /// Creates the file and writes the column names.
    pub fn create(path: &Path) -> Result<Self> {
        let context = || format!("{}: cannot write the statistics", path.display());
        let mut file = std::io::BufWriter::new(std::fs::File::create(path).with_context(context)?);
        writeln!(file, "{}", COLUMNS.each_ref().map(|c| c.name).join(",")).with_context(context)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Adds a line.
    pub fn add(&mut self, line: &Line) -> Result<()> {
        let text = COLUMNS.each_ref().map(|c| c.text(line)).join(",");
        writeln!(self.file, "{text}").with_context(|| format!("{}: cannot write the statistics", self.path.display()))
    }

    /// Writes what is still buffered.
    pub fn finish(mut self) -> Result<()> {
        self.file.flush().with_context(|| format!("{}: cannot write the statistics", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_user_guide_names_every_column() {
        let guide = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/user-guide.md");
        let guide = std::fs::read_to_string(guide).unwrap();
        for column in &COLUMNS {
            assert!(guide.contains(&format!("`{}`", column.name)), "{} is not explained", column.name);
        }
    }

    #[test]
    fn the_table_holds_what_the_file_holds() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut table = Table::new();
        let mut stats = StatsFile::create(file.path()).unwrap();
        for i in 0..3 {
            let line = Line { frame: i, t_secs: i as f64 / 3.0, frame_ms: 1.23456, cut: i == 0, ..Line::default() };
            table.add(&line);
            stats.add(&line).unwrap();
        }
        stats.finish().unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let mut lines = text.lines().map(|l| l.split(',').collect::<Vec<_>>());
        let names = lines.next().unwrap();
        for (row, words) in lines.enumerate() {
            for (name, word) in names.iter().zip(words) {
                assert_eq!(table.column(name)[row], word.parse::<f64>().unwrap(), "{name}");
            }
        }
        assert_eq!(table.column("frame_ms"), [1.235; 3]);
        assert_eq!(table.column("no such column"), [0.0; 0]);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_process_has_memory() {
        let memory = ProcessMemory::now();
        assert!(memory.rss_bytes > 1 << 20 && memory.private_bytes > 0 && memory.private_bytes <= memory.rss_bytes);
    }
}
