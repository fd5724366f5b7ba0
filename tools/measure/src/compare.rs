//! Two pictures of one view: FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020; by
//! NVIDIA's own code), mean absolute error, PSNR, largest change; over all pixels, and over those that the model
//! covers, because a mean over much background flatters.

use anyhow::{Context, Result, ensure};
use image::{GrayImage, RgbImage};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

use crate::reference::COVERAGE;
use crate::seams::{PLACES, Place};

#[derive(clap::Args)]
pub struct Arguments {
    /// The reference: a PNG file or a folder of frames.
    a: PathBuf,
    /// The picture or frames to judge.
    b: PathBuf,
    /// Pixels per degree of the eye: 67 is a 0.7 m wide screen of 3840 pixels at 0.7 m.
    #[arg(long, default_value_t = nv_flip::DEFAULT_PIXELS_PER_DEGREE)]
    pixels_per_degree: f32,
    /// Folder for pictures: reference, picture and their FLIP side by side, and FLIP alone.
    #[arg(long)]
    pictures: Option<PathBuf>,
}

/// Sums over some pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Part {
    pub pixels: usize,
    /// Mean FLIP, 0 to 1.
    pub flip: f64,
    /// Mean absolute difference of the channels, 0 to 255.
    pub mae: f64,
    /// Mean square difference of the channels, 0 to 65025.
    mse: f64,
}

/// A frame against its reference.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    pub name: String,
    pub all: Part,
    /// Where the model covers something of the pixel; as `all` where nothing says what it covers.
    pub covered: Part,
    /// Where it covers the whole pixel: without silhouettes.
    pub inside: Part,
    /// Inside charts, where charts meet, where clusters meet; nothing where nobody says what is where.
    pub places: [Part; 3],
    /// Largest FLIP of a pixel.
    pub flip_max: f64,
    /// Largest change of a channel.
    pub max_change: u8,
}

impl Part {
    fn of(pixels: impl Iterator<Item = usize>, a: &RgbImage, b: &RgbImage, flip: &[f32]) -> Part {
        let mut part = Part::default();
        for i in pixels {
            let at = i * 3..i * 3 + 3;
            let off = a.as_raw()[at.clone()].iter().zip(&b.as_raw()[at]).map(|(a, b)| f64::from(a.abs_diff(*b)));
            part.pixels += 1;
            part.flip += f64::from(flip[i]);
            off.for_each(|d| (part.mae, part.mse) = (part.mae + d / 3.0, part.mse + d * d / 3.0));
        }
        part.over(part.pixels)
    }

    fn over(self, n: usize) -> Part {
        let n = n.max(1) as f64;
        Part { flip: self.flip / n, mae: self.mae / n, mse: self.mse / n, ..self }
    }

    /// Mean over frames, each by its number of pixels.
    fn mean<'a>(parts: impl Iterator<Item = &'a Part>) -> Part {
        let mut sum = Part::default();
        for p in parts {
            let n = p.pixels as f64;
            sum.pixels += p.pixels;
            (sum.flip, sum.mae, sum.mse) = (sum.flip + p.flip * n, sum.mae + p.mae * n, sum.mse + p.mse * n);
        }
        sum.over(sum.pixels)
    }

    /// Peak signal over noise, decibels; at most 99.
    pub fn psnr(&self) -> f64 {
        (10.0 * (255.0f64 * 255.0 / self.mse.max(1e-12)).log10()).min(99.0)
    }

    fn json(&self) -> Value {
        json!({ "pixels": self.pixels, "flip": self.flip, "mae": self.mae, "psnr_db": self.psnr() })
    }
}

/// Compares what the command line names.
pub fn run(arguments: &Arguments) -> Result<Value> {
    let frames = compare(&arguments.a, &arguments.b, arguments.pixels_per_degree, arguments.pictures.as_deref())?;
    let rows: Vec<Value> = frames
        .iter()
        .map(|f| {
            json!({
                "frame": f.name, "all": f.all.json(), "covered": f.covered.json(), "inside": f.inside.json(),
                "flip_max": f.flip_max, "max_change": f.max_change,
            })
        })
        .collect();
    let [all, covered, inside] = means(&frames);
    Ok(json!({ "frames": rows, "all": all.json(), "covered": covered.json(), "inside": inside.json() }))
}

/// Means over frames: inside charts, at charts' and at clusters' borders.
pub fn means_of_places(frames: &[Frame]) -> [Part; 3] {
    std::array::from_fn(|k| Part::mean(frames.iter().map(|f| &f.places[k])))
}

/// Means over frames: all pixels, covered ones, those inside.
pub fn means(frames: &[Frame]) -> [Part; 3] {
    [
        Part::mean(frames.iter().map(|f| &f.all)),
        Part::mean(frames.iter().map(|f| &f.covered)),
        Part::mean(frames.iter().map(|f| &f.inside)),
    ]
}

/// Two files, or all PNG files of folder `a` with those of the same names in `b`. Pictures go to a folder, if any.
pub fn compare(a: &Path, b: &Path, pixels_per_degree: f32, pictures: Option<&Path>) -> Result<Vec<Frame>> {
    if let Some(folder) = pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    }
    let one = |a: &Path, b: &Path| {
        let name = a.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        let beside = |what: &str| {
            let path = a.parent().map(|folder| folder.join(what).join(&name)).filter(|m| m.exists());
            path.map(|m| Ok::<_, anyhow::Error>(open(&m)?.to_luma8())).transpose()
        };
        let pair =
            Pair { a: open(a)?.to_rgb8(), b: open(b)?.to_rgb8(), mask: beside(COVERAGE)?, places: beside(PLACES)? };
        let (frame, flip) = pair.measure(&name, pixels_per_degree)?;
        if let Some(folder) = pictures {
            pair.save(&folder.join(&name), &flip)?;
        }
        Ok(frame)
    };
    if a.is_file() {
        return Ok(vec![one(a, b)?]);
    }
    frames_of(a)?.par_iter().map(|name| one(&a.join(name), &b.join(name))).collect()
}

/// Names of the PNG files of a folder, in order.
pub fn frames_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let names = entries.filter_map(|e| e.ok().map(|e| PathBuf::from(e.file_name())));
    let mut names: Vec<PathBuf> = names.filter(|n| n.extension().is_some_and(|e| e == "png")).collect();
    names.sort();
    ensure!(!names.is_empty(), "{}: no PNG files", folder.display());
    Ok(names)
}

fn open(path: &Path) -> Result<image::DynamicImage> {
    image::open(path).with_context(|| format!("{}: no image", path.display()))
}

struct Pair {
    a: RgbImage,
    b: RgbImage,
    /// How much of each pixel the model covers.
    mask: Option<GrayImage>,
    /// What each pixel sees, see [`Place`].
    places: Option<GrayImage>,
}

impl Pair {
    fn measure(&self, name: &str, pixels_per_degree: f32) -> Result<(Frame, nv_flip::FlipImageFloat)> {
        let (width, height) = self.a.dimensions();
        ensure!(self.b.dimensions() == (width, height), "{name}: the two pictures differ in size");
        let of = |i: &RgbImage| nv_flip::FlipImageRgb8::with_data(width, height, i.as_raw());
        let map = nv_flip::flip(of(&self.a), of(&self.b), pixels_per_degree);
        let flip = map.to_vec();
        let at_least = |least: u8| {
            let mask = self.mask.as_ref().filter(|m| m.dimensions() == (width, height));
            let pixels = (0..flip.len()).filter(move |&i| mask.is_none_or(|m| m.as_raw()[i] >= least));
            Part::of(pixels, &self.a, &self.b, &flip)
        };
        let at = |place: Place| {
            let places = self.places.as_ref().filter(|m| m.dimensions() == (width, height));
            let pixels = (0..flip.len()).filter(|&i| places.is_some_and(|p| p.as_raw()[i] == place as u8));
            Part::of(pixels, &self.a, &self.b, &flip)
        };
        let changes = self.a.as_raw().iter().zip(self.b.as_raw()).map(|(a, b)| a.abs_diff(*b));
        let frame = Frame {
            name: name.to_owned(),
            all: at_least(0),
            covered: at_least(1),
            inside: at_least(255),
            places: [Place::Inside, Place::Charts, Place::Clusters].map(at),
            flip_max: f64::from(flip.iter().copied().fold(0.0, f32::max)),
            max_change: changes.max().unwrap_or(0),
        };
        Ok((frame, map))
    }

    fn save(&self, path: &Path, flip: &nv_flip::FlipImageFloat) -> Result<()> {
        let (width, height) = self.a.dimensions();
        let magma = flip.apply_color_lut(&nv_flip::magma_lut()).to_vec();
        let magma = RgbImage::from_raw(width, height, magma).context("FLIP answers with another size")?;
        let mut beside = RgbImage::new(width * 3, height);
        for (i, picture) in [&self.a, &self.b, &magma].into_iter().enumerate() {
            image::imageops::replace(&mut beside, picture, i64::from(width) * i as i64, 0);
        }
        let saved = beside.save(path).and_then(|()| magma.save(path.with_extension("flip.png")));
        saved.with_context(|| format!("{}: cannot be written", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn flip(a: [u8; 3], b: [u8; 3]) -> Frame {
        let of = |c| RgbImage::from_pixel(48, 32, Rgb(c));
        Pair { a: of(a), b: of(b), mask: None, places: None }.measure("x", 67.0).unwrap().0
    }

    #[test]
    fn equal_pictures_do_not_differ_and_black_and_white_differ_most() {
        let same = flip([90, 20, 200], [90, 20, 200]);
        assert_eq!((same.all.flip, same.all.mae, same.all.psnr(), same.max_change), (0.0, 0.0, 99.0, 0));
        let most = flip([0; 3], [255; 3]);
        assert!((0.95..=1.0).contains(&most.all.flip), "{most:?}");
        assert_eq!((most.all.mae, most.all.psnr(), most.max_change), (255.0, 0.0, 255));
        let little = flip([100; 3], [103; 3]);
        assert!(little.all.flip < 0.1 && little.all.mae == 3.0, "{little:?}");
    }

    #[test]
    fn background_does_not_flatter_what_is_covered() {
        let mut b = RgbImage::new(8, 8);
        b.put_pixel(3, 3, Rgb([255; 3]));
        let mut mask = GrayImage::new(8, 8);
        mask.put_pixel(3, 3, image::Luma([255]));
        mask.put_pixel(4, 3, image::Luma([64]));
        let mut places = GrayImage::from_pixel(8, 8, image::Luma([Place::Inside as u8]));
        places.put_pixel(3, 3, image::Luma([Place::Charts as u8]));
        places.put_pixel(4, 3, image::Luma([Place::Edge as u8]));
        let pair = Pair { a: RgbImage::new(8, 8), b, mask: Some(mask), places: Some(places) };
        let frame = pair.measure("x", 67.0).unwrap().0;
        assert_eq!(frame.places.map(|p| (p.pixels, p.mae)), [(62, 0.0), (1, 255.0), (0, 0.0)]);
        assert_eq!((frame.all.mae, frame.covered.mae, frame.inside.mae), (255.0 / 64.0, 127.5, 255.0));
        assert!(frame.inside.flip >= frame.covered.flip && frame.covered.flip > 3.0 * frame.all.flip, "{frame:?}");
    }
}
