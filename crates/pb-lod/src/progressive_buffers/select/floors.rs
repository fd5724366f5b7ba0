//! Residency floors `m_c` (design section 3): data that arrives fades in, data that leaves fades out first. Geometry
//! and textures have their own.
//!
//! A floor may move freely where no view can tell: below the level that distance alone asks for at every
//! vertex of the cluster, and in clusters that neither are visible nor have a visible neighbour.
//!
//! Floors that stand at their goal are looked at only when the residency of their chunks changes.

use super::super::switch::Switch;
use super::tables::{Ladder, Tables};
use super::walk::{Eyes, Walk};
use crate::plan::{ChunkId, Frame};

/// Speed of a floor where it shows, levels per second: late data takes 0.3 s per level.
const LEVELS_PER_SEC: f32 = 1.0 / 0.3;
/// The same for so many seconds after a cut: the whole picture has just changed, and is wanted sharp soon.
const LEVELS_PER_SEC_AFTER_CUT: f32 = 1.0 / 0.1;
const AFTER_CUT_SECS: f32 = 1.0;

pub(super) struct Floors {
    ladder: Ladder,
    /// `m_c`, levels.
    floors: Vec<f32>,
    /// Per chunk of the ladder, `cluster * levels + level`: handed back in `Plan::released`; not used again before it was resident and not retiring.
    given_back: Vec<bool>,
    /// Clusters that may have to move: not at their goal, or with chunks to hand back.
    moving: Vec<u32>,
    /// Per cluster: is it in `moving`?
    moves: Vec<bool>,
    /// What is left of [`AFTER_CUT_SECS`].
    after_cut_secs: f32,
}

impl Floors {
    /// All on their coarsest level.
    pub fn new(t: &Tables, ladder: Ladder) -> Floors {
        let clusters = 0..t.clusters() as u32;
        let floors = clusters.clone().map(|c| t.coarsest(ladder, c) as f32).collect();
        let (given_back, moves) = (vec![false; t.clusters() * t.levels as usize], vec![true; t.clusters()]);
        Floors { ladder, floors, given_back, moving: clusters.collect(), moves, after_cut_secs: 0.0 }
    }

    pub fn floor(&self, cluster: u32) -> f32 {
        self.floors[cluster as usize]
    }

    pub fn all(&self) -> &[f32] {
        &self.floors
    }

    /// Moves all floors by one frame and collects the chunks that may be freed. True when every floor stands
    /// at its goal.
    pub fn step(
        &mut self,
        t: &Tables,
        eyes: &Eyes,
        switch: &Switch,
        walk: &Walk,
        frame: &Frame,
        released: &mut Vec<ChunkId>,
    ) -> bool {
        self.wake(t, frame.changed);
        self.after_cut_secs = if frame.cut { AFTER_CUT_SECS } else { self.after_cut_secs - frame.dt_secs.max(0.0) };
        let levels_per_sec = if self.after_cut_secs > 0.0 { LEVELS_PER_SEC_AFTER_CUT } else { LEVELS_PER_SEC };
        let most_levels = levels_per_sec * frame.dt_secs.max(0.0);
        let mut stand = true;
        let mut moving = std::mem::take(&mut self.moving);
        moving.retain(|&cluster| {
            let goal = self.goal(t, cluster, frame);
            let floor = self.floors[cluster as usize].max(goal.resident);
            let next = match floor == goal.floor && !goal.retiring {
                true => floor,
                false => {
                    let free = self.free_up_to(t, eyes, switch, walk, cluster);
                    let next = moved(floor, goal.floor, free, most_levels);
                    self.release(t, cluster, next.max(free), frame, released);
                    next
                }
            };
            self.floors[cluster as usize] = next;
            stand &= next == goal.floor;
            let moves = next != goal.floor || goal.retiring;
            self.moves[cluster as usize] = moves;
            moves
        });
        self.moving = moving;
        stand
    }

    /// Clusters with these chunks may move, or all where nobody knows; in order of their number.
    fn wake(&mut self, t: &Tables, changed: Option<&[ChunkId]>) {
        let Some(changed) = changed else {
            self.moving = (0..t.clusters() as u32).collect();
            self.moves.fill(true);
            return;
        };
        let here = changed.iter().map(|&chunk| t.place(chunk)).filter(|(ladder, _)| *ladder == self.ladder);
        for (_, cluster) in here {
            if !std::mem::replace(&mut self.moves[cluster as usize], true) {
                self.moving.push(cluster);
            }
        }
        self.moving.sort_unstable();
    }

    /// Where the floor of a cluster has to go.
    fn goal(&mut self, t: &Tables, cluster: u32, frame: &Frame) -> Goal {
        let coarsest = t.coarsest(self.ladder, cluster);
        let mut goal = Goal { resident: coarsest as f32, floor: coarsest as f32, retiring: false };
        let mut kept = true; // every chunk so far is resident and stays
        let mut usable = true; // every chunk so far is resident and was not given back
        for level in (0..coarsest).rev() {
            let chunk = t.chunk(self.ladder, cluster, level).0 as usize;
            let (resident, retiring) = (frame.resident[chunk], frame.retiring[chunk]);
            let given_back = &mut self.given_back[(cluster * t.levels + level) as usize];
            *given_back &= resident && retiring;
            usable &= resident && !*given_back;
            kept &= usable && !retiring;
            goal.retiring |= resident && retiring && !*given_back;
            if usable {
                goal.resident = level as f32;
            }
            if kept {
                goal.floor = level as f32;
            }
        }
        goal
    }

    /// Hands back the retiring chunks of a cluster that nothing below level of detail `lod` needs.
    fn release(&mut self, t: &Tables, cluster: u32, lod: f32, frame: &Frame, released: &mut Vec<ChunkId>) {
        for level in 0..t.coarsest(self.ladder, cluster) {
            let chunk = t.chunk(self.ladder, cluster, level);
            let c = chunk.0 as usize;
            let given_back = &mut self.given_back[(cluster * t.levels + level) as usize];
            let leaves = frame.resident[c] && frame.retiring[c] && !*given_back;
            if leaves && lod >= (level + 1) as f32 {
                *given_back = true;
                released.push(chunk);
            }
        }
    }

    /// The floor may take any value up to this one without a visible change.
    fn free_up_to(&self, t: &Tables, eyes: &Eyes, switch: &Switch, walk: &Walk, cluster: u32) -> f32 {
        let visible = |c: &u32| walk.is_visible(*c);
        match self.ladder {
            _ if !visible(&cluster) && !t.neighbours(cluster).iter().any(visible) => f32::INFINITY,
            Ladder::Geometry => t.lod(switch, cluster, walk.reach(t, eyes, cluster)),
            // A coarser detail than asked for shows in textures only by their floors.
            Ladder::Texture => {
                let sharp = Switch { scale: switch.scale.max(1.0), ..*switch };
                t.texture_lod(&sharp, cluster, walk.reach(t, eyes, cluster))
            }
        }
    }
}

struct Goal {
    /// Finest level that may be drawn: the floor is never below it.
    resident: f32,
    /// Where the floor goes: the finest level that is resident and stays.
    floor: f32,
    /// Some chunk waits to be handed back.
    retiring: bool,
}

/// One step of a floor towards its goal; only the part above `free` has to be slow, at most `step` levels.
fn moved(floor: f32, goal: f32, free: f32, step: f32) -> f32 {
    if goal <= free && floor <= free {
        goal
    } else if goal > floor {
        goal.min(floor.max(free) + step)
    } else {
        let slow = (floor - step).max(goal);
        if slow <= free { goal } else { slow }
    }
}
