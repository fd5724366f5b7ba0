//! Threads that read and decode chunks while the frame goes on.
//!
//! Requests are served in the order in which they were made, results come back over a channel. What is read, and how,
//! is the caller's function; a panic in it is an error of that chunk, not of the program.

use crate::ChunkId;
use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Most threads of one loader.
pub const MAX_THREADS: usize = 64;
/// Most requests that wait; the cache's `loads_in_flight` keeps far below.
pub const MAX_QUEUE: usize = 4096;

/// A chunk's contents, or why there are none.
pub type LoadResult<P> = Result<P, String>;
type Read<P> = dyn Fn(ChunkId) -> LoadResult<P> + Send + Sync;

/// A running loader. Dropping it forgets waiting requests, and waits for those in work.
pub struct Loader<P> {
    queue: Arc<Queue>,
    results: Receiver<(u64, ChunkId, LoadResult<P>)>,
    threads: Vec<JoinHandle<()>>,
    requested: u64,
    outstanding: usize,
}

/// Too many requests wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{MAX_QUEUE} chunks wait to be loaded already; ask again later")]
pub struct QueueFull;

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    waiting: VecDeque<(u64, ChunkId)>,
    closed: bool,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        // No code that can panic runs under the lock, so a poisoned state is whole all the same.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next request, or none when the loader is closed.
    fn next(&self) -> Option<(u64, ChunkId)> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return None;
            }
            if let Some(request) = state.waiting.pop_front() {
                return Some(request);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<P: Send + 'static> Loader<P> {
    /// Starts `threads` threads (1 to [`MAX_THREADS`]) that call `read`.
    pub fn new(threads: usize, read: impl Fn(ChunkId) -> LoadResult<P> + Send + Sync + 'static) -> Self {
        let queue = Arc::new(Queue::default());
        let read: Arc<Read<P>> = Arc::new(read);
        let (sender, results) = channel();
        let spawn = |i: usize| {
            let (queue, read, sender) = (queue.clone(), read.clone(), sender.clone());
            let thread = std::thread::Builder::new().name(format!("pb-load-{i}"));
            thread.spawn(move || work(&queue, &*read, &sender)).expect("the system has room for a few threads")
        };
        let threads = (0..threads.clamp(1, MAX_THREADS)).map(spawn).collect();
        Self { queue, results, threads, requested: 0, outstanding: 0 }
    }

    /// Asks for a chunk.
    pub fn request(&mut self, chunk: ChunkId) -> Result<(), QueueFull> {
        let mut state = self.queue.lock();
        if state.waiting.len() >= MAX_QUEUE {
            return Err(QueueFull);
        }
        state.waiting.push_back((self.requested, chunk));
        drop(state);
        self.requested += 1;
        self.outstanding += 1;
        self.queue.changed.notify_one();
        Ok(())
    }

    /// Requests that were not answered yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// A finished chunk, if there is one now.
    pub fn try_next(&mut self) -> Option<(ChunkId, LoadResult<P>)> {
        let (_, chunk, result) = self.results.try_recv().ok()?;
        self.outstanding -= 1;
        Some((chunk, result))
    }

    /// Waits for all requests and returns their results in the order of the requests: for runs that must not depend
    /// on the threads' luck.
    pub fn drain(&mut self) -> Vec<(ChunkId, LoadResult<P>)> {
        let mut done = BTreeMap::new();
        while self.outstanding > 0 {
            let (number, chunk, result) = self.results.recv().expect("threads answer every request before they end");
            self.outstanding -= 1;
            done.insert(number, (chunk, result));
        }
        done.into_values().collect()
    }
}

impl<P> Drop for Loader<P> {
    fn drop(&mut self) {
        self.queue.lock().closed = true;
        self.queue.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A thread ends by returning: panics are caught inside.
            let _ = thread.join();
        }
    }
}

fn work<P>(queue: &Queue, read: &Read<P>, results: &Sender<(u64, ChunkId, LoadResult<P>)>) {
    while let Some((number, chunk)) = queue.next() {
        let result = catch_unwind(AssertUnwindSafe(|| read(chunk)))
            .unwrap_or_else(|_| Err(format!("chunk {}: the reader failed unexpectedly; report this", chunk.0)));
        if results.send((number, chunk, result)).is_err() {
            return; // nobody listens any more
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    fn collect(loader: &mut Loader<u32>, count: usize) -> Vec<(ChunkId, LoadResult<u32>)> {
        let mut all = Vec::new();
        while all.len() < count {
            match loader.try_next() {
                Some(result) => all.push(result),
                None => std::thread::sleep(Duration::from_millis(1)),
            }
        }
        all
    }

    #[test]
    fn every_request_is_answered_once() {
        let mut loader = Loader::new(4, |c| Ok(c.0 * 2));
        (0..500).for_each(|c| loader.request(ChunkId(c)).unwrap());
        let mut all = collect(&mut loader, 500);
        all.sort_by_key(|r| r.0);
        assert!(all.iter().enumerate().all(|(i, r)| *r == (ChunkId(i as u32), Ok(2 * i as u32))));
        assert_eq!(loader.outstanding(), 0);
        assert!(loader.try_next().is_none());
    }

    #[test]
    fn drained_results_come_in_the_order_of_the_requests() {
        let slow_first = |c: ChunkId| {
            std::thread::sleep(Duration::from_millis(u64::from(20 - c.0)));
            Ok(c.0)
        };
        let mut loader = Loader::new(8, slow_first);
        let order = [3, 19, 0, 7, 12];
        order.iter().for_each(|&c| loader.request(ChunkId(c)).unwrap());
        let drained: Vec<u32> = loader.drain().into_iter().map(|r| r.0.0).collect();
        assert_eq!(drained, order);
    }

    #[test]
    fn one_thread_serves_in_the_order_of_the_requests() {
        let mut loader = Loader::new(1, |c| Ok(c.0));
        (0..50).for_each(|c| loader.request(ChunkId(c)).unwrap());
        assert!(collect(&mut loader, 50).iter().map(|r| r.0.0).eq(0..50));
    }

    #[test]
    fn errors_and_panics_of_the_reader_are_results() {
        let mut loader: Loader<u32> = Loader::new(2, |c| match c.0 {
            0 => Err("damaged".into()),
            1 => panic!("a bug"),
            n => Ok(n),
        });
        (0..3).for_each(|c| loader.request(ChunkId(c)).unwrap());
        let drained = loader.drain();
        assert_eq!(drained[0].1, Err("damaged".into()));
        assert!(drained[1].1.as_ref().unwrap_err().contains("chunk 1"));
        assert_eq!(drained[2].1, Ok(2));
    }

    #[test]
    fn dropping_a_busy_loader_ends_its_threads_and_forgets_the_rest() {
        let calls = Arc::new(AtomicUsize::new(0));
        let counter = calls.clone();
        let mut loader = Loader::new(2, move |c| {
            counter.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(5));
            Ok(c.0)
        });
        (0..1000).for_each(|c| loader.request(ChunkId(c)).unwrap());
        drop(loader);
        let after = calls.load(Ordering::SeqCst);
        assert!(after < 1000);
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(calls.load(Ordering::SeqCst), after);
    }

    #[test]
    fn a_full_queue_refuses() {
        let gate = Arc::new(Mutex::new(()));
        let held = gate.lock().unwrap();
        let inside = gate.clone();
        let mut loader = Loader::new(1, move |c| {
            drop(inside.lock());
            Ok(c.0)
        });
        let mut accepted = 0;
        while loader.request(ChunkId(0)).is_ok() {
            accepted += 1;
            assert!(accepted <= MAX_QUEUE + 1);
        }
        drop(held);
        assert_eq!(loader.drain().len(), accepted);
    }
}
