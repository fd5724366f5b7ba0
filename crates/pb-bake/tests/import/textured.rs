//! What readers say of materials, images and texture coordinates: small models made here, then real ones.

use super::{load_file, repaired, shared};
use pb_bake::images::{DecodeOptions, ImageContent, decode_all};
use pb_bake::import::{Format, Import, ImportOptions, Model, load, load_bytes};
use pb_mesh::material::{Slot, TextureRef, Wrap};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

const PLAIN_OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 0.5 0.25\n";

/// A folder with some files in it, gone at the end.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, text)| fs::write(folder.path().join(name), text).unwrap());
    folder
}

fn loaded(folder: &tempfile::TempDir, name: &str) -> Import {
    load_file(folder.path().join(name)).unwrap_or_else(|e| panic!("{e}"))
}

fn base_color(import: &Import, material: usize) -> &TextureRef {
    import.materials[material].texture(Slot::BaseColor).expect("it has a base colour image")
}

/// Texture coordinates of the first set, per corner.
fn corner_uvs(soup: &pb_mesh::mesh::Soup) -> Vec<[[f32; 2]; 3]> {
    soup.triangles.iter().map(|t| t.map(|i| soup.uv_sets[0][i as usize])).collect()
}

#[test]
fn obj_seams_and_materials_come_through_with_v_downwards() {
    let faces = "usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 2/4 4/-1 3/1\nf 2 4 3/99\n";
    let files = folder(&[
        ("m.obj", &format!("mtllib m.mtl\n{PLAIN_OBJ}{faces}")),
        ("m.mtl", "newmtl a\nmap_Kd A.PNG\nnewmtl b\nmap_Kd -s 2 2 my b.png\nnewmtl c\nmap_Kd c.png\n"),
        ("a.png", ""),
    ]);
    let import = loaded(&files, "m.obj");
    let expected = [
        [[0.0, 1.0], [1.0, 1.0], [0.0, 0.0]],
        [[0.5, 0.75], [0.5, 0.75], [0.0, 1.0]],
        // None and one that is not defined: what (0, 0) of the file is here.
        [[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]],
    ];
    assert_eq!(corner_uvs(&import.soup), expected);
    assert_eq!(import.soup.material_of, [0, 1, 1]);
    assert_eq!(import.images.len(), 2, "that of the unused material is not wanted");
    assert!(matches!(&import.images[0].content, ImageContent::File(path) if path.ends_with("a.png")));
    assert!(matches!(&import.images[1].content, ImageContent::Missing(_)) && import.images[1].name == "my b.png");
    assert_eq!(base_color(&import, 1).transform, [[2.0, 0.0, 0.0], [0.0, 2.0, -1.0]]);
    let warnings = import.inputs[0].warnings.join("\n");
    assert!(warnings.contains("texture coordinate that is not defined"), "{warnings}");
}

#[test]
fn a_library_that_comes_late_still_gets_its_texture_coordinates() {
    let faces = "f 1/1 2/2 3/3\n";
    let mtl = ("m.mtl", "newmtl a\nmap_Kd a.png\n");
    let first = folder(&[("m.obj", &format!("mtllib m.mtl\nusemtl a\n{PLAIN_OBJ}{faces}")), mtl]);
    let late = folder(&[("m.obj", &format!("{PLAIN_OBJ}mtllib m.mtl\nusemtl a\n{faces}")), mtl]);
    let after_a_face = folder(&[
        ("m.obj", &format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nmtllib m.mtl\nusemtl a\n{PLAIN_OBJ}f 4/1 5/2 6/3\n")),
        mtl,
    ]);
    let (first, late) = (loaded(&first, "m.obj").soup, loaded(&late, "m.obj").soup);
    assert_eq!(first, late);
    assert_eq!(corner_uvs(&loaded(&after_a_face, "m.obj").soup)[1], corner_uvs(&first)[0]);
}

#[test]
fn without_an_image_nothing_of_textures_is_left() {
    let text = format!("mtllib m.mtl\nusemtl a\n{PLAIN_OBJ}f 1/1 2/2 3/3\n");
    let files = folder(&[("m.obj", &text), ("m.mtl", "newmtl a\nKd 1 0 0\nnewmtl b\nmap_Kd b.png\n")]);
    let import = loaded(&files, "m.obj");
    assert!(import.soup.uv_sets.is_empty() && import.soup.material_of.is_empty());
    assert!(import.materials.is_empty() && import.images.is_empty());
    assert_eq!(import.soup.colors, [[255, 0, 0, 255]; 3]);
    assert_eq!(repaired(import.soup).0.texturing, None);
}

#[test]
fn an_image_from_the_command_line_covers_only_what_names_none() {
    let textured = format!("mtllib m.mtl\nusemtl a\n{PLAIN_OBJ}f 1/1 2/2 3/3\n");
    let files = folder(&[
        ("bare.obj", &format!("{PLAIN_OBJ}f 1/1 2/2 3/4\n")),
        ("own.obj", &textured),
        ("m.mtl", "newmtl a\nmap_Kd own.png\n"),
        (
            "flat.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
        ),
        ("own.png", ""),
    ]);
    let path = |name: &str| files.path().join(name);
    let options = ImportOptions { texture: Some(path("given.png")), ..ImportOptions::default() };
    let import =
        load(&[path("bare.obj"), path("own.obj"), path("flat.stl"), path("bare.obj")], &options, &|_| {}).unwrap();
    assert_eq!((import.images.len(), import.soup.material_of.len()), (2, 4));
    let image =
        |t: usize| import.materials[import.soup.material_of[t] as usize].texture(Slot::BaseColor).map(|t| t.image);
    assert_eq!([0, 1, 2, 3].map(image), [Some(0), Some(1), None, Some(0)]);
    assert_eq!(corner_uvs(&import.soup)[0][2], [0.5, 0.75]);
    assert!(import.inputs[2].warnings.join("").contains("--texture is not used"));
}

fn ply(comments: &str, vertex: &str, face: &str, rows: &str) -> String {
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let list = "property list uchar int vertex_indices\n";
    let [vertices, faces] = [rows.matches('v').count(), rows.matches('f').count()];
    let rows = rows.replace(['v', 'f'], "");
    format!(
        "ply\nformat ascii 1.0\n{comments}element vertex {vertices}\n{xyz}{vertex}element face {faces}\n{list}{face}end_header\n{rows}"
    )
}

#[test]
fn ply_vertices_may_have_texture_coordinates_under_many_names() {
    for [u, v] in [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]] {
        let vertex = format!("property float {u}\nproperty float {v}\n");
        let rows = "v 0 0 0 0.25 0\nv 1 0 0 1 0\nv 0 1 0 0 1\nf 3 0 1 2\n";
        let files = folder(&[("a.ply", &ply("comment TextureFile my a.png\n", &vertex, "", rows))]);
        let import = loaded(&files, "a.ply");
        assert_eq!(corner_uvs(&import.soup), [[[0.25, 1.0], [1.0, 1.0], [0.0, 0.0]]]);
        assert_eq!((import.images[0].name.as_str(), import.soup.material_of.as_slice()), ("my a.png", &[0][..]));
    }
}

#[test]
fn ply_faces_may_have_texture_coordinates_and_images_of_their_own() {
    let comments = "comment TextureFile a.png\ncomment TextureFile b.png\n";
    let face = "property list uchar float texcoord\nproperty int texnumber\n";
    let vertices = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    // The quad and the first triangle agree at vertex 0, the second does not; the third's list is too short.
    let faces = "f 4 0 1 2 3 8 0 0 1 0 1 1 0 1 1\nf 3 0 2 1 6 0 0 0.5 0.5 1 0 0\nf 3 0 1 3 6 0.5 0 1 0 0 1 7\nf 3 1 2 3 2 0 0 -1\n";
    let files = folder(&[("a.ply", &ply(comments, "", face, &format!("{vertices}{faces}")))]);
    let import = loaded(&files, "a.ply");
    let soup = &import.soup;
    assert_eq!((soup.triangles.len(), soup.polygons_triangulated, soup.positions.len()), (5, 1, 9));
    let uvs = corner_uvs(soup);
    assert_eq!(uvs[2], [[0.0, 1.0], [0.5, 0.5], [1.0, 1.0]]);
    assert_eq!((uvs[3][0], uvs[4]), ([0.5, 1.0], [[0.0, 1.0]; 3]));
    assert_eq!(soup.triangles[0][0], soup.triangles[2][0], "one record where they agree");
    let none = import.materials.len() as u32 - 1;
    assert_eq!(soup.material_of, [1, 1, 0, none, none]);
    assert_eq!((import.images.len(), import.materials[none as usize].textures), (2, [None; 5]));
    let (mesh, report) = repaired(import.soup);
    assert_eq!((report.positions_welded, report.duplicates_removed), (5, 1));
    assert_eq!(mesh.texturing.unwrap().corner_uvs[0].len(), mesh.triangles.len());
}

/// One triangle with two sets of texture coordinates; everything else is given.
fn gltf(more: Value) -> (Model, Vec<String>) {
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut bytes: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend([0u8, 0, 255, 0, 0, 255, 0, 0]);
    let mut document = json!({
        "asset": { "version": "2.0" },
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "TEXCOORD_0": 0, "TEXCOORD_3": 1 }, "material": 0,
        }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 0, "componentType": 5121, "normalized": true, "byteOffset": 36, "count": 3, "type": "VEC2" },
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2" },
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 44 }],
        "buffers": [{ "byteLength": 44, "uri": data_uri(&bytes) }],
        "nodes": [{ "mesh": 0 }],
        "images": [{ "uri": "data:image/png;base64,AAAA" }, { "uri": "b.png" }],
        "textures": [{ "source": 0 }, { "source": 1, "sampler": 0 }],
        "samplers": [{ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728 }],
    });
    document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(2);
    for (key, value) in more.as_object().unwrap() {
        document[key] = value.clone();
    }
    load_bytes(Format::Gltf, &serde_json::to_vec(&document).unwrap(), None).unwrap_or_else(|e| panic!("{e}"))
}

fn data_uri(bytes: &[u8]) -> String {
    use base64::Engine;
    format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}

#[test]
fn gltf_materials_are_read_whole() {
    let (model, warnings) = gltf(json!({ "materials": [{
        "name": "all",
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": 1, "texCoord": 3 },
            "metallicRoughnessTexture": { "index": 0 },
            "roughnessFactor": 0.25,
        },
        "normalTexture": { "index": 0, "scale": 0.5 },
        "occlusionTexture": { "index": 0, "strength": 0.75 },
        "emissiveTexture": { "index": 0 },
        "emissiveFactor": [0.5, 0.25, 0],
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4 } },
        "alphaMode": "MASK", "alphaCutoff": 0.125,
    }] }));
    let m = &model.materials[0];
    assert_eq!((m.metallic, m.roughness, m.normal_scale, m.occlusion_strength), (1.0, 0.25, 0.5, 0.75));
    assert_eq!((m.emissive, m.alpha_cutoff, m.name.as_str()), ([2.0, 1.0, 0.0], Some(0.125), "all"));
    let base = m.texture(Slot::BaseColor).unwrap();
    assert_eq!((base.wrap, base.nearest), ([Wrap::Clamp, Wrap::Mirror], true));
    assert!(Slot::ALL.iter().all(|&slot| m.texture(slot).is_some()));
    assert_eq!((model.images.len(), model.soup.uv_sets.len()), (2, 2));
    // TEXCOORD_3 is made of bytes.
    assert_eq!(model.soup.uv_sets[base.uv_set as usize], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    assert!(matches!(
        model.images.iter().find(|i| i.name.contains("b.png")).unwrap().content,
        ImageContent::Missing(_)
    ));
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn gltf_blending_becomes_a_cut_out_in_quarters_unless_it_is_opaque() {
    let texture = json!({ "index": 0 });
    let material = |factor: f64, texture: Value| {
        json!({
            "alphaMode": "BLEND",
            "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, factor], "baseColorTexture": texture },
            "emissiveTexture": { "index": 0 },
        })
    };
    for (factor, texture, blended) in
        [(1.0, texture.clone(), true), (0.5, texture, true), (0.25, Value::Null, true), (1.0, Value::Null, false)]
    {
        let (model, warnings) = gltf(json!({ "materials": [material(factor, texture)] }));
        let found = &model.materials[0];
        assert_eq!((found.is_blended, found.alpha_cutoff.is_some()), (blended, blended), "{factor}");
        assert_eq!(warnings.iter().filter(|w| w.contains("cut-out")).count(), 1);
    }
}

#[test]
fn gltf_specular_glossiness_and_webp_have_counterparts() {
    let (model, warnings) = gltf(json!({
        "materials": [{ "extensions": { "KHR_materials_pbrSpecularGlossiness": {
            "diffuseTexture": { "index": 0 }, "glossinessFactor": 0.75,
        } } }],
        "textures": [{ "source": 0, "extensions": { "EXT_texture_webp": { "source": 1 } } }],
    }));
    let m = &model.materials[0];
    assert_eq!((m.metallic, m.roughness, model.images[0].name.contains("b.png")), (0.0, 0.25, true));
    assert!(warnings.iter().any(|w| w.contains("specular-glossiness")));
}

#[test]
fn broken_references_in_a_gltf_material_are_left_out_with_a_warning() {
    let base = |texture: Value| json!([{ "pbrMetallicRoughness": { "baseColorTexture": texture } }]);
    for (more, what) in [
        (json!({ "materials": base(json!({ "index": 7 })) }), "texture 7, but there are only 2"),
        (json!({ "materials": base(json!({ "index": -1 })) }), "texture -1"),
        (json!({ "materials": base(json!({ "index": "x" })) }), "texture \"x\""),
        (
            json!({ "materials": base(json!({ "index": 0 })), "textures": [{ "source": 9 }] }),
            "image 9, but there are only 2",
        ),
        (json!({ "materials": base(json!({ "index": 0 })), "textures": [{}] }), "no image"),
        (json!({ "materials": base(json!({ "index": 0, "texCoord": 1 })) }), "TEXCOORD_1 is not there"),
    ] {
        let (model, warnings) = gltf(more);
        assert!(warnings.iter().any(|w| w.contains(what)), "{what}: {warnings:?}");
        assert_eq!(model.soup.triangles.len(), 1);
    }
    for image in [
        json!({ "bufferView": 9 }),
        json!({}),
        json!({ "uri": "data:image/png;base64,@" }),
        json!({ "uri": "../b.png" }),
        json!({ "uri": "https://a.b/c.png" }),
    ] {
        let (model, _) = gltf(json!({ "materials": base(json!({ "index": 0 })), "images": [image] }));
        assert!(matches!(model.images[0].content, ImageContent::Missing(_)), "{:?}", model.images);
    }
}

#[test]
fn real_models_have_the_materials_images_and_texture_coordinates_of_their_files() {
    let Some(folder) = shared("fixtures") else { return };
    for (name, materials, images, missing, sets) in [
        ("scan_meshroom_4k/texturedMesh.obj", 1, 1, 0, 1),
        ("tiles_mars_220_atlases/mars_tiles.glb", 220, 220, 0, 1),
        ("obj_gazebo_suv/meshes/suv.obj", 2, 2, 0, 1),
        ("obj_gazebo_fire_truck/meshes/fire_truck.obj", 3, 3, 2, 1),
        ("exr_textured_obj/chefmate_8_frypan.obj", 1, 1, 0, 1),
        ("scan_stapler_vcolor/textured.obj", 1, 1, 0, 1),
        // The seventh image is that of a variant, the fourth of the next but one that of a clear coat.
        ("gltf_sheenchair/SheenChair.gltf", 6, 6, 0, 2),
        ("gltf_glass_vase/GlassVaseFlowers.glb", 3, 3, 0, 1),
        ("gltf_duck_variants/glTF-Embedded/Duck.gltf", 1, 1, 0, 1),
        ("gltf_small/TextureTransformMultiTest_glTF-Binary/TextureTransformMultiTest.glb", 29, 3, 0, 2),
        ("gltf_garage/garage.gltf", 0, 0, 0, 0),
        ("obj_spot/spot_triangulated.obj", 0, 0, 0, 0),
    ] {
        let import = load_file(folder.join(name)).unwrap_or_else(|e| panic!("{e}"));
        let gone = import.images.iter().filter(|i| matches!(i.content, ImageContent::Missing(_))).count();
        let found = (import.materials.len(), import.images.len(), gone, import.soup.uv_sets.len());
        assert_eq!(found, (materials, images, missing, sets), "{name}");
        let all = decode_all(&import.images, &DecodeOptions::default(), &|_| {}).unwrap();
        assert_eq!(all.faults.len(), missing, "{name}: {:?}", all.faults);
        let triangles = import.soup.triangles.len();
        assert!(materials == 0 || import.soup.material_of.len() == triangles, "{name}");
    }
}

#[test]
fn the_mars_tiles_clamp_and_their_texture_coordinates_fit() {
    let Some(folder) = shared("fixtures") else { return };
    let import = load_file(folder.join("tiles_mars_220_atlases/mars_tiles.glb")).unwrap();
    assert!((0..220).all(|m| base_color(&import, m).wrap == [Wrap::Clamp; 2]));
    assert!(import.soup.uv_sets[0].as_flattened().iter().all(|x| (-0.01..=1.01).contains(x)));
    let (mesh, report) = repaired(import.soup);
    let texturing = mesh.texturing.unwrap();
    assert_eq!((report.degenerate_removed, report.uvs_repaired), (132, 0));
    assert_eq!((texturing.material_of.len(), texturing.corner_uvs[0].len()), (177_818, 177_818));
}

/// Its tests show a tick where the transform is right: in this corner of its image, and nowhere else.
#[test]
fn texture_transforms_rotate_as_the_test_model_of_the_extension_wants() {
    let Some(folder) = shared("fixtures/gltf_small") else { return };
    let name = "TextureTransformMultiTest_glTF-Binary/TextureTransformMultiTest.glb";
    let import = load_file(folder.join(name)).unwrap();
    let soup = &import.soup;
    for (triangle, &material) in soup.triangles.iter().zip(&soup.material_of) {
        let material = &import.materials[material as usize];
        if !material.name.starts_with("BaseColorTest") {
            continue;
        }
        let texture = material.texture(Slot::BaseColor).unwrap();
        for i in triangle {
            let [u, v] = soup.uv_sets[texture.uv_set as usize][*i as usize];
            let at = texture.transform.map(|row| row[0] * u + row[1] * v + row[2]);
            assert!((0.75..1.0).contains(&at[0]) && (0.0..0.25).contains(&at[1]), "{}: {at:?}", material.name);
        }
    }
}

#[test]
fn damaged_textures_leave_the_model_whole() {
    let Some(folder) = shared("bad-inputs") else { return };
    for (name, least) in [
        ("utf8_damaged_textures/female02/female02.obj", 3),
        ("obj2gltf_missing/box-missing-texture/box-missing-texture.obj", 1),
    ] {
        let import = load_file(Path::new(&folder).join(name)).unwrap();
        let all = decode_all(&import.images, &DecodeOptions::default(), &|_| {}).unwrap();
        assert!(all.faults.len() >= least, "{name}: {:?}", all.faults);
        assert!(repaired(import.soup).0.texturing.is_some());
    }
}
