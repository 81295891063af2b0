//! Lightmaps as OpenEXR: the master copy, E in lux without loss.
//!
//! Layout: channels R, G, B (irradiance E (lux), linear Rec. 709) and A (coverage), row 0 at v = 0, ZIP-compressed
//! scan lines in increasing order. Where some texels' points lie inside or under other geometry, a fifth channel
//! `buried` (16 bit) is 1 at them and 0 elsewhere; readers of colours pass it over. Attributes: `software`, `luxel:unit`, `luxel:key` (the hash of what went into the
//! bake). There is no date, so the same light gives the same bytes.

use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, SmallVec,
    Text, WritableImage, f16,
};
use exr::{image::Blocks, meta::attribute::AttributeValue};

use crate::{BoundMap, ExportError, Lightmap};

/// Name of the channel that tells buried texels.
pub const BURIED: &str = "buried";

/// How the values of an EXR file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Depth {
    /// 32 bit: what luxel computes.
    #[default]
    Float,
    /// 16 bit: half the size, 11 bits of precision; values above 65504 lux are refused.
    Half,
}

/// The bytes of a lightmap as EXR. `key` is the hash under which the bake is known, as hexadecimal digits.
pub fn encode_exr(map: &Lightmap, depth: Depth, key: &str) -> Result<Vec<u8>, ExportError> {
    let band = |c: usize| map.irradiance().iter().map(|e| e[c]).collect::<Vec<f32>>();
    let named = [("R", band(0)), ("G", band(1)), ("B", band(2)), ("A", map.coverage().to_vec())];
    let mut channels = Vec::new();
    for (name, values) in named {
        channels.push(AnyChannel::new(name, samples(name, values, depth)?));
    }
    if !map.buried().is_empty() {
        let marks = map.buried().iter().map(|b| f16::from_f32(f32::from(*b))).collect();
        channels.push(AnyChannel::new(BURIED, FlatSamples::F16(marks)));
    }
    encode(map.width(), map.height(), channels, key)
}

/// The bytes of a bound image as EXR, one channel Y (lux).
pub fn encode_bound_exr(map: &BoundMap, depth: Depth, key: &str) -> Result<Vec<u8>, ExportError> {
    let channel = AnyChannel::new("Y", samples("Y", map.bound().to_vec(), depth)?);
    encode(map.width(), map.height(), vec![channel], key)
}

fn encode(width: u32, height: u32, channels: Vec<AnyChannel<FlatSamples>>, key: &str) -> Result<Vec<u8>, ExportError> {
    let list: SmallVec<_> = channels.into_iter().collect();
    let mut attributes = LayerAttributes {
        software_name: Some(Text::from(concat!("luxel ", env!("CARGO_PKG_VERSION")))),
        ..LayerAttributes::default()
    };
    // The exr crate keeps custom attributes in hash maps, whose order changes from run to run. One attribute in each
    // of its two maps has only one order.
    attributes.other.insert(Text::from("luxel:unit"), AttributeValue::Text(Text::from("lux")));
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let size = (width as usize, height as usize);
    let mut image = Image::from_layer(Layer::new(size, attributes, encoding, AnyChannels::sort(list)));
    let key = Text::new_or_none(key).ok_or_else(|| ExportError::encode("EXR", "the key is not plain text"))?;
    image.attributes.other.insert(Text::from("luxel:key"), AttributeValue::Text(key));
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).map_err(|e| ExportError::encode("EXR", e))?;
    Ok(bytes.into_inner())
}

fn samples(name: &str, values: Vec<f32>, depth: Depth) -> Result<FlatSamples, ExportError> {
    if depth == Depth::Float {
        return Ok(FlatSamples::F32(values));
    }
    if let Some(v) = values.iter().find(|v| !f16::from_f32(**v).is_finite()) {
        let fault = format!("channel {name} holds {v} lux, above the 65504 of half floats: use 32 bit");
        return Err(ExportError::encode("EXR", fault));
    }
    Ok(FlatSamples::F16(values.into_iter().map(f16::from_f32).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{read_first_flat_layer_from_file, read_first_rgba_layer_from_file};
    use glam::Vec3;

    fn map(scale: f32) -> Lightmap {
        let e = (0..35).map(|i| Vec3::new(i as f32, 0.1 * i as f32, 1e-12) * scale).collect();
        Lightmap::new(7, 5, e, (0..35).map(|i| i as f32 / 34.0).collect()).unwrap()
    }

    #[test]
    fn every_value_and_attribute_comes_back_bit_by_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.lightmap.exr");
        let map = map(3e4);
        std::fs::write(&path, encode_exr(&map, Depth::Float, "c0ffee").unwrap()).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        let layer = &image.layer_data;
        assert_eq!((layer.size.0, layer.size.1), (7, 5));
        let names: Vec<String> = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(names, ["A", "B", "G", "R"]);
        for (channel, c) in [(3, 0), (2, 1), (1, 2)] {
            let read: Vec<f32> = layer.channel_data.list[channel].sample_data.values_as_f32().collect();
            let written: Vec<f32> = map.irradiance().iter().map(|e| e[c]).collect();
            assert_eq!(read, written);
        }
        let alpha: Vec<f32> = layer.channel_data.list[0].sample_data.values_as_f32().collect();
        assert_eq!(alpha, map.coverage());
        let text = |v: Option<&AttributeValue>| match v {
            Some(AttributeValue::Text(t)) => t.to_string(),
            other => panic!("{other:?}"),
        };
        assert_eq!(text(layer.attributes.other.get(&Text::from("luxel:unit"))), "lux");
        assert_eq!(text(layer.attributes.other.get(&Text::from("luxel:key"))), "c0ffee");
        assert!(layer.attributes.software_name.as_ref().unwrap().to_string().starts_with("luxel "));
        assert!(layer.attributes.capture_date.is_none());
    }

    #[test]
    fn the_same_light_gives_the_same_bytes() {
        // Large enough for several compressed blocks, which the encoder spreads over threads.
        let e = (0..256 * 200).map(|i| Vec3::splat((i * 7919 % 1013) as f32)).collect();
        let map = Lightmap::new(256, 200, e, vec![1.0; 256 * 200]).unwrap();
        let first = encode_exr(&map, Depth::Float, "k").unwrap();
        for _ in 0..8 {
            assert_eq!(encode_exr(&map, Depth::Float, "k").unwrap(), first);
        }
    }

    #[test]
    fn buried_texels_have_a_channel_of_their_own_that_readers_of_colours_pass_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.lightmap.exr");
        let map = map(1.0).with_buried(&[34, 3]).unwrap();
        std::fs::write(&path, encode_exr(&map, Depth::Float, "k").unwrap()).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        let channels = &image.layer_data.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(names, ["A", "B", "G", "R", BURIED]);
        let marked: Vec<usize> =
            channels[4].sample_data.values_as_f32().enumerate().filter(|(_, v)| *v == 1.0).map(|(i, _)| i).collect();
        assert_eq!(marked, [3, 34]);
        let colours = read_first_rgba_layer_from_file(
            &path,
            |size, _| vec![0.0; size.area()],
            |reds: &mut Vec<f32>, at, (r, _, _, _): (f32, f32, f32, f32)| reds[at.y() * 7 + at.x()] = r,
        );
        let reds = colours.unwrap().layer_data.channel_data.pixels;
        assert_eq!(reds, map.irradiance().iter().map(|e| e.x).collect::<Vec<f32>>());
        assert!(Lightmap::new(1, 1, vec![Vec3::ONE], vec![1.0]).unwrap().with_buried(&[1]).is_err());
    }

    #[test]
    fn half_floats_keep_eleven_bits_and_refuse_what_they_cannot_hold() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("half.exr");
        let fine = map(1000.0);
        std::fs::write(&path, encode_exr(&fine, Depth::Half, "k").unwrap()).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        for (read, e) in image.layer_data.channel_data.list[3].sample_data.values_as_f32().zip(fine.irradiance()) {
            assert!((read - e.x).abs() <= e.x / 2048.0, "{read} {}", e.x);
        }
        let error = encode_exr(&map(1e4), Depth::Half, "k").unwrap_err().to_string();
        assert!(error.contains("65504"), "{error}");
    }

    #[test]
    fn a_bound_has_one_band() {
        let bound = BoundMap::new(2, 1, vec![0.5, 2e5]).unwrap();
        let bytes = encode_bound_exr(&bound, Depth::Float, "k").unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bound.exr");
        crate::write_atomic(&path, &bytes).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        assert_eq!(image.layer_data.channel_data.list.len(), 1);
        let read: Vec<f32> = image.layer_data.channel_data.list[0].sample_data.values_as_f32().collect();
        assert_eq!(read, [0.5, 2e5]);
    }
}
