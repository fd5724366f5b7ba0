//! Meshes that are placed more than once become objects: their geometry is read once and keeps a list of places.
//!
//! Places of one object differ by turns, moves and one scale for all directions. Where a mesh is also mirrored or stretched,
//! those places make objects of their own, up to [`MAX_SHAPES`] per mesh; what is left is written out as geometry.

use super::super::Warnings;
use super::super::textures::InstanceCounts;
use super::scene::Placed;
use glam::{DMat3, DMat4, DQuat, DVec3};
use pb_lod::progressive_buffers::instances::{MIN_SCALE, Placement};
use std::collections::BTreeMap;

/// Most objects that one mesh becomes.
const MAX_SHAPES: usize = 16;

/// What is placed, in the order in which it is written.
#[derive(Default)]
pub(super) struct Layout {
    /// Written out where it stands.
    pub(super) single: Vec<Placed>,
    /// Written once.
    pub(super) objects: Vec<ObjectPlan>,
    /// Places of repeated meshes that are written out nevertheless.
    pub(super) apart: usize,
    /// Places of repeated meshes that have no size.
    pub(super) empty: usize,
}

/// A mesh with its places.
pub(super) struct ObjectPlan {
    pub(super) mesh: usize,
    /// Where it is written: its largest place, so that its details are those of its nearest look.
    pub(super) base: DMat4,
    members: Vec<Member>,
}

struct Member {
    world: DMat4,
    /// From the base.
    rotation: DQuat,
    scale: f64,
}

impl ObjectPlan {
    pub(super) fn len(&self) -> usize {
        self.members.len()
    }

    /// The places of what is written at the base; exact at a point of the mesh, which should be in its middle.
    pub(super) fn placements(&self, middle: DVec3) -> Vec<Placement> {
        let from = self.base.transform_point3(middle);
        let placement = |m: &Member| {
            let to = m.world.transform_point3(middle);
            let turned = Placement { rotation: m.rotation, scale: m.scale, translation: DVec3::ZERO };
            Placement { translation: to - turned.point(from), ..turned }
        };
        self.members.iter().map(placement).collect()
    }
}

impl Layout {
    /// With an object for every mesh that is placed more than once.
    pub(super) fn of(placed: Vec<Placed>) -> Layout {
        let mut uses: BTreeMap<usize, usize> = BTreeMap::new();
        placed.iter().for_each(|at| *uses.entry(at.mesh).or_default() += 1);
        let mut layout = Layout::default();
        let mut shapes: BTreeMap<usize, Vec<ObjectPlan>> = BTreeMap::new();
        for at in placed {
            let has_size = DMat3::from_mat4(at.world) != DMat3::ZERO;
            match uses[&at.mesh] {
                1 => layout.single.push(at),
                _ if !has_size => layout.empty += 1,
                _ => layout.add(at, &mut shapes),
            }
        }
        for shape in shapes.into_values().flatten() {
            let shape = layout.on_its_largest(shape);
            match shape.len() {
                1 => layout.single.push(Placed { mesh: shape.mesh, world: shape.base }),
                _ => layout.objects.push(shape),
            }
        }
        layout
    }

    /// What was found, and warnings of what is odd about it.
    pub(super) fn counts(&self, warnings: &mut Warnings) -> InstanceCounts {
        if self.empty > 0 {
            warnings.add(format!("{} places of repeated meshes have a scale of 0 and are left out", self.empty));
        }
        InstanceCounts {
            objects: self.objects.len() as u64,
            instances: self.objects.iter().map(|o| o.members.len() as u64).sum(),
            apart: self.apart as u64,
        }
    }

    /// Adds a place to the first shape of its mesh that it is one of.
    fn add(&mut self, at: Placed, shapes: &mut BTreeMap<usize, Vec<ObjectPlan>>) {
        let shapes = shapes.entry(at.mesh).or_default();
        for shape in shapes.iter_mut() {
            if let Some(Placement { rotation, scale, .. }) = Placement::of_matrix(at.world * shape.base.inverse()) {
                shape.members.push(Member { world: at.world, rotation, scale });
                return;
            }
        }
        let invertible = DMat3::from_mat4(at.world).inverse().is_finite();
        if invertible && shapes.len() < MAX_SHAPES {
            let itself = Member { world: at.world, rotation: DQuat::IDENTITY, scale: 1.0 };
            shapes.push(ObjectPlan { mesh: at.mesh, base: at.world, members: vec![itself] });
        } else {
            self.apart += 1;
            self.single.push(at);
        }
    }

    /// The shape with its largest place as its base; places that are too small beside that are written out.
    fn on_its_largest(&mut self, mut shape: ObjectPlan) -> ObjectPlan {
        let mut largest = 0;
        for (i, member) in shape.members.iter().enumerate() {
            if member.scale > shape.members[largest].scale {
                largest = i;
            }
        }
        let Member { world, rotation, scale } = shape.members[largest];
        for (i, member) in shape.members.iter_mut().enumerate() {
            member.rotation = (member.rotation * rotation.conjugate()).normalize();
            member.scale /= scale;
            if i == largest {
                (member.rotation, member.scale) = (DQuat::IDENTITY, 1.0);
            }
        }
        shape.base = world;
        let (members, small): (Vec<Member>, Vec<Member>) =
            shape.members.into_iter().partition(|m| m.scale >= MIN_SCALE);
        self.apart += small.len();
        self.single.extend(small.into_iter().map(|m| Placed { mesh: shape.mesh, world: m.world }));
        ObjectPlan { members, ..shape }
    }
}
