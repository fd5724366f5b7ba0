use glam::DVec3;

use super::camera::Camera;
use super::image::Image;
use super::scene::{Blend, Material, Scene, Triangle, Wrap};
use super::*;

/// A unit square at z = 0 with an image on it, upper left corner at (0, 1).
fn square(image: Image) -> Scene {
    let uv = |p: [f32; 2]| [p[0], 1.0 - p[1]];
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0f32]];
    let triangle = |t: [u32; 3]| Triangle { corners: t, uv: t.map(|i| uv(corners[i as usize])), material: 0 };
    Scene {
        positions: corners.iter().map(|p| DVec3::new(p[0].into(), p[1].into(), 0.0)).collect(),
        triangles: vec![triangle([0, 1, 2]), triangle([0, 2, 3])],
        colors: vec![],
        materials: vec![Material { wrap: [Wrap::Clamp; 2], ..Material::plain(Some(0), [1.0; 4]) }],
        images: vec![image],
    }
}

/// The camera that sees the square `share` of the picture high, in the middle.
fn before(share: f64, size: [usize; 2]) -> Camera {
    let center = DVec3::new(0.5, 0.5, 0.0);
    Camera::new(center + DVec3::Z * 0.5 / share, center, DVec3::Y, 90.0, size)
}

fn noise(width: usize) -> Image {
    let mut random = crate::random::Random::new(5);
    let texel = |_| {
        let b = random.bits().to_le_bytes();
        [b[0], b[1], b[2], 255]
    };
    Image::from_bytes(width, (0..width * width).map(texel).collect())
}

fn options(size: usize, filter: Filter) -> Options {
    Options { size: [size, size], filter, grid: None }
}

#[test]
fn an_image_seen_pixel_by_texel_is_the_image() {
    let mut scene = square(noise(8));
    let texels: Vec<[u8; 3]> = (0..64)
        .map(|i| {
            let at = [(i % 8) as f64 / 8.0 + 0.0625, (i / 8) as f64 / 8.0 + 0.0625];
            let [r, g, b, _] = scene.images[0].nearest(at, [Wrap::Clamp; 2]);
            [r, g, b].map(image::srgb_byte)
        })
        .collect();
    scene.images[0].make_mips();
    let drawn = draw(&scene, &before(1.0, [8, 8]), &options(8, Filter::Trilinear));
    assert_eq!(drawn.pixels, texels);
    assert!(drawn.coverage.iter().all(|&c| c == 255));
}

#[test]
fn a_texture_that_is_far_away_is_shown_as_its_mean() {
    for filter in [Filter::Exact, Filter::Trilinear] {
        let grey = |i: usize| if (i % 64 + i / 64).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 255] };
        let mut scene = square(Image::from_bytes(64, (0..4096).map(grey).collect()));
        scene.images[0].make_mips();
        let drawn = draw(&scene, &before(1.0, [8, 8]), &options(8, filter));
        assert!(drawn.pixels.iter().flatten().all(|c| c.abs_diff(188) <= 1), "{filter:?}: {:?}", drawn.pixels);
    }
}

#[test]
fn edges_are_quarters_of_a_pixel() {
    let scene = square(Image::from_bytes(1, vec![[255; 4]]));
    let drawn = draw(&scene, &before(0.4, [15, 15]), &options(15, Filter::Exact));
    let mut found = drawn.coverage.clone();
    found.sort_unstable();
    found.dedup();
    assert_eq!(found, [0, 64, 128, 255], "corners see one sample, sides two");
    assert_eq!(drawn.pixels[0], [38, 42, 48]);
    assert_eq!(drawn.pixels[7 * 15 + 7], [255; 3]);
}

#[test]
fn surfaces_have_two_sides_and_hide_what_lies_behind() {
    let mut scene = square(Image::from_bytes(1, vec![[255, 0, 0, 255]]));
    let behind: Vec<DVec3> = scene.positions.iter().map(|p| *p - DVec3::Z * 0.1).collect();
    scene.positions.extend(behind);
    let more: Vec<Triangle> =
        scene.triangles.iter().map(|t| Triangle { corners: t.corners.map(|i| i + 4), material: 1, ..*t }).collect();
    scene.triangles.splice(0..0, more);
    scene.materials.push(Material::plain(None, [0.0, 0.0, 1.0, 1.0]));
    let front = draw(&scene, &before(1.2, [4, 4]), &options(4, Filter::Exact));
    assert!(front.pixels.iter().all(|p| *p == [255, 0, 0]), "{:?}", front.pixels);
    let center = DVec3::new(0.5, 0.5, 0.0);
    let back = Camera::new(center - DVec3::Z * 0.4, center, DVec3::Y, 60.0, [4, 4]);
    let back = draw(&scene, &back, &options(4, Filter::Exact));
    assert!(back.pixels.iter().all(|p| *p == [0, 0, 255]), "{:?}", back.pixels);
}

#[test]
fn what_is_cut_out_shows_what_lies_behind() {
    let mut scene = square(Image::from_bytes(2, vec![[255, 0, 0, 255], [0; 4], [0; 4], [255, 0, 0, 255]]));
    scene.materials[0].cutoff = Some(0.5);
    scene.materials[0].nearest = true;
    let drawn = draw(&scene, &before(1.0, [8, 8]), &options(8, Filter::Exact));
    let at = |x: usize, y: usize| (drawn.pixels[y * 8 + x], drawn.coverage[y * 8 + x]);
    assert_eq!(at(1, 1), ([255, 0, 0], 255));
    assert_eq!(at(6, 1), ([38, 42, 48], 0));
}

#[test]
fn a_plane_that_begins_behind_the_eye_fills_the_picture_below_the_horizon() {
    let corners = [[-1e3, -1.0, 1e3], [1e3, -1.0, 1e3], [0.0, -1.0, -1e6]];
    let scene = Scene {
        positions: corners.iter().map(|p| DVec3::from_array(*p)).collect(),
        triangles: vec![Triangle { corners: [0, 1, 2], uv: [[0.0; 2]; 3], material: 0 }],
        materials: vec![Material::plain(None, [1.0; 4])],
        ..Scene::default()
    };
    let camera = Camera::new(DVec3::ZERO, -DVec3::Z, DVec3::Y, 60.0, [32, 32]);
    let drawn = draw(&scene, &camera, &options(32, Filter::Exact));
    let covered = |y: usize| (0..32).filter(|x| drawn.coverage[y * 32 + x] == 255).count();
    assert_eq!((covered(14), covered(18)), (0, 32));
}

#[test]
fn an_obj_with_its_image_is_read_the_right_way_up() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut picture = ::image::RgbImage::new(2, 2);
    picture.put_pixel(0, 0, ::image::Rgb([255, 0, 0]));
    picture.put_pixel(1, 1, ::image::Rgb([0, 255, 0]));
    picture.save(at("an image.png")).unwrap();
    std::fs::write(at("m.mtl"), "newmtl a\nKd 0.5 0.5 0.5\nmap_Kd an image.png\n").unwrap();
    let text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\n\
                f 1/1 2/2 3/3 4/4\n";
    std::fs::write(at("m.obj"), text).unwrap();
    let scene = Scene::read(&at("m.obj")).unwrap();
    let drawn = draw(&scene, &before(1.0, [4, 4]), &options(4, Filter::Exact));
    let (first, last) = (drawn.pixels[0], drawn.pixels[15]);
    assert!(first[0] > 180 && first[1] < 90 && last[1] > 180 && last[0] < 90, "{first:?} {last:?}");
}

#[test]
fn what_is_blended_is_mixed_far_to_near_and_seen_from_its_front_alone() {
    let mut scene = square(Image::from_bytes(1, vec![[255, 255, 255, 255]]));
    let (red, blue) = ([1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.25]);
    for (z, factor) in [(0.2, red), (0.1, blue)] {
        let first = scene.positions.len() as u32;
        let more: Vec<DVec3> = scene.positions[..4].iter().map(|p| *p + DVec3::Z * z).collect();
        scene.positions.extend(more);
        let material = scene.materials.len() as u32;
        for t in 0..2 {
            let t = scene.triangles[t];
            scene.triangles.push(Triangle { corners: t.corners.map(|i| first + i), material, ..t });
        }
        scene.materials.push(Material { blend: Some(Blend::Front), ..Material::plain(None, factor) });
    }
    let mixed = [0.5 + 0.5 * 0.75, 0.5 * 0.75, 0.5].map(image::srgb_byte);
    for filter in [Filter::Exact, Filter::Trilinear] {
        scene.images[0].make_mips();
        let front = draw(&scene, &before(1.2, [4, 4]), &options(4, filter));
        assert!(front.pixels.iter().all(|p| *p == mixed), "{filter:?}: {:?}", front.pixels);
    }
    // Without the white square: from the front over the background, from behind nothing at all.
    scene.triangles.drain(..2);
    let front = draw(&scene, &before(1.2, [4, 4]), &options(4, Filter::Exact));
    assert!(front.coverage.iter().all(|c| *c == 255) && front.pixels[0][0] > 180, "{:?}", front.pixels);
    let center = DVec3::new(0.5, 0.5, 0.0);
    let back = Camera::new(center - DVec3::Z, center, DVec3::Y, 60.0, [4, 4]);
    let seen_from_behind = |scene: &Scene| draw(scene, &back, &options(4, Filter::Exact)).coverage[5];
    assert_eq!(seen_from_behind(&scene), 0);
    scene.materials[1].blend = Some(Blend::Both);
    assert_eq!(seen_from_behind(&scene), 255);
}

#[test]
fn an_image_that_is_not_there_is_a_magenta_checker() {
    let image = Image::or_missing(Err(anyhow::anyhow!("missing")));
    let at = |x: f64, y: f64| image.nearest([x / 64.0, y / 64.0], [Wrap::Repeat; 2]);
    assert_eq!((image.width, image.height), (64, 64));
    let (magenta, black) = ([1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]);
    assert_eq!([at(0.5, 0.5), at(7.5, 7.5), at(8.5, 8.5)], [magenta; 3]);
    assert_eq!([at(8.5, 0.5), at(0.5, 8.5), at(63.5, 0.5)], [black; 3]);
}
