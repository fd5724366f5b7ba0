//! The Progressive Buffers file: a checked reader and an atomic writer.
//!
//! An archive is a header, payload chunks, typed sections and a directory (docs/format.md has every byte).
//! Sections are copied into memory when a file is opened; chunks are opaque bytes with a checksum each, read on demand.
//!
//! Must never: know what a mesh, a cluster or a level is; hand out bytes whose place was not checked;
//! panic on any file, or end the program when one is cut under it; leave an unfinished file under the target's name.

#[cfg(target_endian = "big")]
compile_error!("archives are little-endian and are used as they lie in memory");

mod error;
mod format;
mod reader;
mod source;
mod spill;
mod storage;
mod writer;

pub use error::{ArchiveError, Fault};
pub use format::{
    ALIGNMENT, CHUNK_TABLE, ChunkRecord, FEATURES, FORMAT_VERSION, FeatureRecord, Header, MAGIC, SectionRecord,
};
pub use reader::{Archive, Table};
pub use spill::{ChunkBytes, Spill, SpillPlace};
pub use storage::{FileStorage, MemoryStorage, Overwrite, Storage};
pub use writer::{Feature, Writer};
