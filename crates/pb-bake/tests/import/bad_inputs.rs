//! Broken, hostile and odd files of public projects: each loads or is refused with a message, none panics.

use super::{assert_says, load_file, shared};
use pb_mesh::repair::{RepairOptions, repair};
use std::path::{Path, PathBuf};

const EXTENSIONS: &[&str] = &["obj", "ply", "stl", "gltf", "glb", "drc"];

/// Odd, but a surface: triangles before the repair.
const MUST_LOAD: &[(&str, usize)] = &[
    ("assimp_gltf_bad/wrongTypes/badString.gltf", 12),
    ("gltf_hdr_only/tests/box_sparse.glb", 12),
    ("gltf_hdr_only/tests/box_sparse.gltf", 12),
    ("heseler_invalid/gltf/cube-gltf-2.0_binary-unmodified-valid/cube-gltf-2.0_binary-unmodified-valid.glb", 12),
    (
        "heseler_invalid/obj/cube-obj-1.0-linked_mtl_file_deleted-invalid/cube-obj-1.0-linked_mtl_file_deleted-invalid.obj",
        12,
    ),
    ("heseler_invalid/obj/cube-obj-1.0-unmodified-unknown/cube-obj-1.0-unmodified-unknown.obj", 12),
    ("heseler_invalid/ply/cube-ply-1.0_ascii-unmodified-unknown/cube-ply-1.0_ascii-unmodified-unknown.ply", 12),
    ("magnum_stl/ascii.stl", 1),
    ("numpy_stl/stl_binary/CubeInvalidUnicode.stl", 12),
    ("obj2gltf_missing/box-incomplete-attributes/box-incomplete-normals.obj", 12),
    ("obj2gltf_missing/box-missing-attributes/box-missing-attributes.obj", 12),
    ("obj2gltf_missing/box-missing-mtllib/box-missing-mtllib.obj", 12),
    ("obj2gltf_missing/box-missing-texture/box-missing-texture.obj", 12),
    ("obj2gltf_missing/box-mixed-attributes-2/box-mixed-attributes-2.obj", 48),
    ("obj2gltf_missing/box-uncleaned/box-uncleaned.obj", 12),
    ("obj2gltf_missing/box-unnamed-material/box-unnamed-material.obj", 12),
    ("obj2gltf_missing/box-windows-paths/box-windows-paths.obj", 12),
    ("obj2tiles_small/Obj2Tiles.Library.Test/TestData/degenerate-faces.obj", 2),
    ("obj2tiles_small/Obj2Tiles.Library.Test/TestData/mtllib-empty.obj", 1),
    ("obj2tiles_small/Obj2Tiles.Library.Test/TestData/scientific-notation.obj", 1),
    ("obj2tiles_small/Obj2Tiles.Library.Test/TestData/triangle-colors.obj", 2),
    ("obj2tiles_small/Obj2Tiles.Test/TestData/comments-and-blanks.obj", 1),
    ("obj2tiles_small/Obj2Tiles.Test/TestData/negative-idx.obj", 2),
    ("openscad_bad/scad/3D/misc/single-triangle.stl", 1),
    ("openscad_bad/scad/bugs/issue1580-zero-area-triangle.stl", 14),
    ("openscad_bad/stl/cubes-touching.stl", 24),
    ("pytorch3d_missing/missing_files_obj/model.obj", 2),
    ("tinyobj_bad/issue-330.obj", 3),
    ("tinyobj_bad/missing_material_file.obj", 36),
    ("trimesh_bad/face_in_group_name_mid_file.obj", 2),
    ("trimesh_bad/jacked.obj", 12),
    ("trimesh_bad/nancolor.obj", 12),
    ("utf8_damaged_textures/female02/female02.obj", 6233),
];

/// No surface, or too damaged: what the message says.
const MUST_BE_REFUSED: &[(&str, &[&str])] = &[
    ("assimp_gltf_bad/IndexOutOfRange/IndexOutOfRange.gltf", &["primitive 0", "vertex 255", "only 24"]),
    ("assimp_gltf_bad/MissingBin/BoxTextured.gltf", &["\"BoxTextured0.bin\", which is not there"]),
    ("assimp_gltf_bad/SchemaFailures/sceneWrongType.gltf", &[":6:", "cannot be read"]),
    ("assimp_invalid/invalid/malformed.obj", &[":28:", "vertex 0, but OBJ counts from 1"]),
    ("cgltf_fuzz/data/BadBasisU.gltf", &["the glTF document cannot be read"]),
    ("gltf_v1/Cesium_Air.glb", &["is glTF 1.0", "convert it"]),
    ("lfs_pointers/tests/assets/rerun.obj", &["Git LFS pointer", "git lfs pull"]),
    ("lfs_pointers/tests/assets/gaussian_splats/cactus.ply", &["Git LFS pointer"]),
    ("magnum_gltf/error.gltf", &["the glTF document cannot be read"]),
    ("magnum_gltf/scene-default-oob.gltf", &["the default scene is 0"]),
    ("magnum_gltf/scene-invalid-child-oob.gltf", &["node 7", "only 7 nodes"]),
    ("magnum_gltf/scene-invalid-cycle.gltf", &["loop"]),
    ("magnum_gltf/scene-invalid-cycle-deep.gltf", &["loop"]),
    ("magnum_gltf/scene-invalid-multiple-parents.gltf", &["node 2", "several parents"]),
    ("magnum_ply/format-unsupported.ply", &[":2:", "binary_mixed_endian"]),
    ("magnum_ply/invalid-face-type.ply", &[":4:", "float16"]),
    ("magnum_ply/invalid-signature.ply", &[":1:", "\"ply\""]),
    ("magnum_ply/invalid-vertex-property.ply", &[":4:", "property"]),
    ("magnum_ply/positions-missing.ply", &["lacks one of the properties x, y, z"]),
    ("numpy_stl/qt-lc_numeric-reproducer", &["no kind of model"]),
    ("obj2tiles_small/Obj2Tiles.Test/TestData/empty.obj", &["empty"]),
    ("openscad_bad/stl/invalidvertex.stl", &[":89:", "\"blah\" is no number"]),
    ("openscad_bad/stl/toomanyvertices.stl", &[":91:", "endloop"]),
    ("openscad_bad/stl/unparseable.stl", &[":4:", "\\x10"]),
    ("tinyobj_bad/invalid-face-definition.obj", &["no faces"]),
    ("tinyobj_bad/invalid-relative-texture-index.obj", &[":2:", "only 0 are defined"]),
    ("tinyobj_bad/invalid-relative-vertex-index.obj", &[":1:", "vertex -4"]),
    ("tinyobj_bad/issue-140-zero-face-idx.obj", &[":16:", "counts from 1"]),
    ("trimesh_bad/empty.obj", &["no faces"]),
    ("trimesh_bad/empty.ply", &["no faces"]),
    ("trimesh_bad/empty.stl", &["no faces"]),
    ("trimesh_bad/points_bin.ply", &["no faces"]),
    ("utf8_damaged/draco/bunny.drc", &["Draco"]),
    ("utf8_damaged/gltf/Flamingo.glb", &["ends within a chunk"]),
    ("utf8_damaged/gltf/duck.glb", &["the GLB header promises"]),
    ("utf8_damaged/gltf/gears.glb", &["the GLB header promises"]),
    ("utf8_damaged/ply/binary/dolphins_le.ply", &["face 0", "refers to vertex"]),
    ("utf8_damaged/stl/binary/colored.stl", &["promises 538976288 triangles", "room for 3878"]),
    ("utf8_damaged/stl/binary/pr2_head_pan.stl", &["the header promises"]),
];

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files_below(&path, found);
        } else if path.extension().is_some_and(|e| EXTENSIONS.contains(&e.to_string_lossy().to_lowercase().as_str())) {
            found.push(path);
        }
    }
}

#[test]
fn every_bad_input_loads_or_is_refused_with_its_name_and_a_remedy() {
    let Some(folder) = shared("bad-inputs") else { return };
    let mut files = Vec::new();
    files_below(&folder, &mut files);
    assert!(files.len() > 250, "only {} files were found", files.len());
    for path in files {
        match load_file(&path).map(|import| repair(import.soup, &RepairOptions::default())) {
            Ok(Ok((mesh, _))) => assert!(!mesh.triangles.is_empty()),
            Ok(Err(error)) => assert_says(&error.to_string(), &["no usable triangle"]),
            Err(error) => assert_says(&error.to_string(), &[&path.display().to_string(), "; "]),
        }
    }
}

#[test]
fn odd_files_load() {
    let Some(folder) = shared("bad-inputs") else { return };
    for (name, triangles) in MUST_LOAD {
        let import = load_file(folder.join(name)).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(import.inputs[0].triangles, *triangles, "{name}");
    }
}

#[test]
fn damaged_files_are_refused_with_the_place_and_the_reason() {
    let Some(folder) = shared("bad-inputs") else { return };
    for (name, parts) in MUST_BE_REFUSED {
        match load_file(folder.join(name)) {
            Ok(_) => panic!("{name} loads"),
            Err(error) => assert_says(&error.to_string(), parts),
        }
    }
}

#[test]
fn sound_geometry_with_damaged_textures_gets_one_warning() {
    let Some(folder) = shared("bad-inputs") else { return };
    load_file(folder.join("utf8_damaged_textures/female02/female02.obj")).unwrap();
}
