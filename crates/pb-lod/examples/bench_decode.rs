//! Triangles per second from a chunk's bytes in memory to the arrays that the adapter gets, on one core.
//!
//! Arguments: an archive, and how many seconds to measure (default 3).

use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::codec::{Chunk, Decoder};
use pb_lod::progressive_buffers::model::Model;
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

/// Chunks of a level.
struct Level {
    chunks: Vec<(ChunkId, Vec<u8>)>,
    triangles: u64,
    stored: u64,
    decoded: u64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("name an archive")?;
    let seconds: f64 = arguments.next().map_or(Ok(3.0), |s| s.parse())?;
    let model = Model::open(Path::new(&path))?;
    let levels = (0..model.levels()).map(|l| Level::read(&model, l)).collect::<Result<Vec<_>, _>>()?;
    println!("| level | triangles | M triangles/s | MB/s stored | MB/s decoded | bytes per triangle |");
    println!("|---|---|---|---|---|---|");
    for (name, list) in (0..levels.len()).map(|l| (l.to_string(), &levels[l..=l])).chain([("all".into(), &levels[..])])
    {
        let pass = time(&model, list, seconds)?;
        let sum = |of: fn(&Level) -> u64| list.iter().map(of).sum::<u64>() as f64;
        let (triangles, stored, decoded) = (sum(|l| l.triangles), sum(|l| l.stored), sum(|l| l.decoded));
        println!(
            "| {name} | {triangles} | {:.1} | {:.0} | {:.0} | {:.2} |",
            triangles / pass / 1e6,
            stored / pass / 1e6,
            decoded / pass / 1e6,
            stored / triangles.max(1.0)
        );
    }
    Ok(())
}

impl Level {
    fn read(model: &Model, level: u32) -> Result<Level, Box<dyn std::error::Error>> {
        let mut read = Level { chunks: Vec::new(), triangles: 0, stored: 0, decoded: 0 };
        for cluster in 0..model.record().clusters {
            let chunk = model.chunk_id(cluster, level);
            let (offset, bytes) = model.extent(chunk);
            read.chunks.push((chunk, model.archive().read(offset, bytes as usize)?.into_owned()));
            read.triangles += u64::from(model.level(cluster, level).triangles);
            read.stored += u64::from(bytes);
            read.decoded += u64::from(model.decoded_bytes(chunk));
        }
        Ok(read)
    }
}

/// Seconds that all chunks take, each at its fastest over several passes; checksums and checks of every value included.
fn time(model: &Model, levels: &[Level], seconds: f64) -> Result<f64, Box<dyn std::error::Error>> {
    let (mut decoder, mut out) = (Decoder::default(), Chunk::default());
    let chunks: Vec<&(ChunkId, Vec<u8>)> = levels.iter().flat_map(|l| &l.chunks).collect();
    let mut best = vec![f64::INFINITY; chunks.len()];
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        for (best, (chunk, bytes)) in best.iter_mut().zip(&chunks) {
            let begin = Instant::now();
            model.decode_into(*chunk, bytes, &mut decoder, &mut out)?;
            black_box(&out);
            *best = best.min(begin.elapsed().as_secs_f64());
        }
    }
    Ok(best.iter().sum())
}
