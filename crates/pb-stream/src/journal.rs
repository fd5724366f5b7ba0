//! A run of the cache as a file: every event and every answer, and the same run again from it.
//!
//! The first line has the chunks and the bounds, each other one an event; all JSON. Floats are written as their bits, so
//! that a replay meets the very numbers. [`Recorded`] is a cache that may write such a file while it works; [`replay`]
//! runs a new cache through one and stops at the first command that differs.
//!
//! Must never: change what the cache does; hide that writing failed.

use crate::cache::{Cache, ChunkInfo, Command, Limits, LimitsError};
use crate::{ChunkId, Want};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, Write};
use std::ops::Deref;

/// Version of the file, its first number.
const VERSION: u32 = 1;

/// A float as its bits.
pub(crate) mod bits {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(value: &f32, out: S) -> Result<S::Ok, S::Error> {
        value.to_bits().serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
        u32::deserialize(from).map(f32::from_bits)
    }
}

#[derive(Serialize, Deserialize)]
struct Start {
    version: u32,
    chunks: Vec<ChunkInfo>,
    limits: Limits,
}

/// What the cache was told; after a frame also what it answered.
#[derive(Serialize, Deserialize)]
enum Event {
    Frame { wants: Vec<Want>, released: Vec<ChunkId>, commands: Vec<Command> },
    Loaded(ChunkId),
    LoadFailed(ChunkId),
    LoadWithdrawn(ChunkId),
    Uploaded(ChunkId),
    UploadFailed(ChunkId),
    LimitUploads(u64),
}

/// A cache that writes down what happens to it, once it is told to.
pub struct Recorded {
    cache: Cache,
    out: Option<Box<dyn Write + Send>>,
    failure: Option<std::io::Error>,
}

impl Deref for Recorded {
    type Target = Cache;

    fn deref(&self) -> &Cache {
        &self.cache
    }
}

impl Recorded {
    /// As [`Cache::new`].
    pub fn new(chunks: Vec<ChunkInfo>, limits: Limits) -> Result<Self, LimitsError> {
        Ok(Self { cache: Cache::new(chunks, limits)?, out: None, failure: None })
    }

    /// From now on all is written to `out`. To be called before the first event.
    pub fn record(&mut self, out: Box<dyn Write + Send>) {
        self.out = Some(out);
        self.write(&Start { version: VERSION, chunks: self.cache.chunks().to_vec(), limits: *self.cache.limits() });
    }

    /// Writes what is still buffered; fails if that fails, or anything failed before.
    pub fn finish_recording(&mut self) -> std::io::Result<()> {
        match (self.failure.take(), self.out.take()) {
            (Some(failure), _) => Err(failure),
            (None, Some(mut out)) => out.flush(),
            (None, None) => Ok(()),
        }
    }

    /// As [`Cache::frame`].
    pub fn frame(&mut self, wants: &[Want], released: &[ChunkId]) -> Vec<Command> {
        let commands = self.cache.frame(wants, released);
        if self.out.is_some() {
            let (wants, released, commands) = (wants.to_vec(), released.to_vec(), commands.clone());
            self.write(&Event::Frame { wants, released, commands });
        }
        commands
    }

    /// As [`Cache::loaded`].
    pub fn loaded(&mut self, chunk: ChunkId) {
        self.write(&Event::Loaded(chunk));
        self.cache.loaded(chunk);
    }

    /// As [`Cache::load_failed`].
    pub fn load_failed(&mut self, chunk: ChunkId) {
        self.write(&Event::LoadFailed(chunk));
        self.cache.load_failed(chunk);
    }

    /// As [`Cache::load_withdrawn`].
    pub fn load_withdrawn(&mut self, chunk: ChunkId) {
        self.write(&Event::LoadWithdrawn(chunk));
        self.cache.load_withdrawn(chunk);
    }

    /// As [`Cache::uploaded`].
    pub fn uploaded(&mut self, chunk: ChunkId) {
        self.write(&Event::Uploaded(chunk));
        self.cache.uploaded(chunk);
    }

    /// As [`Cache::upload_failed`].
    pub fn upload_failed(&mut self, chunk: ChunkId) {
        self.write(&Event::UploadFailed(chunk));
        self.cache.upload_failed(chunk);
    }

    /// As [`Cache::limit_uploads`].
    pub fn limit_uploads(&mut self, bytes_per_frame: u64) {
        self.write(&Event::LimitUploads(bytes_per_frame));
        self.cache.limit_uploads(bytes_per_frame);
    }

    fn write(&mut self, line: &impl Serialize) {
        let Some(out) = &mut self.out else { return };
        let written = serde_json::to_writer(&mut *out, line).map_err(Into::into).and_then(|()| out.write_all(b"\n"));
        if let Err(failure) = written {
            // Told at the end: the flight goes on.
            self.failure = Some(failure);
            self.out = None;
        }
    }
}

/// What a replay went through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Frames.
    pub frames: u64,
    /// Commands, all the same as when it was recorded.
    pub commands: u64,
}

/// Why a replay stopped.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be read.
    #[error("line {line}: cannot read it: {source}")]
    Io {
        /// From 1.
        line: u64,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A line that is no event.
    #[error("line {line}: not a recorded run: {why}; record it again with this version")]
    Line {
        /// From 1.
        line: u64,
        /// What does not fit.
        why: String,
    },
    /// The cache decides otherwise.
    #[error(
        "line {line}, frame {frame}: the cache says {found} where {expected} was recorded; they are of two versions"
    )]
    Differs {
        /// From 1.
        line: u64,
        /// From 1.
        frame: u64,
        /// The first command that differs, as recorded.
        expected: String,
        /// As it is now.
        found: String,
    },
}

/// Runs a new cache through a recorded run. Fails at the first command that differs.
///
/// # Panics
/// If the file was changed so that an event answers no command.
pub fn replay(file: impl BufRead) -> Result<Replayed, ReplayError> {
    let mut lines = (1..).zip(file.lines());
    let mut next = || {
        let (line, text) = lines.next()?;
        Some(text.map(|text| (line, text)).map_err(|source| ReplayError::Io { line, source }))
    };
    let broken = |line: u64, why: String| ReplayError::Line { line, why };
    let (_, start) = next().ok_or_else(|| broken(1, "it is empty".into()))??;
    let start: Start = serde_json::from_str(&start).map_err(|e| broken(1, e.to_string()))?;
    if start.version != VERSION {
        return Err(broken(1, format!("version {}, not {VERSION}", start.version)));
    }
    let mut cache = Cache::new(start.chunks, start.limits).map_err(|e| broken(1, e.to_string()))?;
    let mut done = Replayed::default();
    while let Some(next) = next() {
        let (line, text) = next?;
        match serde_json::from_str(&text).map_err(|e| broken(line, e.to_string()))? {
            Event::Frame { wants, released, commands } => {
                done.frames += 1;
                done.commands += commands.len() as u64;
                let found = cache.frame(&wants, &released);
                compare(&commands, &found).map_err(|(expected, found)| ReplayError::Differs {
                    line,
                    frame: done.frames,
                    expected,
                    found,
                })?;
            }
            Event::Loaded(chunk) => cache.loaded(chunk),
            Event::LoadFailed(chunk) => cache.load_failed(chunk),
            Event::LoadWithdrawn(chunk) => cache.load_withdrawn(chunk),
            Event::Uploaded(chunk) => cache.uploaded(chunk),
            Event::UploadFailed(chunk) => cache.upload_failed(chunk),
            Event::LimitUploads(bytes) => cache.limit_uploads(bytes),
        }
    }
    Ok(done)
}

/// The first pair of commands that differ.
fn compare(expected: &[Command], found: &[Command]) -> Result<(), (String, String)> {
    let name = |command: Option<&Command>| command.map_or("nothing".into(), |c| format!("{c:?}"));
    match (0..expected.len().max(found.len())).find(|&i| expected.get(i) != found.get(i)) {
        Some(i) => Err((name(expected.get(i)), name(found.get(i)))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Class;
    use crate::cache::POOLS;
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    struct Shared(Arc<Mutex<Vec<u8>>>);

    impl Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// A run over two chains of three chunks under tight bounds, with a failure of each kind.
    fn recorded() -> String {
        let chunk = |id: u32| ChunkInfo {
            ram_bytes: 100,
            vram_bytes: 100,
            pool: 0,
            coarser: (id % 3 < 2).then_some(ChunkId(id + 1)),
            pinned: false,
        };
        let mut cache = Recorded::new((0..6).map(chunk).collect(), Limits::new(400, [400; POOLS])).unwrap();
        let out = Shared::default();
        cache.record(Box::new(out.clone()));
        let mut refused = false;
        for frame in 0u32..40 {
            let error_px = if frame % 7 == 0 { f32::INFINITY } else { 0.1 + frame as f32 / 3.0 };
            let wants = [0, 1].map(|i| {
                let chunk = ChunkId(frame / 10 % 2 * 3 + i);
                Want { chunk, class: Class::Now, error_px }
            });
            let released: Vec<ChunkId> = (0..6).map(ChunkId).filter(|c| cache.retiring()[c.0 as usize]).collect();
            for command in cache.frame(&wants, &released) {
                match command {
                    Command::Load(ChunkId(3)) => cache.load_failed(ChunkId(3)),
                    Command::Load(c) => cache.loaded(c),
                    Command::Upload(c) if c.0 == 1 && !refused => {
                        refused = true;
                        cache.upload_failed(c);
                    }
                    Command::Upload(c) => cache.uploaded(c),
                    _ => {}
                }
            }
        }
        cache.finish_recording().unwrap();
        let bytes = out.0.lock().unwrap().clone();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_recorded_run_is_replayed_command_for_command() {
        let text = recorded();
        for kind in ["Loaded", "LoadFailed", "Uploaded", "UploadFailed", "Retire", "Free"] {
            assert!(text.contains(&format!("\"{kind}\"")), "the run has no {kind}");
        }
        let replayed = replay(text.as_bytes()).unwrap();
        assert_eq!(replayed.frames, 40);
        assert!(replayed.commands > 10, "{replayed:?}");
    }

    #[test]
    fn a_limit_on_uploads_that_changes_is_replayed() {
        let chunk = ChunkInfo { ram_bytes: 100, vram_bytes: 100, pool: 0, coarser: None, pinned: false };
        let mut cache = Recorded::new(vec![chunk; 3], Limits::new(400, [400; POOLS])).unwrap();
        let out = Shared::default();
        cache.record(Box::new(out.clone()));
        cache.limit_uploads(200);
        let wants = [0, 1, 2].map(|c| Want { chunk: ChunkId(c), class: Class::Now, error_px: 1.0 });
        cache.frame(&wants, &[]);
        (0..3).for_each(|c| cache.loaded(ChunkId(c)));
        let uploads = cache.frame(&wants, &[]);
        assert_eq!(uploads, [Command::Upload(ChunkId(0)), Command::Upload(ChunkId(1))]);
        (0..2).for_each(|c| cache.uploaded(ChunkId(c)));
        cache.limit_uploads(1);
        assert_eq!(cache.frame(&wants, &[]), [Command::Upload(ChunkId(2))], "one chunk always passes");
        cache.finish_recording().unwrap();
        let text = String::from_utf8(out.0.lock().unwrap().clone()).unwrap();
        assert_eq!(replay(text.as_bytes()).unwrap().frames, 3);
        let without: String =
            text.lines().filter(|l| !l.contains("LimitUploads")).map(|l| l.to_owned() + "\n").collect();
        assert!(matches!(replay(without.as_bytes()), Err(ReplayError::Differs { frame: 2, .. })));
    }

    #[test]
    fn a_run_that_goes_otherwise_is_noticed_with_its_place() {
        let text = recorded();
        let other = text.replacen("{\"Load\":2}", "{\"Load\":1}", 1);
        assert_ne!(text, other);
        let message = replay(other.as_bytes()).unwrap_err().to_string();
        assert!(message.contains("frame 1") && message.contains("Load(ChunkId(1))"), "{message}");
        // The bits of the wants count: a want that is missing changes the commands.
        let tighter = text.replacen("\"ram_bytes\":400", "\"ram_bytes\":100", 1);
        assert_ne!(text, tighter);
        assert!(matches!(replay(tighter.as_bytes()), Err(ReplayError::Differs { .. })));
    }

    #[test]
    fn other_files_are_refused() {
        for text in ["", "{}", "hello", "\u{0}"] {
            assert!(matches!(replay(text.as_bytes()), Err(ReplayError::Line { line: 1, .. })), "{text}");
        }
        let text = recorded().replacen("\"Loaded\"", "\"Loded\"", 1);
        assert!(matches!(replay(text.as_bytes()), Err(ReplayError::Line { line: 3.., .. })));
    }

    #[test]
    fn a_disk_that_is_full_is_told_at_the_end() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
                Err(std::io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let mut cache = Recorded::new(Vec::new(), Limits::new(1, [1; POOLS])).unwrap();
        cache.record(Box::new(Full));
        assert!(cache.frame(&[], &[]).is_empty());
        assert!(cache.finish_recording().is_err());
    }
}
