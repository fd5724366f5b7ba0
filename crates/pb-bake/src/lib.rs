//! The parts of pb-bake that tests, benchmarks and fuzz targets call: importers and mesh writers.

pub mod export;
pub mod import;
pub mod xatlas;
