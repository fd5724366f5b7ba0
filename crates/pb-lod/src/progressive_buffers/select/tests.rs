use glam::{DVec3, Vec4};

use super::*;
use crate::plan::Prefetch;
use crate::progressive_buffers::display::GridEye;
use crate::progressive_buffers::displayed_surface::{Surface, displayed_surface};
use crate::progressive_buffers::grid_torus::GridTorus;

pub(super) const PIXEL_ANGLE: f32 = 1e-3;

/// A view from `eye` towards the origin, 60 degrees wide and high.
pub(super) fn view(eye: DVec3) -> View {
    let forward = -eye.normalize();
    let right = forward.cross(DVec3::new(0.1, 0.2, 1.0)).normalize();
    let up = right.cross(forward);
    let plane = |n: DVec3| n.normalize().as_vec3().extend(0.0);
    let planes = [right, -right, up, -up].map(|side| plane(side + forward * 0.577));
    View { eye, planes: planes.to_vec(), pixel_angle: PIXEL_ANGLE }
}

/// A model, its selector, and a residency that a test can change.
pub(super) struct Bench {
    torus: GridTorus,
    pub(super) selector: Selector,
    pub(super) resident: Vec<bool>,
    retiring: Vec<bool>,
    failed: Vec<bool>,
    cut: bool,
    pub(super) detail: Detail,
    pub(super) budget: u64,
}

impl Bench {
    pub(super) fn new(side: u32, levels: u32) -> Bench {
        let torus = GridTorus::new(side, levels);
        let selector = Selector::new(&torus.tables());
        let chunks = torus.chunks();
        let coarsest = |c: usize| c as u32 % levels == levels - 1;
        let resident = (0..chunks).map(coarsest).collect();
        Bench {
            torus,
            selector,
            resident,
            retiring: vec![false; chunks],
            failed: vec![false; chunks],
            cut: false,
            detail: Detail::ErrorPx(1.0),
            budget: u64::MAX,
        }
    }

    pub(super) fn all_resident(mut self) -> Bench {
        self.resident.fill(true);
        self
    }

    pub(super) fn select(&mut self, views: &[View], dt_secs: f32) -> Plan {
        self.select_with(views, Prefetch::AROUND, u64::MAX, dt_secs)
    }

    pub(super) fn select_with(&mut self, views: &[View], prefetch: Prefetch, max_triangles: u64, dt_secs: f32) -> Plan {
        self.selector.select(&Frame {
            views,
            resident: &self.resident,
            retiring: &self.retiring,
            failed: &self.failed,
            changed: None,
            detail: self.detail,
            vram_budget_bytes: self.budget,
            texture_budget_bytes: 0,
            max_triangles,
            prefetch,
            cut: self.cut,
            dt_secs,
        })
    }

    fn levels(&self) -> u32 {
        self.torus.model.levels
    }

    /// The surface that a plan shows to one view: draws where it has them, else the coarsest level.
    fn surface(&self, plan: &Plan, view: &View) -> Surface {
        let clusters = self.torus.clusters.len() as u32;
        let level = |c| plan.draws.iter().find(|d| d.cluster == c).map_or(self.levels() - 1, |d| d.level);
        let drawn: Vec<_> = (0..clusters).map(|c| self.torus.drawn(c, level(c))).collect();
        let switch = Switch::new(plan.detail.expect("set"), view.pixel_angle, self.torus.model.quantum);
        let tables: Vec<_> = (0..clusters).map(|c| self.selector.lod_table(c, &switch)).collect();
        let eye = GridEye::new(self.torus.model.origin, self.torus.model.quantum, view.eye);
        displayed_surface(&drawn, &tables, &eye)
    }

    fn is_resident(&self, cluster: u32, level: u32) -> bool {
        self.resident[(cluster * self.levels() + level) as usize]
    }
}

/// Deterministic numbers for tests: xorshift.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn eye(&mut self, nearest: f64, farthest: f64) -> DVec3 {
        let direction = DVec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5).normalize();
        direction * nearest * (farthest / nearest).powf(self.next())
    }
}

#[test]
fn draws_finest_near_and_coarsest_far() {
    let mut bench = Bench::new(4, 4).all_resident();
    bench.detail = Detail::ErrorPx(60.0);
    let near = bench.select(&[view(DVec3::new(20.0, 0.0, 9.5))], f32::INFINITY);
    assert!(near.draws.iter().any(|d| d.level == 0) && near.draws.iter().any(|d| d.level > 0), "{near:?}");
    assert!(near.draws.is_sorted_by_key(|d| d.level));
    let far = bench.select(&[view(DVec3::new(1e6, 0.0, 0.0))], f32::INFINITY);
    let all: u32 = bench.torus.levels.iter().skip(3).step_by(4).map(|l| l.triangles * 3).sum();
    assert_eq!((far.draws.len(), far.coarse.len()), (0, 1), "one range for the whole model");
    assert_eq!(far.coarse[0].indices, 0..all);
    assert_eq!(far.triangles, all as u64 / 3);
    assert!(far.wants.is_empty() && far.settled && far.error_px < 1.0);
}

#[test]
fn culls_what_no_view_sees_and_draws_what_any_view_sees() {
    let mut bench = Bench::new(6, 3).all_resident();
    bench.detail = Detail::ErrorPx(0.01);
    let (mut left, mut right) = (view(DVec3::new(60.0, 1.0, 0.0)), view(DVec3::new(-60.0, 1.0, 0.0)));
    left.planes.push(Vec4::new(1.0, 0.0, 0.0, 55.0)); // keeps x > 5
    right.planes.push(Vec4::new(-1.0, 0.0, 0.0, 55.0)); // keeps x < -5
    let count = |plan: Plan| plan.draws.len();
    let one = count(bench.select(std::slice::from_ref(&left), f32::INFINITY));
    let other = count(bench.select(std::slice::from_ref(&right), f32::INFINITY));
    let both = count(bench.select(&[left, right], f32::INFINITY));
    assert!(one > 0 && other > 0 && one < 36 && both > one && both > other && both <= one + other);
}

#[test]
fn falls_back_to_coarser_resident_level() {
    let mut bench = Bench::new(4, 4);
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    assert!(bench.select(&eye, f32::INFINITY).draws.is_empty(), "only the coarsest level is resident");
    for c in 0..16 {
        bench.resident[c * 4 + 2] = true;
        bench.resident[c * 4] = true; // of no use without level 1
    }
    let plan = bench.select(&eye, f32::INFINITY);
    assert!(!plan.draws.is_empty() && plan.draws.iter().all(|d| d.level == 2), "{:?}", plan.draws);
    assert!(plan.missing_chunks > 0 && !plan.settled && plan.error_px > 1.0);
}

#[test]
fn never_draws_or_floors_below_what_is_resident() {
    let mut bench = Bench::new(3, 4);
    let mut random = Random(7);
    for _ in 0..400 {
        let chunk = (random.next() * bench.resident.len() as f64) as usize;
        bench.resident[chunk] = random.next() < 0.7 || chunk % 4 == 3;
        let plan = bench.select(&[view(random.eye(12.0, 200.0))], random.next() as f32 * 0.2);
        for draw in &plan.draws {
            assert!((draw.level..4).all(|i| bench.is_resident(draw.cluster, i)), "{draw:?}");
            assert!(plan.floors[draw.cluster as usize].floor() as u32 <= draw.level);
        }
        for c in 0..9 {
            let finest = (0..4).rev().take_while(|&i| bench.is_resident(c, i)).last().unwrap();
            assert!(plan.floors[c as usize] >= finest as f32);
        }
    }
}

#[test]
fn detail_that_arrives_fades_in_and_settles() {
    let mut bench = Bench::new(4, 3);
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    bench.select(&eye, 0.01);
    bench.resident.fill(true);
    let (mut last, mut frames, mut faded) = (vec![2.0f32; 16], 0, false);
    loop {
        let plan = bench.select(&eye, 0.01);
        let visible: Vec<u32> = plan.draws.iter().map(|d| d.cluster).collect();
        for &c in &visible {
            let step = last[c as usize] - plan.floors[c as usize];
            let lod_step = step.min(last[c as usize]);
            faded |= plan.floors[c as usize].fract() > 0.0;
            assert!(lod_step <= 0.034 || plan.floors[c as usize] == 0.0, "cluster {c} jumps by {step}");
        }
        last = plan.floors.clone();
        frames += 1;
        if plan.settled {
            break;
        }
        assert!(frames < 200, "never settles");
    }
    assert!(faded && frames > 20, "{frames} frames");
}

#[test]
fn after_a_cut_data_fades_in_faster() {
    let frames = |cut: bool| {
        let mut bench = Bench::new(4, 5);
        let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
        bench.select(&eye, 0.01);
        bench.resident.fill(true);
        bench.cut = cut;
        let mut faded = 0;
        while !bench.select(&eye, 0.01).floors_stand {
            bench.cut = false;
            faded += 1;
        }
        faded
    };
    let (soon, late) = (frames(true), frames(false));
    assert!(soon < 50 && soon > 20 && late > 2 * soon, "{soon} and {late} frames of 10 ms");
}

#[test]
fn gives_back_only_what_no_view_shows_and_never_uses_it_again() {
    let mut bench = Bench::new(4, 4).all_resident();
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    let before = bench.select(&eye, f32::INFINITY);
    let shown = before.draws.iter().find(|d| d.level == 0).expect("something is near").cluster;
    let chunk = bench.torus.tables().model.levels * shown;
    bench.retiring[chunk as usize] = true;
    let mut frames = 0;
    let plan = loop {
        let plan = bench.select(&eye, 0.02);
        frames += 1;
        match plan.released.is_empty() {
            true => assert!(frames < 100),
            false => break plan,
        }
    };
    assert_eq!(plan.released, [ChunkId(chunk)]);
    assert!(frames > 5, "a shown level fades out first, over {frames} frames");
    assert!(plan.floors[shown as usize] >= 1.0);
    let again = bench.select(&eye, f32::INFINITY);
    assert!(again.released.is_empty() && again.floors[shown as usize] >= 1.0, "not before it is resident anew");
    bench.resident[chunk as usize] = false;
    bench.select(&eye, f32::INFINITY);
    (bench.resident[chunk as usize], bench.retiring[chunk as usize]) = (true, false);
    assert_eq!(bench.select(&eye, f32::INFINITY).floors[shown as usize], 0.0);
}

#[test]
fn gives_back_at_once_what_is_far_or_out_of_sight() {
    let mut bench = Bench::new(4, 4).all_resident();
    bench.select(&[view(DVec3::new(1e5, 0.0, 0.0))], 0.01);
    bench.retiring = bench.resident.clone();
    let plan = bench.select(&[view(DVec3::new(1e5, 0.0, 0.0))], 0.01);
    assert_eq!(plan.released.len(), 16 * 3, "all but the coarsest");
    assert!(plan.settled);
}

#[test]
fn wants_coarser_chunks_first_and_all_that_it_would_draw() {
    let mut bench = Bench::new(4, 4);
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    let wants = bench.select(&eye, f32::INFINITY).wants;
    let order = |w: &Want| (std::cmp::Reverse((w.class, w.error_px.to_bits())), w.chunk);
    assert!(wants.is_sorted_by(|a, b| order(a) < order(b)), "sorted, no chunk twice");
    let place = |chunk: u32| wants.iter().position(|w| w.chunk.0 == chunk);
    for want in wants.iter().filter(|w| w.chunk.0 % 4 < 3) {
        let coarser = place(want.chunk.0 + 1).expect("a finer chunk is of no use without its coarser ones");
        assert!(coarser < place(want.chunk.0).unwrap());
    }
    for want in wants.iter().filter(|w| w.class == Class::Now) {
        bench.resident[want.chunk.0 as usize] = true;
    }
    let plan = bench.select(&eye, f32::INFINITY);
    assert!(plan.settled && plan.missing_chunks == 0 && plan.error_px <= 1.001, "{}", plan.error_px);
}

#[test]
fn error_rises_until_the_wanted_bytes_fit_the_budget() {
    let mut bench = Bench::new(4, 4).all_resident();
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    let bytes = |bench: &Bench, plan: &Plan| {
        let now = plan.wants.iter().filter(|w| w.class == Class::Now && w.chunk.0 % 4 != 3);
        let coarsest: u64 = bench.torus.chunk_bytes.iter().skip(3).step_by(4).sum();
        coarsest + now.map(|w| bench.torus.chunk_bytes[w.chunk.0 as usize]).sum::<u64>()
    };
    let free = bench.select(&eye, f32::INFINITY);
    let full = bytes(&bench, &free);
    assert_eq!(free.detail, Some(Detail::ErrorPx(1.0)));
    for detail in [Detail::ErrorPx(1.0), Detail::Bands { k: 8.0, s: 1.0 }] {
        bench.detail = detail;
        bench.budget = u64::MAX;
        let mut last = bench.select(&eye, f32::INFINITY).triangles;
        for share in [0.8, 0.5, 0.3] {
            bench.budget = (full as f64 * share) as u64;
            let plan = bench.select(&eye, f32::INFINITY);
            assert!(bytes(&bench, &plan) <= bench.budget && plan.settled, "{share}: {:?}", plan.detail);
            assert!(plan.triangles <= last);
            last = plan.triangles;
        }
    }
    bench.budget = 0;
    let plan = bench.select(&eye, f32::INFINITY);
    assert!(plan.wants.iter().all(|w| w.class < Class::Now), "too small even for the coarsest: that is drawn");
    bench.retiring.fill(true);
    assert!(bench.select(&eye, f32::INFINITY).draws.is_empty());
}

#[test]
fn detail_moves_slowly_when_time_is_short() {
    let mut bench = Bench::new(4, 4).all_resident();
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    let tau = |plan: &Plan| match plan.detail {
        Some(Detail::ErrorPx(tau)) => tau,
        other => panic!("{other:?}"),
    };
    let mut last = tau(&bench.select(&eye, 1.0 / 60.0));
    bench.budget = 100_000;
    let mut settled = false;
    for _ in 0..600 {
        let plan = bench.select(&eye, 1.0 / 60.0);
        assert!(tau(&plan) / last < 1.031, "{} after {last}", tau(&plan));
        last = tau(&plan);
        settled |= plan.settled;
    }
    assert!(settled && last > 1.5, "{last}");
}

#[test]
fn the_same_frames_give_the_same_plans() {
    let run = || {
        let (mut bench, mut random) = (Bench::new(3, 4).all_resident(), Random(3));
        let plans = (0..30).map(|_| bench.select(&[view(random.eye(12.0, 300.0))], 0.01));
        format!("{:?}", plans.collect::<Vec<_>>())
    };
    assert_eq!(run(), run());
}

#[test]
fn every_selected_surface_is_closed_under_random_views_floors_and_residency() {
    let mut random = Random(11);
    let mut bench = Bench::new(4, 4);
    let mut levels_seen = [0usize; 4];
    for round in 0..300 {
        for _ in 0..8 {
            let chunk = (random.next() * bench.resident.len() as f64) as usize;
            bench.resident[chunk] = random.next() < 0.8 || chunk % 4 == 3;
        }
        bench.detail = match round % 3 {
            0 => Detail::Bands { k: random.next() as f32 * 20.0, s: random.next() as f32 * 10.0 - 5.0 },
            _ => Detail::ErrorPx(0.1 * 100f32.powf(random.next() as f32)),
        };
        let eye = view(random.eye(3.0, 300.0));
        let plan = bench.select(std::slice::from_ref(&eye), 0.05);
        plan.draws.iter().for_each(|d| levels_seen[d.level as usize] += 1);
        assert_eq!(bench.surface(&plan, &eye).unmatched_edges(), 0, "round {round}");
    }
    assert!(levels_seen[..3].iter().all(|&n| n > 20), "{levels_seen:?}");
}

#[test]
fn a_parent_that_differs_on_one_side_of_a_border_is_seen_as_a_crack() {
    let mut bench = Bench::new(4, 4).all_resident();
    let eye = view(DVec3::new(25.0, 1.0, 9.5));
    let plan = bench.select(std::slice::from_ref(&eye), f32::INFINITY);
    assert_eq!(bench.surface(&plan, &eye).unmatched_edges(), 0);
    let cluster = plan.draws[0].cluster as usize;
    let coarsest = bench.torus.levels[cluster * 4 + 3].vertices as usize;
    for v in &mut bench.torus.vertices[cluster][coarsest..] {
        if v.slot() != 0 {
            v.parent = (v.parent + 1) % coarsest as u16;
        }
    }
    assert!(bench.surface(&plan, &eye).unmatched_edges() > 0);
}

#[test]
fn without_prefetch_only_what_is_drawn_is_wanted() {
    let eye = view(DVec3::new(3.0, 0.5, 0.5));
    let mut bench = Bench::new(48, 4);
    let around = bench.select(std::slice::from_ref(&eye), f32::INFINITY);
    let off = bench.select_with(std::slice::from_ref(&eye), Prefetch::OFF, u64::MAX, f32::INFINITY);
    let now = |plan: &Plan| plan.wants.iter().filter(|w| w.class == Class::Now).copied().collect::<Vec<Want>>();
    assert_eq!(now(&around), now(&off));
    // Nothing but what is drawn, and neighbours of that: they move the common border.
    let drawn: Vec<u32> = now(&off).iter().map(|w| w.chunk.0 / 4).collect();
    let beside = |w: &Want| bench.selector.tables.neighbours(w.chunk.0 / 4).iter().any(|c| drawn.contains(c));
    let rest: Vec<&Want> = off.wants.iter().filter(|w| w.class < Class::Now).collect();
    assert!(rest.iter().all(|w| w.class == Class::Soon && beside(w)), "{rest:?}");
    assert!(around.wants.len() > off.wants.len());
}

#[test]
fn the_error_rises_until_the_triangles_are_few_enough_and_no_further() {
    let views = [view(DVec3::new(4.0, 0.5, 0.5))];
    let mut bench = Bench::new(48, 4).all_resident();
    let all = bench.select(&views, f32::INFINITY);
    let most = all.triangles / 3;
    let plan = bench.select_with(&views, Prefetch::AROUND, most, f32::INFINITY);
    assert!(plan.triangles <= most && plan.triangles > most / 2, "{} of {most}", plan.triangles);
    // A bound that nothing keeps leaves the coarsest detail, and that stands.
    let taus = (0..100).map(|_| bench.select_with(&views, Prefetch::AROUND, 1, 0.1).detail.expect("set"));
    let Some(Detail::ErrorPx(tau)) = taus.last() else { panic!() };
    assert!(tau.is_finite() && bench.select_with(&views, Prefetch::AROUND, 1, 0.1).floors_stand, "{tau}");
    bench.select(&views, f32::INFINITY);
    // At once, also where detail moves slowly.
    bench.select(&views, f32::INFINITY);
    let plan = bench.select_with(&views, Prefetch::AROUND, most, 1.0 / 60.0);
    assert!(plan.triangles <= most, "{} of {most}", plan.triangles);
}

/// Reads what is wanted, at most `at_once` chunks per frame and none of `broken`; per frame the error that the detail
/// allows and what was missing, until the detail stands for a second.
fn stream(bench: &mut Bench, at_once: usize, broken: impl Fn(u32) -> bool) -> Vec<(f32, u32)> {
    let eye = [view(DVec3::new(25.0, 1.0, 9.5))];
    let mut out: Vec<(f32, u32)> = Vec::new();
    while out.len() < 60 || out[out.len() - 60].0 != out[out.len() - 1].0 {
        assert!(out.len() < 6000, "the detail never stands");
        let plan = bench.select_with(&eye, Prefetch::OFF, u64::MAX, 1.0 / 60.0);
        let Some(Detail::ErrorPx(tau)) = plan.detail else { panic!("{:?}", plan.detail) };
        out.push((tau, plan.missing_chunks));
        let absent = |c: &u32| !bench.resident[*c as usize] && !broken(*c);
        let next: Vec<u32> = plan.wants.iter().map(|w| w.chunk.0).filter(absent).take(at_once).collect();
        next.into_iter().for_each(|c| bench.resident[c as usize] = true);
    }
    out
}

#[test]
fn detail_gets_finer_as_fast_as_data_comes_and_lacks_nothing_on_the_way() {
    let mut bench = Bench::new(8, 5);
    bench.detail = Detail::ErrorPx(0.01);
    let slow = stream(&mut bench, 1, |_| false);
    assert!(slow[0].0 > 1.0, "{slow:?}");
    assert!(slow.windows(2).all(|f| f[1].0 <= f[0].0), "never coarser again");
    assert!(slow.iter().all(|f| f.1 == 0), "{slow:?}");
    assert_eq!(slow.last().unwrap().0, 0.01);
    let mut bench = Bench::new(8, 5);
    bench.detail = Detail::ErrorPx(0.01);
    let fast = stream(&mut bench, usize::MAX, |_| false);
    assert!(fast.len() < slow.len() && fast.last().unwrap().0 == 0.01, "{} and {}", fast.len(), slow.len());
}

#[test]
fn damaged_chunks_do_not_hold_the_others_up() {
    let mut bench = Bench::new(8, 5);
    bench.detail = Detail::ErrorPx(0.01);
    let broken = |c: u32| c.is_multiple_of(7);
    bench.failed = (0..bench.failed.len() as u32).map(broken).collect();
    let flown = stream(&mut bench, usize::MAX, broken);
    let last = flown.last().unwrap();
    assert!(flown.len() < 300 && last.0 == 0.01 && last.1 > 0, "{} frames, {last:?}", flown.len());
}

#[test]
fn a_coarse_buffer_that_fills_most_of_the_budget_leaves_the_rest_to_detail_when_prefetching() {
    let mut bench = Bench::new(4, 4).all_resident();
    let coarse: u64 = bench.torus.chunk_bytes.iter().skip(3).step_by(4).sum();
    // Selection has to fit one chunk of the next level, but a 16th of the whole budget would be more than that.
    bench.torus.chunk_bytes.iter_mut().skip(3).step_by(4).for_each(|bytes| *bytes *= 1000);
    bench.selector = Selector::new(&bench.torus.tables());
    let finer = bench.torus.chunk_bytes.iter().enumerate().filter(|(c, _)| c % 4 != 3).map(|(_, bytes)| bytes);
    bench.budget = 1000 * coarse + finer.sum::<u64>() / 2;
    let plan = bench.select(&[view(DVec3::new(25.0, 1.0, 9.5))], f32::INFINITY);
    assert!(matches!(plan.detail, Some(Detail::ErrorPx(tau)) if tau < 100.0), "{:?}", plan.detail);
}
