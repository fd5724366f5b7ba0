//! How the images of a scene go into the archive: charts, also those of the xatlas helper, and texels.

use crate::cli::{BakeArgs, ChartsFrom};
use crate::job::Job;
use crate::progress::Progress;
use crate::scene::Scene;
use pb_bake::xatlas::{Helper, HelperCharts, HelperSummary, Pool};
use pb_lod::progressive_buffers::bake::{
    BakeError, BakeReport, ChartMode, ChartOptions, Outside, Stage, TextureInput, bake_textured,
};
use pb_lod::progressive_buffers::write::BakedModel;
use pb_mesh::charts::ClusterSurface;
use pb_mesh::texture::image::Image;
use std::time::Duration;

/// Bakes a scene with its textures. The mesh is taken out of it.
pub fn bake_scene(
    args: &BakeArgs,
    scene: &mut Scene,
    job: &Job,
    progress: &Progress,
    show: &(dyn Fn(Stage, f32) + Sync),
) -> Result<(BakedModel, BakeReport, Option<HelperSummary>), BakeError> {
    let mesh = std::mem::take(&mut scene.mesh);
    let spill = job.spill(args)?;
    let images: Vec<Option<Image>> = scene.images.iter().cloned().map(Some).collect();
    let wanted = args.charts == Some(ChartsFrom::Xatlas) && mesh.texturing.is_some();
    let pool = || Helper::find(args.xatlas_helper.as_deref()).and_then(Pool::new);
    let limit = Duration::from_secs_f64(args.xatlas_time_limit);
    let helper = wanted.then(|| HelperCharts::new(pool(), limit));
    let charter = |surface: &ClusterSurface| helper.as_ref().and_then(|h| h.charts(surface));
    let textures = TextureInput {
        materials: &scene.materials,
        images: &images,
        charts: ChartOptions {
            mode: match args.charts {
                None => ChartMode::Best,
                Some(ChartsFrom::Source) => ChartMode::Source,
                Some(ChartsFrom::Auto | ChartsFrom::Xatlas) => ChartMode::Auto,
            },
            tile_size: args.tile_size,
            charter: helper.is_some().then_some(&charter),
        },
        texels: args.texel_options(),
    };
    let texel_work = |texels| progress.work(|work| work.texels = Some(texels));
    let outside = Outside { progress: show, texel_work: &texel_work, spill: &spill, checkpoints: job };
    let triangles_in = scene.repairs.triangles_in;
    let baked = bake_textured(mesh, Some(&textures), triangles_in, &args.bake_options(), &outside);
    let (model, report) = baked?;
    let helper = helper.map(HelperCharts::summary);
    for fault in helper.iter().flat_map(|h| &h.faults) {
        progress.note(&format!("warning: {fault}; the built-in method has cut that part"));
    }
    Ok((model, report, helper))
}
