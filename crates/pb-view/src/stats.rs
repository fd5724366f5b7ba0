//! One line of numbers per frame, as CSV.

use anyhow::{Context, Result};
use std::io::Write;
use std::path::{Path, PathBuf};

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
}

const HEADER: &str = "frame,t_secs,frame_ms,triangles,draws,vram_bytes,ram_bytes,missing_chunks,error_px,\
                      coarse_draws,allowed_error_px";

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
        writeln!(file, "{HEADER}").with_context(context)?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Adds a line. `t_secs` is the flypath's time, `frame_ms` the wall clock's.
    pub fn add(&mut self, frame: u32, t_secs: f64, frame_ms: f64, s: &FrameStats) -> Result<()> {
        writeln!(
            self.file,
            "{frame},{t_secs:.6},{frame_ms:.3},{},{},{},{},{},{:.4},{},{:.4}",
            s.triangles,
            s.draws,
            s.vram_bytes,
            s.ram_bytes,
            s.missing_chunks,
            s.error_px,
            s.coarse_draws,
            s.allowed_error_px
        )
        .with_context(|| format!("{}: cannot write the statistics", self.path.display()))
    }

    /// Writes what is still buffered.
    pub fn finish(mut self) -> Result<()> {
        self.file.flush().with_context(|| format!("{}: cannot write the statistics", self.path.display()))
    }
}
