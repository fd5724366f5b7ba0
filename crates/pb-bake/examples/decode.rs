//! Decodes images as a bake does and says what that holds in memory: `cargo run --release --example decode -- FILE...`

use pb_bake::images::{DecodeOptions, ImageContent, ImageSource, decode_all};
use pb_bake::memory::Memory;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

#[global_allocator]
static MEMORY: Memory = Memory;

/// A value of this process's status, bytes; 0 where the system has none.
fn status(key: &str) -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    line.and_then(|l| l.trim_start_matches(':').trim().split(' ').next()?.parse::<u64>().ok()).unwrap_or(0) * 1024
}

fn main() {
    let file = |name: String| ImageSource { content: ImageContent::File(name.clone().into()), name };
    let sources: Vec<ImageSource> = std::env::args().skip(1).map(file).collect();
    let (ended, most) = (AtomicBool::new(false), AtomicU64::new(0));
    let options = DecodeOptions { temp_dir: ".".into(), ..DecodeOptions::default() };
    let start = Instant::now();
    let decoded = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) {
                most.fetch_max(status("RssAnon"), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let decoded = decode_all(&sources, &options, &|_| {});
        ended.store(true, Ordering::Relaxed);
        decoded
    });
    match decoded {
        Ok(all) => {
            all.images.iter().for_each(|image| println!("{image:?}"));
            all.faults.iter().for_each(|fault| println!("{}", fault.message));
            let texels = all.texels().max(1) as f64;
            let share = |bytes: u64| bytes as f64 / texels;
            let (peak, anonymous, after) = (status("VmHWM"), most.into_inner(), status("RssAnon"));
            println!(
                "{texels} texels in {:.2} s; bytes per texel: {:.3} anonymous at most, {:.3} after, {:.3} with mapped files",
                start.elapsed().as_secs_f64(),
                share(anonymous),
                share(after),
                share(peak)
            );
        }
        Err(error) => println!("{error}"),
    }
}
