//! Instances as selection looks at them: in blocks of such as stand near each other, so that a block that is out of sight
//! or far away costs one look.

use std::ops::Range;

use glam::DVec3;

use super::super::instances::{Instances, Placement};
use super::tables::{Node, Sphere};

/// Instances of a block; the bake sorts them along a space-filling curve.
const BLOCK: usize = 64;

/// All objects with their instances. Places are counted from the model's origin.
pub(super) struct Crowd {
    pub objects: Vec<Object>,
    /// By instance.
    placements: Vec<Placement>,
    blocks: Vec<Block>,
}

/// An object.
pub(super) struct Object {
    /// Root of its clusters' tree.
    pub node: u32,
    first_cluster: u32,
    blocks: Range<u32>,
}

/// Some instances of an object.
pub(super) struct Block {
    /// Holds the spheres of its instances.
    pub sphere: Sphere,
    /// Largest scale.
    pub scale: f64,
    pub instances: Range<u32>,
}

impl Crowd {
    pub fn new(t: &Instances, nodes: &[Node]) -> Crowd {
        let placements: Vec<Placement> = t.instances.iter().map(|i| i.placement()).collect();
        let mut crowd = Crowd { objects: Vec::with_capacity(t.objects.len()), placements, blocks: Vec::new() };
        for o in t.objects {
            let first_block = crowd.blocks.len() as u32;
            let sphere = &nodes[o.node as usize].sphere;
            let all = o.first_instance..o.first_instance + o.instance_count;
            for first in all.clone().step_by(BLOCK) {
                let instances = first..all.end.min(first + BLOCK as u32);
                crowd.blocks.push(crowd.block(sphere, instances));
            }
            let blocks = first_block..crowd.blocks.len() as u32;
            crowd.objects.push(Object { node: o.node, first_cluster: o.first_cluster, blocks });
        }
        crowd
    }

    fn block(&self, object: &Sphere, instances: Range<u32>) -> Block {
        let spheres = || instances.clone().map(|i| self.sphere(object, i));
        let low = spheres().map(|s| s.center).fold(DVec3::INFINITY, DVec3::min);
        let high = spheres().map(|s| s.center).fold(DVec3::NEG_INFINITY, DVec3::max);
        let center = (low + high) * 0.5;
        let radius = spheres().map(|s| s.center.distance(center) + s.radius).fold(0.0, f64::max);
        let scale = instances.clone().map(|i| self.placement(i).scale).fold(0.0, f64::max);
        Block { sphere: Sphere { center, radius }, scale, instances }
    }

    pub fn placement(&self, instance: u32) -> &Placement {
        &self.placements[instance as usize]
    }

    /// Where an instance has a sphere of its object.
    pub fn sphere(&self, sphere: &Sphere, instance: u32) -> Sphere {
        let placement = self.placement(instance);
        Sphere { center: placement.point(sphere.center), radius: sphere.radius * placement.scale }
    }

    pub fn blocks(&self, object: &Object) -> &[Block] {
        &self.blocks[object.blocks.start as usize..object.blocks.end as usize]
    }

    /// Instances of the object that a cluster belongs to.
    pub fn instances_of(&self, cluster: u32) -> Range<u32> {
        let object = &self.objects[self.objects.partition_point(|o| o.first_cluster <= cluster) - 1];
        let blocks = self.blocks(object);
        blocks[0].instances.start..blocks[blocks.len() - 1].instances.end
    }
}
