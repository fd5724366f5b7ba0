//! One simulated viewer: camera, selection, cache, slow disk and adapter; and a second book of what is where, kept from
//! the commands alone, against which every promise is checked.

use anyhow::{Result, ensure};
use glam::DVec3;
use pb_lod::plan::{self, Class, Detail, Frame, Plan, Prefetch, View};
use pb_lod::progressive_buffers::select::Selector;
use pb_render::Camera;
use pb_stream::ChunkId;
use pb_stream::cache::{Command, Limits, POOLS};
use pb_stream::disk::Disk;
use pb_stream::journal::{Recorded, replay};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::random::Random;
use super::scene::SimScene;
use crate::exchange::stream_want;

/// Frame time of all flights.
const DT_SECS: f32 = 1.0 / 30.0;
/// Frames in which a view comes to rest when the disk is no hindrance: floors that rise level by level, and what refused
/// uploads took from a pool, which comes back by a 64th per frame.
const REST_FRAMES: u64 = 4000;
/// Chance that an upload is refused.
const REFUSED: f64 = 0.02;

/// Sums over flights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Virtual time.
    pub secs: f64,
    pub scenes: u64,
    pub flights: u64,
    pub frames: u64,
    pub loads: u64,
    pub failures: u64,
    pub withdrawn: u64,
    pub uploads: u64,
    pub refused: u64,
    pub retired: u64,
    pub freed: u64,
    pub replayed: u64,
    /// Longest rest until all was there, frames.
    pub slowest_rest: u64,
    /// Largest part of a pool of VRAM that was in use.
    pub fullest: f64,
}

impl Tally {
    /// Adds another's.
    pub fn add(&mut self, o: &Tally) {
        self.secs += o.secs;
        self.scenes += o.scenes;
        self.flights += o.flights;
        self.frames += o.frames;
        self.loads += o.loads;
        self.failures += o.failures;
        self.withdrawn += o.withdrawn;
        self.uploads += o.uploads;
        self.refused += o.refused;
        self.retired += o.retired;
        self.freed += o.freed;
        self.replayed += o.replayed;
        self.slowest_rest = self.slowest_rest.max(o.slowest_rest);
        self.fullest = self.fullest.max(o.fullest);
    }

    /// Two lines for people.
    pub fn report(&self, wall_secs: f64) -> String {
        format!(
            "{:.2} hours of flying in {wall_secs:.0} s: {} scenes, {} flights, {} frames\n\
             {} loads, {} of them failed, {} withdrawn; {} uploads, {} of them refused; {} asked back, {} freed; {} commands replayed; \
             VRAM at most {:.1} % full; rest after at most {} frames",
            self.secs / 3600.0,
            self.scenes,
            self.flights,
            self.frames,
            self.loads,
            self.failures,
            self.withdrawn,
            self.uploads,
            self.refused,
            self.retired,
            self.freed,
            self.replayed,
            self.fullest * 100.0,
            self.slowest_rest
        )
    }
}

/// Bytes that a recorded run is written to.
#[derive(Clone, Default)]
struct Tape(Arc<Mutex<Vec<u8>>>);

impl Write for Tape {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// The second book: where a chunk is.
#[derive(Clone, Copy, Default)]
struct Place {
    loading: bool,
    in_ram: bool,
    uploading: bool,
    in_vram: bool,
    asked_back: bool,
    /// Cannot be read.
    broken: bool,
}

/// A simulated viewer.
pub struct World<'a> {
    scene: &'a SimScene,
    selector: Selector,
    cache: Recorded,
    tape: Option<Tape>,
    disk: Disk,
    now: Duration,
    places: Vec<Place>,
    /// Uploads under way and the frames that are left of them.
    uploads: Vec<(u32, ChunkId)>,
    resident: Vec<bool>,
    ram_bytes: u64,
    vram_bytes: [u64; POOLS],
    budgets: [u64; POOLS],
    detail: Detail,
    /// Also load what a camera nearby would show.
    around: bool,
    /// Cameras that are expected: so many frames ahead along the present motion.
    ahead: Vec<f64>,
    max_triangles: u64,
    /// Frames in which even the slowest rest must be over.
    rest_frames: u64,
    upload_frames: u32,
    eye: DVec3,
    /// Of the frame before.
    last_eye: DVec3,
    target: DVec3,
    tally: Tally,
}

impl<'a> World<'a> {
    /// A viewer with random bounds, disk and damage.
    pub fn new(scene: &'a SimScene, random: &mut Random, record: bool) -> Result<Self> {
        let infos = scene.infos();
        let largest = infos.iter().map(|i| u64::from(i.ram_bytes)).max().unwrap_or(0);
        let bytes = scene.bytes();
        let part = |bytes: u64, random: &mut Random| (bytes as f64 * random.magnitude(0.05, 1.3)) as u64;
        let pools = bytes.map(|b| part(b, random));
        let ram = part(bytes.iter().sum(), random).max(largest);
        let limits = Limits {
            loads_in_flight: random.magnitude(1.0, 4096.0) as u32,
            upload_bytes_per_frame: random.magnitude(1e3, 3e7) as u64,
            ..Limits::new(ram, pools)
        };
        let (latency_ms, mb_per_sec) = (random.real(0.0, 40.0), random.magnitude(0.5, 2000.0));
        let model: pb_stream::disk::DiskModel = format!("{latency_ms},{mb_per_sec}").parse()?;
        let reading: f64 = scene.extents.iter().map(|e| model.read_time(e.bytes).as_secs_f64()).sum();
        let mut cache = Recorded::new(infos, limits)?;
        let tape = record.then(Tape::default);
        if let Some(tape) = &tape {
            cache.record(Box::new(tape.clone()));
        }
        let damage = if random.chance(0.3) { 0.05 } else { 0.0 };
        let place = |random: &mut Random| Place { broken: random.chance(damage), ..Place::default() };
        let upload_frames = random.whole(0, 4);
        let n = scene.chunk_bytes.len() as u64;
        Ok(Self {
            selector: scene.selector(),
            cache,
            tape,
            disk: Disk::new(model),
            now: Duration::ZERO,
            places: (0..n).map(|_| place(random)).collect(),
            uploads: Vec::new(),
            resident: scene.always.clone(),
            ram_bytes: 0,
            vram_bytes: [0; POOLS],
            budgets: [scene.coarse_bytes() + pools[0], pools[1]],
            detail: Detail::ErrorPx(random.magnitude(0.1, 8.0) as f32),
            around: random.chance(0.5),
            ahead: if random.chance(0.5) { vec![8.0, 15.0, 40.0] } else { Vec::new() },
            max_triangles: if random.chance(0.2) { random.magnitude(1e2, 1e6) as u64 } else { u64::MAX },
            // Everything is read twice, and uploaded one chunk after the other.
            rest_frames: REST_FRAMES + (2.0 * reading / f64::from(DT_SECS)) as u64 + n * u64::from(2 + upload_frames),
            upload_frames,
            eye: DVec3::new(0.0, 0.0, 3000.0),
            last_eye: DVec3::new(0.0, 0.0, 3000.0),
            target: DVec3::ZERO,
            tally: Tally { scenes: 1, ..Tally::default() },
            scene,
        })
    }

    /// A flight along random places, with cuts, and a rest at its end.
    pub fn fly(&mut self, random: &mut Random) -> Result<()> {
        let size = (DVec3::from(self.scene.model.bounds_max.map(f64::from))
            - DVec3::from(self.scene.model.bounds_min.map(f64::from)))
        .max_element()
            * self.scene.model.quantum
            * 0.5;
        let middle = DVec3::from(self.scene.model.origin);
        for _ in 0..random.whole(2, 7) {
            let (eye, target) = (self.eye, self.target);
            let next_eye = middle + random.direction() * size * random.magnitude(0.01, 6.0);
            let next_target = middle + random.direction() * size * random.real(0.0, 0.5);
            let frames = if random.chance(0.2) { 1 } else { random.whole(5, 60) };
            for frame in 1..=frames {
                let part = f64::from(frame) / f64::from(frames);
                (self.eye, self.target) = (eye.lerp(next_eye, part), target.lerp(next_target, part));
                self.frame(random, REFUSED)?;
            }
        }
        self.rest(random)
    }

    /// The camera stands: within a bounded number of frames all is there that can be.
    fn rest(&mut self, random: &mut Random) -> Result<()> {
        for frames in 0..self.rest_frames {
            let plan = self.frame(random, 0.0)?;
            if self.cache.is_idle() && (plan.settled || self.cache.stats().failed > 0) {
                self.check_rest(&plan)?;
                self.tally.slowest_rest = self.tally.slowest_rest.max(frames);
                self.tally.flights += 1;
                return Ok(());
            }
        }
        anyhow::bail!(
            "the view did not come to rest in {} frames; the cache has {:?}",
            self.rest_frames,
            self.cache.stats()
        )
    }

    /// What the view wants now is resident, unless it, or what it stands on, cannot be read.
    fn check_rest(&self, plan: &Plan) -> Result<()> {
        for want in plan.wants.iter().filter(|w| w.class == Class::Now) {
            let mut chain = std::iter::successors(Some(want.chunk.0 as usize), |&c| self.scene.coarser(c));
            let readable = chain.all(|c| !self.places[c].broken);
            ensure!(
                self.resident[want.chunk.0 as usize] || !readable,
                "{:?} is wanted, fits and can be read, but is not resident at rest",
                want.chunk
            );
        }
        Ok(())
    }

    /// One frame; `refused` is the chance that an upload is.
    fn frame(&mut self, random: &mut Random, refused: f64) -> Result<Plan> {
        self.now += Duration::from_secs_f32(DT_SECS);
        self.tally.frames += 1;
        self.tally.secs += f64::from(DT_SECS);
        for chunk in self.disk.advance(self.now) {
            self.arrive(chunk);
        }
        self.end_uploads(random, refused);
        self.check_books()?;
        let changed: Vec<plan::ChunkId> = self.cache.changes().iter().map(|c| plan::ChunkId(c.0)).collect();
        let step = self.eye - self.last_eye;
        self.last_eye = self.eye;
        let ahead: Vec<View> = self.ahead.iter().map(|frames| self.view(self.eye + step * *frames)).collect();
        let (soon, later) = ahead.split_at(ahead.len() * 2 / 3);
        let plan = self.selector.select(&Frame {
            views: &[self.view(self.eye)],
            resident: &self.resident,
            retiring: self.cache.retiring(),
            failed: self.cache.failed(),
            changed: Some(&changed),
            detail: self.detail,
            vram_budget_bytes: self.budgets[0],
            texture_budget_bytes: self.budgets[1],
            max_triangles: self.max_triangles,
            prefetch: Prefetch { around: self.around, soon, later },
            cut: self.tally.frames.is_multiple_of(100),
            dt_secs: DT_SECS,
        });
        self.check_plan(&plan)?;
        let wants = plan.wants.iter().filter(|w| !self.scene.always[w.chunk.0 as usize]);
        let wants: Vec<pb_stream::Want> = wants.map(stream_want).collect();
        let released: Vec<ChunkId> = plan.released.iter().map(|c| ChunkId(c.0)).collect();
        let mut begun = Vec::new();
        let mut unwanted = BTreeSet::new();
        for command in self.cache.frame(&wants, &released) {
            if let Command::Withdraw(chunk) = command {
                unwanted.insert(chunk);
            }
            self.obey(command, &mut begun)?;
            self.check_bounds()?;
        }
        let places: BTreeMap<ChunkId, u64> = wants.iter().map(|w| w.chunk).zip(0..).collect();
        self.disk.reorder(|chunk| places.get(&chunk).copied().unwrap_or(u64::MAX));
        for chunk in self.disk.withdraw(|chunk| unwanted.contains(&chunk)) {
            self.places[chunk.0 as usize].loading = false;
            self.ram_bytes -= self.bytes(chunk);
            self.cache.load_withdrawn(chunk);
            self.tally.withdrawn += 1;
        }
        let bytes: u64 = begun.iter().map(|c: &ChunkId| self.bytes(*c)).sum();
        let bound = self.cache.limits().upload_bytes_per_frame;
        ensure!(
            bytes <= bound || begun.len() == 1,
            "{bytes} bytes of uploads begin in one frame, the bound is {bound}"
        );
        Ok(plan)
    }

    fn view(&self, eye: DVec3) -> View {
        let up = if (self.target - eye).normalize_or_zero().y.abs() < 0.99 { DVec3::Y } else { DVec3::X };
        Camera { eye, target: self.target, up, fov_deg: 50.0, near: 1e-3 }.view([1280, 720])
    }

    fn bytes(&self, chunk: ChunkId) -> u64 {
        self.scene.chunk_bytes[chunk.0 as usize]
    }

    /// The disk is done with a chunk.
    fn arrive(&mut self, chunk: ChunkId) {
        let bytes = self.bytes(chunk);
        let place = &mut self.places[chunk.0 as usize];
        place.loading = false;
        place.in_ram = !place.broken;
        if place.broken {
            self.ram_bytes -= bytes;
            self.tally.failures += 1;
            self.cache.load_failed(chunk);
        } else {
            self.cache.loaded(chunk);
        }
    }

    fn end_uploads(&mut self, random: &mut Random, refused: f64) {
        self.uploads.iter_mut().for_each(|(frames, _)| *frames = frames.saturating_sub(1));
        let (done, left): (Vec<_>, Vec<_>) = std::mem::take(&mut self.uploads).into_iter().partition(|u| u.0 == 0);
        self.uploads = left;
        for (_, chunk) in done {
            let bytes = self.bytes(chunk);
            let place = &mut self.places[chunk.0 as usize];
            place.uploading = false;
            if random.chance(refused) {
                self.vram_bytes[self.scene.pool(chunk.0 as usize)] -= bytes;
                self.tally.refused += 1;
                self.cache.upload_failed(chunk);
            } else {
                place.in_vram = true;
                self.resident[chunk.0 as usize] = true;
                self.cache.uploaded(chunk);
            }
        }
    }

    /// Carries a command out, if it may be.
    fn obey(&mut self, command: Command, begun: &mut Vec<ChunkId>) -> Result<()> {
        let (Command::Load(chunk)
        | Command::Withdraw(chunk)
        | Command::Upload(chunk)
        | Command::DropRam(chunk)
        | Command::Retire(chunk)
        | Command::Keep(chunk)
        | Command::Free(chunk)) = command;
        let at = chunk.0 as usize;
        let (bytes, pool, was) = (self.bytes(chunk), self.scene.pool(at), self.places[at]);
        ensure!(!self.scene.always[at], "{command:?}: that chunk is always there");
        match command {
            Command::Load(_) => {
                ensure!(!was.in_ram && !was.loading && !self.cache.has_failed(chunk), "{command:?} once too often");
                self.places[at].loading = true;
                self.ram_bytes += bytes;
                self.disk.ask(chunk, self.scene.extents[at]);
                self.tally.loads += 1;
            }
            Command::Withdraw(_) => ensure!(was.loading, "{command:?} of what is not under way"),
            Command::Upload(_) => {
                let coarser = self.scene.coarser(at);
                ensure!(was.in_ram && !was.uploading && !was.in_vram, "{command:?} of what is not in RAM, or twice");
                ensure!(coarser.is_none_or(|c| self.places[c].in_vram), "{command:?} before its coarser one");
                self.places[at].uploading = true;
                self.vram_bytes[pool] += bytes;
                self.uploads.push((self.upload_frames + 1, chunk));
                begun.push(chunk);
                self.tally.uploads += 1;
            }
            Command::DropRam(_) => {
                ensure!(was.in_ram && !was.uploading, "{command:?} of what is read");
                self.places[at].in_ram = false;
                self.ram_bytes -= bytes;
            }
            Command::Retire(_) => {
                ensure!(was.in_vram && !was.asked_back, "{command:?} of what is not there, or twice");
                self.places[at].asked_back = true;
                self.tally.retired += 1;
            }
            Command::Keep(_) => {
                ensure!(was.asked_back, "{command:?} of what was not asked back");
                self.places[at].asked_back = false;
            }
            Command::Free(_) => {
                let finer = at.checked_sub(1).filter(|&f| self.scene.coarser(f) == Some(at));
                let stands = finer.is_some_and(|f| self.places[f].in_vram || self.places[f].uploading);
                ensure!(was.in_vram && was.asked_back && !stands, "{command:?} of what is still needed");
                self.places[at] = Place { in_vram: false, asked_back: false, ..was };
                self.resident[at] = false;
                self.vram_bytes[pool] -= bytes;
                self.tally.freed += 1;
            }
        }
        Ok(())
    }

    fn check_bounds(&mut self) -> Result<()> {
        let limits = *self.cache.limits();
        ensure!(
            self.ram_bytes <= limits.ram_bytes,
            "{} bytes of RAM, the bound is {}",
            self.ram_bytes,
            limits.ram_bytes
        );
        for (pool, (&bytes, &bound)) in self.vram_bytes.iter().zip(&limits.vram_bytes).enumerate() {
            ensure!(bytes <= bound, "{bytes} bytes of VRAM in pool {pool}, the bound is {bound}");
            self.tally.fullest = self.tally.fullest.max(bytes as f64 / bound.max(1) as f64);
        }
        Ok(())
    }

    /// The cache's sums are those of the second book, in every frame: nothing leaks.
    fn check_books(&self) -> Result<()> {
        let stats = self.cache.stats();
        let loading = self.places.iter().filter(|p| p.loading).count();
        let retiring = self.places.iter().filter(|p| p.asked_back).count();
        let limit = self.cache.limits().loads_in_flight;
        ensure!(stats.loads_in_flight <= limit, "{} loads under way, the bound is {limit}", stats.loads_in_flight);
        let book =
            [self.ram_bytes, self.vram_bytes.iter().sum(), loading as u64, retiring as u64, self.uploads.len() as u64];
        let cache = [
            stats.ram_bytes,
            stats.vram_bytes,
            stats.loads_in_flight.into(),
            stats.retiring.into(),
            stats.uploads_in_flight.into(),
        ];
        ensure!(book == cache, "RAM, VRAM, loading, retiring, uploading are {book:?}, but the cache says {cache:?}");
        let same = |c: usize| self.resident[c] == (self.scene.always[c] || self.cache.resident()[c]);
        ensure!((0..self.resident.len()).all(same), "the cache has other residents than were uploaded");
        Ok(())
    }

    /// What is drawn is there, with all coarser ones; what is given back was asked back.
    fn check_plan(&self, plan: &Plan) -> Result<()> {
        let levels = self.scene.model.levels;
        for draw in &plan.draws {
            for level in draw.level..levels {
                let chunk = (draw.cluster * levels + level) as usize;
                ensure!(
                    self.resident[chunk],
                    "cluster {} is drawn at {}, but {level} is away",
                    draw.cluster,
                    draw.level
                );
            }
        }
        let kept = |c: &&plan::ChunkId| !self.places[c.0 as usize].asked_back;
        ensure!(plan.released.iter().find(kept).is_none(), "a chunk is given back that was not asked for");
        Ok(())
    }

    /// The last sums; a recorded run is the same when it is replayed.
    pub fn finish(mut self) -> Result<Tally> {
        if let Some(tape) = self.tape.take() {
            self.cache.finish_recording()?;
            let bytes = std::mem::take(&mut *tape.0.lock().unwrap_or_else(PoisonError::into_inner));
            self.tally.replayed = replay(&bytes[..])?.commands;
        }
        Ok(self.tally)
    }
}
