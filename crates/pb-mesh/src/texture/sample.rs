//! Reading a source image at a point, or averaged over the footprint of a tile's texel.

use super::color::{SRGB, UNORM, finite_light};
use super::image::{Image, TexelFormat};
use crate::material::{TextureRef, Wrap};
use glam::{DMat2, DVec2, Vec4};
use half::f16;

/// Most samples per axis of a footprint; beyond, samples are spread out.
const MAX_SAMPLES: f64 = 16.0;
/// Nearer than this to the centre of a source texel, in source texels, a copy is that texel.
const ON_CENTRE: f64 = 1.0 / 16.0;
/// Weight of colour under zero alpha: decides only where nothing else does.
const FAINT: f32 = 1.0 / 4096.0;
/// Coordinates beyond are not told apart, source texels.
const FAR: f64 = 1e12;

/// How numbers of 8 bits become linear ones.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Light {
    /// Colours: red, green and blue are sRGB.
    Srgb,
    /// Data.
    Linear,
}

/// An image as one slot of a material shows it.
#[derive(Clone, Copy)]
pub(super) struct Sampler<'a> {
    bytes: &'a [u8],
    width: i64,
    height: i64,
    format: TexelFormat,
    table: &'static [f32; 256],
    wrap: [Wrap; 2],
    nearest: bool,
    /// Averages are weighted by alpha.
    by_alpha: bool,
}

impl<'a> Sampler<'a> {
    pub fn new(image: &'a Image, reference: &TextureRef, light: Light, by_alpha: bool) -> Sampler<'a> {
        Sampler {
            bytes: image.bytes(),
            width: i64::from(image.width()),
            height: i64::from(image.height()),
            format: image.format(),
            table: if light == Light::Srgb { &SRGB } else { &UNORM },
            wrap: reference.wrap,
            nearest: reference.nearest,
            by_alpha: by_alpha && image.format().has_alpha(),
        }
    }

    /// The source texel coordinates of a texture coordinate; the first texel reaches from 0 to 1.
    pub fn place(&self, reference: &TextureRef, uv: [f32; 2]) -> DVec2 {
        let [u, v] = uv.map(f64::from);
        let row = |t: [f32; 3]| f64::from(t[0]) * u + f64::from(t[1]) * v + f64::from(t[2]);
        let at = DVec2::new(
            row(reference.transform[0]) * self.width as f64,
            row(reference.transform[1]) * self.height as f64,
        );
        if at.is_finite() { at.clamp(DVec2::splat(-FAR), DVec2::splat(FAR)) } else { DVec2::ZERO }
    }

    /// The average around `at` over a footprint: the columns are what one texel of the tile to the right and one
    /// downwards are in source texels.
    pub fn average(&self, at: DVec2, footprint: &Footprint) -> Vec4 {
        if footprint.copy {
            let centre = at.floor() + 0.5;
            if (at - centre).abs().max_element() <= ON_CENTRE {
                return self.texel(at.x.floor() as i64, at.y.floor() as i64);
            }
        }
        let [nx, ny] = footprint.samples;
        if nx * ny == 1 {
            return self.point(at);
        }
        let mut sum = Vec4::ZERO;
        let (mut alpha, mut weights) = (0.0, 0.0);
        for j in 0..ny {
            for i in 0..nx {
                let step =
                    DVec2::new((f64::from(i) + 0.5) / f64::from(nx) - 0.5, (f64::from(j) + 0.5) / f64::from(ny) - 0.5);
                let texel = self.bilinear(at + footprint.matrix * step);
                let weight = if self.by_alpha { texel.w + FAINT } else { 1.0 };
                sum += texel * weight;
                alpha += texel.w;
                weights += weight;
            }
        }
        (sum / weights).truncate().extend(alpha / (nx * ny) as f32)
    }

    fn point(&self, at: DVec2) -> Vec4 {
        if self.nearest { self.texel(at.x.floor() as i64, at.y.floor() as i64) } else { self.bilinear(at) }
    }

    fn bilinear(&self, at: DVec2) -> Vec4 {
        let corner = (at - 0.5).floor();
        let f = (at - 0.5 - corner).as_vec2();
        let (x, y) = (corner.x as i64, corner.y as i64);
        let texels = [self.texel(x, y), self.texel(x + 1, y), self.texel(x, y + 1), self.texel(x + 1, y + 1)];
        let mut weights = [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y];
        let alpha: f32 = texels.iter().zip(weights).map(|(t, w)| t.w * w).sum();
        if self.by_alpha {
            weights.iter_mut().zip(&texels).for_each(|(w, t)| *w *= t.w + FAINT);
        }
        let sum: Vec4 = texels.iter().zip(weights).map(|(t, w)| *t * w).sum();
        let total: f32 = if self.by_alpha { weights.iter().sum() } else { 1.0 };
        (sum / total).truncate().extend(alpha)
    }

    /// A texel, in linear light; alpha is 1 where there is none.
    fn texel(&self, x: i64, y: i64) -> Vec4 {
        let (x, y) = (wrapped(x, self.width, self.wrap[0]), wrapped(y, self.height, self.wrap[1]));
        let bytes = &self.bytes[(y * self.width + x) as usize * self.format.bytes()..];
        let color = |k: usize| self.table[usize::from(bytes[k])];
        let alpha = |k: usize| UNORM[usize::from(bytes[k])];
        let half = |k: usize| finite_light(f16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]]).to_f32());
        match self.format {
            TexelFormat::L8 => Vec4::splat(color(0)).with_w(1.0),
            TexelFormat::La8 => Vec4::splat(color(0)).with_w(alpha(1)),
            TexelFormat::Rgb8 => Vec4::new(color(0), color(1), color(2), 1.0),
            TexelFormat::Rgba8 => Vec4::new(color(0), color(1), color(2), alpha(3)),
            TexelFormat::RgbF16 => Vec4::new(half(0), half(1), half(2), 1.0),
            TexelFormat::RgbaF16 => Vec4::new(half(0), half(1), half(2), half(3).min(1.0)),
        }
    }
}

fn wrapped(k: i64, size: i64, wrap: Wrap) -> i64 {
    if (0..size).contains(&k) {
        return k;
    }
    match wrap {
        Wrap::Clamp => k.clamp(0, size - 1),
        Wrap::Repeat => k.rem_euclid(size),
        Wrap::Mirror => {
            let k = k.rem_euclid(2 * size);
            if k < size { k } else { 2 * size - 1 - k }
        }
    }
}

/// What a texel of the tile is in an image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Source texels per texel of the tile: the columns belong to one texel to the right and one downwards.
    matrix: DMat2,
    /// Along the columns.
    samples: [u32; 2],
    /// Texels are as large as the source's and lie along its axes.
    copy: bool,
}

impl Footprint {
    /// `tolerance`: how uncertain the entries of the matrix are, because corners are rounded to integers.
    pub fn new(matrix: DMat2, tolerance: f64) -> Footprint {
        let matrix = if matrix.is_finite() { matrix } else { DMat2::ZERO };
        let slack = 0.01 + tolerance.min(0.2);
        let count = |column: DVec2| (column.length() - slack).ceil().clamp(1.0, MAX_SAMPLES) as u32;
        let close = |a: f64, b: f64| (a.abs() - b).abs() <= slack;
        let axes = matrix.to_cols_array();
        let copy = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]]
            .iter()
            .any(|unit| axes.iter().zip(unit).all(|(&a, &b)| close(a, b)));
        Footprint { matrix, samples: [count(matrix.x_axis), count(matrix.y_axis)], copy }
    }

    /// Whether texels at the centres of source texels are copies.
    pub fn is_copy(&self) -> bool {
        self.copy
    }
}
