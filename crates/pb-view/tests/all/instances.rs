//! Archives with instances: the same pictures as with all of them as geometry, each chunk in memory once.

use crate::reference::{Look, Reference};
use crate::support::{
    adapter, camera, column, crowd, crowd_written_out, folder, pb_view_line, read_frame, write_flight,
};
use pb_render::Samples;
use pb_view::flypath::Flypath;
use std::path::{Path, PathBuf};

/// Five frames: close to a small instance, among them, and from far away.
fn flight(folder: &Path) -> PathBuf {
    let path = folder.join("flight.json");
    let keys = [
        (0.0, [5.4, 1.0, 6.2], [4.5, 0.5, 5.0]),
        (1.0, [12.0, 6.0, 12.0], [0.0, 0.0, 0.0]),
        (2.0, [-25.0, 30.0, 40.0], [0.0, 0.0, -10.0]),
    ];
    write_flight(&path, 2.0, [0.0, 1.0, 0.0], 50.0, &keys);
    path
}

/// Pixels that differ by more than `by` in some channel.
fn pixels_apart(a: &image::RgbImage, b: &image::RgbImage, by: u8) -> usize {
    let apart = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > by);
    a.pixels().zip(b.pixels()).filter(|pair| apart(*pair)).count()
}

/// Frames of an archive along the flight.
fn frames(name: &str, archive: &Path, more: &str) -> PathBuf {
    let out = folder(name);
    let line = format!("{{}} --flypath {{}} --settle --size 320x240 --frames {{}} --stats {{}} {more}");
    let run = pb_view_line(&line, &[archive, &flight(&out), &out, &out.join("stats.csv")]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    out
}

#[test]
fn at_a_tiny_error_instances_are_drawn_as_their_full_meshes_where_they_stand() {
    let Some(gpu) = adapter("instances against plain meshes") else { return };
    let out = frames("crowd_full_detail", crowd(), "--error-px 0.001 --samples 1");
    let flight = Flypath::open(&out.join("flight.json")).unwrap();
    let mut reference = Reference::new(&gpu, crowd(), [320, 240], Samples::One);
    for frame in 0..flight.frames() {
        let full = reference.picture(&camera(&flight.at(flight.time(frame))), Look::Shaded);
        let full = image::RgbaImage::from_raw(320, 240, full).unwrap();
        let full = image::DynamicImage::ImageRgba8(full).to_rgb8();
        let apart = pixels_apart(&full, &read_frame(&out, frame), 8);
        assert!(apart < 40, "frame {frame}: {apart} pixels differ");
    }
}

#[test]
fn pictures_of_instances_are_those_of_the_same_geometry_written_out() {
    let Some(_) = adapter("instances against geometry") else { return };
    // Levels of the two bakes differ, so that their silhouettes may by the error that they may show.
    for (error, by, most) in [("0.01", 12, 150), ("1", 40, 700)] {
        let more = format!("--error-px {error}");
        let kept = frames(&format!("crowd_kept_{error}"), crowd(), &more);
        let written = frames(&format!("crowd_written_out_{error}"), crowd_written_out(), &more);
        for frame in 0..5 {
            let apart = pixels_apart(&read_frame(&kept, frame), &read_frame(&written, frame), by);
            assert!(apart < most, "error {error}, frame {frame}: {apart} pixels differ");
        }
    }
}

#[test]
fn instances_share_their_chunks_in_video_memory() {
    let Some(_) = adapter("memory of instances") else { return };
    let bytes = |archive: &Path, name: &str| {
        let out = frames(name, archive, "--error-px 0.001");
        column(&out.join("stats.csv"), "vram_bytes").into_iter().fold(0.0, f64::max)
    };
    let (kept, written) = (bytes(crowd(), "crowd_vram"), bytes(crowd_written_out(), "crowd_written_out_vram"));
    assert!(kept < 0.65 * written, "{kept} of {written} bytes");
}

#[test]
fn instances_are_drawn_the_same_by_one_indirect_call_and_by_plain_draws() {
    let Some(_) = adapter("draws of instances") else { return };
    let (one, plain) = (frames("crowd_one", crowd(), ""), frames("crowd_plain", crowd(), "--plain-draws"));
    (0..5).for_each(|frame| assert!(read_frame(&one, frame) == read_frame(&plain, frame), "frame {frame}"));
}
