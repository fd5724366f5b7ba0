//! Models with images: what the summary says, and what missing and broken images do.

use crate::harness::Place;

const OBJ: &str = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n\
                   usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 2/2 4/4 3/3\n";

/// Two triangles, one with a sound image, one with one that is cut short.
fn place() -> Place {
    let place = Place::new();
    let mut png = Vec::new();
    let picture = image::RgbImage::from_fn(8, 4, |x, y| image::Rgb([x as u8, y as u8, 0]));
    picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    place.write("m.obj", OBJ.as_bytes());
    place.write("m.mtl", b"newmtl a\nmap_Kd good.png\nnewmtl b\nmap_Kd bad.png\n");
    place.write("good.png", &png);
    place.write("bad.png", &png[..40]);
    place
}

#[test]
fn the_summary_counts_images_texels_and_placeholders() {
    let place = place();
    let run = place.run(&["m.obj", "m.pb"]).succeeds();
    assert!(run.stdout.contains("textures: 2 images, 4128 texels, 1 placeholders"), "{}", run.stdout);
    assert!(run.stderr.contains("bad.png: ") && run.stderr.contains("checker"), "{}", run.stderr);
    let json = place.run(&["m.obj", "m.pb", "--json", "--quiet"]).succeeds();
    assert_eq!(json.stderr, "");
    assert_eq!(json.json()["textures"]["placeholders"], 1);
    let names: Vec<String> = json.json()["stages"].as_array().unwrap().iter().map(|s| s["name"].to_string()).collect();
    assert_eq!(names[1], "\"textures\"");
    place.run(&["verify", "m.pb"]).succeeds();
}

#[test]
fn strict_refuses_what_else_becomes_a_placeholder_and_writes_nothing() {
    let place = place();
    place.run(&["m.obj", "m.pb", "--strict"]).fails(1, "--strict: 1 of 2 images");
    assert!(!place.path("m.pb").exists());
    place.write("m.mtl", b"newmtl a\nmap_Kd good.png\nnewmtl b\nmap_Kd GOOD.PNG\n");
    place.run(&["m.obj", "m.pb", "--strict"]).succeeds();
    place.write("m.mtl", b"newmtl a\nmap_Kd good.png\nnewmtl b\nmap_Kd gone.png\n");
    place.run(&["m.obj", "m.pb", "--strict"]).fails(1, "gone.png");
}

#[test]
fn an_image_may_come_from_the_command_line() {
    let place = place();
    place.write("bare.obj", OBJ.replace("mtllib m.mtl\n", "").as_bytes());
    let run = place.run(&["bare.obj", "b.pb", "--texture", "good.png"]).succeeds();
    assert!(run.stdout.contains("textures: 1 images, 32 texels, 0 placeholders"), "{}", run.stdout);
    let run = place.run(&["bare.obj", "b.pb"]).succeeds();
    assert!(!run.stdout.contains("textures:"), "{}", run.stdout);
    place.run(&["bare.obj", "b.pb", "--texture", "gone.png"]).fails(2, "--texture gone.png");
}

#[test]
fn large_images_need_room_and_say_so() {
    let place = place();
    let mut png = Vec::new();
    let picture = image::RgbImage::new(1500, 1000);
    picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    place.write("bad.png", &png);
    let before = place.files();
    place.run(&["m.obj", "m.pb", "--temp-dir", "nowhere"]).fails(2, "--temp-dir");
    assert_eq!(place.files(), before);
    place.run(&["m.obj", "m.pb"]).succeeds();
    assert_eq!(place.files().len(), before.len() + 1, "temporary files have no names");
}

#[test]
fn texture_chunks_need_room_and_say_so() {
    let place = place();
    let before = place.files();
    place.run(&["m.obj", "m.pb", "--temp-dir", "nowhere"]).fails(2, "nowhere: cannot hold temporary files");
    assert_eq!(place.files(), before);
}

#[test]
fn models_without_images_get_tiles_where_a_normal_map_is_wanted() {
    let place = place();
    place.write("bare.obj", OBJ.replace("mtllib m.mtl\n", "").as_bytes());
    let run = place.run(&["bare.obj", "b.pb", "--normal-map"]).succeeds();
    assert!(run.stdout.contains("charts: 1, new in 1 clusters\n") && run.stdout.contains("tiles: "), "{}", run.stdout);
    place.run(&["verify", "b.pb"]).succeeds();
    place.run(&["m.obj", "m.pb", "--normal-map", "--charts", "source"]).succeeds();
    place.run(&["verify", "m.pb"]).succeeds();
}
