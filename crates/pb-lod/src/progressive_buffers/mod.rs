//! Progressive buffers after Sander and Mitchell (SGP 2005), restated with one record per vertex.
//!
//! - [`layout`]: what the archive's tables and chunks hold, and nothing else;
//! - [`display`]: the display rule, the Rust twin of the vertex shader.

pub mod display;
pub mod layout;
