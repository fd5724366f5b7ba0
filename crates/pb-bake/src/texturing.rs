//! How the images of a scene go into the archive: charts, also those of the xatlas helper, and texels.

use crate::cli::{BakeArgs, ChartsFrom, TexelFormat, TextureQuality};
use crate::progress::Progress;
use crate::scene::Scene;
use pb_archive::Spill;
use pb_bake::xatlas::{Helper, HelperFault, Options, Pool, Request};
use pb_lod::progressive_buffers::bake::{
    BakeError, BakeReport, ChartMode, ChartOptions, Stage, TexelOptions, TextureInput, bake_textured,
};
use pb_lod::progressive_buffers::write::BakedModel;
use pb_mesh::charts::{Charts, ClusterSurface};
use pb_mesh::texture::image::Image;
use pb_mesh::texture::{NormalSpace, Quality};
use serde::Serialize;
use std::sync::Mutex;
use std::time::Duration;

/// Most faults of the helper that are told one by one.
const MAX_TOLD_FAULTS: usize = 3;

/// What the helper did, for reports.
#[derive(Clone, Debug, Default, Serialize)]
pub struct HelperSummary {
    /// Clusters with charts of the helper.
    pub by_helper: u64,
    /// Clusters that the built-in method cut instead.
    pub by_fallback: u64,
    /// Why, for the first of them.
    pub faults: Vec<String>,
}

/// Bakes a scene with its textures.
pub fn bake_scene(
    args: &BakeArgs,
    scene: &Scene,
    progress: &Progress,
    show: &(dyn Fn(Stage, f32) + Sync),
) -> Result<(BakedModel, BakeReport, Option<HelperSummary>), BakeError> {
    let spill = match scene.mesh.texturing {
        Some(_) => Spill::in_folder(&args.decode_options().temp_dir)?,
        None => Spill::in_memory(),
    };
    let images: Vec<Option<Image>> = scene.images.iter().cloned().map(Some).collect();
    let wanted = args.charts == Some(ChartsFrom::Xatlas) && scene.mesh.texturing.is_some();
    let helper = if wanted { Some(HelperCharts::start(args)) } else { None };
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
        texels: TexelOptions {
            quality: match args.texture_quality {
                TextureQuality::Fast => Quality::Fast,
                TextureQuality::Normal => Quality::Normal,
                TextureQuality::Best => Quality::Best,
            },
            compress: args.texture_format == TexelFormat::Bc,
            normal_space: if args.normal_map { NormalSpace::Object } else { NormalSpace::Tangent },
        },
        spill: &spill,
    };
    let triangles_in = scene.repairs.triangles_in;
    let baked = bake_textured(&scene.mesh, Some(&textures), triangles_in, &args.bake_options(), show);
    let (model, report) = baked?;
    let helper = helper.map(HelperCharts::summary);
    for fault in helper.iter().flat_map(|h| &h.faults) {
        progress.note(&format!("warning: {fault}; the built-in method has cut that part"));
    }
    Ok((model, report, helper))
}

/// Charts by the helper program, with what went wrong.
struct HelperCharts {
    pool: Result<Pool, HelperFault>,
    limit: Duration,
    summary: Mutex<HelperSummary>,
}

impl HelperCharts {
    fn start(args: &BakeArgs) -> HelperCharts {
        let pool = Helper::find(args.xatlas_helper.as_deref()).and_then(Pool::new);
        HelperCharts {
            pool,
            limit: Duration::from_secs_f64(args.xatlas_time_limit),
            summary: Mutex::new(HelperSummary::default()),
        }
    }

    fn charts(&self, surface: &ClusterSurface) -> Option<Charts> {
        let request = Request {
            time_limit_ms: u32::try_from(self.limit.as_millis()).unwrap_or(u32::MAX),
            options: Options::default(),
            positions: surface.positions.to_vec(),
            triangles: surface.triangles.to_vec(),
        };
        let answer = match &self.pool {
            Ok(pool) => pool.charts(&request, self.limit).map_err(|fault| fault.to_string()),
            Err(fault) => Err(fault.to_string()),
        };
        let mut summary = self.summary.lock().expect("no thread panics while it counts");
        match answer {
            Ok(charts) => {
                summary.by_helper += 1;
                let mirrored = vec![false; charts.count as usize];
                Some(Charts { chart_of: charts.chart_of, count: charts.count, uv: charts.uv, mirrored })
            }
            Err(fault) => {
                summary.by_fallback += 1;
                if summary.faults.len() < MAX_TOLD_FAULTS && !summary.faults.contains(&fault) {
                    summary.faults.push(fault);
                }
                None
            }
        }
    }

    fn summary(self) -> HelperSummary {
        let mut summary = self.summary.into_inner().expect("no thread panics while it counts");
        summary.faults.sort();
        summary
    }
}
