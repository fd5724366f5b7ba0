//! Opens a graphics adapter, with or without a window.
//!
//! Must never: ask for a feature that the adapter does not have. What is optional is written in [`Gpu`] as a
//! flag, and every user of a flag has a plain way beside it.

use crate::error::RenderError;

/// Storage buffers that one shader stage binds.
const STORAGE_BUFFERS: u32 = 8;

/// An opened adapter.
pub struct Gpu {
    /// The instance; surfaces are made from it.
    pub instance: wgpu::Instance,
    /// The adapter.
    pub adapter: wgpu::Adapter,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Indirect draws may carry a first instance, so many clusters go in one call.
    pub multi_draw: bool,
    /// Triangles can be drawn as lines.
    pub wireframe: bool,
    /// Fragments know their triangle's index.
    pub primitive_index: bool,
    /// Block-compressed texels (BC) can be read as they are; else they are decoded before they are uploaded.
    pub texture_blocks: bool,
}

impl Gpu {
    /// Opens the best adapter without a window. Fails with [`RenderError::NoAdapter`] where there is none.
    pub fn headless() -> Result<Self, RenderError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        Self::open(instance, None)
    }

    /// Opens the best adapter of `instance` that can present to `surface`, or any where that is `None`.
    pub fn open(instance: wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self, RenderError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|e| RenderError::NoAdapter(e.to_string()))?;
        let name = adapter.get_info().name;
        let offered = adapter.features();
        let limits = adapter.limits();
        if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
            let what = format!("{STORAGE_BUFFERS} storage buffers per shader stage");
            return Err(RenderError::Unsuitable { adapter: name, what });
        }
        let optional = wgpu::Features::INDIRECT_FIRST_INSTANCE
            | wgpu::Features::POLYGON_MODE_LINE
            | wgpu::Features::PRIMITIVE_INDEX
            | wgpu::Features::TEXTURE_COMPRESSION_BC;
        let features = offered & optional;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("pb-render"),
            required_features: features,
            required_limits: limits,
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| RenderError::Device { adapter: name, reason: e.to_string() })?;
        Ok(Self {
            instance,
            adapter,
            device,
            queue,
            multi_draw: features.contains(wgpu::Features::INDIRECT_FIRST_INSTANCE),
            wireframe: features.contains(wgpu::Features::POLYGON_MODE_LINE),
            primitive_index: features.contains(wgpu::Features::PRIMITIVE_INDEX),
            texture_blocks: features.contains(wgpu::Features::TEXTURE_COMPRESSION_BC),
        })
    }

    /// True where the adapter is a program on the CPU (Mesa's lavapipe, WARP).
    pub fn software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Largest buffer that a shader can see whole, bytes.
    pub fn largest_storage_bytes(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Waits until everything submitted so far is done.
    pub fn wait(&self) -> Result<(), RenderError> {
        let wait = wgpu::PollType::wait_indefinitely();
        self.device.poll(wait).map(|_| ()).map_err(|e| RenderError::Lost(e.to_string()))
    }

    /// Copies `buffer` (usage COPY_SRC) into memory.
    pub fn read_buffer(&self, buffer: &wgpu::Buffer) -> Result<Vec<u8>, RenderError> {
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: buffer.size(),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, buffer.size());
        self.queue.submit([encoder.finish()]);
        self.map(&staging, <[u8]>::to_vec)
    }

    /// Maps `staging` (usage MAP_READ) once its copies are done and hands its bytes to `read`.
    pub(crate) fn map<T>(&self, staging: &wgpu::Buffer, read: impl FnOnce(&[u8]) -> T) -> Result<T, RenderError> {
        let (send, receive) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver lives until the end of this function, which waits for this callback.
            let _ = send.send(result);
        });
        self.wait()?;
        let mapped = receive.recv().map_err(|e| RenderError::Lost(e.to_string()))?;
        mapped.map_err(|e| RenderError::Lost(e.to_string()))?;
        let view = staging.get_mapped_range(..).map_err(|e| RenderError::Lost(e.to_string()))?;
        let out = read(&view);
        drop(view);
        staging.unmap();
        Ok(out)
    }
}
