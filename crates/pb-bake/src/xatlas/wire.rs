//! What pb-bake and the helper pb-xatlas say to each other, byte by byte: docs/xatlas-helper.md. Both programs compile
//! this very file, and both check every limit; so it uses nothing but the standard library.
//!
//! A message is a header of 16 bytes and a body. All numbers are little-endian. The header, the probe and its answer
//! stay as they are in all versions, so that two versions can tell each other apart.

use std::fmt::{self, Display};
use std::io::{self, Read};

/// First bytes of every message.
pub const MAGIC: [u8; 4] = *b"PBXA";
/// Version of this protocol; another one is refused.
pub const VERSION: u16 = 1;
/// Bytes of a header.
pub const HEADER_BYTES: usize = 16;
/// Most triangles of a cluster.
pub const MAX_TRIANGLES: usize = 1 << 20;
/// Most vertices of a cluster.
pub const MAX_VERTICES: usize = 3 * MAX_TRIANGLES;
/// Longest text in an answer, bytes.
pub const MAX_TEXT_BYTES: usize = 1024;
/// Bytes of a chart request before its arrays.
const REQUEST_BYTES: usize = 24;
/// Bytes of a chart answer before its triangles, and per triangle.
const ANSWER_BYTES: (usize, usize) = (8, 28);
/// Longest body that a helper reads.
pub const MAX_REQUEST_BYTES: usize = REQUEST_BYTES + 12 * (MAX_VERTICES + MAX_TRIANGLES);

/// What a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Kind {
    /// Who is there? No body.
    Probe = 1,
    /// A cluster to cut into charts: [`Request`].
    Charts = 2,
    /// [`Identity`].
    ProbeAnswer = 0x81,
    /// [`Charts`].
    ChartsAnswer = 0x82,
    /// Why there is no answer: UTF-8 text.
    Refusal = 0xff,
}

const KINDS: [Kind; 5] = [Kind::Probe, Kind::Charts, Kind::ProbeAnswer, Kind::ChartsAnswer, Kind::Refusal];

/// Bytes that are no message of this protocol; says what is wrong with them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Malformed(pub String);

impl Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Malformed {}

fn demand(holds: bool, what: impl FnOnce() -> String) -> Result<(), Malformed> {
    if holds { Ok(()) } else { Err(Malformed(what())) }
}

/// The first 16 bytes of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The sender's [`VERSION`].
    pub version: u16,
    /// What follows.
    pub kind: Kind,
    /// Length of the body, bytes; not yet checked against anything.
    pub body_bytes: u64,
}

impl Header {
    /// Reads a header of any version. Fails where the magic or the kind is unknown.
    pub fn parse(bytes: &[u8; HEADER_BYTES]) -> Result<Header, Malformed> {
        demand(bytes[..4] == MAGIC, || format!("it begins with {:02x?}, not with PBXA", &bytes[..4]))?;
        let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
        let known = KINDS.into_iter().find(|k| *k as u16 == kind);
        let kind = known.ok_or_else(|| Malformed(format!("there is no message of kind {kind:#x}")))?;
        let length = bytes[8..16].try_into().expect("eight bytes");
        Ok(Header { version: u16::from_le_bytes([bytes[4], bytes[5]]), kind, body_bytes: u64::from_le_bytes(length) })
    }
}

/// A message of this version.
pub fn message(kind: Kind, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + body.len());
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((kind as u16).to_le_bytes());
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

/// Reads exactly `bytes` bytes. The buffer grows with what arrives, so a lie about the length costs no memory.
pub fn read_body(from: &mut impl Read, bytes: usize) -> io::Result<Vec<u8>> {
    let mut body = Vec::new();
    from.take(bytes as u64).read_to_end(&mut body)?;
    if body.len() < bytes { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(body) }
}

/// Who a helper is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Name and version of the program.
    pub name: String,
    /// Which xatlas it was built from.
    pub xatlas: String,
}

impl Identity {
    /// Longest body of a probe answer.
    pub const MAX_BYTES: usize = 2 * (2 + MAX_TEXT_BYTES);

    /// Two texts, each with its length (u16) before it.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for text in [&self.name, &self.xatlas] {
            let text = &text.as_bytes()[..text.len().min(MAX_TEXT_BYTES)];
            bytes.extend((text.len() as u16).to_le_bytes());
            bytes.extend(text);
        }
        bytes
    }

    /// The body of a probe answer.
    pub fn decode(body: &[u8]) -> Result<Identity, Malformed> {
        let mut rest = body;
        let mut text = || {
            let (length, after) = rest.split_first_chunk::<2>()?;
            let (text, after) = after.split_at_checked(u16::from_le_bytes(*length) as usize)?;
            rest = after;
            std::str::from_utf8(text).ok().map(str::to_string)
        };
        let identity = text().zip(text()).map(|(name, xatlas)| Identity { name, xatlas });
        identity.filter(|_| rest.is_empty()).ok_or_else(|| Malformed("its probe answer holds no two texts".into()))
    }
}

/// How charts are cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Cost at which a chart stops growing, above 0; lower gives more and flatter charts.
    pub max_cost: f32,
    /// Charts with a larger L2 stretch (Sander et al. 2001; 1 is none) are cut again, above 1.
    pub max_stretch: f32,
    /// Rounds of seeding and growing, 1 to 16; more give better charts.
    pub max_iterations: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_cost: 2.0, max_stretch: 2.0, max_iterations: 1 }
    }
}

impl Options {
    fn check(&self) -> Result<(), Malformed> {
        let good = self.max_cost > 0.0 && self.max_cost < 1e6 && self.max_stretch > 1.0 && self.max_stretch < 1e6;
        demand(good && (1..=16).contains(&self.max_iterations), || format!("{self:?} is out of range"))
    }
}

/// A cluster to be cut into charts.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// After so many milliseconds nobody waits for the answer; the helper then ends.
    pub time_limit_ms: u32,
    /// How to cut.
    pub options: Options,
    /// Vertices, units of length, finite; anywhere, but precise only near the origin.
    pub positions: Vec<[f32; 3]>,
    /// Vertices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Request {
    /// Counts, indices, numbers, options: all that either side relies on.
    pub fn check(&self) -> Result<(), Malformed> {
        let (vertices, triangles) = (self.positions.len(), self.triangles.len());
        let counts_fit = (1..=MAX_VERTICES).contains(&vertices) && (1..=MAX_TRIANGLES).contains(&triangles);
        demand(counts_fit, || format!("a cluster of {triangles} triangles and {vertices} vertices is not taken"))?;
        let wrong = self.triangles.iter().flatten().find(|i| **i as usize >= vertices);
        demand(wrong.is_none(), || format!("a triangle uses vertex {wrong:?} of {vertices}"))?;
        let finite = self.positions.iter().flatten().all(|x| x.is_finite() && x.abs() < 1e15);
        demand(finite, || "a coordinate is no number below 1e15".into())?;
        self.options.check()
    }

    /// The body of a request.
    pub fn encode(&self) -> Result<Vec<u8>, Malformed> {
        self.check()?;
        let mut bytes = Vec::with_capacity(REQUEST_BYTES + 12 * (self.positions.len() + self.triangles.len()));
        for number in [self.positions.len() as u32, self.triangles.len() as u32, self.time_limit_ms] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(self.options.max_cost.to_le_bytes());
        bytes.extend(self.options.max_stretch.to_le_bytes());
        bytes.extend(self.options.max_iterations.to_le_bytes());
        self.positions.iter().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
        self.triangles.iter().flatten().for_each(|i| bytes.extend(i.to_le_bytes()));
        Ok(bytes)
    }

    /// The body of a request, checked.
    pub fn decode(body: &[u8]) -> Result<Request, Malformed> {
        let words = words(body)?;
        demand(words.len() >= REQUEST_BYTES / 4, || "the request is cut short".into())?;
        let (vertices, triangles) = (words[0] as usize, words[1] as usize);
        let expected = (vertices as u64 + triangles as u64) * 12 + REQUEST_BYTES as u64;
        demand(body.len() as u64 == expected, || format!("{} bytes instead of {expected}", body.len()))?;
        let options = Options {
            max_cost: f32::from_bits(words[3]),
            max_stretch: f32::from_bits(words[4]),
            max_iterations: words[5],
        };
        let (positions, indices) = words[REQUEST_BYTES / 4..].split_at(3 * vertices);
        let request = Request {
            time_limit_ms: words[2],
            options,
            positions: positions.as_chunks().0.iter().map(|p: &[u32; 3]| p.map(f32::from_bits)).collect(),
            triangles: indices.as_chunks().0.to_vec(),
        };
        request.check().map(|()| request)
    }
}

/// A cluster cut into charts. As read it promises nothing but its counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Charts {
    /// Chart of each triangle, below `count`.
    pub chart_of: Vec<u32>,
    /// Number of charts.
    pub count: u32,
    /// Place of each triangle's corners in its chart's own plane, units of length.
    pub uv: Vec<[[f32; 2]; 3]>,
}

impl Charts {
    /// Bytes of the answer for a cluster of so many triangles.
    pub fn answer_bytes(triangles: usize) -> usize {
        ANSWER_BYTES.0 + ANSWER_BYTES.1 * triangles
    }

    /// The body of an answer.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(Self::answer_bytes(self.chart_of.len()));
        bytes.extend((self.chart_of.len() as u32).to_le_bytes());
        bytes.extend(self.count.to_le_bytes());
        for (chart, uv) in self.chart_of.iter().zip(&self.uv) {
            bytes.extend(chart.to_le_bytes());
            uv.iter().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
        }
        bytes
    }

    /// The body of an answer; only its length and its counts are checked here.
    pub fn decode(body: &[u8]) -> Result<Charts, Malformed> {
        let words = words(body)?;
        demand(words.len() >= ANSWER_BYTES.0 / 4, || "the answer is cut short".into())?;
        let (triangles, count) = (words[0] as usize, words[1]);
        let fits = triangles <= MAX_TRIANGLES && body.len() == Self::answer_bytes(triangles);
        demand(fits, || format!("{} bytes do not hold {triangles} triangles", body.len()))?;
        let records: &[[u32; 7]] = words[ANSWER_BYTES.0 / 4..].as_chunks().0;
        let corners = |r: &[u32; 7]| [[r[1], r[2]], [r[3], r[4]], [r[5], r[6]]].map(|c| c.map(f32::from_bits));
        Ok(Charts {
            chart_of: records.iter().map(|r| r[0]).collect(),
            count,
            uv: records.iter().map(corners).collect(),
        })
    }
}

/// Twice the signed area of a triangle in its chart's plane; positive is counter-clockwise. The sign is that of the
/// numbers as they stand, so both programs agree on it.
pub fn doubled_area(uv: &[[f32; 2]; 3]) -> f64 {
    let [a, b, c] = uv.map(|p| p.map(f64::from));
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

fn words(body: &[u8]) -> Result<Vec<u32>, Malformed> {
    let (words, rest) = body.as_chunks();
    demand(rest.is_empty(), || format!("{} bytes are no whole number of words", body.len()))?;
    Ok(words.iter().map(|w| u32::from_le_bytes(*w)).collect())
}
