//! `pb-measure reference`: frames of a source mesh with its own images at full resolution, by a plain renderer on the
//! CPU that shares nothing with the product but the definition of a flypath.

pub mod camera;
mod draw;
mod image;
mod load_gltf;
mod load_obj;
pub mod scene;

use anyhow::{Context, Result};
use serde_json::json;
use std::path::{Path, PathBuf};

use camera::Flypath;
pub use draw::{BACKGROUND, Filter, NONE, Options, draw, visible};
use scene::Scene;

/// Where frames say how much of each pixel the model covers: a folder beside them.
pub const COVERAGE: &str = "coverage";

#[derive(clap::Args)]
pub struct Arguments {
    /// The source: .obj, .gltf, .glb or .ply.
    model: PathBuf,
    /// Cameras, as for pb-view.
    #[arg(long)]
    flypath: PathBuf,
    /// Folder for frame_00000.png and so on; its folder coverage/ says what the model covers.
    #[arg(long)]
    out: PathBuf,
    /// Pixels.
    #[arg(long, default_value = "640x360", value_parser = parse_size)]
    size: [usize; 2],
    #[arg(long, value_enum, default_value_t = Filter::Exact)]
    filter: Filter,
    /// Samples along the side of a pixel; without it as many as the texture asks for, 4 to 16.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=64))]
    grid: Option<u16>,
    /// An image for all materials that have none.
    #[arg(long)]
    texture: Option<PathBuf>,
}

/// `640x360`.
pub fn parse_size(text: &str) -> Result<[usize; 2], String> {
    let number = |t: &str| t.parse::<usize>().ok().filter(|n| (1..=16384).contains(n));
    let size = text.split_once('x').and_then(|(w, h)| Some([number(w)?, number(h)?]));
    size.ok_or_else(|| format!("'{text}' is no size; write for example 640x360"))
}

/// Draws what the command line asks for; figures about the source.
pub fn run(arguments: &Arguments) -> Result<serde_json::Value> {
    let mut scene = Scene::read(&arguments.model)?;
    if let Some(texture) = &arguments.texture {
        cover_with(&mut scene, texture)?;
    }
    let flight = Flypath::open(&arguments.flypath)?;
    let options = Options { size: arguments.size, filter: arguments.filter, grid: arguments.grid.map(usize::from) };
    frames(&mut scene, &flight, &options, &arguments.out)?;
    Ok(json!({
        "frames": flight.frames(), "triangles": scene.triangles.len(),
        "images": scene.images.len(), "texels": scene.texels(),
    }))
}

/// Gives all materials without an image this one.
pub fn cover_with(scene: &mut Scene, texture: &Path) -> Result<()> {
    scene.cover(image::Image::open(texture)?);
    Ok(())
}

/// All frames of a flight into a folder.
pub fn frames(scene: &mut Scene, flight: &Flypath, options: &Options, out: &Path) -> Result<()> {
    if options.filter == Filter::Trilinear {
        scene.images.iter_mut().for_each(image::Image::make_mips);
    }
    let coverage = out.join(COVERAGE);
    std::fs::create_dir_all(&coverage).with_context(|| format!("{}: cannot be made", coverage.display()))?;
    let [width, height] = options.size.map(|s| s as u32);
    for frame in 0..flight.frames() {
        let picture = draw(scene, &flight.camera(frame, options.size), options);
        let name = format!("frame_{frame:05}.png");
        let rgb = picture.pixels.into_flattened();
        let save = |path: &Path, bytes: &[u8], color| {
            ::image::save_buffer(path, bytes, width, height, color).with_context(|| path.display().to_string())
        };
        save(&out.join(&name), &rgb, ::image::ExtendedColorType::Rgb8)?;
        save(&coverage.join(&name), &picture.coverage, ::image::ExtendedColorType::L8)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
