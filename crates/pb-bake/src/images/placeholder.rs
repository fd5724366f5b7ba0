//! What stands in the place of a missing or broken image.

use pb_mesh::texture::image::{Image, TexelFormat};
use std::sync::Arc;

/// Texels of a side.
const SIDE: u32 = 64;
/// Texels of a field's side.
const FIELD: u32 = 8;

/// A checker of magenta and black, as engines show what is missing.
pub fn placeholder() -> Image {
    let texel = |i: u32| {
        let (x, y) = (i % SIDE / FIELD, i / SIDE / FIELD);
        if (x + y).is_multiple_of(2) { [255u8, 0, 255] } else { [0; 3] }
    };
    let bytes: Vec<u8> = (0..SIDE * SIDE).flat_map(texel).collect();
    Image::new(SIDE, SIDE, TexelFormat::Rgb8, Arc::new(bytes))
}
