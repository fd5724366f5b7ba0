//! Clusters and the borders between them in local numbers.

use super::border::Seam;
use super::charts::Charts;
use super::patch::{Patch, PatchInput};
use super::{UnisonInput, lock};
use crate::numbering::Numbering;
use crate::topology::{Kind, border_pair};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Mutex;

/// A component vanishes when the cost limit reaches this share of its squared diameter.
const VANISH_SHARE: f32 = 0.25;

/// Cluster `c` in local numbers.
pub(super) fn patch_input(input: &UnisonInput, numbering: &mut Numbering, mean_area: f32, c: u32) -> PatchInput {
    let triangles = input.segmentation.cluster(c as usize);
    numbering.assign(triangles.iter().flat_map(|&t| input.triangles[t as usize]));
    let global: Vec<u32> = numbering.items().collect();
    let origin = input.positions[global[0] as usize];
    let positions = global.iter().map(|&v| {
        let p = input.positions[v as usize];
        Vec3::from_array(std::array::from_fn(|k| (i64::from(p[k]) - i64::from(origin[k])) as f32))
    });
    let (mut shared_start, mut shared) = (vec![0], Vec::new());
    for &v in &global {
        if matches!(input.kinds[v as usize], Kind::Border | Kind::Locked) {
            let mut others: Vec<u32> = input.fans.around(v).iter().map(|&t| input.cluster_of[t as usize]).collect();
            others.retain(|&o| o != c);
            others.sort_unstable();
            others.dedup();
            shared.extend(others);
        }
        shared_start.push(shared.len() as u32);
    }
    let positions: Vec<Vec3> = positions.collect();
    let local: Vec<[u32; 3]> =
        triangles.iter().map(|&t| input.triangles[t as usize].map(|v| numbering.of(v))).collect();
    PatchInput {
        charts: input.texture.as_ref().map(|uv| Charts::new(uv, c, triangles, &local, &positions)),
        triangles: local,
        kinds: global.iter().map(|&v| input.kinds[v as usize]).collect(),
        normals: global.iter().map(|&v| input.normals[v as usize]).collect(),
        components: small_components(&global, &input.segmentation.components, &positions, &shared_start),
        positions,
        mean_area,
        shared_start,
        shared,
        global,
    }
}

/// Components that no other cluster touches, largest first, with the cost at which they vanish. Where a cluster has nothing
/// else, the largest one stays.
fn small_components(
    global: &[u32],
    component: &[u32],
    positions: &[Vec3],
    shared_start: &[u32],
) -> Vec<(f32, Vec<u32>)> {
    if global.iter().all(|&v| component[v as usize] == component[global[0] as usize]) {
        return Vec::new();
    }
    let mut members: Vec<(u32, u32)> =
        global.iter().enumerate().map(|(i, &v)| (component[v as usize], i as u32)).collect();
    members.sort_unstable();
    let mut list: Vec<(f32, Vec<u32>)> = members
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|group| group.iter().all(|m| shared_start[m.1 as usize] == shared_start[m.1 as usize + 1]))
        .map(|group| {
            let points = || group.iter().map(|m| positions[m.1 as usize]);
            let (lo, hi) = points().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, p| (b.0.min(p), b.1.max(p)));
            ((hi - lo).length_squared() * VANISH_SHARE, group.iter().map(|m| m.1).collect())
        })
        .collect();
    list.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1[0].cmp(&b.1[0])));
    if list.iter().map(|(_, vertices)| vertices.len()).sum::<usize>() == global.len() {
        list.remove(0);
    }
    list
}

/// The borders between two clusters, ascending by clusters.
pub(super) fn build_seams(input: &UnisonInput, patches: &[Mutex<Patch>]) -> Vec<Seam> {
    let mut ends: Vec<([u32; 2], u32)> = (0..input.positions.len() as u32)
        .into_par_iter()
        .filter(|&v| input.kinds[v as usize] == Kind::Border)
        .map(|v| (border_pair(v, input.cluster_of, input.fans), v))
        .collect();
    ends.par_sort_unstable();
    let seam = |group: &[([u32; 2], u32)]| {
        let clusters = group[0].0;
        let [a, b] = clusters.map(|c| lock(&patches[c as usize]));
        Seam::new(clusters, group.iter().map(|&(_, v)| [a.local(v), b.local(v)]).collect())
    };
    ends.par_chunk_by(|a, b| a.0 == b.0).map(seam).collect()
}

/// Clusters whose seams are worked on together: what they hold fits into a small part of a machine's memory.
const BLOCK_CLUSTERS: u32 = 512;
/// How many times larger the blocks of the seams are that leave one.
const BLOCK_GROWTH: u32 = 8;

/// Groups in which no cluster occurs twice (greedy edge colouring): these may move at the same time.
///
/// The groups of one block of clusters, which are neighbours, follow each other: where the clusters of the whole mesh do not
/// fit into memory together, each block comes in once for all of its groups. Seams that leave a block come later, those of a
/// block of blocks together.
pub(super) fn group_seams(seams: Vec<Seam>) -> Vec<Vec<Seam>> {
    let mut blocks: std::collections::BTreeMap<(u32, u32), Vec<Group>> = Default::default();
    for s in seams {
        let [a, b] = s.clusters;
        let mut size = BLOCK_CLUSTERS;
        while a / size != b / size {
            size = size.saturating_mul(BLOCK_GROWTH);
        }
        let groups = blocks.entry((size, a / size)).or_default();
        let free = groups.iter().position(|g| !g.clusters.contains(&a) && !g.clusters.contains(&b));
        let at = free.unwrap_or_else(|| {
            groups.push(Group::default());
            groups.len() - 1
        });
        groups[at].clusters.extend([a, b]);
        groups[at].seams.push(s);
    }
    blocks.into_values().flatten().map(|g| g.seams).collect()
}

/// Seams of a block, no two of them at one cluster.
#[derive(Default)]
struct Group {
    clusters: std::collections::BTreeSet<u32>,
    seams: Vec<Seam>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_have_no_cluster_twice_and_those_of_a_block_follow_each_other() {
        // A strip of clusters, each beside the next three.
        let pairs = (0..5000u32).flat_map(|a| (1..4).map(move |d| [a, a + d])).collect::<Vec<_>>();
        let groups = group_seams(pairs.iter().map(|&p| Seam::new(p, Vec::new())).collect());
        let mut seen = Vec::new();
        let mut blocks = Vec::new();
        for group in &groups {
            let mut clusters: Vec<u32> = group.iter().flat_map(|s| s.clusters).collect();
            clusters.sort_unstable();
            assert!(clusters.windows(2).all(|w| w[0] < w[1]), "one cluster twice");
            seen.extend(group.iter().map(|s| s.clusters));
            if group.iter().all(|s| s.clusters[0] / BLOCK_CLUSTERS == s.clusters[1] / BLOCK_CLUSTERS) {
                blocks.push(clusters[0] / BLOCK_CLUSTERS);
                assert!(clusters.iter().all(|c| c / BLOCK_CLUSTERS == clusters[0] / BLOCK_CLUSTERS));
            }
        }
        seen.sort_unstable();
        assert_eq!(seen, pairs);
        assert!(blocks.is_sorted() && blocks.last() == Some(&(5002 / BLOCK_CLUSTERS)));
        assert!(groups.len() - blocks.len() < 12, "seams between blocks in few groups");
    }
}
