//! The bake: a clean mesh becomes clusters, levels, measured errors and packed chunks.
//!
//! Order of the steps: segment, snap to the grid, find what each position may do, simplify in unison, measure every
//! level against the input, build the coarse buffer hierarchy, build and pack the buffers. All loops are data
//! parallel over clusters or positions, and no result depends on their order.
//!
//! Must never: read or write a file, or a clock.

mod buffers;
mod grid;

use super::hierarchy;
use super::layout::*;
use super::model::FLAG_COLORS;
use super::write::{BakedModel, EncodedChunk};
use buffers::{Place, Source};
use glam::{DVec3, Vec3};
use grid::Grid;
use pb_mesh::deviation::{LevelPair, measure};
use pb_mesh::mesh::Mesh;
use pb_mesh::segment::{Segmentation, segment};
use pb_mesh::simplify::{Collapses, UnisonInput, simplify};
use pb_mesh::topology::{Fans, Kind, border_pair, classify};
use rayon::prelude::*;
use std::borrow::Cow;

/// Most neighbours that border slots can name.
const MAX_NEIGHBOURS: usize = 255;
/// Default for [`BakeOptions::cluster_triangles`]; docs/performance.md has the measurement behind it.
pub const DEFAULT_CLUSTER_TRIANGLES: usize = 16_384;

/// What the user may choose.
#[derive(Clone, Debug, PartialEq)]
pub struct BakeOptions {
    /// Number of levels, 1 to [`MAX_LEVELS`].
    pub levels: u32,
    /// Vertices of a level over vertices of the next coarser one, above 1.
    pub ratio: f64,
    /// Most triangles of a cluster.
    pub cluster_triangles: usize,
}

impl Default for BakeOptions {
    fn default() -> Self {
        BakeOptions { levels: 5, ratio: 4.0, cluster_triangles: DEFAULT_CLUSTER_TRIANGLES }
    }
}

/// Steps of the bake, for progress displays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Segmentation, grid, neighbourhoods.
    Segment,
    /// Simplification in unison.
    Simplify,
    /// Distances of all levels to the input.
    Measure,
    /// Vertex order, index buffers, packing.
    Pack,
}

/// Counts that the archive does not hold.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BakeReport {
    /// Positions whose surroundings are not a surface: locked at every level.
    pub non_manifold_positions: u64,
    /// Positions where three clusters meet or a border ends: locked at every level.
    pub corner_positions: u64,
    /// Average cache misses per triangle, per level.
    pub acmr: Vec<f32>,
}

/// Options that cannot be baked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BakeError {
    /// Levels out of range.
    #[error("--levels {0} is not possible; choose 1 to {MAX_LEVELS}")]
    Levels(u32),
    /// Ratio out of range.
    #[error("--ratio {0} is not possible; choose a number from 1.2 to 64")]
    Ratio(f64),
    /// Cluster size out of range.
    #[error("--cluster-triangles {0} is not possible; choose 64 to 1000000")]
    ClusterTriangles(usize),
    /// Too much for 32-bit indices.
    #[error("the mesh has {0} triangles; at most 1000000000 can be baked in one piece")]
    TooLarge(usize),
}

/// Bakes a mesh. `progress` is called from any thread with a stage and the share of it that is done.
///
/// # Errors
/// [`BakeError`] for options out of range.
pub fn bake(
    mesh: &Mesh,
    triangles_in: u64,
    options: &BakeOptions,
    progress: &(dyn Fn(Stage, f32) + Sync),
) -> Result<(BakedModel, BakeReport), BakeError> {
    check(mesh, options)?;
    let levels = options.levels as usize;
    progress(Stage::Segment, 0.0);
    let triangles: Vec<[u32; 3]> =
        (0..mesh.triangles.len()).into_par_iter().map(|t| mesh.corner_positions(t)).collect();
    let clusters = Clusters::new(mesh, &triangles, options.cluster_triangles);
    progress(Stage::Simplify, 0.0);
    let collapses = simplify(&clusters.unison(&triangles, &normals(mesh)), levels, options.ratio, &|x| {
        progress(Stage::Simplify, x)
    });
    progress(Stage::Measure, 0.0);
    let errors = measure_levels(&triangles, &clusters, &collapses, levels, &|x| progress(Stage::Measure, x));
    progress(Stage::Pack, 0.0);
    let (model, acmr) =
        assemble(mesh, triangles_in, &triangles, &clusters, &collapses, &errors, levels, &|x| progress(Stage::Pack, x));
    let locked = clusters.kinds.iter().filter(|k| **k == Kind::Locked).count() as u64;
    let report =
        BakeReport { non_manifold_positions: clusters.broken, corner_positions: locked - clusters.broken, acmr };
    Ok((model, report))
}

fn check(mesh: &Mesh, options: &BakeOptions) -> Result<(), BakeError> {
    if !(1..=MAX_LEVELS as u32).contains(&options.levels) {
        return Err(BakeError::Levels(options.levels));
    }
    if !(1.2..=64.0).contains(&options.ratio) {
        return Err(BakeError::Ratio(options.ratio));
    }
    if !(64..=1_000_000).contains(&options.cluster_triangles) {
        return Err(BakeError::ClusterTriangles(options.cluster_triangles));
    }
    if mesh.triangles.len() > 1_000_000_000 {
        return Err(BakeError::TooLarge(mesh.triangles.len()));
    }
    assert!(!mesh.triangles.is_empty(), "repair refuses meshes without triangles");
    Ok(())
}

/// Mean normal of each position's wedges.
fn normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for w in &mesh.wedges {
        sums[w.position as usize] += Vec3::from_array(w.normal);
    }
    sums.into_par_iter().map(Vec3::normalize_or_zero).collect()
}

/// The mesh cut into clusters, on the grid.
struct Clusters {
    segmentation: Segmentation,
    cluster_of: Vec<u32>,
    fans: Fans,
    kinds: Vec<Kind>,
    broken: u64,
    grid: Grid,
}

impl Clusters {
    fn new(mesh: &Mesh, triangles: &[[u32; 3]], max_triangles: usize) -> Self {
        let segmentation = segment(&mesh.positions, triangles, &mesh.triangles, max_triangles);
        let mut cluster_of = vec![0; triangles.len()];
        for c in 0..segmentation.len() {
            for &t in segmentation.cluster(c) {
                cluster_of[t as usize] = c as u32;
            }
        }
        let fans = Fans::new(mesh.positions.len(), triangles);
        let (mut kinds, broken) = classify(triangles, &cluster_of, &fans, mesh.positions.len());
        lock_excess_neighbours(&mut kinds, &cluster_of, &fans, segmentation.len());
        let grid = grid::snap(&mesh.positions, triangles, &segmentation, &cluster_of, &fans);
        Clusters { segmentation, cluster_of, fans, kinds, broken, grid }
    }

    fn unison<'a>(&'a self, triangles: &'a [[u32; 3]], normals: &'a [Vec3]) -> UnisonInput<'a> {
        UnisonInput {
            positions: &self.grid.points,
            normals,
            triangles,
            segmentation: &self.segmentation,
            cluster_of: &self.cluster_of,
            fans: &self.fans,
            kinds: &self.kinds,
        }
    }

    /// The two clusters of a border position, ascending.
    fn pair_of(&self, v: u32) -> [u32; 2] {
        border_pair(v, &self.cluster_of, &self.fans)
    }
}

/// Border slots name at most 255 neighbours of a cluster; borders with further ones stay as they are.
fn lock_excess_neighbours(kinds: &mut [Kind], cluster_of: &[u32], fans: &Fans, clusters: usize) {
    let mut pairs: Vec<[u32; 2]> = (0..kinds.len() as u32)
        .into_par_iter()
        .filter(|&v| kinds[v as usize] == Kind::Border)
        .map(|v| border_pair(v, cluster_of, fans))
        .collect();
    pairs.par_sort_unstable();
    pairs.dedup();
    let mut counts = vec![0; clusters];
    let mut excess = std::collections::BTreeSet::new();
    for pair in pairs {
        if pair.iter().any(|&c| counts[c as usize] == MAX_NEIGHBOURS) {
            excess.insert(pair);
        } else {
            pair.iter().for_each(|&c| counts[c as usize] += 1);
        }
    }
    if !excess.is_empty() {
        kinds.par_iter_mut().enumerate().filter(|k| *k.1 == Kind::Border).for_each(|(v, kind)| {
            if excess.contains(&border_pair(v as u32, cluster_of, fans)) {
                *kind = Kind::Locked;
            }
        });
    }
}

/// Errors of one level, input units.
struct LevelErrors {
    /// Bound per cluster (segmentation order).
    max: Vec<f32>,
    rms: f64,
    /// Positions that triangles of this level use.
    vertices: u64,
}

/// Levels that are this many steps apart are measured against each other.
const MEASURE_STEP: usize = 2;

/// A level as triangles over positions, with the cluster of each.
struct LevelSurface<'a> {
    triangles: Cow<'a, [[u32; 3]]>,
    cluster_of: Cow<'a, [u32]>,
}

impl LevelSurface<'_> {
    /// The next coarser level.
    fn coarser(&self, collapses: &Collapses, level: u8) -> LevelSurface<'static> {
        let at = |t: &[u32; 3]| t.map(|v| collapses.ancestor(v, level));
        let kept = self.triangles.par_iter().zip(&*self.cluster_of).map(|(t, &c)| (at(t), c));
        let (triangles, cluster_of): (Vec<_>, Vec<_>) =
            kept.filter(|(t, _)| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).unzip();
        LevelSurface { triangles: triangles.into(), cluster_of: cluster_of.into() }
    }
}

/// Measures all levels; bounds never fall from a level to the next coarser one.
///
/// Levels 1 and 2 are measured against the input. Level i above is measured against level i - 2, which is several
/// times smaller, and by the triangle inequality the bound of that level is added: a few percent of its own.
fn measure_levels(
    triangles: &[[u32; 3]],
    clusters: &Clusters,
    collapses: &Collapses,
    levels: usize,
    progress: &dyn Fn(f32),
) -> Vec<LevelErrors> {
    let (grid, count) = (&clusters.grid, clusters.segmentation.len());
    let components = &clusters.segmentation.components;
    let open = open_positions(triangles, clusters);
    let mut ancestors: Vec<u32> = (0..grid.points.len() as u32).collect();
    let round_up = |x: f64| (x as f32).next_up();
    let mut surfaces =
        vec![LevelSurface { triangles: triangles.into(), cluster_of: clusters.cluster_of.as_slice().into() }];
    let mut list = vec![LevelErrors {
        max: grid.snap_errors.iter().map(|&e| round_up(e)).collect(),
        rms: (grid.snap_squares / grid.points.len() as f64).sqrt(),
        vertices: grid.points.len() as u64,
    }];
    for level in 1..levels as u8 {
        // A component that has vanished is measured against the point that it shrank to.
        ancestors.par_iter_mut().for_each(|v| {
            let a = collapses.ancestor(*v, level);
            if components[a as usize] == components[*v as usize] {
                *v = a;
            }
        });
        surfaces.push(surfaces[level as usize - 1].coarser(collapses, level));
        let base = (level as usize).saturating_sub(MEASURE_STEP);
        let (fine, coarse) = (&surfaces[base], &surfaces[level as usize]);
        let fans = (base > 0).then(|| Fans::new(grid.points.len(), &fine.triangles));
        let pair = LevelPair {
            positions: &grid.points,
            triangles: &fine.triangles,
            fine: fans.as_ref().unwrap_or(&clusters.fans),
            cluster_of: &fine.cluster_of,
            coarse: &coarse.triangles,
            coarse_cluster_of: &coarse.cluster_of,
            ancestors: &ancestors,
            open: &open,
        };
        let deviation = measure(&pair, count);
        let (finer, base) = (list.last().expect("level 0 is there"), &list[base]);
        let bound = |c: usize| {
            let distance = f64::from(deviation.max[c]) * grid.quantum * (1.0 + 1e-5) + f64::from(base.max[c]);
            round_up(distance).max(finer.max[c])
        };
        let square = deviation.squares.0 / deviation.squares.1.max(f64::MIN_POSITIVE) * grid.quantum * grid.quantum;
        let next = LevelErrors {
            max: (0..count).map(bound).collect(),
            rms: (square + base.rms * base.rms).sqrt().max(finer.rms),
            vertices: used_positions(&coarse.triangles, grid.points.len()),
        };
        list.push(next);
        progress(f32::from(level) / (levels - 1) as f32);
    }
    list
}

/// How many positions triangles use.
fn used_positions(triangles: &[[u32; 3]], positions: usize) -> u64 {
    let mut used = vec![false; positions];
    triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
    used.iter().filter(|u| **u).count() as u64
}

/// Positions on open borders of the mesh.
fn open_positions(triangles: &[[u32; 3]], clusters: &Clusters) -> Vec<bool> {
    (0..clusters.kinds.len() as u32)
        .into_par_iter()
        .map(|v| match clusters.kinds[v as usize] {
            Kind::Inner | Kind::Border => false,
            Kind::Open => true,
            Kind::Locked => {
                let around = || clusters.fans.around(v).iter().map(|&t| triangles[t as usize]);
                let at = |t: [u32; 3], k: usize| t[(t.iter().position(|&x| x == v).expect("in its fan") + k) % 3];
                around().any(|t| !around().any(|o| at(o, 2) == at(t, 1)))
            }
        })
        .collect()
}

/// Orders the clusters, packs their buffers and fills all tables.
#[allow(clippy::too_many_arguments)] // the results of all earlier steps meet here, once
fn assemble(
    mesh: &Mesh,
    triangles_in: u64,
    triangles: &[[u32; 3]],
    clusters: &Clusters,
    collapses: &Collapses,
    errors: &[LevelErrors],
    levels: usize,
    progress: &(dyn Fn(f32) + Sync),
) -> (BakedModel, Vec<f32>) {
    let (grid, count) = (&clusters.grid, clusters.segmentation.len());
    let bounds: Vec<Bounds> = (0..count)
        .into_par_iter()
        .map(|c| Bounds::of(clusters.segmentation.cluster(c).iter().flat_map(|&t| triangles[t as usize]), &grid.points))
        .collect();
    let spheres: Vec<(DVec3, f64)> = bounds.iter().map(|b| (b.center.as_dvec3(), b.radius as f64)).collect();
    let mut hierarchy = hierarchy::build(&spheres);
    let mut new_of = vec![0u32; count];
    hierarchy.order.iter().enumerate().for_each(|(new, &old)| new_of[old as usize] = new as u32);
    let (neighbours, firsts) = neighbour_lists(clusters, &new_of);
    let source = Source {
        wedges: &mesh.wedges,
        triangles: &mesh.triangles,
        points: &grid.points,
        kinds: &clusters.kinds,
        collapses,
        levels,
    };
    let done = std::sync::atomic::AtomicUsize::new(0);
    let built: Vec<(Vec<LevelRecord>, Vec<EncodedChunk>)> = (0..count)
        .into_par_iter()
        .map(|new| {
            let old = hierarchy.order[new] as usize;
            let list = &neighbours[firsts[new] as usize..firsts[new + 1] as usize];
            let slot_of = |v: u32| {
                let other = clusters.pair_of(v).into_iter().find(|&c| c as usize != old).expect("two clusters");
                list.binary_search(&new_of[other as usize]).expect("border clusters are neighbours") as u8 + 1
            };
            let place = Place {
                triangles: clusters.segmentation.cluster(old),
                origin: bounds[old].low.to_array(),
                shift: grid.shifts[old],
                slot_of: &slot_of,
            };
            let result = buffers::build(&source, &place);
            progress((done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1) as f32 / count as f32);
            result
        })
        .collect();
    let (mut level_records, mut chunks) = (Vec::with_capacity(count * levels), Vec::with_capacity(count * levels));
    for (new, (mut records, packed)) in built.into_iter().enumerate() {
        for (level, r) in records.iter_mut().enumerate() {
            r.error = errors[level].max[hierarchy.order[new] as usize];
        }
        level_records.extend(records);
        chunks.extend(packed);
    }
    let coarsest: Vec<f32> = (0..count).map(|new| level_records[new * levels + levels - 1].error).collect();
    hierarchy.set_errors(&coarsest);
    let record = |new: usize| {
        let b = &bounds[hierarchy.order[new] as usize];
        ClusterRecord {
            origin: b.low.to_array(),
            shift: grid.shifts[hierarchy.order[new] as usize],
            center: b.center.to_array(),
            radius: b.radius,
            neighbours_first: firsts[new],
            neighbours_count: firsts[new + 1] - firsts[new],
            reserved: [0; 2],
        }
    };
    let (model_levels, acmr) = model_levels(&level_records, errors, levels);
    let model = BakedModel {
        maps: Vec::new(),
        tiles: Vec::new(),
        record: model_record(mesh, triangles_in, grid, &bounds, levels),
        clusters: (0..count).map(record).collect(),
        levels: level_records,
        neighbours,
        nodes: hierarchy.nodes.clone(),
        model_levels,
        chunks,
    };
    (model, acmr)
}

/// Box and sphere of a cluster, grid space.
struct Bounds {
    low: glam::IVec3,
    high: glam::IVec3,
    center: glam::IVec3,
    /// Rounded up, so that it holds every position (I4).
    radius: f32,
}

impl Bounds {
    fn of(positions: impl Iterator<Item = u32> + Clone, points: &[[i32; 3]]) -> Self {
        let point = |v: u32| glam::IVec3::from_array(points[v as usize]);
        let (low, high) = positions
            .clone()
            .map(point)
            .fold((glam::IVec3::MAX, glam::IVec3::MIN), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let center = low + (high - low) / 2;
        let square = |v: u32| (point(v) - center).as_dvec3().length_squared();
        let radius = positions.map(square).fold(0.0, f64::max).sqrt();
        Bounds { low, high, center, radius: (radius as f32).next_up() }
    }
}

/// Neighbour lists in the new order, each ascending, and where each starts.
fn neighbour_lists(clusters: &Clusters, new_of: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let mut pairs: Vec<[u32; 2]> = (0..clusters.kinds.len() as u32)
        .into_par_iter()
        .filter(|&v| clusters.kinds[v as usize] == Kind::Border)
        .flat_map_iter(|v| {
            let [a, b] = clusters.pair_of(v).map(|c| new_of[c as usize]);
            [[a, b], [b, a]]
        })
        .collect();
    pairs.par_sort_unstable();
    pairs.dedup();
    let mut firsts = vec![0u32; new_of.len() + 1];
    pairs.iter().for_each(|p| firsts[p[0] as usize + 1] += 1);
    for c in 0..new_of.len() {
        firsts[c + 1] += firsts[c];
    }
    (pairs.into_iter().map(|p| p[1]).collect(), firsts)
}

fn model_levels(records: &[LevelRecord], errors: &[LevelErrors], levels: usize) -> (Vec<ModelLevelRecord>, Vec<f32>) {
    let of = |level: usize| records.iter().skip(level).step_by(levels);
    let mut acmr = Vec::new();
    let list = (0..levels)
        .map(|level| {
            let triangles: u64 = of(level).map(|r| u64::from(r.triangles)).sum();
            let misses: f64 = of(level).map(|r| f64::from(r.acmr) * f64::from(r.triangles)).sum();
            acmr.push((misses / triangles.max(1) as f64) as f32);
            ModelLevelRecord {
                vertices: errors[level].vertices,
                triangles,
                max_error: of(level).map(|r| f64::from(r.error)).fold(0.0, f64::max),
                rms_error: errors[level].rms,
            }
        })
        .collect();
    (list, acmr)
}

fn model_record(mesh: &Mesh, triangles_in: u64, grid: &Grid, bounds: &[Bounds], levels: usize) -> ModelRecord {
    let (low, high) =
        bounds.iter().fold((glam::IVec3::MAX, glam::IVec3::MIN), |(lo, hi), b| (lo.min(b.low), hi.max(b.high)));
    ModelRecord {
        origin: grid.origin,
        quantum: grid.quantum,
        bounds_min: low.to_array(),
        bounds_max: high.to_array(),
        levels: levels as u32,
        clusters: bounds.len() as u32,
        triangles_in,
        flags: if mesh.has_colors { FLAG_COLORS } else { 0 },
        reserved: [0; 5],
    }
}
