//! The finest mip: what is sampled, and how.

use super::*;
use crate::material::Wrap;
use half::f16;

const WHITE: [u8; 4] = [255; 4];

/// Colours of a row of a tile that shows the image as it stands.
fn shown(scene: &Scene, row: u32) -> Vec<[u8; 4]> {
    let mips = scene.bake(MapKind::BaseColor);
    rgba(&mips.levels[0])[(row * mips.size) as usize..][..mips.size as usize].to_vec()
}

#[test]
fn texels_of_the_same_size_are_copies_whichever_way_the_chart_is_turned() {
    let source = noise(64, 32);
    let uv = |x: f32, y: f32| [x / 64.0, y / 32.0];
    // the part from (10, 5) to (34, 21) of the image, 24 x 16 texels, laid at (8, 4) of the tile
    let part = [uv(10.0, 5.0), uv(34.0, 5.0), uv(34.0, 21.0), uv(10.0, 21.0)];
    for turn in 0..4 {
        let mut scene = Scene::with_image(64, Slot::BaseColor, source.clone());
        let (w, h) = if turn % 2 == 0 { (24.0, 16.0) } else { (16.0, 24.0) };
        let tile = [[8.0, 4.0], [8.0 + w, 4.0], [8.0 + w, 4.0 + h], [8.0, 4.0 + h]];
        scene.quad(tile, std::array::from_fn(|k| part[(k + turn) % 4]), WHITE);
        let mips = scene.bake(MapKind::BaseColor);
        let texels = rgba(&mips.levels[0]);
        for y in 0..h as u32 {
            for x in 0..w as u32 {
                let (sx, sy) = match turn {
                    0 => (x, y),
                    1 => (23 - y, x),
                    2 => (23 - x, 15 - y),
                    _ => (y, 15 - x),
                };
                let [r, g, b] = pixel(&source, 10 + sx, 5 + sy);
                assert_eq!(texels[((4 + y) * 64 + 8 + x) as usize], [r, g, b, 255], "turn {turn}: {x} {y}");
            }
        }
    }
}

#[test]
fn corners_rounded_to_the_integers_of_a_tile_still_copy() {
    let source = noise(100, 100);
    let mut scene = Scene::with_image(512, Slot::BaseColor, source.clone());
    // a skew triangle: its corners lie off the integers by up to half a unit
    let corners = [[10.377, 20.111], [88.831, 41.523], [30.719, 90.007]];
    let uvs = corners.map(|[x, y]| [(x as f32 - 5.0) / 100.0, (y as f32 - 7.0) / 100.0]);
    scene.corners.push(corners.map(|c| c.map(|x| (x * 128.0_f64).round() as u16)));
    scene.uvs.push(uvs);
    scene.colors.push([WHITE; 3]);
    scene.chart_of.push(0);
    let coverage = Coverage::new(&scene.layout());
    let mips = scene.bake(MapKind::BaseColor);
    let mut seen = 0;
    for (i, texel) in rgba(&mips.levels[0]).iter().enumerate().filter(|(i, _)| coverage.triangles[*i] == 0) {
        let [r, g, b] = pixel(&source, i as u32 % 512 - 5, i as u32 / 512 - 7);
        assert_eq!(*texel, [r, g, b, 255]);
        seen += 1;
    }
    assert!(seen > 1500);
}

#[test]
fn black_and_white_average_in_linear_light() {
    let stripes = image(64, 64, TexelFormat::L8, (0..64 * 64).map(|i| if i % 2 == 0 { 0 } else { 255 }).collect());
    let mut scene = Scene::with_image(16, Slot::BaseColor, stripes);
    scene.rectangle([0.0, 0.0, 15.0, 15.0], [0.0, 0.0, 0.9375, 0.9375], WHITE);
    let mips = scene.bake(MapKind::BaseColor);
    // half the light is 188 of 255 in sRGB; only one value, so the map is constant
    assert_eq!((mips.size, rgba(&mips.levels[0])[0]), (4, [188, 188, 188, 255]));
}

#[test]
fn enlarged_images_are_interpolated_unless_told_otherwise() {
    let two = image(2, 1, TexelFormat::Rgb8, vec![0, 0, 0, 255, 255, 255]);
    let mut scene = Scene::with_image(16, Slot::BaseColor, two);
    scene.materials[0].textures[0].as_mut().unwrap().wrap = [Wrap::Clamp; 2];
    scene.rectangle([0.0, 0.0, 15.999, 15.999], [0.0, 0.0, 1.0, 1.0], WHITE);
    let smooth = shown(&scene, 8);
    assert!(smooth.windows(2).all(|w| w[0][0] <= w[1][0]) && smooth[7][0] > 0 && smooth[8][0] < 255);
    scene.materials[0].textures[0].as_mut().unwrap().nearest = true;
    let hard = shown(&scene, 8);
    assert_eq!([hard[7][0], hard[8][0]], [0, 255]);
}

#[test]
fn images_wrap_as_their_material_says() {
    let red_to_blue: Vec<u8> = (0..8u8).flat_map(|x| [200 - 20 * x, 0, 20 * x]).collect();
    let ramp = image(8, 1, TexelFormat::Rgb8, red_to_blue);
    // two and a half images side by side, beginning half an image to the left
    for (wrap, expected) in [
        (Wrap::Repeat, [4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2]),
        (Wrap::Mirror, [3, 2, 1, 0, 0, 1, 2, 3, 4, 5, 6, 7, 7, 6, 5]),
        (Wrap::Clamp, [0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 7, 7, 7]),
    ] {
        let mut scene = Scene::with_image(16, Slot::BaseColor, ramp.clone());
        scene.materials[0].textures[0].as_mut().unwrap().wrap = [wrap; 2];
        scene.rectangle([0.0, 0.0, 15.0, 15.0], [-0.5, 0.0, 1.375, 0.0], WHITE);
        let row = shown(&scene, 4);
        let found: Vec<u8> = row[..15].iter().map(|t| t[2] / 20).collect();
        assert_eq!(found, expected, "{wrap:?}");
    }
}

#[test]
fn texture_transforms_and_second_uv_sets_move_the_image() {
    let source = noise(16, 16);
    let mut scene = Scene::with_image(16, Slot::BaseColor, source.clone());
    scene.materials[0].textures[0].as_mut().unwrap().transform = [[0.0, 1.0, 0.25], [1.0, 0.0, 0.0]];
    scene.rectangle([0.0, 0.0, 8.0, 8.0], [0.0, 0.0, 0.5, 0.5], WHITE);
    let mips = scene.bake(MapKind::BaseColor);
    let [r, g, b] = pixel(&source, 4 + 5, 2);
    assert_eq!(rgba(&mips.levels[0])[5 * 16 + 2], [r, g, b, 255], "u and v exchanged, a quarter to the right");

    scene.materials[0].textures[0] = Some(TextureRef { uv_set: 1, ..TextureRef::plain(0) });
    let moved: Vec<[[f32; 2]; 3]> = scene.uvs.iter().map(|t| t.map(|[u, v]| [u + 0.5, v])).collect();
    let sets = [scene.uvs.clone(), moved];
    let source_of = TileSource {
        materials: &scene.materials,
        images: &scene.images,
        material_of: &[0, 0],
        uv_sets: &sets,
        colors: &[],
        normals: &[],
        positions: &[],
    };
    let coverage = Coverage::new(&scene.layout());
    let mips = bake_tile(&source_of, &scene.layout(), &coverage, MapKind::BaseColor, BakeOptions::default());
    let [r, g, b] = pixel(&source, 8 + 2, 5);
    assert_eq!(rgba(&mips.levels[0])[5 * 16 + 2], [r, g, b, 255]);
}

#[test]
fn colours_of_vertices_are_multiplied_in_linear_light() {
    let grey = image(1, 1, TexelFormat::L8, vec![188]);
    let mut scene = Scene::with_image(8, Slot::BaseColor, grey);
    scene.rectangle([0.0, 0.0, 7.0, 7.0], [0.0; 4], [188, 255, 0, 255]);
    let mips = scene.bake(MapKind::BaseColor);
    // 188 is half the light, twice is a quarter: 138
    assert_eq!((mips.size, rgba(&mips.levels[0])[0]), (4, [138, 188, 0, 255]));
}

#[test]
fn cut_outs_keep_the_very_texels_that_the_threshold_keeps() {
    let source = image(256, 1, TexelFormat::La8, (0..=255u8).flat_map(|x| [200, x.wrapping_add(1)]).collect());
    for cutoff in [0.25, 0.5, 0.8, 1.0 / 255.0, 1.0] {
        let mut scene = Scene::with_image(256, Slot::BaseColor, source.clone());
        scene.materials[0].alpha_cutoff = Some(cutoff);
        scene.rectangle([0.0, 0.0, 255.0, 8.0], [0.0, 0.0, 255.0 / 256.0, 8.0], WHITE);
        let row = shown(&scene, 3);
        for (x, texel) in row.iter().enumerate().take(255) {
            let a = x + 1;
            assert!(a < 255 || cutoff == 1.0 || texel[3] == 255, "opaque texels stay opaque");
            assert_eq!(texel[3] >= 128, a as f32 / 255.0 >= cutoff, "alpha {a} at threshold {cutoff}");
        }
    }
}

#[test]
fn opaque_materials_ignore_alpha() {
    let source = image(1, 1, TexelFormat::Rgba8, vec![10, 20, 30, 0]);
    let mut scene = Scene::with_image(8, Slot::BaseColor, source);
    scene.rectangle([0.0, 0.0, 7.0, 7.0], [0.0; 4], [255, 255, 255, 9]);
    assert_eq!(rgba(&scene.bake(MapKind::BaseColor).levels[0])[0], [10, 20, 30, 255]);
}

#[test]
fn occlusion_roughness_and_metalness_come_from_their_channels_and_factors() {
    let occlusion = image(1, 1, TexelFormat::Rgb8, vec![128, 0, 0]);
    let rough_metal = image(1, 1, TexelFormat::Rgb8, vec![9, 128, 255]);
    let mut scene = Scene::with_image(8, Slot::Occlusion, occlusion);
    scene.images.push(Some(rough_metal));
    let material = &mut scene.materials[0];
    material.textures[Slot::MetallicRoughness as usize] = Some(TextureRef::plain(1));
    (material.occlusion_strength, material.roughness, material.metallic) = (0.5, 0.5, 0.25);
    scene.rectangle([0.0, 0.0, 7.0, 7.0], [0.0; 4], WHITE);
    assert_eq!(rgba(&scene.bake(MapKind::Orm).levels[0])[0], [192, 64, 64, 255]);
    assert!(MapKind::Orm.is_used_by(&scene.materials) && !MapKind::Orm.is_used_by(&[Material::default()]));
}

#[test]
fn light_above_one_stays_above_one_through_compression() {
    let halves = |v: [f32; 3]| v.map(|x| f16::from_f32(x).to_le_bytes());
    let bytes = (0..64).flat_map(|i| halves([20.0, 0.01 * i as f32, 3.0]).concat()).collect();
    let source = image(8, 8, TexelFormat::RgbF16, bytes);
    let mut scene = Scene::with_image(8, Slot::Emissive, source);
    scene.materials[0].emissive = [1.0, 1.0, 2.0];
    scene.rectangle([0.0, 0.0, 7.999, 7.999], [0.0, 0.0, 1.0, 1.0], WHITE);
    assert!(MapKind::Emissive.is_hdr(&scene.materials, &scene.images));
    let mips = scene.bake_with(MapKind::Emissive, BakeOptions { hdr: true, ..BakeOptions::default() });
    for (mip, texels) in mips.levels.iter().enumerate() {
        for quality in [Quality::Fast, Quality::Normal, Quality::Best] {
            let bytes = encode(texels, mips.side(mip), BlockFormat::Bc6h, quality);
            let Texels::RgbaF16(back) = decode(BlockFormat::Bc6h, &bytes, mips.side(mip)).unwrap() else { panic!() };
            for texel in back {
                let [r, _, b, _] = texel.map(|h| f16::from_bits(h).to_f32());
                assert!((r / 20.0 - 1.0).abs() < 0.03 && (b / 6.0 - 1.0).abs() < 0.03, "{r} {b}");
            }
        }
    }
}

#[test]
fn maps_of_one_value_have_one_mip_of_four_texels() {
    let mut scene = Scene::new(64);
    scene.materials.push(Material { roughness: 0.5, ..Material::default() });
    scene.rectangle([3.0, 3.0, 20.0, 50.0], [0.0; 4], WHITE);
    let mips = scene.bake(MapKind::Orm);
    assert_eq!((mips.size, mips.levels.len()), (4, 1));
    assert!(rgba(&mips.levels[0]).iter().all(|t| *t == [255, 128, 0, 255]));
    assert_eq!(Scene::new(64).bake(MapKind::BaseColor).size, 4, "tiles without charts");
}

#[test]
fn nonsense_in_the_source_makes_no_panic() {
    let mut scene = Scene::with_image(32, Slot::BaseColor, noise(4, 4));
    let bad = f32::NAN;
    scene.quad(
        [[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 9.0]],
        [[bad, 0.0], [1e38, -1e38], [0.0, bad], [1.0; 2]],
        WHITE,
    );
    scene.quad([[12.0, 1.0], [20.0, 1.0], [28.0, 1.0], [12.0, 1.0]], [[1e30; 2], [3.0; 2], [0.0; 2], [1.0; 2]], WHITE);
    scene.materials[0].textures[Slot::Normal as usize] = Some(TextureRef { uv_set: 7, ..TextureRef::plain(9) });
    scene.positions = vec![[[bad; 3]; 3]; 4];
    scene.normals = vec![[[0.0; 3]; 3]; 4];
    for map in [MapKind::BaseColor, MapKind::Orm, MapKind::Normal, MapKind::Emissive] {
        scene.bake(map);
    }
}

#[test]
fn border_texels_show_what_lies_beyond_open_edges_and_repeat_the_chart_at_others() {
    let source = noise(32, 32);
    let mut scene = Scene::with_image(32, Slot::BaseColor, source.clone());
    scene.rectangle([8.0, 8.0, 16.0, 16.0], [0.25, 0.25, 0.5, 0.5], WHITE);
    let at = |scene: &Scene, x: u32, y: u32| rgba(&scene.bake(MapKind::BaseColor).levels[0])[(y * 32 + x) as usize];
    let [r, g, b] = pixel(&source, 15, 10);
    assert_eq!(at(&scene, 16, 10), [r, g, b, 255]);
    scene.open_edges = vec![0b010, 0];
    let [r, g, b] = pixel(&source, 16, 10);
    assert_eq!(at(&scene, 16, 10), [r, g, b, 255]);
}

#[test]
fn nothing_from_beyond_a_chart_of_the_source_comes_in_at_any_density_or_turn() {
    // a green diamond on red: source texels with centres in the diamond are green
    let green = |x: f64, y: f64| (x - 64.0).abs() + (y - 64.0).abs() <= 40.0;
    let texel =
        |i: u32| if green(f64::from(i % 128) + 0.5, f64::from(i / 128) + 0.5) { [0, 255, 0] } else { [255, 0, 0] };
    let source = image(128, 128, TexelFormat::Rgb8, (0..128 * 128).flat_map(texel).collect());
    for (scale, turn) in [(0.3, 0.0), (0.5, 0.0), (0.77, 0.4), (1.0, 0.0), (1.0, 0.9), (1.4, 0.2), (2.0, 0.1)] {
        let mut scene = Scene::with_image(256, Slot::BaseColor, source.clone());
        let (sin, cos) = f64::sin_cos(turn);
        let corners = [[0.0, -40.0], [40.0, 0.0], [0.0, 40.0], [-40.0, 0.0f64]];
        let tile = corners.map(|[x, y]| [128.0 + scale * (x * cos - y * sin), 128.0 + scale * (x * sin + y * cos)]);
        scene.quad(tile, corners.map(|c| c.map(|x| ((64.0 + x) / 128.0) as f32)), WHITE);
        let mips = scene.bake(MapKind::BaseColor);
        for texels in &mips.levels {
            assert!(rgba(texels).iter().all(|t| *t == [0, 255, 0, 255]), "scale {scale}, turn {turn}");
        }
    }
}
