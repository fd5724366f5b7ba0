//! Scenes as files, part by part: what is held at once is one part.

use anyhow::{Result, ensure};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::paint::Picture;
use super::topology::Counts;
use super::{Part, Scene, Unit, create};
use crate::textured::paint;

/// Bytes of a GLB file at most.
const GLB_LIMIT: u64 = u32::MAX as u64;
const BUFFER: usize = 1 << 20;

fn name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Path of the image of a unit beside a model.
fn image_beside(model: &Path, number: usize) -> PathBuf {
    let stem = model.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    model.with_file_name(format!("{stem}_{number:03}.png"))
}

/// The images beside a model; their paths.
fn images(scene: &Scene, model: &Path) -> Result<Vec<PathBuf>> {
    let one = |(number, unit): (usize, &Unit)| {
        let path = image_beside(model, number);
        paint::write(&Picture::new(unit), &path)?;
        Ok(path)
    };
    scene.units.iter().enumerate().map(one).collect()
}

/// The parts, each with the number of its unit and what was written before it.
fn parts(scene: &Scene) -> impl Iterator<Item = (usize, &Part, Counts)> {
    let mut before = Counts::default();
    let all = scene.units.iter().enumerate().flat_map(|(number, unit)| unit.parts.iter().map(move |p| (number, p)));
    all.map(move |(number, part)| {
        let start = before;
        before += part.counts();
        (number, part, start)
    })
}

/// Binary, with places in images and numbers of images at the faces.
pub fn ply(scene: &Scene, path: &Path) -> Result<()> {
    let counts = scene.counts();
    ensure!(counts.positions <= i32::MAX as u64, "{}: PLY indices end at 2 billion vertices", path.display());
    let images = images(scene, path)?;
    let mut out = BufWriter::with_capacity(BUFFER, create(path)?);
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    images.iter().try_for_each(|i| writeln!(out, "comment TextureFile {}", name(i)))?;
    writeln!(out, "element vertex {}\nproperty float x\nproperty float y\nproperty float z", counts.positions)?;
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices", counts.triangles)?;
    writeln!(out, "property list uchar float texcoord\nproperty int texnumber\nend_header")?;
    for (_, part, _) in parts(scene) {
        part.positions().iter().flatten().try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
    }
    for (number, part, start) in parts(scene) {
        let topology = part.topology();
        for triangle in &topology.triangles {
            let wedges = triangle.map(|w| topology.wedges[w as usize]);
            let mut row = [0; 42];
            (row[0], row[13]) = (3, 6);
            row[38..].copy_from_slice(&(number as i32).to_le_bytes());
            for (k, wedge) in wedges.iter().enumerate() {
                let position = start.positions as u32 + wedge.position;
                row[1 + 4 * k..5 + 4 * k].copy_from_slice(&position.to_le_bytes());
                row[14 + 8 * k..18 + 8 * k].copy_from_slice(&wedge.uv[0].to_le_bytes());
                row[18 + 8 * k..22 + 8 * k].copy_from_slice(&(1.0 - wedge.uv[1]).to_le_bytes());
            }
            out.write_all(&row)?;
        }
    }
    Ok(out.flush()?)
}

/// With a material per image in an MTL file.
pub fn obj(scene: &Scene, path: &Path) -> Result<()> {
    let images = images(scene, path)?;
    let mtl = path.with_extension("mtl");
    let material = |(i, image): (usize, &PathBuf)| format!("newmtl stone_{i:03}\nKd 1 1 1\nmap_Kd {}\n\n", name(image));
    std::fs::write(&mtl, images.iter().enumerate().map(material).collect::<String>())?;
    let mut out = BufWriter::with_capacity(BUFFER, create(path)?);
    writeln!(out, "mtllib {}", name(&mtl))?;
    let mut last = None;
    for (number, part, start) in parts(scene) {
        if last.replace(number) != Some(number) {
            writeln!(out, "usemtl stone_{number:03}")?;
        }
        lines(&mut out, &part.positions(), |[x, y, z]| format!("v {x} {y} {z}\n"))?;
        let topology = part.topology();
        lines(&mut out, &topology.wedges, |w| format!("vt {} {}\n", w.uv[0], 1.0 - w.uv[1]))?;
        lines(&mut out, &topology.triangles, |t| {
            let [a, b, c] = t.map(|w| {
                let position = start.positions + 1 + u64::from(topology.wedges[w as usize].position);
                format!("{position}/{}", start.wedges + 1 + u64::from(w))
            });
            format!("f {a} {b} {c}\n")
        })?;
    }
    Ok(out.flush()?)
}

/// Text is made by all threads, so many lines at a time.
const LINES: usize = 1 << 11;

fn lines<T: Sync>(out: &mut impl Write, items: &[T], line: impl Fn(&T) -> String + Sync) -> Result<()> {
    for some in items.chunks(16 * LINES) {
        let texts: Vec<String> = some.par_chunks(LINES).map(|c| c.iter().map(&line).collect::<String>()).collect();
        texts.iter().try_for_each(|t| out.write_all(t.as_bytes()))?;
    }
    Ok(())
}

/// What the document of a GLB file says about a part beside its counts.
type Bounds = [[f32; 3]; 2];

/// Bytes of the positions, places in images and indices of a part.
fn glb_lengths(counts: Counts) -> [u64; 3] {
    [counts.wedges * 12, counts.wedges * 8, counts.triangles * 12]
}

/// Images, then part by part positions, places in images and indices. The document comes first in the file and is
/// known last, so it is written into room that was left for it.
pub fn glb(scene: &Scene, path: &Path) -> Result<()> {
    let geometry: u64 = parts(scene).map(|(_, part, _)| glb_lengths(part.counts()).iter().sum::<u64>()).sum();
    let refuse = |bytes: u64| {
        let gib = bytes as f64 / (1u64 << 30) as f64;
        ensure!(
            bytes < GLB_LIMIT,
            "{}: {gib:.1} GiB are more than the 4 of a GLB file; write .ply or .obj",
            path.display()
        );
        Ok(())
    };
    refuse(geometry)?;
    let folder = tempfile::tempdir_in(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
    let images = images(scene, &folder.path().join("image.png"))?;
    let image_bytes: Vec<u64> = images.iter().map(|i| Ok(std::fs::metadata(i)?.len())).collect::<Result<_>>()?;
    let starts: Vec<u64> = std::iter::once(0)
        .chain(image_bytes.iter().scan(0, |sum, b| {
            *sum += b.next_multiple_of(4);
            Some(*sum)
        }))
        .collect();
    let binary = starts[images.len()] + geometry;
    // The widest numbers there are.
    let widest = vec![[[f32::MIN; 3], [f32::MAX; 3]]; parts(scene).count()];
    let room = (document(scene, &image_bytes, &starts, &widest).len() as u64).next_multiple_of(4);
    let whole = 12 + 8 + room + 8 + binary;
    refuse(whole)?;
    let mut out = BufWriter::with_capacity(BUFFER, create(path)?);
    let words = |list: &[u64]| list.iter().flat_map(|w| (*w as u32).to_le_bytes()).collect::<Vec<u8>>();
    out.write_all(&words(&[0x4654_6c67, 2, whole, room, 0x4e4f_534a]))?;
    out.write_all(&vec![b' '; room as usize])?;
    out.write_all(&words(&[binary, 0x004e_4942]))?;
    for (image, bytes) in images.iter().zip(&image_bytes) {
        std::io::copy(&mut std::fs::File::open(image)?, &mut out)?;
        out.write_all(&vec![0; (bytes.next_multiple_of(4) - bytes) as usize])?;
        std::fs::remove_file(image)?;
    }
    let bounds: Vec<Bounds> = parts(scene).map(|(_, part, _)| glb_part(part, &mut out)).collect::<Result<_>>()?;
    out.seek(SeekFrom::Start(20))?;
    out.write_all(&document(scene, &image_bytes, &starts, &bounds))?;
    Ok(out.flush()?)
}

fn glb_part(part: &Part, out: &mut impl Write) -> Result<Bounds> {
    let (positions, topology) = (part.positions(), part.topology());
    for wedge in &topology.wedges {
        positions[wedge.position as usize].iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
    }
    topology.wedges.iter().flat_map(|w| w.uv).try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
    topology.triangles.iter().flatten().try_for_each(|i| out.write_all(&i.to_le_bytes()))?;
    Ok(positions.iter().fold([[f32::MAX; 3], [f32::MIN; 3]], |[low, high], p| {
        [std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k]))]
    }))
}

/// The document of a GLB file.
fn document(scene: &Scene, image_bytes: &[u64], starts: &[u64], bounds: &[Bounds]) -> Vec<u8> {
    let mut views: Vec<Value> = (image_bytes.iter().zip(starts))
        .map(|(bytes, start)| json!({ "buffer": 0, "byteOffset": start, "byteLength": bytes }))
        .collect();
    let mut accessors = Vec::new();
    let mut primitives: Vec<Vec<Value>> = vec![Vec::new(); scene.units.len()];
    let mut offset = starts[image_bytes.len()];
    for ((number, part, _), [low, high]) in parts(scene).zip(bounds) {
        let (counts, first) = (part.counts(), accessors.len());
        for length in glb_lengths(counts) {
            views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
            offset += length;
        }
        let view = views.len() - 3;
        accessors.extend([
            json!({ "bufferView": view, "componentType": 5126, "type": "VEC3", "count": counts.wedges, "min": low, "max": high }),
            json!({ "bufferView": view + 1, "componentType": 5126, "type": "VEC2", "count": counts.wedges }),
            json!({ "bufferView": view + 2, "componentType": 5125, "type": "SCALAR", "count": counts.triangles * 3 }),
        ]);
        primitives[number].push(json!({
            "attributes": { "POSITION": first, "TEXCOORD_0": first + 1 }, "indices": first + 2, "material": number,
        }));
    }
    let count = scene.units.len();
    let each = |make: &dyn Fn(usize) -> Value| (0..count).map(make).collect::<Vec<Value>>();
    let material =
        |i: usize| json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": i }, "metallicFactor": 0 } });
    let text = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": (0..count).collect::<Vec<_>>() }],
        "nodes": each(&|i| json!({ "mesh": i })), "meshes": each(&|i| json!({ "primitives": primitives[i] })),
        "materials": each(&material), "textures": each(&|i| json!({ "source": i })),
        "images": each(&|i| json!({ "bufferView": i, "mimeType": "image/png" })),
        "accessors": accessors, "bufferViews": views, "buffers": [{ "byteLength": offset }],
    });
    text.to_string().into_bytes()
}
