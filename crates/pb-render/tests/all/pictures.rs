//! Whole frames on the adapter.

use crate::random_model::{PICTURE, RandomModel};
use glam::DVec3;
use pb_lod::plan::{ChunkId, CoarseDraw, Draw, Plan};
use pb_render::{BACKGROUND_SRGB, Camera, Coarse, Gpu, Offscreen, RenderError, Renderer, Scene, Style, grid_eye};

/// Vertices stand still: every cluster's floor is at the coarsest level, or all tables say "finest".
fn picture(gpu: &Gpu, model: &RandomModel, renderer: &Renderer, plan: &Plan, style: Style) -> Vec<u8> {
    let eye = DVec3::new(-10.0, 3.0, 90.0);
    let camera = Camera { eye, target: DVec3::splat(20.0), up: DVec3::Y, fov_deg: 70.0, near: 1e-3 };
    let target = Offscreen::new(gpu, [160, 120], PICTURE.color, PICTURE.samples).unwrap();
    renderer.draw(gpu, &target.surface(), &Scene { plan, camera: &camera, eye: grid_eye(&model.model, eye), style });
    target.read(gpu).unwrap()
}

fn upload_all(gpu: &Gpu, model: &RandomModel, renderer: &mut Renderer) {
    for c in 0..model.model.clusters * model.model.levels {
        renderer.model.upload(gpu, ChunkId(c), model.chunk(ChunkId(c))).unwrap();
    }
}

/// Every cluster drawn with the index buffer of `level`.
fn plan_at(model: &RandomModel, level: u32) -> Plan {
    let draws = (0..model.model.clusters).map(|cluster| Draw { cluster, level, instance: 0 }).collect();
    Plan { draws, floors: model.floors(), ..Plan::default() }
}

#[test]
fn one_indirect_call_draws_what_single_calls_draw() {
    let Some(gpu) = crate::adapter("multi-draw against plain draws") else { return };
    if !gpu.multi_draw {
        eprintln!("SKIPPED: the adapter has no indirect first instance: multi-draw against plain draws did not run");
        return;
    }
    let model = RandomModel::new(5, 30, 4);
    let mut renderer = model.renderer(&gpu, 1 << 30);
    upload_all(&gpu, &model, &mut renderer);
    let plan = plan_at(&model, 1);
    let many = picture(&gpu, &model, &renderer, &plan, Style::default());
    renderer.set_multi_draw(&gpu, false);
    assert!(many == picture(&gpu, &model, &renderer, &plan, Style::default()));
    let background = |p: &[u8]| p[..3] == BACKGROUND_SRGB;
    let covered = many.chunks_exact(4).filter(|p| !background(p)).count();
    assert!(covered > 2000, "{covered} pixels are covered");
    assert!(many.chunks_exact(4).any(background), "and some are not");
}

#[test]
fn the_coarse_buffer_draws_what_single_clusters_draw_at_the_coarsest_level() {
    let Some(gpu) = crate::adapter("coarse buffer against clusters") else { return };
    let mut model = RandomModel::new(6, 30, 2);
    // Level 1 drawn through level 0's machinery: give level 0 the coarse triangles, and floors of 1.
    for cluster in 0..30 {
        model.indices[cluster * 2] = model.indices[cluster * 2 + 1].clone();
        model.levels[cluster * 2].triangles = model.levels[cluster * 2 + 1].triangles;
        model.tables[cluster].floor = 1.0;
    }
    let mut renderer = model.renderer(&gpu, 1 << 30);
    upload_all(&gpu, &model, &mut renderer);
    let fine = picture(&gpu, &model, &renderer, &plan_at(&model, 0), Style::default());
    let all = 0..renderer.model.coarse_indices();
    let part = |indices| CoarseDraw { instance: 0, indices };
    let coarse = Plan { coarse: vec![part(all.clone())], floors: model.floors(), ..Plan::default() };
    assert!(fine == picture(&gpu, &model, &renderer, &coarse, Style::default()));
    let middle = renderer.model.coarse_range(15).start;
    let split = Plan { coarse: vec![part(0..middle), part(middle..all.end)], ..coarse };
    assert!(fine == picture(&gpu, &model, &renderer, &split, Style::default()));
}

#[test]
fn chunks_that_move_inside_the_heap_are_drawn_as_before() {
    let Some(gpu) = crate::adapter("compaction of the heap") else { return };
    let model = RandomModel::new(7, 40, 3);
    let mut roomy = model.renderer(&gpu, 1 << 30);
    upload_all(&gpu, &model, &mut roomy);
    // Just enough for everything, after coming and going in an order that leaves holes.
    let bound = roomy.model.vram_bytes() + 16 * 1024;
    let mut tight = model.renderer(&gpu, bound);
    for round in 0..3 {
        upload_all(&gpu, &model, &mut tight);
        assert!(tight.model.vram_bytes() <= bound);
        let plan = plan_at(&model, 0);
        let expected = picture(&gpu, &model, &roomy, &plan, Style::default());
        assert!(expected == picture(&gpu, &model, &tight, &plan, Style::default()), "round {round}");
        for c in (round..120).step_by(3 + round as usize) {
            tight.model.free(ChunkId(c));
        }
    }
}

#[test]
fn a_bound_below_the_coarsest_level_names_the_size_that_would_do() {
    let Some(gpu) = crate::adapter("too small a bound") else { return };
    let model = RandomModel::new(8, 40, 3);
    let coarse: Vec<_> = (0..40).map(|c| model.chunk(ChunkId(c * 3 + 2))).collect();
    let coarse = Coarse { chunks: &coarse, tails: &[] };
    let make = |bound| Renderer::new(&gpu, &model.tables(), &coarse, bound, PICTURE).map(|r| r.model.vram_bytes());
    let Err(RenderError::BoundTooSmall { needed, bound: 1000 }) = make(1000) else { panic!("too small") };
    assert_eq!(make(needed).unwrap(), needed);
    assert!(make(needed - 1).is_err());
}
