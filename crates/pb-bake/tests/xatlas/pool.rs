//! Many clusters: those that the helper cannot cut are cut otherwise, and counted.

use super::fake::{PATIENCE, SHORT, Workshop, charts, request};
use pb_bake::xatlas::{HelperCharts, HelperFault, HelperSummary, MAX_HANGS, MAX_TOLD_FAULTS, Pool};
use pb_mesh::charts::ClusterSurface;
use rayon::prelude::*;
use std::time::Duration;

/// Whether a helper that runs `script` cut each of `count` clusters, and the summary.
fn cut(script: &str, count: usize, limit: Duration) -> (Vec<bool>, HelperSummary) {
    let workshop = Workshop::new();
    let helper = HelperCharts::new(Pool::new(workshop.helper(script)), limit);
    let request = request();
    let surface = ClusterSurface { positions: &request.positions, triangles: &request.triangles };
    let one = |_| match helper.charts(&surface) {
        Some(found) => {
            assert_eq!((found.chart_of, found.uv), (charts().chart_of, charts().uv));
            assert_eq!((found.count as usize, found.mirrored), (1, vec![false]));
            true
        }
        None => false,
    };
    let by_helper = (0..count).into_par_iter().map(one).collect();
    (by_helper, helper.summary())
}

#[test]
fn a_good_helper_cuts_all_clusters() {
    let (by_helper, summary) = cut("hello; while answer; do :; done", 20, PATIENCE);
    assert_eq!(by_helper, vec![true; 20]);
    assert_eq!(summary, HelperSummary { by_helper: 20, by_fallback: 0, faults: vec![] });
}

#[test]
fn one_that_dies_after_each_cluster_is_started_again() {
    let (by_helper, summary) = cut("hello; answer; head -c 9 > /dev/null; kill -9 $$", 12, PATIENCE);
    assert_eq!(summary.by_helper + summary.by_fallback, 12);
    assert!(summary.by_helper > 0 && summary.by_fallback > 0, "{summary:?}");
    assert_eq!(by_helper.iter().filter(|b| **b).count() as u64, summary.by_helper);
    assert!((1..=MAX_TOLD_FAULTS).contains(&summary.faults.len()), "{summary:?}");
    assert!(summary.faults.iter().all(|fault| fault.contains("ended early")), "{summary:?}");
}

#[test]
fn a_bake_does_not_wait_for_every_cluster_of_a_hanging_helper() {
    let (_, summary) = cut("hello; exec sleep 600", 1000, SHORT / 3);
    assert_eq!((summary.by_helper, summary.by_fallback), (0, 1000));
    let told = |what: &str| summary.faults.iter().any(|fault| fault.contains(what));
    assert!(told("gave no answer in") && told("is not asked any more"), "{summary:?}");
    const { assert!(MAX_HANGS < 10) };
}

#[test]
fn a_pool_that_has_given_up_says_why() {
    let workshop = Workshop::new();
    let pool = Pool::new(workshop.helper("hello; exec sleep 600")).unwrap();
    (0..MAX_HANGS).for_each(|_| drop(pool.charts(&request(), SHORT / 3).unwrap_err()));
    assert!(
        matches!(pool.charts(&request(), SHORT), Err(HelperFault::GivenUp(why)) if why.contains("ran out of time"))
    );
}

#[test]
fn one_that_does_not_start_again_is_not_asked_again() {
    let workshop = Workshop::new();
    let script = "echo x >> starts; [ $(wc -l < starts) = 1 ] || exit 1; hello; exit 1";
    let pool = Pool::new(workshop.helper(script)).unwrap();
    for _ in 0..10 {
        pool.charts(&request(), PATIENCE).unwrap_err();
    }
    assert_eq!(std::fs::read(workshop.path("starts")).unwrap(), b"x\nx\n");
}

#[test]
fn one_that_cannot_be_probed_makes_no_pool() {
    let workshop = Workshop::new();
    assert!(Pool::new(workshop.helper("exit 0")).is_err());
    let (by_helper, summary) = cut("exit 0", 3, PATIENCE);
    assert_eq!((by_helper, summary.by_fallback, summary.faults.len()), (vec![false; 3], 3, 1));
}
