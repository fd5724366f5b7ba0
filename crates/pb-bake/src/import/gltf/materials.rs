//! Materials, textures, samplers and images of a glTF document, for metallic-roughness shading.
//!
//! Nothing here refuses a model: what is broken or not known is left out with a warning, and the surface is drawn
//! without it. KHR_texture_transform, KHR_materials_emissive_strength, KHR_materials_unlit, EXT_texture_webp and, as far
//! as it has a metallic-roughness counterpart, KHR_materials_pbrSpecularGlossiness are known.

use super::super::Warnings;
use super::super::textures::{ImageList, MAX_UV_SETS, shown};
use super::buffers::Buffers;
use super::document::Document;
use crate::images::ImageSource;
use pb_mesh::material::{Material, Slot, TextureRef, Wrap};
use serde_json::Value;

/// Alpha below which blended materials are invisible.
const BLEND_CUTOFF: f32 = 1.0 / 16.0;
/// What `alphaCutoff` is unless given.
const MASK_CUTOFF: f32 = 0.5;
/// Samplers: the codes of OpenGL.
const CLAMP: u64 = 33_071;
const MIRROR: u64 = 33_648;
const NEAREST: u64 = 9728;

/// All materials of a document.
#[derive(Default)]
pub(super) struct Materials {
    /// In the document's order.
    pub(super) list: Vec<Material>,
    /// Which images they use.
    pub(super) images: ImageList,
    /// Which `TEXCOORD_n` each set of texture coordinates is.
    pub(super) uv_sets: Vec<u32>,
}

/// Reads all materials, and finds their images.
pub(super) fn read(document: &Document, buffers: &Buffers, warnings: &mut Warnings) -> Materials {
    let mut reader = Reader { document, buffers, warnings, out: Materials::default() };
    for material in &document.materials {
        let read = reader.material(material);
        reader.out.list.push(read);
    }
    reader.out
}

/// Linear red, green, blue, alpha of a material.
pub(super) fn color(material: &Value) -> [f64; 4] {
    let gloss = extension(material, "KHR_materials_pbrSpecularGlossiness").and_then(|g| numbers(&g["diffuseFactor"]));
    gloss.or(numbers(&material["pbrMetallicRoughness"]["baseColorFactor"])).unwrap_or([1.0; 4])
}

fn extension<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    value["extensions"].get(name)
}

/// N finite numbers.
fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list = value.as_array().filter(|list| list.len() == N)?;
    let mut numbers = [0.0; N];
    for (number, value) in numbers.iter_mut().zip(list) {
        *number = value.as_f64().filter(|x| x.is_finite())?;
    }
    Some(numbers)
}

fn number(value: &Value, missing: f32) -> f32 {
    value.as_f64().map(|x| x as f32).filter(|x| x.is_finite()).unwrap_or(missing)
}

struct Reader<'a, 'b> {
    document: &'a Document,
    buffers: &'a Buffers<'b>,
    warnings: &'a mut Warnings,
    out: Materials,
}

impl Reader<'_, '_> {
    fn material(&mut self, value: &Value) -> Material {
        let name = shown(value["name"].as_str().unwrap_or("without a name"));
        let mut material = Material { name, ..Material::default() };
        let shading = &value["pbrMetallicRoughness"];
        let base = match extension(value, "KHR_materials_pbrSpecularGlossiness") {
            Some(gloss) => {
                self.warnings.add("specular-glossiness materials are read as matt or shiny ones without metal");
                material.roughness = 1.0 - number(&gloss["glossinessFactor"], 1.0).clamp(0.0, 1.0);
                &gloss["diffuseTexture"]
            }
            None => {
                material.metallic = number(&shading["metallicFactor"], 1.0).clamp(0.0, 1.0);
                material.roughness = number(&shading["roughnessFactor"], 1.0).clamp(0.0, 1.0);
                let rough = self.texture(&shading["metallicRoughnessTexture"]);
                material.textures[Slot::MetallicRoughness as usize] = rough;
                &shading["baseColorTexture"]
            }
        };
        material.textures[Slot::BaseColor as usize] = self.texture(base);
        if extension(value, "KHR_materials_unlit").is_some() {
            (material.metallic, material.roughness) = (0.0, 1.0);
        }
        for (slot, key) in [
            (Slot::Normal, "normalTexture"),
            (Slot::Occlusion, "occlusionTexture"),
            (Slot::Emissive, "emissiveTexture"),
        ] {
            material.textures[slot as usize] = self.texture(&value[key]);
        }
        material.normal_scale = number(&value["normalTexture"]["scale"], 1.0);
        material.occlusion_strength = number(&value["occlusionTexture"]["strength"], 1.0).clamp(0.0, 1.0);
        let strength =
            extension(value, "KHR_materials_emissive_strength").map_or(1.0, |e| number(&e["emissiveStrength"], 1.0));
        let emission = numbers::<3>(&value["emissiveFactor"]).unwrap_or_default();
        material.emissive = emission.map(|x| (x as f32 * strength).max(0.0));
        material.alpha_cutoff = self.cutoff(value, &material);
        material.is_blended = material.alpha_cutoff.is_some() && value["alphaMode"] == "BLEND";
        material
    }

    /// The alpha below which texels are holes.
    fn cutoff(&mut self, value: &Value, material: &Material) -> Option<f32> {
        match value["alphaMode"].as_str() {
            Some("MASK") => Some(number(&value["alphaCutoff"], MASK_CUTOFF)),
            Some("BLEND") => {
                self.warnings.add("blended transparency is drawn as cut-out, in steps of a quarter");
                let is_opaque = color(value)[3] >= 1.0 && material.texture(Slot::BaseColor).is_none();
                (!is_opaque).then_some(BLEND_CUTOFF)
            }
            _ => None,
        }
    }

    /// From a textureInfo; none where there is none or it cannot be used.
    fn texture(&mut self, info: &Value) -> Option<TextureRef> {
        if info.is_null() {
            return None;
        }
        let count = self.document.textures.len();
        let Some(texture) = info["index"].as_u64().and_then(|i| self.document.textures.get(i as usize)) else {
            let index = &info["index"];
            self.warnings
                .add(format!("a material refers to texture {index}, but there are only {count}; it is not used"));
            return None;
        };
        let image = self.image(texture)?;
        let transform = extension(info, "KHR_texture_transform");
        let set = transform.and_then(|t| t["texCoord"].as_u64()).or(info["texCoord"].as_u64()).unwrap_or(0);
        let uv_set = self.uv_set(u32::try_from(set).unwrap_or(u32::MAX))?;
        let mut plain = TextureRef { uv_set, ..TextureRef::plain(image) };
        if let Some(transform) = transform {
            plain.transform = matrix(transform);
        }
        if let Some(sampler) = texture["sampler"].as_u64().and_then(|i| self.document.samplers.get(i as usize)) {
            plain.wrap = ["wrapS", "wrapT"].map(|key| match sampler[key].as_u64() {
                Some(CLAMP) => Wrap::Clamp,
                Some(MIRROR) => Wrap::Mirror,
                _ => Wrap::Repeat,
            });
            plain.nearest = sampler["magFilter"].as_u64() == Some(NEAREST);
        }
        Some(plain)
    }

    fn image(&mut self, texture: &Value) -> Option<u32> {
        let webp = extension(texture, "EXT_texture_webp").and_then(|e| e["source"].as_u64());
        let other = || {
            let known = ["MSFT_texture_dds", "KHR_texture_basisu", "EXT_texture_avif"];
            known.iter().find_map(|name| extension(texture, name)?["source"].as_u64())
        };
        let Some(index) = webp.or(texture["source"].as_u64()).or_else(other) else {
            self.warnings.add("a texture has no image; it is not used");
            return None;
        };
        let images = &self.document.images;
        let Some(image) = images.get(index as usize) else {
            let count = images.len();
            self.warnings.add(format!("a texture refers to image {index}, but there are only {count}; it is not used"));
            return None;
        };
        let name = image["name"].as_str().or(image["uri"].as_str().filter(|uri| !uri.starts_with("data:")));
        let name = name.map_or(String::new(), |name| format!(" (\"{}\")", shown(name)));
        let name = format!("image {index}{name}");
        let content = match (image["uri"].as_str(), image["bufferView"].as_u64()) {
            (Some(uri), _) => self.buffers.image_of_uri(uri),
            (None, Some(view)) => self.buffers.image_of_view(&self.document.buffer_views, view as usize),
            (None, None) => {
                crate::images::ImageContent::Missing("it has neither a URI nor a buffer view; export it again".into())
            }
        };
        Some(self.out.images.add(ImageSource { name: format!("{}: {name}", self.buffers.model()), content }))
    }

    /// The set of texture coordinates that `TEXCOORD_n` becomes.
    fn uv_set(&mut self, number: u32) -> Option<u32> {
        let sets = &mut self.out.uv_sets;
        if let Some(known) = sets.iter().position(|&n| n == number) {
            return Some(known as u32);
        }
        if sets.len() == MAX_UV_SETS {
            self.warnings
                .add(format!("more than {MAX_UV_SETS} sets of texture coordinates are in use; the last are not read"));
            return None;
        }
        sets.push(number);
        Some(sets.len() as u32 - 1)
    }
}

/// KHR_texture_transform: scale, then rotation, then offset; rotation counter-clockwise with v downwards.
fn matrix(transform: &Value) -> [[f32; 3]; 2] {
    let [x, y] = numbers(&transform["offset"]).unwrap_or([0.0; 2]);
    let [sx, sy] = numbers(&transform["scale"]).unwrap_or([1.0; 2]);
    let (sin, cos) = transform["rotation"].as_f64().filter(|r| r.is_finite()).unwrap_or(0.0).sin_cos();
    [[cos * sx, sin * sy, x], [-sin * sx, cos * sy, y]].map(|row| row.map(|x| x as f32))
}
