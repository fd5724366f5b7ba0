//! From the textured surface of one cluster to the finest mip of its tile, for one map.

use super::color::{Coding, SRGB, Texels};
use super::coverage::{Coverage, NOBODY, NONE, TileLayout};
use super::image::Image;
use super::mips::{Mips, coarser};
use super::normal::{Derivatives, in_tile, perturbed};
use super::raster::Grid;
use super::sample::{Footprint, Light, Rim, Sampler};
use super::veil;
use crate::charts::tile_area2;
use crate::material::{Material, Slot, TextureRef};
use glam::{DMat2, DVec2, DVec3, Vec3, Vec4};

/// Corners that are less sure than this, in source texels per texel, are not extrapolated.
const MAX_EXTRAPOLATED_ERROR: f64 = 0.25;

/// The textured surface that tiles are made from: the finest triangles of one cluster.
///
/// Lists are per triangle and per corner, in the order of the layout.
#[derive(Clone, Copy, Debug)]
pub struct TileSource<'a> {
    /// Those of the scene.
    pub materials: &'a [Material],
    /// Those of the scene; a material whose image is `None` looks as if it had none.
    pub images: &'a [Option<Image>],
    /// Empty: the default material everywhere.
    pub material_of: &'a [u32],
    /// Per set of texture coordinates.
    pub uv_sets: &'a [Vec<[[f32; 2]; 3]>],
    /// sRGB, straight alpha; empty: white.
    pub colors: &'a [[[u8; 4]; 3]],
    /// Shading normals, unit length; empty: those of the triangles. Used by normal maps only.
    pub normals: &'a [[[f32; 3]; 3]],
    /// Used by normal maps only; empty: normals are flat.
    pub positions: &'a [[[f32; 3]; 3]],
}

/// What a map says about the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MapKind {
    /// Image times vertex colour; alpha below one half is a hole where the material is cut out, else alpha is 1.
    BaseColor,
    /// Red: occlusion, green: roughness, blue: metalness.
    Orm,
    /// The shading normal.
    Normal,
    /// Emitted light.
    Emissive,
}

impl MapKind {
    /// Whether some of the materials makes the map differ from what a viewer takes without it.
    pub fn is_used_by(self, materials: &[Material]) -> bool {
        let has = |slot: Slot| materials.iter().any(|m| m.texture(slot).is_some());
        match self {
            MapKind::BaseColor => true,
            MapKind::Orm => {
                let plain = |m: &Material| m.metallic == 0.0 && m.roughness == 1.0;
                has(Slot::MetallicRoughness) || has(Slot::Occlusion) || !materials.iter().all(plain)
            }
            MapKind::Normal => has(Slot::Normal),
            MapKind::Emissive => materials.iter().any(|m| m.emissive != [0.0; 3]),
        }
    }

    /// Whether the map needs more than 8 bits: an HDR image, or light above 1.
    pub fn is_hdr(self, materials: &[Material], images: &[Option<Image>]) -> bool {
        let image = |m: &Material, slot| m.texture(slot).and_then(|t| images.get(t.image as usize)?.as_ref());
        let hdr = |slot| materials.iter().any(|m| image(m, slot).is_some_and(|i| i.format().is_hdr()));
        match self {
            MapKind::BaseColor => hdr(Slot::BaseColor),
            MapKind::Emissive => hdr(Slot::Emissive) || materials.iter().flat_map(|m| m.emissive).any(|e| e > 1.0),
            MapKind::Orm | MapKind::Normal => false,
        }
    }
}

/// How a normal map is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalSpace {
    /// x and y in the tile's tangent frame.
    #[default]
    Tangent,
    /// x, y, z of the model: coarse levels shade with the normals of the finest.
    Object,
}

/// Choices that are the same for all tiles of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BakeOptions {
    /// Base colour and emission in half floats; see [`MapKind::is_hdr`].
    pub hdr: bool,
    /// Of normal maps.
    pub normal_space: NormalSpace,
}

impl BakeOptions {
    fn coding(self, map: MapKind) -> Coding {
        match (map, self.normal_space) {
            (MapKind::Orm, _) => Coding::Linear8,
            (MapKind::Normal, NormalSpace::Tangent) => Coding::Normal2,
            (MapKind::Normal, NormalSpace::Object) => Coding::Normal3,
            _ if self.hdr => Coding::Half,
            _ => Coding::Srgb8,
        }
    }
}

/// Bytes that a [`Coverage`] and one call of [`bake_tile`] hold at most for a tile of `size` texels per side, but for what
/// charts have along their borders; `hdr`: of half floats.
pub fn scratch_bytes(size: u32, hdr: bool) -> u64 {
    // Owners, nearest texels and texels of every mip; triangles of the finest, and parts of the third and on.
    let texel = if hdr { 8 } else { 4 };
    let texels = u64::from(size) * u64::from(size);
    texels * (2 + 4 + texel) * 4 / 3 + texels * 3
}

/// Makes the mip chain of one map of a tile. A map of one value has a single mip of 4 texels.
///
/// Texels as large as the source's whose centres coincide with those of the source are copies; larger ones are averages
/// over their area, smaller ones are interpolated; all in linear light. Beyond closed edges nothing of the source is used.
///
/// # Panics
/// When lists that are not empty do not have one entry per triangle of the layout, or `coverage` is of another layout.
pub fn bake_tile(
    source: &TileSource,
    layout: &TileLayout,
    coverage: &Coverage,
    map: MapKind,
    options: BakeOptions,
) -> Mips {
    let count = layout.corners.len();
    let fits = |len: usize| len == 0 || len == count;
    assert!(fits(source.material_of.len()) && fits(source.colors.len()), "materials and colours per triangle");
    assert!(fits(source.normals.len()) && fits(source.positions.len()), "normals and positions per triangle");
    assert!(source.uv_sets.iter().all(|set| set.len() == count), "texture coordinates per triangle");
    assert_eq!(coverage.size(), layout.size, "the coverage of this layout");
    let baker = Baker { source, layout, map, options, default: Material::default() };
    let coding = options.coding(map);
    let mut texels = Texels::zeros(coding, (layout.size * layout.size) as usize);
    baker.fill_insides(coverage, |texel, value| texels.set(coding, texel as usize, value));
    baker.fill_borders(coverage, |texel, value| texels.set(coding, texel as usize, value));
    let cut_out = map == MapKind::BaseColor && source.materials.iter().any(|m| m.alpha_cutoff.is_some());
    match only_value(&texels, coverage, coding) {
        Some(value) => Mips::constant(coding, value),
        None => coarser(coverage, coding, texels, cut_out),
    }
}

/// The value of all texels that some chart owns, if they have the same bits; black where there are none.
fn only_value(texels: &Texels, coverage: &Coverage, coding: Coding) -> Option<Vec4> {
    fn same<T: PartialEq>(texels: &[T], mut owned: impl Iterator<Item = usize>) -> Option<Option<usize>> {
        let Some(first) = owned.next() else { return Some(None) };
        owned.all(|i| texels[i] == texels[first]).then_some(Some(first))
    }
    let owned = coverage.owners(0).iter().enumerate().filter(|(_, o)| **o != NOBODY).map(|(i, _)| i);
    let first = match texels {
        Texels::Rgba8(t) => same(t, owned),
        Texels::Rg8(t) => same(t, owned),
        Texels::RgbaF16(t) => same(t, owned),
    }?;
    let nothing = if coding.is_normal() { Vec4::Z } else { Vec4::W };
    Some(first.map_or(nothing, |i| texels.get(coding, i)))
}

struct Baker<'a> {
    source: &'a TileSource<'a>,
    layout: &'a TileLayout<'a>,
    map: MapKind,
    options: BakeOptions,
    default: Material,
}

impl<'a> Baker<'a> {
    fn fill_insides(&self, coverage: &Coverage, mut set: impl FnMut(u32, Vec4)) {
        let size = self.layout.size;
        let mut rim = Vec::new();
        for (triangle, corners) in self.layout.corners.iter().enumerate() {
            if self.layout.chart_of[triangle] == NONE {
                continue;
            }
            let mut patch = None;
            Grid { size }.inside(*corners, |x, y| {
                let texel = y * size + x;
                if coverage.triangles[texel as usize] == triangle as u16 {
                    let patch = patch.get_or_insert_with(|| self.patch(triangle));
                    let at = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
                    self.rim(coverage, texel, &mut rim);
                    set(texel, patch.value(patch.shape.weights(at), &rim));
                }
            });
        }
    }

    /// The texels around charts: beyond open edges the image goes on, at others it is that of the nearest point.
    fn fill_borders(&self, coverage: &Coverage, mut set: impl FnMut(u32, Vec4)) {
        let size = self.layout.size;
        let mut rim = Vec::new();
        for group in coverage.border.chunk_by(|a, b| a.triangle == b.triangle) {
            let triangle = group[0].triangle as usize;
            let patch = self.patch(triangle);
            let open = self.layout.open_edges.get(triangle).copied().unwrap_or(0);
            for border in group {
                let at = DVec2::new(f64::from(border.texel % size), f64::from(border.texel / size)) + 0.5;
                if open & (1 << border.edge) != 0 && patch.shape.tolerance <= MAX_EXTRAPOLATED_ERROR {
                    set(border.texel, patch.value(patch.shape.weights(at), &[]));
                } else {
                    self.rim(coverage, border.texel, &mut rim);
                    set(border.texel, patch.value(patch.shape.nearest_weights(at), &rim));
                }
            }
        }
    }

    /// The closed edges of its chart near a texel, in texels, the chart on the side of positive cross products.
    fn rim(&self, coverage: &Coverage, texel: u32, rim: &mut Vec<[DVec2; 2]>) {
        rim.clear();
        rim.extend(coverage.rim(texel).iter().map(|&(_, (triangle, edge))| {
            let corners = self.layout.corners[triangle as usize];
            let unit = f64::from(self.layout.size) / 65536.0;
            let at = |k: usize| DVec2::new(f64::from(corners[k][0]), f64::from(corners[k][1])) * unit;
            let ends = [at(usize::from(edge)), at((usize::from(edge) + 1) % 3)];
            if tile_area2(corners) < 0 { [ends[1], ends[0]] } else { ends }
        }));
    }

    fn patch(&self, triangle: usize) -> Patch<'_> {
        let shape = Shape::new(self.layout.corners[triangle], self.layout.size);
        let material = match self.source.material_of.get(triangle) {
            Some(&m) => self.source.materials.get(m as usize).unwrap_or(&self.default),
            None => &self.default,
        };
        let slots = match self.map {
            MapKind::BaseColor => [Some(Slot::BaseColor), None],
            MapKind::Orm => [Some(Slot::Occlusion), Some(Slot::MetallicRoughness)],
            MapKind::Normal => [Some(Slot::Normal), None],
            MapKind::Emissive => [Some(Slot::Emissive), None],
        };
        let lookups = slots.map(|s| s.and_then(|s| self.lookup(triangle, material, s, &shape)));
        let linear = |c: [u8; 4]| {
            let [r, g, b, a] = c.map(usize::from);
            Vec4::new(SRGB[r], SRGB[g], SRGB[b], a as f32 / 255.0)
        };
        let colors = self.source.colors.get(triangle).map(|c| c.map(linear));
        let surface =
            (self.map == MapKind::Normal).then(|| self.surface(triangle, &shape, lookups[0].as_ref())).flatten();
        Patch { map: self.map, space: self.options.normal_space, material, shape, lookups, colors, surface }
    }

    fn lookup(&self, triangle: usize, material: &Material, slot: Slot, shape: &Shape) -> Option<Lookup<'a>> {
        let reference: &TextureRef = material.texture(slot)?;
        let image = self.source.images.get(reference.image as usize)?.as_ref()?;
        let uvs = self.source.uv_sets.get(reference.uv_set as usize)?[triangle];
        let light = if matches!(slot, Slot::BaseColor | Slot::Emissive) { Light::Srgb } else { Light::Linear };
        let by_alpha = slot == Slot::BaseColor && material.alpha_cutoff.is_some();
        let sampler = Sampler::new(image, reference, light, by_alpha);
        let places = uvs.map(|uv| sampler.place(reference, uv));
        let footprint = shape.footprint(places);
        Some(Lookup { sampler, places, footprint })
    }

    fn surface(&self, triangle: usize, shape: &Shape, lookup: Option<&Lookup>) -> Option<Surface> {
        let positions = self.source.positions.get(triangle)?.map(|p| DVec3::from_array(p.map(f64::from)));
        let flat = (positions[1] - positions[0]).cross(positions[2] - positions[0]).normalize_or(DVec3::Z).as_vec3();
        let normals = self.source.normals.get(triangle).map_or([flat; 3], |n| n.map(Vec3::from_array));
        let tile = Derivatives::of(positions, shape.corners);
        let image = lookup.and_then(|l| Derivatives::of(positions, l.places));
        Some(Surface { flat, normals, tile, image })
    }
}

/// A triangle in the tile.
struct Shape {
    /// In texels.
    corners: [DVec2; 3],
    /// Twice the signed area in texels; 0 for flat triangles.
    area: f64,
    /// How far the rounding of corners may change the slope of an affine map, parts of 1.
    tolerance: f64,
}

impl Shape {
    fn new(corners: [[u16; 2]; 3], size: u32) -> Shape {
        let unit = f64::from(size) / 65536.0;
        let area = tile_area2(corners) as f64 * unit * unit;
        let corners = corners.map(|c| DVec2::new(f64::from(c[0]), f64::from(c[1])) * unit);
        let longest = (0..3).map(|k| corners[k].distance(corners[(k + 1) % 3])).fold(0.0, f64::max);
        let tolerance = if area == 0.0 { f64::INFINITY } else { unit * longest / area.abs() };
        Shape { corners, area, tolerance }
    }

    /// Barycentric coordinates, negative outside.
    fn weights(&self, at: DVec2) -> [f64; 3] {
        if self.area == 0.0 {
            return self.nearest_weights(at);
        }
        let [a, b, c] = self.corners;
        let (v, w) = ((at - a).perp_dot(c - a) / self.area, (b - a).perp_dot(at - a) / self.area);
        [1.0 - v - w, v, w]
    }

    /// Barycentric coordinates of the triangle's point that is nearest to a point outside.
    fn nearest_weights(&self, at: DVec2) -> [f64; 3] {
        let mut best = (f64::INFINITY, [1.0, 0.0, 0.0]);
        for k in 0..3 {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
            let along = b - a;
            let length = along.length_squared();
            let t = if length > 0.0 { ((at - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
            let distance = at.distance_squared(a + along * t);
            if distance < best.0 {
                let mut weights = [0.0; 3];
                weights[k] = 1.0 - t;
                weights[(k + 1) % 3] = t;
                best = (distance, weights);
            }
        }
        best.1
    }

    fn footprint(&self, places: [DVec2; 3]) -> Footprint {
        if self.area == 0.0 {
            return Footprint::new(DMat2::ZERO, 0.0);
        }
        let tile = DMat2::from_cols(self.corners[1] - self.corners[0], self.corners[2] - self.corners[0]);
        let image = DMat2::from_cols(places[1] - places[0], places[2] - places[0]);
        Footprint::new(image * tile.inverse(), self.tolerance)
    }
}

struct Lookup<'a> {
    sampler: Sampler<'a>,
    /// Of the corners, in source texels.
    places: [DVec2; 3],
    footprint: Footprint,
}

struct Surface {
    flat: Vec3,
    normals: [Vec3; 3],
    tile: Option<Derivatives>,
    image: Option<Derivatives>,
}

/// All that the texels of one triangle have in common.
struct Patch<'a> {
    map: MapKind,
    space: NormalSpace,
    material: &'a Material,
    shape: Shape,
    lookups: [Option<Lookup<'a>>; 2],
    colors: Option<[Vec4; 3]>,
    surface: Option<Surface>,
}

impl Patch<'_> {
    /// The map's value in linear light, or the normal, at barycentric coordinates; `rim`: closed edges that are near.
    fn value(&self, weights: [f64; 3], rim: &[[DVec2; 2]]) -> Vec4 {
        match self.map {
            MapKind::BaseColor => self.base_color(weights, rim),
            MapKind::Orm => {
                let occlusion = self.image(0, weights, rim).x;
                let other = self.image(1, weights, rim);
                let occlusion = 1.0 + self.material.occlusion_strength * (occlusion - 1.0);
                Vec4::new(occlusion, self.material.roughness * other.y, self.material.metallic * other.z, 1.0)
            }
            MapKind::Normal => self.normal(weights, rim).extend(1.0),
            MapKind::Emissive => {
                (Vec3::from_array(self.material.emissive) * self.image(0, weights, rim).truncate()).extend(1.0)
            }
        }
    }

    /// White without an image.
    fn image(&self, lookup: usize, weights: [f64; 3], rim: &[[DVec2; 2]]) -> Vec4 {
        let Some(l) = &self.lookups[lookup] else { return Vec4::ONE };
        let at = l.places[0] * weights[0] + l.places[1] * weights[1] + l.places[2] * weights[2];
        let rim = Rim::new(rim, &l.footprint, l.places[0], self.shape.corners[0]);
        l.sampler.average(at, &l.footprint, rim.as_ref())
    }

    fn base_color(&self, weights: [f64; 3], rim: &[[DVec2; 2]]) -> Vec4 {
        let mut value = self.image(0, weights, rim);
        if let Some([a, b, c]) = self.colors {
            value *= if a == b && b == c {
                a
            } else {
                let [u, v, w] = inner(weights);
                a * u + b * v + c * w
            };
        }
        value.with_w(match self.material.alpha_cutoff {
            None => 1.0,
            Some(_) if self.material.is_blended => veil::stored(value.w),
            Some(cutoff) => centred_alpha(value.w, cutoff),
        })
    }

    fn normal(&self, weights: [f64; 3], rim: &[[DVec2; 2]]) -> Vec3 {
        let Some(s) = &self.surface else { return Vec3::Z };
        let [u, v, w] = inner(weights);
        let normal = (s.normals[0] * u + s.normals[1] * v + s.normals[2] * w).try_normalize().unwrap_or(s.flat);
        let world = match &self.lookups[0] {
            Some(_) => perturbed(self.image(0, weights, rim), self.material.normal_scale, s.image.as_ref(), normal),
            None => normal,
        };
        match self.space {
            NormalSpace::Tangent => in_tile(world, s.tile.as_ref(), normal),
            NormalSpace::Object => world,
        }
    }
}

/// Barycentric coordinates without negative ones.
fn inner(weights: [f64; 3]) -> [f32; 3] {
    let weights = weights.map(|w| w.max(0.0));
    let sum: f64 = weights.iter().sum();
    weights.map(|w| (w / sum) as f32)
}

/// Alpha with the threshold moved to one half; 0 stays 0, and 1 stays 1 unless the threshold is above it.
fn centred_alpha(alpha: f32, cutoff: f32) -> f32 {
    if cutoff <= 0.0 {
        return 1.0;
    }
    if alpha < cutoff || cutoff >= 1.0 { alpha / cutoff * 0.5 } else { 0.5 + 0.5 * (alpha - cutoff) / (1.0 - cutoff) }
}
