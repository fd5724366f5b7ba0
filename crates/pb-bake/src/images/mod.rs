//! Source textures: from names and bytes to decoded [`Image`]s.
//!
//! Importers only say where an image is ([`ImageSource`]); nothing is decoded before it is known to be used. Content
//! decides the format, not the name. Sizes are checked before anything is allocated, a panic inside a decoder becomes
//! an error, what decoders hold lies in files ([`crate::memory`]), and a missing or broken image becomes a placeholder that nobody overlooks.

mod decode;
mod exr;
mod placeholder;
mod raster;
mod store;

pub use decode::{Decoded, ImageFault, decode, decode_all};
pub use placeholder::placeholder;

use std::io;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

/// An image that a model refers to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageSource {
    /// For messages.
    pub name: String,
    /// Where its bytes are.
    pub content: ImageContent,
}

/// Where the bytes of an image are.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum ImageContent {
    /// A file of its own.
    File(PathBuf),
    /// Some bytes of a file.
    Part(PathBuf, Range<u64>),
    /// Decoded from a data URI, or copied from a model in memory.
    Bytes(Arc<[u8]>),
    /// Nowhere, and why.
    Missing(String),
}

/// Bounds of decoding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecodeOptions {
    /// Most texels of one image.
    pub max_texels: u64,
    /// Most bytes of all decoded images together.
    pub max_bytes: u64,
    /// Where the temporary files of large images lie.
    pub temp_dir: PathBuf,
}

/// Longest side of an image, texels.
pub const MAX_IMAGE_SIDE: u32 = 65_536;
/// Most texels of one image unless told otherwise: 32768 x 32768.
pub const MAX_IMAGE_TEXELS: u64 = 1 << 30;
/// Most bytes of all images unless told otherwise: a 64-bit address space has room, a disk perhaps not.
pub const MAX_TOTAL_BYTES: u64 = 256 << 30;

impl Default for DecodeOptions {
    fn default() -> Self {
        DecodeOptions { max_texels: MAX_IMAGE_TEXELS, max_bytes: MAX_TOTAL_BYTES, temp_dir: std::env::temp_dir() }
    }
}

/// Why an image is not what its file should hold.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// It is not there.
    #[error("{0}")]
    Missing(String),
    /// The operating system refuses.
    #[error("cannot be read: {0}; check the name and the permissions")]
    Io(#[source] io::Error),
    /// Its content is no image, or a broken one.
    #[error("{what}; {remedy}")]
    Refused {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// All images together are too large.
    #[error("the images need more than {limit} bytes once they are decoded; scale them down")]
    TooMuch {
        /// [`DecodeOptions::max_bytes`].
        limit: u64,
    },
    /// There is no room for the decoded texels.
    #[error("there is no room for {bytes} bytes in {folder}: {source}; give another folder with --temp-dir")]
    NoRoom {
        /// Of the decoded image.
        bytes: u64,
        /// Of the temporary file.
        folder: String,
        /// What the system says.
        source: io::Error,
    },
}

impl ImageError {
    /// What is wrong with the bytes, with the remedy that all broken images share.
    fn broken(what: impl ToString) -> ImageError {
        ImageError::Refused { what: what.to_string(), remedy: "save the image again, as PNG or JPEG" }
    }
}
