//! Where a writer puts its bytes: five operations, so that tests can make each of them fail.

use crate::error::{ArchiveError, Fault};
use crate::format::MAGIC;
use std::cell::RefCell;
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Read, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use tempfile::NamedTempFile;

/// Bytes gathered before the system is called.
const BUFFER_BYTES: usize = 1 << 20;

/// Names of unfinished files.
const PREFIX: &str = ".pb-bake-";
const SUFFIX: &str = ".tmp";

/// What a writer needs from a file system.
///
/// Nothing is seen under the target's name before [`publish`](Storage::publish) returns, and dropping an
/// unpublished storage leaves nothing behind.
pub trait Storage {
    /// Adds bytes at the end.
    fn append(&mut self, bytes: &[u8]) -> Result<()>;
    /// Replaces bytes that were appended before; further appends go to the end again.
    fn replace(&mut self, offset: u64, bytes: &[u8]) -> Result<()>;
    /// Returns when all bytes are on the medium.
    fn sync(&mut self) -> Result<()>;
    /// Gives the file its name in one step; an older file of that name is gone.
    fn publish(&mut self) -> Result<()>;
    /// Returns when the name is on the medium.
    fn sync_folder(&mut self) -> Result<()>;
}

/// What may be replaced at the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overwrite {
    /// Only a progressive-buffers archive (by its first bytes).
    IfArchive,
    /// Any file; still no folder and no device.
    Force,
}

/// A temporary file in the target's folder.
pub struct FileStorage {
    file: Option<BufWriter<NamedTempFile>>,
    target: PathBuf,
    folder: PathBuf,
}

impl FileStorage {
    /// Checks that `target` may be written and starts a temporary file beside it.
    ///
    /// Fails when the folder is missing or not writable, the target is a folder or a device, or it is a file
    /// that `overwrite` protects; so that a long bake does not fail at its end.
    pub fn create(target: &Path, overwrite: Overwrite) -> std::result::Result<Self, ArchiveError> {
        let fail = |fault| ArchiveError::new(target, fault);
        let target = check_target(target, overwrite).map_err(fail)?;
        let folder = match target.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
            _ => PathBuf::from("."),
        };
        remove_abandoned(&folder);
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666)); // the umask takes its part
        }
        let file = builder.tempfile_in(&folder).map_err(|source| {
            fail(match source.kind() {
                ErrorKind::NotFound => Fault::NoFolder,
                _ => Fault::Io { doing: "write in its folder", source },
            })
        })?;
        // Held until the file is closed: who can lock such a file knows that nobody writes it any more.
        let _ = file.as_file().try_lock();
        Ok(Self { file: Some(BufWriter::with_capacity(BUFFER_BYTES, file)), target, folder })
    }

    /// The file that is written until it gets its name.
    pub fn temporary(&self) -> Option<&Path> {
        self.file.as_ref().map(|f| f.get_ref().path())
    }

    fn open_file(&mut self) -> &mut BufWriter<NamedTempFile> {
        self.file.as_mut().expect("a writer publishes once, as its last step on the file")
    }
}

/// Removes the unfinished files of writers that were killed.
fn remove_abandoned(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let is_ours = name.to_str().is_some_and(|n| n.starts_with(PREFIX) && n.ends_with(SUFFIX));
        if is_ours && File::open(entry.path()).is_ok_and(|file| file.try_lock().is_ok()) {
            // Whoever cannot remove it leaves it.
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// The file that is to be written: `target` itself or, for a link, what it points to.
fn check_target(target: &Path, overwrite: Overwrite) -> std::result::Result<PathBuf, Fault> {
    if target.file_name().is_none() {
        return Err(Fault::NotAFile);
    }
    let metadata = match std::fs::metadata(target) {
        Ok(metadata) => metadata,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(target.to_owned()),
        Err(source) => return Err(Fault::Io { doing: "look at it", source }),
    };
    if !metadata.is_file() {
        return Err(Fault::NotAFile);
    }
    if overwrite == Overwrite::IfArchive && !is_archive(target).unwrap_or(false) {
        return Err(Fault::NotReplaced);
    }
    std::fs::canonicalize(target).map_err(|source| Fault::Io { doing: "look at it", source })
}

fn is_archive(path: &Path) -> Result<bool> {
    let mut first = [0; MAGIC.len()];
    File::open(path)?.read_exact(&mut first)?;
    Ok(first == MAGIC)
}

impl Storage for FileStorage {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.open_file().write_all(bytes)
    }

    fn replace(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        let file = self.open_file();
        file.seek(SeekFrom::Start(offset))?;
        file.write_all(bytes)?;
        file.seek(SeekFrom::End(0)).map(|_| ())
    }

    fn sync(&mut self) -> Result<()> {
        let file = self.open_file();
        file.flush()?;
        file.get_ref().as_file().sync_all()
    }

    fn publish(&mut self) -> Result<()> {
        let file = self.file.take().expect("a writer publishes once");
        let file = file.into_inner().map_err(|e| e.into_error())?;
        file.persist(&self.target).map_err(|e| e.error)?;
        Ok(())
    }

    fn sync_folder(&mut self) -> Result<()> {
        // Only Unix lets a folder be opened and synced; elsewhere the rename is journalled by the system.
        if cfg!(unix) { File::open(&self.folder)?.sync_all() } else { Ok(()) }
    }
}

/// An archive in memory; every clone sees the same bytes.
#[derive(Clone, Default)]
pub struct MemoryStorage {
    bytes: Rc<RefCell<Vec<u8>>>,
}

impl MemoryStorage {
    /// A copy of what was written.
    pub fn to_vec(&self) -> Vec<u8> {
        self.bytes.borrow().clone()
    }
}

impl Storage for MemoryStorage {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.bytes.borrow_mut().extend(bytes);
        Ok(())
    }

    fn replace(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        self.bytes.borrow_mut()[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn sync(&mut self) -> Result<()> {
        Ok(())
    }

    fn publish(&mut self) -> Result<()> {
        Ok(())
    }

    fn sync_folder(&mut self) -> Result<()> {
        Ok(())
    }
}
