//! Opens an archive: everything but the chunks is checked and kept, each chunk is read when it is asked for.
//!
//! Must never: trust a number from the file before it is compared with the file's length; panic, or end the program,
//! because of any file, also of one that is cut or changed while it is open.

use crate::error::{ArchiveError, Fault, tag_text};
use crate::format::*;
use crate::source::{Source, Words};
use bytemuck::Pod;
use std::borrow::Cow;
use std::fs::File;
use std::marker::PhantomData;
use std::ops::Range;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// An open archive. Cheap to share; all access is by shared reference, and reads from many threads do not meet.
pub struct Archive {
    path: PathBuf,
    source: Source,
    tables: Words,
    header: Header,
    sections: Vec<SectionRecord>,
    chunks: Range<usize>,
}

/// Where a section of `T`s lies in one archive.
#[derive(Clone, Debug)]
pub struct Table<T> {
    range: Range<usize>,
    element: PhantomData<T>,
}

impl Archive {
    /// Opens and checks the file. `known_features` has a bit for each required feature that the caller knows.
    ///
    /// Tables are copied into memory; chunks are read from the open file. So a file that is replaced by renaming
    /// goes on to be read as it was, and one that is cut or changed in place gives errors.
    pub fn open(path: &Path, known_features: u64) -> Result<Self, ArchiveError> {
        let io = |doing| move |source| ArchiveError::new(path, Fault::Io { doing, source });
        let metadata = std::fs::metadata(path).map_err(io("open it"))?;
        if !metadata.is_file() {
            return Err(ArchiveError::new(path, Fault::NotAFile));
        }
        let source = File::open(path).and_then(Source::file).map_err(io("open it"))?;
        Self::checked(path, source, known_features)
    }

    /// The same checks on a copy of bytes in memory; `name` is for messages.
    pub fn from_bytes(name: &Path, bytes: &[u8], known_features: u64) -> Result<Self, ArchiveError> {
        Self::checked(name, Source::Memory(Words::copy(bytes)), known_features)
    }

    fn checked(path: &Path, source: Source, known_features: u64) -> Result<Self, ArchiveError> {
        let parsed = parse(&source, known_features).map_err(|fault| ArchiveError::new(path, fault))?;
        let Parsed { tables, header, sections, chunks } = parsed;
        Ok(Self { path: path.to_owned(), source, tables, header, sections, chunks })
    }

    /// The file's name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The header, checked.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Length of the file in bytes.
    pub fn file_bytes(&self) -> u64 {
        self.header.file_length
    }

    /// All sections, in the directory's order.
    pub fn sections(&self) -> &[SectionRecord] {
        &self.sections
    }

    /// The elements of a section, in place. Fails when it is missing or its elements are not of `T`'s size.
    pub fn section<T: Pod>(&self, tag: [u8; 4]) -> Result<&[T], ArchiveError> {
        let fail = |fault| ArchiveError::new(&self.path, fault);
        let record = self.sections.iter().find(|s| s.tag == tag);
        let record = record.ok_or_else(|| fail(Fault::NoSection { tag: tag_text(tag) }))?;
        elements(&self.tail(), record).map_err(fail)
    }

    /// Finds a section once, for quick access with [`rows`](Archive::rows). Fails as [`section`](Archive::section).
    pub fn table<T: Pod>(&self, tag: [u8; 4]) -> Result<Table<T>, ArchiveError> {
        self.section::<T>(tag)?;
        let record = self.sections.iter().find(|s| s.tag == tag).expect("the section was found above");
        Ok(Table { range: self.tail().range(record), element: PhantomData })
    }

    /// The elements of a section that was found in this archive.
    ///
    /// # Panics
    /// May panic if `table` comes from another archive.
    pub fn rows<T: Pod>(&self, table: &Table<T>) -> &[T] {
        bytemuck::cast_slice(&self.tables.bytes()[table.range.clone()])
    }

    /// The chunk table.
    pub fn chunks(&self) -> &[ChunkRecord] {
        bytemuck::cast_slice(&self.tables.bytes()[self.chunks.clone()])
    }

    fn tail(&self) -> Tail<'_> {
        Tail::new(&self.tables, self.header.file_length)
    }

    fn record(&self, id: u32) -> Result<&ChunkRecord, ArchiveError> {
        let table = self.chunks();
        let no_chunk = || ArchiveError::new(&self.path, Fault::NoChunk { id, count: table.len() as u32 });
        table.get(id as usize).ok_or_else(no_chunk)
    }

    /// The stored bytes of a chunk, read and compared with their checksum.
    pub fn chunk(&self, id: u32) -> Result<Cow<'_, [u8]>, ArchiveError> {
        let record = self.record(id)?;
        // In bounds: checked when the archive was opened.
        let bytes = self.source.read(|| format!("chunk {id}"), record.offset, record.stored_bytes as usize);
        let bytes = bytes.map_err(|fault| ArchiveError::new(&self.path, fault))?;
        self.check_chunk(id, &bytes)?;
        Ok(bytes)
    }

    /// Compares bytes that were read with [`read`](Archive::read) with the checksum of a chunk.
    pub fn check_chunk(&self, id: u32, bytes: &[u8]) -> Result<(), ArchiveError> {
        let record = self.record(id)?;
        match bytes.len() == record.stored_bytes as usize && xxh3_64(bytes) == record.checksum {
            true => Ok(()),
            false => {
                let fault = Fault::Checksum { what: format!("chunk {id}"), offset: record.offset };
                Err(ArchiveError::new(&self.path, fault))
            }
        }
    }

    /// Bytes of the file in one read, unchecked: a chunk's, or those of several that lie together.
    /// Fails when they are not, or no longer, in the file.
    pub fn read(&self, offset: u64, bytes: usize) -> Result<Cow<'_, [u8]>, ArchiveError> {
        let fail = |fault| ArchiveError::new(&self.path, fault);
        let end = offset.saturating_add(bytes as u64);
        if end > self.header.file_length {
            return Err(fail(Fault::Shortened { what: "a read".into(), end, found: self.header.file_length }));
        }
        self.source.read(|| format!("what lies at byte {offset}"), offset, bytes).map_err(fail)
    }

    /// Hints to the system that these bytes of the file will be read soon; does nothing where it takes no hints.
    pub fn will_need(&self, offset: u64, bytes: u64) {
        self.source.will_need(offset, bytes);
    }

    /// The order of the chunks on disk, for reading them in one run. Fails when two overlap.
    pub fn chunks_in_file_order(&self) -> Result<Vec<u32>, ArchiveError> {
        let table = self.chunks();
        let mut order: Vec<u32> = (0..table.len() as u32).collect();
        order.sort_by_key(|&id| (table[id as usize].offset, table[id as usize].stored_bytes, id));
        for pair in order.windows(2) {
            let (a, b) = (&table[pair[0] as usize], &table[pair[1] as usize]);
            if a.offset + a.stored_bytes as u64 > b.offset {
                let what = format!("chunks {} and {}", pair[0], pair[1]);
                return Err(ArchiveError::new(&self.path, malformed(what, "they overlap")));
            }
        }
        Ok(order)
    }
}

/// The end of an archive, in memory: `bytes[0]` is byte `start` of the file.
#[derive(Clone, Copy)]
struct Tail<'a> {
    start: u64,
    bytes: &'a [u8],
}

impl<'a> Tail<'a> {
    fn new(tables: &'a Words, file_length: u64) -> Self {
        Self { start: file_length - tables.bytes().len() as u64, bytes: tables.bytes() }
    }

    /// Bytes of the file, by their places in it. They were compared with the file's length.
    fn at(&self, from: u64, to: u64) -> &'a [u8] {
        &self.bytes[(from - self.start) as usize..(to - self.start) as usize]
    }

    /// Where a section lies in `bytes`.
    fn range(&self, s: &SectionRecord) -> Range<usize> {
        (s.offset - self.start) as usize..(s.offset + s.length - self.start) as usize
    }
}

struct Parsed {
    tables: Words,
    header: Header,
    sections: Vec<SectionRecord>,
    chunks: Range<usize>,
}

/// The one place where the bytes of a file become header, directory and chunk table.
fn parse(source: &Source, known_features: u64) -> Result<Parsed, Fault> {
    let header_bytes = source.length().min(size_of::<Header>() as u64);
    let header = parse_header(&source.read(|| "the header".into(), 0, header_bytes as usize)?, source.length())?;
    let what = || "the directory".to_string();
    let directory = source.read(what, header.directory_offset, header.directory_length as usize)?;
    if xxh3_64(&directory) != header.directory_checksum {
        return Err(Fault::Checksum { what: what(), offset: header.directory_offset });
    }
    let records = directory.chunks_exact(size_of::<SectionRecord>());
    let sections: Vec<SectionRecord> = records.map(bytemuck::pod_read_unaligned).collect();
    let payload_end = check_places(&header, &sections)?;
    // With the zeros between the last chunk and the first section.
    let start = (payload_end - ALIGNMENT).max(size_of::<Header>() as u64);
    let tables = source.tail(start)?;
    let tail = Tail::new(&tables, header.file_length);
    check_sections(tail, &header, &sections)?;
    check_features(tail, &header, &sections, known_features)?;
    let chunks = sections.iter().find(|s| s.tag == CHUNK_TABLE);
    let chunks = chunks.ok_or_else(|| Fault::NoSection { tag: tag_text(CHUNK_TABLE) })?;
    check_chunks(tail, elements(&tail, chunks)?, payload_end)?;
    let chunks = tail.range(chunks);
    Ok(Parsed { tables, header, sections, chunks })
}

/// Magic, version, checksum, length, and a directory that lies between the header and the end.
fn parse_header(bytes: &[u8], file_length: u64) -> Result<Header, Fault> {
    if bytes.len() < size_of::<Header>() {
        return Err(if bytes.starts_with(&MAGIC) {
            Fault::Length { expected: size_of::<Header>() as u64, found: file_length }
        } else {
            Fault::NotAnArchive
        });
    }
    let header: Header = bytemuck::pod_read_unaligned(&bytes[..size_of::<Header>()]);
    if header.magic != MAGIC {
        return Err(Fault::NotAnArchive);
    }
    if header.version != FORMAT_VERSION {
        return Err(Fault::Version { found: header.version, known: FORMAT_VERSION });
    }
    if header.header_checksum != header.checksum() {
        return Err(Fault::Checksum { what: "the header".into(), offset: 0 });
    }
    if header.file_length != file_length {
        return Err(Fault::Length { expected: header.file_length, found: file_length });
    }
    if header.reserved != [0; 7] {
        return Err(malformed("the header", "reserved bytes are not zero"));
    }
    let end = header.directory_offset.checked_add(header.directory_length);
    let fits = end == Some(header.file_length)
        && header.directory_offset >= size_of::<Header>() as u64
        && header.directory_offset.is_multiple_of(ALIGNMENT)
        && header.directory_length.is_multiple_of(size_of::<SectionRecord>() as u64)
        && header.directory_length / size_of::<SectionRecord>() as u64 <= MAX_SECTIONS;
    if fits { Ok(header) } else { Err(malformed("the header", "the directory is not where it can be")) }
}

/// Bounds, alignment, order. Returns where the payload of chunks ends: from there on the file is tables.
fn check_places(header: &Header, sections: &[SectionRecord]) -> Result<u64, Fault> {
    for (i, s) in sections.iter().enumerate() {
        let what = || format!("section {:?}", tag_text(s.tag));
        let end = s.offset.checked_add(s.length).filter(|&e| e <= header.directory_offset);
        let end = end.ok_or_else(|| malformed(what(), "it does not fit into the file"))?;
        if s.offset % ALIGNMENT != 0 || s.offset < size_of::<Header>() as u64 {
            return Err(malformed(what(), "it starts at a wrong place"));
        }
        if s.element_size == 0 || s.length % s.element_size as u64 != 0 {
            return Err(malformed(what(), "its length is no multiple of its element size"));
        }
        if sections[..i].iter().any(|other| other.tag == s.tag) {
            return Err(malformed(what(), "it is there twice"));
        }
        let next = sections.get(i + 1).map_or(header.directory_offset, |n| n.offset);
        if end.next_multiple_of(ALIGNMENT) != next {
            return Err(malformed(what(), "the next section does not follow it"));
        }
    }
    Ok(sections.first().map_or(header.directory_offset, |s| s.offset))
}

/// Zeros between the sections, checksums.
fn check_sections(tail: Tail<'_>, header: &Header, sections: &[SectionRecord]) -> Result<(), Fault> {
    for (i, s) in sections.iter().enumerate() {
        let what = || format!("section {:?}", tag_text(s.tag));
        let end = s.offset + s.length;
        let next = sections.get(i + 1).map_or(header.directory_offset, |n| n.offset);
        if tail.at(end, next).iter().any(|&b| b != 0) {
            return Err(malformed(what(), "the bytes behind it are not zero"));
        }
        if xxh3_64(tail.at(s.offset, end)) != s.checksum {
            return Err(Fault::Checksum { what: what(), offset: s.offset });
        }
    }
    Ok(())
}

fn check_features(tail: Tail<'_>, header: &Header, sections: &[SectionRecord], known: u64) -> Result<(), Fault> {
    let unknown = header.required_features & !known;
    if unknown == 0 {
        return Ok(());
    }
    let bit = unknown.trailing_zeros();
    let names: &[FeatureRecord] = match sections.iter().find(|s| s.tag == FEATURES) {
        Some(section) => elements(&tail, section)?,
        None => &[],
    };
    let name = names.iter().find(|f| f.bit == bit).map(|f| {
        let length = f.name.iter().position(|&b| b == 0).unwrap_or(f.name.len());
        f.name[..length].escape_ascii().to_string()
    });
    Err(Fault::Feature { bit, name: name.unwrap_or_else(|| "not named in the file".into()) })
}

/// Every chunk lies between header and sections, and together they fill that space.
fn check_chunks(tail: Tail<'_>, table: &[ChunkRecord], payload_end: u64) -> Result<(), Fault> {
    if table.len() > u32::MAX as usize {
        return Err(malformed("the chunk table", "it has more than 2^32 chunks"));
    }
    let start = size_of::<Header>() as u64;
    let mut used = start;
    for (id, c) in table.iter().enumerate() {
        let end = c.offset.checked_add(c.stored_bytes as u64);
        if c.offset < start || end.is_none_or(|e| e > payload_end) {
            return Err(malformed(format!("chunk {id}"), "it does not fit into the file"));
        }
        used = used.saturating_add(c.stored_bytes as u64);
    }
    if used.checked_next_multiple_of(ALIGNMENT) != Some(payload_end) {
        return Err(malformed("the chunk table", "its chunks do not fill the space between header and sections"));
    }
    if tail.at(used, payload_end).iter().any(|&b| b != 0) {
        return Err(malformed("the chunk table", "the bytes behind the last chunk are not zero"));
    }
    Ok(())
}

/// The elements of a section whose bounds were checked.
fn elements<'a, T: Pod>(tail: &Tail<'a>, section: &SectionRecord) -> Result<&'a [T], Fault> {
    let what = || format!("section {:?}", tag_text(section.tag));
    if section.element_size as usize != size_of::<T>() {
        return Err(malformed(what(), &format!("elements of {} bytes, not {}", section.element_size, size_of::<T>())));
    }
    bytemuck::try_cast_slice(&tail.bytes[tail.range(section)]).map_err(|e| malformed(what(), &e.to_string()))
}

fn malformed(what: impl Into<String>, why: &str) -> Fault {
    Fault::Malformed { what: what.into(), why: why.into() }
}
