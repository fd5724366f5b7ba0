//! What `inspect` and `verify` say about textures.

use pb_lod::progressive_buffers::model::Model;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// One map of the model.
#[derive(Serialize)]
struct Map {
    kind: &'static str,
    format: &'static str,
}

/// Tiles of one size.
#[derive(Serialize)]
struct Tiles {
    /// Texels per side.
    side: u32,
    tiles: u64,
}

/// Maps and tiles of a textured model.
#[derive(Serialize)]
pub struct TextureInspection {
    maps: Vec<Map>,
    /// Base colours with an alpha below one half are holes.
    cut_out: bool,
    /// Smallest first.
    tile_sizes: Vec<Tiles>,
    /// Of all tiles at mip 0.
    texels: u64,
    /// Of all mips of all maps.
    bytes: u64,
    bytes_per_texel: f64,
    /// Side of a texel of mip 0 on the surface, input units, of the finest and of the coarsest tile.
    texel_size_min: f32,
    texel_size_max: f32,
}

impl TextureInspection {
    /// From the tables; `None` for models without textures.
    pub fn new(model: &Model) -> Option<Self> {
        let textures = model.textures()?;
        let map = |m: &pb_lod::progressive_buffers::textures::MapRecord| Map {
            kind: m.kind().map_or("unknown", |k| k.name()),
            format: m.format().map_or("unknown", |f| f.name()),
        };
        let mut sizes: BTreeMap<u32, u64> = BTreeMap::new();
        textures.tiles.iter().for_each(|t| *sizes.entry(t.side(0)).or_default() += 1);
        let texels: u64 = sizes.iter().map(|(&side, tiles)| u64::from(side).pow(2) * tiles).sum();
        let bytes = texture_chunks(model).map(u64::from).sum();
        let sizes_on_surface = || textures.tiles.iter().map(|t| t.texel);
        Some(Self {
            maps: textures.maps.iter().map(map).collect(),
            cut_out: model.has_cutouts(),
            tile_sizes: sizes.into_iter().map(|(side, tiles)| Tiles { side, tiles }).collect(),
            texels,
            bytes,
            bytes_per_texel: bytes as f64 / texels.max(1) as f64,
            texel_size_min: sizes_on_surface().fold(f32::INFINITY, f32::min),
            texel_size_max: sizes_on_surface().fold(0.0, f32::max),
        })
    }

    /// For people, three lines.
    pub fn text(&self) -> String {
        let maps: Vec<String> = self.maps.iter().map(|m| format!("{} ({})", m.kind, m.format)).collect();
        let mut text = format!("maps: {}{}\n", maps.join(", "), if self.cut_out { ", cut out" } else { "" });
        let sizes: Vec<String> = self.tile_sizes.iter().map(|t| format!("{} of {}", t.tiles, t.side)).collect();
        let _ = writeln!(text, "tiles: {} texels wide", sizes.join(", "));
        let _ = writeln!(
            text,
            "texels: {}, {} bytes with all mips, {:.2} per texel; {:.3e} to {:.3e} wide on the surface",
            self.texels, self.bytes, self.bytes_per_texel, self.texel_size_min, self.texel_size_max
        );
        text
    }
}

/// Stored bytes of the chunks of textures.
fn texture_chunks(model: &Model) -> impl Iterator<Item = u32> {
    let geometry = model.record().clusters as usize * model.levels() as usize;
    model.archive().chunks().iter().skip(geometry).map(|c| c.stored_bytes)
}

/// What `verify` has looked at; empty for models without textures.
pub fn checked(model: &Model) -> String {
    let Some(textures) = model.textures() else { return String::new() };
    let chunks = texture_chunks(model).filter(|&bytes| bytes > 0).count();
    format!("textures: {chunks} chunks of {} tiles, no triangle turned over in them; ", textures.tiles.len())
}
