//! Bakes that are cut short, and go on.

use super::harness::{Place, Run, wave};
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Shares of a whole, the same ones in every run.
struct Shares(u64);

impl Shares {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }
}

/// Bakes `args`, is killed so many times at any moment, goes on each time, and in the end makes the same bytes as without.
fn killed_anywhere(place: &Place, args: &[&str], kills: usize) {
    let begin = Instant::now();
    place.run(&[args, &["whole.pb", "--quiet"]].concat()).succeeds();
    let (time, whole) = (begin.elapsed(), place.read("whole.pb"));
    let mut shares = Shares(kills as u64);
    let (mut done, mut went_on) = (0, 0);
    while done < kills {
        let command = [args, &["cut.pb", "--json", "--quiet", "--resume"]].concat();
        // Later kills of one bake come sooner: less is left to do.
        let mut left = time.as_secs_f64();
        while done < kills {
            let moment = shares.next() * left;
            let mut child = place.command(&command).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_secs_f64(moment));
            child.kill().unwrap();
            if child.wait().unwrap().success() {
                break;
            }
            assert!(!place.path("cut.pb").exists());
            done += 1;
            left -= moment * 0.8;
        }
        let run = place.run(&command).succeeds();
        went_on += usize::from(!run.json()["resumed"].as_array().unwrap().is_empty());
        assert!(place.read("cut.pb") == whole, "other bytes after {done} kills");
        std::fs::remove_file(place.path("cut.pb")).unwrap();
    }
    assert!(went_on > 0, "no bake found anything to go on from");
    assert!(place.files().iter().all(|name| !name.contains(".job")), "{:?}", place.files());
}

#[test]
fn a_bake_that_is_killed_at_any_moment_goes_on_to_the_same_bytes() {
    let place = Place::new();
    place.write("large.obj", wave(250).as_bytes());
    killed_anywhere(&place, &["large.obj"], 20);
}

#[test]
fn a_bake_with_textures_that_is_killed_at_any_moment_goes_on_to_the_same_bytes() {
    let place = Place::new();
    place.write("image.png", &image());
    place.write("wave.obj", textured(&wave(60), 60).as_bytes());
    let args = ["--texture", "image.png", "--cluster-triangles", "400", "--charts", "auto", "wave.obj"];
    killed_anywhere(&place, &args, 8);
}

/// The same sheet with the image over it.
fn textured(obj: &str, side: usize) -> String {
    let mut text: String = (0..(side + 1) * (side + 1))
        .map(|i| format!("vt {} {}\n", (i % (side + 1)) as f64 / side as f64, (i / (side + 1)) as f64 / side as f64))
        .collect();
    for line in obj.lines() {
        let corner = |w: &str| if line.starts_with('f') && w != "f" { format!("{w}/{w}") } else { w.into() };
        text += &(line.split(' ').map(corner).collect::<Vec<String>>().join(" ") + "\n");
    }
    text
}

fn image() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 512, 512);
    encoder.set_color(png::ColorType::Rgb);
    let texels: Vec<u8> = (0..512u32 * 512 * 3).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    encoder.write_header().unwrap().write_image_data(&texels).unwrap();
    bytes
}

/// A bake that has ended a stage.
fn after_stage(place: &Place, args: &[&str], stage: &str) -> Child {
    let mut child = place.command(args).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.as_mut().unwrap()).lines();
    assert!(lines.any(|l| l.unwrap().contains(stage)));
    child
}

/// A place with the state of a bake that was killed when it had simplified `large.obj`.
fn killed() -> Place {
    let place = Place::new();
    place.write("large.obj", wave(300).as_bytes());
    cut_short(&place);
    place
}

/// Kills a bake of `large.obj` when it has simplified it.
fn cut_short(place: &Place) {
    let mut child = after_stage(place, &["large.obj", "large.pb"], "simplify");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_resumed_bake_does_not_repeat_what_was_done() {
    let place = killed();
    let run = place.run(&["large.obj", "large.pb", "--resume", "--json"]).succeeds();
    let resumed = run.json()["resumed"].to_string();
    assert!(["mesh", "segments", "collapses"].iter().all(|step| resumed.contains(step)), "{resumed}");
    let text = place.run(&["large.obj", "large.pb", "--resume"]).succeeds();
    assert!(text.stderr.contains("cannot resume from .: nothing is there"), "{}", text.stderr);
    assert!(!text.stdout.contains("resumed:"));
}

#[test]
fn a_bake_without_resume_begins_anew_and_nothing_is_left() {
    let place = killed();
    assert!(place.files().iter().any(|name| name.ends_with(".job")), "{:?}", place.files());
    let run = place.run(&["large.obj", "large.pb", "--json"]).succeeds();
    assert_eq!(run.json()["resumed"].as_array().map(Vec::len), Some(0));
    assert_eq!(place.files(), ["large.obj", "large.pb", "wave.obj"]);
}

#[test]
fn what_was_kept_of_another_input_or_other_options_is_not_used() {
    let place = killed();
    place.run(&["large.obj", "new.pb"]).succeeds();
    let run = place.run(&["large.obj", "large.pb", "--resume", "--levels", "4"]).succeeds();
    assert!(run.stderr.contains("it was begun with other options"), "{}", run.stderr);

    let place = killed();
    place.write("large.obj", wave(299).as_bytes());
    let run = place.run(&["large.obj", "large.pb", "--resume"]).succeeds();
    assert!(run.stderr.contains("the input has changed; the bake begins anew"), "{}", run.stderr);
    place.run(&["large.obj", "fresh.pb"]).succeeds();
    assert!(place.read("large.pb") == place.read("fresh.pb"));
}

#[test]
fn what_was_kept_is_not_used_when_a_file_that_the_input_refers_to_has_changed() {
    let place = Place::new();
    place.write("colours.mtl", b"newmtl m\nKd 1 0 0\n");
    place.write("large.obj", format!("mtllib colours.mtl\nusemtl m\n{}", wave(300)).as_bytes());
    cut_short(&place);
    let run = place.run(&["large.obj", "large.pb", "--resume", "--json"]).succeeds();
    assert!(!run.json()["resumed"].as_array().unwrap().is_empty());
    let before = place.read("large.pb");
    std::fs::remove_file(place.path("large.pb")).unwrap();

    cut_short(&place);
    place.write("colours.mtl", b"newmtl m\nKd 0 0.5 1\n");
    let run = place.run(&["large.obj", "large.pb", "--resume"]).succeeds();
    assert!(run.stderr.contains("a file that the input refers to has changed"), "{}", run.stderr);
    place.run(&["large.obj", "fresh.pb"]).succeeds();
    assert!(place.read("large.pb") == place.read("fresh.pb") && place.read("large.pb") != before);
}

#[test]
fn a_damaged_state_is_made_again() {
    let place = killed();
    let folder = place.files().into_iter().find(|name| name.ends_with(".job")).unwrap();
    for step in ["mesh", "collapses"] {
        let name = format!("{folder}/{step}");
        let mut bytes = place.read(&name);
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
        place.write(&name, &bytes);
    }
    let run = place.run(&["large.obj", "large.pb", "--resume", "--json"]).succeeds();
    assert_eq!(run.json()["resumed"].to_string(), "[\"segments\"]");
    place.run(&["large.obj", "fresh.pb"]).succeeds();
    assert!(place.read("large.pb") == place.read("fresh.pb"));
}

#[cfg(unix)]
#[test]
fn an_interrupted_bake_says_how_to_go_on_and_leaves_only_what_that_needs() {
    let place = Place::new();
    place.write("large.obj", wave(300).as_bytes());
    let mut child = after_stage(&place, &["large.obj", "large.pb"], "segment");
    let pid = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let mut said = String::new();
    child.stderr.as_mut().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert!(said.contains("interrupted; what is finished is kept in .") && said.contains("--resume"), "{said}");
    let files = place.files();
    assert_eq!(files.len(), 3, "{files:?}");
    assert!(files[0].ends_with(".job"), "{files:?}");
    let run = place.run(&["large.obj", "large.pb", "--resume"]).succeeds();
    assert!(run.stdout.contains("resumed: mesh, segments were there"), "{}", run.stdout);
    assert_eq!(place.files(), ["large.obj", "large.pb", "wave.obj"]);
}

#[test]
fn two_bakes_of_one_archive_do_not_share_their_state() {
    let place = Place::new();
    place.write("large.obj", wave(300).as_bytes());
    let mut first = after_stage(&place, &["large.obj", "large.pb"], "read");
    let second = Run::of(place.command(&["large.obj", "large.pb", "--resume"]).output().unwrap());
    if first.try_wait().unwrap().is_none() {
        second.fails(2, "large.pb: another pb-bake makes it just now");
    }
    assert!(first.wait().unwrap().success());
}
