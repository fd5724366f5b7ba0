//! The bytes of an input, and what kind of file they are. Content decides before the name does.

use super::Format;
use super::error::{ImportError, Refusal, damaged, refused};
use crate::memory::Watched;
use memmap2::Mmap;
use std::fs::File;
use std::path::Path;

/// Files of other kinds that people hand in, by how they begin: what they are, and what to do.
const OTHER_KINDS: &[(&[u8], &str, &str)] = &[
    (
        b"version https://git-lfs",
        "is a Git LFS pointer, not the model itself",
        "run `git lfs pull` where it comes from",
    ),
    (b"\x89PBA\r\n\x1a\n", "is a PB archive, which is what baking makes", "give the model that it was baked from"),
    (b"PK\x03\x04", "is a ZIP container (USDZ, 3MF or plain)", "unpack it and give the OBJ, PLY, STL or glTF inside"),
    (b"DRACO", "is a bare Draco stream", "convert it to PLY or OBJ with draco_decoder"),
    (b"Kaydara FBX", "is an FBX file", "export it as glTF or OBJ"),
    (b"; FBX", "is an FBX file", "export it as glTF or OBJ"),
    (b"PXR-USDC", "is a USD file", "export it as glTF or OBJ"),
    (b"#usda", "is a USD file", "export it as glTF or OBJ"),
    (b"BLENDER", "is a Blender file", "export it from Blender as glTF, PLY or OBJ"),
    (b"<?xml", "is an XML file (COLLADA, X3D or the like)", "export it as glTF or OBJ"),
    (b"<COLLADA", "is a COLLADA file", "export it as glTF or OBJ"),
    (b"\x89PNG", "is a PNG image", "give the model; images are found through it"),
    (b"\xFF\xD8\xFF", "is a JPEG image", "give the model; images are found through it"),
    (b"v/1\x01", "is an OpenEXR image", "give the model; images are found through it"),
    (b"\x1F\x8B", "is compressed with gzip", "unpack it first: gunzip"),
    (b"\xFD7zXZ", "is compressed with xz", "unpack it first: unxz"),
    (b"\x28\xB5\x2F\xFD", "is compressed with zstd", "unpack it first: unzstd"),
    (b"7z\xBC\xAF", "is a 7z archive", "unpack it first"),
    (b"\xFF\xFE", "is UTF-16 text", "save it as UTF-8 or plain ASCII"),
    (b"\xFE\xFF", "is UTF-16 text", "save it as UTF-8 or plain ASCII"),
];

/// How far the first word of a text may be from the beginning of the file.
const SNIFFED_BYTES: usize = 4096;

/// A file's bytes, mapped where there are any.
pub(crate) struct Source {
    /// Lets the pages of the map go where memory is short; ends before the map.
    _watched: Option<Watched>,
    map: Option<Mmap>,
}

impl Source {
    /// Maps a regular file.
    #[allow(unsafe_code)]
    pub(crate) fn open(path: &Path) -> Result<Source, ImportError> {
        let name = path.display().to_string();
        let io = |source| ImportError::Io { path: name.clone(), source };
        let metadata = std::fs::metadata(path).map_err(io)?;
        if metadata.is_dir() {
            return Err(refused(Refusal::Unsupported, name, "is a directory", "give the model file inside it"));
        }
        if !metadata.is_file() {
            let remedy = "copy its content to a file first";
            return Err(refused(Refusal::Unsupported, name, "is not a regular file", remedy));
        }
        if metadata.len() == 0 {
            return Ok(Source { _watched: None, map: None });
        }
        let file = File::open(path).map_err(io)?;
        // SAFETY: the mapping is read-only and private to this value. Its bytes are outside data, every reader checks
        // them before use, and nothing relies on their staying the same; a file that another program cuts while it is
        // read ends this one, as the manual of mmap says.
        let map = unsafe { Mmap::map(&file) }.map_err(io)?;
        Ok(Source { _watched: Some(Watched::new(&map)), map: Some(map) })
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        self.map.as_deref().unwrap_or(&[])
    }
}

/// What kind of model the bytes are; `name` is the file's, for its extension and for messages.
pub(super) fn sniff(name: &str, bytes: &[u8]) -> Result<Format, ImportError> {
    if bytes.is_empty() {
        return Err(damaged(name, "the file is empty"));
    }
    let text = &bytes[..bytes.len().min(SNIFFED_BYTES)];
    let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text).trim_ascii_start();
    let extension = Path::new(name).extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if is_binary_stl(bytes) {
        return Ok(Format::Stl);
    }
    if let Some((_, what, remedy)) = OTHER_KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)) {
        return Err(refused(Refusal::Unsupported, name, *what, *remedy));
    }
    if bytes.starts_with(b"glTF") || text.starts_with(b"{") {
        return Ok(Format::Gltf);
    }
    if text.starts_with(b"ply") && text.get(3).is_none_or(u8::is_ascii_whitespace) {
        return Ok(Format::Ply);
    }
    if starts_with_word(text, b"solid") && extension.as_deref() != Some("obj") {
        return Ok(Format::Stl);
    }
    match extension.as_deref() {
        Some("obj") => Ok(Format::Obj),
        Some("ply") => Ok(Format::Ply),
        Some("stl") => Ok(Format::Stl),
        Some("gltf" | "glb") => Ok(Format::Gltf),
        _ if looks_like_obj(text) => Ok(Format::Obj),
        _ => {
            let remedy = "give a model as OBJ, PLY, STL, glTF or GLB";
            Err(refused(Refusal::Unsupported, name, "is no kind of model that can be read", remedy))
        }
    }
}

/// The size of a binary STL follows from its count; that says more than its first word, which is often "solid".
pub(super) fn is_binary_stl(bytes: &[u8]) -> bool {
    let count = bytes.get(80..84).map(|c| u32::from_le_bytes(c.try_into().expect("four bytes")));
    count.is_some_and(|count| count > 0 && bytes.len() as u64 == 84 + 50 * u64::from(count))
}

fn starts_with_word(text: &[u8], word: &[u8]) -> bool {
    text.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word))
        && text.get(word.len()).is_none_or(u8::is_ascii_whitespace)
}

fn looks_like_obj(text: &[u8]) -> bool {
    text.split(|&b| b == b'\n').take(200).any(|line| line.starts_with(b"v ") || line.starts_with(b"mtllib "))
}
