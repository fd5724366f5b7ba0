//! Cameras to come, which are not looked at in every frame: what they see and want is remembered for some hundredths of a
//! second, in which they move little.
//!
//! Must never: be remembered beyond a cut, or in a frame that settles at once; depend on how deep earlier walks went.

use glam::{DVec3, Vec4, Vec4Swizzles};

use super::super::switch::Switch;
use super::tables::Tables;
use super::walk::{Eyes, Scope, Walk};
use crate::plan::{Detail, Frame, View, Want};

/// What cameras see that come soon is this old at most, but frames may be slower; seconds: looked at in every third frame of
/// a 60th of a second.
const SOON_SECS: f32 = 0.051;
/// The same for those that come later: they move as little while they are far ahead.
const LATER_SECS: f32 = 0.15;
/// Walks go so many rungs deeper than asked for, so that they need not be done again when the search goes there.
const SPARE_RUNGS: i32 = 4;
/// A frame counts as this long at least: clocks may stand still while cameras move.
const LEAST_SECS: f32 = 1.0 / 240.0;
/// A step so many times the one before is a cut.
const JUMP: f64 = 4.0;
/// Frusta that turn less than this, radians, make no cut.
const LEAST_TURN: f64 = 0.02;

/// Says when to look at cameras to come again.
#[derive(Default)]
pub(super) struct Turns {
    /// Since what comes soon, and what comes later, was looked at.
    ages_secs: [f32; 2],
    last: Option<Stand>,
}

/// What a frame must have in common with the last one.
#[derive(PartialEq)]
struct Circumstances {
    detail: Detail,
    around: bool,
    /// Whether any cameras come soon, and later.
    ahead: [bool; 2],
    views: usize,
    planes: usize,
}

/// Where the views of a frame stood, and by how much they had moved and turned.
struct Stand {
    circumstances: Circumstances,
    eyes: Vec<DVec3>,
    planes: Vec<Vec4>,
    step: [f64; 2],
}

impl Turns {
    /// Whether this frame looks anew at what comes soon, and at what comes later.
    pub fn next(&mut self, frame: &Frame) -> [bool; 2] {
        let (stand, continues) = Stand::new(frame, self.last.as_ref());
        self.last = Some(stand);
        let dt_secs = frame.dt_secs.max(LEAST_SECS);
        self.ages_secs = self.ages_secs.map(|age| age + dt_secs);
        let [soon_age, later_age] = self.ages_secs;
        let all = frame.cut || !continues || dt_secs > LATER_SECS;
        let soon = all || soon_age + dt_secs > SOON_SECS;
        // In one frame with the others only where there is no frame between.
        let alone = !soon || 2.0 * dt_secs > SOON_SECS;
        let anew = [soon, all || alone && later_age + dt_secs > LATER_SECS];
        self.ages_secs = [0, 1].map(|k| if anew[k] { 0.0 } else { self.ages_secs[k] });
        anew
    }
}

impl Stand {
    /// That of a frame; and whether it continues the last one.
    fn new(frame: &Frame, last: Option<&Stand>) -> (Stand, bool) {
        let planes: Vec<Vec4> = frame.views.iter().flat_map(|view| &view.planes).copied().collect();
        let circumstances = Circumstances {
            detail: frame.detail,
            around: frame.prefetch.around,
            ahead: [!frame.prefetch.soon.is_empty(), !frame.prefetch.later.is_empty()],
            views: frame.views.len(),
            planes: planes.len(),
        };
        let mut stand =
            Stand { circumstances, eyes: frame.views.iter().map(|view| view.eye).collect(), planes, step: [0.0; 2] };
        let Some(last) = last.filter(|last| last.circumstances == stand.circumstances) else { return (stand, false) };
        let moved = stand.eyes.iter().zip(&last.eyes).map(|(a, b)| a.distance(*b));
        let turned = stand.planes.iter().zip(&last.planes).map(|(a, b)| a.xyz().distance(b.xyz()).into());
        stand.step = [moved.fold(0.0, f64::max), turned.fold(0.0, f64::max)];
        let [moved, turned] = [0, 1].map(|k| stand.step[k] <= JUMP * last.step[k]);
        let continues = moved && (turned || stand.step[1] <= LEAST_TURN);
        (stand, continues)
    }
}

/// What cameras to come see and want, as of when they were looked at last.
#[derive(Default)]
pub(super) struct Ahead {
    pub walk: Walk,
    /// Most urgent first.
    pub wants: Vec<Want>,
    eyes: Option<Eyes>,
    /// How deep the walk went: rungs of the details of geometry and textures.
    rungs: [i32; 2],
}

impl Ahead {
    /// Forgets all, where no cameras come; looks at them where that is due.
    pub fn look(&mut self, t: &Tables, cameras: &[View], detail: Detail, anew: bool) {
        match cameras.is_empty() {
            true => *self = Ahead { walk: std::mem::take(&mut self.walk), ..Ahead::default() },
            false if anew => self.eyes = Some(Eyes::new(cameras, detail, t)),
            false => return,
        }
        self.walk.seen.clear();
        self.rungs = [i32::MAX; 2];
    }

    /// Walks the tree for rungs and coarser ones, where it was not walked so deep.
    pub fn go(&mut self, t: &Tables, rungs: [i32; 2], switches: impl Fn([i32; 2]) -> [Switch; 2]) {
        if let Some(eyes) = self.eyes.as_ref().filter(|_| (0..2).any(|k| rungs[k] < self.rungs[k])) {
            self.rungs = [0, 1].map(|k| (rungs[k] - SPARE_RUNGS).max(0).min(self.rungs[k]));
            self.walk.go(t, eyes, &switches(self.rungs), Scope::Drawn);
        }
    }
}

/// Clusters that show in any of some walks, each once: from nearest by.
#[derive(Default)]
pub(super) struct Shown {
    list: Vec<Near>,
    /// Per cluster: its place in the list, if what stands there is that cluster's.
    place: Vec<u32>,
}

/// A cluster; see [`super::walk::Seen`].
#[derive(Clone, Copy)]
pub(super) struct Near {
    pub cluster: u32,
    pub reach: f32,
    pub girth: f32,
}

impl Shown {
    pub fn clear(&mut self) {
        self.list.clear();
    }

    pub fn add(&mut self, t: &Tables, walk: &Walk) {
        self.place.resize(t.clusters(), 0);
        for seen in walk.seen.iter().filter(|s| s.shows) {
            let place = &mut self.place[seen.cluster as usize];
            match self.list.get_mut(*place as usize) {
                Some(other) if other.cluster == seen.cluster => {
                    (other.reach, other.girth) = (other.reach.min(seen.reach), other.girth.min(seen.girth));
                }
                _ => {
                    *place = self.list.len() as u32;
                    self.list.push(Near { cluster: seen.cluster, reach: seen.reach, girth: seen.girth });
                }
            }
        }
    }

    pub fn all(&self) -> &[Near] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Prefetch;

    fn view(x: f64, turn: f32) -> View {
        View { eye: DVec3::X * x, planes: vec![Vec4::new(turn.cos(), turn.sin(), 0.0, 0.0)], pixel_angle: 1e-3 }
    }

    fn next(turns: &mut Turns, views: &[View], prefetch: Prefetch, dt_secs: f32) -> [bool; 2] {
        turns.next(&Frame { views, prefetch, dt_secs, ..Frame::EMPTY })
    }

    #[test]
    fn what_comes_is_looked_at_in_turn_and_never_all_of_it_in_one_frame_of_many() {
        let ahead = [view(1.0, 0.0)];
        let prefetch = Prefetch { around: false, soon: &ahead, later: &ahead };
        for fps in [24.0f32, 30.0, 60.0, 144.0, 1000.0] {
            let mut turns = Turns::default();
            let mut at = |i: u32| next(&mut turns, &[view(f64::from(i) * 0.01, i as f32 * 0.001)], prefetch, 1.0 / fps);
            (0..2).for_each(|i| assert_eq!(at(i), [true; 2], "the first two frames have no step to compare with"));
            let (mut age, mut looked) = ([0.0f32; 2], 0);
            for i in 2..600 {
                let anew = at(i);
                assert!(anew != [true; 2] || fps < 40.0, "frame {i} at {fps}");
                age = [0, 1].map(|k| if anew[k] { 0.0 } else { age[k] + 1.0 / fps });
                assert!(age[0] <= SOON_SECS && age[1] <= LATER_SECS + 1.0 / fps, "frame {i} at {fps}: {age:?}");
                looked += anew.iter().filter(|anew| **anew).count();
            }
            assert!(fps < 50.0 || looked < 600 / 2, "{looked} at {fps}");
        }
        let mut turns = Turns::default();
        assert!((0..20).all(|_| next(&mut turns, &[view(0.0, 0.0)], prefetch, 0.2) == [true; 2]), "slow frames");
    }

    #[test]
    fn cuts_and_other_circumstances_are_seen_at_once() {
        let ahead = [view(1.0, 0.0)];
        let both = Prefetch { around: false, soon: &ahead, later: &ahead };
        let soon = Prefetch { later: &[], ..both };
        let flown = |x: f64, turn: f32, prefetch: Prefetch, dt_secs: f32| {
            let mut turns = Turns::default();
            for i in 0..4 {
                next(&mut turns, &[view(f64::from(i), i as f32 * 0.01)], both, 1e-3);
            }
            next(&mut turns, &[view(x, turn)], prefetch, dt_secs)
        };
        assert_eq!(flown(4.0, 0.04, both, 1e-3), [false; 2], "as before");
        assert_eq!(flown(6.0, 0.05, both, 1e-3), [false; 2], "faster");
        assert_eq!(flown(-9.0, 0.04, both, 1e-3), [true; 2], "elsewhere");
        assert_eq!(flown(4.0, 0.9, both, 1e-3), [true; 2], "turned");
        assert_eq!(flown(4.0, 0.04, soon, 1e-3), [true; 2], "nothing comes later");
        assert_eq!(flown(4.0, 0.04, both, f32::INFINITY), [true; 2], "settles");
    }
}
