//! Real meshes load with the triangles and positions that their manifest counts.

use super::{load_file, repaired, shared, welded_count};
use pb_bake::import::{ImportOptions, Instancing, load};
use std::path::Path;

/// Counts that differ from the manifest's for a reason: triangles, positions with the unreferenced ones.
const COUNTED_OTHERWISE: &[(&str, u64, u64, &str)] = &[
    ("gltf_small/MeshPrimitiveModes_glTF/MeshPrimitiveModes.gltf", 16, 21, "strips and fans are triangles too"),
    ("small_trimesh/Mesh_PrimitiveMode_04.gltf", 2, 4, "triangles"),
    ("gltf_small/SimpleInstancing_glTF-Binary/SimpleInstancing.glb", 1500, 1000, "125 instances"),
    ("small_trimesh/wallhole.obj", 66, 35, "continued lines"),
    ("small_assimp/OBJ/multiple_spaces.obj", 1, 4, "unused positions are counted before the weld"),
    ("small_assimp/OBJ/number_formats.obj", 1, 15, "unused positions are counted before the weld"),
];

/// Files that cannot become a surface, and what is said about them.
const REFUSED: &[(&str, &str)] = &[
    ("gltf_duck_variants/glTF-Draco/Duck.gltf", "compressed with KHR_draco_mesh_compression"),
    ("small_trimesh/points_ascii_with_lists.ply", "no faces"),
    ("small_trimesh/points_emptyface.ply", "no faces"),
    ("small_assimp/OBJ/testline.obj", "no faces"),
    ("small_assimp/OBJ/testpoints.obj", "no faces"),
];

/// Fields of a line of comma-separated values with quotes.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            _ => fields.last_mut().unwrap().push(c),
        }
    }
    fields
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn every_fixture_has_the_triangles_positions_and_bounds_of_its_manifest() {
    let Some(folder) = shared("fixtures") else { return };
    let manifest = std::fs::read_to_string(folder.join("manifest.csv")).unwrap();
    let mut checked = 0;
    let mut differing = Vec::new();
    for line in manifest.lines().skip(1).map(fields) {
        let (name, path) = (&line[0], folder.join(&line[0]));
        let (Ok(triangles), welded) = (line[4].parse::<u64>(), line[6].parse::<u64>()) else { continue };
        if !path.is_file() || name.ends_with(".xz") {
            continue;
        }
        checked += 1;
        if let Some((_, reason)) = REFUSED.iter().find(|r| r.0 == name) {
            let message = load_file(&path).expect_err(name).to_string();
            super::assert_says(&message, &[name, reason]);
            continue;
        }
        let expanded = ImportOptions { instancing: Instancing::Expand, ..ImportOptions::default() };
        let soup = load(std::slice::from_ref(&path), &expanded, &|_| {}).unwrap_or_else(|e| panic!("{e}")).soup;
        let (mesh, report) = repaired(soup);
        let positions = report.unreferenced_dropped + welded_count(&mesh, &report);
        let other = COUNTED_OTHERWISE.iter().find(|o| o.0 == name);
        let expected = other.map_or((triangles, welded.unwrap_or(0)), |o| (o.1, o.2));
        if (report.triangles_in, positions) != expected {
            differing.push(format!("{name}: {:?} instead of {expected:?}", (report.triangles_in, positions)));
        }
        let bounds = numbers(&line[20]);
        if bounds.len() == 6 && !COUNTED_OTHERWISE.iter().any(|o| o.0 == name) {
            let (low, high) = mesh.bounds();
            let size = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
            let far = |k: usize| (low[k] - bounds[k]).abs().max((high[k] - bounds[k + 3]).abs()) > 1e-4 * size;
            if (0..3).any(far) {
                differing.push(format!("{name}: {low:?} .. {high:?} instead of {}", line[20]));
            }
        }
        let kept = report.triangles_in - report.degenerate_removed - report.duplicates_removed;
        assert_eq!(mesh.triangles.len() as u64, kept + report.split.triangles, "{name}");
        if line[8] == "closed" {
            assert_eq!(report.topology.boundary_edges, 0, "{name}");
        }
    }
    assert_eq!(differing, Vec::<String>::new());
    assert!(checked > 80, "only {checked} fixtures were found");
}

#[test]
fn scans_with_facet_normals_get_smooth_ones() {
    let Some(folder) = shared("fixtures") else { return };
    let soup = load_file(folder.join("scan_gso_frypan/chefmate_8_frypan.obj")).unwrap().soup;
    let (mesh, report) = repaired(soup);
    assert!(report.facet_normals_replaced);
    assert!(mesh.wedges.len() < 2 * mesh.positions.len(), "{} wedges", mesh.wedges.len());
}

#[test]
fn five_encodings_of_one_model_are_the_same_surface() {
    let Some(folder) = shared("fixtures/gltf_duck_variants") else { return };
    let duck = |name: &str| repaired(load_file(folder.join(name)).unwrap().soup).0;
    let plain = duck("glTF/Duck.gltf");
    assert_eq!(plain, duck("glTF-Binary/Duck.glb"));
    assert_eq!(plain, duck("glTF-Embedded/Duck.gltf"));
    let quantized = duck("glTF-Quantized/Duck.gltf");
    assert_eq!(plain.triangles.len(), quantized.triangles.len());
    let ((low, high), (low_q, high_q)) = (plain.bounds(), quantized.bounds());
    for k in 0..3 {
        assert!((low[k] - low_q[k]).abs() < 1e-3 && (high[k] - high_q[k]).abs() < 1e-3);
    }
}

#[test]
fn several_inputs_make_one_scene() {
    let Some(folder) = shared("fixtures") else { return };
    let names =
        ["small_trimesh/box.obj", "small_trimesh/plane.ply", "small_trimesh/round.stl", "small_trimesh/nested.glb"];
    let paths: Vec<_> = names.iter().map(|n| folder.join(n)).collect();
    let steps = std::cell::Cell::new(0);
    let scene = load(&paths, &Default::default(), &|p| {
        assert_eq!((p.inputs_done, p.input_count), (steps.replace(steps.get() + 1), 4));
    })
    .unwrap();
    let triangles: Vec<usize> = scene.inputs.iter().map(|i| i.triangles).collect();
    assert_eq!((triangles, scene.soup.triangles.len(), steps.get()), (vec![12, 2, 1120, 36], 1170, 5));
    assert_eq!(scene.soup.normals.len(), scene.soup.positions.len());
}

#[test]
fn instances_stand_where_their_attributes_say() {
    let Some(folder) = shared("fixtures") else { return };
    let soup = load_file(folder.join("gltf_small/SimpleInstancing_glTF-Binary/SimpleInstancing.glb")).unwrap().soup;
    let (mesh, _) = repaired(soup);
    let (low, high) = mesh.bounds();
    assert!(high.iter().zip(low).all(|(h, l)| h - l > 5.0), "{low:?} {high:?}");
}

#[test]
fn mirrored_nodes_keep_their_outside_outside() {
    let Some(folder) = shared("fixtures") else { return };
    let path = folder.join("gltf_small/NegativeScaleTest_glTF-Binary/NegativeScaleTest.glb");
    assert_normals_agree_with_winding(&path);
    assert_normals_agree_with_winding(&folder.join("gltf_duck_variants/glTF/Duck.gltf"));
}

/// The normals of the file and the sense of its triangles point to the same side, but for a few grazing ones.
fn assert_normals_agree_with_winding(path: &Path) {
    let soup = load_file(path).unwrap().soup;
    let agree = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| glam::DVec3::from_array(soup.positions[i as usize]));
        let normal = glam::Vec3::from_array(soup.normals[t[0] as usize]).as_dvec3();
        (b - a).cross(c - a).dot(normal) >= 0.0
    };
    let agreeing = soup.triangles.iter().filter(|t| agree(t)).count();
    assert!(agreeing * 100 >= soup.triangles.len() * 99, "{agreeing} of {}", soup.triangles.len());
}
