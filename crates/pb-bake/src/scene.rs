//! From the command line to what is baked: a clean mesh, its materials, its decoded images.

use crate::cli::BakeArgs;
use crate::failure::{Failure, blame_input, blame_machine};
use crate::job::Job;
use crate::progress::Progress;
use pb_bake::images::{ImageError, ImageSource, decode_all};
use pb_bake::import::{self, InputReport};
use pb_bake::xatlas::HelperSummary;
use pb_lod::progressive_buffers::bake::BakeReport;
use pb_lod::progressive_buffers::write::BakedModel;
use pb_mesh::material::Material;
use pb_mesh::mesh::{Mesh, Texturing};
use pb_mesh::repair::{MeshError, RepairReport, repair};
use pb_mesh::texture::image::Image;
use serde::Serialize;
use std::fmt::Write as _;

/// All that a bake begins with.
pub struct Scene {
    /// With texturing where there are images or a normal map is wanted.
    pub mesh: Mesh,
    /// What the mesh's triangles count; none without images.
    pub materials: Vec<Material>,
    /// What the materials' textures count; placeholders among them.
    pub images: Vec<Image>,
    /// In the order of the command line.
    pub inputs: Vec<InputReport>,
    /// What was found and done to the mesh.
    pub repairs: RepairReport,
    /// None without images and normal map.
    pub textures: Option<TextureSummary>,
}

/// The source images in a report.
#[derive(Clone, Debug, Default, Serialize)]
pub struct TextureSummary {
    images: usize,
    texels: u64,
    placeholders: usize,
    /// Of all tiles at level 0.
    tile_texels: u64,
    tile_bytes: u64,
    tile_fill: f64,
    charts: u64,
    source_clusters: u64,
    new_chart_clusters: u64,
    xatlas_clusters: u64,
    reduced_clusters: u64,
    /// Why the source's charts were not kept, and in how many clusters.
    reasons: Vec<(String, u64)>,
    helper: Option<HelperSummary>,
}

impl TextureSummary {
    /// Texels that a stage of the bake works on: those of the images, or of the tiles at level 0.
    pub fn texels_of(&self, stage: &str) -> Option<u64> {
        match stage {
            "textures" => Some(self.texels),
            "charts" | "texels" => Some(self.tile_texels),
            _ => None,
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        let TextureSummary { images, texels, placeholders, charts, tile_texels, tile_bytes, .. } = self;
        let mut text = match images {
            0 => String::new(),
            _ => format!("textures: {images} images, {texels} texels, {placeholders} placeholders\n"),
        };
        let _ = write!(text, "charts: {charts}, ");
        let from = [
            (self.source_clusters, "of the source"),
            (self.new_chart_clusters, "new"),
            (self.xatlas_clusters, "by xatlas"),
        ];
        let from: Vec<String> =
            from.iter().filter(|f| f.0 > 0).map(|(n, what)| format!("{what} in {n} clusters")).collect();
        let _ = write!(text, "{}", from.join(", "));
        for (reason, clusters) in &self.reasons {
            let _ = write!(text, "; source charts not kept in {clusters}: {reason}");
        }
        let per_texel = *tile_bytes as f64 / (*tile_texels).max(1) as f64;
        let _ = write!(
            text,
            "\ntiles: {tile_texels} texels, {:.0} % covered, {tile_bytes} bytes, {per_texel:.2} per texel",
            self.tile_fill * 100.0
        );
        if self.reduced_clusters > 0 {
            let _ =
                write!(text, "; fewer texels than the source in {} clusters: raise --tile-size", self.reduced_clusters);
        }
        if let Some(helper) = self.helper.as_ref().filter(|h| h.by_fallback > 0) {
            let _ =
                write!(text, "\nxatlas: {} clusters, the built-in method for {}", helper.by_helper, helper.by_fallback);
        }
        text
    }

    /// Adds what the bake made of the images.
    pub fn with_bake(mut self, model: &BakedModel, baked: &BakeReport, helper: Option<HelperSummary>) -> Self {
        let geometry = (model.record.clusters * model.record.levels) as usize;
        self.tile_bytes = model.chunks.iter().skip(geometry).map(|c| c.bytes.len() as u64).sum();
        if let Some(charts) = &baked.charts {
            self.tile_texels = charts.texels;
            self.tile_fill = charts.fill;
            self.charts = charts.charts;
            self.source_clusters = charts.source_clusters;
            self.new_chart_clusters = charts.auto_clusters;
            self.xatlas_clusters = charts.given_clusters;
            self.reduced_clusters = charts.reduced_clusters;
            self.reasons = charts.reasons.clone();
        }
        self.helper = helper;
        self
    }
}

/// Reads, decodes and repairs, or takes what the job has kept of that. Says what was odd on the way.
pub fn load(args: &BakeArgs, job: &mut Job, progress: &Progress) -> Result<Scene, Failure> {
    progress.stage("read");
    let mut scene = match job.load_scene() {
        Some(scene) => scene,
        None => {
            let scene = read(args, progress)?;
            if scene.textures.is_none() {
                job.save_scene(&scene);
            }
            scene
        }
    };
    if scene.textures.is_some() && !job.is_same_scene(&scene) {
        progress.note("the images have changed since the bake was cut short; it begins anew");
        job.clear();
    }
    if args.normal_map && scene.mesh.texturing.is_none() {
        scene.mesh.texturing = Some(Texturing::plain(scene.mesh.triangles.len()));
        scene.textures.get_or_insert_default();
    }
    Ok(scene)
}

fn read(args: &BakeArgs, progress: &Progress) -> Result<Scene, Failure> {
    if let Some(texture) = args.texture.as_ref().filter(|path| !path.is_file()) {
        return Err(blame_machine(format!("--texture {}: there is no such file; check the name", texture.display())));
    }
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
    let summary = TextureSummary { images, texels: decoded.texels(), placeholders, ..TextureSummary::default() };
    Ok((decoded.images, summary))
}
