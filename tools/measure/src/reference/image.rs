//! Images of a model at full resolution, and how they are looked up: plainly, in linear light.

use anyhow::{Context, Result, anyhow, bail};
use image::DynamicImage;
use std::path::Path;
use std::sync::LazyLock;

use super::scene::Wrap;

/// Linear light of each sRGB byte (IEC 61966-2-1).
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| linear_of_srgb(i as f64 / 255.0) as f32));

/// Largest anisotropy of [`Image::trilinear`].
const MAX_ANISOTROPY: f64 = 16.0;

/// sRGB encoded, 0 to 1, to linear light.
pub fn linear_of_srgb(c: f64) -> f64 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Linear light to an sRGB byte.
pub fn srgb_byte(c: f32) -> u8 {
    let c = f64::from(c).clamp(0.0, 1.0);
    let s = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0).round() as u8
}

enum Texels {
    /// sRGB and alpha.
    Bytes(Vec<[u8; 4]>),
    /// Linear light and alpha.
    Floats(Vec<[f32; 4]>),
}

/// An image, rows from the top.
pub struct Image {
    pub width: usize,
    pub height: usize,
    texels: Texels,
    /// Mips from 1 on: width, height, texels; only where asked for.
    mips: Vec<(usize, usize, Vec<[f32; 4]>)>,
}

impl Image {
    /// Reads a file.
    pub fn open(path: &Path) -> Result<Image> {
        let bytes = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        Image::decode(&bytes).with_context(|| path.display().to_string())
    }

    /// What stands in the place of an image that cannot be read, as the user guide says: a checker of 8 x 8 fields, magenta
    /// and black, 8 texels wide each.
    pub fn or_missing(read: Result<Image>) -> Image {
        read.unwrap_or_else(|e| {
            eprintln!("pb-measure: warning: {e:#}; a magenta checker stands in its place");
            let dark = |i: usize| (i % 64 / 8 + i / 512) % 2 == 1;
            let texel = |i: usize| if dark(i) { [0, 0, 0, 255] } else { [255, 0, 255, 255] };
            Image::new(64, Texels::Bytes((0..64 * 64).map(texel).collect()))
        })
    }

    fn new(width: usize, texels: Texels) -> Image {
        let count = match &texels {
            Texels::Bytes(t) => t.len(),
            Texels::Floats(t) => t.len(),
        };
        Image { width, height: count / width, texels, mips: Vec::new() }
    }

    /// The same from memory.
    pub fn decode(bytes: &[u8]) -> Result<Image> {
        if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            return decode_exr(bytes);
        }
        let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format()?;
        reader.no_limits();
        Ok(Image::of(reader.decode()?))
    }

    fn of(decoded: DynamicImage) -> Image {
        let width = decoded.width() as usize;
        let is_deep = decoded.color().bytes_per_pixel() > 2 * u8::from(decoded.color().has_alpha())
            && decoded.color().bits_per_pixel() / u16::from(decoded.color().channel_count()) > 8;
        let texels = match decoded {
            DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
                Texels::Floats(decoded.into_rgba32f().pixels().map(|p| p.0).collect())
            }
            _ if is_deep => {
                let linear = |c: u16| linear_of_srgb(f64::from(c) / 65535.0) as f32;
                let of = |p: [u16; 4]| [linear(p[0]), linear(p[1]), linear(p[2]), f32::from(p[3]) / 65535.0];
                Texels::Floats(decoded.into_rgba16().pixels().map(|p| of(p.0)).collect())
            }
            _ => Texels::Bytes(decoded.into_rgba8().pixels().map(|p| p.0).collect()),
        };
        Image::new(width, texels)
    }

    /// From sRGB bytes and alpha, rows from the top.
    #[cfg(test)]
    pub fn from_bytes(width: usize, texels: Vec<[u8; 4]>) -> Image {
        Image::new(width, Texels::Bytes(texels))
    }

    fn texel(&self, at: usize) -> [f32; 4] {
        match &self.texels {
            Texels::Bytes(bytes) => {
                let [r, g, b, a] = bytes[at];
                let linear = &*LINEAR;
                [linear[r as usize], linear[g as usize], linear[b as usize], f32::from(a) / 255.0]
            }
            Texels::Floats(floats) => floats[at],
        }
    }

    /// Bilinear in the image itself.
    pub fn bilinear(&self, uv: [f64; 2], wrap: [Wrap; 2]) -> [f32; 4] {
        bilinear((self.width, self.height), uv, wrap, |at| self.texel(at))
    }

    /// The nearest texel of the image itself.
    pub fn nearest(&self, uv: [f64; 2], wrap: [Wrap; 2]) -> [f32; 4] {
        let x = wrapped((uv[0] * self.width as f64).floor() as i64, self.width, wrap[0]);
        let y = wrapped((uv[1] * self.height as f64).floor() as i64, self.height, wrap[1]);
        self.texel(y * self.width + x)
    }

    /// As adapters do it: between two mips, with up to 16 probes along the longer axis of the pixel's footprint.
    /// `across` and `down` are the changes of uv from this pixel to the next.
    pub fn trilinear(&self, uv: [f64; 2], across: [f64; 2], down: [f64; 2], wrap: [Wrap; 2]) -> [f32; 4] {
        let size = [self.width as f64, self.height as f64];
        let length = |d: [f64; 2]| (d[0] * size[0]).hypot(d[1] * size[1]);
        let (long, short, axis) = match (length(across), length(down)) {
            (a, d) if a >= d => (a, d, across),
            (a, d) => (d, a, down),
        };
        // A hair above one is one.
        let probes = (long / short.max(1e-9) - 0.01).ceil().clamp(1.0, MAX_ANISOTROPY);
        let lod = (long / probes).max(1.0).log2().min(self.mips.len() as f64);
        let (fine, share) = (lod.floor() as usize, lod.fract() as f32);
        let mut sum = [0.0; 4];
        for i in 0..probes as usize {
            let t = (i as f64 + 0.5) / probes - 0.5;
            let at = [uv[0] + axis[0] * t, uv[1] + axis[1] * t];
            let (a, b) = (self.at_mip(fine, at, wrap), self.at_mip(fine + 1, at, wrap));
            (0..4).for_each(|k| sum[k] += (a[k] + (b[k] - a[k]) * share) / probes as f32);
        }
        sum
    }

    fn at_mip(&self, mip: usize, uv: [f64; 2], wrap: [Wrap; 2]) -> [f32; 4] {
        match mip.min(self.mips.len()) {
            0 => self.bilinear(uv, wrap),
            m => {
                let (width, height, texels) = &self.mips[m - 1];
                bilinear((*width, *height), uv, wrap, |at| texels[at])
            }
        }
    }

    /// Makes the mips that [`Image::trilinear`] needs: averages of 2 x 2 in linear light.
    pub fn make_mips(&mut self) {
        self.mips.clear();
        let (mut width, mut height) = (self.width, self.height);
        while width.max(height) > 1 {
            let (w, h) = ((width / 2).max(1), (height / 2).max(1));
            let last = self.mips.last().map(|m| &m.2);
            let from = |x: usize, y: usize| {
                let at = y.min(height - 1) * width + x.min(width - 1);
                last.map_or_else(|| self.texel(at), |l| l[at])
            };
            let average = |x: usize, y: usize| {
                let four =
                    [from(2 * x, 2 * y), from(2 * x + 1, 2 * y), from(2 * x, 2 * y + 1), from(2 * x + 1, 2 * y + 1)];
                std::array::from_fn(|k| four.iter().map(|t| t[k]).sum::<f32>() / 4.0)
            };
            let texels = (0..w * h).map(|i| average(i % w, i / w)).collect();
            self.mips.push((w, h, texels));
            (width, height) = (w, h);
        }
    }
}

fn wrapped(at: i64, size: usize, wrap: Wrap) -> usize {
    let n = size as i64;
    (match wrap {
        Wrap::Repeat => at.rem_euclid(n),
        Wrap::Clamp => at.clamp(0, n - 1),
        Wrap::Mirror => {
            let m = at.rem_euclid(2 * n);
            m.min(2 * n - 1 - m)
        }
    }) as usize
}

fn bilinear(
    (width, height): (usize, usize),
    uv: [f64; 2],
    wrap: [Wrap; 2],
    texel: impl Fn(usize) -> [f32; 4],
) -> [f32; 4] {
    let (s, t) = (uv[0] * width as f64 - 0.5, uv[1] * height as f64 - 0.5);
    let (x, y) = (s.floor() as i64, t.floor() as i64);
    let (fx, fy) = ((s - s.floor()) as f32, (t - t.floor()) as f32);
    let [x0, x1] = [x, x + 1].map(|x| wrapped(x, width, wrap[0]));
    let [y0, y1] = [y, y + 1].map(|y| wrapped(y, height, wrap[1]) * width);
    let (a, b, c, d) = (texel(y0 + x0), texel(y0 + x1), texel(y1 + x0), texel(y1 + x1));
    std::array::from_fn(|k| {
        let (top, bottom) = (a[k] + (b[k] - a[k]) * fx, c[k] + (d[k] - c[k]) * fx);
        top + (bottom - top) * fy
    })
}

/// The first layer's R, G, B and A, or its one channel as grey; linear light.
fn decode_exr(bytes: &[u8]) -> Result<Image> {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let reader = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let layer = reader.from_buffered(std::io::Cursor::new(bytes)).map_err(|e| anyhow!("{e}"))?.layer_data;
    let channels = &layer.channel_data.list;
    let named = |name: &str| channels.iter().find(|c| c.name.to_string().eq_ignore_ascii_case(name));
    let grey = named("Y").or(channels.first());
    let [r, g, b] = ["R", "G", "B"].map(|n| named(n).or(grey));
    let (Some(r), Some(g), Some(b)) = (r, g, b) else { bail!("the image has no channel") };
    let alpha = named("A");
    let [r, g, b] = [r, g, b].map(|c| c.sample_data.values_as_f32().collect::<Vec<_>>());
    let alpha = alpha.map(|c| c.sample_data.values_as_f32().collect::<Vec<_>>());
    let texels = (0..r.len()).map(|i| [r[i], g[i], b[i], alpha.as_ref().map_or(1.0, |a| a[i])]).collect();
    Ok(Image::new(layer.size.width(), Texels::Floats(texels)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_by_two() -> Image {
        let grey = |c: u8| [c, c, c, 255];
        Image::from_bytes(2, vec![grey(0), grey(255), grey(255), grey(0)])
    }

    #[test]
    fn texel_centres_are_texels_and_between_them_light_is_mixed() {
        let image = two_by_two();
        assert_eq!(image.bilinear([0.25, 0.25], [Wrap::Clamp; 2])[0], 0.0);
        assert_eq!(image.bilinear([0.75, 0.25], [Wrap::Clamp; 2])[0], 1.0);
        assert_eq!(image.bilinear([0.5, 0.25], [Wrap::Clamp; 2])[0], 0.5);
        assert_eq!(image.bilinear([0.0, 0.25], [Wrap::Repeat; 2])[0], 0.5);
        assert_eq!(image.bilinear([0.0, 0.25], [Wrap::Mirror; 2])[0], 0.0);
        assert_eq!(image.nearest([1.3, 0.25], [Wrap::Repeat; 2])[0], 0.0);
        assert_eq!(image.nearest([1.3, 0.25], [Wrap::Mirror; 2])[0], 1.0);
    }

    #[test]
    fn far_away_a_checkerboard_is_half_as_bright() {
        let mut image = two_by_two();
        image.make_mips();
        let far = image.trilinear([0.3, 0.9], [2.0, 0.0], [0.0, 2.0], [Wrap::Repeat; 2]);
        assert_eq!(far[0], 0.5);
        assert_eq!(srgb_byte(far[0]), 188);
    }

    #[test]
    fn every_byte_goes_to_light_and_back() {
        (0..=255u8).for_each(|b| assert_eq!(srgb_byte(LINEAR[b as usize]), b));
    }
}
