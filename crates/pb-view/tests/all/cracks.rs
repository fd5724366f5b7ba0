//! Rendered frames of a closed model show no hole: inside the silhouette there is neither background nor a side
//! that looks away. The silhouette is that of the full mesh, drawn by the plainest pipeline.

use crate::reference::{Look, Reference};
use crate::support::{adapter, camera, column, crowd, folder, pb_view, read_frame, scan, text, torus, write_flight};
use pb_lod::progressive_buffers::model::Model;
use pb_render::{BACKGROUND_SRGB, Samples};
use pb_view::flypath::Flypath;
use pb_view::streaming::subject;
use std::path::Path;

const SIZE: [u32; 2] = [480, 360];
const MAGENTA: [u8; 3] = [255, 0, 255];
/// Colours that differ by no more from the background's say nothing about holes.
const LIKE_BACKGROUND: u8 = 16;

/// From far to near, over the hole and away: 41 frames, none inside the torus.
fn torus_flight(path: &Path) {
    let keys = [
        (0.0, [0.0, 30.0, 60.0], [0.0; 3]),
        (1.0, [6.0, 4.0, 5.0], [0.0; 3]),
        (2.0, [3.0, 1.3, 2.4], [1.0, 0.0, 0.0]),
        (3.0, [0.0, 1.8, 0.5], [3.0, 0.0, -1.0]),
        (4.0, [-1.0, 3.0, -9.0], [0.0, 0.2, 0.0]),
    ];
    write_flight(path, 10.0, [0.0, 1.0, 0.0], 55.0, &keys);
}

/// Around a model outside its sphere, in steps that differ in distance: 25 frames.
fn orbit(archive: &Path, path: &Path) {
    let model = Model::open(archive).unwrap();
    let subject = subject(&model, glam::DVec3::Y);
    let key = |i: u32| {
        let (sin, cos) = (i as f64 * 0.8).sin_cos();
        let distance = subject.radius * if i.is_multiple_of(2) { 1.3 } else { 3.0 };
        let eye = subject.center + glam::DVec3::new(cos, 0.5 * (i as f64).sin(), sin).normalize() * distance;
        (i as f64, eye.to_array(), subject.center.to_array())
    };
    write_flight(path, 3.0, [0.0, 1.0, 0.0], 55.0, &(0..=8).map(key).collect::<Vec<_>>());
}

/// Grey levels of nearness between two pixels that show neither one surface nor a gentle slope.
const JUMP: u8 = 6;

/// True for pixels in whose neighbourhood of `r` pixels the full mesh shows its front and no contour: at a contour
/// a level with an error of some pixels may show what lies behind it. What lies outside of the picture may be one.
fn inside(picture: &[u8], nearness: &[u8], r: i32) -> Vec<bool> {
    let [w, h] = SIZE.map(|s| s as i32);
    let all = || (0..h).flat_map(move |y| (0..w).map(move |x| (x, y)));
    let index = |x: i32, y: i32| (y.clamp(0, h - 1) * w + x.clamp(0, w - 1)) as usize;
    let near = |x: i32, y: i32| nearness[index(x, y) * 4];
    let smooth = |x: i32, y: i32| near(x, y).abs_diff(near(x + 1, y)).max(near(x, y).abs_diff(near(x, y + 1))) < JUMP;
    // A surface may have the background's colour by chance, there or a little further in the frame that is judged.
    let front = |x: i32, y: i32| {
        let pixel = &picture[index(x, y) * 4..][..3];
        let off = |c: [u8; 3]| pixel.iter().zip(c).map(|(&a, b)| a.abs_diff(b)).max().unwrap_or(0);
        off(BACKGROUND_SRGB) > LIKE_BACKGROUND && pixel != MAGENTA
    };
    let good: Vec<bool> = all().map(|(x, y)| front(x, y) && smooth(x, y)).collect();
    let whole = |at: i32, end: i32| (r..end - r).contains(&at);
    let rows: Vec<bool> = all().map(|(x, y)| whole(x, w) && (-r..=r).all(|d| good[index(x + d, y)])).collect();
    all().map(|(x, y)| whole(y, h) && (-r..=r).all(|d| rows[index(x, y + d)])).collect()
}

fn check_torus(name: &str, more: &[&str]) {
    let path = folder(name).join("flight.json");
    torus_flight(&path);
    check(name, torus(), &path, more);
}

fn check(name: &str, archive: &Path, path: &Path, more: &[&str]) {
    let Some(gpu) = adapter(name) else { return };
    let out = folder(name);
    let stats = out.join("stats.csv");
    let size = format!("{}x{}", SIZE[0], SIZE[1]);
    let (archive_text, path_text, out_text, stats_text) = (text(archive), text(path), text(&out), text(&stats));
    let mut words =
        vec![archive_text.as_str(), "--headless", "--debug-backfaces", "--samples", "1", "--flypath", &path_text];
    words.extend(["--frames", &out_text, "--stats", &stats_text, "--size", &size]);
    words.extend(more);
    let run = pb_view(&words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let flight = Flypath::open(path).unwrap();
    let errors = column(&stats, "error_px");
    let mut reference = Reference::new(&gpu, archive, SIZE, Samples::One);
    let (mut judged, least) = (0, flight.frames() * 4000);
    for frame in 0..flight.frames() {
        let camera = camera(&flight.at(flight.time(frame)));
        let full = reference.picture(&camera, Look::BackFaces);
        let nearness = reference.picture(&camera, Look::Nearness);
        let frame_picture = read_frame(&out, frame);
        let inside = inside(&full, &nearness, errors[frame as usize].ceil() as i32 + 2);
        for (i, pixel) in frame_picture.pixels().enumerate().filter(|(i, _)| inside[*i]) {
            let hole = pixel.0 == BACKGROUND_SRGB || pixel.0 == MAGENTA;
            let (x, y) = (i % SIZE[0] as usize, i / SIZE[0] as usize);
            assert!(!hole, "{}: frame {frame}, pixel ({x}, {y}) is {:?}", out.display(), pixel.0);
            judged += 1;
        }
    }
    assert!(judged > least, "only {judged} pixels lie inside the silhouette");
}

#[test]
fn settled_frames_of_a_closed_model_show_no_hole() {
    check_torus("cracks_settled", &["--settle"]);
}

#[test]
fn frames_with_large_errors_show_no_hole() {
    check_torus("cracks_coarse", &["--settle", "--error-px", "4"]);
}

#[test]
fn frames_with_late_data_and_little_vram_show_no_hole() {
    check_torus("cracks_late", &["--vram", "700KiB", "--ram", "1MiB"]);
}

#[test]
fn frames_of_an_archive_four_times_as_large_as_its_bounds_show_no_hole() {
    let size = std::fs::metadata(torus()).unwrap().len();
    assert!(size > 4 * (180 + 90) * 1024, "{size}");
    check_torus("cracks_tight", &["--vram", "180KiB", "--ram", "90KiB", "--error-px", "0.1"]);
}

#[test]
fn frames_with_bands_show_no_hole() {
    check_torus("cracks_bands", &["--settle", "--band", "0.7,0.2"]);
}

#[test]
fn frames_of_a_closed_scan_show_no_hole() {
    let name = "cracks_hammer";
    let Some(archive) = scan(name, "scan_hammer/hammer.obj") else { return };
    let path = folder(name).join("flight.json");
    orbit(&archive, &path);
    check(name, &archive, &path, &["--settle", "--error-px", "2"]);
    check(name, &archive, &path, &["--vram", "300KiB", "--late-frames", "2"]);
}

#[test]
fn frames_of_closed_instances_show_no_hole() {
    let path = folder("cracks_crowd").join("flight.json");
    let keys = [
        (0.0, [5.4, 1.0, 6.2], [4.5, 0.5, 5.0]),
        (1.0, [12.0, 6.0, 12.0], [0.0, 0.0, 0.0]),
        (2.0, [-25.0, 30.0, 40.0], [0.0, 0.0, -10.0]),
    ];
    write_flight(&path, 5.0, [0.0, 1.0, 0.0], 50.0, &keys);
    check("cracks_crowd", crowd(), &path, &["--vram", "600KiB", "--ram", "600KiB"]);
}
