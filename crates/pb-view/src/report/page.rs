//! The page: one file that a browser shows without a network, light or dark. It is well-formed XML as well, so that
//! other programs can read it.

use anyhow::Result;
use std::fmt::Write;

use super::panels::panels;
use super::runs::{Facts, OtherRun};
use super::summary::{Bytes, Cut, Missing, Spread, Summary, Use};
use super::svg::tick;
use super::thumbs::Thumb;
use crate::size::show_bytes;
use crate::stats::Table;

const STYLE: &str = include_str!("style.css");

/// What the page is made of.
pub struct Content<'a> {
    /// What was run.
    pub facts: &'a Facts,
    /// In a few numbers.
    pub summary: &'a Summary,
    /// Frame by frame.
    pub table: &'a Table,
    /// Runs to compare with.
    pub others: &'a [OtherRun],
    /// Pictures.
    pub thumbs: &'a [Thumb],
}

/// The whole page.
pub fn page(content: &Content) -> Result<String> {
    let facts = content.facts;
    let title = format!("{} - {}", escape(&facts.label), escape(&facts.archive.name));
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<header>\n<h1>{title}</h1>\n<p>{}</p>\n\
         </header>\n",
        escape(&subtitle(facts))
    );
    out += &tiles(content);
    out += "<section class=\"plots\">\n";
    for panel in panels(content) {
        let svg = panel.plot.svg()?;
        let _ = writeln!(out, "<figure id=\"plot-{}\">\n{svg}</figure>", panel.id);
    }
    out += "</section>\n";
    out += &thumbs(content.thumbs);
    out += "<section class=\"tables\">\n";
    out += &numbers(content);
    out += &cuts(content);
    out += &facts_table(facts);
    out += "</section>\n</body>\n</html>\n";
    Ok(out)
}

/// Text for the inside of an element or an attribute.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            // No XML text may hold control characters, however they are written.
            c if c.is_control() && !c.is_whitespace() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

fn subtitle(facts: &Facts) -> String {
    let (run, archive) = (&facts.run, &facts.archive);
    format!(
        "{} triangles in {} clusters and {} levels{}, {} on disk; {} frames of {} x {} on {}",
        tick(archive.triangles_in as f64),
        archive.clusters,
        archive.level_triangles.len(),
        if archive.textures { ", textured" } else { "" },
        show_bytes(archive.bytes),
        run.frames,
        run.width,
        run.height,
        if facts.adapter.name.is_empty() { "no adapter" } else { &facts.adapter.name }
    )
}

fn percent(share: f64) -> String {
    // Rounded down: 100 % is said of what is whole only.
    format!("{:.2} %", (share * 1e4).floor() / 1e2)
}

fn ms(value: f64) -> String {
    format!("{value:.1} ms")
}

/// The numbers that one looks for first.
fn tiles(content: &Content) -> String {
    let s = content.summary;
    let start = s.cuts.first().and_then(|c| c.ms_to_full);
    let tiles = [
        (ms(s.frame_ms.p50), "median frame time", format!("{:.1} frames per second", s.fps_mean)),
        (ms(s.frame_ms.p99), "99 % of frames within", format!("slowest {}", ms(s.frame_ms.max))),
        (percent(s.vram.peak_share), "of the video memory bound at most", show_bytes(s.vram.peak_bytes)),
        (percent(s.ram.peak_share), "of the memory bound at most", show_bytes(s.ram.peak_bytes)),
        (
            percent(s.missing.complete_share_after_start),
            "of frames with nothing missing",
            format!("after the first second; {} frames incomplete", s.missing.incomplete_frames_after_start),
        ),
        (
            start.map_or("not reached".to_owned(), ms),
            "to full detail at the start",
            format!("{} cuts after it", s.cuts.len().saturating_sub(1)),
        ),
        (
            show_bytes(s.bytes.disk_bytes),
            "read from disk in flight",
            format!("{} more than was needed", percent(s.bytes.extra_share)),
        ),
    ];
    let mut out = "<section class=\"tiles\">\n".to_owned();
    for (value, what, more) in tiles {
        let _ = writeln!(out, "<div><b>{value}</b><span>{what}</span><small>{more}</small></div>");
    }
    out + "</section>\n"
}

fn thumbs(thumbs: &[Thumb]) -> String {
    let mut out = "<section class=\"thumbs\">\n".to_owned();
    for thumb in thumbs {
        let (line, why) = (&thumb.line, thumb.why.iter().map(|w| w.text()).collect::<Vec<_>>().join(", "));
        let _ = writeln!(
            out,
            "<figure><img src=\"{}\" alt=\"frame {}\"/><figcaption><b>{why}</b><br/>frame {} at {:.2} s: {}, {} \
             triangles, {} missing</figcaption></figure>",
            thumb.address,
            line.frame,
            line.frame,
            line.t_secs,
            ms(line.frame_ms),
            tick(line.stats.triangles as f64),
            line.stats.missing_chunks
        );
    }
    out + "</section>\n"
}

/// A row of the table of numbers: what, and how to show it of a summary.
type Row = (&'static str, fn(&Summary) -> String);

fn spread(of: fn(&Summary) -> &Spread, s: &Summary, show: fn(f64) -> String) -> String {
    let Spread { mean, p50, p90, p99, max } = *of(s);
    [mean, p50, p90, p99, max].map(show).join(" / ")
}

fn tier(of: &Use) -> String {
    let above = if of.frames_above > 0 { format!("; {} frames above", of.frames_above) } else { String::new() };
    format!(
        "{} at most ({}), {} on average ({}) of {}{above}",
        show_bytes(of.peak_bytes),
        percent(of.peak_share),
        show_bytes(of.mean_bytes),
        percent(of.mean_share),
        show_bytes(of.bound_bytes)
    )
}

const ROWS: [Row; 14] = [
    ("frame time [ms]: mean / 50 % / 90 % / 99 % / max", |s| spread(|s| &s.frame_ms, s, |v| format!("{v:.1}"))),
    ("selection, cache and commands [ms]", |s| spread(|s| &s.cpu_ms, s, |v| format!("{v:.2}"))),
    ("frames per second", |s| format!("{:.1}", s.fps_mean)),
    ("triangles", |s| spread(|s| &s.triangles, s, tick)),
    ("draws", |s| spread(|s| &s.draws, s, tick)),
    ("error shown [pixels]", |s| spread(|s| &s.error_px, s, |v| format!("{v:.2}"))),
    ("video memory", |s| tier(&s.vram)),
    ("decoded chunks in memory", |s| tier(&s.ram)),
    ("process at most", |s| {
        format!("{}, {} without mapped files", show_bytes(s.rss_peak_bytes), show_bytes(s.rss_private_peak_bytes))
    }),
    ("missing chunks", |s| spread(|s| &s.missing.chunks, s, tick)),
    ("frames with nothing missing", |s| {
        let Missing { complete_share, complete_share_after_start, max_after_start, .. } = s.missing;
        let after = percent(complete_share_after_start);
        format!("{}; after the first second {after}, at most {max_after_start} missing", percent(complete_share))
    }),
    ("disk to memory (stored)", |s| {
        let Bytes { disk_bytes, prefetch_bytes, needed_bytes, read_bytes, reads, extra_share, .. } = s.bytes;
        let [disk, ahead, needed, read] = [disk_bytes, prefetch_bytes, needed_bytes, read_bytes].map(show_bytes);
        format!(
            "{disk}, {ahead} of it ahead of need, in {reads} reads of {read} together; {needed} were needed, so {} extra",
            percent(extra_share)
        )
    }),
    ("memory to adapter (decoded)", |s| show_bytes(s.bytes.upload_bytes)),
    ("full detail at the start", |s| s.cuts.first().map_or(String::new(), cut_text)),
];

fn numbers(content: &Content) -> String {
    let others = content.others.iter().map(|o| (o.facts.label.as_str(), &o.summary));
    let runs: Vec<(&str, &Summary)> =
        [(content.facts.label.as_str(), content.summary)].into_iter().chain(others).collect();
    let mut out = "<table id=\"numbers\">\n<caption>Numbers</caption>\n<tr><th></th>".to_owned();
    for (label, _) in &runs {
        let _ = write!(out, "<th>{}</th>", escape(label));
    }
    out += "</tr>\n";
    for (what, show) in ROWS {
        let _ = write!(out, "<tr><th>{what}</th>");
        for (_, summary) in &runs {
            let _ = write!(out, "<td>{}</td>", show(summary));
        }
        out += "</tr>\n";
    }
    out + "</table>\n"
}

fn cut_text(cut: &Cut) -> String {
    let reached = |frames: Option<u32>, wall: Option<f64>| match frames.zip(wall) {
        Some((frames, wall)) => format!("after {frames} frames, {}", ms(wall)),
        None => "not reached".to_owned(),
    };
    format!(
        "nothing missing {}; faded in {}",
        reached(cut.frames_to_complete, cut.ms_to_complete),
        reached(cut.frames_to_full, cut.ms_to_full)
    )
}

/// Times to full detail after the start.
fn cuts(content: &Content) -> String {
    let cuts = content.summary.cuts.get(1..).unwrap_or(&[]);
    if cuts.is_empty() {
        return String::new();
    }
    let mut out = "<table id=\"cuts\">\n<caption>Full detail after a cut</caption>\n".to_owned();
    for cut in cuts {
        let _ = writeln!(out, "<tr><th>frame {} at {:.2} s</th><td>{}</td></tr>", cut.frame, cut.t_secs, cut_text(cut));
    }
    out + "</table>\n"
}

fn facts_table(facts: &Facts) -> String {
    let (archive, adapter, run, bounds) = (&facts.archive, &facts.adapter, &facts.run, &facts.bounds);
    let levels: Vec<String> = archive.level_triangles.iter().map(|&t| tick(t as f64)).collect();
    let software = if adapter.software { ", in software" } else { "" };
    let settle = if run.settle { ", each settled" } else { "" };
    let rows = [
        ("command", facts.command.join(" ")),
        ("program", facts.program.clone()),
        (
            "archive",
            format!(
                "{}: {} ({} decoded), {} chunks; {} read when it is opened",
                archive.name,
                show_bytes(archive.bytes),
                show_bytes(archive.decoded_bytes),
                archive.chunks,
                show_bytes(archive.start_bytes)
            ),
        ),
        ("triangles per level", levels.join(" / ")),
        (
            "adapter",
            match adapter.name.is_empty() {
                true => "none: nothing was drawn or read".to_owned(),
                false => format!("{} ({} {}{software})", adapter.name, adapter.backend, adapter.driver),
            },
        ),
        (
            "first picture",
            format!("after {}, and {} for the adapter", ms(facts.start.first_picture_ms), ms(facts.start.adapter_ms)),
        ),
        (
            "pictures",
            format!(
                "{} x {}, {} samples, {} frames at {} per second of flight{settle}",
                run.width, run.height, run.samples, run.frames, run.fps
            ),
        ),
        (
            "video memory made",
            format!(
                "{}, {} of it for textures",
                show_bytes(bounds.vram_planned_bytes),
                show_bytes(bounds.texture_vram_bytes)
            ),
        ),
    ];
    let mut out = "<table id=\"facts\">\n<caption>What was run</caption>\n".to_owned();
    for (what, value) in rows {
        let _ = writeln!(out, "<tr><th>{what}</th><td>{}</td></tr>", escape(&value));
    }
    out + "</table>\n"
}
