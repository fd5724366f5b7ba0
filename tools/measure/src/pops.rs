//! Changes between neighbouring frames of a slow flight, beside those of a reference flight: where something pops, one
//! pixel changes much at once, and the reference does not.

use anyhow::{Context, Result, ensure};
use image::{GrayImage, RgbImage};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

use crate::compare::frames_of;

/// Steps that are listed one by one.
const WORST: usize = 5;

#[derive(clap::Args)]
pub struct Arguments {
    /// Frames to judge: a folder of PNG files.
    a: PathBuf,
    /// The same flight drawn by the reference.
    b: PathBuf,
    /// Print a row of the table in docs/performance.md, under this name.
    #[arg(long)]
    row: Option<String>,
}

/// Heading of the rows.
pub const HEADING: &str = "\
| flight | frames | largest change | of the reference | ratio | mean change | of the reference | 99.99 % inside | largest inside |
|---|---|---|---|---|---|---|---|---|";

/// Changes of pixels by how large they are.
struct Changes([u64; 256]);

impl Changes {
    fn none() -> Changes {
        Changes([0; 256])
    }

    fn add(&mut self, change: u8) {
        self.0[change as usize] += 1;
    }

    /// The smallest change that `share` of the pixels do not exceed.
    fn at(&self, share: f64) -> usize {
        let wanted = (self.0.iter().sum::<u64>() as f64 * share).ceil() as u64;
        let mut sum = 0;
        let enough = |count: &u64| {
            sum += count;
            sum >= wanted.max(1)
        };
        self.0.iter().position(enough).unwrap_or(255)
    }

    fn mean(&self) -> f64 {
        let sum: u64 = self.0.iter().enumerate().map(|(change, count)| change as u64 * count).sum();
        sum as f64 / self.0.iter().sum::<u64>().max(1) as f64
    }

    fn json(&self) -> Value {
        json!({ "largest": self.at(1.0), "p9999": self.at(0.9999), "p999": self.at(0.999), "mean": self.mean() })
    }
}

/// Largest change of a channel, by pixel.
fn step(from: &RgbImage, to: &RgbImage) -> Vec<u8> {
    let channels = from.as_raw().iter().zip(to.as_raw()).map(|(a, b)| a.abs_diff(*b)).collect::<Vec<u8>>();
    channels.chunks_exact(3).map(|p| p[0].max(p[1]).max(p[2])).collect()
}

/// The largest change within one pixel of each: an edge that is drawn a little aside is no pop.
fn around(changes: &[u8], width: usize) -> Vec<u8> {
    let height = changes.len() / width;
    let largest = |x: usize, y: usize| {
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        let columns = |row: usize| &changes[row * width + x.saturating_sub(1)..=row * width + (x + 1).min(width - 1)];
        rows.flat_map(columns).copied().max().unwrap_or(0)
    };
    (0..changes.len()).map(|i| largest(i % width, i / width)).collect()
}

/// Pixels that the model covers fully, like all within two pixels of them: no silhouette is near.
fn inside(coverage: &GrayImage) -> Vec<bool> {
    let (width, height) = coverage.dimensions();
    let full = |x: u32, y: u32| {
        let rows = y.saturating_sub(2)..=(y + 2).min(height - 1);
        let mut around = rows.flat_map(|r| (x.saturating_sub(2)..=(x + 2).min(width - 1)).map(move |c| (c, r)));
        around.all(|(c, r)| coverage.get_pixel(c, r).0[0] == 255)
    };
    (0..width * height).map(|i| full(i % width, i / width)).collect()
}

/// Prints what [`judge`] finds as JSON, or as a row.
pub fn run(arguments: &Arguments) -> Result<String> {
    let found = judge(arguments)?;
    let Some(name) = &arguments.row else { return Ok(format!("{found:#}")) };
    let (a, b, inside) = (&found["a"], &found["b"], &found["excess_inside"]);
    let number = |v: &Value| v.as_f64().unwrap_or(0.0);
    Ok(format!(
        "| {name} | {} | {} | {} | {:.2} | {:.3} | {:.3} | {} | {} |",
        found["frames"],
        a["largest"],
        b["largest"],
        number(&found["ratio_of_largest"]),
        number(&a["mean"]),
        number(&b["mean"]),
        inside["p9999"],
        inside["largest"]
    ))
}

/// Figures of both flights; `excess` is by how much a pixel of `a` changes more than any of `b` within a pixel of it,
/// `excess_inside` the same where no silhouette is near (where the reference wrote its coverage).
pub fn judge(arguments: &Arguments) -> Result<Value> {
    let names = frames_of(&arguments.a)?;
    ensure!(names.len() >= 2, "{}: two frames are needed at least", arguments.a.display());
    let mut last = [open(&arguments.a, &names[0])?, open(&arguments.b, &names[0])?];
    let mut all = [Changes::none(), Changes::none(), Changes::none()];
    let mut far_inside = Changes::none();
    let mut was_inside = Vec::new();
    let mut steps: Vec<(usize, usize)> = Vec::new();
    for (i, name) in names.iter().enumerate().skip(1) {
        let next = [open(&arguments.a, name)?, open(&arguments.b, name)?];
        ensure!(
            next.iter().chain(&last).all(|f| f.dimensions() == next[0].dimensions()),
            "{}: the frames differ in size",
            name.display()
        );
        let width = next[0].width() as usize;
        let (a, b) = (step(&last[0], &next[0]), step(&last[1], &next[1]));
        let excess: Vec<u8> = a.iter().zip(around(&b, width)).map(|(a, b)| a.saturating_sub(b)).collect();
        for (sums, changes) in all.iter_mut().zip([&a, &b, &excess]) {
            changes.iter().for_each(|c| sums.add(*c));
        }
        let coverage = arguments.b.join("coverage").join(name);
        if coverage.is_file() {
            let now = inside(&image::open(&coverage).with_context(|| coverage.display().to_string())?.to_luma8());
            let both = now.iter().zip(&was_inside).zip(&excess);
            both.filter(|((now, before), _)| **now && **before).for_each(|(_, e)| far_inside.add(*e));
            was_inside = now;
        }
        steps.push((excess.iter().copied().max().unwrap_or(0).into(), i));
        last = next;
    }
    steps.sort_by(|a, b| b.cmp(a));
    let ratio = all[0].at(1.0) as f64 / all[1].at(1.0).max(1) as f64;
    let worst: Vec<Value> =
        steps.iter().take(WORST).map(|(e, i)| json!({ "frame": names[*i].to_string_lossy(), "excess": e })).collect();
    Ok(json!({
        "frames": names.len(), "a": all[0].json(), "b": all[1].json(), "excess": all[2].json(),
        "excess_inside": far_inside.json(), "ratio_of_largest": ratio, "worst": worst,
    }))
}

fn open(folder: &Path, name: &Path) -> Result<RgbImage> {
    let path = folder.join(name);
    Ok(image::open(&path).with_context(|| format!("{}: no image", path.display()))?.to_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_jump_that_the_reference_does_not_make_is_found_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|n| folder.path().join(n));
        [&a, &b].iter().for_each(|f| std::fs::create_dir(f).unwrap());
        for i in 0..4u8 {
            let mut smooth = RgbImage::from_pixel(6, 6, Rgb([100 + 2 * i; 3]));
            smooth.save(b.join(format!("frame_0000{i}.png"))).unwrap();
            if i >= 2 {
                smooth.put_pixel(3, 3, Rgb([160, 100, 100]));
            }
            smooth.save(a.join(format!("frame_0000{i}.png"))).unwrap();
        }
        let found = judge(&Arguments { a: a.clone(), b: b.clone(), row: None }).unwrap();
        assert_eq!((&found["a"]["largest"], &found["b"]["largest"]), (&json!(58), &json!(2)));
        assert_eq!(found["worst"][0], json!({ "frame": "frame_00002.png", "excess": 56 }));
        assert_eq!(found["excess"]["p999"], json!(56));
        // Two pixels further in from the rim of what is covered, nothing has changed.
        std::fs::create_dir(b.join("coverage")).unwrap();
        let mut covered = GrayImage::from_pixel(6, 6, image::Luma([255]));
        (0..6).for_each(|y| covered.put_pixel(5, y, image::Luma([0])));
        for i in 0..4 {
            covered.save(b.join(format!("coverage/frame_0000{i}.png"))).unwrap();
        }
        let found = judge(&Arguments { a: a.clone(), b: b.clone(), row: None }).unwrap();
        assert_eq!((&found["excess"]["largest"], &found["excess_inside"]["largest"]), (&json!(56), &json!(0)));
        let row = run(&Arguments { a, b: b.clone(), row: Some("box".into()) }).unwrap();
        assert!(row.starts_with("| box | 4 | 58 | 2 | 29.00 |"), "{row}");
        let same = judge(&Arguments { a: b.clone(), b, row: None }).unwrap();
        assert_eq!((&same["excess"]["largest"], &same["ratio_of_largest"]), (&json!(0), &json!(1.0)));
    }

    #[test]
    fn an_edge_one_pixel_aside_is_no_pop() {
        assert_eq!(around(&[0, 9, 0, 0, 0, 0, 0, 0], 4), [9, 9, 9, 0, 9, 9, 9, 0]);
    }
}
