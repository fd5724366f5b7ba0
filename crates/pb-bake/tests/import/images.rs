//! Decoding: every format, every kind of texel, real OpenEXR files, and damaged images of public projects.

use super::{assert_says, shared};
use half::f16;
use image::{DynamicImage, ImageFormat};
use pb_bake::images::{DecodeOptions, ImageContent, ImageError, ImageSource, decode, decode_all, placeholder};
use pb_mesh::texture::image::{Image, TexelFormat};
use std::io::Cursor;
use std::path::{Path, PathBuf};

fn source(bytes: Vec<u8>) -> ImageSource {
    ImageSource { name: "test".into(), content: ImageContent::Bytes(bytes.into()) }
}

fn file(path: &Path) -> ImageSource {
    ImageSource { name: path.display().to_string(), content: ImageContent::File(path.to_owned()) }
}

fn decoded(bytes: Vec<u8>) -> Image {
    decode(&source(bytes), &DecodeOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn refusal(bytes: Vec<u8>) -> String {
    decode(&source(bytes), &DecodeOptions::default()).expect_err("it is broken").to_string()
}

fn written(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
    bytes
}

/// 5 x 3 texels, all different.
fn picture() -> DynamicImage {
    DynamicImage::ImageRgb8(image::RgbImage::from_fn(5, 3, |x, y| image::Rgb([40 * x as u8, 80 * y as u8, 7])))
}

fn picture_with_holes() -> DynamicImage {
    let mut image = picture().to_rgba8();
    image.put_pixel(2, 1, image::Rgba([9, 8, 7, 60]));
    DynamicImage::ImageRgba8(image)
}

#[test]
fn every_format_is_known_by_its_content() {
    use ImageFormat::{Bmp, Png, Tga, Tiff, WebP};
    for format in [Png, Tiff, Bmp, Tga, WebP] {
        let image = decoded(written(&picture(), format));
        assert_eq!((image.width(), image.height(), image.format()), (5, 3, TexelFormat::Rgb8), "{format:?}");
        assert_eq!(image.bytes(), picture().as_bytes(), "{format:?}");
    }
    let image = decoded(written(&picture(), ImageFormat::Jpeg));
    assert_eq!((image.width(), image.height(), image.format()), (5, 3, TexelFormat::Rgb8));
    for format in [Png, Tiff, Tga, WebP] {
        let image = decoded(written(&picture_with_holes(), format));
        assert_eq!(image.format(), TexelFormat::Rgba8, "{format:?}");
        assert_eq!(image.bytes()[4 * 7..4 * 8], [9, 8, 7, 60], "{format:?}");
    }
}

#[test]
fn alpha_that_is_one_everywhere_is_dropped() {
    let opaque = DynamicImage::ImageRgba8(picture().to_rgba8());
    assert_eq!(decoded(written(&opaque, ImageFormat::Png)).bytes(), picture().as_bytes());
}

#[test]
fn grey_stays_grey_and_sixteen_bits_become_eight() {
    let grey = DynamicImage::ImageLuma8(picture().to_luma8());
    assert_eq!(decoded(written(&grey, ImageFormat::Png)).bytes(), grey.as_bytes());
    let deep = image::ImageBuffer::from_fn(3, 1, |x, _| image::Luma([[0u16, 128 * 257, 65_535][x as usize]]));
    let image = decoded(written(&DynamicImage::ImageLuma16(deep), ImageFormat::Png));
    assert_eq!((image.format(), image.bytes()), (TexelFormat::L8, &[0u8, 128, 255][..]));
    let deep = DynamicImage::ImageRgba16(picture_with_holes().to_rgba16());
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        assert_eq!(decoded(written(&deep, format)).bytes(), picture_with_holes().as_bytes());
    }
}

#[test]
fn palettes_become_colours() {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(vec![255, 0, 0, 0, 255, 0]);
    encoder.set_trns(vec![255, 40]);
    encoder.write_header().unwrap().write_image_data(&[0, 1, 1, 0]).unwrap();
    let image = decoded(bytes);
    assert_eq!(image.format(), TexelFormat::Rgba8);
    assert_eq!(image.bytes()[..8], [255, 0, 0, 255, 0, 255, 0, 40]);
}

#[test]
fn floats_in_a_tiff_stay_bright() {
    let image = image::Rgb32FImage::from_fn(2, 1, |x, _| image::Rgb([7.5 * x as f32, 0.5, 1e9]));
    let image = decoded(written(&DynamicImage::ImageRgb32F(image), ImageFormat::Tiff));
    assert_eq!((image.format(), halves(&image)), (TexelFormat::RgbF16, vec![0.0, 0.5, 65_504.0, 7.5, 0.5, 65_504.0]));
}

fn halves(image: &Image) -> Vec<f32> {
    image.bytes().chunks_exact(2).map(|b| f16::from_ne_bytes([b[0], b[1]]).to_f32()).collect()
}

#[test]
fn sizes_are_refused_before_anything_is_allocated() {
    // A PNG of one texel whose header says 60,000 x 60,000, and one with a side beyond all bounds.
    for (width, height, what) in [(60_000u32, 60_000u32, "60000 x 60000"), (100_000, 1, ""), (0, 5, "")] {
        let mut bytes = Vec::new();
        {
            let encoder = png::Encoder::new(&mut bytes, 1, 1);
            encoder.write_header().unwrap().write_image_data(&[0]).unwrap();
        }
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        assert_says(&refusal(bytes), &[what, "; "]);
    }
    let small = DecodeOptions { max_texels: 14, ..DecodeOptions::default() };
    let error = decode(&source(written(&picture(), ImageFormat::Png)), &small).unwrap_err();
    assert_says(&error.to_string(), &["5 x 3 texels, more than 14", "scale it down"]);
    let few = DecodeOptions { max_bytes: 80, ..DecodeOptions::default() };
    let sources = vec![source(written(&picture(), ImageFormat::Png)); 3];
    assert!(matches!(decode_all(&sources, &few, &|_| {}), Err(ImageError::TooMuch { limit: 80 })));
}

/// Of a PNG chunk.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, &byte: &u8| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
    };
    !bytes.iter().fold(!0, step)
}

#[test]
fn what_is_no_image_is_named_with_a_remedy() {
    for (bytes, what) in [
        (&b"version https://git-lfs.github.com/spec/v1\n"[..], "git lfs pull"),
        (b"\xABKTX 20\xBB\r\n\x1A\n", "KTX"),
        (b"DDS \x7c\0\0\0", "DDS"),
        (b"<!DOCTYPE html>", "web page"),
        (b"hello", "no kind of image"),
        (b"", "empty"),
    ] {
        assert_says(&refusal(bytes.to_vec()), &[what, "; "]);
    }
}

#[test]
fn all_images_come_in_their_order_and_placeholders_for_those_that_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let mut container = vec![0xEE; 100];
    container.extend(written(&picture(), ImageFormat::Tga));
    std::fs::write(&path, written(&picture(), ImageFormat::Png)).unwrap();
    std::fs::write(folder.path().join("c"), &container).unwrap();
    let part = |range| ImageContent::Part(folder.path().join("c"), range);
    let contents = [
        ImageContent::File(path),
        ImageContent::Missing("it went away".into()),
        part(100..container.len() as u64),
        part(0..10_000),
        ImageContent::File(folder.path().join("no.png")),
    ];
    let sources: Vec<ImageSource> =
        contents.into_iter().enumerate().map(|(i, content)| ImageSource { name: format!("i{i}"), content }).collect();
    let all = decode_all(&sources, &DecodeOptions::default(), &|_| {}).unwrap();
    let widths: Vec<u32> = all.images.iter().map(Image::width).collect();
    assert_eq!((widths, all.texels()), (vec![5, 64, 5, 64, 64], 30 + 3 * 64 * 64));
    assert_eq!(all.faults.iter().map(|f| f.image).collect::<Vec<_>>(), [1, 3, 4]);
    assert_says(&all.faults[0].message, &["i1: it went away"]);
    assert_says(&all.faults[2].message, &["i4: ", "no.png", "check the name"]);
    assert_eq!(placeholder().bytes()[..3], [255, 0, 255]);
}

#[test]
fn a_cut_file_never_panics_and_a_cut_png_or_exr_is_no_picture() {
    let exr = {
        let mut bytes = Vec::new();
        let layer = exr::prelude::SpecificChannels::rgb(|p: exr::prelude::Vec2<usize>| (p.0 as f32, 0.5f32, 2.0f32));
        let image = exr::prelude::Image::from_channels((7, 5), layer);
        use exr::prelude::WritableImage;
        image.write().non_parallel().to_buffered(Cursor::new(&mut bytes)).unwrap();
        bytes
    };
    let jpeg = written(&picture(), ImageFormat::Jpeg);
    let mut all = vec![(exr, true), (jpeg, false)];
    for format in [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Bmp, ImageFormat::Tga, ImageFormat::WebP] {
        all.push((written(&picture(), format), format == ImageFormat::Png));
    }
    for (bytes, must_fail) in all {
        for length in 0..bytes.len() {
            let result = decode(&source(bytes[..length].to_vec()), &DecodeOptions::default());
            // The last chunk of a PNG holds nothing that is needed.
            assert!(!must_fail || result.is_err() || bytes.len() - length <= 16, "cut at {length} of {}", bytes.len());
            let mut changed = bytes.clone();
            changed[length] ^= 0xFF;
            let _ = decode(&source(changed), &DecodeOptions::default());
        }
    }
}

#[test]
fn exr_layers_windows_and_single_channels_are_understood() {
    use exr::prelude::*;
    let write = |image: &dyn Fn(&mut Cursor<&mut Vec<u8>>)| {
        let mut bytes = Vec::new();
        image(&mut Cursor::new(&mut bytes));
        decoded(bytes)
    };
    // A part whose window is the right half of a display window of 4 x 2.
    let image = write(&|out| {
        let channels = SpecificChannels::rgba(|p: Vec2<usize>| (p.0 as f32, p.1 as f32, 9.0f32, 0.5f32));
        let layer = Layer::new(
            (2, 2),
            LayerAttributes { layer_position: Vec2(12, 5), ..LayerAttributes::default() },
            Encoding::SMALL_LOSSLESS,
            channels,
        );
        let window = ImageAttributes::new(IntegerBounds::new((10, 5), (4, 2)));
        Image::new(window, layer).write().non_parallel().to_buffered(out).unwrap();
    });
    assert_eq!((image.width(), image.height(), image.format()), (4, 2, TexelFormat::RgbaF16));
    assert_eq!(halves(&image)[4..16], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 0.5, 1.0, 0.0, 9.0, 0.5]);
    // Two parts: the first without colour, the second with a layer of its own.
    let image = write(&|out| {
        let depth = AnyChannels::sort(vec![AnyChannel::new("Z", FlatSamples::F32(vec![5.0; 6]))].into());
        let plane = |name: &str, value: f32| AnyChannel::new(name, FlatSamples::F16(vec![f16::from_f32(value); 6]));
        let color = AnyChannels::sort(
            vec![plane("d.R", 3.0), plane("d.G", 0.25), plane("d.B", 0.75), plane("d.extra", 1.0)].into(),
        );
        let part = |name: &str, channels| {
            let attributes = LayerAttributes::named(name);
            Layer::new((3, 2), attributes, Encoding::FAST_LOSSLESS, channels)
        };
        let layers = vec![part("depth", depth), part("colour", color)];
        let attributes = ImageAttributes::new(IntegerBounds::from_dimensions((3, 2)));
        Image::from_layers(attributes, layers).write().non_parallel().to_buffered(out).unwrap();
    });
    assert_eq!(halves(&image)[..6], [3.0, 0.25, 0.75, 3.0, 0.25, 0.75]);
    // Luminance alone is grey.
    let image = write(&|out| {
        let y = AnyChannels::sort(vec![AnyChannel::new("Y", FlatSamples::F32(vec![2.0, f32::NAN]))].into());
        Image::from_channels((2, 1), y).write().non_parallel().to_buffered(out).unwrap();
    });
    assert_eq!(halves(&image), [2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
}

#[test]
fn real_exr_files_decode_in_all_compressions() {
    let Some(folder) = shared("fixtures") else { return };
    let read = |path: &Path| decode(&file(path), &DecodeOptions::default()).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    for depth in ["f16", "f32"] {
        let of = |name: &str| read(&folder.join("exr_compressions").join(depth).join(name));
        let plain = of("uncompressed.exr");
        assert!(plain.format().is_hdr() && plain.width() > 50);
        for name in ["rle", "zip", "zips", "piz", "pxr24"] {
            let other = of(&format!("{name}.exr"));
            let same =
                halves(&plain).iter().zip(halves(&other)).all(|(a, b)| (a - b).abs() <= 0.002 * a.abs().max(0.01));
            assert!(same, "{depth} {name}");
        }
        for name in ["b44", "b44a", "dwaa", "dwab"] {
            let other = of(&format!("{name}.exr"));
            let (a, b) = (halves(&plain), halves(&other));
            let differing = a.iter().zip(&b).filter(|(a, b)| (**a - **b).abs() > 0.1 * a.abs().max(0.1)).count();
            assert!(differing * 20 < a.len(), "{depth} {name}: {differing} of {}", a.len());
        }
    }
    for name in ["asakusa.exr", "crow_zip_half.exr"] {
        let image = read(&folder.join("exr_single").join(name));
        assert!(image.format().is_hdr() && halves(&image).iter().all(|x| x.is_finite()), "{name}: {image:?}");
    }
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if path.is_dir() { found.extend(files_below(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

#[test]
fn damaged_images_of_public_projects_decode_or_are_refused_with_a_remedy() {
    let mut broken = 0;
    for name in ["png_bad", "jpeg_bad", "exr_damaged", "utf8_damaged_textures"] {
        let Some(folder) = shared("bad-inputs").map(|f| f.join(name)) else { return };
        let files = files_below(&folder);
        assert!(files.len() >= 2, "{name}");
        let sources: Vec<ImageSource> = files.iter().map(|f| file(f)).collect();
        let all = decode_all(&sources, &DecodeOptions::default(), &|_| {}).unwrap();
        broken += all.faults.len();
        assert!(all.faults.iter().all(|f| f.message.contains("; ")));
        assert_eq!(all.images.len(), files.len());
    }
    assert!(broken > 50, "{broken}");
}
