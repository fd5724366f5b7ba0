//! Is a surface closed? Counts edges after joining exactly equal positions, and nothing else is forgiven.

use std::collections::BTreeMap;

use crate::mesh::Mesh;

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Closedness {
    /// Triangles after joining; those that collapsed are not counted.
    pub triangles: usize,
    /// Distinct positions in use.
    pub vertices: usize,
    /// Directed edges without as many opposite ones: 0 for a closed surface.
    pub unmatched_edges: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
}

/// Checks one mesh.
pub fn check(mesh: &Mesh) -> Closedness {
    let mesh = mesh.welded();
    // Edge (smaller, larger) -> uses upwards, uses downwards.
    let mut edges: BTreeMap<(u32, u32), [usize; 2]> = BTreeMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.entry((from.min(to), from.max(to))).or_default()[(from > to) as usize] += 1;
        }
    }
    Closedness {
        triangles: mesh.triangles.len(),
        vertices: mesh.positions.len(),
        unmatched_edges: edges.values().map(|[up, down]| up.abs_diff(*down)).sum(),
        non_manifold_edges: edges.values().filter(|[up, down]| up + down > 2).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_of_one_bit_is_seen() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut mesh = Mesh { positions, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] };
        assert_eq!(check(&mesh).unmatched_edges, 0);
        mesh.positions.push([1.0, 0.0, f64::MIN_POSITIVE]);
        mesh.triangles[2][0] = 4;
        assert_eq!(check(&mesh).unmatched_edges, 4);
    }

    #[test]
    fn a_fin_is_no_manifold() {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]] };
        assert_eq!(check(&mesh).non_manifold_edges, 1);
    }
}
