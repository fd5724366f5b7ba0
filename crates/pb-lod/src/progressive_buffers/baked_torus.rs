//! The closed test torus as a bake's result and as an archive in memory.

use super::codec::{Chunk, encode_chunk};
use super::grid_torus::GridTorus;
use super::layout::ModelLevelRecord;
use super::layout::SCHEME;
use super::model::{Model, ModelError};
use super::write::{BakedModel, EncodedChunk, write_model};
use pb_archive::{MemoryStorage, Writer};
use std::path::Path;

/// A torus of `side * side` clusters (3 or more, so that neighbours are distinct).
pub fn torus(side: u32, levels: u32) -> GridTorus {
    let mut torus = GridTorus::new(side, levels);
    torus.model.quantum = 1.0 / 1024.0;
    let (low, high) = bounds(&torus);
    (torus.model.bounds_min, torus.model.bounds_max) = (low, high);
    torus.model.triangles_in = torus.indices.iter().map(|l| l[0].len() as u64 / 3).sum();
    for i in (0..torus.nodes.len()).rev() {
        let n = torus.nodes[i];
        let levels = levels as usize;
        torus.nodes[i].error = match n.cluster_count {
            1 => torus.levels[(n.first_cluster as usize + 1) * levels - 1].error,
            _ => torus.nodes[n.left as usize].error.max(torus.nodes[n.right as usize].error),
        };
    }
    torus
}

fn bounds(torus: &GridTorus) -> ([i32; 3], [i32; 3]) {
    let mut bounds = ([i32::MAX; 3], [i32::MIN; 3]);
    for (record, vertices) in torus.clusters.iter().zip(&torus.vertices) {
        for (v, k) in vertices.iter().flat_map(|v| (0..3).map(move |k| (v, k))) {
            let x = record.origin[k] + v.offset[k] as i32;
            bounds.0[k] = bounds.0[k].min(x);
            bounds.1[k] = bounds.1[k].max(x);
        }
    }
    bounds
}

/// Packs a torus, damaged by a test or not.
pub fn baked(torus: &GridTorus) -> BakedModel {
    let levels = torus.model.levels as usize;
    let chunk = |(c, i): (usize, usize)| {
        let count = |level: usize| if level < levels { torus.levels[c * levels + level].vertices } else { 0 };
        let (first, end) = (count(i + 1), count(i));
        let mut vertices = torus.vertices[c][first as usize..end as usize].to_vec();
        if first == 0 {
            vertices.iter_mut().enumerate().for_each(|(v, vertex)| vertex.parent = v as u16);
        }
        let chunk = Chunk { first_vertex: first, vertices, indices: torus.indices[c][i].clone() };
        EncodedChunk { bytes: encode_chunk(&chunk).into(), decoded_bytes: chunk.shape().decoded_bytes() }
    };
    let places = (0..torus.clusters.len()).flat_map(|c| (0..levels).map(move |i| (c, i)));
    BakedModel {
        objects: Vec::new(),
        instances: Vec::new(),
        maps: torus.maps.clone(),
        tiles: torus.tiles.clone(),
        record: torus.model,
        clusters: torus.clusters.clone(),
        levels: torus.levels.clone(),
        neighbours: torus.neighbours.clone(),
        nodes: torus.nodes.clone(),
        model_levels: (0..levels).map(|i| model_level(torus, i)).collect(),
        chunks: places.map(chunk).chain(textures(torus)).collect(),
    }
}

/// Texture chunks whose bytes count up.
fn textures(torus: &GridTorus) -> Vec<EncodedChunk> {
    let chunk = |(cluster, level): (u32, u32)| {
        let decoded_bytes = torus.textures().chunk_bytes(cluster, level);
        let bytes: Vec<u8> = (0..decoded_bytes).map(|i| (i + cluster) as u8).collect();
        EncodedChunk { bytes: bytes.into(), decoded_bytes }
    };
    let clusters = 0..torus.tiles.len() as u32;
    clusters.flat_map(|c| (0..torus.model.levels).map(move |i| (c, i))).map(chunk).collect()
}

fn model_level(torus: &GridTorus, level: usize) -> ModelLevelRecord {
    let records = || torus.levels.iter().skip(level).step_by(torus.model.levels as usize);
    let triangles: u64 = records().map(|l| l.triangles as u64).sum();
    let max_error = records().map(|l| l.error).fold(0.0, f32::max) as f64;
    // A closed torus has half as many vertices as triangles.
    ModelLevelRecord { vertices: triangles / 2, triangles, max_error, rms_error: max_error / 2.0 }
}

/// The bytes of the archive.
pub fn archive(model: &BakedModel) -> Vec<u8> {
    let storage = MemoryStorage::default();
    let writer = Writer::with_storage(storage.clone(), Path::new("torus.pb"), SCHEME).unwrap();
    let length = write_model(writer, model).unwrap();
    assert_eq!(length, storage.to_vec().len() as u64);
    storage.to_vec()
}

/// Writes and opens.
pub fn open(model: &BakedModel) -> Result<Model, ModelError> {
    Model::from_bytes(Path::new("torus.pb"), &archive(model))
}
