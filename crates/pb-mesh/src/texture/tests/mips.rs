//! Mip chains: no bleeding, no holes.

use super::*;
use proptest::prelude::*;

const LOUD: [[u8; 4]; 6] =
    [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255], [255, 0, 255, 255], [0, 255, 255, 255]];

/// Whether the centre of a texel is nearer than one texel to a convex quad, maximum norm; corners in units of the tile.
fn touches(quad: &[[f64; 2]; 4], centre: [f64; 2], pitch: f64) -> bool {
    // separating axes of an open square and a convex polygon: the axes and the normals of the edges
    let mut axes = vec![[1.0, 0.0], [0.0, 1.0]];
    axes.extend((0..4).map(|k| [quad[(k + 1) % 4][1] - quad[k][1], quad[k][0] - quad[(k + 1) % 4][0]]));
    axes.iter().all(|[x, y]| {
        let along = |p: &[f64; 2]| p[0] * x + p[1] * y;
        let (low, high) = quad.iter().map(along).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        let reach = pitch * (x.abs() + y.abs());
        low < along(&centre) + reach - 1e-6 && high > along(&centre) - reach + 1e-6
    })
}

/// Checks all mips down to the one that is 32 wide; returns how many texels were looked at.
fn assert_own_colours_only(scene: &Scene, mips: &Mips) -> usize {
    let quads: Vec<[[f64; 2]; 4]> =
        scene.corners.chunks_exact(2).map(|t| [t[0][0], t[0][1], t[0][2], t[1][2]].map(|c| c.map(f64::from))).collect();
    let mut looked_at = 0;
    for (mip, texels) in mips.levels.iter().enumerate().filter(|(m, _)| mips.side(*m) >= 32) {
        let side = mips.side(mip);
        let pitch = 65536.0 / f64::from(side);
        for (i, texel) in rgba(texels).iter().enumerate() {
            let centre = [i as u32 % side, i as u32 / side].map(|k| (f64::from(k) + 0.5) * pitch);
            for (quad, corners) in quads.iter().enumerate().filter(|(_, q)| touches(q, centre, pitch)) {
                assert_eq!(*texel, scene.colors[2 * quad][0], "mip {mip}, texel {i}, chart {quad}: {corners:?}");
                looked_at += 1;
            }
        }
    }
    looked_at
}

/// Quads turned by `turn`, one in each of 4 x 4 cells, two texels apart where the tile is 32 wide; some are slivers.
fn loud_charts(size: u32, turn: f64, shift: f64) -> Scene {
    let mut scene = Scene::new(size);
    let texel = f64::from(size) / 32.0;
    for cell in 0..16 {
        let middle = [cell % 4, cell / 4].map(|k| (f64::from(k) * 8.0 + 4.0) * texel + shift);
        let half = [[3.0, 3.0], [2.1, 0.02], [0.7, 2.5], [0.3, 0.3]][cell as usize % 4].map(|h| h * texel * 0.7);
        let (sin, cos) = (turn * f64::from(cell + 1)).sin_cos();
        let corner = |x: f64, y: f64| {
            [middle[0] + x * half[0] * cos - y * half[1] * sin, middle[1] + x * half[0] * sin + y * half[1] * cos]
        };
        let quad = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        scene.quad(quad, [[0.0; 2]; 4], LOUD[cell as usize * 7 % 6]);
    }
    scene.materials.push(Material::default());
    scene
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn charts_show_only_their_own_colour_at_every_mip(log in 5u32..10, turn in 0.0..1.6, shift in -0.5..0.5) {
        let scene = loud_charts(1 << log, turn, shift);
        let mips = scene.bake(MapKind::BaseColor);
        prop_assert!(assert_own_colours_only(&scene, &mips) > 80);
    }
}

#[test]
fn between_charts_that_are_too_near_the_nearer_owns_a_texel() {
    // at mip 1 the charts end at 10 and begin at 11.5; the texel between has its centre at 10.5
    let (left, right) = ([0.0, 0.0, 20.0, 60.0], [23.0, 0.0, 60.0, 60.0]);
    for (first, second, at_10) in [(left, right, 0), (right, left, 1)] {
        let mut scene = Scene::new(64);
        scene.materials.push(Material::default());
        scene.rectangle(first, [0.0; 4], LOUD[0]);
        scene.rectangle(second, [0.0; 4], LOUD[1]);
        let row = rgba(&scene.bake(MapKind::BaseColor).levels[1])[5 * 32..6 * 32].to_vec();
        assert_eq!([row[10], row[11]], [LOUD[at_10], LOUD[1 - at_10]]);
    }
}

#[test]
fn charts_that_have_no_texel_of_the_finest_mip_still_show_their_colour() {
    let mut scene = Scene::new(128);
    scene.materials.push(Material::default());
    // a sliver between the centres of two rows, and a chart smaller than a texel
    scene.rectangle([10.0, 20.05, 60.0, 20.3], [0.0; 4], LOUD[0]);
    scene.rectangle([80.1, 80.1, 80.3, 80.3], [0.0; 4], LOUD[1]);
    scene.rectangle([10.0, 100.0, 120.0, 110.0], [0.0; 4], LOUD[2]);
    assert!(assert_own_colours_only(&scene, &scene.bake(MapKind::BaseColor)) > 500);
}

#[test]
fn no_texel_of_any_mip_is_left_empty() {
    for size in [4, 8, 64, 256] {
        let mut scene = Scene::new(size);
        scene.materials.push(Material::default());
        scene.rectangle([0.3, 0.2, 0.9, 0.7], [0.0; 4], LOUD[0]);
        scene.rectangle([2.6, 2.1, 3.9, 3.8], [0.0; 4], LOUD[1]);
        let mips = scene.bake(MapKind::BaseColor);
        assert_eq!(mips.levels.len() as u32, size.ilog2() - 1);
        for texels in &mips.levels {
            assert!(rgba(texels).iter().all(|t| *t == LOUD[0] || *t == LOUD[1]));
        }
    }
}

#[test]
fn texels_beyond_a_chart_take_the_colour_of_the_nearest() {
    let mut scene = Scene::new(64);
    scene.materials.push(Material::default());
    scene.rectangle([0.0, 0.0, 10.0, 63.0], [0.0; 4], LOUD[0]);
    scene.rectangle([53.0, 0.0, 63.0, 63.0], [0.0; 4], LOUD[1]);
    let mips = scene.bake(MapKind::BaseColor);
    let row = &rgba(&mips.levels[0])[30 * 64..31 * 64];
    assert!(row[..31].iter().all(|t| *t == LOUD[0]) && row[33..].iter().all(|t| *t == LOUD[1]));
}

#[test]
fn every_mip_is_the_mean_of_the_chart_in_linear_light() {
    let mut scene = Scene::with_image(64, Slot::BaseColor, noise(64, 64));
    scene.rectangle([0.0, 0.0, 63.999, 63.999], [0.0, 0.0, 1.0, 1.0], [255; 4]);
    let mips = scene.bake(MapKind::BaseColor);
    let light = |t: [u8; 4]| f64::from(super::super::color::SRGB[usize::from(t[0])]);
    for mip in 1..mips.levels.len() {
        let (side, under) = (64 >> mip, 1usize << mip);
        for (i, texel) in rgba(&mips.levels[mip]).iter().enumerate() {
            let (x, y) = (i % side * under, i / side * under);
            let texels = (0..under * under).map(|k| rgba(&mips.levels[0])[(y + k / under) * 64 + x + k % under]);
            let mean = texels.map(light).sum::<f64>() / (under * under) as f64;
            assert!((light(*texel) - mean).abs() < 0.005, "mip {mip}, texel {i}");
        }
    }
}

/// A tile of grass: opaque green in front of red without alpha, three texels of ten; shown as large as it is, smaller, or
/// turned.
fn grass(scale: f64, turn: f64) -> Mips {
    let leaves = noise(64, 64);
    let texel = |i: u32| if leaves.bytes()[3 * i as usize] < 77 { [0, 200, 0, 255] } else { [255, 0, 0, 0] };
    let source = image(64, 64, TexelFormat::Rgba8, (0..64 * 64).flat_map(texel).collect());
    let mut scene = Scene::with_image(64, Slot::BaseColor, source);
    scene.materials[0].alpha_cutoff = Some(0.5);
    let (sin, cos) = turn.sin_cos();
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]: [f64; 2]| [63.9 * x, 63.9 * y]);
    let tile = corners.map(|[x, y]| [scale * (x * cos - y * sin) + 32.0 * sin, scale * (x * sin + y * cos)]);
    scene.quad(tile, corners.map(|c| c.map(|x| (x / 64.0) as f32)), [255; 4]);
    scene.bake(MapKind::BaseColor)
}

#[test]
fn holes_bring_no_colour_into_what_is_around_them() {
    for (scale, turn) in [(1.0, 0.0), (0.5, 0.0), (0.6, 0.5)] {
        for (mip, texels) in grass(scale, turn).levels.iter().enumerate() {
            let clean = |t: &[u8; 4]| t[0] <= 1 && t[1] >= 199 && t[2] == 0;
            let dirty = rgba(texels).iter().find(|t| !clean(t));
            assert_eq!(dirty, None, "scale {scale}, turn {turn}, mip {mip}");
        }
    }
}

#[test]
fn cut_outs_keep_their_area_at_coarse_mips() {
    let mips = grass(1.0, 0.0);
    let seen = |texels: &Texels| rgba(texels).iter().filter(|t| t[3] >= 128).count() as f64 / texels.len() as f64;
    for (mip, texels) in mips.levels[..4].iter().enumerate() {
        let (here, finest) = (seen(texels), seen(&mips.levels[0]));
        assert!((here - finest).abs() < 0.1, "mip {mip}: {here} of {finest}");
    }
}
