//! Sorting along a space-filling curve: whatever order a file has, neighbours of the surface become neighbours in memory.
//!
//! Everything after that walks over the mesh in its own order and finds what it needs in the cache, or, under a bound of
//! memory, in the pages that are there. Files mostly have such an order already and keep it; those that jump about are sorted
//! once. The sort is one for large files: a distribution into shards of the curve, chunk by chunk of the input, then shard by
//! shard. Either pass goes through its input and its output once from front to back.

use crate::mesh::{Soup, bounds};
use crate::topology::group_chunk;
use crate::weld::distance_squared;
use rayon::prelude::*;
use std::ops::Range;

/// Items per chunk; fixed, so that the work is cut the same way on any number of threads. Numbers within it have 16 bits.
const CHUNK: usize = 1 << 16;
/// Items per shard, about, and most shards: one of them at a time is sorted in the cache.
const SHARD: usize = 1 << 15;
const MAX_SHARDS: usize = 1 << 12;
/// Keys that shards are cut at, per shard.
const SAMPLES: usize = 16;
/// Bits of the curve per axis.
const BITS: u32 = 21;
/// Records below which no order is bad: all of them are in the cache.
const MIN_RECORDS: usize = 1 << 18;
/// Pairs of neighbouring triangles that the order is judged by.
const JUDGED: usize = 1 << 14;
/// Records further apart than this, and places further apart than this share of the diagonal, are no neighbours.
const FAR_RECORDS: u32 = 1 << 16;
const FAR: f64 = 1.0 / 16.0;
/// An order is bad where more than this share of the pairs are no neighbours.
const BAD_SHARE: f64 = 0.25;

/// Sorts records and triangles along a curve if their order jumps about; tells whether it did.
///
/// Positions must be finite, and the soup keep its own rules.
pub fn sort_where_needed(soup: &mut Soup) -> bool {
    if soup.positions.len() < MIN_RECORDS {
        return false;
    }
    let bounds = bounds(&soup.positions);
    let needed = jumps_about(soup, &bounds);
    if needed {
        sort(soup, &bounds);
    }
    needed
}

/// Does the order of many triangles, or that of the records they use, say nothing of where they are?
fn jumps_about(soup: &Soup, (low, high): &([f64; 3], [f64; 3])) -> bool {
    let Soup { positions, triangles, .. } = soup;
    let far = distance_squared(low, high) * FAR * FAR;
    let step = (triangles.len() / JUDGED).max(1);
    let pairs = || triangles.windows(2).step_by(step);
    let apart = |pair: &&[[u32; 3]]| {
        let [a, b] = [pair[0][0], pair[1][0]].map(|r| &positions[r as usize]);
        distance_squared(a, b) > far
    };
    let scattered = |pair: &&[[u32; 3]]| {
        let [a, b, c] = pair[0];
        a.max(b).max(c) - a.min(b).min(c) > FAR_RECORDS
    };
    let bad = |count: usize| count as f64 > BAD_SHARE * pairs().count() as f64;
    bad(pairs().filter(apart).count()) || bad(pairs().filter(scattered).count())
}

fn sort(soup: &mut Soup, (low, high): &([f64; 3], [f64; 3])) {
    let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    let scale = if extent > 0.0 { f64::from((1u32 << BITS) - 1) / extent } else { 0.0 };
    let place = |p: &[f64; 3]| morton(std::array::from_fn(|k| ((p[k] - low[k]) * scale) as u64));
    let records = Sorting::new(&soup.positions, place);
    records.apply(&mut soup.positions);
    records.apply(&mut soup.normals);
    records.apply(&mut soup.colors);
    records.apply(&mut soup.objects.of);
    soup.uv_sets.iter_mut().for_each(|set| records.apply(set));
    let rank = records.ranks();
    drop(records);
    soup.triangles.par_iter_mut().for_each(|t| *t = t.map(|r| rank[r as usize]));
    drop(rank);
    let triangles = Sorting::new(&soup.triangles, |t| u64::from(t[0].min(t[1]).min(t[2])));
    triangles.apply(&mut soup.triangles);
    triangles.apply(&mut soup.material_of);
}

/// Where items go when they are sorted by a key; equal keys keep their order.
struct Sorting {
    chunks: Vec<Chunk>,
    /// Of each shard: its items in their final order, as numbers in the order in which the chunks have them.
    shards: Vec<Vec<u32>>,
}

/// The items of one chunk, shard by shard.
struct Chunk {
    /// Items, counted from the chunk's first.
    order: Vec<u16>,
    /// Where each shard begins in `order`, and the end.
    starts: Vec<u32>,
}

impl Chunk {
    fn run(&self, shard: usize) -> Range<usize> {
        self.starts[shard] as usize..self.starts[shard + 1] as usize
    }
}

impl Sorting {
    fn new<T: Sync>(items: &[T], key: impl Fn(&T) -> u64 + Sync) -> Sorting {
        let cuts = cuts(items, &key);
        let parts: Vec<(Chunk, Vec<u64>)> = items.par_chunks(CHUNK).map(|part| distribute(part, &cuts, &key)).collect();
        let shard = |s: usize| {
            let mut keyed: Vec<(u64, u32)> = Vec::new();
            for (chunk, keys) in &parts {
                keyed.extend(keys[chunk.run(s)].iter().zip(keyed.len() as u32..).map(|(&k, i)| (k, i)));
            }
            keyed.sort_unstable();
            keyed.into_iter().map(|(_, i)| i).collect()
        };
        let shards = (0..=cuts.len()).into_par_iter().map(shard).collect();
        Sorting { chunks: parts.into_iter().map(|(chunk, _)| chunk).collect(), shards }
    }

    /// Puts a list of as many items as were sorted into their order; an empty one stays empty.
    fn apply<T: Copy + Default + Send + Sync>(&self, list: &mut Vec<T>) {
        if list.is_empty() {
            return;
        }
        list.par_chunks_mut(CHUNK).zip(&self.chunks).for_each(|(part, chunk)| {
            let old = part.to_vec();
            part.iter_mut().zip(&chunk.order).for_each(|(item, &i)| *item = old[usize::from(i)]);
        });
        let mut sorted = vec![T::default(); list.len()];
        self.parts_of(&mut sorted).into_par_iter().enumerate().for_each(|(s, part)| {
            let runs = self.chunks.iter().zip(list.chunks(CHUNK)).map(|(chunk, part)| &part[chunk.run(s)]);
            let items: Vec<T> = runs.flatten().copied().collect();
            part.iter_mut().zip(&self.shards[s]).for_each(|(item, &i)| *item = items[i as usize]);
        });
        *list = sorted;
    }

    /// The place of each item among the sorted ones.
    fn ranks(&self) -> Vec<u32> {
        // The same two passes backwards: first in the order in which the chunks have them.
        let firsts: Vec<u32> =
            self.shards.iter().scan(0, |next, s| Some(std::mem::replace(next, *next + s.len() as u32))).collect();
        let total = self.shards.iter().map(Vec::len).sum();
        let mut by_shard = vec![0u32; total];
        self.parts_of(&mut by_shard).into_par_iter().enumerate().for_each(|(s, part)| {
            self.shards[s].iter().zip(firsts[s]..).for_each(|(&i, rank)| part[i as usize] = rank);
        });
        let mut ranks = vec![0u32; total];
        // Where each chunk's run begins in its shard.
        let mut at = firsts;
        let begins: Vec<Vec<u32>> = self
            .chunks
            .iter()
            .map(|chunk| {
                let here = at.clone();
                at.iter_mut().enumerate().for_each(|(s, at)| *at += chunk.run(s).len() as u32);
                here
            })
            .collect();
        ranks.par_chunks_mut(CHUNK).zip(&self.chunks).zip(begins).for_each(|((part, chunk), begins)| {
            for (s, &begin) in begins.iter().enumerate() {
                let run = chunk.run(s);
                let found = &by_shard[begin as usize..][..run.len()];
                chunk.order[run].iter().zip(found).for_each(|(&i, &rank)| part[usize::from(i)] = rank);
            }
        });
        ranks
    }

    /// The parts of a sorted list that belong to the shards.
    fn parts_of<'a, T>(&self, mut rest: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut take = |shard: &Vec<u32>| rest.split_off_mut(..shard.len()).expect("as many items as were sorted");
        self.shards.iter().map(&mut take).collect()
    }
}

/// Keys at which a new shard begins, from samples: shards of about the same size wherever the keys are.
fn cuts<T>(items: &[T], key: &impl Fn(&T) -> u64) -> Vec<u64> {
    let shards = (items.len() / SHARD).clamp(1, MAX_SHARDS);
    let mut samples: Vec<u64> = items.iter().step_by((items.len() / (shards * SAMPLES)).max(1)).map(key).collect();
    samples.sort_unstable();
    let mut cuts: Vec<u64> = samples.into_iter().skip(SAMPLES).step_by(SAMPLES).collect();
    cuts.dedup();
    cuts
}

/// A chunk's items by shard, and their keys in that order.
fn distribute<T>(part: &[T], cuts: &[u64], key: &impl Fn(&T) -> u64) -> (Chunk, Vec<u64>) {
    let keys: Vec<u64> = part.iter().map(key).collect();
    let shards: Vec<u16> = keys.iter().map(|k| cuts.partition_point(|cut| cut <= k) as u16).collect();
    let mut order = vec![0u16; part.len()];
    let shards = shards.iter().map(|&s| usize::from(s));
    let starts = group_chunk(cuts.len() + 1, shards, |slot, i| order[slot] = i as u16);
    let keys = order.iter().map(|&i| keys[usize::from(i)]).collect();
    (Chunk { order, starts }, keys)
}

/// Place on Morton's curve of a cell with [`BITS`] bits per axis.
fn morton(cell: [u64; 3]) -> u64 {
    let spread = |x: u64| {
        let x = (x | x << 32) & 0x001f_0000_0000_ffff;
        let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A grid of `side` by `side` records with all attributes, whose records and triangles `mix` reorders.
    fn grid(side: u32, mix: impl Fn(u64) -> u64) -> Soup {
        let mixed = |count: usize| {
            let mut list: Vec<u32> = (0..count as u32).collect();
            list.sort_by_key(|&i| mix(u64::from(i)));
            list
        };
        let count = (side * side) as usize;
        let place_of = mixed(count);
        let mut at = vec![0; count];
        place_of.iter().enumerate().for_each(|(new, &old)| at[old as usize] = new as u32);
        let position = |i: u32| [f64::from(i % side), f64::from(i / side), f64::from(i % 7) / 100.0];
        let squares = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
        let triangles: Vec<[u32; 3]> =
            squares.flat_map(|v| [[v, v + 1, v + side], [v + 1, v + side + 1, v + side]]).collect();
        let order = mixed(triangles.len());
        Soup {
            positions: place_of.iter().map(|&i| position(i)).collect(),
            normals: place_of.iter().map(|&i| [i as f32, 0.0, 1.0]).collect(),
            colors: place_of.iter().map(|&i| i.to_le_bytes()).collect(),
            uv_sets: vec![place_of.iter().map(|&i| [i as f32, 1.0]).collect()],
            triangles: order.iter().map(|&t| triangles[t as usize].map(|v| at[v as usize])).collect(),
            material_of: order,
            ..Soup::default()
        }
    }

    fn jumps(soup: &Soup) -> bool {
        jumps_about(soup, &bounds(&soup.positions))
    }

    fn scattered(i: u64) -> u64 {
        (i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
    }

    #[test]
    fn a_sorted_soup_is_the_same_surface_with_neighbours_near_each_other() {
        let (mixed, plain) = (grid(600, scattered), grid(600, |i| i));
        assert!(jumps(&mixed) && !jumps(&plain));
        let mut sorted = mixed.clone();
        assert!(sort_where_needed(&mut sorted));
        assert!(!jumps(&sorted));
        // Materials number the triangles, colours the records: nothing is lost, mixed up or turned over.
        let by_material = |soup: &Soup| {
            let corner = |r: u32| (soup.positions[r as usize].map(f64::to_bits), soup.colors[r as usize]);
            let mut list: Vec<_> =
                soup.triangles.iter().zip(&soup.material_of).map(|(t, m)| (*m, t.map(corner))).collect();
            list.sort_unstable();
            list
        };
        assert_eq!(by_material(&sorted), by_material(&plain));
        for (r, color) in sorted.colors.iter().enumerate() {
            let i = u32::from_le_bytes(*color) as f32;
            assert_eq!((sorted.normals[r][0], sorted.uv_sets[0][r][0]), (i, i));
        }
    }

    #[test]
    fn an_order_that_is_good_stays() {
        let mut plain = grid(600, |i| i);
        let before = plain.clone();
        assert!(!sort_where_needed(&mut plain));
        assert_eq!(plain, before);
    }

    #[test]
    fn records_or_triangles_alone_may_jump_about() {
        let plain = grid(600, |i| i);
        let mut triangles = plain.clone();
        triangles.triangles = grid(600, scattered).material_of.iter().map(|&t| plain.triangles[t as usize]).collect();
        assert!(jumps(&triangles));
        let mixed = grid(600, scattered);
        let mut in_order: Vec<_> = mixed.material_of.iter().zip(&mixed.triangles).collect();
        in_order.sort_unstable();
        let records = Soup { triangles: in_order.iter().map(|t| *t.1).collect(), ..mixed.clone() };
        assert!(jumps(&records));
    }

    #[test]
    fn places_that_are_all_the_same_are_sorted_too() {
        let mut soup = grid(600, scattered);
        soup.positions.fill([1.0, 2.0, 3.0]);
        let before = soup.clone();
        sort(&mut soup, &bounds(&before.positions));
        assert_eq!((soup.colors.len(), soup.positions), (before.colors.len(), before.positions));
    }

    proptest! {
        #[test]
        fn any_keys_are_sorted_and_ranks_say_where_they_went(keys in prop::collection::vec(0u64..50, 0..300), repeat in 1usize..800) {
            let keys: Vec<u64> = (0..repeat).flat_map(|r| keys.iter().map(move |k| k * (r as u64 % 3 + 1))).collect();
            let sorting = Sorting::new(&keys, |k| *k);
            let mut numbers: Vec<u32> = (0..keys.len() as u32).collect();
            sorting.apply(&mut numbers);
            let mut expected: Vec<u32> = (0..keys.len() as u32).collect();
            expected.sort_by_key(|&i| keys[i as usize]);
            prop_assert_eq!(&numbers, &expected);
            let ranks = sorting.ranks();
            prop_assert!(numbers.iter().enumerate().all(|(new, &old)| ranks[old as usize] == new as u32));
        }
    }
}
