//! Residency floors `m_c` (design section 3): data that arrives fades in, data that leaves fades out first.
//!
//! A floor may move freely where no view can tell: below the level that distance alone asks for at every
//! vertex of the cluster, and in clusters that neither are visible nor have a visible neighbour.

use super::super::switch::Switch;
use super::tables::Tables;
use super::walk::{Eyes, Walk};
use crate::plan::{ChunkId, Frame};

/// Speed of a floor where it shows, levels per second: late data takes 0.3 s per level.
const LEVELS_PER_SEC: f32 = 1.0 / 0.3;

pub(super) struct Floors {
    /// `m_c`, levels.
    floors: Vec<f32>,
    /// Per chunk: handed back in `Plan::released`; not used again before it was resident and not retiring.
    given_back: Vec<bool>,
}

impl Floors {
    pub fn new(clusters: usize, levels: u32) -> Floors {
        Floors { floors: vec![(levels - 1) as f32; clusters], given_back: vec![false; clusters * levels as usize] }
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
        let mut stand = true;
        for cluster in 0..t.clusters() as u32 {
            let goal = self.goal(t, cluster, frame);
            let floor = self.floors[cluster as usize].max(goal.resident);
            let next = match floor == goal.floor && !goal.retiring {
                true => floor,
                false => {
                    let free = free_up_to(t, eyes, switch, walk, cluster);
                    let next = moved(floor, goal.floor, free, frame.dt_secs);
                    self.release(t, cluster, next.max(free), frame, released);
                    next
                }
            };
            self.floors[cluster as usize] = next;
            stand &= next == goal.floor;
        }
        stand
    }

    /// Where the floor of a cluster has to go.
    fn goal(&mut self, t: &Tables, cluster: u32, frame: &Frame) -> Goal {
        let coarsest = t.levels - 1;
        let mut goal = Goal { resident: coarsest as f32, floor: coarsest as f32, retiring: false };
        let mut kept = true; // every chunk so far is resident and stays
        let mut usable = true; // every chunk so far is resident and was not given back
        for level in (0..coarsest).rev() {
            let chunk = t.chunk(cluster, level).0 as usize;
            let (resident, retiring) = (frame.resident[chunk], frame.retiring[chunk]);
            self.given_back[chunk] &= resident && retiring;
            usable &= resident && !self.given_back[chunk];
            kept &= usable && !retiring;
            goal.retiring |= resident && retiring && !self.given_back[chunk];
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
        for level in 0..t.levels - 1 {
            let chunk = t.chunk(cluster, level);
            let c = chunk.0 as usize;
            let leaves = frame.resident[c] && frame.retiring[c] && !self.given_back[c];
            if leaves && lod >= (level + 1) as f32 {
                self.given_back[c] = true;
                released.push(chunk);
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

/// The floor may take any value up to this one without a visible change.
fn free_up_to(t: &Tables, eyes: &Eyes, switch: &Switch, walk: &Walk, cluster: u32) -> f32 {
    let visible = |c: &u32| walk.visible[*c as usize];
    if !visible(&cluster) && !t.neighbours(cluster).iter().any(visible) {
        return f32::INFINITY;
    }
    t.lod(switch, cluster, eyes.reach(t, cluster).0)
}

/// One step of a floor towards its goal; only the part above `free` has to be slow.
fn moved(floor: f32, goal: f32, free: f32, dt_secs: f32) -> f32 {
    let step = if dt_secs > 0.0 { LEVELS_PER_SEC * dt_secs } else { 0.0 };
    if goal <= free && floor <= free {
        goal
    } else if goal > floor {
        goal.min(floor.max(free) + step)
    } else {
        let slow = (floor - step).max(goal);
        if slow <= free { goal } else { slow }
    }
}
