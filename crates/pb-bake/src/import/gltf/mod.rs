//! glTF 2.0 and GLB: all triangles of the default scene in world space with their materials, without animations and
//! skins (skinned meshes stand as they were modelled).
//!
//! Own reader on `serde_json`, see docs/decisions/004-own-gltf-reader.md. Counts and ranges are checked against the
//! bytes that are there, and the size of the expanded scene against a limit, before anything is allocated for it.

mod accessor;
mod buffers;
mod document;
mod instances;
mod materials;
mod scene;

use super::error::{ImportError, Refusal, damaged, refused};
use super::textures::Model;
use super::{Input, Warnings};
use accessor::Reader;
use buffers::Buffers;
use document::{Document, Primitive, Versioned};
use glam::{DMat3, DMat4, DVec3};
use instances::Layout;
use materials::Materials;
use pb_mesh::mesh::{NO_MATERIAL, Soup};

const MODE_TRIANGLES: u32 = 4;
const MODE_STRIP: u32 = 5;
const MODE_FAN: u32 = 6;

/// Required extensions that do not change the geometry, by how their names begin, and those that are read.
const HARMLESS_EXTENSIONS: &[&str] = &[
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_animation_",
    "KHR_xmp",
];

/// Reads a glTF or GLB file.
pub(super) fn read(input: &Input, warnings: &mut Warnings) -> Result<Model, ImportError> {
    let (json, chunk) = if input.bytes.starts_with(b"glTF") { split_glb(input)? } else { (input.bytes, None) };
    let document = parse(input, json)?;
    let buffers = Buffers::new(input, chunk, &document.buffers);
    let reader = Reader { name: input.name, document: &document, buffers: &buffers };
    let mut materials = materials::read(&document, &buffers, warnings);
    if materials.uv_sets.is_empty() && input.wants_uvs {
        materials.uv_sets.push(0);
    }
    let placed = scene::placed_meshes(&reader, input.max_triangles)?;
    let layout = match input.keeps_instances {
        true => Layout::of(placed, |mesh| triangles_of(&reader, mesh)),
        false => Layout { single: placed, ..Layout::default() },
    };
    let written = layout.single.iter().map(|at| at.mesh).chain(layout.objects.iter().map(|o| o.mesh));
    let size = measure(&reader, written, &materials, input.max_triangles)?;
    let mut parts = Parts { reader: &reader, materials: &materials, cache: Vec::new(), warnings };
    parts.cache.resize_with(document.meshes.len(), || None);
    let mut soup = Soup::default();
    soup.positions.reserve_exact(size.vertices as usize);
    soup.triangles.reserve_exact(size.triangles as usize);
    soup.uv_sets.resize_with(if size.has_uvs { materials.uv_sets.len() } else { 0 }, Vec::new);
    for at in &layout.single {
        parts.write(at.mesh, at.world, size.has_colors, &mut soup)?;
    }
    for object in &layout.objects {
        soup.objects.of.resize(soup.positions.len(), 0);
        let middle = parts.write(object.mesh, object.base, size.has_colors, &mut soup)?;
        soup.objects.placements.push(object.placements(middle));
        soup.objects.of.resize(soup.positions.len(), soup.objects.placements.len() as u32);
    }
    let instances = layout.counts(parts.warnings);
    if materials.list.is_empty() {
        soup.material_of = Vec::new();
    }
    Ok(Model { soup, materials: materials.list, images: materials.images.list, instances })
}

/// The error for geometry that only an extension can unpack.
fn compressed(name: &str, extension: &str) -> ImportError {
    let what = format!("its geometry is compressed with {extension}, which is not read");
    let remedy = "unpack it first, for example with `gltf-transform copy IN.glb OUT.glb`";
    refused(Refusal::Unsupported, name, what, remedy)
}

/// The JSON chunk of a GLB, and the binary chunk where there is one.
fn split_glb<'a>(input: &Input<'a>) -> Result<(&'a [u8], Option<&'a [u8]>), ImportError> {
    let word = |at: usize| {
        let bytes = input.bytes.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(bytes.try_into().expect("four bytes")) as usize)
    };
    let cut = || damaged(input.name, "the GLB file ends within a chunk");
    match word(4).ok_or_else(cut)? {
        2 => {}
        1 => return Err(old_version(input.name, "1.0")),
        other => return Err(old_version(input.name, &other.to_string())),
    }
    let length = word(8).ok_or_else(cut)?;
    if length > input.bytes.len() {
        let what = format!("the GLB header promises {length} bytes, but the file has {}", input.bytes.len());
        return Err(damaged(input.name, what));
    }
    let (mut at, mut json, mut binary) = (12, None, None);
    while at + 8 <= length {
        let (size, kind) = (word(at).ok_or_else(cut)?, &input.bytes[at + 4..at + 8]);
        let content = input.bytes.get(at + 8..).and_then(|rest| rest.get(..size)).ok_or_else(cut)?;
        match (kind, json, binary) {
            (b"JSON", None, _) => json = Some(content),
            (b"BIN\0", Some(_), None) => binary = Some(content),
            // Chunks of other kinds are to be skipped.
            _ => {}
        }
        at += 8 + size.next_multiple_of(4);
    }
    let json = json.ok_or_else(|| damaged(input.name, "the GLB file has no JSON chunk"))?;
    Ok((json, binary))
}

fn old_version(name: &str, version: &str) -> ImportError {
    let what = format!("is glTF {version}; only glTF 2.0 is read");
    refused(Refusal::Unsupported, name, what, "convert it, for example with `gltf-pipeline -i IN.gltf -o OUT.glb`")
}

fn parse(input: &Input, json: &[u8]) -> Result<Document, ImportError> {
    let json = json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(json);
    let fault = |error: serde_json::Error| {
        let place = format!("{}:{}", input.name, error.line());
        damaged(place, format!("the glTF document cannot be read: {error}"))
    };
    let version = match serde_json::from_slice::<Versioned>(json) {
        Ok(Versioned { asset: Some(asset) }) => asset.min_version.unwrap_or(asset.version),
        Ok(Versioned { asset: None }) => {
            return Err(damaged(input.name, "has no \"asset\" with a version, as every glTF document must"));
        }
        // A document of another version may differ there already; its own error says more otherwise.
        Err(error) => return Err(fault(error)),
    };
    if !version.starts_with("2.") && version != "2" {
        return Err(old_version(input.name, &version.chars().take(20).collect::<String>()));
    }
    let document: Document = serde_json::from_slice(json).map_err(fault)?;
    for name in &document.extensions_required {
        if name == "KHR_draco_mesh_compression" || name.ends_with("_meshopt_compression") {
            return Err(compressed(input.name, name));
        }
        if !HARMLESS_EXTENSIONS.iter().any(|known| name.starts_with(known)) {
            let what =
                format!("it requires the extension {}, which is not known", name.chars().take(80).collect::<String>());
            return Err(refused(Refusal::Unsupported, input.name, what, "export it without that extension"));
        }
    }
    Ok(document)
}

/// How large the scene will be.
#[derive(Default)]
struct Size {
    vertices: u64,
    triangles: u64,
    has_colors: bool,
    has_uvs: bool,
}

/// Sums up the primitives of all meshes that are written; refuses what is too large.
fn measure(
    reader: &Reader,
    meshes: impl Iterator<Item = usize>,
    materials: &Materials,
    max_triangles: usize,
) -> Result<Size, ImportError> {
    let mut size = Size::default();
    for number in meshes {
        let Some(mesh) = reader.document.meshes.get(number) else {
            let what = format!("a node has mesh {number}, but there are only {}", reader.document.meshes.len());
            return Err(damaged(reader.name, what));
        };
        for primitive in &mesh.primitives {
            let Some([vertices, triangles]) = counts(reader, primitive)? else { continue };
            size.vertices = size.vertices.saturating_add(vertices);
            size.triangles = size.triangles.saturating_add(triangles);
            size.has_uvs |= materials.uv_sets.iter().any(|&n| primitive.attributes.uv(n).is_some());
            size.has_colors |= primitive.attributes.color.is_some() || base_color(reader, primitive)? != [1.0; 4];
        }
    }
    // 24 + 12 + 4 bytes of a record and 8 of each texture coordinate; 12 + 4 of a triangle.
    let record = 40 + if size.has_uvs { 8 * materials.uv_sets.len() as u64 } else { 0 };
    let bytes = size.vertices.saturating_mul(record).saturating_add(size.triangles.saturating_mul(16));
    let available = available_memory();
    if size.triangles > max_triangles as u64 || size.vertices >= u64::from(u32::MAX) {
        return Err(super::too_many(reader.name, max_triangles));
    }
    if bytes > available {
        let what = format!("the scene expands to {} triangles, which need {bytes} bytes of memory", size.triangles);
        return Err(refused(Refusal::TooLarge, reader.name, what, format!("only {available} are available: split it")));
    }
    Ok(size)
}

/// Vertices and triangles of a primitive; none of points, lines and what has no positions.
fn counts(reader: &Reader, primitive: &Primitive) -> Result<Option<[u64; 2]>, ImportError> {
    let is_surface = (MODE_TRIANGLES..=MODE_FAN).contains(&primitive.mode);
    let Some(position) = primitive.attributes.position.filter(|_| is_surface) else { return Ok(None) };
    let vertices = reader.accessor(position)?.count;
    let corners = primitive.indices.map_or(Ok(vertices), |i| reader.accessor(i).map(|a| a.count))?;
    let triangles = if primitive.mode == MODE_TRIANGLES { corners / 3 } else { corners.saturating_sub(2) };
    Ok(Some([vertices, triangles]))
}

/// Triangles of a mesh. What is wrong with it counts nothing here, and is said when the scene is measured.
fn triangles_of(reader: &Reader, mesh: usize) -> u64 {
    let primitives = reader.document.meshes.get(mesh).map_or(&[][..], |m| &m.primitives);
    let counts = primitives.iter().filter_map(|p| counts(reader, p).ok()?);
    counts.fold(0, |sum, [_, triangles]| sum.saturating_add(triangles))
}

/// Bytes that the system can give without swapping; where it does not say, four gibibytes.
fn available_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kibibytes = line.and_then(|l| l.trim().split(' ').next()?.parse::<u64>().ok());
    kibibytes.map_or(4 << 30, |k| k.saturating_mul(1024))
}

fn base_color(reader: &Reader, primitive: &Primitive) -> Result<[f64; 4], ImportError> {
    let Some(index) = primitive.material else { return Ok([1.0; 4]) };
    let material = reader.document.materials.get(index);
    material.map(materials::color).ok_or_else(|| {
        let count = reader.document.materials.len();
        damaged(reader.name, format!("a primitive has material {index}, but there are only {count}"))
    })
}

/// A primitive in object space.
struct Part {
    positions: Vec<[f64; 3]>,
    /// Empty, or one per position.
    normals: Vec<[f64; 3]>,
    /// sRGB; empty, or one per position.
    colors: Vec<[u8; 4]>,
    /// sRGB, of all vertices where there are no colours.
    color: [u8; 4],
    /// Per set; empty where the primitive has none.
    uvs: Vec<Vec<[f32; 2]>>,
    /// Index, or [`NO_MATERIAL`].
    material: u32,
    triangles: Vec<[u32; 3]>,
}

/// Reads each mesh once, however often it is placed.
struct Parts<'a, 'w> {
    reader: &'a Reader<'a>,
    materials: &'a Materials,
    cache: Vec<Option<Vec<Part>>>,
    warnings: &'w mut Warnings,
}

impl Parts<'_, '_> {
    fn of_mesh(&mut self, mesh: usize) -> Result<&[Part], ImportError> {
        if self.cache[mesh].is_none() {
            let mut parts = Vec::new();
            for (i, primitive) in self.reader.document.meshes[mesh].primitives.iter().enumerate() {
                parts.extend(self.primitive(primitive, &format!("{}: mesh {mesh}, primitive {i}", self.reader.name))?);
            }
            self.cache[mesh] = Some(parts);
        }
        Ok(self.cache[mesh].as_deref().expect("it was filled above"))
    }

    /// Puts a mesh into the scene. Returns the middle of its positions, in its own space.
    fn write(&mut self, mesh: usize, world: DMat4, has_colors: bool, soup: &mut Soup) -> Result<DVec3, ImportError> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for part in self.of_mesh(mesh)? {
            add(part, world, has_colors, soup);
            soup.material_of.resize(soup.triangles.len(), part.material);
            for p in part.positions.iter().map(|&p| DVec3::from_array(p)) {
                (low, high) = (low.min(p), high.max(p));
            }
        }
        let middle = low * 0.5 + high * 0.5;
        Ok(if middle.is_finite() { middle } else { DVec3::ZERO })
    }

    fn primitive(&mut self, primitive: &Primitive, place: &str) -> Result<Option<Part>, ImportError> {
        if primitive.mode > MODE_FAN {
            return Err(damaged(place, format!("has the mode {}, which does not exist", primitive.mode)));
        }
        if primitive.mode < MODE_TRIANGLES {
            self.warnings.add("points and lines are skipped");
            return Ok(None);
        }
        let Some(position) = primitive.attributes.position else {
            self.warnings.add("a primitive without positions is skipped");
            return Ok(None);
        };
        if primitive.extensions.draco.is_some() && self.reader.accessor(position)?.buffer_view.is_none() {
            return Err(compressed(self.reader.name, "KHR_draco_mesh_compression"));
        }
        let positions = self.reader.vectors::<3>(position, 3, 0.0)?;
        let mut normals = Vec::new();
        if let Some(normal) = primitive.attributes.normal {
            normals = self.reader.vectors::<3>(normal, 3, 0.0)?;
        }
        let factor = base_color(self.reader, primitive)?;
        let mut colors = Vec::new();
        if let Some(color) = primitive.attributes.color {
            let linear = self.reader.vectors::<4>(color, 3, 1.0)?;
            colors = linear.iter().map(|c| encode(std::array::from_fn(|k| c[k] * factor[k]))).collect();
        }
        if !(normals.is_empty() || normals.len() == positions.len()) {
            self.warnings.add("normals that are not as many as the positions are made new");
            normals.clear();
        }
        if !(colors.is_empty() || colors.len() == positions.len()) {
            self.warnings.add("colours that are not as many as the positions are not used");
            colors.clear();
        }
        let corners = match primitive.indices {
            Some(indices) => self.reader.indices(indices)?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(index) = corners.iter().find(|&&i| i as usize >= positions.len()) {
            let what = format!("refers to vertex {index}, but there are only {}", positions.len());
            return Err(damaged(place, what));
        }
        if primitive.mode == MODE_TRIANGLES && corners.len() % 3 != 0 {
            self.warnings.add("indices at the end that make no whole triangle are skipped");
        }
        let triangles = assemble(primitive.mode, &corners);
        let uvs = self.uvs(primitive, positions.len())?;
        let material = primitive.material.map_or(NO_MATERIAL, |m| m as u32);
        Ok(Some(Part { positions, normals, colors, color: encode(factor), uvs, material, triangles }))
    }

    /// Texture coordinates per set that some material uses.
    fn uvs(&mut self, primitive: &Primitive, count: usize) -> Result<Vec<Vec<[f32; 2]>>, ImportError> {
        let mut sets = Vec::new();
        for (set, &number) in self.materials.uv_sets.iter().enumerate() {
            let mut uvs = Vec::new();
            if let Some(accessor) = primitive.attributes.uv(number) {
                let doubles = self.reader.vectors::<2>(accessor, 2, 0.0)?;
                uvs = doubles.iter().map(|uv| uv.map(|x| x as f32)).collect();
            }
            let needed = primitive
                .material
                .and_then(|m| self.materials.list.get(m))
                .is_some_and(|material| material.textures.iter().flatten().any(|t| t.uv_set as usize == set));
            if uvs.len() != count && (needed || !uvs.is_empty()) {
                self.warnings.add(format!("TEXCOORD_{number} is not there for all vertices; (0, 0) is taken"));
            }
            if uvs.len() != count {
                uvs.clear();
            }
            sets.push(uvs);
        }
        Ok(sets)
    }
}

/// Triangles, strips and fans, by the order of corners that the format has for them.
fn assemble(mode: u32, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        MODE_STRIP => corners
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
            .collect(),
        MODE_FAN => corners.windows(2).skip(1).map(|w| [w[0], w[1], corners[0]]).collect(),
        _ => corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

/// Linear to sRGB bytes (IEC 61966-2-1); alpha stays linear.
fn encode([r, g, b, a]: [f64; 4]) -> [u8; 4] {
    let curve = |x: f64| if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    let byte = |x: f64| if x.is_nan() { 255 } else { (x * 255.0).round() as u8 };
    [byte(curve(r)), byte(curve(g)), byte(curve(b)), byte(a)]
}

/// Puts a part into the scene.
fn add(part: &Part, world: DMat4, has_colors: bool, soup: &mut Soup) {
    let linear = DMat3::from_mat4(world);
    let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
    let mirrored = linear.determinant() < 0.0;
    let sign = if mirrored { -1.0 } else { 1.0 };
    // Normals are covectors: the matrix of cofactors carries them, also where the scale is zero along an axis.
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign;
    let (base, count) = (soup.positions.len(), part.positions.len());
    soup.positions.extend(part.positions.iter().map(|&p| world.transform_point3(DVec3::from_array(p)).to_array()));
    if !part.normals.is_empty() {
        soup.normals.resize(base, [0.0; 3]);
        let turned = |&n: &[f64; 3]| (cofactors * DVec3::from_array(n)).normalize_or_zero().as_vec3().to_array();
        soup.normals.extend(part.normals.iter().map(turned));
    } else if !soup.normals.is_empty() {
        soup.normals.resize(base + count, [0.0; 3]);
    }
    if has_colors && !part.colors.is_empty() {
        soup.colors.extend_from_slice(&part.colors);
    } else if has_colors {
        soup.colors.resize(base + count, part.color);
    }
    for (set, uvs) in soup.uv_sets.iter_mut().zip(&part.uvs) {
        set.extend_from_slice(uvs);
        set.resize(base + count, [0.0; 2]);
    }
    let base = base as u32;
    soup.triangles.extend(part.triangles.iter().map(|&[a, b, c]| {
        let [b, c] = if mirrored { [c, b] } else { [b, c] };
        [a + base, b + base, c + base]
    }));
}
