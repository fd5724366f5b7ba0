//! Decodes arbitrary bytes as a source image of whatever kind they claim to be.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pb_bake::images::{DecodeOptions, ImageContent, ImageSource, decode};

fuzz_target!(|data: &[u8]| {
    let source = ImageSource { name: "fuzz".into(), content: ImageContent::Bytes(data.into()) };
    let options = DecodeOptions { max_texels: 1 << 22, ..DecodeOptions::default() };
    if let Ok(image) = decode(&source, &options) {
        assert!(u64::from(image.width()) * u64::from(image.height()) <= options.max_texels);
    }
});
