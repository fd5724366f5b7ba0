//! Textured models: no pops of texels on a slow flight, bright values that stay bright, no seams, and what shines through.

use crate::support::{adapter, column, folder, hills, pb_view_line, read_frame, write_flight};
use pb_archive::{Overwrite, Writer};
use pb_lod::progressive_buffers::bake::{
    BakeOptions, ChartMode, ChartOptions, Outside, TexelOptions, TextureInput, bake_textured,
};
use pb_lod::progressive_buffers::layout::SCHEME;
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::textures::MapFormat;
use pb_lod::progressive_buffers::write::write_model;
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::Soup;
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::texture::Quality;
use pb_mesh::texture::image::{Image, TexelFormat};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Hills, almost flat so that no ridge sparkles, under an image that is spread over them once; `2 * n * n` triangles.
fn bake_hills(name: &str, n: u32, image: Image) -> PathBuf {
    bake_hills_as(name, hills(n), image, ChartMode::Source, Material::default())
}

fn bake_hills_as(name: &str, mut soup: Soup, image: Image, mode: ChartMode, mut material: Material) -> PathBuf {
    soup.positions.iter_mut().for_each(|p| p[1] *= 0.1);
    soup.uv_sets = vec![soup.positions.iter().map(|p| [p[0], p[2]].map(|x| 0.5 + 0.49 * x as f32)).collect()];
    soup.material_of = vec![0; soup.triangles.len()];
    let triangles = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).unwrap();
    material.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(0));
    let textures = TextureInput {
        materials: &[material],
        images: &[Some(image)],
        charts: ChartOptions { mode, tile_size: 512, charter: None },
        texels: TexelOptions { quality: Quality::Fast, ..TexelOptions::default() },
    };
    let options = BakeOptions { levels: 4, cluster_triangles: Some(2048), ..BakeOptions::default() };
    let (model, _) = bake_textured(mesh, Some(&textures), triangles, &options, &Outside::nothing()).unwrap();
    let path = folder("archives").join(name);
    write_model(Writer::create(&path, SCHEME, Overwrite::Force).unwrap(), &model).unwrap();
    path
}

/// Dark and bright at random in squares of 1, 4 and 16 texels, by channel: detail for every mip.
fn loud(size: u32) -> Image {
    let random = |x: u32, y: u32, seed: u32| {
        let n = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ seed).wrapping_mul(2_654_435_761);
        (n ^ n >> 15).wrapping_mul(2_246_822_519) >> 31
    };
    let texel = |i: u32| {
        let (x, y) = (i % size, i / size);
        [1, 4, 16].map(|side| random(x / side, y / side, side) as u8 * 140 + 90)
    };
    Image::new(size, size, TexelFormat::Rgb8, Arc::new((0..size * size).flat_map(texel).collect::<Vec<u8>>()))
}

/// Slow: the rim of the picture moves by an eighth of a pixel per frame, so a mip that pops stands out.
const STEP: f64 = 0.998;
/// Closer by two thirds: more than half a mip.
const FAR: f64 = 1.5;
const NEAR: f64 = 1.0;
const KEY: u32 = 20;

fn keys() -> Vec<(f64, [f64; 3], [f64; 3])> {
    let count = ((FAR / NEAR).ln() / -STEP.ln() / f64::from(KEY)).ceil() as u32;
    let key = |i: u32| {
        let height = FAR * STEP.powi((i * KEY) as i32);
        (f64::from(i * KEY) / 60.0, [0.02, height, 0.01], [0.02, 0.0, 0.01])
    };
    (0..=count).map(key).collect()
}

/// Flies down to the archive; the folder of the frames.
fn fly(archive: &Path, name: &str, more: &str) -> PathBuf {
    let out = folder(name);
    let (path, stats) = (out.join("flight.json"), out.join("stats.csv"));
    write_flight(&path, 60.0, [0.0, 0.7, -0.7], 30.0, &keys());
    let line = format!("{{}} --flypath {{}} --frames {{}} --stats {{}} --size 120x90 --unlit {more}");
    let run = pb_view_line(&line, &[archive, &path, &out, &stats]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    out
}

/// Largest change of a pixel, and the largest mean change, between neighbouring frames.
fn change(folder: &Path) -> (u8, f64) {
    let frames = column(&folder.join("stats.csv"), "frame").len() as u32;
    let pictures: Vec<Vec<u8>> = (0..frames).map(|f| read_frame(folder, f).into_raw()).collect();
    let changes = pictures.windows(2).map(|p| {
        let off = || p[0].iter().zip(&p[1]).map(|(a, b)| a.abs_diff(*b));
        (off().max().unwrap(), off().map(f64::from).sum::<f64>() / p[0].len() as f64)
    });
    changes.fold((0, 0.0), |most, one| (most.0.max(one.0), most.1.max(one.1)))
}

#[test]
fn texels_change_as_smoothly_as_those_of_the_full_model_also_where_they_come_late() {
    let Some(_) = adapter("texture pops on a slow flight") else { return };
    let archive = bake_hills("loud_hills.pb", 64, loud(1024));
    let full = fly(&archive, "texture_pops_full", "--settle --error-px 0.001");
    let settled = fly(&archive, "texture_pops_settled", "--settle --error-px 1");
    let late = fly(&archive, "texture_pops_late", "--error-px 1 --late-frames 30 --no-prefetch");
    // Together less than a quarter of the archive.
    let size = std::fs::metadata(&archive).unwrap().len();
    assert!(size > 4 * (400 + 280) * 1024, "{size}");
    let tight = fly(&archive, "texture_pops_tight", "--error-px 1 --vram 400KiB --ram 280KiB");
    let allowed = column(&tight.join("stats.csv"), "allowed_texel_error_px");
    assert!(allowed.iter().any(|tau| *tau > 1.5), "the bounds have to be felt: {allowed:?}");
    let missing = column(&late.join("stats.csv"), "missing_chunks").iter().filter(|m| **m > 0.0).count();
    let [full, settled, late, tight] = [full, settled, late, tight].map(|f| change(&f));
    println!(
        "largest and mean change: full {full:?}, settled {settled:?}, late {late:?}, {missing} frames lacked data, \
         tight {tight:?}"
    );
    assert!(missing > 25, "data was late in only {missing} frames");
    for (name, found) in [("settled", settled), ("late", late), ("tight", tight)] {
        assert!(f64::from(found.0) <= 1.5 * f64::from(full.0), "{name}: {found:?}, full model: {full:?}");
        assert!(found.1 <= 1.5 * full.1, "{name}: {found:?}, full model: {full:?}");
    }
}

#[test]
fn bright_values_of_a_texture_survive_to_the_frames() {
    let Some(_) = adapter("HDR frames") else { return };
    // A few texels stay halves, many become blocks of halves.
    for (name, n, side) in [("hdr_halves", 32, 128), ("hdr_blocks", 64, 1024)] {
        bright_values_survive(name, n, side);
    }
}

fn bright_values_survive(name: &str, n: u32, side: u32) {
    // Halves: 6 on the left, 0.25 on the right.
    let texel = |i: u32| if i % side < side / 2 { [0x4600u16; 3] } else { [0x3400; 3] };
    let bytes: Vec<u8> = (0..side * side).flat_map(texel).flat_map(u16::to_le_bytes).collect();
    let image = Image::new(side, side, TexelFormat::RgbF16, Arc::new(bytes));
    let archive = bake_hills(&format!("{name}.pb"), n, image);
    let format = Model::open(&archive).unwrap().textures().unwrap().maps[0].format().unwrap();
    assert_eq!(format, if side > 512 { MapFormat::Bc6h } else { MapFormat::RgbaF16 });
    let out = folder(name);
    let path = out.join("flight.json");
    write_flight(
        &path,
        10.0,
        [0.0, 0.0, -1.0],
        30.0,
        &[(0.0, [0.0, 3.0, 0.0], [0.0; 3]), (0.1, [0.0, 3.0, 0.0], [0.0; 3])],
    );
    let line = "{} --flypath {} --frames {} --format exr --size 64x64 --unlit --settle --textures blocks";
    let run = pb_view_line(line, &[&archive, &path, &out]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let frame = exr::prelude::read_first_flat_layer_from_file(out.join("frame_00000.exr")).unwrap();
    for channel in &frame.layer_data.channel_data.list {
        let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
        let at = |x: usize| values[32 * 64 + x];
        assert!((at(16) - 6.0).abs() < 0.1 && (at(48) - 0.25).abs() < 0.02, "{}: {} {}", channel.name, at(16), at(48));
    }
}

/// Waves: red 24 texels long, green 96; blue is even.
const WAVES: [f64; 2] = [24.0, 96.0];
const WAVY_SIZE: u32 = 256;

/// What the wavy image shows at a place of the hills: x and z, from -1 to 1.
fn wavy(x: f64, z: f64) -> [f64; 3] {
    let texel = |x: f64| (0.5 + 0.49 * x) * f64::from(WAVY_SIZE);
    let wave = |k: usize| {
        128.0 + 100.0 * ((texel(x) + 0.4 * texel(z)) / WAVES[k] * std::f64::consts::TAU / 1.16f64.sqrt()).sin()
    };
    [wave(0), wave(1), 128.0]
}

/// The hills straight from above, from so far away that their heights play no part: how much of them a picture shows.
const SHOWN: [f64; 2] = [0.9, 1.8];

/// Largest difference, of 255, between a picture of the hills and the wavy image itself, by channel.
fn off_the_waves(picture: &image::RgbImage, shown: f64) -> [f64; 3] {
    let size = f64::from(picture.width());
    let at = |i: u32| (2.0 * (f64::from(i) + 0.5) / size - 1.0) * shown;
    let mut worst = [0f64; 3];
    for (i, j, pixel) in picture.enumerate_pixels() {
        let (x, z) = (at(i), at(j));
        if x.abs().max(z.abs()) < 0.9 {
            let wanted = wavy(x, z);
            (0..3).for_each(|k| worst[k] = worst[k].max((f64::from(pixel.0[k]) - wanted[k]).abs()));
        }
    }
    worst
}

#[test]
fn no_seam_shows_where_charts_and_clusters_meet() {
    let Some(_) = adapter("seams of charts and clusters") else { return };
    let place = |i: u32| ((f64::from(i) + 0.5) / f64::from(WAVY_SIZE) - 0.5) / 0.49;
    let texel = |i: u32| wavy(place(i % WAVY_SIZE), place(i / WAVY_SIZE)).map(|c| c.round() as u8);
    let bytes: Vec<u8> = (0..WAVY_SIZE * WAVY_SIZE).flat_map(texel).collect();
    let image = Image::new(WAVY_SIZE, WAVY_SIZE, TexelFormat::Rgb8, Arc::new(bytes));
    for (name, mode) in [("source", ChartMode::Source), ("new", ChartMode::Auto)] {
        let archive = bake_hills_as(&format!("wavy_{name}.pb"), hills(64), image.clone(), mode, Material::default());
        let out = folder(&format!("seams_{name}"));
        let path = out.join("flight.json");
        let distance = 50.0;
        let keys = SHOWN.map(|s| s / SHOWN[0] * distance).map(|y| [0.0, y, 0.0]);
        let fov_deg = 2.0 * (SHOWN[0] / distance).atan().to_degrees();
        write_flight(&path, 10.0, [0.0, 0.0, -1.0], fov_deg, &[(0.0, keys[0], [0.0; 3]), (0.1, keys[1], [0.0; 3])]);
        let line = "{} --flypath {} --frames {} --size 240x240 --unlit --settle --error-px 0.05";
        let run = pb_view_line(line, &[&archive, &path, &out]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let near = off_the_waves(&read_frame(&out, 0), SHOWN[0]);
        let far = off_the_waves(&read_frame(&out, 1), SHOWN[1]);
        println!("{name} charts, largest differences by channel: near {near:.1?}, far {far:.1?}");
        // A texel's shift would change red by 26 near, the next mip's green by 13 far, and bleeding blue.
        assert!(near[0] < 13.0 && near[1] < 8.0 && near[2] < 8.0, "{name}, near: {near:?}");
        assert!(far[1] < 14.0 && far[2] < 8.0, "{name}, far: {far:?}");
    }
}

#[test]
fn what_lies_behind_a_blended_surface_shines_through_its_share_of_each_pixel() {
    let Some(_) = adapter("blended surfaces") else { return };
    let linear = |c: f64| ((c / 255.0 + 0.055) / 1.055).powf(2.4);
    let behind = linear(f64::from(pb_render::BACKGROUND_SRGB[1]));
    for (alpha, share) in [(77u8, 0.25), (128, 0.5), (190, 0.75), (255, 1.0)] {
        let mut soup = hills(16);
        soup.colors = vec![[255, 255, 255, alpha]; soup.positions.len()];
        let material = Material { alpha_cutoff: Some(0.0625), is_blended: true, ..Material::default() };
        let white = Image::new(8, 8, TexelFormat::Rgb8, Arc::new(vec![255u8; 8 * 8 * 3]));
        let archive = bake_hills_as(&format!("veil_{alpha}.pb"), soup, white, ChartMode::Source, material);
        let out = folder(&format!("veil_{alpha}"));
        let path = out.join("flight.json");
        let key = |t: f64| (t, [0.0, 3.0, 0.0], [0.0; 3]);
        write_flight(&path, 10.0, [0.0, 0.0, -1.0], 20.0, &[key(0.0), key(0.1)]);
        for samples in [1, 4] {
            let line = format!("{{}} --flypath {{}} --frames {{}} --size 32x32 --unlit --settle --samples {samples}");
            let run = pb_view_line(&line, &[&archive, &path, &out]);
            assert_eq!(run.code, 0, "{}", run.stderr);
            let picture = read_frame(&out, 0);
            let mean = picture.pixels().map(|p| linear(f64::from(p.0[1]))).sum::<f64>() / 1024.0;
            let wanted = share + (1.0 - share) * behind;
            assert!((mean - wanted).abs() < 0.01, "alpha {alpha}, {samples} samples: {mean}, not {wanted}");
        }
    }
}
