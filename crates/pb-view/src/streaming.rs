//! Selection, cache and loader, brought together for one model: the part of the frame loop that needs no adapter.
//!
//! Per frame: select -> wants -> cache -> loads, uploads, frees. What has a place for chunks is an [`Adapter`]: the
//! renderer's model, or, where nothing is drawn, [`NoAdapter`]. Must never: block on a loader, except to settle; decide by
//! itself what is loaded.

use anyhow::{Context, Result};
use pb_lod::plan::{ChunkId, Class, Detail, Frame, Plan, Prefetch, View, Want};
use pb_lod::progressive_buffers::model::{Model, ModelError, Placed};
use pb_lod::progressive_buffers::select::{SelectTables, Selector};
use pb_render::{Camera, ModelTables, VramPlan, grid_eye};
use pb_stream::cache::{ChunkInfo, Command, Limits};
use pb_stream::journal::Recorded;
use pb_stream::loader::LoadResult;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use crate::exchange::Exchange;
use crate::export::ShownFrame;
use crate::feed::{Feed, Loaded};
use crate::flypath::Keyframe;
use crate::meter::Meter;
use crate::navigate::Subject;
use crate::prefetch::{Expected, Latency};
use crate::stats::FrameStats;
use crate::upload_pace::UploadPace;

/// Near plane over the model's diameter. Depth is reversed float, so that a small one costs nothing.
const NEAR: f64 = 1e-6;
/// More bytes than any bound has: of chunks that are never wanted, and small enough to be summed up.
const NEVER_FITS: u64 = 1 << 56;
/// Most rounds of settling one frame.
const MAX_SETTLE_ROUNDS: u32 = 100_000;

/// Bounds of the upper tiers and of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Model data on the adapter.
    pub vram_bytes: u64,
    /// Decoded chunks in memory.
    pub ram_bytes: u64,
    /// Triangles of a picture.
    pub max_triangles: u64,
}

/// One frame's place, time and wishes.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// The camera.
    pub key: Keyframe,
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
    /// Error or bands asked for.
    pub detail: Detail,
    /// Seconds since the last frame.
    pub dt_secs: f32,
}

/// Opens an archive and warns of nothing: a model that opens can be drawn at its coarsest level or says why not.
pub fn open_model(path: &Path) -> Result<Arc<Model>, ModelError> {
    Model::open(path).map(Arc::new)
}

/// The sphere around the model's bounds, world space, for cameras that go around it.
pub fn subject(model: &Model, up: glam::DVec3) -> Subject {
    let [low, high] = model.world_bounds();
    Subject { center: (low + high) * 0.5, radius: (low.distance(high) * 0.5).max(model.record().quantum), up }
}

/// Triangles of the coarsest level, of all instances.
fn coarse_triangles(model: &Model) -> u64 {
    let coarsest = model.levels() - 1;
    let of = |p: &Placed| {
        let triangles: u64 = p.clusters.clone().map(|c| u64::from(model.level(c, coarsest).triangles)).sum();
        triangles * p.placements.len() as u64
    };
    model.placed().iter().map(of).sum()
}

/// The tables of a model that the renderer and the sizes of chunks are made from.
pub fn model_tables(model: &Model) -> ModelTables<'_> {
    ModelTables {
        model: model.record(),
        clusters: model.clusters(),
        levels: model.level_records(),
        neighbours: model.neighbour_entries(),
        textures: model.textures(),
        instances: model.instances(),
    }
}

/// What chunks cost on an adapter, and what it has for them.
#[derive(Clone, Debug)]
pub struct VramCosts {
    /// Per chunk, those of the geometry first.
    pub chunks: Vec<u64>,
    /// For chunks of geometry that are not always there, and for those of textures.
    pub budgets: [u64; 2],
}

impl VramCosts {
    /// Of a model whose bound is spent like this.
    pub fn new(tables: &ModelTables, plan: &VramPlan) -> Self {
        let (texture_bytes, texture_costs) = plan.texture_costs(tables);
        let mut chunks = tables.chunk_vram_bytes();
        chunks.extend(texture_costs);
        Self { chunks, budgets: [plan.chunk_budget_bytes(), texture_bytes] }
    }
}

/// Where chunks are drawn from.
pub trait Adapter {
    /// Takes a chunk in. False where there is no room.
    fn upload(&mut self, chunk: ChunkId, data: &Loaded) -> bool;

    /// Forgets a chunk.
    fn free(&mut self, chunk: ChunkId);
}

/// Has room for all that its costs allow, and draws nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoAdapter;

impl Adapter for NoAdapter {
    fn upload(&mut self, _: ChunkId, _: &Loaded) -> bool {
        true
    }

    fn free(&mut self, _: ChunkId) {}
}

/// A model on its way from the file to the adapter.
pub struct Streaming {
    /// The open archive.
    pub model: Arc<Model>,
    /// Chunks under way.
    pub feed: Feed,
    selector: Selector,
    cache: Recorded,
    /// Decoded chunks, by chunk.
    decoded: Vec<Option<Loaded>>,
    exchange: Exchange,
    /// Of geometry with the coarse buffer, and of textures without their tails.
    budgets: [u64; 2],
    max_triangles: u64,
    plan: Plan,
    /// What is loaded ahead.
    expected: Expected,
    /// Sum of the frames' times, seconds; when chunks were asked for; how long they take.
    clock: f64,
    asked_at: BTreeMap<pb_stream::ChunkId, f64>,
    latency: Latency,
    meter: Meter,
    /// Where frames follow the wall clock.
    upload_pace: Option<UploadPace>,
    near: f64,
}

impl Streaming {
    /// Nothing is there yet but what always is. Fails when a bound is too small.
    pub fn new(model: Arc<Model>, costs: &VramCosts, bounds: Bounds, feed: Feed) -> Result<Self> {
        let levels = model.levels() as usize;
        let coarse_bytes: u64 =
            costs.chunks[..model.clusters().len() * levels].iter().skip(levels - 1).step_by(levels).sum();
        let selector = Selector::new(&SelectTables::of(&model, &costs.chunks));
        let limits = Limits::new(bounds.ram_bytes, costs.budgets);
        let cache = Recorded::new(chunk_infos(&model, &costs.chunks), limits)?;
        let coarsest = coarse_triangles(&model);
        if bounds.max_triangles < coarsest {
            let most = bounds.max_triangles;
            eprintln!(
                "pb-view: warning: the coarsest level has {coarsest} triangles, more than the {most} of --max-triangles; \
                 pictures with all of the model in them will have more. Bake with more --levels, or raise the bound"
            );
        }
        let chunks = costs.chunks.len();
        let s = subject(&model, glam::DVec3::Y);
        Ok(Self {
            feed,
            selector,
            cache,
            decoded: vec![None; chunks],
            exchange: Exchange::new((0..chunks as u32).map(|c| model.always_resident(ChunkId(c))).collect()),
            budgets: [coarse_bytes + costs.budgets[0], costs.budgets[1]],
            max_triangles: bounds.max_triangles,
            plan: Plan::default(),
            expected: Expected { around: true, ..Expected::default() },
            clock: 0.0,
            asked_at: BTreeMap::new(),
            latency: Latency::default(),
            meter: Meter::new(chunks),
            upload_pace: None,
            near: s.radius * 2.0 * NEAR,
            model,
        })
    }

    /// The camera of a moment.
    pub fn camera(&self, key: &Keyframe) -> Camera {
        Camera { eye: key.eye, target: key.target, up: key.up, fov_deg: key.fov_deg, near: self.near }
    }

    /// One frame: what is here is drawn, what is wanted is asked for.
    pub fn advance(&mut self, adapter: &mut dyn Adapter, moment: &Moment) {
        self.clock += moment.dt_secs as f64;
        self.meter.begin_frame();
        for (chunk, result) in self.feed.take(moment.dt_secs) {
            self.accept(chunk, result);
        }
        self.step(adapter, moment, moment.dt_secs);
        if let Some(mut pace) = self.upload_pace {
            pace.add(moment.dt_secs, self.meter.traffic().upload_bytes, self.meter.upload_time());
            self.set_upload_pace(pace);
        }
    }

    /// One frame that waits until all that is wanted and fits is here, and floors stand still.
    pub fn settle(&mut self, adapter: &mut dyn Adapter, moment: &Moment) -> Result<()> {
        self.meter.begin_frame();
        for _ in 0..MAX_SETTLE_ROUNDS {
            let before = std::mem::take(&mut self.plan);
            self.step(adapter, moment, f32::INFINITY);
            let still = before.floors == self.plan.floors && before.detail == self.plan.detail;
            if self.cache.is_idle() && still {
                return Ok(());
            }
            for (chunk, result) in self.feed.drain() {
                self.accept(chunk, result);
            }
        }
        anyhow::bail!("the view did not settle in {MAX_SETTLE_ROUNDS} rounds; raise --vram or --ram")
    }

    /// Selects, and carries out what the cache says.
    fn step(&mut self, adapter: &mut dyn Adapter, moment: &Moment, dt_secs: f32) {
        let start = Instant::now();
        self.exchange.update(&self.cache);
        let views = |keys: &[Keyframe]| keys.iter().map(|k| self.camera(k).view(moment.size)).collect::<Vec<View>>();
        let (soon, later) = (views(&self.expected.soon), views(&self.expected.later));
        let frame = Frame {
            views: &[self.view(moment)],
            resident: self.exchange.resident(),
            retiring: self.cache.retiring(),
            failed: self.cache.failed(),
            changed: Some(self.exchange.changed()),
            detail: moment.detail,
            vram_budget_bytes: self.budgets[0],
            texture_budget_bytes: self.budgets[1],
            max_triangles: self.max_triangles,
            prefetch: Prefetch { around: self.expected.around, soon: &soon, later: &later },
            cut: self.expected.cut,
            dt_secs,
        };
        self.plan = self.selector.select(&frame);
        let (wants, released) = self.exchange.hand_over(&self.plan);
        let commands = self.cache.frame(wants, released);
        let decided = Instant::now();
        self.meter_wants();
        let mut unwanted = BTreeSet::new();
        for command in commands {
            match command {
                Command::Withdraw(chunk) => drop(unwanted.insert(chunk)),
                _ => self.carry_out(adapter, command),
            }
        }
        self.feed.reorder(&self.plan.wants);
        for chunk in self.feed.withdraw(&unwanted) {
            self.asked_at.remove(&chunk);
            self.meter.withdrawn(ChunkId(chunk.0));
            self.cache.load_withdrawn(chunk);
        }
        self.meter.loads(self.feed.stats());
        self.meter.step(start, decided);
    }

    fn meter_wants(&mut self) {
        let (model, cache, resident) = (&self.model, &self.cache, self.exchange.resident());
        self.meter.wants(&self.plan.wants, |chunk| {
            let there = resident[chunk.0 as usize] || cache.in_ram(pb_stream::ChunkId(chunk.0));
            there.then(|| stored_bytes(model, chunk))
        });
    }

    fn carry_out(&mut self, adapter: &mut dyn Adapter, command: Command) {
        match command {
            Command::Load(chunk) => {
                self.asked_at.insert(chunk, self.clock);
                self.meter.asked(ChunkId(chunk.0));
                self.feed.request(chunk);
            }
            Command::DropRam(chunk) => self.decoded[chunk.0 as usize] = None,
            Command::Free(chunk) => adapter.free(ChunkId(chunk.0)),
            // Selection reads these from the cache's flags in the next frame.
            Command::Retire(_) | Command::Keep(_) => {}
            Command::Withdraw(_) => unreachable!("carried out together"),
            Command::Upload(chunk) => {
                let data = self.decoded[chunk.0 as usize].as_ref().expect("the cache uploads what is in RAM");
                let (id, start) = (ChunkId(chunk.0), Instant::now());
                match adapter.upload(id, data) {
                    true => {
                        self.meter.uploaded(self.model.decoded_bytes(id) as u64, start);
                        self.cache.uploaded(chunk);
                    }
                    false => self.cache.upload_failed(chunk),
                }
            }
        }
    }

    /// From now on uploads are limited in time, by what the last ones took.
    pub fn pace_uploads(&mut self) {
        self.set_upload_pace(UploadPace::default());
    }

    fn set_upload_pace(&mut self, pace: UploadPace) {
        if pace.limit_bytes() != self.cache.limits().upload_bytes_per_frame {
            self.cache.limit_uploads(pace.limit_bytes());
        }
        self.upload_pace = Some(pace);
    }

    /// From now on all that happens to the cache is written down, for a replay.
    pub fn record_cache(&mut self, path: &Path) -> Result<()> {
        let file = std::fs::File::create(path).with_context(|| format!("{}: cannot write the run", path.display()))?;
        self.cache.record(Box::new(std::io::BufWriter::new(file)));
        Ok(())
    }

    /// Writes what is still buffered of the recorded run; fails if any of it could not be written.
    pub fn finish_recording(&mut self) -> Result<()> {
        self.cache.finish_recording().context("the run of the cache cannot be written")
    }

    /// From now on loads what these cameras will show.
    pub fn expect(&mut self, expected: Expected) {
        self.expected = expected;
    }

    /// How long loads take.
    pub fn latency(&self) -> &Latency {
        &self.latency
    }

    fn accept(&mut self, chunk: pb_stream::ChunkId, result: LoadResult<Loaded>) {
        if let Some(asked_at) = self.asked_at.remove(&chunk) {
            self.latency.add(self.clock - asked_at);
        }
        match result {
            Ok(data) => {
                self.decoded[chunk.0 as usize] = Some(data);
                let id = ChunkId(chunk.0);
                self.meter.read(id, stored_bytes(&self.model, id));
                self.cache.loaded(chunk);
            }
            Err(error) => {
                let (cluster, level) = self.model.chunk_place(ChunkId(chunk.0));
                let (id, coarser) = (chunk.0, level + 1);
                eprintln!("pb-view: warning: {error}; without chunk {id} cluster {cluster} stays at level {coarser}");
                self.cache.load_failed(chunk);
            }
        }
    }

    /// What a moment's camera sees.
    pub fn view(&self, moment: &Moment) -> View {
        self.camera(&moment.key).view(moment.size)
    }

    /// What the last step decided.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What decides.
    pub fn selector(&self) -> &Selector {
        &self.selector
    }

    /// The surface of the last step, for export.
    pub fn shown(&self, moment: &Moment) -> ShownFrame<'_> {
        ShownFrame {
            model: &self.model,
            selector: &self.selector,
            view: self.view(moment),
            detail: self.detail(moment),
            eye: grid_eye(self.model.record(), moment.key.eye),
        }
    }

    /// The detail of the last step.
    pub fn detail(&self, moment: &Moment) -> Detail {
        self.plan.detail.unwrap_or(moment.detail)
    }

    /// True when the next frame from the same place would look the same.
    pub fn settled(&self) -> bool {
        self.cache.is_idle() && (self.plan.settled || self.cache.stats().failed > 0)
    }

    /// Numbers of the last step, with the bytes of the cache for those of the adapter.
    pub fn stats(&self) -> FrameStats {
        let coarse_draws = self.plan.coarse.len() as u32;
        let now = self.plan.wants.iter().take_while(|w| w.class == Class::Now);
        let absent = |w: &&Want| !self.exchange.resident()[w.chunk.0 as usize];
        let (tau, k) = match self.plan.detail {
            Some(Detail::ErrorPx(tau)) => (tau, 0.0),
            Some(Detail::Bands { k, .. }) => (0.0, k),
            None => (0.0, 0.0),
        };
        FrameStats {
            triangles: self.plan.triangles,
            draws: self.plan.draws.len() as u32 + coarse_draws,
            vram_bytes: self.cache.stats().vram_bytes,
            ram_bytes: self.cache.stats().ram_bytes,
            missing_chunks: self.plan.missing_chunks,
            error_px: self.plan.error_px,
            coarse_draws,
            allowed_error_px: tau,
            band_k: k,
            texture_vram_bytes: 0,
            wanted_chunks: now.clone().count() as u32,
            missing_textures: now.filter(absent).filter(|w| self.model.is_texture(w.chunk)).count() as u32,
            allowed_texel_error_px: match self.plan.texture_detail {
                Some(Detail::ErrorPx(tau)) => tau,
                _ => 0.0,
            },
            rising: self.plan.rising,
            fading: !self.plan.floors_stand,
            loads_in_flight: self.cache.stats().loads_in_flight,
            traffic: self.meter.traffic(),
            times: self.meter.times(),
        }
    }

    /// Chunks that could not be read.
    pub fn damaged_chunks(&self) -> u32 {
        self.cache.stats().failed
    }
}

fn stored_bytes(model: &Model, chunk: ChunkId) -> u64 {
    model.archive().chunks()[chunk.0 as usize].stored_bytes as u64
}

/// The cache's view of the chunks: those that are always there are outside of it.
pub(crate) fn chunk_infos(model: &Model, chunk_bytes: &[u64]) -> Vec<ChunkInfo> {
    let info = |(chunk, &bytes): (u32, &u64)| {
        let id = ChunkId(chunk);
        let (always, texture) = (model.always_resident(id), model.is_texture(id));
        let in_ram = if texture { model.decoded_bytes(id) } else { u32::try_from(bytes).unwrap_or(u32::MAX) };
        ChunkInfo {
            ram_bytes: if always { 0 } else { in_ram },
            vram_bytes: if always { 0 } else { bytes.min(NEVER_FITS) },
            pool: texture as usize,
            coarser: model.needs(id).map(|c| pb_stream::ChunkId(c.0)),
            pinned: false,
        }
    };
    (0..).zip(chunk_bytes).map(info).collect()
}
