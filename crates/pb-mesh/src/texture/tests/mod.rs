//! Promises about whole tiles, on layouts of a few charts.

mod bake;
mod block;
mod mips;
mod normal;

use super::image::{Image, TexelFormat};
use super::*;
use crate::material::{Material, Slot, TextureRef};
use std::sync::Arc;

/// A surface with its layout, one quad after the other.
#[derive(Default)]
struct Scene {
    materials: Vec<Material>,
    images: Vec<Option<Image>>,
    material_of: Vec<u32>,
    uvs: Vec<[[f32; 2]; 3]>,
    colors: Vec<[[u8; 4]; 3]>,
    normals: Vec<[[f32; 3]; 3]>,
    positions: Vec<[[f32; 3]; 3]>,
    size: u32,
    corners: Vec<[[u16; 2]; 3]>,
    chart_of: Vec<u32>,
    open_edges: Vec<u8>,
}

impl Scene {
    fn new(size: u32) -> Scene {
        Scene { size, ..Scene::default() }
    }

    /// A scene of one image in one slot.
    fn with_image(size: u32, slot: Slot, image: Image) -> Scene {
        let mut scene = Scene::new(size);
        scene.images.push(Some(image));
        let mut material = Material::default();
        material.textures[slot as usize] = Some(TextureRef::plain(0));
        scene.materials.push(material);
        scene
    }

    /// Adds a quad as a chart of its own: corners in texels of the tile, texture coordinates of the corners.
    fn quad(&mut self, tile: [[f64; 2]; 4], uvs: [[f32; 2]; 4], color: [u8; 4]) {
        let unit = 65536.0 / f64::from(self.size);
        let tile = tile.map(|p| p.map(|x| (x * unit).round() as u16));
        let chart = self.chart_of.last().map_or(0, |c| c + 1);
        for t in [[0, 1, 2], [0, 2, 3]] {
            self.corners.push(t.map(|k| tile[k]));
            self.uvs.push(t.map(|k| uvs[k]));
            self.colors.push([color; 3]);
            self.chart_of.push(chart);
        }
    }

    /// Adds an axis-aligned rectangle: from x0, y0 to x1, y1 in texels; the image's part from u0, v0 to u1, v1.
    fn rectangle(&mut self, tile: [f64; 4], uv: [f32; 4], color: [u8; 4]) {
        let [x0, y0, x1, y1] = tile;
        let [u0, v0, u1, v1] = uv;
        self.quad([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], [[u0, v0], [u1, v0], [u1, v1], [u0, v1]], color);
    }

    fn layout(&self) -> TileLayout<'_> {
        TileLayout { size: self.size, corners: &self.corners, chart_of: &self.chart_of, open_edges: &self.open_edges }
    }

    fn bake_with(&self, map: MapKind, options: BakeOptions) -> Mips {
        let sets = [self.uvs.clone()];
        let source = TileSource {
            materials: &self.materials,
            images: &self.images,
            material_of: &self.material_of,
            uv_sets: &sets,
            colors: &self.colors,
            normals: &self.normals,
            positions: &self.positions,
        };
        let source = TileSource { material_of: &vec![0; self.corners.len()], ..source };
        bake_tile(&source, &self.layout(), &Coverage::new(&self.layout()), map, options)
    }

    fn bake(&self, map: MapKind) -> Mips {
        self.bake_with(map, BakeOptions::default())
    }
}

fn image(width: u32, height: u32, format: TexelFormat, bytes: Vec<u8>) -> Image {
    Image::new(width, height, format, Arc::new(bytes))
}

/// Every texel another colour.
fn noise(width: u32, height: u32) -> Image {
    let mut state = 12345u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    image(width, height, TexelFormat::Rgb8, (0..width * height * 3).map(|_| next()).collect())
}

fn rgba(texels: &Texels) -> &[[u8; 4]] {
    match texels {
        Texels::Rgba8(t) => t,
        _ => panic!("other texels"),
    }
}

fn pixel(image: &Image, x: u32, y: u32) -> [u8; 3] {
    let at = ((y * image.width() + x) * 3) as usize;
    image.bytes()[at..at + 3].try_into().unwrap()
}
