//! Headless flights from outside: frames, statistics, bounds, and the same pictures on every run.

use crate::reference::{Look, Reference};
use crate::support::{
    FAR, adapter, camera, column, far_torus, folder, pb_view_line, read_frame, small_torus, torus, write_flight,
};
use pb_render::Samples;
use pb_view::flypath::Flypath;
use std::path::{Path, PathBuf};

/// Five frames from near to far around a torus at `center`; the flypath's file.
fn flight(folder: &Path, center: [f64; 3]) -> PathBuf {
    let path = folder.join("flight.json");
    let at = |p: [f64; 3]| std::array::from_fn(|k| p[k] + center[k]);
    let keys = [
        (0.0, at([3.4, 1.5, 2.5]), at([1.0, 0.0, 0.0])),
        (1.0, at([7.0, 4.0, 5.0]), at([0.0; 3])),
        (2.0, at([-20.0, 30.0, 9.0]), at([0.0; 3])),
    ];
    write_flight(&path, 2.0, [0.0, 1.0, 0.0], 50.0, &keys);
    path
}

#[test]
fn nobody_has_to_read_the_summary() {
    let Some(_) = adapter("a closed standard output") else { return };
    let path = flight(&folder("closed_output"), [0.0; 3]);
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_pb-view"));
    command.arg(small_torus()).args(["--headless", "--size", "32x32", "--flypath"]).arg(path);
    command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
    let mut child = command.spawn().unwrap();
    drop(child.stdout.take());
    let run = child.wait_with_output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

fn pixels_apart(a: &image::RgbImage, b: &image::RgbImage, by: u8) -> usize {
    let apart = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > by);
    a.pixels().zip(b.pixels()).filter(|pair| apart(*pair)).count()
}

#[test]
fn the_default_flight_draws_301_frames_and_their_statistics() {
    let Some(_) = adapter("the default flight") else { return };
    let out = folder("default_flight");
    let stats = out.join("stats.csv");
    let line = "{} --headless --size 160x90 --stats {} --frames {}";
    let run = pb_view_line(line, &[small_torus(), &stats, &out]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("301 frames"), "{}", run.stdout);
    let csv = std::fs::read_to_string(&stats).unwrap();
    assert!(csv.starts_with("frame,t_secs,frame_ms,triangles,draws,vram_bytes,ram_bytes,missing_chunks,error_px"));
    assert_eq!(column(&stats, "frame").len(), 301);
    assert!(column(&stats, "t_secs").windows(2).all(|t| (t[1] - t[0] - 1.0 / 30.0).abs() < 1e-5));
    assert_eq!(read_frame(&out, 300).dimensions(), (160, 90));
}

#[test]
fn settled_frames_are_the_same_on_every_run_and_with_plain_draws() {
    let Some(_) = adapter("settled frames twice") else { return };
    let out = folder("settled");
    let path = flight(&out, [0.0; 3]);
    let folders = ["a", "b", "c"].map(|name| folder("settled").join(name));
    for (folder, more) in folders.iter().zip(["", "", "--plain-draws"]) {
        let line = format!("{{}} --flypath {{}} --settle --size 320x240 --frames {{}} {more}");
        let run = pb_view_line(&line, &[torus(), &path, folder]);
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    for frame in 0..5 {
        let [a, b, c] = [0, 1, 2].map(|i| read_frame(&folders[i], frame));
        assert!(a == b, "frame {frame} differs between two runs");
        assert!(a == c, "frame {frame} differs between one indirect call and plain draws");
    }
}

#[test]
fn at_a_tiny_error_the_picture_is_that_of_the_full_mesh() {
    let Some(gpu) = adapter("full detail against the plain mesh") else { return };
    let out = folder("full_detail");
    let path = flight(&out, [0.0; 3]);
    let line = "{} --flypath {} --settle --error-px 0.001 --size 320x240 --samples 1 --frames {}";
    assert_eq!(pb_view_line(line, &[torus(), &path, &out]).code, 0);
    let mut reference = Reference::new(&gpu, torus(), [320, 240], Samples::One);
    let flight = Flypath::open(&path).unwrap();
    for frame in 0..flight.frames() {
        let full = reference.picture(&camera(&flight.at(flight.time(frame))), Look::Shaded);
        let rgb: Vec<u8> = full.chunks_exact(4).flat_map(|p| &p[..3]).copied().collect();
        let full = image::RgbImage::from_raw(320, 240, rgb).unwrap();
        let apart = pixels_apart(&full, &read_frame(&out, frame), 3);
        assert!(apart < 60, "frame {frame}: {apart} of 76800 pixels are not as in the full mesh");
    }
}

#[test]
fn a_model_far_from_the_origin_looks_like_one_near_it() {
    let Some(_) = adapter("UTM coordinates") else { return };
    let folders = ["near", "far"].map(|name| folder("utm").join(name));
    for (folder, (archive, center)) in folders.iter().zip([(small_torus(), [0.0; 3]), (far_torus(), FAR)]) {
        std::fs::create_dir_all(folder).unwrap();
        let path = flight(folder, center);
        let line = "{} --flypath {} --settle --error-px 0.001 --size 320x240 --samples 1 --frames {}";
        let run = pb_view_line(line, &[archive, &path, folder]);
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    for frame in 0..5 {
        let apart = pixels_apart(&read_frame(&folders[0], frame), &read_frame(&folders[1], frame), 8);
        assert!(apart < 120, "frame {frame}: {apart} of 76800 pixels differ");
    }
}

#[test]
fn bounds_coarsen_the_picture_and_are_never_exceeded() {
    let Some(_) = adapter("byte bounds") else { return };
    let out = folder("bounds");
    let path = flight(&out, [0.0; 3]);
    let mut errors = Vec::new();
    for (vram_kib, ram_kib) in [(4096, 4096), (500, 400), (200, 100)] {
        for settle in ["", "--settle"] {
            let stats = out.join("stats.csv");
            let line = format!(
                "{{}} --headless --flypath {{}} --size 320x240 --vram {vram_kib}KiB --ram {ram_kib}KiB \
                 --error-px 0.5 --stats {{}} {settle}"
            );
            let run = pb_view_line(&line, &[torus(), &path, &stats]);
            assert_eq!(run.code, 0, "{}", run.stderr);
            let most = |name: &str| column(&stats, name).into_iter().fold(0.0, f64::max);
            assert!(most("vram_bytes") <= vram_kib as f64 * 1024.0);
            assert!(most("ram_bytes") <= ram_kib as f64 * 1024.0);
            if !settle.is_empty() {
                errors.push(most("error_px"));
            }
        }
    }
    assert!((errors[0] - 0.5).abs() < 0.01 && errors[1] > errors[0] && errors[2] > errors[1], "{errors:?}");
}

#[test]
fn exr_frames_hold_the_linear_light_of_png_frames() {
    let Some(_) = adapter("EXR frames") else { return };
    let out = folder("exr");
    let path = flight(&out, [0.0; 3]);
    for format in ["png", "exr"] {
        let line = format!("{{}} --flypath {{}} --settle --size 161x90 --format {format} --frames {{}}");
        assert_eq!(pb_view_line(&line, &[small_torus(), &path, &out]).code, 0);
    }
    let png = read_frame(&out, 1);
    let exr = exr::prelude::read_first_rgba_layer_from_file(
        out.join("frame_00001.exr"),
        |size, _| (size.width(), vec![[0.0f32; 3]; size.width() * size.height()]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
    );
    let (width, pixels) = exr.unwrap().layer_data.channel_data.pixels;
    assert_eq!((width, pixels.len()), (161, 161 * 90));
    let encode = |v: f32| if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    for (a, b) in png.pixels().zip(&pixels) {
        for (a, b) in a.0.iter().zip(b) {
            assert!((*a as f32 - encode(*b) * 255.0).abs() < 1.6, "{a} {b}");
        }
    }
}

/// On Mesa's software driver a loop in a shader that a uniform bounds costs 0.3 MiB with each frame: 70 MiB here.
#[test]
fn a_long_flight_holds_no_more_memory_than_a_short_one() {
    let Some(_) = adapter("memory of a long flight") else { return };
    let out = folder("long_flight");
    let (path, stats) = (out.join("flight.json"), out.join("stats.csv"));
    let near = |t: f64| (t, [3.4, 1.5 + 0.1 * t, 2.5], [1.0, 0.0, 0.0]);
    write_flight(&path, 60.0, [0.0, 1.0, 0.0], 50.0, &[near(0.0), near(2.0), near(4.0), near(5.0)]);
    let line = "{} --headless --flypath {} --size 64x36 --stats {}";
    let run = pb_view_line(line, &[small_torus(), &path, &stats]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let draws = column(&stats, "draws").into_iter().zip(column(&stats, "coarse_draws"));
    assert!(draws.skip(100).all(|(all, coarse)| all > coarse), "finer levels are drawn, too");
    let held = column(&stats, "rss_private_bytes");
    if held[0] == 0.0 {
        eprintln!("SKIPPED: this system does not say how much memory a program holds");
        return;
    }
    let grown = held[300] - held[100];
    assert!(grown < 8.0 * 1048576.0, "{grown} bytes more after 200 frames");
}
