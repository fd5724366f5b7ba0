//! The file of format version 1 that is kept for ever, read at the offsets that docs/format.md gives.
//!
//! `UPDATE_GOLDEN=1` writes it anew; do that only before a version is released.

use super::baked_torus::{archive, baked, torus};
use super::model::Model;
use super::verify::verify;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-fixtures/format-1.pb")
}

fn golden_bytes() -> Vec<u8> {
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(golden(), archive(&baked(&torus(3, 2)))).unwrap();
    }
    std::fs::read(golden()).expect("data-fixtures/format-1.pb is in the repository")
}

struct At<'a>(&'a [u8]);

impl At<'_> {
    fn u32(&self, at: u64) -> u32 {
        u32::from_le_bytes(self.0[at as usize..][..4].try_into().unwrap())
    }
    fn i32(&self, at: u64) -> i32 {
        self.u32(at) as i32
    }
    fn u64(&self, at: u64) -> u64 {
        u64::from_le_bytes(self.0[at as usize..][..8].try_into().unwrap())
    }
    fn f32(&self, at: u64) -> f32 {
        f32::from_bits(self.u32(at))
    }
    fn f64(&self, at: u64) -> f64 {
        f64::from_bits(self.u64(at))
    }
    fn sum(&self, from: u64, length: u64) -> u64 {
        xxh3_64(&self.0[from as usize..][..length as usize])
    }
    /// Offset and number of elements of a section, by the directory.
    fn section(&self, tag: &[u8; 4], element: u32) -> (u64, u64) {
        let entries = (0..self.u64(40) / 32).map(|i| self.u64(32) + i * 32);
        let entry = entries.clone().find(|&e| &self.0[e as usize..][..4] == tag).unwrap();
        assert_eq!(self.u32(entry + 4), element);
        let (offset, length) = (self.u64(entry + 8), self.u64(entry + 16));
        assert_eq!((offset % 64, self.sum(offset, length)), (0, self.u64(entry + 24)));
        (offset, length / element as u64)
    }
}

#[test]
fn the_kept_file_of_version_1_is_still_read_and_sound() {
    golden_bytes();
    let model = Model::open(&golden()).unwrap();
    let summary = verify(&model).unwrap();
    assert_eq!((summary.vertices, summary.open_edges), (vec![144, 36], vec![0, 0]));
}

#[test]
fn header_and_directory_lie_where_the_document_says() {
    let bytes = golden_bytes();
    let at = At(&bytes);
    assert_eq!(bytes[..8], *b"\x89PBA\r\n\x1a\n");
    assert_eq!((at.u32(8), &bytes[12..16]), (1, &b"PBUF"[..]));
    assert_eq!((at.u64(16), at.u64(24)), (1, 0));
    assert_eq!((at.u64(32) + at.u64(40), at.u64(48)), (bytes.len() as u64, bytes.len() as u64));
    assert_eq!(at.u64(56), at.sum(at.u64(32), at.u64(40)));
    assert!(bytes[64..120].iter().all(|&b| b == 0));
    assert_eq!(at.u64(120), at.sum(0, 120));
}

#[test]
fn chunks_and_features_lie_where_the_document_says() {
    let bytes = golden_bytes();
    let at = At(&bytes);
    let (table, count) = at.section(b"CHNK", 24);
    assert_eq!(count, 9 * 2);
    // Coarsest level first, then cluster order, without gaps.
    let mut next = 128;
    for id in [1, 3, 5, 7, 9, 11, 13, 15, 17, 0, 2, 4, 6, 8, 10, 12, 14, 16] {
        let entry = table + id * 24;
        let (offset, stored) = (at.u64(entry), at.u32(entry + 8) as u64);
        assert_eq!((offset, at.sum(offset, stored)), (next, at.u64(entry + 16)));
        assert_eq!(8 + at.u32(offset) as u64 + at.u32(offset + 4) as u64, stored);
        next += stored;
    }
    let (features, count) = at.section(b"FEAT", 32);
    assert_eq!((count, at.u32(features)), (1, 0));
    assert_eq!(bytes[features as usize + 4..][..28], *b"meshopt-chunks\0\0\0\0\0\0\0\0\0\0\0\0\0\0");
}

#[test]
fn the_tables_lie_where_the_document_says() {
    let bytes = golden_bytes();
    let (at, model) = (At(&bytes), Model::open(&golden()).unwrap());
    let (m, one) = at.section(b"MODL", 96);
    let r = model.record();
    assert_eq!((one, at.f64(m), at.f64(m + 24)), (1, r.origin[0], 1.0 / 1024.0));
    assert_eq!([at.i32(m + 32), at.i32(m + 44)], [r.bounds_min[0], r.bounds_max[0]]);
    assert_eq!((at.u32(m + 56), at.u32(m + 60), at.u64(m + 64), at.u32(m + 72)), (2, 9, 288, 0));

    let (c, count) = at.section(b"CLUS", 48);
    let (c, cluster) = (c + 4 * 48, &model.clusters()[4]);
    assert_eq!((count, at.i32(c), at.u32(c + 12)), (9, cluster.origin[0], cluster.shift));
    assert_eq!((at.i32(c + 16), at.f32(c + 28)), (cluster.center[0], cluster.radius));
    assert_eq!((at.u32(c + 32), at.u32(c + 36)), (16, 4));

    let (l, count) = at.section(b"LEVL", 16);
    assert_eq!((count, at.u32(l), at.u32(l + 4), at.u32(l + 16), at.u32(l + 20)), (18, 25, 32, 9, 8));
    assert_eq!((at.f32(l + 24), at.f32(l + 28)), (model.level(0, 1).error, 1.0));

    let (n, count) = at.section(b"NEIG", 4);
    assert_eq!((count, at.u32(n + 16 * 4)), (36, model.neighbours(4)[0]));

    let (t, count) = at.section(b"TREE", 40);
    let root = &model.nodes()[0];
    assert_eq!((count, at.i32(t), at.f32(t + 12)), (17, root.center[0], root.radius));
    assert_eq!((at.u32(t + 16), at.u32(t + 20), at.u32(t + 24), at.u32(t + 28)), (0, 9, 1, root.right));
    assert_eq!(at.f32(t + 32), root.error);

    let (v, count) = at.section(b"MLEV", 32);
    assert_eq!((count, at.u64(v), at.u64(v + 8), at.u64(v + 32), at.u64(v + 40)), (2, 144, 288, 36, 72));
    assert_eq!(
        (at.f64(v + 48), at.f64(v + 56)),
        (model.model_levels()[1].max_error, model.model_levels()[1].rms_error)
    );
}

/// A decoder written from the document alone, on top of meshopt's.
#[test]
fn a_chunk_unpacks_as_the_document_says() {
    let bytes = golden_bytes();
    let (at, model) = (At(&bytes), Model::open(&golden()).unwrap());
    let (table, _) = at.section(b"CHNK", 24);
    let chunk = at.u64(table + 8 * 24); // cluster 4, level 0
    let (v, i) = (at.u32(chunk) as usize, at.u32(chunk + 4) as usize);
    let start = chunk as usize + 8;
    let records: Vec<[u8; 20]> = meshopt::decode_vertex_buffer(&bytes[start..start + v], 25 - 9).unwrap();
    let indices: Vec<u32> = meshopt::decode_index_buffer(&bytes[start + v..start + v + i], 32 * 3).unwrap();
    let expected = model.read_chunk(model.chunk_id(4, 0)).unwrap();
    for (record, vertex) in records.iter().zip(&expected.vertices) {
        let u16_at = |o: usize| u16::from_le_bytes([record[o], record[o + 1]]);
        assert_eq!([0, 2, 4].map(u16_at), vertex.offset);
        assert_eq!(u16_at(6), vertex.parent);
        let packed = u16_at(8) as u32 | (u16_at(10) as u32) << 12 | (record[16] as u32) << 24;
        assert_eq!((packed, &record[12..16]), (vertex.normal_slot, &vertex.color[..]));
    }
    let unrotated = |i: u32| if i < 25 - 9 { i + 9 } else { i - (25 - 9) };
    assert!(indices.iter().map(|&i| unrotated(i)).eq(expected.indices.iter().map(|&i| i as u32)));
}
