//! glTF documents made by hand: node trees, transforms, URIs, and what must not be believed in them.

use super::{assert_says, load_file, read, refusal};
use base64::Engine;
use pb_bake::import::Format;
use serde_json::{Value, json};
use std::fs;

/// One triangle in the plane z = 0 as a data URI; everything else is given.
fn document(more: Value) -> Value {
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    let uri =
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes));
    let mut document = json!({
        "asset": { "version": "2.0" },
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "byteLength": 36, "uri": uri }],
        "nodes": [{ "mesh": 0 }],
    });
    for (key, value) in more.as_object().unwrap() {
        document[key] = value.clone();
    }
    document
}

fn bytes(more: Value) -> Vec<u8> {
    serde_json::to_vec(&document(more)).unwrap()
}

fn positions(more: Value) -> Vec<[f64; 3]> {
    read(Format::Gltf, bytes(more)).positions
}

fn refused(more: Value) -> String {
    refusal(Format::Gltf, bytes(more))
}

#[test]
fn only_the_default_scene_is_read_and_without_one_all_roots() {
    let nodes = json!([{ "mesh": 0 }, { "mesh": 0, "translation": [5, 0, 0], "children": [2] }, { "mesh": 0 }]);
    let scenes = json!([{ "nodes": [0] }, { "nodes": [1] }]);
    assert_eq!(positions(json!({ "nodes": nodes, "scenes": scenes, "scene": 1 })).len(), 6);
    assert_eq!(positions(json!({ "nodes": nodes, "scenes": scenes })).len(), 9);
}

#[test]
fn transforms_multiply_from_the_root_and_in_double_precision() {
    let nodes = json!([
        { "children": [1], "translation": [500_000.123_456, 4_649_776.5, 0.25] },
        { "children": [2], "rotation": [0, 0, 0.707_106_781_186_547_5, 0.707_106_781_186_547_5], "scale": [2, 1, 1] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 10, 1] },
    ]);
    let p = positions(json!({ "nodes": nodes }));
    let close = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-8);
    assert!(close(p[0], [500_000.123_456, 4_649_776.5, 10.25]), "{p:?}");
    assert!(close(p[1], [500_000.123_456, 4_649_778.5, 10.25]), "{p:?}");
}

#[test]
fn a_mirror_turns_the_winding() {
    let soup = read(Format::Gltf, bytes(json!({ "nodes": [{ "mesh": 0, "scale": [-1, 1, 1] }] })));
    assert_eq!(soup.triangles, [[0, 2, 1]]);
}

#[test]
fn a_chain_of_a_hundred_thousand_nodes_is_walked() {
    let mut nodes: Vec<Value> = (1..=100_000).map(|i| json!({ "children": [i], "translation": [0, 0, 1] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    assert_eq!(positions(json!({ "nodes": nodes }))[0], [0.0, 0.0, 100_000.0]);
}

#[test]
fn loops_and_several_parents_are_refused() {
    let looped = json!({ "nodes": [{ "children": [1] }, { "children": [0], "mesh": 0 }] });
    assert_says(&refused(looped.clone()), &["loop"]);
    let mut rooted = looped;
    rooted["scenes"] = json!([{ "nodes": [0] }]);
    rooted["scene"] = json!(0);
    assert_says(&refused(rooted), &["node 0", "reached in two ways"]);
    let own_child = json!({ "nodes": [{ "children": [0], "mesh": 0 }], "scenes": [{ "nodes": [0] }], "scene": 0 });
    assert_says(&refused(own_child), &["node 0", "loop"]);
    // Twenty generations with two children each would be a million copies if they were followed.
    let mut nodes: Vec<Value> = (1..=20).map(|i| json!({ "children": [i, i] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    assert_says(&refused(json!({ "nodes": nodes })), &["several parents"]);
}

#[test]
fn a_small_file_cannot_expand_without_bound() {
    let instances =
        json!([{ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": 1 } } } }]);
    let accessors = json!([
        { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
        { "componentType": 5126, "count": 1_000_000_000, "type": "VEC3" },
    ]);
    assert_says(
        &refused(json!({ "nodes": instances, "accessors": accessors })),
        &["1000000000 elements without any bytes"],
    );
    let primitives: Vec<Value> = (0..1000).map(|_| json!({ "attributes": { "POSITION": 0 }, "indices": 1 })).collect();
    let accessors = json!([
        { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
        { "componentType": 5125, "count": 4_000_000, "type": "SCALAR" },
    ]);
    let meshes = json!([{ "primitives": primitives }]);
    assert_says(&refused(json!({ "meshes": meshes, "accessors": accessors })), &["more than 715827882 triangles"]);
}

#[test]
fn ranges_are_checked_before_they_are_read() {
    let accessor = |change: Value| {
        let mut accessor = json!({ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" });
        for (key, value) in change.as_object().unwrap() {
            accessor[key] = value.clone();
        }
        refused(json!({ "accessors": [accessor] }))
    };
    assert_says(&accessor(json!({ "count": 4 })), &["accessor 0", "needs 4 elements of 12 bytes"]);
    assert_says(&accessor(json!({ "byteOffset": 4 })), &["accessor 0", "more than buffer view 0 has"]);
    assert_says(&accessor(json!({ "byteOffset": u64::MAX })), &["accessor 0", "more than buffer view 0 has"]);
    assert_says(&accessor(json!({ "bufferView": 7 })), &["buffer view 7, but there are only 1"]);
    assert_says(&accessor(json!({ "type": "MAT4" })), &["accessor 0", "MAT4"]);
    assert_says(&accessor(json!({ "type": "VEC4" })), &["accessor 0", "VEC4"]);
    assert_says(&accessor(json!({ "componentType": 5124 })), &["accessor 0", "5124"]);
    let view = |view: Value| refused(json!({ "bufferViews": [view] }));
    assert_says(&view(json!({ "buffer": 0, "byteLength": 40 })), &["goes beyond the 36 bytes"]);
    assert_says(&view(json!({ "buffer": 0, "byteLength": 36, "byteOffset": u64::MAX })), &["goes beyond the 36 bytes"]);
    assert_says(&view(json!({ "buffer": 0, "byteLength": 36, "byteStride": 4 })), &["overlap: the stride is 4"]);
    assert_says(&view(json!({ "buffer": 3, "byteLength": 36 })), &["buffer 3", "only 1 buffers"]);
    let sparse = json!({
        "count": 1,
        "indices": { "bufferView": 0, "componentType": 5125, "byteOffset": 12 },
        "values": { "bufferView": 0 },
    });
    assert_says(&accessor(json!({ "sparse": sparse })), &["sparse value for element 1065353216 of 3"]);
    let meshes = json!([{ "primitives": [{ "attributes": { "POSITION": 9 } }] }]);
    assert_says(&refused(json!({ "meshes": meshes })), &["accessor 9", "only 1 accessors"]);
    assert_says(&refused(json!({ "nodes": [{ "mesh": 5 }] })), &["mesh 5, but there are only 1"]);
}

#[test]
fn files_outside_the_folder_and_on_other_machines_are_not_touched() {
    let buffer = |uri: &str| refused(json!({ "buffers": [{ "byteLength": 36, "uri": uri }] }));
    for uri in
        ["../secret.bin", "a/../../secret.bin", "%2e%2e/secret.bin", "..%5Csecret.bin", "/etc/passwd", "C:\\a.bin"]
    {
        assert_says(&buffer(uri), &["buffer 0", uri, "outside the folder", "one folder"]);
    }
    assert_says(&buffer("https://example.org/a.bin"), &["on another machine"]);
    assert_says(&buffer("data:application/octet-stream;base64,@@@"), &["data URI is broken"]);
    assert_says(&buffer("data:application/octet-stream;base64,AAAA"), &["has 3 bytes where the document promises 36"]);
    assert_says(&refused(json!({ "buffers": [{ "byteLength": 36 }] })), &["neither a URI nor a GLB chunk"]);
}

#[test]
fn uris_may_have_blanks_and_codes() {
    let folder = tempfile::tempdir().unwrap();
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let data: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(folder.path().join("my dätä.bin"), &data).unwrap();
    fs::write(folder.path().join("100%25.bin"), &data).unwrap();
    for uri in ["my dätä.bin", "my%20d%C3%A4t%C3%A4.bin", "./my dätä.bin", "100%25.bin"] {
        let text = bytes(json!({ "buffers": [{ "byteLength": 36, "uri": uri }] }));
        fs::write(folder.path().join("a.gltf"), text).unwrap();
        assert_eq!(load_file(folder.path().join("a.gltf")).unwrap().soup.triangles.len(), 1, "{uri}");
    }
}

#[test]
fn unknown_required_extensions_and_compression_are_named() {
    let require = |name: &str| refused(json!({ "extensionsRequired": [name] }));
    assert_says(&require("EXT_something_new"), &["requires the extension EXT_something_new"]);
    assert_says(&require("KHR_draco_mesh_compression"), &["KHR_draco_mesh_compression", "gltf-transform"]);
    assert_says(&require("EXT_meshopt_compression"), &["EXT_meshopt_compression", "gltf-transform"]);
    let views = json!([{ "buffer": 0, "byteLength": 36, "extensions": { "EXT_meshopt_compression": { "count": 3 } } }]);
    assert_says(&refused(json!({ "bufferViews": views })), &["compressed with EXT_meshopt_compression"]);
    assert_eq!(positions(json!({ "extensionsRequired": ["KHR_materials_unlit"] })).len(), 3);
}

#[test]
fn colours_are_the_factor_times_the_vertex_in_srgb() {
    let materials = json!([{ "pbrMetallicRoughness": { "baseColorFactor": [0.215_861, 1.0, 0.0, 1.0] } }]);
    let meshes = json!([{ "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }]);
    let soup = read(Format::Gltf, bytes(json!({ "materials": materials, "meshes": meshes })));
    assert_eq!(soup.colors, [[128, 255, 0, 255]; 3]);
    let meshes = json!([{ "primitives": [{ "attributes": { "POSITION": 0, "COLOR_0": 0 }, "material": 0 }] }]);
    let soup = read(Format::Gltf, bytes(json!({ "materials": materials, "meshes": meshes })));
    assert_eq!(soup.colors, [[0, 0, 0, 255], [128, 0, 0, 255], [0, 255, 0, 255]]);
    assert!(read(Format::Gltf, bytes(json!({}))).colors.is_empty());
}

#[test]
fn old_versions_and_broken_json_are_told_apart() {
    assert_says(&refused(json!({ "asset": { "version": "1.0" } })), &["is glTF 1.0", "convert it"]);
    assert_says(&refused(json!({ "asset": { "version": "2.1", "minVersion": "3.0" } })), &["is glTF 3.0"]);
    assert_says(&refusal(Format::Gltf, "{\"nodes\":[]}"), &["no \"asset\""]);
    assert_says(&refusal(Format::Gltf, "{\n\"asset\":}"), &[":2:", "cannot be read"]);
    assert_says(&refusal(Format::Gltf, "[".repeat(200_000)), &["cannot be read"]);
    let deep = format!("{{\"asset\":{}{}}}", "[".repeat(100_000), "]".repeat(100_000));
    assert_says(&refusal(Format::Gltf, deep), &["cannot be read"]);
}
