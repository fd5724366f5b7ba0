//! Textured models: no pops of texels on a slow flight, and bright values that stay bright.

use crate::support::{adapter, column, folder, hills, pb_view_line, read_frame, write_flight};
use pb_archive::{Overwrite, Spill, Writer};
use pb_lod::progressive_buffers::bake::{
    BakeOptions, ChartMode, ChartOptions, TexelOptions, TextureInput, bake_textured,
};
use pb_lod::progressive_buffers::layout::SCHEME;
use pb_lod::progressive_buffers::write::write_model;
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::texture::Quality;
use pb_mesh::texture::image::{Image, TexelFormat};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Hills, almost flat so that no ridge sparkles, under an image that is spread over them once; `2 * n * n` triangles.
fn bake_hills(name: &str, n: u32, image: Image) -> PathBuf {
    let mut soup = hills(n);
    soup.positions.iter_mut().for_each(|p| p[1] *= 0.1);
    soup.uv_sets = vec![soup.positions.iter().map(|p| [p[0], p[2]].map(|x| 0.5 + 0.49 * x as f32)).collect()];
    soup.material_of = vec![0; soup.triangles.len()];
    let triangles = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).unwrap();
    let mut material = Material::default();
    material.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(0));
    let textures = TextureInput {
        materials: &[material],
        images: &[Some(image)],
        charts: ChartOptions { mode: ChartMode::Source, tile_size: 512, charter: None },
        texels: TexelOptions { quality: Quality::Fast, ..TexelOptions::default() },
        spill: &Spill::in_memory(),
    };
    let options = BakeOptions { levels: 4, cluster_triangles: 2048, ..BakeOptions::default() };
    let (model, _) = bake_textured(&mesh, Some(&textures), triangles, &options, &|_, _| {}).unwrap();
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
    let late = fly(&archive, "texture_pops_late", "--error-px 1 --late-frames 30");
    let missing = column(&late.join("stats.csv"), "missing_chunks").iter().filter(|m| **m > 0.0).count();
    let [full, settled, late] = [full, settled, late].map(|f| change(&f));
    println!(
        "largest and mean change: full {full:?}, settled {settled:?}, late {late:?}, {missing} frames lacked data"
    );
    assert!(missing > 25, "data was late in only {missing} frames");
    for (name, found) in [("settled", settled), ("late", late)] {
        assert!(f64::from(found.0) <= 1.5 * f64::from(full.0), "{name}: {found:?}, full model: {full:?}");
        assert!(found.1 <= 1.5 * full.1, "{name}: {found:?}, full model: {full:?}");
    }
}

#[test]
fn bright_values_of_a_texture_survive_to_the_frames() {
    let Some(_) = adapter("HDR frames") else { return };
    // Halves: 6 on the left, 0.25 on the right.
    let texel = |i: u32| if i % 128 < 64 { [0x4600u16; 3] } else { [0x3400; 3] };
    let bytes: Vec<u8> = (0..128 * 128).flat_map(texel).flat_map(u16::to_le_bytes).collect();
    let archive = bake_hills("hdr_hills.pb", 32, Image::new(128, 128, TexelFormat::RgbF16, Arc::new(bytes)));
    let out = folder("hdr_frames");
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
