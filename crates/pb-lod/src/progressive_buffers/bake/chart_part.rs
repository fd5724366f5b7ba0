//! One cluster on its way to a tile: which charts it gets, at which density.

use super::charting::{ChartInput, ChartMode, ChartOptions, ClusterTile, Origin, source_texels};
use glam::{DVec2, DVec3, IVec3};
use pb_mesh::charts::{AutoOptions, Charts, ClusterSurface, Fit, PackOptions, auto_charts, pack, source_charts};
use pb_mesh::mesh::Texturing;
use std::collections::BTreeMap;

/// Keys of triangles without an image start here: they never share a chart with others.
const PLAIN: u32 = 1 << 31;
/// Where vertex colours are all there is, a tile has this many texels per mean edge length.
const TEXELS_PER_EDGE: f64 = 2.0;
/// Where the finest normals are kept, a tile has at least this many texels per mean edge length.
const NORMAL_TEXELS_PER_EDGE: f64 = 1.5;
/// Share of a surface whose texels are at most as large as a tile's or a chart's texel size says.
const TEXEL_PERCENTILE: f64 = 0.95;
/// New charts may be this much sparser than their source, where the next larger tile would be four times as many texels.
const MIN_SCALE: f32 = 0.85;
/// The same where nothing but normals asks for texels.
const MIN_NORMAL_SCALE: f32 = 0.7;
/// New charts are this much denser than asked for, where the tile has room for it: resampling blurs less so.
const MAX_FILLING: f32 = 2.0;
/// Texels of new charts per texel of the source, at most.
const MAX_OVERSAMPLING: f64 = 1.25;
/// Tiles of fewer texels than this are made denser than their source, which keeps resampling from blurring them.
const SMALL_TILE_TEXELS: f64 = 65_536.0;
/// By this factor at most.
const MAX_SMALL_SCALE: f64 = 2.0;
/// Share of a chart that is sampled at least as densely as its source.
const DENSITY_PERCENTILE: f64 = 0.9;

/// A cluster in local indices, with what the source says about its triangles.
pub(super) struct Part {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Texels of the source per corner; all equal where there is no image.
    texels: Vec<[[f32; 2]; 3]>,
    /// Triangles of different keys have different images, or colours of the vertices jump between them.
    keys: Vec<u32>,
    /// See [`Sizing::scale`](super::charting::Sizing::scale).
    scale: f64,
    /// Some triangle without an image has corners of different colours.
    shaded: bool,
    /// Every triangle needs texels, for its normals.
    normals: bool,
}

impl Part {
    /// Cluster `c` of the input.
    pub fn new(input: &ChartInput, texturing: &Texturing, c: usize) -> Part {
        let members = input.clusters.segmentation.cluster(c);
        let mut global: Vec<u32> = members.iter().flat_map(|&t| input.surface.triangles[t as usize]).collect();
        global.sort_unstable();
        global.dedup();
        let point = |v: u32| IVec3::from_array(input.clusters.grid.points[v as usize]);
        let origin = point(global[0]);
        let local = |v: u32| global.binary_search(&v).expect("collected above") as u32;
        let mut part = Part {
            positions: global.iter().map(|&v| (point(v) - origin).as_vec3().to_array()).collect(),
            triangles: members.iter().map(|&t| input.surface.triangles[t as usize].map(local)).collect(),
            texels: Vec::with_capacity(members.len()),
            keys: Vec::with_capacity(members.len()),
            scale: input.scale,
            shaded: false,
            normals: input.normals,
        };
        let mut plain_looks: BTreeMap<(u32, [u8; 4]), u32> = BTreeMap::new();
        let mut image_looks: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let hues = part.hues(input, members);
        for (i, &t) in members.iter().enumerate() {
            let material = texturing.material_of[t as usize];
            match source_texels(texturing, input.materials, input.images, t as usize) {
                Some((texels, material)) => {
                    let next = image_looks.len() as u32;
                    part.texels.push(texels);
                    part.keys.push(*image_looks.entry((material, hues[i])).or_insert(next));
                }
                None => {
                    let colors = input.surface.corners()[t as usize].map(|w| input.surface.wedges[w as usize].color);
                    part.shaded |= colors[0] != colors[1] || colors[1] != colors[2];
                    let next = plain_looks.len() as u32;
                    let number = *plain_looks.entry((material, colors[0])).or_insert(next);
                    part.texels.push([[0.0; 2]; 3]);
                    part.keys.push(PLAIN + number);
                }
            }
        }
        part
    }

    /// Parts of the cluster over which the colours of the vertices do not jump, by triangle. A texel of a chart cannot show
    /// two colours, and where an image is stretched over the surface a texel is wide.
    fn hues(&self, input: &ChartInput, members: &[u32]) -> Vec<u32> {
        let mut hues: Vec<u32> = (0..members.len() as u32).collect();
        if !input.surface.has_colors {
            return vec![0; members.len()];
        }
        fn root(hues: &mut [u32], mut t: u32) -> u32 {
            while hues[t as usize] != t {
                hues[t as usize] = hues[hues[t as usize] as usize];
                t = hues[t as usize];
            }
            t
        }
        let color = |t: usize, k: usize| {
            let wedge = input.surface.corners()[members[t] as usize][k];
            input.surface.wedges[wedge as usize].color
        };
        let mut edges: BTreeMap<[(u32, [u8; 4]); 2], u32> = BTreeMap::new();
        for (t, corners) in self.triangles.iter().enumerate() {
            for k in 0..3 {
                let mut edge = [k, (k + 1) % 3].map(|k| (corners[k], color(t, k)));
                edge.sort_unstable();
                let other = *edges.entry(edge).or_insert(t as u32);
                let (a, b) = (root(&mut hues, t as u32), root(&mut hues, other));
                // The smallest is the root.
                hues[a.max(b) as usize] = a.min(b);
            }
        }
        (0..members.len() as u32).map(|t| root(&mut hues, t)).collect()
    }

    fn surface(&self) -> ClusterSurface<'_> {
        ClusterSurface { positions: &self.positions, triangles: &self.triangles }
    }

    /// Cuts the cluster into charts and packs them.
    pub fn tile(&self, options: &ChartOptions) -> ClusterTile {
        let (charts, origin) = self.charts(options);
        let source = vec![self.scale as f32; charts.count as usize];
        let (densities, fit, least) = match origin {
            Origin::Source => (source, Fit::WholeTexels, 1.0),
            _ if self.only_normals() => (self.densities(&charts), Fit::Free, MIN_NORMAL_SCALE),
            // More than asked for, and as little as asked for is enough: what is left of the tile is made use of.
            _ => {
                (self.densities(&charts).iter().map(|d| d * MAX_FILLING).collect(), Fit::Free, MIN_SCALE / MAX_FILLING)
            }
        };
        let packed = pack(&charts, &densities, &PackOptions { max_size: options.tile_size, fit, min_scale: least });
        let (texel, side) = self.texel_sizes(&packed.corners, packed.size);
        ClusterTile {
            size: packed.size,
            texel,
            side,
            charts: packed.count,
            fill: packed.fill,
            reduced: packed.scale < f64::from(least),
            origin,
            corners: packed.corners,
            chart_of: packed.chart_of,
        }
    }

    /// No colour asks for texels.
    fn only_normals(&self) -> bool {
        self.normals && !self.shaded && self.keys.iter().all(|&key| key >= PLAIN)
    }

    fn charts(&self, options: &ChartOptions) -> (Charts, Origin) {
        let mut why = None;
        if options.mode != ChartMode::Auto {
            let (charts, report) = source_charts(&self.surface(), &self.texels, &self.keys);
            let plain = self.keys.iter().filter(|&&key| key >= PLAIN).count();
            let usable = match () {
                _ if self.shaded => Err("vertex colours without an image".to_string()),
                _ if self.normals && plain > 0 => Err("normals without an image".to_string()),
                _ => report.usable(),
            };
            match usable {
                // Normals of two places cannot share texels.
                _ if options.mode == ChartMode::Source && !self.normals => return (charts, Origin::Source),
                Ok(()) => return (charts, Origin::Source),
                Err(_) if self.normals && plain == self.keys.len() => {}
                // Counts differ from cluster to cluster; what they are of does not.
                Err(reason) => why = reason.split(':').next().map(str::to_owned),
            }
        }
        match options.charter.and_then(|charter| charter(&self.surface())) {
            Some(charts) => (charts, Origin::Given),
            None => (auto_charts(&self.surface(), &AutoOptions::default(), None).0, Origin::Auto(why)),
        }
    }

    fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| DVec3::from(self.positions[v as usize].map(f64::from)))
    }

    /// Texels per unit of every chart, so that nearly all of it is as dense as its source.
    fn densities(&self, charts: &Charts) -> Vec<f32> {
        let edges = (0..self.triangles.len()).flat_map(|t| {
            let [a, b, c] = self.corners(t);
            [a.distance(b), b.distance(c), c.distance(a)]
        });
        let per_edge = (3 * self.triangles.len()) as f64 / edges.sum::<f64>().max(f64::MIN_POSITIVE);
        let least = if self.normals { NORMAL_TEXELS_PER_EDGE * per_edge } else { 0.0 };
        let plain = if self.shaded { TEXELS_PER_EDGE * per_edge } else { least };
        let mut samples: Vec<Vec<(f64, f64)>> = vec![Vec::new(); charts.count as usize];
        for t in 0..self.triangles.len() {
            let uv = self.texels[t].map(|p| DVec2::new(p[0].into(), p[1].into()));
            let area = area2(self.corners(t));
            let density = match self.keys[t] >= PLAIN {
                true => plain,
                false => ((uv[1] - uv[0]).perp_dot(uv[2] - uv[0]).abs() / area).sqrt(),
            };
            if density.is_finite() {
                samples[charts.chart_of[t] as usize].push((density.max(least), area));
            }
        }
        let texels = |density: f64, area: f64| density * density * area;
        let asked: f64 = samples.iter().flatten().map(|&(density, area)| texels(density, area)).sum();
        let densities = samples.iter_mut().map(|s| percentile(s, DENSITY_PERCENTILE).unwrap_or(0.0));
        let densities: Vec<f64> = densities.collect();
        let whole = |s: &Vec<(f64, f64)>| s.iter().map(|x| x.1).sum::<f64>();
        let given: f64 = samples.iter().zip(&densities).map(|(s, &density)| texels(density, whole(s))).sum();
        // Where density varies much, all of it at its highest would be many times the texels of the source.
        let given = given.max(f64::MIN_POSITIVE);
        let scale = match (SMALL_TILE_TEXELS / given).sqrt() {
            _ if self.only_normals() => 1.0,
            roomy if roomy > 1.0 => roomy.min(MAX_SMALL_SCALE),
            _ => (MAX_OVERSAMPLING * asked / given).sqrt().min(1.0),
        };
        densities.iter().map(|d| (d * scale * self.scale).max(1e-9) as f32).collect()
    }

    /// Side of most texels on the surface at most, and length of the tile's side on the surface; quanta.
    fn texel_sizes(&self, corners: &[[[u16; 2]; 3]], size: u32) -> (f32, f32) {
        let unit = f64::from(size) / 65_536.0;
        let (mut samples, mut area, mut texels) = (Vec::with_capacity(corners.len()), 0.0, 0.0);
        for (t, corners) in corners.iter().enumerate() {
            let uv = corners.map(|p| DVec2::new(p[0].into(), p[1].into()) * unit);
            let stretch = largest_stretch(self.corners(t), uv);
            if stretch.is_finite() {
                let a = area2(self.corners(t));
                samples.push((stretch, a));
                area += a;
                texels += (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
            }
        }
        // A tile of one colour is as good as any other at any distance.
        let Some(texel) = percentile(&mut samples, TEXEL_PERCENTILE) else { return (f32::MAX / 1e6, 1.0) };
        let side = f64::from(size) * (area / texels).sqrt();
        ((texel as f32).max(f32::MIN_POSITIVE), (side as f32).max(f32::MIN_POSITIVE))
    }
}

/// Twice the area of a triangle.
fn area2([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length()
}

/// The largest singular value of the map from (u, v) to the surface (Sander et al. 2001, section 3); infinite where there
/// is none.
fn largest_stretch(p: [DVec3; 3], uv: [DVec2; 3]) -> f64 {
    let (s, t) = (uv[1] - uv[0], uv[2] - uv[0]);
    let area = s.perp_dot(t);
    let (e, f) = (p[1] - p[0], p[2] - p[0]);
    let (du, dv) = ((e * t.y - f * s.y) / area, (f * s.x - e * t.x) / area);
    let (a, b, c) = (du.length_squared(), du.dot(dv), dv.length_squared());
    let largest = ((a + c) / 2.0 + ((a - c) / 2.0).hypot(b)).sqrt();
    if area == 0.0 || !largest.is_finite() { f64::INFINITY } else { largest }
}

/// The value that this share of the weight is at most; (value, weight) pairs.
fn percentile(samples: &mut [(f64, f64)], share: f64) -> Option<f64> {
    samples.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = samples.iter().map(|s| s.1).sum();
    let mut sum = 0.0;
    let at = samples.iter().position(|s| {
        sum += s.1;
        sum >= total * share
    });
    at.map(|i| samples[i].0)
}
