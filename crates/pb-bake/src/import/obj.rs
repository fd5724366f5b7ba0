//! Wavefront OBJ by the crate `tobj`, behind [`ObjLines`], which finds faults and their lines; material colours from MTL.
//!
//! Vertex colours win over material colours. Materials with a texture count as white: their colour is meant to be
//! multiplied with the texture, which is not read.

use super::error::{ImportError, damaged};
use super::obj_lines::{Mode, ObjLines, Stop, number};
use super::{Input, TEXTURE_WARNING, Warnings, guarded};
use pb_mesh::mesh::Soup;
use std::cell::RefCell;
use std::path::{Component, Path, PathBuf};
use tobj::{LoadOptions, MTLLoadResult, Material, Model};

/// Longest material library that is read.
const MAX_MTL_BYTES: u64 = 64 << 20;
/// The diffuse colours that programs write when nobody chose one.
const DEFAULT_DIFFUSE: [f64; 2] = [0.8, 1.0];

/// Reads an OBJ file.
pub(super) fn read(input: &Input, warnings: &mut Warnings) -> Result<Soup, ImportError> {
    let mut mode = Mode::default();
    loop {
        let mut lines = ObjLines::new(input.name, input.bytes, mode);
        let libraries = Libraries { base: input.base, warnings: RefCell::default() };
        let options = LoadOptions { single_index: true, ..LoadOptions::default() };
        let parsed = guarded(input.name, || tobj::load_obj_buf(&mut lines, &options, |path| libraries.load(path)))?;
        match lines.verdict() {
            Some(Stop::Error(error)) => return Err(error),
            // Each turn adds an attribute, so there are three at most.
            Some(Stop::Again(again)) => mode = again,
            None => {
                let (models, materials) = parsed.map_err(|error| damaged(input.name, error.to_string()))?;
                warnings.append(libraries.warnings.into_inner());
                let unreferenced_left_out = lines.unreferenced();
                if lines.has_texture_coordinates {
                    warnings.add(TEXTURE_WARNING);
                }
                warnings.append(lines.warnings);
                let soup = join(&models, &materials.unwrap_or_default(), warnings);
                return Ok(Soup { unreferenced_left_out, ..soup });
            }
        }
    }
}

/// All objects as one soup.
fn join(models: &[Model], materials: &[Material], warnings: &mut Warnings) -> Soup {
    let mut soup = Soup::default();
    let color_of = |model: &Model| {
        let material = model.mesh.material_id.and_then(|id| materials.get(id));
        material.map_or([1.0; 3], diffuse)
    };
    let chosen = |color: [f64; 3]| !DEFAULT_DIFFUSE.iter().any(|&d| color == [d; 3]);
    let has_material_colors = models.iter().any(|m| !m.mesh.indices.is_empty() && chosen(color_of(m)));
    let brightest = models.iter().flat_map(|m| &m.mesh.vertex_color).fold(0.0, |a: f64, &b| a.max(b));
    // Some programs write 0 to 255.
    let scale = if brightest > 1.0 { 1.0 } else { 255.0 };
    let byte = |x: f64| (x * scale).round() as u8;
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
        take_faces(&mesh.indices, &mesh.face_arities, base, &mut soup);
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

/// The diffuse colour, 0 to 1, of a material; white where a texture covers it.
fn diffuse(material: &Material) -> [f64; 3] {
    if material.diffuse_texture.is_some() { [1.0; 3] } else { material.diffuse.unwrap_or([1.0; 3]) }
}

/// Finds material libraries beside the model.
struct Libraries<'a> {
    base: Option<&'a Path>,
    warnings: RefCell<Warnings>,
}

impl Libraries<'_> {
    /// Reads what a `mtllib` line names: one file whose name may have blanks, or several.
    fn load(&self, names: &Path) -> MTLLoadResult {
        let names = names.to_string_lossy();
        let whole = self.find(&names);
        let files: Vec<(String, Option<PathBuf>)> = match whole {
            Some(path) => vec![(names.into_owned(), Some(path))],
            None => names.split_ascii_whitespace().map(|name| (name.to_owned(), self.find(name))).collect(),
        };
        let mut text = Vec::new();
        for (name, path) in files {
            match path.and_then(|path| std::fs::read(path).ok()) {
                Some(bytes) => clean_mtl(&bytes, &mut text),
                None => self
                    .warnings
                    .borrow_mut()
                    .add(format!("the material library \"{name}\" is not beside the model; its colours are not used")),
            }
        }
        tobj::load_mtl_buf(&mut text.as_slice())
    }

    /// A file in the folder of the model. Of an absolute path, of this system or of Windows, only the name counts.
    fn find(&self, name: &str) -> Option<PathBuf> {
        let is_absolute =
            name.starts_with(['/', '\\']) || name.get(1..3) == Some(":\\") || name.get(1..3) == Some(":/");
        let name = name.replace('\\', "/");
        let name = if is_absolute { name.rsplit('/').next()? } else { &name };
        let relative = Path::new(name);
        let stays_inside = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        let path = self.base?.join(relative);
        let is_sound = |m: std::fs::Metadata| m.is_file() && m.len() <= MAX_MTL_BYTES;
        (stays_inside && std::fs::metadata(&path).is_ok_and(is_sound)).then_some(path)
    }
}

/// Names, diffuse colours and whether there is a texture: all that is used, in a form that cannot be misread.
fn clean_mtl(bytes: &[u8], out: &mut Vec<u8>) {
    let mut named = false;
    for line in bytes.split(|&b| b == b'\n') {
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("newmtl") => {
                let name = line.trim().strip_prefix("newmtl").unwrap_or("").trim();
                named = !name.is_empty();
                if named {
                    out.extend_from_slice(format!("newmtl {name}\n").as_bytes());
                }
            }
            Some("Kd") if named => {
                let values: Vec<f64> = words.map_while(|w| number(w.as_bytes())).take(3).collect();
                let color = match values[..] {
                    [r, g, b] => [r, g, b],
                    [grey] => [grey; 3],
                    _ => continue,
                };
                if color.iter().all(|x| x.is_finite()) {
                    let [r, g, b] = color.map(|x| x.clamp(0.0, 1.0));
                    out.extend_from_slice(format!("Kd {r} {g} {b}\n").as_bytes());
                }
            }
            Some("map_Kd") if named => out.extend_from_slice(b"map_Kd texture\n"),
            _ => {}
        }
    }
}
