//! Bakes of third-party models and images, where those are beside the checkout.

use crate::harness::Place;
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::textures::MapFormat;
use pb_mesh::texture::{BlockFormat, Texels, decode};
use std::path::{Path, PathBuf};

/// Textured models of less than 60,000 triangles.
const MODELS: &[&str] = &[
    "exr_textured_obj/chefmate_8_frypan.obj",
    "gltf_duck_variants/glTF/Duck.gltf",
    "gltf_duck_variants/glTF-Quantized/Duck.gltf",
    "gltf_small/Fox_glTF-Binary/Fox.glb",
    "gltf_small/MorphPrimitivesTest_glTF-Binary/MorphPrimitivesTest.glb",
    "gltf_small/NegativeScaleTest_glTF-Binary/NegativeScaleTest.glb",
    "gltf_small/TextureTransformMultiTest_glTF-Binary/TextureTransformMultiTest.glb",
    "gltf_small/UnicodeTest_glTF/Unicode❤♻Test.gltf",
    "gltf_small/VertexColorTest_glTF-Binary/VertexColorTest.glb",
    "obj_spot/spot_triangulated.obj",
    "scan_gso_frypan/chefmate_8_frypan.obj",
    "scan_correction_fluid/textured.obj",
    "scan_meshroom_4k/texturedMesh.obj",
];

/// Larger, or with so many texels that all of them take half a minute.
const LARGE_MODELS: &[&str] = &[
    "gltf_glass_vase/GlassVaseFlowers.glb",
    "gltf_sheenchair/SheenChair.gltf",
    "obj_gazebo_fire_truck/meshes/fire_truck.obj",
    "obj_gazebo_suv/meshes/suv.obj",
    "scan_stapler_vcolor/textured.obj",
    "scan_ycb_chain/textured.obj",
    "tiles_mars_220_atlases/mars_tiles.glb",
];

/// A folder or file of third-party data; none, loudly, where it is absent.
fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if !path.exists() {
        eprintln!("SKIPPED: {} is not there, so it is not baked", path.display());
        return None;
    }
    Some(path)
}

/// Bakes each as users do who are in a hurry; `verify` counts flipped texture triangles of all levels.
fn bake_all(models: &[&str]) {
    let place = Place::new();
    for name in models {
        let Some(model) = shared(&format!("fixtures/{name}")) else { continue };
        let spot = shared("fixtures/obj_spot/spot_texture.png").filter(|_| name.starts_with("obj_spot"));
        let spot = spot.map(|s| s.to_str().unwrap().to_string());
        let mut words = vec![model.to_str().unwrap(), "m.pb", "--texture-quality", "fast", "--json", "--quiet"];
        words.extend(spot.iter().flat_map(|s| ["--texture", s]));
        let json = place.run(&words).succeeds().json();
        assert!(json["textures"]["charts"].as_u64() > Some(0), "{name}: {json}");
        place.run(&["verify", "m.pb"]).succeeds();
    }
}

#[test]
fn textured_models_bake_by_default_and_no_triangle_is_turned_over_in_its_texture() {
    bake_all(MODELS);
}

#[test]
fn large_textured_models_bake_by_default_and_no_triangle_is_turned_over_in_its_texture() {
    bake_all(LARGE_MODELS);
}

/// Texels of all mips of the base colour at level 0, linear where they are halves, else sRGB in 0 to 1.
fn base_colors(archive: &Path) -> (MapFormat, Vec<[f32; 3]>) {
    let model = Model::open(archive).unwrap();
    let textures = model.textures().unwrap();
    let format = textures.maps[0].format().unwrap();
    let block = match format {
        MapFormat::Bc6h => BlockFormat::Bc6h,
        MapFormat::RgbaF16 => BlockFormat::RgbaF16,
        _ => BlockFormat::Bc7,
    };
    let mut found = Vec::new();
    for cluster in 0..model.record().clusters {
        let bytes = model.read_texture(model.texture_chunk_id(cluster, 0)).unwrap();
        for place in textures.mips(cluster, 0).filter(|m| m.map == 0) {
            let bytes = &bytes[place.offset as usize..][..place.bytes as usize];
            match decode(block, bytes, place.side).unwrap() {
                Texels::Rgba8(texels) => {
                    found.extend(texels.iter().map(|t| [0, 1, 2].map(|k| f32::from(t[k]) / 255.0)))
                }
                Texels::RgbaF16(texels) => {
                    found.extend(texels.iter().map(|t| [0, 1, 2].map(|k| half::f16::from_bits(t[k]).to_f32())));
                }
                Texels::Rg8(_) => panic!("colours have three channels"),
            }
        }
    }
    (format, found)
}

fn brightest(texels: impl IntoIterator<Item = [f32; 3]>) -> f32 {
    texels.into_iter().flatten().fold(0.0, f32::max)
}

#[test]
fn an_exr_image_becomes_a_half_float_map_whose_bright_values_survive() {
    let Some(folder) = shared("fixtures/exr_textured_obj") else { return };
    let place = Place::new();
    let model = folder.join("chefmate_8_frypan.obj");
    place.run(&[model.to_str().unwrap(), "m.pb"]).succeeds();
    let (format, texels) = base_colors(&place.path("m.pb"));
    assert_eq!(format, MapFormat::RgbaF16, "a small HDR image is not compressed");
    let source = exr::prelude::read_first_flat_layer_from_file(folder.join("zip.exr")).unwrap();
    let colors = source.layer_data.channel_data.list.iter().filter(|c| c.name.to_string() != "A");
    let source = colors.flat_map(|c| c.sample_data.values_as_f32()).fold(0.0, f32::max);
    let found = brightest(texels);
    println!("brightest of the source {source}, of the tiles {found}");
    assert!(source > 1.0 && found > 0.7 * source && found < 1.3 * source, "{source} became {found}");
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<PathBuf> =
        entries.flat_map(|path| if path.is_dir() { files_below(&path) } else { vec![path] }).collect();
    files.sort();
    files
}

/// `all.obj`, a row of squares, each with one of the images as its material's; how many they are.
fn squares(place: &Place, folders: &[&str]) -> Option<usize> {
    let (mut obj, mut mtl, mut count) =
        ("mtllib all.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n".to_string(), String::new(), 0);
    for folder in folders {
        for file in files_below(&shared(&format!("bad-inputs/{folder}"))?) {
            // Plain names, so that nothing but the content is odd.
            let ending = file.extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default();
            let name = format!("{count}.{ending}");
            place.write(&name, &std::fs::read(&file).unwrap());
            mtl += &format!("newmtl m{count}\nmap_Kd {name}\n");
            let x = 2 * count;
            obj += &format!("v {x} 0 0\nv {} 0 0\nv {} 1 0\nv {x} 1 0\nusemtl m{count}\n", x + 1, x + 1);
            obj += "f -4/1 -3/2 -2/3 -1/4\n";
            count += 1;
        }
    }
    place.write("all.obj", obj.as_bytes());
    place.write("all.mtl", mtl.as_bytes());
    Some(count)
}

#[test]
fn damaged_images_become_placeholders_with_a_warning_each_and_the_bake_goes_on() {
    let place = Place::new();
    let Some(count) = squares(&place, &["png_bad", "jpeg_bad", "exr_damaged"]) else { return };
    let run = place.run(&["all.obj", "all.pb", "--texture-quality", "fast", "--tile-size", "512", "--json"]).succeeds();
    let json = run.json();
    let placeholders = json["textures"]["placeholders"].as_u64().unwrap() as usize;
    assert_eq!(json["textures"]["images"], count);
    assert!((40..count).contains(&placeholders), "{placeholders} of {count}");
    assert_eq!(run.stderr.matches("; a magenta checker stands in its place").count(), placeholders, "{}", run.stderr);
    place.run(&["verify", "all.pb"]).succeeds();
    let before = place.files();
    place.run(&["all.obj", "strict.pb", "--strict"]).fails(1, &format!("--strict: {placeholders} of {count} images"));
    assert_eq!(place.files(), before);
}

#[test]
fn a_model_with_damaged_textures_shows_the_placeholder() {
    let Some(model) = shared("bad-inputs/utf8_damaged_textures/female02/female02.obj") else { return };
    let (place, model) = (Place::new(), model.to_str().unwrap());
    let run = place.run(&[model, "m.pb", "--texture-quality", "fast", "--tile-size", "512"]).succeeds();
    assert!(run.stderr.contains("checker stands in its place"), "{}", run.stderr);
    place.run(&["verify", "m.pb"]).succeeds();
    let magenta = |t: &[f32; 3]| t[0] > 0.8 && t[1] < 0.2 && t[2] > 0.8;
    assert!(base_colors(&place.path("m.pb")).1.iter().any(magenta));
    place.run(&[model, "strict.pb", "--strict"]).fails(1, "--strict");
    assert!(!place.path("strict.pb").exists());
}
