//! One level of the whole model as a plain mesh, for other programs and for checks.

use super::instances::Placement;
use super::layout::Vertex;
use super::model::{Model, ModelError, Placed};
use glam::DVec3;
use pb_mesh::mesh::ExportMesh;
use std::collections::HashMap;
use std::ops::Range;

/// Colours (sRGB, straight alpha) for vertices of a cluster, one each.
pub type VertexColors<'a> = &'a mut dyn FnMut(u32, &[Vertex]) -> Result<Vec<[u8; 4]>, ModelError>;

impl Model {
    /// All clusters at one level, welded: one vertex per grid position of an instance, in order of first use by the
    /// clusters in file order, instance after instance; normals and colours of the records at a position are averaged.
    ///
    /// # Panics
    /// If there is no such level.
    pub fn export_level(&self, level: u32) -> Result<ExportMesh, ModelError> {
        let mut stored = |_: u32, vertices: &[Vertex]| Ok(vertices.iter().map(|v| v.color).collect());
        self.weld_level(level, self.has_colors().then_some(&mut stored as VertexColors))
    }

    /// The same with colours that the caller finds, for models that have them in textures.
    ///
    /// # Panics
    /// If there is no such level, or there are fewer colours than vertices.
    pub fn export_level_colored(&self, level: u32, colors: VertexColors) -> Result<ExportMesh, ModelError> {
        self.weld_level(level, Some(colors))
    }

    fn weld_level(&self, level: u32, mut colors: Option<VertexColors>) -> Result<ExportMesh, ModelError> {
        assert!(level < self.levels());
        let mut mesh = ExportMesh { colors: colors.is_some().then(Vec::new), ..ExportMesh::default() };
        for Placed { clusters, placements } in self.placed() {
            let (welder, triangles) = self.weld_clusters(level, clusters, &mut colors)?;
            for placement in &placements {
                let first = mesh.positions.len() as u32;
                mesh.positions.extend(welder.grid.iter().map(|&g| self.world_of(g, placement).to_array()));
                mesh.normals.extend(welder.sums.iter().map(|s| turned(placement, normalized(s.normal))));
                if let Some(colors) = &mut mesh.colors {
                    colors.extend(welder.sums.iter().map(|s| s.color.map(|c| rounded(c, s.records))));
                }
                mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first)));
            }
        }
        Ok(mesh)
    }

    /// Some clusters at one level; triangles count the welder's positions.
    fn weld_clusters(
        &self,
        level: u32,
        clusters: Range<u32>,
        colors: &mut Option<VertexColors>,
    ) -> Result<(Welder, Vec<[u32; 3]>), ModelError> {
        let (mut welder, mut triangles) = (Welder::default(), Vec::new());
        for cluster in clusters {
            let prefix = self.read_prefix(cluster, level)?;
            let colors = match colors {
                Some(colors) => colors(cluster, &prefix.vertices)?,
                None => vec![[255; 4]; prefix.vertices.len()],
            };
            let mut place = vec![u32::MAX; prefix.vertices.len()];
            let mut corner = |i: u16| {
                if place[i as usize] == u32::MAX {
                    let v = &prefix.vertices[i as usize];
                    place[i as usize] = welder.add(self.grid(cluster, v), v.normal(), colors[i as usize]);
                }
                place[i as usize]
            };
            triangles.extend(prefix.indices.chunks_exact(3).map(|t| [corner(t[0]), corner(t[1]), corner(t[2])]));
        }
        Ok((welder, triangles))
    }
}

fn turned(placement: &Placement, normal: [f32; 3]) -> [f32; 3] {
    match *placement == Placement::IDENTITY {
        true => normal,
        false => (placement.rotation * DVec3::from(normal.map(f64::from))).as_vec3().to_array(),
    }
}

/// Sums over the records that share a position.
#[derive(Default)]
struct Sum {
    normal: [f32; 3],
    color: [u32; 4],
    records: u32,
}

/// Finds equal positions. The map is only looked up, never walked, so its order is of no matter.
#[derive(Default)]
struct Welder {
    index: HashMap<[i32; 3], u32>,
    grid: Vec<[i32; 3]>,
    sums: Vec<Sum>,
}

impl Welder {
    fn add(&mut self, grid: [i32; 3], normal: [f32; 3], color: [u8; 4]) -> u32 {
        let next = self.grid.len() as u32;
        let index = *self.index.entry(grid).or_insert(next);
        if index == next {
            self.grid.push(grid);
            self.sums.push(Sum::default());
        }
        let sum = &mut self.sums[index as usize];
        sum.normal.iter_mut().zip(normal).for_each(|(s, n)| *s += n);
        sum.color.iter_mut().zip(color).for_each(|(s, c)| *s += c as u32);
        sum.records += 1;
        index
    }
}

fn normalized(n: [f32; 3]) -> [f32; 3] {
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    if length > 1e-6 { n.map(|x| x / length) } else { [0.0, 0.0, 1.0] }
}

fn rounded(sum: u32, records: u32) -> u8 {
    ((sum + records / 2) / records) as u8
}
