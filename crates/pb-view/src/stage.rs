//! A model on its way from the file to the picture: [`Streaming`] and the renderer.
//!
//! Must never: draw what is not resident.

use anyhow::{Context, Result};
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::switch::Switch;
use pb_render::{ChunkData, Coarse, Gpu, PictureFormat, Renderer, Scene, Style, Surface, grid_eye};
use std::sync::Arc;

use crate::feed::{CoarseChunks, Feed, Loaded, chunk_data};
use crate::stats::FrameStats;
use crate::streaming::{Adapter, Bounds, Moment, Streaming, VramCosts, model_tables};

/// A model that is streamed and drawn.
pub struct Stage {
    /// What is here, and what is under way.
    pub streaming: Streaming,
    /// What draws it.
    pub renderer: Renderer,
    /// What the adapter's switch distances were made for.
    switch: Option<Switch>,
}

/// The renderer's model on its adapter.
struct OnGpu<'a> {
    gpu: &'a Gpu,
    renderer: &'a mut Renderer,
}

impl Adapter for OnGpu<'_> {
    fn upload(&mut self, chunk: ChunkId, data: &Loaded) -> bool {
        let model = &mut self.renderer.model;
        match data {
            Loaded::Geometry(data) => model.upload(self.gpu, chunk, chunk_data(data)).is_ok(),
            Loaded::Texture(bytes) => model.upload_texture(self.gpu, chunk, bytes).is_ok(),
            Loaded::Unread => unreachable!("what is drawn was read"),
        }
    }

    fn free(&mut self, chunk: ChunkId) {
        self.renderer.model.free(chunk);
    }
}

impl Stage {
    /// Decodes the coarsest level, makes all buffers, starts the loader threads. Fails when a coarsest chunk is
    /// damaged, because nothing could stand in for it, and when a bound is too small.
    pub fn new(gpu: &Gpu, model: Arc<Model>, bounds: Bounds, picture: PictureFormat) -> Result<Self> {
        let tables = model_tables(&model);
        let coarse =
            CoarseChunks::read(&model).context("the coarsest level cannot be read, so nothing can be drawn")?;
        let data: Vec<ChunkData> = coarse.chunks.iter().map(chunk_data).collect();
        let tails: Vec<&[u8]> = coarse.tails.iter().map(|t| &**t).collect();
        let coarse = Coarse { chunks: &data, tails: &tails };
        let renderer = Renderer::new(gpu, &tables, &coarse, bounds.vram_bytes, picture)?;
        let costs = VramCosts::new(&tables, renderer.model.plan());
        let streaming = Streaming::new(model.clone(), &costs, bounds, Feed::new(model))?;
        Ok(Self { streaming, renderer, switch: None })
    }

    /// One frame: what is here is drawn, what is wanted is asked for.
    pub fn advance(&mut self, gpu: &Gpu, moment: &Moment) {
        self.streaming.advance(&mut OnGpu { gpu, renderer: &mut self.renderer }, moment);
        self.set_distances(gpu, moment);
    }

    /// One frame that waits until all that is wanted and fits is here, and floors stand still.
    pub fn settle(&mut self, gpu: &Gpu, moment: &Moment) -> Result<()> {
        self.streaming.settle(&mut OnGpu { gpu, renderer: &mut self.renderer }, moment)?;
        self.set_distances(gpu, moment);
        Ok(())
    }

    /// Brings the adapter's switch distances up to the plan's detail.
    fn set_distances(&mut self, gpu: &Gpu, moment: &Moment) {
        let detail = self.streaming.detail(moment);
        let angle = self.streaming.camera(&moment.key).pixel_angle(moment.size);
        let switch = Switch::new(detail, angle, self.model().record().quantum);
        if self.switch != Some(switch) {
            self.renderer.set_distances(gpu, self.streaming.selector().distances(&switch));
            self.switch = Some(switch);
        }
    }

    /// The open archive.
    pub fn model(&self) -> &Arc<Model> {
        &self.streaming.model
    }

    /// Draws the last step's plan.
    pub fn draw(&self, gpu: &Gpu, surface: &Surface, moment: &Moment, style: Style) {
        let camera = self.streaming.camera(&moment.key);
        let eye = grid_eye(self.model().record(), camera.eye);
        self.renderer.draw(gpu, surface, &Scene { plan: self.streaming.plan(), camera: &camera, eye, style });
    }

    /// Numbers of the last step.
    pub fn stats(&self) -> FrameStats {
        let model = &self.renderer.model;
        let (vram_bytes, texture_vram_bytes) = (model.vram_bytes(), model.texture_vram_bytes());
        FrameStats { vram_bytes, texture_vram_bytes, ..self.streaming.stats() }
    }
}
