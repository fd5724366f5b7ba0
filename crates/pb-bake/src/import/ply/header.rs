//! The header of a PLY file: bounded, line by line, each fault with its line.

use super::super::error::{ImportError, Refusal, damaged, refused};
use super::super::{Input, Warnings};
use super::scalar::{Encoding, Scalar};

/// Longest header.
const MAX_HEADER_BYTES: usize = 1 << 20;
/// Most elements, and most properties of one.
const MAX_LIST: usize = 1000;

/// What a property holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    One(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// The first scalar property of a name, as index into `properties`.
    pub(super) fn scalar(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::One(_)))
    }

    /// The first list property of a name, as index into `properties`.
    pub(super) fn list(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::List { .. }))
    }

    /// Fewest bytes of one row in a binary body.
    pub(super) fn least_size(&self) -> usize {
        let least = |p: &Property| match p.kind {
            Kind::One(scalar) => scalar.size(),
            Kind::List { count, .. } => count.size(),
        };
        self.properties.iter().map(least).sum()
    }

    pub(super) fn has_lists(&self) -> bool {
        self.properties.iter().any(|p| matches!(p.kind, Kind::List { .. }))
    }
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Names of images, as comments give them.
    pub(super) textures: Vec<String>,
    /// Where the body begins.
    pub(super) size: usize,
}

/// Reads lines up to `end_header`.
pub(super) fn parse(input: &Input, warnings: &mut Warnings) -> Result<Header, ImportError> {
    let mut lines = Lines::new(input);
    let mut encoding = None;
    let (mut elements, mut textures): (Vec<Element>, Vec<String>) = Default::default();
    if lines.next()? != "ply" {
        return Err(damaged(lines.place(), "the first line of a PLY file is \"ply\", this one differs"));
    }
    loop {
        let line = lines.next()?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["comment", "TextureFile", _, ..] => {
                textures.extend(line.split_once("TextureFile").map(|(_, name)| name.trim().to_owned()));
            }
            [] | ["comment", ..] | ["obj_info", ..] => {}
            ["format", name, _version] => encoding = Some(parse_encoding(&lines, name)?),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| {
                    damaged(lines.place(), format!("the count \"{count}\" of the element \"{name}\" is no number"))
                })?;
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ..] => {
                let property = parse_property(&lines, &words)?;
                let Some(element) = elements.last_mut() else {
                    return Err(damaged(lines.place(), "a property stands before the first element"));
                };
                element.properties.push(property);
            }
            ["end_header"] => break,
            ["format" | "element", ..] => return Err(damaged(lines.place(), format!("\"{line}\" is incomplete"))),
            [word, ..] => warnings.add(format!("the header line \"{word} ...\" is unknown and skipped")),
        }
        if elements.len().max(textures.len()) > MAX_LIST
            || elements.last().is_some_and(|e| e.properties.len() > MAX_LIST)
        {
            let what = format!("there are more than {MAX_LIST} elements, properties or images in the header");
            return Err(refused(Refusal::TooLarge, lines.place(), what, "export the model again"));
        }
    }
    let encoding = encoding.ok_or_else(|| damaged(lines.place(), "the header has no \"format\" line"))?;
    Ok(Header { encoding, elements, textures, size: lines.offset })
}

fn parse_encoding(lines: &Lines, name: &str) -> Result<Encoding, ImportError> {
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        _ => {
            let what = format!("the PLY format \"{name}\" is unknown");
            Err(refused(Refusal::Unsupported, lines.place(), what, "export it as ascii or binary_little_endian"))
        }
    }
}

fn parse_property(lines: &Lines, words: &[&str]) -> Result<Property, ImportError> {
    let scalar = |name: &str| {
        Scalar::from_name(name)
            .ok_or_else(|| damaged(lines.place(), format!("the property type \"{name}\" is unknown")))
    };
    match *words {
        [_, "list", count, item, name] => {
            let (count, item) = (scalar(count)?, scalar(item)?);
            if count.is_float() {
                return Err(damaged(lines.place(), format!("the list \"{name}\" has a count that is no integer")));
            }
            Ok(Property { name: name.to_owned(), kind: Kind::List { count, item } })
        }
        [_, kind, name] => Ok(Property { name: name.to_owned(), kind: Kind::One(scalar(kind)?) }),
        _ => Err(damaged(lines.place(), "a property is \"property TYPE NAME\" or \"property list TYPE TYPE NAME\"")),
    }
}

/// The lines of a header, whatever ends them.
struct Lines<'a> {
    input: &'a Input<'a>,
    offset: usize,
    number: usize,
    /// `\r\n`, `\n` or `\r`, as the first line has it; the body of a binary file begins right behind it.
    end: &'static [u8],
}

impl<'a> Lines<'a> {
    /// Skips empty lines before the first: some files have them.
    fn new(input: &'a Input<'a>) -> Lines<'a> {
        let bytes = input.bytes;
        let offset = bytes.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(bytes.len());
        let offset = offset + if bytes[offset..].starts_with(b"\xEF\xBB\xBF") { 3 } else { 0 };
        let stop = bytes[offset..].iter().position(|&b| b == b'\n' || b == b'\r').map_or(bytes.len(), |i| offset + i);
        let end: &[u8] = match &bytes[stop..] {
            [b'\r', b'\n', ..] => b"\r\n",
            [b'\r', ..] => b"\r",
            _ => b"\n",
        };
        Lines { input, offset, number: 0, end }
    }

    fn place(&self) -> String {
        format!("{}:{}", self.input.name, self.number)
    }

    /// The next line without its end and outer blanks; bytes that are no text are replaced.
    fn next(&mut self) -> Result<String, ImportError> {
        self.number += 1;
        let rest = &self.input.bytes[self.offset..];
        let rest = &rest[..rest.len().min(MAX_HEADER_BYTES)];
        // A line may end with a bare line feed in a file that otherwise has both.
        let Some(stop) = rest.iter().position(|&b| b == *self.end.last().expect("an end is not empty")) else {
            return Err(damaged(self.place(), "the header has no \"end_header\" line"));
        };
        self.offset += stop + 1;
        if self.offset > MAX_HEADER_BYTES {
            return Err(damaged(self.place(), "the header is longer than a mebibyte"));
        }
        Ok(String::from_utf8_lossy(&rest[..stop]).trim().to_owned())
    }
}
