//! pb-mesh
mod closest;
pub mod deviation;
pub mod mesh;
pub mod weld;
pub mod repair;
pub mod polygon;
pub mod normals;
pub mod corners;
pub mod segment;
pub mod simplify;
pub mod split;
pub mod topology;
