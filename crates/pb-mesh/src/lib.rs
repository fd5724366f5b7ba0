//! pb-mesh
