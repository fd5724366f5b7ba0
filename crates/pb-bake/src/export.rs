//! Writes meshes for other programs: PLY, OBJ, GLB. A file appears under its name only when it is whole.

mod textured_glb;
mod textured_obj;
mod tile;

use pb_lod::progressive_buffers::layout::Vertex;
use pb_lod::progressive_buffers::model::{Model, ModelError, Placed};
use pb_lod::progressive_buffers::textures::MapKind;
use pb_mesh::mesh::write_ply;
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use tile::TileImage;

pub use pb_mesh::mesh::ExportMesh;

/// Most bytes of a GLB file: its header has 32 bits for them.
const MAX_GLB_BYTES: u64 = u32::MAX as u64;

/// Why a mesh was not written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The name says no format that can be written.
    #[error("{}: the format follows from the name, and this is none of .ply, .obj and .glb; choose one of them", path.display())]
    UnknownFormat {
        /// As given.
        path: PathBuf,
    },
    /// More than a GLB file can hold.
    #[error("{}: the mesh needs {bytes} bytes, more than the 4 GiB of a GLB file; write a coarser level or another format instead", path.display())]
    TooLarge {
        /// As given.
        path: PathBuf,
        /// That the file would have.
        bytes: u64,
    },
    /// More than there are numbers for.
    #[error("{}: the level has {vertices} vertices where all instances stand, more than a mesh can count; write a coarser level instead", path.display())]
    TooManyVertices {
        /// As given.
        path: PathBuf,
        /// Of all instances.
        vertices: u64,
    },
    /// The operating system refuses.
    #[error("{}: cannot be written: {source}; check the folder, its permissions and the space on the disk", path.display())]
    Io {
        /// As given.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The archive is at fault.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExportCounts {
    /// Vertices.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Images, in the file (GLB) or beside it (OBJ).
    pub images: u64,
}

/// Writes one level of a model, in the format of the file's extension. Levels with textures keep them in `.glb` (images
/// inside) and `.obj` (`NAME.mtl` and `NAME_<cluster>.png` beside it); `.ply` gets the colours at the vertices.
///
/// # Errors
/// See [`ExportError`].
///
/// # Panics
/// If there is no such level.
pub fn write_level(path: &Path, model: &Model, level: u32) -> Result<ExportCounts, ExportError> {
    assert!(level < model.levels());
    check_size(path, model, level)?;
    let mesh = match (model.textures(), extension(path).as_deref()) {
        (Some(_), Some("glb")) => return textured_glb::write(path, model, level),
        (Some(_), Some("obj")) => return textured_obj::write(path, model, level),
        (Some(_), Some("ply")) => colored(model, level)?,
        _ => model.export_level(level)?,
    };
    write_mesh(path, &mesh)?;
    Ok(ExportCounts { vertices: mesh.positions.len() as u64, triangles: mesh.triangles.len() as u64, images: 0 })
}

/// Instances are written out, which may be more than a file has numbers for.
fn check_size(path: &Path, model: &Model, level: u32) -> Result<(), ExportError> {
    let of = |p: &Placed| {
        let vertices: u64 = p.clusters.clone().map(|c| u64::from(model.level(c, level).vertices)).sum();
        vertices.saturating_mul(p.placements.len() as u64)
    };
    let vertices = model.placed().iter().map(of).fold(0, u64::saturating_add);
    match vertices < u64::from(u32::MAX) {
        true => Ok(()),
        false => Err(ExportError::TooManyVertices { path: path.to_owned(), vertices }),
    }
}

/// A level with the colours of its tiles at the vertices, where it has any.
fn colored(model: &Model, level: u32) -> Result<ExportMesh, ModelError> {
    if !model.textures().is_some_and(|t| t.maps.iter().any(|m| m.kind() == Some(MapKind::BaseColor))) {
        return model.export_level(level);
    }
    model.export_level_colored(level, &mut |cluster, vertices: &[Vertex]| {
        let image = TileImage::read(model, cluster, level, MapKind::BaseColor)?;
        let color = |v: &Vertex| image.as_ref().map_or([255; 4], |i| i.nearest(v.uv()));
        Ok(vertices.iter().map(color).collect())
    })
}

fn extension(path: &Path) -> Option<String> {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase())
}

/// Writes a mesh in the format of the file's extension: `.ply` (binary, double positions), `.obj` (text, all digits),
/// `.glb` (single precision around a node's translation, so that large coordinates keep their detail).
///
/// # Errors
/// See [`ExportError`]; then nothing is left behind, and a file that was there stays as it was.
pub fn write_mesh(path: &Path, mesh: &ExportMesh) -> Result<(), ExportError> {
    let extension = extension(path);
    let write: fn(&mut dyn Write, &ExportMesh) -> io::Result<()> = match extension.as_deref() {
        Some("ply") => |mut out, mesh| write_ply(&mut out, mesh),
        Some("obj") => |mut out, mesh| write_obj(&mut out, mesh),
        Some("glb") => |mut out, mesh| write_glb(&mut out, mesh),
        _ => return Err(ExportError::UnknownFormat { path: path.to_owned() }),
    };
    let bytes = glb_layout(mesh).file_bytes;
    if extension.as_deref() == Some("glb") && bytes > MAX_GLB_BYTES {
        return Err(ExportError::TooLarge { path: path.to_owned(), bytes });
    }
    replace(path, |out| write(out, mesh))
}

/// Writes a file that appears under its name when it is whole.
fn replace(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), ExportError> {
    let io = |source| ExportError::Io { path: path.to_owned(), source };
    let file = temporary_in(folder_of(path)).map_err(io)?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    write(&mut out).map_err(io)?;
    let file = out.into_inner().map_err(|e| io(e.into_error()))?;
    file.as_file().sync_all().map_err(io)?;
    file.persist(path).map_err(|e| io(e.error))?;
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file of another name, readable like any other once it has its own.
fn temporary_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".pb-export-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

fn write_obj(out: &mut impl Write, mesh: &ExportMesh) -> io::Result<()> {
    let colors = mesh.colors.as_deref().unwrap_or(&[]);
    for (i, [x, y, z]) in mesh.positions.iter().enumerate() {
        write!(out, "v {x} {y} {z}")?;
        if let Some(color) = colors.get(i) {
            let [r, g, b, _] = color.map(|c| f64::from(c) / 255.0);
            write!(out, " {r:.6} {g:.6} {b:.6}")?;
        }
        writeln!(out)?;
    }
    for [x, y, z] in &mesh.normals {
        writeln!(out, "vn {x} {y} {z}")?;
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| u64::from(i) + 1);
        if mesh.normals.is_empty() {
            writeln!(out, "f {a} {b} {c}")?;
        } else {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
    }
    Ok(())
}

/// Sizes of the parts of a GLB file; all multiples of four.
struct GlbLayout {
    position_bytes: u64,
    normal_bytes: u64,
    color_bytes: u64,
    index_bytes: u64,
    /// Ample for the JSON chunk and the headers.
    file_bytes: u64,
}

fn glb_layout(mesh: &ExportMesh) -> GlbLayout {
    const JSON_BYTES: u64 = 4096;
    let position_bytes = 12 * mesh.positions.len() as u64;
    let normal_bytes = 12 * mesh.normals.len() as u64;
    let color_bytes = 8 * mesh.colors.as_ref().map_or(0, Vec::len) as u64;
    let index_bytes = 12 * mesh.triangles.len() as u64;
    let file_bytes = position_bytes + normal_bytes + color_bytes + index_bytes + JSON_BYTES;
    GlbLayout { position_bytes, normal_bytes, color_bytes, index_bytes, file_bytes }
}

fn write_glb(out: &mut impl Write, mesh: &ExportMesh) -> io::Result<()> {
    let layout = glb_layout(mesh);
    let translation = center(&mesh.positions);
    let local: Vec<[f32; 3]> =
        mesh.positions.iter().map(|p| std::array::from_fn(|k| (p[k] - translation[k]) as f32)).collect();
    let mut json = serde_json::to_vec(&glb_document(mesh, &layout, translation, &local))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = layout.position_bytes + layout.normal_bytes + layout.color_bytes + layout.index_bytes;
    out.write_all(b"glTF")?;
    for word in [2, 12 + 8 + json.len() as u64 + 8 + binary, json.len() as u64] {
        // The caller has refused what does not fit.
        out.write_all(&(word as u32).to_le_bytes())?;
    }
    out.write_all(b"JSON")?;
    out.write_all(&json)?;
    out.write_all(&(binary as u32).to_le_bytes())?;
    out.write_all(b"BIN\0")?;
    out.write_all(bytemuck::cast_slice(&local))?;
    out.write_all(bytemuck::cast_slice(&mesh.normals))?;
    for color in mesh.colors.iter().flatten() {
        out.write_all(bytemuck::cast_slice(&linear(*color)))?;
    }
    out.write_all(bytemuck::cast_slice(&mesh.triangles))
}

/// The middle of the bounds, rounded to single precision: readers that have no more still place the mesh exactly.
fn center(positions: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let low = positions.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = positions.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        let middle = f64::from((low / 2.0 + high / 2.0) as f32);
        if middle.is_finite() { middle } else { 0.0 }
    })
}

fn glb_document(mesh: &ExportMesh, layout: &GlbLayout, translation: [f64; 3], local: &[[f32; 3]]) -> serde_json::Value {
    use serde_json::json;
    const FLOAT: u32 = 5126;
    const UNSIGNED_SHORT: u32 = 5123;
    const UNSIGNED_INT: u32 = 5125;
    const VERTICES: u32 = 34962;
    const INDICES: u32 = 34963;
    let bound = |start: f32, pick: fn(f32, f32) -> f32| -> [f32; 3] {
        std::array::from_fn(|k| local.iter().map(|p| p[k]).fold(start, pick))
    };
    let count = mesh.positions.len();
    let (mut views, mut accessors, mut attributes) = (Vec::new(), Vec::new(), serde_json::Map::new());
    let mut offset = 0;
    let mut view = |bytes: u64, target: u32| {
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": target }));
        offset += bytes;
        views.len() - 1
    };
    let position = view(layout.position_bytes, VERTICES);
    accessors.push(json!({
        "bufferView": position, "componentType": FLOAT, "count": count, "type": "VEC3",
        "min": bound(f32::INFINITY, f32::min), "max": bound(f32::NEG_INFINITY, f32::max),
    }));
    attributes.insert("POSITION".into(), json!(0));
    if layout.normal_bytes > 0 {
        let normal = view(layout.normal_bytes, VERTICES);
        attributes.insert("NORMAL".into(), json!(accessors.len()));
        accessors.push(json!({ "bufferView": normal, "componentType": FLOAT, "count": count, "type": "VEC3" }));
    }
    if layout.color_bytes > 0 {
        let color = view(layout.color_bytes, VERTICES);
        attributes.insert("COLOR_0".into(), json!(accessors.len()));
        accessors.push(json!({
            "bufferView": color, "componentType": UNSIGNED_SHORT, "normalized": true, "count": count, "type": "VEC4",
        }));
    }
    let index = view(layout.index_bytes, INDICES);
    let indices = accessors.len();
    accessors.push(json!({
        "bufferView": index, "componentType": UNSIGNED_INT, "count": 3 * mesh.triangles.len(), "type": "SCALAR",
    }));
    json!({
        "asset": { "version": "2.0", "generator": "pb-bake" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": translation }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": offset }],
    })
}

/// sRGB bytes to linear, as glTF wants vertex colours; 16 bits keep all 256 shades apart.
fn linear([r, g, b, a]: [u8; 4]) -> [u16; 4] {
    let curve = |byte: u8| {
        let x = f64::from(byte) / 255.0;
        let y = if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) };
        (y * 65535.0).round() as u16
    };
    [curve(r), curve(g), curve(b), u16::from(a) * 257]
}
