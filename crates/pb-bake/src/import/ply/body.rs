//! The body of a PLY file: rows of the elements, one after the other.

use super::super::Input;
use super::super::error::{ImportError, Refusal, damaged, refused};
use super::collect_rows;
use super::header::{Element, Header, Kind};
use super::scalar::{Encoding, Scalar};
use rayon::prelude::*;

/// Reads elements in the order of the header.
pub(super) struct Body<'a> {
    input: &'a Input<'a>,
    encoding: Encoding,
    /// Of the next value.
    offset: usize,
}

/// All rows of an element without lists, or the scalars of one with.
pub(super) enum Rows<'a> {
    /// In place, in a binary body.
    Packed { bytes: &'a [u8], stride: usize, count: usize, columns: Vec<(usize, Scalar)>, encoding: Encoding },
    /// Read before; a list has one unused value.
    Parsed { values: Vec<f64>, count: usize, kinds: Vec<Scalar> },
}

impl Rows<'_> {
    #[inline]
    pub(super) fn value(&self, row: usize, column: usize) -> f64 {
        match self {
            Rows::Packed { bytes, stride, columns, encoding, .. } => {
                let (offset, scalar) = columns[column];
                scalar.read(&bytes[row * stride + offset..], *encoding)
            }
            Rows::Parsed { values, kinds, .. } => values[row * kinds.len() + column],
        }
    }

    pub(super) fn kind(&self, column: usize) -> Scalar {
        match self {
            Rows::Packed { columns, .. } => columns[column].1,
            Rows::Parsed { kinds, .. } => kinds[column],
        }
    }

    /// One item per row, in order.
    pub(super) fn collect<T: Send>(&self, make: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        match *self {
            Rows::Packed { count, .. } | Rows::Parsed { count, .. } => collect_rows(count, make),
        }
    }
}

/// The vertex lists of an element.
pub(super) enum Faces {
    Triangles(Vec<[u32; 3]>),
    /// The i-th is `indices[ends[i - 1]..ends[i]]`.
    Polygons(Polygons),
}

/// Faces of any number of corners.
#[derive(Default)]
pub(super) struct Polygons {
    pub(super) indices: Vec<u32>,
    pub(super) ends: Vec<usize>,
    /// Empty, or one per index: texture coordinates with v upwards.
    pub(super) uvs: Vec<[f32; 2]>,
    /// Empty, or one per polygon: number of its image, from 0.
    pub(super) textures: Vec<u32>,
}

impl Faces {
    /// At least as many triangles as will come of it.
    pub(super) fn triangle_bound(&self) -> usize {
        match self {
            Faces::Triangles(triangles) => triangles.len(),
            Faces::Polygons(polygons) => polygons.indices.len(),
        }
    }

    /// The first face with an index of `count` or more, and the index.
    pub(super) fn first_bad_index(&self, count: usize) -> Option<(usize, u32)> {
        match self {
            Faces::Triangles(triangles) => {
                let face = triangles.par_iter().position_first(|t| t.iter().any(|&i| i as usize >= count))?;
                triangles[face].iter().find(|&&i| i as usize >= count).map(|&i| (face, i))
            }
            Faces::Polygons(Polygons { indices, ends, .. }) => {
                let at = indices.iter().position(|&i| i as usize >= count)?;
                Some((ends.partition_point(|&end| end <= at), indices[at]))
            }
        }
    }
}

impl<'a> Body<'a> {
    pub(super) fn new(input: &'a Input<'a>, header: &Header) -> Body<'a> {
        Body { input, encoding: header.encoding, offset: header.size }
    }

    pub(super) fn name(&self) -> &'a str {
        self.input.name
    }

    /// Refuses a count that the rest of the file cannot hold.
    pub(super) fn check_room(&self, element: &Element) -> Result<(), ImportError> {
        let left = self.input.bytes.len() - self.offset;
        // A value of an ascii body takes a digit and a blank, but for the last one.
        let (row, left) = match self.encoding {
            Encoding::Ascii => (2 * element.properties.len() as u64, left as u64 + 1),
            _ => (element.least_size() as u64, left as u64),
        };
        if element.count.checked_mul(row).is_none_or(|needed| needed > left) {
            let Element { name, count, .. } = element;
            let what = format!("the header promises {count} rows of \"{name}\", but only {left} bytes follow");
            return Err(damaged(self.name(), what));
        }
        Ok(())
    }

    /// Passes over an element.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), ImportError> {
        if self.encoding != Encoding::Ascii && !element.has_lists() {
            self.offset += element.count as usize * element.least_size();
            return Ok(());
        }
        self.each_row(element, |_, _, _| Ok(()))
    }

    /// The scalars of an element.
    pub(super) fn rows(&mut self, element: &Element) -> Result<Rows<'a>, ImportError> {
        let count = element.count as usize;
        if self.encoding != Encoding::Ascii && !element.has_lists() {
            let stride = element.least_size();
            let mut columns = Vec::new();
            let mut offset = 0;
            for property in &element.properties {
                if let Kind::One(scalar) = property.kind {
                    columns.push((offset, scalar));
                    offset += scalar.size();
                }
            }
            let bytes = &self.input.bytes[self.offset..self.offset + count * stride];
            self.offset += count * stride;
            return Ok(Rows::Packed { bytes, stride, count, columns, encoding: self.encoding });
        }
        let kinds: Vec<Scalar> = element
            .properties
            .iter()
            .map(|p| match p.kind {
                Kind::One(scalar) => scalar,
                Kind::List { item, .. } => item,
            })
            .collect();
        let mut values = vec![0.0; count * kinds.len()];
        self.each_row(element, |row, column, items| {
            values[row * kinds.len() + column] = items.first().copied().unwrap_or(0.0);
            Ok(())
        })?;
        Ok(Rows::Parsed { values, count, kinds })
    }

    /// The polygons of a face element; with their texture coordinates where those are there and wanted.
    pub(super) fn faces(&mut self, element: &Element, wants_uvs: bool) -> Result<Faces, ImportError> {
        let column = self.index_column(element, "face")?;
        if wants_uvs && let Some(uv_column) = element.list("texcoord") {
            return self.textured_faces(element, column, uv_column).map(Faces::Polygons);
        }
        if let Some(triangles) = self.packed_triangles(element, column) {
            return Ok(Faces::Triangles(triangles));
        }
        let (mut indices, mut ends) = (Vec::new(), Vec::new());
        let name = self.name();
        self.each_row(element, |row, at, items| {
            if at == column {
                for &item in items {
                    indices.push(as_index(item).ok_or_else(|| {
                        damaged(name, format!("face {row} (counted from 0) refers to vertex {item}"))
                    })?);
                }
                ends.push(indices.len());
            }
            Ok(())
        })?;
        Ok(Faces::Polygons(Polygons { indices, ends, ..Polygons::default() }))
    }

    /// A list of the wrong length makes all texture coordinates of its face (0, 0).
    fn textured_faces(&mut self, element: &Element, column: usize, uv_column: usize) -> Result<Polygons, ImportError> {
        let texture_column = element.scalar("texnumber");
        let last = element.properties.len() - 1;
        let (mut all, mut row_uvs) = (Polygons::default(), Vec::new());
        let name = self.name();
        self.each_row(element, |row, at, items| {
            if at == column {
                for &item in items {
                    all.indices.push(as_index(item).ok_or_else(|| {
                        damaged(name, format!("face {row} (counted from 0) refers to vertex {item}"))
                    })?);
                }
                all.ends.push(all.indices.len());
            } else if at == uv_column {
                row_uvs.clear();
                row_uvs.extend(items.chunks_exact(2).map(|uv| [uv[0] as f32, uv[1] as f32]));
            } else if Some(at) == texture_column {
                all.textures.push(as_index(items[0]).unwrap_or(u32::MAX));
            }
            if at == last {
                let corners = all.indices.len() - all.uvs.len();
                if row_uvs.len() == corners {
                    all.uvs.append(&mut row_uvs);
                } else {
                    all.uvs.resize(all.indices.len(), [0.0; 2]);
                }
            }
            Ok(())
        })?;
        Ok(all)
    }

    /// The triangles of a strip element: lists of indices, cut by -1.
    pub(super) fn strips(&mut self, element: &Element) -> Result<Faces, ImportError> {
        let column = self.index_column(element, "tristrips")?;
        let mut triangles = Vec::new();
        let name = self.name();
        self.each_row(element, |row, at, items| {
            if at != column {
                return Ok(());
            }
            for strip in items.split(|&i| i == -1.0) {
                for (i, window) in strip.windows(3).enumerate() {
                    let [a, b, c] = [window[0], window[1], window[2]].map(as_index);
                    let (Some(a), Some(b), Some(c)) = (a, b, c) else {
                        return Err(damaged(name, format!("strip {row} (counted from 0) has a negative index")));
                    };
                    triangles.push(if i % 2 == 0 { [a, b, c] } else { [b, a, c] });
                }
            }
            Ok(())
        })?;
        Ok(Faces::Triangles(triangles))
    }

    fn index_column(&self, element: &Element, what: &str) -> Result<usize, ImportError> {
        let named = |p: &super::header::Property| p.name == "vertex_indices" || p.name == "vertex_index";
        let found = element.properties.iter().position(|p| named(p) && matches!(p.kind, Kind::List { .. }));
        match found.map(|column| (column, element.properties[column].kind)) {
            Some((column, Kind::List { item, .. })) if !item.is_float() => Ok(column),
            Some(_) => Err(damaged(self.name(), format!("the vertex indices of \"{what}\" are no integers"))),
            // No list and no rows: nothing is missing.
            None if element.count == 0 => Ok(usize::MAX),
            None => Err(damaged(self.name(), format!("the element \"{what}\" has no list \"vertex_indices\""))),
        }
    }

    /// Reads a binary face element in parallel when all its lists have three items; else leaves all as it was.
    fn packed_triangles(&mut self, element: &Element, column: usize) -> Option<Vec<[u32; 3]>> {
        if self.encoding == Encoding::Ascii {
            return None;
        }
        let (mut stride, mut at) = (0, None);
        for (i, property) in element.properties.iter().enumerate() {
            match property.kind {
                Kind::One(scalar) => stride += scalar.size(),
                Kind::List { count, item } if i == column => {
                    at = Some((stride, count, item));
                    stride += count.size() + 3 * item.size();
                }
                Kind::List { .. } => return None,
            }
        }
        let (offset, count, item) = at?;
        let size = (element.count as usize).checked_mul(stride)?;
        let bytes = self.input.bytes.get(self.offset..)?.get(..size)?;
        let encoding = self.encoding;
        let triangles: Option<Vec<[u32; 3]>> = bytes
            .par_chunks_exact(stride)
            .with_min_len(super::CHUNK)
            .map(|row| {
                let list = &row[offset..];
                let index = |k: usize| as_index(item.read(&list[count.size() + k * item.size()..], encoding));
                (count.read(list, encoding) == 3.0).then_some(())?;
                Some([index(0)?, index(1)?, index(2)?])
            })
            .collect();
        self.offset += if triangles.is_some() { size } else { 0 };
        triangles
    }

    /// Calls `take(row, column, values)` for every property of every row.
    fn each_row(
        &mut self,
        element: &Element,
        mut take: impl FnMut(usize, usize, &[f64]) -> Result<(), ImportError>,
    ) -> Result<(), ImportError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        let mut items = Vec::new();
        for row in 0..element.count as usize {
            for (column, property) in element.properties.iter().enumerate() {
                items.clear();
                match property.kind {
                    Kind::One(scalar) => items.push(self.value(element, row, scalar)?),
                    Kind::List { count, item } => {
                        let length = self.value(element, row, count)?;
                        if !(length >= 0.0 && length <= (self.input.bytes.len() - self.offset) as f64) {
                            let what = format!("row {row} of \"{}\" promises a list of {length} items", element.name);
                            return Err(damaged(self.name(), what));
                        }
                        for _ in 0..length as usize {
                            items.push(self.value(element, row, item)?);
                        }
                    }
                }
                take(row, column, &items)?;
            }
        }
        Ok(())
    }

    /// The next value.
    fn value(&mut self, element: &Element, row: usize, scalar: Scalar) -> Result<f64, ImportError> {
        let rest = &self.input.bytes[self.offset..];
        let cut = || {
            let what = format!("the file ends within row {row} of {} of \"{}\"", element.count, element.name);
            damaged(self.name(), what)
        };
        if self.encoding != Encoding::Ascii {
            let bytes = rest.get(..scalar.size()).ok_or_else(cut)?;
            self.offset += scalar.size();
            return Ok(scalar.read(bytes, self.encoding));
        }
        let begin = rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(cut)?;
        let word = &rest[begin..];
        let word = &word[..word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len())];
        self.offset += begin + word.len();
        let value = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f64>().ok());
        value.ok_or_else(|| self.not_a_number(word))
    }

    fn not_a_number(&self, word: &[u8]) -> ImportError {
        let line = 1 + self.input.bytes[..self.offset].iter().filter(|&&b| b == b'\n').count();
        let shown = word[..word.len().min(40)].escape_ascii().to_string();
        let place = format!("{}:{line}", self.name());
        refused(
            Refusal::Damaged,
            place,
            format!("\"{shown}\" is no number"),
            "correct the line or export the model again",
        )
    }
}

fn as_index(value: f64) -> Option<u32> {
    (value >= 0.0 && value < f64::from(u32::MAX)).then_some(value as u32)
}
