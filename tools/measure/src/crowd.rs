//! A glTF scene of few meshes in many places: nodes that share meshes, and EXT_mesh_gpu_instancing.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::generate::{Kind, generate};
use crate::mesh::Mesh;
use crate::random::Random;

/// What `pb-measure crowd` takes.
#[derive(clap::Args)]
pub struct Arguments {
    /// Where it goes: .glb.
    out: PathBuf,
    /// Different meshes.
    #[arg(long, default_value_t = 8)]
    meshes: usize,
    /// About how many triangles a mesh has.
    #[arg(long, default_value_t = 2000)]
    triangles: usize,
    /// Nodes with a mesh of their own right.
    #[arg(long, default_value_t = 10_000)]
    nodes: usize,
    /// Instances in all, by one node per mesh with EXT_mesh_gpu_instancing.
    #[arg(long, default_value_t = 0)]
    instances: usize,
    /// One of so many nodes is mirrored, and one stretched; 0: none.
    #[arg(long, default_value_t = 0)]
    odd: usize,
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A place in a wide field, with room between.
struct Place {
    translation: [f64; 3],
    rotation: [f64; 4],
    scale: f64,
}

/// Writes the scene; says what is in it.
pub fn run(arguments: &Arguments) -> Result<Value> {
    let &Arguments { meshes, triangles, nodes, instances, odd, seed, .. } = arguments;
    ensure!(meshes > 0 && triangles > 0, "--meshes and --triangles must be at least 1");
    ensure!(nodes + instances <= 10_000_000, "--nodes and --instances must be 10 million together at most");
    let kinds = [Kind::Sphere, Kind::Torus];
    let parts: Vec<Mesh> = (0..meshes).map(|m| generate(kinds[m % 2], triangles, seed + m as u64)).collect();
    let mut scene = Scene { binary: Vec::new(), views: Vec::new(), accessors: Vec::new() };
    let meshes_json: Vec<Value> = parts.iter().map(|mesh| scene.mesh(mesh)).collect();
    let mut random = Random::new(seed);
    let side = 2.5 * ((nodes + instances) as f64).sqrt().max(1.0);
    let mut place = || {
        let translation = [random.unit() * side, random.unit() * 0.5, random.unit() * side];
        let quaternion: [f64; 4] = std::array::from_fn(|_| random.unit() - 0.5);
        let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
        Place { translation, rotation: quaternion.map(|x| x / length), scale: 0.5 + random.unit() }
    };
    let mut list: Vec<Value> = (0..nodes).map(|i| node(&place(), i, meshes, odd)).collect();
    for mesh in (0..meshes).filter(|_| instances > 0) {
        let count = instances / meshes + usize::from(mesh < instances % meshes);
        let places: Vec<Place> = (0..count).map(|_| place()).collect();
        list.push(scene.instancing(mesh, &places));
    }
    let document = json!({
        "asset": { "version": "2.0", "generator": "pb-measure" },
        "extensionsUsed": ["EXT_mesh_gpu_instancing"], "scene": 0,
        "scenes": [{ "nodes": (0..list.len()).collect::<Vec<_>>() }],
        "nodes": list, "meshes": meshes_json, "accessors": scene.accessors, "bufferViews": scene.views,
        "buffers": [{ "byteLength": scene.binary.len() }],
    });
    write(arguments, &document, &scene.binary)?;
    let each: Vec<u64> = parts.iter().map(|mesh| mesh.triangles.len() as u64).collect();
    let placed = (0..nodes).map(|i| each[i % meshes]).sum::<u64>()
        + (0..meshes).map(|m| each[m] * (instances / meshes + usize::from(m < instances % meshes)) as u64).sum::<u64>();
    Ok(json!({ "meshes": meshes, "nodes": nodes, "instances": instances,
        "triangles": each.iter().sum::<u64>(), "placed_triangles": placed }))
}

fn node(place: &Place, i: usize, meshes: usize, odd: usize) -> Value {
    let s = place.scale;
    let scale = match i {
        i if odd > 0 && i % odd == 0 => [-s, s, s],
        i if odd > 0 && i % odd == 1 => [s, s * (1.5 + i as f64 * 1e-3), s],
        _ => [s; 3],
    };
    json!({ "mesh": i % meshes, "translation": place.translation, "rotation": place.rotation, "scale": scale })
}

struct Scene {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Scene {
    fn accessor(&mut self, bytes: Vec<u8>, component: u32, count: usize, kind: &str) -> usize {
        self.views.push(json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() }));
        let view = self.views.len() - 1;
        self.binary.extend(bytes);
        self.accessors.push(json!({ "bufferView": view, "componentType": component, "count": count, "type": kind }));
        self.accessors.len() - 1
    }

    fn mesh(&mut self, mesh: &Mesh) -> Value {
        let positions = floats(mesh.positions.iter().flatten());
        let position = self.accessor(positions, 5126, mesh.positions.len(), "VEC3");
        let indices = mesh.triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
        let index = self.accessor(indices, 5125, mesh.triangles.len() * 3, "SCALAR");
        json!({ "primitives": [{ "attributes": { "POSITION": position }, "indices": index }] })
    }

    fn instancing(&mut self, mesh: usize, places: &[Place]) -> Value {
        let count = places.len();
        let translation = floats(places.iter().flat_map(|p| &p.translation));
        let translation = self.accessor(translation, 5126, count, "VEC3");
        let rotation = self.accessor(floats(places.iter().flat_map(|p| &p.rotation)), 5126, count, "VEC4");
        let scales: Vec<f64> = places.iter().flat_map(|p| [p.scale; 3]).collect();
        let scale = self.accessor(floats(scales.iter()), 5126, count, "VEC3");
        json!({ "mesh": mesh, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": {
            "TRANSLATION": translation, "ROTATION": rotation, "SCALE": scale } } } })
    }
}

fn floats<'a>(list: impl Iterator<Item = &'a f64>) -> Vec<u8> {
    list.flat_map(|&x| (x as f32).to_le_bytes()).collect()
}

fn write(arguments: &Arguments, document: &Value, binary: &[u8]) -> Result<()> {
    let path = &arguments.out;
    let mut json = serde_json::to_vec(document)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let whole = 12 + 8 + json.len() as u64 + 8 + binary.len() as u64;
    ensure!(whole <= u64::from(u32::MAX), "the scene has {whole} bytes, more than the 4 GiB of a GLB file");
    let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
    let mut out = std::io::BufWriter::new(file);
    let words = |list: &[u64]| list.iter().flat_map(|w| (*w as u32).to_le_bytes()).collect::<Vec<u8>>();
    out.write_all(&words(&[0x4654_6c67, 2, whole, json.len() as u64, 0x4e4f_534a]))?;
    out.write_all(&json)?;
    out.write_all(&words(&[binary.len() as u64, 0x004e_4942]))?;
    out.write_all(binary)?;
    Ok(out.flush()?)
}
