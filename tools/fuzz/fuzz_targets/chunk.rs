//! Decodes arbitrary bytes as a chunk of an arbitrary shape; what is accepted must be in range and pack again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pb_lod::progressive_buffers::codec::{ChunkShape, decode_chunk, encode_chunk};

fuzz_target!(|data: &[u8]| {
    let Some((shape, payload)) = data.split_at_checked(8) else { return };
    let number = |at: usize| u16::from_le_bytes([shape[at], shape[at + 1]]) as u32;
    let shape = ChunkShape { first_vertex: number(0), end_vertex: number(2), triangles: number(4) };
    if let Ok(chunk) = decode_chunk(payload, shape) {
        assert!(chunk.indices.iter().all(|&i| (i as u32) < shape.end_vertex));
        let again = decode_chunk(&encode_chunk(&chunk), shape).expect("what was decoded can be packed");
        assert_eq!(again.vertices, chunk.vertices);
    }
});
