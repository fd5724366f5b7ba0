//! The mesh as importers read it ([`Soup`]), as the bake works on it ([`Mesh`]), and as it is handed back to other
//! programs ([`ExportMesh`], [`write_ply`]).
//!
//! Positions stay in double precision from the file to the archive's integer grid, so that models far from the
//! origin keep their detail. Nothing here repairs or judges a mesh; see [`crate::repair`].

use crate::objects::Objects;
use rayon::prelude::*;
use std::io::{self, Write};

/// In [`Soup::material_of`]: a triangle of an input without materials, beside others that have some.
pub const NO_MATERIAL: u32 = u32::MAX;

/// What importers produce: records (position, normal, colour, texture coordinates) as the file has them, in the file's
/// order.
///
/// All indices in `triangles` are below `positions.len()`; `normals`, `colors` and each of `uv_sets` are empty or as
/// long as `positions`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Soup {
    /// World space, in the units of the input. Several records may have one position.
    pub positions: Vec<[f64; 3]>,
    /// Empty, or one per position. `[0, 0, 0]` stands for "this record has none"; other lengths are normalised later.
    pub normals: Vec<[f32; 3]>,
    /// Empty, or one per position: sRGB, straight alpha.
    pub colors: Vec<[u8; 4]>,
    /// Record indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Sets of texture coordinates, each one per position; v runs downwards from the image's top (as in glTF; OBJ
    /// readers turn theirs over). None where no material has an image.
    pub uv_sets: Vec<Vec<[f32; 2]>>,
    /// Empty, or one per triangle: index into the scene's materials, or [`NO_MATERIAL`].
    pub material_of: Vec<u32>,
    /// Which records belong to which object; no triangle has corners of two objects.
    pub objects: Objects,
    /// Faces of the input with more than three corners.
    pub polygons_triangulated: u64,
    /// Vertices that no face uses and that the reader has left out already.
    pub unreferenced_left_out: u64,
}

impl Soup {
    /// Appends another input of the same scene. Missing normals become `[0, 0, 0]`, missing colours opaque white,
    /// missing texture coordinates `[0, 0]`, missing materials [`NO_MATERIAL`].
    ///
    /// The caller makes sure that both together have at most `u32::MAX` records, and that both count materials in the
    /// same list.
    pub fn append(&mut self, other: Soup) {
        let base = u32::try_from(self.positions.len()).expect("a soup has at most u32::MAX records");
        if self.positions.is_empty() && self.triangles.is_empty() {
            let polygons = self.polygons_triangulated + other.polygons_triangulated;
            let left_out = self.unreferenced_left_out + other.unreferenced_left_out;
            *self = Soup { polygons_triangulated: polygons, unreferenced_left_out: left_out, ..other };
            return;
        }
        let (mine, theirs) = (self.positions.len(), other.positions.len());
        append_attribute(&mut self.normals, other.normals, mine, theirs, [0.0; 3]);
        append_attribute(&mut self.colors, other.colors, mine, theirs, [255; 4]);
        let mut their_sets = other.uv_sets;
        let sets = self.uv_sets.len().max(their_sets.len());
        self.uv_sets.resize_with(sets, Vec::new);
        their_sets.resize_with(sets, Vec::new);
        for (set, more) in self.uv_sets.iter_mut().zip(their_sets) {
            append_attribute(set, more, mine, theirs, [0.0; 2]);
        }
        self.objects.append(other.objects, mine, theirs);
        let counts = (self.triangles.len(), other.triangles.len());
        append_attribute(&mut self.material_of, other.material_of, counts.0, counts.1, NO_MATERIAL);
        self.positions.extend(other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
        self.polygons_triangulated += other.polygons_triangulated;
        self.unreferenced_left_out += other.unreferenced_left_out;
    }
}

fn append_attribute<T: Copy>(mine: &mut Vec<T>, theirs: Vec<T>, my_count: usize, their_count: usize, missing: T) {
    if mine.is_empty() && theirs.is_empty() {
        return;
    }
    mine.resize(my_count, missing);
    mine.extend(theirs);
    mine.resize(my_count + their_count, missing);
}

/// One distinct (position, normal, colour) record. A position on a crease or on a colour seam has several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wedge {
    /// Index into [`Mesh::positions`].
    pub position: u32,
    /// Unit length, world space.
    pub normal: [f32; 3],
    /// sRGB, straight alpha; opaque white where the mesh has no colours.
    pub color: [u8; 4],
}

/// The clean mesh that the bake works on.
///
/// Guarantees: positions are finite (`-0.0` never occurs) and pairwise distinct, but for the copies that split sheets get; every position and every wedge is
/// used by a triangle; the three positions of a triangle are distinct; no two triangles have the same three
/// positions; there is at least one triangle. When no position has several wedges, wedge `i` is that of position `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// World space, in the units of the input.
    pub positions: Vec<[f64; 3]>,
    /// Ordered by position; the wedges of one position are neighbours.
    pub wedges: Vec<Wedge>,
    /// Wedge indices, counter-clockwise seen from outside, in the order of the input or along a curve ([`crate::order`]).
    pub triangles: Vec<[u32; 3]>,
    /// Whether the input had colours; else every wedge is white.
    pub has_colors: bool,
    /// Where some material has an image.
    pub texturing: Option<Texturing>,
    /// Which positions belong to which object; no triangle has corners of two objects.
    pub objects: Objects,
}

/// Which images lie how on the triangles of a [`Mesh`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Texturing {
    /// Per triangle: index into the scene's materials.
    pub material_of: Vec<u32>,
    /// Per set of texture coordinates, per triangle, per corner; see [`Soup::uv_sets`].
    pub corner_uvs: Vec<Vec<[[f32; 2]; 3]>>,
}

impl Texturing {
    /// Of a mesh of so many triangles without materials.
    pub fn plain(triangles: usize) -> Texturing {
        Texturing { material_of: vec![NO_MATERIAL; triangles], corner_uvs: Vec::new() }
    }
}

impl Mesh {
    /// The position indices of a triangle's corners.
    pub fn corner_positions(&self, triangle: usize) -> [u32; 3] {
        self.triangles[triangle].map(|w| self.wedges[w as usize].position)
    }

    /// Smallest and largest coordinate per axis; `([inf; 3], [-inf; 3])` without positions.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        bounds(&self.positions)
    }
}

/// Smallest and largest coordinate per axis; `([inf; 3], [-inf; 3])` of no positions.
pub(crate) fn bounds(positions: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let join = |a: ([f64; 3], [f64; 3]), b: ([f64; 3], [f64; 3])| {
        (std::array::from_fn(|k| a.0[k].min(b.0[k])), std::array::from_fn(|k| a.1[k].max(b.1[k])))
    };
    positions.par_iter().map(|p| (*p, *p)).reduce(|| ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), join)
}

/// A mesh for other programs: one record per vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExportMesh {
    /// World space.
    pub positions: Vec<[f64; 3]>,
    /// Empty, or one per position.
    pub normals: Vec<[f32; 3]>,
    /// One per position where present: sRGB, straight alpha.
    pub colors: Option<Vec<[u8; 4]>>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
}

/// Writes a binary little-endian PLY: double positions, then float normals and uchar colours where the mesh has them.
///
/// # Errors
/// Those of `out`; and `InvalidInput` where a list is not as long as the positions or has more than `u32::MAX` items.
pub fn write_ply(out: &mut impl Write, mesh: &ExportMesh) -> io::Result<()> {
    let count = mesh.positions.len();
    let colors = mesh.colors.as_deref().unwrap_or(&[]);
    let fits = |n: usize| n == 0 || n == count;
    if !fits(mesh.normals.len()) || !fits(colors.len()) || u32::try_from(count).is_err() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "normals and colours must be one per position"));
    }
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n")?;
    out.write_all(b"property double x\nproperty double y\nproperty double z\n")?;
    if !mesh.normals.is_empty() {
        out.write_all(b"property float nx\nproperty float ny\nproperty float nz\n")?;
    }
    if !colors.is_empty() {
        out.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n")?;
    }
    write!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len())?;
    let mut record = Vec::with_capacity(40);
    for (i, position) in mesh.positions.iter().enumerate() {
        record.clear();
        position.iter().for_each(|x| record.extend(x.to_le_bytes()));
        if let Some(normal) = mesh.normals.get(i) {
            normal.iter().for_each(|x| record.extend(x.to_le_bytes()));
        }
        if let Some(color) = colors.get(i) {
            record.extend(color);
        }
        out.write_all(&record)?;
    }
    for triangle in &mesh.triangles {
        record.clear();
        record.push(3);
        triangle.iter().for_each(|i| record.extend(i.to_le_bytes()));
        out.write_all(&record)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(x: f64) -> Soup {
        Soup {
            positions: vec![[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 0.0, 1.0]],
            triangles: vec![[0, 1, 2]],
            ..Soup::default()
        }
    }

    #[test]
    fn appended_inputs_keep_their_own_indices_and_attributes() {
        let mut scene = triangle(0.0);
        let mut second = triangle(1.0);
        second.colors = vec![[1, 2, 3, 4]; 3];
        second.normals = vec![[1.0, 0.0, 0.0]; 3];
        scene.append(second);
        scene.append(triangle(2.0));
        assert_eq!(scene.triangles, [[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
        assert_eq!(scene.colors[2..4], [[255; 4], [1, 2, 3, 4]]);
        assert_eq!(scene.normals[5..7], [[1.0, 0.0, 0.0], [0.0; 3]]);
        assert_eq!((scene.colors.len(), scene.normals.len()), (9, 9));
        assert!(scene.uv_sets.is_empty() && scene.material_of.is_empty());
    }

    #[test]
    fn texture_coordinates_and_materials_of_appended_inputs_stay_with_their_own() {
        let mut scene = triangle(0.0);
        let mut second = triangle(1.0);
        second.uv_sets = vec![vec![[0.25, 0.5]; 3], vec![[0.75, 1.0]; 3]];
        second.material_of = vec![2];
        scene.append(second);
        scene.append(triangle(2.0));
        assert_eq!(scene.material_of, [NO_MATERIAL, 2, NO_MATERIAL]);
        assert_eq!(scene.uv_sets.iter().map(Vec::len).collect::<Vec<_>>(), [9, 9]);
        assert_eq!(scene.uv_sets[1][2..4], [[0.0, 0.0], [0.75, 1.0]]);
        assert_eq!(scene.uv_sets[0][5..7], [[0.25, 0.5], [0.0, 0.0]]);
    }

    #[test]
    fn ply_of_one_triangle_has_the_size_that_its_header_says() {
        let mesh = ExportMesh {
            positions: triangle(0.5).positions,
            normals: vec![[1.0, 0.0, 0.0]; 3],
            colors: Some(vec![[9; 4]; 3]),
            triangles: vec![[0, 1, 2]],
        };
        let mut bytes = Vec::new();
        write_ply(&mut bytes, &mesh).unwrap();
        let header_end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        assert_eq!(bytes.len() - header_end, 3 * (24 + 12 + 4) + 13);
    }

    #[test]
    fn ply_refuses_attributes_of_another_length() {
        let mesh = ExportMesh { positions: vec![[0.0; 3]; 3], normals: vec![[0.0; 3]; 2], ..ExportMesh::default() };
        assert!(write_ply(&mut Vec::new(), &mesh).is_err());
    }
}
