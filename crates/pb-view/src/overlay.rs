//! The status line in the window: text set on the processor, drawn as one box.
//!
//! Must never: touch a headless frame.

use font8x8::UnicodeFonts;
use pb_render::Gpu;

/// Most characters of the line.
const COLUMNS: u32 = 160;
/// Width and height of a letter, pixels of the bitmap.
const CELL: u32 = 8;
/// Empty rows above and below the letters.
const MARGIN: u32 = 3;
/// Screen rows per step of the letters' size.
const ROWS_PER_SCALE: u32 = 700;

const WIDTH: u32 = COLUMNS * CELL;
const HEIGHT: u32 = CELL + 2 * MARGIN;

/// The overlay's shader.
pub const WGSL: &str = include_str!("overlay.wgsl");

/// One line of text.
pub struct Overlay {
    pipeline: wgpu::RenderPipeline,
    group: wgpu::BindGroup,
    texture: wgpu::Texture,
    place: wgpu::Buffer,
    columns: u32,
}

/// The line as a bitmap, one byte per pixel, `WIDTH * HEIGHT`.
fn set_text(line: &str) -> Vec<u8> {
    let mut bitmap = vec![0u8; (WIDTH * HEIGHT) as usize];
    for (column, letter) in line.chars().take(COLUMNS as usize).enumerate() {
        let rows = font8x8::BASIC_FONTS.get(letter).unwrap_or([0; 8]);
        for (y, row) in rows.iter().enumerate() {
            for x in (0..CELL as usize).filter(|x| row >> x & 1 == 1) {
                bitmap[(y + MARGIN as usize) * WIDTH as usize + column * CELL as usize + x] = 255;
            }
        }
    }
    bitmap
}

impl Overlay {
    /// An empty line, to be drawn over pictures of `format`.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("overlay"),
            source: wgpu::ShaderSource::Wgsl(WGSL.into()),
        });
        let pipeline = pipeline(device, &module, format);
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("status line"),
            size: wgpu::Extent3d { width: WIDTH, height: HEIGHT, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let place = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("place of the status line"),
            size: 16,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let view = texture.create_view(&Default::default());
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("overlay"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: place.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&view) },
            ],
        });
        Self { pipeline, group, texture, place, columns: 0 }
    }

    /// Sets the line; letters outside ASCII stay blank, what is past the end is cut.
    pub fn set(&mut self, gpu: &Gpu, line: &str) {
        self.columns = (line.chars().count() as u32).min(COLUMNS);
        gpu.queue.write_texture(
            self.texture.as_image_copy(),
            &set_text(line),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(WIDTH), rows_per_image: None },
            self.texture.size(),
        );
    }

    /// Draws the line into the upper left corner of `color`, `size` pixels.
    pub fn draw(&self, gpu: &Gpu, color: &wgpu::TextureView, size: [u32; 2]) {
        let scale = (size[1] / ROWS_PER_SCALE).max(1);
        let (w, h) = (2.0 * (WIDTH * scale) as f32 / size[0] as f32, 2.0 * (HEIGHT * scale) as f32 / size[1] as f32);
        gpu.queue.write_buffer(&self.place, 0, bytemuck::bytes_of(&[-1.0, 1.0 - h, w, h]));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("overlay"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: color,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
                })],
                ..Default::default()
            });
            pass.set_scissor_rect(0, 0, (self.columns * CELL * scale).clamp(1, size[0]), size[1]);
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.group, &[]);
            pass.draw(0..4, 0..1);
        }
        gpu.queue.submit([encoder.finish()]);
    }
}

fn pipeline(device: &wgpu::Device, module: &wgpu::ShaderModule, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("overlay"),
        layout: None,
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vs_box"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState { topology: wgpu::PrimitiveTopology::TriangleStrip, ..Default::default() },
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("fs_text"),
            compilation_options: Default::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format,
                blend: Some(wgpu::BlendState::ALPHA_BLENDING),
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_set_side_by_side() {
        let bitmap = set_text("I l");
        let ink = |column: u32| {
            (0..HEIGHT)
                .flat_map(|y| (0..CELL).map(move |x| (y * WIDTH + column * CELL + x) as usize))
                .filter(|&i| bitmap[i] > 0)
                .count()
        };
        assert!(ink(0) > 10 && ink(1) == 0 && ink(2) > 8 && ink(3) == 0);
        assert_eq!(set_text(&"x".repeat(1000)).len(), (WIDTH * HEIGHT) as usize);
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(WGSL).unwrap();
        let mut validator =
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
        validator.validate(&module).unwrap();
    }
}
