//! Reading a source image at a point, or averaged over the footprint of a tile's texel.

use super::color::{SRGB, UNORM, finite_light};
use super::image::{Image, TexelFormat};
use crate::material::{TextureRef, Wrap};
use glam::{DAffine2, DMat2, DVec2, Vec4};
use half::f16;

/// Most samples per axis of a footprint; beyond, samples are spread out.
const MAX_SAMPLES: f64 = 16.0;
/// Nearer than this to the centre of a source texel, in source texels, a copy is that texel.
const ON_CENTRE: f64 = 1.0 / 16.0;
/// Source texels whose centres are this little outside a chart are in it, texels of the tile.
const ON_RIM: f64 = 1.0 / 64.0;
/// Weight of colour under zero alpha: decides only where nothing else does.
const FAINT: f32 = 1e-6;
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

    /// The average around `at` over a footprint. Of the source's texels only those that `rim` keeps are used, if it keeps
    /// any.
    pub fn average(&self, at: DVec2, footprint: &Footprint, rim: Option<&Rim>) -> Vec4 {
        if footprint.copy && (at - at.floor() - 0.5).abs().max_element() <= ON_CENTRE
            || self.nearest && footprint.samples == [1, 1]
        {
            return self.texel(at.x.floor() as i64, at.y.floor() as i64);
        }
        rim.and_then(|rim| self.gather(at, footprint, |x, y| rim.keeps(DVec2::new(x as f64, y as f64) + 0.5)))
            .or_else(|| self.gather(at, footprint, |_, _| true))
            .unwrap_or(Vec4::ONE)
    }

    /// The average of the texels that `keep` accepts; `None` without any.
    fn gather(&self, at: DVec2, footprint: &Footprint, keep: impl Fn(i64, i64) -> bool) -> Option<Vec4> {
        let [nx, ny] = footprint.samples;
        let mut sum = Sum::default();
        for j in 0..ny {
            for i in 0..nx {
                let step = DVec2::new(middle(i, nx), middle(j, ny));
                self.bilinear(at + footprint.matrix * step, &keep, &mut sum);
            }
        }
        (sum.weight > 0.0).then(|| (sum.color / sum.color.w).with_w(sum.alpha / sum.weight))
    }

    fn bilinear(&self, at: DVec2, keep: &impl Fn(i64, i64) -> bool, sum: &mut Sum) {
        let corner = (at - 0.5).floor();
        let f = (at - 0.5 - corner).as_vec2();
        let (x, y) = (corner.x as i64, corner.y as i64);
        let weights = [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y];
        for (k, weight) in (0..4).zip(weights) {
            let (x, y) = (x + k % 2, y + k / 2);
            if weight > 0.0 && keep(x, y) {
                let texel = self.texel(x, y);
                let share = if self.by_alpha { texel.w + FAINT } else { 1.0 } * weight;
                sum.color += texel.with_w(1.0) * share;
                sum.alpha += texel.w * weight;
                sum.weight += weight;
            }
        }
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

/// Of texels under a footprint.
#[derive(Default)]
struct Sum {
    /// Colours times their shares; the sum of these.
    color: Vec4,
    /// Alpha times weight.
    alpha: f32,
    weight: f32,
}

/// The middle of part i of n, from one half below to one half above 0.
fn middle(i: u32, n: u32) -> f64 {
    (f64::from(i) + 0.5) / f64::from(n) - 0.5
}

/// The border of a chart near a texel of the tile: source texels beyond are of other charts, or of none.
pub(super) struct Rim<'a> {
    /// Edges in texels of the tile; the chart is on the side of positive cross products.
    edges: &'a [[DVec2; 2]],
    /// From source texels to texels of the tile.
    to_tile: DAffine2,
}

impl<'a> Rim<'a> {
    /// `None` without edges, and where the image is flat on the tile.
    pub fn new(edges: &'a [[DVec2; 2]], footprint: &Footprint, place: DVec2, corner: DVec2) -> Option<Rim<'a>> {
        let inverse = footprint.matrix.inverse();
        let usable = !edges.is_empty() && inverse.is_finite() && footprint.matrix.determinant().abs() > 1e-6;
        let to_tile = DAffine2::from_mat2_translation(inverse, corner - inverse * place);
        usable.then_some(Rim { edges, to_tile })
    }

    /// Whether a point of the source is in the chart: on the inner side of the nearest edge.
    fn keeps(&self, source: DVec2) -> bool {
        let at = self.to_tile.transform_point2(source);
        let mut nearest = (f64::INFINITY, 0.0);
        for &[a, b] in self.edges {
            let along = b - a;
            let side = along.perp_dot(at - a) / along.length();
            let on_edge = a + along * ((at - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            let distance = at.distance_squared(on_edge);
            // of two edges that meet in the nearest point, the one that is seen less obliquely decides
            let same = (distance - nearest.0).abs() <= 1e-9 * (1.0 + distance);
            let decides = if same { side.abs() > f64::abs(nearest.1) } else { distance < nearest.0 };
            if decides {
                nearest = (distance, side);
            }
        }
        nearest.1 >= -ON_RIM
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
}
