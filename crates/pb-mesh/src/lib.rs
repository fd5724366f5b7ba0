//! pb-mesh
pub mod mesh;
