//! pb-bake: turns meshes into Progressive Buffers archives, and looks into archives.
//!
//! This file is the order of events and the exit codes: 0 done, 1 the input or archive is at fault, 2 the usage or the
//! machine is, 130 it was interrupted. Everything that can refuse the target is asked before the work begins.

mod cli;
mod doctor;
mod failure;
mod inspect;
mod interrupt;
mod job;
mod progress;
mod report;
mod room;
mod scene;
mod texturing;

use clap::Parser;
use cli::{BakeArgs, Cli, Command};
use failure::{Failure, blame_input, blame_machine};
use job::Job;
use pb_archive::{FileStorage, Overwrite, Writer};
use pb_bake::memory::{Bound, Memory, set_aside};
use pb_bake::traces;
use pb_lod::progressive_buffers::bake::{BakeError, Stage};
use pb_lod::progressive_buffers::layout::SCHEME;
use pb_lod::progressive_buffers::write::write_model;
use progress::{Mode, Progress, Work};
use report::BakeSummary;
use scene::Scene;
use std::process::ExitCode;

/// Bounded; see its module.
#[global_allocator]
static MEMORY: Memory = Memory;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Command::Inspect(args)) => inspect::inspect(&args),
        Some(Command::Verify(args)) => inspect::verify(&args),
        Some(Command::Export(args)) => inspect::export(&args),
        Some(Command::Doctor(args)) => doctor::doctor(&args),
        None => run_bake(&cli.bake),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("pb-bake: {failure}");
            failure.exit_code()
        }
    }
}

fn run_bake(args: &BakeArgs) -> Result<(), Failure> {
    let output = args.output.as_ref().expect("the command line demands it");
    refuse_own_input(args)?;
    if let Some(threads) = args.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        pool.map_err(blame_machine)?;
    }
    let overwrite = if args.force { Overwrite::Force } else { Overwrite::IfArchive };
    let writer = Writer::create(output, SCHEME, overwrite).map_err(blame_machine)?;
    writer.temporary().into_iter().for_each(traces::add);
    interrupt::install()?;
    let (bound, keeps) = room::bound_memory(args)?;
    let bytes = |input: &std::path::PathBuf| std::fs::metadata(input).map_or(0, |m| m.len());
    let work = Work {
        input_bytes: args.inputs.iter().map(bytes).sum(),
        texel_options: args.texel_options(),
        ..Work::default()
    };
    let progress = Progress::new(Mode::of(args.quiet, args.progress_json), work);
    let mut job = Job::open(args, keeps, &progress)?;
    match bake_into(writer, args, &mut job, &progress) {
        Ok(summary) => {
            let resumed = job.resumed();
            job.remove();
            let summary = summary.with_stages(progress.finish(), &resumed);
            let summary = summary.with_memory(args.memory_bytes(), bound.as_ref().map(Bound::usage));
            match (args.json, args.quiet) {
                (true, _) => report::print_json(&summary),
                (false, true) => Ok(()),
                (false, false) => report::print_text(&summary.text()),
            }
        }
        Err(failure) if failure.is_of_input() => {
            job.remove();
            Err(failure)
        }
        Err(failure) => Err(match job.keep() {
            Some(advice) => blame_machine(format!("{failure}; {advice}")),
            None => failure,
        }),
    }
}

fn bake_into(
    writer: Writer<FileStorage>,
    args: &BakeArgs,
    job: &mut Job,
    progress: &Progress,
) -> Result<BakeSummary, Failure> {
    let mut scene = scene::load(args, job, progress)?;
    let show = |stage, share| {
        progress.stage(stage_name(stage));
        progress.share(share);
        if stage == Stage::Simplify && share == 0.0 {
            // No other thread is at work. The surface is read once more, cluster by cluster; then rounds go over what was made
            // of it.
            set_aside(args.temp_folder());
        }
    };
    let (model, baked, helper) =
        texturing::bake_scene(args, &mut scene, job, progress, &show).map_err(|e| match e {
            BakeError::TooLarge(_) => blame_input(e),
            e => blame_machine(e),
        })?;
    let Scene { inputs, repairs, textures, .. } = scene;
    progress.stage("write");
    let bytes = write_model(writer, &model).map_err(blame_machine)?;
    let output = args.output.as_ref().expect("the command line demands it");
    let textures = textures.map(|t| t.with_bake(&model, &baked, helper));
    Ok(BakeSummary::new(output, bytes, &model, &baked).with_input(&inputs, &repairs, textures))
}

/// Guards against `pb-bake a.obj b.obj`, where somebody forgot the archive's name.
fn refuse_own_input(args: &BakeArgs) -> Result<(), Failure> {
    let output = args.output.as_ref().expect("the command line demands it");
    let target = std::fs::canonicalize(output).ok();
    let same = |input: &&std::path::PathBuf| target.is_some() && std::fs::canonicalize(input).ok() == target;
    if let Some(input) = args.inputs.iter().find(same) {
        let text = "is an input and the archive to be written; the last argument names the archive";
        return Err(blame_machine(format!("{}: {text}", input.display())));
    }
    let extension = output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if let Some(mesh @ ("obj" | "ply" | "stl" | "gltf" | "glb")) = extension.as_deref() {
        let text =
            format!("an archive is not written under the name of a .{mesh} mesh; the last argument names the archive");
        return Err(blame_machine(format!("{}: {text}", output.display())));
    }
    Ok(())
}

fn stage_name(stage: Stage) -> &'static str {
    match stage {
        Stage::Segment => "segment",
        Stage::Charts => "charts",
        Stage::Simplify => "simplify",
        Stage::Measure => "measure",
        Stage::Pack => "pack",
        Stage::Textures => "texels",
    }
}
