//! Decoding asks for no memory once it has had the largest chunk.

use pb_lod::progressive_buffers::codec::{Chunk, ChunkShape, Decoder, encode_chunk};
use pb_lod::progressive_buffers::layout::Vertex;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator, which counts what this thread asks for.
struct Counting;

thread_local! {
    static ASKED: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: all is the system's.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ASKED.set(ASKED.get() + 1);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, start: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(start, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A strip of `count` triangles, all its vertices new or half of them.
fn strip(count: u16, coarser: u16) -> Chunk {
    let vertex = |i: u16| Vertex {
        offset: [i, i / 2, i % 7],
        parent: if coarser == 0 { i } else { i % coarser },
        normal_slot: Vertex::pack_normal_slot([0.0, 0.5, 0.5], 0),
        color: [255; 4],
    };
    Chunk {
        first_vertex: coarser.into(),
        vertices: (coarser..count + 2).map(vertex).collect(),
        indices: (0..count).flat_map(|i| [i, i + 1, i + 2]).collect(),
    }
}

#[test]
fn a_decoder_that_has_had_the_largest_chunk_asks_for_no_memory() {
    let chunks = [strip(9000, 0), strip(9000, 4000), strip(20, 3), strip(5000, 11)];
    let packed: Vec<(ChunkShape, Vec<u8>)> = chunks.iter().map(|c| (c.shape(), encode_chunk(c))).collect();
    let (mut decoder, mut out) = (Decoder::default(), Chunk::default());
    let mut pass = || {
        let before = ASKED.get();
        for ((shape, bytes), chunk) in packed.iter().zip(&chunks) {
            decoder.decode(bytes, *shape, &mut out).unwrap();
            assert_eq!((&out.vertices, out.indices.len()), (&chunk.vertices, chunk.indices.len()));
        }
        ASKED.get() - before
    };
    assert!(pass() > 0, "the count sees what is asked for");
    assert_eq!([pass(), pass()], [0, 0]);
}
