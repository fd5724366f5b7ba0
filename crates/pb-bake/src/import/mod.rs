//! From files to one [`Soup`]: OBJ, PLY, STL, glTF and GLB.
//!
//! Every reader takes bytes that may be hostile: counts are checked against the bytes that are there before anything
//! is allocated, indices before anything is read, and a panic inside a parser of somebody else becomes an error that
//! names the file. No reader repairs a mesh ([`pb_mesh::repair`]) or decodes an image ([`crate::images`]).

mod error;
mod gltf;
mod mtl;
mod obj;
mod obj_lines;
mod ply;
mod source;
mod stl;
mod textures;

pub use error::{ImportError, Refusal};
pub use textures::{InstanceCounts, Model};

use crate::images::{ImageContent, ImageSource};
use error::{damaged, refused};
use pb_lod::progressive_buffers::instances::MAX_INSTANCES;
use pb_mesh::material::Material;
use pb_mesh::mesh::Soup;
use pb_mesh::repair::{MAX_TRIANGLE_COUNT, first_bad_position};
use serde::{Deserialize, Serialize};
pub(crate) use source::Source;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Most different warnings that are kept per input.
const MAX_WARNING_COUNT: usize = 20;
/// The kinds of model that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Format {
    /// Wavefront OBJ, with the colours of its MTL.
    Obj,
    /// Stanford PLY: ascii, binary little and big endian.
    Ply,
    /// STL: ascii and binary.
    Stl,
    /// glTF 2.0 and its binary form, GLB.
    Gltf,
}

/// Limits of an import, and what is added to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImportOptions {
    /// Most triangles of all inputs together; those of repeated meshes count once where instances are kept.
    pub max_triangles: usize,
    /// An image for the inputs that have texture coordinates but no image.
    pub texture: Option<PathBuf>,
    /// What becomes of meshes that stand in several places.
    pub instancing: Instancing,
}

/// What becomes of meshes that stand in several places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Instancing {
    /// Each is kept once, with its places.
    #[default]
    Keep,
    /// All are written out as geometry.
    Expand,
}

impl Default for ImportOptions {
    fn default() -> Self {
        ImportOptions { max_triangles: MAX_TRIANGLE_COUNT, texture: None, instancing: Instancing::Keep }
    }
}

/// How far an import is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImportProgress {
    /// Inputs that are done.
    pub inputs_done: usize,
    /// Inputs in all.
    pub input_count: usize,
    /// Bytes of the inputs that are done.
    pub bytes_done: u64,
}

/// What one input contributed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputReport {
    /// As given.
    pub path: PathBuf,
    /// By its content.
    pub format: Format,
    /// Of the file itself, without those that it refers to.
    pub bytes: u64,
    /// Triangles, polygons cut.
    pub triangles: usize,
    /// Records, before any weld.
    pub vertices: usize,
    /// Meshes that stand in several places.
    pub instances: InstanceCounts,
    /// Files that it refers to and that were read: buffers and material libraries, but no images.
    pub companions: Vec<PathBuf>,
    /// What was odd but no reason to refuse it.
    pub warnings: Vec<String>,
}

/// All inputs as one scene.
#[derive(Clone, Debug, Default)]
pub struct Import {
    /// The inputs one after the other. It has texture coordinates and materials only where there are images.
    pub soup: Soup,
    /// All materials, or none where there are no images.
    pub materials: Vec<Material>,
    /// Those that triangles show, not decoded yet.
    pub images: Vec<ImageSource>,
    /// In the order of the inputs.
    pub inputs: Vec<InputReport>,
}

/// Reads all inputs into one scene. Calls `progress` before the first and after each.
///
/// # Errors
/// The first input that cannot be read, in the order given.
pub fn load(
    paths: &[PathBuf],
    options: &ImportOptions,
    progress: &dyn Fn(ImportProgress),
) -> Result<Import, ImportError> {
    let (mut scene, mut inputs) = (Model::default(), Vec::new());
    let mut bytes_done = 0;
    let report =
        |inputs_done, bytes_done| progress(ImportProgress { inputs_done, input_count: paths.len(), bytes_done });
    report(0, 0);
    for (i, path) in paths.iter().enumerate() {
        let name = path.display().to_string();
        let source = Source::open(path)?;
        let bytes = source.bytes();
        let format = source::sniff(&name, bytes)?;
        let base = path.parent().map(|p| if p.as_os_str().is_empty() { Path::new(".") } else { p });
        let max_triangles = options.max_triangles.saturating_sub(scene.soup.triangles.len());
        let wants_uvs = options.texture.is_some();
        let keeps_instances = options.instancing == Instancing::Keep;
        let companions = Mutex::default();
        let input =
            Input { name: &name, path: Some(path), bytes, base, max_triangles, wants_uvs, keeps_instances, companions };
        let (model, warnings) = read(format, &input, options.texture.as_deref())?;
        if scene.soup.positions.len() + model.soup.positions.len() >= u32::MAX as usize {
            return Err(too_many(&name, options.max_triangles));
        }
        bytes_done += bytes.len() as u64;
        inputs.push(InputReport {
            path: path.clone(),
            format,
            bytes: bytes.len() as u64,
            triangles: model.soup.triangles.len(),
            vertices: model.soup.positions.len(),
            instances: model.instances,
            companions: input.companions(),
            warnings,
        });
        scene.append(model);
        if scene.instances.instances >= u64::from(MAX_INSTANCES) {
            let what = format!("the scene has {} instances, more than an archive can hold", scene.instances.instances);
            let remedy = format!("bake it in parts of less than {MAX_INSTANCES}, or with --expand-instances");
            return Err(refused(Refusal::TooLarge, &name, what, remedy));
        }
        report(i + 1, bytes_done);
    }
    scene.finish();
    let Model { soup, materials, images, .. } = scene;
    Ok(Import { soup, materials, images, inputs })
}

/// Reads one model from memory, and what was odd about it. Files that it refers to are looked for in `base`; without
/// one, they count as missing.
///
/// # Errors
/// See [`ImportError`]; messages call the input "input".
pub fn load_bytes(format: Format, bytes: &[u8], base: Option<&Path>) -> Result<(Model, Vec<String>), ImportError> {
    let max_triangles = ImportOptions::default().max_triangles;
    let input = Input {
        name: "input",
        path: None,
        bytes,
        base,
        max_triangles,
        wants_uvs: false,
        keeps_instances: true,
        companions: Mutex::default(),
    };
    let (mut model, warnings) = read(format, &input, None)?;
    model.finish();
    Ok((model, warnings))
}

/// One input, as all readers take it.
struct Input<'a> {
    /// For messages.
    name: &'a str,
    /// Where its bytes come from; none for bytes in memory.
    path: Option<&'a Path>,
    bytes: &'a [u8],
    /// Where files that it refers to are.
    base: Option<&'a Path>,
    max_triangles: usize,
    /// Texture coordinates are read also where no material has an image.
    wants_uvs: bool,
    /// Meshes that stand in several places become objects.
    keeps_instances: bool,
    /// Files that it refers to and that were read so far.
    companions: Mutex<Vec<PathBuf>>,
}

impl Input<'_> {
    /// Notes that this file was read as a part of the model.
    fn has_companion(&self, path: &Path) {
        self.companions.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_owned());
    }

    /// All that were noted, each once.
    fn companions(&self) -> Vec<PathBuf> {
        let mut list = self.companions.lock().unwrap_or_else(PoisonError::into_inner).clone();
        list.sort_unstable();
        list.dedup();
        list
    }
}

/// `texture`: for models without images of their own.
fn read(format: Format, input: &Input, texture: Option<&Path>) -> Result<(Model, Vec<String>), ImportError> {
    let mut warnings = Warnings::default();
    let mut model = match format {
        Format::Obj => obj::read(input, &mut warnings),
        Format::Ply => ply::read(input, &mut warnings),
        Format::Stl => stl::read(input, &mut warnings).map(|soup| Model { soup, ..Model::default() }),
        Format::Gltf => gltf::read(input, &mut warnings),
    }?;
    let soup = &model.soup;
    if soup.triangles.len() > input.max_triangles {
        return Err(too_many(input.name, input.max_triangles));
    }
    if soup.triangles.is_empty() {
        let what = "there are no faces in it";
        return Err(refused(Refusal::NoFaces, input.name, what, "points and lines cannot be baked: export a mesh"));
    }
    if let Some(i) = first_bad_position(&soup.positions) {
        let [x, y, z] = soup.positions[i];
        let what = format!("vertex {i} (counted from 0) has the position ({x}, {y}, {z}), which is no usable place");
        return Err(refused(Refusal::NotFinite, input.name, what, "remove the vertex or export the model again"));
    }
    model.tidy(&mut warnings);
    if let Some(path) = texture {
        let content = ImageContent::File(path.to_owned());
        model.cover(ImageSource { name: path.display().to_string(), content }, &mut warnings);
    }
    Ok((model, warnings.into_list()))
}

fn too_many(name: &str, limit: usize) -> ImportError {
    let what = format!("the scene has more than {limit} triangles once this input is expanded");
    refused(Refusal::TooLarge, name, what, "bake it in several parts")
}

/// Different warnings in order of appearance, so many times each.
#[derive(Default)]
struct Warnings {
    list: Vec<(String, u64)>,
    more: u64,
}

impl Warnings {
    /// Notes something odd; the same text is kept once and counted.
    fn add(&mut self, text: impl AsRef<str>) {
        let text = text.as_ref();
        if let Some(known) = self.list.iter_mut().find(|w| w.0 == text) {
            known.1 += 1;
        } else if self.list.len() < MAX_WARNING_COUNT {
            self.list.push((text.to_owned(), 1));
        } else {
            self.more += 1;
        }
    }

    /// Takes over those of another list.
    fn append(&mut self, other: Warnings) {
        for (text, count) in other.list {
            match self.list.iter_mut().find(|w| w.0 == text) {
                Some(known) => known.1 += count,
                None => self.list.push((text, count)),
            }
        }
        self.more += other.more;
    }

    fn into_list(self) -> Vec<String> {
        let counted = |(text, count): (String, u64)| if count > 1 { format!("{text} ({count} times)") } else { text };
        let more = (self.more > 0).then(|| format!("and {} more warnings", self.more));
        self.list.into_iter().map(counted).chain(more).collect()
    }
}

/// Runs a parser of somebody else; a panic in it becomes an error that names the file.
fn guarded<T>(name: &str, parse: impl FnOnce() -> T) -> Result<T, ImportError> {
    let damage = || damaged(name, "its content is so damaged that the parser gave up");
    crate::guard::guarded(parse).ok_or_else(damage)
}
