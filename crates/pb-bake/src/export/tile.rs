//! Tiles for other programs: a cluster's mesh with its texture coordinates, and its maps as plain images.

use half::f16;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use pb_lod::progressive_buffers::model::{Model, ModelError};
use pb_lod::progressive_buffers::textures::{MapFormat, MapKind, TAIL_SIZE_LOG2};
use pb_mesh::texture::{BlockFormat, Texels, decode};
use std::io;

/// One level of one cluster, without vertices that no triangle uses.
#[derive(Default)]
pub(super) struct Part {
    /// Grid space.
    pub grid: Vec<[i32; 3]>,
    /// Unit length.
    pub normals: Vec<[f32; 3]>,
    /// Parts of the tile's side, v downwards.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex indices.
    pub triangles: Vec<[u16; 3]>,
}

impl Part {
    /// Decodes a level of a cluster.
    pub fn read(model: &Model, cluster: u32, level: u32) -> Result<Part, ModelError> {
        let prefix = model.read_prefix(cluster, level)?;
        let mut part = Part::default();
        let mut place = vec![None; prefix.vertices.len()];
        let mut corner = |i: u16| {
            *place[usize::from(i)].get_or_insert_with(|| {
                let v = &prefix.vertices[usize::from(i)];
                part.grid.push(model.grid(cluster, v));
                part.normals.push(v.normal());
                part.uvs.push(v.uv().map(|c| f32::from(c) / 65536.0));
                (part.grid.len() - 1) as u16
            })
        };
        part.triangles = prefix.indices.chunks_exact(3).map(|t| [corner(t[0]), corner(t[1]), corner(t[2])]).collect();
        Ok(part)
    }
}

/// One mip of one map of a tile.
pub(super) struct TileImage {
    side: u32,
    /// Rows from the top; colours sRGB encoded, brightness above 1 cut off.
    texels: Vec<[u8; 4]>,
}

impl TileImage {
    /// The mip that belongs to a level, or of a small tile the one 32 texels wide: below that, charts may mix. `None`
    /// where the model has no such map.
    pub fn read(model: &Model, cluster: u32, level: u32, kind: MapKind) -> Result<Option<TileImage>, ModelError> {
        let Some(textures) = model.textures() else { return Ok(None) };
        let Some(map) = textures.maps.iter().position(|m| m.kind() == Some(kind)) else { return Ok(None) };
        let tile = &textures.tiles[cluster as usize];
        let widest_mixed = u32::from(tile.size_log2.saturating_sub(TAIL_SIZE_LOG2));
        let wanted = level.min(widest_mixed).max(u32::from(tile.first[map]));
        let place = (0..model.levels()).find_map(|level| {
            let mut mips = textures.mips(cluster, level);
            mips.find(|m| m.map as usize == map && m.mip == wanted).map(|m| (level, m))
        });
        let (level, mip) = place.expect("every mip from the map's first is in one chunk");
        let bytes = model.read_texture(model.texture_chunk_id(cluster, level))?;
        let bytes = &bytes[mip.offset as usize..][..mip.bytes as usize];
        let format = block_format(textures.maps[map].format().expect("checked when opened"));
        let texels = decode(format, bytes, mip.side).expect("a mip has its format's bytes");
        let mut texels = bytes_of(texels);
        if !model.has_cutouts() {
            texels.iter_mut().for_each(|t| t[3] = 255); // what blocks say there is rounding
        }
        Ok(Some(TileImage { side: mip.side, texels }))
    }

    /// The texel at a texture coordinate, units of 1/65536 of the tile.
    pub fn nearest(&self, uv: [u16; 2]) -> [u8; 4] {
        let [x, y] = uv.map(|c| ((u64::from(c) * u64::from(self.side)) >> 16) as usize);
        self.texels[y * self.side as usize + x]
    }

    /// As a PNG file, with alpha only where it is asked for.
    pub fn png(&self, alpha: bool) -> io::Result<Vec<u8>> {
        let mut png = Vec::new();
        let opaque: Vec<u8>;
        let (bytes, color) = match alpha {
            true => (self.texels.as_flattened(), ExtendedColorType::Rgba8),
            false => {
                opaque = self.texels.iter().flat_map(|t| [t[0], t[1], t[2]]).collect();
                (opaque.as_slice(), ExtendedColorType::Rgb8)
            }
        };
        PngEncoder::new(&mut png).write_image(bytes, self.side, self.side, color).map_err(io::Error::other)?;
        Ok(png)
    }
}

fn block_format(format: MapFormat) -> BlockFormat {
    match format {
        MapFormat::Bc7Srgb | MapFormat::Bc7Linear => BlockFormat::Bc7,
        MapFormat::Bc5 => BlockFormat::Bc5,
        MapFormat::Bc6h => BlockFormat::Bc6h,
        MapFormat::Rgba8Srgb | MapFormat::Rgba8Linear => BlockFormat::Rgba8,
        MapFormat::Rg8 => BlockFormat::Rg8,
        MapFormat::RgbaF16 => BlockFormat::RgbaF16,
    }
}

fn bytes_of(texels: Texels) -> Vec<[u8; 4]> {
    match texels {
        Texels::Rgba8(texels) => texels,
        Texels::Rg8(texels) => texels.into_iter().map(with_z).collect(),
        Texels::RgbaF16(texels) => {
            let byte = |x: f32| (x * 255.0).round() as u8;
            let half = |h: u16| f16::from_bits(h).to_f32().clamp(0.0, 1.0);
            texels
                .into_iter()
                .map(|t| t.map(half))
                .map(|[r, g, b, a]| [byte(srgb(r)), byte(srgb(g)), byte(srgb(b)), byte(a)])
                .collect()
        }
    }
}

/// A unit vector from its x and y, as `2 c - 1`.
fn with_z([r, g]: [u8; 2]) -> [u8; 4] {
    let [x, y] = [r, g].map(|c| f32::from(c) / 127.5 - 1.0);
    let z = (1.0 - x * x - y * y).max(0.0).sqrt();
    [r, g, ((z + 1.0) * 127.5).round() as u8, 255]
}

/// Linear light as sRGB says it.
fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}
