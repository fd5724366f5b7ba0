//! What the text and binary formats allow, and what is read from them.

use super::{assert_says, load_file, read, refusal, repaired, welded_count};
use pb_bake::import::{Format, load_bytes};
use std::fs;

fn warnings(format: Format, text: &str) -> Vec<String> {
    load_bytes(format, text.as_bytes(), None).unwrap_or_else(|e| panic!("{e}")).1
}

#[test]
fn obj_indices_may_count_backwards_and_point_ahead() {
    let soup = read(Format::Obj, "f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n");
    assert_eq!(soup.positions.len(), 3);
    assert_eq!(soup.triangles, [[0, 1, 2], [0, 1, 2]]);
}

#[test]
fn obj_faults_name_their_line() {
    let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let cases = [
        ("f 1 2 9000", ":4:", "vertex 9000, but only 3 are defined"),
        ("f 1 2 -4", ":4:", "vertex -4, but only 3 are defined"),
        ("f 1 0 2", ":4:", "vertex 0, but OBJ counts from 1"),
        ("f 1 2 x", ":4:", "\"x\" is no corner of a face"),
        ("f 1 2 3/1/1/1", ":4:", "is no corner of a face"),
        ("f 1 2 3//a", ":4:", "is no corner of a face"),
        ("v 1 2\nf 1 2 4", ":4:", "a vertex needs three numbers"),
        ("v 1,5 2 3\nf 1 2 4", ":4:", "a vertex needs three numbers"),
    ];
    for (line, place, what) in cases {
        assert_says(&refusal(Format::Obj, format!("{v}{line}\n")), &[place, what]);
    }
}

#[test]
fn obj_lines_may_be_continued_end_with_crlf_and_have_bytes_that_are_no_utf8() {
    let text = b"# caf\xE9 C:\\models\\\r\nv 0 0 0\r\nv 1 \\\r\n0 0\r\nv 0 1 0 # corner\r\nf 1 \\\r\n  2 \\\r\n  3\r\n";
    let soup = read(Format::Obj, text);
    assert_eq!((soup.positions.len(), soup.triangles.len()), (3, 1));
}

#[test]
fn obj_colours_may_come_late_and_be_bytes() {
    let text = "v 0 0 0\nv 1 0 0 1 0 0.5\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(read(Format::Obj, text).colors, [[255; 4], [255, 0, 128, 255], [255; 4]]);
    let text = "v 0 0 0 255 0 10\nv 1 0 0 0 0 0\nv 0 1 0 1 2 3\nf 1 2 3\n";
    assert_eq!(read(Format::Obj, text).colors[0], [255, 0, 10, 255]);
    let text = "v 0 0 0 nan 0 0\nv 1 0 0 0 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n";
    assert_eq!(read(Format::Obj, text).colors[0], [255; 4]);
    assert_says(&warnings(Format::Obj, text)[0], &["vertex colour cannot be read"]);
}

#[test]
fn obj_corners_with_and_without_normals_stand_side_by_side() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nvn 1 0 0\nf 1//1 3//1 2//7\n";
    let soup = read(Format::Obj, text);
    let normals: Vec<_> = soup.triangles.iter().map(|t| t.map(|i| soup.normals[i as usize])).collect();
    let x = [1.0, 0.0, 0.0];
    assert_eq!(normals, [[[0.0; 3]; 3], [x, x, [0.0; 3]]]);
    assert_says(&warnings(Format::Obj, text)[0], &["a normal that is not defined"]);
}

#[test]
fn obj_with_many_faces_is_read_in_parts_without_losing_any() {
    let mut text = String::from("v 0 0 0\nv 0 1 0\n");
    let count = 300_000;
    for i in 1..=count {
        let face = if i % 2 == 0 { "-3 -2 -1" } else { "-2 -3 -1" };
        text.push_str(&format!("v {i} {} 0\nf {face}\n", i % 2));
    }
    let (mesh, report) = repaired(read(Format::Obj, &text));
    assert_eq!((mesh.triangles.len() as u64, welded_count(&mesh, &report)), (count, count + 2));
    assert_eq!(report.topology.boundary_edges, count + 2);
}

#[test]
fn concave_polygons_are_covered_once() {
    let soup = read(Format::Obj, "v 0 0 0\nv 2 -2 0\nv 1 0 0\nv 2 2 0\nf 1 2 3 4\n");
    assert_eq!(soup.polygons_triangulated, 1);
    let area: f64 = soup
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| glam::DVec3::from_array(soup.positions[i as usize]));
            (b - a).cross(c - a).z / 2.0
        })
        .inspect(|&area| assert!(area > 0.0))
        .sum();
    assert!((area - 2.0).abs() < 1e-12);
}

#[test]
fn material_colours_become_vertex_colours_unless_a_texture_covers_them() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write(
        "my colours.mtl",
        "newmtl red one\nKd 1 0 0\nNs oops\nnewmtl tex\nKd 0 0 0\nmap_Kd a.png\nnewmtl grey\nKd 0.5\n",
    );
    let v = "mtllib my colours.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n";
    write("a.obj", &format!("{v}usemtl red one\nf 1 2 3\nusemtl tex\nf 3 2 1\nusemtl grey\nf 1 2 3\n"));
    let soup = load_file(folder.path().join("a.obj")).unwrap().soup;
    let colors: Vec<_> = soup.triangles.iter().map(|t| soup.colors[t[0] as usize]).collect();
    assert_eq!(colors, [[255, 0, 0, 255], [255; 4], [128, 128, 128, 255]]);

    write("plain.mtl", "newmtl plain\nKd 0.8 0.8 0.8\n");
    write("b.obj", "mtllib plain.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl plain\nf 1 2 3\n");
    assert!(load_file(folder.path().join("b.obj")).unwrap().soup.colors.is_empty(), "nobody chose that colour");
}

#[test]
fn a_missing_or_outside_material_library_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("in");
    fs::create_dir(&inside).unwrap();
    fs::write(folder.path().join("secret.mtl"), "newmtl a\nKd 1 0 0\n").unwrap();
    for name in ["missing.mtl", "../secret.mtl", "/etc/passwd", "C:\\models\\x.mtl"] {
        let text = format!("mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n");
        fs::write(inside.join("a.obj"), text).unwrap();
        let import = load_file(inside.join("a.obj")).unwrap();
        assert_says(&import.inputs[0].warnings[0], &[name, "is not beside the model"]);
        assert!(import.soup.colors.is_empty());
    }
}

#[test]
fn large_coordinates_keep_their_detail_in_every_format_that_has_it() {
    let place = [500_123.456_789, 4_649_776.223_456, 1_234.000_001];
    let row = |x: f64| format!("{} {} {}", place[0] + x, place[1] + x * x, place[2]);
    let obj = format!("v {}\nv {}\nv {}\nf 1 2 3\n", row(0.0), row(1.0), row(2.0));
    assert_eq!(read(Format::Obj, obj).positions[0], place);
    let xyz = "property double x\nproperty double y\nproperty double z\n";
    let list = "element face 1\nproperty list uchar int vertex_index\nend_header\n";
    let body = format!("{}\n{}\n{}\n3 0 1 2\n", row(0.0), row(1.0), row(2.0));
    let ply = format!("ply\nformat ascii 1.0\nelement vertex 3\n{xyz}{list}{body}");
    assert_eq!(read(Format::Ply, ply).positions[0], place);
    let facet = format!("vertex {} vertex {} vertex {}", row(0.0), row(1.0), row(2.0));
    let stl = format!("solid\nfacet normal 0 0 1 outer loop {facet} endloop endfacet\nendsolid\n");
    assert_eq!(read(Format::Stl, stl).positions[0], place);
}

/// A header for four vertices with colours as `kind`, and one face element.
fn ply_header(format: &str, kind: &str, face: &str) -> String {
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let rgb: String = ["red", "green", "blue"].iter().map(|c| format!("property {kind} {c}\n")).collect();
    format!("ply\nformat {format} 1.0\nobj_info x\nelement vertex 4\n{xyz}{rgb}{face}end_header\n")
}

#[test]
fn ply_in_all_three_encodings_is_the_same_mesh() {
    let rows: [([f32; 3], [u8; 3]); 4] = [
        ([0.0, 0.0, 0.0], [255, 0, 1]),
        ([1.5, 0.0, 0.0], [2, 3, 4]),
        ([1.5, 1.0, 0.0], [5, 6, 7]),
        ([0.0, 1.0, -2.0], [8, 9, 255]),
    ];
    let face =
        "element face 2\nproperty uchar flags\nproperty list uchar short vertex_indices\nproperty list int char more\n";
    let mut ascii = ply_header("ascii", "uchar", face);
    let mut little = ply_header("binary_little_endian", "uchar", face).into_bytes();
    let mut big = ply_header("binary_big_endian", "uchar", face).into_bytes();
    for (p, c) in rows {
        ascii.push_str(&format!("{} {} {} {} {} {}\n", p[0], p[1], p[2], c[0], c[1], c[2]));
        p.iter().for_each(|x| little.extend(x.to_le_bytes()));
        p.iter().for_each(|x| big.extend(x.to_be_bytes()));
        little.extend(c);
        big.extend(c);
    }
    for face in [vec![0i16, 1, 2, 3], vec![0, 2, 1]] {
        let words: Vec<String> = face.iter().map(i16::to_string).collect();
        ascii.push_str(&format!("7 {} {} 1 9\n", face.len(), words.join(" ")));
        for bytes in [&mut little, &mut big] {
            bytes.extend([7, face.len() as u8]);
        }
        face.iter().for_each(|i| little.extend(i.to_le_bytes()));
        face.iter().for_each(|i| big.extend(i.to_be_bytes()));
        little.extend(1i32.to_le_bytes());
        big.extend(1i32.to_be_bytes());
        little.push(9);
        big.push(9);
    }
    let soup = read(Format::Ply, &ascii);
    assert_eq!(soup.positions[3], [0.0, 1.0, -2.0]);
    assert_eq!((soup.colors[0], soup.colors[3]), ([255, 0, 1, 255], [8, 9, 255, 255]));
    assert_eq!((soup.triangles.len(), soup.polygons_triangulated), (3, 1));
    assert_eq!(soup, read(Format::Ply, &little));
    assert_eq!(soup, read(Format::Ply, &big));
    assert_eq!(soup, read(Format::Ply, ascii.replace('\n', "\r\n")));
    assert_eq!(soup, read(Format::Ply, format!("\n\n{ascii}")));
}

#[test]
fn ply_colours_of_other_types_are_scaled() {
    let face = "element face 1\nproperty list uchar int vertex_indices\n";
    for (kind, row) in
        [("float", "1 0.5 0"), ("double", "1 0.5 0"), ("ushort", "65535 32896 0"), ("uchar", "255 128 0")]
    {
        let body = format!("0 0 0 {row}\n1 0 0 {row}\n0 1 0 {row}\n0 0 1 {row}\n3 0 1 2\n");
        let soup = read(Format::Ply, ply_header("ascii", kind, face) + &body);
        assert_eq!(soup.colors[0], [255, 128, 0, 255], "{kind}");
    }
}

#[test]
fn ply_strips_are_cut_at_minus_one_and_keep_their_orientation() {
    let strips = "element tristrips 1\nproperty list int int vertex_indices\n";
    let rows = "0 0 0 0 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n1 1 0 0 0 0\n";
    let body = format!("{rows}8 0 1 2 3 -1 1 3 2\n");
    let soup = read(Format::Ply, ply_header("ascii", "uchar", strips) + &body);
    assert_eq!(soup.triangles, [[0, 1, 2], [2, 1, 3], [1, 3, 2]]);
}

#[test]
fn ply_faults_are_named() {
    let face = "element face 1\nproperty list uchar int vertex_indices\n";
    let header = ply_header("ascii", "uchar", face);
    let rows = "0 0 0 0 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n0 0 1 0 0 0\n";
    assert_says(&refusal(Format::Ply, format!("{header}{rows}3 0 1 4\n")), &["face 0", "vertex 4", "4 vertices"]);
    assert_says(&refusal(Format::Ply, format!("{header}{rows}3 0 1 -1\n")), &["face 0", "vertex -1"]);
    assert_says(&refusal(Format::Ply, format!("{header}{rows}3 0 1\n")), &["ends within row 0 of 1 of \"face\""]);
    assert_says(&refusal(Format::Ply, format!("{header}{rows}3 0 1 zwei\n")), &[":18:", "\"zwei\" is no number"]);
    assert_says(&refusal(Format::Ply, header.replace("end_header\n", "")), &["no \"end_header\" line"]);
    let without_format = header.replace("format ascii 1.0\n", "");
    assert_says(&refusal(Format::Ply, format!("{without_format}{rows}3 0 1 2\n")), &["no \"format\" line"]);
}

#[test]
fn stl_with_several_solids_and_odd_case_is_read_whole() {
    let facet =
        "  FACET Normal nan 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 0 1e0 0\n endloop\n endfacet\n";
    let text = format!("Solid first facet\r\n{facet}endsolid first\nsolid\n{facet}{facet}endsolid\n");
    let soup = read(Format::Stl, &text);
    assert_eq!((soup.triangles.len(), soup.normals.len()), (3, 0));
    let cut = warnings(Format::Stl, text.trim_end().trim_end_matches("endsolid"));
    assert_says(&cut[0], &["no end"]);
}

#[test]
fn binary_stl_that_begins_with_solid_is_binary() {
    let mut bytes = b"solid of a program that should know better".to_vec();
    bytes.resize(80, b' ');
    bytes.extend(1u32.to_le_bytes());
    let corners: [f32; 12] = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.5, 0.0];
    corners.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    bytes.extend([0; 2]);
    assert_eq!(read(Format::Stl, &bytes).positions[2], [0.0, 2.5, 0.0]);
    bytes[80] = 2;
    assert_says(&refusal(Format::Stl, &bytes), &["promises 2 triangles", "room for 1"]);
    bytes[80] = 1;
    bytes.extend([0; 7]);
    let (model, warnings) = load_bytes(Format::Stl, &bytes, None).unwrap();
    assert_eq!(model.soup.triangles.len(), 1);
    assert_says(&warnings[0], &["7 bytes behind the last triangle"]);
}
