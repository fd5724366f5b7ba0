//! Frames on disk: PNG as seen, EXR in linear light.

use anyhow::{Context, Result};
use exr::prelude::{SpecificChannels, WritableImage};
use std::path::Path;

/// File format of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// 8 bits per channel, sRGB.
    Png,
    /// 16-bit float per channel, linear light.
    Exr,
}

impl Format {
    /// What the frame is drawn in.
    pub fn texture(self) -> wgpu::TextureFormat {
        match self {
            Format::Png => wgpu::TextureFormat::Rgba8UnormSrgb,
            Format::Exr => wgpu::TextureFormat::Rgba16Float,
        }
    }

    /// File name extension.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Png => "png",
            Format::Exr => "exr",
        }
    }

    /// Writes pixels of [`Format::texture`], rows from the top.
    pub fn write(self, path: &Path, size: [u32; 2], pixels: &[u8]) -> Result<()> {
        match self {
            Format::Png => write_png(path, size, pixels),
            Format::Exr => write_exr(path, size, pixels),
        }
        .with_context(|| format!("{}: cannot write the frame", path.display()))
    }
}

fn write_png(path: &Path, size: [u32; 2], pixels: &[u8]) -> Result<()> {
    let file = std::io::BufWriter::new(std::fs::File::create(path)?);
    // Frames are opaque: three channels say all.
    let rgb: Vec<u8> = pixels.chunks_exact(4).flat_map(|p| &p[..3]).copied().collect();
    let encoder = image::codecs::png::PngEncoder::new_with_quality(
        file,
        image::codecs::png::CompressionType::Fast,
        image::codecs::png::FilterType::Adaptive,
    );
    image::ImageEncoder::write_image(encoder, &rgb, size[0], size[1], image::ExtendedColorType::Rgb8)?;
    Ok(())
}

fn write_exr(path: &Path, size: [u32; 2], pixels: &[u8]) -> Result<()> {
    let (width, height) = (size[0] as usize, size[1] as usize);
    let bits: Vec<u16> = bytemuck::pod_collect_to_vec(pixels);
    let half = |i: usize| exr::prelude::f16::from_bits(bits[i]);
    let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
        let i = (at.y() * width + at.x()) * 4;
        (half(i), half(i + 1), half(i + 2))
    });
    exr::prelude::Image::from_channels((width, height), channels).write().to_file(path)?;
    Ok(())
}
