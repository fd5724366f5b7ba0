//! Vertex normals: keeps what the input has, makes what it lacks, and gathers the distinct (position, normal, colour)
//! records, the wedges, of a mesh whose positions are already distinct.
//!
//! Made normals are means over the triangles of a fan, weighted by corner angle (Thürmer and Wüthrich, "Computing
//! Vertex Normals from Polygonal Facets", JGT 1998) or by area. Every vertex gathers its own triangles, in ascending
//! order, so sums do not depend on threads.

use crate::corners::{Corners, Star, next_and_previous};
use crate::mesh::Wedge;
use rayon::prelude::*;

/// What weighs a triangle's normal in the mean at a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalWeight {
    /// The angle of the triangle at the vertex: does not depend on how flat parts are cut into triangles.
    #[default]
    Angle,
    /// The area of the triangle.
    Area,
}

/// How normals are made where the input has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalOptions {
    /// What weighs a triangle in the mean.
    pub weight: NormalWeight,
    /// Neighbouring triangles whose normals differ by more (degrees) do not share a made normal; 180: all share.
    pub crease_angle_deg: f64,
}

impl Default for NormalOptions {
    fn default() -> Self {
        NormalOptions { weight: NormalWeight::Angle, crease_angle_deg: 180.0 }
    }
}

/// Smaller areas and squares of lengths are not trusted: their own squares would lose digits.
const MIN_SQUARE: f64 = 1e-140;

/// A mesh with distinct positions, and what the input says about its corners.
pub struct Surface<'a> {
    /// World space, pairwise distinct.
    pub positions: &'a [[f64; 3]],
    /// Position indices.
    pub triangles: &'a [[u32; 3]],
    /// The corners at each position.
    pub corners: &'a Corners,
    /// Record indices of the same corners; empty when there are no attributes.
    pub records: &'a [[u32; 3]],
    /// Per record, or empty. Zero length: none. Need not be normalised.
    pub normals: &'a [[f32; 3]],
    /// Per record, or empty.
    pub colors: &'a [[u8; 4]],
}

/// The answer of [`wedges`].
pub struct Wedges {
    /// Ordered by position.
    pub wedges: Vec<Wedge>,
    /// Wedge indices, one triangle per input triangle; `None` where they are the position indices.
    pub triangles: Option<Vec<[u32; 3]>>,
    /// Wedges whose normal was made because the input has none there.
    pub normals_made: u64,
    /// Wedges whose normal was made because the input's is not a number or infinite.
    pub normals_repaired: u64,
}

/// Gathers the wedges of a surface in which every position is used.
pub fn wedges(surface: &Surface, options: &NormalOptions) -> Wedges {
    let parts: Vec<Part> = surface
        .corners
        .chunks()
        .map(|vertices| {
            let mut part = Part::default();
            let mut around = Around::new(surface, options);
            vertices.for_each(|v| around.add_wedges(v, &mut part));
            part
        })
        .collect();
    let triangles = corner_wedges(surface, &parts);
    let mut all = Wedges { wedges: Vec::new(), triangles, normals_made: 0, normals_repaired: 0 };
    all.wedges.reserve_exact(parts.iter().map(|p| p.wedges.len()).sum());
    for part in parts {
        all.wedges.extend(part.wedges);
        all.normals_made += part.made;
        all.normals_repaired += part.repaired;
    }
    all
}

/// The wedges of one chunk of vertices.
#[derive(Default)]
struct Part {
    wedges: Vec<Wedge>,
    /// Per corner in the order of [`Corners`]: index into `wedges`. Empty where all positions have one wedge anyway.
    local: Vec<u32>,
    several: bool,
    made: u64,
    repaired: u64,
}

/// Triangles over wedge indices; `None` where no position has several wedges: they are the position indices themselves.
fn corner_wedges(surface: &Surface, parts: &[Part]) -> Option<Vec<[u32; 3]>> {
    if !parts.iter().any(|p| p.several) {
        return None;
    }
    let mut triangles = vec![[0u32; 3]; surface.triangles.len()];
    let flat = triangles.as_flattened_mut();
    let (mut vertex, mut base) = (0, 0);
    for part in parts {
        let mut local = part.local.iter();
        while vertex < surface.corners.vertex_count() && local.len() > 0 {
            for (&corner, &wedge) in surface.corners.of(vertex).iter().zip(local.by_ref()) {
                flat[corner as usize] = base + wedge;
            }
            vertex += 1;
        }
        base += part.wedges.len() as u32;
    }
    Some(triangles)
}

/// Where the normal of a corner comes from.
#[derive(Clone, Copy, PartialEq)]
enum Origin {
    Input,
    Missing,
    Broken,
}

/// Works on one vertex after the other; kept between them for its buffers.
struct Around<'a> {
    surface: &'a Surface<'a>,
    options: &'a NormalOptions,
    star: Star,
    faces: Vec<CornerFace>,
    /// Made normals per slot.
    made: Vec<[f32; 3]>,
}

/// A triangle seen from one of its corners.
#[derive(Clone, Copy)]
struct CornerFace {
    /// Unit length, or zero for a triangle without area.
    normal: [f64; 3],
    weight: f64,
}

impl<'a> Around<'a> {
    fn new(surface: &'a Surface, options: &'a NormalOptions) -> Self {
        Around { surface, options, star: Star::default(), faces: Vec::new(), made: Vec::new() }
    }

    fn add_wedges(&mut self, vertex: usize, part: &mut Part) {
        let incident = self.surface.corners.of(vertex);
        if self.surface.records.is_empty() && self.options.crease_angle_deg >= 180.0 {
            let normal = self.smooth_normal(vertex);
            part.wedges.push(Wedge { position: vertex as u32, normal, color: [255; 4] });
            part.made += 1;
            return;
        }
        let begin = part.wedges.len();
        self.made.clear();
        for (slot, &corner) in incident.iter().enumerate() {
            let record = self.surface.records.as_flattened().get(corner as usize).map(|&r| r as usize);
            let given = record.and_then(|r| self.surface.normals.get(r)).map_or(Err(Origin::Missing), normalised);
            let (normal, origin) = match given {
                Ok(normal) => (normal, Origin::Input),
                Err(origin) => (self.made_normal(vertex, slot), origin),
            };
            let color = record.and_then(|r| self.surface.colors.get(r)).copied().unwrap_or([255; 4]);
            let wedge = Wedge { position: vertex as u32, normal, color };
            let known = part.wedges[begin..].iter().position(|w| *w == wedge);
            let index = begin + known.unwrap_or(part.wedges.len() - begin);
            if known.is_none() {
                part.wedges.push(wedge);
                part.made += u64::from(origin == Origin::Missing);
                part.repaired += u64::from(origin == Origin::Broken);
            }
            part.local.push(index as u32);
        }
        part.several |= part.wedges.len() - begin > 1;
    }

    /// The mean normal of the fan that a slot belongs to.
    fn made_normal(&mut self, vertex: usize, slot: usize) -> [f32; 3] {
        if self.made.is_empty() {
            self.make_normals(vertex);
        }
        self.made[slot]
    }

    /// The mean normal of all triangles at a vertex; `faces` has them afterwards.
    fn smooth_normal(&mut self, vertex: usize) -> [f32; 3] {
        let incident = self.surface.corners.of(vertex);
        let weight = self.options.weight;
        self.faces.clear();
        self.faces.extend(incident.iter().map(|&corner| corner_face(self.surface, vertex, corner, weight)));
        mean_normal(self.faces.iter())
    }

    fn make_normals(&mut self, vertex: usize) {
        let incident = self.surface.corners.of(vertex);
        let smooth = self.smooth_normal(vertex);
        if self.options.crease_angle_deg >= 180.0 {
            self.made.resize(incident.len(), smooth);
            return;
        }
        let least_cosine = self.options.crease_angle_deg.to_radians().cos();
        let faces = &self.faces;
        self.star.gather(self.surface.triangles, incident);
        let fans = self.star.fans(incident.len(), |a, b| {
            let (a, b) = (faces[a].normal, faces[b].normal);
            a == [0.0; 3] || b == [0.0; 3] || dot(a, b) >= least_cosine
        });
        for &fan in fans {
            let normal = match self.made.get(fan as usize) {
                Some(&normal) => normal,
                None => mean_normal(faces.iter().zip(fans).filter(|(_, f)| **f == fan).map(|(face, _)| face)),
            };
            self.made.push(normal);
        }
    }
}

fn normalised(normal: &[f32; 3]) -> Result<[f32; 3], Origin> {
    let n = normal.map(f64::from);
    let length = dot(n, n).sqrt();
    match length {
        _ if !length.is_finite() => Err(Origin::Broken),
        _ if length < 1e-20 => Err(Origin::Missing),
        _ if (length - 1.0).abs() < 1e-6 => Ok(normal.map(|x| x + 0.0)),
        _ => Ok(n.map(|x| (x / length) as f32 + 0.0)),
    }
}

fn corner_face(surface: &Surface, vertex: usize, corner: u32, weight: NormalWeight) -> CornerFace {
    let (next, previous) = next_and_previous(surface.triangles, corner);
    let apex = surface.positions[vertex];
    let a = subtract(surface.positions[next as usize], apex);
    let b = subtract(surface.positions[previous as usize], apex);
    let face = spanned_face(a, b, weight);
    if dot(a, a).min(dot(b, b)) > MIN_SQUARE && face.normal != [0.0; 3] {
        return face;
    }
    // Squares of such short edges leave the range of numbers: stretch them first.
    let largest = |v: [f64; 3]| v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let (size_a, size_b) = (largest(a), largest(b));
    if size_a == 0.0 || size_b == 0.0 {
        return CornerFace { normal: [0.0; 3], weight: 0.0 };
    }
    let face = spanned_face(a.map(|x| x / size_a), b.map(|x| x / size_b), weight);
    let stretch = if weight == NormalWeight::Area { size_a * size_b } else { 1.0 };
    CornerFace { weight: face.weight * stretch, ..face }
}

/// The triangle between two edges from the corner.
fn spanned_face(a: [f64; 3], b: [f64; 3], weight: NormalWeight) -> CornerFace {
    let cross = cross(a, b);
    let area = dot(cross, cross).sqrt();
    if !(area > MIN_SQUARE && area.is_finite()) {
        return CornerFace { normal: [0.0; 3], weight: 0.0 };
    }
    let weight = match weight {
        NormalWeight::Area => area,
        NormalWeight::Angle => angle(dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()),
    };
    CornerFace { normal: cross.map(|x| x / area), weight }
}

/// Arc cosine to 7e-5 (Abramowitz and Stegun 4.4.45): ample for a weight, several times faster than the exact one,
/// and the same on every machine.
fn angle(cosine: f64) -> f64 {
    let x = cosine.abs().min(1.0);
    let acute = (1.0 - x).sqrt() * (1.570_728_8 + x * (-0.212_114_4 + x * (0.074_261_0 - 0.018_729_3 * x)));
    if cosine < 0.0 { std::f64::consts::PI - acute } else { acute }
}

/// `[0, 0, 1]` where all triangles are without area or cancel out.
fn mean_normal<'f>(faces: impl Iterator<Item = &'f CornerFace> + Clone) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for face in faces.clone() {
        (0..3).for_each(|k| sum[k] += face.normal[k] * face.weight);
    }
    let length = dot(sum, sum).sqrt();
    let total: f64 = faces.clone().map(|f| f.weight).sum();
    if length > (1e-9 * total).max(MIN_SQUARE) {
        return sum.map(|x| (x / length) as f32 + 0.0);
    }
    let any = faces.map(|f| f.normal).find(|n| *n != [0.0; 3]);
    any.unwrap_or([0.0, 0.0, 1.0]).map(|x| x as f32 + 0.0)
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit cube, each face cut along one diagonal.
    fn cube() -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let positions = (0..8).map(|i| [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)]).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        (positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
    }

    fn cube_wedges(options: NormalOptions) -> Wedges {
        let (positions, triangles) = cube();
        let corners = Corners::new(&triangles, positions.len());
        let surface = Surface {
            positions: &positions,
            triangles: &triangles,
            corners: &corners,
            records: &[],
            normals: &[],
            colors: &[],
        };
        wedges(&surface, &options)
    }

    #[test]
    fn angle_weights_make_cube_normals_point_along_the_diagonals() {
        let made = cube_wedges(NormalOptions::default());
        assert_eq!((made.wedges.len(), made.normals_made), (8, 8));
        for (i, wedge) in made.wedges.iter().enumerate() {
            for k in 0..3 {
                let expected = if i >> k & 1 == 1 { 1.0 } else { -1.0 } / 3f32.sqrt();
                assert!((wedge.normal[k] - expected).abs() < 1e-3, "{wedge:?}");
            }
        }
    }

    #[test]
    fn a_crease_angle_gives_each_side_of_a_cube_its_own_normals() {
        let made = cube_wedges(NormalOptions { crease_angle_deg: 30.0, ..NormalOptions::default() });
        assert_eq!(made.wedges.len(), 24);
        let (_, triangles) = cube();
        for (t, triangle) in made.triangles.expect("several wedges at a corner").iter().enumerate() {
            let own = triangle.map(|w| made.wedges[w as usize]);
            assert_eq!(own.map(|w| w.position), triangles[t]);
            assert!(own.iter().all(|w| w.normal == own[0].normal && w.normal.contains(&0.0)));
        }
    }

    #[test]
    fn triangles_of_any_size_have_unit_normals() {
        for size in [1e-300, 1e-170, 1e-100, 1e-30, 1.0, 1e29] {
            for b in [[0.0, size, 0.0], [size, 1e-3 * size, 0.0], [0.0, 1e-30, 0.0]] {
                let positions = [[0.0; 3], [size, 0.0, 0.0], b];
                let corners = Corners::new(&[[0, 1, 2]], 3);
                let surface = Surface {
                    positions: &positions,
                    triangles: &[[0, 1, 2]],
                    corners: &corners,
                    records: &[],
                    normals: &[],
                    colors: &[],
                };
                for weight in [NormalWeight::Angle, NormalWeight::Area] {
                    let made = wedges(&surface, &NormalOptions { weight, ..NormalOptions::default() });
                    assert!(made.wedges.iter().all(|w| w.normal == [0.0, 0.0, 1.0]), "{size} {b:?} {:?}", made.wedges);
                }
            }
        }
    }

    #[test]
    fn the_fast_angle_is_within_its_bound() {
        for i in -1000..=1000 {
            let x = f64::from(i) / 1000.0;
            assert!((angle(x) - x.acos()).abs() < 7e-5);
        }
    }
}
