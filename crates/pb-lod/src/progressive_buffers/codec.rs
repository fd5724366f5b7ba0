//! Chunk payloads: the vertices that a level adds and its index buffer, packed with meshopt's codecs.
//!
//! Vertices are stored as 20-byte records whose fields fall on the codec's 16-bit and 8-bit channels (position and
//! normal components are not split across bytes, border slots stand alone). Indices are rotated so that a level's
//! own vertices, which are numbered in order of first use, start at 0, where the index codec has its cheapest codes.
//! docs/format.md gives the bytes, docs/decisions/002-chunk-codec.md the figures.
//!
//! Must never: trust a byte. Whatever `decode_chunk` accepts has all indices and parents in range.

mod streams;
mod unpack;

pub use streams::StreamBytes;

use super::layout::Vertex;
use bytemuck::{Pod, Zeroable};

/// Most vertices of one cluster (indices are u16, and 65535 stays free).
pub const MAX_VERTICES: u32 = 65_535;
/// Most triangles of one cluster.
pub const MAX_TRIANGLES: u32 = 1 << 20;

/// What one level adds to the next coarser one in one cluster.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chunk {
    /// `n_{i+1}`: vertices of the coarser levels, which are in their chunks; 0 at the coarsest level.
    pub first_vertex: u32,
    /// Vertices `[n_{i+1}, n_i)`.
    pub vertices: Vec<Vertex>,
    /// Index buffer of level i: a triangle list over the prefix `[0, n_i)`.
    pub indices: Vec<u16>,
}

/// The counts of a chunk, as the archive's tables give them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkShape {
    /// `n_{i+1}`, 0 at the coarsest level.
    pub first_vertex: u32,
    /// `n_i`.
    pub end_vertex: u32,
    /// Triangles of level i.
    pub triangles: u32,
}

impl ChunkShape {
    /// Bytes of the chunk when decoded: 16 per vertex and 2 per index, the latter rounded up to 4.
    pub fn decoded_bytes(&self) -> u32 {
        (self.end_vertex - self.first_vertex) * 16 + (self.triangles * 6).next_multiple_of(4)
    }
}

impl Chunk {
    /// The counts of this chunk.
    pub fn shape(&self) -> ChunkShape {
        ChunkShape {
            first_vertex: self.first_vertex,
            end_vertex: self.first_vertex + self.vertices.len() as u32,
            triangles: (self.indices.len() / 3) as u32,
        }
    }
}

/// Why a payload is no chunk of the expected shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The two lengths at the start do not add up to the payload's.
    #[error("the lengths of its parts do not fit its {bytes} bytes")]
    Lengths {
        /// Length of the payload.
        bytes: usize,
    },
    /// The vertex part does not decode.
    #[error("its vertices do not decode")]
    Vertices,
    /// The index part does not decode.
    #[error("its indices do not decode")]
    Indices,
    /// A triangle corner past the last vertex of the level.
    #[error("index {place} refers to vertex {index}, but there are only {vertices}")]
    Index {
        /// Position in the index buffer.
        place: usize,
        /// Its value.
        index: u16,
        /// `n_i`.
        vertices: u32,
    },
    /// A parent that does not live at the next coarser level (I3).
    #[error("vertex {vertex} has parent {parent}, which does not live at the next coarser level")]
    Parent {
        /// Index in the cluster.
        vertex: u32,
        /// Its parent.
        parent: u16,
    },
}

/// A vertex as the codec sees it. 20 bytes.
#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct Stored {
    offset: [u16; 3],
    /// At the coarsest level, where a vertex is its own parent, 0.
    parent: u16,
    normal: [u16; 2],
    color: [u8; 4],
    slot: u32,
}

/// Bytes in front of the two parts: their lengths as u32.
const PREFIX_BYTES: usize = 8;

/// Packs a chunk. The triangles keep their order and orientation, but may start at another corner.
///
/// # Panics
/// If the chunk breaks a limit of the format: it would not be read back.
pub fn encode_chunk(chunk: &Chunk) -> Vec<u8> {
    let shape = chunk.shape();
    assert!(
        shape.end_vertex <= MAX_VERTICES && shape.triangles <= MAX_TRIANGLES && chunk.indices.len().is_multiple_of(3)
    );
    check(chunk).expect("a chunk's indices and parents are in range");
    let stored: Vec<Stored> = chunk.vertices.iter().map(|v| store(v, shape)).collect();
    let (vertices, indices) = (encode_vertices(&stored), encode_indices(&chunk.indices, shape));
    let mut bytes = Vec::with_capacity(PREFIX_BYTES + vertices.len() + indices.len());
    bytes.extend((vertices.len() as u32).to_le_bytes());
    bytes.extend((indices.len() as u32).to_le_bytes());
    bytes.extend(vertices);
    bytes.extend(indices);
    bytes
}

fn encode_vertices(stored: &[Stored]) -> Vec<u8> {
    match stored.is_empty() {
        true => Vec::new(),
        false => meshopt::encode_vertex_buffer_level(stored, 3, Some(1)).expect("20-byte records are encodable"),
    }
}

fn encode_indices(indices: &[u16], shape: ChunkShape) -> Vec<u8> {
    let rotated: Vec<u32> = indices.iter().map(|&i| rotate(i as u32, shape)).collect();
    match rotated.is_empty() {
        true => Vec::new(),
        false => {
            meshopt::encode_index_buffer(&rotated, shape.end_vertex as usize).expect("triangle lists are encodable")
        }
    }
}

/// Unpacks and checks a payload from outside.
///
/// # Errors
/// See [`CodecError`].
pub fn decode_chunk(bytes: &[u8], shape: ChunkShape) -> Result<Chunk, CodecError> {
    let mut chunk = Chunk::default();
    Decoder::default().decode(bytes, shape, &mut chunk)?;
    Ok(chunk)
}

/// Decodes chunk after chunk. Once it, and the chunks that it decodes into, have had the largest, no memory is asked for.
#[derive(Default)]
pub struct Decoder {
    stored: Vec<Stored>,
}

impl Decoder {
    /// Unpacks and checks a payload from outside into `chunk`, whose vectors keep their room. After an error its content is
    /// undefined.
    ///
    /// # Errors
    /// See [`CodecError`].
    pub fn decode(&mut self, bytes: &[u8], shape: ChunkShape, chunk: &mut Chunk) -> Result<(), CodecError> {
        let (vertices, indices) = split(bytes).ok_or(CodecError::Lengths { bytes: bytes.len() })?;
        chunk.first_vertex = shape.first_vertex;
        self.decode_vertices(vertices, shape, &mut chunk.vertices)?;
        decode_indices(indices, shape, &mut chunk.indices)?;
        check(chunk)
    }

    fn decode_vertices(&mut self, bytes: &[u8], shape: ChunkShape, out: &mut Vec<Vertex>) -> Result<(), CodecError> {
        let count = shape.end_vertex.checked_sub(shape.first_vertex).ok_or(CodecError::Vertices)?;
        if shape.end_vertex > MAX_VERTICES || (count == 0) != bytes.is_empty() {
            return Err(CodecError::Vertices);
        }
        out.clear();
        if count > 0 {
            self.stored.resize(count as usize, Stored::default());
            if !unpack::vertices(bytes, &mut self.stored) {
                return Err(CodecError::Vertices);
            }
            match shape.first_vertex {
                0 => out.extend(self.stored.iter().enumerate().map(|(i, s)| restore(s, i as u16))),
                _ => out.extend(self.stored.iter().map(|s| restore(s, s.parent))),
            }
        }
        Ok(())
    }
}

fn split(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (prefix, rest) = bytes.split_at_checked(PREFIX_BYTES)?;
    let length = |at: usize| u32::from_le_bytes(prefix[at..at + 4].try_into().expect("four bytes")) as usize;
    let (vertices, indices) = rest.split_at_checked(length(0))?;
    (indices.len() == length(4)).then_some((vertices, indices))
}

fn decode_indices(bytes: &[u8], shape: ChunkShape, out: &mut Vec<u16>) -> Result<(), CodecError> {
    // The codec spends at least one byte on a triangle, so a short payload cannot ask for much memory.
    let count = shape.triangles as usize;
    if shape.triangles > MAX_TRIANGLES || count > bytes.len() || (count == 0) != bytes.is_empty() {
        return Err(CodecError::Indices);
    }
    out.resize(count * 3, 0);
    if count > 0 && !unpack::indices(bytes, out) {
        return Err(CodecError::Indices);
    }
    // The inverse of `rotate`, without a branch; values past the end stay there and are refused by `check`.
    let (first, end) = (shape.first_vertex as u16, shape.end_vertex as u16);
    let new = end - first;
    for i in out {
        let own = i.wrapping_add(first);
        let coarser = i.wrapping_sub(new);
        let inside = if *i < new { own } else { coarser };
        *i = if *i < end { inside } else { *i };
    }
    Ok(())
}

/// Own vertices `[n_{i+1}, n_i)` first, then the coarser ones.
fn rotate(index: u32, shape: ChunkShape) -> u32 {
    match index.checked_sub(shape.first_vertex) {
        Some(own) => own,
        None => index + shape.end_vertex - shape.first_vertex,
    }
}

fn store(v: &Vertex, shape: ChunkShape) -> Stored {
    Stored {
        offset: v.offset,
        parent: if shape.first_vertex == 0 { 0 } else { v.parent },
        normal: [(v.normal_slot & 0xfff) as u16, (v.normal_slot >> 12 & 0xfff) as u16],
        color: v.color,
        slot: v.normal_slot >> 24,
    }
}

fn restore(s: &Stored, parent: u16) -> Vertex {
    Vertex {
        offset: s.offset,
        parent,
        normal_slot: (s.normal[0] & 0xfff) as u32 | ((s.normal[1] & 0xfff) as u32) << 12 | s.slot << 24,
        color: s.color,
    }
}

/// Indices below `n_i`; parents below `n_{i+1}`, or the vertex itself at the coarsest level (I3).
fn check(chunk: &Chunk) -> Result<(), CodecError> {
    let shape = chunk.shape();
    let most = chunk.indices.iter().copied().max();
    if most.is_some_and(|most| u32::from(most) >= shape.end_vertex) {
        let place = chunk.indices.iter().position(|&i| u32::from(i) >= shape.end_vertex).expect("the largest is one");
        return Err(CodecError::Index { place, index: chunk.indices[place], vertices: shape.end_vertex });
    }
    let most = chunk.vertices.iter().map(|v| v.parent).max();
    if shape.first_vertex > 0 && most.is_none_or(|most| u32::from(most) < shape.first_vertex) {
        return Ok(());
    }
    for (vertex, v) in (shape.first_vertex..).zip(&chunk.vertices) {
        let fits = match shape.first_vertex {
            0 => v.parent as u32 == vertex,
            coarser => (v.parent as u32) < coarser,
        };
        if !fits {
            return Err(CodecError::Parent { vertex, parent: v.parent });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wavy grid of `side * side` vertices whose first `coarser` ones belong to coarser levels.
    fn grid(side: u32, coarser: u32) -> Chunk {
        let vertex = |i: u32| Vertex {
            offset: [(i % side * 300) as u16, (i / side * 300) as u16, (i * i % 97) as u16],
            parent: if coarser == 0 { i as u16 } else { (i % coarser) as u16 },
            normal_slot: Vertex::pack_normal_slot([0.1, (i as f32).sin() * 0.2, 0.9], (i % 3) as u8),
            color: [i as u8, 2, 3, 255],
        };
        let corner = |x: u32, y: u32| (y * side + x) as u16;
        let cells = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| (x, y)));
        let indices = cells.flat_map(|(x, y)| {
            let (a, b, c, d) = (corner(x, y), corner(x + 1, y), corner(x, y + 1), corner(x + 1, y + 1));
            [a, b, c, c, b, d]
        });
        Chunk {
            first_vertex: coarser,
            vertices: (coarser..side * side).map(vertex).collect(),
            indices: indices.collect(),
        }
    }

    /// Triangles as sets of corners in order, each starting at its smallest.
    fn canonical(indices: &[u16]) -> Vec<[u16; 3]> {
        let start = |t: &[u16]| (0..3).min_by_key(|&k| t[k]).unwrap();
        indices.chunks(3).map(|t| std::array::from_fn(|k| t[(start(t) + k) % 3])).collect()
    }

    #[test]
    fn a_chunk_is_read_back_as_it_was_with_corners_rotated_at_most() {
        for chunk in [grid(20, 0), grid(20, 100), grid(256, 3).clone(), grid(2, 4)] {
            if chunk.shape().end_vertex > MAX_VERTICES {
                continue;
            }
            let decoded = decode_chunk(&encode_chunk(&chunk), chunk.shape()).unwrap();
            assert_eq!(decoded.vertices, chunk.vertices);
            assert_eq!(canonical(&decoded.indices), canonical(&chunk.indices));
        }
        let empty = Chunk { first_vertex: 7, ..Chunk::default() };
        assert_eq!(decode_chunk(&encode_chunk(&empty), empty.shape()).unwrap(), empty);
    }

    #[test]
    fn streams_add_up_to_about_the_chunk_and_what_says_nothing_costs_nothing() {
        for chunk in [grid(20, 0), grid(200, 100)] {
            let (streams, bytes) = (StreamBytes::of(&chunk), encode_chunk(&chunk).len() as u64);
            assert!(streams.total().abs_diff(bytes) * 50 <= bytes, "{streams:?} {bytes}");
            assert!(streams.positions > 0 && streams.normals > 0 && streams.indices > 0);
        }
        let mut plain = grid(20, 0);
        plain.vertices.iter_mut().for_each(|v| v.color = [0; 4]);
        assert_eq!(StreamBytes::of(&plain).colors, 0);
        assert_eq!(StreamBytes::of(&plain).parents, 0, "at the coarsest level");
    }

    #[test]
    fn decoding_is_repeatable_on_its_own_output() {
        let chunk = grid(20, 100);
        let once = decode_chunk(&encode_chunk(&chunk), chunk.shape()).unwrap();
        let twice = decode_chunk(&encode_chunk(&once), once.shape()).unwrap();
        assert_eq!(once.vertices, twice.vertices);
        assert_eq!(canonical(&once.indices), canonical(&twice.indices));
    }

    #[test]
    fn any_cut_and_any_flipped_bit_gives_an_error_or_a_chunk_in_range() {
        let chunk = grid(8, 10);
        let bytes = encode_chunk(&chunk);
        for length in 0..bytes.len() {
            assert!(decode_chunk(&bytes[..length], chunk.shape()).is_err(), "{length}");
        }
        for bit in 0..bytes.len() * 8 {
            let mut bad = bytes.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            if let Ok(decoded) = decode_chunk(&bad, chunk.shape()) {
                check(&decoded).unwrap();
            }
        }
    }

    #[test]
    fn a_payload_of_another_shape_is_refused() {
        let chunk = grid(8, 10);
        let bytes = encode_chunk(&chunk);
        let shape = chunk.shape();
        for other in [
            ChunkShape { first_vertex: 65, ..shape },
            ChunkShape { end_vertex: 63, ..shape },
            ChunkShape { end_vertex: 70_000, ..shape },
            ChunkShape { triangles: 97, ..shape },
            ChunkShape { triangles: u32::MAX, ..shape },
            ChunkShape { triangles: 0, ..shape },
        ] {
            assert!(decode_chunk(&bytes, other).is_err(), "{other:?}");
        }
    }

    #[test]
    fn parents_and_indices_out_of_range_are_named() {
        let mut chunk = grid(8, 10);
        chunk.vertices[3].parent = 10;
        assert_eq!(check(&chunk), Err(CodecError::Parent { vertex: 13, parent: 10 }));
        let mut chunk = grid(8, 10);
        chunk.indices[5] = 64;
        assert_eq!(check(&chunk), Err(CodecError::Index { place: 5, index: 64, vertices: 64 }));
        let mut coarsest = grid(8, 0);
        coarsest.vertices[1].parent = 0;
        assert_eq!(check(&coarsest), Err(CodecError::Parent { vertex: 1, parent: 0 }));
    }
}
