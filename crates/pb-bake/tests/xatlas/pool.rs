//! Many clusters: those that the helper cannot cut are cut otherwise, and counted.

use super::fake::{PATIENCE, SHORT, Workshop, charts, request};
use pb_bake::xatlas::{HelperFault, HelperReport, MAX_FIRST_FAULTS, MAX_HANGS, Pool, charts_with_helper};
use std::time::Duration;

/// Whether the helper cut each of `count` clusters, and the report.
fn cut(pool: &Pool, count: usize, limit: Duration) -> (Vec<bool>, HelperReport) {
    charts_with_helper(pool, &vec![(); count], limit, |_| request(), |c| c == charts(), |_, _| false)
}

#[test]
fn a_good_helper_cuts_all_clusters() {
    let workshop = Workshop::new();
    let pool = Pool::new(workshop.helper("hello; while answer; do :; done")).unwrap();
    let (by_helper, report) = cut(&pool, 20, PATIENCE);
    assert_eq!((by_helper, report.by_helper, report.by_fallback), (vec![true; 20], 20, 0));
    assert!(report.first_faults.is_empty());
}

#[test]
fn one_that_dies_after_each_cluster_is_started_again() {
    let workshop = Workshop::new();
    let pool = Pool::new(workshop.helper("hello; answer; head -c 9 > /dev/null; kill -9 $$")).unwrap();
    let (by_helper, report) = cut(&pool, 12, PATIENCE);
    assert_eq!(report.by_helper + report.by_fallback, 12);
    assert!(report.by_helper > 0 && report.by_fallback > 0, "{report:?}");
    assert_eq!(by_helper.iter().filter(|b| **b).count(), report.by_helper);
    assert_eq!(report.first_faults.len(), report.by_fallback.min(MAX_FIRST_FAULTS));
    for (number, fault) in &report.first_faults {
        assert!(!by_helper[*number] && matches!(fault, HelperFault::Died { .. }), "{number}: {fault}");
    }
}

#[test]
fn a_bake_does_not_wait_for_every_cluster_of_a_hanging_helper() {
    let workshop = Workshop::new();
    let pool = Pool::new(workshop.helper("hello; exec sleep 600")).unwrap();
    let (_, report) = cut(&pool, 1000, SHORT / 3);
    assert_eq!((report.by_helper, report.by_fallback), (0, 1000));
    assert!(matches!(report.first_faults[0].1, HelperFault::TimedOut { .. } | HelperFault::GivenUp(_)));
    assert!(
        matches!(pool.charts(&request(), SHORT), Err(HelperFault::GivenUp(why)) if why.contains("ran out of time"))
    );
    const { assert!(MAX_HANGS < 10) };
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
}
