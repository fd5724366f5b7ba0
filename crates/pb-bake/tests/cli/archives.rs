//! inspect, verify and export, on sound and on damaged archives.

use crate::harness::Place;

#[test]
fn inspect_shows_levels_for_people_and_for_machines() {
    let place = Place::baked();
    let text = place.run(&["inspect", "wave.pb"]).succeeds().stdout;
    assert!(text.contains("rms error") && text.contains("version 1"), "{text}");
    let json = place.run(&["inspect", "wave.pb", "--json"]).succeeds().json();
    assert_eq!(json["format_version"], 1);
    assert_eq!(json["triangles_in"], 3200);
    assert_eq!(json["bytes"], place.read("wave.pb").len());
    assert!(json["clusters"].as_u64().unwrap() >= 8);
    let levels = json["levels"].as_array().unwrap();
    assert_eq!(levels.len(), 3);
    assert_eq!((&levels[0]["level"], &levels[0]["triangles"]), (&0.into(), &3200.into()));
    assert!(levels[2]["max_error"].as_f64() >= levels[2]["rms_error"].as_f64());
}

#[test]
fn verify_finds_a_sound_archive_sound() {
    let place = Place::baked();
    assert!(place.run(&["verify", "wave.pb"]).succeeds().stdout.contains("sound"));
    assert_eq!(place.run(&["verify", "wave.pb", "--quiet"]).succeeds().stdout, "");
}

#[test]
fn export_writes_each_level_in_each_format() {
    let place = Place::baked();
    let json = place.run(&["inspect", "wave.pb", "--json"]).succeeds().json();
    for (level, name) in ["l0.ply", "l1.obj", "l2.glb"].iter().enumerate() {
        let said = place.run(&["export", "wave.pb", name, "--level", &level.to_string()]).succeeds().stdout;
        let l = &json["levels"][level];
        assert_eq!(said, format!("{name}: {} vertices, {} triangles\n", l["vertices"], l["triangles"]));
    }
    // What is exported can be baked again, and level 0 has the input's triangles.
    let again = place.run(&["l0.ply", "again.pb", "--json"]).succeeds().json();
    assert_eq!((&again["triangles_in"], &again["levels"][0]["vertices"]), (&3200.into(), &1681.into()));
}

#[test]
fn export_refuses_levels_and_formats_that_are_not_there() {
    let place = Place::baked();
    place.run(&["export", "wave.pb", "l.ply", "--level", "3"]).fails(2, "levels 0 to 2");
    place.run(&["export", "wave.pb", "l.stl"]).fails(2, ".ply, .obj and .glb");
    place.run(&["export", "wave.pb", "no/l.ply"]).fails(2, "no/l.ply");
    assert_eq!(place.files(), ["wave.obj", "wave.pb"]);
}

#[test]
fn what_is_no_archive_is_refused_by_all() {
    let place = Place::new();
    place.write("empty.pb", b"");
    for (file, what) in [
        ("wave.obj", "not a progressive-buffers archive"),
        ("empty.pb", "not a"),
        ("no.pb", "cannot open"),
        (".", "folder"),
    ] {
        place.run(&["inspect", file]).fails(1, what);
        place.run(&["verify", file]).fails(1, what);
        place.run(&["export", file, "l.ply"]).fails(1, what);
    }
}

#[test]
fn a_cut_archive_is_refused_by_all() {
    let place = Place::baked();
    let bytes = place.read("wave.pb");
    for length in [1, 8, 100, 127, 128, 1000, bytes.len() / 2, bytes.len() - 1] {
        place.write("cut.pb", &bytes[..length]);
        place.run(&["inspect", "cut.pb"]).fails(1, "cut.pb");
        place.run(&["verify", "cut.pb"]).fails(1, "cut.pb");
        place.run(&["export", "cut.pb", "l.ply"]).fails(1, "cut.pb");
    }
    assert!(!place.path("l.ply").exists());
}

#[test]
fn a_flipped_bit_anywhere_is_found_and_its_chunk_named() {
    let place = Place::baked();
    let bytes = place.read("wave.pb");
    for i in 0..40 {
        let at = i * bytes.len() / 40;
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (i % 8);
        place.write("bad.pb", &bad);
        place.run(&["verify", "bad.pb"]).fails(1, "bad.pb");
    }
    let mut bad = bytes.clone();
    bad[130] ^= 1;
    place.write("bad.pb", &bad);
    place.run(&["verify", "bad.pb"]).fails(1, "chunk 2 at byte 128 is damaged");
    place.run(&["export", "bad.pb", "l.ply", "--level", "2"]).fails(1, "chunk 2 at byte 128 is damaged");
    assert!(!place.path("l.ply").exists());
}

#[test]
fn an_unknown_version_is_refused_by_number() {
    let place = Place::baked();
    let mut bytes = place.read("wave.pb");
    bytes[8] = 7;
    place.write("new.pb", &bytes);
    place.run(&["inspect", "new.pb"]).fails(1, "format version 7, but this program reads version 1");
}

#[test]
fn inspect_shows_what_each_stream_costs() {
    let place = Place::baked();
    let run = place.run(&["inspect", "wave.pb", "--streams"]).succeeds();
    assert!(["positions", "normals", "indices", "tables"].iter().all(|n| run.stdout.contains(n)), "{}", run.stdout);
    let json = place.run(&["inspect", "wave.pb", "--streams", "--json"]).succeeds().json();
    let streams = json["streams"]["streams"].as_array().unwrap();
    let sum: u64 = streams.iter().map(|s| s["bytes"].as_u64().unwrap()).sum();
    let (all, tables) = (json["bytes"].as_u64().unwrap(), json["streams"]["tables"].as_u64().unwrap());
    // Each stream is packed alone, so the sum is off by a little.
    assert!((sum + tables).abs_diff(all) * 50 <= all, "{sum} + {tables} of {all}");
    assert!(place.run(&["inspect", "wave.pb", "--json"]).succeeds().json()["streams"].is_null());
}
