//! What generated textures show, and how they are written: row by row, so that size costs no memory.

use anyhow::{Context, Result, bail};
use image::{GenericImageView, Rgb};
use rayon::prelude::*;
use std::io::BufWriter;
use std::path::Path;

use crate::random::{mixed, noise, octaves};

/// Side of the patches of a surface that show one kind of detail, texels.
const PATCH: f64 = 160.0;
/// Rows that are painted at once.
const BAND: u32 = 64;

/// A colour for every texel of a square image.
pub trait Paint: Sync {
    /// Side, texels.
    fn size(&self) -> u32;
    /// sRGB.
    fn texel(&self, x: u32, y: u32) -> [u8; 3];
}

/// Colours that change slowly over a surface, with some grain, 0 to 1.
pub fn slow(place: [f64; 3], seed: u64) -> [f64; 3] {
    let grain = 0.08 * octaves(place.map(|x| x * 20.0), seed, 4, 0.6);
    std::array::from_fn(|k| 0.5 + 0.35 * noise(place.map(|x| x * 2.5), seed ^ (k as u64 + 11)) + grain)
}

/// The detail of a surface at `(s, t)`, texels on the surface: on top of slow colours letters, a checkerboard of 3
/// texels, noise, or nothing.
pub fn detail(s: f64, t: f64, base: [f64; 3], seed: u64) -> [u8; 3] {
    let patch = hash((s / PATCH).floor() as i64, (t / PATCH).floor() as i64, seed);
    let factor = match patch % 5 {
        0 => letters(s, t, seed),
        1 => [0.25, 1.6][((s / 3.0).floor() as i64 + (t / 3.0).floor() as i64).rem_euclid(2) as usize],
        2 | 3 => 0.75 + 0.5 * (hash(s.floor() as i64, t.floor() as i64, seed) % 256) as f64 / 255.0,
        _ => 1.0,
    };
    base.map(|c| ((c * factor).clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// Dark marks of 5 x 7 dots in cells of 6 x 9, each dot 2 texels, on light ground.
fn letters(s: f64, t: f64, seed: u64) -> f64 {
    let (x, y) = ((s / 2.0).floor() as i64, (t / 2.0).floor() as i64);
    let (column, row) = (x.rem_euclid(6), y.rem_euclid(9));
    let glyph = hash(x.div_euclid(6), y.div_euclid(9), seed ^ 5);
    let is_ink = column < 5 && row < 7 && glyph >> (row * 5 + column) & 1 == 1;
    if is_ink { 0.15 } else { 1.7 }
}

fn hash(x: i64, y: i64, seed: u64) -> u64 {
    mixed(mixed(seed ^ x as u64).wrapping_add(y as u64))
}

/// Writes a .png, .jpg or .tif file.
pub fn write(paint: &dyn Paint, path: &Path) -> Result<()> {
    let size = paint.size();
    let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
    let out = BufWriter::with_capacity(1 << 20, file);
    match path.extension().and_then(|e| e.to_str()) {
        Some("png") => {
            let mut encoder = png::Encoder::new(out, size, size);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_compression(png::Compression::Fast);
            let mut header = encoder.write_header()?;
            let mut stream = header.stream_writer()?;
            for top in (0..size).step_by(BAND as usize) {
                std::io::Write::write_all(&mut stream, &band(paint, top))?;
            }
            stream.finish()?;
        }
        Some("jpg" | "jpeg") => {
            image::codecs::jpeg::JpegEncoder::new_with_quality(out, 95).encode_image(&Lazily(paint))?;
        }
        Some("tif") => {
            let mut encoder = tiff::encoder::TiffEncoder::new(out)?;
            let mut image = encoder.new_image::<tiff::encoder::colortype::RGB8>(size, size)?;
            image.rows_per_strip(BAND)?;
            (0..size).step_by(BAND as usize).try_for_each(|top| image.write_strip(&band(paint, top)))?;
            image.finish()?;
        }
        _ => bail!("{}: only .png, .jpg and .tif can be written", path.display()),
    }
    Ok(())
}

fn band(paint: &dyn Paint, top: u32) -> Vec<u8> {
    let rows: Vec<u32> = (top..(top + BAND).min(paint.size())).collect();
    let row = |&y: &u32| (0..paint.size()).flat_map(|x| paint.texel(x, y)).collect::<Vec<u8>>();
    rows.par_iter().map(row).collect::<Vec<_>>().concat()
}

/// An image that exists texel by texel, as the encoder asks.
struct Lazily<'a>(&'a dyn Paint);

impl GenericImageView for Lazily<'_> {
    type Pixel = Rgb<u8>;

    fn dimensions(&self) -> (u32, u32) {
        (self.0.size(), self.0.size())
    }

    fn get_pixel(&self, x: u32, y: u32) -> Rgb<u8> {
        Rgb(self.0.texel(x, y))
    }
}
