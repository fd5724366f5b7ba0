//! Rendered frames of a closed model show no hole: inside the silhouette there is neither background nor a side
//! that looks away. The silhouette is that of the full mesh, drawn by the plainest pipeline.

use crate::reference::Reference;
use crate::support::{adapter, camera, column, folder, pb_view, read_frame, text, torus, write_flight};
use pb_render::{BACKGROUND_SRGB, Samples};
use pb_view::flypath::Flypath;
use std::path::Path;

const SIZE: [u32; 2] = [480, 360];
const MAGENTA: [u8; 3] = [255, 0, 255];

/// From far to near, over the hole and away: 41 frames, none inside the model.
fn flight(path: &Path) {
    let keys = [
        (0.0, [0.0, 30.0, 60.0], [0.0; 3]),
        (1.0, [6.0, 4.0, 5.0], [0.0; 3]),
        (2.0, [3.0, 1.3, 2.4], [1.0, 0.0, 0.0]),
        (3.0, [0.0, 1.8, 0.5], [3.0, 0.0, -1.0]),
        (4.0, [-1.0, 3.0, -9.0], [0.0, 0.2, 0.0]),
    ];
    write_flight(path, 10.0, [0.0, 1.0, 0.0], 55.0, &keys);
}

/// True for pixels whose whole neighbourhood of `r` pixels shows the model's front in the full mesh's picture.
fn inside(picture: &[u8], r: i32) -> Vec<bool> {
    let [w, h] = SIZE.map(|s| s as i32);
    let covered: Vec<bool> = picture.chunks_exact(4).map(|p| p[..3] != BACKGROUND_SRGB && p[..3] != MAGENTA).collect();
    let at = |x: i32, y: i32| covered[(y.clamp(0, h - 1) * w + x.clamp(0, w - 1)) as usize];
    let rows: Vec<bool> =
        (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| (-r..=r).all(|d| at(x + d, y))).collect();
    let row_at = |x: i32, y: i32| rows[(y.clamp(0, h - 1) * w + x) as usize];
    (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| (-r..=r).all(|d| row_at(x, y + d))).collect()
}

fn check(name: &str, more: &[&str]) {
    let Some(gpu) = adapter(name) else { return };
    let out = folder(name);
    let (path, stats) = (out.join("flight.json"), out.join("stats.csv"));
    flight(&path);
    let size = format!("{}x{}", SIZE[0], SIZE[1]);
    let (archive, path_text, out_text, stats_text) = (text(torus()), text(&path), text(&out), text(&stats));
    let mut words =
        vec![archive.as_str(), "--headless", "--debug-backfaces", "--samples", "1", "--flypath", &path_text];
    words.extend(["--frames", &out_text, "--stats", &stats_text, "--size", &size]);
    words.extend(more);
    let run = pb_view(&words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let flight = Flypath::open(&path).unwrap();
    let errors = column(&stats, "error_px");
    let mut reference = Reference::new(&gpu, torus(), SIZE, Samples::One);
    let mut judged = 0;
    for frame in 0..flight.frames() {
        let full = reference.picture(&camera(&flight.at(flight.time(frame))), true);
        let frame_picture = read_frame(&out, frame);
        let inside = inside(&full, errors[frame as usize].ceil() as i32 + 2);
        for (i, pixel) in frame_picture.pixels().enumerate().filter(|(i, _)| inside[*i]) {
            let hole = pixel.0 == BACKGROUND_SRGB || pixel.0 == MAGENTA;
            let (x, y) = (i % SIZE[0] as usize, i / SIZE[0] as usize);
            assert!(!hole, "{}: frame {frame}, pixel ({x}, {y}) is {:?}", out.display(), pixel.0);
            judged += 1;
        }
    }
    assert!(judged > 1_000_000, "only {judged} pixels lie inside the silhouette");
}

#[test]
fn settled_frames_of_a_closed_model_show_no_hole() {
    check("cracks_settled", &["--settle"]);
}

#[test]
fn frames_with_large_errors_show_no_hole() {
    check("cracks_coarse", &["--settle", "--error-px", "4"]);
}

#[test]
fn frames_with_late_data_and_little_vram_show_no_hole() {
    check("cracks_late", &["--vram", "700KiB", "--ram", "1MiB"]);
}

#[test]
fn frames_with_bands_show_no_hole() {
    check("cracks_bands", &["--settle", "--band", "0.7,0.2"]);
}
