//! Texels as tiles store them, and the way to linear light and back.

use glam::{Vec2, Vec3, Vec4};
use half::f16;
use std::sync::LazyLock;

/// Largest finite half float.
const MAX_HALF: f32 = 65504.0;

/// Linear light of an 8-bit sRGB value (IEC 61966-2-1).
pub(super) static SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| srgb_to_linear(i as f64 / 255.0) as f32));

/// An 8-bit value as a part of 255.
pub(super) static UNORM: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|i| i as f32 / 255.0));

/// Steps of linear light in [`FIRST_GUESS`].
const GUESSES: usize = 4096;

/// The linear light from which on a colour is rounded to `i + 1`.
static ROUNDED_UP: LazyLock<[f32; 255]> =
    LazyLock::new(|| std::array::from_fn(|i| srgb_to_linear((i as f64 + 0.5) / 255.0) as f32));

/// The smallest 8-bit sRGB value in each step of linear light.
static FIRST_GUESS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let value = |step: usize| ROUNDED_UP.partition_point(|&t| t <= step as f32 / GUESSES as f32) as u8;
    (0..=GUESSES).map(value).collect()
});

fn srgb_to_linear(c: f64) -> f64 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// The nearest 8-bit sRGB value of linear light; NaN is 0.
pub(super) fn to_srgb(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let mut value = FIRST_GUESS[(linear * GUESSES as f32) as usize];
    while value < 255 && linear >= ROUNDED_UP[value as usize] {
        value += 1;
    }
    value
}

/// The nearest multiple of 1 / 255, halves upwards; NaN is 0.
pub(super) fn to_unorm(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// What light of any bits counts as: finite, not negative; NaN is 0.
pub(super) fn finite_light(x: f32) -> f32 {
    if x > 0.0 { x.min(MAX_HALF) } else { 0.0 }
}

/// The nearest half float of finite light.
pub(super) fn to_half(x: f32) -> u16 {
    f16::from_f32(finite_light(x)).to_bits()
}

/// What the numbers of a texel mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Coding {
    /// [`Texels::Rgba8`]: sRGB colour, linear straight alpha.
    Srgb8,
    /// [`Texels::Rgba8`]: linear numbers.
    Linear8,
    /// [`Texels::Rg8`]: x and y of a unit vector as `2 c - 1`; z is not negative.
    Normal2,
    /// [`Texels::Rgba8`]: a unit vector as `2 c - 1`.
    Normal3,
    /// [`Texels::RgbaF16`]: linear light, not negative, finite; linear straight alpha.
    Half,
}

impl Coding {
    /// Whether texels are unit vectors.
    pub(super) fn is_normal(self) -> bool {
        matches!(self, Coding::Normal2 | Coding::Normal3)
    }
}

/// The texels of one image, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// Four channels of 8 bits.
    Rgba8(Vec<[u8; 4]>),
    /// Two channels of 8 bits.
    Rg8(Vec<[u8; 2]>),
    /// Four IEEE half floats.
    RgbaF16(Vec<[u16; 4]>),
}

impl Texels {
    /// `count` texels of zeros.
    pub(super) fn zeros(coding: Coding, count: usize) -> Texels {
        match coding {
            Coding::Srgb8 | Coding::Linear8 | Coding::Normal3 => Texels::Rgba8(vec![[0; 4]; count]),
            Coding::Normal2 => Texels::Rg8(vec![[0; 2]; count]),
            Coding::Half => Texels::RgbaF16(vec![[0; 4]; count]),
        }
    }

    /// Number of texels.
    pub fn len(&self) -> usize {
        match self {
            Texels::Rgba8(t) => t.len(),
            Texels::Rg8(t) => t.len(),
            Texels::RgbaF16(t) => t.len(),
        }
    }

    /// True without texels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A texel in linear light; of normals the unit vector.
    pub(super) fn get(&self, coding: Coding, index: usize) -> Vec4 {
        match (self, coding) {
            (Texels::Rgba8(t), Coding::Srgb8) => {
                let [r, g, b, a] = t[index].map(usize::from);
                Vec4::new(SRGB[r], SRGB[g], SRGB[b], UNORM[a])
            }
            (Texels::Rgba8(t), Coding::Normal3) => {
                let [x, y, z, _] = t[index].map(|c| UNORM[usize::from(c)] * 2.0 - 1.0);
                Vec3::new(x, y, z).normalize_or(Vec3::Z).extend(1.0)
            }
            (Texels::Rgba8(t), _) => Vec4::from_array(t[index].map(|c| UNORM[usize::from(c)])),
            (Texels::Rg8(t), _) => {
                let xy = Vec2::from_array(t[index].map(|c| UNORM[usize::from(c)] * 2.0 - 1.0));
                let z = (1.0 - xy.length_squared()).max(0.0).sqrt();
                xy.extend(z).normalize_or(Vec3::Z).extend(1.0)
            }
            (Texels::RgbaF16(t), _) => Vec4::from_array(t[index].map(|h| f16::from_bits(h).to_f32())),
        }
    }

    /// Stores a texel of linear light; of normals any vector along it.
    pub(super) fn set(&mut self, coding: Coding, index: usize, value: Vec4) {
        let signed = |v: Vec3| (v.normalize_or(Vec3::Z) * 0.5 + 0.5).to_array().map(to_unorm);
        match self {
            Texels::Rgba8(t) => {
                t[index] = match coding {
                    Coding::Srgb8 => [to_srgb(value.x), to_srgb(value.y), to_srgb(value.z), to_unorm(value.w)],
                    Coding::Normal3 => {
                        let [x, y, z] = signed(value.truncate());
                        [x, y, z, 255]
                    }
                    _ => value.to_array().map(to_unorm),
                }
            }
            Texels::Rg8(t) => {
                let [x, y, _] = signed(value.truncate());
                t[index] = [x, y];
            }
            Texels::RgbaF16(t) => t[index] = value.to_array().map(to_half),
        }
    }

    /// Copies texels onto others of the same list, in order.
    pub(super) fn copy(&mut self, from_to: impl Iterator<Item = (u32, u32)>) {
        fn all<T: Copy>(texels: &mut [T], from_to: impl Iterator<Item = (u32, u32)>) {
            from_to.for_each(|(from, to)| texels[to as usize] = texels[from as usize]);
        }
        match self {
            Texels::Rgba8(t) => all(t, from_to),
            Texels::Rg8(t) => all(t, from_to),
            Texels::RgbaF16(t) => all(t, from_to),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_the_way_to_linear_light_and_back() {
        for c in 0..=255u8 {
            assert_eq!((to_srgb(SRGB[c as usize]), to_unorm(UNORM[c as usize])), (c, c));
        }
        assert_eq!([to_srgb(-1.0), to_srgb(2.0), to_srgb(f32::NAN), to_unorm(f32::NAN)], [0, 255, 0, 0]);
        assert_eq!(to_half(f32::INFINITY), to_half(MAX_HALF));
    }

    #[test]
    fn colours_are_rounded_to_the_nearest() {
        for i in 0..10_000 {
            let linear = (i as f32 + 0.5) / 10_000.0;
            let exact = if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
            assert!((exact * 255.0 - f32::from(to_srgb(linear))).abs() < 0.501, "{linear}");
        }
    }
}
