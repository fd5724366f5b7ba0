//! Real scans through the real helper, cluster by cluster as a bake would.

use super::fake::PATIENCE;
use super::real::helper;
use pb_bake::import::load;
use pb_bake::xatlas::{HelperCharts, Pool};
use pb_mesh::charts::ClusterSurface;
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::segment::segment;
use rayon::prelude::*;
use std::path::Path;
use std::time::Instant;

#[test]
fn scans_are_cut_without_a_fallback() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/fixtures");
    if !folder.is_dir() {
        eprintln!("SKIPPED: {} is not there, so its scans are not cut", folder.display());
        return;
    }
    let Some(helper) = helper() else { return };
    for name in
        ["scan_gso_frypan/chefmate_8_frypan.obj", "cad_trimesh/1002_tray_bottom.STL", "cad_trimesh/quadknot.obj"]
    {
        let clusters = clusters(&folder.join(name));
        let triangles: usize = clusters.iter().map(|c| c.triangles.len()).sum();
        let start = Instant::now();
        let charts = HelperCharts::new(Pool::new(helper.clone()), PATIENCE);
        let count = |c: &Cluster| {
            let surface = ClusterSurface { positions: &c.positions, triangles: &c.triangles };
            charts.charts(&surface).map_or(0, |charts| charts.count)
        };
        let count: u32 = clusters.par_iter().map(count).sum();
        let (seconds, summary) = (start.elapsed().as_secs_f64(), charts.summary());
        println!("{name}: {triangles} triangles, {} clusters, {count} charts, {seconds:.2} s", clusters.len());
        assert_eq!(summary.by_fallback, 0, "{name}: {summary:?}");
    }
}

struct Cluster {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

/// The clusters of a repaired model, each around its own first vertex.
fn clusters(path: &Path) -> Vec<Cluster> {
    let soup = load(&[path.to_owned()], &Default::default(), &|_| {}).unwrap().soup;
    let mesh = repair(soup, &RepairOptions::default()).unwrap().0;
    let corners: Vec<[u32; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t)).collect();
    let segmentation = segment(&mesh.positions, &corners, &mesh.triangles, 16384);
    let cluster = |c: usize| {
        let triangles: Vec<[u32; 3]> = segmentation.cluster(c).iter().map(|t| corners[*t as usize]).collect();
        let mut used = triangles.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let origin = mesh.positions[used[0] as usize];
        let place = |i: &u32| std::array::from_fn(|k| (mesh.positions[*i as usize][k] - origin[k]) as f32);
        let local = |t: &[u32; 3]| t.map(|i| used.binary_search(&i).unwrap() as u32);
        Cluster { positions: used.iter().map(place).collect(), triangles: triangles.iter().map(local).collect() }
    };
    (0..segmentation.len()).map(cluster).collect()
}
