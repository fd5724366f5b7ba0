//! Objects and instances: clusters that stand in several places of the world (docs/decisions/014-instances.md;
//! docs/format.md gives the bytes).
//!
//! The clusters of an object are a range of their own and a subtree of the coarse buffer hierarchy; no cluster has
//! neighbours in another object. An instance turns, scales and moves its object as a whole, so that seen from an eye that
//! is moved the other way its object looks the same: levels, errors, floors and morphs need no other rule.
//!
//! An archive without these tables has one object with one instance, which stands where its clusters are.

use super::layout::{ClusterRecord, ModelRecord, NodeRecord};
use bytemuck::{Pod, Zeroable};
use glam::{DQuat, DVec3};
pub use pb_mesh::objects::Placement;

/// Section tag of the [`ObjectRecord`]s.
pub const OBJECTS: [u8; 4] = *b"OBJT";
/// Section tag of the [`InstanceRecord`]s.
pub const INSTANCES: [u8; 4] = *b"INST";
/// Most instances of an archive.
pub const MAX_INSTANCES: u32 = 1 << 20;
/// Scales of instances lie between this and its inverse.
pub const MIN_SCALE: f64 = 1e-9;
/// Places of instances are no further from the model's origin, input units.
pub const MAX_DISTANCE: f64 = 1e30;

/// One object. 24 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ObjectRecord {
    /// First of its clusters; objects are in the order of these.
    pub first_cluster: u32,
    /// Number of its clusters, at least 1.
    pub cluster_count: u32,
    /// The node of the hierarchy that has its clusters and no others.
    pub node: u32,
    /// First of its instances.
    pub first_instance: u32,
    /// Number of its instances, at least 1.
    pub instance_count: u32,
    /// Zero.
    pub reserved: u32,
}

/// One instance: moves `p` to `translation + scale * (rotation * p)`, both counted from the model's origin, input units.
/// 64 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct InstanceRecord {
    /// Unit quaternion: x, y, z, w.
    pub rotation: [f64; 4],
    /// From the model's origin.
    pub translation: [f64; 3],
    /// Alike in all directions, above 0.
    pub scale: f64,
}

impl InstanceRecord {
    /// Of a placement around the model's origin.
    pub fn new(placement: &Placement) -> InstanceRecord {
        InstanceRecord {
            rotation: placement.rotation.to_array(),
            translation: placement.translation.to_array(),
            scale: placement.scale,
        }
    }

    /// Around the model's origin.
    pub fn placement(&self) -> Placement {
        Placement {
            rotation: DQuat::from_array(self.rotation),
            scale: self.scale,
            translation: DVec3::from_array(self.translation),
        }
    }

    /// Why it is no instance.
    fn fault(&self) -> Option<&'static str> {
        let squares: f64 = self.rotation.iter().map(|x| x * x).sum();
        let far = self.translation.iter().any(|x| !(-MAX_DISTANCE..=MAX_DISTANCE).contains(x));
        match () {
            _ if !(-1e-9..=1e-9).contains(&(squares - 1.0)) => Some("its rotation is no unit quaternion"),
            _ if !(MIN_SCALE..=1.0 / MIN_SCALE).contains(&self.scale) => Some("its scale is not 1e-9 to 1e9"),
            _ if far => Some("its place is beyond 1e30"),
            _ => None,
        }
    }
}

const _: () = {
    assert!(size_of::<ObjectRecord>() == 24);
    assert!(size_of::<InstanceRecord>() == 64);
};

/// Both tables of a model.
#[derive(Clone, Copy, Debug)]
pub struct Instances<'a> {
    /// In the order of their clusters.
    pub objects: &'a [ObjectRecord],
    /// In the order of their objects.
    pub instances: &'a [InstanceRecord],
}

impl<'a> Instances<'a> {
    /// Those of an object.
    pub fn of(&self, object: &ObjectRecord) -> &'a [InstanceRecord] {
        &self.instances[object.first_instance as usize..][..object.instance_count as usize]
    }

    /// Smallest and largest world coordinates of boxes around all objects at all their places.
    pub fn world_bounds(&self, model: &ModelRecord, clusters: &[ClusterRecord]) -> [DVec3; 2] {
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for object in self.objects {
            let own = &clusters[object.first_cluster as usize..][..object.cluster_count as usize];
            let corners = box_of(model, own);
            for instance in self.of(object) {
                let placement = instance.placement();
                for corner in 0..8 {
                    let pick = |k: usize| corners[corner >> k & 1][k];
                    let at = placement.point(DVec3::new(pick(0), pick(1), pick(2))) + DVec3::from(model.origin);
                    bounds = [bounds[0].min(at), bounds[1].max(at)];
                }
            }
        }
        bounds
    }

    /// Triangles of all instances, from those of the clusters of an object.
    pub fn placed(&self, triangles: impl Fn(&ObjectRecord) -> u64) -> u64 {
        self.objects.iter().map(|o| triangles(o).saturating_mul(o.instance_count.into())).fold(0, u64::saturating_add)
    }

    /// What is wrong with the tables of a model of so many clusters: which record, and what. The nodes were checked before.
    pub(super) fn fault(&self, clusters: u32, nodes: &[NodeRecord]) -> Option<(String, String)> {
        if self.instances.len() > MAX_INSTANCES as usize {
            return Some(("the instances".into(), format!("there are more than {MAX_INSTANCES}")));
        }
        let (mut cluster, mut instance) = (0u64, 0u64);
        for (i, o) in self.objects.iter().enumerate() {
            let fail = |why: &str| Some((format!("object {i}"), why.to_string()));
            if (u64::from(o.first_cluster), u64::from(o.first_instance)) != (cluster, instance) {
                return fail("it does not begin where the one before ends");
            }
            if o.cluster_count == 0 || o.instance_count == 0 || o.reserved != 0 {
                return fail("it has no clusters or no instances, or its reserved bytes are not zero");
            }
            let own = |n: &NodeRecord| (n.first_cluster, n.cluster_count) == (o.first_cluster, o.cluster_count);
            if !nodes.get(o.node as usize).is_some_and(own) {
                return fail("its node has not its clusters");
            }
            cluster += u64::from(o.cluster_count);
            instance += u64::from(o.instance_count);
        }
        if (cluster, instance) != (clusters.into(), self.instances.len() as u64) {
            let why = format!(
                "they have {cluster} clusters and {instance} instances, but the archive {clusters} and {}",
                self.instances.len()
            );
            return Some(("the objects".into(), why));
        }
        let fault =
            |(i, record): (usize, &InstanceRecord)| Some((format!("instance {i}"), record.fault()?.to_string()));
        self.instances.iter().enumerate().find_map(fault)
    }

    /// Index of the object of a cluster.
    pub fn object_of(&self, cluster: u32) -> usize {
        self.objects.partition_point(|o| o.first_cluster <= cluster) - 1
    }
}

/// Smallest and largest coordinates of some clusters, counted from the model's origin, input units: of their spheres, as far
/// as they are inside the model.
fn box_of(model: &ModelRecord, clusters: &[ClusterRecord]) -> [DVec3; 2] {
    let grid = |g: [i32; 3]| DVec3::from(g.map(f64::from));
    let radius = |c: &ClusterRecord| DVec3::splat(c.radius.into());
    let low = clusters.iter().map(|c| grid(c.center) - radius(c)).fold(DVec3::INFINITY, DVec3::min);
    let high = clusters.iter().map(|c| grid(c.center) + radius(c)).fold(DVec3::NEG_INFINITY, DVec3::max);
    [low.max(grid(model.bounds_min)) * model.quantum, high.min(grid(model.bounds_max)) * model.quantum]
}
