//! Positions that several vertex records use: borders, corners, and creases inside one cluster (I1, I2).

use super::{Breach, Promise, cluster::Decoded, position};
use crate::progressive_buffers::model::Model;

/// One vertex of one cluster. Ordered by position, then cluster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Record {
    pub grid: [i32; 3],
    pub cluster: u32,
    pub vertex: u16,
    /// The coarsest level at which the vertex lives.
    pub death: u8,
    /// Its border slot.
    pub slot: u8,
    /// Position that it collapses to; its own at the coarsest level.
    pub parent: [i32; 3],
}

/// The records of one cluster.
pub(super) fn records(model: &Model, cluster: u32, decoded: &Decoded) -> Vec<Record> {
    let record = |(vertex, v): (usize, &crate::progressive_buffers::layout::Vertex)| Record {
        grid: decoded.grid[vertex],
        cluster,
        vertex: vertex as u16,
        death: (0..model.levels()).rev().find(|&l| (vertex as u32) < model.level(cluster, l).vertices).unwrap_or(0)
            as u8,
        slot: v.slot(),
        parent: decoded.grid[v.parent as usize],
    };
    decoded.vertices.iter().enumerate().map(record).collect()
}

/// Which round looks at a position.
pub(super) fn round_of(record: &Record, rounds: u32) -> u32 {
    let mix = |h: u32, x: i32| (h ^ x as u32).wrapping_mul(0x9e37_79b1).rotate_left(15);
    record.grid.iter().fold(0, |h, &x| mix(h, x)) % rounds
}

/// Groups of at least two records with one position.
#[derive(Default)]
pub(super) struct Shared {
    /// By position.
    records: Vec<Record>,
    /// First record of each group.
    starts: Vec<u32>,
    /// `(cluster, vertex, group)`, sorted: the way back from a vertex.
    places: Vec<(u32, u16, u32)>,
}

impl Shared {
    /// Keeps the groups out of sorted records.
    pub fn add(&mut self, sorted: &[Record]) {
        let groups = sorted.chunk_by(|a, b| a.grid == b.grid).filter(|g| g.len() > 1);
        groups.for_each(|g| self.records.extend(g));
    }

    /// Sorts the groups of all rounds and numbers them.
    pub fn finish(&mut self) {
        self.records.sort_unstable();
        let mut start = 0;
        for (number, group) in self.records.chunk_by(|a, b| a.grid == b.grid).enumerate() {
            self.starts.push(start);
            start += group.len() as u32;
            self.places.extend(group.iter().map(|r| (r.cluster, r.vertex, number as u32)));
        }
        self.places.sort_unstable();
    }

    /// The records of group `number`.
    pub fn group(&self, number: u32) -> &[Record] {
        let start = self.starts[number as usize] as usize;
        let end = self.starts.get(number as usize + 1).map_or(self.records.len(), |&e| e as usize);
        &self.records[start..end]
    }

    /// `(vertex, group)` of the vertices of a cluster that are in groups, by vertex.
    pub fn of_cluster(&self, cluster: u32) -> impl Iterator<Item = (u16, u32)> + '_ {
        let from = self.places.partition_point(|p| p.0 < cluster);
        self.places[from..].iter().take_while(move |p| p.0 == cluster).map(|p| (p.1, p.2))
    }

    /// Number of positions of exactly two clusters, and of more.
    pub fn counts(&self) -> (u64, u64) {
        let users = (0..self.starts.len() as u32).map(|g| clusters(self.group(g)).count());
        users.fold((0, 0), |(borders, corners), n| (borders + (n == 2) as u64, corners + (n > 2) as u64))
    }

    fn at(&self, grid: [i32; 3]) -> &[Record] {
        let found = self.starts.binary_search_by_key(&grid, |&s| self.records[s as usize].grid);
        found.map_or(&[], |number| self.group(number as u32))
    }

    /// I1 and I2 of all groups.
    pub fn check(&self, model: &Model, breaches: &mut Vec<Breach>) {
        for number in 0..self.starts.len() as u32 {
            self.check_group(model, self.group(number), breaches);
        }
    }

    fn check_group(&self, model: &Model, group: &[Record], breaches: &mut Vec<Breach>) {
        let users: Vec<u32> = clusters(group).collect();
        let place = |r: &Record| format!("cluster {} vertex {} at {}", r.cluster, r.vertex, position(model, r.grid));
        let mut breach = |promise, r: &Record, what: String| breaches.push(Breach { promise, place: place(r), what });
        let coarsest = model.levels() as u8 - 1;
        for r in group {
            let dies = r.death < coarsest;
            if dies && users.len() > 2 {
                breach(Promise::I2, r, format!("a corner of clusters {users:?} collapses at level {}", r.death));
            }
            if dies && users.len() == 2 && !users.iter().all(|&u| self.at(r.parent).iter().any(|p| p.cluster == u)) {
                let target = position(model, r.parent);
                breach(Promise::I2, r, format!("a border vertex of clusters {users:?} leaves its border for {target}"));
            }
            let named = r.slot.checked_sub(1).map(|s| model.neighbours(r.cluster)[s as usize]);
            match named {
                None if dies && users.len() == 2 => {
                    breach(Promise::I1, r, format!("on the border of clusters {users:?}, but its border slot is 0"));
                }
                Some(n) if !users.contains(&n) => {
                    breach(Promise::I1, r, format!("its border slot names cluster {n}, which does not use it"));
                }
                _ => {}
            }
        }
        let first = &group[0];
        for r in group {
            if r.death != first.death {
                let text =
                    format!("lives up to level {}, but in {} up to level {}", r.death, place(first), first.death);
                breach(Promise::I1, r, text);
            } else if r.parent != first.parent {
                let (a, b) = (r.parent, first.parent);
                breach(Promise::I1, r, format!("collapses to grid {a:?}, but in {} to grid {b:?}", place(first)));
            }
        }
    }
}

/// Distinct clusters of a group, rising.
pub(super) fn clusters(group: &[Record]) -> impl Iterator<Item = u32> + '_ {
    group.chunk_by(|a, b| a.cluster == b.cluster).map(|g| g[0].cluster)
}
