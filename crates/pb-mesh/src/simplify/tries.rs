//! The coarse levels of small models are made several times, with other weights each, and the best one counts.
//!
//! Which of many collapses of like cost comes first is chance, and at a level of a hundred vertices a single one moves the largest
//! distance by a third. Such levels have few collapses, so that tries cost little.

use super::compact::Forest;
use super::weights::Weights;
use super::{State, Steps, UnisonInput, WATCHED_COUNT, lock};
use crate::deviation::{LevelPair, estimate};
use crate::topology::{Fans, Kind};
use rayon::prelude::*;
use std::sync::Mutex;

/// Vertices that all tries of a level start with together: time.
const BUDGET: usize = 1 << 17;
/// Tries of a level: fewer are not worth their judge, more hardly find better ones.
const MIN_TRIES: usize = 8;
const MAX_TRIES: usize = 32;
/// The best tries are judged by what they lead to, each by so many tries of the next level.
const FINALISTS: usize = 3;
const OUTLOOK_TRIES: usize = 8;
/// Levels are judged against the finest one that has at most so many positions.
const MAX_JUDGED: usize = 1 << 15;
/// How much more the mean distance counts than the largest one.
const MEAN_WEIGHT: f64 = 1.2;

/// Weights of the tries in turn: of witnesses, and the exponent of the number of triangles.
#[rustfmt::skip]
const GRID: [(f32, u8); MAX_TRIES] = [
    (9.0, 4), (6.0, 7), (6.0, 4), (12.0, 7), (8.0, 3), (3.0, 7), (12.0, 4), (6.0, 10),
    (12.0, 5), (9.0, 7), (6.0, 5), (9.0, 5), (12.0, 10), (4.5, 4), (3.0, 4), (4.5, 7),
    (9.0, 9), (15.0, 7), (20.0, 4), (6.0, 9), (12.0, 9), (7.5, 6), (3.0, 10), (20.0, 12),
    (9.0, 3), (12.0, 3), (15.0, 5), (7.5, 5), (10.0, 6), (2.0, 4), (4.5, 9), (6.0, 12),
];
/// What the squared size of vanishing components counts in every other try.
const RELUCTANT: f32 = 4.0;

impl Weights {
    fn of_try(i: usize) -> Self {
        let (witness, sixteenths) = GRID[i];
        Weights { witness, sixteenths, vanish: if i.is_multiple_of(2) { 1.0 } else { RELUCTANT * witness } }
    }
}

impl Try {
    /// The better one first; the same on any number of threads.
    fn order(&self, other: &Try) -> std::cmp::Ordering {
        self.score.total_cmp(&other.score).then(self.number.cmp(&other.number))
    }
}

/// Makes levels several times where that is worth it.
pub(super) struct Tries<'a> {
    input: &'a UnisonInput<'a>,
    steps: Steps,
    judge: Option<Judge>,
}

/// A level that was made.
struct Try {
    /// Lower is better.
    score: f64,
    number: usize,
    state: State,
}

impl<'a> Tries<'a> {
    /// Before the first collapse.
    pub fn new(input: &'a UnisonInput, steps: Steps) -> Self {
        let mut tries = Tries { input, steps, judge: None };
        if input.positions.len() <= MAX_JUDGED {
            tries.judge = Some(Judge::new(input, (0..input.positions.len() as u32).collect(), input.triangles));
        }
        tries
    }

    /// Takes a mesh through a step in several ways, and keeps the one that leads to the best levels, this one and the next; `false` when
    /// that is not worth it, and nothing was done.
    pub fn run_level(&self, state: &mut State, step: usize) -> bool {
        let tries = BUDGET / state.patches.iter().map(|p| lock(p).size()).sum::<usize>().max(1);
        let Some(judge) = self.judge.as_ref().filter(|_| tries >= MIN_TRIES) else { return false };
        let is_last = step + 1 == self.steps.count;
        let mut best = self.best(judge, state, step, tries.min(MAX_TRIES), if is_last { 1 } else { FINALISTS });
        if !is_last {
            best.par_iter_mut().for_each(|t| t.score += self.outlook(judge, &t.state, step + 1));
        }
        *state = best.into_iter().min_by(Try::order).expect("several were made").state;
        true
    }

    /// The best ones among the first tries of a step, in their order; no more of them are held.
    fn best(&self, judge: &Judge, state: &State, step: usize, count: usize, wanted: usize) -> Vec<Try> {
        let target = self.steps.target(step);
        let best = Mutex::new(Vec::new());
        (0..count).into_par_iter().for_each(|number| {
            let mut own = state.clone();
            own.reweigh(Weights::of_try(number), target);
            own.run_level(target, true, &|_| ());
            let made = Try { score: judge.score(&own), number, state: own };
            let mut best = best.lock().expect("no thread panics while it holds the list");
            best.push(made);
            best.sort_by(Try::order);
            best.truncate(wanted);
        });
        best.into_inner().expect("the same")
    }

    /// The best score among a few tries of the next step.
    fn outlook(&self, judge: &Judge, state: &State, step: usize) -> f64 {
        let mut state = state.clone();
        state.start_level(step, self.steps.ratio);
        self.best(judge, &state, step, OUTLOOK_TRIES, 1)[0].score
    }

    /// The collapses up to level `level` were handed over.
    pub fn end_level(&mut self, state: &State, forest: &Forest, level: u8) {
        if let Some(judge) = &mut self.judge {
            judge.ancestors.iter_mut().zip(&judge.global).for_each(|(a, &v)| {
                *a = judge.global.binary_search(&forest.ancestor(v, level)).expect("it lived before") as u32;
            });
        } else if self.input.positions.len() <= WATCHED_COUNT && state.alive <= MAX_JUDGED {
            let (positions, triangles) = state.surface();
            self.judge = Some(Judge::new(self.input, positions, &triangles));
        }
    }
}

impl State {
    /// The living positions, ascending, and the living triangles over positions.
    fn surface(&self) -> (Vec<u32>, Vec<[u32; 3]>) {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for p in &self.patches {
            lock(p).add_surface(&mut positions, &mut triangles);
        }
        positions.sort_unstable();
        positions.dedup();
        (positions, triangles)
    }
}

/// What levels are judged by: a finer one, the same for all of them. Its positions are numbered anew.
struct Judge {
    /// The number of each in the input, ascending.
    global: Vec<u32>,
    positions: Vec<[i32; 3]>,
    triangles: Vec<[u32; 3]>,
    fans: Fans,
    open: Vec<bool>,
    /// What each has become at the latest level.
    ancestors: Vec<u32>,
}

impl Judge {
    fn new(input: &UnisonInput, global: Vec<u32>, triangles: &[[u32; 3]]) -> Self {
        let number = |v: u32| global.binary_search(&v).expect("triangles are over its positions") as u32;
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(number)).collect();
        Judge {
            positions: global.iter().map(|&v| input.positions[v as usize]).collect(),
            fans: Fans::new(global.len(), &triangles),
            open: global.iter().map(|&v| input.kinds[v as usize] == Kind::Open).collect(),
            ancestors: (0..global.len() as u32).collect(),
            triangles,
            global,
        }
    }

    /// What each position has become, with the collapses that were not handed over yet.
    fn ancestors_in(&self, state: &State) -> Vec<u32> {
        let mut parent: Vec<u32> = (0..self.global.len() as u32).collect();
        let number = |v: u32| self.global.binary_search(&v).expect("what dies now lived before");
        for p in &state.patches {
            lock(p).graves.iter().for_each(|&[v, to]| parent[number(v)] = number(to) as u32);
        }
        let last = |&v: &u32| {
            let mut v = v;
            while parent[v as usize] != v {
                v = parent[v as usize];
            }
            v
        };
        self.ancestors.iter().map(last).collect()
    }

    /// The logarithm of the mean and the largest distance, weighed, as if errors fell with the number of vertices; lower is better.
    fn score(&self, state: &State) -> f64 {
        let ancestors = self.ancestors_in(state);
        let shrunk = self.triangles.iter().map(|t| t.map(|v| ancestors[v as usize]));
        let coarse: Vec<[u32; 3]> = shrunk.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).collect();
        let found = estimate(&LevelPair {
            positions: &self.positions,
            triangles: &self.triangles,
            fine: &self.fans,
            cluster_of: &[],
            coarse: &coarse,
            fans: &Fans::new(self.positions.len(), &coarse),
            coarse_cluster_of: &[],
            ancestors: &ancestors,
            open: &self.open,
        });
        let mean = found.mean_square.max(f64::MIN_POSITIVE).ln() / 2.0;
        let most = f64::from(found.max.max(f32::MIN_POSITIVE)).ln();
        MEAN_WEIGHT * mean + most + (MEAN_WEIGHT + 1.0) * (state.alive.max(1) as f64).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::segment;
    use crate::simplify::{Search, build_seams, group_seams, hand_over, head_start};
    use crate::topology::classify;
    use glam::Vec3;

    #[test]
    fn several_tries_are_better_than_the_usual_weights_and_the_next_level_counts_too() {
        let gains: Vec<f64> = [0.0, 1.0, 2.0, 3.0].map(gain_of_outlook).to_vec();
        assert!(gains.iter().all(|&g| g >= 0.0) && gains.iter().any(|&g| g > 0.01), "{gains:?}");
    }

    /// Makes level 2 of a bumpy sheet in the usual way, in several ways, and in several ways with a look at level 3; how much better
    /// both levels are for the look.
    fn gain_of_outlook(phase: f64) -> f64 {
        const SIDE: u32 = 60;
        let at = |x: u32, y: u32| y * (SIDE + 1) + x;
        let height = |x: f64, y: f64| 3.0 * (x * 0.4 + phase).sin() * (y * 0.3).cos() + (x * 1.3 + y * 0.7).sin();
        let all = || (0..=SIDE).flat_map(move |y| (0..=SIDE).map(move |x| (x, y)));
        let real =
            |(x, y): (u32, u32)| [f64::from(x), f64::from(y), height(x.into(), y.into())].map(|c: f64| c * 1000.0);
        let real: Vec<[f64; 3]> = all().map(real).collect();
        let positions: Vec<[i32; 3]> = real.iter().map(|p| p.map(|c| c as i32)).collect();
        let halves = |(x, y)| [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]];
        let triangles: Vec<[u32; 3]> = all().filter(|&(x, y)| x < SIDE && y < SIDE).flat_map(halves).collect();
        let segmentation = segment(&real, &triangles, &triangles, 4000);
        let mut cluster_of = vec![0; triangles.len()];
        (0..segmentation.len())
            .for_each(|c| segmentation.cluster(c).iter().for_each(|&t| cluster_of[t as usize] = c as u32));
        let fans = Fans::new(positions.len(), &triangles);
        let (kinds, _) = classify(&triangles, &cluster_of, &fans, positions.len());
        let input = UnisonInput {
            positions: &positions,
            normals: &vec![Vec3::ZERO; positions.len()],
            triangles: &triangles,
            segmentation: &segmentation,
            cluster_of: &cluster_of,
            fans: &fans,
            kinds: &kinds,
            texture: None,
        };
        let forest = Forest::new(positions.len(), 4);
        let steps = Steps { positions: positions.len(), ratio: 4.0, count: 3 };
        let (mut search, mut tries) = (Search::new(&positions), Tries::new(&input, steps));
        let (patches, died) = head_start::patches(&input, &mut search, &forest, 4.0, &|_| ());
        let seams = group_seams(build_seams(&input, &patches));
        let mut state = State { patches, seams, search, alive: positions.len() - died };
        state.start_level(0, 4.0);
        state.run_level(steps.target(0), false, &|_| ());
        hand_over(&state.patches, &mut state.seams, &forest, 0);
        tries.end_level(&state, &forest, 1);

        state.start_level(1, 4.0);
        let mut usual = state.clone();
        usual.reweigh(Weights::of_try(0), steps.target(1));
        usual.run_level(steps.target(1), true, &|_| ());
        let mut short_sighted = state.clone();
        assert!(tries.run_level(&mut state, 1));
        tries.steps.count = 2;
        assert!(tries.run_level(&mut short_sighted, 1));
        let judge = tries.judge.as_ref().expect("a small model has one");
        assert!(judge.score(&short_sighted) < judge.score(&usual), "no try was better");
        assert!((state.alive as f64 / steps.target(1) - 1.0).abs() < 0.02, "{} left", state.alive);
        let both = |s: &State| judge.score(s) + tries.outlook(judge, s, 2);
        both(&short_sighted) - both(&state)
    }
}
