//! The displayed surface of a frame: every cluster walked, morphed and welded (design section 3).
//!
//! What `--export-view` writes and what the crack tests check: the same f32 arithmetic as the shader, through
//! the twin in [`super::display`]. Vertices are joined only where all bits of their positions are equal, so a
//! gap of one rounding error shows up as an unmatched edge.

use std::collections::HashMap;

use glam::DVec3;

use super::display::{ClusterView, GridEye, LodTable};
use super::instances::Placement;
use super::layout::Vertex;

/// One cluster with the data of its drawn level.
#[derive(Clone, Debug)]
pub struct DrawnCluster {
    /// Grid origin.
    pub origin: [i32; 3],
    /// Offsets are multiples of `2^shift` quanta.
    pub shift: u32,
    /// `n_i` per level.
    pub counts: Vec<u32>,
    /// Neighbouring clusters, by border slot - 1.
    pub neighbours: Vec<u32>,
    /// Level whose index buffer is drawn.
    pub level: u32,
    /// Vertices `[0, n_level)`.
    pub vertices: Vec<Vertex>,
    /// Triangle list of `level`.
    pub indices: Vec<u16>,
}

/// A welded triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Positions relative to the eye, world units; no two are equal in all bits.
    pub positions: Vec<[f32; 3]>,
    /// RGBA, sRGB, of one of the vertices at each position.
    pub colors: Vec<[u8; 4]>,
    /// Vertex indices; triangles that the walk collapsed to an edge or a point are left out.
    pub triangles: Vec<[u32; 3]>,
}

/// The surface that `clusters` show to `eye` when cluster c uses `tables[c]`. Where they are those of one object, neighbours
/// count from its first cluster, and eye and surface are in its space.
pub fn displayed_surface(clusters: &[DrawnCluster], tables: &[LodTable], eye: &GridEye) -> Surface {
    assert_eq!(clusters.len(), tables.len(), "one table per cluster");
    let mut welder = Welder::default();
    for (index, cluster) in clusters.iter().enumerate() {
        let neighbours: Vec<(u32, LodTable)> = cluster.neighbours.iter().map(|&n| (n, tables[n as usize])).collect();
        let view = ClusterView {
            origin: cluster.origin,
            shift: cluster.shift,
            counts: &cluster.counts,
            vertices: &cluster.vertices,
            cluster: index as u32,
            table: &tables[index],
            neighbours: &neighbours,
        };
        welder.add(cluster, &view, eye);
    }
    welder.surface
}

#[derive(Default)]
struct Welder {
    surface: Surface,
    /// Bits of a position -> its index.
    seen: HashMap<[u32; 3], u32>,
}

impl Welder {
    fn add(&mut self, cluster: &DrawnCluster, view: &ClusterView, eye: &GridEye) {
        let count = cluster.counts[cluster.level as usize];
        let welded: Vec<u32> = (0..count).map(|v| self.weld(view, v, cluster.level, eye)).collect();
        for corner in cluster.indices.chunks_exact(3) {
            let [a, b, c] = [corner[0], corner[1], corner[2]].map(|i| welded[i as usize]);
            if a != b && b != c && c != a {
                self.surface.triangles.push([a, b, c]);
            }
        }
    }

    fn weld(&mut self, view: &ClusterView, vertex: u32, level: u32, eye: &GridEye) -> u32 {
        let shown = view.display(vertex, level, eye);
        let position = shown.position.map(|x| x + 0.0); // -0 and 0 are the same place
        *self.seen.entry(position.map(f32::to_bits)).or_insert_with(|| {
            self.surface.positions.push(position);
            self.surface.colors.push(shown.color.map(|c| (c * 255.0).round() as u8));
            self.surface.positions.len() as u32 - 1
        })
    }
}

impl Surface {
    /// Appends another surface, as it is seen from the same eye in the world: turned and scaled.
    pub fn append(&mut self, other: Surface, placement: &Placement) {
        let first = self.positions.len() as u32;
        let placed = |p: &[f32; 3]| match *placement == Placement::IDENTITY {
            true => *p,
            false => (placement.rotation * DVec3::from(p.map(f64::from)) * placement.scale).as_vec3().to_array(),
        };
        self.positions.extend(other.positions.iter().map(placed));
        self.colors.extend(other.colors);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    /// Directed edges whose opposite does not occur as often: 0 for a closed surface, whatever its shape.
    pub fn unmatched_edges(&self) -> usize {
        let edges = self.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        // (smaller end, larger end, direction): an edge is matched when its directions cancel.
        let mut edges: Vec<(u32, u32, i64)> = edges.map(|(a, b)| if a < b { (a, b, 1) } else { (b, a, -1) }).collect();
        edges.sort_unstable();
        edges
            .chunk_by(|x, y| (x.0, x.1) == (y.0, y.1))
            .map(|run| run.iter().map(|e| e.2).sum::<i64>().unsigned_abs() as usize)
            .sum()
    }
}

#[cfg(test)]
mod tests;
