//! An archive opened as a progressive-buffers model: tables in memory, chunks read and decoded on demand.
//!
//! All tables are compared with one another when the model is opened, and each chunk with its tables when it is
//! read; so whoever holds a [`Model`] or a [`Chunk`] from it may index without further checks. The deeper promises
//! (I1, I2, I4, I6), which need whole clusters, are the business of [`verify`](super::verify).
//!
//! Must never: panic on any file; change one.

use super::codec::{Chunk, ChunkShape, CodecError, Decoder};
use super::instances::{INSTANCES, InstanceRecord, Instances, OBJECTS, ObjectRecord, Placement};
use super::layout::*;
use super::textures::{MAPS, MapRecord, TILES, Textures, TileRecord};
use super::{model_check, write::KNOWN_FEATURES};
use crate::plan::ChunkId;
use bytemuck::Pod;
use glam::DVec3;
use pb_archive::{Archive, ArchiveError, Fault, Table};
use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Bit 0 of [`ModelRecord::flags`]: vertices carry colours.
pub const FLAG_COLORS: u32 = 1;
/// Bit 1: the model has textures, and vertices texture coordinates instead of colours.
pub const FLAG_TEXTURES: u32 = 2;
/// Bit 2: base colours with an alpha below one half are holes.
pub const FLAG_CUTOUT: u32 = 4;
/// Bit 3: there are objects and instances.
pub const FLAG_INSTANCES: u32 = 8;

/// Why an archive is no sound model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The container is at fault, or the machine.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// Two tables, or a table and itself, contradict one another.
    #[error("{}: {what}: {why}; the file is damaged or written by a faulty program", path.display())]
    Table {
        /// The archive.
        path: PathBuf,
        /// Which record.
        what: String,
        /// What does not fit.
        why: String,
    },
    /// A chunk that does not decode to what the tables say.
    #[error("{}: cluster {cluster} level {level} (chunk {}): {fault}; bake the archive again", path.display(), chunk.0)]
    Chunk {
        /// The archive.
        path: PathBuf,
        /// Which chunk.
        chunk: ChunkId,
        /// Its cluster.
        cluster: u32,
        /// Its level.
        level: u32,
        /// What is wrong with it.
        fault: ChunkFault,
    },
}

/// What is wrong with a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChunkFault {
    /// It does not decode, or its indices are out of range.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A vertex outside the model's bounds.
    #[error("vertex {vertex} lies outside the model's bounds")]
    Bounds {
        /// Index in the cluster.
        vertex: u32,
    },
    /// Texture mips of another size than the tables say.
    #[error("it has {found} bytes of texels instead of {expected}")]
    TextureBytes {
        /// Stored.
        found: usize,
        /// By the tables.
        expected: u32,
    },
    /// A border slot past the neighbour list.
    #[error("vertex {vertex} has border slot {slot}, but the cluster has {neighbours} neighbours")]
    Slot {
        /// Index in the cluster.
        vertex: u32,
        /// Its border slot.
        slot: u8,
        /// Length of the list.
        neighbours: u32,
    },
}

/// A level of one cluster, ready to draw.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Prefix {
    /// Vertices `[0, n_level)`, coarsest first.
    pub vertices: Vec<Vertex>,
    /// Index buffer of the level.
    pub indices: Vec<u16>,
}

/// Clusters that stand together, in one place or in several.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// One object's.
    pub clusters: Range<u32>,
    /// Counted from the model's origin.
    pub placements: Vec<Placement>,
}

/// An open, checked model.
pub struct Model {
    archive: Archive,
    record: ModelRecord,
    clusters: Table<ClusterRecord>,
    levels: Table<LevelRecord>,
    neighbours: Table<u32>,
    nodes: Table<NodeRecord>,
    model_levels: Table<ModelLevelRecord>,
    textures: Option<(Table<MapRecord>, Table<TileRecord>)>,
    instances: Option<(Table<ObjectRecord>, Table<InstanceRecord>)>,
}

impl Model {
    /// Opens and checks an archive: container, tables, and the tables against one another.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        Self::from_archive(Archive::open(path, KNOWN_FEATURES)?)
    }

    /// The same on a copy of bytes in memory; `name` is for messages.
    pub fn from_bytes(name: &Path, bytes: &[u8]) -> Result<Self, ModelError> {
        Self::from_archive(Archive::from_bytes(name, bytes, KNOWN_FEATURES)?)
    }

    fn from_archive(archive: Archive) -> Result<Self, ModelError> {
        let scheme = archive.header().scheme;
        if scheme != SCHEME {
            let (found, expected) = (scheme.escape_ascii().to_string(), SCHEME.escape_ascii().to_string());
            return Err(ArchiveError::new(archive.path(), Fault::Scheme { found, expected }).into());
        }
        let fail =
            |what: &str, why: String| ModelError::Table { path: archive.path().to_owned(), what: what.into(), why };
        let record: &[ModelRecord] = archive.section(MODEL)?;
        let [record] = record else {
            return Err(fail("the model record", format!("there are {} of it", record.len())));
        };
        let model = Self {
            record: *record,
            clusters: archive.table(CLUSTERS)?,
            levels: archive.table(LEVELS)?,
            neighbours: archive.table(NEIGHBOURS)?,
            nodes: archive.table(NODES)?,
            model_levels: archive.table(MODEL_LEVELS)?,
            textures: match record.flags & FLAG_TEXTURES {
                0 => None,
                _ => Some((archive.table(MAPS)?, archive.table(TILES)?)),
            },
            instances: match record.flags & FLAG_INSTANCES {
                0 => None,
                _ => Some((archive.table(OBJECTS)?, archive.table(INSTANCES)?)),
            },
            archive,
        };
        model_check::check(&model).map_err(|(what, why)| model.table_error(what, why))?;
        Ok(model)
    }

    fn table_error(&self, what: String, why: String) -> ModelError {
        ModelError::Table { path: self.archive.path().to_owned(), what, why }
    }

    /// The container.
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// The model as a whole.
    pub fn record(&self) -> &ModelRecord {
        &self.record
    }

    /// Number of levels L, 1 to [`MAX_LEVELS`].
    pub fn levels(&self) -> u32 {
        self.record.levels
    }

    /// True when vertices carry colours; else they are white.
    pub fn has_colors(&self) -> bool {
        self.record.flags & FLAG_COLORS != 0
    }

    /// Maps and tiles, where the model has textures.
    pub fn textures(&self) -> Option<Textures<'_>> {
        let (maps, tiles) = self.textures.as_ref()?;
        Some(Textures { maps: self.rows(maps), tiles: self.rows(tiles), levels: self.levels() })
    }

    /// True when base colours with an alpha below one half are holes.
    pub fn has_cutouts(&self) -> bool {
        self.record.flags & FLAG_CUTOUT != 0
    }

    /// Objects and instances, where there are any; else all clusters stand where they are, once.
    pub fn instances(&self) -> Option<Instances<'_>> {
        let (objects, instances) = self.instances.as_ref()?;
        Some(Instances { objects: self.rows(objects), instances: self.rows(instances) })
    }

    /// Smallest and largest world coordinates; where there are instances, of boxes around them.
    pub fn world_bounds(&self) -> [DVec3; 2] {
        match self.instances() {
            Some(instances) => instances.world_bounds(&self.record, self.clusters()),
            None => [self.world(self.record.bounds_min), self.world(self.record.bounds_max)],
        }
    }

    fn rows<T: Pod>(&self, table: &Table<T>) -> &[T] {
        self.archive.rows(table)
    }

    /// All clusters, in leaf order of the hierarchy.
    pub fn clusters(&self) -> &[ClusterRecord] {
        self.rows(&self.clusters)
    }

    /// All levels of all clusters, `cluster * levels + level`.
    pub fn level_records(&self) -> &[LevelRecord] {
        self.rows(&self.levels)
    }

    /// One level of one cluster.
    pub fn level(&self, cluster: u32, level: u32) -> &LevelRecord {
        &self.level_records()[self.chunk_id(cluster, level).0 as usize]
    }

    /// The clusters that share border positions with `cluster`; border slot `k` names entry `k - 1`.
    pub fn neighbours(&self, cluster: u32) -> &[u32] {
        let record = &self.clusters()[cluster as usize];
        &self.neighbour_entries()[record.neighbours_first as usize..][..record.neighbours_count as usize]
    }

    /// The lists of all clusters in one.
    pub fn neighbour_entries(&self) -> &[u32] {
        self.rows(&self.neighbours)
    }

    /// The coarse buffer hierarchy; node 0 is the root, children come after their parents.
    pub fn nodes(&self) -> &[NodeRecord] {
        self.rows(&self.nodes)
    }

    /// The levels of the whole model, finest first.
    pub fn model_levels(&self) -> &[ModelLevelRecord] {
        self.rows(&self.model_levels)
    }

    /// The chunk that `level` adds in `cluster`.
    pub fn chunk_id(&self, cluster: u32, level: u32) -> ChunkId {
        debug_assert!(level < self.levels());
        ChunkId(cluster * self.levels() + level)
    }

    /// The chunk of the texture mips that `level` adds in `cluster`, where the model has textures.
    pub fn texture_chunk_id(&self, cluster: u32, level: u32) -> ChunkId {
        debug_assert!(level < self.levels() && self.textures.is_some());
        ChunkId((self.record.clusters + cluster) * self.levels() + level)
    }

    /// Chunks of geometry and, where there are any, of textures.
    pub fn chunk_count(&self) -> u32 {
        self.record.clusters * self.levels() * if self.textures.is_some() { 2 } else { 1 }
    }

    /// True for chunks that hold texture mips.
    pub fn is_texture(&self, chunk: ChunkId) -> bool {
        chunk.0 >= self.record.clusters * self.levels()
    }

    /// Cluster and level of a chunk, of geometry or of textures.
    pub fn chunk_place(&self, chunk: ChunkId) -> (u32, u32) {
        (chunk.0 / self.levels() % self.record.clusters, chunk.0 % self.levels())
    }

    /// The chunk of the next coarser level of the same kind; none for the coarsest.
    pub fn coarser(&self, chunk: ChunkId) -> Option<ChunkId> {
        (self.chunk_place(chunk).1 + 1 < self.levels()).then_some(ChunkId(chunk.0 + 1))
    }

    /// True for chunks that every viewer keeps from the start: those of the coarsest level, and empty ones.
    pub fn always_resident(&self, chunk: ChunkId) -> bool {
        self.coarser(chunk).is_none() || self.is_texture(chunk) && self.decoded_bytes(chunk) == 0
    }

    /// The chunk that must be resident before this one (I5), if it is not always.
    pub fn needs(&self, chunk: ChunkId) -> Option<ChunkId> {
        self.coarser(chunk).filter(|&c| !self.always_resident(c))
    }

    /// The counts of a chunk of geometry.
    pub fn shape(&self, chunk: ChunkId) -> ChunkShape {
        let records = self.level_records();
        let record = records[chunk.0 as usize];
        ChunkShape {
            first_vertex: self.coarser(chunk).map_or(0, |c| records[c.0 as usize].vertices),
            end_vertex: record.vertices,
            triangles: record.triangles,
        }
    }

    /// Bytes of a chunk in RAM and in VRAM: 16 per vertex and 2 per index, the latter rounded up to 4; those of the
    /// texels of a chunk of textures.
    pub fn decoded_bytes(&self, chunk: ChunkId) -> u32 {
        match self.textures().filter(|_| self.is_texture(chunk)) {
            Some(textures) => {
                let (cluster, level) = self.chunk_place(chunk);
                textures.chunk_bytes(cluster, level)
            }
            None => self.shape(chunk).decoded_bytes(),
        }
    }

    /// Where a chunk lies in the file, bytes, and how many there are.
    pub fn extent(&self, chunk: ChunkId) -> (u64, u32) {
        let record = &self.archive.chunks()[chunk.0 as usize];
        (record.offset, record.stored_bytes)
    }

    /// Reads and checks the mips of a chunk of textures: bytes as [`Textures::mips`] says, in the archive's formats.
    pub fn read_texture(&self, chunk: ChunkId) -> Result<Cow<'_, [u8]>, ModelError> {
        let bytes = self.archive.chunk(chunk.0)?;
        self.check_texture_size(chunk, &bytes)?;
        Ok(bytes)
    }

    /// Checks the bytes of a chunk of textures that were read from its [`extent`](Model::extent).
    pub fn check_texture(&self, chunk: ChunkId, bytes: &[u8]) -> Result<(), ModelError> {
        self.archive.check_chunk(chunk.0, bytes)?;
        self.check_texture_size(chunk, bytes)
    }

    fn check_texture_size(&self, chunk: ChunkId, bytes: &[u8]) -> Result<(), ModelError> {
        let expected = self.decoded_bytes(chunk);
        match bytes.len() == expected as usize {
            true => Ok(()),
            false => Err(self.chunk_error(chunk, ChunkFault::TextureBytes { found: bytes.len(), expected })),
        }
    }

    fn chunk_error(&self, chunk: ChunkId, fault: ChunkFault) -> ModelError {
        let (cluster, level) = self.chunk_place(chunk);
        ModelError::Chunk { path: self.archive.path().to_owned(), chunk, cluster, level, fault }
    }

    /// Reads, checks and decodes a chunk of geometry. May be called from several threads at once.
    pub fn read_chunk(&self, chunk: ChunkId) -> Result<Chunk, ModelError> {
        let bytes = self.archive.chunk(chunk.0)?;
        let mut decoded = Chunk::default();
        self.decode_checked(chunk, &bytes, &mut Decoder::default(), &mut decoded)?;
        Ok(decoded)
    }

    /// Checks and decodes the bytes of a chunk of geometry that were read from its [`extent`](Model::extent), into a chunk that
    /// is there already; see [`Decoder`].
    pub fn decode_into(
        &self,
        chunk: ChunkId,
        bytes: &[u8],
        decoder: &mut Decoder,
        out: &mut Chunk,
    ) -> Result<(), ModelError> {
        self.archive.check_chunk(chunk.0, bytes)?;
        self.decode_checked(chunk, bytes, decoder, out)
    }

    fn decode_checked(
        &self,
        chunk: ChunkId,
        bytes: &[u8],
        decoder: &mut Decoder,
        out: &mut Chunk,
    ) -> Result<(), ModelError> {
        let (cluster, _) = self.chunk_place(chunk);
        let fail = |fault| self.chunk_error(chunk, fault);
        decoder.decode(bytes, self.shape(chunk), out).map_err(|e| fail(e.into()))?;
        self.check_vertices(cluster, out).map_err(fail)
    }

    /// Positions inside the model's bounds, slots inside the neighbour list.
    fn check_vertices(&self, cluster: u32, chunk: &Chunk) -> Result<(), ChunkFault> {
        let record = &self.clusters()[cluster as usize];
        let (low, high) = (self.record.bounds_min, self.record.bounds_max);
        let grid = |k: usize, offset: u16| i64::from(record.origin[k]) + (i64::from(offset) << record.shift);
        let range = |k: usize| i64::from(low[k])..=i64::from(high[k]);
        // Nearly always the corner, the largest offsets and the largest slot say that all are fine.
        let most = chunk.vertices.iter().fold(([0; 3], 0), |(offset, slot): ([u16; 3], u32), v| {
            (std::array::from_fn(|k| offset[k].max(v.offset[k])), slot.max(v.normal_slot))
        });
        let fine = |k: usize| range(k).contains(&grid(k, 0)) && range(k).contains(&grid(k, most.0[k]));
        if (0..3).all(fine) && most.1 >> 24 <= record.neighbours_count {
            return Ok(());
        }
        for (vertex, v) in (chunk.first_vertex..).zip(&chunk.vertices) {
            let inside = (0..3).all(|k| range(k).contains(&grid(k, v.offset[k])));
            if !inside {
                return Err(ChunkFault::Bounds { vertex });
            }
            if v.slot() as u32 > record.neighbours_count {
                return Err(ChunkFault::Slot { vertex, slot: v.slot(), neighbours: record.neighbours_count });
            }
        }
        Ok(())
    }

    /// Reads a whole level of a cluster: the vertices of the chunks `level ... L-1` and the indices of `level`.
    pub fn read_prefix(&self, cluster: u32, level: u32) -> Result<Prefix, ModelError> {
        let mut vertices = Vec::with_capacity(self.level(cluster, level).vertices as usize);
        for coarser in (level + 1..self.levels()).rev() {
            vertices.extend(self.read_chunk(self.chunk_id(cluster, coarser))?.vertices);
        }
        let own = self.read_chunk(self.chunk_id(cluster, level))?;
        vertices.extend(own.vertices);
        Ok(Prefix { vertices, indices: own.indices })
    }

    /// Grid position of a vertex of `cluster`; exact, and inside the model's bounds for vertices of this model.
    pub fn grid(&self, cluster: u32, v: &Vertex) -> [i32; 3] {
        let record = &self.clusters()[cluster as usize];
        std::array::from_fn(|k| record.origin[k].wrapping_add((v.offset[k] as i32) << record.shift))
    }

    /// All clusters, in runs that stand together.
    pub fn placed(&self) -> Vec<Placed> {
        let placements = |records: &[InstanceRecord]| records.iter().map(InstanceRecord::placement).collect();
        match self.instances() {
            None => vec![Placed { clusters: 0..self.record.clusters, placements: vec![Placement::IDENTITY] }],
            Some(all) => {
                let clusters = |o: &ObjectRecord| o.first_cluster..o.first_cluster + o.cluster_count;
                let placed = |o| Placed { clusters: clusters(o), placements: placements(all.of(o)) };
                all.objects.iter().map(placed).collect()
            }
        }
    }

    /// World position (input units) of a grid point of an instance.
    pub fn world_of(&self, grid: [i32; 3], placement: &Placement) -> DVec3 {
        let origin = DVec3::from(self.record.origin);
        match *placement == Placement::IDENTITY {
            true => self.world(grid),
            false => origin + placement.point(DVec3::from(grid.map(f64::from)) * self.record.quantum),
        }
    }

    /// World position (input units) of a grid point.
    pub fn world(&self, grid: [i32; 3]) -> DVec3 {
        let [x, y, z] = grid.map(f64::from);
        DVec3::from(self.record.origin) + DVec3::new(x, y, z) * self.record.quantum
    }
}
