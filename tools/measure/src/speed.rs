//! Speeds: the whole pb-bake command beside a plain meshopt chain in the same run, and a flight's frame times.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::chain::quarters;
use crate::mesh::Mesh;

/// Times that each bake runs; the fastest counts. The first one after a while pays for memory that the host of a virtual
/// machine took back meanwhile, up to a quarter of its time.
const RUNS: usize = 2;

/// Bakes `mesh` to a temporary file, process start to exit, with all threads and with one, and runs the chain on the same mesh.
pub fn bake(pb_bake: &Path, mesh: &Path, steps: u32) -> Result<Value> {
    let threads = std::thread::available_parallelism()?.get();
    let (seconds, summary) = fastest(pb_bake, mesh, threads)?;
    let (alone, _) = fastest(pb_bake, mesh, 1)?;
    let mesh = Mesh::read(mesh)?;
    let triangles = mesh.triangles.len() as f64;
    let chain_secs = quarters(&mesh.welded(), steps);
    Ok(json!({
        "triangles": triangles, "bytes_per_triangle": summary["bytes_per_input_triangle"],
        "peak_memory_bytes": summary["peak_memory_bytes"], "spilled_bytes": summary["spilled_bytes"],
        "threads": threads, "runs": RUNS, "bake_secs": seconds, "bake_mtri_per_sec": triangles / seconds / 1e6,
        "bake_secs_one_thread": alone, "parallel_efficiency": alone / seconds / threads as f64,
        "stages": summary["stages"],
        "meshopt_chain_secs": chain_secs, "meshopt_chain_mtri_per_sec": triangles / chain_secs / 1e6,
    }))
}

/// The same as rows of a table; the first one of several names the columns.
pub fn bake_row(found: &Value, name: &str, first: bool) -> String {
    let number = |key: &str| found[key].as_f64().unwrap_or(f64::NAN);
    let stages: Vec<(&str, f64)> = found["stages"].as_array().into_iter().flatten().filter_map(stage).collect();
    let mut text = String::new();
    if first {
        let names: Vec<&str> = stages.iter().map(|s| s.0).collect();
        text += "| mesh | M triangles | seconds | M/s | one thread, s | efficiency | peak, MiB | bytes per triangle | ";
        text += &format!("{} | meshopt chain, s | M/s |\n|---|", names.join(" | "));
        text += &"---|".repeat(9 + names.len());
        text.push('\n');
    }
    let seconds: Vec<String> = stages.iter().map(|s| format!("{:.2}", s.1)).collect();
    text + &format!(
        "| {name} | {:.2} | {:.2} | {:.3} | {:.2} | {:.2} | {:.0} | {:.2} | {} | {:.2} | {:.3} |",
        number("triangles") / 1e6,
        number("bake_secs"),
        number("bake_mtri_per_sec"),
        number("bake_secs_one_thread"),
        number("parallel_efficiency"),
        number("peak_memory_bytes") / f64::from(1 << 20),
        number("bytes_per_triangle"),
        seconds.join(" | "),
        number("meshopt_chain_secs"),
        number("meshopt_chain_mtri_per_sec"),
    )
}

fn stage(stage: &Value) -> Option<(&str, f64)> {
    Some((stage["name"].as_str()?, stage["seconds"].as_f64()?))
}

fn fastest(pb_bake: &Path, mesh: &Path, threads: usize) -> Result<(f64, Value)> {
    let mut runs = (0..RUNS).map(|_| timed(pb_bake, mesh, threads)).collect::<Result<Vec<_>>>()?;
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(runs.swap_remove(0))
}

/// Seconds of a bake, and what it says of itself.
fn timed(pb_bake: &Path, mesh: &Path, threads: usize) -> Result<(f64, Value)> {
    let archive = std::env::temp_dir().join(format!("pb-measure-{}.pb", std::process::id()));
    let start = Instant::now();
    let mut command = Command::new(pb_bake);
    command.arg(mesh).arg(&archive).args(["--force", "--quiet", "--json", "--threads", &threads.to_string()]);
    let run = command.output();
    let seconds = start.elapsed().as_secs_f64();
    let _ = std::fs::remove_file(&archive);
    let output = run.with_context(|| format!("{}: does not start; build it or pass --pb-bake", pb_bake.display()))?;
    ensure!(output.status.success(), "{}: {}", pb_bake.display(), String::from_utf8_lossy(&output.stderr));
    Ok((seconds, serde_json::from_slice(&output.stdout).context("the summary of a bake is JSON")?))
}

/// Median, 95th percentile and maximum of every column of a --stats file.
pub fn stats(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().context("the file is empty")?.split(',').collect();
    let rows: Vec<Vec<f64>> = lines
        .map(|line| line.split(',').map(|w| w.parse::<f64>()).collect::<Result<_, _>>())
        .collect::<Result<_, _>>()
        .with_context(|| format!("{}: not a table of numbers", path.display()))?;
    ensure!(!rows.is_empty() && rows.iter().all(|r| r.len() == names.len()), "{}: no full rows", path.display());
    let mut out = json!({ "frames": rows.len() });
    for (column, name) in names.iter().enumerate().filter(|(_, n)| !["frame", "t_secs"].contains(*n)) {
        let mut values: Vec<f64> = rows.iter().map(|r| r[column]).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
        out[*name] = json!({ "median": at(0.5), "p95": at(0.95), "max": at(1.0) });
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_flight_are_order_statistics() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "frame,t_secs,frame_ms\n0,0,5\n1,0.1,1\n2,0.2,9\n").unwrap();
        let found = stats(file.path()).unwrap();
        assert_eq!(found["frame_ms"], json!({ "median": 5.0, "p95": 9.0, "max": 9.0 }));
        std::fs::write(file.path(), "frame,t_secs,frame_ms\n0,0,x\n").unwrap();
        assert!(stats(file.path()).is_err());
    }
}
