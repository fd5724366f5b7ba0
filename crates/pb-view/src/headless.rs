//! Flights without a window: one frame after the other, each exactly one frame's time after the last.
//!
//! Must never: let the wall clock into what is drawn; with --settle, let the threads either.

use anyhow::{Context, Result, bail};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::args::Args;
use crate::export::write_ply;
use crate::failure::Outcome;
use crate::flyer::Flyer;
use crate::flypath::{Flypath, default_flight};
use crate::frame_rate::FrameRate;
use crate::prefetch::Prefetcher;
use crate::report::cuts::is_cut;
use crate::report::runs::StartTimes;
use crate::report::{self, Report};
use crate::size::show_bytes;
use crate::stats::{Line, ProcessMemory, StatsFile};
use crate::streaming::{Moment, Streaming, open_model, subject};

/// Vertical field of view of the default flight, degrees.
const FOV_DEG: f64 = 50.0;

/// Flies the flypath, or the default one, and writes what `args` asks for.
pub fn run(args: &Args) -> Result<Outcome> {
    let begin = Instant::now();
    let flight = args.flypath.as_deref().map(Flypath::open).transpose()?;
    let model = open_model(&args.archive)?;
    let flight = flight.unwrap_or_else(|| {
        let s = subject(&model, args.up.vector());
        default_flight(s.center, s.radius, s.up, FOV_DEG)
    });
    check_exports(args, flight.frames())?;
    if let Some(folder) = &args.frames {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    }
    let report = report::prepare(args)?;
    let stats_path = args.stats.clone().or_else(|| args.report.as_deref().map(report::csv_path));
    let stats = stats_path.as_deref().map(StatsFile::create).transpose()?;
    let mut flyer = Flyer::new(args, model)?;
    if let Some(path) = &args.record_cache {
        flyer.streaming_mut().record_cache(path)?;
    }
    let report = report.map(|r| r.begin(args, &flyer, &flight));
    let frame_rate = FrameRate::new(args.target_fps);
    let mut run = Run { args, stats, report, prefetcher: args.prefetcher(), frame_rate };
    let mut total = Total::default();
    let start = Instant::now();
    let more = |frame: u32| match args.minutes {
        Some(minutes) => start.elapsed().as_secs_f64() < minutes * 60.0,
        None => frame < flight.frames(),
    };
    for frame in (0..).take_while(|&frame| more(frame)) {
        total.add(&run.frame(&mut flyer, &flight, frame)?);
        if frame == 0 {
            let start = StartTimes::new(begin.elapsed(), flyer.adapter_time());
            total.start = start;
            run.report.iter_mut().for_each(|r| r.started(start));
        }
    }
    if let Some(stats) = run.stats {
        stats.finish()?;
    }
    let mut files = vec![("frames", args.frames.clone()), ("statistics", stats_path)];
    if let Some(report) = run.report {
        let [html, json] = report.finish()?;
        files.extend([("report", Some(html)), ("its numbers", Some(json))]);
    }
    flyer.streaming_mut().finish_recording()?;
    let damaged = flyer.streaming().damaged_chunks();
    total.print(&files, damaged)?;
    Ok(if damaged == 0 { Outcome::Done } else { Outcome::Damaged })
}

fn check_exports(args: &Args, frames: u32) -> Result<()> {
    match args.export_view.iter().find(|e| e.frame >= frames) {
        Some(e) => bail!("--export-view {}: the flight has frames 0 to {}; name one of them", e.frame, frames - 1),
        None => Ok(()),
    }
}

struct Run<'a> {
    args: &'a Args,
    stats: Option<StatsFile>,
    prefetcher: Prefetcher,
    report: Option<Report>,
    frame_rate: FrameRate,
}

impl Run<'_> {
    /// The next frame; after the flight's last one comes its first.
    fn frame(&mut self, flyer: &mut Flyer, flight: &Flypath, frame: u32) -> Result<Line> {
        let start = Instant::now();
        let place = frame % flight.frames();
        let key = flight.at(flight.time(place));
        let (asked, dt_secs) = (self.args.detail(), flight.dt_secs());
        let detail = self.frame_rate.detail(asked);
        let moment = Moment { key, size: self.args.size, detail, dt_secs: dt_secs as f32 };
        let at = Some((flight, flight.time(place)));
        let streaming = flyer.streaming_mut();
        streaming.expect(self.prefetcher.expect(&key, dt_secs, at, streaming.latency()));
        let draw_ms = flyer.frame(&moment, self.args.settle, self.args.style())?;
        let frame_secs = start.elapsed().as_secs_f64();
        self.frame_rate.add(frame_secs, frame_secs.max(dt_secs), asked, flyer.streaming().detail(&moment));
        let frame_ms = frame_secs * 1e3;
        let (t_secs, cut) = (flight.time(place), is_cut(flight, place));
        let memory = if self.stats.is_some() { ProcessMemory::now() } else { ProcessMemory::default() };
        let line = Line { frame, t_secs, frame_ms, draw_ms, cut, memory, stats: flyer.stats() };
        if let Some(file) = &mut self.stats {
            file.add(&line)?;
        }
        let thumbnail = self.report.as_mut().is_some_and(|r| r.add(&line));
        if thumbnail || self.args.frames.is_some() {
            self.keep_picture(flyer, frame, thumbnail)?;
        }
        for export in self.args.export_view.iter().filter(|e| e.frame == frame) {
            export_view(flyer.streaming(), &moment, &export.path)?;
        }
        Ok(line)
    }

    /// Reads the picture back, for --frames and for the report.
    fn keep_picture(&mut self, flyer: &Flyer, frame: u32, thumbnail: bool) -> Result<()> {
        let Some((size, pixels)) = flyer.picture()? else { return Ok(()) };
        if let Some(folder) = &self.args.frames {
            let name = format!("frame_{frame:05}.{}", self.args.format.extension());
            self.args.format.write(&folder.join(name), size, &pixels)?;
        }
        if let Some(report) = self.report.as_mut().filter(|_| thumbnail) {
            report.picture(size, &pixels)?;
        }
        Ok(())
    }
}

fn export_view(streaming: &Streaming, moment: &Moment, path: &Path) -> Result<()> {
    let shown = streaming.shown(moment);
    let surface = shown.surface()?;
    write_ply(path, &surface, &shown.eye, streaming.model.record())
}

/// Sums for the line at the end.
#[derive(Default)]
struct Total {
    start: StartTimes,
    frames: u32,
    ms: f64,
    triangles: u64,
    vram_bytes: u64,
    ram_bytes: u64,
}

impl Total {
    fn add(&mut self, Line { stats, frame_ms, .. }: &Line) {
        self.frames += 1;
        self.ms += frame_ms;
        self.triangles += stats.triangles;
        self.vram_bytes = self.vram_bytes.max(stats.vram_bytes);
        self.ram_bytes = self.ram_bytes.max(stats.ram_bytes);
    }

    fn print(&self, files: &[(&str, Option<PathBuf>)], damaged: u32) -> Result<()> {
        let mut text = format!(
            "{} frames, {:.1} ms and {} triangles each on average; at most {} of VRAM and {} of RAM\n",
            self.frames,
            self.ms / self.frames as f64,
            self.triangles / self.frames as u64,
            show_bytes(self.vram_bytes),
            show_bytes(self.ram_bytes)
        );
        let StartTimes { adapter_ms, first_picture_ms } = self.start;
        text +=
            &format!("first picture after {first_picture_ms:.0} ms, and {adapter_ms:.0} ms for the graphics adapter\n");
        for (what, path) in files {
            if let Some(path) = path {
                text += &format!("{what}: {}\n", path.display());
            }
        }
        // Whoever reads may have gone (`| head`); that is no failure.
        match std::io::stdout().lock().write_all(text.as_bytes()) {
            Err(e) if e.kind() != ErrorKind::BrokenPipe => return Err(e).context("standard output"),
            _ => {}
        }
        if damaged > 0 {
            eprintln!(
                "pb-view: {damaged} damaged chunks were left out; the picture is coarser there. Bake the archive again"
            );
        }
        Ok(())
    }
}
