//! Opens an archive: everything but the chunks is checked at once, each chunk when it is asked for.
//!
//! Must never: trust a number from the file before it is compared with the file's length; panic.

use crate::error::{ArchiveError, Fault, tag_text};
use crate::format::*;
use bytemuck::Pod;
use std::fs::File;
use std::marker::PhantomData;
use std::ops::Range;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// An open archive. Cheap to share; all access is by shared reference.
pub struct Archive {
    path: PathBuf,
    bytes: Bytes,
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

enum Bytes {
    Map(memmap2::Mmap),
    Memory(Vec<u64>, usize),
}

impl Bytes {
    fn all(&self) -> &[u8] {
        match self {
            Bytes::Map(map) => map,
            Bytes::Memory(words, length) => &bytemuck::cast_slice(words)[..*length],
        }
    }
}

impl Archive {
    /// Maps and checks the file. `known_features` has a bit for each required feature that the caller knows.
    ///
    /// Assumes that nobody shortens the file in place while it is open (the system would then end the program
    /// with SIGBUS); pb-bake itself never does, it replaces files by renaming.
    pub fn open(path: &Path, known_features: u64) -> Result<Self, ArchiveError> {
        let io = |doing| move |source| ArchiveError::new(path, Fault::Io { doing, source });
        let metadata = std::fs::metadata(path).map_err(io("open it"))?;
        if !metadata.is_file() {
            return Err(ArchiveError::new(path, Fault::NotAFile));
        }
        let file = File::open(path).map_err(io("open it"))?;
        if metadata.len() < size_of::<Header>() as u64 {
            return Self::checked(path, Bytes::Memory(Vec::new(), 0), known_features);
        }
        let map = map(&file).map_err(io("map it into memory"))?;
        Self::checked(path, Bytes::Map(map), known_features)
    }

    /// The same checks on a copy of bytes in memory; `name` is for messages.
    pub fn from_bytes(name: &Path, bytes: &[u8], known_features: u64) -> Result<Self, ArchiveError> {
        let mut words = vec![0u64; bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self::checked(name, Bytes::Memory(words, bytes.len()), known_features)
    }

    fn checked(path: &Path, bytes: Bytes, known_features: u64) -> Result<Self, ArchiveError> {
        let parsed = parse(bytes.all(), known_features).map_err(|fault| ArchiveError::new(path, fault))?;
        let Parsed { header, sections, chunks } = parsed;
        Ok(Self { path: path.to_owned(), bytes, header, sections, chunks })
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
        elements(self.bytes.all(), record).map_err(fail)
    }

    /// Finds a section once, for quick access with [`rows`](Archive::rows). Fails as [`section`](Archive::section).
    pub fn table<T: Pod>(&self, tag: [u8; 4]) -> Result<Table<T>, ArchiveError> {
        self.section::<T>(tag)?;
        let record = self.sections.iter().find(|s| s.tag == tag).expect("the section was found above");
        let range = record.offset as usize..(record.offset + record.length) as usize;
        Ok(Table { range, element: PhantomData })
    }

    /// The elements of a section that was found in this archive.
    ///
    /// # Panics
    /// May panic if `table` comes from another archive.
    pub fn rows<T: Pod>(&self, table: &Table<T>) -> &[T] {
        bytemuck::cast_slice(&self.bytes.all()[table.range.clone()])
    }

    /// The chunk table.
    pub fn chunks(&self) -> &[ChunkRecord] {
        bytemuck::cast_slice(&self.bytes.all()[self.chunks.clone()])
    }

    /// The stored bytes of a chunk, compared with their checksum.
    pub fn chunk(&self, id: u32) -> Result<&[u8], ArchiveError> {
        let fail = |fault| ArchiveError::new(&self.path, fault);
        let table = self.chunks();
        let no_chunk = || fail(Fault::NoChunk { id, count: table.len() as u32 });
        let record = table.get(id as usize).ok_or_else(no_chunk)?;
        // In bounds: checked when the archive was opened.
        let bytes = &self.bytes.all()[record.offset as usize..][..record.stored_bytes as usize];
        if xxh3_64(bytes) != record.checksum {
            return Err(fail(Fault::Checksum { what: format!("chunk {id}"), offset: record.offset }));
        }
        Ok(bytes)
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

#[allow(unsafe_code)]
fn map(file: &File) -> std::io::Result<memmap2::Mmap> {
    // SAFETY: the map is read-only and private to this process. Another process that changes the file in
    // place could change bytes behind shared references; every use of them is plain-old-data that is valid for
    // any bit pattern, and writers of this format never change a file in place (see `open`).
    unsafe { memmap2::Mmap::map(file) }
}

struct Parsed {
    header: Header,
    sections: Vec<SectionRecord>,
    chunks: Range<usize>,
}

/// The one place where the bytes of a file become header, directory and chunk table.
fn parse(bytes: &[u8], known_features: u64) -> Result<Parsed, Fault> {
    let header = parse_header(bytes)?;
    let start = header.directory_offset as usize;
    let directory = &bytes[start..start + header.directory_length as usize];
    if xxh3_64(directory) != header.directory_checksum {
        return Err(Fault::Checksum { what: "the directory".into(), offset: header.directory_offset });
    }
    let records = directory.chunks_exact(size_of::<SectionRecord>());
    let sections: Vec<SectionRecord> = records.map(bytemuck::pod_read_unaligned).collect();
    let payload_end = check_sections(bytes, &header, &sections)?;
    check_features(bytes, &header, &sections, known_features)?;
    let chunks = sections.iter().find(|s| s.tag == CHUNK_TABLE);
    let chunks = chunks.ok_or_else(|| Fault::NoSection { tag: tag_text(CHUNK_TABLE) })?;
    check_chunks(bytes, elements(bytes, chunks)?, payload_end)?;
    let chunks = chunks.offset as usize..(chunks.offset + chunks.length) as usize;
    Ok(Parsed { header, sections, chunks })
}

/// Magic, version, checksum, length, and a directory that lies between the header and the end.
fn parse_header(bytes: &[u8]) -> Result<Header, Fault> {
    if bytes.len() < size_of::<Header>() {
        return Err(if bytes.starts_with(&MAGIC) {
            Fault::Length { expected: size_of::<Header>() as u64, found: bytes.len() as u64 }
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
    if header.file_length != bytes.len() as u64 {
        return Err(Fault::Length { expected: header.file_length, found: bytes.len() as u64 });
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

/// Bounds, alignment, order, zeros between, checksums. Returns where the payload of chunks ends.
fn check_sections(bytes: &[u8], header: &Header, sections: &[SectionRecord]) -> Result<u64, Fault> {
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
        if bytes[end as usize..next as usize].iter().any(|&b| b != 0) {
            return Err(malformed(what(), "the bytes behind it are not zero"));
        }
        if xxh3_64(&bytes[s.offset as usize..end as usize]) != s.checksum {
            return Err(Fault::Checksum { what: what(), offset: s.offset });
        }
    }
    Ok(sections.first().map_or(header.directory_offset, |s| s.offset))
}

fn check_features(bytes: &[u8], header: &Header, sections: &[SectionRecord], known: u64) -> Result<(), Fault> {
    let unknown = header.required_features & !known;
    if unknown == 0 {
        return Ok(());
    }
    let bit = unknown.trailing_zeros();
    let names: &[FeatureRecord] = match sections.iter().find(|s| s.tag == FEATURES) {
        Some(section) => elements(bytes, section)?,
        None => &[],
    };
    let name = names.iter().find(|f| f.bit == bit).map(|f| {
        let length = f.name.iter().position(|&b| b == 0).unwrap_or(f.name.len());
        f.name[..length].escape_ascii().to_string()
    });
    Err(Fault::Feature { bit, name: name.unwrap_or_else(|| "not named in the file".into()) })
}

/// Every chunk lies between header and sections, and together they fill that space.
fn check_chunks(bytes: &[u8], table: &[ChunkRecord], payload_end: u64) -> Result<(), Fault> {
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
    if bytes[used as usize..payload_end as usize].iter().any(|&b| b != 0) {
        return Err(malformed("the chunk table", "the bytes behind the last chunk are not zero"));
    }
    Ok(())
}

/// The elements of a section whose bounds were checked.
fn elements<'a, T: Pod>(bytes: &'a [u8], section: &SectionRecord) -> Result<&'a [T], Fault> {
    let what = || format!("section {:?}", tag_text(section.tag));
    if section.element_size as usize != size_of::<T>() {
        return Err(malformed(what(), &format!("elements of {} bytes, not {}", section.element_size, size_of::<T>())));
    }
    let bytes = &bytes[section.offset as usize..(section.offset + section.length) as usize];
    bytemuck::try_cast_slice(bytes).map_err(|e| malformed(what(), &e.to_string()))
}

fn malformed(what: impl Into<String>, why: &str) -> Fault {
    Fault::Malformed { what: what.into(), why: why.into() }
}
