//! What each stream of a chunk costs.

use super::{Chunk, PREFIX_BYTES, Stored, store};
use std::ops::AddAssign;

/// Packed bytes of a chunk by what they say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamBytes {
    /// Positions, as offsets from the cluster's origin.
    pub positions: u64,
    /// Normals.
    pub normals: u64,
    /// Colours, or texture coordinates in their place.
    pub colors: u64,
    /// Parents at the next coarser level.
    pub parents: u64,
    /// Border slots.
    pub slots: u64,
    /// Index buffers.
    pub indices: u64,
    /// What chunks have besides: lengths, and what the codec spends on vertices that say nothing.
    pub frames: u64,
}

impl StreamBytes {
    /// Of a chunk, packed anew. Fields lie on channels of their own, which the vertex codec packs one after the other: what one
    /// costs is what a chunk takes that has nothing else, less what one takes that has nothing at all.
    pub fn of(chunk: &Chunk) -> StreamBytes {
        let shape = chunk.shape();
        let stored: Vec<Stored> = chunk.vertices.iter().map(|v| store(v, shape)).collect();
        let packed = |keep: &dyn Fn(&Stored) -> Stored| -> u64 {
            let part: Vec<Stored> = stored.iter().map(keep).collect();
            super::encode_vertices(&part).len() as u64
        };
        let nothing = packed(&|_| Stored::default());
        let alone = |keep: &dyn Fn(&Stored) -> Stored| packed(keep).saturating_sub(nothing);
        StreamBytes {
            positions: alone(&|s| Stored { offset: s.offset, ..Stored::default() }),
            normals: alone(&|s| Stored { normal: s.normal, ..Stored::default() }),
            colors: alone(&|s| Stored { color: s.color, ..Stored::default() }),
            parents: alone(&|s| Stored { parent: s.parent, ..Stored::default() }),
            slots: alone(&|s| Stored { slot: s.slot, ..Stored::default() }),
            indices: super::encode_indices(&chunk.indices, shape).len() as u64,
            frames: nothing + PREFIX_BYTES as u64,
        }
    }

    /// All of them, with their names.
    pub fn named(&self) -> [(&'static str, u64); 7] {
        let StreamBytes { positions, normals, colors, parents, slots, indices, frames } = *self;
        [
            ("positions", positions),
            ("normals", normals),
            ("colors", colors),
            ("parents", parents),
            ("slots", slots),
            ("indices", indices),
            ("frames", frames),
        ]
    }

    /// Bytes of all.
    pub fn total(&self) -> u64 {
        self.named().iter().map(|n| n.1).sum()
    }
}

impl AddAssign for StreamBytes {
    fn add_assign(&mut self, other: StreamBytes) {
        self.positions += other.positions;
        self.normals += other.normals;
        self.colors += other.colors;
        self.parents += other.parents;
        self.slots += other.slots;
        self.indices += other.indices;
        self.frames += other.frames;
    }
}
