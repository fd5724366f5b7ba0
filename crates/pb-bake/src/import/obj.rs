//! Wavefront OBJ by the crate `tobj`, behind [`ObjLines`], which finds faults and their lines; materials from MTL.
//!
//! Vertex colours win over material colours. Texture coordinates are read only where a material has an image.

use super::error::{ImportError, damaged};
use super::mtl::{self, MtlMaterial, Surroundings};
use super::obj_lines::{Mode, ObjLines, Stop};
use super::textures::{ImageList, Model};
use super::{Input, Warnings, guarded};
use pb_mesh::mesh::{NO_MATERIAL, Soup};
use std::cell::RefCell;
use std::path::{Component, Path, PathBuf};
use tobj::{LoadOptions, MTLLoadResult};

/// Longest material library that is read.
const MAX_MTL_BYTES: u64 = 64 << 20;
/// The diffuse colours that programs write when nobody chose one.
const DEFAULT_DIFFUSE: [f64; 2] = [0.8, 1.0];

/// Reads an OBJ file.
pub(super) fn read(input: &Input, warnings: &mut Warnings) -> Result<Model, ImportError> {
    let mut mode = Mode::default();
    loop {
        let libraries = Libraries::new(input);
        let mut lines = ObjLines::new(input.name, input.bytes, mode, &libraries);
        let options = LoadOptions { single_index: true, ..LoadOptions::default() };
        let parsed = guarded(input.name, || tobj::load_obj_buf(&mut lines, &options, |_| libraries.names()))?;
        match lines.verdict() {
            Some(Stop::Error(error)) => return Err(error),
            // Each turn adds an attribute, so there are four at most.
            Some(Stop::Again(again)) => mode = again,
            None => {
                let (models, _) = parsed.map_err(|error| damaged(input.name, error.to_string()))?;
                let unreferenced_left_out = lines.unreferenced();
                let has_uvs = lines.has_uvs();
                let more = std::mem::take(&mut lines.warnings);
                drop(lines);
                let Shelf { materials, images, warnings: found, .. } = libraries.shelf.into_inner();
                warnings.append(found);
                warnings.append(more);
                let soup = join(&models, &materials, has_uvs, warnings);
                return Ok(Model {
                    soup: Soup { unreferenced_left_out, ..soup },
                    materials: materials.into_iter().map(|m| m.material).collect(),
                    images: images.list,
                    ..Model::default()
                });
            }
        }
    }
}

/// All objects as one soup.
fn join(models: &[tobj::Model], materials: &[MtlMaterial], has_uvs: bool, warnings: &mut Warnings) -> Soup {
    let mut soup = Soup::default();
    let color_of = |model: &tobj::Model| {
        let material = model.mesh.material_id.and_then(|id| materials.get(id));
        material.and_then(|m| m.diffuse).unwrap_or([1.0; 3])
    };
    let chosen = |color: [f64; 3]| !DEFAULT_DIFFUSE.iter().any(|&d| color == [d; 3]);
    let has_material_colors = models.iter().any(|m| !m.mesh.indices.is_empty() && chosen(color_of(m)));
    let brightest = models.iter().flat_map(|m| &m.mesh.vertex_color).fold(0.0, |a: f64, &b| a.max(b));
    // Some programs write 0 to 255.
    let scale = if brightest > 1.0 { 1.0 } else { 255.0 };
    let byte = |x: f64| (x * scale).round() as u8;
    let mut uv_set = Vec::new();
    for model in models {
        let mesh = &model.mesh;
        let base = soup.positions.len() as u32;
        soup.positions.extend_from_slice(triples(&mesh.positions));
        soup.normals.extend(triples(&mesh.normals).iter().map(|n| n.map(|x| x as f32)));
        let colors = triples(&mesh.vertex_color);
        soup.colors.extend(colors.iter().map(|&[r, g, b]| [byte(r), byte(g), byte(b), 255]));
        if colors.is_empty() && has_material_colors {
            let [r, g, b] = color_of(model).map(|x| (x * 255.0).round() as u8);
            soup.colors.resize(soup.positions.len(), [r, g, b, 255]);
        }
        if has_uvs {
            // OBJ's v runs upwards.
            let uvs = mesh.texcoords.chunks_exact(2).map(|uv| [uv[0] as f32, (1.0 - uv[1]) as f32]);
            uv_set.extend(uvs);
            uv_set.resize(soup.positions.len(), [0.0; 2]);
        }
        take_faces(&mesh.indices, &mesh.face_arities, base, &mut soup);
        if !materials.is_empty() {
            let material = mesh.material_id.map_or(NO_MATERIAL, |id| id as u32);
            soup.material_of.resize(soup.triangles.len(), material);
        }
    }
    if has_uvs {
        soup.uv_sets.push(uv_set);
    }
    // Objects without normals between objects with: none for those.
    if !soup.normals.is_empty() && soup.normals.len() != soup.positions.len() {
        warnings.add("the normals do not fit the vertices; all are made new");
        soup.normals.clear();
    }
    if !soup.colors.is_empty() && soup.colors.len() != soup.positions.len() {
        warnings.add("the colours do not fit the vertices; none are used");
        soup.colors.clear();
    }
    soup
}

/// The parser has flat lists of three coordinates each.
fn triples(flat: &[f64]) -> &[[f64; 3]] {
    bytemuck::cast_slice(&flat[..flat.len() / 3 * 3])
}

fn take_faces(indices: &[u32], arities: &[u32], base: u32, soup: &mut Soup) {
    if arities.is_empty() {
        soup.triangles.extend(indices.chunks_exact(3).map(|t| [t[0] + base, t[1] + base, t[2] + base]));
        return;
    }
    let (mut begin, mut corners, mut cut) = (0, Vec::new(), Vec::new());
    for &arity in arities {
        let face = &indices[begin..begin + arity as usize];
        begin += arity as usize;
        corners.clear();
        corners.extend(face.iter().map(|&i| soup.positions[(base + i) as usize]));
        cut.clear();
        pb_mesh::polygon::triangulate(&corners, &mut cut);
        soup.triangles.extend(cut.iter().map(|t| t.map(|i| base + face[i as usize])));
        soup.polygons_triangulated += u64::from(arity > 3);
    }
}

/// Finds material libraries beside the model.
pub(super) struct Libraries<'a> {
    input: &'a Input<'a>,
    shelf: RefCell<Shelf>,
}

/// What the libraries had so far.
#[derive(Default)]
struct Shelf {
    materials: Vec<MtlMaterial>,
    images: ImageList,
    warnings: Warnings,
    /// How many materials the parser knows.
    told: usize,
}

impl Libraries<'_> {
    fn new<'a>(input: &'a Input<'a>) -> Libraries<'a> {
        Libraries { input, shelf: RefCell::default() }
    }

    /// Reads what a `mtllib` line names: one file whose name may have blanks, or several.
    pub(super) fn load(&self, names: &str) {
        let whole = self.find(names);
        let files: Vec<(&str, Option<PathBuf>)> = match whole {
            Some(path) => vec![(names, Some(path))],
            None => names.split_ascii_whitespace().map(|name| (name, self.find(name))).collect(),
        };
        let Shelf { materials, images, warnings, .. } = &mut *self.shelf.borrow_mut();
        for (name, path) in files {
            let bytes = path.as_ref().and_then(|path| std::fs::read(path).ok());
            let (Some(bytes), Some(path)) = (bytes, path) else {
                let text = "is not beside the model; its colours and images are not used";
                warnings.add(format!("the material library \"{name}\" {text}"));
                continue;
            };
            self.input.has_companion(&path);
            let folders: Vec<&Path> = path.parent().into_iter().chain(self.input.base).collect();
            let mut around = Surroundings { model: self.input.name, folders: &folders, images, warnings };
            mtl::parse(&bytes, &mut around, materials);
        }
    }

    /// Whether texture coordinates are worth reading, as far as is known.
    pub(super) fn want_uvs(&self) -> bool {
        self.input.wants_uvs || !self.shelf.borrow().images.list.is_empty()
    }

    /// The names of the materials that the parser does not know yet.
    fn names(&self) -> MTLLoadResult {
        let shelf = &mut *self.shelf.borrow_mut();
        let new = &shelf.materials[shelf.told..];
        let named = |m: &MtlMaterial| tobj::Material { name: m.material.name.clone(), ..tobj::Material::default() };
        let index = new.iter().enumerate().map(|(i, m)| (m.material.name.clone(), i)).collect();
        let list = new.iter().map(named).collect();
        shelf.told = shelf.materials.len();
        Ok((list, index))
    }

    /// A file in the folder of the model. Of an absolute path, of this system or of Windows, only the name counts.
    fn find(&self, name: &str) -> Option<PathBuf> {
        let is_absolute =
            name.starts_with(['/', '\\']) || name.get(1..3) == Some(":\\") || name.get(1..3) == Some(":/");
        let name = name.replace('\\', "/");
        let name = if is_absolute { name.rsplit('/').next()? } else { &name };
        let relative = Path::new(name);
        let stays_inside = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        let path = self.input.base?.join(relative);
        let is_sound = |m: std::fs::Metadata| m.is_file() && m.len() <= MAX_MTL_BYTES;
        (stays_inside && std::fs::metadata(&path).is_ok_and(is_sound)).then_some(path)
    }
}
