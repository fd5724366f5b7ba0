//! Finds records with the same position: exactly, or within a tolerance.
//!
//! The exact search partitions hashes into shards small enough for the cache and searches the shards in parallel.
//! Both searches answer with the lowest index of each group, so the result depends neither on threads nor on hash
//! order. Positions must be finite; nothing here moves one.

use crate::topology::group_chunk;
use rayon::prelude::*;
use std::collections::HashMap;

/// Records per partition job; fixed, so that the work is cut the same way on any number of threads.
const CHUNK: usize = 1 << 16;
/// Wanted records per shard: its table of 8-byte slots stays in the second-level cache.
const SHARD: usize = 1 << 14;
/// Most shards that a partition may have.
const MAX_SHARD_COUNT: usize = 1 << 12;
/// An unused slot of a shard's table; no record has this index.
const EMPTY: u32 = u32::MAX;

/// For each position the lowest index that has the same position; `-0.0` equals `0.0`.
///
/// Positions of different objects are never the same; `object_of` is empty where there is one object.
///
/// Takes fewer than `u32::MAX` finite positions.
pub fn weld_exact(positions: &[[f64; 3]], object_of: &[u32]) -> Vec<u32> {
    assert!(positions.len() < EMPTY as usize, "record indices are 32 bits wide");
    assert!(object_of.is_empty() || object_of.len() == positions.len(), "one object per position");
    let shard_count = (positions.len() / SHARD).next_power_of_two().min(MAX_SHARD_COUNT);
    let chunks: Vec<Partition> = positions
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, part)| Partition::new(part, chunk * CHUNK, shard_count))
        .collect();
    let repeats: Vec<Vec<(u32, u32)>> = (0..shard_count)
        .into_par_iter()
        .map(|shard| repeats_of_shard((positions, object_of), &chunks, shard))
        .collect();
    let mut first: Vec<u32> = (0..positions.len() as u32).collect();
    for (record, earlier) in repeats.into_iter().flatten() {
        first[record as usize] = earlier;
    }
    first
}

/// For each position the lowest index that stands for it: an earlier standing position at most `tolerance` away, the
/// lowest of them, else its own. `first` is the answer of [`weld_exact`].
pub fn weld_within(positions: &[[f64; 3]], object_of: &[u32], first: &[u32], tolerance: f64) -> Vec<u32> {
    assert!(tolerance > 0.0 && tolerance.is_finite() && first.len() == positions.len());
    let cell_of = |p: &[f64; 3]| p.map(|x| (x / tolerance).floor());
    let key = |i: usize, cell: [f64; 3]| (object_of.get(i).copied().unwrap_or(0), cell.map(|x| (x + 0.0).to_bits()));
    let mut standing: HashMap<(u32, [u64; 3]), Vec<u32>> = HashMap::new();
    let mut stands_for = first.to_vec();
    for (i, p) in positions.iter().enumerate() {
        if first[i] as usize != i {
            stands_for[i] = stands_for[first[i] as usize];
            continue;
        }
        let cell = cell_of(p);
        let found = neighbours(cell)
            .filter_map(|cell| standing.get(&key(i, cell)))
            .flatten()
            .copied()
            .filter(|&j| distance_squared(&positions[j as usize], p) <= tolerance * tolerance)
            .min();
        match found {
            Some(j) => stands_for[i] = j,
            None => standing.entry(key(i, cell)).or_default().push(i as u32),
        }
    }
    stands_for
}

/// The cells at and around a cell: 27, or fewer where the coordinates are too large for neighbours to be told apart.
fn neighbours(cell: [f64; 3]) -> impl Iterator<Item = [f64; 3]> {
    (0..27).map(move |i| {
        [cell[0] + (i % 3) as f64 - 1.0, cell[1] + (i / 3 % 3) as f64 - 1.0, cell[2] + (i / 9) as f64 - 1.0]
    })
}

pub(crate) fn distance_squared(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum()
}

/// One chunk of records ordered by shard, each shard in ascending order of records.
struct Partition {
    /// (rest of the hash, record)
    entries: Vec<(u32, u32)>,
    /// Where each shard begins in `entries`, and the end.
    offsets: Vec<u32>,
}

impl Partition {
    fn new(positions: &[[f64; 3]], base: usize, shard_count: usize) -> Partition {
        let hashes: Vec<u64> = positions.iter().map(hash).collect();
        let shard_of = |hash: u64| (hash >> 32) as usize & (shard_count - 1);
        let mut entries = vec![(0, 0); positions.len()];
        let shards = hashes.iter().map(|&h| shard_of(h));
        let offsets = group_chunk(shard_count, shards, |slot, i| entries[slot] = (hashes[i] as u32, (base + i) as u32));
        Partition { entries, offsets }
    }

    fn shard(&self, shard: usize) -> &[(u32, u32)] {
        &self.entries[self.offsets[shard] as usize..self.offsets[shard + 1] as usize]
    }
}

/// (record, lowest record with the same position) for all but the first of each group.
fn repeats_of_shard(
    (positions, object_of): (&[[f64; 3]], &[u32]),
    chunks: &[Partition],
    shard: usize,
) -> Vec<(u32, u32)> {
    let count: usize = chunks.iter().map(|c| c.shard(shard).len()).sum();
    let mask = (2 * count).next_power_of_two() - 1;
    let mut table = vec![(0u32, EMPTY); mask + 1];
    let mut repeats = Vec::new();
    let together = |a: u32, b: u32| object_of.is_empty() || object_of[a as usize] == object_of[b as usize];
    for &(hash, record) in chunks.iter().flat_map(|c| c.shard(shard)) {
        let mut slot = hash as usize & mask;
        loop {
            let (other_hash, other) = table[slot];
            if other == EMPTY {
                table[slot] = (hash, record);
                break;
            }
            let same = other_hash == hash && positions[other as usize] == positions[record as usize];
            if same && together(other, record) {
                repeats.push((record, other));
                break;
            }
            slot = (slot + 1) & mask;
        }
    }
    repeats
}

/// Equal positions have equal hashes, also where one has `-0.0`.
fn hash(position: &[f64; 3]) -> u64 {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    for x in position {
        let wide = u128::from(state ^ (x + 0.0).to_bits()) * 0xD6E8_FEB8_6659_FD93_u128;
        state = ((wide >> 64) as u64 ^ wide as u64).wrapping_add(0xA076_1D64_78BD_642F);
    }
    state ^ (state >> 29)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn equal_positions_share_the_lowest_index_and_minus_zero_is_zero() {
        let positions = [[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [0.0, 1.0, 2.0 + 1e-15], [0.0, 1.0, 2.0]];
        assert_eq!(weld_exact(&positions, &[]), [0, 0, 2, 0]);
        assert!(weld_exact(&[], &[]).is_empty());
    }

    #[test]
    fn tolerance_joins_across_cell_borders_and_chooses_the_lowest() {
        let positions = [[0.99, 0.0, 0.0], [1.01, 0.0, 0.0], [1.2, 0.0, 0.0], [-0.005, 0.0, 0.0], [0.99, 0.0, 0.0]];
        let first = weld_exact(&positions, &[]);
        assert_eq!(weld_within(&positions, &[], &first, 0.1), [0, 0, 2, 3, 0]);
    }

    #[test]
    fn many_records_weld_like_a_map_says() {
        let positions: Vec<[f64; 3]> =
            (0..200_000u64).map(|i| [(i * 7919 % 50_021) as f64, (i * 7919 % 50_021 % 7) as f64, 0.5]).collect();
        let mut seen = HashMap::new();
        let expected: Vec<u32> =
            positions.iter().enumerate().map(|(i, p)| *seen.entry(p.map(f64::to_bits)).or_insert(i as u32)).collect();
        assert_eq!(weld_exact(&positions, &[]), expected);
    }

    proptest! {
        #[test]
        fn nothing_moves_further_than_the_tolerance(points in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 0..200)) {
            let stands_for = weld_within(&points, &[], &weld_exact(&points, &[]), 0.2);
            for (i, &j) in stands_for.iter().enumerate() {
                prop_assert!(distance_squared(&points[i], &points[j as usize]) <= 0.04 + 1e-12);
                prop_assert!(j as usize <= i && stands_for[j as usize] == j);
            }
        }
    }

    #[test]
    fn equal_positions_of_two_objects_stay_two() {
        let positions = [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.05]];
        let objects = [0, 7, 0, 7];
        let first = weld_exact(&positions, &objects);
        assert_eq!(first, [0, 1, 0, 3]);
        assert_eq!(weld_within(&positions, &objects, &first, 0.1), [0, 1, 0, 1]);
    }
}
