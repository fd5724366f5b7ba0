//! Normal maps: the tile's frame shows the very normals that the source's frame shows.

use super::*;
use glam::{Vec2, Vec3};

/// The frame as a viewer derives it: dP/du and dP/dv of the tile's coordinates, made orthonormal.
fn viewer_normal(positions: [[f32; 3]; 3], tile: [[u16; 2]; 3], normal: Vec3, texel: [u8; 2]) -> Vec3 {
    let p = positions.map(Vec3::from_array);
    let c = tile.map(|c| Vec2::new(f32::from(c[0]), f32::from(c[1])));
    let (e1, e2, d1, d2) = (p[1] - p[0], p[2] - p[0], c[1] - c[0], c[2] - c[0]);
    let det = d1.perp_dot(d2);
    let (du, dv) = ((e1 * d2.y - e2 * d1.y) / det, (e2 * d1.x - e1 * d2.x) / det);
    let t = (du - normal * normal.dot(du)).normalize();
    let side = normal.cross(t);
    let b = if side.dot(dv) > 0.0 { -side } else { side };
    let xy = Vec2::new(f32::from(texel[0]), f32::from(texel[1])) / 127.5 - 1.0;
    t * xy.x + b * xy.y + normal * (1.0 - xy.length_squared()).max(0.0).sqrt()
}

/// A quad in space facing +z, 1 x 1, with the image upright as seen from +z, or mirrored.
fn quad_scene(turn: f64, mirrored: bool, map_texel: [u8; 3]) -> Scene {
    let mut scene = Scene::with_image(64, Slot::Normal, image(1, 1, TexelFormat::Rgb8, map_texel.to_vec()));
    let uvs = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let uvs = if mirrored { uvs.map(|[u, v]| [1.0 - u, v]) } else { uvs };
    let space = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let (sin, cos) = turn.sin_cos();
    let tile = [[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0f64]]
        .map(|[x, y]| [32.0 + 20.0 * (x * cos - y * sin), 32.0 + 20.0 * (x * sin + y * cos)]);
    scene.quad(tile, uvs, [255; 4]);
    scene.positions = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|k: usize| space[k])).to_vec();
    scene.normals = vec![[[0.0, 0.0, 1.0]; 3]; 2];
    scene
}

fn rg(texels: &Texels) -> &[[u8; 2]] {
    match texels {
        Texels::Rg8(t) => t,
        _ => panic!("other texels"),
    }
}

#[test]
fn turned_and_mirrored_charts_show_the_normals_of_the_source() {
    // leaning to the right of the image and up
    let texel = [190, 170, 220];
    let lean = Vec3::new(190.0, 170.0, 220.0) / 127.5 - 1.0;
    for mirrored in [false, true] {
        for turn in [0.0, 0.7, std::f64::consts::FRAC_PI_2, 2.5, 4.0] {
            let scene = quad_scene(turn, mirrored, texel);
            let mips = scene.bake(MapKind::Normal);
            let bytes = encode(&mips.levels[0], mips.size, BlockFormat::Bc5, Quality::Normal);
            let back = decode(BlockFormat::Bc5, &bytes, mips.size).unwrap();
            let world = viewer_normal(scene.positions[0], scene.corners[0], Vec3::Z, rg(&back)[5]);
            // a mirrored image leans to the left
            let expected = Vec3::new(if mirrored { -lean.x } else { lean.x }, lean.y, lean.z).normalize();
            assert!(world.angle_between(expected) < 0.015, "turn {turn}, mirrored {mirrored}: {world} {expected}");
        }
    }
}

#[test]
fn stretched_charts_show_the_normals_of_the_source_too() {
    let mut scene = quad_scene(0.4, false, [190, 170, 220]);
    scene.corners.iter_mut().flatten().for_each(|c| c[0] /= 3);
    let mips = scene.bake(MapKind::Normal);
    let world = viewer_normal(scene.positions[0], scene.corners[0], Vec3::Z, rg(&mips.levels[0])[0]);
    let expected = (Vec3::new(190.0, 170.0, 220.0) / 127.5 - 1.0).normalize();
    assert!(world.angle_between(expected) < 0.012, "{world} {expected}");
}

#[test]
fn unturned_charts_keep_the_very_texels_of_unit_length() {
    let scene = quad_scene(0.0, false, [204, 127, 230]);
    assert_eq!(rg(&scene.bake(MapKind::Normal).levels[0])[0], [204, 127]);
}

#[test]
fn the_scale_of_a_normal_map_bends_or_straightens_it() {
    let mut scene = quad_scene(0.0, false, [190, 128, 220]);
    scene.materials[0].normal_scale = 0.0;
    assert_eq!(rg(&scene.bake(MapKind::Normal).levels[0])[0], [128, 128]);
    scene.materials[0].normal_scale = 2.0;
    assert!(rg(&scene.bake(MapKind::Normal).levels[0])[0][0] > 210);
}

#[test]
fn normals_stay_of_unit_length_at_coarse_mips() {
    let texels = (0..64 * 64).flat_map(|i| if (i / 4 + i / 256) % 2 == 0 { [220, 128, 200] } else { [128, 40, 200] });
    let mut scene = quad_scene(0.0, false, [128, 128, 255]);
    scene.images[0] = Some(image(64, 64, TexelFormat::Rgb8, texels.collect()));
    let mips =
        scene.bake_with(MapKind::Normal, BakeOptions { normal_space: NormalSpace::Object, ..BakeOptions::default() });
    for texel in mips.levels.iter().flat_map(rgba) {
        let length = (Vec3::new(f32::from(texel[0]), f32::from(texel[1]), f32::from(texel[2])) / 127.5 - 1.0).length();
        assert!((length - 1.0).abs() < 0.01, "{texel:?}");
    }
}

#[test]
fn object_space_shows_the_normals_of_the_geometry() {
    let mut scene = quad_scene(0.3, false, [128, 128, 255]);
    scene.materials[0].textures = [None; 5];
    scene.normals = vec![[[0.6, 0.0, 0.8]; 3]; 2];
    let options = BakeOptions { normal_space: NormalSpace::Object, ..BakeOptions::default() };
    assert_eq!(rgba(&scene.bake_with(MapKind::Normal, options).levels[0])[0], [204, 128, 230, 255]);
}
