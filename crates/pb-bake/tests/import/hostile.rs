//! Files made to break a reader: cut, garbled, with absurd counts, and things that are no files.

use super::{assert_says, load_file, read, refusal, repaired};
use pb_bake::export::{ExportMesh, write_mesh};
use pb_bake::import::{Format, load_bytes};
use std::fs;

const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1//1 3//1 2//1\nf 1 2 4\nf 2 3 4\nf -2 -4 -1\n";

fn tetrahedron() -> ExportMesh {
    ExportMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        colors: Some(vec![[10, 20, 30, 255]; 4]),
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    }
}

fn written(extension: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model").with_extension(extension);
    write_mesh(&path, &tetrahedron()).unwrap();
    fs::read(path).unwrap()
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(4u32.to_le_bytes());
    let mesh = tetrahedron();
    for t in mesh.triangles {
        bytes.extend([0; 12]);
        t.iter().flat_map(|&i| mesh.positions[i as usize]).for_each(|x| bytes.extend((x as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii_stl() -> Vec<u8> {
    let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    format!("solid a b\n{facet}{facet}endsolid a b\n").into_bytes()
}

fn ascii_ply() -> Vec<u8> {
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    format!("{header}element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1 0 0 0 1 0\n3 0 1 2\n")
        .into_bytes()
}

fn models() -> Vec<(Format, Vec<u8>)> {
    vec![
        (Format::Obj, OBJ.into()),
        (Format::Ply, ascii_ply()),
        (Format::Ply, written("ply")),
        (Format::Stl, ascii_stl()),
        (Format::Stl, binary_stl()),
        (Format::Gltf, written("glb")),
    ]
}

#[test]
fn the_models_of_these_tests_are_sound() {
    for (format, bytes) in models() {
        assert!(!repaired(read(format, bytes)).0.triangles.is_empty());
    }
}

#[test]
fn a_file_cut_at_any_length_never_panics_and_binary_ones_are_refused() {
    for (format, bytes) in models() {
        let is_text = bytes.is_ascii() && format != Format::Gltf;
        for length in 0..bytes.len() {
            let result = load_bytes(format, &bytes[..length], None);
            assert!(is_text || result.is_err(), "{format:?} cut at {length} of {} loads", bytes.len());
        }
    }
}

#[test]
fn a_file_with_any_byte_changed_never_panics() {
    for (format, bytes) in models() {
        for at in 0..bytes.len() {
            for change in [1, 0x80, 0xFF] {
                let mut changed = bytes.clone();
                changed[at] ^= change;
                if let Ok((model, _)) = load_bytes(format, &changed, None) {
                    let soup = model.soup;
                    let count = soup.positions.len();
                    assert!(soup.triangles.as_flattened().iter().all(|&i| (i as usize) < count));
                }
            }
        }
    }
}

#[test]
fn garbage_is_refused_by_every_reader() {
    let mut state = 1u64;
    let garbage: Vec<u8> = std::iter::repeat_with(|| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 56) as u8
    })
    .take(100_000)
    .collect();
    for format in [Format::Obj, Format::Ply, Format::Stl, Format::Gltf] {
        for start in ["", "solid ", "ply\n", "glTF\x02\0\0\0", "v 0 0 0\nf ", "{\"asset\":"] {
            refusal(format, [start.as_bytes(), &garbage].concat());
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("garbage.dat");
    fs::write(&path, &garbage).unwrap();
    assert_says(&load_file(&path).unwrap_err().to_string(), &["garbage.dat", "no kind of model", "OBJ, PLY, STL"]);
}

#[test]
fn absurd_counts_are_refused_before_anything_is_allocated() {
    let ply = |format: &str, vertices: &str, faces: &str| {
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let list = "property list uint int vertex_indices\n";
        format!("ply\nformat {format} 1.0\nelement vertex {vertices}\n{xyz}element face {faces}\n{list}end_header\n")
    };
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let message = refusal(Format::Ply, ply(format, "1000000000000", "1"));
        assert_says(&message, &["promises 1000000000000 rows of \"vertex\"", "bytes follow"]);
        assert_says(&refusal(Format::Ply, ply(format, "0", "1000000000000")), &["rows of \"face\""]);
        assert_says(&refusal(Format::Ply, ply(format, "18446744073709551615", "1")), &["rows of \"vertex\""]);
        assert_says(&refusal(Format::Ply, ply(format, "99999999999999999999", "1")), &[":3:", "is no number"]);
    }
    let mut list = ply("binary_little_endian", "0", "1").into_bytes();
    list.extend(u32::MAX.to_le_bytes());
    assert_says(&refusal(Format::Ply, &list), &["a list of 4294967295 items"]);
    let nothing = "ply\nformat ascii 1.0\nelement nothing 1000000000000000000\nelement vertex 0\nproperty float x\n\
                   property float y\nproperty float z\nend_header\n";
    assert_says(&refusal(Format::Ply, nothing), &["no faces"]);

    let mut stl = binary_stl();
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_says(&refusal(Format::Stl, &stl), &["promises 4294967295 triangles", "room for 4"]);
    assert_says(&refusal(Format::Obj, "v 0 0 0\nf 1 2 999999999999\n"), &[":2:", "vertex 999999999999"]);
    assert_says(&refusal(Format::Obj, "v 0 0 0\nf 1 1 99999999999999999999\n"), &[":2:", "is no corner"]);
}

#[test]
fn unusable_coordinates_are_named() {
    for (text, at) in [("v 0 0 nan\n", ":1:"), ("v 0 0 0\nv -inf 0 0\n", ":2:"), ("v 1e999 0 0\n", ":1:")] {
        assert_says(&refusal(Format::Obj, format!("{text}f 1 1 1\n")), &[at, "no usable number"]);
    }
    assert_says(&refusal(Format::Obj, "v 1e35 0 0\nv 0 0 0\nv 1 0 0\nf 1 2 3\n"), &["vertex 0", "no usable place"]);
    let text = String::from_utf8(ascii_ply()).unwrap();
    assert_says(&refusal(Format::Ply, text.replace("1 0 0", "1 nan 0")), &["vertex 1 (counted from 0)", "(1, NaN, 0)"]);
    assert_says(&refusal(Format::Ply, text.replace("1 0 0", "1 inf 0")), &["(1, inf, 0)"]);
    let text = String::from_utf8(ascii_stl()).unwrap();
    assert_says(&refusal(Format::Stl, text.replace("vertex 1", "vertex nan")), &[":5:", "\"nan\""]);
    let mut stl = binary_stl();
    stl[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_says(&refusal(Format::Stl, &stl), &["vertex 0", "NaN"]);
}

#[test]
fn no_faces_is_refused_and_one_triangle_is_enough() {
    for text in ["v 0 0 0\nv 1 0 0\nl 1 2\n", "v 0 0 0\np 1\n", "# nothing\n"] {
        assert_says(&refusal(Format::Obj, text), &["no faces", "export a mesh"]);
    }
    assert_says(&refusal(Format::Stl, "solid a\nendsolid a\n"), &["no faces"]);
    assert_says(&refusal(Format::Gltf, r#"{"asset":{"version":"2.0"}}"#), &["no faces"]);
    for (format, bytes) in [(Format::Ply, ascii_ply()), (Format::Obj, b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3".to_vec())] {
        let (mesh, _) = repaired(read(format, bytes));
        assert_eq!((mesh.triangles.len(), mesh.positions.len()), (1, 3));
    }
}

#[test]
fn directories_missing_and_empty_files_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("model.obj")).unwrap();
    assert_says(&load_file(at("model.obj")).unwrap_err().to_string(), &["model.obj", "is a directory"]);
    let missing = load_file(at("missing.ply")).unwrap_err();
    assert!(missing.refusal().is_none());
    assert_says(&missing.to_string(), &["missing.ply", "cannot be read", "check the name"]);
    fs::write(at("empty.stl"), "").unwrap();
    assert_says(&load_file(at("empty.stl")).unwrap_err().to_string(), &["empty.stl", "is empty"]);
    #[cfg(unix)]
    assert_says(&load_file("/dev/null").unwrap_err().to_string(), &["/dev/null", "not a regular file"]);
}

#[test]
fn files_of_other_kinds_are_named_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&str, &[u8], &str); 7] = [
        ("a.obj", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        ("a.usdz", b"PK\x03\x04whatever", "unpack it"),
        ("a.glb", b"PK\x03\x04whatever", "unpack it"),
        ("a.ply.gz", b"\x1F\x8B\x08whatever", "gunzip"),
        ("a.fbx", b"Kaydara FBX Binary  \0", "export it as glTF"),
        ("a.dae", b"<?xml version=\"1.0\"?><COLLADA>", "export it as glTF"),
        ("a.stl", b"\xFF\xFEs\0o\0l\0i\0d\0", "UTF-8"),
    ];
    for (name, bytes, remedy) in cases {
        fs::write(folder.path().join(name), bytes).unwrap();
        assert_says(&load_file(folder.path().join(name)).unwrap_err().to_string(), &[name, remedy]);
    }
}

#[test]
fn content_decides_before_the_name_does() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in [("a.obj", ascii_ply()), ("b.ply", written("glb")), ("c", binary_stl()), ("d.txt", OBJ.into())]
    {
        fs::write(folder.path().join(name), bytes).unwrap();
        assert!(load_file(folder.path().join(name)).is_ok(), "{name}");
    }
}
