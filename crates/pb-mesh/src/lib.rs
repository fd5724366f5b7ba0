//! Geometry kernels on slices: repair, normals, connectivity, segmentation, simplification, distances.
//!
//! Must never: do I/O, read a clock, keep a thread. Loops are data parallel, and no result depends on their order.

pub mod charts;
mod closest;
pub mod corners;
pub mod deviation;
pub mod material;
pub mod mesh;
pub mod normals;
pub mod numbering;
pub mod objects;
pub mod order;
pub mod polygon;
pub mod progress;
pub mod repair;
pub mod segment;
pub mod simplify;
pub mod split;
pub mod texture;
pub mod topology;
pub mod weld;
