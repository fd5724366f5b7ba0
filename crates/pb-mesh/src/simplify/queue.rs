//! The collapses of a round in the order of their costs, to within one percent.
//!
//! A list per 64th of an octave instead of a heap: one step to put something in and one to take the cheapest out, where a
//! heap takes as many as its logarithm, each at another place in memory.

/// Bits of a cost that a list does not look at: those of an `f32` below 1/64 of its octave.
const SHIFT: u32 = 17;
/// Lists: 64 octaves below the limit; the first one has everything cheaper.
const COUNT: usize = 64 * 64;
/// The end of a list.
const NONE: u32 = u32::MAX;

/// One vertex and its cost at that time.
#[derive(Clone, Copy)]
struct Entry {
    cost: f32,
    vertex: u32,
    next: u32,
}

/// A queue of vertices, cheapest first; of costs that share a list, the latest first.
#[derive(Clone)]
pub(super) struct Queue {
    /// Most that an entry may cost.
    limit: f32,
    /// First entry of each list; empty until something is put in.
    heads: Vec<u32>,
    /// Which lists have entries, and which of those 64 words have bits.
    used: [u64; COUNT / 64],
    words: u64,
    entries: Vec<Entry>,
    /// First of the entries that are free.
    free: u32,
}

impl Default for Queue {
    /// Takes nothing until it is started.
    fn default() -> Self {
        Queue {
            limit: f32::NEG_INFINITY,
            heads: Vec::new(),
            used: [0; COUNT / 64],
            words: 0,
            entries: Vec::new(),
            free: NONE,
        }
    }
}

impl Queue {
    /// Forgets all and takes costs up to `limit` from now on.
    pub fn restart(&mut self, limit: f32) {
        self.limit = limit;
        self.heads.clear();
        self.heads.resize(COUNT, NONE);
        (self.used, self.words) = ([0; COUNT / 64], 0);
        self.entries.clear();
        self.free = NONE;
    }

    /// Forgets all, and takes nothing until it is restarted. A queue that waits holds no memory.
    pub fn stop(&mut self) {
        *self = Queue::default();
    }

    /// Puts a vertex in unless its cost, which is not negative, is above the limit.
    pub fn push(&mut self, cost: f32, vertex: u32) {
        if cost.is_nan() || cost > self.limit {
            return;
        }
        let below = (self.limit.to_bits() >> SHIFT) - (cost.to_bits() >> SHIFT);
        let list = COUNT - 1 - (below as usize).min(COUNT - 1);
        let entry = Entry { cost, vertex, next: self.heads[list] };
        let at = self.free;
        if at == NONE {
            self.heads[list] = self.entries.len() as u32;
            self.entries.push(entry);
        } else {
            self.heads[list] = at;
            self.free = std::mem::replace(&mut self.entries[at as usize], entry).next;
        }
        self.used[list / 64] |= 1 << (list % 64);
        self.words |= 1 << (list / 64);
    }

    /// Entries that were ever put in since the start: an upper bound of those that are there.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// The cheapest list that is not empty.
    fn first(&self) -> Option<usize> {
        let word = (self.words != 0).then(|| self.words.trailing_zeros() as usize)?;
        Some(word * 64 + self.used[word].trailing_zeros() as usize)
    }

    /// What the next one costs.
    pub fn next_cost(&self) -> Option<f32> {
        self.first().map(|list| self.entries[self.heads[list] as usize].cost)
    }

    /// Takes the next one out.
    pub fn pop(&mut self) -> Option<(f32, u32)> {
        let list = self.first()?;
        let at = self.heads[list];
        let Entry { cost, vertex, next } = self.entries[at as usize];
        self.entries[at as usize].next = std::mem::replace(&mut self.free, at);
        self.heads[list] = next;
        if next == NONE {
            self.used[list / 64] &= !(1 << (list % 64));
            if self.used[list / 64] == 0 {
                self.words &= !(1 << (list / 64));
            }
        }
        Some((cost, vertex))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever is put in and taken out between: nothing is lost, and what comes is the cheapest to within a list.
        #[test]
        fn vertices_come_in_the_order_of_their_costs(
            steps in prop::collection::vec((any::<bool>(), 0..1_000_000u32), 1..300), limit in 0.5f32..2e6,
        ) {
            let mut queue = Queue::default();
            queue.restart(limit);
            let mut kept: Vec<(f32, u32)> = Vec::new();
            for (i, (put, cost)) in steps.into_iter().enumerate() {
                let cost = if cost % 7 == 0 { 0.0 } else { cost as f32 * 0.7 };
                if put {
                    queue.push(cost, i as u32);
                    kept.extend((cost <= limit).then_some((cost, i as u32)));
                    continue;
                }
                let least = kept.iter().map(|k| k.0).fold(f32::INFINITY, f32::min);
                let next = queue.next_cost();
                let taken = queue.pop();
                prop_assert_eq!(taken.map(|t| t.0), next);
                prop_assert_eq!(taken.is_none(), kept.is_empty());
                if let Some(taken) = taken {
                    prop_assert!(taken.0 <= least * (1.0 + 1.0 / 64.0), "{} after {least}", taken.0);
                    let at = kept.iter().position(|k| *k == taken);
                    prop_assert!(at.is_some(), "it was put in");
                    kept.swap_remove(at.unwrap());
                }
            }
        }
    }
}
