//! Compares the tables of an opened model with one another, so that nobody after has to.
//!
//! Each check returns `(which record, what does not fit)`. No chunk is decoded here.

use super::codec::{MAX_TRIANGLES, MAX_VERTICES};
use super::layout::*;
use super::model::{FLAG_COLORS, FLAG_CUTOUT, FLAG_INSTANCES, FLAG_TEXTURES, Model};
use super::textures::{map_fault, tile_fault};
use crate::plan::ChunkId;

type Check = Result<(), (String, String)>;

/// Most neighbours of a cluster: border slots have 8 bits and 0 means none.
pub const MAX_NEIGHBOURS: u32 = 255;
/// Grid coordinates lie within plus and minus this: sums and differences of two fit i32.
pub const MAX_GRID: i32 = 1 << 30;
/// Largest shift: offsets of 16 bits stay inside 31 bits.
pub const MAX_SHIFT: u32 = 15;

/// All checks, in an order in which each may rely on those before.
pub(super) fn check(model: &Model) -> Check {
    check_record(model)?;
    check_sizes(model)?;
    check_textures(model)?;
    check_clusters(model)?;
    check_levels(model)?;
    check_model_levels(model)?;
    check_nodes(model)?;
    check_instances(model)
}

fn ensure(holds: bool, what: impl FnOnce() -> String, why: &str) -> Check {
    if holds { Ok(()) } else { Err((what(), why.into())) }
}

fn on_grid(p: [i32; 3]) -> bool {
    p.iter().all(|x| (-MAX_GRID..=MAX_GRID).contains(x))
}

fn check_record(model: &Model) -> Check {
    let r = model.record();
    let what = || "the model record".to_string();
    ensure((1..=MAX_LEVELS as u32).contains(&r.levels), what, "the number of levels is not 1 to 12")?;
    ensure(r.clusters >= 1, what, "there are no clusters")?;
    ensure(r.clusters.checked_mul(2 * r.levels).is_some(), what, "there are more than 2^32 chunks")?;
    ensure(r.origin.iter().all(|x| x.is_finite()), what, "the origin is not finite")?;
    let power_of_two = r.quantum.is_normal() && r.quantum > 0.0 && r.quantum.to_bits() << 12 == 0;
    ensure(power_of_two, what, "the quantum is not a power of two")?;
    ensure((0..3).all(|k| r.bounds_min[k] <= r.bounds_max[k]), what, "the bounds are empty")?;
    ensure(on_grid(r.bounds_min) && on_grid(r.bounds_max), what, "the bounds are beyond 2^30 quanta")?;
    let known = r.flags & !(FLAG_COLORS | FLAG_TEXTURES | FLAG_CUTOUT | FLAG_INSTANCES) == 0 && r.reserved == [0; 5];
    let textured = r.flags & FLAG_TEXTURES != 0;
    ensure(textured || r.flags & FLAG_CUTOUT == 0, what, "it has cut-outs but no textures")?;
    ensure(!textured || r.flags & FLAG_COLORS == 0, what, "it has both textures and vertex colours")?;
    ensure(known, what, "reserved bits or bytes are not zero")
}

fn check_sizes(model: &Model) -> Check {
    let r = model.record();
    let chunks = (r.clusters * r.levels) as usize;
    for (name, found, expected) in [
        ("the cluster table", model.clusters().len(), r.clusters as usize),
        ("the level table", model.level_records().len(), chunks),
        ("the chunk table", model.archive().chunks().len(), model.chunk_count() as usize),
        ("the model level table", model.model_levels().len(), r.levels as usize),
        ("the hierarchy", model.nodes().len(), 2 * r.clusters as usize - 1),
    ] {
        if found != expected {
            return Err((name.into(), format!("it has {found} entries instead of {expected}")));
        }
    }
    Ok(())
}

fn check_textures(model: &Model) -> Check {
    let Some(textures) = model.textures() else { return Ok(()) };
    let clusters = model.record().clusters as usize;
    let tiles = || "the tile table".to_string();
    ensure(textures.tiles.len() == clusters, tiles, "it has not one entry per cluster")?;
    if let Some(why) = map_fault(textures.maps) {
        return Err(("the map table".into(), why.into()));
    }
    for (cluster, tile) in textures.tiles.iter().enumerate() {
        if let Some(why) = tile_fault(tile, textures.maps.len()) {
            return Err((format!("the tile of cluster {cluster}"), why.into()));
        }
        for level in 0..model.levels() {
            let chunk = model.texture_chunk_id(cluster as u32, level);
            let fits = model.archive().chunks()[chunk.0 as usize].decoded_bytes == model.decoded_bytes(chunk);
            let what = || format!("the textures of cluster {cluster} level {level}");
            ensure(fits, what, "the decoded size in the chunk table differs from the tables of maps and tiles")?;
        }
    }
    Ok(())
}

fn check_clusters(model: &Model) -> Check {
    let entries = model.neighbour_entries();
    let mut first = 0;
    for (id, c) in model.clusters().iter().enumerate() {
        let what = || format!("cluster {id}");
        ensure(c.shift <= MAX_SHIFT, what, "the shift is more than 15")?;
        ensure(on_grid(c.origin) && on_grid(c.center), what, "its origin or centre is beyond 2^30 quanta")?;
        ensure(c.radius.is_finite() && c.radius >= 0.0, what, "the radius is not a finite length")?;
        ensure(c.reserved == [0; 2], what, "reserved bytes are not zero")?;
        ensure(c.neighbours_count <= MAX_NEIGHBOURS, what, "it has more than 255 neighbours")?;
        ensure(c.neighbours_first as usize == first, what, "its neighbours do not follow those before")?;
        first += c.neighbours_count as usize;
        ensure(first <= entries.len(), what, "its neighbours run past the end of the table")?;
        let list = &entries[c.neighbours_first as usize..first];
        ensure(list.iter().all(|&n| n < model.record().clusters), what, "a neighbour does not exist")?;
        ensure(list.iter().all(|&n| n != id as u32), what, "it is its own neighbour")?;
    }
    ensure(first == entries.len(), || "the neighbour table".into(), "entries at its end belong to nobody")
}

fn check_levels(model: &Model) -> Check {
    let chunks = model.archive().chunks();
    for (id, level) in model.level_records().iter().enumerate() {
        let chunk = ChunkId(id as u32);
        let what = || {
            let (cluster, level) = model.chunk_place(chunk);
            format!("cluster {cluster} level {level}")
        };
        ensure((1..=MAX_VERTICES).contains(&level.vertices), what, "the vertices are not 1 to 65535")?;
        ensure(level.triangles <= MAX_TRIANGLES, what, "it has more than 2^20 triangles")?;
        let finite = |x: f32| x.is_finite() && x >= 0.0;
        ensure(finite(level.error) && finite(level.acmr), what, "error or acmr is not a finite positive number")?;
        if let Some(coarser) = model.coarser(chunk) {
            let coarser = model.level_records()[coarser.0 as usize].vertices;
            ensure(coarser <= level.vertices, what, "the next coarser level has more vertices")?;
        }
        let fits = chunks[id].decoded_bytes == model.decoded_bytes(chunk);
        ensure(fits, what, "the decoded size in the chunk table differs from the counts")?;
    }
    Ok(())
}

fn check_model_levels(model: &Model) -> Check {
    let levels = model.levels() as usize;
    for (i, m) in model.model_levels().iter().enumerate() {
        let what = || format!("model level {i}");
        let records = || model.level_records().iter().skip(i).step_by(levels);
        let triangles: u64 = records().map(|l| l.triangles as u64).sum();
        let vertices: u64 = records().map(|l| l.vertices as u64).sum();
        ensure(m.triangles == triangles, what, "its triangles are not the sum over the clusters")?;
        ensure(m.vertices >= 1 && m.vertices <= vertices, what, "it has more positions than vertices, or none")?;
        let finite = |x: f64| x.is_finite() && x >= 0.0;
        ensure(finite(m.max_error) && finite(m.rms_error), what, "an error is not a finite positive number")?;
    }
    Ok(())
}

/// Objects divide clusters and instances, and no border lies between two of them.
fn check_instances(model: &Model) -> Check {
    let Some(instances) = model.instances() else { return Ok(()) };
    instances.fault(model.record().clusters, model.nodes()).map_or(Ok(()), Err)?;
    for (i, o) in instances.objects.iter().enumerate() {
        let own = o.first_cluster..o.first_cluster + o.cluster_count;
        let inside = own.clone().all(|c| model.neighbours(c).iter().all(|n| own.contains(n)));
        ensure(inside, || format!("object {i}"), "a cluster of it has a neighbour in another object")?;
    }
    Ok(())
}

/// A binary tree: children behind their parents, each the child of one, leaves in cluster order.
fn check_nodes(model: &Model) -> Check {
    let nodes = model.nodes();
    let mut parents = vec![0u8; nodes.len()];
    for (id, n) in nodes.iter().enumerate() {
        let what = || format!("hierarchy node {id}");
        let plain = n.radius.is_finite() && n.radius >= 0.0 && n.error.is_finite() && n.error >= 0.0;
        ensure(on_grid(n.center), what, "its centre is beyond 2^30 quanta")?;
        ensure(plain && n.reserved == 0, what, "a number in it is not finite or not zero where it must be")?;
        if n.cluster_count == 1 {
            ensure(n.left == u32::MAX && n.right == u32::MAX, what, "one cluster, but it has children")?;
            ensure(n.first_cluster < model.record().clusters, what, "its cluster does not exist")?;
            continue;
        }
        let (left, right) = (n.left as usize, n.right as usize);
        let behind = left > id && right > id && left != right && left < nodes.len() && right < nodes.len();
        ensure(behind, what, "a child does not come behind it")?;
        let (l, r) = (&nodes[left], &nodes[right]);
        let covered = l.first_cluster == n.first_cluster
            && l.first_cluster.checked_add(l.cluster_count) == Some(r.first_cluster)
            && l.cluster_count.checked_add(r.cluster_count) == Some(n.cluster_count);
        ensure(covered, what, "its children do not cover its clusters")?;
        for child in [left, right] {
            parents[child] = parents[child].saturating_add(1);
            ensure(parents[child] == 1, || format!("hierarchy node {child}"), "it has two parents")?;
        }
    }
    let root = nodes[0].first_cluster == 0 && nodes[0].cluster_count == model.record().clusters;
    ensure(root, || "hierarchy node 0".into(), "the root does not cover all clusters")?;
    let all = parents[1..].iter().all(|&p| p == 1);
    ensure(all, || "the hierarchy".into(), "a node hangs under no other")
}
