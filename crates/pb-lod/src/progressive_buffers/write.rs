//! From a finished bake to a file: the other half of [`model`](super::model).

use super::instances::{INSTANCES, InstanceRecord, OBJECTS, ObjectRecord};
use super::layout::*;
use super::textures::{MAPS, MapRecord, TILES, TileRecord};
use pb_archive::{ArchiveError, ChunkBytes, Feature, Storage, Writer};

/// Chunks are packed as [`codec`](super::codec) says. A later codec gets another bit.
pub const CHUNK_CODEC: Feature = Feature { bit: 0, name: "meshopt-chunks" };
/// Chunks behind those of the geometry hold texture mips, and vertices texture coordinates.
pub const TEXTURE_TILES: Feature = Feature { bit: 1, name: "texture-tiles" };
/// Clusters belong to objects, which stand in several places.
pub const OBJECT_INSTANCES: Feature = Feature { bit: 2, name: "instances" };
/// The required features that this program reads, as bits.
pub const KNOWN_FEATURES: u64 = 1 << CHUNK_CODEC.bit | 1 << TEXTURE_TILES.bit | 1 << OBJECT_INSTANCES.bit;

/// A packed chunk.
#[derive(Clone, Debug)]
pub struct EncodedChunk {
    /// From [`encode_chunk`](super::codec::encode_chunk).
    pub bytes: ChunkBytes,
    /// From [`ChunkShape::decoded_bytes`](super::codec::ChunkShape::decoded_bytes).
    pub decoded_bytes: u32,
}

/// All that an archive holds, in memory but for chunks that wait in a [`Spill`](pb_archive::Spill).
#[derive(Clone, Debug)]
pub struct BakedModel {
    /// The model as a whole.
    pub record: ModelRecord,
    /// In leaf order of the hierarchy.
    pub clusters: Vec<ClusterRecord>,
    /// `cluster * levels + level`.
    pub levels: Vec<LevelRecord>,
    /// The clusters' neighbour lists one after the other, in cluster order.
    pub neighbours: Vec<u32>,
    /// The coarse buffer hierarchy, node 0 is the root.
    pub nodes: Vec<NodeRecord>,
    /// One per level, finest first.
    pub model_levels: Vec<ModelLevelRecord>,
    /// The maps of a textured model; else none.
    pub maps: Vec<MapRecord>,
    /// Their tiles, one per cluster where there are maps.
    pub tiles: Vec<TileRecord>,
    /// In the order of their clusters; none where all clusters stand where they are, once.
    pub objects: Vec<ObjectRecord>,
    /// In the order of their objects.
    pub instances: Vec<InstanceRecord>,
    /// `cluster * levels + level`; where there are maps, those of the textures follow in the same order.
    pub chunks: Vec<EncodedChunk>,
}

/// Writes the archive and gives it its name. Returns its length in bytes.
///
/// Payloads lie coarsest level first, each level in cluster order: what every viewer needs at its start is one run.
pub fn write_model<S: Storage>(mut writer: Writer<S>, model: &BakedModel) -> Result<u64, ArchiveError> {
    writer.require(CHUNK_CODEC);
    let levels = model.record.levels;
    let kinds = if model.maps.is_empty() { 1 } else { 2 };
    if kinds == 2 {
        writer.require(TEXTURE_TILES);
    }
    if !model.objects.is_empty() {
        writer.require(OBJECT_INSTANCES);
    }
    for level in (0..levels).rev() {
        for cluster in 0..model.record.clusters * kinds {
            let id = cluster * levels + level;
            let chunk = &model.chunks[id as usize];
            writer.put_chunk(id, &chunk.bytes.read()?, chunk.decoded_bytes)?;
        }
    }
    writer.add_section(MODEL, &[model.record])?;
    writer.add_section(CLUSTERS, &model.clusters)?;
    writer.add_section(LEVELS, &model.levels)?;
    writer.add_section(NEIGHBOURS, &model.neighbours)?;
    writer.add_section(NODES, &model.nodes)?;
    writer.add_section(MODEL_LEVELS, &model.model_levels)?;
    if kinds == 2 {
        writer.add_section(MAPS, &model.maps)?;
        writer.add_section(TILES, &model.tiles)?;
    }
    if !model.objects.is_empty() {
        writer.add_section(OBJECTS, &model.objects)?;
        writer.add_section(INSTANCES, &model.instances)?;
    }
    writer.finish()
}
