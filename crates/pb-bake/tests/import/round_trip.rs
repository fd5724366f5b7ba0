//! What is written is read back, also far from the origin.

use super::{assert_says, load_file};
use pb_bake::export::{ExportMesh, write_mesh};
use pb_mesh::mesh::Soup;
use std::fs;

/// A strip of triangles around a place in metres of a map projection.
fn far_mesh(with_colors: bool, with_normals: bool) -> ExportMesh {
    let count = 300;
    let place = |i: u32| [500_000.0 + f64::from(i) * 0.37, 4_649_776.25 + f64::from(i % 2) * 1.1, f64::from(i).sin()];
    ExportMesh {
        positions: (0..count).map(place).collect(),
        normals: if with_normals { vec![[0.0, 0.6, 0.8]; count as usize] } else { Vec::new() },
        colors: with_colors.then(|| (0..count).map(|i| [i as u8, 255 - i as u8, 7, 255]).collect()),
        triangles: (0..count - 2).map(|i| [i, i + 1 + i % 2, i + 2 - i % 2]).collect(),
    }
}

fn assert_same(name: &str, mesh: &ExportMesh, read: &Soup, tolerance: f64) {
    assert_eq!(read.positions.len(), mesh.positions.len(), "{name}");
    for (a, b) in mesh.positions.as_flattened().iter().zip(read.positions.as_flattened()) {
        assert!((a - b).abs() <= tolerance, "{name}: {a} {b}");
    }
    assert_eq!(read.normals, mesh.normals, "{name}");
    assert_eq!(read.colors, mesh.colors.clone().unwrap_or_default(), "{name}");
    assert_eq!(read.triangles, mesh.triangles, "{name}");
}

#[test]
fn written_meshes_are_read_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    for (with_colors, with_normals) in [(false, false), (true, false), (false, true), (true, true)] {
        let mesh = far_mesh(with_colors, with_normals);
        for (extension, tolerance) in [("ply", 0.0), ("obj", 0.0), ("glb", 1e-5)] {
            let path = folder.path().join("mesh").with_extension(extension);
            write_mesh(&path, &mesh).unwrap();
            assert_same(extension, &mesh, &load_file(&path).unwrap().soup, tolerance);
        }
    }
}

#[test]
fn glb_files_are_valid_for_an_independent_reader() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.glb");
    let mesh = far_mesh(true, true);
    write_mesh(&path, &mesh).unwrap();
    let model = gltf::Gltf::open(&path).unwrap();
    let blob = model.blob.as_deref().unwrap();
    let node = model.nodes().next().unwrap();
    let (translation, ..) = node.transform().decomposed();
    let primitive = node.mesh().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|_| Some(blob));
    let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
    for (read, written) in positions.iter().zip(&mesh.positions) {
        for k in 0..3 {
            let place = f64::from(read[k]) + f64::from(translation[k]);
            assert!((place - written[k]).abs() < 1e-5, "also where the translation is read in single precision");
        }
    }
    let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
    assert_eq!(indices, mesh.triangles.as_flattened());
    assert_eq!(reader.read_normals().unwrap().next(), Some([0.0, 0.6, 0.8]));
    assert_eq!(reader.read_colors(0).unwrap().into_rgba_u8().count(), mesh.positions.len());
    let bounds = primitive.bounding_box();
    assert!(positions.iter().all(|p| (0..3).all(|k| bounds.min[k] <= p[k] && p[k] <= bounds.max[k])));
}

#[test]
fn a_failed_export_leaves_nothing_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    fs::write(&path, "what was there").unwrap();
    let mut broken = far_mesh(false, true);
    broken.normals.pop();
    let message = write_mesh(&path, &broken).unwrap_err().to_string();
    assert_says(&message, &["mesh.ply", "cannot be written", "one per position"]);
    assert_eq!(fs::read_to_string(&path).unwrap(), "what was there");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);

    let message = write_mesh(&folder.path().join("mesh.step"), &far_mesh(false, false)).unwrap_err().to_string();
    assert_says(&message, &["mesh.step", ".ply, .obj and .glb"]);
    let message = write_mesh(&folder.path().join("no/such/mesh.ply"), &far_mesh(false, false)).unwrap_err().to_string();
    assert_says(&message, &["no/such", "cannot be written"]);
}

#[cfg(unix)]
#[test]
fn exported_files_are_as_readable_as_any_other() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (mesh, other) = (folder.path().join("mesh.ply"), folder.path().join("other"));
    write_mesh(&mesh, &far_mesh(false, false)).unwrap();
    fs::write(&other, "").unwrap();
    let mode = |path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(mesh), mode(other));
}
