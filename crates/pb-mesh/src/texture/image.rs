//! Decoded source images.

use std::sync::Arc;

/// How the texels of an [`Image`] are stored; channels follow one another, rows from the top, no padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TexelFormat {
    /// One channel of 8 bits: grey.
    L8,
    /// Grey and straight alpha, 8 bits each.
    La8,
    /// Red, green, blue, 8 bits each.
    Rgb8,
    /// Red, green, blue, straight alpha, 8 bits each.
    Rgba8,
    /// Red, green, blue as IEEE half floats, linear light.
    RgbF16,
    /// Red, green, blue, straight alpha as IEEE half floats, linear light.
    RgbaF16,
}

impl TexelFormat {
    /// Bytes of one texel.
    pub const fn bytes(self) -> usize {
        match self {
            TexelFormat::L8 => 1,
            TexelFormat::La8 => 2,
            TexelFormat::Rgb8 => 3,
            TexelFormat::Rgba8 => 4,
            TexelFormat::RgbF16 => 6,
            TexelFormat::RgbaF16 => 8,
        }
    }

    /// True for half floats in linear light.
    pub const fn is_hdr(self) -> bool {
        matches!(self, TexelFormat::RgbF16 | TexelFormat::RgbaF16)
    }

    /// True where there is a channel of alpha.
    pub const fn has_alpha(self) -> bool {
        matches!(self, TexelFormat::La8 | TexelFormat::Rgba8 | TexelFormat::RgbaF16)
    }
}

/// Bytes that live in memory or in a mapped file.
pub type TexelBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// A decoded image; cheap to clone.
#[derive(Clone)]
pub struct Image {
    width: u32,
    height: u32,
    format: TexelFormat,
    bytes: TexelBytes,
}

impl Image {
    /// Puts an image together.
    ///
    /// # Panics
    /// When the number of bytes is not that of `width * height` texels, or a side is 0.
    pub fn new(width: u32, height: u32, format: TexelFormat, bytes: TexelBytes) -> Image {
        let wanted = u64::from(width) * u64::from(height) * format.bytes() as u64;
        assert!(width > 0 && height > 0 && (*bytes).as_ref().len() as u64 == wanted, "bytes of {width} x {height}");
        Image { width, height, format, bytes }
    }

    /// Texels per row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// How texels are stored.
    pub fn format(&self) -> TexelFormat {
        self.format
    }

    /// The texels, row by row from the top.
    pub fn bytes(&self) -> &[u8] {
        (*self.bytes).as_ref()
    }
}

impl std::fmt::Debug for Image {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "Image({} x {} {:?})", self.width, self.height, self.format)
    }
}
