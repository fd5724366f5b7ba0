//! What comes before the bake, kept: the repaired mesh and what is said about the input.
//!
//! Of a scene with images only a sum is kept: it is read and decoded again, which takes a small part of the time that its
//! texels take, and must be what it was.

use super::Job;
use crate::scene::Scene;
use glam::{DQuat, DVec3};
use pb_bake::import::InputReport;
use pb_lod::progressive_buffers::bake::checkpoints::{Checkpoints, put_list, take_list};
use pb_mesh::corners::Topology;
use pb_mesh::mesh::{Mesh, Wedge};
use pb_mesh::objects::{Objects, Placement};
use pb_mesh::repair::RepairReport;
use pb_mesh::split::Added;
use std::io::{Error, Read, Result, Write};
use std::path::PathBuf;
use xxhash_rust::xxh3::Xxh3;

/// Names of the steps.
const MESH: &str = "mesh";
const SUM: &str = "sum";

/// Wedges that are turned into words at a time.
const BLOCK: usize = 1 << 14;

impl Job<'_> {
    /// The scene without images that was kept. Where a file that an input refers to has changed since, all that was kept goes.
    pub fn load_scene(&mut self) -> Option<Scene> {
        let (stamps, scene) = {
            let mut input = self.load(MESH, 0)?;
            let stamps = take_list::<u8>(&mut input).ok()?;
            let (inputs, repairs, mesh) = read(&mut input).ok()?;
            (stamps, Scene { mesh, materials: Vec::new(), images: Vec::new(), inputs, repairs, textures: None })
        };
        if stamps == stamps_of(&scene.inputs).as_bytes() {
            return Some(scene);
        }
        self.progress.note("a file that the input refers to has changed since the bake was cut short; it begins anew");
        self.clear();
        None
    }

    /// Keeps a scene without images.
    pub fn save_scene(&self, scene: &Scene) {
        self.save(MESH, 0, &|out| {
            put_list(out, stamps_of(&scene.inputs).as_bytes())?;
            write(scene, out)
        });
    }

    /// Whether a scene with images is the one that the steps were kept for; the first one is.
    pub fn is_same_scene(&self, scene: &Scene) -> bool {
        if self.folder.is_none() {
            return true;
        }
        let mut sum = Sum(Xxh3::new());
        write(scene, &mut sum).expect("a sum takes all");
        let _ = write!(sum, "{:?}", scene.materials);
        for image in &scene.images {
            let _ = write!(sum, "{} {} {:?}", image.width(), image.height(), image.format());
            sum.0.update(image.bytes());
        }
        let sum = [sum.0.digest()];
        match self.load(SUM, 0).map(|mut input| take_list::<u64>(&mut input)) {
            Some(known) => known.is_ok_and(|known| known == sum),
            None => {
                self.save(SUM, 0, &|out| put_list(out, &sum));
                true
            }
        }
    }
}

/// Size and time of all files that the inputs refer to; the inputs' own are in the job's origin.
fn stamps_of(inputs: &[InputReport]) -> String {
    let stamp = |path: &PathBuf| format!("{}\n", super::stamp(path));
    inputs.iter().flat_map(|input| &input.companions).map(stamp).collect()
}

struct Sum(Xxh3);

impl Write for Sum {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

fn write(scene: &Scene, out: &mut dyn Write) -> Result<()> {
    let Scene { mesh, inputs, repairs, .. } = scene;
    let Mesh { positions, wedges, triangles, has_colors, texturing: _, objects: Objects { of, placements } } = mesh;
    put_list(out, &serde_json::to_vec(inputs).map_err(Error::other)?)?;
    put_list(out, &numbers(repairs))?;
    put_list(out, positions)?;
    put_list(out, triangles)?;
    put_list(out, &[u8::from(*has_colors)])?;
    put_list(out, of)?;
    put_list(out, &placements.iter().map(|list| list.len() as u64).collect::<Vec<_>>())?;
    put_list(out, &placements.iter().flatten().map(numbers_of).collect::<Vec<_>>())?;
    for block in wedges.chunks(BLOCK) {
        put_list(out, &block.iter().map(words).collect::<Vec<_>>())?;
    }
    put_list::<[u32; 5]>(out, &[])
}

fn read(input: &mut dyn Read) -> Result<(Vec<InputReport>, RepairReport, Mesh)> {
    let inputs = serde_json::from_slice(&take_list::<u8>(input)?).map_err(Error::other)?;
    let repairs = repairs(&take_list(input)?).ok_or_else(|| Error::other("a count is missing"))?;
    let (positions, triangles) = (take_list(input)?, take_list(input)?);
    let has_colors = take_list::<u8>(input)? == [1];
    let objects = objects(take_list(input)?, &take_list(input)?, &take_list(input)?)?;
    let mut wedges = Vec::new();
    loop {
        let block = take_list::<[u32; 5]>(input)?;
        if block.is_empty() {
            break;
        }
        wedges.extend(block.iter().map(wedge));
    }
    Ok((inputs, repairs, Mesh { positions, wedges, triangles, has_colors, objects, texturing: None }))
}

/// From the list of positions, the number of places of each object, and all of these.
fn objects(of: Vec<u32>, counts: &[u64], places: &[[f64; 8]]) -> Result<Objects> {
    let mut rest = places;
    let mut placements = Vec::new();
    for &count in counts {
        let (own, after) = rest.split_at_checked(count as usize).ok_or_else(|| Error::other("a place is missing"))?;
        placements.push(own.iter().map(placement).collect());
        rest = after;
    }
    Ok(Objects { of, placements })
}

fn numbers_of(placement: &Placement) -> [f64; 8] {
    let ([a, b, c, d], [x, y, z]) = (placement.rotation.to_array(), placement.translation.to_array());
    [a, b, c, d, placement.scale, x, y, z]
}

fn placement(&[a, b, c, d, scale, x, y, z]: &[f64; 8]) -> Placement {
    Placement { rotation: DQuat::from_xyzw(a, b, c, d), scale, translation: DVec3::new(x, y, z) }
}

fn words(wedge: &Wedge) -> [u32; 5] {
    let [x, y, z] = wedge.normal.map(f32::to_bits);
    [wedge.position, x, y, z, u32::from_ne_bytes(wedge.color)]
}

fn wedge(&[position, x, y, z, color]: &[u32; 5]) -> Wedge {
    Wedge { position, normal: [x, y, z].map(f32::from_bits), color: color.to_ne_bytes() }
}

/// All counts of a report in their order, and its flags.
fn counts(report: &mut RepairReport) -> ([&mut u64; 17], [&mut bool; 2]) {
    let RepairReport {
        triangles_in,
        records_in,
        polygons_triangulated,
        positions_welded,
        unreferenced_dropped,
        degenerate_removed,
        duplicates_removed,
        zero_area_kept,
        normals_made,
        normals_repaired,
        uvs_repaired,
        facet_normals_replaced,
        sorted_along_curve,
        split: Added { copies, middles, triangles },
        topology: Topology { boundary_edges, nonmanifold_edges, nonmanifold_vertices },
    } = report;
    let counts = [
        triangles_in,
        records_in,
        polygons_triangulated,
        positions_welded,
        unreferenced_dropped,
        degenerate_removed,
        duplicates_removed,
        zero_area_kept,
        normals_made,
        normals_repaired,
        uvs_repaired,
        copies,
        middles,
        triangles,
        boundary_edges,
        nonmanifold_edges,
        nonmanifold_vertices,
    ];
    (counts, [facet_normals_replaced, sorted_along_curve])
}

/// The counts, and the flags behind them.
fn numbers(repairs: &RepairReport) -> Vec<u64> {
    let mut report = *repairs;
    let (counts, flags) = counts(&mut report);
    counts.into_iter().map(|n| *n).chain(flags.map(|f| u64::from(*f))).collect()
}

fn repairs(numbers: &[u64]) -> Option<RepairReport> {
    let mut report = RepairReport::default();
    let (counts, flags) = counts(&mut report);
    let (known, raised) = numbers.split_at_checked(counts.len())?;
    if raised.len() != flags.len() {
        return None;
    }
    counts.into_iter().zip(known).for_each(|(count, n)| *count = *n);
    flags.into_iter().zip(raised).for_each(|(flag, n)| *flag = *n != 0);
    Some(report)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_is_what_was_written() {
        let wedge =
            |position: u32| Wedge { position, normal: [0.5, -0.0, position as f32], color: [1, 2, 3, position as u8] };
        let place = |scale: f64| placement(&[0.0, 0.6, 0.0, 0.8, scale, -1.0, 1e-300, scale * 7.0]);
        let numbers: Vec<u64> = (0..17).map(|i| i * 7).chain([0, 1]).collect();
        let mesh = Mesh {
            positions: (0..9).map(|i| [f64::from(i), 0.1, 1e300]).collect(),
            wedges: (0..BLOCK as u32 + 3).map(wedge).collect(),
            triangles: vec![[0, 1, 2], [2, 1, 3]],
            has_colors: true,
            objects: Objects {
                of: vec![0, 0, 1, 2, 2, 2, 2, 2, 2],
                placements: vec![vec![place(1.0)], vec![place(0.5), place(3.0)]],
            },
            texturing: None,
        };
        let input = InputReport {
            path: "a b.ply".into(),
            format: pb_bake::import::Format::Ply,
            bytes: 5,
            triangles: 2,
            vertices: 4,
            instances: pb_bake::import::InstanceCounts { objects: 2, instances: 3, apart: 1 },
            companions: vec!["c d.mtl".into()],
            warnings: vec!["odd".into()],
        };
        let scene = Scene {
            mesh,
            materials: Vec::new(),
            images: Vec::new(),
            inputs: vec![input],
            repairs: repairs(&numbers).unwrap(),
            textures: None,
        };
        let mut bytes = Vec::new();
        write(&scene, &mut bytes).unwrap();
        let (inputs, known, mesh) = read(&mut bytes.as_slice()).unwrap();
        assert_eq!((inputs, mesh), (scene.inputs, scene.mesh));
        assert_eq!(super::numbers(&known), numbers);
        assert!(read(&mut &bytes[..bytes.len() - 1]).is_err());
    }
}
