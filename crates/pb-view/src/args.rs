//! The command line of pb-view.

use clap::{Parser, ValueEnum};
use pb_lod::plan::Detail;
use pb_render::{ColorMode, Gpu, Samples, Style};
use pb_stream::disk::DiskModel;
use std::path::PathBuf;

use crate::picture::Format;
use crate::prefetch::Prefetcher;
use crate::size::parse_bytes;
use crate::streaming::Bounds;

const AFTER_HELP: &str = "\
In the window:
  left drag      turn around the model          F  fit the model into the picture
  right drag     move sideways (or middle)      1 2 3 4  colour: shaded, level, cluster, triangle
  wheel          closer, farther                5 6 7 8 9  albedo, normals, mips, texels, checker
  Tab or C       fly: W A S D move, Q E down    L  lines instead of surfaces
                 and up, mouse looks around,    [ ]  allowed error up, down
                 Shift is fast, wheel is speed  Space  pause a flypath;  Esc  quit

Examples:
  pb-view statue.pb
  pb-view statue.pb --error-px 2 --vram 256MiB --color level
  pb-view statue.pb --flypath flight.json --headless --settle --frames frames --stats stats.csv
  pb-view statue.pb --vram 64MiB --report small.html
  pb-view statue.pb --report large.html --compare small.json
  pb-view simulate --hours 24      flies without a picture and checks what loads (pb-view simulate --help)

Exit codes: 0 done; 1 the archive or the flypath is at fault; 2 the command line or the machine is.";

/// Streams and draws a Progressive Buffers archive, at any distance, in a window or without one.
#[derive(Parser, Clone, Debug)]
#[command(version, after_help = AFTER_HELP)]
pub struct Args {
    /// The archive, made by pb-bake.
    pub archive: PathBuf,

    /// Fly along the keyframes of this JSON file (the user guide describes it).
    #[arg(long, value_name = "P.json")]
    pub flypath: Option<PathBuf>,

    /// Draw without a window, one frame after the other. Without --flypath: a default flight around the model.
    /// --frames, --stats, --report, --settle and --export-view do the same.
    #[arg(long)]
    pub headless: bool,

    /// Open a window although --stats is given, which then gets a line for each frame of the window.
    #[arg(long, conflicts_with_all = ["headless", "no_draw", "settle", "frames", "report", "export_view", "minutes"])]
    pub window: bool,

    /// Size of the picture or the window, pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = parse_size)]
    pub size: [u32; 2],

    /// Write each frame into this folder, as frame_00000.png and so on.
    #[arg(long, value_name = "DIR")]
    pub frames: Option<PathBuf>,

    /// File format of --frames.
    #[arg(long, value_enum, default_value_t = Format::Png)]
    pub format: Format,

    /// Write one line per frame into this CSV file: times, triangles, bytes, missing chunks.
    #[arg(long, value_name = "S.csv")]
    pub stats: Option<PathBuf>,

    /// Write a page with plots, figures and pictures of the flight; the same numbers go beside it as R.json and R.csv.
    #[arg(long, value_name = "R.html")]
    pub report: Option<PathBuf>,

    /// Draw an earlier run into the plots of --report, from its R.json; may be given several times.
    #[arg(long, value_name = "OTHER.json", requires = "report")]
    pub compare: Vec<PathBuf>,

    /// At each frame wait until all that the view wants is there: the same pictures on every run.
    #[arg(long)]
    pub settle: bool,

    /// Write the surface that frame FRAME shows, all clusters together, as PLY; may be given several times.
    #[arg(long, value_name = "FRAME=FILE.ply", value_parser = parse_export)]
    pub export_view: Vec<Export>,

    /// Write the path flown by hand into this file when the window is closed.
    #[arg(long, value_name = "P.json")]
    pub record: Option<PathBuf>,

    /// Error that the picture may show, pixels: smaller is finer.
    #[arg(long, value_name = "T", default_value_t = 1.0, value_parser = parse_error_px)]
    pub error_px: f32,

    /// Switch levels by distance bands instead of by error: level i begins at (2^i - 1) K + S input units.
    #[arg(long, value_name = "K[,S]", conflicts_with = "error_px", value_parser = parse_band)]
    pub band: Option<[f32; 2]>,

    /// Bound for the model's data on the graphics adapter; KiB, MiB or GiB.
    #[arg(long, value_name = "SIZE", default_value = "1GiB", value_parser = parse_bytes)]
    pub vram: u64,

    /// Bound for decoded data in memory; KiB, MiB or GiB.
    #[arg(long, value_name = "SIZE", default_value = "1GiB", value_parser = parse_bytes)]
    pub ram: u64,

    /// Most triangles of a picture; the allowed error rises until it holds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub max_triangles: Option<u64>,

    /// Least frames per second: the allowed error rises until frames are quick enough. Pictures then depend on the
    /// machine's speed, also without a window.
    #[arg(long, value_name = "N", value_parser = parse_fps, conflicts_with_all = ["settle", "no_draw"])]
    pub target_fps: Option<f64>,

    /// Load what a flypath will show this many seconds ahead; with 0, what the camera's motion leads to.
    #[arg(long, value_name = "SECS", default_value_t = 2.0, value_parser = parse_lookahead)]
    pub lookahead: f64,

    /// Load nothing before it is drawn.
    #[arg(long)]
    pub no_prefetch: bool,

    /// What surfaces are coloured by.
    #[arg(long, visible_alias = "view", value_enum, default_value_t = Color::Shaded)]
    pub color: Color,

    /// The same as --color albedo: no light, colours exactly as in the texture.
    #[arg(long, conflicts_with = "color")]
    pub unlit: bool,

    /// Most samples of a texture along the longer axis of a pixel's footprint: 1 is fast and blurs slanted surfaces.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub anisotropy: u32,

    /// How textures lie in video memory.
    #[arg(long, value_enum, default_value_t = Textures::Auto)]
    pub textures: Textures,

    /// Draw triangles as lines.
    #[arg(long)]
    pub wireframe: bool,

    /// Samples per pixel: 4 for smooth edges, 1 where each pixel shall be the colour of one point.
    #[arg(long, value_name = "1|4", default_value = "4", value_parser = parse_samples)]
    pub samples: Samples,

    /// Which way is up, where no flypath says it.
    #[arg(long, value_enum, default_value_t = Up::Y)]
    pub up: Up,

    /// Let vertices jump between levels (for tests: shows what the morph is good for).
    #[arg(long, hide = true)]
    pub no_morph: bool,

    /// Paint back faces in pure magenta (for tests of closed models).
    #[arg(long, hide = true)]
    pub debug_backfaces: bool,

    /// Hold each chunk back for this many frames after it was asked for (for tests: late data, always the same).
    #[arg(long, hide = true, value_name = "N", default_value_t = 0)]
    pub late_frames: u32,

    /// Read as slowly as a disk that needs LATENCY_MS milliseconds for each read and gives MB_PER_S megabytes per second,
    /// one read after the other. Without a window the flight's own time is the disk's: every run is the same.
    #[arg(long, value_name = "LATENCY_MS,MB_PER_S", conflicts_with = "late_frames")]
    pub disk_model: Option<DiskModel>,

    /// Fly the flypath over and over for so many minutes (for long runs).
    #[arg(long, hide = true, value_name = "M", conflicts_with_all = ["report", "frames", "export_view"])]
    pub minutes: Option<f64>,

    /// Write all that the cache is told and says into this file (pb-view simulate --replay runs it again).
    #[arg(long, hide = true, value_name = "R.jsonl")]
    pub record_cache: Option<PathBuf>,

    /// Fly without a graphics adapter and without a picture: only what is loaded when, in a fraction of the flight's time.
    /// Nothing is read; with --disk-model chunks arrive when that disk would have read them, else in the next frame.
    #[arg(long, conflicts_with_all = ["frames", "late_frames"])]
    pub no_draw: bool,

    /// One draw call per cluster even where the adapter takes many in one.
    #[arg(long, hide = true)]
    pub plain_draws: bool,
}

/// How textures lie in video memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Textures {
    /// Compressed where the graphics adapter reads that and is no software.
    Auto,
    /// Compressed where the graphics adapter reads that; slow in software.
    Blocks,
    /// Decoded: four times the memory, and fast in software too.
    Decoded,
}

impl Textures {
    /// Whether textures stay compressed on this adapter.
    pub fn blocks(self, gpu: &Gpu) -> bool {
        gpu.texture_blocks
            && match self {
                Textures::Auto => !gpu.software(),
                Textures::Blocks => true,
                Textures::Decoded => false,
            }
    }
}

/// What surfaces are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Color {
    /// Their own colours.
    Shaded,
    /// The level that draws them.
    Level,
    /// Their cluster.
    Cluster,
    /// Their triangle.
    Triangle,
    /// Their own colours without light.
    Albedo,
    /// Their normals, after normal mapping.
    Normals,
    /// The mip of the texture that is shown, over the texture.
    Mips,
    /// Texels per pixel, over the texture: blue too few, green enough, red more than the picture can show.
    Texels,
    /// Squares of 8 texels and of an eighth of the tile.
    Checker,
}

/// An axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[allow(missing_docs)]
pub enum Up {
    X,
    Y,
    Z,
}

impl Up {
    /// Its unit vector.
    pub fn vector(self) -> glam::DVec3 {
        match self {
            Up::X => glam::DVec3::X,
            Up::Y => glam::DVec3::Y,
            Up::Z => glam::DVec3::Z,
        }
    }
}

/// A frame whose surface is to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Export {
    /// Frame number, from 0.
    pub frame: u32,
    /// Where to.
    pub path: PathBuf,
}

impl Args {
    /// True when no window is wanted.
    pub fn without_window(&self) -> bool {
        let files = [&self.frames, &self.stats, &self.report].iter().any(|path| path.is_some());
        !self.window && (self.headless || self.no_draw || self.settle || files || !self.export_view.is_empty())
    }

    /// The detail asked for.
    pub fn detail(&self) -> Detail {
        match self.band {
            Some([k, s]) => Detail::Bands { k, s },
            None => Detail::ErrorPx(self.error_px),
        }
    }

    /// The byte bounds.
    pub fn bounds(&self) -> Bounds {
        Bounds { vram_bytes: self.vram, ram_bytes: self.ram, max_triangles: self.max_triangles.unwrap_or(u64::MAX) }
    }

    /// What is loaded before it is drawn.
    pub fn prefetcher(&self) -> Prefetcher {
        match self.no_prefetch {
            true => Prefetcher::off(),
            false => Prefetcher::new(self.lookahead),
        }
    }

    /// Colours and debug switches.
    pub fn style(&self) -> Style {
        let color = match self.color {
            _ if self.unlit => ColorMode::Albedo,
            Color::Shaded => ColorMode::Shaded,
            Color::Level => ColorMode::Level,
            Color::Cluster => ColorMode::Cluster,
            Color::Triangle => ColorMode::Triangle,
            Color::Albedo => ColorMode::Albedo,
            Color::Normals => ColorMode::Normals,
            Color::Mips => ColorMode::Mips,
            Color::Texels => ColorMode::Texels,
            Color::Checker => ColorMode::Checker,
        };
        Style {
            color,
            wireframe: self.wireframe,
            show_back_faces: self.debug_backfaces,
            morph: !self.no_morph,
            anisotropy: self.anisotropy,
        }
    }
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let bad = || format!("'{text}' is no size; write for example 1280x720");
    let (w, h) = text.split_once(['x', 'X']).ok_or_else(bad)?;
    let size = [w, h].map(|t| t.trim().parse::<u32>().ok().filter(|n| (1..=16384).contains(n)));
    match size {
        [Some(w), Some(h)] => Ok([w, h]),
        _ => Err(format!("{}, each from 1 to 16384", bad())),
    }
}

fn parse_samples(text: &str) -> Result<Samples, String> {
    match text {
        "1" => Ok(Samples::One),
        "4" => Ok(Samples::Four),
        _ => Err(format!("'{text}' samples are not offered; choose 1 or 4")),
    }
}

fn parse_export(text: &str) -> Result<Export, String> {
    let bad = || format!("'{text}' does not name a frame and a file; write for example 120=frame120.ply");
    let (frame, path) = text.split_once('=').ok_or_else(bad)?;
    if path.is_empty() {
        return Err(bad());
    }
    Ok(Export { frame: frame.trim().parse().map_err(|_| bad())?, path: path.into() })
}

fn parse_error_px(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("'{text}' is no number of pixels"))?;
    match (1e-3..=1e4).contains(&value) {
        true => Ok(value),
        false => Err(format!("{text} is out of range; write a number of pixels from 0.001 to 10000")),
    }
}

fn parse_fps(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is no number of frames per second"))?;
    match (0.1..=1000.0).contains(&value) {
        true => Ok(value),
        false => Err(format!("{text} is out of range; write a number of frames per second from 0.1 to 1000")),
    }
}

fn parse_lookahead(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is no number of seconds"))?;
    match (0.0..=60.0).contains(&value) {
        true => Ok(value),
        false => Err(format!("{text} is out of range; write a number of seconds from 0 to 60")),
    }
}

fn parse_band(text: &str) -> Result<[f32; 2], String> {
    let bad = || format!("'{text}' is no band; write K or K,S in input units, K more than 0, for example 2.5,1");
    let (k, s) = text.split_once(',').unwrap_or((text, "0"));
    let k = k.trim().parse::<f32>().ok().filter(|k| k.is_finite() && *k > 0.0).ok_or_else(bad)?;
    let s = s.trim().parse::<f32>().ok().filter(|s| s.is_finite()).ok_or_else(bad)?;
    Ok([k, s])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(more: &[&str]) -> Result<Args, String> {
        let all = ["pb-view", "a.pb"].iter().chain(more);
        Args::try_parse_from(all).map_err(|e| e.to_string())
    }

    #[test]
    fn the_contract_command_line_is_understood() {
        let args = parse(&[
            "--flypath",
            "p.json",
            "--headless",
            "--size",
            "640x360",
            "--frames",
            "d",
            "--stats",
            "s.csv",
            "--settle",
            "--export-view",
            "3=a.ply",
            "--export-view",
            "7=b.ply",
            "--vram",
            "64MiB",
            "--ram",
            "1GiB",
            "--color",
            "cluster",
        ])
        .unwrap();
        assert_eq!((args.size, args.vram, args.export_view.len()), ([640, 360], 64 << 20, 2));
        assert_eq!(args.detail(), Detail::ErrorPx(1.0));
        assert_eq!(parse(&["--band", "2,0.5"]).unwrap().detail(), Detail::Bands { k: 2.0, s: 0.5 });
        assert_eq!(parse(&["--band", "2"]).unwrap().detail(), Detail::Bands { k: 2.0, s: 0.0 });
    }

    #[test]
    fn statistics_are_those_of_a_flight_without_a_window_unless_one_is_asked_for() {
        assert!(parse(&["--stats", "s.csv"]).unwrap().without_window());
        assert!(!parse(&["--stats", "s.csv", "--window"]).unwrap().without_window());
        assert!(parse(&["--window", "--headless"]).is_err());
    }

    #[test]
    fn wrong_values_say_what_is_right() {
        let cases: [(&[&str], &str); 9] = [
            (&["--target-fps", "0"], "0.1 to 1000"),
            (&["--compare", "a.json"], "--report"),
            (&["--size", "12"], "1280x720"),
            (&["--size", "0x5"], "1 to 16384"),
            (&["--export-view", "x.ply"], "120=frame120.ply"),
            (&["--error-px", "0"], "0.001"),
            (&["--band", "0"], "K more than 0"),
            (&["--band", "1,2", "--error-px", "3"], "cannot be used with"),
            (&["--vram", "12MB"], "KiB, MiB or GiB"),
        ];
        for (more, expected) in cases {
            let message = parse(more).expect_err(expected);
            assert!(message.contains(expected), "{more:?}: {message}");
        }
    }
}
