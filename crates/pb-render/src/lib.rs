//! Draws progressive buffers with wgpu: what another engine would embed.
//!
//! An engine opens a [`Gpu`], makes a [`Renderer`] from an archive's tables and coarsest chunks, uploads and
//! frees chunks as its cache says, and hands in one [`Scene`] per frame. The display rule runs in the vertex
//! shader (design section 3); its Rust twin is `pb_lod::progressive_buffers::display`.
//!
//! Must never: know of windows, user interfaces, files or threads; decide what is resident or drawn.

mod camera;
mod crowd;
mod draw_table;
mod error;
mod gpu;
mod gpu_model;
mod heap;
mod pipelines;
mod renderer;
mod share;
mod squares;
mod tables;
mod target;
mod texture_pool;
mod tiles;

pub use camera::{Camera, grid_eye};
pub use draw_table::{DrawTable, texture_floors};
pub use error::RenderError;
pub use gpu::Gpu;
pub use gpu_model::{AdapterLimits, ChunkData, Coarse, GpuModel, ModelTables, VramPlan};
pub use heap::{HeapFull, Move, Range, UNIT_BYTES};
pub use pipelines::{ColorMode, DISPLAY_WGSL, PictureFormat, ShaderKind, Style, shader_source};
pub use renderer::{BACKGROUND_SRGB, Renderer, Scene};
pub use squares::PagesFull;
pub use tables::{ClusterGpu, DrawArguments, DrawGpu, LevelGpu, StandGpu, ViewUniform};
pub use target::{Canvas, DEPTH_FORMAT, Offscreen, Samples, Surface};
pub use texture_pool::PageLimits;
