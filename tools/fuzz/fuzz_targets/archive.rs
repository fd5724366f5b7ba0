//! Opens, verifies and exports arbitrary bytes as an archive: once as they are, and once with all checksums made
//! right, so that what lies behind them is reached. Start from data-fixtures/format-1.pb.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pb_archive::{CHUNK_TABLE, ChunkRecord, Header, SectionRecord};
use pb_lod::plan::ChunkId;
use pb_lod::progressive_buffers::model::Model;
use pb_lod::progressive_buffers::verify::verify;
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// More chunks than a small file can hold in earnest.
const MAX_CHUNKS: usize = 2000;

fuzz_target!(|data: &[u8]| {
    look(data);
    let mut sealed = data.to_vec();
    if seal(&mut sealed).is_some() {
        look(&sealed);
    }
});

fn look(bytes: &[u8]) {
    let Ok(model) = Model::from_bytes(Path::new("input.pb"), bytes) else { return };
    if model.archive().chunks().len() > MAX_CHUNKS {
        return;
    }
    for chunk in 0..model.archive().chunks().len() as u32 {
        let _ = model.read_chunk(ChunkId(chunk));
    }
    let _ = verify(&model);
    for level in 0..model.levels() {
        let _ = model.export_level(level);
    }
}

/// Makes lengths and checksums right where the structures lie inside the file.
fn seal(bytes: &mut [u8]) -> Option<()> {
    let mut header: Header = bytemuck::pod_read_unaligned(bytes.get(..128)?);
    header.file_length = bytes.len() as u64;
    header.directory_length = header.file_length.checked_sub(header.directory_offset)?;
    let entries = (header.directory_length / 32).min(64) as usize;
    let first = header.directory_offset as usize;
    for place in (0..entries).map(|i| first + i * 32) {
        let mut section: SectionRecord = bytemuck::pod_read_unaligned(bytes.get(place..place + 32)?);
        let (offset, length) = (section.offset as usize, section.length as usize);
        if section.tag == CHUNK_TABLE && length / 24 <= MAX_CHUNKS {
            for chunk in (0..length / 24).filter_map(|i| offset.checked_add(i * 24)) {
                seal_chunk(bytes, chunk);
            }
        }
        let content = offset.checked_add(length).and_then(|end| bytes.get(offset..end));
        section.checksum = content.map_or(0, xxh3_64);
        bytes[place..place + 32].copy_from_slice(bytemuck::bytes_of(&section));
    }
    header.directory_checksum = xxh3_64(bytes.get(first..)?);
    header.header_checksum = header.checksum();
    bytes[..128].copy_from_slice(bytemuck::bytes_of(&header));
    Some(())
}

fn seal_chunk(bytes: &mut [u8], place: usize) -> Option<()> {
    let mut chunk: ChunkRecord = bytemuck::pod_read_unaligned(bytes.get(place..place.checked_add(24)?)?);
    let start = chunk.offset as usize;
    chunk.checksum = xxh3_64(bytes.get(start..start.checked_add(chunk.stored_bytes as usize)?)?);
    bytes[place..place + 24].copy_from_slice(bytemuck::bytes_of(&chunk));
    Some(())
}
