//! Level-of-detail schemes: each in one folder with its layout, bake, selection and tests.
//!
//! Must never: touch a GPU, read a clock, start a thread that outlives a call, know about windows.
//! The rest of the system sees a scheme only through [`plan`].

pub mod plan;
pub mod progressive_buffers;
