//! Changes between neighbouring frames of a flight: where something pops, one pixel changes much at once.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// The largest change of any channel of any pixel from each frame to the next, in 0..=255.
pub fn changes(folder: &Path) -> Result<Vec<u8>> {
    let mut frames: Vec<PathBuf> = std::fs::read_dir(folder)
        .with_context(|| format!("{}: cannot be read", folder.display()))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "png"))
        .collect();
    frames.sort();
    ensure!(frames.len() >= 2, "{}: two PNG frames are needed at least", folder.display());
    let load = |path: &PathBuf| -> Result<image::RgbImage> {
        Ok(image::open(path).with_context(|| format!("{}: no image", path.display()))?.to_rgb8())
    };
    let mut last = load(&frames[0])?;
    let mut out = Vec::new();
    for path in &frames[1..] {
        let next = load(path)?;
        ensure!(next.dimensions() == last.dimensions(), "{}: differs in size from the frame before", path.display());
        out.push(last.iter().zip(next.iter()).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0));
        last = next;
    }
    Ok(out)
}
