//! The viewer: window, input, flypaths, headless runs and their reports.
//!
//! The program is thin over pb-lod (what to draw), pb-stream (what is where) and pb-render (how it is drawn).
//! This library is its inside, so that tests can reach it.

pub mod args;
pub mod flypath;
pub mod navigate;
mod overlay;
mod picture;
mod size;
mod stats;
