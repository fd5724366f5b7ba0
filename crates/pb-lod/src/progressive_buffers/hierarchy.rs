//! The coarse buffer hierarchy: a binary tree over the clusters' bounding spheres (paper section 5.2).
//!
//! "We use a greedy bottom-up approach": of all pairs of roots, the two whose common bounding sphere is smallest are
//! merged, until one is left. The leaves in tree order are the order of the clusters in the archive, so every
//! subtree is one range of the coarse buffer.
//!
//! Each root remembers its best partner among the roots that are older than itself. A merged sphere is never
//! smaller than its parts, so a remembered radius whose partner is gone is still a lower bound; it is looked up
//! anew only when it comes first. That makes `n` searches of `n` spheres plus a few: quadratic, 30 000 spheres in
//! seconds.

use super::layout::NodeRecord;
use bytemuck::Zeroable;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Order of the clusters and the tree over them.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    /// `order[new] = old`: the input sphere that becomes cluster `new`.
    pub order: Vec<u32>,
    /// Node 0 is the root, children come after their parents; `first_cluster` counts in the new order.
    /// Errors are 0, see [`set_errors`](Hierarchy::set_errors).
    pub nodes: Vec<NodeRecord>,
}

impl Hierarchy {
    /// Fills the nodes' errors from the coarsest level's error per cluster, in the new order.
    ///
    /// # Panics
    /// If there is not one error per cluster.
    pub fn set_errors(&mut self, errors: &[f32]) {
        assert_eq!(errors.len(), self.order.len());
        for i in (0..self.nodes.len()).rev() {
            let node = self.nodes[i];
            self.nodes[i].error = match node.cluster_count {
                1 => errors[node.first_cluster as usize],
                _ => self.nodes[node.left as usize].error.max(self.nodes[node.right as usize].error),
            };
        }
    }
}

/// Builds the tree over spheres `(center, radius)` in grid space (quanta). Deterministic.
///
/// # Panics
/// If there are no spheres, or a number is not finite or does not fit the archive's i32 grid.
pub fn build(spheres: &[(DVec3, f64)]) -> Hierarchy {
    build_groups(spheres, &[spheres.len()])
}

/// The same where the spheres come in groups, so many of each, one after the other: each group becomes a subtree of its
/// own, and the groups' subtrees are merged by the same rule.
///
/// # Panics
/// As [`build`]; and if a group is empty, or the groups are not all spheres.
pub fn build_groups(spheres: &[(DVec3, f64)], groups: &[usize]) -> Hierarchy {
    assert!(!spheres.is_empty(), "a hierarchy has at least one cluster");
    let fits = |&(c, r): &(DVec3, f64)| c.abs().max_element() <= i32::MAX as f64 && r >= 0.0 && r.is_finite();
    assert!(spheres.iter().all(fits), "spheres lie on the i32 grid");
    assert!(groups.iter().sum::<usize>() == spheres.len() && !groups.contains(&0), "groups divide the spheres");
    let mut children = Vec::with_capacity(spheres.len() - 1);
    let mut add = |pairs: Vec<(u32, u32)>, leaves: &[u32]| {
        let base = (spheres.len() + children.len()) as u32;
        let global = |id: u32| leaves.get(id as usize).copied().unwrap_or_else(|| id - leaves.len() as u32 + base);
        children.extend(pairs.iter().map(|&(a, b)| (global(a), global(b))));
        global((leaves.len() + pairs.len()) as u32 - 1)
    };
    let mut roots = Vec::with_capacity(groups.len());
    let mut first = 0;
    for &count in groups {
        let (pairs, sphere) = merge_all(&spheres[first..first + count]);
        let leaves: Vec<u32> = (first as u32..(first + count) as u32).collect();
        roots.push((add(pairs, &leaves), sphere));
        first += count;
    }
    let (ids, tops): (Vec<u32>, Vec<(DVec3, f64)>) = roots.into_iter().unzip();
    add(merge_all(&tops).0, &ids);
    number(spheres, &children)
}

/// Merges spheres until one is left: which pairs, where ids below the number of spheres are spheres, and the next ids the
/// merges in their order; and the last sphere.
fn merge_all(spheres: &[(DVec3, f64)]) -> (Vec<(u32, u32)>, (DVec3, f64)) {
    let mut roots = Roots::new(spheres);
    let mut pairs = Vec::with_capacity(spheres.len() - 1);
    while let Some((a, b)) = roots.pop_pair() {
        pairs.push((a, b));
        roots.merge(a, b);
    }
    (pairs, roots.sphere(roots.id.len() - 1))
}

/// A pair of roots in the queue: smallest radius first, then oldest ids, so that ties are settled always alike.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    /// Bits of the non-negative radius of the common sphere: ordered as the numbers are.
    radius: u64,
    newer: u32,
    older: u32,
}

/// The spheres that were not merged yet, as columns for a fast search, oldest first.
struct Roots {
    id: Vec<u32>,
    center: [Vec<f64>; 3],
    /// Infinite for a root that was merged; such rows are removed from time to time.
    radius: Vec<f64>,
    /// Row of each id, or `u32::MAX` when it was merged.
    row: Vec<u32>,
    dead: usize,
    queue: BinaryHeap<Reverse<Pair>>,
}

impl Roots {
    fn new(spheres: &[(DVec3, f64)]) -> Self {
        let n = spheres.len();
        let mut roots = Self {
            id: Vec::with_capacity(n),
            center: std::array::from_fn(|_| Vec::with_capacity(n)),
            radius: Vec::with_capacity(n),
            row: Vec::with_capacity(2 * n),
            dead: 0,
            queue: BinaryHeap::with_capacity(n),
        };
        spheres.iter().for_each(|&s| roots.add(s));
        roots
    }

    fn sphere(&self, row: usize) -> (DVec3, f64) {
        (DVec3::new(self.center[0][row], self.center[1][row], self.center[2][row]), self.radius[row])
    }

    fn add(&mut self, (center, radius): (DVec3, f64)) {
        let row = self.id.len();
        let id = self.row.len() as u32;
        self.id.push(id);
        (0..3).for_each(|k| self.center[k].push(center[k]));
        self.radius.push(radius);
        self.row.push(row as u32);
        self.search(row);
    }

    /// Queues the best partner of `row` among the older roots.
    fn search(&mut self, row: usize) {
        let (center, radius) = self.sphere(row);
        let [x, y, z] = &self.center;
        let mut best = (f64::INFINITY, usize::MAX);
        for other in 0..row {
            let (dx, dy, dz) = (x[other] - center.x, y[other] - center.y, z[other] - center.z);
            let distance = (dx * dx + dy * dy + dz * dz).sqrt();
            let common = common_radius(distance, radius, self.radius[other]);
            if common < best.0 {
                best = (common, other);
            }
        }
        if best.1 != usize::MAX {
            let pair = Pair { radius: best.0.to_bits(), newer: self.id[row], older: self.id[best.1] };
            self.queue.push(Reverse(pair));
        }
    }

    /// The two roots with the smallest common sphere, or none when one root is left.
    fn pop_pair(&mut self) -> Option<(u32, u32)> {
        while let Some(Reverse(pair)) = self.queue.pop() {
            let (newer, older) = (self.row[pair.newer as usize], self.row[pair.older as usize]);
            match (newer, older) {
                (u32::MAX, _) => {}
                (row, u32::MAX) => self.search(row as usize),
                _ => return Some((pair.older, pair.newer)),
            }
        }
        None
    }

    fn merge(&mut self, a: u32, b: u32) {
        let rows = [a, b].map(|id| self.row[id as usize] as usize);
        let merged = enclose(self.sphere(rows[0]), self.sphere(rows[1]));
        for (id, row) in [a, b].into_iter().zip(rows) {
            self.radius[row] = f64::INFINITY;
            self.row[id as usize] = u32::MAX;
        }
        self.dead += 2;
        if self.dead * 4 > self.id.len() {
            self.remove_dead();
        }
        self.add(merged);
    }

    /// Keeps the order, so that older roots still come first.
    fn remove_dead(&mut self) {
        let mut kept = 0;
        for row in 0..self.id.len() {
            if self.radius[row].is_infinite() {
                continue;
            }
            self.id[kept] = self.id[row];
            (0..3).for_each(|k| self.center[k][kept] = self.center[k][row]);
            self.radius[kept] = self.radius[row];
            self.row[self.id[kept] as usize] = kept as u32;
            kept += 1;
        }
        self.id.truncate(kept);
        (0..3).for_each(|k| self.center[k].truncate(kept));
        self.radius.truncate(kept);
        self.dead = 0;
    }
}

/// Radius of the smallest sphere around two spheres whose centres are `distance` apart.
fn common_radius(distance: f64, a: f64, b: f64) -> f64 {
    (0.5 * (distance + a + b)).max(a).max(b)
}

/// The smallest sphere around two.
fn enclose(a: (DVec3, f64), b: (DVec3, f64)) -> (DVec3, f64) {
    let distance = a.0.distance(b.0);
    let radius = common_radius(distance, a.1, b.1);
    match () {
        _ if radius <= a.1 || distance == 0.0 => (a.0, radius),
        _ if radius <= b.1 => (b.0, radius),
        _ => (a.0.lerp(b.0, (radius - a.1) / distance), radius),
    }
}

/// Numbers the nodes parents first, left before right, and the clusters in leaf order.
///
/// Ids below `n` are spheres, `n + i` is the i-th merge.
fn number(spheres: &[(DVec3, f64)], children: &[(u32, u32)]) -> Hierarchy {
    let n = spheres.len();
    let mut order = Vec::with_capacity(n);
    let mut nodes: Vec<NodeRecord> = Vec::with_capacity(2 * n - 1);
    let none = u32::MAX;
    // (merge id, parent node, is it the parent's right child?)
    let mut stack = vec![((n + children.len() - 1) as u32, none, false)];
    while let Some((id, parent, is_right)) = stack.pop() {
        let node = nodes.len() as u32;
        if parent != none {
            let parent = &mut nodes[parent as usize];
            *if is_right { &mut parent.right } else { &mut parent.left } = node;
        }
        nodes.push(NodeRecord { left: none, right: none, first_cluster: order.len() as u32, ..Zeroable::zeroed() });
        match (id as usize).checked_sub(n) {
            None => order.push(id),
            Some(merge) => {
                let (left, right) = children[merge];
                stack.push((right, node, true));
                stack.push((left, node, false));
            }
        }
    }
    for i in (0..nodes.len()).rev() {
        let record = match nodes[i].left {
            u32::MAX => leaf(nodes[i], spheres[order[nodes[i].first_cluster as usize] as usize]),
            left => inner(nodes[i], &nodes[left as usize], &nodes[nodes[i].right as usize]),
        };
        nodes[i] = record;
    }
    Hierarchy { order, nodes }
}

fn leaf(node: NodeRecord, sphere: (DVec3, f64)) -> NodeRecord {
    let center = grid(sphere.0);
    NodeRecord { cluster_count: 1, center, radius: holding(center, &[sphere]), ..node }
}

fn inner(node: NodeRecord, left: &NodeRecord, right: &NodeRecord) -> NodeRecord {
    let sphere = |n: &NodeRecord| (DVec3::from(n.center.map(f64::from)), n.radius as f64);
    let parts = [sphere(left), sphere(right)];
    let center = grid(enclose(parts[0], parts[1]).0);
    let cluster_count = left.cluster_count + right.cluster_count;
    NodeRecord { cluster_count, center, radius: holding(center, &parts), ..node }
}

/// Nearest grid point.
fn grid(p: DVec3) -> [i32; 3] {
    p.to_array().map(|x| x.round() as i32)
}

/// A radius, rounded up, that holds all spheres; exact where one sphere has this centre and an f32 radius.
fn holding(center: [i32; 3], spheres: &[(DVec3, f64)]) -> f32 {
    let center = DVec3::from(center.map(f64::from));
    let reach = |&(c, r): &(DVec3, f64)| match c.distance(center) {
        0.0 => r,
        d => (d + r) * (1.0 + 1e-12),
    };
    let radius = spheres.iter().map(reach).fold(0.0, f64::max);
    let rounded = radius as f32;
    if (rounded as f64) < radius { rounded.next_up() } else { rounded }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spheres in a box, from a small congruential generator.
    fn cloud(n: usize, mut seed: u64) -> Vec<(DVec3, f64)> {
        let mut next = move || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64
        };
        (0..n).map(|_| (DVec3::new(next(), next(), next()), next() / 50.0)).collect()
    }

    /// The paper's rule, word by word: all pairs at each step.
    fn plain_greedy(spheres: &[(DVec3, f64)]) -> Vec<f64> {
        let mut roots = spheres.to_vec();
        let mut radii = Vec::new();
        while roots.len() > 1 {
            let mut best = (f64::INFINITY, 0, 0);
            for i in 0..roots.len() {
                for j in 0..i {
                    let radius = common_radius(roots[i].0.distance(roots[j].0), roots[i].1, roots[j].1);
                    if radius < best.0 {
                        best = (radius, i, j);
                    }
                }
            }
            let (a, b) = (roots[best.2], roots.remove(best.1));
            roots[best.2] = enclose(a, b);
            radii.push(best.0);
        }
        radii
    }

    fn sphere(n: &NodeRecord) -> (DVec3, f64) {
        (DVec3::from(n.center.map(f64::from)), n.radius as f64)
    }

    #[test]
    fn merges_as_the_plain_greedy_rule_does() {
        let spheres = cloud(60, 7);
        let hierarchy = build(&spheres);
        let mut radii: Vec<f64> =
            hierarchy.nodes.iter().filter(|n| n.cluster_count > 1).map(|n| n.radius as f64).collect();
        let mut expected = plain_greedy(&spheres);
        radii.sort_by(f64::total_cmp);
        expected.sort_by(f64::total_cmp);
        for (found, expected) in radii.iter().zip(&expected) {
            assert!((found - expected).abs() < 20.0 + expected * 1e-5, "{found} {expected}");
        }
    }

    #[test]
    fn every_node_holds_its_children_and_every_leaf_its_sphere() {
        let spheres = cloud(500, 3);
        let Hierarchy { order, nodes } = build(&spheres);
        assert_eq!(nodes.len(), 999);
        for n in &nodes {
            let inside = |(c, r): (DVec3, f64)| c.distance(sphere(n).0) + r <= sphere(n).1;
            if n.cluster_count == 1 {
                assert!(inside(spheres[order[n.first_cluster as usize] as usize]));
            } else {
                assert!(inside(sphere(&nodes[n.left as usize])) && inside(sphere(&nodes[n.right as usize])));
            }
        }
    }

    #[test]
    fn subtrees_are_ranges_and_every_sphere_is_one_leaf() {
        let Hierarchy { mut order, nodes } = build(&cloud(300, 9));
        for (i, n) in nodes.iter().enumerate().filter(|(_, n)| n.cluster_count > 1) {
            let (l, r) = (nodes[n.left as usize], nodes[n.right as usize]);
            assert!(n.left as usize > i && n.right as usize > i);
            assert_eq!((l.first_cluster, r.first_cluster), (n.first_cluster, n.first_cluster + l.cluster_count));
            assert_eq!(l.cluster_count + r.cluster_count, n.cluster_count);
        }
        order.sort();
        assert!(order.into_iter().eq(0..300));
    }

    #[test]
    fn one_sphere_and_equal_spheres_work() {
        let one = build(&[(DVec3::ONE, 2.0)]);
        assert_eq!((one.order, one.nodes[0].radius, one.nodes[0].left), (vec![0], 2.0, u32::MAX));
        let same = build(&[(DVec3::ZERO, 1.0); 40]);
        assert_eq!((same.nodes[0].cluster_count, same.nodes[0].radius), (40, 1.0));
    }

    #[test]
    fn errors_rise_towards_the_root() {
        let mut hierarchy = build(&cloud(20, 1));
        let errors: Vec<f32> = (0..20).map(|i| ((i * 7) % 20) as f32).collect();
        hierarchy.set_errors(&errors);
        assert_eq!(hierarchy.nodes[0].error, 19.0);
    }

    #[test]
    fn groups_become_subtrees_and_one_group_is_as_none() {
        let spheres = cloud(90, 11);
        let Hierarchy { order, nodes } = build_groups(&spheres, &[40, 1, 30, 19]);
        assert_eq!(nodes.len(), 179);
        let mut sorted = order.clone();
        sorted.sort();
        assert!(sorted.into_iter().eq(0..90));
        for group in [0..40u32, 40..41, 41..71, 71..90] {
            let is_own = |n: &&NodeRecord| {
                let range = n.first_cluster as usize..(n.first_cluster + n.cluster_count) as usize;
                n.cluster_count as usize == group.len() && order[range].iter().all(|i| group.contains(i))
            };
            assert_eq!(nodes.iter().filter(is_own).count(), 1, "{group:?}");
        }
        for n in nodes.iter().filter(|n| n.cluster_count > 1) {
            let inside = |i: u32| {
                sphere(&nodes[i as usize]).0.distance(sphere(n).0) + sphere(&nodes[i as usize]).1 <= sphere(n).1
            };
            assert!(inside(n.left) && inside(n.right));
        }
        assert_eq!(build(&spheres).order, build_groups(&spheres, &[90]).order);
    }

    #[test]
    fn ten_thousand_spheres_are_no_trouble() {
        assert_eq!(build(&cloud(10_000, 5)).order.len(), 10_000);
    }
}
