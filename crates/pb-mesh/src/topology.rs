//! Which triangles meet at a position, and what kind of neighbourhood that is.

use rayon::prelude::*;

/// Triangles around every position, as one flat list.
#[derive(Clone, Debug, Default)]
pub struct Fans {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl Fans {
    /// Counts and collects; `triangles` hold indices below `positions`.
    pub fn new(positions: usize, triangles: &[[u32; 3]]) -> Self {
        let (starts, triangles) = group(positions, triangles);
        Fans { starts, triangles }
    }

    /// Triangles that use position `v`, ascending.
    pub fn around(&self, v: u32) -> &[u32] {
        &self.triangles[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }
}

/// Items whose extent is looked at together; see [`group`].
const GROUP_BLOCK: usize = 1 << 12;

/// Items by key, as one flat list: entry `k` of the first answer is where group `k` begins in the second, which holds the
/// items that have key `k`, ascending. Keys are below `groups`.
///
/// Each thread fills the groups of one range. Items near each other mostly have keys near each other, so it skips most of
/// the others' blocks; where they have not, it reads over them, which costs less than what it fills.
pub fn group<const K: usize>(groups: usize, items: &[[u32; K]]) -> (Vec<u32>, Vec<u32>) {
    let extent = |block: &[[u32; K]]| {
        block.as_flattened().iter().fold((u32::MAX, 0), |(low, high), &k| (low.min(k), high.max(k)))
    };
    let extents: Vec<(u32, u32)> = items.par_chunks(GROUP_BLOCK).map(extent).collect();
    let share = groups.div_ceil(rayon::current_num_threads()).max(1);
    // Every item, by number, that has keys in `first .. first + count`.
    let each = |first: usize, count: usize, visit: &mut dyn FnMut(usize, u32)| {
        for (b, block) in items.chunks(GROUP_BLOCK).enumerate() {
            let (low, high) = extents[b];
            if (high as usize) < first || low as usize >= first + count {
                continue;
            }
            for (i, keys) in block.iter().enumerate() {
                for &k in keys {
                    let at = (k as usize).wrapping_sub(first);
                    if at < count {
                        visit(at, (b * GROUP_BLOCK + i) as u32);
                    }
                }
            }
        }
    };
    let mut starts = vec![0u32; groups + 1];
    starts[1..].par_chunks_mut(share).enumerate().for_each(|(job, ends)| {
        let count = ends.len();
        each(job * share, count, &mut |at, _| ends[at] += 1);
    });
    (0..groups).for_each(|k| starts[k + 1] += starts[k]);
    let mut list = vec![0; items.len() * K];
    let (mut rest, mut runs) = (list.as_mut_slice(), Vec::new());
    for first in (0..groups).step_by(share) {
        let next = groups.min(first + share);
        let (run, after) = rest.split_at_mut((starts[next] - starts[first]) as usize);
        runs.push((first, next, run));
        rest = after;
    }
    runs.into_par_iter().for_each(|(first, next, run)| {
        let mut at: Vec<u32> = starts[first..next].iter().map(|s| s - starts[first]).collect();
        each(first, next - first, &mut |group, item| {
            run[at[group] as usize] = item;
            at[group] += 1;
        });
    });
    (starts, list)
}

/// The same for one chunk on one thread: `put` gets the place of each item in the list, and the item. The answer is where the
/// groups begin, and the end.
pub(crate) fn group_chunk(
    groups: usize,
    keys: impl Iterator<Item = usize> + Clone,
    mut put: impl FnMut(usize, usize),
) -> Vec<u32> {
    let mut starts = vec![0u32; groups + 1];
    keys.clone().for_each(|k| starts[k + 1] += 1);
    (0..groups).for_each(|k| starts[k + 1] += starts[k]);
    let mut next = starts.clone();
    for (item, k) in keys.enumerate() {
        put(next[k] as usize, item);
        next[k] += 1;
    }
    starts
}

/// What a position may do, from the triangles around it and the clusters that those belong to (design I2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One cluster, closed fan: collapses anywhere inside its cluster.
    Inner,
    /// One cluster, open fan: on an open border of the mesh, collapses along it.
    Open,
    /// Two clusters, closed fan with one run of triangles each: collapses along the border.
    Border,
    /// Corner of three or more clusters, end of a border, or not manifold: never collapses.
    Locked,
}

/// The two clusters of a [`Kind::Border`] position, ascending.
///
/// # Panics
/// When no triangle uses `v`.
pub fn border_pair(v: u32, cluster_of: &[u32], fans: &Fans) -> [u32; 2] {
    let around = || fans.around(v).iter().map(|&t| cluster_of[t as usize]);
    [around().min().expect("a border position has triangles"), around().max().expect("the same")]
}

/// Kind of every position, and how many are not manifold. `cluster_of` gives each triangle's cluster.
pub fn classify(triangles: &[[u32; 3]], cluster_of: &[u32], fans: &Fans, positions: usize) -> (Vec<Kind>, u64) {
    let kinds: Vec<(Kind, bool)> =
        (0..positions as u32).into_par_iter().map(|v| classify_one(v, triangles, cluster_of, fans.around(v))).collect();
    let broken = kinds.par_iter().filter(|k| k.1).count() as u64;
    (kinds.par_iter().map(|k| k.0).collect(), broken)
}

/// Fans up to this size are ordered on the stack.
const SMALL_FAN: usize = 32;

/// The kind of one position and whether its fan is broken (not one disc or half disc).
fn classify_one(v: u32, triangles: &[[u32; 3]], cluster_of: &[u32], fan: &[u32]) -> (Kind, bool) {
    if fan.is_empty() {
        return (Kind::Locked, false);
    }
    let (mut small, mut large) = ([(0, 0, 0); SMALL_FAN], Vec::new());
    let spokes: &mut [(u32, u32, u32)] = if fan.len() <= SMALL_FAN {
        &mut small[..fan.len()]
    } else {
        large.resize(fan.len(), (0, 0, 0));
        &mut large
    };
    for (s, &t) in spokes.iter_mut().zip(fan) {
        let tri = triangles[t as usize];
        let k = tri.iter().position(|&x| x == v).expect("fan triangles use the position");
        *s = (tri[(k + 1) % 3], tri[(k + 2) % 3], cluster_of[t as usize]);
    }
    match order_fan(spokes) {
        None => (Kind::Locked, true),
        Some(closed) => (kind_of_ordered(spokes, closed), false),
    }
}

/// Orders spokes (next, previous, cluster) so that each `previous` is the following `next`; true when the
/// fan closes, `None` when it is not one single fan.
fn order_fan(spokes: &mut [(u32, u32, u32)]) -> Option<bool> {
    let n = spokes.len();
    // Most fans are closed, and it does not matter where those begin.
    let closed = chain(spokes) && spokes[n - 1].1 == spokes[0].0;
    if !closed {
        let mut firsts = (0..n).filter(|&i| !spokes.iter().any(|s| s.1 == spokes[i].0));
        let (Some(first), None) = (firsts.next(), firsts.next()) else { return None };
        spokes.swap(0, first);
        if !chain(spokes) {
            return None;
        }
    }
    let distinct = (0..n).all(|i| (0..i).all(|j| spokes[i].0 != spokes[j].0 && spokes[i].1 != spokes[j].1));
    distinct.then_some(closed)
}

/// Puts behind each spoke, from the first on, one that follows it; false where none does.
fn chain(spokes: &mut [(u32, u32, u32)]) -> bool {
    (1..spokes.len()).all(|i| {
        let found = (i..spokes.len()).find(|&j| spokes[j].0 == spokes[i - 1].1);
        found.is_some_and(|j| {
            spokes.swap(i, j);
            true
        })
    })
}

fn kind_of_ordered(spokes: &[(u32, u32, u32)], closed: bool) -> Kind {
    let n = spokes.len();
    let changes = (0..n).filter(|&i| spokes[i].2 != spokes[(i + 1) % n].2).count();
    match (changes, closed) {
        (0, true) => Kind::Inner,
        (0, false) => Kind::Open,
        (2, true) => Kind::Border,
        _ => Kind::Locked,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Items with keys all over the place, and some groups that stay empty.
    fn scattered(count: u32) -> Vec<[u32; 3]> {
        (0..count).map(|i| [i.wrapping_mul(2_654_435_761) % 997, i % 400, 998]).collect()
    }

    #[test]
    fn groups_hold_their_items_ascending_on_any_number_of_threads() {
        let items = scattered(20_000);
        let mut expected = vec![Vec::new(); 1000];
        for (i, keys) in items.iter().enumerate() {
            keys.iter().for_each(|&k| expected[k as usize].push(i as u32));
        }
        for threads in [1, 2, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (starts, list) = pool.install(|| group(1000, &items));
            let found: Vec<Vec<u32>> = starts.windows(2).map(|w| list[w[0] as usize..w[1] as usize].to_vec()).collect();
            assert_eq!(found, expected, "{threads} threads");
        }
        assert_eq!(group::<3>(0, &[]), (vec![0], vec![]));
        assert_eq!(group::<1>(2, &[]), (vec![0, 0, 0], vec![]));
    }
}
