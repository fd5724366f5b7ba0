//! What is drawn to: depth and samples behind a colour image, and the way back into memory.
//!
//! Depth is 32-bit float, reversed: 1 at the near plane, 0 at infinity, so precision follows distance.

use crate::{error::RenderError, gpu::Gpu};

/// Depth format of every pipeline.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Depth, and samples per pixel where there are several, behind a colour image of the same size.
pub struct Canvas {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Samples that are averaged into a pixel.
    pub samples: Samples,
    samples_view: Option<wgpu::TextureView>,
    depth: wgpu::TextureView,
}

/// Where a pass stands among those of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FramePass {
    pub is_first: bool,
    pub is_last: bool,
}

/// Samples per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Samples {
    /// The pixel's centre: every colour is that of one surface point.
    One = 1,
    /// Four: edges are smooth, and things that move slowly change pixels slowly.
    Four = 4,
}

impl Canvas {
    /// For colour images of `size` pixels and `format`.
    pub fn new(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat, samples: Samples) -> Self {
        let view = |format| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
            texture(gpu, size, (format, samples), usage).create_view(&Default::default())
        };
        let samples_view = (samples != Samples::One).then(|| view(format));
        Self { size, samples, samples_view, depth: view(DEPTH_FORMAT) }
    }

    /// Begins to draw into `color`. The first pass of a frame clears it; only its last one may lose depth and samples.
    pub(crate) fn begin<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        color: &wgpu::TextureView,
        background: wgpu::Color,
        pass: FramePass,
    ) -> wgpu::RenderPass<'a> {
        let kept = if pass.is_last { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        let store = if self.samples_view.is_some() { kept } else { wgpu::StoreOp::Store };
        let cleared = pass.is_first;
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("clusters"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: self.samples_view.as_ref().unwrap_or(color),
                depth_slice: None,
                resolve_target: self.samples_view.as_ref().map(|_| color),
                ops: wgpu::Operations {
                    load: if cleared { wgpu::LoadOp::Clear(background) } else { wgpu::LoadOp::Load },
                    store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: if cleared { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load },
                    store: kept,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}

fn texture(
    gpu: &Gpu,
    size: [u32; 2],
    (format, samples): (wgpu::TextureFormat, Samples),
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: samples as u32,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// Where a frame is drawn to.
pub struct Surface<'a> {
    /// Colour, in the format that the renderer was made for.
    pub color: &'a wgpu::TextureView,
    /// Depth and samples of the same size.
    pub canvas: &'a Canvas,
}

/// An image to draw to without a window.
pub struct Offscreen {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Colour format.
    pub format: wgpu::TextureFormat,
    /// Colour, to draw to.
    pub color: wgpu::TextureView,
    /// What lies behind it.
    pub canvas: Canvas,
    texture: wgpu::Texture,
    staging: wgpu::Buffer,
    row_bytes: u32,
}

impl Offscreen {
    /// An image of `size` pixels: `Rgba8UnormSrgb` for display, `Rgba16Float` for linear light.
    /// Fails where the adapter cannot make images of this size.
    pub fn new(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat, samples: Samples) -> Result<Self, RenderError> {
        let limit = gpu.device.limits().max_texture_dimension_2d;
        if size[0].max(size[1]) > limit || size[0].min(size[1]) == 0 {
            let what = format!("images of {} x {} pixels (1 to {limit} each way)", size[0], size[1]);
            return Err(RenderError::Unsuitable { adapter: gpu.adapter.get_info().name, what });
        }
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let texture = texture(gpu, size, (format, Samples::One), usage);
        let pixel_bytes = format.block_copy_size(None).expect("colour formats have a size");
        let row_bytes = (size[0] * pixel_bytes).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let staging = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture read back"),
            size: row_bytes as u64 * size[1] as u64,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let color = texture.create_view(&Default::default());
        let canvas = Canvas::new(gpu, size, format, samples);
        Ok(Self { size, format, color, canvas, texture, staging, row_bytes })
    }

    /// What the renderer draws to.
    pub fn surface(&self) -> Surface<'_> {
        Surface { color: &self.color, canvas: &self.canvas }
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
