//! The command line.

use clap::{Args, Parser, Subcommand, ValueEnum};
use pb_bake::images::DecodeOptions;
use pb_bake::import::{ImportOptions, Instancing};
use pb_lod::progressive_buffers::bake::{BakeOptions, DEFAULT_TILE_SIZE, TexelOptions};
use pb_mesh::normals::{NormalOptions, NormalWeight};
use pb_mesh::repair::RepairOptions;
use pb_mesh::texture::{NormalSpace, Quality};
use std::path::{Path, PathBuf};

const ABOUT: &str = "Turns triangle meshes into an archive that pb-view streams and draws at any distance";
const LONG_ABOUT: &str = "\
Turns triangle meshes into one archive that pb-view streams and draws at any distance, without cracks or pops.

Several inputs make one scene. OBJ (with MTL materials), PLY, STL, glTF and GLB are read; the mesh is repaired where \
that is safe, cut into clusters, simplified into levels of detail, and packed. The archive appears under its name only \
when it is complete.";
const EXAMPLES: &str = "\
Examples:
  pb-bake statue.ply statue.pb            bake a scan with the usual five levels
  pb-bake hull.stl deck.glb ship.pb       several files, one scene
  pb-bake city.ply city.pb --resume       go on after Ctrl-C or a crash
  pb-bake inspect statue.pb               what is in an archive
  pb-bake verify statue.pb                check every byte and every promise of an archive
  pb-bake export statue.pb s.ply --level 2    one level as a mesh for other programs
  pb-bake doctor                          what pb-bake finds on this machine

Exit codes: 0 done, 1 the input or the archive is at fault, 2 the command line or the machine is, 130 interrupted.";

/// The whole command line.
#[derive(Parser)]
#[command(name = "pb-bake", version, about = ABOUT, long_about = LONG_ABOUT, after_help = EXAMPLES)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Cli {
    /// What to do instead of baking.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// How to bake.
    #[command(flatten)]
    pub bake: BakeArgs,
}

/// What pb-bake does besides baking.
#[derive(Subcommand)]
pub enum Command {
    /// Show what is in an archive: levels, errors, sizes
    Inspect(InspectArgs),
    /// Check every checksum and every promise of an archive; exit 1 and the place where one is broken
    Verify(VerifyArgs),
    /// Write one level of an archive as a PLY, OBJ or GLB mesh
    Export(ExportArgs),
    /// Show what this program finds on this machine: memory, room, the xatlas helper, formats
    Doctor(DoctorArgs),
}

/// Arguments of a bake.
#[derive(Args)]
pub struct BakeArgs {
    /// Meshes to bake: OBJ, PLY, STL, glTF or GLB; several make one scene
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    /// Archive to write, for example statue.pb
    #[arg(required = true, value_name = "OUT.pb")]
    pub output: Option<PathBuf>,
    /// Levels of detail, 1 to 12; level 0 is the input
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=12))]
    pub levels: u32,
    /// How many times fewer vertices each level has; 2 gives finer steps and asks for about twice the levels
    #[arg(long, value_name = "R", default_value_t = 4.0, value_parser = ratio)]
    pub ratio: f64,
    /// Triangles per cluster at most, the unit of streaming and of culling [default: 32768; 65536 for meshes of up to 262144
    /// triangles, 16384 with textures]
    #[arg(long, value_name = "N", value_parser = cluster_triangles)]
    pub cluster_triangles: Option<usize>,
    /// Threads to use; all cores unless given. The result is the same whatever their number
    #[arg(long, value_name = "N", value_parser = threads)]
    pub threads: Option<usize>,
    /// Write repeated meshes of glTF scenes out as geometry, instead of keeping each once with its places
    #[arg(long)]
    pub expand_instances: bool,

    /// Base colour image for the inputs that have texture coordinates but name no image
    #[arg(long, value_name = "FILE")]
    pub texture: Option<PathBuf>,
    /// Exit with 1, and write nothing, where an image is missing or broken; else a checker stands in its place
    #[arg(long)]
    pub strict: bool,
    /// Where the charts of textures come from; unless given, the source's are kept where they are usable
    #[arg(long, value_enum, value_name = "FROM")]
    pub charts: Option<ChartsFrom>,
    /// Widest texture tile of a cluster, texels: a power of two from 32 to 4096
    #[arg(long, value_name = "N", default_value_t = DEFAULT_TILE_SIZE, value_parser = tile_size)]
    pub tile_size: u32,
    /// Keep the normals of the finest level as a map, so that coarse levels are lit like it; also for models without images
    #[arg(long)]
    pub normal_map: bool,
    /// How long to search for good texture blocks
    #[arg(long, value_enum, default_value_t = TextureQuality::Normal)]
    pub texture_quality: TextureQuality,
    /// How texels are stored
    #[arg(long, value_enum, default_value_t = TexelFormat::Bc)]
    pub texture_format: TexelFormat,
    /// The xatlas helper program, for --charts xatlas; looked for beside this program and in PATH unless given
    #[arg(long, value_name = "PATH")]
    pub xatlas_helper: Option<PathBuf>,
    /// Seconds that the xatlas helper may take for one cluster
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = seconds)]
    pub xatlas_time_limit: f64,
    /// Most memory to use, for example 4GiB; half of the machine's unless given. What does not fit lies in temporary files
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    pub memory: Option<u64>,
    /// Folder for temporary files: images, texture chunks, what exceeds --memory; that of the archive unless given
    #[arg(long, value_name = "DIR")]
    pub temp_dir: Option<PathBuf>,
    /// Go on where a bake of the same archive was cut short, if inputs and options are the same; else begin anew
    #[arg(long)]
    pub resume: bool,
    /// Replace an existing file even if it is not an archive
    #[arg(long)]
    pub force: bool,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
    /// Print the summary as one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    /// Print progress on standard error as JSON objects, one per line, five per second; also with --quiet
    #[arg(long)]
    pub progress_json: bool,
    /// Join positions at most this far apart, in units of the model; 0 joins equal ones only
    #[arg(long, value_name = "T", default_value_t = 0.0, value_parser = tolerance)]
    pub weld_tolerance: f64,
    /// Where normals are missing: angle between neighbouring triangles from which on an edge is shown sharp
    #[arg(long, value_name = "DEG", default_value_t = 180.0, value_parser = crease_angle)]
    pub crease_angle: f64,
    /// Where normals are missing: what weighs the triangles around a vertex
    #[arg(long, value_enum, default_value_t = Normals::Angle)]
    pub normals: Normals,
}

/// How missing normals are made.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Normals {
    /// By the triangle's angle at the vertex
    Angle,
    /// By the triangle's area
    Area,
}

/// Where charts come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ChartsFrom {
    /// The texture coordinates of the input, texels copied one to one; with --normal-map only where they are usable
    Source,
    /// The built-in method: new charts, texels resampled
    Auto,
    /// The xatlas helper program; the built-in method where it fails
    Xatlas,
}

/// How long to search for good texture blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TextureQuality {
    /// For trials
    Fast,
    /// For use
    Normal,
    /// Many times slower, for the last tenths of a decibel
    Best,
}

/// How texels are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TexelFormat {
    /// Block compressed: BC7, BC5, BC6H
    Bc,
    /// Plain: RGBA8, RG8, half floats; four times the bytes
    Rgba8,
}

impl BakeArgs {
    /// For [`TextureInput`](pb_lod::progressive_buffers::bake::TextureInput).
    pub fn texel_options(&self) -> TexelOptions {
        TexelOptions {
            quality: match self.texture_quality {
                TextureQuality::Fast => Quality::Fast,
                TextureQuality::Normal => Quality::Normal,
                TextureQuality::Best => Quality::Best,
            },
            compress: self.texture_format == TexelFormat::Bc,
            normal_space: if self.normal_map { NormalSpace::Object } else { NormalSpace::Tangent },
        }
    }

    /// For [`pb_mesh::repair::repair`].
    pub fn repair_options(&self) -> RepairOptions {
        let weight = match self.normals {
            Normals::Angle => NormalWeight::Angle,
            Normals::Area => NormalWeight::Area,
        };
        let normals = NormalOptions { weight, crease_angle_deg: self.crease_angle };
        RepairOptions { weld_tolerance: self.weld_tolerance, normals, ..RepairOptions::default() }
    }

    /// For [`pb_bake::import::load`].
    pub fn import_options(&self) -> ImportOptions {
        let instancing = if self.expand_instances { Instancing::Expand } else { Instancing::Keep };
        ImportOptions { texture: self.texture.clone(), instancing, ..ImportOptions::default() }
    }

    /// Where temporary files lie.
    pub fn temp_folder(&self) -> &Path {
        let beside = self.output.as_deref().and_then(Path::parent).filter(|p| !p.as_os_str().is_empty());
        self.temp_dir.as_deref().or(beside).unwrap_or(Path::new("."))
    }

    /// For [`pb_bake::images::decode_all`].
    pub fn decode_options(&self) -> DecodeOptions {
        DecodeOptions { temp_dir: self.temp_folder().to_owned(), ..DecodeOptions::default() }
    }

    /// Most bytes of memory to use; `None` where the machine does not tell how many it has.
    pub fn memory_bytes(&self) -> Option<u64> {
        self.memory.or_else(|| pb_bake::memory::of_machine().map(|(total, _)| total / 2))
    }

    /// For [`pb_lod::progressive_buffers::bake::bake`].
    pub fn bake_options(&self) -> BakeOptions {
        BakeOptions { levels: self.levels, ratio: self.ratio, cluster_triangles: self.cluster_triangles }
    }
}

/// Arguments of `inspect`.
#[derive(Args)]
pub struct InspectArgs {
    /// Archive to look into
    #[arg(value_name = "A.pb")]
    pub archive: PathBuf,
    /// Also read all chunks, and show what each stream costs: positions, normals, indices, ...
    #[arg(long)]
    pub streams: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `verify`.
#[derive(Args)]
pub struct VerifyArgs {
    /// Archive to check
    #[arg(value_name = "A.pb")]
    pub archive: PathBuf,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Arguments of `export`.
#[derive(Args)]
pub struct ExportArgs {
    /// Archive to read
    #[arg(value_name = "A.pb")]
    pub archive: PathBuf,
    /// Mesh to write; its ending chooses the format: .ply, .obj or .glb
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Level to write; 0 is the finest
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub level: u32,
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
}

/// Arguments of `doctor`.
#[derive(Args)]
pub struct DoctorArgs {
    /// The helper of --charts xatlas; else PB_XATLAS names it, else it is beside pb-bake or in PATH
    #[arg(long, value_name = "FILE")]
    pub xatlas_helper: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

fn ratio(text: &str) -> Result<f64, String> {
    number(text, 1.2, 64.0)
}

fn crease_angle(text: &str) -> Result<f64, String> {
    number(text, 0.0, 180.0)
}

fn tolerance(text: &str) -> Result<f64, String> {
    number(text, 0.0, 1e30)
}

fn cluster_triangles(text: &str) -> Result<usize, String> {
    number(text, 64.0, 1e6).map(|n| n as usize)
}

fn tile_size(text: &str) -> Result<u32, String> {
    let size = number(text, 32.0, 4096.0)? as u32;
    if size.is_power_of_two() { Ok(size) } else { Err("it must be a power of two".into()) }
}

/// Least bound on memory: what the program, its threads and one cluster's work take.
const LEAST_MEMORY: u64 = 256 << 20;

fn memory(text: &str) -> Result<u64, String> {
    let bytes = text.parse::<bytesize::ByteSize>().map_err(|_| "write a size, for example 4GiB or 512MiB")?.as_u64();
    if bytes >= LEAST_MEMORY { Ok(bytes) } else { Err(format!("it must be at least {}MiB", LEAST_MEMORY >> 20)) }
}

fn seconds(text: &str) -> Result<f64, String> {
    number(text, 0.1, 86_400.0)
}

fn threads(text: &str) -> Result<usize, String> {
    number(text, 1.0, 1024.0).map(|n| n as usize)
}

fn number(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "this is not a number".to_string())?;
    if (least..=most).contains(&number) { Ok(number) } else { Err(format!("it must be from {least} to {most}")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn the_last_of_several_names_is_the_archive() {
        let cli = Cli::parse_from(["pb-bake", "a.obj", "b.ply", "out.pb", "--levels", "3"]);
        assert_eq!(cli.bake.inputs, ["a.obj", "b.ply"].map(PathBuf::from));
        assert_eq!((cli.bake.output, cli.bake.levels), (Some("out.pb".into()), 3));
    }
}
