//! Each way to fail has its own name, comes in time, and leaves no process behind.

use super::fake::{PATIENCE, SHORT, Workshop, charts, request};
use pb_bake::xatlas::wire::{HEADER_BYTES, Kind, MAGIC, message};
use pb_bake::xatlas::{Helper, HelperFault, Process};
use std::time::{Duration, Instant};

#[test]
fn a_good_helper_is_believed() {
    let workshop = Workshop::new();
    assert_eq!(workshop.charts_of("hello; answer", PATIENCE).unwrap(), charts());
    assert_eq!(workshop.helper("hello").probe().unwrap().name, "fake 1");
}

#[test]
fn one_that_is_killed_in_the_middle_has_died_of_it() {
    let workshop = Workshop::new();
    for middle in ["", "head -c 7 charts;", "head -c 40 charts;"] {
        let script = format!("hello; {middle} echo lost the thread >&2; kill -9 $$");
        match workshop.charts_of(&script, PATIENCE) {
            Err(HelperFault::Died { how, stderr }) => {
                assert!(how.contains("signal: 9"), "{how}");
                assert_eq!(stderr, "lost the thread");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn one_that_ends_at_once_has_died_too() {
    let workshop = Workshop::new();
    let fault = workshop.helper("echo no library >&2; exit 3").probe().unwrap_err();
    let text = fault.to_string();
    assert!(matches!(fault, HelperFault::Died { .. }) && text.contains("3") && text.contains("no library"), "{text}");
}

#[test]
fn one_that_hangs_runs_out_of_time_wherever_it_hangs() {
    let workshop = Workshop::new();
    for script in ["hello; exec sleep 600", "hello; head -c 50 charts; sleep 600", "hello; sleep 600 & wait"] {
        let mut process = Process::start(&workshop.helper(script), PATIENCE).unwrap();
        let start = Instant::now();
        let fault = process.charts(&request(), SHORT).unwrap_err();
        drop(process);
        assert!(matches!(fault, HelperFault::TimedOut { limit: SHORT, .. }), "{script}: {fault:?}");
        assert!(start.elapsed() < SHORT + Duration::from_secs(5), "{script}: {:?}", start.elapsed());
    }
    let fault = workshop.helper("exec sleep 600").probe_within(SHORT).unwrap_err();
    assert!(matches!(fault, HelperFault::TimedOut { .. }), "{fault:?}");
}

#[test]
fn one_that_reads_nothing_cannot_block_the_asker() {
    let workshop = Workshop::new();
    let mut large = request();
    large.positions.resize(100_000, [0.0; 3]);
    let mut process = Process::start(&workshop.helper("hello; exec sleep 600"), PATIENCE).unwrap();
    assert!(matches!(process.charts(&large, SHORT), Err(HelperFault::TimedOut { .. })));
}

#[test]
fn whatever_a_helper_started_ends_with_it() {
    let workshop = Workshop::new();
    let process =
        Process::start(&workshop.helper("sleep 600 & echo $! > child; echo $$ > self; hello; wait"), PATIENCE);
    drop(process.unwrap());
    for name in ["self", "child"] {
        let id = std::fs::read_to_string(workshop.path(name)).unwrap();
        assert!(ends_soon(id.trim()), "{name} still runs");
    }
}

/// Gone, or dead and waiting for a parent that is not this process.
fn ends_soon(id: &str) -> bool {
    let ended = || {
        let state = std::process::Command::new("ps").args(["-o", "stat=", "-p", id]).output().unwrap().stdout;
        state.trim_ascii().is_empty() || (state.starts_with(b"Z") && !is_child_of_this(id))
    };
    (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(10));
        ended()
    })
}

fn is_child_of_this(id: &str) -> bool {
    let parent = std::process::Command::new("ps").args(["-o", "ppid=", "-p", id]).output().unwrap().stdout;
    parent.trim_ascii() == std::process::id().to_string().as_bytes()
}

#[test]
fn garbage_is_called_garbage() {
    let workshop = Workshop::new();
    let mut unknown = message(Kind::ChartsAnswer, &[]);
    unknown[6] = 0x55;
    workshop.put("unknown", &unknown);
    for script in ["exec yes", "exec cat /dev/zero", "hello; exec yes", "hello; cat unknown", "cat probe probe"] {
        match workshop.charts_of(script, PATIENCE) {
            Err(HelperFault::Garbage(_)) => {}
            other => panic!("{script}: {other:?}"),
        }
    }
}

#[test]
fn another_version_is_named() {
    let workshop = Workshop::new();
    let mut probe = std::fs::read(workshop.path("probe")).unwrap();
    probe[MAGIC.len()] = 7;
    workshop.put("probe7", &probe);
    let fault = workshop.helper("cat probe7; cat > taken").probe().unwrap_err();
    assert!(matches!(fault, HelperFault::WrongVersion { found: 7 }), "{fault:?}");
}

#[test]
fn a_huge_length_is_refused_before_anything_is_read() {
    let workshop = Workshop::new();
    for bytes in [u64::MAX, 1 << 40, 8 + 28 * 3] {
        let mut header = message(Kind::ChartsAnswer, &[]);
        header[8..HEADER_BYTES].copy_from_slice(&bytes.to_le_bytes());
        workshop.put("header", &header);
        match workshop.charts_of("hello; cat header; exec cat /dev/zero", PATIENCE) {
            Err(HelperFault::Garbage(what)) => assert!(what.0.contains(&bytes.to_string()), "{what}"),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_refusal_is_passed_on() {
    let workshop = Workshop::new();
    workshop.put("refusal", &message(Kind::Refusal, b"too\nknotty"));
    match workshop.charts_of("hello; cat refusal; cat > taken", PATIENCE) {
        Err(HelperFault::Refused(why)) => assert_eq!(why, "too knotty"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_flood_of_complaints_is_cut_short() {
    let workshop = Workshop::new();
    match workshop.charts_of("hello; yes complaint | head -c 1000000 >&2; exit 1", PATIENCE) {
        Err(HelperFault::Died { stderr, .. }) => assert!((1000..3000).contains(&stderr.len()), "{}", stderr.len()),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_helper_that_is_not_there_is_named() {
    let workshop = Workshop::new();
    let nowhere = workshop.path("nowhere");
    let fault = Helper::find(Some(&nowhere)).unwrap_err();
    assert!(matches!(&fault, HelperFault::NotThere { path, .. } if *path == nowhere), "{fault:?}");
    let fault = Helper { path: nowhere, found: pb_bake::xatlas::Found::Option }.probe().unwrap_err();
    assert!(matches!(fault, HelperFault::Start { .. }), "{fault:?}");
}

#[test]
fn nonsense_is_not_even_asked() {
    let workshop = Workshop::new();
    let mut process = Process::start(&workshop.helper("hello; cat charts; cat > taken"), PATIENCE).unwrap();
    let spoil: [fn(&mut pb_bake::xatlas::Request); 4] = [
        |r| r.positions[0][1] = f32::NAN,
        |r| r.triangles[1][2] = 4,
        |r| r.triangles.clear(),
        |r| r.options.max_stretch = f32::NAN,
    ];
    for spoil in spoil {
        let mut bad = request();
        spoil(&mut bad);
        assert!(matches!(process.charts(&bad, PATIENCE), Err(HelperFault::BadRequest(_))));
    }
    assert_eq!(process.charts(&request(), PATIENCE).unwrap(), charts());
}
