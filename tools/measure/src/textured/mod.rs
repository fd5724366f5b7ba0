//! Textured meshes made from a seed: a torus cut into islands, which lie shuffled in an image, as in atlases of
//! photogrammetry. The image is a function of the surface, so islands that meet on it agree on its colours.

pub mod paint;

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::random::{Random, noise, octaves};
use paint::Paint;

/// Radius of the ring, and of its tube on average.
const RING: f64 = 0.36;
const TUBE: f64 = 0.14;
/// Texels between an island and the border of its cell, of which half continue the island.
const MARGIN: f64 = 2.0;

/// What to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// 1 M triangles in 177 x 177 islands: an atlas in shreds.
    Islands,
    /// 1 M triangles in 16 x 16 islands: a large scan.
    Scan,
    /// 8192 triangles in 8 x 8 islands, green on one half, yellow on the other, on a magenta ground: whatever bleeds
    /// has less green, or red where there is none.
    Loud,
    /// 8192 triangles in 4 x 4 islands of an image of 16384 x 16384.
    Big,
}

#[derive(clap::Args)]
pub struct Arguments {
    kind: Kind,
    /// Where it goes: .obj (with .mtl and image beside it) or .glb.
    out: PathBuf,
    /// About how many triangles; else as the kind says.
    #[arg(long)]
    triangles: Option<u64>,
    /// Islands along each of the two ways around the torus.
    #[arg(long)]
    islands: Option<u32>,
    /// Side of the image, texels.
    #[arg(long)]
    texture: Option<u32>,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How the image is stored.
    #[arg(long, value_enum, default_value_t = ImageKind::Png)]
    image: ImageKind,
}

/// How an image is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ImageKind {
    Png,
    /// Baseline.
    Jpeg,
    /// Plain strips; not for .glb.
    Tiff,
}

impl ImageKind {
    fn extension(self) -> &'static str {
        match self {
            ImageKind::Png => "png",
            ImageKind::Jpeg => "jpg",
            ImageKind::Tiff => "tif",
        }
    }
}

/// A torus in islands.
struct Torus {
    kind: Kind,
    seed: u64,
    /// Islands each way.
    islands: u32,
    /// Quads of an island, around the ring and around the tube.
    quads: [u32; 2],
    /// Side of the image, texels.
    size: u32,
    /// Cells of the image, one per island and some more.
    columns: u32,
    rows: u32,
    /// By cell: its island, if any.
    island_of: Vec<Option<u32>>,
    /// By island: its cell.
    cell_of: Vec<u32>,
}

/// Makes what the command line asks for.
pub fn run(arguments: &Arguments) -> Result<Value> {
    let (triangles, islands, size) = match arguments.kind {
        Kind::Islands => (1_000_000, 177, 4096),
        Kind::Scan => (1_000_000, 16, 4096),
        Kind::Loud => (8192, 8, 512),
        Kind::Big => (8192, 4, 16384),
    };
    let triangles = arguments.triangles.unwrap_or(triangles);
    let (islands, size) = (arguments.islands.unwrap_or(islands), arguments.texture.unwrap_or(size));
    ensure!((1..=50_000_000).contains(&triangles), "--triangles must be 1 to 50 million");
    ensure!((1..=1024).contains(&islands), "--islands must be 1 to 1024");
    ensure!((16..=32768).contains(&size), "--texture must be 16 to 32768");
    let torus = Torus::new(arguments.kind, triangles, islands, size, arguments.seed);
    ensure!(torus.span().iter().all(|s| *s >= 1.0), "the islands are too many for the texture");
    let image = arguments.out.with_extension(arguments.image.extension());
    paint::write(&torus, &image)?;
    match arguments.out.extension().and_then(|e| e.to_str()) {
        Some("obj") => torus.write_obj(&arguments.out, &image)?,
        Some("glb") => {
            ensure!(arguments.image != ImageKind::Tiff, "a GLB file holds PNG or JPEG; write .obj");
            torus.write_glb(&arguments.out, &image)?;
            std::fs::remove_file(&image)?;
        }
        _ => bail!("{}: only .obj and .glb can be written", arguments.out.display()),
    }
    Ok(json!({ "triangles": torus.triangles(), "islands": islands * islands, "texture": size }))
}

impl Torus {
    fn new(kind: Kind, triangles: u64, islands: u32, size: u32, seed: u64) -> Torus {
        // About 2.5 times as far around the ring as around the tube.
        let per_island = triangles as f64 / 2.0 / f64::from(islands).powi(2);
        let along = (per_island * RING / TUBE).sqrt().round().max(1.0);
        let across = (per_island / along).round().max(if islands < 3 { 3.0 } else { 1.0 });
        let count = islands * islands;
        let columns = (f64::from(count) * TUBE / RING).sqrt().ceil() as u32;
        let rows = count.div_ceil(columns);
        let mut random = Random::new(seed);
        let mut cell_of: Vec<u32> = (0..columns * rows).collect();
        for i in (1..cell_of.len()).rev() {
            cell_of.swap(i, (random.unit() * (i + 1) as f64) as usize);
        }
        cell_of.truncate(count as usize);
        let mut island_of = vec![None; (columns * rows) as usize];
        cell_of.iter().enumerate().for_each(|(island, cell)| island_of[*cell as usize] = Some(island as u32));
        Torus { kind, seed, islands, quads: [along as u32, across as u32], size, columns, rows, island_of, cell_of }
    }

    fn triangles(&self) -> u64 {
        2 * u64::from(self.quads[0]) * u64::from(self.quads[1]) * u64::from(self.islands).pow(2)
    }

    /// Grid lines around the ring and around the tube.
    fn lines(&self) -> [u32; 2] {
        self.quads.map(|q| q * self.islands)
    }

    /// A point of the surface, at shares of the ways around; detail down to the length of the edges.
    fn point(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let ((su, cu), (sv, cv)) = ((u * TAU).sin_cos(), (v * TAU).sin_cos());
        let base = [(1.0 + 0.4 * cv) * cu, (1.0 + 0.4 * cv) * su, 0.4 * sv];
        let detail = f64::from(self.lines()[0]).log2().ceil() as u32;
        let radius = TUBE + 0.025 * octaves(base.map(|x| x * 3.0), self.seed, detail, 0.45);
        [(RING + radius * cv) * cu, (RING + radius * cv) * su, radius * sv]
    }

    fn vertex(&self, i: u32, j: u32) -> [f64; 3] {
        let [n, m] = self.lines();
        self.point([f64::from(i % n) / f64::from(n), f64::from(j % m) / f64::from(m)])
    }

    /// Size of a cell of the image, texels.
    fn cell(&self) -> [f64; 2] {
        [f64::from(self.size) / f64::from(self.columns), f64::from(self.size) / f64::from(self.rows)]
    }

    /// Size of an island in the image, texels.
    fn span(&self) -> [f64; 2] {
        self.cell().map(|c| c - 2.0 * MARGIN)
    }

    /// Upper left corner of what a cell (column, row) holds, texels.
    fn start(&self, cell: [u32; 2]) -> [f64; 2] {
        [0, 1].map(|k| f64::from(cell[k]) * self.cell()[k] + MARGIN)
    }

    /// Where a share of an island lies in the image, texels.
    fn texel_of(&self, island: u32, share: [f64; 2]) -> [f64; 2] {
        let cell = self.cell_of[island as usize];
        let (start, span) = (self.start([cell % self.columns, cell / self.columns]), self.span());
        [0, 1].map(|k| start[k] + share[k] * span[k])
    }

    /// Triangles of an island as corners in its grid of `(quads + 1)^2` corners.
    fn island_triangles(&self) -> Vec<[[u32; 2]; 3]> {
        let [n, m] = self.quads;
        let quad = |(i, j): (u32, u32)| {
            let [a, b, c, d] = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
            if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
        };
        (0..m).flat_map(|j| (0..n).map(move |i| (i, j))).flat_map(quad).collect()
    }

    /// uv of a corner of an island, v downwards.
    fn uv(&self, island: u32, corner: [u32; 2]) -> [f64; 2] {
        let share = [0, 1].map(|k| f64::from(corner[k]) / f64::from(self.quads[k]));
        self.texel_of(island, share).map(|x| x / f64::from(self.size))
    }

    fn write_obj(&self, path: &Path, image: &Path) -> Result<()> {
        let mtl = path.with_extension("mtl");
        let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        std::fs::write(&mtl, format!("newmtl surface\nKd 1 1 1\nmap_Kd {}\n", name(image)))?;
        let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        writeln!(out, "mtllib {}\nusemtl surface", name(&mtl))?;
        let [n, m] = self.lines();
        for (i, j) in (0..m).flat_map(|j| (0..n).map(move |i| (i, j))) {
            let [x, y, z] = self.vertex(i, j);
            writeln!(out, "v {x:.7} {y:.7} {z:.7}")?;
        }
        let [corners_n, corners_m] = self.quads.map(|q| q + 1);
        let triangles = self.island_triangles();
        for island in 0..self.islands * self.islands {
            for (i, j) in (0..corners_m).flat_map(|j| (0..corners_n).map(move |i| (i, j))) {
                let [u, v] = self.uv(island, [i, j]);
                writeln!(out, "vt {u:.7} {:.7}", 1.0 - v)?;
            }
            let start = [island % self.islands * self.quads[0], island / self.islands * self.quads[1]];
            for t in &triangles {
                let word = t.map(|[i, j]| {
                    let v = (start[1] + j) % m * n + (start[0] + i) % n + 1;
                    let vt = island * corners_n * corners_m + j * corners_n + i + 1;
                    format!("{v}/{vt}")
                });
                writeln!(out, "f {} {} {}", word[0], word[1], word[2])?;
            }
        }
        Ok(out.flush()?)
    }

    fn write_glb(&self, path: &Path, image: &Path) -> Result<()> {
        let islands = self.islands * self.islands;
        let [n, m] = self.quads.map(|q| q + 1);
        let (per_island, triangles) = (n * m, self.island_triangles());
        let vertices = u64::from(islands) * u64::from(per_island);
        let image_bytes = std::fs::metadata(image)?.len();
        let lengths = [vertices * 12, vertices * 8, self.triangles() * 12, image_bytes];
        let starts = [0, lengths[0], lengths[0] + lengths[1], lengths[0] + lengths[1] + lengths[2]];
        let binary = (starts[3] + lengths[3]).next_multiple_of(4);
        ensure!(binary < 1 << 32, "a GLB file ends at 4 GiB; write .obj");
        let mime = if image.extension().is_some_and(|e| e == "png") { "image/png" } else { "image/jpeg" };
        let views: Vec<Value> =
            (0..4).map(|i| json!({ "buffer": 0, "byteOffset": starts[i], "byteLength": lengths[i] })).collect();
        let bound = RING + 2.0 * TUBE;
        let document = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }] }],
            "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0 } }],
            "textures": [{ "source": 0 }], "images": [{ "bufferView": 3, "mimeType": mime }],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": vertices,
                  "min": [-bound, -bound, -bound], "max": [bound, bound, bound] },
                { "bufferView": 1, "componentType": 5126, "type": "VEC2", "count": vertices },
                { "bufferView": 2, "componentType": 5125, "type": "SCALAR", "count": self.triangles() * 3 },
            ],
            "bufferViews": views, "buffers": [{ "byteLength": binary }],
        });
        let mut text = serde_json::to_vec(&document)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        let mut words = |list: &[u64]| list.iter().try_for_each(|w| out.write_all(&(*w as u32).to_le_bytes()));
        words(&[0x4654_6c67, 2, 12 + 8 + text.len() as u64 + 8 + binary, text.len() as u64, 0x4e4f_534a])?;
        out.write_all(&text)?;
        out.write_all(&(binary as u32).to_le_bytes())?;
        out.write_all(&0x004e_4942u32.to_le_bytes())?;
        let mut floats = |list: &[f64]| list.iter().try_for_each(|x| out.write_all(&(*x as f32).to_le_bytes()));
        let corners: Vec<[u32; 2]> = (0..m).flat_map(|j| (0..n).map(move |i| [i, j])).collect();
        for island in 0..islands {
            let start = [island % self.islands * self.quads[0], island / self.islands * self.quads[1]];
            corners.iter().try_for_each(|c| floats(&self.vertex(start[0] + c[0], start[1] + c[1])))?;
        }
        for island in 0..islands {
            corners.iter().try_for_each(|c| floats(&self.uv(island, *c)))?;
        }
        for island in 0..islands {
            for [i, j] in triangles.iter().flatten() {
                out.write_all(&(island * per_island + j * n + i).to_le_bytes())?;
            }
        }
        std::io::copy(&mut std::fs::File::open(image)?, &mut out)?;
        out.write_all(&vec![0; (binary - starts[3] - lengths[3]) as usize])?;
        Ok(out.flush()?)
    }
}

impl Paint for Torus {
    fn size(&self) -> u32 {
        self.size
    }

    /// The surface under a texel; half of the margin goes on as the island does, the rest is ground.
    fn texel(&self, x: u32, y: u32) -> [u8; 3] {
        let cell = self.cell();
        let at = [f64::from(x) + 0.5, f64::from(y) + 0.5];
        let [column, row] = [0, 1].map(|k| (at[k] / cell[k]) as u32);
        let ground = if self.kind == Kind::Loud { [255, 0, 255] } else { [0, 0, 0] };
        let index = (row * self.columns + column) as usize;
        let Some(island) = self.island_of.get(index).copied().flatten() else { return ground };
        let (start, span) = (self.start([column, row]), self.span());
        let inside = [0, 1].map(|k| at[k] - start[k]);
        if (0..2).any(|k| inside[k] < -MARGIN / 2.0 || inside[k] > span[k] + MARGIN / 2.0) {
            return ground;
        }
        let corner = [island % self.islands, island / self.islands].map(f64::from);
        let along = [0, 1].map(|k| corner[k] + inside[k] / span[k]);
        if self.kind == Kind::Loud {
            return if island % self.islands < self.islands / 2 { [0, 255, 0] } else { [255, 255, 0] };
        }
        let around = along.map(|a| a / f64::from(self.islands));
        let base = match self.kind {
            // Quarter of a billion texels: nothing dear.
            Kind::Big => [0.0, 2.0, 4.0].map(|k| 0.5 + 0.3 * ((around[0] * TAU + k).sin() * (around[1] * TAU).cos())),
            _ => paint::slow(self.smooth(around), self.seed),
        };
        paint::detail(along[0] * span[0], along[1] * span[1], base, self.seed)
    }
}

impl Torus {
    /// The torus without its bumps: what slow colours follow.
    fn smooth(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        let ((su, cu), (sv, cv)) = ((u * TAU).sin_cos(), (v * TAU).sin_cos());
        let place = [(RING + TUBE * cv) * cu, (RING + TUBE * cv) * su, TUBE * sv];
        place.map(|x| x + 0.01 * noise(place.map(|x| x * 8.0), self.seed ^ 3))
    }
}

#[cfg(test)]
mod tests;
