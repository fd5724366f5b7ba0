//! A colonnade in ruins, of any number of triangles, as large textured scenes of architecture are: pillars that all
//! differ in shape and in texture, on paving, with steps and hills around them.
//!
//! Every part is a closed solid with detail down to the length of its edges, and a function of the seed alone. So a
//! scene is written part by part and row by row, and what is held at once is one part and some rows of one image.

mod field;
mod flight;
mod ground;
mod lathe;
mod paint;
mod profile;
mod stone;
mod topology;
mod write;

use anyhow::{Context, Result, bail, ensure};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

use crate::random::{Random, mixed};
use ground::{Axis, Ground, Kind};
use lathe::Lathe;
use stone::Stone;
use topology::{Counts, Topology};

pub use flight::FlightArguments;
pub use flight::run as run_flight;

/// Distance of pillars along a row and of rows, m.
const BAY: [f64; 2] = [4.5, 6.0];
/// Fewest and most triangles.
const TRIANGLES: [u64; 2] = [10_000, 400_000_000];
/// Texels of an image per triangle of a whole bay.
const TEXELS_PER_TRIANGLE: f64 = 10.0;
/// Texels around a chart that continue it.
const MARGIN: f64 = 2.5;
/// Share of the pillars that have broken off.
const BROKEN: f64 = 0.15;
/// Triangles of the parts, as shares.
const PILLAR: f64 = 0.60;
const PAVING: f64 = 0.17;
const BEAM: f64 = 0.11;
const DEBRIS: f64 = 0.05;
const LAND: f64 = 0.45;

#[derive(clap::Args)]
pub struct Arguments {
    /// Where it goes: .ply, .obj (images beside both) or .glb (images inside).
    out: PathBuf,
    /// How many triangles, to within 1 %: 10 thousand to 400 million.
    #[arg(long, default_value_t = 1_000_000)]
    triangles: u64,
    /// Side of the image of a pillar and its bay, texels; else as fine as the triangles are.
    #[arg(long)]
    texture: Option<u32>,
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A part of an image, in shares of its sides, v downwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    start: [f64; 2],
    size: [f64; 2],
}

impl Rect {
    /// The place in the image at shares of the part.
    fn at(&self, share: [f64; 2]) -> [f32; 2] {
        [0, 1].map(|k| (self.start[k] + share[k] * self.size[k]) as f32)
    }

    /// Without a border, as wide on all sides.
    fn inset(&self, border: f64) -> Rect {
        Rect { start: self.start.map(|x| x + border), size: self.size.map(|x| x - 2.0 * border) }
    }
}

/// A solid of the scene.
#[derive(Clone, Debug)]
enum Solid {
    Lathe(Box<Lathe>),
    Ground(Ground),
}

impl Solid {
    /// Columns and rows for about so many triangles.
    fn size(&self, triangles: f64) -> [usize; 2] {
        match self {
            Solid::Lathe(lathe) => lathe.size(triangles),
            Solid::Ground(ground) => ground.size(triangles),
        }
    }

    fn counts(&self, size: [usize; 2]) -> Counts {
        match self {
            Solid::Lathe(lathe) => lathe.counts(size),
            Solid::Ground(ground) => ground.counts(size),
        }
    }
}

/// A solid, how fine it is, and where its charts lie in the image of its unit.
#[derive(Clone, Debug)]
struct Part {
    solid: Solid,
    /// Columns and rows.
    size: [usize; 2],
    /// Of each chart, with the margin around it.
    cells: Vec<Rect>,
    /// Without.
    charts: Vec<Rect>,
}

impl Part {
    fn counts(&self) -> Counts {
        self.solid.counts(self.size)
    }

    fn topology(&self) -> Topology {
        match &self.solid {
            Solid::Lathe(lathe) => lathe.topology(self.size, &self.charts),
            Solid::Ground(ground) => ground.topology(self.size, &self.charts),
        }
    }

    fn positions(&self) -> Vec<[f32; 3]> {
        match &self.solid {
            Solid::Lathe(lathe) => lathe.positions(self.size),
            Solid::Ground(ground) => ground.positions(self.size),
        }
    }

    /// sRGB at shares of a chart.
    fn color(&self, chart: usize, share: [f64; 2]) -> [f64; 3] {
        match &self.solid {
            Solid::Lathe(lathe) => lathe.color(self.size[1], chart, share),
            Solid::Ground(ground) => ground.color(chart, share),
        }
    }
}

/// Solids that share an image.
#[derive(Clone, Debug)]
struct Unit {
    parts: Vec<Part>,
    /// Side of its image, texels.
    texture: u32,
    seed: u64,
}

/// A solid before it is known how fine it will be.
struct Sketch {
    solid: Solid,
    share: f64,
    /// In tenths of the image: x, y, width, height.
    cells: Vec<[f64; 4]>,
}

/// How many pillars there are, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Pillars of a row.
    pub columns: u32,
    pub rows: u32,
}

impl Layout {
    /// More triangles are both more pillars and finer ones.
    pub fn new(triangles: u64) -> Layout {
        let pillars = 4.0 * (triangles as f64 / 1e4).powf(0.35);
        let rows = if pillars < 32.0 { 2 } else { 4 };
        Layout { columns: (pillars / f64::from(rows)).round().max(2.0) as u32, rows }
    }

    /// Far corner of the paving; the near one is at 0, 0.
    pub fn paved(&self) -> [f64; 2] {
        [f64::from(self.columns) * BAY[0], f64::from(self.rows) * BAY[1]]
    }

    /// Where a pillar stands.
    pub fn foot(&self, column: u32, row: u32) -> DVec3 {
        DVec3::new((f64::from(column) + 0.5) * BAY[0], 0.0, (f64::from(row) + 0.5) * BAY[1])
    }

    fn seed(&self, column: u32, row: u32, seed: u64) -> u64 {
        mixed(mixed(seed).wrapping_add(u64::from(row * self.columns + column) * 0x9e37_79b9))
    }

    fn is_broken(&self, column: u32, row: u32, seed: u64) -> bool {
        Random::new(self.seed(column, row, seed) ^ 7).unit() < BROKEN
    }
}

/// A number from a range.
fn random_between(random: &mut Random, low: f64, high: f64) -> f64 {
    low + (high - low) * random.unit()
}

/// The whole scene.
struct Scene {
    layout: Layout,
    units: Vec<Unit>,
}

impl Scene {
    fn new(triangles: u64, texture: Option<u32>, seed: u64) -> Scene {
        let layout = Layout::new(triangles);
        let mut units: Vec<(Vec<Sketch>, u32)> = Vec::new();
        for (column, row) in (0..layout.rows).flat_map(|row| (0..layout.columns).map(move |column| (column, row))) {
            units.push((bay(&layout, column, row, seed), 1));
        }
        units.extend(land(&layout, seed).into_iter().map(|sketch| (vec![sketch], 2)));
        let shares: f64 = units.iter().flat_map(|u| &u.0).map(|s| s.share).sum();
        let per_bay = triangles as f64 / shares;
        let side = ((TEXELS_PER_TRIANGLE * per_bay).sqrt() / 128.0).round().clamp(1.0, 32.0) as u32 * 128;
        let side = texture.unwrap_or(side);
        // What rounding leaves over is carried to the next part, so the sum is what was asked for.
        let (mut wanted, mut made) = (0.0, 0.0);
        let mut part = |sketch: Sketch, texture: u32| {
            wanted += sketch.share * per_bay;
            let size = sketch.solid.size(wanted - made);
            made += sketch.solid.counts(size).triangles as f64;
            let rect = |c: &[f64; 4]| Rect { start: [c[0] / 10.0, c[1] / 10.0], size: [c[2] / 10.0, c[3] / 10.0] };
            let cells: Vec<Rect> = sketch.cells.iter().map(rect).collect();
            let charts = cells.iter().map(|c| c.inset(MARGIN / f64::from(texture))).collect();
            Part { solid: sketch.solid, size, cells, charts }
        };
        let mut unit = |(number, (sketches, coarser)): (usize, (Vec<Sketch>, u32))| {
            let texture = side / coarser;
            let parts = sketches.into_iter().map(|s| part(s, texture)).collect();
            Unit { parts, texture, seed: mixed(seed ^ number as u64) }
        };
        Scene { layout, units: units.into_iter().enumerate().map(&mut unit).collect() }
    }

    fn counts(&self) -> Counts {
        let mut sum = Counts::default();
        self.units.iter().flat_map(|u| &u.parts).for_each(|p| sum += p.counts());
        sum
    }

    fn texels(&self) -> u64 {
        self.units.iter().map(|u| u64::from(u.texture).pow(2)).sum()
    }
}

/// A pillar with the paving around it, the beam to the next one, and what has fallen down.
fn bay(layout: &Layout, column: u32, row: u32, seed: u64) -> Vec<Sketch> {
    let (foot, own) = (layout.foot(column, row), layout.seed(column, row, seed));
    let broken = layout.is_broken(column, row, seed);
    let pillar = Solid::Lathe(Box::new(lathe::pillar(foot, own, broken)));
    let mut cells = vec![[0.0, 6.0, 5.0, 2.0]];
    match broken {
        true => cells.push([0.0, 0.0, 3.4, 6.0]),
        false => cells.extend([[0.0, 0.0, 3.4, 3.0], [0.0, 3.0, 3.4, 3.0], [5.0, 6.0, 5.0, 2.0]]),
    }
    cells.extend([[5.0, 8.0, 1.0, 1.0], [6.0, 8.0, 1.5, 2.0]]);
    let mut all = vec![Sketch { solid: pillar, share: PILLAR, cells }];
    let paving = Ground {
        kind: Kind::Paving,
        x: Axis::Even(foot.x - BAY[0] / 2.0, foot.x + BAY[0] / 2.0),
        z: Axis::Even(foot.z - BAY[1] / 2.0, foot.z + BAY[1] / 2.0),
        paved: layout.paved(),
        stone: Stone::new(seed ^ 0xf1a6),
        seed,
    };
    let cells = vec![[3.4, 0.0, 4.5, 6.0], [5.0, 9.0, 1.0, 1.0]];
    all.push(Sketch { solid: Solid::Ground(paving), share: PAVING, cells });
    if column + 1 < layout.columns && !broken && !layout.is_broken(column + 1, row, seed) {
        let beam = lathe::beam(foot + DVec3::Y * lathe::PILLAR_TOP, BAY[0], own);
        let cells = vec![[7.9, 0.0, 2.1, 6.0], [7.5, 8.0, 1.0, 1.0], [7.5, 9.0, 1.0, 1.0]];
        all.push(Sketch { solid: Solid::Lathe(Box::new(beam)), share: BEAM, cells });
    }
    let mut random = Random::new(own ^ 0xde);
    let mut between = |low: f64, high: f64| random_between(&mut random, low, high);
    for (i, side) in [(0, -1.0), (1, 1.0)] {
        let place = foot + DVec3::new(between(-0.7, 0.7), 0.0, side * between(1.2, 1.5));
        let debris = lathe::debris(place, own ^ (100 + i));
        let x = 2.5 * i as f64;
        let y = 8.0 + i as f64;
        let cells = vec![[x, 8.0, 2.5, 2.0], [8.5, y, 0.75, 1.0], [9.25, y, 0.75, 1.0]];
        all.push(Sketch { solid: Solid::Lathe(Box::new(debris)), share: DEBRIS, cells });
    }
    all
}

/// Steps and hills on all sides of the paving.
fn land(layout: &Layout, seed: u64) -> Vec<Sketch> {
    let pieces = |length: f64, bays: u32| {
        let count = bays.div_ceil(2);
        let at = move |i: u32| length * f64::from(i) / f64::from(count);
        let inner = (0..count).map(move |i| Axis::Even(at(i), at(i + 1)));
        std::iter::once(Axis::Outward(0.0, -1.0)).chain(inner).chain([Axis::Outward(length, 1.0)]).collect::<Vec<_>>()
    };
    let paved = layout.paved();
    let (along_x, along_z) = (pieces(paved[0], layout.columns), pieces(paved[1], layout.rows));
    let is_outside = |axis: &Axis| matches!(axis, Axis::Outward(..));
    let mut all = Vec::new();
    for (x, z) in along_z.iter().flat_map(|z| along_x.iter().map(move |x| (x, z))) {
        if is_outside(x) || is_outside(z) {
            let stone = Stone::new(seed ^ 0xf1a6);
            let ground = Ground { kind: Kind::Land, x: *x, z: *z, paved, stone, seed };
            let cells = vec![[0.0, 0.0, 10.0, 9.2], [0.0, 9.2, 0.8, 0.8]];
            all.push(Sketch { solid: Solid::Ground(ground), share: LAND, cells });
        }
    }
    all
}

/// Makes what the command line asks for, and a flypath beside it.
pub fn run(arguments: &Arguments) -> Result<Value> {
    let Arguments { out, triangles, texture, seed } = arguments;
    check_triangles(*triangles)?;
    ensure!(texture.is_none_or(|t| (128..=16384).contains(&t)), "--texture must be 128 to 16384");
    let scene = Scene::new(*triangles, *texture, *seed);
    match out.extension().and_then(|e| e.to_str()) {
        Some("ply") => write::ply(&scene, out)?,
        Some("obj") => write::obj(&scene, out)?,
        Some("glb") => write::glb(&scene, out)?,
        _ => bail!("{}: only .ply, .obj and .glb can be written", out.display()),
    }
    let path = out.with_extension("flight.json");
    flight::flight(&scene.layout, flight::SECONDS, flight::FPS).write(&path)?;
    let counts = scene.counts();
    Ok(json!({
        "triangles": counts.triangles, "positions": counts.positions,
        "pillars": scene.layout.columns * scene.layout.rows, "images": scene.units.len(), "texels": scene.texels(),
        "flypath": path.display().to_string(),
    }))
}

fn check_triangles(triangles: u64) -> Result<()> {
    let [least, most] = TRIANGLES;
    ensure!((least..=most).contains(&triangles), "--triangles must be {least} to {most}");
    Ok(())
}

/// A file to write.
fn create(path: &Path) -> Result<std::fs::File> {
    std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))
}

#[cfg(test)]
mod tests;
