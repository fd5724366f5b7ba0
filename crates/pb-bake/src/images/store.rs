//! Room for decoded texels: memory for small images, a mapped file without a name for large ones, so that the
//! system may write them out and take their pages back at any time.

use super::{DecodeOptions, ImageError};
use crate::memory::Watched;
use memmap2::{Mmap, MmapMut};
use pb_mesh::texture::image::{Image, TexelBytes, TexelFormat};
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Images of fewer bytes stay in memory.
const SMALL_BYTES: u64 = 4 << 20;

/// Writable room for the texels of one image.
pub(super) enum Store {
    Memory(Vec<u8>),
    Mapped(MmapMut),
}

impl Store {
    /// Room for `bytes` bytes, all 0.
    pub(super) fn new(bytes: u64, options: &DecodeOptions) -> Result<Store, ImageError> {
        if bytes < SMALL_BYTES {
            return Ok(Store::Memory(vec![0; bytes as usize]));
        }
        let folder = options.temp_dir.display().to_string();
        let no_room = |source: io::Error| ImageError::NoRoom { bytes, folder: folder.clone(), source };
        map_new_file(&options.temp_dir, bytes).map(Store::Mapped).map_err(no_room)
    }

    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Store::Memory(bytes) => bytes,
            Store::Mapped(map) => map,
        }
    }

    /// The finished image, from the first `length` bytes. An alpha channel that says nothing is dropped.
    pub(super) fn into_image(
        mut self,
        width: u32,
        height: u32,
        format: TexelFormat,
        length: usize,
    ) -> Result<Image, ImageError> {
        let (format, length) = drop_opaque_alpha(&mut self.bytes_mut()[..length], format);
        let bytes: TexelBytes = match self {
            Store::Memory(mut bytes) => {
                bytes.truncate(length);
                bytes.shrink_to_fit();
                Arc::new(bytes)
            }
            Store::Mapped(map) => {
                let map = map.make_read_only().map_err(ImageError::Io)?;
                Arc::new(Texels { _watched: Watched::new(&map), map, length })
            }
        };
        Ok(Image::new(width, height, format, bytes))
    }
}

/// A new file of zeros in memory; it has no name and is gone when the map is.
#[allow(unsafe_code)]
fn map_new_file(folder: &Path, bytes: u64) -> io::Result<MmapMut> {
    let file = tempfile::tempfile_in(folder)?;
    reserve(&file, bytes)?;
    // SAFETY: the file was made for this mapping alone, has no name, and its descriptor is closed when this
    // function ends: nothing else can change or shorten it.
    unsafe { MmapMut::map_mut(&file) }
}

/// Sets the size of a new file; where the system can, its blocks too, so that a full disk is an error now and no
/// fault later.
fn reserve(file: &std::fs::File, bytes: u64) -> io::Result<()> {
    use std::io::Write;
    const BLOCK: usize = 1 << 20;
    let zeros = vec![0; BLOCK];
    let mut file = file;
    let mut left = bytes;
    while left > 0 {
        let step = left.min(BLOCK as u64) as usize;
        file.write_all(&zeros[..step])?;
        left -= step as u64;
    }
    file.flush()
}

/// The first bytes of a mapped file.
struct Texels {
    /// Lets the pages of the map go where memory is short; ends before the map.
    _watched: Watched,
    map: Mmap,
    length: usize,
}

impl AsRef<[u8]> for Texels {
    fn as_ref(&self) -> &[u8] {
        &self.map[..self.length]
    }
}

/// Packs texels without their alpha where it is 1 everywhere. Returns the format and the bytes that are left.
fn drop_opaque_alpha(bytes: &mut [u8], format: TexelFormat) -> (TexelFormat, usize) {
    let size = format.bytes();
    let half_one = half::f16::ONE.to_ne_bytes();
    let (without, opaque) = match format {
        TexelFormat::La8 => (TexelFormat::L8, bytes.chunks_exact(size).all(|t| t[1] == 255)),
        TexelFormat::Rgba8 => (TexelFormat::Rgb8, bytes.chunks_exact(size).all(|t| t[3] == 255)),
        TexelFormat::RgbaF16 => (TexelFormat::RgbF16, bytes.chunks_exact(size).all(|t| t[6..] == half_one)),
        _ => return (format, bytes.len()),
    };
    if !opaque {
        return (format, bytes.len());
    }
    let (count, kept) = (bytes.len() / size, without.bytes());
    for i in 0..count {
        bytes.copy_within(i * size..i * size + kept, i * kept);
    }
    (without, count * kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_images_lie_in_a_file_and_small_ones_in_memory() {
        let options = DecodeOptions::default();
        assert!(matches!(Store::new(SMALL_BYTES - 1, &options), Ok(Store::Memory(_))));
        let mut store = Store::new(SMALL_BYTES, &options).unwrap_or_else(|e| panic!("{e}"));
        assert!(matches!(store, Store::Mapped(_)));
        store.bytes_mut()[7] = 9;
        let image = store.into_image(1 << 10, 1 << 10, TexelFormat::Rgba8, 4 << 20).unwrap();
        assert_eq!((image.format(), image.bytes()[7]), (TexelFormat::Rgba8, 9));
    }

    #[test]
    fn alpha_that_is_one_everywhere_is_dropped_and_other_alpha_kept() {
        let image = |texels: &[[u8; 4]]| {
            let store = Store::Memory(texels.as_flattened().to_vec());
            store.into_image(texels.len() as u32, 1, TexelFormat::Rgba8, 4 * texels.len()).unwrap()
        };
        let opaque = image(&[[1, 2, 3, 255], [4, 5, 6, 255]]);
        assert_eq!((opaque.format(), opaque.bytes()), (TexelFormat::Rgb8, &[1u8, 2, 3, 4, 5, 6][..]));
        assert_eq!(image(&[[1, 2, 3, 255], [4, 5, 6, 254]]).format(), TexelFormat::Rgba8);
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error_with_a_remedy() {
        let options = DecodeOptions { temp_dir: "/no/such/folder".into(), ..DecodeOptions::default() };
        let message = Store::new(SMALL_BYTES, &options).err().unwrap().to_string();
        assert!(message.contains("/no/such/folder") && message.contains("--temp-dir"), "{message}");
    }
}
