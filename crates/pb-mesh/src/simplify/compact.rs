//! Collapses handed over, and what is left moved together: later rounds walk over the living alone.

use super::corner_lists::NONE;
use super::patch::Patch;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};

/// What every position collapsed onto and when, filled by all patches at the same time. Both patches of a border write the
/// same.
pub(super) struct Forest {
    parent: Vec<AtomicU32>,
    last_level: Vec<AtomicU8>,
}

impl Forest {
    /// All of so many positions live at `last` still.
    pub fn new(positions: usize, last: u8) -> Self {
        Forest {
            parent: (0..positions as u32).map(AtomicU32::new).collect(),
            last_level: (0..positions).map(|_| AtomicU8::new(last)).collect(),
        }
    }

    /// The position that stands for `v` at `level`, as far as collapses were handed over.
    pub fn ancestor(&self, mut v: u32, level: u8) -> u32 {
        while self.last_level[v as usize].load(Ordering::Relaxed) < level {
            v = self.parent[v as usize].load(Ordering::Relaxed);
        }
        v
    }

    /// Parents and last levels.
    pub fn into_inner(self) -> (Vec<u32>, Vec<u8>) {
        let parent = self.parent.into_iter().map(AtomicU32::into_inner).collect();
        (parent, self.last_level.into_iter().map(AtomicU8::into_inner).collect())
    }
}

impl Patch {
    /// Adds the living positions and triangles, over positions of the mesh.
    pub fn add_surface(&self, positions: &mut Vec<u32>, triangles: &mut Vec<[u32; 3]>) {
        for v in (0..self.living.len() as u32).filter(|&v| self.living[v as usize]) {
            positions.push(self.input.global[v as usize]);
            // Each triangle once: at its lowest corner.
            let own = self.corners.around(v).iter().filter(|c| v < c.a && v < c.b);
            triangles.extend(own.map(|c| [v, c.a, c.b].map(|x| self.input.global[x as usize])));
        }
    }

    /// Writes the collapses since the last time, all of one level, and forgets the dead. Returns the new number of each
    /// vertex, [`NONE`] for the dead; `None` where numbers stay: with textures, whose wedges are numbered by vertex, and
    /// where few died.
    pub fn hand_over(&mut self, forest: &Forest, level: u8) -> Option<Vec<u32>> {
        for [v, parent] in self.graves.drain(..) {
            forest.parent[v as usize].store(parent, Ordering::Relaxed);
            forest.last_level[v as usize].store(level, Ordering::Relaxed);
        }
        let living = self.living.iter().filter(|l| **l).count();
        if self.input.charts.is_some() || living * 8 > self.living.len() * 7 {
            return None;
        }
        self.graves = Vec::new();
        let mut next = 0..;
        let number = |alive: &bool| if *alive { next.next().expect("without end") } else { NONE };
        let numbers: Vec<u32> = self.living.iter().map(number).collect();
        let of = |v: u32| numbers.get(v as usize).copied().unwrap_or(NONE);
        let living = std::mem::replace(&mut self.living, vec![true; living]);
        let input = &mut self.input;
        keep(&mut input.global, &living);
        keep(&mut input.positions, &living);
        keep(&mut input.normals, &living);
        keep(&mut input.kinds, &living);
        keep(&mut self.quadrics, &living);
        keep(&mut self.scales, &living);
        keep(&mut self.witness, &living);
        keep(&mut self.best, &living);
        // A target that is gone stays one: what it cost is where the search for another begins.
        self.best.iter_mut().filter(|b| b.1 != NONE).for_each(|b| b.1 = of(b.1).min(GONE));
        self.marks = vec![0; self.living.len()];
        self.epoch = 0;
        self.corners.keep(&living, of);
        let mut shared = (vec![0], Vec::new());
        for v in (0..living.len()).filter(|&v| living[v]) {
            shared
                .1
                .extend_from_slice(&input.shared[input.shared_start[v] as usize..input.shared_start[v + 1] as usize]);
            shared.0.push(shared.1.len() as u32);
        }
        (input.shared_start, input.shared) = shared;
        for (_, members) in &mut input.components {
            *members = members.iter().map(|&v| of(v)).filter(|&v| v != NONE).collect();
        }
        self.points.iter_mut().for_each(|v| *v = of(*v));
        Some(numbers)
    }
}

/// A target that was forgotten.
const GONE: u32 = NONE - 1;

/// Keeps the living, in a vector of their size.
fn keep<T: Copy>(list: &mut Vec<T>, living: &[bool]) {
    *list = list.iter().zip(living).filter(|(_, alive)| **alive).map(|(x, _)| *x).collect();
}
