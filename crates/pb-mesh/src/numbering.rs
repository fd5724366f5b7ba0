//! Numbers from zero for the few items that one cluster uses, out of all that a mesh has.

/// Items of a page: one bit each.
const PAGE: u32 = u64::BITS;
/// No page is in use here.
const NONE: u32 = u32::MAX;

/// Sixty-four items in a row, some of which have numbers.
#[derive(Clone, Copy)]
struct Page {
    /// Number of its first item over [`PAGE`].
    index: u32,
    /// How many items of pages before have numbers.
    before: u32,
    used: u64,
}

/// Ascending numbers for a set of items. One is made per thread and used for one cluster after the other: apart from four
/// bytes per 64 items of the mesh, which are made once, it costs what the cluster has.
pub struct Numbering {
    slot_of: Vec<u32>,
    pages: Vec<Page>,
}

impl Numbering {
    /// For items below `items`; none has a number.
    pub fn new(items: usize) -> Self {
        Numbering { slot_of: vec![NONE; items.div_ceil(PAGE as usize)], pages: Vec::new() }
    }

    /// Gives these items numbers in their order, and no others; an item may come several times.
    pub fn assign(&mut self, items: impl Iterator<Item = u32>) {
        self.pages.drain(..).for_each(|p| self.slot_of[p.index as usize] = NONE);
        for item in items {
            let slot = &mut self.slot_of[(item / PAGE) as usize];
            if *slot == NONE {
                *slot = self.pages.len() as u32;
                self.pages.push(Page { index: item / PAGE, before: 0, used: 0 });
            }
            self.pages[*slot as usize].used |= 1 << (item % PAGE);
        }
        self.pages.sort_unstable_by_key(|p| p.index);
        let mut before = 0;
        for (slot, page) in self.pages.iter_mut().enumerate() {
            self.slot_of[page.index as usize] = slot as u32;
            page.before = before;
            before += page.used.count_ones();
        }
    }

    /// How many items have numbers.
    pub fn len(&self) -> usize {
        self.pages.last().map_or(0, |p| (p.before + p.used.count_ones()) as usize)
    }

    /// Has none a number?
    pub fn is_empty(&self) -> bool {
        self.pages.is_empty()
    }

    /// The number of an item that has one.
    pub fn of(&self, item: u32) -> u32 {
        let page = self.pages[self.slot_of[(item / PAGE) as usize] as usize];
        page.before + (page.used & ((1 << (item % PAGE)) - 1)).count_ones()
    }

    /// The items that have numbers, ascending.
    pub fn items(&self) -> impl Iterator<Item = u32> + '_ {
        self.pages.iter().flat_map(|p| {
            let mut left = p.used;
            std::iter::from_fn(move || {
                let bit = (left != 0).then(|| left.trailing_zeros())?;
                left &= left - 1;
                Some(p.index * PAGE + bit)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// As sorting and searching would number them, for one set after the other.
        #[test]
        fn numbers_are_places_in_the_sorted_set(sets in prop::collection::vec(prop::collection::vec(0..1000u32, 0..200), 1..4)) {
            let mut numbering = Numbering::new(1000);
            for set in sets {
                numbering.assign(set.iter().copied());
                let sorted: Vec<u32> = set.into_iter().collect::<std::collections::BTreeSet<u32>>().into_iter().collect();
                prop_assert_eq!(numbering.items().collect::<Vec<u32>>(), sorted.clone());
                prop_assert_eq!((numbering.len(), numbering.is_empty()), (sorted.len(), sorted.is_empty()));
                for (i, &item) in sorted.iter().enumerate() {
                    prop_assert_eq!(numbering.of(item), i as u32);
                }
            }
        }
    }
}
