//! Each invariant is broken by hand once, and must be found.

use super::*;
use crate::progressive_buffers::baked_torus::{archive, baked, open, torus};
use crate::progressive_buffers::grid_torus::GridTorus;
use crate::progressive_buffers::layout::Vertex;
use std::path::Path;

const LEVELS: u32 = 4;

/// The breaches of a damaged torus as text.
fn breaches(damage: impl FnOnce(&mut GridTorus)) -> Vec<String> {
    let mut torus = torus(3, LEVELS);
    damage(&mut torus);
    let model = open(&baked(&torus)).unwrap();
    verify(&model).unwrap_err().iter().map(Breach::to_string).collect()
}

#[track_caller]
fn assert_found(breaches: &[String], promise: &str, what: &str) {
    assert!(breaches.iter().any(|b| b.starts_with(promise) && b.contains(what)), "{promise} {what}: {breaches:#?}");
}

/// A vertex of `cluster` with this border slot that dies at `level`.
fn vertex(torus: &GridTorus, cluster: usize, slot: u8, level: usize) -> usize {
    let record = |l: usize| torus.levels[cluster * LEVELS as usize + l].vertices as usize;
    let found = (record(level + 1)..record(level)).find(|&v| torus.vertices[cluster][v].slot() == slot);
    found.expect("the torus has such a vertex")
}

fn set_slot(torus: &mut GridTorus, cluster: usize, vertex: usize, slot: u8) {
    let v = &mut torus.vertices[cluster][vertex];
    v.normal_slot = v.normal_slot & 0xff_ffff | (slot as u32) << 24;
}

#[test]
fn a_sound_model_passes_with_its_counts() {
    let torus = torus(3, LEVELS);
    let summary = verify(&open(&baked(&torus)).unwrap()).unwrap();
    assert_eq!(summary.open_edges, [0; 4]);
    assert_eq!(summary.vertices, [48 * 48, 24 * 24, 12 * 12, 6 * 6]);
    assert_eq!(summary.triangles[0], 2 * 48 * 48);
    assert_eq!((summary.corner_positions, summary.border_positions), (9, 2 * 3 * 48 - 2 * 9));
    assert_eq!(summary.chunks, 36);
}

#[test]
fn i1_a_border_vertex_that_collapses_elsewhere_in_the_other_cluster_is_found() {
    let found = breaches(|t| {
        let v = vertex(t, 0, 2, 0);
        let wrong = vertex(t, 0, 2, 1);
        assert_ne!(t.vertices[0][v].parent as usize, wrong);
        t.vertices[0][v].parent = wrong as u16;
    });
    assert_found(&found, "I1", "collapses to grid");
}

#[test]
fn i1_a_border_vertex_that_lives_longer_in_one_cluster_is_found() {
    let found = breaches(|t| {
        // The first vertex that dies at level 1 trades places with the last of level 2.
        let (a, b) = (t.levels[2].vertices as usize - 1, t.levels[2].vertices as usize);
        assert!(t.vertices[0][b].slot() != 0 || t.vertices[0][a].slot() != 0);
        t.vertices[0].swap(a, b);
    });
    assert_found(&found, "I1", "lives up to level");
}

#[test]
fn i1_a_border_vertex_at_another_place_is_found() {
    let found = breaches(|t| {
        let v = vertex(t, 0, 2, 0);
        t.vertices[0][v].offset[0] += 1;
    });
    assert_found(&found, "I1", "no other cluster uses its position");
}

#[test]
fn i1_a_missing_or_wrong_border_slot_is_found() {
    let found = breaches(|t| {
        let v = vertex(t, 4, 2, 0);
        set_slot(t, 4, v, 0);
    });
    assert_found(&found, "I1", "but its border slot is 0");
    let found = breaches(|t| {
        let v = vertex(t, 4, 2, 0);
        set_slot(t, 4, v, 1);
    });
    assert_found(&found, "I1", "its border slot names cluster");
    let found = breaches(|t| {
        let v = vertex(t, 4, 0, 0);
        set_slot(t, 4, v, 3);
    });
    assert_found(&found, "I1", "no other cluster uses its position");
}

#[test]
fn i2_a_border_vertex_that_leaves_its_border_is_found() {
    let found = breaches(|t| {
        let v = vertex(t, 0, 2, 0);
        t.vertices[0][v].parent = vertex(t, 0, 0, 1) as u16;
    });
    assert_found(&found, "I2", "leaves its border");
}

#[test]
fn i2_a_corner_that_collapses_is_found() {
    let found = breaches(|t| {
        let coarsest = t.levels[LEVELS as usize - 1].vertices as usize;
        let corner = (0..coarsest).find(|&v| t.vertices[0][v].slot() == 0).unwrap();
        t.vertices[0].swap(corner, coarsest);
    });
    assert_found(&found, "I2", "a corner of clusters");
}

#[test]
fn i3_a_parent_that_dies_no_later_is_found_when_the_chunk_is_decoded() {
    use crate::progressive_buffers::codec::{ChunkShape, CodecError, decode_chunk};
    let torus = torus(3, LEVELS);
    let baked_torus = baked(&torus);
    let bytes = baked_torus.chunks[0].bytes.read().unwrap();
    let model = open(&baked_torus).unwrap();
    let shape = model.shape(crate::plan::ChunkId(0));
    // The same bytes, read as if one vertex fewer lived at the coarser level.
    let first_vertex = shape.first_vertex - 1;
    let wrong = ChunkShape { first_vertex, end_vertex: shape.end_vertex - 1, ..shape };
    let result = decode_chunk(&bytes, wrong);
    assert!(matches!(result, Err(CodecError::Parent { .. } | CodecError::Index { .. })), "{result:?}");
    let error = ModelError::Chunk {
        path: "torus.pb".into(),
        chunk: crate::plan::ChunkId(0),
        cluster: 0,
        level: 0,
        fault: CodecError::Parent { vertex: 9, parent: 9 }.into(),
    };
    assert_found(&[chunk_breach(&error).to_string()], "I3", "vertex 9 has parent 9");
}

#[test]
fn i4_a_vertex_outside_the_sphere_is_found() {
    let found = breaches(|t| t.clusters[5].radius *= 0.99);
    assert_found(&found, "I4", "lies outside the cluster's bounding sphere");
}

#[test]
fn i4_a_node_that_does_not_hold_its_children_is_found() {
    assert_found(&breaches(|t| t.nodes[0].radius *= 0.9), "I4", "does not hold that of cluster");
    let found = breaches(|t| {
        let leaf = t.nodes.iter_mut().find(|n| n.cluster_count == 1).unwrap();
        leaf.center[0] += 50;
    });
    assert_found(&found, "I4", "does not hold that of cluster");
}

#[test]
fn i5_a_level_with_fewer_vertices_than_the_coarser_one_is_refused() {
    let mut model = baked(&torus(3, LEVELS));
    model.levels[3].vertices = model.levels[2].vertices + 1;
    let text = open(&model).err().unwrap().to_string();
    assert!(text.contains("cluster 0 level 2: the next coarser level has more vertices"), "{text}");
}

#[test]
fn i6_a_hole_at_a_coarser_level_is_found() {
    let found = breaches(|t| {
        let length = t.indices[4][2].len() - 3;
        t.indices[4][2].truncate(length);
        t.levels[4 * LEVELS as usize + 2].triangles -= 1;
    });
    assert_found(&found, "I6: level 2", "3 edges have no opposite");
    assert!(found.iter().all(|b| !b.starts_with("I6: level 1")));
}

#[test]
fn i6_a_doubled_triangle_is_found() {
    let found = breaches(|t| {
        let double: Vec<u16> = t.indices[4][1][..3].to_vec();
        t.indices[4][1].extend(double);
        t.levels[4 * LEVELS as usize + 1].triangles += 1;
    });
    assert_found(&found, "I6: level 1", "used 2 times in one direction");
}

#[test]
fn i6_a_triangle_without_area_is_found() {
    let found = breaches(|t| {
        t.indices[4][1][1] = t.indices[4][1][0];
    });
    assert_found(&found, "I6: cluster 4 level 1 triangle 0", "have one position");
}

#[test]
fn i6_a_triangle_turned_over_in_its_texture_coordinates_is_found_at_every_level() {
    let mut torus = torus(3, LEVELS).with_textures(6, 1.0);
    assert!(verify(&open(&baked(&torus)).unwrap()).is_ok());
    let coarsest = torus.levels[LEVELS as usize - 1].vertices as usize;
    for v in &mut torus.vertices[0][..coarsest] {
        let [x, y] = v.uv();
        v.color = Vertex::pack_uv([y, x]);
    }
    let found: Vec<String> =
        verify(&open(&baked(&torus)).unwrap()).unwrap_err().iter().map(Breach::to_string).collect();
    assert_found(&found, "I6", "cluster 0 level 0");
    assert_found(&found, "I6", "cluster 0 level 3");
    assert_found(&found, "I6", "turned over in its texture coordinates");
}

#[test]
fn a_damaged_texture_is_named() {
    let torus = torus(3, LEVELS).with_textures(6, 1.0);
    let mut model = baked(&torus);
    let bytes = [&*model.chunks[36].bytes.read().unwrap(), &[0]].concat();
    model.chunks[36].bytes = bytes.into();
    let found: Vec<String> = verify(&open(&model).unwrap()).unwrap_err().iter().map(Breach::to_string).collect();
    assert_found(&found, "Bytes", "cluster 0 level 0 (chunk 36)");
}

#[test]
fn tables_that_disagree_with_the_chunks_are_found() {
    let mut model = baked(&torus(3, LEVELS));
    model.model_levels[1].vertices += 1;
    model.model_levels[2].max_error *= 2.0;
    model.levels[7].error = 0.0;
    model.nodes[0].error = 0.0;
    let found: Vec<String> = verify(&open(&model).unwrap()).unwrap_err().iter().map(Breach::to_string).collect();
    assert_found(&found, "Tables: level 1", "positions in the table");
    assert_found(&found, "Tables: model level 2", "not the largest");
    assert_found(&found, "Tables: cluster 1 level 3", "below that of the finer level");
    assert_found(&found, "Tables: hierarchy node 0", "smaller than one below it");
}

#[test]
fn a_damaged_chunk_is_named() {
    let bytes = archive(&baked(&torus(3, LEVELS)));
    let mut bad = bytes.clone();
    bad[200] ^= 4;
    let found = verify(&Model::from_bytes(Path::new("torus.pb"), &bad).unwrap()).unwrap_err();
    assert_found(&[found[0].to_string()], "Bytes", "chunk 3 at byte 128 is damaged");
}

#[test]
fn every_flipped_bit_of_an_archive_is_found() {
    let bytes = archive(&baked(&torus(3, 1)));
    for place in (0..bytes.len()).step_by(7) {
        let mut bad = bytes.clone();
        bad[place] ^= 1 << (place % 8);
        let sound = Model::from_bytes(Path::new("torus.pb"), &bad).ok().is_some_and(|m| verify(&m).is_ok());
        assert!(!sound, "byte {place}");
    }
}
