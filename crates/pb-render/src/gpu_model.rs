//! A model on the adapter: its tables, the coarse buffer, and the heap of resident chunks.
//!
//! All buffers that hold model data are made here, once, inside one byte bound; nothing grows later.
//! Must never: exceed the bound; read the archive; decide what is resident (the caller does).

use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::instances::Instances;
use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord, ModelRecord, Vertex};
use pb_lod::progressive_buffers::model::{FLAG_COLORS, FLAG_CUTOUT};
use pb_lod::progressive_buffers::textures::Textures;
use wgpu::BufferUsages;

use crate::crowd::{Crowd, Room};
use crate::draw_table::DrawTable;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::heap::{HeapFull, Move, UNIT_BYTES, plannable_units};
use crate::share::{Party, share};
use crate::squares::PagesFull;
use crate::tables::{ClusterGpu, LevelGpu};
use crate::texture_pool::PageLimits;
use crate::tiles::{GpuTiles, TexturePlan};

/// Levels per cluster that fit beside the cluster's index in an instance number.
pub(crate) const LEVEL_SLOTS: u32 = 16;

/// The archive's tables as the renderer reads them once.
#[derive(Clone, Copy)]
pub struct ModelTables<'a> {
    /// The whole model.
    pub model: &'a ModelRecord,
    /// Clusters in file order.
    pub clusters: &'a [ClusterRecord],
    /// `cluster * levels + level`.
    pub levels: &'a [LevelRecord],
    /// Concatenated neighbour lists.
    pub neighbours: &'a [u32],
    /// Where the model has textures.
    pub textures: Option<Textures<'a>>,
    /// Objects and instances, where the model has them.
    pub instances: Option<Instances<'a>>,
}

impl ModelTables<'_> {
    fn level_count(&self) -> usize {
        self.model.levels as usize
    }

    /// Vertices that `chunk` adds to the coarser ones.
    pub(crate) fn new_vertices(&self, chunk: usize) -> u32 {
        let coarser = if (chunk + 1).is_multiple_of(self.level_count()) { 0 } else { self.levels[chunk + 1].vertices };
        self.levels[chunk].vertices - coarser
    }

    /// Units of the heap that a chunk fills: vertices, then indices.
    fn units(&self, chunk: usize) -> u32 {
        self.new_vertices(chunk) + (self.levels[chunk].triangles * 6).div_ceil(UNIT_BYTES as u32)
    }

    /// Bytes of each geometry chunk in VRAM, `cluster * levels + level`. A coarsest chunk lies in the coarse
    /// buffer: vertices with their cluster's index, and 32-bit indices.
    pub fn chunk_vram_bytes(&self) -> Vec<u64> {
        let coarsest = |chunk: usize| (chunk + 1).is_multiple_of(self.level_count());
        let bytes = |chunk: usize| match coarsest(chunk) {
            true => self.new_vertices(chunk) as u64 * 20 + self.levels[chunk].triangles as u64 * 12,
            false => self.units(chunk) as u64 * UNIT_BYTES,
        };
        (0..self.levels.len()).map(bytes).collect()
    }

    /// Sum of `f` over the coarsest chunks.
    fn coarse_sum(&self, f: impl Fn(usize) -> u32) -> u64 {
        (0..self.levels.len()).skip(self.level_count() - 1).step_by(self.level_count()).map(|c| f(c) as u64).sum()
    }

    fn finer(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.levels.len()).filter(|c| !(c + 1).is_multiple_of(self.level_count())).map(|c| self.units(c))
    }
}

/// One decoded chunk: what a level adds to the next coarser one.
#[derive(Clone, Copy)]
pub struct ChunkData<'a> {
    /// Vertices `[n_{level+1}, n_level)`.
    pub vertices: &'a [Vertex],
    /// Index buffer of the level, three per triangle, local to the cluster.
    pub indices: &'a [u16],
}

/// What is always there.
#[derive(Clone, Copy)]
pub struct Coarse<'a> {
    /// The coarsest chunk of each cluster.
    pub chunks: &'a [ChunkData<'a>],
    /// The last texture chunk of each cluster, mips as the archive has them; empty where there are no textures.
    pub tails: &'a [&'a [u8]],
}

/// What an adapter can hold.
#[derive(Clone, Copy, Debug)]
pub struct AdapterLimits {
    /// Largest buffer that a shader can see whole, bytes.
    pub binding_bytes: u64,
    /// Of textures.
    pub pages: PageLimits,
    /// Compressed texels can be read as they are.
    pub blocks: bool,
}

impl AdapterLimits {
    /// No adapter: what every one with memory of its own has, and compressed textures.
    pub const COMMON: AdapterLimits = AdapterLimits {
        binding_bytes: (2 << 30) - 1,
        pages: PageLimits { side: 16384, layers: 2048, bytes: 4 << 30 },
        blocks: true,
    };

    /// Of an opened adapter.
    pub fn of(gpu: &Gpu) -> Self {
        Self { binding_bytes: gpu.largest_storage_bytes(), pages: PageLimits::of(gpu), blocks: gpu.texture_blocks }
    }
}

/// How the bytes of a bound are spent on a model.
#[derive(Clone, Debug)]
pub struct VramPlan {
    /// Tables, coarse indices and scratch space, bytes; not those of the textures.
    pub fixed_bytes: u64,
    /// Vertices of the coarse buffer at the start of the heap, units.
    coarse_units: u64,
    /// The whole heap, units.
    heap_units: u64,
    largest_units: u32,
    /// Where the model has textures.
    textures: Option<TexturePlan>,
}

impl VramPlan {
    /// Splits `bound` bytes between geometry and textures by what the model has of each.
    /// Fails with the size that would do where the coarsest level does not fit.
    pub fn new(tables: &ModelTables, bound: u64, limits: &AdapterLimits) -> Result<Self, RenderError> {
        let chunks = tables.levels.len() as u64;
        let clusters = tables.clusters.len() as u64;
        let coarse_units = tables.coarse_sum(|c| tables.new_vertices(c));
        let largest_units = tables.finer().max().unwrap_or(0);
        let coarse_index_bytes = tables.coarse_sum(|c| tables.levels[c].triangles) * 12;
        let room = Room::new(tables);
        let per_cluster = (size_of::<ClusterGpu>() + size_of::<f32>()) as u64;
        let per_chunk = (size_of::<LevelGpu>() + size_of::<f32>()) as u64;
        let fixed_bytes = clusters * per_cluster
            + chunks * per_chunk
            + (tables.neighbours.len() as u64 + coarse_units).max(1) * 4
            + room.bytes()
            + coarse_index_bytes
            + largest_units as u64 * UNIT_BYTES;
        let mut plan = Self { fixed_bytes, coarse_units, heap_units: 0, largest_units, textures: None };
        if let Some(t) = &tables.textures {
            let textures = TexturePlan::new(t, bound, &limits.pages, limits.blocks);
            plan.textures = Some(textures.ok_or(RenderError::TileTooLarge { limit: limits.pages.side })?);
        }
        plan.split(tables, bound, limits)?;
        Ok(plan)
    }

    /// Gives the heap and each texture pool its part of `bound`.
    fn split(&mut self, tables: &ModelTables, bound: u64, limits: &AdapterLimits) -> Result<(), RenderError> {
        let fixed = self.fixed_bytes + self.textures.as_ref().map_or(0, TexturePlan::fixed_bytes);
        let slack = self.largest_units as u64 / 8 + 17;
        let whole = self.coarse_units + tables.finer().map(u64::from).sum::<u64>() + slack;
        let most = limits.binding_bytes.min(u32::MAX as u64 * UNIT_BYTES) / UNIT_BYTES;
        if self.coarse_units > most {
            let needed = fixed + self.coarse_units * UNIT_BYTES;
            return Err(RenderError::BoundTooSmall { needed, bound: fixed + most * UNIT_BYTES });
        }
        let bytes = |units: u64| units.min(most) * UNIT_BYTES;
        let mut parties = self.textures.as_ref().map_or(Vec::new(), |t| t.parties(&limits.pages));
        let enough = bytes(self.coarse_units + self.largest_units as u64 + slack);
        parties.push(Party { least: bytes(self.coarse_units), enough, all: bytes(whole), step: UNIT_BYTES });
        let shares = bound.checked_sub(fixed).and_then(|bytes| share(bytes, &parties)).ok_or_else(|| {
            let needed = fixed + parties.iter().map(|p| p.least).sum::<u64>();
            RenderError::BoundTooSmall { needed, bound }
        })?;
        self.heap_units = (shares[shares.len() - 1] / UNIT_BYTES).max(1);
        if let Some(t) = &mut self.textures {
            t.give(&shares[..shares.len() - 1]);
        }
        Ok(())
    }

    /// Bytes that finer chunks of geometry may fill together, in those of [`ModelTables::chunk_vram_bytes`].
    pub fn chunk_budget_bytes(&self) -> u64 {
        let units = plannable_units((self.heap_units - self.coarse_units) as u32, self.largest_units);
        units as u64 * UNIT_BYTES
    }

    /// Budget for texture chunks that are no tails, and what each texture chunk costs of it (bytes, or more where
    /// the pool of one of its formats is short). Nothing where the model has no textures.
    pub fn texture_costs(&self, tables: &ModelTables) -> (u64, Vec<u64>) {
        self.textures.as_ref().zip(tables.textures.as_ref()).map_or((0, Vec::new()), |(plan, t)| plan.costs(t))
    }

    /// Tables, scratch space and the coarse buffer: what is there from the start, but for the tails of textures.
    pub fn start_bytes(&self) -> u64 {
        let textures = self.textures.as_ref().map_or(0, TexturePlan::fixed_bytes);
        self.fixed_bytes + self.coarse_units * UNIT_BYTES + textures
    }

    /// The part of [`VramPlan::bytes`] that is textures and their tables.
    pub fn texture_bytes(&self) -> u64 {
        self.textures.as_ref().map_or(0, TexturePlan::bytes)
    }

    /// Bytes of all memory that the model will hold on the adapter: at most the bound.
    pub fn bytes(&self) -> u64 {
        self.fixed_bytes + self.heap_units * UNIT_BYTES + self.texture_bytes()
    }
}

/// Buffers and bookkeeping of one model.
pub struct GpuModel {
    pub(crate) levels: u32,
    pub(crate) clusters: u32,
    pub(crate) has_colors: bool,
    pub(crate) heap_buffer: wgpu::Buffer,
    pub(crate) cluster_buffer: wgpu::Buffer,
    pub(crate) level_buffer: wgpu::Buffer,
    pub(crate) distance_buffer: wgpu::Buffer,
    pub(crate) floor_buffer: wgpu::Buffer,
    /// Neighbour lists, then the cluster of each vertex of the coarse buffer.
    pub(crate) link_buffer: wgpu::Buffer,
    pub(crate) first_owner: u32,
    /// What instances need in each frame.
    pub(crate) frame_buffer: wgpu::Buffer,
    pub(crate) coarse_index_buffer: wgpu::Buffer,
    pub(crate) argument_buffer: wgpu::Buffer,
    scratch: wgpu::Buffer,
    pub(crate) draws: DrawTable,
    /// Where the model has instances.
    pub(crate) crowd: Option<Crowd>,
    plan: VramPlan,
    /// As on the adapter.
    level_table: Vec<LevelGpu>,
    /// First index of each cluster in the coarse buffer, and the end of the last.
    coarse_first: Vec<u32>,
    /// Where the model has textures.
    pub(crate) tiles: Option<GpuTiles>,
}

impl GpuModel {
    /// Makes all buffers and textures, and uploads tables and what is always there.
    pub fn new(gpu: &Gpu, t: &ModelTables, coarse: &Coarse, bound: u64) -> Result<Self, RenderError> {
        assert_eq!(coarse.chunks.len(), t.clusters.len(), "one coarsest chunk per cluster");
        assert!(t.model.levels <= LEVEL_SLOTS && t.levels.len() == t.clusters.len() * t.level_count());
        let plan = VramPlan::new(t, bound, &AdapterLimits::of(gpu))?;
        let tiles = t.textures.as_ref().zip(plan.textures.clone());
        let cutouts = t.model.flags & FLAG_CUTOUT != 0;
        let tiles = tiles.map(|(textures, plan)| GpuTiles::new(gpu, textures, plan, coarse.tails, cutouts));
        let buffer = |name: &str, bytes: u64, usage: BufferUsages| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(name),
                size: bytes.max(4).next_multiple_of(4),
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let storage = BufferUsages::STORAGE;
        let (clusters, chunks) = (t.clusters.len() as u64, t.levels.len() as u64);
        let room = Room::new(t);
        let heap_usage = storage | BufferUsages::INDEX | BufferUsages::COPY_SRC;
        let mut out = Self {
            levels: t.model.levels,
            clusters: t.model.clusters,
            has_colors: t.model.flags & FLAG_COLORS != 0,
            heap_buffer: buffer("heap", plan.heap_units * UNIT_BYTES, heap_usage),
            cluster_buffer: buffer("clusters", clusters * size_of::<ClusterGpu>() as u64, storage),
            level_buffer: buffer("levels", chunks * size_of::<LevelGpu>() as u64, storage),
            distance_buffer: buffer("distances", chunks * 4, storage),
            floor_buffer: buffer("floors", clusters * 4, storage),
            link_buffer: buffer("links", (t.neighbours.len() as u64 + plan.coarse_units) * 4, storage),
            first_owner: t.neighbours.len() as u32,
            frame_buffer: buffer("frame", room.frame_bytes(), storage),
            coarse_index_buffer: buffer(
                "coarse indices",
                t.coarse_sum(|c| t.levels[c].triangles) * 12,
                BufferUsages::INDEX,
            ),
            argument_buffer: buffer("draws", room.argument_bytes(), BufferUsages::INDIRECT),
            scratch: buffer("scratch", plan.largest_units as u64 * UNIT_BYTES, BufferUsages::COPY_SRC),
            draws: DrawTable::new(t, plan.heap_units as u32, plan.coarse_units as u32),
            crowd: t.instances.map(|instances| Crowd::new(&instances, t.model, room)),
            plan,
            level_table: t.levels.iter().map(|l| LevelGpu { vertices: l.vertices, base: 0 }).collect(),
            coarse_first: vec![0],
            tiles,
        };
        out.upload_tables(gpu, t);
        out.upload_coarse(gpu, coarse.chunks);
        Ok(out)
    }

    fn upload_tables(&self, gpu: &Gpu, t: &ModelTables) {
        let cluster = |c: &ClusterRecord| ClusterGpu {
            origin: c.origin,
            shift: c.shift,
            neighbours_first: c.neighbours_first,
            reserved: [0; 3],
        };
        let clusters: Vec<ClusterGpu> = t.clusters.iter().map(cluster).collect();
        gpu.queue.write_buffer(&self.cluster_buffer, 0, bytemuck::cast_slice(&clusters));
        gpu.queue.write_buffer(&self.link_buffer, 0, bytemuck::cast_slice(t.neighbours));
    }

    fn upload_coarse(&mut self, gpu: &Gpu, coarse: &[ChunkData]) {
        let (mut vertices, mut owners, mut indices) = (Vec::<Vertex>::new(), Vec::<u32>::new(), Vec::<u32>::new());
        let last = self.levels as usize - 1;
        for (c, chunk) in coarse.iter().enumerate() {
            let slot = c * self.levels as usize + last;
            assert_eq!(
                [chunk.vertices.len() as u32, chunk.indices.len() as u32],
                self.draws.sizes[slot],
                "as the table says"
            );
            let base = vertices.len() as u32;
            self.level_table[slot].base = base;
            vertices.extend_from_slice(chunk.vertices);
            owners.extend(std::iter::repeat_n(c as u32, chunk.vertices.len()));
            indices.extend(chunk.indices.iter().map(|&i| base + i as u32));
            self.coarse_first.push(indices.len() as u32);
        }
        gpu.queue.write_buffer(&self.heap_buffer, 0, bytemuck::cast_slice(&vertices));
        gpu.queue.write_buffer(&self.link_buffer, u64::from(self.first_owner) * 4, bytemuck::cast_slice(&owners));
        gpu.queue.write_buffer(&self.coarse_index_buffer, 0, bytemuck::cast_slice(&indices));
        gpu.queue.write_buffer(&self.level_buffer, 0, bytemuck::cast_slice(&self.level_table));
    }

    /// Bytes that the finer chunks may fill together: the byte bound of a cache in front of this model, in the
    /// bytes of [`ModelTables::chunk_vram_bytes`].
    pub fn chunk_budget_bytes(&self) -> u64 {
        self.plan.chunk_budget_bytes()
    }

    /// Bytes in use now: tables, coarse buffer, resident chunks. Never more than the bound.
    pub fn vram_bytes(&self) -> u64 {
        self.plan.fixed_bytes + self.draws.heap.used_units() as u64 * UNIT_BYTES + self.texture_vram_bytes()
    }

    /// The part of [`GpuModel::vram_bytes`] that is textures and their tables.
    pub fn texture_vram_bytes(&self) -> u64 {
        self.tiles.as_ref().map_or(0, GpuTiles::used_bytes)
    }

    /// How the bound is spent.
    pub fn plan(&self) -> &VramPlan {
        &self.plan
    }

    /// Budget for texture chunks that are no tails, and what each texture chunk costs of it (bytes, or more where
    /// the pool of one of its formats is short). Nothing where the model has no textures.
    pub fn texture_costs(&self) -> (u64, Vec<u64>) {
        self.tiles.as_ref().map_or((0, Vec::new()), GpuTiles::costs)
    }

    /// The texture chunk behind a chunk's number, which follow those of the geometry.
    fn texture_chunk(&self, chunk: ChunkId) -> Option<usize> {
        (chunk.0 as usize).checked_sub(self.draws.sizes.len())
    }

    /// Makes a texture chunk resident; `bytes` are its mips as the archive has them. A no-op for tails and for
    /// chunks without mips. Fails only when resident chunks cost more than the budget of [`Self::texture_costs`].
    ///
    /// # Panics
    /// If the chunk is one of geometry, or the bytes are not as many as the tables say.
    pub fn upload_texture(&mut self, gpu: &Gpu, chunk: ChunkId, bytes: &[u8]) -> Result<(), PagesFull> {
        let texture = self.texture_chunk(chunk).expect("texture chunks follow those of geometry");
        self.tiles.as_mut().expect("the model has textures").upload(gpu, texture, bytes)
    }

    /// Makes a chunk of geometry resident; a no-op for the coarsest level, which always is.
    /// Fails only when chunks of more than [`Self::chunk_budget_bytes`] are resident.
    pub fn upload(&mut self, gpu: &Gpu, chunk: ChunkId, data: ChunkData) -> Result<(), HeapFull> {
        let slot = chunk.0 as usize;
        let [vertices, indices] = self.draws.sizes[slot];
        assert_eq!([data.vertices.len() as u32, data.indices.len() as u32], [vertices, indices], "as the table says");
        if self.is_coarsest(slot) || self.draws.heap.range(slot).is_some() {
            return Ok(());
        }
        let units = self.draws.units(slot);
        let (range, moves) = self.draws.place(slot)?;
        if !moves.is_empty() {
            self.carry_out(gpu, &moves);
        }
        let mut bytes = vec![0u8; units as usize * UNIT_BYTES as usize];
        let (head, tail) = bytes.split_at_mut(size_of_val(data.vertices));
        head.copy_from_slice(bytemuck::cast_slice(data.vertices));
        tail[..size_of_val(data.indices)].copy_from_slice(bytemuck::cast_slice(data.indices));
        gpu.queue.write_buffer(&self.heap_buffer, range.first as u64 * UNIT_BYTES, &bytes);
        self.set_base(gpu, slot);
        Ok(())
    }

    /// Takes a chunk out; nothing drawn from now on may need it.
    pub fn free(&mut self, chunk: ChunkId) {
        match (self.texture_chunk(chunk), &mut self.tiles) {
            (Some(texture), Some(tiles)) => tiles.free(texture),
            _ => {
                self.draws.heap.free(chunk.0 as usize);
            }
        }
    }

    /// True when the chunk may be drawn, as far as it alone goes.
    pub fn is_resident(&self, chunk: ChunkId) -> bool {
        if let (Some(texture), Some(tiles)) = (self.texture_chunk(chunk), &self.tiles) {
            return tiles.is_resident(texture);
        }
        self.is_coarsest(chunk.0 as usize) || self.draws.heap.range(chunk.0 as usize).is_some()
    }

    fn is_coarsest(&self, slot: usize) -> bool {
        (slot + 1).is_multiple_of(self.levels as usize)
    }

    /// Tells the shader where a slot's vertices lie.
    fn set_base(&mut self, gpu: &Gpu, slot: usize) {
        let range = self.draws.heap.range(slot).expect("the slot was just filled");
        self.level_table[slot].base = range.first.wrapping_sub(self.level_table[slot + 1].vertices);
        let offset = (slot * size_of::<LevelGpu>()) as u64;
        gpu.queue.write_buffer(&self.level_buffer, offset, bytemuck::bytes_of(&self.level_table[slot]));
    }

    /// Slides ranges of the heap through the scratch buffer, and tells the shader.
    fn carry_out(&mut self, gpu: &Gpu, moves: &[Move]) {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for m in moves {
            let bytes = m.units as u64 * UNIT_BYTES;
            encoder.copy_buffer_to_buffer(&self.heap_buffer, m.from as u64 * UNIT_BYTES, &self.scratch, 0, bytes);
            encoder.copy_buffer_to_buffer(&self.scratch, 0, &self.heap_buffer, m.to as u64 * UNIT_BYTES, bytes);
        }
        gpu.queue.submit([encoder.finish()]);
        for slot in 0..self.level_table.len() {
            if self.draws.heap.range(slot).is_some() {
                self.set_base(gpu, slot);
            }
        }
    }

    /// Where a cluster's triangles lie in the coarse buffer, in indices.
    pub fn coarse_range(&self, cluster: u32) -> std::ops::Range<u32> {
        self.coarse_first[cluster as usize]..self.coarse_first[cluster as usize + 1]
    }

    /// Indices of the whole coarse buffer.
    pub fn coarse_indices(&self) -> u32 {
        *self.coarse_first.last().expect("starts with 0")
    }
}
