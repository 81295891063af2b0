//! A lightmap as a graphics card takes it: decoded here, because a browser needs many times as long for an .exr.
//!
//! All numbers are little-endian: width, height (u32), scale (f32), 0 (u32), then rows from v = 0 on of four half
//! floats a texel: R, G, B = E / scale with E in lux, and A = the share of the texel that its chart covers, negative
//! where the texel's point lies inside or under other geometry. The scale is 1 unless the light is beyond half floats.

use std::io::Cursor;

use exr::meta::MetaData;
use exr::prelude::{AnyChannel, FlatSamples, ReadChannels, ReadLayers, f16, read};
use luxel_export::openexr::BURIED;
use rayon::prelude::*;

/// No more texels are decoded: they fill 512 MiB, and more of a browser's memory.
const MAX_TEXELS: usize = 1 << 26;
/// A larger file holds more than that.
pub const MAX_BYTES: u64 = 24 * MAX_TEXELS as u64;
/// Four numbers and, for each texel, four half floats.
const HEADER: usize = 16;
const TEXEL: usize = 8;
/// The largest number that is laid on a half float (the largest of all is 65504).
const MAX_HALF: f32 = 60_000.0;

/// Why a lightmap is not decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It has more texels than are decoded.
    Large,
    /// It is no .exr, or not one that luxel writes.
    Broken,
}

/// The texels of an .exr that luxel wrote.
pub fn decode(exr: &[u8]) -> Result<Vec<u8>, Fault> {
    let meta = MetaData::read_from_buffered(Cursor::new(exr), false).map_err(|_| Fault::Broken)?;
    let area = |size: exr::math::Vec2<usize>| size.0.checked_mul(size.1).filter(|area| *area <= MAX_TEXELS);
    if !meta.headers.iter().all(|h| h.channels.list.len() <= 8 && area(h.layer_size).is_some()) {
        return Err(Fault::Large);
    }
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let layer = image.from_buffered(Cursor::new(exr)).map_err(|_| Fault::Broken)?.layer_data;
    let (width, height) = (layer.size.0, layer.size.1);
    let channel = |name: &str| {
        let found = layer.channel_data.list.iter().find(|c| c.name.eq(name));
        found.filter(|c| c.sample_data.len() == width * height)
    };
    let band = |name: &str| channel(name).ok_or(Fault::Broken);
    let light = [band("R")?, band("G")?, band("B")?];
    let (cover, buried) = (band("A")?, channel(BURIED));
    let scale = scale(light);
    let mut texels = vec![0; HEADER + TEXEL * width * height];
    let (header, rows) = texels.split_at_mut(HEADER);
    let numbers = [width as u32, height as u32, scale.to_bits(), 0].map(u32::to_le_bytes);
    header.copy_from_slice(numbers.as_flattened());
    rows.par_chunks_exact_mut(TEXEL * width.max(1)).enumerate().for_each(|(y, row)| {
        let of = |channel: &AnyChannel<FlatSamples>| values(channel, y * width, width);
        let [r, g, b] = light.map(of);
        let (a, buried) = (of(cover), buried.map(of));
        for (x, texel) in row.chunks_exact_mut(TEXEL).enumerate() {
            let is_buried = buried.as_ref().is_some_and(|buried| buried[x] > 0.5);
            let sign = if is_buried { -1.0 } else { 1.0 };
            let band = |e: f32| if e > 0.0 { (e / scale).min(MAX_HALF) } else { 0.0 };
            let values = [band(r[x]), band(g[x]), band(b[x]), sign * a[x].clamp(0.0, 1.0)];
            texel.copy_from_slice(values.map(|v| f16::from_f32(v).to_le_bytes()).as_flattened());
        }
    });
    Ok(texels)
}

/// What E must be divided by to be a half float.
fn scale(light: [&AnyChannel<FlatSamples>; 3]) -> f32 {
    let most = |channel: &AnyChannel<FlatSamples>| {
        let values = channel.sample_data.values_as_f32();
        values.filter(|v| v.is_finite()).fold(0.0, f32::max)
    };
    let max = light.into_iter().map(most).fold(0.0, f32::max);
    if max > MAX_HALF { max / MAX_HALF } else { 1.0 }
}

/// Some values of a channel.
fn values(channel: &AnyChannel<FlatSamples>, start: usize, count: usize) -> Vec<f32> {
    match &channel.sample_data {
        FlatSamples::F32(all) => all[start..start + count].to_vec(),
        FlatSamples::F16(all) => all[start..start + count].iter().map(|v| v.to_f32()).collect(),
        FlatSamples::U32(all) => all[start..start + count].iter().map(|v| *v as f32).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_export::{Depth, Lightmap, openexr::Exr};

    fn encoded(map: &Lightmap, depth: Depth) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        Exr::lightmap(map, depth, "k").unwrap().write(&mut bytes).unwrap();
        bytes.into_inner()
    }

    fn exr(e: Vec<Vec3>, coverage: Vec<f32>) -> Vec<u8> {
        encoded(&Lightmap::new(2, (e.len() / 2) as u32, e, coverage).unwrap(), Depth::Float)
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
        let texels = decode(&exr(e, vec![1.0, 0.5, 0.0, 0.25])).unwrap();
        let (width, height, scale, numbers) = read_back(&texels);
        assert_eq!((width, height, scale), (2, 2, 1.0));
        let expected =
            [[0.0, 0.5, 1024.0, 1.0], [1.0, 0.5, 1024.0, 0.5], [2.0, 0.5, 1024.0, 0.0], [3.0, 0.5, 1024.0, 0.25]];
        assert_eq!(numbers, expected.concat());
    }

    #[test]
    fn buried_texels_have_negative_coverage() {
        let map = Lightmap::new(2, 2, vec![Vec3::ONE; 4], vec![1.0, 0.5, 1.0, 0.0]).unwrap();
        let bytes = encoded(&map.with_buried([2, 1]).unwrap(), Depth::Half);
        let (_, _, _, numbers) = read_back(&decode(&bytes).unwrap());
        let cover: Vec<f32> = numbers.into_iter().skip(3).step_by(4).collect();
        assert_eq!(cover, [1.0, -0.5, -1.0, 0.0]);
    }

    #[test]
    fn light_beyond_half_floats_is_scaled() {
        for max in [1e5, 3e38] {
            let (_, _, scale, numbers) =
                read_back(&decode(&exr(vec![Vec3::splat(max), Vec3::splat(0.5 * max)], vec![1.0; 2])).unwrap());
            for (k, expected) in [(0, max), (4, 0.5 * max)] {
                let found = numbers[k] * scale;
                assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_picture_beyond_the_limit_is_told_from_a_broken_one() {
        let mut bytes = exr(vec![Vec3::ONE; 2], vec![1.0; 2]);
        // The data window, whose last two numbers are the largest x and y.
        let name = b"dataWindow\0box2i\0";
        let window = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
        bytes[window + 8..window + 16].copy_from_slice([16_383u32.to_le_bytes(); 2].as_flattened());
        assert_eq!(decode(&bytes), Err(Fault::Large));
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
            let _ = decode(&bytes);
        }
        assert_eq!(decode(b"no exr"), Err(Fault::Broken));
    }
}
