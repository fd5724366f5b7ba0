//! Selection: the resident chunks and the views go in, the draws and the wanted chunks come out
//! (design sections 3, 4, 6, 7; paper sections 3.2 and 4).
//!
//! Deterministic: no GPU, clock or thread. The only state is what must be continuous from frame to frame: the residency
//! floors `m_c` and the detail that the byte budget allows; and what cameras to come want, for some hundredths of a second.
//! A plan never draws a level whose chunks are not resident (I5), and never gives back a chunk that a view still shows.

mod ahead;
#[cfg(test)]
mod ahead_tests;
mod budget;
mod crowd;
mod floors;
mod tables;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod texture_tests;
mod walk;
mod wants;

pub use tables::SelectTables;

use self::ahead::{Ahead, Near, Shown, Turns};
use self::budget::{Conditions, DetailControl, Target, on_rung};
use self::floors::Floors;
use self::tables::{Ladder, Tables};
use self::walk::{Eyes, Place, Scope, Seen, Walk};
use self::wants::Wants;
use super::display::LodTable;
use super::instances::Placement;
use super::model::Model;
use super::switch::Switch;
use crate::plan::{ChunkId, Class, CoarseDraw, Detail, Draw, Frame, Plan, View, Want};

/// A cluster this much nearer (distance ratio) would need its next level: load that about now.
const SOON_MARGIN: f32 = 0.8;
/// The same for data that only has to be in RAM. The walk looks no further than this.
const MAYBE_MARGIN: f32 = 0.5;

/// Part of a byte budget that is kept free for what is not drawn yet, 1 of so many, where not all fits anyway.
const PREFETCH_SHARE: u64 = 16;

/// Chooses levels, residency floors and wants; one per open archive.
pub struct Selector {
    tables: Tables,
    floors: Floors,
    /// Where there are textures.
    texture_floors: Option<Floors>,
    /// Of geometry and of textures.
    controls: [DetailControl; 2],
    /// When to look at cameras to come.
    turns: Turns,
    work: Work,
}

/// What selection works with.
#[derive(Default)]
struct Work {
    /// What the views of this frame see; what shows in them or soon; and what all want.
    walk: Walk,
    shown: Shown,
    wants: Wants,
    /// Cameras that come soon, and later.
    soon: Ahead,
    later: Ahead,
}

impl Selector {
    /// A selector for one archive. At first every cluster stands on its coarsest level.
    pub fn new(tables: &SelectTables) -> Selector {
        let tables = Tables::new(tables);
        let floors = Floors::new(&tables, Ladder::Geometry);
        let texture_floors = tables.has_textures().then(|| Floors::new(&tables, Ladder::Texture));
        let work = Work { wants: Wants::new(tables.chunks()), ..Work::default() };
        Selector { tables, floors, texture_floors, controls: Default::default(), turns: Turns::default(), work }
    }

    /// A selector for an open archive; bytes in VRAM are those of decoded chunks.
    pub fn for_model(model: &Model) -> Selector {
        let chunk_bytes: Vec<u64> = (0..model.chunk_count()).map(|c| model.decoded_bytes(ChunkId(c)) as u64).collect();
        Selector::new(&SelectTables::of(model, &chunk_bytes))
    }

    /// Errors of a cluster per level, input units, starting at 0 and strictly increasing: what a
    /// [`Switch`] turns into switch distances, here and on the GPU.
    pub fn errors(&self, cluster: u32) -> &[f32] {
        self.tables.errors(cluster)
    }

    /// The display rule's table of a cluster in one view, with the floors of the last plan.
    pub fn lod_table(&self, cluster: u32, switch: &Switch) -> LodTable {
        switch.table(self.errors(cluster), self.floors.floor(cluster))
    }

    /// Switch distances of all clusters in one view, `cluster * levels + level`, world units: what the GPU reads.
    pub fn distances(&self, switch: &Switch) -> Vec<f32> {
        match &switch.bands {
            Some(bands) => bands[..self.tables.levels as usize].repeat(self.tables.clusters()),
            None => self.tables.all_errors().iter().map(|error| error * switch.scale).collect(),
        }
    }

    /// What to draw, load and give back for this frame. `resident` and `retiring` have one entry per chunk.
    pub fn select(&mut self, frame: &Frame) -> Plan {
        let mut work = std::mem::take(&mut self.work);
        let plan = self.select_with(frame, &mut work);
        self.work = work;
        plan
    }

    fn select_with(&mut self, frame: &Frame, work: &mut Work) -> Plan {
        let t = &self.tables;
        assert_eq!(frame.resident.len(), t.chunks(), "one residency flag per chunk");
        assert_eq!(frame.retiring.len(), t.chunks(), "one retiring flag per chunk");
        assert_eq!(frame.failed.len(), t.chunks(), "one failed flag per chunk");
        let eyes = &Eyes::new(frame.views, frame.detail, t);
        let [soon_anew, later_anew] = self.turns.next(frame);
        // With those of this frame: from there to where they will be, what comes into view may be nearest here.
        let soon = if frame.prefetch.soon.is_empty() { vec![] } else { [frame.views, frame.prefetch.soon].concat() };
        work.soon.look(t, &soon, frame.detail, soon_anew);
        work.later.look(t, frame.prefetch.later, frame.detail, later_anew);
        let [(target, now), (texture_target, texels)] = aim(t, &mut self.controls, &self.floors, work, eyes, frame);
        let drawn = Switch::new(now.detail, 1.0, t.quantum);

        let walk = &work.walk;
        let mut plan = Plan { detail: Some(now.detail), ..Plan::default() };
        let mut floors_stand = self.floors.step(t, eyes, &drawn, walk, frame, &mut plan.released);
        if let Some(floors) = &mut self.texture_floors {
            let shown = Switch::new(texels.detail, 1.0, t.quantum);
            floors_stand &= floors.step(t, eyes, &shown, walk, frame, &mut plan.released);
            plan.texture_floors = floors.all().to_vec();
        }
        self.draw(walk, eyes, &drawn, &mut plan);
        let targets = [&target, &texture_target];
        if soon_anew {
            self.want_ahead(&mut work.soon, Class::Soon, targets, frame, &mut work.wants);
        }
        if later_anew {
            let rungs = [0, 1].map(|k| self.controls[k].rung());
            work.later.go(&self.tables, rungs, |rungs| on_rungs(&self.tables, frame, rungs));
            self.want_ahead(&mut work.later, Class::Maybe, targets, frame, &mut work.wants);
        }
        self.want(walk, targets, [&now, &texels], frame, &mut work.wants);
        let now = work.wants.ordered();
        plan.wants = work.wants.merged([&now, &work.soon.wants, &work.later.wants]);
        let now = now.iter().take_while(|w| w.class == Class::Now);
        plan.missing_chunks = now.filter(|w| !frame.resident[w.chunk.0 as usize]).count() as u32;
        plan.texture_detail = self.tables.has_textures().then_some(texels.detail);
        plan.rising = self.controls.iter().any(DetailControl::rises);
        plan.floors = self.floors.all().to_vec();
        plan.floors_stand = floors_stand;
        plan.settled = floors_stand && self.controls.iter().all(DetailControl::settled) && plan.missing_chunks == 0;
        plan
    }

    /// Draws and coarse ranges of the visible clusters; triangles; projected error.
    fn draw(&self, walk: &Walk, eyes: &Eyes, switch: &Switch, plan: &mut Plan) {
        let t = &self.tables;
        let coarsest = t.levels - 1;
        let mut draws: Vec<(Draw, f32)> = Vec::new();
        let coarse = |instance: u32, clusters: &std::ops::Range<u32>| CoarseDraw {
            instance,
            indices: t.coarse_indices(clusters.clone()),
        };
        let mut ranges: Vec<CoarseDraw> = walk.coarse.iter().map(|(i, r)| coarse(*i, r)).collect();
        plan.error_px = walk.coarse_error_px;
        for seen in walk.seen.iter().filter(|s| s.place == Place::Visible) {
            let lod = t.lod(switch, seen.cluster, seen.reach).max(self.floors.floor(seen.cluster));
            let level = (lod as u32).min(coarsest);
            plan.error_px = plan.error_px.max(eyes.error_px(t.error_at(seen.cluster, lod), seen.pixel));
            if level == coarsest {
                ranges.push(coarse(seen.instance, &(seen.cluster..seen.cluster + 1)));
            } else {
                plan.triangles += t.triangles(seen.cluster, level) as u64;
                draws.push((Draw { cluster: seen.cluster, level, instance: seen.instance }, seen.pixel));
            }
        }
        draws.sort_by(|(a, near), (b, far)| {
            let order = a.level.cmp(&b.level).then(near.total_cmp(far));
            order.then((a.instance, a.cluster).cmp(&(b.instance, b.cluster)))
        });
        plan.draws = draws.into_iter().map(|(draw, _)| draw).collect();
        plan.coarse = merge(ranges);
        plan.triangles += plan.coarse.iter().map(|r| r.indices.len() as u64 / 3).sum::<u64>();
    }

    /// Chunks that the views of this frame want: now for what is drawn, soon for the target on the way to which that is.
    /// One of each for geometry and for textures.
    fn want(&self, walk: &Walk, targets: [&Target; 2], drawn: [&Target; 2], frame: &Frame, wants: &mut Wants) {
        let t = &self.tables;
        let switches = drawn.map(|drawn| Switch::new(drawn.detail, 1.0, t.quantum));
        let arrived = [0, 1].map(|k| drawn[k] == targets[k]);
        self.want_seen(walk, targets, frame, wants, |seen, ladder, coarsest, level| {
            let (k, finest) = (ladder as usize, level(1.0));
            let now = match seen.place {
                Place::Visible if arrived[k] => finest,
                Place::Visible => {
                    let reach = seen.reach.max(seen.girth * drawn[k].nearest);
                    finest.max(t.ladder_level(ladder, &switches[k], seen.cluster, reach))
                }
                _ => coarsest,
            };
            match (seen.place, frame.prefetch.around) {
                (Place::Visible, true) => [now, level(SOON_MARGIN), level(MAYBE_MARGIN)],
                (Place::Ring, true) => [now, finest, level(MAYBE_MARGIN)],
                (Place::Elsewhere, true) => [now, coarsest, finest],
                (_, false) => [now, finest, finest],
            }
        });
    }

    /// Chunks that cameras to come will draw, of class Soon or Maybe.
    fn want_ahead(&self, ahead: &mut Ahead, class: Class, targets: [&Target; 2], frame: &Frame, wants: &mut Wants) {
        self.want_seen(&ahead.walk, targets, frame, wants, |_, _, coarsest, level| {
            let finest = level(1.0);
            [coarsest, if class == Class::Soon { finest } else { coarsest }, finest]
        });
        ahead.wants = wants.ordered();
    }

    /// Wants the chunks of what a walk saw. `levels` tells from which level on by class, Now first; it gets the coarsest
    /// level and that of a fraction of the distance.
    fn want_seen(
        &self,
        walk: &Walk,
        targets: [&Target; 2],
        frame: &Frame,
        wants: &mut Wants,
        levels: impl Fn(&Seen, Ladder, u32, &dyn Fn(f32) -> u32) -> [u32; 3],
    ) {
        let t = &self.tables;
        for (ladder, target) in t.ladders().zip(targets) {
            let switch = Switch::new(target.detail, 1.0, t.quantum);
            for seen in &walk.seen {
                let reach = seen.reach.max(seen.girth * target.nearest);
                let level = |margin: f32| t.ladder_level(ladder, &switch, seen.cluster, reach * margin);
                let levels = levels(seen, ladder, t.coarsest(ladder, seen.cluster), &level);
                self.want_cluster(ladder, seen, levels, frame, wants);
            }
        }
    }

    /// Wants the chunks of a cluster; by class, Now first, from which level on.
    fn want_cluster(&self, ladder: Ladder, seen: &Seen, levels: [u32; 3], frame: &Frame, wants: &mut Wants) {
        let t = &self.tables;
        let coarsest = t.coarsest(ladder, seen.cluster);
        let [now, soon, maybe] = levels;
        for i in maybe..=coarsest {
            let chunk = t.chunk(ladder, seen.cluster, i);
            let visible_hole = seen.place == Place::Visible && !frame.resident[chunk.0 as usize];
            let always_there = ladder == Ladder::Texture;
            if i == coarsest && (always_there || now == coarsest && !visible_hole) {
                break; // nothing finer is drawn, and the coarse buffer already shows the cluster
            }
            let class = match () {
                _ if i >= now => Class::Now,
                _ if i >= soon => Class::Soon,
                _ => Class::Maybe,
            };
            let error_px = t.error_if_missing(ladder, seen.cluster, i) / seen.pixel;
            wants.add(Want { chunk, class, error_px });
        }
    }

    /// The level whose index buffer may draw a cluster for this view: `floor` of the smallest lod in its
    /// sphere, rounded towards finer so that the shader's f32 never sees a smaller lod at a vertex. `placement` is that of
    /// an instance, or the identity.
    pub fn drawn_level(&self, cluster: u32, view: &View, detail: Detail, placement: &Placement) -> u32 {
        let eyes = Eyes::new(std::slice::from_ref(view), detail, &self.tables);
        let reach = eyes.reach_at(placement, self.tables.sphere(cluster)).0;
        let switch = Switch::new(detail, 1.0, self.tables.quantum);
        let lod = self.tables.lod(&switch, cluster, reach).max(self.floors.floor(cluster));
        (lod as u32).min(self.tables.levels - 1)
    }
}

/// Bytes in VRAM if every cluster that shows is resident at the level that the target asks for, with the coarse buffer and
/// without the tails of textures.
fn bytes_wanted(t: &Tables, ladder: Ladder, shown: &Shown, target: &Target) -> u64 {
    let switch = Switch::new(target.detail, 1.0, t.quantum);
    let finer = shown.all().iter().map(|&Near { cluster, reach, girth }| {
        let reach = reach.max(girth * target.nearest);
        t.bytes_above_coarsest(ladder, cluster, t.ladder_level(ladder, &switch, cluster, reach))
    });
    let always = if ladder == Ladder::Geometry { t.coarse_bytes } else { 0 };
    always.saturating_add(finer.fold(0, u64::saturating_add))
}

/// For geometry and textures: what the budgets allow, and what to use in this frame on the way there. Walks the tree for
/// details little finer than those of the last frame, and again for finer ones where it turns out that the budgets may
/// allow them. The budgets hold what shows in the views of this frame, and what comes soon as far as that was looked at.
fn aim(
    t: &Tables,
    controls: &mut [DetailControl; 2],
    floors: &Floors,
    Work { walk, soon, shown, .. }: &mut Work,
    eyes: &Eyes,
    frame: &Frame,
) -> [(Target, Target); 2] {
    let scope = if frame.prefetch.around { Scope::Around(MAYBE_MARGIN) } else { Scope::Drawn };
    let rooms = rooms(t, frame);
    let mut first = [0, 1].map(|k| controls[k].first_rung());
    let mut step = 1;
    loop {
        let finest = [0, 1].map(|k| Switch::new(controls[k].finest(frame, first[k]), 1.0, t.quantum));
        walk.go(t, eyes, &finest, scope);
        soon.go(t, first, |rungs| on_rungs(t, frame, rungs));
        shown.clear();
        [&*walk, &soon.walk].into_iter().for_each(|walk| shown.add(t, walk));
        let most = frame.max_triangles;
        // The target has to hold when all that it wants is resident, a picture with what is.
        let few = |x: &Target| most == u64::MAX || triangles(t, |_| 0.0, walk, x) <= most;
        let now_few = |x: &Target| most == u64::MAX || triangles(t, |c| floors.floor(c), walk, x) <= most;
        let fits = |x: &Target| bytes_wanted(t, Ladder::Geometry, shown, x) <= rooms[0] && few(x);
        let texels_fit = |x: &Target| !t.has_textures() || bytes_wanted(t, Ladder::Texture, shown, x) <= rooms[1];
        let rungs = [controls[0].search(frame, first[0], fits), controls[1].search(frame, first[1], texels_fit)];
        if let [Some(rung), Some(texture_rung)] = rungs {
            let is_there =
                |ladder, x: &Target| [&*walk, &soon.walk].into_iter().all(|walk| is_there(t, ladder, walk, x, frame));
            let geometry = Conditions {
                is_there: &|x| is_there(Ladder::Geometry, x),
                may_be_drawn: &|detail| now_few(&Target { detail, nearest: 0.0 }),
            };
            let textures = Conditions {
                is_there: &|x| !t.has_textures() || is_there(Ladder::Texture, x),
                may_be_drawn: &|_| true,
            };
            return [controls[0].step(frame, rung, &geometry), controls[1].step(frame, texture_rung, &textures)];
        }
        step *= 4;
        first = [0, 1].map(|k| if rungs[k].is_none() { (first[k] - step).max(0) } else { first[k] });
    }
}

/// The switches of geometry and textures on two rungs of the ladder of details.
fn on_rungs(t: &Tables, frame: &Frame, rungs: [i32; 2]) -> [Switch; 2] {
    rungs.map(|rung| Switch::new(on_rung(frame.detail, rung), 1.0, t.quantum))
}

/// The budgets without what is kept free for prefetching: a part of what comes and goes, not of the coarse buffer.
fn rooms(t: &Tables, frame: &Frame) -> [u64; 2] {
    let kept_free = |budget: u64, all: u64, always: u64| match frame.prefetch.is_off() || budget >= all {
        true => budget,
        false => budget - budget.saturating_sub(always) / PREFETCH_SHARE,
    };
    let [all, all_textures] = t.all_bytes;
    [kept_free(frame.vram_budget_bytes, all, t.coarse_bytes), kept_free(frame.texture_budget_bytes, all_textures, 0)]
}

/// Whether all chunks that a target draws of what a walk saw are resident, but for those that cannot be.
fn is_there(t: &Tables, ladder: Ladder, walk: &Walk, target: &Target, frame: &Frame) -> bool {
    let switch = Switch::new(target.detail, 1.0, t.quantum);
    walk.seen.iter().filter(|s| s.place == Place::Visible).all(|s| {
        let reach = s.reach.max(s.girth * target.nearest);
        let level = t.ladder_level(ladder, &switch, s.cluster, reach);
        let at = |level: u32| t.chunk(ladder, s.cluster, level).0 as usize;
        let mut needed = level..t.coarsest(ladder, s.cluster);
        // Coarser ones are resident with the finest (I5), and nothing is finer than what failed.
        needed.is_empty() || frame.resident[at(level)] || needed.any(|level| frame.failed[at(level)])
    })
}

/// Triangles that are drawn at a target with these residency floors.
fn triangles(t: &Tables, floor: impl Fn(u32) -> f32, walk: &Walk, target: &Target) -> u64 {
    let switch = Switch::new(target.detail, 1.0, t.quantum);
    let seen = walk.seen.iter().filter(|s| s.place == Place::Visible).map(|s| {
        let reach = s.reach.max(s.girth * target.nearest);
        let lod = t.lod(&switch, s.cluster, reach).max(floor(s.cluster));
        t.triangles(s.cluster, (lod as u32).min(t.levels - 1)) as u64
    });
    let coarse = walk.coarse.iter().map(|(_, r)| t.coarse_indices(r.clone())).map(|r| u64::from(r.end - r.start) / 3);
    seen.sum::<u64>() + coarse.sum::<u64>()
}

/// Sorts ranges by instance, and joins those of one instance that touch.
fn merge(mut ranges: Vec<CoarseDraw>) -> Vec<CoarseDraw> {
    ranges.sort_by_key(|r| (r.instance, r.indices.start));
    let mut out: Vec<CoarseDraw> = Vec::new();
    for range in ranges.into_iter().filter(|r| !r.indices.is_empty()) {
        match out.last_mut() {
            Some(last) if last.instance == range.instance && last.indices.end == range.indices.start => {
                last.indices.end = range.indices.end;
            }
            _ => out.push(range),
        }
    }
    out
}
