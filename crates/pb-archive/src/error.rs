//! What can be wrong with an archive, and where.

use std::path::{Path, PathBuf};

/// A fault together with the file it was found in.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", path.display())]
pub struct ArchiveError {
    /// The archive, or the target of a writer.
    pub path: PathBuf,
    /// What is wrong.
    #[source]
    pub fault: Fault,
}

impl ArchiveError {
    /// Names the file in which `fault` was found.
    pub fn new(path: &Path, fault: Fault) -> Self {
        Self { path: path.to_owned(), fault }
    }
}

/// What is wrong with an archive or with the place where one is to be written.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The operating system refused.
    #[error("cannot {doing}: {source}")]
    Io {
        /// What was tried.
        doing: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// Chunks cannot wait in a temporary file; the path is its folder.
    #[error("chunks cannot be kept in a temporary file there: {0}; give another folder with --temp-dir")]
    Spill(#[source] std::io::Error),
    /// The first bytes are not those of an archive.
    #[error("not a progressive-buffers archive (its first bytes are others); make one with pb-bake")]
    NotAnArchive,
    /// The file is shorter or longer than its header says.
    #[error("the file has {found} bytes, but its header says {expected}; it was cut or added to, copy it again")]
    Length {
        /// Bytes that the header promises.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// The file became shorter after it was opened.
    #[error(
        "{what} ends at byte {end}, but the file has only {found} now; it was cut while it was open, copy it again"
    )]
    Shortened {
        /// What was read.
        what: String,
        /// Where that ends.
        end: u64,
        /// Bytes that are left.
        found: u64,
    },
    /// A format version that this program does not read.
    #[error("format version {found}, but this program reads version {known}; update it or bake the archive again")]
    Version {
        /// Version in the file.
        found: u32,
        /// The only version that is read.
        known: u32,
    },
    /// A scheme that this program does not draw.
    #[error("level-of-detail scheme {found:?}, but {expected:?} is needed here; update the program")]
    Scheme {
        /// Tag in the file.
        found: String,
        /// Tag that was asked for.
        expected: String,
    },
    /// A required feature that this program does not know.
    #[error("needs feature {bit} ({name}), which this program does not know; update it")]
    Feature {
        /// Bit in the header.
        bit: u32,
        /// Name as given by the program that wrote the file.
        name: String,
    },
    /// Bytes that differ from their checksum.
    #[error("{what} at byte {offset} is damaged (its checksum differs); copy the file again or bake it again")]
    Checksum {
        /// Which structure.
        what: String,
        /// Where it starts.
        offset: u64,
    },
    /// A structure that contradicts itself or the file.
    #[error("{what}: {why}; the file is damaged or written by a faulty program")]
    Malformed {
        /// Which structure.
        what: String,
        /// What does not fit.
        why: String,
    },
    /// A section that is needed and not there.
    #[error("section {tag:?} is missing; the file was written by a faulty or another program")]
    NoSection {
        /// Its tag.
        tag: String,
    },
    /// A chunk number past the end of the chunk table.
    #[error("chunk {id} was asked for, but there are only {count}")]
    NoChunk {
        /// The number asked for.
        id: u32,
        /// Chunks in the table.
        count: u32,
    },
    /// The folder of the target is not there.
    #[error("its folder does not exist; create it first")]
    NoFolder,
    /// The target is a folder or a device.
    #[error("is a folder or a device, not a file; give a file name")]
    NotAFile,
    /// The target exists and is something else than an archive.
    #[error("exists and is not a progressive-buffers archive; use --force to replace it")]
    NotReplaced,
}

/// A tag as text for messages; bytes that are not printable become escapes.
pub(crate) fn tag_text(tag: [u8; 4]) -> String {
    tag.escape_ascii().to_string()
}
