//! pb-stream
