//! Rounding to integers of 1 / 65536 of the tile without turning a triangle over.

use crate::charts::tile_area2;
use std::collections::BTreeMap;

/// Rounds of moving corners of triangles that are turned over.
const ROUNDS: usize = 4;
/// How far from where it was rounded to a corner may be moved, in integers.
const REACH: i32 = 2;

/// Moves corners of turned triangles by as little as it takes. `vertex_of`: which vertex a corner is, before rounding.
/// Returns the triangles that are still turned, which got the coordinates of their first corner.
pub(super) fn turn_back<K: Ord>(corners: &mut [[[u16; 2]; 3]], vertex_of: impl Fn(usize, usize) -> K) -> Vec<u32> {
    let turned = |corners: &[[[u16; 2]; 3]]| -> Vec<usize> {
        (0..corners.len()).filter(|&t| tile_area2(corners[t]) < 0).collect()
    };
    let mut bad = turned(corners);
    if bad.is_empty() {
        return Vec::new();
    }
    let mut around: BTreeMap<K, Vec<(u32, u8)>> = BTreeMap::new();
    for &t in &bad {
        (0..3).for_each(|k| drop(around.insert(vertex_of(t, k), Vec::new())));
    }
    for t in 0..corners.len() {
        for k in 0..3 {
            if let Some(list) = around.get_mut(&vertex_of(t, k)) {
                list.push((t as u32, k as u8));
            }
        }
    }
    let rounded: BTreeMap<&K, [u16; 2]> =
        around.iter().map(|(key, list)| (key, corners[list[0].0 as usize][list[0].1 as usize])).collect();
    for _ in 0..ROUNDS {
        for &t in &bad {
            for k in 0..3 {
                // A triangle that a move has turned over may have vertices that stay where they are.
                let vertex = vertex_of(t, k);
                let (Some(list), Some(&home)) = (around.get(&vertex), rounded.get(&vertex)) else { continue };
                if tile_area2(corners[t]) < 0 {
                    nudge(corners, list, home);
                }
            }
        }
        bad = turned(corners);
        if bad.is_empty() {
            return Vec::new();
        }
    }
    bad.iter().for_each(|&t| corners[t] = [corners[t][0]; 3]);
    bad.into_iter().map(|t| t as u32).collect()
}

/// Moves one vertex to the place nearest to `rounded` where its triangles are turned the least.
fn nudge(corners: &mut [[[u16; 2]; 3]], around: &[(u32, u8)], rounded: [u16; 2]) {
    let old = rounded.map(i32::from);
    let wrong = |at: [u16; 2], corners: &[[[u16; 2]; 3]]| -> i64 {
        let turned = around.iter().map(|&(t, k)| {
            let mut c = corners[t as usize];
            c[k as usize] = at;
            tile_area2(c).min(0)
        });
        turned.sum()
    };
    let mut best = (-wrong(rounded, corners), 0, rounded);
    for dy in -REACH..=REACH {
        for dx in -REACH..=REACH {
            let (x, y) = (u16::try_from(old[0] + dx), u16::try_from(old[1] + dy));
            let (Ok(x), Ok(y)) = (x, y) else { continue };
            best = best.min((-wrong([x, y], corners), dx * dx + dy * dy, [x, y]));
        }
    }
    around.iter().for_each(|&(t, k)| corners[t as usize][k as usize] = best.2);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_triangle_is_turned_back_with_its_neighbours_in_order() {
        // Two triangles on the edge (1, 2); the corner 3 of the second was rounded to the wrong side.
        let place = [[0u16, 0], [10, 0], [10, 10], [9, 5]];
        let triangles = [[0usize, 1, 2], [1, 3, 2]];
        let mut corners = triangles.map(|t| t.map(|v| place[v])).to_vec();
        assert!(tile_area2(corners[1]) < 0);
        assert_eq!(turn_back(&mut corners, |t, k| triangles[t][k]), Vec::<u32>::new());
        assert!(corners.iter().all(|c| tile_area2(*c) >= 0));
        assert_eq!(corners[0][1], corners[1][0]);
    }

    #[test]
    fn a_hopeless_triangle_becomes_a_point() {
        let mut corners = vec![[[0, 0], [0, 500], [500, 0]]];
        assert_eq!(turn_back(&mut corners, |t, k| (t, k)), [0]);
        assert!(corners[0].iter().all(|c| *c == corners[0][0]) && corners[0][0][0] <= 2, "{corners:?}");
    }
}
