//! Which clusters belong to which object, and the tables of objects and instances.

use crate::progressive_buffers::hierarchy::Hierarchy;
use crate::progressive_buffers::instances::{InstanceRecord, ObjectRecord};
use glam::DVec3;
use pb_mesh::objects::{Objects, Placement};
use pb_mesh::segment::Segmentation;
use std::collections::BTreeMap;

/// Steps per axis in which places are sorted along a space-filling curve.
const CURVE_BITS: u32 = 20;

/// The objects of a segmentation, in its order.
pub(super) struct ObjectClusters {
    /// Number of clusters of each.
    pub counts: Vec<usize>,
    /// Where each stands; none where all stand where they are, once.
    placements: Option<Vec<Vec<Placement>>>,
}

impl ObjectClusters {
    /// `triangles` are position indices. Objects whose triangles are all gone have no clusters and are left out.
    pub fn new(objects: &Objects, triangles: &[[u32; 3]], segmentation: &Segmentation) -> ObjectClusters {
        if objects.of.is_empty() {
            return ObjectClusters { counts: vec![segmentation.len()], placements: None };
        }
        let object = |c: usize| objects.of[triangles[segmentation.cluster(c)[0] as usize][0] as usize];
        let clusters: Vec<u32> = (0..segmentation.len()).map(object).collect();
        let runs = || clusters.chunk_by(|a, b| a == b);
        let placements = runs().map(|run| match run[0] {
            0 => vec![Placement::IDENTITY],
            object => objects.placements[object as usize - 1].clone(),
        });
        ObjectClusters { counts: runs().map(<[u32]>::len).collect(), placements: Some(placements.collect()) }
    }

    /// The tables, for clusters in the order of a hierarchy with a subtree for each object. Instances of an object are in
    /// the order of a space-filling curve, so that those near each other are near each other in the table.
    pub fn tables(
        &self,
        hierarchy: &Hierarchy,
        origin: [f64; 3],
        quantum: f64,
    ) -> (Vec<ObjectRecord>, Vec<InstanceRecord>) {
        let (mut objects, mut instances) = (Vec::new(), Vec::new());
        let Some(placements) = &self.placements else { return (objects, instances) };
        let ends = ends(&self.counts);
        let object_of = |old: u32| ends.partition_point(|&end| end <= old as usize);
        let nodes: BTreeMap<(u32, u32), usize> =
            hierarchy.nodes.iter().enumerate().map(|(i, n)| ((n.first_cluster, n.cluster_count), i)).collect();
        let mut first = 0;
        while first < hierarchy.order.len() {
            let object = object_of(hierarchy.order[first]);
            let range = (first as u32, self.counts[object] as u32);
            let node = *nodes.get(&range).expect("each object is a subtree");
            let center = DVec3::from_array(hierarchy.nodes[node].center.map(f64::from)) * quantum;
            let around = placements[object].iter().map(|p| p.around(DVec3::from_array(origin))).collect();
            let sorted = along_curve(around, center);
            objects.push(ObjectRecord {
                first_cluster: range.0,
                cluster_count: range.1,
                node: node as u32,
                first_instance: instances.len() as u32,
                instance_count: sorted.len() as u32,
                reserved: 0,
            });
            instances.extend(sorted.iter().map(InstanceRecord::new));
            first += self.counts[object];
        }
        (objects, instances)
    }
}

fn ends(counts: &[usize]) -> Vec<usize> {
    let mut sum = 0;
    counts
        .iter()
        .map(|n| {
            sum += n;
            sum
        })
        .collect()
}

/// Sorts placements by where they put `center`, along a Morton curve; equal ones keep their order.
fn along_curve(placements: Vec<Placement>, center: DVec3) -> Vec<Placement> {
    let at = |p: &Placement| p.point(center);
    let low = placements.iter().map(at).fold(DVec3::INFINITY, DVec3::min);
    let high = placements.iter().map(at).fold(DVec3::NEG_INFINITY, DVec3::max);
    let steps = f64::from((1u32 << CURVE_BITS) - 1) / (high - low).max_element().max(f64::MIN_POSITIVE);
    let code = |p: &Placement| {
        let cell = ((at(p) - low) * steps).to_array().map(|x| x as u64);
        (0..CURVE_BITS)
            .fold(0u64, |code, bit| code | (0..3).fold(0, |c, k| c | (cell[k] >> bit & 1) << (3 * bit + k as u32)))
    };
    let mut coded: Vec<(u64, Placement)> = placements.iter().map(|p| (code(p), *p)).collect();
    coded.sort_by_key(|c| c.0);
    coded.into_iter().map(|c| c.1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_near_each_other_lie_near_each_other_in_the_table() {
        let at = |x: i32, y: i32| Placement {
            translation: DVec3::new(f64::from(x), f64::from(y), 0.0),
            ..Placement::IDENTITY
        };
        let all: Vec<Placement> = (0..16).flat_map(|x| (0..16).map(move |y| at(x * 7 % 16, y * 5 % 16))).collect();
        let sorted = along_curve(all, DVec3::ZERO);
        let step = |w: &[Placement]| w[0].translation.distance(w[1].translation);
        let mean = sorted.windows(2).map(step).sum::<f64>() / 255.0;
        assert!(mean < 2.0, "{mean}");
        assert_eq!(along_curve(vec![at(3, 4); 5], DVec3::ONE).len(), 5);
    }
}
