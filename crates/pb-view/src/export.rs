//! `--export-view`: the surface that a frame shows, written as PLY.
//!
//! All clusters, also those outside the picture, each at the level that its distance gives; so a closed model
//! gives a closed surface. Positions are joined where they are equal in all bits, and nowhere else.

use anyhow::{Context, Result};
use glam::DVec3;
use pb_lod::plan::{Detail, View};
use pb_lod::progressive_buffers::display::{GridEye, LodTable};
use pb_lod::progressive_buffers::displayed_surface::{DrawnCluster, Surface, displayed_surface};
use pb_lod::progressive_buffers::instances::Placement;
use pb_lod::progressive_buffers::layout::ModelRecord;
use pb_lod::progressive_buffers::model::{Model, ModelError, Placed};
use pb_lod::progressive_buffers::select::Selector;
use pb_lod::progressive_buffers::switch::Switch;
use pb_render::grid_eye;
use std::io::Write;
use std::path::Path;

/// What a frame shows, as far as the display rule goes.
pub struct ShownFrame<'a> {
    /// The archive.
    pub model: &'a Model,
    /// With the floors of this frame.
    pub selector: &'a Selector,
    /// The frame's camera.
    pub view: View,
    /// The frame's detail, after all budgets.
    pub detail: Detail,
    /// The camera on the model's grid.
    pub eye: GridEye,
}

impl ShownFrame<'_> {
    /// The surface, by the Rust twin of the vertex shader. Fails when a chunk cannot be read.
    pub fn surface(&self) -> Result<Surface, ModelError> {
        let model = self.model;
        let switch = Switch::new(self.detail, self.view.pixel_angle, model.record().quantum);
        let origin = DVec3::from(model.record().origin);
        let mut surface = Surface::default();
        for Placed { clusters, placements } in model.placed() {
            for placement in &placements {
                let stretch = if switch.bands.is_some() { placement.scale as f32 } else { 1.0 };
                let table = |c| self.selector.lod_table(c, &switch).at_scale(stretch);
                let tables: Vec<LodTable> = clusters.clone().map(table).collect();
                let drawn: Result<Vec<DrawnCluster>, ModelError> =
                    clusters.clone().map(|c| self.cluster(c, clusters.start, placement)).collect();
                let eye = match *placement == Placement::IDENTITY {
                    true => self.eye,
                    false => grid_eye(model.record(), placement.point_of(self.view.eye - origin) + origin),
                };
                surface.append(displayed_surface(&drawn?, &tables, &eye), placement);
            }
        }
        if model.textures().is_some() {
            // Vertices of textured models have texture coordinates where others have colours.
            surface.colors.fill([255; 4]);
        }
        Ok(surface)
    }

    /// A cluster of an instance; neighbours count from the object's first cluster.
    fn cluster(&self, cluster: u32, first: u32, placement: &Placement) -> Result<DrawnCluster, ModelError> {
        let model = self.model;
        let level = self.selector.drawn_level(cluster, &self.view, self.detail, placement);
        let prefix = model.read_prefix(cluster, level)?;
        let record = &model.clusters()[cluster as usize];
        Ok(DrawnCluster {
            origin: record.origin,
            shift: record.shift,
            counts: (0..model.levels()).map(|l| model.level(cluster, l).vertices).collect(),
            neighbours: model.neighbours(cluster).iter().map(|n| n - first).collect(),
            level,
            vertices: prefix.vertices,
            indices: prefix.indices,
        })
    }
}

/// Writes a surface around `eye` as binary PLY, in world space, double precision.
pub fn write_ply(path: &Path, surface: &Surface, eye: &GridEye, model: &ModelRecord) -> Result<()> {
    let bytes = ply(surface, eye, model);
    let context = || format!("{}: cannot write the surface", path.display());
    let mut file = std::fs::File::create(path).with_context(context)?;
    file.write_all(&bytes).with_context(context)
}

fn ply(surface: &Surface, eye: &GridEye, model: &ModelRecord) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\ncomment the surface shown by one frame\nelement vertex {}\n\
         property double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        surface.positions.len(),
        surface.triangles.len()
    )
    .into_bytes();
    let at: [f64; 3] =
        std::array::from_fn(|k| model.origin[k] + eye.cell[k] as f64 * model.quantum + eye.rest[k] as f64);
    for (position, color) in surface.positions.iter().zip(&surface.colors) {
        for (p, at) in position.iter().zip(at) {
            out.extend((at + *p as f64).to_le_bytes());
        }
        out.extend(color);
    }
    for triangle in &surface.triangles {
        out.push(3);
        out.extend(triangle.iter().flat_map(|&i| (i as i32).to_le_bytes()));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn positions_are_written_in_world_space() {
        let surface = Surface {
            positions: vec![[0.5, 0.0, -1.0]; 3],
            colors: vec![[1, 2, 3, 255]; 3],
            triangles: vec![[0, 1, 2]],
        };
        let eye = GridEye { cell: [4, 0, 0], rest: [0.25, 0.0, 0.0], quantum: 0.5 };
        let model = ModelRecord { origin: [500_000.0, 0.0, 0.0], quantum: 0.5, ..ModelRecord::zeroed() };
        let bytes = ply(&surface, &eye, &model);
        let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        assert_eq!(bytes.len() - body, 3 * 28 + 13);
        let x = f64::from_le_bytes(bytes[body..body + 8].try_into().unwrap());
        assert_eq!(x, 500_002.75);
    }
}
