//! Triangle meshes for measurements: a reader of PLY and OBJ of its own, so that a mistake in the product's
//! importers cannot hide itself, and a binary PLY and OBJ writer.
//!
//! Reads positions and faces only; polygons become fans.

use std::collections::HashMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

/// Positions (input units) and triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Reads a .ply or .obj file.
    pub fn read(path: &Path) -> Result<Mesh> {
        let bytes = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let mesh = match path.extension().and_then(|e| e.to_str()) {
            Some("ply") => read_ply(&bytes),
            Some("obj") => read_obj(&bytes),
            _ => bail!("{}: only .ply and .obj can be measured", path.display()),
        };
        let mesh = mesh.with_context(|| path.display().to_string())?;
        let count = mesh.positions.len() as u32;
        ensure!(mesh.triangles.iter().flatten().all(|&i| i < count), "{}: face index out of range", path.display());
        Ok(mesh)
    }

    /// Writes a .ply (binary, f32) or .obj file.
    pub fn write(&self, path: &Path) -> Result<()> {
        let file = std::fs::File::create(path).with_context(|| format!("{}: cannot be written", path.display()))?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        match path.extension().and_then(|e| e.to_str()) {
            Some("ply") => self.write_ply(&mut out)?,
            Some("obj") => self.write_obj(&mut out)?,
            _ => bail!("{}: only .ply and .obj can be written", path.display()),
        }
        Ok(out.flush()?)
    }

    fn write_ply(&self, out: &mut impl Write) -> Result<()> {
        let (v, f) = (self.positions.len(), self.triangles.len());
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {v}\nproperty float x\nproperty float y\n")?;
        write!(out, "property float z\nelement face {f}\nproperty list uchar int vertex_indices\nend_header\n")?;
        for p in &self.positions {
            p.iter().try_for_each(|&x| out.write_all(&(x as f32).to_le_bytes()))?;
        }
        for t in &self.triangles {
            out.write_all(&[3])?;
            t.iter().try_for_each(|&i| out.write_all(&i.to_le_bytes()))?;
        }
        Ok(())
    }

    fn write_obj(&self, out: &mut impl Write) -> Result<()> {
        for p in &self.positions {
            writeln!(out, "v {} {} {}", p[0] as f32, p[1] as f32, p[2] as f32)?;
        }
        for t in &self.triangles {
            writeln!(out, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1)?;
        }
        Ok(())
    }

    /// Joins positions that are equal in all bits; drops triangles that lose a corner by it, and vertices that
    /// no triangle uses. Vertices keep the order of their first use.
    pub fn welded(&self) -> Mesh {
        let mut seen: HashMap<[u64; 3], u32> = HashMap::with_capacity(self.positions.len());
        let mut out = Mesh::default();
        for t in &self.triangles {
            let corners = t.map(|i| {
                let p = self.positions[i as usize].map(|x| x + 0.0);
                *seen.entry(p.map(f64::to_bits)).or_insert_with(|| {
                    out.positions.push(p);
                    out.positions.len() as u32 - 1
                })
            });
            if corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0] {
                out.triangles.push(corners);
            }
        }
        out
    }

    /// Lowest and highest corner of the bounding box.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        self.positions.iter().fold(([f64::MAX; 3], [f64::MIN; 3]), |(low, high), p| {
            (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
        })
    }

    /// Length of the diagonal of the bounding box.
    pub fn diagonal(&self) -> f64 {
        let (low, high) = self.bounds();
        (0..3).map(|k| (high[k] - low[k]).powi(2)).sum::<f64>().sqrt()
    }
}

fn read_obj(bytes: &[u8]) -> Result<Mesh> {
    let mut mesh = Mesh::default();
    for (number, line) in String::from_utf8_lossy(bytes).lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let p: Vec<f64> = words.take(3).map(str::parse).collect::<Result<_, _>>()?;
                let p = p.try_into().map_err(|_| anyhow::anyhow!("line {}: a vertex needs 3 numbers", number + 1))?;
                mesh.positions.push(p);
            }
            Some("f") => {
                let count = mesh.positions.len() as i64;
                let index = |word: &str| -> Result<u32> {
                    let i: i64 = word.split('/').next().unwrap_or(word).parse()?;
                    Ok(u32::try_from(if i < 0 { count + i } else { i - 1 })?)
                };
                let polygon: Vec<u32> =
                    words.map(index).collect::<Result<_>>().with_context(|| format!("line {}", number + 1))?;
                fan(&polygon, &mut mesh.triangles);
            }
            _ => {}
        }
    }
    Ok(mesh)
}

fn fan(polygon: &[u32], triangles: &mut Vec<[u32; 3]>) {
    triangles.extend((1..polygon.len().max(1) - 1).map(|k| [polygon[0], polygon[k], polygon[k + 1]]));
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

struct Property {
    name: String,
    kind: String,
    /// Type of the count where the property is a list.
    count: Option<String>,
}

struct Element {
    name: String,
    rows: usize,
    properties: Vec<Property>,
}

/// The values of a PLY body, one after another.
struct Values<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Values<'_> {
    fn next(&mut self, kind: &str) -> Result<f64> {
        if self.encoding == Encoding::Ascii {
            let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).context("the file is cut short")?;
            let word = &self.rest[start..];
            let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
            self.rest = &word[end..];
            return Ok(std::str::from_utf8(&word[..end])?.parse()?);
        }
        let size = match kind {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            "int" | "uint" | "int32" | "uint32" | "float" | "float32" => 4,
            "double" | "float64" => 8,
            other => bail!("unknown PLY type {other}"),
        };
        ensure!(self.rest.len() >= size, "the file is cut short");
        let (value, rest) = self.rest.split_at(size);
        self.rest = rest;
        let mut b = [0u8; 8];
        b[..size].copy_from_slice(value);
        if self.encoding == Encoding::Big {
            b[..size].reverse();
        }
        let bits = u64::from_le_bytes(b);
        Ok(match kind {
            "char" | "int8" => bits as i8 as f64,
            "short" | "int16" => bits as i16 as f64,
            "int" | "int32" => bits as i32 as f64,
            "float" | "float32" => f32::from_bits(bits as u32) as f64,
            "double" | "float64" => f64::from_bits(bits),
            _ => bits as f64,
        })
    }
}

fn read_ply(bytes: &[u8]) -> Result<Mesh> {
    let marker = b"end_header";
    let end = bytes.windows(marker.len()).position(|w| w == marker).context("no end_header")?;
    let body = end + bytes[end..].iter().position(|&b| b == b'\n').context("no line end after end_header")? + 1;
    let (encoding, elements) = ply_header(std::str::from_utf8(&bytes[..end])?)?;
    let mut values = Values { rest: &bytes[body..], encoding };
    let mut mesh = Mesh::default();
    for element in &elements {
        for _ in 0..element.rows {
            ply_row(element, &mut values, &mut mesh)?;
        }
    }
    Ok(mesh)
}

fn ply_header(text: &str) -> Result<(Encoding, Vec<Element>)> {
    let (mut encoding, mut elements) = (Encoding::Ascii, Vec::<Element>::new());
    for line in text.lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let property = |kind: &str, name: &str, count: Option<&str>| Property {
            name: name.into(),
            kind: kind.into(),
            count: count.map(Into::into),
        };
        match words[..] {
            ["format", "binary_little_endian", _] => encoding = Encoding::Little,
            ["format", "binary_big_endian", _] => encoding = Encoding::Big,
            ["element", name, rows] => {
                elements.push(Element { name: name.into(), rows: rows.parse()?, properties: vec![] });
            }
            ["property", "list", count, kind, name] => {
                elements.last_mut().context("property before element")?.properties.push(property(
                    kind,
                    name,
                    Some(count),
                ));
            }
            ["property", kind, name] => {
                elements.last_mut().context("property before element")?.properties.push(property(kind, name, None));
            }
            _ => {}
        }
    }
    Ok((encoding, elements))
}

fn ply_row(element: &Element, values: &mut Values, mesh: &mut Mesh) -> Result<()> {
    let mut position = [0.0; 3];
    for property in &element.properties {
        let Some(count_kind) = &property.count else {
            let value = values.next(&property.kind)?;
            if let Some(axis) = ["x", "y", "z"].iter().position(|n| *n == property.name) {
                position[axis] = value;
            }
            continue;
        };
        let count = values.next(count_kind)? as usize;
        let list: Vec<f64> = (0..count).map(|_| values.next(&property.kind)).collect::<Result<_>>()?;
        if element.name == "face" && property.name.starts_with("vertex_ind") {
            let polygon: Vec<u32> = list.iter().map(|&i| i as u32).collect();
            fan(&polygon, &mut mesh.triangles);
        }
    }
    if element.name == "vertex" {
        mesh.positions.push(position);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Mesh {
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, -2.0]];
        Mesh { positions, triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.ply", "a.obj"] {
            let path = folder.path().join(name);
            tetrahedron().write(&path).unwrap();
            assert_eq!(Mesh::read(&path).unwrap(), tetrahedron(), "{name}");
        }
    }

    #[test]
    fn reads_ascii_and_big_endian_polygons() {
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment x\nelement vertex 4\nproperty double x\nproperty float y\n\
                 property short z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
            )
        };
        let ascii = header("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 -7\n4 0 1 2 3\n";
        let mut big = header("binary_big_endian").into_bytes();
        for (x, y, z) in [(0.0f64, 0.0f32, 0i16), (1.0, 0.0, 0), (1.0, 1.0, 0), (0.0, 1.0, -7)] {
            big.extend(x.to_be_bytes());
            big.extend(y.to_be_bytes());
            big.extend(z.to_be_bytes());
        }
        big.push(4);
        (0..4i32).for_each(|i| big.extend(i.to_be_bytes()));
        let mesh = read_ply(&big).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[3], [0.0, 1.0, -7.0]);
        assert_eq!(read_ply(ascii.as_bytes()).unwrap(), mesh);
        assert!(read_ply(&big[..big.len() - 1]).is_err());
    }

    #[test]
    fn welding_joins_equal_positions_and_drops_what_collapses() {
        let mut mesh = tetrahedron();
        mesh.positions.push([1.0, 0.0, -0.0]);
        mesh.triangles[1] = [0, 4, 3];
        mesh.triangles.push([0, 1, 4]);
        let welded = mesh.welded();
        assert_eq!((welded.positions.len(), welded.triangles.len()), (4, 4));
    }
}
