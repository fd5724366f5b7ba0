//! Levels with textures, written for other programs and read by them.

use crate::harness::Place;
use pb_bake::import::{ImportOptions, load};

/// Quads per side of the sheet.
const QUADS: usize = 40;
/// Texels per side of its image.
const SIDE: u32 = 128;
/// Largest difference of a channel to the image: block compression and rounding.
const TOLERANCE: f64 = 6.0;

/// A wavy sheet over [0, 40] x [0, 40] whose image is red along x and green against y, baked as `sheet.pb`.
fn place() -> Place {
    let place = Place::new();
    let points = || (0..=QUADS).flat_map(|y| (0..=QUADS).map(move |x| (x as f64, y as f64)));
    let mut obj = String::from("mtllib sheet.mtl\nusemtl a\n");
    points().for_each(|(x, y)| obj += &format!("v {x} {y} {}\n", (x / 5.0).sin() + (y / 7.0).cos()));
    points().for_each(|(x, y)| obj += &format!("vt {} {}\n", part(x), part(y)));
    for (x, y) in (0..QUADS * QUADS).map(|i| (i % QUADS, i / QUADS)) {
        let a = y * (QUADS + 1) + x + 1;
        let corner = |i: usize| format!("{i}/{i}");
        let [a, b, c, d] = [a, a + 1, a + QUADS + 2, a + QUADS + 1].map(corner);
        obj += &format!("f {a} {b} {c} {d}\n");
    }
    let picture = image::RgbImage::from_fn(SIDE, SIDE, |x, y| image::Rgb([2 * x as u8, 2 * y as u8, 64]));
    picture.save(place.path("sheet.png")).unwrap();
    place.write("sheet.obj", obj.as_bytes());
    place.write("sheet.mtl", b"newmtl a\nmap_Kd sheet.png\n");
    place.run(&["sheet.obj", "sheet.pb", "--levels", "3", "--cluster-triangles", "800"]).succeeds();
    place
}

/// Texture coordinate of a place: away from the image's borders, where it would repeat.
fn part(place: f64) -> f64 {
    0.1 + 0.8 * place / QUADS as f64
}

/// What the image says at a place of the sheet.
fn expected([x, y]: [f64; 2]) -> [f64; 3] {
    let texel = |part: f64| (f64::from(SIDE) * part - 0.5).clamp(0.0, f64::from(SIDE - 1));
    [2.0 * texel(part(x)), 2.0 * texel(1.0 - part(y)), 64.0]
}

/// Between the four nearest texels.
fn bilinear(image: &image::RgbImage, [u, v]: [f32; 2]) -> [f64; 3] {
    let (w, h) = (image.width(), image.height());
    let (x, y) = (f64::from(u) * f64::from(w) - 0.5, f64::from(v) * f64::from(h) - 0.5);
    let texel = |x: f64, y: f64| {
        let at = |c: f64, side: u32| c.clamp(0.0, f64::from(side - 1)) as u32;
        image.get_pixel(at(x, w), at(y, h)).0.map(f64::from)
    };
    let (x0, y0) = (x.floor(), y.floor());
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    std::array::from_fn(|k| {
        let row = |y: f64| mix(texel(x0, y)[k], texel(x0 + 1.0, y)[k], x - x0);
        mix(row(y0), row(y0 + 1.0), y - y0)
    })
}

#[track_caller]
fn assert_near(found: [f64; 3], at: [f64; 2], tolerance: f64) {
    let wanted = expected(at);
    let near = found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= tolerance);
    assert!(near, "{found:?} instead of {wanted:?} at {at:?}");
}

#[test]
fn an_exported_glb_shows_the_source_s_colours_to_an_independent_reader() {
    let place = place();
    let json = place.run(&["inspect", "sheet.pb", "--json"]).succeeds().json();
    for level in 0..3 {
        let said = place.run(&["export", "sheet.pb", "l.glb", "--level", &level.to_string()]).succeeds().stdout;
        let file = gltf::Gltf::open(place.path("l.glb")).unwrap();
        let blob = file.blob.as_deref().unwrap();
        let node = file.nodes().next().unwrap();
        let ([tx, ty, _], ..) = node.transform().decomposed();
        let (mut triangles, mut colors) = (0, std::collections::BTreeSet::new());
        for primitive in node.mesh().unwrap().primitives() {
            let texture = primitive.material().pbr_metallic_roughness().base_color_texture().unwrap();
            let gltf::image::Source::View { view, mime_type } = texture.texture().source().source() else {
                panic!("the image is not inside")
            };
            assert_eq!(mime_type, "image/png");
            let png = &blob[view.offset()..view.offset() + view.length()];
            let image = image::load_from_memory(png).unwrap().into_rgb8();
            let reader = primitive.reader(|_| Some(blob));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            let uvs: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
            let corners: Vec<usize> = reader.read_indices().unwrap().into_u32().map(|i| i as usize).collect();
            triangles += corners.len() / 3;
            for i in corners {
                let at = [positions[i][0] + tx, positions[i][1] + ty].map(f64::from);
                let color = bilinear(&image, uvs[i]);
                // A coarser mip is flatter where the image ends, and a collapse may slide texture.
                assert_near(color, at, TOLERANCE * (1 << level) as f64);
                colors.insert(color.map(|c| c as u8));
            }
        }
        assert_eq!(triangles, json["levels"][level]["triangles"].as_u64().unwrap() as usize);
        assert!(colors.len() > 20, "all of one colour");
        assert!(said.contains(" images\n"), "{said}");
    }
}

#[test]
fn an_exported_obj_names_images_that_are_beside_it() {
    let place = place();
    place.run(&["export", "sheet.pb", "l.obj"]).succeeds();
    let clusters = place.run(&["inspect", "sheet.pb", "--json"]).succeeds().json()["clusters"].as_u64().unwrap();
    let import = load(&[place.path("l.obj")], &ImportOptions::default(), &|_| {}).unwrap();
    assert_eq!((import.images.len() as u64, import.soup.triangles.len()), (clusters, 2 * QUADS * QUADS));
    let again = place.run(&["l.obj", "again.pb", "--strict", "--json", "--quiet"]).succeeds().json();
    assert_eq!((&again["triangles_in"], &again["textures"]["placeholders"]), (&3200.into(), &0.into()));
    // The same colours at the same places, twice through an archive.
    assert_eq!(vertex_colors_are_near(&place, "again.pb", 2.0 * TOLERANCE), 1681);
}

#[test]
fn an_exported_ply_has_the_texture_s_colours_at_its_vertices() {
    let place = place();
    assert_eq!(vertex_colors_are_near(&place, "sheet.pb", TOLERANCE), 1681);
}

/// Exports level 0 as PLY and compares all its colours; how many there are.
#[track_caller]
fn vertex_colors_are_near(place: &Place, archive: &str, tolerance: f64) -> usize {
    place.run(&["export", archive, "l.ply"]).succeeds();
    let soup = load(&[place.path("l.ply")], &ImportOptions::default(), &|_| {}).unwrap().soup;
    for (position, color) in soup.positions.iter().zip(&soup.colors) {
        assert_near([0, 1, 2].map(|k| f64::from(color[k])), [position[0], position[1]], tolerance);
    }
    soup.colors.len()
}

#[test]
fn inspect_and_verify_tell_of_the_textures() {
    let place = place();
    let text = place.run(&["inspect", "sheet.pb"]).succeeds().stdout;
    assert!(text.contains("maps: base colour (BC7 sRGB)") && text.contains("texture bytes"), "{text}");
    let json = place.run(&["inspect", "sheet.pb", "--json"]).succeeds().json();
    let textures = &json["textures"];
    let tiles: u64 = textures["tile_sizes"].as_array().unwrap().iter().map(|t| t["tiles"].as_u64().unwrap()).sum();
    assert_eq!((Some(tiles), &textures["maps"][0]["kind"]), (json["clusters"].as_u64(), &"base colour".into()));
    let sum = |key: &str| json["levels"].as_array().unwrap().iter().map(|l| l[key].as_u64().unwrap()).sum::<u64>();
    assert_eq!(sum("texture_bytes"), textures["bytes"].as_u64().unwrap());
    assert_eq!(sum("bytes"), sum("geometry_bytes") + sum("texture_bytes"));
    let said = place.run(&["verify", "sheet.pb"]).succeeds().stdout;
    assert!(said.contains(&format!("chunks of {tiles} tiles")), "{said}");
    let place = Place::baked();
    assert_eq!(place.run(&["inspect", "wave.pb", "--json"]).succeeds().json()["textures"], serde_json::Value::Null);
    assert!(!place.run(&["verify", "wave.pb"]).succeeds().stdout.contains("textures"));
}

#[test]
fn stages_of_a_bake_have_rates() {
    let place = place();
    let json = place.run(&["sheet.obj", "s.pb", "--json", "--quiet"]).succeeds().json();
    for stage in json["stages"].as_array().unwrap() {
        assert!(stage["triangle_rate"].as_f64().unwrap() > 0.0, "{stage}");
        let textured = ["textures", "charts", "texels"].contains(&stage["name"].as_str().unwrap());
        assert_eq!(stage["texel_rate"].as_f64().is_some_and(|r| r > 0.0), textured, "{stage}");
    }
}
