//! Time of a frame's work on the processor, on one thread and without an adapter, by number of clusters: selection, the
//! viewer's own work around it, the cache's decisions, and the commands for the adapter. `just bench-frame` runs it.
//!
//! The camera flies in a circle through the middle of a [`City`] that is larger than the bounds: half of what the view
//! asks for fits. Each frame is timed after the view has filled, and, apart from that, while it fills.

mod city;
mod viewer;

use city::City;
use viewer::{Ahead, Times, Viewer};

/// Frames while the first view fills, those left out until memory is full, and those of the steady flight.
const COLD: usize = 60;
const FILL: usize = 300;
const STEADY: usize = 300;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut sizes: Vec<u32> = arguments.iter().filter_map(|a| a.parse().ok()).collect();
    if sizes.is_empty() {
        sizes = vec![1_000, 3_000, 10_000, 30_000, 100_000, 300_000];
    }
    let wanted = |ahead: &Ahead| {
        let names = arguments.iter().any(|a| Ahead::ALL.iter().any(|x| x.name() == *a));
        !names || arguments.iter().any(|a| a == ahead.name())
    };
    println!("{}", processor());
    let mut curves = Vec::new();
    for ahead in Ahead::ALL.into_iter().filter(wanted) {
        println!("\n### {}\n\n{HEADER}", ahead.says());
        let mut curve = Vec::new();
        for &clusters in &sizes {
            let city = City::new(clusters);
            let mut viewer = Viewer::new(&city, ahead);
            let cold: Vec<Times> = (0..COLD).map(|_| viewer.frame()).collect();
            (0..FILL).for_each(|_| {
                viewer.frame();
            });
            let steady: Vec<Times> = (0..STEADY).map(|_| viewer.frame()).collect();
            println!("{}", row(clusters, &cold, &steady, &viewer));
            curve.push((clusters, median(&steady, Times::sum)));
        }
        curves.push((ahead, curve));
    }
    println!("\ngrowth: exponent of the number of clusters between one row and the next\n");
    for (ahead, curve) in curves {
        let growth = curve.windows(2).map(|w| {
            let [(n, t), (m, u)] = [w[0], w[1]];
            format!("{:.2}", (u / t).ln() / (f64::from(m) / f64::from(n)).ln())
        });
        println!("- {}: {}", ahead.name(), growth.collect::<Vec<_>>().join(", "));
    }
}

const HEADER: &str = "\
| clusters | select | viewer | cache | commands | all: least | median | 99 % | cold: median | wants | draws | loads/frame | missing/frame | fingerprint |
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

fn row(clusters: u32, cold: &[Times], steady: &[Times], viewer: &Viewer) -> String {
    let parts = [Times::select, Times::viewer, Times::cache, Times::commands].map(|part| {
        let (median, high) = (median(steady, part), percentile(steady, part, 0.99));
        format!("{median:.3} / {high:.3}")
    });
    let tally = viewer.tally();
    format!(
        "| {clusters} | {} | {:.3} | **{:.3}** | {:.3} | {:.3} | {} | {} | {:.1} | {:.1} | {:016x} |",
        parts.join(" | "),
        percentile(steady, Times::sum, 0.0),
        median(steady, Times::sum),
        percentile(steady, Times::sum, 0.99),
        median(cold, Times::sum),
        tally.wants,
        tally.draws,
        tally.loads as f64 / tally.frames as f64,
        tally.missing as f64 / tally.frames as f64,
        tally.fingerprint,
    )
}

fn median(times: &[Times], part: fn(&Times) -> f64) -> f64 {
    percentile(times, part, 0.5)
}

fn percentile(times: &[Times], part: fn(&Times) -> f64, share: f64) -> f64 {
    let mut ms: Vec<f64> = times.iter().map(part).collect();
    ms.sort_by(f64::total_cmp);
    ms[((ms.len() - 1) as f64 * share).round() as usize]
}

fn processor() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|l| l.strip_prefix("model name").and_then(|l| l.split_once(": ")));
    name.map_or("unknown processor", |(_, name)| name).to_owned()
}
