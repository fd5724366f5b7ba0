//! Speed of positional reads beside that of a map, all chunks of an archive with their checksums: in the file's order and in
//! a shuffled one, with the file in the system's cache and without (docs/decisions/010-reads.md has the figures).
//!
//! `reads make FILE MIB` writes an archive of random bytes in chunks of 4 to 124 KiB; `reads FILE THREADS` measures one.

use pb_archive::{Archive, Overwrite, Writer};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use xxhash_rust::xxh3::xxh3_64;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["make", file, mib] => make(Path::new(file), mib.parse()?),
        [file, threads] => measure(Path::new(file), threads.parse()?),
        _ => Err("usage: reads make FILE MIB | reads FILE THREADS".into()),
    }
}

fn next(random: &mut u64) -> u64 {
    *random ^= *random << 13;
    *random ^= *random >> 7;
    *random ^= *random << 17;
    *random
}

fn make(path: &Path, mib: u64) -> Result<(), Failure> {
    let mut writer = Writer::create(path, *b"TEST", Overwrite::IfArchive)?;
    let (mut random, mut id, mut left) = (1, 0, mib << 20);
    while left > 0 {
        let words = 512 + next(&mut random) as usize % 15_360;
        let bytes: Vec<u8> = (0..words).flat_map(|_| next(&mut random).to_le_bytes()).collect();
        writer.put_chunk(id, &bytes, 0)?;
        (id, left) = (id + 1, left.saturating_sub(bytes.len() as u64));
    }
    writer.finish()?;
    Ok(())
}

fn measure(path: &Path, threads: usize) -> Result<(), Failure> {
    let archive = Archive::open(path, u64::MAX)?;
    let in_order = archive.chunks_in_file_order()?;
    let mut shuffled = in_order.clone();
    let mut random = 7;
    (1..shuffled.len()).rev().for_each(|i| shuffled.swap(i, next(&mut random) as usize % (i + 1)));
    println!("{} chunks, {} MiB, {threads} threads; MB/s", in_order.len(), archive.file_bytes() >> 20);
    for (order_name, order) in [("file order", &in_order), ("shuffled", &shuffled)] {
        for state in ["cold", "warm", "warm"] {
            for way in ["map", "read"] {
                if state == "cold" {
                    forget(path)?;
                }
                let (start, cpu) = (Instant::now(), cpu_secs());
                match way {
                    "map" => through_map(path, &archive, order, threads)?,
                    _ => share(order, threads, |id| archive.chunk(id).is_ok()),
                }
                let rate = archive.file_bytes() as f64 / 1e6 / start.elapsed().as_secs_f64();
                println!("{order_name:10} {state} {way:4} {rate:8.0}  {:8.2} s of processor time", cpu_secs() - cpu);
            }
        }
    }
    Ok(())
}

/// The work of `Archive::chunk` on a map.
fn through_map(path: &Path, archive: &Archive, order: &[u32], threads: usize) -> Result<(), Failure> {
    let file = std::fs::File::open(path)?;
    #[allow(unsafe_code)]
    // SAFETY: nobody else changes the file of a measurement.
    let map = unsafe { memmap2::Mmap::map(&file)? };
    share(order, threads, |id| {
        let record = &archive.chunks()[id as usize];
        xxh3_64(&map[record.offset as usize..][..record.stored_bytes as usize]) == record.checksum
    });
    Ok(())
}

fn share(order: &[u32], threads: usize, read: impl Fn(u32) -> bool + Sync) {
    let at = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(&id) = order.get(at.fetch_add(1, Ordering::Relaxed)) {
                    assert!(read(id), "chunk {id} is damaged");
                }
            });
        }
    });
}

/// Processor time of this process, the system's on its behalf included: says something on a busy machine too.
fn cpu_secs() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or("").split_whitespace().skip(11).take(2);
    fields.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Takes the file out of the system's cache.
fn forget(path: &Path) -> Result<(), Failure> {
    #[cfg(target_os = "linux")]
    {
        let file = std::fs::File::open(path)?;
        file.sync_all()?;
        rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed)?;
    }
    Ok(())
}
