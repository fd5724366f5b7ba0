//! Kernels on textures: sources, resampling into cluster tiles, mip chains, block compression.
//!
//! Must never: do I/O or keep a thread. Colours are averaged in linear light only.

pub mod image;
