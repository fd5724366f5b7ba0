//! Checks every checksum and every invariant I1 to I6 (design section 3) on the decoded data of an archive.
//!
//! Two passes over the clusters: the first gathers all positions that several records use, and settles I1 and I2 on
//! them; the second looks at each cluster alone for I4 and I6 and hands the edges that touch other clusters on to be
//! matched. Memory is about 32 bytes per vertex, in several rounds where that would exceed [`ROUND_RECORDS`].
//!
//! Must never: stop at the first fault of an archive, or trust what another invariant promises.

mod cluster;
mod shared;

use self::cluster::{ClusterReport, Decoded, LevelReport};
use self::shared::Shared;
use super::codec::CodecError;
use super::layout::NodeRecord;
use super::model::{ChunkFault, Model, ModelError};
use rayon::prelude::*;
use std::fmt;

/// Most breaches that are listed.
pub const MAX_BREACHES: usize = 100;
/// Most vertex records in memory at once, 32 bytes each.
const ROUND_RECORDS: u64 = 1 << 24;

/// Which promise is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Promise {
    /// Bytes are those that were written, and decode to what the tables say.
    Bytes,
    /// Tables that are computed from the chunks agree with them.
    Tables,
    /// Border positions and their parent chains are the same in both clusters.
    I1,
    /// Border vertices collapse along their border, corners not at all.
    I2,
    /// A parent lives at the next coarser level.
    I3,
    /// Spheres hold what is below them.
    I4,
    /// A level is its coarser chunks and its own: the chunks form prefixes.
    I5,
    /// Closed in, closed out; every triangle is a triangle, and none is turned over in its texture coordinates.
    I6,
}

/// One broken promise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Breach {
    /// Which one.
    pub promise: Promise,
    /// Where: cluster, level, vertex, position.
    pub place: String,
    /// What is wrong there.
    pub what: String,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{:?}: {}: {}", self.promise, self.place, self.what)
    }
}

/// What a sound archive was found to hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VerifySummary {
    /// Chunks read and decoded.
    pub chunks: u64,
    /// Positions that exactly two clusters use.
    pub border_positions: u64,
    /// Positions that three or more clusters use.
    pub corner_positions: u64,
    /// Distinct positions that triangles use, per level.
    pub vertices: Vec<u64>,
    /// Triangles per level.
    pub triangles: Vec<u64>,
    /// Directed edges without an opposite, per level: 0 everywhere for a closed model.
    pub open_edges: Vec<u64>,
}

/// Reads the whole archive. Lists at most [`MAX_BREACHES`] breaches, in a fixed order.
pub fn verify(model: &Model) -> Result<VerifySummary, Vec<Breach>> {
    let mut breaches = check_bytes(model);
    if !breaches.is_empty() {
        return Err(breaches); // without the chunks there is nothing more to look at
    }
    check_nodes(model, &mut breaches);
    check_errors(model, &mut breaches);
    let shared = gather(model);
    shared.check(model, &mut breaches);
    let summary = check_clusters(model, &shared, &mut breaches);
    if breaches.is_empty() {
        return Ok(summary);
    }
    breaches.truncate(MAX_BREACHES);
    Err(breaches)
}

/// Decodes every chunk once; the container's own checks come with it.
fn check_bytes(model: &Model) -> Vec<Breach> {
    let mut breaches: Vec<Breach> = (0..model.record().clusters)
        .into_par_iter()
        .flat_map_iter(|cluster| {
            let chunks = (0..model.levels()).map(move |level| model.chunk_id(cluster, level));
            let geometry = chunks.filter_map(|chunk| model.read_chunk(chunk).err());
            let levels = if model.textures().is_some() { 0..model.levels() } else { 0..0 };
            let chunks = levels.map(move |level| model.texture_chunk_id(cluster, level));
            geometry.chain(chunks.filter_map(|chunk| model.read_texture(chunk).err())).map(|e| chunk_breach(&e))
        })
        .collect();
    if let Err(e) = model.archive().chunks_in_file_order() {
        breaches.push(chunk_breach(&ModelError::Archive(e)));
    }
    breaches.truncate(MAX_BREACHES);
    breaches
}

fn chunk_breach(error: &ModelError) -> Breach {
    let breach = |promise, place: String, what: String| Breach { promise, place, what };
    match error {
        ModelError::Chunk { chunk, cluster, level, fault, .. } => {
            let promise = match fault {
                ChunkFault::Codec(CodecError::Parent { .. }) => Promise::I3,
                ChunkFault::Codec(CodecError::Index { .. }) => Promise::I5,
                ChunkFault::Slot { .. } => Promise::I1,
                _ => Promise::Bytes,
            };
            breach(promise, format!("cluster {cluster} level {level} (chunk {})", chunk.0), fault.to_string())
        }
        ModelError::Archive(e) => breach(Promise::Bytes, "archive".into(), e.fault.to_string()),
        other => breach(Promise::Bytes, "archive".into(), other.to_string()),
    }
}

/// I4 for the hierarchy: a node's sphere holds those of its clusters; and errors do not fall towards the root.
fn check_nodes(model: &Model, breaches: &mut Vec<Breach>) {
    let nodes = model.nodes();
    for (id, n) in nodes.iter().enumerate() {
        let place = || format!("hierarchy node {id}");
        let children: &[u32] = if n.cluster_count == 1 { &[] } else { &[n.left, n.right] };
        let outside = |&child: &u32| !holds(n, nodes[child as usize].center, nodes[child as usize].radius);
        // A node that holds its children's spheres holds the clusters'; only others are looked at one by one.
        if children.is_empty() || children.iter().any(outside) {
            let mut clusters = n.first_cluster..n.first_cluster + n.cluster_count;
            let outside = |&c: &u32| {
                let cluster = &model.clusters()[c as usize];
                !holds(n, cluster.center, cluster.radius)
            };
            if let Some(cluster) = clusters.find(outside) {
                let what = format!("its sphere does not hold that of cluster {cluster}");
                breaches.push(Breach { promise: Promise::I4, place: place(), what });
            }
        }
        let coarsest = model.levels() - 1;
        let below = match children {
            [] => model.level(n.first_cluster, coarsest).error,
            _ => children.iter().map(|&c| nodes[c as usize].error).fold(0.0, f32::max),
        };
        if n.error < below {
            let what = "its error is smaller than one below it".into();
            breaches.push(Breach { promise: Promise::Tables, place: place(), what });
        }
    }
}

fn holds(outer: &NodeRecord, center: [i32; 3], radius: f32) -> bool {
    distance(outer.center, center) + radius as f64 <= outer.radius as f64 * (1.0 + 1e-9)
}

/// Euclidean distance of two grid points, quanta.
fn distance(a: [i32; 3], b: [i32; 3]) -> f64 {
    let square = |k: usize| (a[k] as f64 - b[k] as f64).powi(2);
    (square(0) + square(1) + square(2)).sqrt()
}

/// Errors do not fall towards coarse, and the model's is the largest of its clusters'.
fn check_errors(model: &Model, breaches: &mut Vec<Breach>) {
    let mut breach = |place: String, what: &str| {
        breaches.push(Breach { promise: Promise::Tables, place, what: what.into() });
    };
    for cluster in 0..model.record().clusters {
        for level in 1..model.levels() {
            if model.level(cluster, level).error < model.level(cluster, level - 1).error {
                breach(format!("cluster {cluster} level {level}"), "its error is below that of the finer level");
            }
        }
    }
    for (level, record) in model.model_levels().iter().enumerate() {
        let errors = model.level_records().iter().skip(level).step_by(model.levels() as usize).map(|l| l.error);
        let largest = errors.fold(0.0, f32::max) as f64;
        if (record.max_error - largest).abs() > largest * 1e-6 {
            breach(format!("model level {level}"), "its error is not the largest of its clusters' errors");
        }
    }
}

/// All positions that several records use, in as many rounds as memory demands.
fn gather(model: &Model) -> Shared {
    let records: u64 = model.level_records().iter().step_by(model.levels() as usize).map(|l| l.vertices as u64).sum();
    let rounds = records.div_ceil(ROUND_RECORDS).max(1) as u32;
    let mut shared = Shared::default();
    for round in 0..rounds {
        let mut records: Vec<_> = (0..model.record().clusters)
            .into_par_iter()
            .flat_map_iter(|c| shared::records(model, c, &decode(model, c)))
            .filter(|r| shared::round_of(r, rounds) == round)
            .collect();
        records.par_sort_unstable();
        shared.add(&records);
    }
    shared.finish();
    shared
}

fn decode(model: &Model, cluster: u32) -> Decoded {
    Decoded::read(model, cluster).expect("every chunk was decoded before, and the archive is not changed while open")
}

/// I4 and I6, and the counts that the tables promise.
fn check_clusters(model: &Model, shared: &Shared, breaches: &mut Vec<Breach>) -> VerifySummary {
    let reports: Vec<ClusterReport> = (0..model.record().clusters)
        .into_par_iter()
        .map(|c| cluster::check(model, c, &decode(model, c), shared))
        .collect();
    let mut levels = vec![LevelReport::default(); model.levels() as usize];
    for report in reports {
        breaches.extend(report.breaches);
        levels.iter_mut().zip(report.levels).for_each(|(all, one)| all.add(one));
    }
    levels.iter_mut().for_each(LevelReport::finish);
    for (i, level) in levels.iter().enumerate() {
        check_level(model, i, level, &levels[0], breaches);
    }
    let (border_positions, corner_positions) = shared.counts();
    VerifySummary {
        chunks: model.archive().chunks().len() as u64,
        border_positions,
        corner_positions,
        vertices: levels.iter().map(|l| l.used_positions).collect(),
        triangles: model.model_levels().iter().map(|l| l.triangles).collect(),
        open_edges: levels.iter().map(|l| l.open_edges).collect(),
    }
}

fn check_level(model: &Model, i: usize, level: &LevelReport, finest: &LevelReport, breaches: &mut Vec<Breach>) {
    let mut breach = |promise, what| breaches.push(Breach { promise, place: format!("level {i}"), what });
    if finest.open_edges == 0 && level.open_edges > 0 {
        let place = level.open_example.map(|p| format!(", first at {}", position(model, p))).unwrap_or_default();
        breach(Promise::I6, format!("level 0 is closed, but here {} edges have no opposite{place}", level.open_edges));
    }
    if level.most_repeated > finest.most_repeated.max(1) {
        let text = format!(
            "an edge is used {} times in one direction, at level 0 at most {}",
            level.most_repeated, finest.most_repeated
        );
        breach(Promise::I6, text);
    }
    let stored = model.model_levels()[i].vertices;
    if stored != level.used_positions {
        let text = format!("{stored} positions in the table, but triangles use {}", level.used_positions);
        breach(Promise::Tables, text);
    }
}

/// A grid point for messages, with its world position.
fn position(model: &Model, grid: [i32; 3]) -> String {
    let w = model.world(grid);
    format!("grid {grid:?} (world {} {} {})", w.x, w.y, w.z)
}

#[cfg(test)]
mod tests;
