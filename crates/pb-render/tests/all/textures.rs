//! Textures on the adapter: what a pixel shows of a tile.

use crate::random_model::Random;
use crate::textured_model::{Shot, TexturedModel, in_front, noise};
use glam::DVec3;
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::layout::Vertex;
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MipPlace, TileRecord};
use pb_render::{AdapterLimits, Camera, ColorMode, Gpu, PageLimits, RenderError, Renderer, VramPlan};

const BASE: (MapKind, MapFormat) = (MapKind::BaseColor, MapFormat::Rgba8Linear);

fn tile(size_log2: u8) -> TileRecord {
    TileRecord { size_log2, first: [0; 4], reserved: [0; 3], texel: 1.0 }
}

fn albedo(size: u32, zoom: f64, floors: &[f32]) -> Shot<'_> {
    Shot { cluster: 0, camera: in_front(zoom), floors, color: ColorMode::Albedo, size }
}

/// Largest difference of two pictures' channels.
fn difference(a: &[[u8; 4]], b: &[[u8; 4]]) -> u8 {
    let texels = |p: &[[u8; 4]]| p.iter().flatten().copied().collect::<Vec<u8>>();
    texels(a).iter().zip(texels(b)).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0)
}

/// Every mip in one colour of its own; black those that are too coarse to be drawn.
fn level_colors(gpu: &Gpu) -> (TexturedModel, Renderer) {
    let mut fill = |_: u32, m: &MipPlace| [200 - 40 * m.mip.min(5) as u8, 0, 0, 255].repeat(m.bytes as usize / 4);
    let model = TexturedModel::new(4, &[BASE], &[tile(9)], 4096, &mut fill);
    let mut renderer = model.renderer(gpu, 1 << 24);
    model.upload_all(gpu, &mut renderer);
    (model, renderer)
}

#[test]
fn a_texel_as_large_as_a_pixel_is_shown_exactly() {
    let Some(gpu) = crate::adapter("texels at 1:1") else { return };
    let mut random = Random(1);
    let mut fill = |_: u32, m: &MipPlace| noise(&mut random, m.bytes);
    let model = TexturedModel::new(3, &[BASE], &[tile(6)], 32768, &mut fill);
    let mut renderer = model.renderer(&gpu, 1 << 24);
    model.upload_all(&gpu, &mut renderer);
    let picture = albedo(32, 1.0, &[0.0]).take(&gpu, &model, &renderer);
    for (i, pixel) in picture.iter().enumerate() {
        let texel = &model.bytes[0][(i / 32 * 64 + i % 32) * 4..][..3];
        let far = pixel.iter().zip(texel).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(far <= Some(1), "pixel {i}: {pixel:?}, texel {texel:?}");
    }
}

#[test]
fn mips_are_mixed_by_the_size_of_a_pixel() {
    let Some(gpu) = crate::adapter("trilinear filtering") else { return };
    let (model, renderer) = level_colors(&gpu);
    for lod in [-2.0, 0.0, 0.25, 0.5, 1.0, 1.75, 3.5, 4.0, 4.5f64] {
        // The square fills a picture of 32 pixels at lod 0; its middle does so everywhere.
        let picture = albedo(32, (-lod).exp2(), &[0.0]).take(&gpu, &model, &renderer);
        let expected = 200.0 - 40.0 * lod.clamp(0.0, 4.0);
        let shown = picture[16 * 32 + 16][0] as f64;
        assert!((shown - expected).abs() < 1.5, "lod {lod}: {shown}, expected {expected}");
    }
}

#[test]
fn a_floor_keeps_finer_mips_away() {
    let Some(gpu) = crate::adapter("texture floors") else { return };
    let (model, mut renderer) = level_colors(&gpu);
    let shown = |renderer: &_, floor: f32| albedo(32, 1.0, &[floor]).take(&gpu, &model, renderer)[528][0] as f32;
    for floor in [0.0, 0.3, 1.0, 2.6, 4.0, 9.0f32] {
        let expected = 200.0 - 40.0 * floor.min(4.0);
        assert!((shown(&renderer, floor) - expected).abs() < 1.5, "floor {floor}");
    }
    renderer.model.free(model.chunk(0, 0));
    assert!((shown(&renderer, 0.0) - 160.0).abs() < 1.5, "mip 0 is gone, whatever the floor says");
}

#[test]
fn texels_without_alpha_are_holes_where_the_model_has_cut_outs() {
    let Some(gpu) = crate::adapter("cut-outs") else { return };
    // Left half of the shown part opaque, right half not.
    let mut fill = |_: u32, m: &MipPlace| {
        (0..m.bytes / 4).flat_map(|t| [90, 90, 90, if t % m.side < m.side / 4 { 255 } else { 0 }]).collect()
    };
    let mut model = TexturedModel::new(3, &[BASE], &[tile(6)], 32768, &mut fill);
    for cutouts in [false, true] {
        model.set_cutouts(cutouts);
        let mut renderer = model.renderer(&gpu, 1 << 24);
        model.upload_all(&gpu, &mut renderer);
        let picture = albedo(32, 1.0, &[0.0]).take(&gpu, &model, &renderer);
        let solid = picture.iter().filter(|p| p[0] == 90).count();
        assert_eq!(solid, if cutouts { 512 } else { 1024 });
        assert_eq!((picture[0][0], picture[31][0] == 90), (90, !cutouts));
    }
}

#[test]
fn no_neighbour_in_the_page_shows_at_the_rim_of_a_tile() {
    let Some(gpu) = crate::adapter("bleeding between squares") else { return };
    let sizes = [4, 5, 4, 6, 4, 5, 4, 4, 3];
    let tiles = sizes.map(tile);
    let mut fill = |cluster: u32, m: &MipPlace| {
        [[250, 0, 0, 255], [0, 250, 0, 255], [0, 0, 250, 255]][cluster as usize % 3].repeat(m.bytes as usize / 4)
    };
    let model = TexturedModel::new(5, &[BASE], &tiles, 65535, &mut fill);
    let mut renderer = model.renderer(&gpu, 1 << 24);
    model.upload_all(&gpu, &mut renderer);
    let slanted = Camera { eye: DVec3::new(-3.0, 10.0, 1.5), ..in_front(1.0) };
    for camera in [in_front(1.0), in_front(0.07), slanted] {
        for cluster in 0..tiles.len() as u32 {
            let shot = Shot { cluster, camera, floors: &[0.0; 9], color: ColorMode::Albedo, size: 96 };
            let picture = shot.take(&gpu, &model, &renderer);
            let background = shot_of_nothing(&gpu, &model, &renderer);
            let covered: Vec<_> = picture.iter().filter(|p| **p != background).collect();
            assert!(covered.len() > 20, "cluster {cluster} is seen");
            let own = cluster as usize % 3;
            assert!(covered.iter().all(|p| (0..3).all(|k| p[k] == if k == own { 250 } else { 0 })), "{cluster}");
        }
    }
}

fn shot_of_nothing(gpu: &Gpu, model: &TexturedModel, renderer: &Renderer) -> [u8; 4] {
    let away = Camera { eye: DVec3::new(500.0, 0.0, 5.0), target: DVec3::new(900.0, 0.0, 5.0), ..in_front(1.0) };
    let floors = vec![0.0; model.tiles.len()];
    Shot { cluster: 0, camera: away, floors: &floors, color: ColorMode::Albedo, size: 4 }.take(gpu, model, renderer)[0]
}

/// Blocks that every decoder understands: BC7 and BC5 of any bits; BC6H of its plainest mode, no large values.
fn block(random: &mut Random, format: MapFormat) -> Vec<u8> {
    let mut block = noise(random, 16);
    match format {
        MapFormat::Bc6h => {
            let bits = 0b00011 | (0..6).map(|k| (random.below(400) as u128) << (5 + 10 * k)).sum::<u128>();
            block[..8].copy_from_slice(&(bits as u64).to_le_bytes());
            block[8] = block[8] & !1 | (bits >> 64) as u8;
        }
        MapFormat::Bc7Srgb | MapFormat::Bc7Linear if block[0] == 0 => block[0] = 64,
        // Normals that lean so little that z is no root of next to nothing.
        MapFormat::Bc5 => [0, 1, 8, 9].into_iter().for_each(|k| block[k] = 90 + block[k] / 4),
        _ => {}
    }
    block
}

#[test]
fn decoded_texels_look_like_blocks() {
    let Some(mut gpu) = crate::adapter("decoded blocks") else { return };
    if !gpu.texture_blocks {
        eprintln!("SKIPPED: the adapter has no BC textures: decoded blocks did not run");
        return;
    }
    let cases = [
        (MapKind::BaseColor, MapFormat::Bc7Srgb, ColorMode::Albedo),
        (MapKind::BaseColor, MapFormat::Bc7Linear, ColorMode::Albedo),
        (MapKind::BaseColor, MapFormat::Bc6h, ColorMode::Albedo),
        (MapKind::Normal, MapFormat::Bc5, ColorMode::Normals),
    ];
    for (kind, format, color) in cases {
        let mut random = Random(5);
        let mut fill = |_: u32, m: &MipPlace| (0..m.bytes / 16).flat_map(|_| block(&mut random, format)).collect();
        let model = TexturedModel::new(3, &[(kind, format)], &[tile(6)], 32768, &mut fill);
        let mut picture = |blocks| {
            gpu.texture_blocks = blocks;
            let mut renderer = model.renderer(&gpu, 1 << 24);
            model.upload_all(&gpu, &mut renderer);
            Shot { color, ..albedo(32, 1.0, &[0.0]) }.take(&gpu, &model, &renderer)
        };
        let (blocks, decoded) = (picture(true), picture(false));
        assert!(blocks.iter().any(|p| *p != blocks[0]), "{format:?} shows something");
        let limit = if format == MapFormat::Bc5 { 3 } else { 1 };
        assert!(difference(&blocks, &decoded) <= limit, "{format:?}: {}", difference(&blocks, &decoded));
    }
}

/// The normal that is seen in the middle of a picture taken from above `(x, y)`.
fn normal_seen(gpu: &Gpu, model: &TexturedModel, (x, y, up): (f64, f64, DVec3)) -> [f32; 3] {
    let renderer = model.renderer(gpu, 1 << 24);
    let camera = Camera { eye: DVec3::new(x, y, 12.0), up, ..in_front(1.0) };
    let shot = Shot { camera, color: ColorMode::Normals, ..albedo(33, 1.0, &[0.0]) };
    let pixel = shot.take(gpu, model, &renderer)[33 * 16 + 16];
    // Pictures are in linear light, normals are drawn for sRGB ones.
    [0, 1, 2].map(|k| 1.055 * (pixel[k] as f32 / 255.0).powf(1.0 / 2.4) - 0.055).map(|n| n * 2.0 - 1.0)
}

#[test]
fn normal_maps_lean_towards_u_and_away_from_v_also_in_stretched_charts() {
    let Some(gpu) = crate::adapter("normal maps") else { return };
    for (texel, expected) in [([128u8, 128], [0.0, 0.0]), ([204, 128], [0.6, 0.0]), ([128, 52], [0.0, -0.6])] {
        let mut fill = |_: u32, m: &MipPlace| texel.repeat(m.bytes as usize / 2);
        let map = (MapKind::Normal, MapFormat::Rg8);
        let mut model = TexturedModel::new(1, &[map], &[tile(5)], 32768, &mut fill);
        // In the second u grows along y too: dP/dv is no longer at right angles to dP/du.
        let charts =
            [[[0, 32768], [32768, 32768], [32768, 0], [0, 0]], [[0, 16384], [16384, 16384], [32768, 0], [16384, 0]]];
        for uv in charts {
            model.vertices.iter_mut().zip(uv).for_each(|(v, uv)| v.color = Vertex::pack_uv(uv));
            for place in [(16.0, 16.0, DVec3::Y), (2.0, 30.0, DVec3::X), (29.0, 9.0, DVec3::new(1.0, -2.0, 0.0))] {
                let seen = normal_seen(&gpu, &model, place);
                for (seen, n) in seen.iter().zip(expected) {
                    assert!((seen - n).abs() < 0.03, "{texel:?} from {place:?}, {uv:?}: {seen:?}");
                }
            }
        }
    }
}

/// A white square in light, seen from above `(x, y)`, 64 pixels wide; `orm` where it says something.
fn white_in_light(gpu: &Gpu, orm: Option<[u8; 3]>, (x, y): (f64, f64)) -> Vec<[u8; 4]> {
    let maps = [BASE, (MapKind::Orm, MapFormat::Rgba8Linear)];
    let mut fill = |_: u32, m: &MipPlace| {
        let [r, g, b] = if m.map == 0 { [200; 3] } else { orm.unwrap_or_default() };
        [r, g, b, 255].repeat(m.bytes as usize / 4)
    };
    let model = TexturedModel::new(1, &maps[..1 + orm.is_some() as usize], &[tile(5)], 32768, &mut fill);
    let renderer = model.renderer(gpu, 1 << 24);
    let camera = Camera { eye: DVec3::new(x, y, 9.0), ..in_front(1.0) };
    Shot { camera, color: ColorMode::Shaded, ..albedo(64, 1.0, &[0.0]) }.take(gpu, &model, &renderer)
}

#[test]
fn glossy_surfaces_shine_without_a_speck_and_rough_ones_look_matt() {
    let Some(gpu) = crate::adapter("glossy surfaces") else { return };
    for place in [(16.0, 16.0), (3.0, 29.0), (20.0, 2.0)] {
        let matt = white_in_light(&gpu, None, place);
        for orm in [[255, 0, 0], [255, 40, 255], [255, 128, 0], [255, 255, 0], [255, 255, 255], [100, 90, 70]] {
            let picture = white_in_light(&gpu, Some(orm), place);
            let middle = |p: &[[u8; 4]], k: usize| p[(28 + k / 8) * 64 + 28 + k % 8][1];
            let dark = (0..64).filter(|&k| middle(&picture, k) < 10).count();
            assert_eq!(dark, 0, "{orm:?} from {place:?}");
            if orm == [255, 255, 0] {
                let far = (0..64).map(|k| middle(&picture, k).abs_diff(middle(&matt, k))).max();
                assert!(far < Some(20), "rough and no metal from {place:?}: {far:?}");
            }
        }
    }
}

#[test]
fn normals_of_the_model_are_shown_whatever_the_triangle_and_its_frame() {
    let Some(gpu) = crate::adapter("normals of the model") else { return };
    for (texel, expected) in [([128u8, 52, 26, 255], [0.0, -0.6, -0.8]), ([26, 52, 128, 255], [-0.8, -0.6, 0.0])] {
        let mut fill = |_: u32, m: &MipPlace| texel.repeat(m.bytes as usize / 4);
        let map = (MapKind::Normal, MapFormat::Rgba8Linear);
        let model = TexturedModel::new(1, &[map], &[tile(5)], 32768, &mut fill);
        for place in [(16.0, 16.0, DVec3::Y), (2.0, 30.0, DVec3::X)] {
            let seen = normal_seen(&gpu, &model, place);
            assert!(seen.iter().zip(expected).all(|(s, n)| (s - n).abs() < 0.03), "{texel:?}: {seen:?}");
        }
    }
    // A mixture that cancels out has no direction: the triangle's own normal is left.
    let map = (MapKind::Normal, MapFormat::Rgba8Linear);
    let mut fill = |_: u32, m: &MipPlace| [127u8, 128, 127, 255].repeat(m.bytes as usize / 4);
    let model = TexturedModel::new(1, &[map], &[tile(5)], 32768, &mut fill);
    let seen = normal_seen(&gpu, &model, (16.0, 16.0, DVec3::Y));
    assert!(seen[2] > 0.97, "{seen:?}");
}

/// Tiles of several sizes and maps of several formats, some of them small.
fn mixed(random: &mut Random, clusters: usize) -> TexturedModel {
    let maps = [BASE, (MapKind::Orm, MapFormat::Bc7Linear), (MapKind::Normal, MapFormat::Bc5)];
    let tiles: Vec<TileRecord> = (0..clusters)
        .map(|_| {
            let size_log2 = 3 + random.below(5) as u8;
            let small = if random.below(3) == 0 { size_log2 - 2 } else { 0 };
            TileRecord { first: [0, small, random.below(2) as u8, 0], ..tile(size_log2) }
        })
        .collect();
    let mut fill = |_: u32, m: &MipPlace| noise(random, m.bytes);
    TexturedModel::new(4, &maps, &tiles, 65535, &mut fill)
}

#[test]
fn all_memory_together_is_never_more_than_the_bound() {
    let pages = PageLimits { side: 8192, layers: 256, bytes: 1 << 30 };
    for seed in 0..20 {
        let model = mixed(&mut Random(seed), 40);
        for blocks in [false, true] {
            let limits = AdapterLimits { binding_bytes: 1 << 27, pages, blocks };
            let plan = |bound| VramPlan::new(&model.tables(), bound, &limits);
            let Err(RenderError::BoundTooSmall { needed, .. }) = plan(1000) else { panic!("too small") };
            assert_eq!(plan(needed).unwrap().bytes(), needed);
            assert!(plan(needed - 1).is_err());
            for bound in (needed..needed * 40).step_by(needed as usize / 3) {
                let bytes = plan(bound).unwrap().bytes();
                assert!(bytes <= bound, "{bytes} of {bound}");
            }
        }
    }
}

/// A renderer whose texture pools hold a part of the model only, and its bound.
fn tight(gpu: &Gpu, model: &TexturedModel, roomy: &Renderer, part: f64) -> (Renderer, u64) {
    let least = match VramPlan::new(&model.tables(), 0, &AdapterLimits::of(gpu)) {
        Err(RenderError::BoundTooSmall { needed, .. }) => needed,
        _ => panic!("nothing fits 0 bytes"),
    };
    let bound = least + ((roomy.model.plan().bytes() - least) as f64 * part) as u64;
    (model.renderer(gpu, bound), bound)
}

/// Chunks come and go within the budget. All must find a place, the bound must hold, and now and then a cluster must
/// look as where nothing ever moves. Returns how much of the budget was used at the end.
fn come_and_go(gpu: &Gpu, model: &TexturedModel, random: &mut Random, part: f64) -> f64 {
    let mut roomy = model.renderer(gpu, 1 << 30);
    model.upload_all(gpu, &mut roomy);
    let (mut tight, bound) = tight(gpu, model, &roomy, part);
    let (budget, costs) = tight.model.texture_costs();
    let (levels, clusters) = (model.model.levels, model.model.clusters);
    let first = model.chunk(0, 0).0;
    let mut used = 0;
    for round in 0..2000 {
        let chunk = random.below(costs.len() as u32);
        let (id, cost) = (ChunkId(first + chunk), costs[chunk as usize]);
        if (chunk + 1).is_multiple_of(levels) || cost == 0 {
            assert!(tight.model.is_resident(id));
        } else if used + cost > budget || random.below(4) == 0 {
            used -= if tight.model.is_resident(id) { cost } else { 0 };
            tight.model.free(id);
        } else if !tight.model.is_resident(id) {
            model.upload(gpu, &mut tight, id);
            used += cost;
        }
        assert!(tight.model.vram_bytes() <= bound);
        if round % 20 == 0 {
            let cluster = chunk / levels;
            let there = |l: &u32| tight.model.is_resident(model.chunk(cluster, *l));
            let finest = (0..levels - 1).rev().take_while(there).last().unwrap_or(levels - 1);
            let mut floors = vec![0.0; clusters as usize];
            floors[cluster as usize] = finest as f32;
            let shot = |renderer| Shot { cluster, ..albedo(48, 1.0, &floors) }.take(gpu, model, renderer);
            assert!(shot(&tight) == shot(&roomy), "round {round}");
        }
    }
    used as f64 / budget as f64
}

#[test]
fn chunks_within_the_budget_always_find_a_place_and_look_as_in_a_roomy_pool() {
    let Some(gpu) = crate::adapter("pools under pressure") else { return };
    let mut random = Random(9);
    let model = mixed(&mut random, 60);
    let used = come_and_go(&gpu, &model, &mut random, 0.33);
    assert!(used > 0.3, "the pools were under pressure: {used}");
}

#[test]
fn a_bound_far_below_the_largest_mip_shows_coarser_ones() {
    let Some(gpu) = crate::adapter("small bounds") else { return };
    let mut random = Random(2);
    let mut fill = |_: u32, m: &MipPlace| noise(&mut random, m.bytes);
    let model = TexturedModel::new(7, &[BASE], &[tile(11)], 65535, &mut fill);
    let bound = 2 << 20;
    let mut renderer = model.renderer(&gpu, bound);
    assert!(renderer.model.plan().bytes() <= bound);
    let (budget, costs) = renderer.model.texture_costs();
    let fits: Vec<u32> = (0..6).rev().take_while(|&l| costs[l as usize] <= budget).collect();
    assert_eq!(fits, [5, 4, 3], "mips of 64 to 256 texels: 512 are 1 MiB, wider than a page");
    assert!(renderer.model.upload_texture(&gpu, model.chunk(0, 2), &model.bytes[2]).is_err());
    fits.iter().for_each(|&l| model.upload(&gpu, &mut renderer, model.chunk(0, l)));
    let picture = albedo(256, 1.0, &[0.0]).take(&gpu, &model, &renderer);
    let texel = &model.bytes[3][(100 * 256 + 100) * 4..][..3];
    assert!(picture[100 * 256 + 100].iter().zip(texel).all(|(a, b)| a.abs_diff(*b) <= 2));
}

/// With one map a chunk costs its bytes and no more, so that a full budget is a full pool, where squares have to move.
#[test]
fn squares_that_move_keep_their_texels() {
    let Some(gpu) = crate::adapter("moving squares") else { return };
    let mut random = Random(4);
    let tiles: Vec<TileRecord> = (0..70).map(|c| tile(if c % 14 == 0 { 8 } else { 6 + (c % 2) as u8 })).collect();
    let mut fill = |_: u32, m: &MipPlace| noise(&mut random, m.bytes);
    let model = TexturedModel::new(4, &[BASE], &tiles, 65535, &mut fill);
    let used = come_and_go(&gpu, &model, &mut random, 0.4);
    assert!(used > 0.9, "the pool was full: {used}");
}
