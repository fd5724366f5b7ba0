//! Room for chunks until their turn to be written comes: memory, or a temporary file without a name.
//!
//! Chunks may come in any order and from any thread; each is found again by what [`Spill::put`] returned, so nothing that
//! is written later depends on that order. The file is gone when the last of them is, also after a crash.

use crate::error::{ArchiveError, Fault};
use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::{Read, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Where chunks wait. Clones share the room.
#[derive(Clone, Debug, Default)]
pub struct Spill {
    /// `None`: memory.
    file: Option<Arc<SpillFile>>,
}

struct SpillFile {
    folder: PathBuf,
    /// The file and the end of what was written to it.
    inner: Mutex<(File, u64)>,
}

/// The bytes of a chunk, in memory or in the file of a [`Spill`].
#[derive(Clone, Debug)]
pub struct ChunkBytes(Place);

#[derive(Clone, Debug)]
enum Place {
    Held(Vec<u8>),
    Spilled { file: Arc<SpillFile>, offset: u64, length: usize },
}

impl Spill {
    /// Chunks wait in memory.
    pub fn in_memory() -> Spill {
        Spill::default()
    }

    /// Chunks wait in a new file in `folder`.
    pub fn in_folder(folder: &Path) -> std::result::Result<Spill, ArchiveError> {
        let file = tempfile::tempfile_in(folder).map_err(|source| no_room(folder, source))?;
        let inner = Mutex::new((file, 0));
        Ok(Spill { file: Some(Arc::new(SpillFile { folder: folder.to_owned(), inner })) })
    }

    /// Takes a chunk in.
    pub fn put(&self, bytes: Vec<u8>) -> std::result::Result<ChunkBytes, ArchiveError> {
        let Some(file) = &self.file else { return Ok(bytes.into()) };
        let offset = file.append(&bytes).map_err(|source| no_room(&file.folder, source))?;
        Ok(ChunkBytes(Place::Spilled { file: file.clone(), offset, length: bytes.len() }))
    }
}

impl SpillFile {
    /// Where the bytes begin. After a failure the next ones take the same place.
    fn append(&self, bytes: &[u8]) -> Result<u64> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let (file, end) = &mut *inner;
        let offset = *end;
        file.seek(SeekFrom::Start(offset))?;
        file.write_all(bytes)?;
        *end += bytes.len() as u64;
        Ok(offset)
    }

    fn read(&self, offset: u64, length: usize) -> Result<Vec<u8>> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut bytes = vec![0; length];
        inner.0.seek(SeekFrom::Start(offset))?;
        inner.0.read_exact(&mut bytes)?;
        Ok(bytes)
    }
}

impl fmt::Debug for SpillFile {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "SpillFile({})", self.folder.display())
    }
}

fn no_room(folder: &Path, source: std::io::Error) -> ArchiveError {
    ArchiveError::new(folder, Fault::Spill(source))
}

impl ChunkBytes {
    /// How many.
    pub fn len(&self) -> usize {
        match &self.0 {
            Place::Held(bytes) => bytes.len(),
            Place::Spilled { length, .. } => *length,
        }
    }

    /// True without bytes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The bytes themselves, read from the file where they are there.
    pub fn read(&self) -> std::result::Result<Cow<'_, [u8]>, ArchiveError> {
        match &self.0 {
            Place::Held(bytes) => Ok(Cow::Borrowed(bytes)),
            Place::Spilled { file, offset, length } => {
                let bytes = file.read(*offset, *length).map_err(|source| no_room(&file.folder, source))?;
                Ok(Cow::Owned(bytes))
            }
        }
    }
}

impl From<Vec<u8>> for ChunkBytes {
    fn from(bytes: Vec<u8>) -> Self {
        ChunkBytes(Place::Held(bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_come_back_whatever_the_order_and_threads() {
        let folder = tempfile::tempdir().unwrap();
        for spill in [Spill::in_memory(), Spill::in_folder(folder.path()).unwrap()] {
            let chunk = |i: u8| vec![i; 1000 + usize::from(i)];
            let put = |i: u8| (i, spill.put(chunk(i)).unwrap());
            let chunks: Vec<(u8, ChunkBytes)> = std::thread::scope(|scope| {
                let threads: Vec<_> =
                    (0..4).map(|t| scope.spawn(move || (0..50).map(|i| put(i * 4 + t)).collect::<Vec<_>>())).collect();
                threads.into_iter().flat_map(|t| t.join().unwrap()).collect()
            });
            drop(spill);
            for (i, bytes) in chunks.iter().rev() {
                assert_eq!((bytes.len(), &*bytes.read().unwrap()), (1000 + usize::from(*i), &*chunk(*i)));
            }
        }
    }

    #[test]
    fn the_file_has_no_name() {
        let folder = tempfile::tempdir().unwrap();
        let spill = Spill::in_folder(folder.path()).unwrap();
        let _chunk = spill.put(vec![1; 100]).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error_with_a_remedy() {
        let message = Spill::in_folder(Path::new("/no/such/folder")).unwrap_err().to_string();
        assert!(message.starts_with("/no/such/folder: ") && message.contains("--temp-dir"), "{message}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error_with_a_remedy() {
        let file = File::options().read(true).write(true).open("/dev/full").unwrap();
        let inner = Mutex::new((file, 0));
        let spill = Spill { file: Some(Arc::new(SpillFile { folder: "/tmp".into(), inner })) };
        let message = spill.put(vec![0; 100]).unwrap_err().to_string();
        assert!(message.contains("No space left") && message.contains("--temp-dir"), "{message}");
    }
}
