//! Bad luck while flying: archives that are cut, replaced or written over, and slow disks.

use crate::support::{Run, adapter, column, folder, pb_view_line, small_torus, text, torus, write_flight};
use glam::DVec3;
use pb_lod::plan::{ChunkId, Detail};
use pb_stream::disk::DiskModel;
use pb_view::feed::{DiskClock, Feed, Loaded};
use pb_view::flypath::Keyframe;
use pb_view::streaming::{Adapter, Bounds, Moment, Streaming, VramCosts, model_tables, open_model};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A second far away, then a long way close to the surface, at 25 frames per second.
fn flight(folder: &Path) -> PathBuf {
    let path = folder.join("flight.json");
    let far = [(0.0, [0.0, 900.0, 800.0], [0.0; 3]), (1.0, [0.0, 910.0, 800.0], [0.0; 3])];
    let near = (0..=6).map(|i| {
        let a = i as f64 * 0.6;
        (1.4 + i as f64 * 0.25, [4.3 * a.cos(), 0.8, -4.3 * a.sin()], [3.0 * a.cos(), 0.0, -3.0 * a.sin()])
    });
    let keys: Vec<_> = far.into_iter().chain(near).collect();
    write_flight(&path, 25.0, [0.0, 1.0, 0.0], 50.0, &keys);
    path
}

/// Flies with a copy of the torus; after the first frame `meddle` does something to the file.
fn fly_while(name: &str, meddle: impl Fn(&Path)) -> Run {
    let out = folder(name);
    let _ = std::fs::remove_dir_all(out.join("frames"));
    let (archive, path) = (out.join("copy.pb"), flight(&out));
    std::fs::copy(torus(), &archive).unwrap();
    let first = out.join("frames/frame_00000.png");
    let mut command = Command::new(env!("CARGO_BIN_EXE_pb-view"));
    let line =
        format!("{} --flypath {} --size 64x64 --error-px 0.1 --no-prefetch --frames", text(&archive), text(&path));
    command.args(line.split(' ')).arg(out.join("frames")).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    while !first.exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    meddle(&archive);
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let code =
        output.status.code().unwrap_or_else(|| panic!("a signal ended the program: {}: {stderr}", output.status));
    assert!(out.join("frames/frame_00070.png").exists(), "the flight did not go on: {stderr}");
    Run { code, stdout: String::from_utf8_lossy(&output.stdout).into_owned(), stderr }
}

/// Each chunk that is missing is named once.
fn named(run: &Run) -> usize {
    let mut lines: Vec<&str> = run.stderr.lines().filter(|l| l.contains("stays at level")).collect();
    let all = lines.len();
    lines.sort_unstable();
    lines.dedup();
    assert_eq!(lines.len(), all, "{}", run.stderr);
    all
}

#[test]
fn an_archive_that_is_cut_in_flight_leaves_the_picture_coarser() {
    let Some(_) = adapter("an archive cut in flight") else { return };
    let run = fly_while("cut", |archive| {
        let file = std::fs::File::options().write(true).open(archive).unwrap();
        file.set_len(file.metadata().unwrap().len() / 3).unwrap();
    });
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(named(&run) > 3 && run.stderr.contains("cut while it was open"), "{}", run.stderr);
    let all_gone = fly_while("emptied", |archive| drop(std::fs::File::create(archive).unwrap()));
    assert_eq!(all_gone.code, 1, "{}", all_gone.stderr);
    assert!(named(&all_gone) > 3 && all_gone.stderr.contains("only 0 now"), "{}", all_gone.stderr);
}

#[test]
fn an_archive_that_is_replaced_in_flight_is_flown_through_as_it_was() {
    let Some(_) = adapter("an archive replaced in flight") else { return };
    let run = fly_while("replaced", |archive| {
        let other = archive.with_extension("other");
        std::fs::write(&other, "something else").unwrap();
        std::fs::rename(other, archive).unwrap();
    });
    assert_eq!((run.code, named(&run)), (0, 0), "{}", run.stderr);
}

#[test]
fn an_archive_that_is_written_over_in_flight_leaves_the_picture_coarser() {
    let Some(_) = adapter("an archive written over in flight") else { return };
    let run = fly_while("written_over", |archive| {
        use std::io::Write;
        let mut file = std::fs::File::options().write(true).open(archive).unwrap();
        file.write_all(&vec![0x5a; file.metadata().unwrap().len() as usize]).unwrap();
    });
    assert_eq!(run.code, 1, "{}", run.stderr);
    assert!(named(&run) > 3 && run.stderr.contains("checksum"), "{}", run.stderr);
}

/// Missing chunks per frame of a flight with these words.
fn missing(name: &str, more: &str) -> Vec<f64> {
    let out = folder(name);
    let stats = out.join("stats.csv");
    let line = format!("{{}} --flypath {{}} --size 64x64 --error-px 0.1 --stats {{}} {more}");
    let run = pb_view_line(&line, &[torus(), &flight(&out), &stats]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    column(&stats, "missing_chunks")
}

fn sum(all: &[f64]) -> f64 {
    all.iter().sum()
}

#[test]
fn a_slow_disk_is_the_same_in_every_run_and_slower_than_a_fast_one() {
    let Some(_) = adapter("slow disks") else { return };
    let slow = missing("slow_disk", "--disk-model 60,1 --no-prefetch");
    assert_eq!(slow, missing("slow_disk_again", "--disk-model 60,1 --no-prefetch"));
    let fast = missing("fast_disk", "--disk-model 0.1,5000 --no-prefetch");
    assert!(sum(&slow) > 2.0 * sum(&fast), "{} and {}", sum(&slow), sum(&fast));
    // A settled frame waits for any disk.
    assert_eq!(sum(&missing("slow_disk_settled", "--disk-model 60,1 --no-prefetch --settle")), 0.0);
}

/// The paper's figure 8. Without an adapter, so that it runs everywhere.
#[test]
fn with_prefetching_nothing_is_missing_and_little_is_read_in_vain() {
    let flown = |name: &str, more: &str| {
        let counts = missing(name, &format!("--no-draw --disk-model 8,20 {more}"));
        let bytes = |column_name| sum(&column(&folder(name).join("stats.csv"), column_name));
        (sum(&counts), bytes("disk_bytes") / bytes("needed_bytes") - 1.0)
    };
    let [off, motion, path] =
        [("on_demand", "--no-prefetch"), ("by_motion", "--lookahead 0"), ("by_path", "--lookahead 2")]
            .map(|(name, more)| flown(name, more));
    println!("chunks missing, and part read in vain: {off:?}, by motion {motion:?}, by the path {path:?}");
    assert!(off.0 > 50.0 && motion.0 < 0.5 * off.0, "{off:?} {motion:?}");
    assert_eq!(path.0, 0.0);
    assert!(motion.1 < 0.3 && path.1 < 0.1, "{motion:?} {path:?}");
}

#[test]
fn a_bound_on_triangles_below_the_coarsest_level_is_told_at_the_start() {
    let run = |most: &str| pb_view_line(&format!("{{}} --no-draw --max-triangles {most}"), &[small_torus()]);
    let (few, many) = (run("10"), run("100000"));
    assert!(few.code == 0 && few.stderr.contains("the coarsest level has"), "{}", few.stderr);
    assert!(many.code == 0 && many.stderr.is_empty(), "{}", many.stderr);
}

#[test]
fn without_drawing_the_same_is_loaded() {
    let Some(_) = adapter("flights without drawing") else { return };
    let drawn = missing("streamed_drawn", "--disk-model 8,5 --lookahead 0");
    assert!(sum(&drawn) > 0.0, "something has to be late");
    assert_eq!(drawn, missing("streamed_undrawn", "--disk-model 8,5 --lookahead 0 --no-draw"));
    let bytes = |name: &str| column(&folder(name).join("stats.csv"), "disk_bytes");
    assert_eq!(bytes("streamed_drawn"), bytes("streamed_undrawn"));
}

#[test]
fn a_recorded_flight_is_replayed_command_for_command() {
    let Some(_) = adapter("a recorded flight") else { return };
    let out = folder("recorded_run");
    let record = out.join("run.jsonl");
    let line = "{} --headless --flypath {} --size 64x64 --error-px 0.1 --vram 600KiB --ram 300KiB --record-cache {}";
    let run = pb_view_line(line, &[torus(), &flight(&out), &record]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let file = std::io::BufReader::new(std::fs::File::open(&record).unwrap());
    let replayed = pb_stream::journal::replay(file).unwrap();
    assert!(replayed.frames > 70 && replayed.commands > 200, "{replayed:?}");
    let run = pb_view_line("simulate --replay {}", &[&record]);
    assert!(run.code == 0 && run.stdout.contains("all as recorded"), "{}", run.stderr);
    let run = pb_view_line("simulate --replay {}", &[&flight(&out)]);
    assert!(run.code == 2 && run.stderr.contains("not a recorded run"), "{}", run.stderr);
}

#[test]
fn an_archive_is_simulated_without_an_adapter() {
    let run = pb_view_line("simulate --hours 0.01 --seed 5 --archive {}", &[small_torus()]);
    assert!(run.code == 0 && run.stdout.contains("no bound was exceeded"), "{}{}", run.stdout, run.stderr);
}

#[test]
fn in_a_window_a_slow_disk_takes_its_time() {
    let mut feed = Feed::new(open_model(small_torus()).unwrap());
    feed.set_disk("15,1000".parse().unwrap(), DiskClock::Wall);
    let start = Instant::now();
    (0..3).for_each(|c| feed.request(pb_stream::ChunkId(c * 4)));
    let arrived = feed.drain();
    assert!(arrived.len() == 3 && arrived.iter().all(|a| a.1.is_ok()));
    let stats = feed.stats();
    assert!(stats.reads >= 1 && start.elapsed() >= Duration::from_millis(15 * stats.reads), "{stats:?}");
}

/// Takes its time for each chunk.
struct SlowAdapter;

impl Adapter for SlowAdapter {
    fn upload(&mut self, _: ChunkId, _: &Loaded) -> bool {
        std::thread::sleep(std::time::Duration::from_micros(100));
        true
    }

    fn free(&mut self, _: ChunkId) {}
}

#[test]
fn only_where_uploads_are_paced_does_the_clock_limit_their_bytes() {
    let key = Keyframe { t: 0.0, eye: [3.4, 1.5, 2.5].into(), target: DVec3::X, up: DVec3::Y, fov_deg: 50.0 };
    let moment = Moment { key, size: [640, 360], detail: Detail::ErrorPx(0.5), dt_secs: 0.02 };
    let limits_of = |paced: bool| {
        let model = open_model(small_torus()).unwrap();
        let costs = VramCosts { chunks: model_tables(&model).chunk_vram_bytes(), budgets: [1 << 30, 0] };
        let bounds = Bounds { vram_bytes: 1 << 30, ram_bytes: 1 << 30, max_triangles: u64::MAX };
        let feed = Feed::unread(model.clone(), DiskModel::default());
        let mut streaming = Streaming::new(model, &costs, bounds, feed).unwrap();
        let run = folder("paced").join("run.jsonl");
        streaming.record_cache(&run).unwrap();
        if paced {
            streaming.pace_uploads();
        }
        (0..50).for_each(|_| streaming.advance(&mut SlowAdapter, &moment));
        streaming.finish_recording().unwrap();
        let text = std::fs::read_to_string(run).unwrap();
        assert!(text.contains("\"Uploaded\""), "nothing was uploaded");
        text.matches("LimitUploads").count()
    };
    assert_eq!(limits_of(false), 0);
    assert!(limits_of(true) > 1, "the limit follows what uploads take");
}
