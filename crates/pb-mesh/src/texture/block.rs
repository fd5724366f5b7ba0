//! Block compression of mips and back (docs/decisions/008-block-compression.md).

use super::color::Texels;
use ctt_bc7enc_rdo as bc7e;
use ctt_intel_texture_compressor as intel;
use half::f16;
use rayon::prelude::*;

/// How texels lie in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BlockFormat {
    /// 8 bits per channel of [`Texels::Rgba8`], 16 bytes per 4 x 4 texels.
    Bc7,
    /// [`Texels::Rg8`], 16 bytes per 4 x 4 texels.
    Bc5,
    /// Red, green and blue of [`Texels::RgbaF16`], unsigned, 16 bytes per 4 x 4 texels; alpha reads as 1.
    Bc6h,
    /// 4 bytes per texel, as they are.
    Rgba8,
    /// 2 bytes per texel, as they are.
    Rg8,
    /// 8 bytes per texel, as they are, little endian.
    RgbaF16,
}

impl BlockFormat {
    /// Bytes of an image of `side` x `side` texels, `side` a multiple of 4.
    pub fn bytes(self, side: u32) -> usize {
        let texels = side as usize * side as usize;
        match self {
            BlockFormat::Bc7 | BlockFormat::Bc5 | BlockFormat::Bc6h => texels,
            BlockFormat::Rgba8 => texels * 4,
            BlockFormat::Rg8 => texels * 2,
            BlockFormat::RgbaF16 => texels * 8,
        }
    }
}

/// How long to search for the best block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quality {
    /// More than ten million texels per second and core (BC7).
    Fast,
    /// Several millions.
    #[default]
    Normal,
    /// Well below one million.
    Best,
}

/// Bytes that are not an image of the wanted format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found} bytes for {side} x {side} texels; {wanted} are needed")]
pub struct WrongLength {
    /// Texels per side.
    pub side: u32,
    /// Bytes given.
    pub found: usize,
    /// Bytes of such an image.
    pub wanted: usize,
}

/// Packs a square image; blocks and texels row by row from the top.
///
/// The same texels give the same bytes on processors with the same vector instructions.
///
/// # Panics
/// When the texels are not of the format's kind, or are not `side * side`, or `side` is no multiple of 4.
pub fn encode(texels: &Texels, side: u32, format: BlockFormat, quality: Quality) -> Vec<u8> {
    assert!(side > 0 && side.is_multiple_of(4), "blocks of 4 texels in {side}");
    assert_eq!(texels.len(), side as usize * side as usize, "texels of a square");
    match (texels, format) {
        (Texels::Rgba8(t), BlockFormat::Bc7) => encode_bc7(t, side, quality),
        (Texels::Rg8(t), BlockFormat::Bc5) => {
            let surface = intel::RgSurface::new(t.as_flattened(), side, side, side * 2);
            intel::bc5::compress_blocks(&surface)
        }
        (Texels::RgbaF16(t), BlockFormat::Bc6h) => encode_bc6h(t, side, quality),
        (Texels::Rgba8(t), BlockFormat::Rgba8) => t.as_flattened().to_vec(),
        (Texels::Rg8(t), BlockFormat::Rg8) => t.as_flattened().to_vec(),
        (Texels::RgbaF16(t), BlockFormat::RgbaF16) => halves_to_bytes(t),
        _ => panic!("texels of another kind than {format:?}"),
    }
}

/// The same where some blocks are never looked at: BC7 blocks that are not `shown` (row by row) are black, which takes no
/// time. Other formats are packed whole.
///
/// # Panics
/// As [`encode`], or when there is not one flag per block.
pub fn encode_shown(texels: &Texels, side: u32, format: BlockFormat, quality: Quality, shown: &[bool]) -> Vec<u8> {
    assert_eq!(shown.len(), (side as usize / 4).pow(2), "a flag per block");
    let (Texels::Rgba8(texels), BlockFormat::Bc7) = (texels, format) else {
        return encode(texels, side, format, quality);
    };
    let (settings, across) = (bc7_settings(quality), side as usize / 4);
    let hidden = bc7_blocks(&[0; 16], &settings);
    let texel = |block: usize, i: usize| {
        let (x, y) = (block % across * 4 + i % 4, block / across * 4 + i / 4);
        u32::from_ne_bytes(texels[y * side as usize + x])
    };
    let pack = |(band, bytes): (usize, &mut [u8])| {
        let first = band * BAND;
        let shown = &shown[first..first + bytes.len() / 16];
        let places: Vec<usize> = (0..shown.len()).filter(|&b| shown[b]).collect();
        bytes.chunks_exact_mut(16).zip(shown).filter(|b| !b.1).for_each(|(block, _)| block.copy_from_slice(&hidden));
        for batch in places.chunks(BATCH) {
            let pixels: Vec<u32> = batch.iter().flat_map(|&b| (0..16).map(move |i| texel(first + b, i))).collect();
            let packed = bc7_blocks(&pixels, &settings);
            for (&place, block) in batch.iter().zip(packed.chunks_exact(16)) {
                bytes[place * 16..][..16].copy_from_slice(block);
            }
        }
    };
    let mut bytes = vec![0; texels.len()];
    bytes.par_chunks_mut(16 * BAND).enumerate().for_each(pack);
    bytes
}

/// Blocks of an image that one thread packs.
const BAND: usize = 1 << 12;
/// Blocks that are packed at a time.
const BATCH: usize = 256;

fn bc7_blocks(pixels: &[u32], settings: &bc7e::bindings::bc7e_compress_block_params) -> Vec<u8> {
    let mut blocks = vec![0u64; pixels.len() / 8];
    bc7e::compress_blocks(&mut blocks, pixels, settings);
    blocks.iter().flat_map(|b| b.to_ne_bytes()).collect()
}

fn bc7_settings(quality: Quality) -> bc7e::bindings::bc7e_compress_block_params {
    match quality {
        Quality::Fast => bc7e::params_init_veryfast(false),
        Quality::Normal => bc7e::params_init_slow(false),
        Quality::Best => bc7e::params_init_slowest(false),
    }
}

fn encode_bc7(texels: &[[u8; 4]], side: u32, quality: Quality) -> Vec<u8> {
    let settings = bc7_settings(quality);
    let side = side as usize;
    let mut bytes = Vec::with_capacity(side * side);
    let mut pixels = vec![0u32; side * 4];
    let mut blocks = vec![0u64; side / 2];
    for rows in texels.chunks_exact(side * 4) {
        for (i, texel) in rows.iter().enumerate() {
            let (x, y) = (i % side, i / side);
            // the encoder reads its pixels byte by byte: red first in memory
            pixels[x / 4 * 16 + y * 4 + x % 4] = u32::from_ne_bytes(*texel);
        }
        bc7e::compress_blocks(&mut blocks, &pixels, &settings);
        bytes.extend(blocks.iter().flat_map(|b| b.to_ne_bytes()));
    }
    bytes
}

fn encode_bc6h(texels: &[[u16; 4]], side: u32, quality: Quality) -> Vec<u8> {
    let settings = match quality {
        Quality::Fast => intel::bc6h::fast_settings(),
        Quality::Normal => intel::bc6h::basic_settings(),
        Quality::Best => intel::bc6h::very_slow_settings(),
    };
    let bytes = halves_to_bytes(texels);
    intel::bc6h::compress_blocks(&settings, &intel::RgbaF16Surface::new(&bytes, side, side, side * 8))
}

fn halves_to_bytes(texels: &[[u16; 4]]) -> Vec<u8> {
    texels.iter().flatten().flat_map(|h| h.to_le_bytes()).collect()
}

/// Unpacks what [`encode`] made. Bytes of any content give some image.
///
/// # Errors
/// When the number of bytes is not [`BlockFormat::bytes`], or `side` is no multiple of 4.
pub fn decode(format: BlockFormat, bytes: &[u8], side: u32) -> Result<Texels, WrongLength> {
    let wanted = format.bytes(side);
    if bytes.len() != wanted || !side.is_multiple_of(4) {
        return Err(WrongLength { side, found: bytes.len(), wanted });
    }
    let width = side as usize;
    Ok(match format {
        BlockFormat::Bc7 => Texels::Rgba8(blocks(bytes, width, |block, out: &mut [[u8; 4]]| {
            bcdec_rs::bc7(block, out.as_flattened_mut(), 16);
        })),
        BlockFormat::Bc5 => Texels::Rg8(blocks(bytes, width, |block, out: &mut [[u8; 2]]| {
            bcdec_rs::bc5(block, out.as_flattened_mut(), 8, false);
        })),
        BlockFormat::Bc6h => {
            let rgb = blocks(bytes, width, |block, out: &mut [[u16; 3]]| {
                bcdec_rs::bc6h_half(block, out.as_flattened_mut(), 12, false);
            });
            Texels::RgbaF16(rgb.into_iter().map(|[r, g, b]| [r, g, b, f16::ONE.to_bits()]).collect())
        }
        BlockFormat::Rgba8 => Texels::Rgba8(bytes.as_chunks().0.to_vec()),
        BlockFormat::Rg8 => Texels::Rg8(bytes.as_chunks().0.to_vec()),
        BlockFormat::RgbaF16 => {
            let half = |b: &[u8; 2]| u16::from_le_bytes(*b);
            let texel = |t: &[u8; 8]| std::array::from_fn(|k| half(&[t[2 * k], t[2 * k + 1]]));
            Texels::RgbaF16(bytes.as_chunks().0.iter().map(texel).collect())
        }
    })
}

/// Unpacks blocks of 16 bytes, each into 4 rows of 4 texels.
fn blocks<const C: usize, T: Copy + Default>(
    bytes: &[u8],
    width: usize,
    unpack: impl Fn(&[u8], &mut [[T; C]]),
) -> Vec<[T; C]> {
    let mut texels = vec![[T::default(); C]; width * width];
    let mut square = [[T::default(); C]; 16];
    for (i, block) in bytes.chunks_exact(16).enumerate() {
        let (x, y) = (i % (width / 4) * 4, i / (width / 4) * 4);
        unpack(block, &mut square);
        for row in 0..4 {
            let start = (y + row) * width + x;
            texels[start..start + 4].copy_from_slice(&square[row * 4..row * 4 + 4]);
        }
    }
    texels
}
