//! Chunks on their way from the file to the frames: what reads them, and in which frame they arrive.
//!
//! As they come, or, so that a run can be repeated, on virtual time: frames late, or from a slow disk of which the flight's
//! own time is the clock. Must never: let the wall clock decide when a chunk arrives on virtual time.

use pb_lod::plan::{ChunkId, Want};
use pb_lod::progressive_buffers::codec::{Chunk, Decoder};
use pb_lod::progressive_buffers::model::{Model, ModelError};
use pb_render::ChunkData;
use pb_stream::disk::{Disk, DiskModel};
use pb_stream::loader::{LoadResult, LoadStats, Loader, Source, Threads};
use pb_stream::merge::Extent;
use rayon::prelude::*;
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Threads that wait for the disk: enough to keep a solid state disk busy.
const READERS: usize = 4;
/// Most threads that decode; they leave half of the processor to the frame.
const MAX_DECODERS: usize = 8;

/// Threads that decode are this nice to those that draw: on few processors a frame would wait for chunks that it does not
/// need.
#[cfg(target_os = "linux")]
const DECODER_NICENESS: i32 = 5;

thread_local! {
    /// Of each thread that decodes: it asks for memory for what a chunk becomes and for nothing else.
    static DECODER: RefCell<Decoder> = RefCell::default();
}

/// A chunk in memory.
#[derive(Clone)]
pub enum Loaded {
    /// Vertices and indices.
    Geometry(Chunk),
    /// Mips as the archive has them.
    Texture(Vec<u8>),
    /// Only its arrival is simulated: nothing will be drawn.
    Unread,
}

/// Which clock a slow disk has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiskClock {
    /// The frames' times: the same arrivals in every run.
    Frames,
    /// The wall's: reads take longer.
    Wall,
}

/// What is always there, read from the file.
pub struct CoarseChunks<'a> {
    /// Geometry, by cluster.
    pub chunks: Vec<Chunk>,
    /// Texture mips, by cluster; empty where there are none.
    pub tails: Vec<Cow<'a, [u8]>>,
}

impl<'a> CoarseChunks<'a> {
    /// Reads the coarsest level of every cluster.
    pub fn read(model: &'a Model) -> Result<Self, ModelError> {
        let (clusters, coarsest) = (0..model.record().clusters, model.levels() - 1);
        let textured = if model.textures().is_some() { clusters.clone() } else { 0..0 };
        let geometry = clusters.map(|c| model.chunk_id(c, coarsest));
        let tails = textured.map(|c| model.texture_chunk_id(c, coarsest));
        let (geometry, tails): (Vec<ChunkId>, Vec<ChunkId>) = (geometry.collect(), tails.collect());
        for kind in [&geometry, &tails] {
            announce(model, kind);
        }
        let chunks: Result<Vec<Chunk>, ModelError> = geometry.into_par_iter().map(|c| model.read_chunk(c)).collect();
        let tails: Result<Vec<_>, ModelError> = tails.into_par_iter().map(|c| model.read_texture(c)).collect();
        Ok(Self { chunks: chunks?, tails: tails? })
    }
}

/// Tells the system of chunks that will be read, where they lie together: one long read instead of many short ones.
fn announce(model: &Model, chunks: &[ChunkId]) {
    let extents = || chunks.iter().map(|&c| model.extent(c));
    let bytes: u64 = extents().map(|(_, bytes)| u64::from(bytes)).sum();
    let start = extents().map(|(offset, _)| offset).min().unwrap_or(0);
    let end = extents().map(|(offset, bytes)| offset + u64::from(bytes)).max().unwrap_or(0);
    if end - start <= 2 * bytes {
        model.archive().will_need(start, end - start);
    }
}

/// The archive as the loader sees it.
struct ArchiveSource {
    model: Arc<Model>,
    /// Reads take at least as long as this disk's.
    slow: Option<DiskModel>,
}

impl Source for ArchiveSource {
    type Payload = Loaded;

    fn extent(&self, chunk: pb_stream::ChunkId) -> Extent {
        let (offset, bytes) = self.model.extent(ChunkId(chunk.0));
        Extent { offset, bytes: bytes.into() }
    }

    fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
        let start = Instant::now();
        let bytes = self.model.archive().read(extent.offset, extent.bytes as usize);
        if let Some(model) = &self.slow {
            std::thread::sleep(model.read_time(extent.bytes).saturating_sub(start.elapsed()));
        }
        bytes.map(Cow::into_owned).map_err(|e| e.to_string())
    }

    fn decode(&self, chunk: pb_stream::ChunkId, bytes: &[u8]) -> LoadResult<Loaded> {
        let chunk = ChunkId(chunk.0);
        let loaded = match self.model.is_texture(chunk) {
            true => self.model.check_texture(chunk, bytes).map(|()| Loaded::Texture(bytes.to_vec())),
            false => {
                let mut decoded = Chunk::default();
                let decode = |decoder: &RefCell<Decoder>| {
                    self.model.decode_into(chunk, bytes, &mut decoder.borrow_mut(), &mut decoded)
                };
                DECODER.with(decode).map(|()| Loaded::Geometry(decoded))
            }
        };
        loaded.map_err(|e| e.to_string())
    }

    fn begin_decoding(&self) {
        // On Linux this is the thread's own niceness. Where it is refused, frames and decoding share as equals.
        #[cfg(target_os = "linux")]
        let _ = rustix::process::setpriority_process(None, DECODER_NICENESS);
    }

    fn will_need(&self, extent: Extent) {
        if self.slow.is_none() {
            self.model.archive().will_need(extent.offset, extent.bytes);
        }
    }
}

/// The two arrays of a chunk of geometry.
pub fn chunk_data(chunk: &Chunk) -> ChunkData<'_> {
    ChunkData { vertices: &chunk.vertices, indices: &chunk.indices }
}

type Arrival = (pb_stream::ChunkId, LoadResult<Loaded>);

/// When chunks arrive.
enum Pace {
    AsTheyCome,
    /// So many frames after they were asked for; those that wait, with what is left of that.
    Late(u32, VecDeque<(u32, Arrival)>),
    /// When this disk has read them.
    Disk(Box<Disk>),
}

/// Chunks under way.
pub struct Feed {
    model: Arc<Model>,
    /// None where nothing is read.
    loader: Option<Loader<ArchiveSource>>,
    pace: Pace,
    /// Virtual time: the sum of the frames'.
    now: Duration,
    /// Read, but the slow disk has not said so yet.
    early: BTreeMap<pb_stream::ChunkId, LoadResult<Loaded>>,
    /// Per chunk: the frame in which it was last wanted while something was under way, and its place in the order then.
    ranks: Vec<(u64, u32)>,
    frame: u64,
}

impl Feed {
    /// Starts the threads.
    pub fn new(model: Arc<Model>) -> Self {
        let loader = Some(start(&model, READERS, None));
        Self::with(model, loader, Pace::AsTheyCome)
    }

    /// Reads nothing: chunks come when this disk would have read them, on the frames' clock, and are empty.
    pub fn unread(model: Arc<Model>, disk: DiskModel) -> Self {
        Self::with(model, None, Pace::Disk(Box::new(Disk::new(disk))))
    }

    fn with(model: Arc<Model>, loader: Option<Loader<ArchiveSource>>, pace: Pace) -> Self {
        let ranks = vec![(0, 0); model.chunk_count() as usize];
        Self { model, loader, pace, now: Duration::ZERO, early: BTreeMap::new(), ranks, frame: 0 }
    }

    /// From now on chunks arrive exactly this many frames after they were asked for; 0 is as soon as they are here.
    pub fn set_late_frames(&mut self, frames: u32) {
        self.pace = if frames > 0 { Pace::Late(frames, VecDeque::new()) } else { Pace::AsTheyCome };
    }

    /// From now on chunks come from a slow disk. To be called before the first request.
    pub fn set_disk(&mut self, model: DiskModel, clock: DiskClock) {
        match clock {
            DiskClock::Frames => self.pace = Pace::Disk(Box::new(Disk::new(model))),
            DiskClock::Wall => self.loader = Some(start(&self.model, 1, Some(model))),
        }
    }

    /// Asks for a chunk.
    pub fn request(&mut self, chunk: pb_stream::ChunkId) {
        if let Some(loader) = &mut self.loader {
            loader.request(chunk).expect("the cache keeps fewer loads in flight than the queue holds");
        }
        if let Pace::Disk(disk) = &mut self.pace {
            disk.ask(chunk, extent(&self.model, chunk));
        }
    }

    /// What is under way is read in the order of these wants, most urgent first; what is not among them, last.
    pub fn reorder(&mut self, wants: &[Want]) {
        if self.loader.as_ref().is_some_and(|l| l.outstanding() == 0) && self.early.is_empty() {
            return;
        }
        self.frame += 1;
        for (place, want) in (0..).zip(wants) {
            self.ranks[want.chunk.0 as usize] = (self.frame, place);
        }
        let (ranks, frame) = (&self.ranks, self.frame);
        let rank = |chunk: pb_stream::ChunkId| match ranks[chunk.0 as usize] {
            (wanted, place) if wanted == frame => place.into(),
            _ => u64::MAX,
        };
        match &mut self.pace {
            Pace::Disk(disk) => disk.reorder(rank),
            _ => self.loader.iter().for_each(|l| l.reorder(rank)),
        }
    }

    /// These are not to be read, where that was not begun. They come back here, and nowhere else.
    pub fn withdraw(&mut self, chunks: &BTreeSet<pb_stream::ChunkId>) -> Vec<pb_stream::ChunkId> {
        let unwanted = |chunk| chunks.contains(&chunk);
        match (&mut self.pace, &mut self.loader) {
            _ if chunks.is_empty() => Vec::new(),
            (Pace::Disk(disk), _) => {
                let withdrawn = disk.withdraw(unwanted);
                self.forget(&withdrawn);
                withdrawn
            }
            (Pace::AsTheyCome, Some(loader)) => loader.withdraw(unwanted),
            // All is read before the next frame.
            (Pace::Late(..) | Pace::AsTheyCome, _) => Vec::new(),
        }
    }

    /// The slow disk will not read these; the loader does not have to either, unless it was quicker.
    fn forget(&mut self, chunks: &[pb_stream::ChunkId]) {
        let Some(loader) = &mut self.loader else { return };
        let mut all: BTreeSet<pb_stream::ChunkId> = chunks.iter().copied().collect();
        for chunk in loader.withdraw(|c| all.contains(&c)) {
            all.remove(&chunk);
        }
        all.into_iter().for_each(|chunk| drop(self.wait_for(chunk)));
    }

    /// What arrives in this frame, `dt_secs` after the last one.
    pub fn take(&mut self, dt_secs: f32) -> Vec<Arrival> {
        self.now += Duration::try_from_secs_f32(dt_secs).unwrap_or_default();
        let read = match &mut self.pace {
            Pace::AsTheyCome => return std::iter::from_fn(|| self.loader.as_mut()?.try_next()).collect(),
            Pace::Late(frames, waiting) => {
                waiting.iter_mut().for_each(|(left, _)| *left -= 1);
                waiting.extend(drain(&mut self.loader).into_iter().map(|arrival| (*frames, arrival)));
                let due = waiting.iter().take_while(|(left, _)| *left == 0).count();
                return waiting.drain(..due).map(|(_, arrival)| arrival).collect();
            }
            Pace::Disk(disk) => disk.advance(self.now),
        };
        read.into_iter().map(|chunk| self.wait_for(chunk)).collect()
    }

    /// Waits for all that was asked for, and returns it in an order that does not depend on threads.
    pub fn drain(&mut self) -> Vec<Arrival> {
        match &mut self.pace {
            Pace::AsTheyCome => drain(&mut self.loader),
            Pace::Late(_, waiting) => {
                let waiting = std::mem::take(waiting).into_iter().map(|(_, arrival)| arrival);
                waiting.chain(drain(&mut self.loader)).collect()
            }
            Pace::Disk(disk) => disk.finish().into_iter().map(|chunk| self.wait_for(chunk)).collect(),
        }
    }

    fn wait_for(&mut self, chunk: pb_stream::ChunkId) -> Arrival {
        let Some(loader) = &mut self.loader else { return (chunk, Ok(Loaded::Unread)) };
        loop {
            if let Some(result) = self.early.remove(&chunk) {
                return (chunk, result);
            }
            let (other, result) = loader.wait_next().expect("the slow disk reads what the loader was asked for");
            self.early.insert(other, result);
        }
    }

    /// What was read up to now; on virtual time by the slow disk, so that it is the same in every run.
    pub fn stats(&self) -> LoadStats {
        let stats = self.loader.as_ref().map_or(LoadStats::default(), Loader::stats);
        match &self.pace {
            Pace::Disk(disk) => LoadStats { reads: disk.reads().0, bytes_read: disk.reads().1, ..stats },
            _ => stats,
        }
    }
}

fn drain(loader: &mut Option<Loader<ArchiveSource>>) -> Vec<Arrival> {
    loader.as_mut().map_or(Vec::new(), Loader::drain)
}

fn extent(model: &Model, chunk: pb_stream::ChunkId) -> Extent {
    let (offset, bytes) = model.extent(ChunkId(chunk.0));
    Extent { offset, bytes: bytes.into() }
}

fn start(model: &Arc<Model>, readers: usize, slow: Option<DiskModel>) -> Loader<ArchiveSource> {
    let decode = std::thread::available_parallelism().map_or(1, |n| n.get() / 2).clamp(1, MAX_DECODERS);
    Loader::new(Threads { read: readers, decode }, ArchiveSource { model: model.clone(), slow })
}
