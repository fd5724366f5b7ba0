//! The product beside the reference on one textured model: bake, fly near, close and far, compare.
//!
//! Two figures per view: FLIP between pb-view's frames and the exact ones, and the same for what an adapter makes of the
//! full images with plain trilinear filtering, which says how much of the former is filtering and no loss.

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::compare::{Part, compare, means};
use crate::flights::{Kind, flight};
use crate::reference::scene::Scene;
use crate::reference::{COVERAGE, Filter, Options, cover_with, frames, parse_size};

/// The heading of the table that [`row`] continues.
pub const HEADING: &str = "\
| model | triangles | source texels | archive bytes | tile texels | bytes per texel | bake s | FLIP near | close | far \
| FLIP on the model near | close | far | the same, full images | | | MAE on the model near | close | far | \
silhouette off, px |
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

/// The views of the table, in its order.
const VIEWS: [(&str, Kind); 3] = [("near", Kind::Near), ("close", Kind::Close), ("far", Kind::Far)];
/// Bounds that no model of the fixtures touches: quality is judged, not streaming.
const BOUNDS: [&str; 4] = ["--vram", "4GiB", "--ram", "4GiB"];

#[derive(clap::Args)]
pub struct Arguments {
    /// The source: .obj, .gltf or .glb.
    model: PathBuf,
    /// Its name in the table; else that of its folder.
    #[arg(long)]
    name: Option<String>,
    /// Folder for archive, flypaths, frames and pictures side by side.
    #[arg(long)]
    out: PathBuf,
    #[arg(long, default_value = "640x360", value_parser = parse_size)]
    size: [usize; 2],
    /// An image for all materials that have none, for pb-bake too.
    #[arg(long)]
    texture: Option<PathBuf>,
    /// Options for pb-bake, separated by blanks.
    #[arg(long, default_value = "", allow_hyphen_values = true)]
    bake_options: String,
    /// Options for pb-view, separated by blanks.
    #[arg(long, default_value = "", allow_hyphen_values = true)]
    view_options: String,
    /// Folder of pb-bake and pb-view; else that of this program.
    #[arg(long)]
    programs: Option<PathBuf>,
    /// Print a row of the table of docs/performance.md instead of JSON.
    #[arg(long)]
    markdown: bool,
}

/// Prints what was found.
pub fn run(arguments: &Arguments) -> Result<()> {
    let name = arguments.name.clone().unwrap_or_else(|| {
        let folder = arguments.model.parent().and_then(Path::file_name);
        folder.map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    });
    let figures = measure(arguments, &name).with_context(|| name.clone())?;
    match arguments.markdown {
        true => println!("{}", row(&name, &figures)),
        false => println!("{figures:#}"),
    }
    Ok(())
}

fn measure(arguments: &Arguments, name: &str) -> Result<Value> {
    let out = arguments.out.join(name);
    std::fs::create_dir_all(&out).with_context(|| format!("{}: cannot be made", out.display()))?;
    let archive = out.join("model.pb");
    let bake = bake(arguments, &archive)?;
    let mut scene = Scene::read(&arguments.model)?;
    if let Some(texture) = &arguments.texture {
        cover_with(&mut scene, texture)?;
    }
    let mut views = serde_json::Map::new();
    for (view, kind) in VIEWS {
        let path = out.join(format!("{view}.json"));
        let flight = flight(&scene, kind, arguments.size, 1)?;
        flight.write(&path)?;
        let folder = |what: &str| out.join(format!("{view}-{what}"));
        fly(arguments, &archive, &path, &folder("view"))?;
        for (filter, what) in [(Filter::Exact, "exact"), (Filter::Trilinear, "trilinear")] {
            let options = Options { size: arguments.size, filter, grid: None };
            frames(&mut scene, &flight, &options, &folder(what))?;
        }
        let ours = compare_folders(&folder("exact"), &folder("view"), Some(&folder("pictures")))?;
        let plain = compare_folders(&folder("exact"), &folder("trilinear"), None)?;
        let beside = compare_folders(&folder("trilinear"), &folder("view"), None)?;
        let off = silhouette_off(&folder("exact").join(COVERAGE), &folder("view"))?;
        let figures = json!({
            "ours": ours, "full_images": plain, "ours_against_full_images": beside, "silhouette_off_px": off,
        });
        views.insert(view.into(), figures);
    }
    Ok(json!({
        "triangles": scene.triangles.len(), "source_texels": scene.texels(), "bake": bake, "views": views,
    }))
}

fn program(arguments: &Arguments, name: &str) -> PathBuf {
    let beside = std::env::current_exe().ok().and_then(|p| p.parent().map(Path::to_owned));
    arguments.programs.clone().or(beside).unwrap_or_default().join(name)
}

fn finished(command: &mut Command) -> Result<Vec<u8>> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.output().with_context(|| format!("{name}: does not start; build it"))?;
    ensure!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr).trim());
    Ok(output.stdout)
}

/// What pb-bake says of itself.
fn bake(arguments: &Arguments, archive: &Path) -> Result<Value> {
    let mut command = Command::new(program(arguments, "pb-bake"));
    command.arg(&arguments.model).arg(archive).args(["--force", "--json"]);
    if let Some(texture) = &arguments.texture {
        command.arg("--texture").arg(texture);
    }
    let text = finished(command.args(arguments.bake_options.split_whitespace()))?;
    serde_json::from_slice(&text).context("pb-bake --json does not print JSON")
}

fn fly(arguments: &Arguments, archive: &Path, flypath: &Path, frames: &Path) -> Result<()> {
    let [width, height] = arguments.size;
    let mut command = Command::new(program(arguments, "pb-view"));
    command.arg(archive).args(["--headless", "--settle", "--unlit"]).args(BOUNDS);
    command.arg("--size").arg(format!("{width}x{height}"));
    command.arg("--flypath").arg(flypath).arg("--frames").arg(frames);
    finished(command.args(arguments.view_options.split_whitespace())).map(|_| ())
}

fn compare_folders(a: &Path, b: &Path, pictures: Option<&Path>) -> Result<Value> {
    let frames = compare(a, b, nv_flip::DEFAULT_PIXELS_PER_DEGREE, pictures)?;
    let part = |p: &Part| json!({ "flip": p.flip, "mae": p.mae, "psnr_db": p.psnr() });
    let [all, covered, inside] = means(&frames);
    let worst = frames.iter().map(|f| f.covered.flip).fold(0.0, f64::max);
    Ok(json!({
        "all": part(&all), "covered": part(&covered), "inside": part(&inside), "worst_frame_covered_flip": worst,
    }))
}

/// Pixels that one of the two covers fully and the other not at all.
fn silhouette_off(coverage: &Path, view: &Path) -> Result<u64> {
    let mut off = 0;
    for name in crate::compare::frames_of(coverage)? {
        let mask = image::open(coverage.join(&name))?.to_luma8();
        let shown = image::open(view.join(&name)).with_context(|| format!("{}: no frame", name.display()))?.to_rgb8();
        let background = shown.pixels().map(|p| p.0 == crate::reference::BACKGROUND);
        off += mask.pixels().zip(background).filter(|(m, b)| (m.0[0] == 255 && *b) || (m.0[0] == 0 && !*b)).count();
    }
    Ok(off as u64)
}

/// One line of the table; what pb-bake does not say is a dash.
fn row(name: &str, figures: &Value) -> String {
    let bake = &figures["bake"];
    let texels = bake.pointer("/textures/tile_texels").and_then(Value::as_f64);
    let bytes = bake.pointer("/textures/tile_bytes").and_then(Value::as_f64);
    let ratio = texels.zip(bytes).filter(|(t, _)| *t > 0.0).map_or("–".into(), |(t, b)| format!("{:.2}", b / t));
    let of = |pointer: &str, digits: usize| {
        let one = |(view, _): (&str, Kind)| {
            let value = figures["views"][view].pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
            format!("{value:.digits$}")
        };
        VIEWS.map(one).join(" | ")
    };
    let off: u64 = VIEWS.iter().filter_map(|(v, _)| figures["views"][*v]["silhouette_off_px"].as_u64()).sum();
    format!(
        "| {name} | {} | {} | {} | {} | {ratio} | {:.2} | {} | {} | {} | {} | {off} |",
        figures["triangles"],
        figures["source_texels"],
        bake["bytes"],
        texels.map_or("–".into(), |t| format!("{t}")),
        bake["seconds"].as_f64().unwrap_or(f64::NAN),
        of("/ours/all/flip", 4),
        of("/ours/covered/flip", 4),
        of("/full_images/covered/flip", 4),
        of("/ours/covered/mae", 2),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_a_cell_for_each_heading() {
        let part = json!({ "all": { "flip": 0.01, "mae": 1.0 }, "covered": { "flip": 0.02, "mae": 2.0 } });
        let view = json!({ "ours": part, "full_images": part, "silhouette_off_px": 1 });
        let figures = json!({
            "triangles": 7, "source_texels": 9, "views": { "near": view, "close": view, "far": view },
            "bake": { "bytes": 5, "seconds": 0.5, "textures": { "tile_texels": 100, "tile_bytes": 140 } },
        });
        let row = row("a", &figures);
        let cells = |line: &str| line.matches('|').count();
        assert!(HEADING.lines().all(|line| cells(line) == cells(&row)), "{row}");
        assert!(row.contains("| 1.40 | 0.50 | 0.0100 |") && row.ends_with("| 3 |"), "{row}");
    }
}
