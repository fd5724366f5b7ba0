//! The reference: the whole mesh collapsed by the meshopt crate, positions only, to given vertex counts.

use std::time::Instant;

use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};

use crate::mesh::Mesh;

/// One level of a chain.
pub struct Link {
    pub mesh: Mesh,
    /// Time of one simplification from the link before, seconds.
    pub seconds: f64,
}

/// Steps of the search for a vertex count.
const SEARCH_STEPS: usize = 12;

/// Simplifies `mesh` (welded) to each of `counts` distinct vertices in turn, each from the one before.
pub fn chain(mesh: &Mesh, counts: &[usize]) -> Vec<Link> {
    let (low, high) = mesh.bounds();
    let center: [f64; 3] = std::array::from_fn(|k| low[k].midpoint(high[k]));
    let positions: Vec<[f32; 3]> =
        mesh.positions.iter().map(|p| std::array::from_fn(|k| (p[k] - center[k]) as f32)).collect();
    let mut indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let mut links = Vec::new();
    for &count in counts {
        let seconds;
        (indices, seconds) = to_vertices(&indices, &positions, count);
        let triangles = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        links.push(Link { mesh: Mesh { positions: mesh.positions.clone(), triangles }.welded(), seconds });
    }
    links
}

/// A plain chain: `steps` simplifications, each to a quarter of the triangles; seconds.
pub fn quarters(mesh: &Mesh, steps: u32) -> f64 {
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.map(|x| x as f32)).collect();
    let mut indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let start = Instant::now();
    for _ in 0..steps {
        indices = to_indices(&indices, &positions, indices.len() / 12 * 3);
    }
    start.elapsed().as_secs_f64()
}

fn to_indices(indices: &[u32], positions: &[[f32; 3]], target: usize) -> Vec<u32> {
    let bytes = meshopt::typed_to_bytes(positions);
    let adapter = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0).expect("stride and offset fit the array");
    simplify(indices, &adapter, target, f32::MAX, SimplifyOptions::None, None)
}

/// The index count is what meshopt is told; the one that gives `count` vertices is searched for.
fn to_vertices(indices: &[u32], positions: &[[f32; 3]], count: usize) -> (Vec<u32>, f64) {
    let (mut low, mut high) = (0, indices.len() / 3);
    let mut guess = (count * 2).min(high);
    let mut best: Option<(usize, Vec<u32>, f64)> = None;
    for _ in 0..SEARCH_STEPS {
        let start = Instant::now();
        let result = to_indices(indices, positions, guess * 3);
        let seconds = start.elapsed().as_secs_f64();
        let vertices = used(&result, positions.len());
        let off = vertices.abs_diff(count);
        if best.as_ref().is_none_or(|b| off < b.0) {
            best = Some((off, result, seconds));
        }
        if off * 1000 <= count || high - low <= 1 {
            break;
        }
        if vertices < count {
            low = guess
        } else {
            high = guess
        }
        // About two triangles per vertex: step by the miss, inside the bracket.
        let step = guess as i64 + 2 * (count as i64 - vertices as i64);
        guess = if (low as i64 + 1..high as i64).contains(&step) { step as usize } else { low.midpoint(high) };
    }
    let (_, result, seconds) = best.expect("one step at least");
    (result, seconds)
}

fn used(indices: &[u32], vertices: usize) -> usize {
    let mut seen = vec![false; vertices];
    indices.iter().for_each(|&i| seen[i as usize] = true);
    seen.iter().filter(|s| **s).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Kind, generate};

    #[test]
    fn hits_the_vertex_counts_within_half_a_percent() {
        let mesh = generate(Kind::Sphere, 12_000, 1);
        let n = mesh.positions.len();
        for (link, wanted) in chain(&mesh, &[n / 4, n / 16, n / 64]).iter().zip([n / 4, n / 16, n / 64]) {
            let found = link.mesh.positions.len();
            assert!(found.abs_diff(wanted) * 200 <= wanted.max(200), "{found} of {wanted}");
        }
    }
}
