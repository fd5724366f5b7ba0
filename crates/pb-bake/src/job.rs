//! A bake that can be cut short at any moment and continued: its finished steps lie in a hidden folder among the temporary
//! files, one journal per step, until the archive is written.
//!
//! The folder belongs to one archive name and says what it was made from: this program, the inputs, the options. A bake
//! with `--resume` goes on from there when all of that is still so; every other bake of that name removes it. A power cut
//! may lose what was written last; then the sums of the journals show it, and those steps are made again.

mod journal;
mod scene;

use crate::cli::BakeArgs;
use crate::failure::{Failure, blame_machine};
use crate::interrupt;
use crate::progress::Progress;
use journal::Journal;
use pb_archive::{ArchiveError, Spill};
use pb_lod::progressive_buffers::bake::checkpoints::Checkpoints;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use xxhash_rust::xxh3::xxh3_64;

/// Says what the folder was made from.
const ORIGIN: &str = "origin";
/// Whoever holds this file's lock works in the folder.
const LOCK: &str = "lock";
/// Packed chunks.
const CHUNKS: &str = "chunks";

/// The state of a bake beyond its process; without a folder, nothing is kept.
pub struct Job<'a> {
    progress: &'a Progress,
    folder: Option<Folder>,
    state: Mutex<State>,
}

struct Folder {
    path: PathBuf,
    /// Held until the end.
    _lock: File,
}

#[derive(Default)]
struct State {
    journals: BTreeMap<&'static str, Journal>,
    /// Steps of which something was found.
    resumed: BTreeSet<&'static str>,
    /// Has something been kept, now or before?
    holds: bool,
    /// Something could not be kept: nothing more is.
    failed: bool,
}

impl<'a> Job<'a> {
    /// Looks for what an earlier bake has left, and makes room for what this one will. `room`: is there some on the disk?
    ///
    /// # Errors
    /// With `--resume`: another process works there.
    pub fn open(args: &BakeArgs, room: bool, progress: &'a Progress) -> Result<Self, Failure> {
        let job = |folder| Job { progress, folder, state: Mutex::default() };
        let output = args.output.as_ref().expect("the command line demands it");
        let path = folder_of(args.temp_folder(), output);
        let lock = match lock_folder(&path) {
            Ok(lock) => lock,
            Err(TryLockError::WouldBlock) if args.resume => {
                return Err(blame_machine(format!("{}: another pb-bake makes it just now", output.display())));
            }
            Err(TryLockError::WouldBlock) => {
                progress.note("another pb-bake makes the same archive; this one cannot be resumed");
                return Ok(job(None));
            }
            Err(TryLockError::Error(e)) => {
                progress.note(&format!("{}: {e}; this bake cannot be resumed", args.temp_folder().display()));
                return Ok(job(None));
            }
        };
        let origin = origin(args);
        let before = fs::read_to_string(path.join(ORIGIN)).ok();
        let fits = before.as_deref() == Some(&origin);
        if args.resume && !fits {
            let why = before.map_or("nothing is there".into(), |before| difference(&before, &origin));
            progress.note(&format!("cannot resume from {}: {why}; the bake begins anew", args.temp_folder().display()));
        }
        let mut kept = job(Some(Folder { path, _lock: lock }));
        if !(args.resume && fits) {
            kept.clear();
            let written = kept.folder.as_ref().map(|f| fs::write(f.path.join(ORIGIN), origin));
            if !room || written.is_none_or(|w| w.is_err()) {
                progress.note("the disk has no room for what a bake could be resumed from; this one cannot be");
                kept.remove();
                return Ok(job(None));
            }
        }
        let here = args.temp_folder().display();
        interrupt::advise(Some(format!(
            "what is finished is kept in {here}: give the same command with --resume to go on, without it to begin anew"
        )));
        Ok(kept)
    }

    /// Where chunks wait: in the folder, where they can be found again.
    pub fn spill(&self, args: &BakeArgs) -> Result<Spill, ArchiveError> {
        match &self.folder {
            Some(folder) => Spill::in_file(&folder.path.join(CHUNKS)),
            None => Spill::in_folder(args.temp_folder()),
        }
    }

    /// The steps of which something was found.
    pub fn resumed(&self) -> Vec<&'static str> {
        self.lock().resumed.iter().copied().collect()
    }

    /// Forgets all that is kept.
    pub fn clear(&mut self) {
        *self.lock() = State::default();
        let Some(folder) = &self.folder else { return };
        for entry in fs::read_dir(&folder.path).into_iter().flatten().flatten() {
            if entry.file_name() != LOCK {
                // What cannot be removed is found damaged or of another origin.
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// The archive is written, or can never be.
    pub fn remove(self) {
        interrupt::advise(None);
        if let Some(folder) = &self.folder {
            let _ = fs::remove_dir_all(&folder.path);
        }
    }

    /// After a failure that has its reason in the machine: how to go on, if there is something to go on from.
    pub fn keep(self) -> Option<String> {
        if self.lock().holds {
            return interrupt::advice();
        }
        self.remove();
        None
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn journal(&mut self, folder: &Folder, step: &'static str) -> io::Result<&mut Journal> {
        if !self.journals.contains_key(step) {
            self.journals.insert(step, Journal::open(folder.path.join(step))?);
        }
        Ok(self.journals.get_mut(step).expect("inserted where it was missing"))
    }
}

impl Checkpoints for Job<'_> {
    fn load(&self, step: &'static str, part: u32) -> Option<Box<dyn Read + '_>> {
        let mut state = self.lock();
        let found = state.journal(self.folder.as_ref()?, step).ok()?.find(part)?;
        state.resumed.insert(step);
        state.holds = true;
        Some(Box::new(found))
    }

    fn save(&self, step: &'static str, part: u32, write: &dyn Fn(&mut dyn Write) -> io::Result<()>) {
        let mut state = self.lock();
        let Some(folder) = self.folder.as_ref().filter(|_| !state.failed) else { return };
        match state.journal(folder, step).and_then(|journal| journal.append(part, write)) {
            Ok(()) => state.holds = true,
            Err(e) => {
                state.failed = true;
                drop(state);
                let path = folder.path.display();
                self.progress.note(&format!("{path}: {e}; the bake goes on, but can be resumed only from here"));
            }
        }
    }
}

/// The folder of the bake of an archive.
fn folder_of(temp: &Path, output: &Path) -> PathBuf {
    let full = std::path::absolute(output).unwrap_or_else(|_| output.to_owned());
    let folder = full.parent().and_then(|p| fs::canonicalize(p).ok());
    let full = folder.zip(full.file_name()).map_or(full.clone(), |(folder, name)| folder.join(name));
    temp.join(format!(".pb-bake-{:016x}.job", xxh3_64(full.as_os_str().as_encoded_bytes())))
}

fn lock_folder(path: &Path) -> Result<File, TryLockError> {
    let open = || {
        fs::create_dir_all(path)?;
        File::options().write(true).create(true).truncate(false).open(path.join(LOCK))
    };
    let file = open().map_err(TryLockError::Error)?;
    file.try_lock().map(|()| file)
}

/// All that decides over the bytes of the archive, a line each: the program, the inputs, the options.
fn origin(args: &BakeArgs) -> String {
    let program = std::env::current_exe().and_then(fs::read).map(|bytes| xxh3_64(&bytes));
    let mut text = format!("program {} {:016x}\n", env!("CARGO_PKG_VERSION"), program.unwrap_or_default());
    let mut file = |kind: &str, path: &Path| {
        let _ = writeln!(text, "{kind} {}", stamp(path));
    };
    let BakeArgs {
        inputs,
        output: _,
        levels,
        ratio,
        cluster_triangles,
        threads: _,
        expand_instances,
        texture,
        strict,
        charts,
        tile_size,
        normal_map,
        texture_quality,
        texture_format,
        xatlas_helper,
        xatlas_time_limit,
        memory: _,
        temp_dir: _,
        resume: _,
        force: _,
        quiet: _,
        json: _,
        progress_json: _,
        weld_tolerance,
        crease_angle,
        normals,
    } = args;
    inputs.iter().for_each(|path| file("input", path));
    texture.iter().for_each(|path| file("texture", path));
    xatlas_helper.iter().for_each(|path| file("helper", path));
    let _ = writeln!(text, "levels {levels} {ratio} {cluster_triangles:?}");
    let _ =
        writeln!(text, "textures {strict} {charts:?} {tile_size} {normal_map} {texture_quality:?} {texture_format:?}");
    let _ = writeln!(text, "instances {expand_instances}");
    let _ = writeln!(text, "xatlas {xatlas_time_limit}");
    let _ = writeln!(text, "repairs {weld_tolerance} {crease_angle} {normals:?}");
    text
}

/// What tells a file from what it is after a change: path, size, time.
fn stamp(path: &Path) -> String {
    let full = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let (length, changed) = fs::metadata(path).map(|m| (m.len(), m.modified().ok())).unwrap_or_default();
    format!("{full:?} {length} {changed:?}")
}

/// What has changed, in words.
fn difference(before: &str, now: &str) -> String {
    let kind = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
    let changed = now.lines().find(|line| !before.lines().any(|b| b == *line));
    match changed.map(kind).as_deref() {
        Some("program") => "it was begun by another version of pb-bake".into(),
        Some(kind @ ("input" | "texture" | "helper")) => format!("the {kind} has changed"),
        _ => "it was begun with other options".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_follows_the_archive_not_how_it_is_named() {
        let temp = tempfile::tempdir().unwrap();
        let of = |name: &str| folder_of(temp.path(), &temp.path().join(name));
        assert_eq!(of("a.pb"), of("../").parent().map(|_| of("./a.pb")).unwrap());
        assert_ne!(of("a.pb"), of("b.pb"));
    }

    #[test]
    fn what_has_changed_is_named() {
        let before = "program 1\ninput a 3\nlevels 5\n";
        assert_eq!(
            difference(before, "program 2\ninput a 3\nlevels 5\n"),
            "it was begun by another version of pb-bake"
        );
        assert_eq!(difference(before, "program 1\ninput a 4\nlevels 5\n"), "the input has changed");
        assert_eq!(difference(before, "program 1\ninput a 3\nlevels 4\n"), "it was begun with other options");
    }
}
