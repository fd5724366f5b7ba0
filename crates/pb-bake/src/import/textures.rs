//! What readers say about surfaces besides their shape: materials, and where their images are.
//!
//! Images are looked for beside the model and below its folder, never elsewhere, and never on another machine. One
//! that is not there stays in the list, so that it can be named and replaced by a placeholder later.

use super::Warnings;
use crate::images::{ImageContent, ImageSource};
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::{NO_MATERIAL, Soup};
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

/// Most sets of texture coordinates that are read.
pub(super) const MAX_UV_SETS: usize = 8;
/// Most files of a folder that are compared when a name differs in its case.
const MAX_LISTED_FILES: usize = 100_000;

/// What a reader makes of one input; then of all inputs together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// The surface.
    pub soup: Soup,
    /// What the soup's triangles count.
    pub materials: Vec<Material>,
    /// What the materials' textures count.
    pub images: Vec<ImageSource>,
    /// Of the soup's objects.
    pub instances: InstanceCounts,
}

/// What became of meshes that stand in several places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct InstanceCounts {
    /// Meshes that are kept once, each turned or stretched in one way.
    pub objects: u64,
    /// Their places.
    pub instances: u64,
    /// Places of repeated meshes that are written out: they are stretched like no other or flattened, or save few triangles.
    pub apart: u64,
}

impl Model {
    /// Drops images that no triangle shows, or that lie on no texture coordinates.
    pub(super) fn tidy(&mut self, warnings: &mut Warnings) {
        let sets = self.soup.uv_sets.len();
        let mut shown_somewhere = vec![false; self.materials.len()];
        self.soup.material_of.iter().filter(|&&m| m != NO_MATERIAL).for_each(|&m| shown_somewhere[m as usize] = true);
        let mut list = ImageList::default();
        for (material, shown_somewhere) in self.materials.iter_mut().zip(shown_somewhere) {
            let has_images = material.textures.iter().any(Option::is_some);
            for texture in &mut material.textures {
                *texture = texture.filter(|t| shown_somewhere && (t.uv_set as usize) < sets).map(|t| {
                    let image = list.add(self.images[t.image as usize].clone());
                    TextureRef { image, ..t }
                });
            }
            if has_images && shown_somewhere && sets == 0 {
                let name = shown(&material.name);
                warnings.add(format!(
                    "the images of the material \"{name}\" are not used: there are no texture coordinates"
                ));
            }
        }
        self.images = list.list;
    }

    /// Appends another input of the same scene. Images that are the same become one.
    pub(super) fn append(&mut self, other: Model) {
        let mut list = ImageList::of(std::mem::take(&mut self.images));
        let place: Vec<u32> = other.images.into_iter().map(|image| list.add(image)).collect();
        self.images = list.list;
        let base = self.materials.len() as u32;
        self.materials.extend(other.materials.into_iter().map(|mut material| {
            material.textures.iter_mut().flatten().for_each(|t| t.image = place[t.image as usize]);
            material
        }));
        self.instances.objects += other.instances.objects;
        self.instances.instances += other.instances.instances;
        self.instances.apart += other.instances.apart;
        let mut soup = other.soup;
        soup.material_of.iter_mut().filter(|m| **m != NO_MATERIAL).for_each(|m| *m += base);
        self.soup.append(soup);
    }

    /// Ends a scene: without images it has no materials either, with some every triangle has one.
    pub(super) fn finish(&mut self) {
        if self.images.is_empty() {
            self.materials = Vec::new();
            self.soup.material_of = Vec::new();
            self.soup.uv_sets = Vec::new();
        } else if self.soup.material_of.contains(&NO_MATERIAL) {
            let none = self.materials.len() as u32;
            self.soup.material_of.iter_mut().filter(|m| **m == NO_MATERIAL).for_each(|m| *m = none);
            self.materials.push(Material::default());
        }
    }

    /// Gives all materials of an input without images one as base colour.
    pub(super) fn cover(&mut self, image: ImageSource, warnings: &mut Warnings) {
        if self.materials.iter().any(|m| m.textures.iter().any(Option::is_some)) {
            return;
        }
        if self.soup.uv_sets.is_empty() {
            warnings.add("there are no texture coordinates, so --texture is not used");
            return;
        }
        self.soup.material_of.resize(self.soup.triangles.len(), NO_MATERIAL);
        self.images = vec![image];
        if self.soup.material_of.contains(&NO_MATERIAL) {
            let none = self.materials.len() as u32;
            self.soup.material_of.iter_mut().filter(|m| **m == NO_MATERIAL).for_each(|m| *m = none);
            self.materials.push(Material::default());
        }
        self.materials.iter_mut().for_each(|m| m.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(0)));
    }
}

/// Images without repetition, in the order of their first use.
#[derive(Default)]
pub(super) struct ImageList {
    pub(super) list: Vec<ImageSource>,
    /// By content; missing ones by their name too.
    known: HashMap<(String, ImageContent), u32>,
}

impl ImageList {
    fn of(images: Vec<ImageSource>) -> ImageList {
        let mut list = ImageList::default();
        for image in images {
            list.add(image);
        }
        list
    }

    /// Its index.
    pub(super) fn add(&mut self, image: ImageSource) -> u32 {
        let name = if matches!(image.content, ImageContent::Missing(_)) { image.name.clone() } else { String::new() };
        *self.known.entry((name, image.content.clone())).or_insert_with(|| {
            self.list.push(image);
            self.list.len() as u32 - 1
        })
    }
}

/// The image of a name in a model, in the first folder that has it; else one that says that it is missing.
pub(super) fn named_image(model: &str, folders: &[&Path], name: &str) -> ImageSource {
    match find(folders, name) {
        Some(path) => ImageSource { name: path.display().to_string(), content: ImageContent::File(path) },
        None => {
            let reason = format!("{model} refers to this image, but it is not there; copy it beside the model");
            ImageSource { name: shown(name), content: ImageContent::Missing(reason) }
        }
    }
}

/// A file in or below one of some folders: by its path, by its last part alone, then by either without regard to case.
fn find(folders: &[&Path], name: &str) -> Option<PathBuf> {
    let name = name.trim().trim_matches('"').replace('\\', "/");
    let last = name.rsplit('/').next().filter(|last| !last.is_empty() && stays_inside(last))?;
    let relative = if stays_inside(&name) { &name } else { last };
    let places = || folders.iter().flat_map(|folder| [folder.join(relative), folder.join(last)]);
    places().find(|path| path.is_file()).or_else(|| places().find_map(|path| find_in_any_case(&path)))
}

/// The first file by its name that differs from a path in the case of its last part only.
fn find_in_any_case(path: &Path) -> Option<PathBuf> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let entries = std::fs::read_dir(path.parent()?).ok()?.take(MAX_LISTED_FILES).flatten();
    let same = entries.filter(|e| e.file_name().to_string_lossy().to_lowercase() == wanted).map(|e| e.path());
    same.filter(|p| p.is_file()).min()
}

/// Whether a relative path names something in or below the folder that it is relative to.
pub(super) fn stays_inside(name: &str) -> bool {
    let is_windows_absolute = name.as_bytes().get(1) == Some(&b':');
    let components = Path::new(name).components();
    !is_windows_absolute && components.into_iter().all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
}

/// A name of the input, short enough for a message.
pub(super) fn shown(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(200).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_that_leave_the_folder_are_known() {
        for name in ["../a.bin", "a/../../b", "/etc/passwd", "C:/a.bin", "c:a"] {
            assert!(!stays_inside(name), "{name}");
        }
        for name in ["a.bin", "./a b.bin", "deep/er/a.bin", "a..bin"] {
            assert!(stays_inside(name), "{name}");
        }
    }

    #[test]
    fn images_are_found_by_path_by_name_and_in_any_case_but_never_outside() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("model");
        std::fs::create_dir_all(inside.join("maps")).unwrap();
        for name in ["model/maps/a.png", "model/Wood Floor.PNG", "secret.png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = |name: &str| find(&[&inside], name).map(|p| p.strip_prefix(&inside).unwrap().to_owned());
        for name in ["maps/a.png", ".\\maps\\a.png", "maps/A.PNG"] {
            assert_eq!(found(name), Some("maps/a.png".into()), "{name}");
        }
        for name in [
            "Wood Floor.PNG",
            "wood floor.png",
            "C:\\art\\Wood Floor.PNG",
            "/art/wood floor.png",
            "file:///x/Wood Floor.PNG",
        ] {
            assert_eq!(found(name), Some("Wood Floor.PNG".into()), "{name}");
        }
        for name in ["../secret.png", "..\\secret.png", "a.png", "", "/", ".."] {
            assert_eq!(found(name), None, "{name}");
        }
    }
}
