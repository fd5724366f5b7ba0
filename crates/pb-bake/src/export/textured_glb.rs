//! A level with its textures as GLB (glTF 2.0): a primitive, a material and its images per cluster, a mesh per object, a
//! node per instance. The binary part is
//! written to a temporary file first, one cluster in memory at a time, because the header says its size.

use super::tile::{Part, TileImage};
use super::{ExportCounts, ExportError, MAX_GLB_BYTES, folder_of, replace, temporary_in};
use pb_lod::progressive_buffers::instances::Placement;
use pb_lod::progressive_buffers::model::{Model, Placed};
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, MapRecord};
use serde_json::{Map, Value, json};
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// Writes the file; all maps, embedded as PNG.
pub(super) fn write(path: &Path, model: &Model, level: u32) -> Result<ExportCounts, ExportError> {
    let io = |source| ExportError::Io { path: path.to_owned(), source };
    let binary = temporary_in(folder_of(path)).map_err(io)?;
    let mut glb = Glb::new(BufWriter::with_capacity(1 << 20, binary), model);
    for Placed { clusters, placements } in model.placed() {
        for cluster in clusters {
            let part = Part::read(model, cluster, level)?;
            if part.triangles.is_empty() {
                continue;
            }
            let mut images = Vec::new();
            for kind in MapKind::ALL.into_iter().filter(|&kind| is_written(model, kind)) {
                images.push((kind, TileImage::read(model, cluster, level, kind)?));
            }
            glb.add(&part, &images).map_err(io)?;
        }
        glb.place(&placements);
    }
    let mut json = serde_json::to_vec(&glb.document()).map_err(|e| io(e.into()))?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let (bytes, counts) = (12 + 8 + json.len() as u64 + 8 + glb.offset, glb.counts);
    if bytes > MAX_GLB_BYTES {
        return Err(ExportError::TooLarge { path: path.to_owned(), bytes });
    }
    let words = [2, bytes as u32, json.len() as u32];
    let binary_bytes = glb.offset as u32;
    let mut binary = glb.out.into_inner().map_err(|e| io(e.into_error()))?;
    binary.rewind().map_err(io)?;
    replace(path, |out| {
        out.write_all(b"glTF")?;
        words.iter().try_for_each(|w| out.write_all(&w.to_le_bytes()))?;
        out.write_all(b"JSON")?;
        out.write_all(&json)?;
        out.write_all(&binary_bytes.to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        io::copy(&mut binary, out).map(|_| ())
    })?;
    Ok(counts)
}

/// Normals in the model's axes have no place in glTF; those in the tile's frame are as glTF wants them.
fn is_written(model: &Model, kind: MapKind) -> bool {
    let maps = model.textures().map_or(&[][..], |t| t.maps);
    let map = maps.iter().find(|m| m.kind() == Some(kind));
    let tangent = |m: &MapRecord| matches!(m.format(), Some(MapFormat::Bc5 | MapFormat::Rg8));
    map.is_some_and(|m| kind != MapKind::Normal || tangent(m))
}

/// A file that grows.
struct Glb<'a, W: Write> {
    out: W,
    /// Bytes of the binary part so far.
    offset: u64,
    model: &'a Model,
    /// The grid point that positions are relative to, and where it is: single precision has room for the rest.
    center: [i32; 3],
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
    materials: Vec<Value>,
    /// Of the mesh under way.
    primitives: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    counts: ExportCounts,
}

impl<'a, W: Write> Glb<'a, W> {
    fn new(out: W, model: &'a Model) -> Self {
        let (low, high) = (model.record().bounds_min, model.record().bounds_max);
        let center = std::array::from_fn(|k| ((i64::from(low[k]) + i64::from(high[k])) / 2) as i32);
        Glb {
            out,
            offset: 0,
            model,
            center,
            views: Vec::new(),
            accessors: Vec::new(),
            images: Vec::new(),
            materials: Vec::new(),
            primitives: Vec::new(),
            meshes: Vec::new(),
            nodes: Vec::new(),
            counts: ExportCounts::default(),
        }
    }

    fn add(&mut self, part: &Part, images: &[(MapKind, Option<TileImage>)]) -> io::Result<()> {
        let quantum = self.model.record().quantum;
        let local = |p: &[i32; 3]| -> [f32; 3] {
            std::array::from_fn(|k| ((f64::from(p[k]) - f64::from(self.center[k])) * quantum) as f32)
        };
        let positions: Vec<[f32; 3]> = part.grid.iter().map(local).collect();
        let bound = |start: f32, pick: fn(f32, f32) -> f32| -> [f32; 3] {
            std::array::from_fn(|k| positions.iter().map(|p| p[k]).fold(start, pick))
        };
        let (low, high) = (bound(f32::INFINITY, f32::min), bound(f32::NEG_INFINITY, f32::max));
        let count = positions.len();
        let position = self.accessor(bytemuck::cast_slice(&positions), VERTICES, FLOAT, count, "VEC3")?;
        self.accessors[position]["min"] = json!(low);
        self.accessors[position]["max"] = json!(high);
        let normal = self.accessor(bytemuck::cast_slice(&part.normals), VERTICES, FLOAT, count, "VEC3")?;
        let uv = self.accessor(bytemuck::cast_slice(&part.uvs), VERTICES, FLOAT, count, "VEC2")?;
        let corners = part.triangles.as_flattened();
        let index = self.accessor(bytemuck::cast_slice(corners), INDICES, UNSIGNED_SHORT, corners.len(), "SCALAR")?;
        let material = self.material(images)?;
        self.primitives.push(json!({
            "attributes": { "POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv },
            "indices": index, "material": material,
        }));
        self.counts.vertices += count as u64;
        self.counts.triangles += part.triangles.len() as u64;
        Ok(())
    }

    /// Ends a mesh, and places it.
    fn place(&mut self, placements: &[Placement]) {
        let primitives = std::mem::take(&mut self.primitives);
        if primitives.is_empty() {
            return;
        }
        let mesh = self.meshes.len();
        self.meshes.push(json!({ "primitives": primitives }));
        for placement in placements {
            let mut node = json!({
                "mesh": mesh, "translation": self.model.world_of(self.center, placement).to_array(),
            });
            if *placement != Placement::IDENTITY {
                node["rotation"] = json!(placement.rotation.to_array());
                let scale = placement.scale;
                node["scale"] = json!([scale, scale, scale]);
            }
            self.nodes.push(node);
        }
    }

    fn material(&mut self, images: &[(MapKind, Option<TileImage>)]) -> io::Result<usize> {
        let (mut surface, mut material) = (Map::new(), Map::new());
        surface.insert("metallicFactor".into(), json!(0.0));
        for (kind, image) in images {
            let Some(image) = image else { continue };
            let cut_out = *kind == MapKind::BaseColor && self.model.has_cutouts();
            let png = image.png(cut_out)?;
            let view = self.view(&png, None)?;
            let texture = json!({ "index": self.images.len() });
            self.images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
            match kind {
                MapKind::BaseColor => drop(surface.insert("baseColorTexture".into(), texture)),
                MapKind::Orm => {
                    surface.insert("metallicFactor".into(), json!(1.0));
                    surface.insert("metallicRoughnessTexture".into(), texture.clone());
                    material.insert("occlusionTexture".into(), texture);
                }
                MapKind::Emissive => {
                    material.insert("emissiveFactor".into(), json!([1.0, 1.0, 1.0]));
                    material.insert("emissiveTexture".into(), texture);
                }
                MapKind::Normal => drop(material.insert("normalTexture".into(), texture)),
            }
        }
        material.insert("pbrMetallicRoughness".into(), Value::Object(surface));
        material.insert("doubleSided".into(), json!(true));
        if self.model.has_cutouts() {
            material.insert("alphaMode".into(), json!("MASK"));
        }
        self.materials.push(Value::Object(material));
        Ok(self.materials.len() - 1)
    }

    fn accessor(&mut self, bytes: &[u8], target: u32, component: u32, count: usize, kind: &str) -> io::Result<usize> {
        let view = self.view(bytes, Some(target))?;
        let accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
        self.accessors.push(accessor);
        Ok(self.accessors.len() - 1)
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> io::Result<usize> {
        let mut view = json!({ "buffer": 0, "byteOffset": self.offset, "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.out.write_all(bytes)?;
        let padding = bytes.len().next_multiple_of(4) - bytes.len();
        self.out.write_all(&[0; 3][..padding])?;
        self.offset += (bytes.len() + padding) as u64;
        Ok(self.views.len() - 1)
    }

    fn document(&mut self) -> Value {
        self.counts.images = self.images.len() as u64;
        let textures: Vec<Value> = (0..self.images.len()).map(|i| json!({ "source": i, "sampler": 0 })).collect();
        let mut document = json!({
            "asset": { "version": "2.0", "generator": "pb-bake" },
            "scene": 0,
            "scenes": [{ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() }],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.offset }],
        });
        if !self.images.is_empty() {
            document["images"] = json!(self.images);
            document["textures"] = json!(textures);
            // Tiles do not repeat.
            document["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33071, "magFilter": 9729, "minFilter": 9729 }]);
        }
        document
    }
}
