//! What the tests on baked models share: meshes, bakes, and one drawn state of a whole model.
#![allow(dead_code)] // each test program uses its part

use std::path::{Path, PathBuf};

use glam::DVec3;
use pb_archive::{MemoryStorage, Writer};
use pb_lod::progressive_buffers::bake::{BakeOptions, bake};
use pb_lod::progressive_buffers::display::{GridEye, LodTable};
use pb_lod::progressive_buffers::displayed_surface::{DrawnCluster, Surface, displayed_surface};
use pb_lod::progressive_buffers::layout::{MAX_LEVELS, SCHEME};
use pb_lod::progressive_buffers::model::{Model, Prefix};
use pb_lod::progressive_buffers::write::write_model;
use pb_mesh::mesh::Soup;
use pb_mesh::repair::{RepairOptions, repair};

/// Deterministic numbers: xorshift.
pub struct Random(pub u64);

impl Random {
    /// In `0.0..1.0`.
    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: u32) -> u32 {
        (self.next() * n as f64) as u32
    }
}

/// A closed torus of `6 * across^2` triangles with bumps down to the edge length, about 1 in size.
pub fn torus(across: u32) -> Soup {
    let (around, mut soup) = (across * 3, Soup::default());
    let mut random = Random(88172645463325252);
    for (u, v) in (0..across).flat_map(|v| (0..around).map(move |u| (u, v))) {
        let angle = |i: u32, n: u32| i as f64 / n as f64 * std::f64::consts::TAU;
        let ((su, cu), (sv, cv)) = (angle(u, around).sin_cos(), angle(v, across).sin_cos());
        let bump = (angle(u, around) * 7.0).sin() * (angle(v, across) * 3.0).cos();
        let radius = 0.13 + 0.02 * bump + 0.05 / across as f64 * random.next();
        soup.positions.push([(0.36 + radius * cv) * cu, (0.36 + radius * cv) * su, radius * sv]);
        let at = |u: u32, v: u32| v % across * around + u % around;
        let [a, b, c, d] = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup
}

/// A file of the shared fixtures, or `None` with a loud line.
pub fn fixture(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/fixtures").join(name);
    if !path.exists() {
        eprintln!("SKIPPED: {name} is not here; see README.md about the shared fixtures");
    }
    path.exists().then_some(path)
}

/// Positions and faces of an OBJ file, polygons as fans; no more than these tests need.
pub fn read_obj(path: &Path) -> Soup {
    let mut soup = Soup::default();
    for line in std::fs::read_to_string(path).expect("the fixture is readable").lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["v", x, y, z, ..] => soup.positions.push([x, y, z].map(|w| w.parse().expect("a number"))),
            ["f", ref corners @ ..] => {
                let index = |w: &&str| w.split('/').next().expect("not empty").parse::<u32>().expect("an index") - 1;
                let corners: Vec<u32> = corners.iter().map(index).collect();
                soup.triangles.extend((1..corners.len() - 1).map(|k| [corners[0], corners[k], corners[k + 1]]));
            }
            _ => {}
        }
    }
    soup
}

/// Bakes and opens in memory.
pub fn baked(soup: Soup, options: &BakeOptions) -> Model {
    let count = soup.triangles.len() as u64;
    let (mesh, _) = repair(soup, &RepairOptions::default()).expect("a sound mesh");
    let (model, _) = bake(mesh, count, options, &|_, _| {}).expect("sound options");
    let storage = MemoryStorage::default();
    let writer = Writer::with_storage(storage.clone(), Path::new("test.pb"), SCHEME).expect("memory");
    write_model(writer, &model).expect("memory");
    Model::from_bytes(Path::new("test.pb"), &storage.to_vec()).expect("a fresh archive is sound")
}

/// A decoded model.
pub struct Decoded {
    pub model: Model,
    /// `cluster * levels + level`.
    pub prefixes: Vec<Prefix>,
}

impl Decoded {
    pub fn new(model: Model) -> Decoded {
        let places = (0..model.record().clusters).flat_map(|c| (0..model.levels()).map(move |i| (c, i)));
        let prefixes = places.map(|(c, i)| model.read_prefix(c, i).expect("decodes")).collect();
        Decoded { model, prefixes }
    }

    pub fn clusters(&self) -> u32 {
        self.model.record().clusters
    }

    pub fn drawn(&self, cluster: u32, level: u32) -> DrawnCluster {
        let record = &self.model.clusters()[cluster as usize];
        let prefix = self.prefixes[(cluster * self.model.levels() + level) as usize].clone();
        DrawnCluster {
            origin: record.origin,
            shift: record.shift,
            counts: (0..self.model.levels()).map(|l| self.model.level(cluster, l).vertices).collect(),
            neighbours: self.model.neighbours(cluster).to_vec(),
            level,
            vertices: prefix.vertices,
            indices: prefix.indices,
        }
    }

    /// Centre and half the diagonal of the model's box, world space.
    pub fn extent(&self) -> (DVec3, f64) {
        let (low, high) =
            (self.model.world(self.model.record().bounds_min), self.model.world(self.model.record().bounds_max));
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }

    pub fn eye(&self, at: DVec3) -> GridEye {
        GridEye::new(self.model.record().origin, self.model.record().quantum, at)
    }

    /// A view from anywhere near or in the model: half of them close to its surface.
    pub fn random_eye(&self, random: &mut Random) -> DVec3 {
        let (center, size) = self.extent();
        let direction = DVec3::new(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5).normalize();
        center + direction * size * 0.2 * 50f64.powf(random.next())
    }

    /// Tables with random distances (steps of up to 20 : 1, a different one per cluster) and random floors over
    /// a random residency.
    pub fn random_tables(&self, random: &mut Random) -> Vec<LodTable> {
        let (_, size) = self.extent();
        let levels = self.model.levels();
        let table = |random: &mut Random| {
            let mut distances = [0.0f32; MAX_LEVELS];
            let mut d = size * 0.02 * 30f64.powf(random.next());
            for distance in &mut distances[1..levels as usize] {
                *distance = d as f32;
                d *= 1.01 + 19.0 * random.next().powi(3);
            }
            let finest_resident = if random.next() < 0.5 { 0 } else { random.below(levels) };
            let rise = (levels - 1 - finest_resident) as f64 * random.next().powi(2);
            LodTable { levels, floor: finest_resident as f32 + rise as f32, distances }
        };
        (0..self.clusters()).map(|_| table(random)).collect()
    }

    /// `floor(lod)` at the nearest point of the cluster's sphere, rounded towards finer.
    pub fn level(&self, cluster: u32, table: &LodTable, eye: DVec3) -> u32 {
        let record = &self.model.clusters()[cluster as usize];
        let quantum = self.model.record().quantum;
        let away = (self.model.world(record.center) - eye).length() - record.radius as f64 * quantum;
        let nearest = (away * (1.0 - 1e-5) - quantum).max(0.0);
        table.lod(nearest as f32) as u32
    }

    /// The whole model as these tables show it.
    pub fn surface(&self, tables: &[LodTable], eye: DVec3) -> Surface {
        let drawn: Vec<DrawnCluster> =
            tables.iter().zip(0..).map(|(table, c)| self.drawn(c, self.level(c, table, eye))).collect();
        displayed_surface(&drawn, tables, &self.eye(eye))
    }
}

/// A binary PLY as tools/measure writes it: three f32 per vertex, triangles only.
pub fn read_generated_ply(path: &Path) -> Soup {
    let bytes = std::fs::read(path).expect("a fixture of this repository");
    let marker = b"end_header\n";
    let body = bytes.windows(marker.len()).position(|w| w == marker).expect("a PLY header") + marker.len();
    let header = String::from_utf8_lossy(&bytes[..body]).into_owned();
    let count = |element: &str| -> usize {
        let line = header.lines().find_map(|l| l.strip_prefix(&format!("element {element} ")));
        line.and_then(|n| n.parse().ok()).expect("an element count")
    };
    let (vertices, faces) = bytes[body..].split_at(count("vertex") * 12);
    let word = |w: &[u8]| -> [u8; 4] { w.try_into().expect("four bytes") };
    let triple = |t: &[u8]| -> [[u8; 4]; 3] { std::array::from_fn(|k| word(&t[k * 4..k * 4 + 4])) };
    assert_eq!(faces.len(), count("face") * 13);
    Soup {
        positions: vertices.chunks_exact(12).map(|v| triple(v).map(|w| f32::from_le_bytes(w) as f64)).collect(),
        triangles: faces.chunks_exact(13).map(|f| triple(&f[1..]).map(u32::from_le_bytes)).collect(),
        ..Soup::default()
    }
}

/// A mesh of data-fixtures/.
pub fn small_fixture(name: &str) -> Soup {
    read_generated_ply(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-fixtures").join(name))
}
