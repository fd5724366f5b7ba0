//! Some minutes of simulated flying, and hours of it where PB_SIMULATE_HOURS says how many.

use super::*;

#[test]
fn bounds_hold_and_views_come_to_rest_in_random_scenes() {
    let hours = std::env::var("PB_SIMULATE_HOURS").ok().and_then(|h| h.parse().ok()).unwrap_or(1.0);
    let (tally, _) = simulate(7, hours, None).unwrap();
    println!("{}", tally.report(0.0));
    // All that can happen did.
    let happened = [tally.failures, tally.refused, tally.retired, tally.freed, tally.replayed];
    assert!(happened.iter().all(|&n| n > 40), "{tally:?}");
    assert!(tally.fullest > 0.99, "no bound was touched: {tally:?}");
}

#[test]
fn the_same_seed_flies_the_same() {
    let some = |seed| (0..3).map(|scene| fly_scene(seed, scene, None).unwrap()).collect::<Vec<Tally>>();
    assert_eq!(some(3), some(3));
    assert_ne!(some(3), some(4));
}

#[test]
fn a_bound_on_triangles_and_wants_all_around_come_to_rest() {
    fly_scene(1, 2995, None).unwrap();
}
