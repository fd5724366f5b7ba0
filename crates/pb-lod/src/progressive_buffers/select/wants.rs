//! The chunks that a frame wants: each once, at the highest class and error that anybody gave it, most urgent first.
//!
//! Must never: depend on the order in which wants come.

use crate::plan::{Class, Want};

/// Bits of a sort key that hold a want's place in the list.
const PLACE_BITS: u32 = 31;

/// Collects wants.
#[derive(Default)]
pub(super) struct Wants {
    list: Vec<Want>,
    /// Per chunk: its place in the list, if what stands there is that chunk's.
    place: Vec<u32>,
    keys: Vec<u64>,
}

impl Wants {
    /// For so many chunks.
    pub fn new(chunks: usize) -> Wants {
        Wants { place: vec![0; chunks], ..Wants::default() }
    }

    /// Wants a chunk; of several wants of the same one the most urgent stays.
    pub fn add(&mut self, want: Want) {
        let place = &mut self.place[want.chunk.0 as usize];
        match self.list.get_mut(*place as usize) {
            Some(other) if other.chunk == want.chunk => {
                if (want.class, want.error_px) > (other.class, other.error_px) {
                    *other = want;
                }
            }
            _ => {
                *place = self.list.len() as u32;
                self.list.push(want);
            }
        }
    }

    /// Those collected since the last call: class, then the larger error, then the smaller chunk id.
    pub fn ordered(&mut self) -> Vec<Want> {
        assert!(self.list.len() < 1 << PLACE_BITS, "a want's place fits its key");
        let keys = self.list.iter().zip(0..).map(|(w, place)| key(w) << PLACE_BITS | place);
        self.keys.clear();
        self.keys.extend(keys);
        self.keys.sort_unstable();
        let place = |key: &u64| (key & ((1 << PLACE_BITS) - 1)) as usize;
        let mut out: Vec<Want> = self.keys.iter().map(|key| self.list[place(key)]).collect();
        let alike = |a: &Want, b: &Want| key(a) == key(b);
        out.chunk_by_mut(alike).filter(|run| run.len() > 1).for_each(|run| run.sort_unstable_by_key(|w| w.chunk));
        self.list.clear();
        out
    }

    /// One list of three, each of which is in order; only the first has wants of class Now.
    pub fn merged(&mut self, mut lists: [&[Want]; 3]) -> Vec<Want> {
        let mut out: Vec<Want> = Vec::with_capacity(lists.iter().map(|list| list.len()).sum());
        let (now, rest) = lists[0].split_at(lists[0].partition_point(|w| w.class == Class::Now));
        out.extend_from_slice(now);
        (0..).zip(now).for_each(|(place, w)| self.place[w.chunk.0 as usize] = place);
        lists[0] = rest;
        let rank = |list: &[Want]| list.first().map_or(u128::MAX, |w| u128::from(key(w)) << 32 | u128::from(w.chunk.0));
        let mut ranks = lists.map(rank);
        loop {
            let first = if ranks[1] <= ranks[2] { 1 } else { 2 };
            let first = if ranks[0] <= ranks[first] { 0 } else { first };
            let Some((&want, rest)) = lists[first].split_first() else { return out };
            (lists[first], ranks[first]) = (rest, rank(rest));
            let place = &mut self.place[want.chunk.0 as usize];
            if out.get(*place as usize).is_none_or(|other| other.chunk != want.chunk) {
                *place = out.len() as u32;
                out.push(want);
            }
        }
    }
}

/// Smaller for what is more urgent: class, then error. Errors are never negative, so their bits rise with them.
fn key(want: &Want) -> u64 {
    let error = u64::from(want.error_px.to_bits() & 0x7fff_ffff);
    (3 - want.class as u64) << 31 | (0x7fff_ffff - error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::ChunkId;

    fn want(chunk: u32, class: Class, error_px: f32) -> Want {
        Want { chunk: ChunkId(chunk), class, error_px }
    }

    #[test]
    fn each_chunk_comes_once_at_its_most_urgent_and_the_order_of_coming_does_not_matter() {
        let wants = [
            want(4, Class::Maybe, f32::INFINITY),
            want(3, Class::Now, 0.0),
            want(1, Class::Soon, 2.0),
            want(9, Class::Now, 2.0),
            want(1, Class::Now, 0.5),
            want(1, Class::Now, 1.5),
            want(7, Class::Now, 1.5),
            want(0, Class::Now, 1.5),
            want(4, Class::Maybe, 1e-30),
        ];
        let expected = [
            want(9, Class::Now, 2.0),
            want(0, Class::Now, 1.5),
            want(1, Class::Now, 1.5),
            want(7, Class::Now, 1.5),
            want(3, Class::Now, 0.0),
            want(4, Class::Maybe, f32::INFINITY),
        ];
        let mut all = Wants::new(10);
        for turn in 0..wants.len() {
            wants.iter().cycle().skip(turn).take(wants.len()).for_each(|&w| all.add(w));
            assert_eq!(all.ordered(), expected, "beginning with {turn}");
        }
    }

    #[test]
    fn lists_in_order_become_one_as_if_all_had_come_one_by_one() {
        let noise = |i: u32, k: u32| (u64::from(i * 4 + k) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        let wants: Vec<Want> = (0..300)
            .map(|i| {
                let class =
                    [Class::Maybe, Class::Soon, Class::Now][(noise(i, 1) % if i < 150 { 3 } else { 2 }) as usize];
                want((noise(i, 0) % 100) as u32, class, (noise(i, 2) % 9) as f32)
            })
            .collect();
        let mut all = Wants::new(100);
        for (first, second) in [(150, 150), (150, 300), (200, 250), (300, 300), (160, 161)] {
            let lists = [&wants[..first], &wants[first..second], &wants[second..]].map(|list| {
                list.iter().for_each(|&w| all.add(w));
                all.ordered()
            });
            let merged = all.merged([&lists[0], &lists[1], &lists[2]]);
            wants.iter().for_each(|&w| all.add(w));
            assert_eq!(merged, all.ordered());
        }
    }
}
