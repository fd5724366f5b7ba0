//! PNG, JPEG, TIFF, BMP, TGA and WebP by the crate `image`, straight into the room where the texels stay.

use super::store::Store;
use super::{DecodeOptions, ImageError, MAX_IMAGE_SIDE};
use half::f16;
use image::{ColorType, ImageDecoder, ImageFormat, ImageReader, Limits};
use pb_mesh::texture::image::{Image, TexelFormat};
use std::io::Cursor;

/// Samples as a decoder delivers them, in the byte order of the machine.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sample {
    U8,
    U16,
    F32,
}

impl Sample {
    fn bytes(self) -> usize {
        match self {
            Sample::U8 => 1,
            Sample::U16 => 2,
            Sample::F32 => 4,
        }
    }
}

/// What the texels are in the end, and the samples that they are made of.
fn layout(color: ColorType) -> Option<(TexelFormat, Sample)> {
    Some(match color {
        ColorType::L8 => (TexelFormat::L8, Sample::U8),
        ColorType::La8 => (TexelFormat::La8, Sample::U8),
        ColorType::Rgb8 => (TexelFormat::Rgb8, Sample::U8),
        ColorType::Rgba8 => (TexelFormat::Rgba8, Sample::U8),
        ColorType::L16 => (TexelFormat::L8, Sample::U16),
        ColorType::La16 => (TexelFormat::La8, Sample::U16),
        ColorType::Rgb16 => (TexelFormat::Rgb8, Sample::U16),
        ColorType::Rgba16 => (TexelFormat::Rgba8, Sample::U16),
        ColorType::Rgb32F => (TexelFormat::RgbF16, Sample::F32),
        ColorType::Rgba32F => (TexelFormat::RgbaF16, Sample::F32),
        _ => return None,
    })
}

/// Decodes an image of a known format.
pub(super) fn read(bytes: &[u8], format: ImageFormat, options: &DecodeOptions) -> Result<Image, ImageError> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(MAX_IMAGE_SIDE);
    limits.max_image_height = Some(MAX_IMAGE_SIDE);
    // Of a decoder's own buffers, the widest texel that there is.
    limits.max_alloc = Some(options.max_texels.saturating_mul(16));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(ImageError::broken)?;
    let (width, height) = decoder.dimensions();
    super::decode::check_size(width.into(), height.into(), options)?;
    let color = decoder.color_type();
    let Some((texel, sample)) = layout(color) else {
        return Err(ImageError::broken(format!("its texels are {color:?}, which are not read")));
    };
    let texels = u64::from(width) * u64::from(height);
    let mut store = Store::new(texels * u64::from(color.bytes_per_pixel()), options)?;
    decoder.read_image(store.bytes_mut()).map_err(ImageError::broken)?;
    let length = narrow(store.bytes_mut(), sample);
    store.into_image(width, height, texel, length)
}

/// Texels by the header; 0 where it cannot be read.
pub(super) fn texels(bytes: &[u8], format: ImageFormat) -> u64 {
    let size = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions();
    size.map_or(0, |(width, height)| u64::from(width) * u64::from(height))
}

/// Rewrites samples of 16 bits as 8 and of 32 as half floats, in place. Returns the bytes that are left.
fn narrow(bytes: &mut [u8], sample: Sample) -> usize {
    let count = bytes.len() / sample.bytes();
    match sample {
        Sample::U8 => count,
        Sample::U16 => {
            for i in 0..count {
                let wide = u32::from(u16::from_ne_bytes([bytes[2 * i], bytes[2 * i + 1]]));
                bytes[i] = ((wide * 255 + 32_767) / 65_535) as u8;
            }
            count
        }
        Sample::F32 => {
            for i in 0..count {
                let wide = f32::from_ne_bytes(std::array::from_fn(|k| bytes[4 * i + k]));
                bytes[2 * i..2 * i + 2].copy_from_slice(&finite_half(wide).to_ne_bytes());
            }
            2 * count
        }
    }
}

/// The nearest half float; what is no number becomes 0, what is too large the largest.
pub(super) fn finite_half(x: f32) -> f16 {
    let most = f16::MAX.to_f32();
    if x.is_nan() { f16::ZERO } else { f16::from_f32(x.clamp(-most, most)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_round_to_the_nearest_of_eight() {
        let wide = [0u16, 128, 129, 257 * 7, 65_535, 65_406];
        let mut bytes: Vec<u8> = wide.iter().flat_map(|x| x.to_ne_bytes()).collect();
        let length = narrow(&mut bytes, Sample::U16);
        assert_eq!(bytes[..length], [0, 0, 1, 7, 255, 254]);
    }

    #[test]
    fn floats_become_finite_halves() {
        let halves = [f32::NAN, f32::INFINITY, -1e9, 0.5].map(|x| finite_half(x).to_f32());
        assert_eq!(halves, [0.0, 65_504.0, -65_504.0, 0.5]);
    }
}
