//! From the records of the inputs to the clean mesh of the bake: welds, drops what is no surface, completes normals.
//!
//! Closed meshes stay closed: triangles are removed only where a position repeats (after the weld) or where an earlier
//! triangle has the same three positions. Triangles without area but with three distinct positions stay, because
//! their neighbours may need them. Non-manifold places are counted and left alone. The result does not depend on the
//! number of threads.

use crate::corners::{Corners, Topology, duplicate_triangles, topology};
use crate::mesh::{Mesh, Soup, Texturing};
use crate::normals::{NormalOptions, Surface, wedges};
use crate::order::sort_where_needed;
use crate::split::{Added, split_non_manifold};
use crate::weld::{weld_exact, weld_within};
use rayon::prelude::*;

/// Coordinates beyond this are taken for damage: squares and products of them would leave the range of numbers.
pub const MAX_COORDINATE: f64 = 1e30;
/// Texture coordinates beyond this are taken for damage: an `f32` has no fraction there.
pub const MAX_UV: f32 = 16_777_216.0;
/// Most triangles of one mesh: three corner indices each fit into 31 bits.
pub const MAX_TRIANGLE_COUNT: usize = (1 << 31) / 3;
/// Meshes with fewer triangles may be meant to look facetted.
const MIN_FACETTED_TRIANGLES: usize = 1000;
/// Made normals that replace facet normals keep edges that are sharper (degrees).
const FACET_CREASE_ANGLE_DEG: f64 = 45.0;
/// Share of the corners that must have the normal of their facet, and how well it must fit: to within half a degree.
const FACETTED_SHARE: f64 = 0.95;
const FACETTED_COSINE: f64 = 0.999_96;

/// What [`repair`] may be told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RepairOptions {
    /// Positions at most this far apart (input units) become one; 0: only equal ones.
    pub weld_tolerance: f64,
    /// How missing normals are made.
    pub normals: NormalOptions,
    /// Whether the normals of the input are used.
    pub input_normals: InputNormals,
}

/// Whether the normals of the input are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InputNormals {
    /// Where they are there and sound; facet normals of a large mesh are replaced, see [`has_facet_normals`].
    #[default]
    Use,
    /// Where they are there and sound, also facet normals.
    Keep,
    /// Never: all normals are made.
    Ignore,
}

/// What [`repair`] found and did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RepairReport {
    /// Triangles of the input, polygons counted as the triangles they were cut into.
    pub triangles_in: u64,
    /// Records of the input.
    pub records_in: u64,
    /// Faces of the input with more than three corners.
    pub polygons_triangulated: u64,
    /// Records that were joined with an earlier one of the same position.
    pub positions_welded: u64,
    /// Positions that no triangle uses.
    pub unreferenced_dropped: u64,
    /// Triangles in which a position repeats.
    pub degenerate_removed: u64,
    /// Triangles with the positions of an earlier one.
    pub duplicates_removed: u64,
    /// Triangles without area that were kept.
    pub zero_area_kept: u64,
    /// Wedges that got a normal because the input has none there.
    pub normals_made: u64,
    /// Wedges that got a normal because the input's is not a finite number.
    pub normals_repaired: u64,
    /// Records with a texture coordinate that is no usable number; it became 0.
    pub uvs_repaired: u64,
    /// Whether all normals were made because those of the input were only those of the facets.
    pub facet_normals_replaced: bool,
    /// Whether records and triangles were sorted along a curve because their order in the input says nothing of where they
    /// are.
    pub sorted_along_curve: bool,
    /// What was added so that every sheet of a non-manifold place has positions of its own.
    pub split: Added,
    /// Borders and non-manifold places before they were split.
    pub topology: Topology,
}

/// Why there is no mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// A coordinate is NaN, infinite or absurdly large.
    #[error(
        "vertex {record} (counted from 0) has the position ({}, {}, {}), which is no usable place; \
         remove the vertex or export the model again", position[0], position[1], position[2]
    )]
    BadCoordinate {
        /// Index in the soup.
        record: usize,
        /// As the input has it.
        position: [f64; 3],
    },
    /// Nothing is left to bake.
    #[error(
        "there is no usable triangle: {triangles_in} in the input, {degenerate} of them with a repeated position; \
         check that the model was exported as a triangle or polygon mesh"
    )]
    NoTriangles {
        /// Triangles of the input.
        triangles_in: u64,
        /// Those in which a position repeats.
        degenerate: u64,
    },
    /// More than one mesh may have.
    #[error("the scene has {triangles} triangles, more than {MAX_TRIANGLE_COUNT}; bake it in several parts")]
    TooManyTriangles {
        /// Triangles of the input.
        triangles: usize,
    },
    /// The weld tolerance is negative or no number.
    #[error("the weld tolerance is {tolerance}; give a length of 0 or more in the units of the model")]
    BadTolerance {
        /// As given.
        tolerance: f64,
    },
}

/// The first position that [`repair`] would refuse.
pub fn first_bad_position(positions: &[[f64; 3]]) -> Option<usize> {
    positions.par_iter().position_first(|p| !p.iter().all(|x| x.abs() <= MAX_COORDINATE))
}

/// Makes the clean mesh; see the module's description and [`Mesh`]'s guarantees.
///
/// # Errors
/// See [`MeshError`].
///
/// # Panics
/// When the soup breaks its own rules: an index out of range, or attributes of another length than the positions, or
/// texture coordinates without materials.
pub fn repair(mut soup: Soup, options: &RepairOptions) -> Result<(Mesh, RepairReport), MeshError> {
    check(&soup, options)?;
    let mut report = RepairReport {
        sorted_along_curve: sort_where_needed(&mut soup),
        triangles_in: soup.triangles.len() as u64,
        records_in: soup.positions.len() as u64,
        polygons_triangulated: soup.polygons_triangulated,
        unreferenced_dropped: soup.unreferenced_left_out,
        ..RepairReport::default()
    };
    let Soup { positions, mut normals, colors, triangles: mut records, uv_sets, mut material_of, mut objects, .. } =
        soup;
    if options.input_normals == InputNormals::Ignore {
        normals.clear();
    }
    let stands_for = weld(&positions, &objects.of, options.weld_tolerance);
    drop_degenerate(&stands_for, &mut records, &mut material_of, &mut report);
    let (positions, mut triangles) = number_positions(positions, &stands_for, &records, &mut objects.of, &mut report);
    drop(stands_for);
    if triangles.is_empty() {
        let RepairReport { triangles_in, degenerate_removed: degenerate, .. } = report;
        return Err(MeshError::NoTriangles { triangles_in, degenerate });
    }
    let mut normal_options = options.normals;
    if options.input_normals == InputNormals::Use && has_facet_normals(&positions, &triangles, &records, &normals) {
        normals = Vec::new();
        normal_options.crease_angle_deg = normal_options.crease_angle_deg.min(FACET_CREASE_ANGLE_DEG);
        report.facet_normals_replaced = true;
    }
    let bare = normals.is_empty() && colors.is_empty();
    if bare && uv_sets.is_empty() {
        records = Vec::new();
    }
    let mut lists = TriangleLists { triangles: &mut triangles, records: &mut records, material_of: &mut material_of };
    let corners = remove_duplicates(positions.len(), &mut lists, &mut report);
    report.topology = topology(&triangles, &corners);
    report.zero_area_kept = triangles.par_iter().filter(|t| is_flat(t.map(|v| positions[v as usize]))).count() as u64;
    let surface = Surface {
        positions: &positions,
        triangles: &triangles,
        corners: &corners,
        records: if bare { &[] } else { &records },
        normals: &normals,
        colors: &colors,
    };
    let made = wedges(&surface, &normal_options);
    report.normals_made = made.normals_made;
    report.normals_repaired = made.normals_repaired;
    let texturing = (!material_of.is_empty()).then(|| texturing(material_of, uv_sets, &records, &mut report));
    let (wedges, triangles) = (made.wedges, made.triangles.unwrap_or(triangles));
    let mut mesh = Mesh { wedges, triangles, has_colors: !colors.is_empty(), positions, texturing, objects };
    if report.topology.nonmanifold_edges + report.topology.nonmanifold_vertices > 0 {
        report.split = split_non_manifold(&mut mesh);
    }
    Ok((mesh, report))
}

fn check(soup: &Soup, options: &RepairOptions) -> Result<(), MeshError> {
    let count = soup.positions.len();
    assert!(count < u32::MAX as usize, "record indices are 32 bits wide");
    assert!(soup.normals.is_empty() || soup.normals.len() == count, "one normal per record");
    assert!(soup.objects.of.is_empty() || soup.objects.of.len() == count, "one object per record");
    assert!(soup.colors.is_empty() || soup.colors.len() == count, "one colour per record");
    let materials = soup.material_of.len();
    assert!(
        materials == 0 && soup.uv_sets.is_empty() || materials == soup.triangles.len(),
        "one material per triangle"
    );
    assert!(soup.uv_sets.iter().all(|set| set.len() == count), "one texture coordinate per record");
    assert!(soup.triangles.par_iter().all(|t| t.iter().all(|&i| (i as usize) < count)), "triangle indices in range");
    if !(options.weld_tolerance >= 0.0 && options.weld_tolerance.is_finite()) {
        return Err(MeshError::BadTolerance { tolerance: options.weld_tolerance });
    }
    if soup.triangles.len() > MAX_TRIANGLE_COUNT {
        return Err(MeshError::TooManyTriangles { triangles: soup.triangles.len() });
    }
    match first_bad_position(&soup.positions) {
        Some(record) => Err(MeshError::BadCoordinate { record, position: soup.positions[record] }),
        None => Ok(()),
    }
}

fn weld(positions: &[[f64; 3]], object_of: &[u32], tolerance: f64) -> Vec<u32> {
    let first = weld_exact(positions, object_of);
    if tolerance > 0.0 { weld_within(positions, object_of, &first, tolerance) } else { first }
}

/// Removes the triangles in which a position repeats.
fn drop_degenerate(
    stands_for: &[u32],
    records: &mut Vec<[u32; 3]>,
    material_of: &mut Vec<u32>,
    report: &mut RepairReport,
) {
    let degenerate = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|r| stands_for[r as usize]);
        a == b || b == c || c == a
    };
    let before = records.len();
    if records.par_iter().any(degenerate) {
        let mut kept = records.iter().map(|t| !degenerate(t));
        material_of.retain(|_| kept.next().unwrap_or(false));
        records.retain(|t| !degenerate(t));
    }
    report.degenerate_removed = (before - records.len()) as u64;
}

/// Numbers the positions that triangles use, in the order of their first record, with their objects. The answer's
/// triangles are position indices.
fn number_positions(
    mut positions: Vec<[f64; 3]>,
    stands_for: &[u32],
    records: &[[u32; 3]],
    object_of: &mut Vec<u32>,
    report: &mut RepairReport,
) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut number = vec![u32::MAX; positions.len()];
    for record in records.as_flattened() {
        number[stands_for[*record as usize] as usize] = 0;
    }
    let mut used = 0u32;
    let mut welded = 0u64;
    for record in 0..positions.len() {
        welded += u64::from(stands_for[record] as usize != record);
        if number[record] != u32::MAX {
            positions[used as usize] = positions[record].map(|x| x + 0.0);
            if !object_of.is_empty() {
                object_of[used as usize] = object_of[record];
            }
            number[record] = used;
            used += 1;
        }
    }
    report.positions_welded = welded;
    report.unreferenced_dropped += positions.len() as u64 - welded - u64::from(used);
    positions.truncate(used as usize);
    object_of.truncate(used as usize);
    positions.shrink_to_fit();
    let numbered = |t: &[u32; 3]| t.map(|r| number[stands_for[r as usize] as usize]);
    let triangles = records.par_iter().map(numbered).collect();
    (positions, triangles)
}

/// What there is per triangle; lists that are not needed are empty.
struct TriangleLists<'a> {
    triangles: &'a mut Vec<[u32; 3]>,
    records: &'a mut Vec<[u32; 3]>,
    material_of: &'a mut Vec<u32>,
}

/// Removes triangles with the positions of an earlier one, and tells the corners of the rest.
fn remove_duplicates(position_count: usize, lists: &mut TriangleLists, report: &mut RepairReport) -> Corners {
    let corners = Corners::new(lists.triangles, position_count);
    let duplicates = duplicate_triangles(lists.triangles, &corners);
    report.duplicates_removed = duplicates.len() as u64;
    if duplicates.is_empty() {
        return corners;
    }
    remove_at(lists.triangles, &duplicates);
    remove_at(lists.records, &duplicates);
    remove_at(lists.material_of, &duplicates);
    Corners::new(lists.triangles, position_count)
}

/// Removes the items at some indices, which ascend.
fn remove_at<T>(list: &mut Vec<T>, indices: &[u32]) {
    let mut next = indices.iter().peekable();
    let mut index = 0;
    list.retain(|_| {
        let drop = next.next_if(|&&d| d == index).is_some();
        index += 1;
        !drop
    });
}

/// Texture coordinates per corner, in the order of the triangles that are left.
fn texturing(
    material_of: Vec<u32>,
    uv_sets: Vec<Vec<[f32; 2]>>,
    records: &[[u32; 3]],
    report: &mut RepairReport,
) -> Texturing {
    let usable = |x: f32| x.abs() <= MAX_UV;
    let mut sets = uv_sets;
    for uv in sets.iter_mut().flatten().filter(|uv| !uv.iter().all(|&x| usable(x))) {
        *uv = uv.map(|x| if usable(x) { x } else { 0.0 });
        report.uvs_repaired += 1;
    }
    let corners = |set: Vec<[f32; 2]>| records.par_iter().map(|t| t.map(|r| set[r as usize])).collect();
    Texturing { material_of, corner_uvs: sets.into_iter().map(corners).collect() }
}

/// Whether nearly all normals of a large mesh are only those of the facets: they say nothing that the positions do
/// not, and would take a curved surface apart into single triangles.
fn has_facet_normals(
    positions: &[[f64; 3]],
    triangles: &[[u32; 3]],
    records: &[[u32; 3]],
    normals: &[[f32; 3]],
) -> bool {
    if normals.is_empty() || triangles.len() < MIN_FACETTED_TRIANGLES {
        return false;
    }
    let fits = |cross: [f64; 3], record: u32| {
        let n = normals[record as usize].map(f64::from);
        dot(cross, n) >= FACETTED_COSINE * (dot(cross, cross) * dot(n, n)).sqrt()
    };
    let corners = |(t, r): (&[u32; 3], &[u32; 3])| {
        let (_, _, cross) = spans(t.map(|v| positions[v as usize]));
        r.iter().filter(|&&record| fits(cross, record)).count()
    };
    let facetted: usize = triangles.par_iter().zip(records).map(corners).sum();
    facetted as f64 >= FACETTED_SHARE * 3.0 * triangles.len() as f64
}

/// Whether three positions are on one line, to within the rounding of doubles.
fn is_flat(corners: [[f64; 3]; 3]) -> bool {
    let (u, v, cross) = spans(corners);
    dot(cross, cross) <= 1e-24 * dot(u, u) * dot(v, v)
}

/// Two edges of a triangle from its first corner, and their cross product.
fn spans([a, b, c]: [[f64; 3]; 3]) -> ([f64; 3], [f64; 3], [f64; 3]) {
    let u: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
    let v: [f64; 3] = std::array::from_fn(|k| c[k] - a[k]);
    let cross = std::array::from_fn(|k| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
    (u, v, cross)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
#[path = "repair_tests.rs"]
mod tests;
