//! Meshes made from a seed: stand-ins for scans where the real ones are absent, and small fixtures.

use std::collections::HashMap;

use crate::mesh::Mesh;
use crate::random::{Random, noise, octaves};

/// What to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// A closed sphere with bumps of a few sizes.
    Sphere,
    /// A closed torus with detail at every scale, down to the edge length, as a scan has it.
    Torus,
    /// An open height field.
    Terrain,
    /// Many small closed parts.
    Parts,
    /// Very many tetrahedra, each closed and by itself.
    Crumbs,
}

/// A mesh of about `triangles` triangles, about 1 unit in size (terrain 10).
pub fn generate(kind: Kind, triangles: usize, seed: u64) -> Mesh {
    match kind {
        Kind::Sphere => sphere(triangles, seed),
        Kind::Torus => torus(triangles, seed),
        Kind::Terrain => terrain(triangles, seed),
        Kind::Parts => parts(triangles, seed),
        Kind::Crumbs => crumbs(triangles, seed),
    }
}

/// The surface of a cube of `n` x `n` x `n` cells, blown up to a sphere: `12 n^2` triangles.
fn sphere(triangles: usize, seed: u64) -> Mesh {
    let n = ((triangles as f64 / 12.0).sqrt().round() as u32).max(1);
    let shape = |p: [f64; 3]| {
        let radius = 0.5 + 0.06 * octaves(p.map(|x| x * 2.0), seed, 5, 0.5);
        p.map(|x| x * radius)
    };
    cube_sphere(n, shape)
}

fn cube_sphere(n: u32, shape: impl Fn([f64; 3]) -> [f64; 3]) -> Mesh {
    let (mut mesh, mut seen) = (Mesh::default(), HashMap::new());
    let mut vertex = |mesh: &mut Mesh, lattice: [u32; 3]| -> u32 {
        *seen.entry(lattice).or_insert_with(|| {
            // Equal angles rather than equal steps, so that cells have about the same size.
            let p = lattice.map(|c| ((f64::from(c) / f64::from(n) * 2.0 - 1.0) * std::f64::consts::FRAC_PI_4).tan());
            let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            mesh.positions.push(shape(p.map(|x| x / length)));
            mesh.positions.len() as u32 - 1
        })
    };
    for (axis, far) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
        for (u, v) in (0..n).flat_map(|v| (0..n).map(move |u| (u, v))) {
            let lattice = |a: u32, b: u32| {
                let mut l = [0; 3];
                l[axis] = if far { n } else { 0 };
                (l[(axis + 1) % 3], l[(axis + 2) % 3]) = (a, b);
                l
            };
            let [a, b, c, d] =
                [(u, v), (u + 1, v), (u + 1, v + 1), (u, v + 1)].map(|(a, b)| vertex(&mut mesh, lattice(a, b)));
            mesh.triangles.extend(if far { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }
    mesh
}

fn torus(triangles: usize, seed: u64) -> Mesh {
    let across = ((triangles as f64 / 6.0).sqrt().round() as u32).max(3);
    let around = across * 3;
    let detail = f64::from(around).log2().ceil() as u32;
    let mut mesh = Mesh::default();
    for (u, v) in (0..across).flat_map(|v| (0..around).map(move |u| (u, v))) {
        let angle = |i: u32, n: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        let ((su, cu), (sv, cv)) = (angle(u, around).sin_cos(), angle(v, across).sin_cos());
        let base = [(1.0 + 0.4 * cv) * cu, (1.0 + 0.4 * cv) * su, 0.4 * sv];
        let ridge = 1.0 - noise(base.map(|x| x * 3.0), seed ^ 1).abs();
        let radius = 0.13 + 0.03 * octaves(base.map(|x| x * 3.0), seed, detail, 0.45) + 0.02 * ridge * ridge;
        mesh.positions.push([(0.36 + radius * cv) * cu, (0.36 + radius * cv) * su, radius * sv]);
        let at = |u: u32, v: u32| v % across * around + u % around;
        let [a, b, c, d] = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
        mesh.triangles.extend(if (u + v) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
    }
    mesh
}

fn terrain(triangles: usize, seed: u64) -> Mesh {
    let n = ((triangles as f64 / 2.0).sqrt().round() as u32).max(1);
    let mut mesh = Mesh::default();
    for (x, y) in (0..=n).flat_map(|y| (0..=n).map(move |x| (x, y))) {
        let p = [x, y].map(|c| f64::from(c) / f64::from(n) * 10.0);
        let ridge = 1.0 - octaves([p[0] * 0.3, p[1] * 0.3, 0.5], seed, 10, 0.5).abs();
        mesh.positions.push([p[0], p[1], ridge * ridge + 0.2 * noise([p[0] * 0.2, p[1] * 0.2, 9.5], seed)]);
    }
    let at = |x: u32, y: u32| y * (n + 1) + x;
    for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }
    mesh
}

/// Little spheres of 12 to 432 triangles in a unit cube, sizes over two orders of magnitude.
fn parts(triangles: usize, seed: u64) -> Mesh {
    let (mut random, mut mesh) = (Random::new(seed), Mesh::default());
    while mesh.triangles.len() < triangles {
        let cells = 1 + (random.unit() * 6.0) as u32;
        let center: [f64; 3] = std::array::from_fn(|_| random.unit());
        let size = 0.05 * 0.01f64.powf(random.unit());
        let stretch: [f64; 3] = std::array::from_fn(|_| size * (0.3 + random.unit()));
        let part = cube_sphere(cells, |p| std::array::from_fn(|k| center[k] + p[k] * stretch[k]));
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(part.positions);
        mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + first)));
    }
    mesh
}

/// Tetrahedra of 4 triangles in a unit cube, turned anyhow, about as far apart as they are large.
fn crumbs(triangles: usize, seed: u64) -> Mesh {
    let (mut random, mut mesh) = (Random::new(seed), Mesh::default());
    let count = (triangles / 4).max(1);
    let size = 0.5 / (count as f64).cbrt();
    let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    for i in 0..count as u32 {
        let center: [f64; 3] = std::array::from_fn(|_| random.unit());
        let size = size * (0.3 + random.unit());
        let [(sa, ca), (sb, cb)] = [0, 1].map(|_| (random.unit() * std::f64::consts::TAU).sin_cos());
        let turned = |[x, y, z]: [f64; 3]| {
            let (x, y) = (x * ca - y * sa, x * sa + y * ca);
            [x, y * cb - z * sb, y * sb + z * cb]
        };
        mesh.positions.extend(corners.map(|c| {
            let at = turned(c);
            std::array::from_fn(|k| center[k] + at[k] * size)
        }));
        let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
        mesh.triangles.extend(faces.map(|t: [u32; 3]| t.map(|v| v + 4 * i)));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watertight::check;

    #[test]
    fn every_kind_has_about_the_triangles_asked_for() {
        for kind in [Kind::Sphere, Kind::Torus, Kind::Terrain, Kind::Parts, Kind::Crumbs] {
            let count = generate(kind, 20_000, 1).triangles.len() as f64;
            assert!((count / 20_000.0 - 1.0).abs() < 0.05, "{kind:?}: {count}");
        }
    }

    #[test]
    fn all_but_the_terrain_are_closed_and_oriented() {
        for kind in [Kind::Sphere, Kind::Torus, Kind::Parts, Kind::Crumbs] {
            let found = check(&generate(kind, 5_000, 2));
            assert_eq!((found.unmatched_edges, found.non_manifold_edges), (0, 0), "{kind:?}");
        }
        assert!(check(&generate(Kind::Terrain, 5_000, 2)).unmatched_edges > 0);
    }

    #[test]
    fn triangles_face_outwards() {
        for kind in [Kind::Sphere, Kind::Torus, Kind::Parts, Kind::Crumbs] {
            let mesh = generate(kind, 5_000, 3);
            let volume: f64 = mesh
                .triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                    a[0] * (b[1] * c[2] - b[2] * c[1])
                        + a[1] * (b[2] * c[0] - b[0] * c[2])
                        + a[2] * (b[0] * c[1] - b[1] * c[0])
                })
                .sum();
            assert!(volume > 0.0, "{kind:?}");
        }
    }

    #[test]
    fn a_seed_gives_the_same_mesh_and_another_seed_another() {
        assert_eq!(generate(Kind::Torus, 2_000, 4), generate(Kind::Torus, 2_000, 4));
        assert_ne!(generate(Kind::Torus, 2_000, 4), generate(Kind::Torus, 2_000, 5));
    }
}
