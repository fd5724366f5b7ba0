//! The lines of an OBJ file, checked and cleaned for the parser behind: only positions, colours, normals, texture coordinates,
//! faces and material names remain, all indices absolute and in range, so that every fault is found here, with its line.
//!
//! What the parser cannot take is put right on the way: continued lines, bytes that are no UTF-8, vertices with and
//! without colours in one file, corners with and without normals, indices of texture coordinates that are not there.

use super::Warnings;
use super::error::{ImportError, Refusal, damaged, refused};
use super::obj::Libraries;
use std::io::{BufRead, Read, Write};

/// Cleaned text per step.
const BLOCK: usize = 1 << 16;
/// Faces after which the parser is told to start a new object: it keeps about 100 bytes per face of the current one.
const FACES_PER_OBJECT: u64 = 1 << 18;
/// Most unreadable vertices that are remembered; a file with more is refused.
const MAX_BAD_VERTICES: usize = 1000;
const BLANKS: [u8; 3] = [b' ', b'\t', b'\r'];

/// Which attributes the cleaned lines have. The parser needs them on all lines or on none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Mode {
    pub(super) colors: bool,
    pub(super) normals: bool,
    pub(super) uvs: bool,
}

/// A corner of a face, all counted from 1; 0: none.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u64,
    uv: u64,
    normal: u64,
}

/// Reads cleaned lines.
pub(super) struct ObjLines<'a> {
    name: &'a str,
    libraries: &'a Libraries<'a>,
    rest: &'a [u8],
    /// Of the line at hand, counted from 1.
    line: usize,
    mode: Mode,
    out: Vec<u8>,
    read: usize,
    joined: Vec<u8>,
    corners: Vec<Corner>,
    /// Unreadable vertices: number counted from 1, line.
    bad_vertices: Vec<(u64, usize)>,
    /// The highest index so far that points ahead, and the line that has it.
    ahead: (u64, usize),
    pub(super) vertices: u64,
    /// Whether a face uses each vertex.
    used: Vec<bool>,
    normals: u64,
    uvs: u64,
    pub(super) faces: u64,
    pub(super) warnings: Warnings,
    stop: Option<Stop>,
}

/// Why no more lines come before the end.
pub(super) enum Stop {
    /// The file is at fault.
    Error(ImportError),
    /// Start again with these attributes: they came after lines without.
    Again(Mode),
}

impl<'a> ObjLines<'a> {
    /// `libraries` get to know the material libraries that the lines name.
    pub(super) fn new(name: &'a str, bytes: &'a [u8], mode: Mode, libraries: &'a Libraries<'a>) -> ObjLines<'a> {
        let mut lines = ObjLines {
            name,
            libraries,
            rest: bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes),
            line: 0,
            mode,
            out: Vec::with_capacity(2 * BLOCK),
            read: 0,
            joined: Vec::new(),
            corners: Vec::new(),
            bad_vertices: Vec::new(),
            ahead: (0, 0),
            vertices: 0,
            used: Vec::new(),
            normals: 0,
            uvs: 0,
            faces: 0,
            warnings: Warnings::default(),
            stop: None,
        };
        if mode.normals {
            lines.put_no_normal();
        }
        if mode.uvs {
            lines.put_no_uv();
        }
        lines
    }

    /// Whether all corners have a texture coordinate, be it a made one.
    pub(super) fn has_uvs(&self) -> bool {
        self.mode.uvs
    }

    /// What stopped the lines, or is wrong at their end.
    pub(super) fn verdict(&mut self) -> Option<Stop> {
        if let Some(stop) = self.stop.take() {
            return Some(stop);
        }
        let (index, line) = self.ahead;
        if index > self.vertices {
            self.line = line;
            return Some(Stop::Error(self.out_of_range(&index.to_string())));
        }
        match (self.bad_vertices.first(), index) {
            (Some(&(_, line)), 1..) => Some(Stop::Error(self.unreadable_vertex(line))),
            (Some(&(_, line)), 0) => {
                let text = format!("line {line} has a vertex that cannot be read; no face uses it");
                self.warnings.add(text);
                None
            }
            (None, _) => None,
        }
    }

    /// Vertices that no face uses; 0 where faces point ahead and it is not known.
    pub(super) fn unreferenced(&self) -> u64 {
        if self.ahead.0 > 0 { 0 } else { self.used.iter().filter(|used| !**used).count() as u64 }
    }

    fn place(&self) -> String {
        format!("{}:{}", self.name, self.line)
    }

    /// Fills `out` with the next block of cleaned lines; leaves it empty at the end.
    fn refill(&mut self) {
        self.out.clear();
        self.read = 0;
        while self.out.len() < BLOCK && !self.rest.is_empty() && self.stop.is_none() {
            let first_line = self.line + 1;
            let line = self.next_line();
            let last_line = std::mem::replace(&mut self.line, first_line);
            match line {
                Some(line) => self.clean(line),
                None => {
                    let joined = std::mem::take(&mut self.joined);
                    self.clean(&joined);
                    self.joined = joined;
                }
            }
            self.line = last_line;
        }
        if self.stop.is_some() {
            self.out.clear();
        }
    }

    /// The next line, or none when it was continued and stands in `joined`.
    fn next_line(&mut self) -> Option<&'a [u8]> {
        let line = self.raw_line();
        let mut head = match line.strip_suffix(b"\\") {
            Some(head) if !line.starts_with(b"#") => head,
            _ => return Some(line),
        };
        self.joined.clear();
        loop {
            self.joined.extend_from_slice(head);
            self.joined.push(b' ');
            let line = self.raw_line();
            match line.strip_suffix(b"\\") {
                Some(more) if !self.rest.is_empty() => head = more,
                _ => {
                    self.joined.extend_from_slice(line.strip_suffix(b"\\").unwrap_or(line));
                    return None;
                }
            }
        }
    }

    fn raw_line(&mut self) -> &'a [u8] {
        self.line += 1;
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let line = &self.rest[..end];
        self.rest = self.rest.get(end + 1..).unwrap_or(&[]);
        line.trim_ascii()
    }

    fn clean(&mut self, line: &[u8]) {
        let (word, rest) = line.split_at(line.iter().position(|b| BLANKS.contains(b)).unwrap_or(line.len()));
        let result = match word {
            b"v" => self.vertex(rest),
            b"vn" => self.normal(rest),
            b"f" | b"fo" => self.face(rest),
            b"l" | b"p" => {
                self.warnings.add("points and lines are skipped");
                Ok(())
            }
            b"vt" => self.uv(rest),
            b"curv" | b"curv2" | b"surf" => {
                self.warnings.add("free-form curves and surfaces are skipped");
                Ok(())
            }
            b"mtllib" | b"usemtl" => self.material(word, rest),
            _ => Ok(()),
        };
        if let Err(stop) = result {
            self.stop = Some(stop);
        }
    }

    fn vertex(&mut self, rest: &[u8]) -> Result<(), Stop> {
        let mut words = words(rest);
        let place: [Option<&[u8]>; 3] = std::array::from_fn(|_| words.next());
        let values = place.map(|word| word.and_then(number));
        let more: Vec<&[u8]> = words.take(5).collect();
        if more.len() >= 3 && !self.mode.colors {
            let colors = Mode { colors: true, ..self.mode };
            if self.vertices > 0 {
                return Err(Stop::Again(colors));
            }
            self.mode = colors;
        }
        self.vertices += 1;
        self.used.push(false);
        let [Some(_), Some(_), Some(_)] = values else {
            self.bad_vertices.push((self.vertices, self.line));
            self.put_vertex(&[b"0"; 3], &more);
            return match self.bad_vertices.len() {
                MAX_BAD_VERTICES.. => Err(Stop::Error(self.unreadable_vertex(self.bad_vertices[0].1))),
                _ => Ok(()),
            };
        };
        if let Some(bad) = (0..3).find(|&k| values[k].is_some_and(|x| !x.is_finite())) {
            let what = format!("the coordinate \"{}\" is no usable number", shown(place[bad].unwrap_or_default()));
            let remedy = "remove the vertex or export the model again";
            return Err(Stop::Error(refused(Refusal::NotFinite, self.place(), what, remedy)));
        }
        let place = place.map(|word| word.expect("all three were read"));
        self.put_vertex(&place, &more);
        Ok(())
    }

    /// `more`: what follows the coordinates: nothing, a weight, which meshes do not have, or a colour and perhaps alpha.
    fn put_vertex(&mut self, place: &[&[u8]; 3], more: &[&[u8]]) {
        self.out.push(b'v');
        let mut color: [&[u8]; 3] = [b"1"; 3];
        if let [r, g, b, ..] = *more {
            if [r, g, b].iter().all(|word| number(word).is_some_and(f64::is_finite)) {
                color = [r, g, b];
            } else {
                self.warnings.add("a vertex colour cannot be read; white is taken");
            }
        }
        let colors = if self.mode.colors { &color[..] } else { &[] };
        for word in place.iter().chain(colors) {
            self.out.push(b' ');
            self.out.extend_from_slice(word);
        }
        self.out.push(b'\n');
    }

    fn normal(&mut self, rest: &[u8]) -> Result<(), Stop> {
        if !self.mode.normals {
            if self.faces > 0 {
                return Err(Stop::Again(Mode { normals: true, ..self.mode }));
            }
            self.mode.normals = true;
            self.put_no_normal();
        }
        self.normals += 1;
        let mut words = words(rest).take(3).filter(|word| number(word).is_some());
        match (words.next(), words.next(), words.next()) {
            (Some(x), Some(y), Some(z)) => {
                self.out.extend_from_slice(b"vn");
                for word in [x, y, z] {
                    self.out.push(b' ');
                    self.out.extend_from_slice(word);
                }
                self.out.push(b'\n');
            }
            _ => {
                self.warnings.add("a normal cannot be read; it is made new");
                self.put_no_normal();
            }
        }
        Ok(())
    }

    fn material(&mut self, word: &[u8], rest: &[u8]) -> Result<(), Stop> {
        let name = String::from_utf8_lossy(rest).trim().to_owned();
        if name.is_empty() {
            return Ok(());
        }
        self.out.extend_from_slice(word);
        self.out.push(b' ');
        self.out.extend_from_slice(name.as_bytes());
        self.out.push(b'\n');
        if word == b"mtllib" {
            self.libraries.load(&name);
            // Texture coordinates that went by are wanted after all.
            if self.uvs > 0 && !self.mode.uvs && self.libraries.want_uvs() {
                return Err(Stop::Again(Mode { uvs: true, ..self.mode }));
            }
        }
        Ok(())
    }

    fn uv(&mut self, rest: &[u8]) -> Result<(), Stop> {
        if !self.mode.uvs && self.libraries.want_uvs() {
            // A face or a texture coordinate went by.
            if self.faces > 0 || self.uvs > 0 {
                return Err(Stop::Again(Mode { uvs: true, ..self.mode }));
            }
            self.mode.uvs = true;
            self.put_no_uv();
        }
        self.uvs += 1;
        if !self.mode.uvs {
            return Ok(());
        }
        let mut words = words(rest);
        let zero: &[u8] = b"0";
        let (u, v) = (words.next().unwrap_or(zero), words.next().unwrap_or(zero));
        if number(u).is_some() && number(v).is_some() {
            self.out.extend_from_slice(b"vt ");
            self.out.extend_from_slice(u);
            self.out.push(b' ');
            self.out.extend_from_slice(v);
            self.out.push(b'\n');
        } else {
            self.warnings.add("a texture coordinate cannot be read; (0, 0) is taken");
            self.put_no_uv();
        }
        Ok(())
    }

    /// Stands for none.
    fn put_no_uv(&mut self) {
        self.out.extend_from_slice(b"vt 0 0\n");
    }

    /// A normal of no length stands for none.
    fn put_no_normal(&mut self) {
        self.out.extend_from_slice(b"vn 0 0 0\n");
    }

    fn face(&mut self, rest: &[u8]) -> Result<(), Stop> {
        self.corners.clear();
        for word in words(rest).take_while(|word| word[0] != b'#') {
            let corner = self.corner(word).map_err(Stop::Error)?;
            self.corners.push(corner);
        }
        if self.corners.len() < 3 {
            self.warnings.add("a face with fewer than three corners is skipped");
            return Ok(());
        }
        self.faces += 1;
        if self.faces.is_multiple_of(FACES_PER_OBJECT) && self.ahead.0 == 0 {
            self.out.extend_from_slice(b"o next\n");
        }
        self.out.push(b'f');
        for i in 0..self.corners.len() {
            let Corner { vertex, uv, normal } = self.corners[i];
            let written = match (self.mode.uvs, self.mode.normals) {
                (false, true) => write!(self.out, " {vertex}//{}", normal + 1),
                (false, false) => write!(self.out, " {vertex}"),
                (true, true) => write!(self.out, " {vertex}/{}/{}", uv + 1, normal + 1),
                (true, false) => write!(self.out, " {vertex}/{}", uv + 1),
            };
            written.expect("writing to a vector does not fail");
        }
        self.out.push(b'\n');
        Ok(())
    }

    /// Of `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&mut self, word: &[u8]) -> Result<Corner, ImportError> {
        let mut parts = word.split(|&b| b == b'/');
        let vertex = parts.next().and_then(integer);
        let texture = parts.next();
        let normal = parts.next();
        let texture_is_sound = texture.is_none_or(|t| t.is_empty() || integer(t).is_some());
        let normal_is_sound = normal.is_none_or(|n| n.is_empty() || integer(n).is_some());
        let (Some(index), true, true, None) = (vertex, texture_is_sound, normal_is_sound, parts.next()) else {
            let what = format!("\"{}\" is no corner of a face (v, v/vt, v//vn or v/vt/vn)", shown(word));
            return Err(damaged(self.place(), what));
        };
        let vertex = match index {
            1.. => index as u64,
            _ => self.vertices.checked_sub(index.unsigned_abs()).map_or(0, |v| v + 1),
        };
        if index == 0 || vertex == 0 {
            return Err(self.out_of_range(&index.to_string()));
        }
        if vertex > self.vertices && vertex > self.ahead.0 {
            self.ahead = (vertex, self.line);
        }
        if let Some(used) = self.used.get_mut(vertex as usize - 1) {
            *used = true;
        }
        if self.bad_vertices.binary_search_by_key(&vertex, |bad| bad.0).is_ok() {
            let line = self.bad_vertices.iter().find(|bad| bad.0 == vertex).map_or(0, |bad| bad.1);
            return Err(self.unreadable_vertex(line));
        }
        let (uv, normal) = (texture.and_then(integer), normal.and_then(integer));
        let missing_normal = "a face refers to a normal that is not defined; it is made new";
        let missing_uv = "a face refers to a texture coordinate that is not defined; (0, 0) is taken";
        let normal = self.defined(normal, self.normals, missing_normal);
        let uv = if self.mode.uvs { self.defined(uv, self.uvs, missing_uv) } else { 0 };
        Ok(Corner { vertex, uv, normal })
    }

    /// One of `count` things so far by an index that may be relative, counted from 1; 0 where there is none.
    fn defined(&mut self, index: Option<i64>, count: u64, warning: &str) -> u64 {
        let number = match index {
            None => return 0,
            Some(index @ 1..) => index as u64,
            Some(index) => count.checked_sub(index.unsigned_abs()).map_or(0, |n| n + 1),
        };
        if index == Some(0) || number == 0 || number > count {
            self.warnings.add(warning);
            return 0;
        }
        number
    }

    fn out_of_range(&self, index: &str) -> ImportError {
        let what = match index {
            "0" => "a face refers to vertex 0, but OBJ counts from 1".to_owned(),
            _ => format!("a face refers to vertex {index}, but only {} are defined", self.vertices),
        };
        damaged(self.place(), what)
    }

    fn unreadable_vertex(&self, line: usize) -> ImportError {
        damaged(format!("{}:{line}", self.name), "a vertex needs three numbers, and these cannot be read")
    }
}

impl Read for ObjLines<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for ObjLines<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        while self.read == self.out.len() && !self.rest.is_empty() && self.stop.is_none() {
            self.refill();
        }
        Ok(&self.out[self.read..])
    }

    fn consume(&mut self, count: usize) {
        self.read += count;
    }
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| b.is_ascii_whitespace()).filter(|word| !word.is_empty())
}

pub(super) fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// A decimal integer with an optional sign.
fn integer(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut value = 0i64;
    for &digit in digits {
        value = value * 10 + i64::from(digit.is_ascii_digit().then_some(digit - b'0')?);
    }
    Some(if negative { -value } else { value })
}

fn shown(word: &[u8]) -> String {
    word[..word.len().min(40)].escape_ascii().to_string()
}
