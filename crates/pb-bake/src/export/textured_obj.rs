//! A level with its textures as OBJ, MTL and one PNG per cluster. The OBJ appears last, so whoever finds it finds all.

use super::tile::{Part, TileImage};
use super::{ExportCounts, ExportError, replace};
use glam::Vec3;
use pb_lod::progressive_buffers::instances::Placement;
use pb_lod::progressive_buffers::model::{Model, Placed};
use pb_lod::progressive_buffers::textures::MapKind;
use std::io::{self, Write};
use std::path::Path;

/// Writes `NAME.obj`, `NAME.mtl` and `NAME_<cluster>.png`.
pub(super) fn write(path: &Path, model: &Model, level: u32) -> Result<ExportCounts, ExportError> {
    let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let mut counts = ExportCounts::default();
    let mut materials = String::new();
    for cluster in 0..model.record().clusters {
        materials += &format!("newmtl cluster_{cluster}\nKd 1 1 1\n");
        if let Some(image) = TileImage::read(model, cluster, level, MapKind::BaseColor)? {
            let name = format!("{stem}_{cluster}.png");
            let file = path.with_file_name(&name);
            let png = image.png(model.has_cutouts()).map_err(|source| io_error(&file, source))?;
            replace(&file, |out| out.write_all(&png))?;
            // Charts reach up to the edges of a tile: without it, readers repeat the image there.
            materials += &format!("map_Kd -clamp on {name}\n");
            if model.has_cutouts() {
                materials += &format!("map_d -clamp on -imfchan m {name}\n");
            }
            counts.images += 1;
        }
    }
    replace(&path.with_extension("mtl"), |out| out.write_all(materials.as_bytes()))?;
    let mut fault = None;
    let written = replace(path, |out| {
        writeln!(out, "mtllib {stem}.mtl")?;
        for Placed { clusters, placements } in model.placed() {
            for cluster in clusters {
                let part = Part::read(model, cluster, level).map_err(|e| {
                    fault = Some(e);
                    io::Error::other("the archive is at fault")
                })?;
                for placement in &placements {
                    write_part(out, model, (cluster, placement), &part, counts.vertices + 1)?;
                    counts.vertices += part.grid.len() as u64;
                    counts.triangles += part.triangles.len() as u64;
                }
            }
        }
        Ok(())
    });
    match fault {
        Some(fault) => Err(fault.into()),
        None => written.map(|()| counts),
    }
}

fn write_part(
    out: &mut dyn Write,
    model: &Model,
    (cluster, placement): (u32, &Placement),
    part: &Part,
    first: u64,
) -> io::Result<()> {
    for &grid in &part.grid {
        let [x, y, z] = model.world_of(grid, placement).to_array();
        writeln!(out, "v {x} {y} {z}")?;
    }
    for normal in &part.normals {
        let [x, y, z] = turned(placement, *normal);
        writeln!(out, "vn {x} {y} {z}")?;
    }
    for [u, v] in &part.uvs {
        writeln!(out, "vt {u} {}", 1.0 - v)?;
    }
    writeln!(out, "usemtl cluster_{cluster}")?;
    for triangle in &part.triangles {
        let [a, b, c] = triangle.map(|i| u64::from(i) + first);
        writeln!(out, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}")?;
    }
    Ok(())
}

fn turned(placement: &Placement, normal: [f32; 3]) -> [f32; 3] {
    match *placement == Placement::IDENTITY {
        true => normal,
        false => (placement.rotation.as_quat() * Vec3::from(normal)).to_array(),
    }
}

fn io_error(path: &Path, source: io::Error) -> ExportError {
    ExportError::Io { path: path.to_owned(), source }
}
