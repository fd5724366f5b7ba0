//! Kernels on textures: sources, resampling into cluster tiles, mip chains, block compression.
//!
//! Must never: do I/O or keep a thread. Colours are averaged in linear light only.
//!
//! A tile goes through three steps, one call each:
//! [`Coverage::new`] says which chart owns which texel of every mip, once for all maps of a tile;
//! [`bake_tile`] makes the mip chain of one map; [`encode`] packs its mips.

mod bake;
pub mod block;
mod color;
mod coverage;
pub mod image;
mod mips;
mod normal;
mod raster;
mod sample;
#[cfg(test)]
mod tests;
pub mod veil;

pub use bake::{BakeOptions, MapKind, NormalSpace, TileSource, bake_tile, scratch_bytes};
pub use block::{BlockFormat, Quality, decode, encode, encode_shown};
pub use color::{Coding, Texels};
pub use coverage::{Coverage, TileLayout};
pub use mips::Mips;
