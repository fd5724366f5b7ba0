//! A quick estimate of the distance between two levels, where several are to be compared.

use super::back::{Below, Walk, inner_points};
use super::{Field, LevelPair, NONE, facets, relative};
use crate::closest::closest_on_triangle;
use glam::Vec3;

/// Samples along the edge of a coarse triangle at most.
const MAX_STEPS: u32 = 8;

/// Triangles that are looked at for the positions of vanished components at most.
const MAX_LOOKS: usize = 1 << 20;

/// Distances between a surface and a level of it, grid quanta.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Mean square over the finer surface, by area.
    pub mean_square: f64,
    /// The largest that was seen, both ways.
    pub max: f32,
}

/// Estimates by the finer surface's positions, and by points of the coarse triangles, about as many. Asks for no clusters
/// of the pair.
pub fn estimate(pair: &LevelPair) -> Estimate {
    let facets = facets(pair);
    let field = Field { pair, fans: pair.fans, facets: &facets };
    let mut nearest = field.nearest();
    find_lost(&field, &mut nearest);
    let (mut squares, mut areas, mut max) = (0.0, 0.0, 0f32);
    for &t in pair.triangles {
        let images = t.map(|v| nearest[v as usize]);
        let (square, area) = field.weighted_square(t, images);
        (squares, areas) = (squares + square, areas + area);
        max = images.iter().map(|i| i.0).fold(max, f32::max);
    }
    let per_triangle = pair.positions.len() as f32 / pair.coarse.len().max(1) as f32;
    let steps = ((2.0 * per_triangle).sqrt() as u32).clamp(2, MAX_STEPS);
    let below = Below::new(&nearest, pair.coarse.len());
    for (i, tri) in pair.coarse.iter().enumerate() {
        let p = tri.map(|v| relative(pair.positions, tri[0], v));
        let mut last = tri[0];
        let mut look = |at: Vec3, k: usize| {
            let enough = max * max;
            let quick;
            (quick, last) = field.quick_distance_back(tri[0], [tri[k], last], at, enough);
            if quick > max {
                let starts = below.nearest(&field, i, at).into_iter().chain(*tri);
                let far = |v: u32| field.distance_back([tri[0], v], at, Walk::Thorough, enough).0;
                let mut least = f32::INFINITY;
                // As far as it matters.
                starts.map(far).any(|d| {
                    least = least.min(d);
                    least <= max
                });
                max = max.max(least);
            }
        };
        for (weights, nearest) in inner_points(steps) {
            look(p[0] * weights[0] + p[1] * weights[1] + p[2] * weights[2], nearest);
        }
        look((p[0] + p[1] + p[2]) / 3.0, 0);
    }
    Estimate { mean_square: squares / f64::max(areas, f64::MIN_POSITIVE), max }
}

/// Positions of components that have vanished are as far away as the rest of the level is. Where there are too many of them for a
/// look at all triangles, they count with the size of the component.
fn find_lost(field: &Field, nearest: &mut [(f32, u32)]) {
    let is_lost = |v: usize| nearest[v].1 == NONE && !field.pair.fine.around(v as u32).is_empty();
    let lost: Vec<usize> = (0..nearest.len()).filter(|&v| is_lost(v)).collect();
    if lost.len() * field.pair.coarse.len() > MAX_LOOKS {
        return;
    }
    for v in lost {
        let to = |t: u32| closest_on_triangle(Vec3::ZERO, field.corners(v as u32, t)).length();
        nearest[v].0 = (0..field.pair.coarse.len() as u32).map(to).fold(f32::INFINITY, f32::min);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topology::Fans;

    /// A wavy sheet of squares, and for every position the corner of its block of four by four squares.
    fn sheet(side: u32) -> (Vec<[i32; 3]>, Vec<[u32; 3]>, Vec<u32>) {
        let at = |x: u32, y: u32| y * (side + 1) + x;
        let height = |x: u32, y: u32| 900.0 * ((x as f32 * 0.31).sin() + (y as f32 * 0.23 + x as f32 * 0.07).cos());
        let all = || (0..=side).flat_map(move |y| (0..=side).map(move |x| (x, y)));
        let positions = all().map(|(x, y)| [x as i32 * 500, y as i32 * 500, height(x, y) as i32]).collect();
        let squares = all().filter(|&(x, y)| x < side && y < side);
        let halves = |(x, y)| [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]];
        (positions, squares.flat_map(halves).collect(), all().map(|(x, y)| at(x / 4 * 4, y / 4 * 4)).collect())
    }

    /// The estimate of a level that positions collapsed into as `ancestors` say.
    fn estimate_of(positions: &[[i32; 3]], triangles: &[[u32; 3]], coarse: &[[u32; 3]], ancestors: &[u32]) -> Estimate {
        estimate(&LevelPair {
            positions,
            triangles,
            fine: &Fans::new(positions.len(), triangles),
            cluster_of: &[],
            coarse,
            fans: &Fans::new(positions.len(), coarse),
            coarse_cluster_of: &[],
            ancestors,
            open: &vec![false; positions.len()],
        })
    }

    #[test]
    fn it_is_near_what_a_look_at_all_triangles_tells() {
        let (positions, triangles, ancestors) = sheet(40);
        let shrunk = triangles.iter().map(|t| t.map(|v| ancestors[v as usize]));
        let coarse: Vec<[u32; 3]> = shrunk.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).collect();
        let found = estimate_of(&positions, &triangles, &coarse, &ancestors);
        let at = |v: u32| Vec3::from_array(positions[v as usize].map(|x| x as f32));
        let distance = |p: Vec3, to: &[[u32; 3]]| {
            to.iter().map(|t| closest_on_triangle(p, t.map(at)).distance(p)).fold(f32::INFINITY, f32::min)
        };
        let there: Vec<f32> = (0..positions.len() as u32).map(|v| distance(at(v), &coarse)).collect();
        let points = |t: &[u32; 3]| {
            let p = t.map(at);
            inner_points(6).map(move |(w, _)| p[0] * w[0] + p[1] * w[1] + p[2] * w[2]).collect::<Vec<_>>()
        };
        let back = coarse.iter().flat_map(points).map(|p| distance(p, &triangles)).fold(0.0, f32::max);
        let max = there.iter().copied().fold(back, f32::max);
        let mean = (there.iter().map(|d| d * d).sum::<f32>() / there.len() as f32).sqrt();
        let (found_mean, found_max) = (found.mean_square.sqrt() as f32, found.max);
        assert!((found_max / max - 1.0).abs() < 0.1, "{found_max} instead of {max}");
        assert!((found_mean / mean - 1.0).abs() < 0.1, "{found_mean} instead of {mean}");
    }

    #[test]
    fn a_component_that_vanished_is_as_far_away_as_what_is_left() {
        let (mut positions, mut triangles, _) = sheet(12);
        let (first, sheet) = (positions.len() as u32, triangles.clone());
        let top = positions.iter().map(|p| p[2]).max().unwrap() + 4000;
        positions.extend([[2600, 2600, top], [2700, 2600, top], [2600, 2700, top]]);
        triangles.push([first, first + 1, first + 2]);
        let mut ancestors: Vec<u32> = (0..first + 3).collect();
        ancestors[first as usize..].fill(first);
        let found = estimate_of(&positions, &triangles, &sheet, &ancestors);
        assert!((3000.0..9000.0).contains(&found.max), "{}", found.max);
    }

    #[test]
    fn a_level_that_is_the_surface_is_not_away_from_it() {
        let (positions, triangles, _) = sheet(12);
        let ancestors: Vec<u32> = (0..positions.len() as u32).collect();
        let found = estimate_of(&positions, &triangles, &triangles, &ancestors);
        assert_eq!(found.mean_square, 0.0);
        assert!(found.max < 0.01, "{}", found.max);
    }
}
