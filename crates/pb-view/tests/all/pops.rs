//! Nothing pops: on a slow flight neighbouring frames differ hardly more than those of the full mesh.

use crate::reference::{Look, Reference};
use crate::support::{adapter, camera, column, folder, hilly, pb_view, read_frame, text, write_flight};
use pb_render::Samples;
use pb_view::flypath::Flypath;
use std::path::{Path, PathBuf};

const SIZE: [u32; 2] = [120, 90];
/// Camera distance between two frames, over the one before; less than 0.2 %.
const STEP: f64 = 0.9981;
/// From where the picture is full of hills to near: all levels.
const FAR: f64 = 2.4;
const NEAR: f64 = 0.25;

fn flight(path: &Path) -> Flypath {
    let steps_per_key = 20;
    let keys = (FAR / NEAR).ln() / -STEP.ln() / steps_per_key as f64;
    let keys: Vec<_> = (0..=keys.ceil() as u32)
        .map(|i| {
            let height = FAR * STEP.powi((i * steps_per_key) as i32);
            ((i * steps_per_key) as f64 / 60.0, [0.02, height, 0.01], [0.02, 0.0, 0.01])
        })
        .collect();
    write_flight(path, 60.0, [0.0, 0.7, -0.7], 30.0, &keys);
    Flypath::open(path).unwrap()
}

/// Flies it with the program; the folder of the frames.
fn fly(name: &str, more: &[&str]) -> PathBuf {
    let out = folder(name);
    let path = out.join("flight.json");
    flight(&path);
    let stats = out.join("stats.csv");
    let size = format!("{}x{}", SIZE[0], SIZE[1]);
    let (archive, path, frames, stats) = (text(hilly()), text(&path), text(&out), text(&stats));
    let mut words = vec![
        archive.as_str(),
        "--error-px",
        "2",
        "--flypath",
        &path,
        "--frames",
        &frames,
        "--stats",
        &stats,
        "--size",
        &size,
    ];
    words.extend(more);
    let run = pb_view(&words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    out
}

fn largest_change(a: &[u8], b: &[u8]) -> u8 {
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

/// Largest change of a pixel between neighbouring frames of a flight of the program.
fn change(folder: &Path, frames: u32) -> u8 {
    let pictures: Vec<Vec<u8>> = (0..frames).map(|f| read_frame(folder, f).into_raw()).collect();
    pictures.windows(2).map(|p| largest_change(&p[0], &p[1])).max().unwrap_or(0)
}

#[test]
fn late_data_and_level_changes_are_as_smooth_as_the_full_mesh_and_only_because_of_the_morph() {
    let Some(gpu) = adapter("pops on a slow flight") else { return };
    let late = fly("pops_late", &["--late-frames", "450"]);
    let settled = fly("pops_settled", &["--settle"]);
    let jumping = fly("pops_jumping", &["--settle", "--no-morph"]);
    let path = flight(&late.join("flight.json"));
    let mut reference = Reference::new(&gpu, hilly(), SIZE, Samples::Four);
    let full: Vec<Vec<u8>> =
        (0..path.frames()).map(|f| reference.picture(&camera(&path.at(path.time(f))), Look::Shaded)).collect();
    let full = full.windows(2).map(|p| largest_change(&p[0], &p[1])).max().unwrap_or(0);
    let missing = column(&late.join("stats.csv"), "missing_chunks").iter().filter(|m| **m > 0.0).count();
    assert!(missing > 100, "data was late in only {missing} frames");
    let [late, settled, jumping] = [late, settled, jumping].map(|f| change(&f, path.frames()));
    println!("full mesh {full}, late data {late}, settled {settled}, without the morph {jumping}");
    assert!(full > 0);
    let limit = full as f64 * 1.5;
    assert!(late as f64 <= limit, "late data: {late}, full mesh: {full}");
    assert!(settled as f64 <= limit, "settled: {settled}, full mesh: {full}");
    assert!(jumping as f64 > limit, "this test has to fail without the morph: {jumping}, full mesh: {full}");
}
