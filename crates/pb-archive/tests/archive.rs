//! What the container promises, for whole, cut, damaged and hostile files.

use pb_archive::*;
use std::cell::Cell;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::rc::Rc;

const SCHEME: [u8; 4] = *b"TEST";
const NUMBERS: [u8; 4] = *b"NUMB";

fn fill<S: Storage>(mut writer: Writer<S>) -> Result<u64, ArchiveError> {
    writer.put_chunk(1, b"second chunk", 40)?;
    writer.put_chunk(0, b"first", 10)?;
    writer.put_chunk(2, b"", 0)?;
    writer.add_section(NUMBERS, &[7u64, 8, 9])?;
    writer.finish()
}

fn target(folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join("out.pb")
}

fn sample() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    fill(Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap()).unwrap();
    std::fs::read(target(&folder)).unwrap()
}

fn open(bytes: &[u8]) -> Result<Archive, ArchiveError> {
    Archive::from_bytes(Path::new("sample.pb"), bytes, 0)
}

/// Reads everything, as a program that checks a file would.
fn read_all(bytes: &[u8]) -> Result<(), ArchiveError> {
    let archive = open(bytes)?;
    archive.section::<u64>(NUMBERS)?;
    archive.chunks_in_file_order()?;
    (0..archive.chunks().len() as u32).try_for_each(|id| archive.chunk(id).map(|_| ()))
}

fn files_in(folder: &tempfile::TempDir) -> usize {
    std::fs::read_dir(folder.path()).unwrap().count()
}

#[test]
fn what_was_written_is_read_back_from_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let writer = Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap();
    let length = fill(writer).unwrap();
    let archive = Archive::open(&target(&folder), 0).unwrap();
    assert_eq!(archive.file_bytes(), length);
    assert_eq!(archive.header().scheme, SCHEME);
    assert_eq!(archive.section::<u64>(NUMBERS).unwrap(), [7, 8, 9]);
    assert_eq!(*archive.chunk(0).unwrap(), *b"first");
    assert_eq!(*archive.chunk(1).unwrap(), *b"second chunk");
    assert_eq!(*archive.chunk(2).unwrap(), *b"");
    assert_eq!(archive.chunks()[1].decoded_bytes, 40);
    assert_eq!(archive.chunks_in_file_order().unwrap(), [1, 0, 2]);
    assert_eq!(files_in(&folder), 1);
}

#[test]
fn the_same_contents_give_the_same_bytes() {
    assert_eq!(sample(), sample());
}

#[test]
fn a_file_cut_at_any_length_is_refused() {
    let bytes = sample();
    for length in 0..bytes.len() {
        assert!(open(&bytes[..length]).is_err(), "{length}");
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(open(&longer).err().unwrap().to_string().contains("cut or added to"));
}

#[test]
fn every_flipped_bit_is_found() {
    let bytes = sample();
    for bit in 0..bytes.len() * 8 {
        let mut bad = bytes.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        assert!(read_all(&bad).is_err(), "bit {bit}");
    }
}

#[test]
fn a_damaged_chunk_is_named_and_the_others_are_read() {
    let mut bytes = sample();
    let place = bytes.windows(5).position(|w| w == b"first").unwrap();
    bytes[place] ^= 1;
    let archive = open(&bytes).unwrap();
    assert!(archive.chunk(0).unwrap_err().to_string().contains("chunk 0 at byte 140 is damaged"));
    assert_eq!(*archive.chunk(1).unwrap(), *b"second chunk");
}

/// A larger archive in a file, open: chunk `i` is 5000 bytes of `i`.
fn opened() -> (tempfile::TempDir, Archive) {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap();
    (0..20).for_each(|i| writer.put_chunk(i, &[i as u8; 5000], 5000).unwrap());
    writer.add_section(NUMBERS, &[7u64, 8, 9]).unwrap();
    writer.finish().unwrap();
    let archive = Archive::open(&target(&folder), 0).unwrap();
    (folder, archive)
}

#[test]
fn a_file_that_is_cut_while_it_is_open_gives_errors_and_no_signal() {
    let (folder, archive) = opened();
    let file = std::fs::File::options().write(true).open(target(&folder)).unwrap();
    file.set_len(25_000).unwrap();
    assert_eq!(*archive.chunk(0).unwrap(), [0; 5000]);
    let text = archive.chunk(10).unwrap_err().to_string();
    assert!(text.contains("chunk 10 ends at byte 55128") && text.contains("only 25000 now"), "{text}");
    assert!(archive.read(20_000, 6000).is_err() && archive.read(0, 25_000).is_ok());
    file.set_len(0).unwrap();
    assert!(archive.chunk(0).is_err());
    assert_eq!(archive.section::<u64>(NUMBERS).unwrap(), [7, 8, 9], "tables are kept");
    assert_eq!(archive.chunks().len(), 20);
}

#[test]
fn a_file_that_is_replaced_while_it_is_open_is_read_as_it_was() {
    let (folder, archive) = opened();
    fill(Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap()).unwrap();
    assert!((0..20).all(|i| *archive.chunk(i).unwrap() == [i as u8; 5000]));
}

#[test]
fn a_file_that_is_written_over_while_it_is_open_gives_errors() {
    let (folder, archive) = opened();
    std::fs::write(target(&folder), vec![0; archive.file_bytes() as usize]).unwrap();
    assert!(archive.chunk(3).unwrap_err().to_string().contains("chunk 3 at byte"));
}

#[test]
fn several_chunks_are_read_at_once_and_checked_one_by_one() {
    let (_folder, archive) = opened();
    archive.will_need(0, archive.file_bytes());
    let (first, second) = (archive.chunks()[4], archive.chunks()[5]);
    let bytes = archive.read(first.offset, 10_000).unwrap();
    assert_eq!(second.offset, first.offset + 5000);
    archive.check_chunk(4, &bytes[..5000]).unwrap();
    archive.check_chunk(5, &bytes[5000..]).unwrap();
    assert!(archive.check_chunk(5, &bytes[4999..9999]).is_err() && archive.check_chunk(5, &bytes[5000..9999]).is_err());
    assert!(archive.read(archive.file_bytes(), 1).is_err() && archive.read(u64::MAX, 2).is_err());
}

#[test]
fn asking_for_what_is_not_there_is_an_error() {
    let bytes = sample();
    let archive = open(&bytes).unwrap();
    assert!(archive.chunk(3).unwrap_err().to_string().contains("only 3"));
    assert!(archive.section::<u64>(*b"NONE").unwrap_err().to_string().contains("\"NONE\" is missing"));
    assert!(archive.section::<u32>(NUMBERS).unwrap_err().to_string().contains("elements of 8 bytes"));
}

/// Changes the header of a sound file and makes its checksum right again.
fn with_header(change: impl FnOnce(&mut Header)) -> Vec<u8> {
    let mut bytes = sample();
    let mut header: Header = bytemuck::pod_read_unaligned(&bytes[..128]);
    change(&mut header);
    header.header_checksum = header.checksum();
    bytes[..128].copy_from_slice(bytemuck::bytes_of(&header));
    bytes
}

fn message(bytes: &[u8]) -> String {
    open(bytes).err().expect("refused").to_string()
}

#[test]
fn an_unknown_version_is_refused_by_number() {
    let text = message(&with_header(|h| h.version = 9));
    assert!(text.contains("version 9") && text.contains("reads version 1"), "{text}");
}

#[test]
fn an_unknown_required_feature_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap();
    writer.require(Feature { bit: 5, name: "texture-tiles" });
    fill(writer).unwrap();
    let text = Archive::open(&target(&folder), 0b11111).err().unwrap().to_string();
    assert!(text.contains("feature 5 (texture-tiles)"), "{text}");
    assert!(Archive::open(&target(&folder), 1 << 5).is_ok());
}

#[test]
fn an_unknown_required_bit_without_a_name_is_refused_by_number() {
    assert!(message(&with_header(|h| h.required_features = 1 << 63)).contains("feature 63"));
}

#[test]
fn an_unknown_optional_feature_is_ignored() {
    assert!(open(&with_header(|h| h.optional_features = u64::MAX)).is_ok());
}

#[test]
fn absurd_places_and_lengths_are_refused() {
    let far = [0, 1, 64, 127, 1 << 20, u64::MAX - 63, u64::MAX];
    for value in far {
        assert!(open(&with_header(|h| h.directory_offset = value)).is_err(), "{value}");
        if value != 0 {
            assert!(open(&with_header(|h| h.directory_length = value)).is_err(), "{value}");
        }
    }
    assert!(message(&with_header(|h| h.file_length += 1)).contains("header says"));
}

#[test]
fn absurd_sections_and_chunks_are_refused() {
    // The directory's records are rewritten with right checksums, so only the bounds can refuse them.
    for change in [
        |s: &mut SectionRecord| s.offset = u64::MAX - 63,
        |s: &mut SectionRecord| s.offset = 0,
        |s: &mut SectionRecord| s.offset += 8,
        |s: &mut SectionRecord| s.length = u64::MAX,
        |s: &mut SectionRecord| s.element_size = 0,
        |s: &mut SectionRecord| s.element_size = 5,
        |s: &mut SectionRecord| s.tag = CHUNK_TABLE,
    ] {
        let mut bytes = sample();
        let header: Header = bytemuck::pod_read_unaligned(&bytes[..128]);
        let place = header.directory_offset as usize;
        let mut record: SectionRecord = bytemuck::pod_read_unaligned(&bytes[place..place + 32]);
        change(&mut record);
        bytes[place..place + 32].copy_from_slice(bytemuck::bytes_of(&record));
        let checksum = xxhash_rust::xxh3::xxh3_64(&bytes[place..]);
        let header = Header { directory_checksum: checksum, ..header };
        let header = Header { header_checksum: header.checksum(), ..header };
        bytes[..128].copy_from_slice(bytemuck::bytes_of(&header));
        assert!(message(&bytes).contains("section"), "{}", message(&bytes));
    }
}

#[test]
fn other_files_are_no_archives() {
    for bytes in [&b""[..], b"ply\nformat ascii 1.0\n", &[0; 4096], &[0xff; 200]] {
        assert!(message(bytes).contains("not a progressive-buffers archive"));
    }
    assert!(Archive::open(Path::new("/"), 0).err().unwrap().to_string().contains("is a folder"));
    assert!(Archive::open(Path::new("nowhere.pb"), 0).err().unwrap().to_string().contains("cannot open it"));
}

#[test]
fn an_archive_is_replaced_and_another_file_only_by_force() {
    let folder = tempfile::tempdir().unwrap();
    let path = target(&folder);
    std::fs::write(&path, "my thesis").unwrap();
    let refused = Writer::create(&path, SCHEME, Overwrite::IfArchive).err().unwrap().to_string();
    assert!(refused.contains("--force"), "{refused}");
    assert_eq!(std::fs::read(&path).unwrap(), b"my thesis");
    fill(Writer::create(&path, SCHEME, Overwrite::Force).unwrap()).unwrap();
    fill(Writer::create(&path, SCHEME, Overwrite::IfArchive).unwrap()).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), sample());
}

#[test]
fn targets_that_cannot_be_written_are_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |path: &Path| Writer::create(path, SCHEME, Overwrite::Force).err().unwrap().to_string();
    assert!(refusal(folder.path()).contains("is a folder"));
    assert!(refusal(&folder.path().join("no/such/out.pb")).contains("create it first"));
    assert!(refusal(Path::new("")).contains("is a folder or a device"));
    #[cfg(unix)]
    assert!(refusal(Path::new("/dev/null")).contains("device"));
}

#[test]
fn dropping_an_unfinished_writer_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap();
    writer.put_chunk(0, &[1; 5000], 1).unwrap();
    assert!(!target(&folder).exists());
    drop(writer);
    assert_eq!(files_in(&folder), 0);
}

/// Passes everything on to a file, but fails at operation number `fail_at`.
struct Faulty {
    inner: FileStorage,
    operation: Rc<Cell<usize>>,
    fail_at: usize,
}

impl Faulty {
    fn step(&mut self) -> io::Result<()> {
        let n = self.operation.get();
        self.operation.set(n + 1);
        if n == self.fail_at { Err(io::Error::new(ErrorKind::StorageFull, "disk full")) } else { Ok(()) }
    }
}

impl Storage for Faulty {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.step().and_then(|()| self.inner.append(bytes))
    }
    fn replace(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        self.step().and_then(|()| self.inner.replace(offset, bytes))
    }
    fn sync(&mut self) -> io::Result<()> {
        self.step().and_then(|()| self.inner.sync())
    }
    fn publish(&mut self) -> io::Result<()> {
        self.step().and_then(|()| self.inner.publish())
    }
    fn sync_folder(&mut self) -> io::Result<()> {
        self.step().and_then(|()| self.inner.sync_folder())
    }
}

#[test]
fn a_fault_at_any_operation_leaves_the_old_file_or_the_whole_new_one() {
    let mut fail_at = 0;
    loop {
        let folder = tempfile::tempdir().unwrap();
        let path = target(&folder);
        let operation = Rc::new(Cell::new(0));
        let inner = FileStorage::create(&path, Overwrite::IfArchive).unwrap();
        let faulty = Faulty { inner, operation: operation.clone(), fail_at };
        let result = Writer::with_storage(faulty, &path, SCHEME).and_then(fill);
        if result.is_ok() {
            assert!(operation.get() <= fail_at && fail_at > 10, "{fail_at}");
            return;
        }
        assert!(result.unwrap_err().to_string().contains("disk full"));
        if path.exists() {
            // Only the last step, syncing the folder, comes after the name.
            assert_eq!(std::fs::read(&path).unwrap(), sample());
            assert_eq!(files_in(&folder), 1);
        } else {
            assert_eq!(files_in(&folder), 0, "operation {fail_at}");
        }
        fail_at += 1;
    }
}

#[test]
fn what_killed_writers_left_is_removed_and_what_others_are_writing_is_not() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(".pb-bake-killed.tmp"), b"half").unwrap();
    let first = Writer::create(&target(&folder), SCHEME, Overwrite::IfArchive).unwrap();
    assert_eq!(files_in(&folder), 1, "only the first writer's");
    let second = Writer::create(&folder.path().join("other.pb"), SCHEME, Overwrite::IfArchive).unwrap();
    assert_ne!(first.temporary(), second.temporary());
    fill(first).unwrap();
    fill(second).unwrap();
    assert_eq!(files_in(&folder), 2, "both archives");
}
