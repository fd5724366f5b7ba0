//! Texture mips: wanted by texel size, with floors and a budget of their own.

use super::*;
use crate::plan::Prefetch;
use crate::progressive_buffers::grid_torus::GridTorus;
use glam::{DVec3, Vec4};

const PIXEL_ANGLE: f32 = 1e-3;
const LEVELS: u32 = 5;
/// Texels of the test model at mip 0, world units.
const TEXEL: f32 = 1.0;

struct Bench {
    selector: Selector,
    resident: Vec<bool>,
    retiring: Vec<bool>,
    failed: Vec<bool>,
    clusters: u32,
}

impl Bench {
    /// Tiles of 256 texels: mips 0 to 2 are chunks, 3 and coarser ones are the tail.
    fn new() -> Bench {
        let torus = GridTorus::new(4, LEVELS).with_textures(8, TEXEL);
        let clusters = torus.clusters.len() as u32;
        let mut bench = Bench {
            selector: Selector::new(&torus.tables()),
            resident: vec![false; torus.chunks()],
            retiring: vec![false; torus.chunks()],
            failed: vec![false; torus.chunks()],
            clusters,
        };
        for c in 0..clusters {
            for kind in [0, clusters] {
                bench.resident[((kind + c) * LEVELS + LEVELS - 1) as usize] = true;
            }
            bench.resident[((clusters + c) * LEVELS + 3) as usize] = true;
        }
        bench
    }

    fn select(&mut self, distance: f64, tau: f32, budget: u64, dt_secs: f32) -> Plan {
        let eye = DVec3::new(0.0, 0.0, distance);
        let planes = vec![Vec4::new(0.0, 0.0, -1.0, 0.0)];
        self.selector.select(&Frame {
            views: &[View { eye, planes, pixel_angle: PIXEL_ANGLE }],
            resident: &self.resident,
            retiring: &self.retiring,
            failed: &self.failed,
            changed: None,
            detail: Detail::ErrorPx(tau),
            vram_budget_bytes: u64::MAX,
            texture_budget_bytes: budget,
            max_triangles: u64::MAX,
            prefetch: Prefetch::AROUND,
            cut: false,
            dt_secs,
        })
    }

    /// The finest mip that a plan wants now, over all clusters; the tail's number where it wants none.
    fn finest(&self, plan: &Plan) -> u32 {
        let first = self.clusters * LEVELS;
        let now = plan.wants.iter().filter(|w| w.class == Class::Now && w.chunk.0 >= first);
        now.map(|w| w.chunk.0 % LEVELS).min().unwrap_or(3)
    }
}

#[test]
fn mips_are_wanted_while_their_texels_are_smaller_than_a_pixel() {
    // The torus is small against these distances: a pixel covers `distance * 1e-3`.
    for (distance, mip) in [(500.0, 0), (5e3, 1), (9e3, 2), (2e4, 3), (1e6, 3)] {
        let mut bench = Bench::new();
        let plan = bench.select(distance, 1.0, u64::MAX, f32::INFINITY);
        assert_eq!(bench.finest(&plan), mip, "at {distance}");
        let coarser = bench.select(distance, 2.0, u64::MAX, f32::INFINITY);
        assert_eq!(bench.finest(&coarser), (mip + u32::from(distance > 1e3)).min(3), "twice the error, at {distance}");
        let finer = bench.select(distance, 0.1, u64::MAX, f32::INFINITY);
        assert_eq!(bench.finest(&finer), mip, "texels below a pixel are of no use, at {distance}");
    }
}

#[test]
fn a_floor_comes_down_slowly_to_what_is_resident_and_no_further() {
    let mut bench = Bench::new();
    assert!(bench.select(500.0, 1.0, u64::MAX, 0.1).texture_floors.iter().all(|&f| f == 3.0));
    let first = (bench.clusters * LEVELS) as usize;
    bench.resident[first + 2] = true;
    bench.resident[first] = true; // mip 1 is missing: of no use yet
    let plan = bench.select(500.0, 1.0, u64::MAX, 0.1);
    assert!(plan.texture_floors[0] > 2.5 && plan.texture_floors[0] < 3.0, "{}", plan.texture_floors[0]);
    assert!(!plan.settled && plan.texture_floors[1] == 3.0);
    let plan = bench.select(500.0, 1.0, u64::MAX, 10.0);
    assert_eq!(plan.texture_floors[0], 2.0);
    assert_eq!(plan.floors[0], 4.0, "the geometry has a floor of its own");
}

#[test]
fn a_leaving_mip_is_given_back_when_its_floor_has_left_it() {
    let mut bench = Bench::new();
    let chunk = (bench.clusters * LEVELS + 2) as usize;
    bench.resident[chunk] = true;
    assert_eq!(bench.select(500.0, 1.0, u64::MAX, 10.0).texture_floors[0], 2.0);
    bench.retiring[chunk] = true;
    let plan = bench.select(500.0, 1.0, u64::MAX, 0.1);
    assert!(plan.released.is_empty() && plan.texture_floors[0] > 2.0);
    let plan = bench.select(500.0, 1.0, u64::MAX, 10.0);
    assert_eq!((plan.released, plan.texture_floors[0]), (vec![ChunkId(chunk as u32)], 3.0));
}

#[test]
fn mips_are_held_under_their_budget_and_leave_the_geometry_alone() {
    let mut bench = Bench::new();
    let all = bench.select(500.0, 1.0, u64::MAX, f32::INFINITY);
    let first = bench.clusters * LEVELS;
    let wanted = |plan: &Plan, texture: bool| -> Vec<Want> {
        let now = plan.wants.iter().filter(|w| w.class == Class::Now && (w.chunk.0 >= first) == texture);
        now.copied().collect()
    };
    let bytes =
        |plan: &Plan| -> u64 { wanted(plan, true).iter().map(|w| bench.selector.tables.chunk_bytes(w.chunk)).sum() };
    let half = bytes(&all) / 2;
    let mut tight = Bench::new();
    let plan = tight.select(500.0, 1.0, half, f32::INFINITY);
    assert!(bytes(&plan) <= half && bytes(&plan) > 0);
    assert!(tight.finest(&plan) > 0, "less of the textures");
    assert_eq!((wanted(&plan, false), plan.detail), (wanted(&all, false), all.detail));
    let none = Bench::new().select(500.0, 1.0, 0, f32::INFINITY);
    assert_eq!((bytes(&none), wanted(&none, false)), (0, wanted(&all, false)));
}

#[test]
fn mips_that_never_fit_are_not_wanted() {
    let torus = GridTorus::new(4, LEVELS).with_textures(8, TEXEL);
    let tables = torus.tables();
    let mut chunk_bytes = tables.chunk_bytes.to_vec();
    let first = torus.clusters.len() * LEVELS as usize;
    chunk_bytes[first] = u64::MAX;
    chunk_bytes[first + LEVELS as usize + 1] = u64::MAX;
    let mut bench = Bench::new();
    bench.selector = Selector::new(&SelectTables { chunk_bytes: &chunk_bytes, ..tables });
    let plan = bench.select(500.0, 1.0, 1 << 40, f32::INFINITY);
    let finest = |cluster: usize| {
        let mips = first + cluster * LEVELS as usize..first + (cluster + 1) * LEVELS as usize;
        plan.wants.iter().filter(|w| mips.contains(&(w.chunk.0 as usize))).map(|w| w.chunk.0 % LEVELS).min()
    };
    assert_eq!([0, 1, 2].map(finest), [Some(1), Some(2), Some(0)]);
    assert_eq!(plan.detail, Some(Detail::ErrorPx(1.0)));
}
