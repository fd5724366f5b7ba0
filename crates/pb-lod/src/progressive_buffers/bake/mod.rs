//! The bake: a clean mesh becomes clusters, levels, measured errors and packed chunks.
//!
//! Order of the steps: segment, snap to the grid, find what each position may do, simplify in unison, measure every
//! level against the input, build the coarse buffer hierarchy, build and pack the buffers. All loops are data
//! parallel over clusters or positions, and no result depends on their order.
//!
//! Must never: open a file, or read a clock. Chunks and the results of steps go where the caller says ([`Outside`]).

mod assemble;
mod buffers;
mod chart_part;
mod charting;
pub mod checkpoints;
mod grid;
mod lanes;
mod levels;
mod objects;
mod surface;
mod tiles;

pub use charting::{ChartMode, ChartOptions, ChartSummary, Charter, DEFAULT_TILE_SIZE};
pub use tiles::{TexelOptions, TexelWork};

use super::layout::MAX_LEVELS;
use super::textures::MAX_SIZE_LOG2;
use super::write::BakedModel;
use assemble::{Finished, assemble};
use charting::{ChartInput, Tiles, make_tiles, sizing};
use checkpoints::{Checkpoints, Kept, NoCheckpoints};
use glam::Vec3;
use grid::Grid;
use levels::{add_slides, measure_levels};
use objects::ObjectClusters;
use pb_archive::{ArchiveError, Spill};
use pb_mesh::deviation::texture_deviation;
use pb_mesh::material::Material;
use pb_mesh::mesh::{Mesh, Wedge};
use pb_mesh::progress::share_of;
use pb_mesh::segment::{Segmentation, segment_objects};
use pb_mesh::simplify::{UnisonInput, simplify};
use pb_mesh::texture::NormalSpace;
use pb_mesh::texture::image::Image;
use pb_mesh::topology::{Fans, Kind, border_pair, classify};
use rayon::prelude::*;
use std::convert::Infallible;
use surface::Surface;
use tiles::fill_tiles;

/// Most neighbours that border slots can name.
const MAX_NEIGHBOURS: usize = 255;
/// Defaults for [`BakeOptions::cluster_triangles`]; docs/decisions/006-levels-and-bounds.md has the measurements behind them.
pub const CLUSTER_TRIANGLES: usize = 32_768;
/// The same for meshes of at most [`SMALL_MESH`] triangles: their coarse levels have so few vertices that borders of clusters
/// would take most of them.
pub const SMALL_MESH_CLUSTER_TRIANGLES: usize = 65_536;
/// See [`SMALL_MESH_CLUSTER_TRIANGLES`].
pub const SMALL_MESH: usize = 262_144;
/// The same with textures, whose tiles are bounded.
pub const TEXTURED_CLUSTER_TRIANGLES: usize = 16_384;
/// Most triangles of a cluster with textures: in the worst case each has three vertices of its own, and indices are u16.
const MAX_TEXTURED_TRIANGLES: usize = 21_845;

/// Share of the time of measuring that goes into textures, where there are any.
const SLIDES_SHARE: f32 = 0.25;

/// What the user may choose.
#[derive(Clone, Debug, PartialEq)]
pub struct BakeOptions {
    /// Number of levels, 1 to [`MAX_LEVELS`].
    pub levels: u32,
    /// Vertices of a level over vertices of the next coarser one, above 1.
    pub ratio: f64,
    /// Most triangles of a cluster; `None`: as many as suit the mesh, such as [`CLUSTER_TRIANGLES`].
    pub cluster_triangles: Option<usize>,
}

impl Default for BakeOptions {
    fn default() -> Self {
        BakeOptions { levels: 5, ratio: 4.0, cluster_triangles: None }
    }
}

/// The images of a textured mesh, and how they go into the archive.
#[derive(Clone, Copy)]
pub struct TextureInput<'a> {
    /// Those of the scene, which [`Texturing`](pb_mesh::mesh::Texturing) refers to.
    pub materials: &'a [Material],
    /// Those of the scene; `None` for images that no material needs.
    pub images: &'a [Option<Image>],
    /// How charts and tiles are made.
    pub charts: ChartOptions<'a>,
    /// How texels are stored.
    pub texels: TexelOptions,
}

/// What a bake reaches of the world outside.
#[derive(Clone, Copy)]
pub struct Outside<'a> {
    /// Called from any thread with a stage and the share of it that is done. A share of 0 comes once, where the stage begins:
    /// no other thread of the bake is at work then.
    pub progress: &'a (dyn Fn(Stage, f32) + Sync),
    /// Called once, when the charts of a textured mesh are made, with what its texels will be.
    pub texel_work: &'a (dyn Fn(TexelWork) + Sync),
    /// Where finished chunks wait until they are written.
    pub spill: &'a Spill,
    /// Where results of steps are kept, and were kept by a bake of the same input with the same options that was cut short.
    pub checkpoints: &'a dyn Checkpoints,
}

impl Outside<'static> {
    /// Nothing is shown or kept, and chunks wait in memory.
    pub fn nothing() -> Self {
        static IN_MEMORY: Spill = Spill::in_memory();
        Outside { progress: &|_, _| (), texel_work: &|_| (), spill: &IN_MEMORY, checkpoints: &NoCheckpoints }
    }
}

impl Outside<'_> {
    /// The result of a part of a step as it was kept, else made and kept.
    fn kept<T: Kept>(&self, step: &'static str, part: u32, make: impl FnOnce() -> T) -> T {
        let made: Result<T, Infallible> = self.try_kept(step, part, || Ok(make()));
        made.unwrap_or_else(|never| match never {})
    }

    /// The same where it may fail.
    fn try_kept<T: Kept, E>(&self, step: &'static str, part: u32, make: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        if let Some(mut input) = self.checkpoints.load(step, part)
            && let Ok(known) = T::read(&mut input, self.spill)
        {
            return Ok(known);
        }
        let made = make()?;
        self.checkpoints.save(step, part, &|out| made.write(out));
        Ok(made)
    }
}

/// Steps of the bake, for progress displays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Segmentation, grid, neighbourhoods.
    Segment,
    /// Charts and their places in tiles; only with textures.
    Charts,
    /// Simplification in unison.
    Simplify,
    /// Distances of all levels to the input.
    Measure,
    /// Vertex order, index buffers, packing.
    Pack,
    /// Texels resampled and packed; only with textures.
    Textures,
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
    /// What became of the textures, where there are any.
    pub charts: Option<ChartSummary>,
}

/// Why nothing was baked.
#[derive(Debug, thiserror::Error)]
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
    /// Tile size out of range.
    #[error("--tile-size {0} is not possible; choose a power of two from 32 to 4096")]
    TileSize(u32),
    /// No room for finished chunks.
    #[error(transparent)]
    Spill(#[from] ArchiveError),
}

/// Bakes a mesh without textures. `progress` is called from any thread with a stage and the share of it that is done.
///
/// # Errors
/// [`BakeError`] for options out of range.
pub fn bake(
    mesh: Mesh,
    triangles_in: u64,
    options: &BakeOptions,
    progress: &(dyn Fn(Stage, f32) + Sync),
) -> Result<(BakedModel, BakeReport), BakeError> {
    bake_textured(mesh, None, triangles_in, options, &Outside { progress, ..Outside::nothing() })
}

/// The same with its textures; they are left out where the mesh has no [`Texturing`](pb_mesh::mesh::Texturing).
///
/// # Errors
/// [`BakeError`] for options out of range, and where there is no room for chunks.
pub fn bake_textured(
    mesh: Mesh,
    textures: Option<&TextureInput>,
    triangles_in: u64,
    options: &BakeOptions,
    outside: &Outside,
) -> Result<(BakedModel, BakeReport), BakeError> {
    let progress = outside.progress;
    let textures = textures.filter(|_| mesh.texturing.is_some());
    check(&mesh, textures, options)?;
    let levels = options.levels as usize;
    progress(Stage::Segment, 0.0);
    let (mut surface, positions) = Surface::new(mesh);
    let wanted = options.cluster_triangles.unwrap_or(match surface.triangles.len() {
        _ if textures.is_some() => TEXTURED_CLUSTER_TRIANGLES,
        ..=SMALL_MESH => SMALL_MESH_CLUSTER_TRIANGLES,
        _ => CLUSTER_TRIANGLES,
    });
    let sizing = textures.map(|t| sizing(&surface, t, wanted.min(MAX_TEXTURED_TRIANGLES)));
    let max_triangles = sizing.map_or(wanted, |s| s.cluster_triangles);
    let clusters = Clusters::new(&mut surface, positions, max_triangles, outside);
    let tiles = textures.map(|t| {
        progress(Stage::Charts, 0.0);
        let input = ChartInput {
            surface: &surface,
            clusters: &clusters,
            materials: t.materials,
            images: t.images,
            normals: t.texels.normal_space == NormalSpace::Object,
            scale: sizing.map_or(1.0, |s| s.scale),
        };
        let tiles = make_tiles(&input, &t.charts, outside);
        (outside.texel_work)(TexelWork::new(t, surface.has_colors, &tiles));
        tiles
    });
    progress(Stage::Simplify, 0.0);
    let normals = normals(&surface.wedges, clusters.grid.points.len());
    let unison = clusters.unison(&surface.triangles, &normals, tiles.as_ref());
    let collapses =
        outside.kept("collapses", 0, || simplify(&unison, levels, options.ratio, &|x| progress(Stage::Simplify, x)));
    drop(normals);
    progress(Stage::Measure, 0.0);
    let distances = if tiles.is_some() { 1.0 - SLIDES_SHARE } else { 1.0 };
    let share = |x| progress(Stage::Measure, x * distances);
    let mut errors = measure_levels(&surface.triangles, &clusters, &collapses, levels, outside, &share);
    if let Some(tiles) = &tiles {
        let (points, segmentation) = (&clusters.grid.points, &clusters.segmentation);
        let share = |x| progress(Stage::Measure, distances + x * SLIDES_SHARE);
        let slides = texture_deviation(points, &surface.triangles, segmentation, &tiles.uv_input(), &collapses, &share);
        add_slides(&mut errors, &slides, clusters.grid.quantum);
    }
    progress(Stage::Pack, 0.0);
    let finished = Finished {
        surface: &surface,
        triangles_in,
        clusters: &clusters,
        tiles: tiles.as_ref(),
        collapses: &collapses,
        errors: &errors,
        levels,
    };
    let (mut model, order, acmr) = assemble(&finished, outside)?;
    if let (Some(input), Some(tiles)) = (textures, &tiles) {
        progress(Stage::Textures, 0.0);
        fill_tiles(&finished, input, tiles, &order, &mut model, outside)?;
    }
    let locked = clusters.kinds.iter().filter(|k| **k == Kind::Locked).count() as u64;
    let report = BakeReport {
        non_manifold_positions: clusters.broken,
        corner_positions: locked - clusters.broken,
        acmr,
        charts: tiles.as_ref().map(Tiles::summary),
    };
    Ok((model, report))
}

fn check(mesh: &Mesh, textures: Option<&TextureInput>, options: &BakeOptions) -> Result<(), BakeError> {
    if let Some(size) = textures.map(|t| t.charts.tile_size)
        && !(size.is_power_of_two() && (32..=1 << MAX_SIZE_LOG2).contains(&size))
    {
        return Err(BakeError::TileSize(size));
    }
    if !(1..=MAX_LEVELS as u32).contains(&options.levels) {
        return Err(BakeError::Levels(options.levels));
    }
    if !(1.2..=64.0).contains(&options.ratio) {
        return Err(BakeError::Ratio(options.ratio));
    }
    if let Some(wanted) = options.cluster_triangles.filter(|n| !(64..=1_000_000).contains(n)) {
        return Err(BakeError::ClusterTriangles(wanted));
    }
    if mesh.triangles.len() > 1_000_000_000 {
        return Err(BakeError::TooLarge(mesh.triangles.len()));
    }
    assert!(!mesh.triangles.is_empty(), "repair refuses meshes without triangles");
    Ok(())
}

/// Runs `job` for every cluster, in parallel; the answers are in the order of the clusters. `progress` gets the share done.
fn for_clusters<T: Send>(
    count: usize,
    progress: &(dyn Fn(f32) + Sync),
    job: impl Fn(usize) -> T + Sync + Send,
) -> Vec<T> {
    for_clusters_with(count, progress, || (), |_, c| job(c))
}

/// The same with something that a thread keeps from one cluster to the next.
fn for_clusters_with<K, T: Send>(
    count: usize,
    progress: &(dyn Fn(f32) + Sync),
    keep: impl Fn() -> K + Sync + Send,
    job: impl Fn(&mut K, usize) -> T + Sync + Send,
) -> Vec<T> {
    let share = share_of(count, progress);
    (0..count).into_par_iter().map_init(keep, |kept, c| share(job(kept, c))).collect()
}

/// Mean normal of each position's wedges.
fn normals(wedges: &[Wedge], positions: usize) -> Vec<Vec3> {
    if wedges.len() == positions {
        return wedges.par_iter().map(|w| (Vec3::ZERO + Vec3::from_array(w.normal)).normalize_or_zero()).collect();
    }
    let mut sums = vec![Vec3::ZERO; positions];
    for w in wedges {
        sums[w.position as usize] += Vec3::from_array(w.normal);
    }
    sums.into_par_iter().map(Vec3::normalize_or_zero).collect()
}

/// The mesh cut into clusters, on the grid.
struct Clusters {
    segmentation: Segmentation,
    objects: ObjectClusters,
    cluster_of: Vec<u32>,
    fans: Fans,
    kinds: Vec<Kind>,
    broken: u64,
    grid: Grid,
}

impl Clusters {
    /// Cuts a surface, and puts it in the order of the clusters.
    fn new(surface: &mut Surface, mut positions: Vec<[f64; 3]>, max_triangles: usize, outside: &Outside) -> Self {
        let objects = std::mem::take(&mut surface.objects);
        let mut segmentation = outside.kept("segments", 0, || {
            segment_objects(&positions, &objects.of, &surface.triangles, surface.corners(), max_triangles)
        });
        let objects = ObjectClusters::new(&objects, &surface.triangles, &segmentation);
        surface.arrange(&mut positions, &mut segmentation);
        let triangles = surface.triangles.as_slice();
        let mut cluster_of = vec![0; triangles.len()];
        for c in 0..segmentation.len() {
            for &t in segmentation.cluster(c) {
                cluster_of[t as usize] = c as u32;
            }
        }
        let fans = Fans::new(positions.len(), triangles);
        let (mut kinds, broken) = classify(triangles, &cluster_of, &fans, positions.len());
        lock_excess_neighbours(&mut kinds, &cluster_of, &fans, segmentation.len());
        let grid = grid::snap(&positions, triangles, &segmentation, &cluster_of, &fans);
        Clusters { segmentation, objects, cluster_of, fans, kinds, broken, grid }
    }

    fn unison<'a>(
        &'a self,
        triangles: &'a [[u32; 3]],
        normals: &'a [Vec3],
        tiles: Option<&'a Tiles>,
    ) -> UnisonInput<'a> {
        UnisonInput {
            positions: &self.grid.points,
            normals,
            triangles,
            segmentation: &self.segmentation,
            cluster_of: &self.cluster_of,
            fans: &self.fans,
            kinds: &self.kinds,
            texture: tiles.map(Tiles::uv_input),
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
