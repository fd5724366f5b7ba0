//! Meshes that are placed more than once become objects: their geometry is read once and keeps a list of places.
//!
//! Places of one object differ by turns, moves and one scale for all directions. Where a mesh is also mirrored or stretched,
//! all places that are so in the same way make an object of their own. What would save few triangles is written out as
//! geometry: an object has clusters of its own, and each of its instances draws of its own.

use super::super::Warnings;
use super::super::textures::InstanceCounts;
use super::scene::Placed;
use glam::{DMat3, DMat4, DQuat, DVec3};
use pb_lod::progressive_buffers::instances::{MIN_SCALE, Placement};
use std::collections::BTreeMap;

/// Steps in which stretches are told apart before they are compared closely.
const STRETCH_STEPS: f64 = 1e4;

/// Objects save at least so many triangles.
const MIN_SAVED_TRIANGLES: u64 = 1024;

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
    /// With objects for meshes that are placed more than once. `triangles` of a mesh.
    pub(super) fn of(placed: Vec<Placed>, triangles: impl Fn(usize) -> u64) -> Layout {
        let mut uses: BTreeMap<usize, usize> = BTreeMap::new();
        placed.iter().for_each(|at| *uses.entry(at.mesh).or_default() += 1);
        let mut layout = Layout::default();
        let mut shapes: BTreeMap<(usize, Stretch), ObjectPlan> = BTreeMap::new();
        for at in placed {
            match (uses[&at.mesh], Stretch::of(&at.world)) {
                (1, _) => layout.single.push(at),
                (_, None) if DMat3::from_mat4(at.world) == DMat3::ZERO => layout.empty += 1,
                (_, None) => layout.write_out(at),
                (_, Some(stretch)) => layout.add(at, stretch, &mut shapes),
            }
        }
        for shape in shapes.into_values() {
            let shape = layout.on_its_largest(shape);
            let saved = triangles(shape.mesh).saturating_mul(shape.members.len() as u64 - 1);
            match saved >= MIN_SAVED_TRIANGLES {
                true => layout.objects.push(shape),
                false => {
                    shape.members.iter().for_each(|m| layout.write_out(Placed { mesh: shape.mesh, world: m.world }))
                }
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

    /// Adds a place to the shape that is stretched like it.
    fn add(&mut self, at: Placed, stretch: Stretch, shapes: &mut BTreeMap<(usize, Stretch), ObjectPlan>) {
        let Some(shape) = shapes.get_mut(&(at.mesh, stretch)) else {
            let itself = Member { world: at.world, rotation: DQuat::IDENTITY, scale: 1.0 };
            let shape = ObjectPlan { mesh: at.mesh, base: at.world, members: vec![itself] };
            shapes.insert((at.mesh, stretch), shape);
            return;
        };
        match Placement::of_matrix(at.world * shape.base.inverse()) {
            Some(Placement { rotation, scale, .. }) => shape.members.push(Member { world: at.world, rotation, scale }),
            None => self.write_out(at),
        }
    }

    fn write_out(&mut self, at: Placed) {
        self.apart += 1;
        self.single.push(at);
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
        small.into_iter().for_each(|m| self.write_out(Placed { mesh: shape.mesh, world: m.world }));
        ObjectPlan { members, ..shape }
    }
}

/// How a matrix stretches, shears and mirrors, whatever its turn and its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Stretch {
    mirrored: bool,
    /// Products of the axes, over the size squared, in steps.
    products: [i64; 6],
}

impl Stretch {
    /// None where it flattens.
    fn of(matrix: &DMat4) -> Option<Stretch> {
        let linear = DMat3::from_mat4(*matrix);
        let size = linear.determinant().abs().cbrt();
        let (x, y, z) = (linear.x_axis / size, linear.y_axis / size, linear.z_axis / size);
        let products = [x.dot(x), y.dot(y), z.dot(z), x.dot(y), y.dot(z), z.dot(x)];
        // A product of 1e6 is a stretch by a thousand in one direction.
        let usable = size > 0.0 && products.iter().all(|p| p.abs() < 1e6);
        let step = |p: f64| (p * STRETCH_STEPS).round() as i64;
        usable.then(|| Stretch { mirrored: linear.determinant() < 0.0, products: products.map(step) })
    }
}
