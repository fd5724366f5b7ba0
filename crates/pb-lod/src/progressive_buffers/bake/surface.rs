//! The mesh in the order of its clusters: the triangles of a cluster lie together, and so do its positions and wedges.
//! Whatever works on one cluster and its neighbours then touches a few runs of memory, wherever the input had them.

use pb_mesh::mesh::{Mesh, Texturing, Wedge};
use pb_mesh::objects::Objects;
use pb_mesh::segment::Segmentation;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// A [`Mesh`] whose positions are somewhere else.
pub(super) struct Surface {
    /// Position indices.
    pub triangles: Vec<[u32; 3]>,
    /// Wedge indices, where they are others than those of positions.
    wedge_corners: Option<Vec<[u32; 3]>>,
    /// Ordered by position.
    pub wedges: Vec<Wedge>,
    pub has_colors: bool,
    pub texturing: Option<Texturing>,
    /// By position, in the order of the input; nothing is left of them once the surface is cut.
    pub objects: Objects,
}

impl Surface {
    /// Takes a mesh apart: the surface, and its positions.
    pub(super) fn new(mesh: Mesh) -> (Surface, Vec<[f64; 3]>) {
        let Mesh { positions, wedges, triangles, has_colors, texturing, objects } = mesh;
        let (triangles, wedge_corners) = match wedges.len() == positions.len() {
            true => (triangles, None),
            false => {
                let position = |t: &[u32; 3]| t.map(|w| wedges[w as usize].position);
                (triangles.par_iter().map(position).collect(), Some(triangles))
            }
        };
        (Surface { triangles, wedge_corners, wedges, has_colors, texturing, objects }, positions)
    }

    /// Wedge indices of all triangles.
    pub(super) fn corners(&self) -> &[[u32; 3]] {
        self.wedge_corners.as_deref().unwrap_or(&self.triangles)
    }

    /// Puts triangles, positions and wedges in the order of the clusters; a position belongs to the first cluster that uses
    /// it. The order inside of a cluster is that of the triangles and of their corners.
    pub(super) fn arrange(&mut self, positions: &mut Vec<[f64; 3]>, segmentation: &mut Segmentation) {
        let order = std::mem::take(&mut segmentation.order);
        gather(&mut self.triangles, &order);
        self.wedge_corners.iter_mut().for_each(|list| gather(list, &order));
        if let Some(texturing) = &mut self.texturing {
            gather(&mut texturing.material_of, &order);
            texturing.corner_uvs.iter_mut().for_each(|list| gather(list, &order));
        }
        segmentation.order = (0..order.len() as u32).collect();
        drop(order);

        let uses = Order::of_positions(positions.len(), &self.triangles, segmentation);
        gather(positions, &uses.old_of);
        gather(&mut segmentation.components, &uses.old_of);
        segmentation.components.par_iter_mut().for_each(|v| *v = uses.new_of[*v as usize]);
        self.triangles.par_iter_mut().for_each(|t| *t = t.map(|v| uses.new_of[v as usize]));
        match &mut self.wedge_corners {
            None => gather(&mut self.wedges, &uses.old_of),
            Some(corners) => {
                let order = uses.of_wedges(&self.wedges);
                corners.par_iter_mut().for_each(|t| *t = t.map(|w| order.new_of[w as usize]));
                gather(&mut self.wedges, &order.old_of);
            }
        }
        self.wedges.par_iter_mut().for_each(|w| w.position = uses.new_of[w.position as usize]);
    }
}

fn gather<T: Copy + Send + Sync>(list: &mut Vec<T>, old_of: &[u32]) {
    *list = old_of.par_iter().map(|&old| list[old as usize]).collect();
}

/// A new order of items, both ways.
struct Order {
    old_of: Vec<u32>,
    new_of: Vec<u32>,
}

impl Order {
    /// Positions by their first use. The triangles are in the order of the clusters.
    fn of_positions(positions: usize, triangles: &[[u32; 3]], segmentation: &Segmentation) -> Order {
        /// Marks positions that their cluster has listed.
        const LISTED: u32 = u32::MAX;
        let corners = |c: usize| {
            let (from, to) = (segmentation.starts[c] as usize, segmentation.starts[c + 1] as usize);
            triangles[from..to].as_flattened()
        };
        let owners: Vec<AtomicU32> = (0..positions).into_par_iter().map(|_| AtomicU32::new(LISTED)).collect();
        (0..segmentation.len()).into_par_iter().for_each(|c| {
            corners(c).iter().for_each(|&v| {
                owners[v as usize].fetch_min(c as u32, Ordering::Relaxed);
            });
        });
        // Only the owner writes here, so nothing depends on the order of the clusters.
        let list = |c: usize| {
            let is_new = |v: &u32| {
                let own = owners[*v as usize].load(Ordering::Relaxed) == c as u32;
                if own {
                    owners[*v as usize].store(LISTED, Ordering::Relaxed);
                }
                own
            };
            corners(c).iter().copied().filter(is_new).collect::<Vec<u32>>()
        };
        let old_of: Vec<u32> = (0..segmentation.len()).into_par_iter().flat_map_iter(list).collect();
        debug_assert_eq!(old_of.len(), positions, "every position is used");
        Order::from_old(old_of)
    }

    /// Wedges in the order of their positions.
    fn of_wedges(&self, wedges: &[Wedge]) -> Order {
        let mut starts = vec![0u32; self.new_of.len() + 1];
        wedges.iter().for_each(|w| starts[w.position as usize + 1] += 1);
        (0..self.new_of.len()).for_each(|p| starts[p + 1] += starts[p]);
        let run = |&old: &u32| starts[old as usize]..starts[old as usize + 1];
        Order::from_old(self.old_of.par_iter().flat_map_iter(run).collect())
    }

    fn from_old(old_of: Vec<u32>) -> Order {
        let new_of: Vec<AtomicU32> = (0..old_of.len()).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        old_of.par_iter().enumerate().for_each(|(new, &old)| new_of[old as usize].store(new as u32, Ordering::Relaxed));
        Order { old_of, new_of: new_of.into_par_iter().map(AtomicU32::into_inner).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb_mesh::segment::segment;

    /// A strip of quads; triangles and positions shuffled by multiplication, two wedges at every third position.
    fn strip() -> Mesh {
        const QUADS: usize = 300;
        let count = 2 * (QUADS + 1);
        let shuffled = |i: usize| (i * 211 + 5) % count;
        let mut positions = vec![[0.0; 3]; count];
        (0..count).for_each(|i| positions[shuffled(i)] = [(i / 2) as f64, (i % 2) as f64, (i % 5) as f64]);
        let mut firsts = Vec::new();
        let mut wedges = Vec::new();
        for p in 0..count {
            firsts.push(wedges.len() as u32);
            let wedge = |side: f32| Wedge { position: p as u32, normal: [p as f32, side, 0.0], color: [255; 4] };
            wedges.extend((0..1 + usize::from(p % 3 == 0)).map(|side| wedge(side as f32)));
        }
        let last = |p: usize| firsts.get(p + 1).map_or(wedges.len() as u32, |&f| f) - 1;
        let quads = (0..QUADS).map(|i| i * 97 % QUADS);
        let triangles = quads.flat_map(|q| {
            let [a, b, c, d] = [2 * q, 2 * q + 1, 2 * q + 2, 2 * q + 3].map(shuffled);
            [[firsts[a], firsts[c], firsts[b]], [last(b), last(c), last(d)]]
        });
        let triangles = triangles.collect();
        Mesh { positions, wedges, triangles, ..Mesh::default() }
    }

    /// Triangles as (position, normal) of their corners, sorted.
    fn shape(positions: &[[f64; 3]], wedges: &[Wedge], triangles: &[[u32; 3]]) -> Vec<String> {
        let corner = |&w: &u32| {
            let wedge = &wedges[w as usize];
            format!("{:?} {:?}", positions[wedge.position as usize], wedge.normal)
        };
        let mut list: Vec<String> =
            triangles.iter().map(|t| t.iter().map(corner).collect::<Vec<_>>().join("; ")).collect();
        list.sort();
        list
    }

    #[test]
    fn a_surface_in_the_order_of_its_clusters_is_the_same_and_each_cluster_lies_together() {
        let mesh = strip();
        let before = shape(&mesh.positions, &mesh.wedges, &mesh.triangles);
        let (mut surface, mut positions) = Surface::new(mesh);
        let mut segmentation = segment(&positions, &surface.triangles, surface.corners(), 40);
        surface.arrange(&mut positions, &mut segmentation);
        assert_eq!(shape(&positions, &surface.wedges, surface.corners()), before);
        let expected: Vec<[u32; 3]> =
            surface.corners().iter().map(|t| t.map(|w| surface.wedges[w as usize].position)).collect();
        assert_eq!(surface.triangles, expected);
        assert!(surface.wedges.is_sorted_by_key(|w| w.position));
        let mut next = 0;
        for c in 0..segmentation.len() {
            for &v in segmentation.cluster(c).iter().flat_map(|&t| &surface.triangles[t as usize]) {
                assert!(v <= next, "position {v} before its turn");
                next = next.max(v + 1);
            }
        }
        assert_eq!(next as usize, positions.len());
        assert!(segmentation.components.iter().all(|&c| c == segmentation.components[0]), "one component");
    }
}
