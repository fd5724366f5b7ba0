//! Independent measurements: nothing here uses the product's crates, so that no mistake can confirm itself.

mod chain;
mod colonnade;
mod compare;
mod crowd;
mod distance;
mod flights;
mod forecast;
mod generate;
mod landscape;
mod levels;
mod memory;
mod mesh;
mod parts;
mod pops;
mod random;
mod reference;
mod seams;
mod speed;
mod textured;
mod textures;
mod watertight;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, ensure};
use clap::{Parser, Subcommand};
use serde_json::json;

use crate::distance::Surface;
use crate::generate::Kind;
use crate::mesh::Mesh;

/// Makes test meshes and measures surfaces, archives and frames. Results are JSON on standard output.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Measurement,
}

#[derive(Subcommand)]
enum Measurement {
    /// Make a mesh from a seed.
    Generate {
        kind: Kind,
        /// Where it goes: .ply (binary) or .obj.
        out: PathBuf,
        /// About how many triangles.
        #[arg(long, default_value_t = 100_000)]
        triangles: usize,
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Make a height field of any size, row by row: a binary PLY.
    Landscape {
        out: PathBuf,
        /// About how many triangles.
        #[arg(long, default_value_t = 16_000_000)]
        triangles: usize,
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// How true the remaining time is that a bake shows.
    Forecast {
        /// The pb-bake to follow; else the one beside this program.
        #[arg(long)]
        pb_bake: Option<PathBuf>,
        /// Its arguments.
        #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Distance between two surfaces, both ways, by sampling.
    Distance {
        a: PathBuf,
        b: PathBuf,
        #[arg(long, default_value_t = 200_000)]
        samples: usize,
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// Count open and non-manifold edges after joining equal positions; exit 1 when a file is not closed.
    Watertight {
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Collapse a mesh with the meshopt crate to given vertex counts, each from the one before.
    MeshoptChain {
        input: PathBuf,
        /// Vertex counts, e.g. 10000,2500,625.
        #[arg(long, value_delimiter = ',', required = true)]
        counts: Vec<usize>,
        /// Folder for the results, as PLY.
        #[arg(long)]
        out: Option<PathBuf>,
        #[arg(long, default_value_t = 200_000)]
        samples: usize,
    },
    /// Speed of the whole pb-bake command, and of a plain meshopt chain, each step to a quarter of the triangles.
    BakeSpeed {
        #[arg(required = true)]
        meshes: Vec<PathBuf>,
        /// A row of a table for each, instead of JSON.
        #[arg(long)]
        markdown: bool,
        #[arg(long, default_value_t = 4)]
        steps: u32,
        /// The pb-bake to time; else the one beside this program.
        #[arg(long)]
        pb_bake: Option<PathBuf>,
    },
    /// Run a command and say what it holds at most in memory that is not a file's; exit 1 above a limit.
    Memory(memory::Arguments),
    /// Median, 95th percentile and maximum of each column of a pb-view --stats file.
    Stats { csv: PathBuf },
    /// All levels of an archive against its input and against meshopt; exit 1 when a stated bound does not hold.
    Levels {
        archive: PathBuf,
        input: PathBuf,
        #[arg(long, default_value_t = 200_000)]
        samples: usize,
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// The pb-bake to ask; else the one beside this program.
        #[arg(long)]
        pb_bake: Option<PathBuf>,
        /// Print the table of docs/performance.md instead of JSON.
        #[arg(long)]
        markdown: bool,
    },
    /// Draw the source itself, with its images at full resolution and without light, from the cameras of a flypath.
    Reference(reference::Arguments),
    /// Write a flypath that suits a model: stills from near, close up and far, or a slow flight.
    Flypath(flights::Arguments),
    /// FLIP, errors and largest change between pictures, or between frames of two folders; the reference first.
    Compare(compare::Arguments),
    /// Changes between neighbouring frames of two flights along one path, the second drawn by the reference.
    Pops(pops::Arguments),
    /// The heading of the table that `pops --row` continues.
    PopsHeading,
    /// pb-bake and pb-view beside the reference on one textured model, near, close and far.
    Textures(textures::Arguments),
    /// The heading of the table that `textures --markdown` continues.
    TexturesHeading,
    /// Make a textured mesh from a seed.
    Textured(textured::Arguments),
    /// Make a textured scene of any size from a seed, a colonnade in ruins, and a flypath for it beside it.
    Colonnade(colonnade::Arguments),
    /// Make a glTF scene of few meshes in many places from a seed.
    Crowd(crowd::Arguments),
    /// The flypath of a colonnade alone: longer, shorter, or at another rate.
    ColonnadeFlypath(colonnade::FlightArguments),
}

fn main() -> ExitCode {
    match run(Arguments::parse().command) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("pb-measure: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// True when everything that was checked holds.
fn run(command: Measurement) -> Result<bool> {
    match command {
        Measurement::Generate { kind, out, triangles, seed } => {
            ensure!(triangles > 0 && triangles <= 50_000_000, "--triangles must be 1 to 50 million");
            let mesh = generate::generate(kind, triangles, seed);
            mesh.write(&out)?;
            println!("{}", json!({ "triangles": mesh.triangles.len(), "vertices": mesh.positions.len() }));
        }
        Measurement::Landscape { out, triangles, seed } => {
            ensure!(triangles > 0 && triangles <= 1_000_000_000, "--triangles must be 1 to 1000 million");
            println!("{}", landscape::write(&out, triangles, seed)?);
        }
        Measurement::Forecast { pb_bake, arguments } => {
            println!("{:#}", forecast::run(&pb_bake.unwrap_or_else(levels::default_pb_bake), &arguments)?);
        }
        Measurement::Distance { a, b, samples, seed } => {
            let found = distance_of(&Mesh::read(&a)?, &Mesh::read(&b)?, samples, seed)?;
            println!("{found:#}");
        }
        Measurement::Watertight { files } => return watertight_of(&files),
        Measurement::MeshoptChain { input, counts, out, samples } => {
            let input = Mesh::read(&input)?.welded();
            for (link, wanted) in chain::chain(&input, &counts).iter().zip(&counts) {
                let mut found = distance_of(&link.mesh, &input, samples, 1)?;
                found["wanted_vertices"] = json!(wanted);
                found["vertices"] = json!(link.mesh.positions.len());
                found["seconds"] = json!(link.seconds);
                println!("{found:#}");
                if let Some(folder) = &out {
                    std::fs::create_dir_all(folder)?;
                    link.mesh.write(&folder.join(format!("{wanted}.ply")))?;
                }
            }
        }
        Measurement::BakeSpeed { meshes, markdown, steps, pb_bake } => {
            let pb_bake = pb_bake.unwrap_or_else(levels::default_pb_bake);
            for (i, mesh) in meshes.iter().enumerate() {
                let found = speed::bake(&pb_bake, mesh, steps)?;
                match markdown {
                    true => println!(
                        "{}",
                        speed::bake_row(&found, &mesh.file_stem().unwrap_or_default().to_string_lossy(), i == 0)
                    ),
                    false => println!("{found:#}"),
                }
            }
        }
        Measurement::Memory(arguments) => {
            let found = memory::run(&arguments)?;
            println!("{:#}", found.figures);
            return Ok(found.holds);
        }
        Measurement::Stats { csv } => println!("{:#}", speed::stats(&csv)?),
        Measurement::Levels { archive, input, samples, seed, pb_bake, markdown } => {
            let pb_bake = pb_bake.unwrap_or_else(levels::default_pb_bake);
            let job = levels::Job { pb_bake: &pb_bake, archive: &archive, input: &input, samples, seed };
            let (figures, table) = levels::measure(&job)?;
            if markdown {
                print!("{table}")
            } else {
                println!("{figures:#}")
            }
            return Ok(figures["levels"].as_array().is_some_and(|l| l.iter().all(|r| r["bound_holds"] == true)));
        }
        Measurement::Reference(arguments) => println!("{:#}", reference::run(&arguments)?),
        Measurement::Flypath(arguments) => println!("{:#}", flights::run(&arguments)?),
        Measurement::Compare(arguments) => println!("{:#}", compare::run(&arguments)?),
        Measurement::Pops(arguments) => println!("{}", pops::run(&arguments)?),
        Measurement::PopsHeading => println!("{}", pops::HEADING),
        Measurement::Textures(arguments) => textures::run(&arguments)?,
        Measurement::TexturesHeading => println!("{}", textures::HEADING),
        Measurement::Textured(arguments) => println!("{:#}", textured::run(&arguments)?),
        Measurement::Colonnade(arguments) => println!("{:#}", colonnade::run(&arguments)?),
        Measurement::Crowd(arguments) => println!("{:#}", crowd::run(&arguments)?),
        Measurement::ColonnadeFlypath(arguments) => println!("{:#}", colonnade::run_flight(&arguments)?),
    }
    Ok(true)
}

fn distance_of(a: &Mesh, b: &Mesh, samples: usize, seed: u64) -> Result<serde_json::Value> {
    let (low, high) = b.bounds();
    let center = std::array::from_fn(|k| low[k].midpoint(high[k]));
    let found = Surface::new(a, center)?.both_ways(&Surface::new(b, center)?, samples, seed);
    Ok(json!({
        "rms": found.rms(), "max": found.max(), "diagonal": b.diagonal(),
        "rms_over_diagonal": found.rms() / b.diagonal(), "max_over_diagonal": found.max() / b.diagonal(),
        "a_to_b": { "rms": found.a_to_b.rms, "max": found.a_to_b.max },
        "b_to_a": { "rms": found.b_to_a.rms, "max": found.b_to_a.max },
    }))
}

fn watertight_of(files: &[PathBuf]) -> Result<bool> {
    let mut closed = true;
    for file in files {
        let found = watertight::check(&Mesh::read(file)?);
        closed &= found.unmatched_edges == 0;
        println!(
            "{}",
            json!({
                "file": file.display().to_string(), "triangles": found.triangles, "vertices": found.vertices,
                "unmatched_edges": found.unmatched_edges, "non_manifold_edges": found.non_manifold_edges,
            })
        );
    }
    Ok(closed)
}
