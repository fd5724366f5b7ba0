//! pb-render
