//! Encoders and decoders against one another.

use super::*;
use proptest::prelude::*;

const QUALITIES: [Quality; 3] = [Quality::Fast, Quality::Normal, Quality::Best];

/// A picture with slopes, an edge and some noise.
fn picture(side: u32) -> Vec<[u8; 4]> {
    let grain = noise(side, side);
    (0..side * side)
        .map(|i| {
            let (x, y) = (i % side, i / side);
            let edge = if x * 3 + y > side * 2 { 90 } else { 0 };
            let n = u32::from(grain.bytes()[i as usize * 3] / 24);
            [x * 100 / side + edge + n, y * 100 / side + edge + n, 40 + edge + n, 255].map(|c| c as u8)
        })
        .collect()
}

/// Peak signal to noise ratio, dB, over the first `channels`.
fn psnr<const C: usize>(a: &[[u8; C]], b: &[[u8; C]], channels: usize) -> f64 {
    let square = |x: u8, y: u8| (f64::from(x) - f64::from(y)).powi(2);
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (0..channels).map(|k| square(a[k], b[k])).sum::<f64>()).sum();
    10.0 * (255.0f64.powi(2) / (sum / (a.len() * channels) as f64)).log10()
}

#[test]
fn colours_come_back_as_well_as_the_quality_promises() {
    let texels = Texels::Rgba8(picture(64));
    let floors = [41.0, 42.0, 42.0];
    let mut last = 0.0;
    for (quality, floor) in QUALITIES.into_iter().zip(floors) {
        let bytes = encode(&texels, 64, BlockFormat::Bc7, quality);
        assert_eq!(bytes, encode(&texels, 64, BlockFormat::Bc7, quality), "the same bytes again");
        let back = decode(BlockFormat::Bc7, &bytes, 64).unwrap();
        let found = psnr(rgba(&texels), rgba(&back), 3);
        assert!(found > floor && found >= last - 0.01, "{quality:?}: {found} dB");
        assert!(rgba(&back).iter().all(|t| t[3] >= 254), "opaque stays opaque");
        last = found;
    }
}

#[test]
fn holes_keep_their_alpha() {
    let mut texels = picture(32);
    texels.iter_mut().enumerate().for_each(|(i, t)| t[3] = if i / 32 % 8 < 3 { 0 } else { 255 });
    let texels = Texels::Rgba8(texels);
    for quality in QUALITIES {
        let back = decode(BlockFormat::Bc7, &encode(&texels, 32, BlockFormat::Bc7, quality), 32).unwrap();
        let wrong = rgba(&texels).iter().zip(rgba(&back)).filter(|(a, b)| (a[3] < 128) != (b[3] < 128)).count();
        assert_eq!(wrong, 0, "{quality:?}");
    }
}

#[test]
fn two_channels_come_back_well() {
    let texels: Vec<[u8; 2]> = picture(64).iter().map(|t| [t[0], t[1]]).collect();
    let bytes = encode(&Texels::Rg8(texels.clone()), 64, BlockFormat::Bc5, Quality::Normal);
    let Texels::Rg8(back) = decode(BlockFormat::Bc5, &bytes, 64).unwrap() else { panic!() };
    assert!(psnr(&texels, &back, 2) > 45.0, "{}", psnr(&texels, &back, 2));
}

#[test]
fn uncompressed_formats_lose_nothing() {
    let picture = picture(8);
    let all = [
        (Texels::Rgba8(picture.clone()), BlockFormat::Rgba8),
        (Texels::Rg8(picture.iter().map(|t| [t[0], t[1]]).collect()), BlockFormat::Rg8),
        (Texels::RgbaF16(picture.iter().map(|t| t.map(u16::from)).collect()), BlockFormat::RgbaF16),
    ];
    for (texels, format) in all {
        let bytes = encode(&texels, 8, format, Quality::Fast);
        assert_eq!(decode(format, &bytes, 8), Ok(texels));
    }
}

#[test]
fn all_mips_of_a_tile_are_at_most_a_third_more_than_the_finest() {
    let mut scene = Scene::with_image(128, Slot::BaseColor, noise(128, 128));
    scene.rectangle([0.0, 0.0, 127.0, 127.0], [0.0, 0.0, 1.0, 1.0], [255; 4]);
    let mips = scene.bake(MapKind::BaseColor);
    let encoded: usize = (0..mips.levels.len())
        .map(|m| encode(&mips.levels[m], mips.side(m), BlockFormat::Bc7, Quality::Fast).len())
        .sum();
    assert_eq!(mips.side(mips.levels.len() - 1), 4);
    assert!(encoded as f64 <= 1.34 * 128.0 * 128.0);
}

#[test]
fn bytes_of_another_length_are_refused() {
    let error = decode(BlockFormat::Bc7, &[0; 17], 4).unwrap_err();
    assert_eq!(error.to_string(), "17 bytes for 4 x 4 texels; 16 are needed");
    assert!(decode(BlockFormat::Rgba8, &[0; 4 * 25], 5).is_err());
}

proptest! {
    #[test]
    fn blocks_of_any_bytes_decode(bytes in prop::collection::vec(any::<u8>(), 64)) {
        for format in [BlockFormat::Bc7, BlockFormat::Bc5, BlockFormat::Bc6h] {
            prop_assert_eq!(decode(format, &bytes, 8).unwrap().len(), 64);
        }
    }
}
