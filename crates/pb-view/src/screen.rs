//! The window's surface: its format, its size, and the next picture to draw into.

use anyhow::{Context, Result};
use pb_render::{Canvas, Gpu, PictureFormat, Samples};

/// What the window system has for the next frame.
pub enum Next {
    /// A picture to draw into.
    Picture(wgpu::SurfaceTexture),
    /// Nothing now; ask again.
    Later,
    /// Nothing, and nobody would see it; ask again at the next event.
    Hidden,
}

/// A surface, configured, and what lies behind its pictures.
pub struct Screen {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    /// Depth and samples of the window's size.
    pub canvas: Canvas,
}

impl Screen {
    /// Configures a surface of `size` pixels: an sRGB format where there is one, vertical sync.
    pub fn new(gpu: &Gpu, surface: wgpu::Surface<'static>, size: [u32; 2], samples: Samples) -> Result<Self> {
        let config = surface.get_default_config(&gpu.adapter, size[0].max(1), size[1].max(1));
        let mut config = config.context("the graphics adapter cannot draw to this window")?;
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        config.format = formats.iter().copied().find(|f| f.is_srgb()).unwrap_or(config.format);
        config.present_mode = wgpu::PresentMode::AutoVsync;
        surface.configure(&gpu.device, &config);
        let canvas = Canvas::new(gpu, [config.width, config.height], config.format, samples);
        Ok(Self { surface, config, canvas })
    }

    /// What pipelines have to draw to.
    pub fn format(&self) -> PictureFormat {
        PictureFormat { color: self.config.format, samples: self.canvas.samples }
    }

    /// Width over height.
    pub fn aspect(&self) -> f64 {
        self.config.width as f64 / self.config.height as f64
    }

    /// The window has another size now; a minimised one has none.
    pub fn resize(&mut self, gpu: &Gpu, size: [u32; 2]) {
        if size[0] == 0 || size[1] == 0 {
            return;
        }
        (self.config.width, self.config.height) = (size[0], size[1]);
        self.surface.configure(&gpu.device, &self.config);
        self.canvas = Canvas::new(gpu, size, self.config.format, self.canvas.samples);
    }

    /// The next picture of a window whose inner size is `size`.
    pub fn next(&mut self, gpu: &Gpu, size: [u32; 2]) -> Result<Next> {
        use wgpu::CurrentSurfaceTexture as Current;
        if size[0] == 0 || size[1] == 0 {
            return Ok(Next::Hidden);
        }
        match self.surface.get_current_texture() {
            Current::Success(picture) => return Ok(Next::Picture(picture)),
            // The old picture has to go before the surface is configured anew.
            Current::Suboptimal(picture) => drop(picture),
            Current::Outdated => {}
            Current::Timeout => return Ok(Next::Later),
            Current::Occluded => return Ok(Next::Hidden),
            Current::Lost | Current::Validation => {
                anyhow::bail!("the window's surface was lost; start the program again")
            }
        }
        self.resize(gpu, size);
        Ok(Next::Later)
    }
}
