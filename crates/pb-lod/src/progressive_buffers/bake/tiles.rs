//! The texels of every tile: resampled from the source's images, filled, packed, and cut into chunks.

use super::assemble::Finished;
use super::charting::{ClusterTile, Tiles};
use super::lanes::run_bounded;
use super::surface::Surface;
use super::{Clusters, Outside, Stage, TextureInput};
use crate::progressive_buffers::model::{FLAG_CUTOUT, FLAG_INSTANCES, FLAG_TEXTURES};
use crate::progressive_buffers::textures::{MapFormat, MapKind, MapRecord, TileRecord, chunk_mips};
use crate::progressive_buffers::write::{BakedModel, EncodedChunk};
use glam::IVec3;
use pb_archive::{ArchiveError, Spill};
use pb_mesh::material::Material;
use pb_mesh::mesh::Texturing;
use pb_mesh::texture::{
    self, BakeOptions, BlockFormat, Coverage, Mips, NormalSpace, Quality, TileLayout, TileSource, bake_tile, encode,
    encode_shown, scratch_bytes,
};
use std::sync::atomic::{AtomicU64, Ordering};

/// Tiles at work hold at most so many bytes together, or one is at work alone.
const TILE_WORK_BYTES: u64 = 640 << 20;

/// How texels are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TexelOptions {
    /// How long to search for good blocks.
    pub quality: Quality,
    /// Blocks of 4 x 4 texels; else plain texels, which take 4 times the room.
    pub compress: bool,
    /// Of normal maps. [`NormalSpace::Object`] makes one for every model that has a
    /// [`Texturing`](pb_mesh::mesh::Texturing), be it one without images: coarse levels are lit like the finest.
    pub normal_space: NormalSpace,
}

impl Default for TexelOptions {
    fn default() -> Self {
        TexelOptions { quality: Quality::default(), compress: true, normal_space: NormalSpace::default() }
    }
}

/// HDR models of no more texels than this keep halves: what is magnified shows the steps of blocks, and 8 bytes for each
/// of them are soon read.
const FEW_TEXELS: u64 = 1 << 18;

/// A texel that shows nowhere takes this much of the time of others: it is filled, but not packed.
const BARE_TEXEL: f64 = 0.04;

/// One map of the model, and how it is made.
struct Map {
    record: MapRecord,
    kind: texture::MapKind,
    format: BlockFormat,
    hdr: bool,
}

/// The maps that a model with these materials and tiles has; `has_colors`: of its vertices.
fn maps(input: &TextureInput, has_colors: bool, tile_texels: u64) -> Vec<Map> {
    let TextureInput { materials, images, texels: options, .. } = input;
    const KINDS: [(texture::MapKind, MapKind); 4] = [
        (texture::MapKind::BaseColor, MapKind::BaseColor),
        (texture::MapKind::Orm, MapKind::Orm),
        (texture::MapKind::Normal, MapKind::Normal),
        (texture::MapKind::Emissive, MapKind::Emissive),
    ];
    let cut_out = materials.iter().any(|m| m.alpha_cutoff.is_some());
    let is_used = |kind: texture::MapKind| match kind {
        // Without a colour anywhere surfaces look as without textures.
        texture::MapKind::BaseColor => has_colors || !materials.is_empty(),
        texture::MapKind::Normal if options.normal_space == NormalSpace::Object => true,
        _ => kind.is_used_by(materials),
    };
    let used = KINDS.into_iter().filter(|(kind, _)| is_used(*kind));
    used.map(|(kind, stored)| {
        let hdr = kind.is_hdr(materials, images);
        let tangent = options.normal_space == NormalSpace::Tangent;
        // Blocks of halves have no alpha.
        let plain_halves =
            !options.compress || tile_texels <= FEW_TEXELS || kind == texture::MapKind::BaseColor && cut_out;
        let color = matches!(kind, texture::MapKind::BaseColor | texture::MapKind::Emissive);
        let (format, record) = match (kind, options.compress) {
            _ if hdr && plain_halves => (BlockFormat::RgbaF16, MapFormat::RgbaF16),
            _ if hdr => (BlockFormat::Bc6h, MapFormat::Bc6h),
            (_, true) if color => (BlockFormat::Bc7, MapFormat::Bc7Srgb),
            (_, false) if color => (BlockFormat::Rgba8, MapFormat::Rgba8Srgb),
            (texture::MapKind::Normal, true) if tangent => (BlockFormat::Bc5, MapFormat::Bc5),
            (texture::MapKind::Normal, false) if tangent => (BlockFormat::Rg8, MapFormat::Rg8),
            (_, true) => (BlockFormat::Bc7, MapFormat::Bc7Linear),
            (_, false) => (BlockFormat::Rgba8, MapFormat::Rgba8Linear),
        };
        Map { record: MapRecord::new(stored, record), kind, format, hdr }
    })
    .collect()
}

/// How much there is to do for the texels of a model, for progress displays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelWork {
    /// Texels of all tiles at level 0.
    pub tile_texels: u64,
    /// What takes the time: texels of all maps under charts, and a small share of the others.
    pub packed_texels: u64,
}

impl TexelWork {
    pub(super) fn new(input: &TextureInput, has_colors: bool, tiles: &Tiles) -> Self {
        let tile_texels = tiles.texels();
        let maps = maps(input, has_colors, tile_texels).len() as u64;
        TexelWork { tile_texels, packed_texels: tiles.tiles.iter().map(|t| packed_texels(t) * maps).sum() }
    }
}

/// Of one map, see [`TexelWork`].
fn packed_texels(tile: &ClusterTile) -> u64 {
    (f64::from(tile.size).powi(2) * (tile.fill + BARE_TEXEL)) as u64
}

/// Fills all tiles: maps, tiles and texture chunks of the model, in the given order of the clusters.
pub(super) fn fill_tiles(
    finished: &Finished,
    input: &TextureInput,
    tiles: &Tiles,
    order: &[u32],
    model: &mut BakedModel,
    outside: &Outside,
) -> Result<(), ArchiveError> {
    let texels = tiles.texels();
    let maps = maps(input, finished.surface.has_colors, texels);
    let baker = TileBaker {
        surface: finished.surface,
        texturing: finished.surface.texturing.as_ref().expect("only textured meshes have tiles"),
        triangles: &finished.surface.triangles,
        clusters: finished.clusters,
        tiles,
        input,
        maps: &maps,
        materials: input.materials.iter().cloned().chain([Material::default()]).collect(),
        levels: finished.levels as u32,
    };
    let bytes: Vec<u64> = order.iter().map(|&c| baker.work_bytes(tiles.tiles[c as usize].size)).collect();
    let whole = tiles.tiles.iter().map(packed_texels).sum::<u64>().max(1);
    let done = AtomicU64::new(0);
    let tile = |new: usize| {
        let c = order[new] as usize;
        let baked = outside.try_kept("texels", new as u32, || baker.bake(c, outside.spill));
        let own = packed_texels(&tiles.tiles[c]);
        (outside.progress)(Stage::Textures, (done.fetch_add(own, Ordering::Relaxed) + own) as f32 / whole as f32);
        baked
    };
    let baked = run_bounded(&bytes, TILE_WORK_BYTES, tile);
    for (tile, chunks) in baked? {
        model.tiles.push(tile);
        model.chunks.extend(chunks);
    }
    model.maps = maps.iter().map(|m| m.record).collect();
    let cut_out = input.materials.iter().any(|m| m.alpha_cutoff.is_some());
    model.record.flags = model.record.flags & FLAG_INSTANCES | FLAG_TEXTURES | if cut_out { FLAG_CUTOUT } else { 0 };
    Ok(())
}

/// What tiles are filled from.
struct TileBaker<'a> {
    surface: &'a Surface,
    texturing: &'a Texturing,
    /// Position indices.
    triangles: &'a [[u32; 3]],
    clusters: &'a Clusters,
    tiles: &'a Tiles,
    input: &'a TextureInput<'a>,
    maps: &'a [Map],
    /// Those of the input, and one for triangles without.
    materials: Vec<Material>,
    levels: u32,
}

impl TileBaker<'_> {
    /// What [`bake`](Self::bake) holds at most: one map at a time, and what is packed of all.
    fn work_bytes(&self, size: u32) -> u64 {
        let packed: usize = self.maps.iter().map(|m| m.format.bytes(size) * 4 / 3).sum();
        let hdr = self.maps.iter().any(|m| m.hdr);
        scratch_bytes(size, hdr) + packed as u64
    }

    /// The tile of cluster `c` and its texture chunks, finest level first.
    fn bake(&self, c: usize, spill: &Spill) -> Result<(TileRecord, Vec<EncodedChunk>), ArchiveError> {
        let tile = &self.tiles.tiles[c];
        let members = self.clusters.segmentation.cluster(c);
        let open_edges: Vec<u8> = members.iter().map(|&t| self.open_edges(t)).collect();
        let layout =
            TileLayout { size: tile.size, corners: &tile.corners, chart_of: &tile.chart_of, open_edges: &open_edges };
        let size_log2 = tile.size.trailing_zeros() as u8;
        let mut record = TileRecord {
            size_log2,
            first: [0; 4],
            reserved: [0; 3],
            texel: (tile.texel * self.clusters.grid.quantum as f32).clamp(f32::MIN_POSITIVE, f32::MAX),
        };
        let mut encoded: Vec<Vec<Vec<u8>>> = Vec::new();
        self.each_map(&layout, members, |coverage, k, mips| {
            record.first[k] = size_log2 - mips.size.trailing_zeros() as u8;
            encoded.push(self.encoded(&mips, &self.maps[k], coverage));
        });
        let records: Vec<MapRecord> = self.maps.iter().map(|m| m.record).collect();
        let mut chunk = |level: u32| {
            let mut bytes = Vec::new();
            for place in chunk_mips(&records, &record, level, self.levels) {
                let map = place.map as usize;
                let mip = std::mem::take(&mut encoded[map][(place.mip - u32::from(record.first[map])) as usize]);
                if bytes.is_empty() { bytes = mip } else { bytes.extend(mip) }
            }
            Ok(EncodedChunk { decoded_bytes: bytes.len() as u32, bytes: spill.put(bytes)? })
        };
        let chunks: Result<_, ArchiveError> = (0..self.levels).map(&mut chunk).collect();
        Ok((record, chunks?))
    }

    fn encoded(&self, mips: &Mips, map: &Map, coverage: &Coverage) -> Vec<Vec<u8>> {
        let (format, quality) = (map.format, self.input.texels.quality);
        let finer = (coverage.size() / mips.size).trailing_zeros() as usize;
        let each = mips.levels.iter().enumerate();
        each.map(|(i, texels)| match mips.levels.len() {
            1 => encode(texels, mips.side(i), format, quality),
            _ => encode_shown(texels, mips.side(i), format, quality, &coverage.shown_blocks(finer + i)),
        })
        .collect()
    }

    /// Makes the maps of a tile, one after the other, and hands them out with their numbers.
    fn each_map(&self, layout: &TileLayout, members: &[u32], mut take: impl FnMut(&Coverage, usize, Mips)) {
        let wedge = |w: u32| &self.surface.wedges[w as usize];
        let per_triangle = |t: &u32| self.surface.corners()[*t as usize];
        let none = self.input.materials.len() as u32;
        let material_of: Vec<u32> = members.iter().map(|&t| self.texturing.material_of[t as usize].min(none)).collect();
        let of_set = |set: &Vec<[[f32; 2]; 3]>| members.iter().map(|&t| set[t as usize]).collect();
        let uv_sets: Vec<Vec<[[f32; 2]; 3]>> = self.texturing.corner_uvs.iter().map(of_set).collect();
        let colors: Vec<_> = match self.surface.has_colors {
            true => members.iter().map(|t| per_triangle(t).map(|w| wedge(w).color)).collect(),
            false => Vec::new(),
        };
        let needs_normals = self.maps.iter().any(|m| m.kind == texture::MapKind::Normal);
        let (mut normals, mut positions) = (Vec::new(), Vec::new());
        if needs_normals {
            let point = |v: u32| IVec3::from_array(self.clusters.grid.points[v as usize]);
            let origin = point(self.triangles[members[0] as usize][0]);
            normals = members.iter().map(|t| per_triangle(t).map(|w| wedge(w).normal)).collect();
            let place = |&t: &u32| self.triangles[t as usize].map(|v| (point(v) - origin).as_vec3().to_array());
            positions = members.iter().map(place).collect();
        }
        let source = TileSource {
            materials: &self.materials,
            images: self.input.images,
            material_of: &material_of,
            uv_sets: &uv_sets,
            colors: &colors,
            normals: &normals,
            positions: &positions,
        };
        let coverage = Coverage::new(layout);
        for (k, map) in self.maps.iter().enumerate() {
            let options = BakeOptions { hdr: map.hdr, normal_space: self.input.texels.normal_space };
            take(&coverage, k, bake_tile(&source, layout, &coverage, map.kind, options));
        }
    }

    /// Bit k: beyond edge k of a triangle the source's images go on, in a neighbour of the same material.
    fn open_edges(&self, t: u32) -> u8 {
        let corners = self.triangles[t as usize];
        let material = self.texturing.material_of[t as usize];
        let is_open = |k: usize| {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let mut around = self.clusters.fans.around(a).iter().filter(|&&o| o != t);
            around.any(|&o| {
                let other = self.triangles[o as usize];
                let Some(at) = (0..3).find(|&j| other[j] == b && other[(j + 1) % 3] == a) else { return false };
                let same = |set: &Vec<[[f32; 2]; 3]>| {
                    let (own, its) = (set[t as usize], set[o as usize]);
                    own[k] == its[(at + 1) % 3] && own[(k + 1) % 3] == its[at]
                };
                self.texturing.material_of[o as usize] == material && self.texturing.corner_uvs.iter().all(same)
            })
        };
        (0..3).filter(|&k| is_open(k)).map(|k| 1 << k).sum()
    }
}
