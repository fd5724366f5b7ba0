//! Charts by the built-in method beside those of xatlas, on the same clusters, packed by the same packer into tiles of
//! the same size; both are measured here, by code that neither of them uses. `just bench-charts` runs it:
//! docs/performance.md has the table and says what its columns are.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Parser;
use glam::{DVec2, DVec3};
use pb_bake::import::load;
use pb_bake::xatlas::{Helper, HelperCharts, HelperSummary, Pool};
use pb_mesh::charts::{AutoOptions, Charts, ClusterSurface, PackOptions, Packed, auto_charts, pack, tile_area2};
use pb_mesh::repair::{RepairOptions, repair};
use pb_mesh::segment::segment;
use rayon::prelude::*;

/// Share of a surface whose texels are at most as long as the worst stretch says.
const WORST_PERCENTILE: f64 = 0.99;
/// How long the helper may take for a cluster.
const PATIENCE: Duration = Duration::from_secs(600);

/// Charts of models by both methods, as rows of a Markdown table.
#[derive(Parser)]
struct Arguments {
    /// Meshes in any format that pb-bake reads.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Most triangles of a cluster.
    #[arg(long, default_value_t = 16_384)]
    cluster_triangles: usize,
    /// Texels per side of every tile.
    #[arg(long, default_value_t = 512)]
    tile: u32,
    /// Runs of the built-in method, of which the fastest counts.
    #[arg(long, default_value_t = 5)]
    runs: usize,
    /// The helper; else it is looked for as pb-bake does.
    #[arg(long)]
    xatlas_helper: Option<PathBuf>,
    /// Without xatlas.
    #[arg(long)]
    built_in_only: bool,
    /// Without the heading of the table.
    #[arg(long)]
    no_heading: bool,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    if !arguments.no_heading {
        println!("{HEADING}");
    }
    for model in &arguments.models {
        let clusters = clusters(model, arguments.cluster_triangles)?;
        let runs = (0..arguments.runs.max(1)).map(|_| built_in(&clusters));
        let best = runs.min_by(|a, b| a.cpu_seconds.total_cmp(&b.cpu_seconds)).expect("at least one run");
        println!("{}", row(&name(model), "built-in", &clusters, &best, arguments.tile));
        if !arguments.built_in_only {
            let (made, summary) = by_helper(&clusters, arguments.xatlas_helper.as_deref())?;
            println!("{}", row(&name(model), "xatlas", &clusters, &made, arguments.tile));
            summary.faults.iter().for_each(|fault| eprintln!("{}: {fault}", name(model)));
        }
    }
    Ok(())
}

/// Folder of the model, which tells fixtures apart.
fn name(model: &Path) -> String {
    let folder = model.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
    let stem = model.file_stem().unwrap_or_default().to_string_lossy();
    format!("{folder}/{stem}")
}

/// A cluster around its own first vertex.
struct Cluster {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

/// The clusters of a repaired model.
fn clusters(path: &Path, most: usize) -> Result<Vec<Cluster>> {
    let soup = load(&[path.to_owned()], &Default::default(), &|_| {}).context("cannot be read")?.soup;
    let mesh = repair(soup, &RepairOptions::default()).context("cannot be repaired")?.0;
    let corners: Vec<[u32; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corner_positions(t)).collect();
    let segmentation = segment(&mesh.positions, &corners, &mesh.triangles, most);
    let cluster = |c: usize| {
        let triangles: Vec<[u32; 3]> = segmentation.cluster(c).iter().map(|t| corners[*t as usize]).collect();
        let mut used = triangles.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let origin = mesh.positions[used[0] as usize];
        let place = |i: &u32| std::array::from_fn(|k| (mesh.positions[*i as usize][k] - origin[k]) as f32);
        let local = |t: &[u32; 3]| t.map(|i| used.binary_search(&i).expect("collected above") as u32);
        Cluster { positions: used.iter().map(place).collect(), triangles: triangles.iter().map(local).collect() }
    };
    Ok((0..segmentation.len()).map(cluster).collect())
}

impl Cluster {
    fn surface(&self) -> ClusterSurface<'_> {
        ClusterSurface { positions: &self.positions, triangles: &self.triangles }
    }
}

/// Charts of all clusters, and what they took.
struct Made {
    /// `None` where the method failed.
    charts: Vec<Option<Charts>>,
    cpu_seconds: f64,
}

fn made(clusters: &[Cluster], make: impl Fn(&Cluster) -> Option<Charts> + Sync + Send) -> Vec<Option<Charts>> {
    clusters.par_iter().with_max_len(1).map(make).collect()
}

fn built_in(clusters: &[Cluster]) -> Made {
    let before = cpu_seconds();
    let charts = made(clusters, |c| Some(auto_charts(&c.surface(), &AutoOptions::default(), None).0));
    Made { charts, cpu_seconds: cpu_seconds() - before }
}

fn by_helper(clusters: &[Cluster], named: Option<&Path>) -> Result<(Made, HelperSummary)> {
    let before = cpu_seconds();
    let helper = HelperCharts::new(Ok(Helper::find(named).and_then(Pool::new)?), PATIENCE);
    let charts = made(clusters, |c| helper.charts(&c.surface()));
    // This ends the helpers, whose time counts from then on.
    let summary = helper.summary();
    Ok((Made { charts, cpu_seconds: cpu_seconds() - before }, summary))
}

/// Of all threads of this process, and of its children that have ended; 0 where the system does not tell.
fn cpu_seconds() -> f64 {
    /// Linux counts the time of children in these, whatever the hardware.
    const TICKS_PER_SECOND: f64 = 100.0;
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    let of = |thread: std::io::Result<std::fs::DirEntry>| -> Option<f64> {
        let text = std::fs::read_to_string(thread.ok()?.path().join("schedstat")).ok()?;
        Some(text.split(' ').next()?.parse::<f64>().ok()? * 1e-9)
    };
    let status = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Fields 16 and 17 of proc(5), counted from the one after the name in brackets, which is the third.
    let fields = status.rsplit(')').next().unwrap_or_default().split_whitespace().skip(13).take(2);
    threads.filter_map(of).sum::<f64>() + fields.filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / TICKS_PER_SECOND
}

const HEADING: &str = "\
| model | triangles | clusters | method | charts | single | seams | fill | L2 stretch | worst 1 % | area error | turned | µs per triangle and core |
|---|---|---|---|---|---|---|---|---|---|---|---|---|";

fn row(name: &str, method: &str, clusters: &[Cluster], made: &Made, tile: u32) -> String {
    let measured: Vec<Option<Figures>> = clusters
        .par_iter()
        .zip(&made.charts)
        .map(|(c, charts)| Some(Figures::new(c, charts.as_ref()?, tile)))
        .collect();
    let failed = measured.iter().filter(|m| m.is_none()).count();
    let mut all = Figures::default();
    measured.into_iter().flatten().for_each(|figures| all.add(figures));
    let triangles: usize = clusters.iter().map(|c| c.triangles.len()).sum();
    let failures = if failed > 0 { format!(" ({failed} clusters failed)") } else { String::new() };
    format!(
        "| {name} | {triangles} | {} | {method}{failures} | {} | {} | {:.2} | {:.3} | {:.4} | {:.3} | {:.4} | {} | {:.2} |",
        clusters.len(),
        all.charts,
        all.single,
        all.seams / all.root_area,
        all.covered / all.tiles,
        all.l2(),
        all.worst(),
        all.area_error(),
        all.turned,
        made.cpu_seconds / triangles as f64 * 1e6,
    )
}

/// Sums over clusters.
#[derive(Default)]
struct Figures {
    charts: usize,
    /// Charts of one triangle.
    single: usize,
    /// Length of edges inside of the cluster that are apart in the charts.
    seams: f64,
    /// Roots of the clusters' areas.
    root_area: f64,
    /// Tiles, and how much of them triangles cover.
    tiles: f64,
    covered: f64,
    /// Triangles of negative area, as made and as packed.
    turned: usize,
    /// Area of triangles that have one, on the surface and in the charts.
    area: f64,
    flat: f64,
    /// Mean square of both singular values of the map to the surface, times area.
    squares: f64,
    /// Larger singular value, area and area in the chart, of every triangle.
    samples: Vec<[f64; 3]>,
}

impl Figures {
    fn new(cluster: &Cluster, charts: &Charts, tile: u32) -> Figures {
        let packed = packed(charts, tile);
        let mut figures = Figures {
            charts: charts.count as usize,
            tiles: 1.0,
            covered: covered(&packed),
            turned: packed.corners.iter().filter(|c| tile_area2(**c) < 0).count(),
            seams: seams(cluster, charts),
            ..Figures::default()
        };
        let mut members = vec![0; charts.count as usize];
        charts.chart_of.iter().for_each(|&c| members[c as usize] += 1);
        figures.single = members.iter().filter(|m| **m == 1).count();
        let mut whole = 0.0;
        for (triangle, uv) in cluster.triangles.iter().zip(&charts.uv) {
            let p = triangle.map(|v| DVec3::from_array(cluster.positions[v as usize].map(f64::from)));
            let uv = uv.map(|p| DVec2::from_array(p.map(f64::from)));
            let area = 0.5 * (p[1] - p[0]).cross(p[2] - p[0]).length();
            let flat = 0.5 * (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
            figures.turned += usize::from(flat < 0.0);
            whole += area;
            if area > 0.0 && flat > 0.0 {
                let [large, small] = singular_values(p, uv);
                figures.squares += 0.5 * (large * large + small * small) * area;
                figures.samples.push([large, area, flat]);
                (figures.area, figures.flat) = (figures.area + area, figures.flat + flat);
            }
        }
        figures.root_area = whole.sqrt();
        figures
    }

    fn add(&mut self, other: Figures) {
        self.charts += other.charts;
        self.single += other.single;
        self.seams += other.seams;
        self.root_area += other.root_area;
        self.tiles += other.tiles;
        self.covered += other.covered;
        self.turned += other.turned;
        self.area += other.area;
        self.flat += other.flat;
        self.squares += other.squares;
        self.samples.extend(other.samples);
    }

    /// Sander et al. 2001, section 3: 1 for an isometry.
    fn l2(&self) -> f64 {
        (self.squares / self.area).sqrt() * (self.flat / self.area).sqrt()
    }

    /// How long a texel is on the surface, of all but the worst of it, in roots of the mean area of a texel.
    fn worst(&self) -> f64 {
        let mut samples = self.samples.clone();
        samples.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut sum = 0.0;
        let found = samples.iter().find(|s| {
            sum += s[1];
            sum >= WORST_PERCENTILE * self.area
        });
        found.map_or(1.0, |s| s[0]) * (self.flat / self.area).sqrt()
    }

    /// Share of the texels that lie on triangles which have too many of them.
    fn area_error(&self) -> f64 {
        let wrong = |s: &[f64; 3]| (s[2] / self.flat - s[1] / self.area).abs();
        0.5 * self.samples.iter().map(wrong).sum::<f64>()
    }
}

/// Singular values of the map from the plane to the surface.
fn singular_values(p: [DVec3; 3], uv: [DVec2; 3]) -> [f64; 2] {
    let (s, t) = (uv[1] - uv[0], uv[2] - uv[0]);
    let area = s.perp_dot(t);
    let (e, f) = (p[1] - p[0], p[2] - p[0]);
    let (du, dv) = ((e * t.y - f * s.y) / area, (f * s.x - e * t.x) / area);
    let (a, b, c) = (du.length_squared(), du.dot(dv), dv.length_squared());
    let (mean, half) = (0.5 * (a + c), (0.5 * (a - c)).hypot(b));
    [(mean + half).sqrt(), (mean - half).max(0.0).sqrt()]
}

/// Edges between two triangles of a cluster whose corners have not the same places in one chart.
fn seams(cluster: &Cluster, charts: &Charts) -> f64 {
    let mut sides: HashMap<(u32, u32), Vec<[u32; 5]>> = HashMap::new();
    for (t, corners) in cluster.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = ((corners[k], k), (corners[(k + 1) % 3], (k + 1) % 3));
            let (low, high) = if a.0 < b.0 { (a, b) } else { (b, a) };
            let [p, q] = [low.1, high.1].map(|k| charts.uv[t][k].map(f32::to_bits));
            let side = [charts.chart_of[t], p[0], p[1], q[0], q[1]];
            sides.entry((low.0, high.0)).or_default().push(side);
        }
    }
    let mut lengths: Vec<f64> = sides
        .iter()
        .filter(|(_, sides)| sides.iter().any(|s| *s != sides[0]))
        .map(|((a, b), _)| {
            let [a, b] = [a, b].map(|v| DVec3::from_array(cluster.positions[*v as usize].map(f64::from)));
            a.distance(b)
        })
        .collect();
    lengths.sort_by(f64::total_cmp);
    lengths.iter().sum()
}

/// As dense as fits into a tile of that size.
fn packed(charts: &Charts, tile: u32) -> Packed {
    let areas = charts.uv.iter().map(|uv| {
        let [a, b, c] = uv.map(|p| DVec2::from_array(p.map(f64::from)));
        0.5 * (b - a).perp_dot(c - a)
    });
    let area: f64 = areas.sum();
    let full = (f64::from(tile) * f64::from(tile) / area.max(f64::MIN_POSITIVE)).sqrt() as f32;
    pack(charts, &vec![full; charts.count as usize], &PackOptions { max_size: tile, ..PackOptions::default() })
}

/// Share of the tile.
fn covered(packed: &Packed) -> f64 {
    packed.corners.iter().map(|c| tile_area2(*c) as f64).sum::<f64>() / 2.0 / 65_536f64.powi(2)
}
