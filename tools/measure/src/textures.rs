//! The product beside the reference on one textured model: bake, fly near, close and far, compare.
//!
//! Two figures per view: FLIP between pb-view's frames and the exact ones, and the same for what an adapter makes of the
//! full images with plain trilinear filtering, which says how much of the former is filtering and no loss.

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::compare::{Part, compare, means, means_of_places};
use crate::flights::{Kind, flight};
use crate::reference::scene::Scene;
use crate::reference::{COVERAGE, Filter, Options, cover_with, frames, parse_size};
use crate::seams::{Borders, PLACES};

/// The heading of the table of docs/performance.md that [`row`] continues.
pub const HEADING: &str = "\
| model | triangles | source, M texels | tiles, M texels | bytes per texel | FLIP near / close / far | on the model \
| the same, full images | MAE inside / at charts / at clusters | the same, full images |
|---|---|---|---|---|---|---|---|---|---|";

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
    let borders = borders(arguments, &archive, &bake)?;
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
        if let Some(borders) = &borders {
            borders.write(&flight, arguments.size, &folder("exact").join(PLACES))?;
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

/// The charts and clusters of an archive with textures.
fn borders(arguments: &Arguments, archive: &Path, bake: &Value) -> Result<Option<Borders>> {
    if bake.pointer("/textures/tile_texels").and_then(Value::as_u64).unwrap_or(0) == 0 {
        return Ok(None);
    }
    let exported = archive.with_extension("glb");
    finished(
        Command::new(program(arguments, "pb-bake")).arg("export").arg(archive).arg(&exported).args(["--level", "0"]),
    )?;
    let borders = Borders::read(&exported)?;
    std::fs::remove_file(&exported).with_context(|| format!("{}: cannot be removed", exported.display()))?;
    Ok(Some(borders))
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
    let places = means_of_places(&frames).map(|p| json!({ "pixels": p.pixels, "mae": p.mae, "flip": p.flip }));
    let worst = frames.iter().map(|f| f.covered.flip).fold(0.0, f64::max);
    Ok(json!({
        "all": part(&all), "covered": part(&covered), "inside": part(&inside), "worst_frame_covered_flip": worst,
        "inside_charts": places[0], "at_charts": places[1], "at_clusters": places[2],
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
    let textures = |what: &str| figures["bake"]["textures"][what].as_f64().filter(|x| *x > 0.0);
    let (texels, bytes) = (textures("tile_texels"), textures("tile_bytes"));
    let shown = |x: Option<f64>| x.map_or("–".into(), |x| format!("{x:.2}"));
    let of = |pointer: &str| {
        let one = |(view, _): (&str, Kind)| figures["views"][view].pointer(pointer).and_then(Value::as_f64);
        VIEWS.map(one).map(|x| x.map_or("–".into(), |x| format!("{x:.4}"))).join(" / ")
    };
    let million = |x: f64| x / 1e6;
    format!(
        "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
        figures["triangles"],
        shown(figures["source_texels"].as_f64().map(million)),
        shown(texels.map(million)),
        shown(texels.zip(bytes).map(|(t, b)| b / t)),
        of("/ours/all/flip"),
        of("/ours/covered/flip"),
        of("/full_images/covered/flip"),
        places(figures, "ours"),
        places(figures, "full_images"),
    )
}

/// Mean absolute errors inside charts, at charts' and at clusters' borders, over the pixels of all views.
fn places(figures: &Value, whose: &str) -> String {
    let one = |place: &str| {
        let of = |view: &str, what: &str| figures["views"][view][whose][place][what].as_f64().unwrap_or(0.0);
        let pixels: f64 = VIEWS.iter().map(|(v, _)| of(v, "pixels")).sum();
        let sum: f64 = VIEWS.iter().map(|(v, _)| of(v, "pixels") * of(v, "mae")).sum();
        if pixels > 0.0 { format!("{:.2}", sum / pixels) } else { "–".into() }
    };
    ["inside_charts", "at_charts", "at_clusters"].map(one).join(" / ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_a_cell_for_each_heading() {
        let part = json!({
            "all": { "flip": 0.01 }, "covered": { "flip": 0.02 },
            "inside_charts": { "pixels": 9, "mae": 1.0 }, "at_charts": { "pixels": 0, "mae": 0.0 },
        });
        let view = json!({ "ours": part, "full_images": part, "silhouette_off_px": 1 });
        let figures = json!({
            "triangles": 7, "source_texels": 9, "views": { "near": view, "close": view, "far": view },
            "bake": { "bytes": 5, "seconds": 0.5, "textures": { "tile_texels": 100, "tile_bytes": 140 } },
        });
        let row = row("a", &figures);
        let cells = |line: &str| line.matches('|').count();
        assert!(HEADING.lines().all(|line| cells(line) == cells(&row)), "{row}");
        assert!(row.contains("| 0.00 | 1.40 | 0.0100 / 0.0100 / 0.0100 |"), "{row}");
        assert!(row.ends_with("| 1.00 / – / – | 1.00 / – / – |"), "{row}");
    }
}
