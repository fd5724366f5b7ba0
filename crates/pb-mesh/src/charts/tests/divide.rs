//! Dividing layouts that lie on themselves.

use super::shapes::{self, Shape};
use crate::charts::divide::divide;
use crate::charts::outline::overlaps;
use crate::charts::piece::{NONE, Piece, partners};
use glam::{DVec2, DVec3};

/// A shape as one piece, and where its vertices go by `layout`.
fn laid_out(shape: &Shape, layout: impl Fn(DVec3) -> DVec2) -> (Piece, Vec<DVec2>) {
    let faces: Vec<u32> = (0..shape.triangles.len() as u32).collect();
    let partner = partners(&shape.triangles, |_| 0);
    let point =
        |f: u32, k: usize| DVec3::from_array(shape.positions[shape.triangles[f as usize][k] as usize].map(f64::from));
    let piece = Piece::new(&faces, &partner, point, &mut vec![NONE; faces.len()]);
    let uv = piece.points.iter().map(|p| layout(*p)).collect();
    (piece, uv)
}

/// A ramp of some turns as seen from below: each turn lies on the one before.
fn ramp(turns: f32) -> (Piece, Vec<DVec2>) {
    laid_out(&shapes::ramp([(48.0 * turns) as u32, 6], turns), |p| DVec2::new(p.y, p.x))
}

/// A sheet with a short slit near a corner, whose upper side lies a little over the lower one.
fn slit() -> (Piece, Vec<DVec2>) {
    let mut shape = shapes::grid([24, 24], [false; 2], |u, v| [u, v, 0.0]);
    let (row, above) = (18 * 25, 18 * 48);
    let copy = shape.positions.len() as u32;
    (0..6).for_each(|i| shape.positions.push([shape.positions[row + i][0] + 0.003, 0.74, 0.01]));
    for v in shape.triangles[above..].iter_mut().flatten() {
        if (row..row + 6).contains(&(*v as usize)) {
            *v += copy - row as u32;
        }
    }
    laid_out(&shape, |p| DVec2::new(p.x, p.y))
}

#[test]
fn what_is_cut_too_much_is_joined_again() {
    let (disc, uv) = slit();
    assert!(overlaps(&disc, &uv));
    let (done, rest) = divide(&disc, &uv, 1.25);
    assert_eq!((done.len(), rest.len()), (2, 0));
}

#[test]
fn parts_do_not_lie_on_themselves_and_are_few() {
    for (turns, most) in [(1.5, 2), (2.5, 5), (5.5, 11)] {
        let (disc, uv) = ramp(turns);
        assert!(overlaps(&disc, &uv));
        let (done, rest) = divide(&disc, &uv, 1.25);
        assert_eq!(rest, Vec::<Vec<u32>>::new());
        assert!(done.len() > turns as usize && done.len() <= most, "{turns} turns: {} parts", done.len());
        let mut faces: Vec<u32> = done.iter().flat_map(|d| d.piece.faces.clone()).collect();
        faces.sort_unstable();
        assert_eq!(faces, disc.faces);
        for part in &done {
            assert_eq!(part.piece.euler_characteristic(), 1);
            assert!(!overlaps(&part.piece, &part.uv) && part.stretch.l2() < 1.1);
            for (&f, t) in part.piece.faces.iter().zip(&part.piece.triangles) {
                assert_eq!(t.map(|v| part.uv[v as usize]), disc.triangles[f as usize].map(|v| uv[v as usize]));
            }
        }
    }
}

#[test]
fn parts_that_are_stretched_too_much_get_another_layout() {
    let (disc, uv) = ramp(2.5);
    let flat: Vec<DVec2> = uv.iter().map(|p| *p * DVec2::new(1.0, 0.1)).collect();
    let (done, rest) = divide(&disc, &flat, 1.25);
    assert!(done.is_empty() && rest.len() > 1);
    assert_eq!(rest.iter().map(Vec::len).sum::<usize>(), disc.faces.len());
}
