//! The bytes of a glTF model: the binary chunk of a GLB, data URIs, and files beside the model. Never files elsewhere.

use super::super::Input;
use super::super::error::{ImportError, Refusal, damaged, refused};
use super::super::source::Source;
use super::super::textures::{named_image, shown, stays_inside};
use super::document::{Buffer, BufferView};
use crate::images::ImageContent;
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::cell::OnceCell;
use std::path::PathBuf;

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
    Mapped(PathBuf, Source),
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
            Bytes::Mapped(_, source) => source.bytes(),
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
            Some(path) => {
                self.input.has_companion(&path);
                Source::open(&path).map(|source| Bytes::Mapped(path, source))
            }
            None => {
                let what = format!("refers to the file \"{shown}\", which is not there");
                Err(refused(Refusal::Damaged, place, what, "copy it beside the model, or export a GLB"))
            }
        }
    }

    /// For messages.
    pub(super) fn model(&self) -> &str {
        self.input.name
    }

    /// Where an image is that a URI names.
    pub(super) fn image_of_uri(&self, uri: &str) -> ImageContent {
        if let Some(data) = uri.strip_prefix("data:") {
            let broken = || ImageContent::Missing("its data URI is broken; export the model again".into());
            return decode_data_uri(data).map_or_else(broken, |bytes| ImageContent::Bytes(bytes.into()));
        }
        if uri.contains("://") {
            let text = "is on another machine; fetch that file, put it beside the model and correct the URI";
            return ImageContent::Missing(format!("\"{}\" {text}", shown(uri)));
        }
        let folders: Vec<_> = self.input.base.into_iter().collect();
        let decoded = String::from_utf8_lossy(&percent_decode(uri.as_bytes())).into_owned();
        match named_image(self.input.name, &folders, &decoded).content {
            ImageContent::Missing(_) => named_image(self.input.name, &folders, uri).content,
            found => found,
        }
    }

    /// Where an image is that lies in a buffer.
    pub(super) fn image_of_view(&self, views: &[BufferView], index: usize) -> ImageContent {
        let missing = |what: String| ImageContent::Missing(format!("{what}; export the model again"));
        let Some(view) = views.get(index) else {
            return missing(format!("it is in buffer view {index}, but there are only {}", views.len()));
        };
        let buffer = match self.get(view.buffer) {
            Ok(buffer) => buffer,
            Err(error) => return ImageContent::Missing(error.to_string()),
        };
        let end = view.byte_offset.checked_add(view.byte_length).filter(|&end| end <= buffer.len() as u64);
        let Some(end) = end else {
            return missing(format!("buffer view {index} goes beyond the {} bytes of its buffer", buffer.len()));
        };
        let (begin, bytes) = (view.byte_offset, &buffer[view.byte_offset as usize..end as usize]);
        match (self.loaded[view.buffer].get(), self.input.path) {
            (Some(Bytes::Mapped(path, _)), _) => ImageContent::Part(path.clone(), begin..end),
            (Some(Bytes::Chunk(chunk)), Some(path)) => {
                let before = chunk.as_ptr() as u64 - self.input.bytes.as_ptr() as u64;
                ImageContent::Part(path.to_owned(), before + begin..before + end)
            }
            _ => ImageContent::Bytes(bytes.into()),
        }
    }

    fn find(&self, name: &str) -> Option<PathBuf> {
        let path = self.input.base?.join(name);
        path.is_file().then_some(path)
    }
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
}
