//! STL, ascii and binary. Own reader, see docs/decisions/003-own-stl-reader.md.
//!
//! Facet normals and attribute bytes are not passed on: a facet normal says nothing that the corners do not, and
//! would keep the corners of a smooth surface apart.

use super::error::{ImportError, Refusal, damaged, refused};
use super::{Input, Warnings, source};
use pb_mesh::mesh::Soup;
use rayon::prelude::*;

/// Bytes before the triangles of a binary file, and of one triangle.
const HEADER: usize = 84;
const RECORD: usize = 50;
/// A binary file that begins with "solid" shows a zero byte this early.
const TEXT_PROBE: usize = 1024;

/// Reads an STL file.
pub(super) fn read(input: &Input, warnings: &mut Warnings) -> Result<Soup, ImportError> {
    let bytes = input.bytes;
    let begin = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes).trim_ascii_start();
    let is_text = begin.get(..5).is_some_and(|w| w.eq_ignore_ascii_case(b"solid"))
        && !begin[..begin.len().min(TEXT_PROBE)].contains(&0);
    let corners = if !source::is_binary_stl(bytes) && is_text {
        Ascii { input, rest: begin, triangles: 0 }.read(warnings)?
    } else {
        read_binary(input, warnings)?
    };
    if corners.len() >= u32::MAX as usize {
        return Err(super::too_many(input.name, input.max_triangles));
    }
    let triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Ok(Soup { positions: corners, triangles, ..Soup::default() })
}

fn read_binary(input: &Input, warnings: &mut Warnings) -> Result<Vec<[f64; 3]>, ImportError> {
    let bytes = input.bytes;
    let Some(count) = bytes.get(80..HEADER) else {
        let what = format!("{} bytes are too few for an STL file", bytes.len());
        return Err(damaged(input.name, what));
    };
    let count = u32::from_le_bytes(count.try_into().expect("four bytes")) as usize;
    let room = (bytes.len() - HEADER) / RECORD;
    if count > room {
        let what = format!("the header promises {count} triangles, but there is room for {room}");
        return Err(damaged(input.name, what));
    }
    if bytes.len() > HEADER + count * RECORD {
        warnings.add(format!("{} bytes behind the last triangle are skipped", bytes.len() - HEADER - count * RECORD));
    }
    let corner = |corner: usize| -> [f64; 3] {
        let at = HEADER + corner / 3 * RECORD + 12 + corner % 3 * 12;
        std::array::from_fn(|k| {
            let raw = bytes[at + 4 * k..at + 4 * k + 4].try_into().expect("four bytes");
            f64::from(f32::from_le_bytes(raw))
        })
    };
    Ok((0..3 * count).into_par_iter().with_min_len(1 << 16).map(corner).collect())
}

/// Reads words; line ends only matter behind `solid` and `endsolid`, whose names may be anything.
struct Ascii<'a> {
    input: &'a Input<'a>,
    rest: &'a [u8],
    triangles: usize,
}

impl<'a> Ascii<'a> {
    fn read(mut self, warnings: &mut Warnings) -> Result<Vec<[f64; 3]>, ImportError> {
        let mut corners = Vec::new();
        let mut open = false;
        while let Some(word) = self.word() {
            match word.to_ascii_lowercase().as_slice() {
                b"solid" => {
                    open = true;
                    self.skip_line();
                }
                b"endsolid" => {
                    open = false;
                    self.skip_line();
                }
                b"facet" => {
                    self.facet(&mut corners)?;
                    self.triangles += 1;
                }
                _ => return Err(self.unexpected(word, "facet")),
            }
        }
        if open {
            warnings.add("the last solid has no end: the file may be cut short");
        }
        Ok(corners)
    }

    /// What follows the word `facet`.
    fn facet(&mut self, corners: &mut Vec<[f64; 3]>) -> Result<(), ImportError> {
        self.expect("normal")?;
        // Normals are not used, so words like "nan" may stand there.
        for _ in 0..3 {
            self.word().ok_or_else(|| self.cut())?;
        }
        self.expect("outer")?;
        self.expect("loop")?;
        for _ in 0..3 {
            self.expect("vertex")?;
            corners.push([self.number()?, self.number()?, self.number()?]);
        }
        self.expect("endloop")?;
        self.expect("endfacet")
    }

    fn word(&mut self) -> Option<&'a [u8]> {
        self.rest = self.rest.trim_ascii_start();
        let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        (!word.is_empty()).then_some(word)
    }

    fn skip_line(&mut self) {
        let end = self.rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(self.rest.len());
        self.rest = &self.rest[end..];
    }

    fn expect(&mut self, wanted: &str) -> Result<(), ImportError> {
        match self.word() {
            Some(word) if word.eq_ignore_ascii_case(wanted.as_bytes()) => Ok(()),
            Some(word) => Err(self.unexpected(word, wanted)),
            None => Err(self.cut()),
        }
    }

    fn number(&mut self) -> Result<f64, ImportError> {
        let word = self.word().ok_or_else(|| self.cut())?;
        let value = std::str::from_utf8(word).ok().and_then(|w| w.parse::<f64>().ok());
        match value {
            Some(value) if value.is_finite() => Ok(value),
            Some(_) => {
                let what = format!("the coordinate \"{}\" is no usable number", shown(word));
                Err(refused(Refusal::NotFinite, self.place(word), what, "remove the facet or export the model again"))
            }
            None => Err(damaged(self.place(word), format!("\"{}\" is no number", shown(word)))),
        }
    }

    fn unexpected(&self, word: &[u8], wanted: &str) -> ImportError {
        damaged(self.place(word), format!("\"{wanted}\" must stand where \"{}\" is", shown(word)))
    }

    fn cut(&self) -> ImportError {
        damaged(self.input.name, format!("the file ends within facet {} (counted from 0)", self.triangles))
    }

    /// File and line of a word that was just read.
    fn place(&self, word: &[u8]) -> String {
        let before = self.input.bytes.len() - self.rest.len() - word.len();
        let line = 1 + self.input.bytes[..before].iter().filter(|&&b| b == b'\n').count();
        format!("{}:{line}", self.input.name)
    }
}

fn shown(word: &[u8]) -> String {
    word[..word.len().min(40)].escape_ascii().to_string()
}
