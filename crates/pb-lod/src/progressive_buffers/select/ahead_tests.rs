//! Tests of what is remembered between frames: of cameras to come, and of the work done.

use std::collections::BTreeMap;

use glam::DVec3;

use super::tests::{Bench, view};
use super::*;
use crate::plan::Prefetch;
use crate::progressive_buffers::grid_torus::GridTorus;

/// A camera beside the torus, so far around it; radians.
fn beside(angle: f64) -> View {
    view(DVec3::new(angle.cos(), angle.sin(), 0.08) * 2.5)
}

/// What a view alone wants that the coarse buffer does not have.
fn alone(bench: &mut Bench, view: &View) -> Vec<Want> {
    let plan = bench.select_with(std::slice::from_ref(view), Prefetch::OFF, u64::MAX, f32::INFINITY);
    plan.wants.into_iter().filter(|w| w.chunk.0 % 4 != 3).collect()
}

/// Whether a plan wants all of these, each at this class or its own at least.
fn wants_all(plan: &Plan, wants: &[Want], class: Class) -> bool {
    let wanted: BTreeMap<ChunkId, Class> = plan.wants.iter().map(|w| (w.chunk, w.class)).collect();
    wants.iter().all(|w| wanted.get(&w.chunk) >= Some(&w.class.min(class)))
}

fn error(plan: &Plan) -> f32 {
    match plan.detail {
        Some(Detail::ErrorPx(tau)) => tau,
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_cameras_to_come_draw_is_wanted_before() {
    let [here, soon, later] = [DVec3::X, DVec3::Y, -DVec3::X].map(|d| view(d * 2.5 + DVec3::Z * 0.2));
    let mut bench = Bench::new(48, 4);
    let [now, then, at_last] = [&here, &soon, &later].map(|v| alone(&mut bench, v));
    let prefetch = Prefetch { around: false, soon: &[soon], later: &[later] };
    let plan = bench.select_with(&[here], prefetch, u64::MAX, f32::INFINITY);
    assert!(wants_all(&plan, &now, Class::Now));
    assert!(wants_all(&plan, &then, Class::Soon) && wants_all(&plan, &at_last, Class::Maybe));
    let of = |class| plan.wants.iter().filter(|w| w.class == class).count();
    assert!(of(Class::Soon) > 0 && of(Class::Maybe) > 0);
    let mut chunks: Vec<ChunkId> = plan.wants.iter().map(|w| w.chunk).collect();
    chunks.sort_unstable();
    assert!(chunks.windows(2).all(|c| c[0] < c[1]), "a chunk is wanted twice");
}

#[test]
fn what_cameras_to_come_draw_is_wanted_in_every_frame_although_they_are_looked_at_in_few() {
    let (soon, later) = (beside(1.6), beside(3.1));
    let mut bench = Bench::new(48, 4);
    let [then, at_last] = [&soon, &later].map(|v| alone(&mut bench, v));
    let prefetch = Prefetch { around: false, soon: &[soon], later: &[later] };
    for frame in 0..30 {
        let views = [beside(f64::from(frame) * 0.003)];
        let plan = bench.select_with(&views, prefetch, u64::MAX, 1.0 / 60.0);
        let classes = plan.wants.iter().map(|w| std::cmp::Reverse(w.class));
        assert!(classes.is_sorted(), "frame {frame}");
        // The detail in use gets finer while data comes, but what is wanted for later is that of the target.
        assert!(wants_all(&plan, &then, Class::Soon) && wants_all(&plan, &at_last, Class::Maybe), "frame {frame}");
    }
}

#[test]
fn cameras_to_come_are_followed_soon_and_at_once_after_a_cut() {
    let mut bench = Bench::new(48, 4);
    let flight = |bench: &mut Bench, frame: i32, ahead: f64| {
        let soon = [beside(1.0 + ahead)];
        let later = [beside(2.0 + ahead)];
        let prefetch = Prefetch { around: false, soon: &soon, later: &later };
        bench.select_with(&[beside(f64::from(frame) * 0.003)], prefetch, u64::MAX, 1.0 / 60.0)
    };
    let ahead = 0.7;
    let [then, at_last] = [1.0, 2.0].map(|angle| alone(&mut bench, &beside(angle + ahead)));
    let complete = |plan: &Plan| wants_all(plan, &then, Class::Soon) && wants_all(plan, &at_last, Class::Maybe);
    (0..4).for_each(|frame| drop(flight(&mut bench, frame, 0.0)));
    let late = (4..40).take_while(|&frame| !complete(&flight(&mut bench, frame, ahead))).count();
    assert!((1..=9).contains(&late), "{late} frames");
    (40..44).for_each(|frame| drop(flight(&mut bench, frame, 0.0)));
    assert!(complete(&flight(&mut bench, 200, ahead)), "a cut");
}

#[test]
fn what_settles_at_once_does_not_depend_on_what_was_before() {
    let (soon, later) = ([beside(0.5)], [beside(1.0)]);
    let prefetch = Prefetch { around: false, soon: &soon, later: &later };
    let settled = |history: u32| {
        let mut bench = Bench::new(24, 4).all_resident();
        bench.budget = 500_000;
        for frame in 0..history {
            let eye = beside(3.0 + f64::from(frame) * 0.01);
            let ahead = [beside(4.0 + f64::from(frame) * 0.01)];
            let prefetch = Prefetch { around: false, soon: &ahead, later: &ahead };
            bench.select_with(&[eye], prefetch, u64::MAX, 1.0 / 60.0);
        }
        format!("{:?}", bench.select_with(&[beside(0.0)], prefetch, u64::MAX, f32::INFINITY))
    };
    let fresh = settled(0);
    assert!([1, 2, 7, 30].into_iter().all(|history| settled(history) == fresh));
}

#[test]
fn the_error_rises_until_what_is_seen_soon_fits_too() {
    let mut bench = Bench::new(48, 4).all_resident();
    let [here, there] = [DVec3::X, -DVec3::X].map(|d| [view(d * 2.5 + DVec3::Z * 0.2)]);
    let soon = Prefetch { around: false, soon: &there, later: &[] };
    let bytes = |bench: &Bench, plan: &Plan| {
        let finer = plan.wants.iter().filter(|w| w.class >= Class::Soon).map(|w| w.chunk.0);
        let finer = finer.filter(|c| c % 4 != 3).map(|c| bench.selector.tables.chunk_bytes(ChunkId(c)));
        finer.sum::<u64>() + bench.selector.tables.coarse_bytes
    };
    let all = bench.select_with(&here, Prefetch::OFF, u64::MAX, f32::INFINITY);
    bench.budget = bytes(&bench, &all) * 17 / 15;
    let alone = error(&bench.select_with(&here, Prefetch::OFF, u64::MAX, f32::INFINITY));
    let plan = bench.select_with(&here, soon, u64::MAX, f32::INFINITY);
    assert!(bytes(&bench, &plan) <= bench.budget, "{} of {}", bytes(&bench, &plan), bench.budget);
    assert!(alone == 1.0 && error(&plan) > alone);
    // Also in frames that do not look at what comes soon.
    for _ in 0..20 {
        let next = bench.select_with(&here, soon, u64::MAX, 1.0 / 60.0);
        assert_eq!((next.detail, bytes(&bench, &next)), (plan.detail, bytes(&bench, &plan)));
    }
}

/// The short cuts of a frame: floors at rest are not looked at, the search begins at the last answer, and the walk goes
/// only as deep as that needs.
#[test]
fn what_is_remembered_of_the_last_frame_saves_work_and_changes_nothing() {
    let torus = GridTorus::new(8, 5);
    let chunks = torus.chunks();
    let all: u64 = torus.chunk_bytes.iter().sum();
    let (mut quick, mut thorough) = (Selector::new(&torus.tables()), Selector::new(&torus.tables()));
    let mut resident: Vec<bool> = (0..chunks).map(|c| c % 5 == 4).collect();
    let mut retiring = vec![false; chunks];
    let (mut finer, mut moved) = (0, 0);
    for step in 0..300u64 {
        let noise = |k: u64| (step * 97 + k * 31).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        let mut changed = Vec::new();
        for k in 0..noise(1) % 5 {
            let chunk = (noise(k + 2) % chunks as u64) as usize;
            resident[chunk] = chunk % 5 == 4 || noise(k + 9) % 4 > 0;
            retiring[chunk] = resident[chunk] && chunk % 5 < 4 && noise(k + 17) % 3 == 0;
            changed.push(ChunkId(chunk as u32));
        }
        let eye = |ahead: f64| {
            let t = (step as f64 + ahead) * 0.02;
            view(DVec3::new(24.0 * t.cos(), 3.0 + 20.0 * (0.3 * t).sin().abs(), 24.0 * t.sin()))
        };
        let (soon, later) = ([eye(8.0), eye(16.0)], [eye(40.0)]);
        let frame = Frame {
            views: &[eye(0.0)],
            resident: &resident,
            retiring: &retiring,
            failed: &vec![false; chunks],
            changed: Some(&changed),
            detail: Detail::ErrorPx(0.2),
            vram_budget_bytes: all / if step / 25 % 2 == 0 { 3 } else { 40 },
            texture_budget_bytes: 0,
            max_triangles: if step < 200 { u64::MAX } else { 400 },
            prefetch: match step / 30 % 3 {
                0 => Prefetch::OFF,
                1 => Prefetch { around: false, soon: &soon, later: &later },
                _ => Prefetch { around: true, soon: &soon, later: &later },
            },
            cut: false,
            dt_secs: 0.05,
        };
        let before = quick.controls[0].first_rung();
        let found = quick.select(&frame);
        thorough.controls.iter_mut().for_each(DetailControl::forget_rung);
        let expected = thorough.select(&Frame { changed: None, ..frame });
        assert_eq!(format!("{found:?}"), format!("{expected:?}"), "frame {step}");
        let after = quick.controls[0].first_rung();
        (finer, moved) = (finer + (after + 4 < before) as u32, moved + (after != before) as u32);
    }
    assert!(finer > 1 && moved > 20, "the walk had to go deeper {finer} times, the search moved {moved} times");
}
