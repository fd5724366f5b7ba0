//! Distance between two surfaces by sampling: points spread evenly over the area of one surface, their nearest
//! points on the other found with parry's BVH. Both directions, because each alone misses what the other sees.

use anyhow::{Result, ensure};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;
use rayon::prelude::*;

use crate::mesh::Mesh;
use crate::parts::Parts;
use crate::random::Random;

/// Distances from one surface to another, input units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OneWay {
    /// Root mean square over the samples.
    pub rms: f64,
    /// Largest over the samples and the vertices.
    pub max: f64,
    /// The same where no point counts with more than the radius of the connected part that it is on, half the diagonal of its box:
    /// a part that the other surface lacks counts with its size, wherever the rest is.
    pub max_within_parts: f64,
}

/// Both ways.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TwoWay {
    pub a_to_b: OneWay,
    pub b_to_a: OneWay,
}

impl TwoWay {
    /// The larger of the two root mean squares.
    pub fn rms(&self) -> f64 {
        self.a_to_b.rms.max(self.b_to_a.rms)
    }

    /// The largest distance of `a` from `b`, and back, where parts that `a` lacks count with their size.
    pub fn max_but_for_lost_parts(&self) -> f64 {
        self.a_to_b.max.max(self.b_to_a.max_within_parts)
    }

    /// The larger of the two maxima.
    pub fn max(&self) -> f64 {
        self.a_to_b.max.max(self.b_to_a.max)
    }
}

/// A surface that distances can be measured to.
pub struct Surface {
    mesh: Mesh,
    tree: TriMesh,
    /// Areas summed up to and including each triangle.
    area: Vec<f64>,
    /// Per vertex: radius of the connected part that it is on.
    part_radius: Vec<f64>,
}

impl Surface {
    /// `offset` is taken from all positions, so that far coordinates lose nothing in products.
    pub fn new(mesh: &Mesh, offset: [f64; 3]) -> Result<Surface> {
        ensure!(!mesh.triangles.is_empty(), "a surface without triangles has no distance");
        let mut mesh = mesh.welded();
        mesh.positions.iter_mut().for_each(|p| *p = std::array::from_fn(|k| p[k] - offset[k]));
        let points = mesh.positions.iter().map(|&[x, y, z]| Vector::new(x, y, z)).collect();
        let tree = TriMesh::new(points, mesh.triangles.clone())?;
        let area = mesh.triangles.iter().scan(0.0, |sum, t| {
            *sum += triangle_area(t.map(|i| mesh.positions[i as usize]));
            Some(*sum)
        });
        Ok(Surface { area: area.collect(), part_radius: part_radii(&mesh), mesh, tree })
    }

    fn distance(&self, p: [f64; 3]) -> f64 {
        let point = Vector::new(p[0], p[1], p[2]);
        self.tree.project_local_point(point, false).point.distance(point)
    }

    /// `count` points, evenly by area, the same for the same seed, each with a vertex of its triangle.
    fn samples(&self, count: usize, seed: u64) -> Vec<([f64; 3], u32)> {
        let mut random = Random::new(seed);
        let total = *self.area.last().expect("checked: there are triangles");
        let mut sample = |i: usize| {
            // One sample in each of `count` equal shares of the area.
            let at = (i as f64 + random.unit()) / count as f64 * total;
            let triangle = self.area.partition_point(|&a| a < at).min(self.area.len() - 1);
            let (mut u, mut v) = (random.unit(), random.unit());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = self.mesh.triangles[triangle].map(|i| self.mesh.positions[i as usize]);
            let point = std::array::from_fn(|k| a[k] + (b[k] - a[k]) * u + (c[k] - a[k]) * v);
            (point, self.mesh.triangles[triangle][0])
        };
        (0..count).map(&mut sample).collect()
    }

    /// Distances from points of this surface to the other.
    pub fn to(&self, other: &Surface, count: usize, seed: u64) -> OneWay {
        let look = |(p, vertex): ([f64; 3], u32)| {
            let distance = other.distance(p);
            (distance, distance.min(self.part_radius[vertex as usize]))
        };
        let largest = |a: (f64, f64), b: (f64, f64)| (a.0.max(b.0), a.1.max(b.1));
        let samples: Vec<(f64, f64)> = self.samples(count, seed).into_par_iter().map(look).collect();
        let vertices = self.mesh.positions.par_iter().enumerate().map(|(i, &p)| look((p, i as u32)));
        let vertices = vertices.reduce(Default::default, largest);
        let squares: f64 = samples.iter().map(|d| d.0 * d.0).sum();
        let (max, max_within_parts) = samples.into_iter().fold(vertices, largest);
        OneWay { rms: (squares / count as f64).sqrt(), max, max_within_parts }
    }

    /// Both ways between two surfaces.
    pub fn both_ways(&self, other: &Surface, count: usize, seed: u64) -> TwoWay {
        TwoWay { a_to_b: self.to(other, count, seed), b_to_a: other.to(self, count, seed ^ 0x5eed) }
    }
}

/// Per vertex, half the diagonal of the box of its connected part.
fn part_radii(mesh: &Mesh) -> Vec<f64> {
    let mut parts = Parts::new(mesh.positions.len());
    for &[a, b, c] in &mesh.triangles {
        parts.join(a, b);
        parts.join(a, c);
    }
    let parts = parts.list();
    let mut boxes = vec![([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]); parts.len()];
    for (&part, p) in parts.iter().zip(&mesh.positions) {
        let (low, high) = &mut boxes[part as usize];
        (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
    }
    let radius = |&part: &u32| {
        let (low, high) = boxes[part as usize];
        (0..3).map(|k| (high[k] - low[k]).powi(2)).sum::<f64>().sqrt() / 2.0
    };
    parts.iter().map(radius).collect()
}

fn triangle_area([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (u, v): ([f64; 3], [f64; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    0.5 * cross.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Kind, generate};

    fn between(a: &Mesh, b: &Mesh) -> TwoWay {
        let (a, b) = (Surface::new(a, [0.0; 3]).unwrap(), Surface::new(b, [0.0; 3]).unwrap());
        a.both_ways(&b, 5_000, 1)
    }

    #[test]
    fn a_surface_has_no_distance_to_itself() {
        let mesh = generate(Kind::Torus, 3_000, 1);
        assert!(between(&mesh, &mesh).max() < 1e-12);
    }

    #[test]
    fn two_parallel_squares_are_as_far_apart_as_they_are() {
        let square = |z: f64, size: f64| Mesh {
            positions: vec![[0.0, 0.0, z], [size, 0.0, z], [size, size, z], [0.0, size, z]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let found = between(&square(0.0, 1.0), &square(0.25, 1.0));
        assert!((found.a_to_b.rms - 0.25).abs() < 1e-12 && (found.b_to_a.max - 0.25).abs() < 1e-12);
        let mut with_part = square(0.0, 1.0);
        with_part.positions.extend([[0.0, 0.0, 9.0], [0.3, 0.0, 9.0], [0.0, 0.4, 9.0]]);
        with_part.triangles.push([4, 5, 6]);
        let lost = between(&square(0.0, 1.0), &with_part);
        assert_eq!((lost.max(), lost.max_but_for_lost_parts()), (9.0, 0.25));
        let larger = between(&square(0.0, 1.0), &square(0.0, 2.0));
        assert!(larger.a_to_b.max < 1e-12 && (larger.b_to_a.max - 2f64.sqrt()).abs() < 1e-9, "{larger:?}");
    }
}
