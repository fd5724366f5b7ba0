//! Progressive buffers after Sander and Mitchell (SGP 2005), restated with one record per vertex.
//!
//! - [`layout`]: what the archive's tables and chunks hold, and nothing else;
//! - [`display`]: the display rule, the Rust twin of the vertex shader;
//! - [`switch`]: how the rule's switch distances are filled, from errors or from bands;
//! - [`select`]: what to draw, load and give back in a frame.

pub mod display;
pub mod layout;
pub mod select;
pub mod switch;
