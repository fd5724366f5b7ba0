//! The parts of pb-bake that tests, benchmarks and fuzz targets call: importers, image decoders and mesh writers.

pub mod export;
mod guard;
pub mod images;
pub mod import;
pub mod xatlas;
