//! A lightmap as a graphics card takes it: decoded here, because a browser needs many times as long for an .exr.
//!
//! All numbers are little-endian: width, height (u32), scale (f32), 0 (u32), then rows from v = 0 on of four half
//! floats a texel: R, G, B = E / scale with E in lux, and A = the share of the texel that its chart covers, negative
//! where the texel's point lies inside or under other geometry. The scale is 1 unless the light is beyond half floats.

use std::io::{Cursor, Read};

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, f16, read};
use luxel_export::openexr::BURIED;

/// No more texels are decoded.
const MAX_TEXELS: usize = 1 << 26;
/// A larger file holds more than that.
const MAX_BYTES: u64 = 24 * MAX_TEXELS as u64;
/// The largest number that is laid on a half float (the largest of all is 65504).
const MAX_HALF: f32 = 60_000.0;
/// The texels of an .exr that luxel wrote; what is wrong with it otherwise.
pub fn decode(file: impl Read) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    let meta = MetaData::read_from_buffered(Cursor::new(&bytes), false).map_err(|e| e.to_string())?;
    let area = |size: exr::math::Vec2<usize>| size.0.checked_mul(size.1).filter(|area| *area <= MAX_TEXELS);
    if !meta.headers.iter().all(|h| h.channels.list.len() <= 8 && area(h.layer_size).is_some()) {
        return Err("it is larger than any lightmap".into());
    }
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let layer = image.from_buffered(Cursor::new(&bytes)).map_err(|e| e.to_string())?.layer_data;
    drop(bytes);
    let (width, height) = (layer.size.0, layer.size.1);
    let channel = |name: &str| {
        let found = layer.channel_data.list.iter().find(|c| c.name.eq(name));
        found.map(|c| c.sample_data.values_as_f32().collect::<Vec<f32>>()).filter(|v| v.len() == width * height)
    };
    let band = |name: &str| channel(name).ok_or_else(|| format!("it has no channel {name}"));
    let [r, g, b, a] = [band("R")?, band("G")?, band("B")?, band("A")?];
    let buried = channel(BURIED);
    let max = r.iter().chain(&g).chain(&b).copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let scale = if max > MAX_HALF { max / MAX_HALF } else { 1.0 };
    let mut texels = Vec::with_capacity(16 + 8 * r.len());
    for number in [width as u32, height as u32, scale.to_bits(), 0] {
        texels.extend(number.to_le_bytes());
    }
    let light = |e: f32| if e > 0.0 { (e / scale).min(MAX_HALF) } else { 0.0 };
    for i in 0..r.len() {
        let is_buried = buried.as_ref().is_some_and(|buried| buried[i] > 0.5);
        let cover = if is_buried { -a[i].clamp(0.0, 1.0) } else { a[i].clamp(0.0, 1.0) };
        for value in [light(r[i]), light(g[i]), light(b[i]), cover] {
            texels.extend(f16::from_f32(value).to_le_bytes());
        }
    }
    Ok(texels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_export::{Depth, Lightmap, openexr::encode_exr};

    fn exr(e: Vec<Vec3>, coverage: Vec<f32>) -> Vec<u8> {
        let map = Lightmap::new(2, (e.len() / 2) as u32, e, coverage).unwrap();
        encode_exr(&map, Depth::Float, "k").unwrap()
    }

    /// Width, height, scale, and the numbers of all texels.
    fn read_back(bytes: &[u8]) -> (u32, u32, f32, Vec<f32>) {
        let word = |i: usize| <[u8; 4]>::try_from(&bytes[4 * i..4 * i + 4]).unwrap();
        let halves = bytes[16..].chunks_exact(2).map(|h| f16::from_le_bytes([h[0], h[1]]).to_f32());
        (u32::from_le_bytes(word(0)), u32::from_le_bytes(word(1)), f32::from_le_bytes(word(2)), halves.collect())
    }

    #[test]
    fn texels_come_back_in_their_order() {
        let e: Vec<Vec3> = (0..4).map(|i| Vec3::new(i as f32, 0.5, 1024.0)).collect();
        let texels = decode(&exr(e, vec![1.0, 0.5, 0.0, 0.25])[..]).unwrap();
        let (width, height, scale, numbers) = read_back(&texels);
        assert_eq!((width, height, scale), (2, 2, 1.0));
        let expected =
            [[0.0, 0.5, 1024.0, 1.0], [1.0, 0.5, 1024.0, 0.5], [2.0, 0.5, 1024.0, 0.0], [3.0, 0.5, 1024.0, 0.25]];
        assert_eq!(numbers, expected.concat());
    }

    #[test]
    fn buried_texels_have_negative_coverage() {
        let map = Lightmap::new(2, 2, vec![Vec3::ONE; 4], vec![1.0, 0.5, 1.0, 0.0]).unwrap();
        let bytes = encode_exr(&map.with_buried(&[2, 1]).unwrap(), Depth::Half, "k").unwrap();
        let (_, _, _, numbers) = read_back(&decode(&bytes[..]).unwrap());
        let cover: Vec<f32> = numbers.into_iter().skip(3).step_by(4).collect();
        assert_eq!(cover, [1.0, -0.5, -1.0, 0.0]);
    }

    #[test]
    fn light_beyond_half_floats_is_scaled() {
        for max in [1e5, 3e38] {
            let (_, _, scale, numbers) =
                read_back(&decode(&exr(vec![Vec3::splat(max), Vec3::splat(0.5 * max)], vec![1.0; 2])[..]).unwrap());
            for (k, expected) in [(0, max), (4, 0.5 * max)] {
                let found = numbers[k] * scale;
                assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
            }
        }
    }

    #[test]
    fn damage_is_an_error_and_no_panic() {
        let whole = exr(vec![Vec3::ONE; 2], vec![1.0; 2]);
        for cut in (0..whole.len()).step_by(3) {
            assert!(decode(&whole[..cut]).is_err(), "{cut}");
        }
        for i in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[i] ^= 0x5a;
            // Whether the change shows depends on where it is.
            let _ = decode(&bytes[..]);
        }
        assert!(decode(&b"no exr"[..]).is_err());
    }
}
