//! Jobs that hold much memory while they run, so many at a time that together they stay below a bound.
//!
//! Jobs of one size run in as many lanes as fit; the next smaller size follows when they are done. Nobody waits for
//! memory in the middle of a job, so threads that help one another out cannot block each other.

use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Runs `job` for every index of `bytes`, what each holds, largest first; the answers are in the order of the indices.
/// Those at work hold at most `limit` bytes together, or one runs alone. After an error no further job begins.
pub(super) fn run_bounded<T: Send, E: Send>(
    bytes: &[u64],
    limit: u64,
    job: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let mut order: Vec<usize> = (0..bytes.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse(bytes[i]));
    let failed = AtomicBool::new(false);
    let done: Mutex<Vec<(usize, Result<T, E>)>> = Mutex::new(Vec::with_capacity(bytes.len()));
    for group in order.chunk_by(|&a, &b| bytes[a] == bytes[b]) {
        let fit = usize::try_from(limit / bytes[group[0]].max(1)).unwrap_or(usize::MAX);
        let lanes = fit.min(rayon::current_num_threads()).min(group.len()).max(1);
        let next = AtomicUsize::new(0);
        let lane = |_| {
            while !failed.load(Ordering::Relaxed) {
                let Some(&i) = group.get(next.fetch_add(1, Ordering::Relaxed)) else { return };
                let result = job(i);
                failed.fetch_or(result.is_err(), Ordering::Relaxed);
                done.lock().expect("no thread panics while it adds one").push((i, result));
            }
        };
        (0..lanes).into_par_iter().with_max_len(1).for_each(lane);
    }
    let mut done = done.into_inner().expect("no thread panics while it adds one");
    done.sort_unstable_by_key(|d| d.0);
    done.into_iter().map(|d| d.1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    fn pool(threads: usize) -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
    }

    #[test]
    fn what_is_held_stays_below_the_limit_and_answers_are_in_order() {
        let bytes: Vec<u64> = (0..60).map(|i| [1, 7, 30, 200][i % 4]).collect();
        let (held, most) = (AtomicU64::new(0), AtomicU64::new(0));
        let job = |i: usize| {
            let now = held.fetch_add(bytes[i], Ordering::SeqCst) + bytes[i];
            most.fetch_max(if bytes[i] > 100 { now - bytes[i] } else { now }, Ordering::SeqCst);
            // others get their chance to begin, also nested in this one
            (0..4).into_par_iter().for_each(|_| std::thread::sleep(std::time::Duration::from_micros(200)));
            held.fetch_sub(bytes[i], Ordering::SeqCst);
            Ok::<_, ()>(i)
        };
        let answers = pool(8).install(|| run_bounded(&bytes, 100, job));
        assert_eq!(answers, Ok((0..60).collect()));
        let most = most.into_inner();
        assert!((30..=100).contains(&most), "{most}");
    }

    #[test]
    fn an_error_ends_the_run() {
        let begun = AtomicUsize::new(0);
        let job = |i: usize| {
            begun.fetch_add(1, Ordering::SeqCst);
            if i == 3 { Err(i) } else { Ok(i) }
        };
        assert_eq!(pool(1).install(|| run_bounded(&[1; 100], 1, job)), Err(3));
        assert_eq!(begun.into_inner(), 4);
    }
}
