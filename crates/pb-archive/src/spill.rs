//! Room for chunks until their turn to be written comes: memory, a temporary file without a name, or a file that outlives
//! the process.
//!
//! Chunks may come in any order and from any thread; each is found again by what [`Spill::put`] returned, so nothing that
//! is written later depends on that order. A file without a name is gone when the last of them is, also after a crash; in
//! one with a name, chunks are found again by their [`SpillPlace`].

use crate::error::{ArchiveError, Fault};
use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::{Read, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use xxhash_rust::xxh3::xxh3_64;

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
    Spilled { file: Arc<SpillFile>, place: SpillPlace },
}

/// Where the bytes of a chunk lie in the file of a [`Spill`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct SpillPlace {
    offset: u64,
    length: u64,
    /// XXH3 of the bytes.
    hash: u64,
}

impl Spill {
    /// Chunks wait in memory.
    pub const fn in_memory() -> Spill {
        Spill { file: None }
    }

    /// Chunks wait in a new file in `folder`.
    pub fn in_folder(folder: &Path) -> std::result::Result<Spill, ArchiveError> {
        let file = tempfile::tempfile_in(folder).map_err(|source| no_room(folder, source))?;
        Ok(Spill::over(folder, file, 0))
    }

    /// Chunks wait in this file, behind what is in it already; it stays when the process ends.
    pub fn in_file(path: &Path) -> std::result::Result<Spill, ArchiveError> {
        let folder = path.parent().unwrap_or(path);
        let open = || {
            let file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
            let end = file.metadata()?.len();
            Ok((file, end))
        };
        let (file, end) = open().map_err(|source| no_room(folder, source))?;
        Ok(Spill::over(folder, file, end))
    }

    fn over(folder: &Path, file: File, end: u64) -> Spill {
        Spill { file: Some(Arc::new(SpillFile { folder: folder.to_owned(), inner: Mutex::new((file, end)) })) }
    }

    /// Takes a chunk in.
    pub fn put(&self, bytes: Vec<u8>) -> std::result::Result<ChunkBytes, ArchiveError> {
        let Some(file) = &self.file else { return Ok(bytes.into()) };
        let offset = file.append(&bytes).map_err(|source| no_room(&file.folder, source))?;
        let place = SpillPlace { offset, length: bytes.len() as u64, hash: xxh3_64(&bytes) };
        Ok(ChunkBytes(Place::Spilled { file: file.clone(), place }))
    }

    /// A chunk that an earlier process put into the same file; `None` where its bytes are not there any more.
    pub fn find(&self, place: SpillPlace) -> Option<ChunkBytes> {
        let file = self.file.as_ref()?;
        let end = file.inner.lock().unwrap_or_else(PoisonError::into_inner).1;
        let is_inside = place.offset.checked_add(place.length).is_some_and(|last| last <= end);
        let whole = is_inside && file.read(place).is_ok_and(|bytes| xxh3_64(&bytes) == place.hash);
        whole.then(|| ChunkBytes(Place::Spilled { file: file.clone(), place }))
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

    fn read(&self, place: SpillPlace) -> Result<Vec<u8>> {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let mut bytes = vec![0; place.length as usize];
        inner.0.seek(SeekFrom::Start(place.offset))?;
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
            Place::Spilled { place, .. } => place.length as usize,
        }
    }

    /// True without bytes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Where it lies in the file of its [`Spill`]; `None` in memory.
    pub fn place(&self) -> Option<SpillPlace> {
        match &self.0 {
            Place::Held(_) => None,
            Place::Spilled { place, .. } => Some(*place),
        }
    }

    /// The bytes themselves, read from the file where they are there.
    pub fn read(&self) -> std::result::Result<Cow<'_, [u8]>, ArchiveError> {
        match &self.0 {
            Place::Held(bytes) => Ok(Cow::Borrowed(bytes)),
            Place::Spilled { file, place } => {
                let bytes = file.read(*place).map_err(|source| no_room(&file.folder, source))?;
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
    fn chunks_in_a_file_with_a_name_are_found_again_unless_they_are_damaged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chunks");
        let put = |bytes: &[u8]| Spill::in_file(&path).unwrap().put(bytes.to_vec()).unwrap().place().unwrap();
        let places = [put(b"first"), put(b"second")];
        let found = |place| Spill::in_file(&path).unwrap().find(place).map(|c| c.read().unwrap().into_owned());
        assert_eq!(places.map(found), [Some(b"first".to_vec()), Some(b"second".to_vec())]);
        std::fs::write(&path, b"f1rstsecon").unwrap();
        assert_eq!(places.map(found), [None, None], "one changed, one cut");
        assert_eq!(Spill::in_memory().put(vec![1]).unwrap().place(), None);
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
