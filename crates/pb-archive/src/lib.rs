//! pb-archive
