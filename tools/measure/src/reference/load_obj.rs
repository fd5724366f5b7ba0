//! OBJ and MTL by the crate tobj.
//!
//! As in pb-bake: `Kd` and colours of vertices are sRGB; where there is an image or a vertex has a colour, `Kd` plays
//! no part.

use anyhow::{Context, Result};
use std::path::Path;

use super::image::{Image, linear_of_srgb};
use super::scene::{Material, Scene, Triangle};

/// Diffuse colours that programs write when nobody chose one.
const DEFAULT_DIFFUSE: [f64; 2] = [0.8, 1.0];

pub fn load(path: &Path) -> Result<Scene> {
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj(path, &options).with_context(|| path.display().to_string())?;
    let materials = materials.unwrap_or_else(|e| {
        eprintln!("pb-measure: warning: {}: materials: {e}", path.display());
        Vec::new()
    });
    let mut scene = Scene::default();
    for material in &materials {
        let image = material.diffuse_texture.as_ref().map(|name| image_of(path, name, &mut scene.images));
        let kd = material.diffuse.filter(|kd| !DEFAULT_DIFFUSE.iter().any(|d| *kd == [*d; 3])).unwrap_or([1.0; 3]);
        let factor = if image.is_some() { [1.0; 3] } else { kd };
        let [r, g, b] = factor.map(|c| linear_of_srgb(c.clamp(0.0, 1.0)) as f32);
        scene.materials.push(Material::plain(image, [r, g, b, 1.0]));
    }
    scene.materials.push(Material::plain(None, [1.0; 4]));
    // The same once more without Kd, for parts with colours of their own.
    let white: Vec<Material> = scene.materials.iter().map(|m| Material { factor: [1.0; 4], ..m.clone() }).collect();
    scene.materials.extend(white);
    let has_colors = models.iter().any(|m| !m.mesh.vertex_color.is_empty());
    for model in &models {
        add(&model.mesh, has_colors, &mut scene);
    }
    Ok(scene)
}

fn add(mesh: &tobj::Mesh, has_colors: bool, scene: &mut Scene) {
    let first = scene.positions.len() as u32;
    let count = scene.materials.len() / 2;
    let own = mesh.material_id.unwrap_or(count - 1).min(count - 1);
    let material = if mesh.vertex_color.is_empty() { own } else { own + count } as u32;
    scene.positions.extend(mesh.positions.chunks_exact(3).map(glam::DVec3::from_slice));
    let uv_of = |corner: usize| match mesh.texcoord_indices.get(corner) {
        Some(&i) => [mesh.texcoords[2 * i as usize] as f32, (1.0 - mesh.texcoords[2 * i as usize + 1]) as f32],
        None => [0.0; 2],
    };
    let color_of = |i: u32| match mesh.vertex_color.get(3 * i as usize..3 * i as usize + 3) {
        Some(c) => [linear_of_srgb(c[0]) as f32, linear_of_srgb(c[1]) as f32, linear_of_srgb(c[2]) as f32, 1.0],
        None => [1.0; 4],
    };
    for (t, corners) in mesh.indices.chunks_exact(3).enumerate() {
        let uv = [3 * t, 3 * t + 1, 3 * t + 2].map(uv_of);
        scene.triangles.push(Triangle { corners: [0, 1, 2].map(|k| first + corners[k]), uv, material });
        if has_colors {
            scene.colors.push([0, 1, 2].map(|k| color_of(corners[k])));
        }
    }
}

/// The image that an MTL names: without its options, slashes of any kind, beside the OBJ.
fn image_of(obj: &Path, name: &str, images: &mut Vec<Image>) -> usize {
    let name = name.trim().replace('\\', "/");
    let folder = obj.parent().unwrap_or(Path::new("."));
    images.push(Image::or_missing(Image::open(&folder.join(&name))));
    images.len() - 1
}
