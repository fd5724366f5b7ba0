//! The bytes of a glTF model: the binary chunk of a GLB, data URIs, and files beside the model. Never files elsewhere.

use super::super::Input;
use super::super::error::{ImportError, Refusal, damaged, refused};
use super::super::source::Source;
use super::document::Buffer;
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::cell::OnceCell;
use std::path::{Component, Path, PathBuf};

/// Writers disagree about padding and unused bits at the end.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// All buffers of a document, each read when it is first needed.
pub(super) struct Buffers<'a> {
    input: &'a Input<'a>,
    /// The binary chunk of a GLB.
    chunk: Option<&'a [u8]>,
    buffers: &'a [Buffer],
    loaded: Vec<OnceCell<Bytes<'a>>>,
}

enum Bytes<'a> {
    Chunk(&'a [u8]),
    Decoded(Vec<u8>),
    Mapped(Source),
}

impl<'a> Buffers<'a> {
    pub(super) fn new(input: &'a Input<'a>, chunk: Option<&'a [u8]>, buffers: &'a [Buffer]) -> Buffers<'a> {
        Buffers { input, chunk, buffers, loaded: buffers.iter().map(|_| OnceCell::new()).collect() }
    }

    /// The bytes of a buffer, exactly as many as the document says.
    pub(super) fn get(&self, index: usize) -> Result<&[u8], ImportError> {
        let place = || format!("{}: buffer {index}", self.input.name);
        let Some(buffer) = self.buffers.get(index) else {
            return Err(damaged(place(), format!("there are only {} buffers", self.buffers.len())));
        };
        let cell = &self.loaded[index];
        if cell.get().is_none() {
            let bytes = self.load(index, buffer)?;
            // The cell is empty: nothing else fills it.
            let _ = cell.set(bytes);
        }
        let bytes = match cell.get().expect("it was filled above") {
            Bytes::Chunk(bytes) => bytes,
            Bytes::Decoded(bytes) => bytes.as_slice(),
            Bytes::Mapped(source) => source.bytes(),
        };
        let length = usize::try_from(buffer.byte_length).unwrap_or(usize::MAX);
        bytes.get(..length).ok_or_else(|| {
            damaged(place(), format!("has {} bytes where the document promises {}", bytes.len(), buffer.byte_length))
        })
    }

    fn load(&self, index: usize, buffer: &Buffer) -> Result<Bytes<'a>, ImportError> {
        let place = format!("{}: buffer {index}", self.input.name);
        let Some(uri) = &buffer.uri else {
            let chunk = self.chunk.filter(|_| index == 0);
            return chunk.map(Bytes::Chunk).ok_or_else(|| damaged(place, "has no data: neither a URI nor a GLB chunk"));
        };
        if let Some(data) = uri.strip_prefix("data:") {
            return decode_data_uri(data).map(Bytes::Decoded).ok_or_else(|| damaged(place, "its data URI is broken"));
        }
        let shown: String = uri.chars().take(200).collect();
        if uri.contains("://") {
            let what = format!("refers to \"{shown}\" on another machine");
            return Err(refused(Refusal::Unsupported, place, what, "fetch that file and put it beside the model"));
        }
        let decoded = String::from_utf8_lossy(&percent_decode(uri.as_bytes())).replace('\\', "/");
        let candidates = [decoded.as_str(), uri.as_str()];
        if !candidates.iter().all(|name| stays_inside(name)) {
            let what = format!("refers to \"{shown}\", which is outside the folder of the model");
            let remedy = "put all files of the model into one folder and correct the URI";
            return Err(refused(Refusal::Unsupported, place, what, remedy));
        }
        match candidates.iter().find_map(|name| self.find(name)) {
            Some(path) => Source::open(&path).map(Bytes::Mapped),
            None => {
                let what = format!("refers to the file \"{shown}\", which is not there");
                Err(refused(Refusal::Damaged, place, what, "copy it beside the model, or export a GLB"))
            }
        }
    }

    fn find(&self, name: &str) -> Option<PathBuf> {
        let path = self.input.base?.join(name);
        path.is_file().then_some(path)
    }
}

/// Whether a relative path names something in or below the folder that it is relative to.
fn stays_inside(name: &str) -> bool {
    let is_windows_absolute = name.as_bytes().get(1) == Some(&b':');
    let components = Path::new(name).components();
    !is_windows_absolute && components.into_iter().all(|c| matches!(c, Component::Normal(_) | Component::CurDir))
}

/// What follows `data:`.
fn decode_data_uri(data: &str) -> Option<Vec<u8>> {
    let (kind, content) = data.split_once(',')?;
    let bytes = percent_decode(content.as_bytes());
    if kind.ends_with(";base64") { BASE64.decode(bytes.trim_ascii()).ok() } else { Some(bytes) }
}

/// Replaces `%41` by `A`; what is no such code stays.
fn percent_decode(text: &[u8]) -> Vec<u8> {
    let digit = |b: Option<&u8>| b.and_then(|&b| char::from(b).to_digit(16));
    let mut out = Vec::with_capacity(text.len());
    let mut i = 0;
    while i < text.len() {
        match (text[i], digit(text.get(i + 1)), digit(text.get(i + 2))) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                i += 3;
            }
            (byte, ..) => {
                out.push(byte);
                i += 1;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_decode_with_and_without_padding_and_percent_codes() {
        let decoded = |uri| decode_data_uri(uri).map(|b| String::from_utf8(b).unwrap());
        for uri in ["application/octet-stream;base64,QUJD", "a;base64,QUI=", "a;base64,QUI", "a;base64,QUI%3D", ",A%42"]
        {
            assert!(decoded(uri).unwrap().starts_with("AB"), "{uri}");
        }
        assert_eq!(decoded("a;base64"), None);
        assert_eq!(decoded("a;base64,Q*"), None);
    }

    #[test]
    fn paths_that_leave_the_folder_are_known() {
        for name in ["../a.bin", "a/../../b", "/etc/passwd", "C:/a.bin", "c:a"] {
            assert!(!stays_inside(name), "{name}");
        }
        for name in ["a.bin", "./a b.bin", "deep/er/a.bin", "a..bin"] {
            assert!(stays_inside(name), "{name}");
        }
    }
}
