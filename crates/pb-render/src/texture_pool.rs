//! Pages of one texel format on the adapter: an array texture, and squares in it.
//!
//! The texture is made once and never grows. Must never: exceed its pages; know which mip a square is.

use pb_lod::progressive_buffers::textures::{MIN_SIZE_LOG2, MapFormat};
use std::borrow::Cow;

use crate::gpu::Gpu;
use crate::squares::{PagesFull, Square, SquareMove, Squares, place};

/// log2 of the side of a unit, texels: one block.
const MIN_SIDE_LOG2: u32 = MIN_SIZE_LOG2 as u32;
/// log2 of the largest page, texels: the shader's place entries have ten bits for 4-texel units.
const MAX_PAGE_LOG2: u32 = 12;
/// log2 of the smallest page, texels.
const MIN_PAGE_LOG2: u32 = 8;
/// No page is larger than this part of the byte bound, so that small bounds are not all page.
const PAGES_PER_BOUND: u64 = 16;
/// Most pages: the shader's place entries have twelve bits, and all ones mean "absent".
const MAX_PAGES: u64 = 4095;

/// How texels lie on the adapter. sRGB or not is a matter of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Storage {
    /// Blocks of BC7.
    Bc7,
    /// Blocks of BC5.
    Bc5,
    /// Blocks of BC6H.
    Bc6h,
    /// Four bytes.
    Rgba8,
    /// Two bytes.
    Rg8,
    /// Four half floats.
    Rgba16f,
}

impl Storage {
    /// Where texels of `format` are kept; `blocks` where the adapter reads compressed ones.
    pub fn of(format: MapFormat, blocks: bool) -> Self {
        match format {
            MapFormat::Bc7Srgb | MapFormat::Bc7Linear if blocks => Storage::Bc7,
            MapFormat::Bc5 if blocks => Storage::Bc5,
            MapFormat::Bc6h if blocks => Storage::Bc6h,
            MapFormat::Bc5 | MapFormat::Rg8 => Storage::Rg8,
            MapFormat::Bc6h | MapFormat::RgbaF16 => Storage::Rgba16f,
            _ => Storage::Rgba8,
        }
    }

    /// Bytes of 4 x 4 texels on the adapter.
    pub fn unit_bytes(self) -> u64 {
        match self {
            Storage::Bc7 | Storage::Bc5 | Storage::Bc6h => 16,
            Storage::Rg8 => 32,
            Storage::Rgba8 => 64,
            Storage::Rgba16f => 128,
        }
    }

    fn is_compressed(self) -> bool {
        matches!(self, Storage::Bc7 | Storage::Bc5 | Storage::Bc6h)
    }

    /// Formats of the texture and of a view that decodes sRGB, where there is one.
    fn formats(self) -> (wgpu::TextureFormat, Option<wgpu::TextureFormat>) {
        use wgpu::TextureFormat as F;
        match self {
            Storage::Bc7 => (F::Bc7RgbaUnorm, Some(F::Bc7RgbaUnormSrgb)),
            Storage::Bc5 => (F::Bc5RgUnorm, None),
            Storage::Bc6h => (F::Bc6hRgbUfloat, None),
            Storage::Rgba8 => (F::Rgba8Unorm, Some(F::Rgba8UnormSrgb)),
            Storage::Rg8 => (F::Rg8Unorm, None),
            Storage::Rgba16f => (F::Rgba16Float, None),
        }
    }
}

/// A mip of 4 x 4 blocks as the adapter keeps it. `bytes` are blocks or rows of texels of `format`.
fn stored(format: MapFormat, storage: Storage, side: u32, bytes: &[u8]) -> Cow<'_, [u8]> {
    if !is_compressed(format) || storage.is_compressed() {
        return Cow::Borrowed(bytes);
    }
    let texel = storage.unit_bytes() as usize / 16;
    let pitch = side as usize * texel;
    let mut out = vec![0; pitch * side as usize];
    for (b, block) in bytes.chunks_exact(16).enumerate() {
        let (x, y) = (b % (side as usize / 4), b / (side as usize / 4));
        let texels = decoded_block(format, block);
        for (row, texels) in texels.chunks_exact(4 * texel).take(4).enumerate() {
            out[(y * 4 + row) * pitch + x * 4 * texel..][..4 * texel].copy_from_slice(texels);
        }
    }
    Cow::Owned(out)
}

/// True where 4 x 4 texels are stored as one block.
fn is_compressed(format: MapFormat) -> bool {
    matches!(format, MapFormat::Bc7Srgb | MapFormat::Bc7Linear | MapFormat::Bc5 | MapFormat::Bc6h)
}

/// 4 x 4 texels, row by row, in the layout of [`Storage::of`] without blocks.
fn decoded_block(format: MapFormat, block: &[u8]) -> [u8; 128] {
    let mut out = [0; 128];
    match format {
        MapFormat::Bc5 => bcdec_rs::bc5(block, &mut out, 8, false),
        MapFormat::Bc6h => {
            let mut rgb = [0u16; 48];
            bcdec_rs::bc6h_half(block, &mut rgb, 12, false);
            for (texel, rgb) in out.chunks_exact_mut(8).zip(rgb.chunks_exact(3)) {
                const ONE: u16 = 0x3c00;
                let rgba = [rgb[0], rgb[1], rgb[2], ONE];
                texel.copy_from_slice(bytemuck::bytes_of(&rgba));
            }
        }
        _ => bcdec_rs::bc7(block, &mut out, 16),
    }
    out
}

/// Size of a pool: its pages, and room to move squares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolSize {
    /// What lies in it.
    pub storage: Storage,
    /// log2 of a page's side, texels.
    pub page_log2: u32,
    /// Number of pages.
    pub pages: u32,
    /// log2 of the side of the square through which others are moved, texels.
    pub scratch_log2: u32,
}

/// What a device offers for one texture.
#[derive(Clone, Copy, Debug)]
pub struct PageLimits {
    /// Largest side, texels.
    pub side: u32,
    /// Most layers.
    pub layers: u32,
    /// Most bytes.
    pub bytes: u64,
}

impl PageLimits {
    /// Of an opened adapter.
    pub fn of(gpu: &Gpu) -> Self {
        let l = gpu.device.limits();
        Self { side: l.max_texture_dimension_2d, layers: l.max_texture_array_layers, bytes: l.max_buffer_size }
    }
}

/// What a pool is made for; sides are log2 of texels.
#[derive(Clone, Copy, Debug)]
pub struct PoolWish {
    /// Of the largest mip that must have a place.
    pub tail_log2: u32,
    /// Of the largest mip.
    pub largest_log2: u32,
    /// Of all mips together.
    pub bytes: u64,
    /// Bound of everything on the adapter, bytes.
    pub bound: u64,
}

impl PoolSize {
    /// No pages yet; a page is as small as the largest mip and the number of pages allow. Where the bound is small it
    /// is smaller still, and mips wider than a page find no place. `None` where a mip that must have one is wider than
    /// a texture may be.
    pub fn empty(storage: Storage, wish: &PoolWish, limits: &PageLimits) -> Option<Self> {
        let most = limits.side.max(1).ilog2().min(MAX_PAGE_LOG2);
        let mut page_log2 = wish.largest_log2.min(most).max(MIN_PAGE_LOG2);
        while page_log2 > MIN_PAGE_LOG2 && page_bytes(storage, page_log2) > wish.bound / PAGES_PER_BOUND {
            page_log2 -= 1;
        }
        page_log2 = page_log2.max(wish.tail_log2);
        let bytes = wish.bytes.min(wish.bound);
        let pages = |page_log2: u32| bytes.div_ceil(page_bytes(storage, page_log2));
        while page_log2 < most && pages(page_log2) > MAX_PAGES.min(limits.layers as u64) {
            page_log2 += 1;
        }
        let scratch_log2 = wish.largest_log2.min(page_log2).saturating_sub(1).max(MIN_SIDE_LOG2);
        (page_log2 <= most).then_some(Self { storage, page_log2, pages: 0, scratch_log2 })
    }

    /// Bytes of one page.
    pub fn page_bytes(&self) -> u64 {
        page_bytes(self.storage, self.page_log2)
    }

    /// Bytes of all pages.
    pub fn bytes(&self) -> u64 {
        self.page_bytes() * self.pages as u64
    }

    /// Bytes of the square that moves go through.
    pub fn scratch_bytes(&self) -> u64 {
        page_bytes(self.storage, self.scratch_log2)
    }

    /// Most pages that the limits allow.
    pub fn most_pages(&self, limits: &PageLimits) -> u32 {
        MAX_PAGES.min(limits.layers as u64).min(limits.bytes / self.page_bytes()) as u32
    }
}

fn page_bytes(storage: Storage, side_log2: u32) -> u64 {
    storage.unit_bytes() << (2 * (side_log2 - MIN_SIDE_LOG2))
}

/// One mip on its way into a pool.
pub struct NewSquare<'a> {
    /// Whose it is.
    pub owner: u32,
    /// Texels each way.
    pub side: u32,
    /// Format of `bytes`.
    pub format: MapFormat,
    /// The mip as the archive has it.
    pub bytes: &'a [u8],
}

/// An array texture and who lies where in it.
pub struct TexturePool {
    size: PoolSize,
    texture: wgpu::Texture,
    scratch: wgpu::Texture,
    squares: Squares,
    used_units: u64,
}

impl TexturePool {
    /// All pages, empty. A texture has at least one layer, so a pool without pages costs one page of `4^2` texels.
    pub fn new(gpu: &Gpu, size: PoolSize) -> Self {
        let (format, srgb) = size.storage.formats();
        let texture = |label: &str, side_log2: u32, layers: u32, usage: wgpu::TextureUsages| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: 1 << side_log2, height: 1 << side_log2, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: usage | wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST,
                view_formats: srgb.as_slice(),
            })
        };
        let page_log2 = if size.pages == 0 { MIN_SIDE_LOG2 } else { size.page_log2 };
        let binding = wgpu::TextureUsages::TEXTURE_BINDING;
        Self {
            size,
            texture: texture("texture pages", page_log2, size.pages.max(1), binding),
            scratch: texture("texture scratch", size.scratch_log2, 1, wgpu::TextureUsages::empty()),
            squares: Squares::new(size.pages, size.page_log2 - MIN_SIDE_LOG2),
            used_units: 0,
        }
    }

    /// All layers, as texels of `format` are read.
    pub fn view(&self, format: MapFormat) -> wgpu::TextureView {
        let (linear, srgb) = self.size.storage.formats();
        let decodes = matches!(format, MapFormat::Bc7Srgb | MapFormat::Rgba8Srgb);
        self.texture.create_view(&wgpu::TextureViewDescriptor {
            format: Some(srgb.filter(|_| decodes).unwrap_or(linear)),
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        })
    }

    /// Bytes of squares in use.
    pub fn used_bytes(&self) -> u64 {
        self.used_units * self.size.storage.unit_bytes()
    }

    /// Units of 4 x 4 texels that nobody uses.
    pub fn free_units(&self) -> u64 {
        self.squares.free_units()
    }

    /// Finds a place for a mip and fills it. Other squares may move: all that changed are in the answer, as owner
    /// and shader entry, the new one last.
    pub fn put(&mut self, gpu: &Gpu, new: &NewSquare) -> Result<Vec<(u32, u32)>, PagesFull> {
        let order = new.side.ilog2() - MIN_SIDE_LOG2;
        let (square, moves) = self.squares.allocate(order, new.owner)?;
        self.used_units += 1 << (2 * order);
        self.carry_out(gpu, &moves);
        self.write(gpu, square, new);
        let changed = moves.iter().map(|m| m.to).chain([square]);
        Ok(changed.map(|s| (s.owner, self.entry(s.at))).collect())
    }

    /// Takes a square back by its shader entry.
    pub fn take_out(&mut self, entry: u32) {
        let at = self.at(entry);
        let before = self.squares.free_units();
        self.squares.free(at);
        self.used_units -= self.squares.free_units() - before;
    }

    /// What the shader reads: x and y in 4-texel units, ten bits each, then the layer.
    fn entry(&self, at: u32) -> u32 {
        let (page, x, y) = place(at, self.size.page_log2 - MIN_SIDE_LOG2);
        x | y << 10 | page << 20
    }

    /// The first unit of a shader entry's square.
    fn at(&self, entry: u32) -> u32 {
        crate::squares::unit(entry >> 20, entry & 0x3ff, (entry >> 10) & 0x3ff, self.size.page_log2 - MIN_SIDE_LOG2)
    }

    fn location(&self, at: u32) -> wgpu::TexelCopyTextureInfo<'_> {
        let (page, x, y) = place(at, self.size.page_log2 - MIN_SIDE_LOG2);
        wgpu::TexelCopyTextureInfo {
            texture: &self.texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: x * 4, y: y * 4, z: page },
            aspect: wgpu::TextureAspect::All,
        }
    }

    fn write(&self, gpu: &Gpu, square: Square, new: &NewSquare) {
        let bytes = stored(new.format, self.size.storage, new.side, new.bytes);
        let row_blocks = if self.size.storage.is_compressed() { new.side / 4 } else { new.side };
        let rows = row_blocks;
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some((bytes.len() / rows as usize) as u32),
            rows_per_image: None,
        };
        gpu.queue.write_texture(self.location(square.at), &bytes, layout, extent(new.side));
    }

    /// Slides squares through the scratch texture: a copy within a layer of one texture is not allowed.
    fn carry_out(&self, gpu: &Gpu, moves: &[SquareMove]) {
        if moves.is_empty() {
            return;
        }
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for m in moves {
            let size = extent(4 << m.to.order);
            encoder.copy_texture_to_texture(self.location(m.from), self.scratch.as_image_copy(), size);
            encoder.copy_texture_to_texture(self.scratch.as_image_copy(), self.location(m.to.at), size);
        }
        gpu.queue.submit([encoder.finish()]);
    }
}

fn extent(side: u32) -> wgpu::Extent3d {
    wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_as_small_as_the_largest_square_and_the_number_of_layers_allow() {
        let limits = PageLimits { side: 16384, layers: 256, bytes: 1 << 32 };
        let wish = |largest_log2, bytes| PoolWish { tail_log2: 5, largest_log2, bytes, bound: u64::MAX };
        let page = |wish: PoolWish| PoolSize::empty(Storage::Bc7, &wish, &limits).map(|s| s.page_log2);
        assert_eq!(page(wish(5, 1 << 20)), Some(8));
        assert_eq!(page(wish(9, 1 << 20)), Some(9));
        assert_eq!(page(wish(9, 1 << 30)), Some(11), "1 GiB is 256 pages of 4 MiB");
        assert_eq!(page(wish(12, u64::MAX)), Some(12));
        assert_eq!(page(PoolWish { bound: 32 << 20, ..wish(12, 1 << 30) }), Some(10), "a 16th of the bound");
        let small = PageLimits { side: 2048, ..limits };
        assert_eq!(PoolSize::empty(Storage::Bc7, &wish(12, 1), &small).map(|s| s.page_log2), Some(11));
        assert_eq!(PoolSize::empty(Storage::Bc7, &PoolWish { tail_log2: 12, ..wish(12, 1) }, &small), None);
    }

    /// A solid BC7 block (mode 5) and a solid BC5 block.
    #[test]
    fn blocks_are_decoded_where_the_adapter_does_not_read_them() {
        let mut bc5 = [0u8; 16];
        (bc5[0], bc5[1], bc5[8], bc5[9]) = (200, 200, 50, 50);
        let bytes = [bc5, bc5, bc5, bc5].concat();
        let out = stored(MapFormat::Bc5, Storage::Rg8, 8, &bytes);
        assert_eq!(out.len(), 8 * 8 * 2);
        assert!(out.chunks_exact(2).all(|t| t == [200, 50]), "{out:?}");
        let same = stored(MapFormat::Bc5, Storage::Bc5, 8, &bytes);
        assert_eq!(*same, *bytes);
        let half = stored(MapFormat::Bc6h, Storage::Rgba16f, 4, &[0x03; 16]);
        assert_eq!((half.len(), &half[6..8]), (128, &[0x00, 0x3c][..]), "alpha is one");
    }
}
