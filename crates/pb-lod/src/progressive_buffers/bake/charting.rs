//! Charts and tiles of a bake: every cluster is cut into charts, which are packed into its tile
//! (docs/decisions/007-textures.md). What comes out is integers; simplification and drawing use the very same.

use super::chart_part::Part;
use super::surface::Surface;
use super::{Clusters, Outside, Stage, TextureInput, for_clusters};
use pb_mesh::charts::{Charts, ClusterSurface};
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::Texturing;
use pb_mesh::simplify::UvInput;
use pb_mesh::texture::image::Image;
use rayon::prelude::*;

/// Default for [`ChartOptions::tile_size`]: as many texels as the source asks for.
pub const DEFAULT_TILE_SIZE: u32 = 4096;

/// Share of a tile that charts are expected to cover.
const EXPECTED_FILL: f64 = 0.55;
/// How much better a tile must be filled for smaller clusters.
const WORTH_HALVING: f64 = 1.5;
/// Halves differ a little in size.
const SEGMENT_SLACK: f64 = 1.02;
/// Texels of all tiles per texel of the images, at most: what an image that repeats is unrolled to.
const MAX_UNROLLING: f64 = 8.0;
/// Clusters do not get smaller than this for the sake of their tiles.
const MIN_CLUSTER_TRIANGLES: usize = 256;

/// Where charts come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChartMode {
    /// The source's where they are usable, new ones elsewhere; decided for every cluster.
    #[default]
    Best,
    /// The source's always.
    Source,
    /// New ones always.
    Auto,
}

/// Makes charts of a cluster in another way than the built-in one; `None` where it fails.
pub type Charter<'a> = &'a (dyn Fn(&ClusterSurface) -> Option<Charts> + Sync);

/// How charts and tiles are made.
#[derive(Clone, Copy)]
pub struct ChartOptions<'a> {
    /// Where charts come from.
    pub mode: ChartMode,
    /// Widest tile, texels: a power of two.
    pub tile_size: u32,
    /// Used for new charts before the built-in method.
    pub charter: Option<Charter<'a>>,
}

/// What came of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChartSummary {
    /// Clusters with the source's charts.
    pub source_clusters: u64,
    /// Clusters with new charts from the built-in method.
    pub auto_clusters: u64,
    /// Clusters with charts from the caller's method.
    pub given_clusters: u64,
    /// Why source charts were not used, and in how many clusters.
    pub reasons: Vec<(String, u64)>,
    /// All charts.
    pub charts: u64,
    /// Texels of all tiles at level 0.
    pub texels: u64,
    /// Share of them that charts cover.
    pub fill: f64,
    /// Clusters whose tile has fewer texels than the source asks for.
    pub reduced_clusters: u64,
}

/// The tiles of all clusters and the texture coordinates of the mesh.
pub(super) struct Tiles {
    /// Per triangle corner: UV wedge.
    pub corners: Vec<[u32; 3]>,
    /// Per UV wedge.
    pub position_of: Vec<u32>,
    /// Per UV wedge, units of 1/65536 tile.
    pub uv: Vec<[u16; 2]>,
    /// Per cluster: length of the tile's side on the surface, quanta.
    pub side: Vec<f32>,
    /// Per cluster.
    pub tiles: Vec<ClusterTile>,
}

/// The tile of one cluster.
pub(super) struct ClusterTile {
    /// Texels per side.
    pub size: u32,
    /// Texture coordinates per corner, in the order of the cluster's triangles.
    pub corners: Vec<[[u16; 2]; 3]>,
    /// Chart per triangle, in the same order.
    pub chart_of: Vec<u32>,
    /// Side of most texels on the surface at most, quanta.
    pub texel: f32,
    /// Length of the tile's side on the surface, quanta.
    pub side: f32,
    /// How many.
    pub charts: u32,
    /// Share of the texels that they cover.
    pub fill: f64,
    /// Fewer texels than the source asks for.
    pub reduced: bool,
    /// Where they come from.
    pub origin: Origin,
}

/// Where the charts of a cluster come from.
pub(super) enum Origin {
    Source,
    /// Built in; why not the source's, if they were asked for.
    Auto(Option<String>),
    Given,
}

/// What charts are made from.
pub(super) struct ChartInput<'a> {
    pub surface: &'a Surface,
    pub clusters: &'a Clusters,
    pub materials: &'a [Material],
    pub images: &'a [Option<Image>],
    /// Tiles hold the normals of the finest level.
    pub normals: bool,
    /// See [`Sizing::scale`].
    pub scale: f64,
}

/// How dense a model's tiles are, and how large its clusters.
#[derive(Clone, Copy)]
pub(super) struct Sizing {
    /// Triangles per cluster at most: the texels of a cluster should fill a tile well, which has a power of two of texels
    /// per side; a few more than fit would quadruple it.
    pub cluster_triangles: usize,
    /// Texels of tiles per texel of the source along an axis: 1, or one half so many times that small images which repeat
    /// many times over the surface are not unrolled to too many texels.
    pub scale: f64,
}

/// Sizes clusters of `most` triangles at most.
pub(super) fn sizing(surface: &Surface, textures: &TextureInput, most: usize) -> Sizing {
    let texturing = surface.texturing.as_ref().expect("only textured meshes have tiles");
    let texels = |t: usize| {
        let Some((uv, _)) = source_texels(texturing, textures.materials, textures.images, t) else { return 0.0 };
        let [a, b, c] = uv.map(|p| p.map(f64::from));
        ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs() / 2.0
    };
    const BLOCK: usize = 1 << 14;
    let count = surface.triangles.len();
    let block = |from: usize| (from..(from + BLOCK).min(count)).map(texels).filter(|x| x.is_finite()).sum::<f64>();
    let starts: Vec<usize> = (0..count).step_by(BLOCK).collect();
    let per_triangle = starts.into_par_iter().map(block).collect::<Vec<f64>>().iter().sum::<f64>() / count as f64;
    let images = textures.images.iter().flatten().map(|i| f64::from(i.width()) * f64::from(i.height()));
    let scale = (MAX_UNROLLING * images.sum::<f64>() / (per_triangle * count as f64)).sqrt().min(1.0);
    let scale = if scale > 0.0 { scale.log2().floor().exp2() } else { 1.0 };
    let per_triangle = per_triangle * scale * scale;
    let sizing = |cluster_triangles| Sizing { cluster_triangles, scale };
    // The segmentation halves: clusters have about so many triangles.
    let halved = |times: u32| (count as f64 / 2f64.powi(times as i32)).ceil();
    let first = (0..32).find(|&k| halved(k) <= most as f64).expect("2^31 triangles at most");
    // The share of the smallest tile that holds a cluster; above the widest tile's for clusters that are too large.
    let fill = |triangles: f64| {
        let texels = triangles * per_triangle;
        let size = (texels / EXPECTED_FILL).sqrt().log2().ceil().exp2();
        texels / size.clamp(4.0, textures.charts.tile_size.into()).powi(2)
    };
    let fits = |k: &u32| fill(halved(*k)) <= EXPECTED_FILL;
    let start = (first..32).find(|k| fits(k) || halved(*k) <= MIN_CLUSTER_TRIANGLES as f64).unwrap_or(first);
    // Half the size again only where that fills tiles much better.
    let best = if fill(halved(start + 1)) > WORTH_HALVING * fill(halved(start)) { start + 1 } else { start };
    let wanted = halved(best) * SEGMENT_SLACK;
    sizing((wanted as usize).clamp(MIN_CLUSTER_TRIANGLES.min(most), most))
}

/// Where the corners of a triangle lie on the image that its charts come from, in texels, and its material; `None`
/// without an image.
pub(super) fn source_texels(
    texturing: &Texturing,
    materials: &[Material],
    images: &[Option<Image>],
    t: usize,
) -> Option<([[f32; 2]; 3], u32)> {
    let material = texturing.material_of[t];
    let texture = materials.get(material as usize).and_then(chart_texture)?;
    let image = images[texture.image as usize].as_ref()?;
    let size = [image.width() as f32, image.height() as f32];
    let uv = texturing.corner_uvs.get(texture.uv_set as usize).map_or([[0.0; 2]; 3], |set| set[t]);
    Some((uv.map(|uv| std::array::from_fn(|k| texture.apply(uv)[k] * size[k])), material))
}

/// The image whose coordinates make the charts of a material: that of the colour where there is one.
fn chart_texture(material: &Material) -> Option<&TextureRef> {
    const ORDER: [Slot; 5] = [Slot::BaseColor, Slot::Emissive, Slot::Normal, Slot::MetallicRoughness, Slot::Occlusion];
    ORDER.iter().find_map(|&slot| material.texture(slot))
}

/// Charts and packs all clusters.
pub(super) fn make_tiles(input: &ChartInput, options: &ChartOptions, outside: &Outside) -> Tiles {
    let texturing = input.surface.texturing.as_ref().expect("only textured meshes have tiles");
    let count = input.clusters.segmentation.len();
    let tile = |c: usize| outside.kept("charts", c as u32, || Part::new(input, texturing, c).tile(options));
    let tiles = for_clusters(count, &|x| (outside.progress)(Stage::Charts, x), tile);
    number(input, tiles)
}

/// Gives UV wedges their numbers: cluster after cluster, ascending by position.
fn number(input: &ChartInput, tiles: Vec<ClusterTile>) -> Tiles {
    let mut out = Tiles {
        corners: vec![[0; 3]; input.surface.triangles.len()],
        position_of: Vec::new(),
        uv: Vec::new(),
        side: tiles.iter().map(|t| t.side).collect(),
        tiles: Vec::new(),
    };
    for (c, tile) in tiles.iter().enumerate() {
        let members = input.clusters.segmentation.cluster(c);
        let mut corners: Vec<(u32, u32, [u16; 2], u32, u8)> = Vec::with_capacity(members.len() * 3);
        for (i, &t) in members.iter().enumerate() {
            let corner =
                |k: usize| (input.surface.triangles[t as usize][k], tile.chart_of[i], tile.corners[i][k], t, k as u8);
            corners.extend((0..3).map(corner));
        }
        corners.sort_unstable();
        for (i, &(position, chart, uv, t, k)) in corners.iter().enumerate() {
            if i == 0 || (corners[i - 1].0, corners[i - 1].1, corners[i - 1].2) != (position, chart, uv) {
                out.position_of.push(position);
                out.uv.push(uv);
            }
            out.corners[t as usize][k as usize] = out.uv.len() as u32 - 1;
        }
    }
    out.tiles = tiles;
    out
}

impl Tiles {
    /// For the simplification.
    pub fn uv_input(&self) -> UvInput<'_> {
        UvInput { corners: &self.corners, position_of: &self.position_of, uv: &self.uv, tile_side: &self.side }
    }

    /// Counts for reports.
    pub fn summary(&self) -> ChartSummary {
        let mut sum = ChartSummary::default();
        let mut covered = 0.0;
        for tile in &self.tiles {
            let texels = u64::from(tile.size) * u64::from(tile.size);
            sum.charts += u64::from(tile.charts);
            sum.texels += texels;
            sum.reduced_clusters += u64::from(tile.reduced);
            covered += tile.fill * texels as f64;
            match &tile.origin {
                Origin::Source => sum.source_clusters += 1,
                Origin::Given => sum.given_clusters += 1,
                Origin::Auto(why) => {
                    sum.auto_clusters += 1;
                    if let Some(why) = why {
                        match sum.reasons.iter_mut().find(|r| r.0 == *why) {
                            Some(known) => known.1 += 1,
                            None => sum.reasons.push((why.clone(), 1)),
                        }
                    }
                }
            }
        }
        sum.fill = covered / sum.texels.max(1) as f64;
        sum
    }
}
