//! A file of results, one after the other, each with its number, length and sum. What a process has not finished writing
//! has no valid head, and is overwritten by the next.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use xxhash_rust::xxh3::Xxh3;

/// Before every result.
#[derive(Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Head {
    magic: u32,
    part: u32,
    length: u64,
    /// XXH3 of the result.
    sum: u64,
}

const MAGIC: u32 = u32::from_ne_bytes(*b"part");
const HEAD_BYTES: u64 = size_of::<Head>() as u64;
/// Bytes that are read and written at a time.
const BLOCK: usize = 1 << 18;

/// The results of a step.
pub(super) struct Journal {
    path: PathBuf,
    file: File,
    /// Where the bytes of each part begin, and how many they are.
    parts: BTreeMap<u32, (u64, u64)>,
    end: u64,
}

impl Journal {
    /// What lies in a file, as far as it is whole; a new one where there is none.
    pub fn open(path: PathBuf) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(&path)?;
        let mut journal = Journal { path, file, parts: BTreeMap::new(), end: 0 };
        let mut reader = BufReader::with_capacity(BLOCK, &journal.file);
        while let Some(head) = whole_part(&mut reader)? {
            journal.parts.insert(head.part, (journal.end + HEAD_BYTES, head.length));
            journal.end += HEAD_BYTES + head.length;
        }
        Ok(journal)
    }

    /// The bytes of a part.
    pub fn find(&self, part: u32) -> Option<impl Read + use<>> {
        let &(start, length) = self.parts.get(&part)?;
        let mut file = File::open(&self.path).ok()?;
        file.seek(SeekFrom::Start(start)).ok()?;
        Some(BufReader::with_capacity(BLOCK, file).take(length))
    }

    /// Adds a part. Its head is written last.
    pub fn append(&mut self, part: u32, write: &dyn Fn(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let start = self.end + HEAD_BYTES;
        self.file.set_len(self.end)?;
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(&[0; HEAD_BYTES as usize])?;
        let mut out = Summing { out: BufWriter::with_capacity(BLOCK, &self.file), sum: Xxh3::new(), length: 0 };
        write(&mut out).and_then(|()| out.flush())?;
        let (length, sum) = (out.length, out.sum.digest());
        drop(out);
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(bytemuck::bytes_of(&Head { magic: MAGIC, part, length, sum }))?;
        self.parts.insert(part, (start, length));
        self.end = start + length;
        Ok(())
    }
}

/// Reads a part; `None` where there is no further one that is whole.
fn whole_part(input: &mut impl Read) -> io::Result<Option<Head>> {
    let mut head: Head = bytemuck::Zeroable::zeroed();
    match input.read_exact(bytemuck::bytes_of_mut(&mut head)) {
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    if head.magic != MAGIC {
        return Ok(None);
    }
    let (mut sum, mut left, mut block) = (Xxh3::new(), head.length, vec![0; BLOCK]);
    while left > 0 {
        let got = input.read(&mut block[..left.min(BLOCK as u64) as usize])?;
        if got == 0 {
            return Ok(None);
        }
        sum.update(&block[..got]);
        left -= got as u64;
    }
    Ok((sum.digest() == head.sum).then_some(head))
}

/// Sums what passes through.
struct Summing<W> {
    out: W,
    sum: Xxh3,
    length: u64,
}

impl<W: Write> Write for Summing<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.sum.update(&bytes[..written]);
        self.length += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(journal: &Journal, part: u32) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        journal.find(part)?.read_to_end(&mut bytes).unwrap();
        Some(bytes)
    }

    #[test]
    fn a_cut_anywhere_leaves_the_parts_before_it_and_the_next_ones_follow_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("step");
        let mut journal = Journal::open(path.clone()).unwrap();
        journal.append(7, &|out| out.write_all(b"seven")).unwrap();
        let first = std::fs::metadata(&path).unwrap().len();
        journal.append(2, &|out| out.write_all(b"two")).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let mut journal = Journal::open(path.clone()).unwrap();
            let expected = [cut as u64 >= first, cut == whole.len()].map(|there| there.then_some(()));
            let found = [7, 2].map(|part| read(&journal, part));
            assert_eq!(found.clone().map(|f| f.map(drop)), expected, "{cut} bytes");
            assert!(found[0].as_ref().is_none_or(|bytes| bytes == b"seven"));
            journal.append(9, &|out| out.write_all(b"nine")).unwrap();
            drop(journal);
            let journal = Journal::open(path.clone()).unwrap();
            assert_eq!(read(&journal, 9).as_deref(), Some(&b"nine"[..]), "{cut} bytes");
            assert_eq!(read(&journal, 7), found[0]);
        }
    }

    #[test]
    fn damage_shows_and_what_could_not_be_written_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("step");
        let mut journal = Journal::open(path.clone()).unwrap();
        journal.append(1, &|out| out.write_all(&[5; 1000])).unwrap();
        journal.append(2, &|_| Err(io::Error::other("no"))).unwrap_err();
        journal.append(3, &|out| out.write_all(b"three")).unwrap();
        let journal = Journal::open(path.clone()).unwrap();
        assert_eq!([1, 2, 3].map(|part| read(&journal, part).is_some()), [true, false, true]);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[500] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert!(read(&Journal::open(path).unwrap(), 1).is_none());
    }
}
