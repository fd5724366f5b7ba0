//! Charts that came in the right form are still checked against the cluster.

use super::fake::{PATIENCE, Workshop, charts, request};
use pb_bake::xatlas::wire::{Kind, message};
use pb_bake::xatlas::{AnswerFault, Charts, HelperFault, Pool, check};

/// Through a helper and a pool, as in a bake.
fn fault_of(charts: &Charts) -> HelperFault {
    let workshop = Workshop::new();
    workshop.put("charts", &message(Kind::ChartsAnswer, &charts.encode()));
    let pool = Pool::new(workshop.helper("hello; cat charts; cat > taken")).unwrap();
    pool.charts(&request(), PATIENCE).expect_err("the charts are bad")
}

fn answer_fault(spoil: impl Fn(&mut Charts)) -> AnswerFault {
    let mut charts = charts();
    spoil(&mut charts);
    match fault_of(&charts) {
        HelperFault::BadCharts(fault) => fault,
        other => panic!("{other:?}"),
    }
}

#[test]
fn good_charts_pass() {
    let (request, mut charts) = (request(), charts());
    assert_eq!(check(&request.positions, &request.triangles, &charts), Ok(()));
    (charts.chart_of, charts.count) = (vec![1, 0], 2);
    charts.uv[1] = [[0.0, 0.0], [0.0, -1.0], [1.0, 0.0]];
    assert_eq!(check(&request.positions, &request.triangles, &charts), Ok(()));
}

#[test]
fn other_counts_are_refused() {
    let mut one = charts();
    one.chart_of.pop();
    one.uv.pop();
    assert!(matches!(fault_of(&one), HelperFault::Garbage(_)));
    let request = request();
    let fault = AnswerFault::Counts { found: 1, triangles: 2 };
    assert_eq!(check(&request.positions, &request.triangles, &one), Err(fault));
    // The counts inside the answer are lies, its length is right.
    let workshop = Workshop::new();
    let mut body = charts().encode();
    body[0] = 9;
    workshop.put("charts", &message(Kind::ChartsAnswer, &body));
    let fault = workshop.charts_of("hello; cat charts", PATIENCE).unwrap_err();
    assert!(matches!(fault, HelperFault::Garbage(_)), "{fault:?}");
}

#[test]
fn numbers_that_are_none_are_refused() {
    assert_eq!(answer_fault(|c| c.uv[1][2][0] = f32::NAN), AnswerFault::NotFinite(1));
    assert_eq!(answer_fault(|c| c.uv[0][0][1] = f32::INFINITY), AnswerFault::NotFinite(0));
}

#[test]
fn triangles_that_are_turned_over_are_refused() {
    assert_eq!(answer_fault(|c| c.uv.iter_mut().flatten().for_each(|p| p[0] *= -1.0)), AnswerFault::Flipped(0));
    assert_eq!(answer_fault(|c| c.uv[1][2] = [1.0, 0.0]), AnswerFault::Flipped(1));
}

#[test]
fn charts_that_are_not_there_are_refused() {
    assert_eq!(answer_fault(|c| c.chart_of[1] = 1), AnswerFault::NoSuchChart { triangle: 1, chart: 1, count: 1 });
    assert_eq!(
        answer_fault(|c| c.chart_of[0] = u32::MAX),
        AnswerFault::NoSuchChart { triangle: 0, chart: u32::MAX, count: 1 }
    );
    assert_eq!(answer_fault(|c| c.count = 2), AnswerFault::Empty(1));
    assert_eq!(answer_fault(|c| (c.chart_of, c.count) = (vec![1, 1], 2)), AnswerFault::Empty(0));
    assert_eq!(answer_fault(|c| c.count = u32::MAX), AnswerFault::Empty(u32::MAX - 1));
}

#[test]
fn torn_charts_are_refused() {
    let shift = |c: &mut Charts| c.uv[1].iter_mut().for_each(|p| p[0] += 0.5);
    assert_eq!(answer_fault(shift), AnswerFault::Torn { chart: 0, triangle: 1 });
}

#[test]
fn charts_of_absurd_size_are_refused() {
    for factor in [0.0, 1e-3, 3.0, 1e20] {
        let fault = answer_fault(|c| c.uv.iter_mut().flatten().flatten().for_each(|x| *x *= factor));
        assert!(matches!(fault, AnswerFault::Size { chart: 0, .. }), "{factor}: {fault}");
    }
    let long = answer_fault(|c| c.uv.iter_mut().flatten().for_each(|p| *p = [p[0] * 1e4, p[1] * 1e-4]));
    assert!(matches!(long, AnswerFault::Size { .. }), "{long}");
}

#[test]
fn charts_that_lie_over_themselves_are_refused() {
    // In two charts they may; in one they may touch.
    let positions =
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0]];
    let triangles = [[0, 1, 2], [3, 4, 5]];
    let uv = vec![[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.9, 0.1], [2.5, 0.0], [1.5, 1.0]]];
    let mut charts = Charts { chart_of: vec![0, 1], count: 2, uv };
    assert_eq!(check(&positions, &triangles, &charts), Ok(()));
    (charts.chart_of, charts.count) = (vec![0, 0], 1);
    let fault = AnswerFault::Overlap { chart: 0, first: 0, second: 1 };
    assert_eq!(check(&positions, &triangles, &charts), Err(fault));
    charts.uv[1].iter_mut().for_each(|p| p[0] += 0.1);
    assert_eq!(check(&positions, &triangles, &charts), Ok(()));
}
