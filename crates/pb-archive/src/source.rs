//! Where an archive's bytes come from: an open file that is read at positions, or a copy in memory.
//!
//! No file is mapped: a page of a map that vanishes, because somebody cuts the file, ends the program with a signal;
//! a read that finds too little is an error (docs/decisions/010-reads.md).
//!
//! Must never: allocate by a number from the file that was not compared with the file's length.

use crate::error::Fault;
use std::borrow::Cow;
use std::fs::File;
use std::io::{Error, ErrorKind, Result};

/// Most bytes of tables that are kept in memory; those of 10 million clusters are fewer.
const MAX_TABLE_BYTES: u64 = 4 << 30;

/// A file, or bytes that stand for one.
pub(crate) enum Source {
    File { file: File, length: u64 },
    Memory(Words),
}

/// Bytes that begin at a multiple of 8, so that tables can be used where they lie.
#[derive(Default)]
pub(crate) struct Words {
    words: Vec<u64>,
    length: usize,
}

impl Words {
    /// A copy of bytes.
    pub fn copy(bytes: &[u8]) -> Self {
        let mut words = vec![0u64; bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self { words, length: bytes.len() }
    }

    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.length]
    }
}

impl Source {
    /// All bytes of an open file.
    pub fn file(file: File) -> Result<Self> {
        let length = file.metadata()?.len();
        Ok(Source::File { file, length })
    }

    /// Bytes when it was opened.
    pub fn length(&self) -> u64 {
        match self {
            Source::File { length, .. } => *length,
            Source::Memory(words) => words.length as u64,
        }
    }

    /// `bytes` bytes from `offset`, as `what` in messages. The caller compared both with the length.
    pub fn read(
        &self,
        what: impl Fn() -> String,
        offset: u64,
        bytes: usize,
    ) -> std::result::Result<Cow<'_, [u8]>, Fault> {
        match self {
            Source::Memory(words) => Ok(Cow::Borrowed(&words.bytes()[offset as usize..][..bytes])),
            Source::File { file, .. } => {
                let mut read = vec![0; bytes];
                read_exact_at(file, &mut read, offset).map_err(|e| fault(file, what(), offset + bytes as u64, e))?;
                Ok(Cow::Owned(read))
            }
        }
    }

    /// The bytes from `offset` to the end, to be kept.
    pub fn tail(&self, offset: u64) -> std::result::Result<Words, Fault> {
        let what = "the tables";
        let bytes = self.length() - offset;
        if bytes > MAX_TABLE_BYTES {
            let why = format!("they have {bytes} bytes, more than any model needs");
            return Err(Fault::Malformed { what: what.into(), why });
        }
        match self {
            Source::Memory(words) => Ok(Words::copy(&words.bytes()[offset as usize..])),
            Source::File { file, .. } => {
                let mut words = vec![0u64; (bytes as usize).div_ceil(8)];
                let read = &mut bytemuck::cast_slice_mut(&mut words)[..bytes as usize];
                read_exact_at(file, read, offset).map_err(|e| fault(file, what.into(), offset + bytes, e))?;
                Ok(Words { words, length: bytes as usize })
            }
        }
    }

    /// Tells the system that these bytes will be read soon, where it listens; it reads ahead by itself then.
    pub fn will_need(&self, offset: u64, bytes: u64) {
        #[cfg(any(target_os = "linux", target_os = "android", target_os = "freebsd"))]
        if let (Source::File { file, .. }, Some(bytes)) = (self, std::num::NonZeroU64::new(bytes)) {
            // A hint: where it is refused, reading works all the same.
            let _ = rustix::fs::fadvise(file, offset, Some(bytes), rustix::fs::Advice::WillNeed);
        }
        #[cfg(not(any(target_os = "linux", target_os = "android", target_os = "freebsd")))]
        let _ = (offset, bytes);
    }
}

/// Why a read failed: the file is shorter than it was when it was opened, or the system refused.
fn fault(file: &File, what: String, end: u64, error: Error) -> Fault {
    match file.metadata() {
        Ok(now) if error.kind() == ErrorKind::UnexpectedEof => Fault::Shortened { what, end, found: now.len() },
        _ => Fault::Io { doing: "read it", source: error },
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset) {
            Ok(0) => return Err(Error::from(ErrorKind::UnexpectedEof)),
            Ok(n) => {
                bytes = &mut bytes[n..];
                offset += n as u64;
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}
