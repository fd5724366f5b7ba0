//! From the command line to what is baked: a clean mesh, its materials, its decoded images.

use crate::cli::BakeArgs;
use crate::failure::{Failure, blame_input, blame_machine};
use crate::progress::Progress;
use pb_bake::images::{ImageError, ImageSource, decode_all};
use pb_bake::import::{self, InputReport};
use pb_mesh::material::Material;
use pb_mesh::mesh::Mesh;
use pb_mesh::repair::{MeshError, RepairReport, repair};
use pb_mesh::texture::image::Image;
use serde::Serialize;

/// All that a bake begins with.
pub struct Scene {
    /// With texturing where there are images.
    pub mesh: Mesh,
    /// What the mesh's triangles count; none without images.
    pub materials: Vec<Material>,
    /// What the materials' textures count; placeholders among them.
    pub images: Vec<Image>,
    /// In the order of the command line.
    pub inputs: Vec<InputReport>,
    /// What was found and done to the mesh.
    pub repairs: RepairReport,
    /// None without images.
    pub textures: Option<TextureSummary>,
}

/// The source images in a report.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TextureSummary {
    images: usize,
    texels: u64,
    placeholders: usize,
}

impl TextureSummary {
    /// For people.
    pub fn text(&self) -> String {
        let TextureSummary { images, texels, placeholders } = self;
        format!("textures: {images} images, {texels} texels, {placeholders} placeholders")
    }
}

/// Reads, decodes and repairs. Says what was odd on the way.
pub fn load(args: &BakeArgs, progress: &Progress) -> Result<Scene, Failure> {
    if let Some(texture) = args.texture.as_ref().filter(|path| !path.is_file()) {
        return Err(blame_machine(format!("--texture {}: there is no such file; check the name", texture.display())));
    }
    progress.stage("read");
    let read = |p: import::ImportProgress| progress.share(p.inputs_done as f32 / p.input_count as f32);
    let import = import::load(&args.inputs, &args.import_options(), &read).map_err(blame_input)?;
    for (input, warning) in import.inputs.iter().flat_map(|i| i.warnings.iter().map(move |w| (i, w))) {
        progress.note(&format!("warning: {}: {warning}", input.path.display()));
    }
    let (images, textures) = match import.images.is_empty() {
        true => (Vec::new(), None),
        false => decode(&import.images, args, progress).map(|(images, summary)| (images, Some(summary)))?,
    };
    progress.stage("repair");
    let (mesh, repairs) = repair(import.soup, &args.repair_options()).map_err(|e| match e {
        MeshError::BadTolerance { .. } => blame_machine(e),
        e => blame_input(e),
    })?;
    Ok(Scene { mesh, materials: import.materials, images, inputs: import.inputs, repairs, textures })
}

fn decode(
    sources: &[ImageSource],
    args: &BakeArgs,
    progress: &Progress,
) -> Result<(Vec<Image>, TextureSummary), Failure> {
    progress.stage("textures");
    let decoded = decode_all(sources, &args.decode_options(), &|share| progress.share(share));
    let decoded = decoded.map_err(|e| match e {
        ImageError::NoRoom { .. } => blame_machine(e),
        e => blame_input(e),
    })?;
    for fault in &decoded.faults {
        progress.note(&format!("warning: {}; a magenta checker stands in its place", fault.message));
    }
    let (images, placeholders) = (decoded.images.len(), decoded.faults.len());
    if let (true, Some(first)) = (args.strict, decoded.faults.first()) {
        let text = format!("{} (--strict: {placeholders} of {images} images cannot be used)", first.message);
        return Err(blame_input(text));
    }
    let summary = TextureSummary { images, texels: decoded.texels(), placeholders };
    Ok((decoded.images, summary))
}
