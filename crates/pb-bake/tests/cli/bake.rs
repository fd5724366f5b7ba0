//! Baking: summaries, targets, interruptions.

use crate::harness::{Place, Run, wave};
use std::io::{BufRead, BufReader};
use std::process::Stdio;

#[test]
fn a_bake_ends_with_its_archive_and_a_summary() {
    let place = Place::new();
    let run = place.run(&["wave.obj", "wave.pb"]).succeeds();
    assert_eq!(place.files(), ["wave.obj", "wave.pb"]);
    for word in ["level", "acmr", "rms error", "polygons triangulated", "time:", "bytes per input triangle"] {
        assert!(run.stdout.contains(word), "{word}: {}", run.stdout);
    }
    assert!(run.stderr.contains("simplify"), "plain lines of progress: {}", run.stderr);
}

#[test]
fn quiet_says_nothing() {
    let run = Place::new().run(&["wave.obj", "wave.pb", "--quiet"]).succeeds();
    assert_eq!((run.stdout.as_str(), run.stderr.as_str()), ("", ""));
}

#[test]
fn json_is_one_object_with_the_figures_of_the_summary() {
    let place = Place::new();
    let json = place.run(&["wave.obj", "wave.pb", "--json", "--quiet", "--levels", "3"]).succeeds().json();
    assert_eq!(json["triangles_in"], 3200);
    assert_eq!(json["levels"].as_array().unwrap().len(), 3);
    assert_eq!(json["levels"][0]["vertices"], 41 * 41);
    assert_eq!(json["bytes"], place.read("wave.pb").len());
    assert_eq!(json["repairs"]["polygons_triangulated"], 1600);
    let stages: Vec<&str> = json["stages"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(stages, ["read", "repair", "segment", "simplify", "measure", "pack", "write"]);
}

#[test]
fn the_same_input_gives_the_same_bytes_on_one_and_on_many_threads() {
    let place = Place::new();
    for (name, threads) in [("a.pb", "1"), ("b.pb", "4"), ("c.pb", "4")] {
        place.run(&["wave.obj", name, "--threads", threads, "--cluster-triangles", "200"]).succeeds();
    }
    assert!(place.read("a.pb") == place.read("b.pb") && place.read("b.pb") == place.read("c.pb"));
}

#[test]
fn several_inputs_make_one_scene() {
    let place = Place::new();
    let shifted = wave(40).replace("v ", "v 1");
    place.write("other.obj", shifted.as_bytes());
    let json = place.run(&["wave.obj", "other.obj", "both.pb", "--json"]).succeeds().json();
    assert_eq!(json["triangles_in"], 6400);
    assert_eq!(json["inputs"].as_array().unwrap().len(), 2);
}

#[test]
fn an_archive_is_replaced_and_another_file_only_by_force() {
    let place = Place::baked();
    place.run(&["wave.obj", "wave.pb", "--levels", "2"]).succeeds();
    place.write("notes.txt", b"mine");
    place.run(&["wave.obj", "notes.txt"]).fails(2, "--force");
    assert_eq!(place.read("notes.txt"), b"mine");
    place.run(&["wave.obj", "notes.txt", "--force"]).succeeds();
    place.run(&["verify", "notes.txt"]).succeeds();
}

#[test]
fn targets_that_cannot_be_written_are_refused_before_the_input_is_read() {
    let place = Place::new();
    // The input does not exist either, but the target is looked at first.
    place.run(&["no.obj", "."]).fails(2, "is a folder");
    place.run(&["no.obj", "no/such/folder/out.pb"]).fails(2, "folder does not exist");
    if cfg!(target_os = "linux") {
        place.run(&["no.obj", "/sys/out.pb"]).fails(2, "cannot write in its folder");
        place.run(&["no.obj", "/dev/null", "--force"]).fails(2, "device");
    }
}

#[test]
fn an_input_is_never_the_target() {
    let place = Place::new();
    place.run(&["wave.obj", "wave.obj", "--force"]).fails(2, "last argument names the archive");
    place.run(&["wave.obj", "forgotten.obj"]).fails(2, "last argument names the archive");
    assert_eq!(place.read("wave.obj"), wave(40).as_bytes());
}

#[test]
fn an_input_at_fault_exits_with_1_and_leaves_nothing() {
    let place = Place::new();
    place.write("empty.obj", b"");
    place.write("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    place.write("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
    place.write("garbage.ply", &[0x9c; 300]);
    for input in ["empty.obj", "nan.obj", "index.obj", "garbage.ply", "missing.obj", "."] {
        place.run(&[input, "out.pb"]).fails(1, "pb-bake: ");
        assert!(!place.path("out.pb").exists(), "{input}");
    }
    assert_eq!(place.files().len(), 5, "no temporary file is left: {:?}", place.files());
}

#[test]
fn a_failed_bake_leaves_the_old_archive() {
    let place = Place::baked();
    let before = place.read("wave.pb");
    place.write("empty.obj", b"");
    place.run(&["empty.obj", "wave.pb"]).fails(1, "empty.obj");
    assert!(place.read("wave.pb") == before);
}

#[test]
fn usage_errors_exit_with_2_and_name_the_argument() {
    let place = Place::new();
    for (args, what) in [
        (&[][..], "Usage"),
        (&["wave.obj"], "OUT.pb"),
        (&["wave.obj", "o.pb", "--levels", "0"], "--levels"),
        (&["wave.obj", "o.pb", "--levels", "13"], "--levels"),
        (&["wave.obj", "o.pb", "--ratio", "1"], "--ratio"),
        (&["wave.obj", "o.pb", "--ratio", "nan"], "--ratio"),
        (&["wave.obj", "o.pb", "--cluster-triangles", "3"], "--cluster-triangles"),
        (&["wave.obj", "o.pb", "--threads", "0"], "--threads"),
        (&["wave.obj", "o.pb", "--weld-tolerance=-1"], "--weld-tolerance"),
        (&["wave.obj", "o.pb", "--crease-angle", "200"], "--crease-angle"),
        (&["wave.obj", "o.pb", "--normals", "up"], "--normals"),
        (&["wave.obj", "o.pb", "--no-such-option"], "--no-such-option"),
        (&["export", "o.pb"], "OUT"),
    ] {
        place.run(args).fails(2, what);
    }
    assert_eq!(place.files(), ["wave.obj"]);
}

#[test]
fn help_and_version_are_there() {
    let place = Place::new();
    for word in ["Examples:", "Exit codes:", "--cluster-triangles", "inspect", "verify", "export"] {
        assert!(place.run(&["--help"]).succeeds().stdout.contains(word), "{word}");
    }
    assert!(place.run(&["--version"]).succeeds().stdout.starts_with("pb-bake "));
}

#[test]
fn a_killed_bake_leaves_nothing_under_the_targets_name() {
    let place = Place::new();
    place.write("large.obj", wave(300).as_bytes());
    let mut child =
        place.command(&["large.obj", "large.pb"]).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    // The line at the end of a stage: the bake is in its middle.
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    assert!(lines.any(|l| l.unwrap().contains("segment")));
    assert!(!place.path("large.pb").exists());
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    assert!(!place.path("large.pb").exists());
}

#[cfg(unix)]
#[test]
fn a_full_disk_is_the_machines_fault_and_leaves_nothing() {
    let place = Place::new();
    let script = "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\"";
    let mut command = std::process::Command::new("sh");
    command.args(["-c", script, env!("CARGO_BIN_EXE_pb-bake"), "wave.obj", "wave.pb"]).current_dir(place.path("."));
    Run::of(command.output().unwrap()).fails(2, "chunks cannot be kept");
    assert_eq!(place.files(), ["wave.obj"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_bake_that_does_not_fit_its_memory_spills_and_gives_the_same_bytes() {
    let place = Place::new();
    place.write("large.ply", &large_ply(1000));
    let free = place.run(&["large.ply", "a.pb", "--json", "--quiet", "--memory", "16GiB"]).succeeds().json();
    let bound = place.run(&["large.ply", "b.pb", "--json", "--quiet", "--memory", "256MiB"]).succeeds().json();
    assert!(place.read("a.pb") == place.read("b.pb"));
    assert_eq!((free["spilled_bytes"].as_u64(), bound["memory_bound_bytes"].as_u64()), (Some(0), Some(256 << 20)));
    assert!(bound["spilled_bytes"].as_u64() > Some(50 << 20), "{}", bound["spilled_bytes"]);
    assert!(bound["peak_memory_bytes"].as_u64() < free["peak_memory_bytes"].as_u64());
    assert_eq!(place.files(), ["a.pb", "b.pb", "large.ply", "wave.obj"], "nothing is left");
}

/// `2 * side * side` triangles as a binary PLY.
#[cfg(target_os = "linux")]
fn large_ply(side: u32) -> Vec<u8> {
    let (vertices, faces) = ((side + 1) * (side + 1), 2 * side * side);
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\nelement face {faces}\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    .into_bytes();
    for (x, y) in (0..vertices).map(|i| ((i % (side + 1)) as f32, (i / (side + 1)) as f32)) {
        let point = [x, y, (x / 9.0).sin() * (y / 7.0).cos() * 5.0];
        point.iter().for_each(|c| bytes.extend(c.to_le_bytes()));
    }
    for a in (0..side * side).map(|i| i / side * (side + 1) + i % side) {
        for t in [[a, a + 1, a + side + 2], [a, a + side + 2, a + side + 1]] {
            bytes.push(3);
            t.iter().for_each(|i| bytes.extend(i.to_le_bytes()));
        }
    }
    bytes
}

#[test]
fn memory_that_is_too_little_or_no_size_is_a_usage_error() {
    let place = Place::new();
    place.run(&["wave.obj", "wave.pb", "--memory", "1MiB"]).fails(2, "at least 256MiB");
    place.run(&["wave.obj", "wave.pb", "--memory", "much"]).fails(2, "for example 4GiB");
}

#[test]
fn what_a_killed_bake_left_is_removed_by_the_next_one() {
    let place = Place::new();
    place.write(".pb-bake-killed.tmp", b"half an archive");
    place.write(".pb-bake-notes.txt", b"mine");
    place.run(&["wave.obj", "wave.pb"]).succeeds();
    assert_eq!(place.files(), [".pb-bake-notes.txt", "wave.obj", "wave.pb"]);
}
