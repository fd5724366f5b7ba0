//! OpenEXR by the crate `exr`, block by block: half, float and integer samples, several parts, layers and channels.
//!
//! Of several parts and layers the first with red, green and blue is taken; else one with luminance; else a part with
//! a single channel, as grey. Blocks are decompressed on the calling thread, where a panic can be caught.

use super::raster::finite_half;
use super::store::Store;
use super::{DecodeOptions, ImageError};
use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::f16;
use pb_mesh::texture::image::{Image, TexelFormat};
use std::io::Cursor;

/// How an OpenEXR file begins.
pub(super) const MAGIC: &[u8] = b"\x76\x2F\x31\x01";

/// The channels that make the texels of an image.
#[derive(Debug, PartialEq, Eq)]
struct Choice {
    /// Index of the part.
    part: usize,
    /// Per channel of the part: which samples of a texel it is, as begin and count; grey is three at once.
    targets: Vec<Option<(usize, usize)>>,
    has_alpha: bool,
}

/// Where the texels of a part lie in the image.
struct Frame {
    width: usize,
    height: usize,
    /// Of the part's first texel.
    offset: [i64; 2],
    samples: usize,
}

/// Decodes an OpenEXR image as half floats in linear light.
pub(super) fn read(bytes: &[u8], options: &DecodeOptions) -> Result<Image, ImageError> {
    let reader = exr::block::read(Cursor::new(bytes), false).map_err(ImageError::broken)?;
    let choice = choose(reader.headers())?;
    let header = &reader.headers()[choice.part];
    let frame = frame(header, &choice);
    super::decode::check_size(frame.width as u64, frame.height as u64, options)?;
    super::decode::check_size(header.layer_size.0 as u64, header.layer_size.1 as u64, options)?;
    let (format, length) = match choice.has_alpha {
        true => (TexelFormat::RgbaF16, frame.width * frame.height * 8),
        false => (TexelFormat::RgbF16, frame.width * frame.height * 6),
    };
    let mut store = Store::new(length as u64, options)?;
    let part = choice.part;
    let wanted = |_: &_, tile: exr::block::chunk::TileCoordinates, block: exr::block::BlockIndex| {
        block.layer == part && tile.is_largest_resolution_level()
    };
    let chunks = reader.filter_chunks(false, wanted).map_err(ImageError::broken)?;
    let texels = store.bytes_mut();
    let put = |meta: &exr::meta::MetaData, block: exr::block::UncompressedBlock| {
        let channels = &meta.headers[part].channels;
        for line in block.lines(channels) {
            if let Some(target) = choice.targets[line.location.channel] {
                put_line(&line, channels.list[line.location.channel].sample_type, target, &frame, texels)?;
            }
        }
        Ok(())
    };
    chunks.decompress_sequential(false, put).map_err(ImageError::broken)?;
    store.into_image(frame.width as u32, frame.height as u32, format, length)
}

/// The image is the display window, where it is sound; texels outside the part's window stay black.
fn frame(header: &Header, choice: &Choice) -> Frame {
    let samples = if choice.has_alpha { 4 } else { 3 };
    let window = header.shared_attributes.display_window;
    let at = header.own_attributes.layer_position;
    let offset = [i64::from(at.0) - i64::from(window.position.0), i64::from(at.1) - i64::from(window.position.1)];
    let overlaps = |k: usize, size: usize, part: usize| offset[k] < size as i64 && offset[k] + part as i64 > 0;
    let sound = overlaps(0, window.size.0, header.layer_size.0) && overlaps(1, window.size.1, header.layer_size.1);
    match sound {
        true => Frame { width: window.size.0, height: window.size.1, offset, samples },
        false => Frame { width: header.layer_size.0, height: header.layer_size.1, offset: [0; 2], samples },
    }
}

/// Writes one channel of a row.
fn put_line(
    line: &LineRef,
    kind: SampleType,
    (begin, count): (usize, usize),
    frame: &Frame,
    texels: &mut [u8],
) -> exr::error::UnitResult {
    let y = line.location.position.1 as i64 + frame.offset[1];
    if y < 0 || y >= frame.height as i64 {
        return Ok(());
    }
    let row_bytes = frame.width * frame.samples * 2;
    let row = &mut texels[y as usize * row_bytes..][..row_bytes];
    let first = line.location.position.0 as i64 + frame.offset[0];
    let mut put = |i: usize, value: f16| {
        let x = first + i as i64;
        if x >= 0 && x < frame.width as i64 {
            let at = (x as usize * frame.samples + begin) * 2;
            row[at..at + 2 * count].chunks_exact_mut(2).for_each(|s| s.copy_from_slice(&value.to_ne_bytes()));
        }
    };
    match kind {
        SampleType::F16 => {
            for (i, sample) in line.read_samples::<f16>().enumerate() {
                let sample = sample?;
                put(i, if sample.is_finite() { sample } else { finite_half(sample.to_f32()) });
            }
        }
        SampleType::F32 => {
            for (i, sample) in line.read_samples::<f32>().enumerate() {
                put(i, finite_half(sample?));
            }
        }
        SampleType::U32 => {
            for (i, sample) in line.read_samples::<u32>().enumerate() {
                put(i, finite_half(sample? as f32));
            }
        }
    }
    Ok(())
}

fn choose(headers: &[Header]) -> Result<Choice, ImageError> {
    let usable = |h: &Header| !h.deep && h.channels.list.iter().all(|c| c.sampling.0 == 1 && c.sampling.1 == 1);
    let parts = || headers.iter().enumerate().filter(|(_, h)| usable(h));
    let found = parts()
        .find_map(|(part, h)| choose_named(part, &names(h), &["r", "g", "b"], &["red", "green", "blue"]))
        .or_else(|| parts().find_map(|(part, h)| choose_named(part, &names(h), &["y"], &["l"])))
        .or_else(|| {
            let (part, _) = parts().find(|(_, h)| h.channels.list.len() == 1)?;
            Some(Choice { part, targets: vec![Some((0, 3))], has_alpha: false })
        });
    found.ok_or_else(|| {
        let what = "it has no part with the channels R, G and B, or Y, or a single one, all in full resolution";
        ImageError::Refused { what: what.into(), remedy: "save it as RGB, without deep or subsampled data" }
    })
}

/// Names of the channels of a part, in lower case.
fn names(header: &Header) -> Vec<String> {
    header.channels.list.iter().map(|c| c.name.to_string().to_ascii_lowercase()).collect()
}

/// The first layer (the part of a channel's name before its last dot) with all channels of one of two sets of names.
fn choose_named(part: usize, names: &[String], short: &[&str], long: &[&str]) -> Option<Choice> {
    let split =
        |name: &str| name.rsplit_once('.').map_or((String::new(), name.to_owned()), |(l, c)| (l.into(), c.into()));
    let split: Vec<(String, String)> = names.iter().map(|n| split(n)).collect();
    let layers = || std::iter::once("").chain(split.iter().map(|s| s.0.as_str()));
    let find = |layer: &str, channel: &str| split.iter().position(|s| s.0 == layer && s.1 == channel);
    for (layer, set) in layers().flat_map(|layer| [(layer, short), (layer, long)]) {
        let Some(found) = set.iter().map(|c| find(layer, c)).collect::<Option<Vec<usize>>>() else { continue };
        let mut targets = vec![None; names.len()];
        for (k, &channel) in found.iter().enumerate() {
            targets[channel] = Some(if found.len() == 1 { (0, 3) } else { (k, 1) });
        }
        let alpha = find(layer, "a").or_else(|| find(layer, "alpha"));
        if let Some(alpha) = alpha {
            targets[alpha] = Some((3, 1));
        }
        return Some(Choice { part, targets, has_alpha: alpha.is_some() });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(names: &[&str]) -> Option<Vec<Option<(usize, usize)>>> {
        let names: Vec<String> = names.iter().map(|n| n.to_string()).collect();
        choose_named(0, &names, &["r", "g", "b"], &["red", "green", "blue"]).map(|c| c.targets)
    }

    #[test]
    fn colour_is_found_in_any_order_and_in_the_first_layer_that_has_it() {
        assert_eq!(chosen(&["a", "b", "g", "r"]).unwrap(), [Some((3, 1)), Some((2, 1)), Some((1, 1)), Some((0, 1))]);
        assert_eq!(chosen(&["depth.z", "d.b", "d.g", "d.r"]).unwrap()[1..], [Some((2, 1)), Some((1, 1)), Some((0, 1))]);
        assert_eq!(chosen(&["red", "green", "blue"]).unwrap(), [Some((0, 1)), Some((1, 1)), Some((2, 1))]);
        assert_eq!(chosen(&["d.r", "s.g", "s.b"]), None);
    }
}
