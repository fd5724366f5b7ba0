//! Cutting a part in two along a line where its normals turn: two proxies of variational shape approximation (Cohen-
//! Steiner, Alliez, Desbrun 2004), with the place counting a little as well.

use super::piece::{NONE, Piece};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Rounds of growing both halves from new seeds, where they matter.
pub(super) const ROUNDS: usize = 4;
/// Rounds in which triangles change to the half that has most of their neighbours.
const SMOOTHING: usize = 4;
/// Rounds that average the normals of neighbours, against noise.
const NORMAL_ROUNDS: usize = 3;

/// A plane patch that stands for a half.
#[derive(Clone, Copy)]
struct Proxy {
    normal: DVec3,
    centre: DVec3,
}

/// Half (0 or 1) of each triangle of a connected `piece` with two or more; both occur. `place`: weight of the distance,
/// in radii of the piece, against the difference of unit normals; `rounds`: of growing both halves from new seeds, 1 or more.
pub(super) fn halve(piece: &Piece, place: f64, rounds: usize) -> Vec<u8> {
    let n = piece.triangles.len();
    let centres: Vec<DVec3> =
        piece.triangles.iter().map(|t| t.iter().map(|&v| piece.points[v as usize]).sum::<DVec3>() / 3.0).collect();
    let areas: Vec<f64> = (0..n).map(|t| piece.normal2(t).length()).collect();
    let normals = smooth_normals(piece);
    let all = proxy(&normals, &centres, &areas, |_| true);
    let radius2 = centres.iter().map(|c| c.distance_squared(all.centre)).fold(f64::MIN_POSITIVE, f64::max);
    let distance = |t: usize, p: &Proxy| {
        (normals[t] - p.normal).length_squared() + place * centres[t].distance_squared(p.centre) / radius2
    };
    let at = |t: usize| Proxy { normal: normals[t], centre: centres[t] };
    let farthest =
        |p: &Proxy| (0..n).fold((0, -1.0), |m, t| if distance(t, p) > m.1 { (t, distance(t, p)) } else { m }).0;
    let first = farthest(&all);
    let mut proxies = [at(first), at(farthest(&at(first)))];
    let mut seeds = [first, farthest(&at(first))];
    let mut half = Vec::new();
    for round in 0..rounds {
        if seeds[0] == seeds[1] {
            seeds = [0, n - 1];
        }
        half = grow(piece, seeds, |t, k| distance(t, &proxies[k]));
        if round + 1 == rounds {
            break;
        }
        for k in 0..2 {
            proxies[k] = proxy(&normals, &centres, &areas, |t| half[t] == k as u8);
            let mine = (0..n).filter(|&t| half[t] == k as u8);
            let best = mine.map(|t| (distance(t, &proxies[k]), t)).min_by(|a, b| a.0.total_cmp(&b.0));
            seeds[k] = best.map_or(seeds[k], |b| b.1);
        }
    }
    straighten(piece, &mut half, seeds);
    half
}

fn proxy(normals: &[DVec3], centres: &[DVec3], areas: &[f64], mine: impl Fn(usize) -> bool) -> Proxy {
    let mut sums = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for t in (0..normals.len()).filter(|&t| mine(t)) {
        sums = (sums.0 + areas[t] * normals[t], sums.1 + areas[t] * centres[t], sums.2 + areas[t]);
    }
    let centre = if sums.2 > 0.0 { sums.1 / sums.2 } else { centres[0] };
    Proxy { normal: sums.0.normalize_or_zero(), centre }
}

/// Unit normals, averaged over neighbours.
fn smooth_normals(piece: &Piece) -> Vec<DVec3> {
    let mut normals: Vec<DVec3> = (0..piece.triangles.len()).map(|t| piece.normal2(t)).collect();
    for _ in 0..NORMAL_ROUNDS {
        let mut at = vec![DVec3::ZERO; piece.points.len()];
        for (t, n) in piece.triangles.iter().zip(&normals) {
            t.iter().for_each(|&v| at[v as usize] += *n);
        }
        normals = piece.triangles.iter().map(|t| t.iter().map(|&v| at[v as usize]).sum()).collect();
    }
    normals.into_iter().map(|n| n.normalize_or_zero()).collect()
}

/// Grows both halves from their seeds, the nearest triangle next.
fn grow(piece: &Piece, seeds: [usize; 2], distance: impl Fn(usize, usize) -> f64) -> Vec<u8> {
    const FREE: u8 = 2;
    let mut half = vec![FREE; piece.triangles.len()];
    let mut queue = BinaryHeap::with_capacity(piece.triangles.len());
    let spread = |t: u32, k: u8, half: &[u8], queue: &mut BinaryHeap<_>| {
        for &across in piece.partner[3 * t as usize..3 * t as usize + 3].iter().filter(|&&p| p != NONE) {
            if half[across as usize / 3] == FREE {
                let cost = distance(across as usize / 3, k as usize);
                queue.push(Reverse((cost.to_bits(), across / 3, k)));
            }
        }
    };
    // Both seeds first: no half may swallow the other's.
    seeds.iter().zip(0..).for_each(|(&seed, k)| half[seed] = k);
    seeds.iter().zip(0..).for_each(|(&seed, k)| spread(seed as u32, k, &half, &mut queue));
    while let Some(Reverse((_, t, k))) = queue.pop() {
        if half[t as usize] == FREE {
            half[t as usize] = k;
            spread(t, k, &half, &mut queue);
        }
    }
    half
}

/// Lets triangles with most neighbours in the other half change over; the seeds stay, so both halves do.
fn straighten(piece: &Piece, half: &mut [u8], seeds: [usize; 2]) {
    for _ in 0..SMOOTHING {
        let mut changed = false;
        for t in (0..half.len()).filter(|t| !seeds.contains(t)) {
            let across = piece.partner[3 * t..3 * t + 3].iter().filter(|&&p| p != NONE);
            let (others, mine) = across.fold((0, 0), |(o, m), &p| match half[p as usize / 3] == half[t] {
                true => (o, m + 1),
                false => (o + 1, m),
            });
            if others > mine {
                half[t] = 1 - half[t];
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
}
