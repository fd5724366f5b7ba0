//! Speeds: the whole pb-bake command beside a plain meshopt chain in the same run, and a flight's frame times.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::chain::quarters;
use crate::mesh::Mesh;

/// Bakes `mesh` to a temporary file, process start to exit, and runs the chain on the same mesh.
pub fn bake(pb_bake: &Path, mesh: &Path, steps: u32) -> Result<Value> {
    let archive = std::env::temp_dir().join(format!("pb-measure-{}.pb", std::process::id()));
    let start = Instant::now();
    let run = Command::new(pb_bake).arg(mesh).arg(&archive).args(["--force", "--quiet"]).output();
    let bake_secs = start.elapsed().as_secs_f64();
    let bytes = std::fs::metadata(&archive).map_or(0, |m| m.len());
    let _ = std::fs::remove_file(&archive);
    let output = run.with_context(|| format!("{}: does not start; build it or pass --pb-bake", pb_bake.display()))?;
    ensure!(output.status.success(), "{}: {}", pb_bake.display(), String::from_utf8_lossy(&output.stderr));
    let mesh = Mesh::read(mesh)?;
    let triangles = mesh.triangles.len() as f64;
    let chain_secs = quarters(&mesh.welded(), steps);
    Ok(json!({
        "triangles": triangles, "archive_bytes": bytes, "bytes_per_triangle": bytes as f64 / triangles,
        "bake_secs": bake_secs, "bake_mtri_per_sec": triangles / bake_secs / 1e6,
        "meshopt_chain_secs": chain_secs, "meshopt_chain_mtri_per_sec": triangles / chain_secs / 1e6,
    }))
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
