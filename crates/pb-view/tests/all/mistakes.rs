//! What goes wrong has a message that says what to do, and the right exit code.

use crate::support::{adapter, folder, pb_view_line, small_torus, write_flight};
use std::path::{Path, PathBuf};

fn one_frame(folder: &Path) -> PathBuf {
    let path = folder.join("one.json");
    write_flight(&path, 1.0, [0.0, 1.0, 0.0], 50.0, &[(0.0, [3.4, 1.5, 2.5], [1.0, 0.0, 0.0])]);
    path
}

/// Runs and expects this exit code and these words on stderr.
fn expect(line: &str, paths: &[&Path], code: i32, words: &[&str]) {
    let run = pb_view_line(line, paths);
    assert_eq!(run.code, code, "{line}: {}", run.stderr);
    assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
    for word in words {
        assert!(run.stderr.contains(word), "{line}: '{word}' is missing in: {}", run.stderr);
    }
}

#[test]
fn a_wrong_command_line_ends_with_2() {
    expect("", &[], 2, &["Usage"]);
    expect("{} --size big", &[small_torus()], 2, &["1280x720"]);
    expect("{} --vram 12parsecs", &[small_torus()], 2, &["KiB, MiB or GiB"]);
    expect("{} --headless --frobnicate", &[small_torus()], 2, &["--frobnicate"]);
}

#[test]
fn a_bad_archive_ends_with_1_and_is_named() {
    let out = folder("bad_archives");
    let write = |name: &str, bytes: &[u8]| {
        let path = out.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let good = std::fs::read(small_torus()).unwrap();
    let mut version = good.clone();
    version[8] ^= 0x40;
    let files = [
        write("empty.pb", b""),
        write("garbage.pb", &[0xa5; 5000]),
        write("cut.pb", &good[..good.len() / 2]),
        write("text.pb", b"o a mesh, not an archive\nv 1 2 3\n"),
        write("version.pb", &version),
    ];
    for file in &files {
        let name = file.file_name().unwrap().to_str().unwrap();
        expect("{} --headless", &[file], 1, &[name]);
    }
    expect("{} --headless", &[&out], 1, &["bad_archives"]);
}

#[test]
fn a_bad_flypath_ends_with_1_and_says_where() {
    let out = folder("bad_flypaths");
    let path = out.join("bad.json");
    std::fs::write(&path, "{\"version\":1,\n\"fps\":60,\n\"fov_deg\":60,\n\"keyframes\":[{]}").unwrap();
    expect("{} --headless --flypath {}", &[small_torus(), &path], 1, &["bad.json:4:"]);
    std::fs::write(&path, r#"{"version":7,"fps":60,"fov_deg":60,"keyframes":[]}"#).unwrap();
    expect("{} --headless --flypath {}", &[small_torus(), &path], 1, &["version 7", "version 1"]);
    let missing = out.join("missing.json");
    expect("{} --headless --flypath {}", &[small_torus(), &missing], 1, &["missing.json"]);
}

#[test]
fn bounds_too_small_for_the_coarsest_level_name_the_size_that_would_do() {
    let Some(_) = adapter("too small bounds") else { return };
    let path = one_frame(&folder("too_small"));
    let line = "{} --headless --flypath {} --vram 1KiB";
    expect(line, &[small_torus(), &path], 2, &["VRAM bound", "raise --vram"]);
    let line = "{} --headless --flypath {} --ram 1KiB";
    expect(line, &[small_torus(), &path], 2, &["RAM bound", "raise"]);
}

#[test]
fn what_cannot_be_written_ends_with_2() {
    let Some(_) = adapter("unwritable targets") else { return };
    let out = folder("unwritable");
    let (path, file) = (one_frame(&out), out.join("file"));
    std::fs::write(&file, "in the way").unwrap();
    let below = file.join("below");
    expect("{} --flypath {} --frames {}", &[small_torus(), &path, &below], 2, &["file/below"]);
    expect("{} --headless --flypath {} --stats {}", &[small_torus(), &path, &below], 2, &["file/below"]);
    expect("{} --flypath {} --export-view 0={}", &[small_torus(), &path, &below], 2, &["file/below"]);
    let line = "{} --flypath {} --export-view 7={}";
    expect(line, &[small_torus(), &path, &below], 2, &["--export-view 7", "0 to 0"]);
}

#[test]
fn without_an_adapter_the_remedy_is_named() {
    let path = one_frame(&folder("no_adapter"));
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_pb-view"))
        .args([small_torus(), "--headless".as_ref(), "--flypath".as_ref(), &path])
        .env("VK_DRIVER_FILES", "/nonexistent.json")
        .env("VK_ICD_FILENAMES", "/nonexistent.json")
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        eprintln!("SKIPPED: the loader finds adapters without these variables: the remedy was not tested");
        return;
    }
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("mesa-vulkan-drivers"), "{stderr}");
}

#[test]
fn without_a_display_the_way_without_a_window_is_named() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_pb-view"))
        .arg(small_torus())
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    if cfg!(not(target_os = "linux")) {
        eprintln!("SKIPPED: only on Linux can a display be taken away: the message was not tested");
        return;
    }
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("--headless") && stderr.contains("DISPLAY"), "{stderr}");
}

#[test]
fn a_damaged_chunk_is_named_once_drawn_coarser_and_ends_with_1() {
    let Some(_) = adapter("damaged chunks") else { return };
    let out = folder("damaged");
    let (path, archive) = (one_frame(&out), out.join("damaged.pb"));
    let mut bytes = std::fs::read(small_torus()).unwrap();
    // Chunks lie coarsest first behind the header, tables at the end: the middle is some fine chunk.
    let middle = bytes.len() * 6 / 10;
    bytes[middle] ^= 0xff;
    std::fs::write(&archive, bytes).unwrap();
    let line = "{} --flypath {} --settle --error-px 0.01 --size 160x120 --frames {} --debug-backfaces --samples 1";
    let run = pb_view_line(line, &[&archive, &path, &out]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let named = run.stderr.lines().filter(|l| l.contains("warning") && l.contains("chunk")).count();
    assert_eq!(named, 1, "{}", run.stderr);
    assert!(run.stderr.contains("Bake the archive again"), "{}", run.stderr);
    let picture = image::open(out.join("frame_00000.png")).unwrap().to_rgb8();
    let magenta = picture.pixels().filter(|p| p.0 == [255, 0, 255]).count();
    assert_eq!(magenta, 0, "the hole of the damaged chunk shows");
}
