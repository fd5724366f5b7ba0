//! A buddy allocator of squares in pages: who lies where, without a GPU.
//!
//! A page is a square of `4^k` units (a unit is 4 x 4 texels), numbered along the Morton curve, so that a square of
//! order `j` (side `2^j` units) is an aligned run of `4^j` units; pages follow one another. Free squares are split
//! in four and joined again with their three buddies (Knowlton 1965, base 4 instead of 2).
//!
//! A request fails only when the free units together are too few: scattered ones are brought together by moving
//! smaller squares away ([`Squares::allocate`] says which). Always the lowest place is taken, so the same requests
//! give the same places.
//! Must never: hand out a unit that is in use.

use std::collections::{BTreeMap, BTreeSet};

/// A square in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Square {
    /// Its first unit.
    pub at: u32,
    /// log2 of its side, units.
    pub order: u32,
    /// Whose it is.
    pub owner: u32,
}

/// A square that has to go to another place first. Moves are carried out in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SquareMove {
    /// Where it goes.
    pub to: Square,
    /// First unit of where it lies.
    pub from: u32,
}

/// Not enough free units for a square, wherever they lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the texture pages are full: {wanted} units wanted, {free} free")]
pub struct PagesFull {
    /// Units of the square.
    pub wanted: u64,
    /// Free units.
    pub free: u64,
}

/// All pages of one texture.
pub struct Squares {
    page_order: u32,
    /// By order: first units of free squares.
    free: Vec<BTreeSet<u32>>,
    /// By first unit.
    used: BTreeMap<u32, (u32, u32)>,
    free_units: u64,
}

impl Squares {
    /// `pages` empty pages of `2^page_order` units side. The units must be fewer than 2^32.
    pub fn new(pages: u32, page_order: u32) -> Self {
        let page_units = 1u64 << (2 * page_order);
        assert!(pages as u64 * page_units < 1 << 32, "units are u32");
        let mut free = vec![BTreeSet::new(); page_order as usize + 1];
        free[page_order as usize] = (0..pages).map(|p| p << (2 * page_order)).collect();
        Self { page_order, free, used: BTreeMap::new(), free_units: pages as u64 * page_units }
    }

    /// Units that nobody uses.
    pub fn free_units(&self) -> u64 {
        self.free_units
    }

    /// Gives `owner` a square of side `2^order` units. The moves have to be carried out before it is written.
    pub fn allocate(&mut self, order: u32, owner: u32) -> Result<(Square, Vec<SquareMove>), PagesFull> {
        assert!(order <= self.page_order, "no square is larger than a page");
        let wanted = 1u64 << (2 * order);
        if self.free_units < wanted {
            return Err(PagesFull { wanted, free: self.free_units });
        }
        let mut moves = Vec::new();
        let at = self.take(order, &mut moves);
        self.used.insert(at, (order, owner));
        self.free_units -= wanted;
        Ok((Square { at, order, owner }, moves))
    }

    /// Takes back the square that begins at unit `at`.
    pub fn free(&mut self, at: u32) {
        let (order, _) = self.used.remove(&at).expect("only squares in use are freed");
        self.free_units += 1 << (2 * order);
        self.join(at, order);
    }

    /// Puts a free square back, joined with its buddies as far as they are free.
    fn join(&mut self, mut at: u32, mut order: u32) {
        while order < self.page_order {
            let step = 1u32 << (2 * order);
            let parent = at & !(4 * step - 1);
            let buddies = (0..4).map(|k| parent + k * step).filter(|&b| b != at);
            if !buddies.clone().all(|b| self.free[order as usize].contains(&b)) {
                break;
            }
            for b in buddies {
                self.free[order as usize].remove(&b);
            }
            (at, order) = (parent, order + 1);
        }
        self.free[order as usize].insert(at);
    }

    /// Takes a free square of `order` out of the lists, after moving smaller ones if there is none. The free
    /// units in the lists must be enough.
    fn take(&mut self, order: u32, moves: &mut Vec<SquareMove>) -> u32 {
        match self.split_free(order) {
            Some(at) => at,
            None => self.clear_square(order, moves),
        }
    }

    /// The lowest free square among the smallest that hold one of `order`, split down to it.
    fn split_free(&mut self, order: u32) -> Option<u32> {
        let found = (order..=self.page_order).find(|&o| !self.free[o as usize].is_empty())?;
        let at = self.free[found as usize].pop_first().expect("not empty");
        for o in (order..found).rev() {
            self.free[o as usize].extend((1..4).map(|k| at + (k << (2 * o))));
        }
        Some(at)
    }

    /// Empties the square of `order` with the most free units and takes it. What lies there always finds a place:
    /// no square of `order` is free, so all free units are in smaller ones, and as many units lie free elsewhere as
    /// are in use here; by induction over `order` each can be brought together.
    fn clear_square(&mut self, order: u32, moves: &mut Vec<SquareMove>) -> u32 {
        let (at, end) = self.emptiest(order);
        for o in 0..order as usize {
            let inside: Vec<u32> = self.free[o].range(at..end).copied().collect();
            for b in inside {
                self.free[o].remove(&b);
            }
        }
        let mut squares: Vec<(u32, (u32, u32))> = self.used.range(at..end).map(|(&a, &s)| (a, s)).collect();
        // Large ones first: small ones fit what they leave.
        squares.sort_by_key(|&(a, (o, _))| (std::cmp::Reverse(o), a));
        for (from, (o, owner)) in squares {
            let to = self.take(o, moves);
            self.used.remove(&from);
            self.used.insert(to, (o, owner));
            moves.push(SquareMove { to: Square { at: to, order: o, owner }, from });
        }
        at
    }

    /// First unit and end of the square of `order` with the most free units, the lowest of them.
    fn emptiest(&self, order: u32) -> (u32, u32) {
        let units = 1u32 << (2 * order);
        let mut tally: BTreeMap<u32, u32> = BTreeMap::new();
        for (o, squares) in self.free[..order as usize].iter().enumerate() {
            for &b in squares {
                *tally.entry(b & !(units - 1)).or_default() += 1 << (2 * o);
            }
        }
        let best = tally.iter().max_by_key(|&(&at, &free)| (free, std::cmp::Reverse(at)));
        let &at = best.expect("the caller has seen enough free units, none of them in a larger square").0;
        (at, at + units)
    }
}

/// Every second bit of `v`, from bit 0, pushed together.
fn even_bits(v: u32) -> u32 {
    let mut v = v & 0x5555_5555;
    for (shift, mask) in [(1, 0x3333_3333), (2, 0x0f0f_0f0f), (4, 0x00ff_00ff), (8, 0x0000_ffff)] {
        v = (v | v >> shift) & mask;
    }
    v
}

/// Page, and x and y in units, of a unit in pages of `2^page_order` units side.
pub fn place(at: u32, page_order: u32) -> (u32, u32, u32) {
    let inside = at & ((1u64 << (2 * page_order)) - 1) as u32;
    ((at as u64 >> (2 * page_order)) as u32, even_bits(inside), even_bits(inside >> 1))
}

/// The bits of `v` (at most 16) moved apart to the even places.
fn spread_bits(v: u32) -> u32 {
    let mut v = v & 0xffff;
    for (shift, mask) in [(8, 0x00ff_00ff), (4, 0x0f0f_0f0f), (2, 0x3333_3333), (1, 0x5555_5555)] {
        v = (v | v << shift) & mask;
    }
    v
}

/// The unit at a place: the inverse of [`place`].
pub fn unit(page: u32, x: u32, y: u32, page_order: u32) -> u32 {
    (page << (2 * page_order)) | spread_bits(x) | spread_bits(y) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_follow_the_morton_curve_and_pages_follow_one_another() {
        let expected = [(0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (0, 2, 0)];
        for (at, place_of) in expected.into_iter().enumerate() {
            assert_eq!(place(at as u32, 3), place_of);
            assert_eq!(unit(place_of.0, place_of.1, place_of.2, 3), at as u32);
        }
        assert_eq!(place(64 + 63, 3), (1, 7, 7));
        assert_eq!(place(0b1110, 10), (0, 2, 3));
        assert_eq!(place(unit(5, 600, 1023, 10), 10), (5, 600, 1023));
    }

    #[test]
    fn a_page_is_whole_again_when_all_its_squares_are_freed() {
        let mut s = Squares::new(1, 3);
        let places: Vec<u32> = (0..64).map(|i| s.allocate(0, i).unwrap().0.at).collect();
        assert_eq!(s.allocate(0, 64), Err(PagesFull { wanted: 1, free: 0 }));
        places.into_iter().rev().for_each(|at| s.free(at));
        assert_eq!(s.allocate(3, 0).unwrap(), (Square { at: 0, order: 3, owner: 0 }, Vec::new()));
    }

    #[test]
    fn scattered_units_are_brought_together() {
        let mut s = Squares::new(1, 2);
        (0..16).for_each(|i| assert_eq!(s.allocate(0, i).unwrap().0.at, i));
        [2, 5, 8, 15].into_iter().for_each(|at| s.free(at));
        let (square, moves) = s.allocate(1, 99).unwrap();
        assert_eq!((square.at, s.free_units()), (0, 0));
        assert_eq!(moves.iter().map(|m| (m.from, m.to.at)).collect::<Vec<_>>(), [(0, 5), (1, 8), (3, 15)]);
    }

    /// A simple random number, the same on every run.
    fn next(state: &mut u64) -> u32 {
        *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*state >> 33) as u32
    }

    /// Every unit holds its owner's number, as texels would, through all moves; and a request fails only when the
    /// units are not there.
    #[test]
    fn squares_never_overlap_and_what_is_free_is_always_found() {
        for (pages, page_order) in [(1, 4), (3, 3), (2, 5)] {
            let (mut s, mut state) = (Squares::new(pages, page_order), 3);
            let units = (pages as usize) << (2 * page_order);
            let mut content = vec![u32::MAX; units];
            let mut live: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
            let mut moved = 0;
            for owner in 0..4000u32 {
                let order = next(&mut state) % (page_order + 1);
                let order = order.min(next(&mut state) % (page_order + 1));
                match s.allocate(order, owner) {
                    Ok((square, moves)) => {
                        moved += moves.len();
                        for m in moves {
                            let n = 1usize << (2 * m.to.order);
                            content.copy_within(m.from as usize..m.from as usize + n, m.to.at as usize);
                            live.insert(m.to.owner, (m.to.at, m.to.order));
                        }
                        content[square.at as usize..][..1 << (2 * order)].fill(owner);
                        live.insert(owner, (square.at, order));
                    }
                    Err(full) => {
                        assert!(full.free < full.wanted);
                        let victim = *live.keys().nth(next(&mut state) as usize % live.len()).unwrap();
                        s.free(live.remove(&victim).unwrap().0);
                    }
                }
                for (&owner, &(at, order)) in &live {
                    assert!(content[at as usize..][..1 << (2 * order)].iter().all(|&c| c == owner));
                }
                let used: usize = live.values().map(|&(_, order)| 1 << (2 * order)).sum();
                assert_eq!(s.free_units() as usize, units - used);
            }
            assert!(moved > 0, "some requests have to move others");
        }
    }
}
