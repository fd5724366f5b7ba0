//! Writes an archive: chunks as they come, then sections, then directory and header, then the name.
//!
//! Must never: show an unfinished file under the target's name.

use crate::error::{ArchiveError, Fault};
use crate::format::*;
use crate::storage::{FileStorage, Overwrite, Storage};
use bytemuck::{Pod, Zeroable};
use std::io;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// A feature of the contents that a reader must know (required) or may ignore.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Feature {
    /// Bit number, 0 to 63.
    pub bit: u32,
    /// ASCII, at most 28 bytes; readers that do not know the bit show it.
    pub name: &'static str,
}

/// An archive being written. Dropping it before [`finish`](Writer::finish) removes all traces.
pub struct Writer<S: Storage = FileStorage> {
    storage: S,
    path: PathBuf,
    length: u64,
    header: Header,
    chunks: Vec<Option<ChunkRecord>>,
    sections: Vec<SectionRecord>,
    features: Vec<FeatureRecord>,
}

impl Writer<FileStorage> {
    /// Starts an archive that will appear at `target`; everything that could refuse it there is checked now.
    pub fn create(target: &Path, scheme: [u8; 4], overwrite: Overwrite) -> Result<Self, ArchiveError> {
        Self::with_storage(FileStorage::create(target, overwrite)?, target, scheme)
    }

    /// The file that is written until it gets its name.
    pub fn temporary(&self) -> Option<&Path> {
        self.storage.temporary()
    }
}

impl<S: Storage> Writer<S> {
    /// Starts an archive in any storage; `path` is for messages only.
    pub fn with_storage(storage: S, path: &Path, scheme: [u8; 4]) -> Result<Self, ArchiveError> {
        let header = Header { magic: MAGIC, version: FORMAT_VERSION, scheme, ..Header::zeroed() };
        let mut writer = Self {
            storage,
            path: path.to_owned(),
            length: 0,
            header,
            chunks: Vec::new(),
            sections: Vec::new(),
            features: Vec::new(),
        };
        // Zeros until the end: a file that lost its tail in a crash has no magic number either.
        writer.append(&[0; size_of::<Header>()])?;
        Ok(writer)
    }

    /// Demands that a reader knows `feature`.
    ///
    /// # Panics
    /// If the bit is past 63 or the name is longer than 28 bytes.
    pub fn require(&mut self, feature: Feature) {
        let mut record = FeatureRecord { bit: feature.bit, name: [0; 28] };
        record.name[..feature.name.len()].copy_from_slice(feature.name.as_bytes());
        self.header.required_features |= 1 << feature.bit;
        self.features.push(record);
    }

    /// Writes chunk `id`, each once, in any order; the order of the calls is the order on disk.
    ///
    /// # Panics
    /// If `id` was written before, sections were begun, or the chunk has 4 GiB or more.
    pub fn put_chunk(&mut self, id: u32, bytes: &[u8], decoded_bytes: u32) -> Result<(), ArchiveError> {
        assert!(self.sections.is_empty(), "chunks come before sections");
        let stored_bytes = u32::try_from(bytes.len()).expect("a chunk is smaller than 4 GiB");
        let record = ChunkRecord { offset: self.length, stored_bytes, decoded_bytes, checksum: xxh3_64(bytes) };
        if self.chunks.len() <= id as usize {
            self.chunks.resize(id as usize + 1, None);
        }
        assert!(self.chunks[id as usize].replace(record).is_none(), "chunk {id} is written once");
        self.append(bytes)
    }

    /// Writes a section; its bytes are read back in place, so `T` must hold plain little-endian numbers.
    ///
    /// # Panics
    /// If the tag was used before.
    pub fn add_section<T: Pod>(&mut self, tag: [u8; 4], elements: &[T]) -> Result<(), ArchiveError> {
        assert!(self.sections.iter().all(|s| s.tag != tag), "section {tag:?} is written once");
        self.pad()?;
        let bytes: &[u8] = bytemuck::cast_slice(elements);
        self.sections.push(SectionRecord {
            tag,
            element_size: size_of::<T>() as u32,
            offset: self.length,
            length: bytes.len() as u64,
            checksum: xxh3_64(bytes),
        });
        self.append(bytes)
    }

    /// Writes tables, directory and header, syncs, and gives the file its name. Returns its length in bytes.
    ///
    /// # Panics
    /// If a chunk number was left out.
    pub fn finish(mut self) -> Result<u64, ArchiveError> {
        let chunks: Option<Vec<ChunkRecord>> = std::mem::take(&mut self.chunks).into_iter().collect();
        self.add_section(CHUNK_TABLE, &chunks.expect("every chunk up to the last was written"))?;
        let features = std::mem::take(&mut self.features);
        self.add_section(FEATURES, &features)?;
        self.pad()?;
        let sections = std::mem::take(&mut self.sections);
        let directory: &[u8] = bytemuck::cast_slice(&sections);
        self.header.directory_offset = self.length;
        self.header.directory_length = directory.len() as u64;
        self.header.directory_checksum = xxh3_64(directory);
        self.append(directory)?;
        self.header.file_length = self.length;
        self.header.header_checksum = self.header.checksum();
        // The header goes to the medium after everything that it vouches for.
        self.check("sync the file", |s| s.sync())?;
        let header = self.header;
        self.check("write the header", |s| s.replace(0, bytemuck::bytes_of(&header)))?;
        self.check("sync the file", |s| s.sync())?;
        self.check("give the file its name", |s| s.publish())?;
        self.check("sync the folder", |s| s.sync_folder())?;
        Ok(self.length)
    }

    fn pad(&mut self) -> Result<(), ArchiveError> {
        let end = self.length.next_multiple_of(ALIGNMENT);
        self.append(&[0; ALIGNMENT as usize][..(end - self.length) as usize])
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), ArchiveError> {
        self.length += bytes.len() as u64;
        self.check("write", |s| s.append(bytes))
    }

    fn check(
        &mut self,
        doing: &'static str,
        operation: impl FnOnce(&mut S) -> io::Result<()>,
    ) -> Result<(), ArchiveError> {
        operation(&mut self.storage).map_err(|source| ArchiveError::new(&self.path, Fault::Io { doing, source }))
    }
}
