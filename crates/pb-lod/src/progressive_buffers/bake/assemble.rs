//! The last step of a bake: clusters in the order of the hierarchy, their buffers, and all tables.

use super::buffers::{self, Coordinates, Place, Source};
use super::charting::Tiles;
use super::grid::Grid;
use super::levels::LevelErrors;
use super::surface::Surface;
use super::{Clusters, Outside, Stage, for_clusters_with};
use crate::progressive_buffers::hierarchy;
use crate::progressive_buffers::layout::*;
use crate::progressive_buffers::model::{FLAG_COLORS, FLAG_INSTANCES};
use crate::progressive_buffers::write::BakedModel;
use glam::DVec3;
use pb_archive::ArchiveError;
use pb_mesh::numbering::Numbering;
use pb_mesh::simplify::Collapses;
use pb_mesh::topology::Kind;
use rayon::prelude::*;

/// The results of all earlier steps.
pub(super) struct Finished<'a> {
    pub surface: &'a Surface,
    pub triangles_in: u64,
    pub clusters: &'a Clusters,
    /// Where there are textures.
    pub tiles: Option<&'a Tiles>,
    pub collapses: &'a Collapses,
    pub errors: &'a [LevelErrors],
    pub levels: usize,
}

/// Orders the clusters, packs their buffers and fills all tables but those of textures. Returns the model, the clusters
/// of the segmentation in its order, and the average cache misses per triangle of each level.
pub(super) fn assemble(input: &Finished, outside: &Outside) -> Result<(BakedModel, Vec<u32>, Vec<f32>), ArchiveError> {
    let &Finished { surface, triangles_in, clusters, collapses, errors, levels, .. } = input;
    let (grid, count) = (&clusters.grid, clusters.segmentation.len());
    let bounds: Vec<Bounds> = (0..count)
        .into_par_iter()
        .map(|c| {
            Bounds::of(
                clusters.segmentation.cluster(c).iter().flat_map(|&t| surface.triangles[t as usize]),
                &grid.points,
            )
        })
        .collect();
    let spheres: Vec<(DVec3, f64)> = bounds.iter().map(|b| (b.center.as_dvec3(), b.radius as f64)).collect();
    let mut hierarchy = hierarchy::build_groups(&spheres, &clusters.objects.counts);
    let mut new_of = vec![0u32; count];
    hierarchy.order.iter().enumerate().for_each(|(new, &old)| new_of[old as usize] = new as u32);
    let (neighbours, firsts) = neighbour_lists(clusters, &new_of);
    let source = Source {
        wedges: &surface.wedges,
        triangles: surface.corners(),
        points: &grid.points,
        kinds: &clusters.kinds,
        collapses,
        uv: input.tiles.map(|t| Coordinates { corners: &t.corners, uv: &t.uv }),
        levels,
    };
    let build = |numbering: &mut Numbering, new: usize| {
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
        outside.try_kept("geometry", new as u32, || buffers::build(&source, &place, numbering, outside.spill))
    };
    let numbering = || Numbering::new(grid.points.len());
    let built: Result<Vec<_>, ArchiveError> =
        for_clusters_with(count, &|x| (outside.progress)(Stage::Pack, x), numbering, build).into_iter().collect();
    let (mut level_records, mut chunks) = (Vec::with_capacity(count * levels), Vec::with_capacity(count * levels));
    for (new, (mut records, packed)) in built?.into_iter().enumerate() {
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
    let (objects, instances) = clusters.objects.tables(&hierarchy, grid.origin, grid.quantum);
    let (model_levels, acmr) = model_levels(&level_records, errors, levels);
    let model = BakedModel {
        maps: Vec::new(),
        tiles: Vec::new(),
        record: ModelRecord {
            flags: if surface.has_colors { FLAG_COLORS } else { 0 }
                | if objects.is_empty() { 0 } else { FLAG_INSTANCES },
            ..model_record(triangles_in, grid, &bounds, levels)
        },
        objects,
        instances,
        clusters: (0..count).map(record).collect(),
        levels: level_records,
        neighbours,
        nodes: hierarchy.nodes.clone(),
        model_levels,
        chunks,
    };
    Ok((model, hierarchy.order, acmr))
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

/// But for the flags.
fn model_record(triangles_in: u64, grid: &Grid, bounds: &[Bounds], levels: usize) -> ModelRecord {
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
        flags: 0,
        reserved: [0; 5],
    }
}
