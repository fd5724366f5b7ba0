//! Instances in a frame: where the eye is for each that is drawn, and the arguments of their draws. Needs no adapter.
//!
//! What a frame has room for on the adapter is bounded; where a plan draws more, it is drawn in several passes.
//!
//! Must never: touch the GPU; know what is near or far.

use std::collections::HashMap;

use glam::{DMat3, DVec3};
use pb_lod::plan::{Detail, Plan};
use pb_lod::progressive_buffers::instances::{Instances, Placement};
use pb_lod::progressive_buffers::layout::ModelRecord;

use crate::camera::grid_eye;
use crate::draw_table::DrawTable;
use crate::gpu_model::ModelTables;
use crate::tables::{DrawArguments, DrawGpu, StandGpu};

/// Most instances, and most draws, of one pass.
const MAX_PASS: u64 = 1 << 16;
/// Words of 16 bytes of a [`StandGpu`].
const STAND_WORDS: u32 = (size_of::<StandGpu>() / WORD_BYTES) as u32;
const WORD_BYTES: usize = 16;

/// Room for what is made anew in each frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Room {
    stands: u32,
    draws: u32,
    instanced: bool,
}

impl Room {
    /// For all that a model can draw at once, or for a pass of it.
    pub fn new(t: &ModelTables) -> Room {
        let Some(instances) = &t.instances else {
            return Room { stands: 0, draws: t.clusters.len() as u32, instanced: false };
        };
        let placed = instances.placed(|object| object.cluster_count.into());
        Room {
            stands: MAX_PASS.min(instances.instances.len() as u64) as u32,
            draws: MAX_PASS.min(placed) as u32,
            instanced: true,
        }
    }

    /// Bytes of the buffer that display.wgsl calls `frame`.
    pub fn frame_bytes(&self) -> u64 {
        match self.instanced {
            true => (u64::from(self.stands) * u64::from(STAND_WORDS) + u64::from(self.draws)) * WORD_BYTES as u64,
            false => WORD_BYTES as u64,
        }
    }

    /// Bytes of the arguments of draws.
    pub fn argument_bytes(&self) -> u64 {
        u64::from(self.draws) * size_of::<DrawArguments>() as u64
    }

    /// All of them.
    pub fn bytes(&self) -> u64 {
        self.frame_bytes() + self.argument_bytes()
    }
}

/// The instances of a model.
pub(crate) struct Crowd {
    model: ModelRecord,
    placements: Vec<Placement>,
    room: Room,
}

/// What one pass draws.
#[derive(Default)]
pub(crate) struct Batch {
    pub stands: Vec<StandGpu>,
    pub draws: Vec<DrawGpu>,
    /// Of the draws.
    pub arguments: Vec<DrawArguments>,
    /// Of ranges of the coarse buffer.
    pub coarse: Vec<DrawArguments>,
}

impl Crowd {
    pub fn new(instances: &Instances, model: &ModelRecord, room: Room) -> Crowd {
        let placements = instances.instances.iter().map(|i| i.placement()).collect();
        Crowd { model: *model, placements, room }
    }

    /// Where the draws begin in the words of a frame.
    pub fn first_draw(&self) -> u32 {
        self.room.stands * STAND_WORDS
    }

    /// A plan's draws, then its coarse ranges, in as many passes as there has to be; at least one.
    ///
    /// # Panics
    /// If a drawn chunk has no place (I5).
    pub fn batches(&self, plan: &Plan, eye: DVec3, table: &DrawTable) -> Vec<Batch> {
        let mut writer =
            Writer { crowd: self, plan, eye, done: Vec::new(), now: Batch::default(), slots: HashMap::new() };
        for draw in &plan.draws {
            let argument = table.argument(draw);
            let slot = writer.slot(draw.instance);
            let batch = &mut writer.now;
            let first_instance = batch.draws.len() as u32;
            batch.draws.push(DrawGpu { draw: argument.first_instance, slot, reserved: [0; 2] });
            batch.arguments.push(DrawArguments { first_instance, ..argument });
        }
        for range in &plan.coarse {
            let first_instance = writer.slot(range.instance);
            writer.now.coarse.push(DrawArguments {
                index_count: range.indices.end - range.indices.start,
                instance_count: 1,
                first_index: range.indices.start,
                base_vertex: 0,
                first_instance,
            });
        }
        writer.done.push(writer.now);
        writer.done
    }

    /// How an instance stands for an eye in the world.
    fn stand(&self, instance: u32, eye: DVec3, detail: Option<Detail>) -> StandGpu {
        let placement = &self.placements[instance as usize];
        let origin = DVec3::from(self.model.origin);
        let grid = grid_eye(&self.model, placement.point_of(eye - origin) + origin);
        let axes = DMat3::from_quat(placement.rotation) * placement.scale;
        let axis = |v: DVec3| v.as_vec3().extend(0.0).to_array();
        StandGpu {
            eye_cell: grid.cell,
            stretch: if matches!(detail, Some(Detail::Bands { .. })) { placement.scale as f32 } else { 1.0 },
            eye_rest: grid.rest,
            reserved: 0,
            axes: [axis(axes.x_axis), axis(axes.y_axis), axis(axes.z_axis)],
        }
    }
}

/// Fills batches.
struct Writer<'a> {
    crowd: &'a Crowd,
    plan: &'a Plan,
    eye: DVec3,
    done: Vec<Batch>,
    now: Batch,
    /// Of the instances in the batch under way; only looked up.
    slots: HashMap<u32, u32>,
}

impl Writer<'_> {
    /// The place of an instance in a batch that has room for one more draw of it.
    fn slot(&mut self, instance: u32) -> u32 {
        let Room { stands, draws, .. } = self.crowd.room;
        let known = self.slots.contains_key(&instance);
        let is_full = self.now.arguments.len() + self.now.coarse.len() == draws as usize;
        if is_full || !known && self.now.stands.len() == stands as usize {
            self.done.push(std::mem::take(&mut self.now));
            self.slots.clear();
        }
        let Writer { crowd, plan, eye, now, slots, .. } = self;
        *slots.entry(instance).or_insert_with(|| {
            now.stands.push(crowd.stand(instance, *eye, plan.detail));
            now.stands.len() as u32 - 1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use pb_lod::plan::CoarseDraw;
    use pb_lod::progressive_buffers::layout::{ClusterRecord, LevelRecord};

    fn crowd(room: Room) -> (Crowd, DrawTable) {
        let model = ModelRecord { quantum: 0.5, levels: 1, clusters: 1, ..ModelRecord::zeroed() };
        let at = |x: f64| Placement { translation: DVec3::X * x, scale: 2.0, ..Placement::IDENTITY };
        let (clusters, levels) =
            ([ClusterRecord::zeroed()], [LevelRecord { vertices: 3, triangles: 1, ..LevelRecord::zeroed() }]);
        let tables = ModelTables {
            model: &model,
            clusters: &clusters,
            levels: &levels,
            neighbours: &[],
            textures: None,
            instances: None,
        };
        let table = DrawTable::new(&tables, 8, 3);
        (Crowd { model, placements: (0..9).map(|i| at(f64::from(i))).collect(), room }, table)
    }

    #[test]
    fn what_does_not_fit_one_pass_is_drawn_in_several_and_nothing_is_lost() {
        let (crowd, table) = crowd(Room { stands: 2, draws: 3, instanced: true });
        let range = |k: u32| CoarseDraw { instance: k / 2, indices: 3 * k..3 * k + 3 };
        let plan = Plan { coarse: (0..18).map(range).collect(), ..Plan::default() };
        let batches = crowd.batches(&plan, DVec3::ZERO, &table);
        let mut drawn = Vec::new();
        for batch in &batches {
            assert!(batch.stands.len() <= 2 && batch.coarse.len() <= 3);
            for draw in &batch.coarse {
                let stand = &batch.stands[draw.first_instance as usize];
                // The eye at 0 is at -x / 2 of an object that stands at x, twice as large: in cells of a half, at -x.
                drawn.push((-stand.eye_cell[0] as u32, draw.first_index / 3));
            }
        }
        assert_eq!(drawn, (0..18).map(|k| (k / 2, k)).collect::<Vec<_>>());
        assert_eq!(crowd.batches(&Plan::default(), DVec3::ZERO, &table).len(), 1, "an empty frame is cleared, too");
    }

    #[test]
    fn bands_are_measured_in_the_world_and_errors_in_pixels() {
        let (crowd, _) = crowd(Room { stands: 2, draws: 3, instanced: true });
        let stretch = |detail| crowd.stand(1, DVec3::ZERO, Some(detail)).stretch;
        assert_eq!([stretch(Detail::ErrorPx(1.0)), stretch(Detail::Bands { k: 1.0, s: 0.0 })], [1.0, 2.0]);
    }
}
