//! Tests of the renderer: shaders without an adapter, and the display rule and pictures on one.

mod pictures;
mod random_model;
mod shaders;
mod textured_model;
mod textures;
mod twin;

use pb_render::{Gpu, RenderError};

/// The adapter, or `None` after saying loudly that the test did not run.
fn adapter(test: &str) -> Option<Gpu> {
    match Gpu::headless() {
        Ok(gpu) => Some(gpu),
        Err(RenderError::NoAdapter(reason)) => {
            eprintln!("SKIPPED: no Vulkan adapter: {test} did not run ({reason})");
            None
        }
        Err(e) => panic!("the adapter cannot be opened: {e}"),
    }
}
