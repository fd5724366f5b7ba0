//! The container's records as they lie on disk, little-endian; docs/format.md has the same as byte tables.

use bytemuck::{Pod, Zeroable};
use xxhash_rust::xxh3::xxh3_64;

/// First eight bytes. Like PNG's: a high bit, a name, and the line ends that text transfers would change.
pub const MAGIC: [u8; 8] = *b"\x89PBA\r\n\x1a\n";
/// The format version that is written, and the only one that is read.
pub const FORMAT_VERSION: u32 = 1;
/// Every section starts at a multiple of this many bytes.
pub const ALIGNMENT: u64 = 64;
/// Section tag of the [`ChunkRecord`]s, one per chunk.
pub const CHUNK_TABLE: [u8; 4] = *b"CHNK";
/// Section tag of the [`FeatureRecord`]s: the names of the features that the header demands.
pub const FEATURES: [u8; 4] = *b"FEAT";
/// Most sections in one archive.
pub(crate) const MAX_SECTIONS: u64 = 256;

/// The start of the file. 128 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Header {
    /// [`MAGIC`].
    pub magic: [u8; 8],
    /// [`FORMAT_VERSION`].
    pub version: u32,
    /// Level-of-detail scheme of the contents.
    pub scheme: [u8; 4],
    /// Features without which the contents cannot be understood.
    pub required_features: u64,
    /// Features that a reader may ignore.
    pub optional_features: u64,
    /// Where the directory starts.
    pub directory_offset: u64,
    /// Its length in bytes, a multiple of 32.
    pub directory_length: u64,
    /// Length of the whole file in bytes.
    pub file_length: u64,
    /// xxh3-64 of the directory.
    pub directory_checksum: u64,
    /// Zero.
    pub reserved: [u64; 7],
    /// xxh3-64 of the 120 bytes before this one.
    pub header_checksum: u64,
}

impl Header {
    /// xxh3-64 of everything but the last field.
    pub fn checksum(&self) -> u64 {
        xxh3_64(&bytemuck::bytes_of(self)[..size_of::<Header>() - 8])
    }
}

/// One directory entry. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct SectionRecord {
    /// Which section; each tag occurs once.
    pub tag: [u8; 4],
    /// Bytes of one element; the length is a multiple of it.
    pub element_size: u32,
    /// Where it starts, a multiple of [`ALIGNMENT`].
    pub offset: u64,
    /// Its length in bytes, without the zeros up to the next section.
    pub length: u64,
    /// xxh3-64 of those bytes.
    pub checksum: u64,
}

/// One chunk of payload. 24 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ChunkRecord {
    /// Where it starts; chunks are packed without gaps behind the header.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_bytes: u32,
    /// Bytes after decoding, as the scheme counts them.
    pub decoded_bytes: u32,
    /// xxh3-64 of the stored bytes.
    pub checksum: u64,
}

/// The name of one feature bit. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct FeatureRecord {
    /// Bit number in the header's words, 0 to 63.
    pub bit: u32,
    /// ASCII, padded with zeros.
    pub name: [u8; 28],
}

const _: () = {
    assert!(size_of::<Header>() == 128);
    assert!(size_of::<SectionRecord>() == 32);
    assert!(size_of::<ChunkRecord>() == 24);
    assert!(size_of::<FeatureRecord>() == 32);
};
