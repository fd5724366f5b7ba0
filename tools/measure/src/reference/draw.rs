//! Draws a scene without light: for each sample of the picture the nearest triangle that its ray meets, in doubles.
//!
//! A ray d meets the triangle (a, b, c) seen from the eye where d . (b x c), d . (c x a) and d . (a x b) have one
//! sign; they are the barycentric coordinates, up to their sum, and perspective needs no further thought. The two
//! triangles of an edge use the same products, so no ray passes between them.

use glam::DVec3;
use rayon::prelude::*;

use super::camera::Camera;
use super::image::{linear_of_srgb, srgb_byte};
use super::scene::{Blend, Scene, Triangle};

/// What pb-view shows where nothing is, sRGB.
pub const BACKGROUND: [u8; 3] = [38, 42, 48];
/// The four samples of a pixel at which adapters look for edges.
const FOUR: [[f64; 2]; 4] = [[0.375, 0.125], [0.875, 0.375], [0.125, 0.625], [0.625, 0.875]];
/// Side of the squares that threads draw, pixels.
const TILE: usize = 16;
/// Fewest and most samples along the side of a pixel where the number follows the texture.
const GRID: (usize, usize) = (4, 16);
/// Depths that differ by this share are equal.
const EDGE: f64 = 1e-9;
/// No triangle.
pub const NONE: u32 = u32::MAX;

/// How colours are found inside a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Filter {
    /// The mean over many points, each of which sees the full image: the truth.
    Exact,
    /// Once per triangle and pixel, trilinear with anisotropy: what adapters do with the full image.
    Trilinear,
}

/// What to draw.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub size: [usize; 2],
    pub filter: Filter,
    /// Samples along the side of a pixel; else as many as the texture asks for.
    pub grid: Option<usize>,
}

/// A frame.
pub struct Picture {
    /// sRGB, rows from the top.
    pub pixels: Vec<[u8; 3]>,
    /// How much of each pixel the model covers, 0 to 255.
    pub coverage: Vec<u8>,
}

/// A triangle as rays see it.
struct Seen {
    triangle: u32,
    /// b x c, c x a, a x b, signed so that the determinant is positive.
    edges: [DVec3; 3],
    determinant: f64,
    /// Its corners are seen clockwise.
    from_behind: bool,
    /// First and last pixel, x and y.
    low: [usize; 2],
    high: [usize; 2],
}

impl Seen {
    /// Depth and barycentric coordinates where a ray (x, y, 1) meets it.
    fn hit(&self, ray: DVec3) -> Option<(f64, [f64; 3])> {
        let w = self.edges.map(|e| e.dot(ray));
        let sum = w[0] + w[1] + w[2];
        (w.iter().all(|&w| w >= 0.0) && sum > 0.0).then(|| (self.determinant / sum, w.map(|w| w / sum)))
    }

    /// The same on its plane, also beside the triangle.
    fn on_plane(&self, ray: DVec3) -> [f64; 3] {
        let w = self.edges.map(|e| e.dot(ray));
        w.map(|x| x / (w[0] + w[1] + w[2]))
    }
}

/// Draws one frame.
pub fn draw(scene: &Scene, camera: &Camera, options: &Options) -> Picture {
    let size = options.size;
    let projected: Vec<DVec3> = scene.positions.par_iter().map(|&p| camera.project(p)).collect();
    let seen: Vec<Seen> = (0..scene.triangles.len() as u32)
        .into_par_iter()
        .filter_map(|t| see(t, scene.triangles[t as usize].corners.map(|i| projected[i as usize]), size))
        .collect();
    let samples = match options.filter {
        Filter::Trilinear => grid_samples(1),
        Filter::Exact => grid_samples(options.grid.unwrap_or_else(|| wanted_grid(scene, &projected, &seen, size))),
    };
    let across = size[0].div_ceil(TILE);
    let mut bins = vec![Vec::new(); across * size[1].div_ceil(TILE)];
    for (i, s) in seen.iter().enumerate() {
        for y in s.low[1] / TILE..=s.high[1] / TILE {
            (s.low[0] / TILE..=s.high[0] / TILE).for_each(|x| bins[y * across + x].push(i as u32));
        }
    }
    let work = Work { scene, seen: &seen, samples: &samples, options };
    let tiles: Vec<Vec<([u8; 3], u8)>> =
        bins.par_iter().enumerate().map(|(i, bin)| work.tile(i % across * TILE, i / across * TILE, bin)).collect();
    let pixel = |i: usize| {
        let (x, y) = (i % size[0], i / size[0]);
        tiles[y / TILE * across + x / TILE][y % TILE * TILE + x % TILE]
    };
    let (pixels, coverage) = (0..size[0] * size[1]).map(pixel).unzip();
    Picture { pixels, coverage }
}

/// Depth and triangle that the adapter's four samples of each pixel see; holes are not looked through.
pub fn visible(scene: &Scene, camera: &Camera, size: [usize; 2]) -> Vec<[(f64, u32); 4]> {
    let projected: Vec<DVec3> = scene.positions.iter().map(|&p| camera.project(p)).collect();
    let mut nearest = vec![[(f64::INFINITY, NONE); 4]; size[0] * size[1]];
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let Some(seen) = see(t as u32, triangle.corners.map(|i| projected[i as usize]), size) else { continue };
        for y in seen.low[1]..=seen.high[1] {
            for x in seen.low[0]..=seen.high[0] {
                for (place, slot) in FOUR.iter().zip(&mut nearest[y * size[0] + x]) {
                    let depth = seen.hit(ray(x, y, *place, size)).map_or(f64::INFINITY, |h| h.0);
                    if depth < slot.0 {
                        *slot = (depth, t as u32);
                    }
                }
            }
        }
    }
    nearest
}

/// Through a place of a pixel, a unit deep.
fn ray(x: usize, y: usize, place: [f64; 2], size: [usize; 2]) -> DVec3 {
    let [width, height] = size.map(|s| s as f64);
    DVec3::new((x as f64 + place[0]) / width * 2.0 - 1.0, 1.0 - (y as f64 + place[1]) / height * 2.0, 1.0)
}

/// The four of the adapter, then a regular grid.
fn grid_samples(n: usize) -> Vec<[f64; 2]> {
    let at = |i: usize| (i as f64 + 0.5) / n as f64;
    FOUR.into_iter().chain((0..n * n).map(|i| [at(i % n), at(i / n)])).collect()
}

fn see(triangle: u32, [a, b, c]: [DVec3; 3], size: [usize; 2]) -> Option<Seen> {
    let mut edges = [b.cross(c), c.cross(a), a.cross(b)];
    let mut determinant = a.dot(edges[0]);
    // The axes of the camera (right, up, ahead) are left-handed.
    let from_behind = determinant < 0.0;
    if from_behind {
        edges = edges.map(|e| -e);
        determinant = -determinant;
    }
    if determinant == 0.0 || a.z.max(b.z).max(c.z) <= 0.0 {
        return None;
    }
    let half = [size[0] as f64 / 2.0, size[1] as f64 / 2.0];
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for p in [a, b, c] {
        // A corner behind the eye: the triangle may be anywhere in the picture.
        let at = if p.z > 0.0 { [p.x / p.z, -p.y / p.z] } else { [f64::NAN; 2] };
        for k in 0..2 {
            let x = (at[k] + 1.0) * half[k];
            (low[k], high[k]) = match x.is_nan() {
                true => (f64::MIN, f64::MAX),
                false => (low[k].min(x), high[k].max(x)),
            };
        }
    }
    let inside = (0..2).all(|k| high[k] >= 0.0 && low[k] < size[k] as f64);
    let pixel = |x: f64, k: usize| (x.max(0.0) as usize).min(size[k] - 1);
    inside.then(|| Seen {
        triangle,
        edges,
        determinant,
        from_behind,
        low: [pixel(low[0], 0), pixel(low[1], 1)],
        high: [pixel(high[0], 0), pixel(high[1], 1)],
    })
}

/// Samples along the side of a pixel, so that neighbouring ones are a texel apart on average.
fn wanted_grid(scene: &Scene, projected: &[DVec3], seen: &[Seen], size: [usize; 2]) -> usize {
    let (mut texels, mut pixels) = (0.0, 0.0);
    for t in seen.iter().map(|s| &scene.triangles[s.triangle as usize]) {
        let corners = t.corners.map(|i| projected[i as usize]);
        let Some(image) = scene.materials[t.material as usize].image.map(|i| &scene.images[i]) else { continue };
        if corners.iter().any(|p| p.z <= 0.0) {
            continue;
        }
        let area = |p: [[f64; 2]; 3], sx: f64, sy: f64| {
            let (u, v) = ([p[1][0] - p[0][0], p[1][1] - p[0][1]], [p[2][0] - p[0][0], p[2][1] - p[0][1]]);
            (u[0] * v[1] - u[1] * v[0]).abs() / 2.0 * sx * sy
        };
        texels += area(t.uv.map(|uv| uv.map(f64::from)), image.width as f64, image.height as f64);
        pixels += area(corners.map(|p| [p.x / p.z, p.y / p.z]), size[0] as f64 / 2.0, size[1] as f64 / 2.0);
    }
    let texels_per_pixel = if pixels > 0.0 { (texels / pixels).sqrt() } else { 0.0 };
    (texels_per_pixel.ceil() as usize).clamp(GRID.0, GRID.1)
}

/// What the samples of a pixel see.
struct Found<'a> {
    /// Depth and triangle.
    nearest: &'a [(f64, u32)],
    /// Sample, depth, triangle: what is looked through, by sample, far to near.
    veils: &'a [(usize, f64, u32)],
    /// Number of the first sample in `veils`.
    first: usize,
}

impl Found<'_> {
    fn veils(&self, sample: usize) -> &[(usize, f64, u32)] {
        let before = |at: usize| self.veils.partition_point(|v| v.0 < self.first + at);
        &self.veils[before(sample)..before(sample + 1)]
    }

    fn any(&self, sample: usize) -> bool {
        self.nearest[sample].1 != NONE || !self.veils(sample).is_empty()
    }

    fn sees(&self, sample: usize, triangle: u32) -> bool {
        self.nearest[sample].1 == triangle || self.veils(sample).iter().any(|v| v.2 == triangle)
    }
}

struct Work<'a> {
    scene: &'a Scene,
    seen: &'a [Seen],
    samples: &'a [[f64; 2]],
    options: &'a Options,
}

impl Work<'_> {
    /// Colour and coverage of the pixels of a square, row by row.
    fn tile(&self, left: usize, top: usize, bin: &[u32]) -> Vec<([u8; 3], u8)> {
        let n = self.samples.len();
        let mut nearest = vec![(f64::INFINITY, NONE); TILE * TILE * n];
        let (blended, solid): (Vec<u32>, Vec<u32>) = bin.iter().partition(|i| self.blend(**i).is_some());
        for &index in &solid {
            let is_cut_out = self.cutoff(&self.seen[index as usize]).is_some();
            self.hits(index, left, top, |at, depth, w| {
                let slot = &mut nearest[at];
                if depth < slot.0 && !(is_cut_out && self.is_hole(&self.seen[index as usize], w)) {
                    *slot = (depth, index);
                }
            });
        }
        // By sample: what is looked through, with its depth.
        let mut veils: Vec<(usize, f64, u32)> = Vec::new();
        for &index in &blended {
            let culled = self.blend(index) == Some(Blend::Front) && self.seen[index as usize].from_behind;
            self.hits(index, left, top, |at, depth, _| {
                if !culled && depth < nearest[at].0 {
                    veils.push((at, depth, index));
                }
            });
        }
        veils.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        // On an edge two triangles are one surface.
        let material = |v: &(usize, f64, u32)| self.triangle(&self.seen[v.2 as usize]).material;
        veils.dedup_by(|b, a| a.0 == b.0 && (a.1 - b.1).abs() <= EDGE * a.1 && material(a) == material(b));
        (0..TILE * TILE)
            .map(|i| {
                let samples = i * n..(i + 1) * n;
                let before = |at: usize| veils.partition_point(|v| v.0 < at);
                let veils = &veils[before(samples.start)..before(samples.end)];
                let found = Found { nearest: &nearest[samples.clone()], veils, first: samples.start };
                if found.nearest.iter().all(|f| f.1 == NONE) && veils.is_empty() {
                    return (BACKGROUND, 0);
                }
                let (light, share) = match self.options.filter {
                    Filter::Exact => self.exact(left + i % TILE, top + i / TILE, &found),
                    Filter::Trilinear => self.trilinear(left + i % TILE, top + i / TILE, &found),
                };
                (over_background(light, share), (share * 255.0).round() as u8)
            })
            .collect()
    }

    /// Calls `hit` with the samples of a square that see a triangle: number, depth, barycentric coordinates.
    fn hits(&self, index: u32, left: usize, top: usize, mut hit: impl FnMut(usize, f64, [f64; 3])) {
        let seen = &self.seen[index as usize];
        for y in seen.low[1].max(top)..=seen.high[1].min(top + TILE - 1) {
            for x in seen.low[0].max(left)..=seen.high[0].min(left + TILE - 1) {
                let pixel = ((y - top) * TILE + x - left) * self.samples.len();
                for (i, place) in self.samples.iter().enumerate() {
                    if let Some((depth, w)) = seen.hit(self.ray(x, y, *place)) {
                        hit(pixel + i, depth, w);
                    }
                }
            }
        }
    }

    fn ray(&self, x: usize, y: usize, place: [f64; 2]) -> DVec3 {
        ray(x, y, place, self.options.size)
    }

    /// Mean light of all samples that hit the model; edges as the adapter's four samples see them.
    fn exact(&self, x: usize, y: usize, found: &Found) -> ([f32; 3], f32) {
        self.mean(found, 0..self.samples.len(), |index, sample| {
            let seen = &self.seen[index as usize];
            self.color(seen, seen.on_plane(self.ray(x, y, self.samples[sample])), None)
        })
    }

    /// Each triangle that one of the four samples sees gives the colour at the pixel's centre, or, where it does not
    /// reach that, at the middle of its samples.
    fn trilinear(&self, x: usize, y: usize, found: &Found) -> ([f32; 3], f32) {
        self.mean(found, 0..4, |index, _| {
            let seen = &self.seen[index as usize];
            let place = if seen.hit(self.ray(x, y, [0.5; 2])).is_some() {
                [0.5; 2]
            } else {
                let of: Vec<[f64; 2]> = (0..4).filter(|&j| found.sees(j, index)).map(|j| FOUR[j]).collect();
                [0, 1].map(|k| of.iter().map(|p| p[k]).sum::<f64>() / of.len() as f64)
            };
            let at = |dx: f64, dy: f64| seen.on_plane(self.ray(x, y, [place[0] + dx, place[1] + dy]));
            self.color(seen, at(0.0, 0.0), Some([at(1.0, 0.0), at(0.0, 1.0)]))
        })
    }

    /// Mean light of those samples that see anything, and the share of the first four that do. `color`: of a triangle at
    /// a sample.
    fn mean(
        &self,
        found: &Found,
        samples: std::ops::Range<usize>,
        color: impl Fn(u32, usize) -> [f32; 4],
    ) -> ([f32; 3], f32) {
        let (mut light, mut count) = ([0.0; 3], 0.0f32);
        for sample in samples.filter(|&s| found.any(s)) {
            let behind = match found.nearest[sample].1 {
                NONE => background(),
                index => {
                    let [r, g, b, _] = color(index, sample);
                    [r, g, b]
                }
            };
            let through = |behind: [f32; 3], veil: &(usize, f64, u32)| {
                let c = color(veil.2, sample);
                let alpha = c[3].clamp(0.0, 1.0);
                [0, 1, 2].map(|k| behind[k] + (c[k] - behind[k]) * alpha)
            };
            let seen = found.veils(sample).iter().fold(behind, through);
            (0..3).for_each(|k| light[k] += seen[k]);
            count += 1.0;
        }
        let share = (0..4).filter(|&s| found.any(s)).count() as f32 / 4.0;
        (light.map(|c| c / count.max(1.0)), share)
    }

    fn blend(&self, index: u32) -> Option<Blend> {
        self.scene.materials[self.triangle(&self.seen[index as usize]).material as usize].blend
    }

    fn triangle(&self, seen: &Seen) -> &Triangle {
        &self.scene.triangles[seen.triangle as usize]
    }

    fn cutoff(&self, seen: &Seen) -> Option<f32> {
        self.scene.materials[self.triangle(seen).material as usize].cutoff
    }

    fn is_hole(&self, seen: &Seen, w: [f64; 3]) -> bool {
        self.cutoff(seen).is_some_and(|cutoff| self.color(seen, w, None)[3] < cutoff)
    }

    /// Linear light and alpha at barycentric coordinates; with those of the next pixel right and down, filtered.
    fn color(&self, seen: &Seen, w: [f64; 3], next: Option<[[f64; 3]; 2]>) -> [f32; 4] {
        let triangle = self.triangle(seen);
        let material = &self.scene.materials[triangle.material as usize];
        let mut color = material.factor;
        if let Some(colors) = self.scene.colors.get(seen.triangle as usize) {
            for (k, c) in color.iter_mut().enumerate() {
                *c *= (0..3).map(|i| colors[i][k] * w[i] as f32).sum::<f32>();
            }
        }
        let Some(image) = material.image.map(|i| &self.scene.images[i]) else { return color };
        let uv_at = |w: [f64; 3]| [0, 1].map(|k| (0..3).map(|i| f64::from(triangle.uv[i][k]) * w[i]).sum::<f64>());
        let uv = uv_at(w);
        let texel = match next {
            _ if material.nearest => image.nearest(uv, material.wrap),
            None => image.bilinear(uv, material.wrap),
            Some(next) => {
                let [across, down] = next.map(|w| [uv_at(w)[0] - uv[0], uv_at(w)[1] - uv[1]]);
                image.trilinear(uv, across, down, material.wrap)
            }
        };
        std::array::from_fn(|k| color[k] * texel[k])
    }
}

fn over_background(light: [f32; 3], share: f32) -> [u8; 3] {
    let behind = background();
    std::array::from_fn(|k| srgb_byte(light[k].min(1.0) * share + behind[k] * (1.0 - share)))
}

/// Linear light.
fn background() -> [f32; 3] {
    BACKGROUND.map(|c| linear_of_srgb(f64::from(c) / 255.0) as f32)
}
