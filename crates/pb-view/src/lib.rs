//! The viewer: window, input, flypaths, headless runs and their reports.
//!
//! The program is thin over pb-lod (what to draw), pb-stream (what is where) and pb-render (how it is drawn).
//! This library is its inside, so that tests can reach it.

pub mod args;
pub mod exchange;
mod export;
pub mod failure;
pub mod feed;
mod flyer;
pub mod flypath;
mod frame_rate;
mod headless;
mod meter;
pub mod navigate;
mod overlay;
mod picture;
pub mod prefetch;
pub mod report;
mod screen;
pub mod simulate;
mod size;
mod stage;
mod stats;
pub mod streaming;
mod upload_pace;
mod window;

/// Runs the program.
pub fn run(args: args::Args) -> anyhow::Result<failure::Outcome> {
    match args.without_window() {
        true => headless::run(&args),
        false => window::run(args),
    }
}
