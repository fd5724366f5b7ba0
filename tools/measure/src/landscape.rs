//! A height field of any size, written row by row: nothing but a few rows is in memory.

use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use rayon::prelude::*;
use serde_json::{Value, json};

use crate::random::{noise, octaves};

/// Rows that are made at a time.
const ROWS: u32 = 64;

/// Writes `2 n^2`, about `triangles`, triangles as a binary PLY: ridges with detail down to the edge length.
pub fn write(path: &Path, triangles: usize, seed: u64) -> Result<Value> {
    let n = ((triangles as f64 / 2.0).sqrt().round() as u32).max(1);
    let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    let (vertices, faces) = (u64::from(n + 1).pow(2), 2 * u64::from(n).pow(2));
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\n")?;
    write!(out, "property float y\nproperty float z\nelement face {faces}\n")?;
    write!(out, "property list uchar int vertex_indices\nend_header\n")?;
    in_blocks(&mut out, n + 1, |y| vertex_row(n, y, seed))?;
    in_blocks(&mut out, n, |y| face_row(n, y))?;
    out.flush()?;
    Ok(json!({ "triangles": faces, "vertices": vertices }))
}

fn in_blocks(out: &mut impl Write, rows: u32, row: impl Fn(u32) -> Vec<u8> + Sync) -> Result<()> {
    for first in (0..rows).step_by(ROWS as usize) {
        let block: Vec<Vec<u8>> = (first..rows.min(first + ROWS)).into_par_iter().map(&row).collect();
        block.iter().try_for_each(|bytes| out.write_all(bytes))?;
    }
    Ok(())
}

fn vertex_row(n: u32, y: u32, seed: u64) -> Vec<u8> {
    let detail = f64::from(n).log2().ceil() as u32;
    let vertex = |x: u32| {
        let p = [x, y].map(|c| f64::from(c) / f64::from(n) * 10.0);
        let ridge = 1.0 - octaves([p[0] * 0.3, p[1] * 0.3, 0.5], seed, detail, 0.5).abs();
        let height = ridge * ridge + 0.2 * noise([p[0] * 0.2, p[1] * 0.2, 9.5], seed);
        [p[0], p[1], height].map(|c| (c as f32).to_le_bytes())
    };
    (0..=n).flat_map(vertex).flatten().collect()
}

fn face_row(n: u32, y: u32) -> Vec<u8> {
    let at = |x: u32, y: u32| y * (n + 1) + x;
    let face = |t: [u32; 3]| std::iter::once(3u8).chain(t.into_iter().flat_map(u32::to_le_bytes));
    let quad = |x: u32| {
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        face([a, b, c]).chain(face([a, c, d]))
    };
    (0..n).flat_map(quad).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    #[test]
    fn what_is_written_row_by_row_is_one_open_sheet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("land.ply");
        let counts = write(&path, 20_000, 3).unwrap();
        let mesh = Mesh::read(&path).unwrap();
        assert_eq!((counts["triangles"].as_u64(), mesh.triangles.len()), (Some(20_000), 20_000));
        assert_eq!(mesh.positions.len(), 101 * 101);
        assert_eq!(crate::watertight::check(&mesh).unmatched_edges, 400, "the rim");
    }
}
