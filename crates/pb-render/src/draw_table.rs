//! The part of a frame's drawing that needs no adapter: from a plan to the arguments of its draws, and the floors of its
//! textures.
//!
//! Must never: touch the GPU.

use pb_lod::plan::Draw;

use crate::gpu_model::{LEVEL_SLOTS, ModelTables};
use crate::heap::{Heap, HeapFull, Move, Range, UNIT_BYTES};
use crate::tables::DrawArguments;

/// Where the chunks of geometry lie in the heap, and how large they are.
pub struct DrawTable {
    levels: u32,
    pub(crate) heap: Heap,
    /// By chunk: vertices that it adds, indices of its level.
    pub(crate) sizes: Vec<[u32; 2]>,
}

impl DrawTable {
    /// With an empty heap of so many units, the first of which hold the coarse buffer.
    pub fn new(t: &ModelTables, heap_units: u32, coarse_units: u32) -> Self {
        let chunks = 0..t.levels.len();
        Self {
            levels: t.model.levels,
            heap: Heap::new(heap_units, coarse_units, t.levels.len()),
            sizes: chunks.map(|c| [t.new_vertices(c), t.levels[c].triangles * 3]).collect(),
        }
    }

    /// Units of the heap that a chunk fills: vertices, then indices.
    pub fn units(&self, chunk: usize) -> u32 {
        let [vertices, indices] = self.sizes[chunk];
        vertices + (indices * 2).div_ceil(UNIT_BYTES as u32)
    }

    /// Finds a place for a chunk that has none; as [`Heap::allocate`].
    pub fn place(&mut self, chunk: usize) -> Result<(Range, Vec<Move>), HeapFull> {
        self.heap.allocate(chunk, self.units(chunk))
    }

    /// Takes a chunk's place back.
    pub fn free(&mut self, chunk: usize) {
        self.heap.free(chunk);
    }

    /// Arguments of draws, in their order.
    ///
    /// # Panics
    /// If a drawn chunk has no place (I5).
    pub fn arguments(&self, draws: &[Draw]) -> Vec<DrawArguments> {
        draws.iter().map(|draw| self.argument(draw)).collect()
    }

    pub(crate) fn argument(&self, &Draw { cluster, level, .. }: &Draw) -> DrawArguments {
        let slot = (cluster * self.levels + level) as usize;
        let range = self.heap.range(slot).expect("only resident chunks are drawn (I5)");
        let [vertices, indices] = self.sizes[slot];
        DrawArguments {
            index_count: indices,
            instance_count: 1,
            first_index: (range.first + vertices) * (UNIT_BYTES as u32 / 2),
            base_vertex: 0,
            first_instance: cluster * LEVEL_SLOTS + level,
        }
    }
}

/// Floors of textures (levels, by cluster), never finer than what is resident.
pub fn texture_floors(floors: &[f32], finest: &[u32]) -> Vec<f32> {
    floors.iter().zip(finest).map(|(floor, &finest)| floor.max(finest as f32)).collect()
}
