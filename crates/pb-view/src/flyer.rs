//! What a flight without a window flies: a model that is drawn into a picture, or, with `--no-draw`, one that is only
//! streamed, without an adapter.

use anyhow::Result;
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::model::Model;
use pb_render::{AdapterLimits, Gpu, Offscreen, PictureFormat, Style, VramPlan};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::args::Args;
use crate::feed::{DiskClock, Feed};
use crate::stage::Stage;
use crate::stats::FrameStats;
use crate::streaming::{Moment, NoAdapter, Streaming, VramCosts, model_tables};

/// What flies.
pub enum Flyer {
    /// With pictures.
    Drawn(Box<Drawn>),
    /// Without.
    Undrawn(Box<Undrawn>),
}

/// A model, an adapter and a picture.
pub struct Drawn {
    gpu: Gpu,
    target: Offscreen,
    stage: Stage,
    adapter_time: Duration,
}

/// A model whose chunks come and go as if it were drawn.
pub struct Undrawn {
    streaming: Streaming,
    plan: VramPlan,
    /// What is in VRAM from the start: all, and the textures' part of it.
    start_bytes: [u64; 2],
}

impl Flyer {
    /// Opens what `args` ask for.
    pub fn new(args: &Args, model: Arc<Model>) -> Result<Self> {
        if args.no_draw {
            return Ok(Self::Undrawn(Box::new(Undrawn::new(args, model)?)));
        }
        let start = Instant::now();
        let mut gpu = Gpu::headless()?;
        let adapter_time = start.elapsed();
        gpu.texture_blocks = args.textures.blocks(&gpu);
        if args.wireframe && !gpu.wireframe {
            eprintln!("pb-view: warning: the graphics adapter cannot draw lines; surfaces are drawn filled");
        }
        let target = Offscreen::new(&gpu, args.size, args.format.texture(), args.samples)?;
        let format = PictureFormat { color: target.format, samples: args.samples };
        let mut stage = Stage::new(&gpu, model, args.bounds(), format)?;
        stage.streaming.feed.set_late_frames(args.late_frames);
        if let Some(disk) = args.disk_model {
            stage.streaming.feed.set_disk(disk, DiskClock::Frames);
        }
        if args.plain_draws {
            stage.renderer.set_multi_draw(&gpu, false);
        }
        Ok(Self::Drawn(Box::new(Drawn { gpu, target, stage, adapter_time })))
    }

    /// What is here, and what is under way.
    pub fn streaming(&self) -> &Streaming {
        match self {
            Self::Drawn(d) => &d.stage.streaming,
            Self::Undrawn(u) => &u.streaming,
        }
    }

    /// The same, to be changed.
    pub fn streaming_mut(&mut self) -> &mut Streaming {
        match self {
            Self::Drawn(d) => &mut d.stage.streaming,
            Self::Undrawn(u) => &mut u.streaming,
        }
    }

    /// What draws, if anything does.
    pub fn gpu(&self) -> Option<&Gpu> {
        match self {
            Self::Drawn(d) => Some(&d.gpu),
            Self::Undrawn(_) => None,
        }
    }

    /// How long it took to find the graphics adapter and to make a device of it.
    pub fn adapter_time(&self) -> Duration {
        match self {
            Self::Drawn(d) => d.adapter_time,
            Self::Undrawn(_) => Duration::ZERO,
        }
    }

    /// How the bound on VRAM is spent.
    pub fn vram_plan(&self) -> &VramPlan {
        match self {
            Self::Drawn(d) => d.stage.renderer.model.plan(),
            Self::Undrawn(u) => &u.plan,
        }
    }

    /// One frame; how long it took to build and submit the draw commands, milliseconds.
    pub fn frame(&mut self, moment: &Moment, settle: bool, style: Style) -> Result<f64> {
        match self {
            Self::Undrawn(u) if settle => u.streaming.settle(&mut NoAdapter, moment)?,
            Self::Undrawn(u) => u.streaming.advance(&mut NoAdapter, moment),
            Self::Drawn(d) => return d.frame(moment, settle, style),
        }
        Ok(0.0)
    }

    /// Numbers of the last frame.
    pub fn stats(&self) -> FrameStats {
        match self {
            Self::Drawn(d) => d.stage.stats(),
            Self::Undrawn(u) => u.stats(),
        }
    }

    /// Size and pixels of the last picture, if there is one.
    pub fn picture(&self) -> Result<Option<([u32; 2], Vec<u8>)>> {
        match self {
            Self::Drawn(d) => Ok(Some((d.target.size, d.target.read(&d.gpu)?))),
            Self::Undrawn(_) => Ok(None),
        }
    }
}

impl Drawn {
    fn frame(&mut self, moment: &Moment, settle: bool, style: Style) -> Result<f64> {
        match settle {
            true => self.stage.settle(&self.gpu, moment)?,
            false => self.stage.advance(&self.gpu, moment),
        }
        let drawing = Instant::now();
        self.stage.draw(&self.gpu, &self.target.surface(), moment, style);
        let draw_ms = drawing.elapsed().as_secs_f64() * 1e3;
        self.gpu.wait()?;
        Ok(draw_ms)
    }
}

impl Undrawn {
    fn new(args: &Args, model: Arc<Model>) -> Result<Self> {
        let tables = model_tables(&model);
        let plan = VramPlan::new(&tables, args.vram, &AdapterLimits::COMMON)?;
        let costs = VramCosts::new(&tables, &plan);
        let is_tail = |c: &ChunkId| model.is_texture(*c) && model.always_resident(*c);
        let tails = (0..model.chunk_count()).map(ChunkId).filter(is_tail);
        let tails: u64 = tails.map(|c| costs.chunks[c.0 as usize]).sum();
        let start_bytes = [plan.start_bytes() + tails, tails];
        let feed = Feed::unread(model.clone(), args.disk_model.unwrap_or_default());
        Ok(Self { streaming: Streaming::new(model, &costs, args.bounds(), feed)?, plan, start_bytes })
    }

    fn stats(&self) -> FrameStats {
        let [all, textures] = self.start_bytes;
        let stats = self.streaming.stats();
        let (vram_bytes, texture_vram_bytes) = (all + stats.vram_bytes, textures + stats.texture_vram_bytes);
        FrameStats { vram_bytes, texture_vram_bytes, ..stats }
    }
}
