//! Reads arbitrary bytes as a PLY file, without any file beside it.
#![no_main]

mod imported;

use libfuzzer_sys::fuzz_target;
use pb_bake::import::Format;

fuzz_target!(|data: &[u8]| imported::import(Format::Ply, data));
