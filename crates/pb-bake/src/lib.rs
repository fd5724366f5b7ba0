//! The parts of pb-bake that tests, benchmarks and fuzz targets call: importers, image decoders, mesh writers, and the
//! allocator that bounds a bake's memory.

pub mod export;
mod guard;
pub mod images;
pub mod import;
pub mod memory;
pub mod traces;
pub mod xatlas;
