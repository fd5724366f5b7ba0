//! Threads that read and decode chunks while the frame goes on.
//!
//! Requests are served in the order in which they were made, or of the ranks that they were given since, and neighbours
//! in the file are read together ([`merge`](crate::merge)); results come back over a channel. Some threads read, others decode, so that the disk does
//! not wait for the processor. What fails is tried again, by itself and behind the others. A panic of the source is an
//! error of that chunk, not of the program.

use crate::ChunkId;
use crate::merge::{Batch, Company, Extent, Waiting};
use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Most threads of a kind of one loader.
pub const MAX_THREADS: usize = 64;
/// Most requests that wait: more than a cache asks for at a time.
pub const MAX_QUEUE: usize = 1 << 16;
/// When so many bytes are being read or wait to be decoded, no further read begins.
pub const MAX_HELD_BYTES: u64 = 8 << 20;
/// How often a chunk that failed is tried again.
pub const RETRIES: u32 = 2;
/// Requests behind the one at work of which the system is told.
const HINTS: usize = 16;

/// A chunk's contents, or why there are none.
pub type LoadResult<P> = Result<P, String>;

/// Where chunks come from.
pub trait Source: Send + Sync + 'static {
    /// A decoded chunk.
    type Payload: Send + 'static;

    /// Where a chunk lies.
    fn extent(&self, chunk: ChunkId) -> Extent;

    /// All these bytes, or why not.
    fn read(&self, extent: Extent) -> Result<Vec<u8>, String>;

    /// Checks and unpacks the bytes of a chunk.
    fn decode(&self, chunk: ChunkId, bytes: &[u8]) -> LoadResult<Self::Payload>;

    /// Called by each thread that decodes, once, before its first chunk: a chance to let others go first.
    fn begin_decoding(&self) {}

    /// These bytes will be read soon: a chance to tell the system.
    fn will_need(&self, extent: Extent);
}

/// How many threads do what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threads {
    /// Read, and mostly wait for the disk. One makes reads follow one another.
    pub read: usize,
    /// Check and decode.
    pub decode: usize,
}

/// What a loader has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadStats {
    /// Reads that were begun.
    pub reads: u64,
    /// Their bytes, gaps between neighbours and repetitions included.
    pub bytes_read: u64,
    /// Chunks that were tried again.
    pub retries: u64,
}

/// A running loader. Dropping it forgets waiting requests, and waits for those in work.
pub struct Loader<S: Source> {
    source: Arc<S>,
    queue: Arc<Queue>,
    results: Receiver<Answer<S>>,
    threads: Vec<JoinHandle<()>>,
    requested: u64,
    outstanding: usize,
}

/// Number of the request, chunk, contents.
type Answer<S> = (u64, ChunkId, LoadResult<<S as Source>::Payload>);

/// Too many requests wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{MAX_QUEUE} chunks wait to be loaded already; ask again later")]
pub struct QueueFull;

/// A request and how often it failed.
#[derive(Clone, Copy)]
struct Ticket {
    number: u64,
    chunk: ChunkId,
    failures: u32,
}

/// A chunk that was read, among the bytes of its read.
struct Piece {
    ticket: Ticket,
    extent: Extent,
    bytes: Arc<Vec<u8>>,
    range: Range<usize>,
}

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: Waiting<Ticket>,
    read: VecDeque<Piece>,
    /// Being read, or read and not decoded.
    held_bytes: u64,
    stats: LoadStats,
    closed: bool,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        // No code that can panic runs under the lock, so a poisoned state is whole all the same.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `next` finds something; none when the loader is closed.
    fn next<T>(&self, next: impl Fn(&mut State) -> Option<T>) -> Option<T> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(found) = next(&mut state) {
                return Some(found);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The next read, and what will follow it.
    fn next_batch(&self) -> Option<(Batch<Ticket>, Vec<Extent>)> {
        self.next(|state| {
            if state.held_bytes >= MAX_HELD_BYTES {
                return None;
            }
            let batch = state.waiting.take()?;
            state.held_bytes += batch.extent.bytes;
            state.stats.reads += 1;
            state.stats.bytes_read += batch.extent.bytes;
            Some((batch, state.waiting.ahead(HINTS)))
        })
    }

    /// The bytes of a read are there for those who decode.
    fn was_read(&self, batch: Batch<Ticket>, bytes: Vec<u8>) {
        let bytes = Arc::new(bytes);
        let start = batch.extent.offset;
        let pieces = batch.parts.into_iter().map(|(extent, ticket)| {
            let range = (extent.offset - start) as usize..(extent.end() - start) as usize;
            Piece { ticket, extent, bytes: bytes.clone(), range }
        });
        let pieces: Vec<Piece> = pieces.collect();
        drop(bytes);
        self.lock().read.extend(pieces);
        self.changed.notify_all();
    }

    /// Back into the queue, behind the others and by itself. False when it failed too often.
    fn again(&self, extent: Extent, ticket: Ticket) -> bool {
        if ticket.failures > RETRIES {
            return false;
        }
        let mut state = self.lock();
        state.stats.retries += 1;
        state.waiting.push(extent, Company::Alone, ticket);
        drop(state);
        self.changed.notify_all();
        true
    }

    fn let_go(&self, bytes: u64) {
        self.lock().held_bytes -= bytes;
        self.changed.notify_all();
    }
}

impl<S: Source> Loader<S> {
    /// Starts the threads, 1 to [`MAX_THREADS`] of each kind.
    pub fn new(threads: Threads, source: S) -> Self {
        let (queue, source) = (Arc::new(Queue::default()), Arc::new(source));
        let (sender, results) = channel();
        let spawn = |name: String, work: fn(&Queue, &S, &Sender<Answer<S>>)| {
            let (queue, source, sender) = (queue.clone(), source.clone(), sender.clone());
            let thread = std::thread::Builder::new().name(name);
            thread.spawn(move || work(&queue, &source, &sender)).expect("the system has room for a few threads")
        };
        let read = (0..threads.read.clamp(1, MAX_THREADS)).map(|i| spawn(format!("pb-read-{i}"), read_all));
        let decode = (0..threads.decode.clamp(1, MAX_THREADS)).map(|i| spawn(format!("pb-decode-{i}"), decode_all));
        let threads = read.chain(decode).collect();
        Self { source, queue, results, threads, requested: 0, outstanding: 0 }
    }

    /// Asks for a chunk.
    pub fn request(&mut self, chunk: ChunkId) -> Result<(), QueueFull> {
        let extent = self.source.extent(chunk);
        let mut state = self.queue.lock();
        if state.waiting.len() + state.read.len() >= MAX_QUEUE {
            return Err(QueueFull);
        }
        state.waiting.push(extent, Company::Any, Ticket { number: self.requested, chunk, failures: 0 });
        drop(state);
        self.requested += 1;
        self.outstanding += 1;
        self.queue.changed.notify_all();
        Ok(())
    }

    /// Gives each chunk that waits a new rank; the lowest is read first.
    pub fn reorder(&self, rank: impl Fn(ChunkId) -> u64) {
        self.queue.lock().waiting.reorder(|ticket| rank(ticket.chunk));
    }

    /// Takes chunks out that are not to be read, where that was not begun. They come back here, and nowhere else.
    pub fn withdraw(&mut self, unwanted: impl Fn(ChunkId) -> bool) -> Vec<ChunkId> {
        let withdrawn = self.queue.lock().waiting.withdraw(|ticket| unwanted(ticket.chunk));
        self.outstanding -= withdrawn.len();
        withdrawn.into_iter().map(|ticket| ticket.chunk).collect()
    }

    /// Where chunks come from.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// Requests that were not answered yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// What was read up to now.
    pub fn stats(&self) -> LoadStats {
        self.queue.lock().stats
    }

    /// A finished chunk, if there is one now.
    pub fn try_next(&mut self) -> Option<(ChunkId, LoadResult<S::Payload>)> {
        let (_, chunk, result) = self.results.try_recv().ok()?;
        self.outstanding -= 1;
        Some((chunk, result))
    }

    /// Waits for a chunk; none when none was asked for.
    pub fn wait_next(&mut self) -> Option<(ChunkId, LoadResult<S::Payload>)> {
        self.receive().map(|(_, chunk, result)| (chunk, result))
    }

    fn receive(&mut self) -> Option<Answer<S>> {
        if self.outstanding == 0 {
            return None;
        }
        let answer = self.results.recv().expect("threads answer every request before they end");
        self.outstanding -= 1;
        Some(answer)
    }

    /// Waits for all requests and returns their results in the order of the requests: for runs that must not depend
    /// on the threads' luck.
    pub fn drain(&mut self) -> Vec<(ChunkId, LoadResult<S::Payload>)> {
        let mut done = BTreeMap::new();
        while let Some((number, chunk, result)) = self.receive() {
            done.insert(number, (chunk, result));
        }
        done.into_values().collect()
    }
}

impl<S: Source> Drop for Loader<S> {
    fn drop(&mut self) {
        self.queue.lock().closed = true;
        self.queue.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A thread ends by returning: panics are caught inside.
            let _ = thread.join();
        }
    }
}

fn read_all<S: Source>(queue: &Queue, source: &S, results: &Sender<Answer<S>>) {
    while let Some((batch, ahead)) = queue.next_batch() {
        let read = || {
            ahead.iter().for_each(|&extent| source.will_need(extent));
            source.read(batch.extent)
        };
        let bytes = caught(read).and_then(|bytes| match bytes.len() as u64 == batch.extent.bytes {
            true => Ok(bytes),
            false => Err(format!("{} bytes were read instead of {}", bytes.len(), batch.extent.bytes)),
        });
        match bytes {
            Ok(bytes) => queue.was_read(batch, bytes),
            Err(error) => {
                queue.let_go(batch.extent.bytes);
                // Of several chunks nobody knows yet whose fault it is.
                let blame = u32::from(batch.parts.len() == 1);
                for (extent, ticket) in batch.parts {
                    let ticket = Ticket { failures: ticket.failures + blame, ..ticket };
                    if !queue.again(extent, ticket) {
                        // Nobody may listen any more: then the loader is being closed.
                        let _ = results.send((ticket.number, ticket.chunk, Err(error.clone())));
                    }
                }
            }
        }
    }
}

fn decode_all<S: Source>(queue: &Queue, source: &S, results: &Sender<Answer<S>>) {
    source.begin_decoding();
    while let Some(piece) = queue.next(|state| state.read.pop_front()) {
        let Piece { ticket, extent, bytes, range } = piece;
        let result = caught(|| source.decode(ticket.chunk, &bytes[range]));
        // The last chunk of a read to be decoded gives its bytes back.
        if let Some(bytes) = Arc::into_inner(bytes) {
            queue.let_go(bytes.len() as u64);
        }
        let ticket = Ticket { failures: ticket.failures + 1, ..ticket };
        if result.is_err() && queue.again(extent, ticket) {
            continue;
        }
        if results.send((ticket.number, ticket.chunk, result)).is_err() {
            return; // nobody listens any more
        }
    }
}

fn caught<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err("a chunk could not be read because its reader failed; report this".into()))
}

#[cfg(test)]
mod tests;
