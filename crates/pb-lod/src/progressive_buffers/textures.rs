//! Textures of a model: its maps, the tile of each cluster, and which mips lie in which chunk
//! (docs/decisions/007-textures.md; docs/format.md gives the bytes).
//!
//! A tile of `S` texels has the mips 0 (finest) to `log2 S - 2` (4 texels wide, one block). Texture chunk
//! `clusters * L + cluster * L + level` holds mip `level` of all maps. The chunk of level `L - 1` holds the **tail**: all
//! mips from [`TileRecord::tail`] on, of each map finest first. A map may begin at a coarser mip than 0.

use super::layout::MAX_LEVELS;
use bytemuck::{Pod, Zeroable};

/// Section tag of the [`MapRecord`]s of a textured model.
pub const MAPS: [u8; 4] = *b"TMAP";
/// Section tag of the [`TileRecord`]s, one per cluster.
pub const TILES: [u8; 4] = *b"TILE";
/// Most maps of a model.
pub const MAX_MAPS: usize = 4;
/// Widest tile, as a logarithm: 4096 texels.
pub const MAX_SIZE_LOG2: u8 = 12;
/// Smallest tile: 4 texels, one compressed block.
pub const MIN_SIZE_LOG2: u8 = 2;
/// Mips of at most this many texels (32), as a logarithm, are in the tail.
pub const TAIL_SIZE_LOG2: u8 = 5;

/// What a map says about the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum MapKind {
    /// Colour; alpha below one half is a hole where the model has cut-outs.
    BaseColor = 0,
    /// Red: occlusion, green: roughness, blue: metalness.
    Orm = 1,
    /// The normal, as `2 c - 1`. Two channels: x and y in the tile's tangent frame; more: x, y, z in the model's axes.
    Normal = 2,
    /// Emitted light.
    Emissive = 3,
}

impl MapKind {
    /// By number.
    pub const ALL: [MapKind; MAX_MAPS] = [MapKind::BaseColor, MapKind::Orm, MapKind::Normal, MapKind::Emissive];

    /// For people.
    pub fn name(self) -> &'static str {
        ["base colour", "occlusion-roughness-metalness", "normal", "emission"][self as usize]
    }
}

/// How texels lie in a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum MapFormat {
    /// BC7, 16 bytes per 4 x 4 texels, colours sRGB encoded.
    Bc7Srgb = 0,
    /// BC7, linear.
    Bc7Linear = 1,
    /// BC5, 16 bytes per 4 x 4 texels, two channels.
    Bc5 = 2,
    /// BC6H with unsigned halves, 16 bytes per 4 x 4 texels.
    Bc6h = 3,
    /// 4 bytes per texel, colours sRGB encoded.
    Rgba8Srgb = 4,
    /// 4 bytes per texel, linear.
    Rgba8Linear = 5,
    /// 2 bytes per texel.
    Rg8 = 6,
    /// 4 halves per texel.
    RgbaF16 = 7,
}

impl MapFormat {
    /// By number.
    pub const ALL: [MapFormat; 8] = [
        MapFormat::Bc7Srgb,
        MapFormat::Bc7Linear,
        MapFormat::Bc5,
        MapFormat::Bc6h,
        MapFormat::Rgba8Srgb,
        MapFormat::Rgba8Linear,
        MapFormat::Rg8,
        MapFormat::RgbaF16,
    ];

    /// For people.
    pub fn name(self) -> &'static str {
        ["BC7 sRGB", "BC7 linear", "BC5", "BC6H", "RGBA8 sRGB", "RGBA8 linear", "RG8", "RGBA half floats"]
            [self as usize]
    }

    /// Bytes of a mip that is `side` texels wide, a multiple of 4.
    pub fn mip_bytes(self, side: u32) -> u32 {
        side * side
            * match self {
                MapFormat::Bc7Srgb | MapFormat::Bc7Linear | MapFormat::Bc5 | MapFormat::Bc6h => 1,
                MapFormat::Rgba8Srgb | MapFormat::Rgba8Linear => 4,
                MapFormat::Rg8 => 2,
                MapFormat::RgbaF16 => 8,
            }
    }
}

/// One map of the model. 8 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct MapRecord {
    /// Number of its [`MapKind`]; records are in the order of these.
    pub kind: u32,
    /// Number of its [`MapFormat`].
    pub format: u32,
}

impl MapRecord {
    /// A record of these.
    pub fn new(kind: MapKind, format: MapFormat) -> MapRecord {
        MapRecord { kind: kind as u32, format: format as u32 }
    }

    /// What the map says; `None` in damaged files.
    pub fn kind(&self) -> Option<MapKind> {
        MapKind::ALL.get(self.kind as usize).copied()
    }

    /// How its texels lie; `None` in damaged files.
    pub fn format(&self) -> Option<MapFormat> {
        MapFormat::ALL.get(self.format as usize).copied()
    }
}

/// The tile of one cluster. 12 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TileRecord {
    /// Texels per side are 2 to this power, from [`MIN_SIZE_LOG2`] to [`MAX_SIZE_LOG2`].
    pub size_log2: u8,
    /// Finest mip of each map of the model; 0 for maps that the model does not have.
    pub first: [u8; MAX_MAPS],
    /// Zero.
    pub reserved: [u8; 3],
    /// Side of a texel of mip 0 on the surface, input units: most of the surface has texels of at most this size.
    pub texel: f32,
}

impl TileRecord {
    /// The coarsest mip.
    pub fn last(&self) -> u32 {
        u32::from(self.size_log2 - MIN_SIZE_LOG2)
    }

    /// The mip that the always resident tail begins with, in a model of `levels` levels.
    pub fn tail(&self, levels: u32) -> u32 {
        u32::from(self.size_log2.saturating_sub(TAIL_SIZE_LOG2)).min(levels - 1)
    }

    /// Texels per side of a mip.
    pub fn side(&self, mip: u32) -> u32 {
        1 << (u32::from(self.size_log2) - mip)
    }

    /// The mips in the chunk of a level; may be empty.
    fn mips(&self, level: u32, levels: u32) -> std::ops::Range<u32> {
        let tail = self.tail(levels);
        match () {
            _ if level == levels - 1 => tail..self.last() + 1,
            _ if level < tail => level..level + 1,
            _ => 0..0,
        }
    }
}

/// One mip of one map in a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MipPlace {
    /// Index of the map in the model.
    pub map: u32,
    /// 0 is the finest.
    pub mip: u32,
    /// Texels per side.
    pub side: u32,
    /// Where its bytes begin in the decoded chunk.
    pub offset: u32,
    /// How many they are.
    pub bytes: u32,
}

/// Maps and tiles of a textured model.
#[derive(Clone, Copy)]
pub struct Textures<'a> {
    /// In the order of their kinds.
    pub maps: &'a [MapRecord],
    /// One per cluster.
    pub tiles: &'a [TileRecord],
    /// Levels of the model.
    pub levels: u32,
}

impl Textures<'_> {
    /// The mips in the texture chunk of a cluster and level, in the order of their bytes.
    pub fn mips(&self, cluster: u32, level: u32) -> impl Iterator<Item = MipPlace> + '_ {
        chunk_mips(self.maps, &self.tiles[cluster as usize], level, self.levels)
    }

    /// Bytes of the texture chunk of a cluster and level; 0 where there is none.
    pub fn chunk_bytes(&self, cluster: u32, level: u32) -> u32 {
        self.mips(cluster, level).map(|m| m.bytes).sum()
    }
}

/// The mips of all maps in a tile's chunk of a level, in the order of their bytes.
pub fn chunk_mips<'a>(
    maps: &'a [MapRecord],
    tile: &'a TileRecord,
    level: u32,
    levels: u32,
) -> impl Iterator<Item = MipPlace> + 'a {
    let mut offset = 0;
    maps.iter()
        .enumerate()
        .flat_map(move |(map, record)| {
            let (first, format) = (u32::from(tile.first[map]), record.format().expect("checked when opened"));
            let mips = tile.mips(level, levels).filter(move |&mip| mip >= first);
            mips.map(move |mip| (map as u32, mip, format)).collect::<Vec<_>>()
        })
        .map(move |(map, mip, format)| {
            let side = tile.side(mip);
            let bytes = format.mip_bytes(side);
            offset += bytes;
            MipPlace { map, mip, side, offset: offset - bytes, bytes }
        })
}

/// What is wrong with the maps of a model, if anything.
pub(super) fn map_fault(maps: &[MapRecord]) -> Option<&'static str> {
    match () {
        _ if maps.is_empty() || maps.len() > MAX_MAPS => Some("there are not 1 to 4 maps"),
        _ if maps.iter().any(|m| m.kind().is_none() || m.format().is_none()) => Some("a kind or format is not known"),
        _ if maps.windows(2).any(|w| w[0].kind >= w[1].kind) => Some("the maps are not in the order of their kinds"),
        _ => None,
    }
}

/// What is wrong with a tile, if anything.
pub(super) fn tile_fault(tile: &TileRecord, maps: usize) -> Option<&'static str> {
    match () {
        _ if !(MIN_SIZE_LOG2..=MAX_SIZE_LOG2).contains(&tile.size_log2) => {
            Some("the tile is not 4 to 4096 texels wide")
        }
        _ if tile.first.iter().any(|&f| u32::from(f) > tile.last()) => Some("a map begins after the last mip"),
        _ if tile.first[maps..].iter().any(|&f| f != 0) => Some("a map that does not exist has a first mip"),
        _ if tile.reserved != [0; 3] => Some("reserved bytes are not zero"),
        _ if !(tile.texel.is_finite() && tile.texel > 0.0) => Some("the size of its texels is not a positive number"),
        _ => None,
    }
}

const _: () = {
    assert!(size_of::<MapRecord>() == 8 && size_of::<TileRecord>() == 12);
    // Bytes of the largest chunk fit u32.
    assert!((1u64 << (2 * MAX_SIZE_LOG2)) * 8 * MAX_MAPS as u64 * 2 < 1 << 32 && MAX_LEVELS <= 12);
};

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(size_log2: u8, first: [u8; 4]) -> TileRecord {
        TileRecord { size_log2, first, reserved: [0; 3], texel: 1.0 }
    }

    #[test]
    fn a_tile_of_512_gives_a_mip_per_level_and_a_tail_of_32_to_4() {
        let maps = [MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb)];
        let tile = tile(9, [0; 4]);
        let sides = |level| chunk_mips(&maps, &tile, level, 5).map(|m| m.side).collect::<Vec<_>>();
        assert_eq!([0, 1, 2, 3].map(sides), [[512], [256], [128], [64]]);
        assert_eq!(sides(4), [32, 16, 8, 4]);
    }

    #[test]
    fn a_small_tile_is_all_tail_and_its_other_chunks_are_empty() {
        let maps = [MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb)];
        let tile = tile(6, [0; 4]);
        let sides = |level| chunk_mips(&maps, &tile, level, 5).map(|m| m.side).collect::<Vec<_>>();
        assert_eq!([0, 1, 2, 3].map(sides), [vec![64], vec![], vec![], vec![]]);
        assert_eq!(sides(4), [32, 16, 8, 4]);
    }

    #[test]
    fn all_mips_of_all_maps_are_in_exactly_one_chunk_at_its_own_bytes() {
        let maps = [
            MapRecord::new(MapKind::BaseColor, MapFormat::Bc7Srgb),
            MapRecord::new(MapKind::Normal, MapFormat::Rg8),
            MapRecord::new(MapKind::Emissive, MapFormat::RgbaF16),
        ];
        for size_log2 in MIN_SIZE_LOG2..=MAX_SIZE_LOG2 {
            for levels in 1..=MAX_LEVELS as u32 {
                let tile = tile(size_log2, [0, size_log2 - 2, (size_log2 - 2) / 2, 0]);
                let mut seen = Vec::new();
                for level in 0..levels {
                    let mut end = 0;
                    for m in chunk_mips(&maps, &tile, level, levels) {
                        assert_eq!(m.offset, end);
                        end += m.bytes;
                        seen.push((m.map, m.mip));
                    }
                }
                seen.sort_unstable();
                let all =
                    (0..3u32).flat_map(|k| (u32::from(tile.first[k as usize])..=tile.last()).map(move |m| (k, m)));
                assert_eq!(seen, all.collect::<Vec<_>>(), "2^{size_log2}, {levels} levels");
            }
        }
    }
}
