//! What the reference renderer draws: all triangles of a model in world space, with the images that colour them.

use anyhow::{Result, bail};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::Path;

use crate::mesh::Mesh;

use super::image::Image;
use super::{load_gltf, load_obj};

/// What an image shows outside the unit square.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

/// Base colour of some triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Index into [`Scene::images`].
    pub image: Option<usize>,
    /// Linear light, straight alpha; multiplied with image and vertex colour.
    pub factor: [f32; 4],
    /// Per axis.
    pub wrap: [Wrap; 2],
    /// No interpolation between texels.
    pub nearest: bool,
    /// Points with less alpha are holes.
    pub cutoff: Option<f32>,
    /// Light from behind comes through as alpha says; of which side of the surface.
    pub blend: Option<Blend>,
}

/// Which sides of a surface that is blended are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blend {
    /// Those that see their corners counter-clockwise.
    Front,
    Both,
}

impl Material {
    /// Opaque, repeated.
    pub fn plain(image: Option<usize>, factor: [f32; 4]) -> Material {
        Material { image, factor, wrap: [Wrap::Repeat; 2], nearest: false, cutoff: None, blend: None }
    }
}

/// One triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Into [`Scene::positions`].
    pub corners: [u32; 3],
    /// Of the corners; (0, 0) is the upper left corner of the image, 1 its width and height.
    pub uv: [[f32; 2]; 3],
    /// Into [`Scene::materials`].
    pub material: u32,
}

/// A model.
#[derive(Default)]
pub struct Scene {
    pub positions: Vec<DVec3>,
    pub triangles: Vec<Triangle>,
    /// Linear light, of the corners of each triangle; empty where no vertex of the model has a colour.
    pub colors: Vec<[[f32; 4]; 3]>,
    pub materials: Vec<Material>,
    pub images: Vec<Image>,
}

/// What pb-view shows where a model has neither colours nor images; linear light.
const GREY: [f32; 4] = [0.58, 0.56, 0.53, 1.0];

impl Scene {
    /// Reads an .obj (with its MTL), .gltf, .glb or .ply (positions only) file.
    pub fn read(path: &Path) -> Result<Scene> {
        let mut scene = match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("obj") => load_obj::load(path)?,
            Some("gltf" | "glb") => load_gltf::load(path, load_gltf::Images::Read)?,
            Some("ply") => uncoloured(&Mesh::read(path)?),
            _ => bail!("{}: only .obj, .gltf, .glb and .ply can be drawn", path.display()),
        };
        let used: BTreeSet<u32> = scene.triangles.iter().map(|t| t.material).collect();
        let is_plain = |m: &Material| m.image.is_none() && m.factor == [1.0; 4];
        if scene.colors.is_empty() && used.iter().all(|&m| is_plain(&scene.materials[m as usize])) {
            scene.materials.iter_mut().for_each(|m| m.factor = GREY);
        }
        Ok(scene)
    }

    /// The same of a .glb file without its images: where its triangles are, and with which coordinates.
    pub fn read_shape(path: &Path) -> Result<Scene> {
        load_gltf::load(path, load_gltf::Images::Skipped)
    }

    /// Gives all materials without an image this one.
    pub fn cover(&mut self, image: Image) {
        let index = self.images.len();
        self.images.push(image);
        for material in self.materials.iter_mut().filter(|m| m.image.is_none()) {
            (material.image, material.factor) = (Some(index), [1.0; 4]);
        }
    }

    /// Lowest and highest corner of the bounding box of all triangles.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let corners = self.triangles.iter().flat_map(|t| t.corners).map(|i| self.positions[i as usize]);
        corners.fold((DVec3::MAX, DVec3::MIN), |(low, high), p| (low.min(p), high.max(p)))
    }

    /// Corners of a triangle.
    pub fn corners(&self, triangle: &Triangle) -> [DVec3; 3] {
        triangle.corners.map(|i| self.positions[i as usize])
    }

    /// Texels of all images.
    pub fn texels(&self) -> u64 {
        self.images.iter().map(|i| i.width as u64 * i.height as u64).sum()
    }
}

fn uncoloured(mesh: &Mesh) -> Scene {
    Scene {
        positions: mesh.positions.iter().map(|&p| p.into()).collect(),
        triangles: mesh.triangles.iter().map(|&t| Triangle { corners: t, uv: [[0.0; 2]; 3], material: 0 }).collect(),
        materials: vec![Material::plain(None, [1.0; 4])],
        ..Scene::default()
    }
}
