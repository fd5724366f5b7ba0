//! Progressive buffers after Sander and Mitchell (SGP 2005), restated with one record per vertex.
//!
//! - [`layout`]: what the archive's tables and chunks hold, and nothing else;
//! - [`bake`](mod@bake): a clean mesh becomes tables and chunks;
//! - [`codec`]: chunk payloads, packed and unpacked;
//! - [`hierarchy`]: the coarse buffer hierarchy and the order of the clusters;
//! - [`write`](mod@write): a finished bake becomes a file;
//! - [`model`]: a file becomes a checked model;
//! - [`verify`](mod@verify): checks every promise of a model on its decoded data;
//! - [`display`]: the display rule, the Rust twin of the vertex shader;
//! - [`displayed_surface`](mod@displayed_surface): what a frame shows, all clusters welded;
//! - [`textures`]: maps, tiles, and which mips lie in which chunk;
//! - [`instances`]: objects that stand in several places;
//! - [`switch`]: how the rule's switch distances are filled, from errors or from bands;
//! - [`select`]: what to draw, load and give back in a frame.

pub mod bake;
#[cfg(test)]
mod baked_torus;
pub mod codec;
pub mod display;
pub mod displayed_surface;
#[cfg(test)]
mod format_tests;
#[cfg(test)]
mod grid_torus;
pub mod hierarchy;
pub mod instances;
pub mod layout;
mod level_mesh;
pub mod model;
mod model_check;
#[cfg(test)]
mod model_tests;
pub mod select;
pub mod switch;
pub mod textures;
pub mod verify;
pub mod write;
