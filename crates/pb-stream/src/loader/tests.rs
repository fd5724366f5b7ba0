//! Every request is answered once, in order, whatever the disk and the threads do.

use super::*;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::time::Duration;

/// Chunk `c` of 4 bytes, its number, at `c * spacing`; decoded by a function.
struct Numbers<F> {
    spacing: u64,
    decode: F,
    /// Reads that hold this byte fail.
    hole: Option<u64>,
    reads: Arc<Mutex<Vec<Extent>>>,
}

const FAR: u64 = 10 << 20;

impl<F: Fn(ChunkId) -> LoadResult<u32> + Send + Sync + 'static> Source for Numbers<F> {
    type Payload = u32;

    fn extent(&self, chunk: ChunkId) -> Extent {
        Extent { offset: u64::from(chunk.0) * self.spacing, bytes: 4 }
    }

    fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
        self.reads.lock().unwrap().push(extent);
        if self.hole.is_some_and(|h| extent.offset <= h && h < extent.end()) {
            return Err(format!("no byte {:?}", self.hole));
        }
        let mut bytes = vec![0; extent.bytes as usize];
        for c in extent.offset.div_ceil(self.spacing)..=extent.end() / self.spacing {
            let at = (c * self.spacing - extent.offset) as usize;
            if at + 4 <= bytes.len() {
                bytes[at..at + 4].copy_from_slice(&(c as u32).to_le_bytes());
            }
        }
        Ok(bytes)
    }

    fn decode(&self, chunk: ChunkId, bytes: &[u8]) -> LoadResult<u32> {
        assert_eq!(bytes, chunk.0.to_le_bytes(), "the bytes of another chunk");
        (self.decode)(chunk)
    }

    fn will_need(&self, _: Extent) {}
}

type Decode = Box<dyn Fn(ChunkId) -> LoadResult<u32> + Send + Sync>;

fn numbers(decode: impl Fn(ChunkId) -> LoadResult<u32> + Send + Sync + 'static) -> Numbers<Decode> {
    Numbers { spacing: FAR, decode: Box::new(decode), hole: None, reads: Arc::default() }
}

fn loader(threads: usize, source: Numbers<Decode>) -> Loader<Numbers<Decode>> {
    Loader::new(Threads { read: threads, decode: threads }, source)
}

fn collect(loader: &mut Loader<Numbers<Decode>>, count: usize) -> Vec<(ChunkId, LoadResult<u32>)> {
    (0..count).map(|_| loader.wait_next().expect("asked for")).collect()
}

#[test]
fn every_request_is_answered_once() {
    let mut loader = loader(4, numbers(|c| Ok(c.0 * 2)));
    (0..500).for_each(|c| loader.request(ChunkId(c)).unwrap());
    let mut all = collect(&mut loader, 500);
    all.sort_by_key(|r| r.0);
    assert!(all.iter().enumerate().all(|(i, r)| *r == (ChunkId(i as u32), Ok(2 * i as u32))));
    assert_eq!(loader.outstanding(), 0);
    assert!(loader.try_next().is_none() && loader.wait_next().is_none());
}

#[test]
fn drained_results_come_in_the_order_of_the_requests() {
    let slow_first = |c: ChunkId| {
        std::thread::sleep(Duration::from_millis(u64::from(20 - c.0)));
        Ok(c.0)
    };
    for spacing in [4, FAR] {
        let mut loader = loader(8, Numbers { spacing, ..numbers(slow_first) });
        let order = [3, 19, 0, 7, 12];
        order.iter().for_each(|&c| loader.request(ChunkId(c)).unwrap());
        let drained: Vec<u32> = loader.drain().into_iter().map(|r| r.0.0).collect();
        assert_eq!(drained, order);
    }
}

#[test]
fn one_thread_serves_in_the_order_of_the_requests() {
    let mut loader = loader(1, numbers(|c| Ok(c.0)));
    (0..50).for_each(|c| loader.request(ChunkId(c)).unwrap());
    assert!(collect(&mut loader, 50).iter().map(|r| r.0.0).eq(0..50));
}

/// A source whose first read waits until the test lets it go, so that the other requests meet in the queue.
fn gated(source: Numbers<Decode>) -> (Loader<Gate>, Sender<()>) {
    let (open, gate) = channel();
    (Loader::new(Threads { read: 1, decode: 1 }, Gate { source, gate: Mutex::new(Some(gate)) }), open)
}

struct Gate {
    source: Numbers<Decode>,
    gate: Mutex<Option<Receiver<()>>>,
}

impl Source for Gate {
    type Payload = u32;

    fn extent(&self, chunk: ChunkId) -> Extent {
        self.source.extent(chunk)
    }

    fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
        if let Some(gate) = self.gate.lock().unwrap().take() {
            gate.recv().unwrap();
        }
        self.source.read(extent)
    }

    fn decode(&self, chunk: ChunkId, bytes: &[u8]) -> LoadResult<u32> {
        self.source.decode(chunk, bytes)
    }

    fn will_need(&self, extent: Extent) {
        self.source.will_need(extent);
    }
}

#[test]
fn neighbours_are_read_together() {
    let source = Numbers { spacing: 100, ..numbers(|c| Ok(c.0)) };
    let reads = source.reads.clone();
    let (mut loader, open) = gated(source);
    loader.request(ChunkId(1_000_000)).unwrap();
    [7, 5, 6, 900_000, 4].iter().for_each(|&c| loader.request(ChunkId(c)).unwrap());
    open.send(()).unwrap();
    let drained: Vec<_> = loader.drain().into_iter().map(|(c, r)| (c.0, r)).collect();
    assert_eq!(drained, [1_000_000, 7, 5, 6, 900_000, 4].map(|c| (c, Ok(c))));
    let reads = reads.lock().unwrap();
    // Whether the first was taken before the others came is luck; they are not its neighbours.
    assert_eq!(reads.len(), 3, "{reads:?}");
    assert!(reads.contains(&Extent { offset: 400, bytes: 304 }), "{reads:?}");
    assert_eq!(loader.stats(), LoadStats { reads: 3, bytes_read: 312, retries: 0 });
}

#[test]
fn a_hole_in_a_shared_read_fails_only_its_own_chunk() {
    let source = Numbers { spacing: 100, hole: Some(502), ..numbers(|c| Ok(c.0)) };
    let reads = source.reads.clone();
    let (mut loader, open) = gated(source);
    [1_000_000, 4, 5, 6].iter().for_each(|&c| loader.request(ChunkId(c)).unwrap());
    open.send(()).unwrap();
    let drained = loader.drain();
    assert_eq!([0, 1, 3].map(|i| drained[i].1.clone()), [Ok(1_000_000), Ok(4), Ok(6)]);
    assert!(drained[2].1.as_ref().unwrap_err().contains("no byte"));
    let tried = reads.lock().unwrap().iter().filter(|e| e.offset == 500).count();
    assert_eq!(tried, 1 + RETRIES as usize, "once by itself, then again");
}

#[test]
fn what_fails_is_tried_again_and_may_succeed() {
    let calls = Arc::new(AtomicU32::new(0));
    let counter = calls.clone();
    let mut loader = loader(
        2,
        numbers(move |c| match c.0 {
            7 if counter.fetch_add(1, Ordering::SeqCst) < RETRIES => Err("not yet".into()),
            n => Ok(n),
        }),
    );
    (0..10).for_each(|c| loader.request(ChunkId(c)).unwrap());
    assert!(loader.drain().into_iter().map(|r| r.1).eq((0..10).map(Ok)));
    assert_eq!((calls.load(Ordering::SeqCst), loader.stats().retries), (RETRIES + 1, u64::from(RETRIES)));
}

#[test]
fn errors_and_panics_of_the_source_are_results() {
    let mut loader = loader(
        2,
        numbers(|c| match c.0 {
            0 => Err("damaged".into()),
            1 => panic!("a bug"),
            n => Ok(n),
        }),
    );
    (0..3).for_each(|c| loader.request(ChunkId(c)).unwrap());
    let drained = loader.drain();
    assert_eq!(drained[0].1, Err("damaged".into()));
    assert!(drained[1].1.as_ref().unwrap_err().contains("report this"));
    assert_eq!(drained[2].1, Ok(2));
}

#[test]
fn what_waits_to_be_decoded_is_bounded_and_all_of_it_is_given_back() {
    struct Big;
    impl Source for Big {
        type Payload = usize;
        fn extent(&self, chunk: ChunkId) -> Extent {
            Extent { offset: u64::from(chunk.0) * FAR, bytes: 3 << 20 }
        }
        fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
            Ok(vec![0; extent.bytes as usize])
        }
        fn decode(&self, _: ChunkId, bytes: &[u8]) -> LoadResult<usize> {
            std::thread::sleep(Duration::from_millis(1));
            Ok(bytes.len())
        }
        fn will_need(&self, _: Extent) {}
    }
    let mut loader = Loader::new(Threads { read: 3, decode: 1 }, Big);
    (0..40).for_each(|c| loader.request(ChunkId(c)).unwrap());
    for _ in 0..40 {
        assert!(loader.wait_next().is_some_and(|(_, bytes)| bytes == Ok(3 << 20)));
        assert!(loader.queue.lock().held_bytes < MAX_HELD_BYTES + (3 << 20));
    }
    assert_eq!(loader.queue.lock().held_bytes, 0);
}

#[test]
fn dropping_a_busy_loader_ends_its_threads_and_forgets_the_rest() {
    let calls = Arc::new(AtomicUsize::new(0));
    let counter = calls.clone();
    let source = numbers(move |c| {
        counter.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(5));
        Ok(c.0)
    });
    let mut loader = loader(2, source);
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
    let mut loader = loader(
        1,
        numbers(move |c| {
            drop(inside.lock());
            Ok(c.0)
        }),
    );
    let mut accepted = 0;
    while loader.request(ChunkId(0)).is_ok() {
        accepted += 1;
        assert!(accepted <= MAX_QUEUE * 2, "no end");
    }
    drop(held);
    assert_eq!(loader.drain().len(), accepted);
}

#[test]
fn each_thread_that_decodes_says_so_before_its_first_chunk() {
    struct Counted(Arc<AtomicUsize>);

    impl Source for Counted {
        type Payload = usize;

        fn extent(&self, chunk: ChunkId) -> Extent {
            Extent { offset: u64::from(chunk.0), bytes: 1 }
        }

        fn read(&self, extent: Extent) -> Result<Vec<u8>, String> {
            Ok(vec![0; extent.bytes as usize])
        }

        fn decode(&self, _: ChunkId, _: &[u8]) -> LoadResult<usize> {
            Ok(self.0.load(Ordering::SeqCst))
        }

        fn begin_decoding(&self) {
            self.0.fetch_add(1, Ordering::SeqCst);
        }

        fn will_need(&self, _: Extent) {}
    }

    let begun = Arc::new(AtomicUsize::new(0));
    let mut loader = Loader::new(Threads { read: 1, decode: 3 }, Counted(begun.clone()));
    (0..20).for_each(|c| loader.request(ChunkId(c)).unwrap());
    for (_, result) in loader.drain() {
        assert!(result.unwrap() > 0, "decoded before the thread said so");
    }
    drop(loader);
    assert_eq!(begun.load(Ordering::SeqCst), 3);
}
