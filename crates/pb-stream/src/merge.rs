//! Requests that wait for the disk, and which of them one read serves.
//!
//! The most urgent request is always served next, and of those that are alike the oldest; requests for bytes beside its
//! own are taken along, because a second visit would cost a second latency. Must never: read past what was asked for;
//! let a read grow without bound.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::ops::Bound::{Excluded, Unbounded};

/// Most unwanted bytes between two chunks of one read: about what a solid state disk reads in the time of a request.
pub const MAX_GAP_BYTES: u64 = 64 << 10;
/// Most bytes of one read that serves several requests.
pub const MAX_READ_BYTES: u64 = 4 << 20;

/// Bytes of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Where they begin.
    pub offset: u64,
    /// How many.
    pub bytes: u64,
}

impl Extent {
    /// Where they end.
    pub fn end(&self) -> u64 {
        self.offset.saturating_add(self.bytes)
    }

    /// The shortest extent that holds both.
    fn with(&self, other: &Extent) -> Extent {
        let offset = self.offset.min(other.offset);
        Extent { offset, bytes: self.end().max(other.end()) - offset }
    }

    fn gap(&self, later: &Extent) -> u64 {
        later.offset.saturating_sub(self.end())
    }
}

/// May a request share its read?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Company {
    /// With its neighbours.
    Any,
    /// With none: a shared read of it failed.
    Alone,
}

/// One read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch<T> {
    /// What to read.
    pub extent: Extent,
    /// Whom it serves, most urgent first, and their own bytes.
    pub parts: Vec<(Extent, T)>,
}

/// The requests that wait.
#[derive(Clone, Debug)]
pub struct Waiting<T> {
    pushed: u64,
    /// Urgency, order of asking, where it begins; also of requests that were served meanwhile, as neighbours.
    order: BinaryHeap<Reverse<(u64, u64, u64)>>,
    /// By where it begins, then order.
    places: BTreeMap<(u64, u64), Request<T>>,
}

#[derive(Clone, Debug)]
struct Request<T> {
    extent: Extent,
    company: Company,
    rank: u64,
    tag: T,
}

impl<T> Default for Waiting<T> {
    fn default() -> Self {
        Self { pushed: 0, order: BinaryHeap::new(), places: BTreeMap::new() }
    }
}

impl<T> Waiting<T> {
    /// A request, behind all others that are as urgent as can be.
    pub fn push(&mut self, extent: Extent, company: Company, tag: T) {
        self.order.push(Reverse((0, self.pushed, extent.offset)));
        self.places.insert((extent.offset, self.pushed), Request { extent, company, rank: 0, tag });
        self.pushed += 1;
    }

    /// Gives each request that waits a new rank; the lowest is served first.
    pub fn reorder(&mut self, rank: impl Fn(&T) -> u64) {
        let order = self.places.iter_mut().map(|(&(offset, number), request)| {
            request.rank = rank(&request.tag);
            Reverse((request.rank, number, offset))
        });
        self.order = order.collect();
    }

    /// Takes requests out that are not to be served; in the order of the file.
    pub fn withdraw(&mut self, unwanted: impl Fn(&T) -> bool) -> Vec<T> {
        let keys = self.places.iter().filter(|(_, request)| unwanted(&request.tag)).map(|(key, _)| *key);
        let keys: Vec<(u64, u64)> = keys.collect();
        keys.iter().filter_map(|key| self.places.remove(key)).map(|r| r.tag).collect()
    }

    /// Requests that wait.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// True when none waits.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// What the next `count` requests will read, in order.
    pub fn ahead(&self, count: usize) -> Vec<Extent> {
        let mut order = self.order.clone();
        let next = std::iter::from_fn(|| order.pop());
        next.filter_map(|Reverse((_, number, offset))| self.places.get(&(offset, number)))
            .map(|r| r.extent)
            .take(count)
            .collect()
    }

    /// Takes the most urgent request, and those that one read with it serves.
    pub fn take(&mut self) -> Option<Batch<T>> {
        let (number, offset, first) = loop {
            let Reverse((_, number, offset)) = self.order.pop()?;
            if let Some(first) = self.places.get(&(offset, number)) {
                break (number, offset, first);
            }
        };
        let (mut extent, company) = (first.extent, first.company);
        let mut keys = vec![(offset, number)];
        if company == Company::Any {
            let after = self.places.range((Excluded((offset, number)), Unbounded));
            grow(&mut extent, &mut keys, after);
            let before = self.places.range(..(offset, number)).rev();
            grow(&mut extent, &mut keys, before);
        }
        let mut requests: Vec<(u64, Request<T>)> =
            keys.iter().map(|key| (key.1, self.places.remove(key).expect("the key was found above"))).collect();
        requests.sort_unstable_by_key(|(number, r)| (r.rank, *number));
        Some(Batch { extent, parts: requests.into_iter().map(|(_, r)| (r.extent, r.tag)).collect() })
    }
}

/// Takes neighbours along, one after the other, as long as the gaps and the whole stay small.
fn grow<'a, T: 'a>(
    extent: &mut Extent,
    keys: &mut Vec<(u64, u64)>,
    neighbours: impl Iterator<Item = (&'a (u64, u64), &'a Request<T>)>,
) {
    for (key, Request { extent: next, company, .. }) in neighbours {
        let whole = extent.with(next);
        let near = extent.gap(next) <= MAX_GAP_BYTES && next.gap(extent) <= MAX_GAP_BYTES;
        if *company == Company::Alone || !near || whole.bytes > MAX_READ_BYTES {
            return;
        }
        *extent = whole;
        keys.push(*key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn waiting(places: &[(u64, u64)]) -> Waiting<usize> {
        let mut waiting = Waiting::default();
        for (i, &(offset, bytes)) in places.iter().enumerate() {
            waiting.push(Extent { offset, bytes }, Company::Any, i);
        }
        waiting
    }

    fn served(mut waiting: Waiting<usize>) -> Vec<Vec<usize>> {
        std::iter::from_fn(|| waiting.take()).map(|b| b.parts.into_iter().map(|p| p.1).collect()).collect()
    }

    #[test]
    fn neighbours_of_the_oldest_request_are_read_with_it() {
        let gap = MAX_GAP_BYTES;
        let places = [(1000, 100), (5_000_000, 10), (1100, 50), (900, 100), (1150 + gap, 7), (1158 + 2 * gap, 7)];
        assert_eq!(served(waiting(&places)), [vec![0, 2, 3, 4], vec![1], vec![5]]);
        let whole = waiting(&places).take().unwrap().extent;
        assert_eq!((whole.offset, whole.end()), (900, 1157 + gap));
    }

    #[test]
    fn a_read_stays_below_its_bound_unless_one_chunk_is_larger() {
        let half = MAX_READ_BYTES / 2;
        assert_eq!(served(waiting(&[(0, half), (half, half), (2 * half, 1)])), [vec![0, 1], vec![2]]);
        assert_eq!(served(waiting(&[(0, 9 * half), (9 * half, 1)])), [vec![0], vec![1]]);
    }

    #[test]
    fn who_asked_to_be_alone_is() {
        let mut all = waiting(&[(0, 10), (20, 10)]);
        all.push(Extent { offset: 10, bytes: 10 }, Company::Alone, 2);
        all.push(Extent { offset: 30, bytes: 10 }, Company::Any, 3);
        assert_eq!(served(all), [vec![0], vec![1, 3], vec![2]]);
    }

    #[test]
    fn the_most_urgent_is_served_first() {
        let mut all = waiting(&[(0, 10), (9_000_000, 10), (5_000_000, 10), (10, 10)]);
        all.reorder(|&i| [7, 3, 3, 1][i]);
        all.push(Extent { offset: 7_000_000, bytes: 1 }, Company::Any, 4);
        assert_eq!(
            all.ahead(2),
            [7_000_000, 10].map(|offset| Extent { offset, bytes: if offset == 10 { 10 } else { 1 } })
        );
        assert_eq!(served(all), [vec![4], vec![3, 0], vec![1], vec![2]]);
    }

    #[test]
    fn what_is_not_wanted_any_more_is_not_read() {
        let mut all = waiting(&[(0, 10), (10, 10), (20, 10), (9_000_000, 10)]);
        assert_eq!(all.withdraw(|&i| i == 1 || i == 3), [1, 3]);
        assert_eq!((all.len(), all.ahead(9).len()), (2, 2));
        assert_eq!(served(all), [vec![0, 2]]);
    }

    proptest! {
        /// Also where extents overlap, as those of a hostile file may.
        #[test]
        fn every_request_is_served_once_and_lies_in_its_read(
            places in prop::collection::vec((0u64..3_000_000, 0u64..700_000), 1..60)
        ) {
            let mut all = waiting(&places);
            let mut seen = vec![0; places.len()];
            let mut oldest = 0;
            while let Some(batch) = all.take() {
                prop_assert_eq!(batch.parts[0].1, oldest, "the oldest comes first");
                prop_assert!(batch.parts.len() == 1 || batch.extent.bytes <= MAX_READ_BYTES);
                for (extent, i) in &batch.parts {
                    seen[*i] += 1;
                    prop_assert!(extent.offset >= batch.extent.offset && extent.end() <= batch.extent.end());
                }
                oldest = seen.iter().position(|&n| n == 0).unwrap_or(0);
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
        }
    }
}
