//! One image, or all of a scene: what kind its bytes are, whether they fit, and what happens when they do not.

use super::{DecodeOptions, ImageContent, ImageError, ImageSource, MAX_IMAGE_SIDE, exr, placeholder, raster};
use crate::import::Source;
use crate::memory::in_files;
use image::ImageFormat;
use pb_mesh::texture::image::Image;
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};

/// Most images that are decoded at once.
const MAX_DECODERS: usize = 16;
/// Decoders' own buffers may take about so many bytes together; one image may exceed it alone.
const IN_FLIGHT_BYTES: u64 = 1 << 30;
/// What a decoder may hold of its own per texel, beyond the texels: the coefficients of a progressive JPEG.
const BYTES_PER_TEXEL_IN_FLIGHT: u64 = 6;

/// Kinds of content that are no image which can be read, by how they begin: what they are, and what to do.
const OTHER_KINDS: &[(&[u8], &str, &str)] = &[
    (b"version https://git-lfs", "is a Git LFS pointer, not the image itself", "run `git lfs pull`"),
    (b"\xABKTX", "is a KTX texture", "convert it to PNG, for example with `ktx extract`"),
    (b"DDS ", "is a DDS texture", "convert it to PNG"),
    (b"GIF8", "is a GIF image", "convert it to PNG"),
    (b"#?RADIANCE", "is a Radiance HDR image", "convert it to OpenEXR"),
    (b"8BPS", "is a Photoshop document", "save it as PNG"),
    (b"<svg", "is an SVG drawing", "render it to PNG"),
    (b"<!DOCTYPE", "is a web page", "fetch the image itself"),
    (b"<html", "is a web page", "fetch the image itself"),
];

/// All images of a scene.
#[derive(Debug, Default)]
pub struct Decoded {
    /// As many as there were sources, in their order; placeholders among them.
    pub images: Vec<Image>,
    /// Those that are placeholders, in order.
    pub faults: Vec<ImageFault>,
}

impl Decoded {
    /// Texels of all images together.
    pub fn texels(&self) -> u64 {
        self.images.iter().map(|i| u64::from(i.width()) * u64::from(i.height())).sum()
    }
}

/// An image that could not be had.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFault {
    /// Index of the image.
    pub image: usize,
    /// Which, why, and what to do.
    pub message: String,
}

/// Decodes one image. Texels of large ones lie in a temporary file, which has no name and vanishes with the image; so
/// does what the decoder holds meanwhile, in programs whose allocator is [`Memory`](super::Memory).
///
/// # Errors
/// See [`ImageError`].
pub fn decode(source: &ImageSource, options: &DecodeOptions) -> Result<Image, ImageError> {
    with_bytes(&source.content, |bytes| {
        let decode = || in_files(&options.temp_dir, || decode_bytes(bytes, options));
        let decoded = crate::guard::guarded(decode);
        decoded.unwrap_or_else(|| Err(ImageError::broken("its content is so damaged that the decoder gave up")))
    })
}

/// Decodes all images, several at once. A missing or broken one becomes a [`placeholder`] and a fault. Calls `progress`
/// with the share that is done, from any thread.
///
/// # Errors
/// [`ImageError::NoRoom`] for the first image that does not fit on the disk; and where all together are more than
/// [`DecodeOptions::max_bytes`].
pub fn decode_all(
    sources: &[ImageSource],
    options: &DecodeOptions,
    progress: &(dyn Fn(f32) + Sync),
) -> Result<Decoded, ImageError> {
    let results: Vec<OnceLock<Result<Image, ImageError>>> = sources.iter().map(|_| OnceLock::new()).collect();
    let (next, done, bytes) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicU64::new(0));
    let gate = Gate::default();
    let work = || {
        while bytes.load(Ordering::Relaxed) <= options.max_bytes {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(source) = sources.get(index) else { return };
            let bytes_in_flight = in_files(&options.temp_dir, || in_flight_bytes(source));
            let result = gate.pass(bytes_in_flight, || decode(source, options));
            let length = result.as_ref().map_or(0, |image| image.bytes().len() as u64);
            bytes.fetch_add(length, Ordering::Relaxed);
            // Each index is taken once, so the place is empty.
            let _ = results[index].set(result);
            progress((done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / sources.len() as f32);
        }
    };
    let threads = rayon::current_num_threads().min(MAX_DECODERS).min(sources.len());
    // Threads of their own: they wait at the gate, which those of the pool must not.
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    if bytes.into_inner() > options.max_bytes {
        return Err(ImageError::TooMuch { limit: options.max_bytes });
    }
    let mut all = Decoded::default();
    for (index, result) in results.into_iter().enumerate() {
        all.images.push(match result.into_inner().expect("all were taken, as the limit was not reached") {
            Ok(image) => image,
            Err(error @ ImageError::NoRoom { .. }) => return Err(error),
            Err(error) => {
                let message = format!("{}: {error}", sources[index].name);
                all.faults.push(ImageFault { image: index, message });
                placeholder()
            }
        });
    }
    Ok(all)
}

/// Refuses sizes that no image has, before anything is allocated for them.
pub(super) fn check_size(width: u64, height: u64, options: &DecodeOptions) -> Result<(), ImageError> {
    let texels = width.saturating_mul(height);
    let what = match (texels, width.max(height)) {
        (0, _) => format!("it says that it has {width} x {height} texels"),
        (_, side) if side > u64::from(MAX_IMAGE_SIDE) => {
            format!("it has {width} x {height} texels; a side may have {MAX_IMAGE_SIDE}")
        }
        _ if texels > options.max_texels => {
            format!("it has {width} x {height} texels, more than {} in all", options.max_texels)
        }
        _ => return Ok(()),
    };
    Err(ImageError::Refused { what, remedy: "scale it down, or cut it into several" })
}

/// Hands out the bytes of an image, mapped where they are a file's.
fn with_bytes<T>(content: &ImageContent, take: impl FnOnce(&[u8]) -> Result<T, ImageError>) -> Result<T, ImageError> {
    let open = |path: &Path| Source::open(path).map_err(|error| ImageError::Missing(error.to_string()));
    match content {
        ImageContent::File(path) => take(open(path)?.bytes()),
        ImageContent::Part(path, range) => {
            let source = open(path)?;
            let part = source.bytes().get(range.start as usize..range.end as usize);
            take(part.ok_or_else(|| ImageError::broken("the file has become shorter"))?)
        }
        ImageContent::Bytes(bytes) => take(bytes),
        ImageContent::Missing(reason) => Err(ImageError::Missing(reason.clone())),
    }
}

/// The kind of an image by its content.
enum Kind {
    Exr,
    Raster(ImageFormat),
}

fn kind(bytes: &[u8]) -> Result<Kind, ImageError> {
    if bytes.is_empty() {
        return Err(ImageError::broken("it is empty"));
    }
    if bytes.starts_with(exr::MAGIC) {
        return Ok(Kind::Exr);
    }
    let refused = |what: &str, remedy| Err(ImageError::Refused { what: what.to_owned(), remedy });
    if let Some((_, what, remedy)) = OTHER_KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)) {
        return refused(what, remedy);
    }
    match image::guess_format(bytes) {
        Ok(format) if format.reading_enabled() => Ok(Kind::Raster(format)),
        _ if is_tga(bytes) => Ok(Kind::Raster(ImageFormat::Tga)),
        _ => refused("is no kind of image that can be read", "save it as PNG, JPEG, TIFF, BMP, TGA, WebP or OpenEXR"),
    }
}

/// TGA has no word at its beginning; its header must make sense instead.
fn is_tga(bytes: &[u8]) -> bool {
    let Some(header) = bytes.get(..18) else { return false };
    let side = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
    header[1] <= 1
        && matches!(header[2], 1..=3 | 9..=11)
        && matches!(header[16], 8 | 15 | 16 | 24 | 32)
        && side(12) > 0
        && side(14) > 0
}

fn decode_bytes(bytes: &[u8], options: &DecodeOptions) -> Result<Image, ImageError> {
    match kind(bytes)? {
        Kind::Exr => exr::read(bytes, options),
        Kind::Raster(format) => raster::read(bytes, format, options),
    }
}

/// About what a decoder may need besides the texels; 0 where the image is broken.
fn in_flight_bytes(source: &ImageSource) -> u64 {
    let texels = with_bytes(&source.content, |bytes| match kind(bytes)? {
        // Block by block.
        Kind::Exr => Ok(0),
        Kind::Raster(format) => Ok(crate::guard::guarded(|| raster::texels(bytes, format)).unwrap_or(0)),
    });
    texels.unwrap_or(0).saturating_mul(BYTES_PER_TEXEL_IN_FLIGHT)
}

/// Lets so many in that what they hold stays below [`IN_FLIGHT_BYTES`]; one that is larger waits until it is alone.
#[derive(Default)]
struct Gate {
    held: Mutex<u64>,
    left: Condvar,
}

impl Gate {
    fn pass<T>(&self, bytes: u64, work: impl FnOnce() -> T) -> T {
        let lock = || self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let waits = |held: &mut u64| *held > 0 && held.saturating_add(bytes) > IN_FLIGHT_BYTES;
        *self.left.wait_while(lock(), waits).unwrap_or_else(PoisonError::into_inner) += bytes;
        let result = work();
        *lock() -= bytes;
        self.left.notify_all();
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_at_once_stays_below_the_bound() {
        let (gate, held, most) = (Gate::default(), AtomicU64::new(0), AtomicU64::new(0));
        let share = IN_FLIGHT_BYTES / 2;
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    gate.pass(share, || {
                        most.fetch_max(held.fetch_add(share, Ordering::SeqCst) + share, Ordering::SeqCst);
                        std::thread::sleep(std::time::Duration::from_millis(2));
                        held.fetch_sub(share, Ordering::SeqCst);
                    });
                });
            }
        });
        assert!(most.into_inner() <= IN_FLIGHT_BYTES);
        gate.pass(2 * IN_FLIGHT_BYTES, || ());
    }
}
