//! `doctor`: what this program finds on this machine, and what to do about what is missing.

use crate::cli::DoctorArgs;
use crate::failure::{Failure, blame_machine};
use crate::report::{print_json, print_text};
use pb_bake::memory::{free_bytes, of_machine};
use pb_bake::xatlas::{Found, Helper, HelperFault, wire};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Models that the importers read.
const MESH_FORMATS: [&str; 5] = ["OBJ (with MTL)", "PLY", "STL", "glTF", "GLB"];
/// Images that textures may be in.
const IMAGE_FORMATS: [&str; 7] = ["PNG", "JPEG", "TIFF", "BMP", "TGA", "WebP", "EXR"];

/// What `doctor --json` prints.
#[derive(Serialize)]
struct Findings {
    version: &'static str,
    threads: usize,
    memory: Option<Memory>,
    temp_dir: TempDir,
    xatlas: Xatlas,
    mesh_formats: Vec<&'static str>,
    image_formats: Vec<&'static str>,
}

/// Of the machine, or of the control group that this process is in.
#[derive(Serialize)]
struct Memory {
    total_bytes: u64,
    available_bytes: u64,
}

#[derive(Serialize)]
struct TempDir {
    path: PathBuf,
    free_bytes: Option<u64>,
    /// Why nothing can be written there.
    problem: Option<String>,
}

/// The helper of `--charts xatlas`.
#[derive(Serialize)]
struct Xatlas {
    usable: bool,
    path: Option<PathBuf>,
    found: Option<Found>,
    name: Option<String>,
    xatlas: Option<String>,
    protocol: u16,
    probe_ms: Option<f64>,
    problem: Option<String>,
    advice: Option<String>,
}

/// Looks around. Fails, after it has said everything, where a helper that was named cannot be used.
pub fn doctor(args: &DoctorArgs) -> Result<(), Failure> {
    let (xatlas, asked_for) = look_for_xatlas(args.xatlas_helper.as_deref());
    let broken = xatlas.problem.clone().filter(|_| asked_for);
    let findings = Findings {
        version: env!("CARGO_PKG_VERSION"),
        threads: rayon::current_num_threads(),
        memory: of_machine().map(|(total_bytes, available_bytes)| Memory { total_bytes, available_bytes }),
        temp_dir: temp_dir(),
        xatlas,
        mesh_formats: MESH_FORMATS.to_vec(),
        image_formats: IMAGE_FORMATS.to_vec(),
    };
    if args.json {
        print_json(&findings)?
    } else {
        print_text(&text(&findings))?
    }
    broken.map_or(Ok(()), |problem| Err(blame_machine(problem)))
}

/// What there is, and whether somebody named it.
fn look_for_xatlas(named: Option<&Path>) -> (Xatlas, bool) {
    let mut xatlas = Xatlas {
        usable: false,
        path: None,
        found: None,
        name: None,
        xatlas: None,
        protocol: wire::VERSION,
        probe_ms: None,
        problem: None,
        advice: None,
    };
    let start = Instant::now();
    let helper = Helper::find(named);
    let asked_for = match &helper {
        Ok(helper) => helper.found.asked_for(),
        Err(fault) => matches!(fault, HelperFault::NotThere { .. }),
    };
    let probed = helper.and_then(|helper| {
        (xatlas.path, xatlas.found) = (Some(helper.path.clone()), Some(helper.found));
        helper.probe()
    });
    match probed {
        Ok(identity) => {
            xatlas.usable = true;
            xatlas.probe_ms = Some(start.elapsed().as_secs_f64() * 1e3);
            (xatlas.name, xatlas.xatlas) = (Some(identity.name), Some(identity.xatlas));
        }
        Err(fault) => {
            xatlas.problem = Some(fault.to_string());
            xatlas.advice = Some(advice());
        }
    }
    (xatlas, asked_for)
}

/// The command that puts a helper where this program looks for it.
fn advice() -> String {
    let folder = std::env::current_exe().ok().and_then(|p| p.parent().map(|f| f.display().to_string()));
    let folder = folder.unwrap_or_else(|| "FOLDER-OF-PB-BAKE".into());
    format!("to build it, in the source of pb-bake: tools/xatlas-helper/build '{folder}'")
}

fn temp_dir() -> TempDir {
    let path = std::env::temp_dir();
    let problem = tempfile::tempfile_in(&path).err().map(|e| e.to_string());
    TempDir { free_bytes: free_bytes(&path), path, problem }
}

fn text(findings: &Findings) -> String {
    let mut text = format!("pb-bake {}\nthreads: {}\n", findings.version, findings.threads);
    if let Some(Memory { total_bytes, available_bytes }) = findings.memory {
        let _ = writeln!(text, "memory: {} MiB, {} MiB available", total_bytes >> 20, available_bytes >> 20);
    }
    let room = findings.temp_dir.free_bytes.map_or("unknown room".into(), |b| format!("{} MiB free", b >> 20));
    let problem = findings.temp_dir.problem.as_ref().map_or(String::new(), |p| format!("; not writable: {p}"));
    let _ = writeln!(text, "temporary files: {}: {room}{problem}", findings.temp_dir.path.display());
    let _ = writeln!(text, "meshes: {}", findings.mesh_formats.join(", "));
    let _ = writeln!(text, "images: {}", findings.image_formats.join(", "));
    text + &xatlas_text(&findings.xatlas)
}

fn xatlas_text(xatlas: &Xatlas) -> String {
    let place = match (&xatlas.path, xatlas.found) {
        (Some(path), Some(found)) => format!("{} ({})", path.display(), place_text(found)),
        _ => "not found".into(),
    };
    let mut text = format!("xatlas helper: {place}\n");
    if let (Some(name), Some(xatlas), Some(ms)) = (&xatlas.name, &xatlas.xatlas, xatlas.probe_ms) {
        let _ = writeln!(text, "  {name}, {xatlas}, answered a probe in {ms:.0} ms");
    }
    if let Some(problem) = &xatlas.problem {
        let _ = writeln!(text, "  {problem}\n  only --charts xatlas needs it; the other charts are built in");
    }
    if let Some(advice) = &xatlas.advice {
        let _ = writeln!(text, "  {advice}");
    }
    text
}

fn place_text(found: Found) -> &'static str {
    match found {
        Found::Option => "as --xatlas-helper says",
        Found::Variable => "as PB_XATLAS says",
        Found::BesideProgram => "beside pb-bake",
        Found::SearchPath => "in PATH",
    }
}
