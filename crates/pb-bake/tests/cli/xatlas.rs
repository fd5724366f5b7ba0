//! Bakes with `--charts xatlas` and helpers that fail: every bake ends well, and says what happened.

use crate::doctor::Alone;
use crate::harness::{Place, Run};
use pb_bake::xatlas::{Identity, wire};
use std::process::Command;

/// A wavy sheet of 3,200 triangles with texture coordinates, in `sheet.obj`, and its image.
fn textured(place: &Place) {
    let mut text = String::from("mtllib sheet.mtl\nusemtl a\n");
    for line in crate::harness::wave(40).lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[0] {
            "v" => {
                let [x, y] = [1, 2].map(|k: usize| words[k].parse::<f32>().unwrap() / 40.0);
                text += &format!("{line}\nvt {x} {y}\n");
            }
            _ => text += &format!("f {}\n", words[1..].iter().map(|i| format!("{i}/{i} ")).collect::<String>()),
        }
    }
    place.write("sheet.obj", text.as_bytes());
    place.write("sheet.mtl", b"newmtl a\nmap_Kd sheet.png\n");
    image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([x as u8 * 4, y as u8 * 4, 99]))
        .save(place.path("sheet.png"))
        .unwrap();
}

/// A helper that answers the probe and then runs `script`, for each cluster anew.
fn fake(place: &Place, script: &str) -> String {
    let identity = Identity { name: "fake 1".into(), xatlas: "none".into() };
    place.write("probe", &wire::message(wire::Kind::ProbeAnswer, &identity.encode()));
    let path = place.path("fake");
    let folder = place.path(".");
    let text = format!("#!/bin/sh\ncd '{}' || exit 9\nhead -c 16 > /dev/null; cat probe\n{script}\n", folder.display());
    // Another process writes: a file open for writing here cannot be executed from another thread.
    let write = "printf %s \"$1\" > \"$0\" && chmod +x \"$0\"";
    assert!(Command::new("sh").arg("-c").arg(write).arg(&path).arg(text).status().unwrap().success());
    path.to_str().unwrap().into()
}

/// Every cluster has charts of the built-in method, one warning at least says `why`, and the archive is sound.
fn ends_well(place: &Place, run: Run, why: &str) {
    let run = run.succeeds();
    assert!(run.stderr.contains("warning: ") && run.stderr.contains("the built-in method"), "{}", run.stderr);
    assert!(run.stderr.contains(why), "{}", run.stderr);
    let json = run.json();
    let (textures, clusters) = (&json["textures"], json["clusters"].as_u64().unwrap());
    assert!(clusters >= 6, "{clusters} clusters");
    assert_eq!(textures["helper"]["by_fallback"], clusters, "{textures}");
    assert_eq!((&textures["helper"]["by_helper"], &textures["xatlas_clusters"]), (&0.into(), &0.into()));
    assert_eq!(textures["new_chart_clusters"], clusters);
    place.run(&["verify", "sheet.pb"]).succeeds();
}

const BAKE: &[&str] = &["sheet.obj", "sheet.pb", "--levels", "3", "--cluster-triangles", "400"];

fn bake(place: &Place, helper: &str, more: &[&str]) -> Run {
    let with_helper = ["--charts", "xatlas", "--xatlas-helper", helper];
    place.run(&[BAKE, &with_helper, more].concat())
}

#[test]
fn a_bake_ends_well_where_the_helper_fails() {
    let place = Place::new();
    textured(&place);
    for (script, why) in [
        ("head -c 20 > /dev/null; yes nonsense | head -c 100000; exec sleep 60", "xatlas"),
        ("head -c 20 > /dev/null; head -c 10 probe; kill -9 $$", "xatlas"),
        ("exit 3", "xatlas"),
    ] {
        let helper = fake(&place, script);
        ends_well(&place, bake(&place, &helper, &["--json"]), why);
    }
}

#[test]
fn a_bake_ends_well_and_soon_where_the_helper_hangs() {
    let place = Place::new();
    textured(&place);
    let helper = fake(&place, "exec sleep 600");
    ends_well(&place, bake(&place, &helper, &["--json", "--xatlas-time-limit", "0.3"]), "300ms");
}

#[test]
fn a_bake_ends_well_where_there_is_no_helper_or_none_where_it_was_said_to_be() {
    let alone = Alone::new();
    textured(&alone.0);
    let run = alone.pb_bake().args(BAKE).args(["--charts", "xatlas", "--json"]).output().unwrap();
    ends_well(&alone.0, Run::of(run), "pb-xatlas");
    ends_well(&alone.0, bake(&alone.0, "nowhere/pb-xatlas", &["--json"]), "nowhere/pb-xatlas");
    alone.0.write("text", b"no program");
    ends_well(&alone.0, bake(&alone.0, alone.0.path("text").to_str().unwrap(), &["--json"]), "does not start");
    let text = bake(&alone.0, "nowhere/pb-xatlas", &[]).succeeds().stdout;
    assert!(text.contains("xatlas: 0 clusters, the built-in method for "), "{text}");
}
