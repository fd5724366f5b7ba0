//! Before the work begins: the bound on memory, and whether the disk has room for what will lie beyond it.

use crate::cli::BakeArgs;
use crate::failure::{Failure, blame_machine};
use bytesize::ByteSize;
use pb_bake::memory::{ANONYMOUS_SHARE, Bound, free_bytes};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes that a bake holds at its peak per byte of an input; docs/performance.md has the measurements. By how a triangle is
/// written: 19 bytes and more in a binary PLY, 18 in a glTF, 50 in a binary STL, about 50 in an ascii PLY, 70 in an OBJ.
const BINARY_PLY: u64 = 9;
const GLTF: u64 = 9;
const TEXT: u64 = 3;

/// What is kept for a resumption takes about this share of what a bake holds at its peak.
const KEPT_SHARE: f64 = 0.3;

/// Bounds the memory of this bake, where that can be done on this system. Also: has the disk room for what a bake could be
/// resumed from?
///
/// # Errors
/// No temporary file can be made, or the disk has no room for what is going to be in it.
pub fn bound_memory(args: &BakeArgs) -> Result<(Option<Bound>, bool), Failure> {
    let Some(memory) = args.memory_bytes() else { return Ok((None, true)) };
    let folder = args.temp_folder();
    let held: u64 = args.inputs.iter().map(|input| working_bytes(input)).sum();
    let beyond = held.saturating_sub((memory as f64 * ANONYMOUS_SHARE) as u64);
    let free = free_bytes(folder);
    if let Some(free) = free.filter(|free| *free < beyond) {
        return Err(blame_machine(format!(
            "{}: about {} of temporary files are going to be needed, and {} are free; name a folder with more room with \
             --temp-dir, or allow more memory than {} with --memory",
            folder.display(),
            ByteSize(beyond),
            ByteSize(free),
            ByteSize(memory),
        )));
    }
    let keeps = free.is_none_or(|free| free - beyond >= (held as f64 * KEPT_SHARE) as u64);
    let bound = Bound::new(memory, folder);
    bound.map(|bound| (Some(bound), keeps)).map_err(|e| {
        blame_machine(format!(
            "{}: cannot hold temporary files: {e}; name another folder with --temp-dir",
            folder.display()
        ))
    })
}

/// What a bake of this input holds at its peak, roughly. Images are not counted: they lie in files of their own.
fn working_bytes(input: &Path) -> u64 {
    let Ok(metadata) = std::fs::metadata(input) else { return 0 };
    let mut start = Vec::new();
    let read = File::open(input).and_then(|file| file.take(64).read_to_end(&mut start));
    let factor = match read {
        Ok(_) if start.starts_with(b"glTF") => GLTF,
        Ok(_) if start.starts_with(b"ply") && contains(&start, b"format binary") => BINARY_PLY,
        Ok(_) => TEXT,
        Err(_) => 0,
    };
    metadata.len().saturating_mul(factor)
}

fn contains(text: &[u8], word: &[u8]) -> bool {
    text.windows(word.len()).any(|w| w == word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_input_needs_follows_from_its_kind_and_size() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str, start: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, [start, &vec![b' '; 1000 - start.len()]].concat()).unwrap();
            working_bytes(&path)
        };
        assert_eq!(of("a.ply", b"ply\nformat binary_little_endian 1.0\n"), 1000 * BINARY_PLY);
        assert_eq!(of("b.ply", b"ply\nformat ascii 1.0\n"), 1000 * TEXT);
        assert_eq!(of("c.obj", b"v 0 0 0\n"), 1000 * TEXT);
        assert_eq!(working_bytes(&folder.path().join("none.obj")), 0);
    }
}
