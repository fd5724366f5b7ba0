//! What is drawn to: a colour and a depth image, and the way back into memory.
//!
//! Depth is 32-bit float, reversed: 1 at the near plane, 0 at infinity, so precision follows distance.

use crate::{error::RenderError, gpu::Gpu};

/// Depth format of every pipeline.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Depth buffer of `size` pixels.
pub fn depth_view(gpu: &Gpu, size: [u32; 2]) -> wgpu::TextureView {
    texture(gpu, size, DEPTH_FORMAT, wgpu::TextureUsages::RENDER_ATTACHMENT).create_view(&Default::default())
}

fn texture(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat, usage: wgpu::TextureUsages) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// An image to draw to without a window.
pub struct Offscreen {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Colour format, 4 or 16 bytes per pixel.
    pub format: wgpu::TextureFormat,
    /// Colour, to draw to.
    pub color: wgpu::TextureView,
    /// Depth, to draw to.
    pub depth: wgpu::TextureView,
    texture: wgpu::Texture,
    staging: wgpu::Buffer,
    row_bytes: u32,
}

impl Offscreen {
    /// An image of `size` pixels: `Rgba8UnormSrgb` for display, `Rgba32Float` for linear light.
    /// Fails where the adapter cannot make images of this size.
    pub fn new(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat) -> Result<Self, RenderError> {
        let limit = gpu.device.limits().max_texture_dimension_2d;
        if size[0].max(size[1]) > limit || size[0].min(size[1]) == 0 {
            let what = format!("images of {} x {} pixels (1 to {limit} each way)", size[0], size[1]);
            return Err(RenderError::Unsuitable { adapter: gpu.adapter.get_info().name, what });
        }
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let texture = texture(gpu, size, format, usage);
        let pixel_bytes = format.block_copy_size(None).expect("colour formats have a size");
        let row_bytes = (size[0] * pixel_bytes).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let staging = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture read back"),
            size: row_bytes as u64 * size[1] as u64,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let color = texture.create_view(&Default::default());
        Ok(Self { size, format, color, depth: depth_view(gpu, size), texture, staging, row_bytes })
    }

    /// The colour image, rows from the top, without padding, in the bytes of its format.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<u8>, RenderError> {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            self.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &self.staging,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(self.row_bytes),
                    rows_per_image: None,
                },
            },
            self.texture.size(),
        );
        gpu.queue.submit([encoder.finish()]);
        let pixel_bytes = self.format.block_copy_size(None).expect("colour formats have a size");
        let used = (self.size[0] * pixel_bytes) as usize;
        gpu.map(&self.staging, |bytes| {
            bytes.chunks_exact(self.row_bytes as usize).flat_map(|row| &row[..used]).copied().collect()
        })
    }
}
