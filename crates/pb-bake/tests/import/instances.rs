//! glTF meshes that stand in several places: read once, with places that are exactly where the written-out copies are.

use super::shared;
use base64::Engine;
use glam::{DQuat, DVec3};
use pb_bake::import::{Import, ImportOptions, Instancing, load};
use pb_mesh::objects::Placement;
use serde_json::{Value, json};
use std::path::Path;

/// Triangles of each mesh.
const TRIANGLES: usize = 600;

fn floats(list: &[f64]) -> Vec<u8> {
    list.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect()
}

/// A document of two meshes, each a wavy band of 600 triangles, the second one twice as high, and lists of numbers.
fn document(nodes: Value, lists: &[(&str, &[f64])]) -> Value {
    let at = |k: usize, height: f64| [k as f64 * 0.1, (k % 2) as f64 * height, (k as f64 * 0.05).sin()];
    let band = |height: f64| (0..TRIANGLES + 2).flat_map(|k| at(k, height)).collect::<Vec<f64>>();
    let bands = [band(1.0), band(2.0)];
    let lists = bands.iter().map(|b| ("VEC3", b.as_slice())).chain(lists.iter().copied());
    let (mut binary, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    for (kind, list) in lists {
        let bytes = floats(list);
        let size = if kind == "VEC4" { 4 } else { 3 };
        accessors.push(json!({ "bufferView": views.len(), "componentType": 5126, "count": list.len() / size,
            "type": kind }));
        views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() }));
        binary.extend(bytes);
    }
    let strip = |accessor: usize| json!({ "primitives": [{ "attributes": { "POSITION": accessor }, "mode": 5 }] });
    let uri = base64::engine::general_purpose::STANDARD.encode(&binary);
    json!({
        "asset": { "version": "2.0" }, "nodes": nodes, "meshes": [strip(0), strip(1)],
        "accessors": accessors, "bufferViews": views,
        "buffers": [{ "byteLength": binary.len(), "uri": format!("data:application/octet-stream;base64,{uri}") }],
    })
}

fn loaded(path: &Path, instancing: Instancing) -> Import {
    load(&[path.to_owned()], &ImportOptions { instancing, ..ImportOptions::default() }, &|_| {}).unwrap()
}

/// Read with instances, and written out.
fn both(document: &Value) -> [Import; 2] {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    std::fs::write(&path, serde_json::to_vec(document).unwrap()).unwrap();
    [Instancing::Keep, Instancing::Expand].map(|i| loaded(&path, i))
}

/// Corners of all triangles where all objects stand, each triangle turned to begin with its least corner; sorted.
fn triangles(import: &Import) -> Vec<[DVec3; 3]> {
    let soup = &import.soup;
    let one = [Placement::IDENTITY];
    let mut list = Vec::new();
    for t in &soup.triangles {
        let places = match soup.objects.object_of(t[0] as usize) {
            0 => &one[..],
            object => &soup.objects.placements[object as usize - 1],
        };
        list.extend(places.iter().map(|p| t.map(|v| p.point(DVec3::from(soup.positions[v as usize])))));
    }
    let key = |p: DVec3| p.to_array().map(|x| (x * 1e4).round() as i64);
    list.iter_mut().for_each(|t| {
        let least = (0..3).min_by_key(|&k| key(t[k])).unwrap();
        t.rotate_left(least);
    });
    list.sort_by_key(|t| t.map(key));
    list
}

#[track_caller]
fn assert_stand_alike([kept, expanded]: &[Import; 2]) {
    let (kept, expanded) = (triangles(kept), triangles(expanded));
    assert_eq!(kept.len(), expanded.len());
    for (a, b) in kept.iter().zip(&expanded) {
        assert!((0..3).all(|k| a[k].distance(b[k]) < 1e-5 * (1.0 + b[k].length() * 1e-3)), "{a:?} instead of {b:?}");
    }
}

/// Instances of each object.
fn places(import: &Import) -> Vec<usize> {
    import.soup.objects.placements.iter().map(Vec::len).collect()
}

fn rotation(axis: [f64; 3], angle: f64) -> Value {
    json!(DQuat::from_axis_angle(DVec3::from(axis).normalize(), angle).to_array())
}

#[test]
fn meshes_of_several_nodes_are_read_once_and_stand_where_the_nodes_do() {
    let document = document(
        json!([
            { "mesh": 0, "translation": [0, 0, 3] },
            { "mesh": 1, "translation": [0, 9, 3] },
            { "mesh": 0, "translation": [5, 1, 2], "rotation": rotation([1.0, 2.0, 0.5], 2.5), "scale": [4, 4, 4] },
            { "children": [4, 5], "rotation": rotation([0.0, 1.0, 0.0], -1.0), "scale": [2, 2, 2] },
            { "mesh": 0, "translation": [-7, 1, 2], "scale": [0.125, 0.125, 0.125] },
            { "mesh": 0, "translation": [500.5, 20, -80], "rotation": rotation([0.0, 0.3, 1.0], 0.7) },
        ]),
        &[],
    );
    let both = both(&document);
    assert_eq!(both[0].soup.triangles.len(), 2 * TRIANGLES);
    assert_eq!(places(&both[0]), [4]);
    assert_eq!(both[0].soup.objects.placements[0].iter().filter(|p| **p == Placement::IDENTITY).count(), 1);
    assert!(both[0].soup.objects.placements[0].iter().all(|p| p.scale <= 1.0), "the largest place is the object's own");
    assert_stand_alike(&both);
}

#[test]
fn instancing_by_extension_gives_the_same_as_nodes() {
    let translations: Vec<f64> = (0..36).map(|k| f64::from(k * k % 23)).collect();
    let quaternions: Vec<f64> =
        (0..12).flat_map(|k| DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), f64::from(k)).to_array()).collect();
    let scales: Vec<f64> = (0..12).flat_map(|k| [0.5 + f64::from(k % 3); 3]).collect();
    let attributes = json!({ "TRANSLATION": 2, "ROTATION": 3, "SCALE": 4 });
    let node = |attributes: Value| {
        json!([{ "mesh": 1, "scale": [2, 2, 2],
            "extensions": { "EXT_mesh_gpu_instancing": { "attributes": attributes } } }])
    };
    let lists: [(&str, &[f64]); 3] = [("VEC3", &translations), ("VEC4", &quaternions), ("VEC3", &scales)];
    let both = both(&document(node(attributes), &lists));
    assert_eq!((both[0].soup.triangles.len(), places(&both[0])), (TRIANGLES, vec![12]));
    assert_stand_alike(&both);
}

#[test]
fn places_that_are_mirrored_or_stretched_alike_share_an_object_and_others_are_written_out() {
    let scaled = |x: f64, y: f64, z: f64, at: f64| json!({ "mesh": 0, "scale": [x, y, z], "translation": [0, at, 0], "rotation": rotation([1.0, 1.0, 0.0], at) });
    let nodes = json!([
        scaled(1.0, 1.0, 1.0, 0.0),
        scaled(2.0, 2.0, 2.0, 9.0),
        scaled(1.0, 1.0, 1.0, 18.0),
        scaled(-1.0, 1.0, 1.0, 27.0),
        scaled(-3.0, 3.0, 3.0, 36.0),
        scaled(-1.0, -1.0, -1.0, 45.0),
        scaled(1.0, 3.0, 1.0, 54.0),
        scaled(2.0, 6.0, 2.0, 63.0),
        scaled(1.0, 3.0, 1.0, 72.0),
        // In one place alone, and without a size.
        scaled(1.0, 1.0, 5.0, 90.0),
        scaled(0.0, 0.0, 0.0, 99.0),
    ]);
    let both = both(&document(nodes, &[]));
    let report = &both[0].inputs[0];
    assert_eq!(places(&both[0]), [3, 3, 3], "plain, mirrored, stretched");
    assert_eq!((report.instances.objects, report.instances.instances, report.instances.apart), (3, 9, 1));
    assert!(report.warnings.iter().any(|w| w.contains("1 places of repeated meshes have a scale of 0")));
    let flat = triangles(&both[1]).into_iter().filter(|t| t[0] == t[1] && t[1] == t[2]).count();
    assert_eq!(triangles(&both[0]).len() + flat, triangles(&both[1]).len());
    let whole = |import: &Import| {
        let corner = |p: DVec3| p.to_array().map(|x| (x * 1e3).round() as i64);
        let list = triangles(import).into_iter().filter(|t| t[0] != t[1] || t[1] != t[2]);
        let area: f64 = list.clone().map(|t| (t[1] - t[0]).cross(t[2] - t[0]).length()).sum();
        (list.clone().map(|t| corner(t[0])).min(), list.map(|t| corner(t[0])).max(), (area * 1e3).round())
    };
    assert_eq!(whole(&both[0]), whole(&both[1]));
}

#[test]
fn what_saves_few_triangles_is_written_out() {
    let nodes =
        |count: usize| json!((0..count).map(|k| json!({ "mesh": 0, "translation": [0, k, 0] })).collect::<Vec<_>>());
    let [two, three] = [2, 3].map(|count| both(&document(nodes(count), &[])));
    assert_eq!((places(&two[0]), two[0].soup.triangles.len()), (vec![], 2 * TRIANGLES));
    assert_eq!((places(&three[0]), three[0].soup.triangles.len()), (vec![3], TRIANGLES));
}

#[test]
fn instances_of_a_real_scene_stand_where_its_nodes_do() {
    let Some(folder) = shared("fixtures/gltf_glass_vase") else { return };
    let path = folder.join("GlassVaseFlowers.glb");
    let both = [Instancing::Keep, Instancing::Expand].map(|i| loaded(&path, i));
    assert!(!places(&both[0]).is_empty());
    let bounds = |import: &Import| {
        let all = triangles(import);
        let corners = || all.iter().flatten();
        let low = corners().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        (all.len(), (low * 1e5).round(), (high * 1e5).round())
    };
    assert_eq!(bounds(&both[0]), bounds(&both[1]));
}
