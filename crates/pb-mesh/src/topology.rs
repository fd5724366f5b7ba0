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
        let mut starts = vec![0u32; positions + 1];
        for t in triangles {
            for &v in t {
                starts[v as usize + 1] += 1;
            }
        }
        for v in 0..positions {
            starts[v + 1] += starts[v];
        }
        let mut at = starts.clone();
        let mut list = vec![0; triangles.len() * 3];
        for (i, t) in triangles.iter().enumerate() {
            for &v in t {
                list[at[v as usize] as usize] = i as u32;
                at[v as usize] += 1;
            }
        }
        Fans { starts, triangles: list }
    }

    /// Triangles that use position `v`, ascending.
    pub fn around(&self, v: u32) -> &[u32] {
        &self.triangles[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }
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
    (kinds.into_iter().map(|k| k.0).collect(), broken)
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
    let mut first = None;
    for i in 0..n {
        if !spokes.iter().any(|s| s.1 == spokes[i].0) && first.replace(i).is_some() {
            return None;
        }
    }
    spokes.swap(0, first.unwrap_or(0));
    for i in 1..n {
        let wanted = spokes[i - 1].1;
        let found = (i..n).find(|&j| spokes[j].0 == wanted)?;
        spokes.swap(i, found);
    }
    let closed = spokes[n - 1].1 == spokes[0].0;
    let distinct = (0..n).all(|i| (0..i).all(|j| spokes[i].0 != spokes[j].0 && spokes[i].1 != spokes[j].1));
    (distinct && closed == first.is_none()).then_some(closed)
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
