//! A viewer without window, adapter and file: what `Stage` does in a frame, part by part, timed.

use glam::DVec3;
use pb_lod::plan::{Detail, Frame, Plan, Prefetch, View};
use pb_lod::progressive_buffers::select::Selector;
use pb_lod::progressive_buffers::switch::Switch;
use pb_render::{Camera, DrawTable, ModelTables, UNIT_BYTES, texture_floors};
use pb_stream::cache::{Cache, Command, Limits};
use pb_stream::disk::Disk;
use pb_stream::merge::Extent;
use pb_view::exchange::Exchange;
use pb_view::flypath::{Flypath, Keyframe};
use pb_view::prefetch::{Expected, Latency, Prefetcher};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use crate::city::City;

const SIZE: [u32; 2] = [1920, 1080];
const FPS: f64 = 60.0;
const DETAIL: Detail = Detail::ErrorPx(1.0);
/// The camera: radius of its circle (or a quarter of a small city's width), speed and height, world units.
const RADIUS: f64 = 40.0;
const SPEED: f64 = 10.0;
const HEIGHT: f64 = 3.0;
/// Seconds of a flight: more than are flown.
const SECS: f64 = 20.0;

/// What is loaded ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ahead {
    Off,
    Motion,
    Path,
}

impl Ahead {
    pub const ALL: [Ahead; 3] = [Ahead::Off, Ahead::Motion, Ahead::Path];

    pub fn name(&self) -> &'static str {
        match self {
            Ahead::Off => "off",
            Ahead::Motion => "motion",
            Ahead::Path => "path",
        }
    }

    pub fn says(&self) -> &'static str {
        match self {
            Ahead::Off => "Nothing is loaded ahead (`--no-prefetch`)",
            Ahead::Motion => "Prefetch from motion: 2 cameras soon, 1 later",
            Ahead::Path => "Prefetch along the flypath, 2 s ahead: up to 5 cameras soon, 4 later",
        }
    }
}

/// Milliseconds of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Times([f64; 4]);

impl Times {
    pub fn select(&self) -> f64 {
        self.0[0]
    }
    pub fn viewer(&self) -> f64 {
        self.0[1]
    }
    pub fn cache(&self) -> f64 {
        self.0[2]
    }
    pub fn commands(&self) -> f64 {
        self.0[3]
    }
    pub fn sum(&self) -> f64 {
        self.0.iter().sum()
    }
}

/// Counts of all frames, and of the last one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub frames: u64,
    pub loads: u64,
    pub wants: usize,
    pub draws: usize,
    pub missing: u64,
    /// Of all decisions so far: two builds that print the same decide the same.
    pub fingerprint: u64,
}

impl Tally {
    fn add(&mut self, numbers: impl IntoIterator<Item = u32>) {
        for number in numbers {
            self.fingerprint = (self.fingerprint ^ u64::from(number)).wrapping_mul(0x100_0000_01b3).rotate_left(29);
        }
    }
}

pub struct Viewer {
    selector: Selector,
    cache: Cache,
    exchange: Exchange,
    budgets: [u64; 2],
    disk: Disk,
    extents: Vec<Extent>,
    ranks: Vec<(u64, u32)>,
    prefetcher: Prefetcher,
    latency: Latency,
    ahead: Ahead,
    flight: Flypath,
    plan: Plan,
    draws: DrawTable,
    /// Chunks of geometry come first.
    geometry_chunks: usize,
    /// Per cluster, as the adapter has them.
    finest: Vec<u32>,
    /// What would be copied to the adapter.
    sent: Vec<u8>,
    switch: Option<Switch>,
    distances: Vec<f32>,
    tally: Tally,
}

impl Viewer {
    pub fn new(city: &City, ahead: Ahead) -> Viewer {
        let mut selector = city.selector();
        let flight = flight(city);
        let wanted = bytes_wanted(city, &mut selector, &flight);
        let pools = wanted.map(|bytes| bytes / 2);
        let ram = pools.iter().sum::<u64>().max(64 << 20);
        let mut offset = 0;
        let extents = city.chunk_bytes.iter().map(|bytes| {
            offset += bytes / 3;
            Extent { offset: offset - bytes / 3, bytes: bytes / 3 }
        });
        let always = city.always();
        Viewer {
            cache: Cache::new(city.infos(), Limits::new(ram, pools)).expect("nothing is pinned, chunks are small"),
            budgets: [city.coarse_bytes() + pools[0], pools[1]],
            disk: Disk::new("0.1,2000".parse().expect("a disk")),
            extents: extents.collect(),
            ranks: vec![(0, 0); always.len()],
            exchange: Exchange::new(always),
            prefetcher: match ahead {
                Ahead::Off => Prefetcher::off(),
                Ahead::Motion => Prefetcher::new(0.0),
                Ahead::Path => Prefetcher::new(2.0),
            },
            latency: Latency::default(),
            ahead,
            flight,
            plan: Plan::default(),
            draws: draw_table(city, pools[0]),
            geometry_chunks: city.levels.len(),
            finest: vec![0; city.clusters.len()],
            sent: Vec::new(),
            switch: None,
            distances: Vec::new(),
            tally: Tally::default(),
            selector,
        }
    }

    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// One frame of the flight.
    pub fn frame(&mut self) -> Times {
        let t = self.tally.frames as f64 / FPS;
        let key = self.flight.at(t);
        let flight = (self.ahead == Ahead::Path).then_some((&self.flight, t));
        let expected = self.prefetcher.expect(&key, 1.0 / FPS, flight, &self.latency);
        self.tally.frames += 1;
        for chunk in self.disk.advance(Duration::from_secs_f64(t)) {
            self.cache.loaded(chunk);
        }
        let start = Instant::now();
        let frame = self.begin(&key, &expected);
        let begun = Instant::now();
        let plan = self.selector.select(&frame.frame(&self.exchange, &self.cache, self.budgets));
        let selected = Instant::now();
        self.plan = plan;
        let (wants, released) = self.exchange.hand_over(&self.plan);
        let handed = Instant::now();
        let commands = self.cache.frame(wants, released);
        let decided = Instant::now();
        let commands_copy = commands.clone();
        let mut unwanted = BTreeSet::new();
        for command in commands {
            match command {
                Command::Load(chunk) => {
                    self.tally.loads += 1;
                    self.disk.ask(chunk, self.extents[chunk.0 as usize]);
                }
                Command::Upload(chunk) => {
                    self.cache.uploaded(chunk);
                    if (chunk.0 as usize) < self.geometry_chunks {
                        self.draws.place(chunk.0 as usize).expect("the heap is larger than the bound");
                    }
                }
                Command::Free(chunk) if (chunk.0 as usize) < self.geometry_chunks => self.draws.free(chunk.0 as usize),
                Command::Withdraw(chunk) => drop(unwanted.insert(chunk)),
                _ => {}
            }
        }
        self.rank();
        for chunk in self.disk.withdraw(|chunk| unwanted.contains(&chunk)) {
            self.cache.load_withdrawn(chunk);
        }
        let carried = Instant::now();
        self.build(&key);
        let built = Instant::now();
        self.count(&commands_copy);
        let ms = |d: Duration| d.as_secs_f64() * 1e3;
        let viewer = (begun - start) + (handed - selected) + (carried - decided);
        Times([ms(selected - begun), ms(viewer), ms(decided - handed), ms(built - carried)])
    }

    fn count(&mut self, commands: &[Command]) {
        let (plan, tally) = (&self.plan, &mut self.tally);
        (tally.wants, tally.draws) = (plan.wants.len(), plan.draws.len());
        tally.missing += u64::from(plan.missing_chunks);
        tally.add(plan.draws.iter().flat_map(|d| [d.cluster, d.level]));
        tally.add(plan.coarse.iter().flat_map(|r| [r.indices.start, r.indices.end]));
        tally.add(plan.wants.iter().flat_map(|w| [w.chunk.0, w.class as u32, w.error_px.to_bits()]));
        tally.add(plan.released.iter().map(|c| c.0));
        tally.add(plan.floors.iter().chain(&plan.texture_floors).map(|f| f.to_bits()));
        for command in commands {
            tally.add(match *command {
                Command::Load(c) => [0, c.0],
                Command::Upload(c) => [1, c.0],
                Command::DropRam(c) => [2, c.0],
                Command::Retire(c) => [3, c.0],
                Command::Keep(c) => [4, c.0],
                Command::Free(c) => [5, c.0],
                Command::Withdraw(c) => [6, c.0],
            });
        }
    }

    fn begin(&mut self, key: &Keyframe, expected: &Expected) -> Views {
        self.exchange.update(&self.cache);
        let views = |keys: &[Keyframe]| keys.iter().map(|k| camera(k).view(SIZE)).collect::<Vec<View>>();
        let (soon, later) = (views(&expected.soon), views(&expected.later));
        Views { now: camera(key).view(SIZE), soon, later, around: expected.around }
    }

    fn rank(&mut self) {
        let frame = self.tally.frames;
        for (place, want) in (0..).zip(&self.plan.wants) {
            self.ranks[want.chunk.0 as usize] = (frame, place);
        }
        let ranks = &self.ranks;
        self.disk.reorder(|chunk| match ranks[chunk.0 as usize] {
            (wanted, place) if wanted == frame => place.into(),
            _ => u64::MAX,
        });
    }

    /// What the adapter is told.
    fn build(&mut self, key: &Keyframe) {
        let detail = self.plan.detail.unwrap_or(DETAIL);
        let switch = Switch::new(detail, camera(key).pixel_angle(SIZE), 1.0 / 1024.0);
        if self.switch != Some(switch) {
            let distances = self.selector.distances(&switch);
            if distances != self.distances {
                self.distances = distances;
            }
            self.switch = Some(switch);
        }
        // Copied once, as the queue of the adapter does.
        self.sent.clear();
        self.sent.extend_from_slice(bytemuck::cast_slice(&self.draws.arguments(&self.plan.draws)));
        self.sent.extend_from_slice(bytemuck::cast_slice(&self.plan.floors));
        self.sent.extend_from_slice(bytemuck::cast_slice(&texture_floors(&self.plan.texture_floors, &self.finest)));
    }
}

/// The views of a frame.
struct Views {
    now: View,
    soon: Vec<View>,
    later: Vec<View>,
    around: bool,
}

impl Views {
    fn frame<'a>(&'a self, exchange: &'a Exchange, cache: &'a Cache, budgets: [u64; 2]) -> Frame<'a> {
        Frame {
            views: std::slice::from_ref(&self.now),
            resident: exchange.resident(),
            retiring: cache.retiring(),
            failed: cache.failed(),
            changed: Some(exchange.changed()),
            detail: DETAIL,
            vram_budget_bytes: budgets[0],
            texture_budget_bytes: budgets[1],
            max_triangles: u64::MAX,
            prefetch: Prefetch { around: self.around, soon: &self.soon, later: &self.later },
            cut: false,
            dt_secs: (1.0 / FPS) as f32,
        }
    }
}

fn camera(key: &Keyframe) -> Camera {
    Camera { eye: key.eye, target: key.target, up: key.up, fov_deg: key.fov_deg, near: 1e-3 }
}

/// With room for the coarse buffer, and for a bound with holes between what lies in it.
fn draw_table(city: &City, bound: u64) -> DrawTable {
    let tables = ModelTables {
        instances: None,
        model: &city.model,
        clusters: &city.clusters,
        levels: &city.levels,
        neighbours: &city.neighbours,
        textures: None,
    };
    let coarse_units = (city.coarse_bytes() / UNIT_BYTES) as u32;
    DrawTable::new(&tables, coarse_units + (bound / UNIT_BYTES) as u32 * 5 / 4 + 65536, coarse_units)
}

/// A circle around the middle, looking along it.
fn flight(city: &City) -> Flypath {
    let radius = RADIUS.min(city.half_width * 0.5);
    let key = |i: u32| {
        let t = f64::from(i) * 0.25;
        let angle = t * SPEED / radius;
        let at = |angle: f64| DVec3::new(angle.sin() * radius, HEIGHT, angle.cos() * radius);
        let ahead = DVec3::new(angle.cos(), -0.1, -angle.sin());
        Keyframe { t, eye: at(angle), target: at(angle) + ahead * 10.0, up: DVec3::Y, fov_deg: 50.0 }
    };
    Flypath::new(FPS, (0..=(SECS * 4.0) as u32).map(key).collect()).expect("times rise")
}

/// Bytes that the flight's views want at most, without bounds: geometry and textures.
fn bytes_wanted(city: &City, selector: &mut Selector, flight: &Flypath) -> [u64; 2] {
    let mut most = [0; 2];
    let always = city.always();
    let none = vec![false; always.len()];
    for i in 0..8 {
        let view = camera(&flight.at(f64::from(i))).view(SIZE);
        let plan = selector.select(&Frame {
            views: &[view],
            resident: &none,
            retiring: &none,
            failed: &none,
            changed: None,
            detail: DETAIL,
            vram_budget_bytes: u64::MAX,
            texture_budget_bytes: u64::MAX,
            max_triangles: u64::MAX,
            prefetch: Prefetch::OFF,
            cut: false,
            dt_secs: f32::INFINITY,
        });
        let mut bytes = [0; 2];
        for want in plan.wants.iter().filter(|w| !always[w.chunk.0 as usize]) {
            let chunk = want.chunk.0 as usize;
            bytes[usize::from(city.is_texture(chunk))] += city.chunk_bytes[chunk];
        }
        most = [0, 1].map(|k| most[k].max(bytes[k]));
    }
    most
}
