//! The table of docs/performance.md: each level of an archive against its input, beside the meshopt chain.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::chain::chain;
use crate::distance::{Surface, TwoWay};
use crate::mesh::Mesh;

/// What to measure and how.
pub struct Job<'a> {
    pub pb_bake: &'a Path,
    pub archive: &'a Path,
    pub input: &'a Path,
    pub samples: usize,
    pub seed: u64,
}

/// One level.
struct Row {
    level: u64,
    vertices: usize,
    triangles: usize,
    ours: TwoWay,
    meshopt: Option<(usize, TwoWay)>,
    /// The bound that the archive states, input units.
    bound: f64,
}

/// Measures all levels; returns the figures and the same as a table in markdown.
pub fn measure(job: &Job) -> Result<(Value, String)> {
    let inspected: Value =
        serde_json::from_slice(&run(job.pb_bake, &["inspect".as_ref(), job.archive, "--json".as_ref()])?)?;
    let levels = inspected["levels"].as_array().context("inspect --json gives no levels")?;
    let input = Mesh::read(job.input)?.welded();
    let (low, high) = input.bounds();
    let center = std::array::from_fn(|k| low[k].midpoint(high[k]));
    let surface = Surface::new(&input, center)?;
    let exported: Vec<Mesh> = (0..levels.len()).map(|level| export(job, level)).collect::<Result<_>>()?;
    let counts: Vec<usize> = exported[1..].iter().map(|m| m.positions.len()).collect();
    let reference = chain(&input, &counts);
    let mut rows = Vec::new();
    for (level, mesh) in exported.iter().enumerate() {
        let compare = |mesh: &Mesh| -> Result<TwoWay> {
            Ok(Surface::new(mesh, center)?.both_ways(&surface, job.samples, job.seed))
        };
        let meshopt = match level {
            0 => None,
            l => Some((reference[l - 1].mesh.positions.len(), compare(&reference[l - 1].mesh)?)),
        };
        rows.push(Row {
            level: level as u64,
            vertices: mesh.positions.len(),
            triangles: mesh.triangles.len(),
            ours: compare(mesh)?,
            meshopt,
            bound: levels[level]["max_error"].as_f64().context("a level without max_error")?,
        });
    }
    Ok(report(job, &rows, input.diagonal()))
}

fn export(job: &Job, level: usize) -> Result<Mesh> {
    let path = std::env::temp_dir().join(format!("pb-measure-{}-{level}.ply", std::process::id()));
    let number = level.to_string();
    let result = run(job.pb_bake, &["export".as_ref(), job.archive, &path, "--level".as_ref(), number.as_ref()])
        .and_then(|_| Mesh::read(&path));
    let _ = std::fs::remove_file(&path);
    Ok(result?.welded())
}

fn run(program: &Path, arguments: &[&Path]) -> Result<Vec<u8>> {
    let output = Command::new(program)
        .args(arguments)
        .output()
        .with_context(|| format!("{}: does not start; build it or pass --pb-bake", program.display()))?;
    let error = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{} {arguments:?}: {error}", program.display());
    Ok(output.stdout)
}

/// pb-bake beside this program, where a build puts both.
pub fn default_pb_bake() -> PathBuf {
    let beside = std::env::current_exe().ok().and_then(|p| p.parent().map(|d| d.join("pb-bake")));
    beside.unwrap_or_else(|| "pb-bake".into())
}

fn report(job: &Job, rows: &[Row], diagonal: f64) -> (Value, String) {
    let mut table = String::from(
        "| level | vertices | ratio | RMS/diag | max/diag | meshopt RMS | meshopt max | RMS ours/meshopt | max ours/meshopt | bound/sampled max |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    let mut figures = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        let ratio = if i == 0 { 1.0 } else { rows[i - 1].vertices as f64 / row.vertices as f64 };
        let (rms, max) = (row.ours.rms() / diagonal, row.ours.max() / diagonal);
        let slack = row.bound / row.ours.max_but_for_lost_parts();
        table += &format!("| {} | {} | {ratio:.3} | {rms:.2e} | {max:.2e} |", row.level, row.vertices);
        let mut figure = json!({
            "level": row.level, "vertices": row.vertices, "triangles": row.triangles, "ratio": ratio,
            "rms": row.ours.rms(), "max": row.ours.max(), "rms_over_diagonal": rms, "max_over_diagonal": max,
            "level_to_input": one_way(row.ours.a_to_b), "input_to_level": one_way(row.ours.b_to_a),
            "bound": row.bound, "bound_holds": row.bound >= row.ours.max_but_for_lost_parts(),
        });
        match &row.meshopt {
            None => table += &format!(" | | | | {slack:.2} |\n"),
            Some((vertices, theirs)) => {
                let (r, m) = (row.ours.rms() / theirs.rms(), row.ours.max() / theirs.max());
                let (t_rms, t_max) = (theirs.rms() / diagonal, theirs.max() / diagonal);
                table += &format!(" {t_rms:.2e} | {t_max:.2e} | {r:.2} | {m:.2} | {slack:.2} |\n");
                figure["meshopt"] = json!({
                    "vertices": vertices, "rms": theirs.rms(), "max": theirs.max(),
                    "rms_ours_over_meshopt": r, "max_ours_over_meshopt": m,
                });
            }
        }
        figures.push(figure);
    }
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    (json!({ "input": name(job.input), "diagonal": diagonal, "samples": job.samples, "levels": figures }), table)
}

fn one_way(d: crate::distance::OneWay) -> Value {
    json!({ "rms": d.rms, "max": d.max })
}
