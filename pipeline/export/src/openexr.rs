//! Lightmaps and pictures as OpenEXR: the master copy, without loss.
//!
//! Layout: channels R, G, B (irradiance E (lux), linear Rec. 709) and A (coverage), row 0 at v = 0, ZIP-compressed
//! scan lines in increasing order. Where some texels' points lie inside or under other geometry, a fifth channel
//! [`BURIED`] (16 bit) is 1 at them and 0 elsewhere; readers of colours pass it over. Attributes: `software`,
//! `luxel:unit`, `luxel:key` (the hash of what went into the bake). There is no date, so the same light gives the same
//! bytes.
//!
//! Pictures of radiance have the same form, in cd/m², with A = 1 and without a key.

use std::io::{self, Seek, Write};

use exr::block::lines::LineRefMut;
use exr::image::write::samples::{SamplesWriter, WritableSamples};
use exr::math::RoundingMode;
use exr::meta::{attribute::LevelMode, header::Header};
use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, Image, Layer, LayerAttributes, LineOrder, SampleType, SmallVec,
    Text, WritableImage, f16,
};
use exr::{error::Error, image::Blocks, meta::attribute::AttributeValue};
use glam::Vec3;

use crate::{BoundMap, Effort, ExportError, Lightmap};

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

/// A page that is ready to become an EXR file. It borrows the page and copies lines of it while it is written, a few
/// blocks of 16 at a time.
pub struct Exr<'a>(Box<Image<Layer<AnyChannels<Plane<'a>>>>>);

impl<'a> Exr<'a> {
    /// A lightmap. `key` is the hash under which the bake is known, as hexadecimal digits.
    ///
    /// # Errors
    /// Values that `depth` cannot hold, and a key that is not plain text.
    pub fn lightmap(map: &'a Lightmap, depth: Depth, key: &str) -> Result<Self, ExportError> {
        let band = |c: usize| Values::Band(map.irradiance(), c);
        let mut channels = vec![("R", band(0)), ("G", band(1)), ("B", band(2)), ("A", Values::All(map.coverage()))];
        if !map.buried().is_empty() {
            channels.push((BURIED, Values::Marks(map.buried())));
        }
        Self::new([map.width(), map.height()], &channels, depth, "lux", Some(key))
    }

    /// A bound image: one channel Y (lux).
    ///
    /// # Errors
    /// As [`Exr::lightmap`].
    pub fn bound(map: &'a BoundMap, depth: Depth, key: &str) -> Result<Self, ExportError> {
        Self::new([map.width(), map.height()], &[("Y", Values::All(map.bound()))], depth, "lux", Some(key))
    }

    /// A picture of radiances (cd/m², linear Rec. 709), row-major from the top; A is 1. 32 bit, no key.
    ///
    /// # Errors
    /// Another number of pixels than `width × height`.
    pub fn picture(width: u32, height: u32, radiance: &'a [Vec3]) -> Result<Self, ExportError> {
        if u64::from(width) * u64::from(height) != radiance.len() as u64 {
            let fault = format!("{} pixels do not make {width} × {height}", radiance.len());
            return Err(ExportError::Image { what: "EXR".into(), fault });
        }
        let band = |c: usize| Values::Band(radiance, c);
        let channels = [("R", band(0)), ("G", band(1)), ("B", band(2)), ("A", Values::One)];
        Self::new([width, height], &channels, Depth::Float, "cd/m^2", None)
    }

    fn new(
        size: [u32; 2],
        channels: &[(&str, Values<'a>)],
        depth: Depth,
        unit: &str,
        key: Option<&str>,
    ) -> Result<Self, ExportError> {
        let [width, height] = size.map(|side| side as usize);
        let mut list = SmallVec::new();
        for &(name, values) in channels {
            let depth = values.depth(depth);
            if depth == Depth::Half {
                check_halves(name, values, width * height)?;
            }
            list.push(AnyChannel::new(name, Plane { values, width, depth }));
        }
        let mut attributes = LayerAttributes {
            software_name: Some(Text::from(concat!("luxel ", env!("CARGO_PKG_VERSION")))),
            ..LayerAttributes::default()
        };
        // The exr crate keeps custom attributes in hash maps, whose order changes from run to run. One attribute in
        // each of its two maps has only one order.
        attributes.other.insert(Text::from("luxel:unit"), AttributeValue::Text(Text::from(unit)));
        let encoding =
            Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
        let layer = Layer::new((width, height), attributes, encoding, AnyChannels::sort(list));
        let mut image = Image::from_layer(layer);
        if let Some(key) = key {
            let key = Text::new_or_none(key).ok_or_else(|| ExportError::encode("EXR", "the key is not plain text"))?;
            image.attributes.other.insert(Text::from("luxel:key"), AttributeValue::Text(key));
        }
        Ok(Self(Box::new(image)))
    }

    /// The same, with so much effort: what is to be written soon is not compressed.
    pub fn with(mut self, effort: Effort) -> Self {
        self.0.layer_data.encoding.compression = match effort {
            Effort::Small => Compression::ZIP16,
            Effort::Fast => Compression::Uncompressed,
        };
        self
    }

    /// Writes the file; `out` stands at its beginning, and seeks pay when it is buffered.
    ///
    /// # Errors
    /// Those of `out`; the encoder's own, of which none is known for an image that was made, as [`io::Error::other`].
    pub fn write(&self, out: &mut (impl Write + Seek)) -> io::Result<()> {
        let written = self.0.write().to_buffered(&mut *out);
        written.map_err(|error| match error {
            Error::Io(error) => error,
            other => io::Error::other(other),
        })?;
        out.flush()
    }
}

/// The values of one channel of a page, row-major.
#[derive(Clone, Copy)]
enum Values<'a> {
    Band(&'a [Vec3], usize),
    All(&'a [f32]),
    /// 1 where it is true, 0 elsewhere.
    Marks(&'a [bool]),
    One,
}

impl Values<'_> {
    /// How they are stored in a file of this depth. Marks lose nothing.
    fn depth(self, file: Depth) -> Depth {
        match self {
            Self::Marks(_) => Depth::Half,
            Self::Band(..) | Self::All(_) | Self::One => file,
        }
    }

    fn at(self, i: usize) -> f32 {
        match self {
            Self::Band(colours, band) => colours[i][band],
            Self::All(values) => values[i],
            Self::Marks(marks) => f32::from(marks[i]),
            Self::One => 1.0,
        }
    }
}

fn check_halves(name: &str, values: Values, count: usize) -> Result<(), ExportError> {
    match (0..count).map(|i| values.at(i)).find(|v| !f16::from_f32(*v).is_finite()) {
        Some(v) => {
            let fault = format!("channel {name} holds {v} lux, above the 65504 of half floats: use 32 bit");
            Err(ExportError::encode("EXR", fault))
        }
        None => Ok(()),
    }
}

/// A channel as the encoder asks for it, line by line.
#[derive(Clone, Copy)]
struct Plane<'a> {
    values: Values<'a>,
    width: usize,
    depth: Depth,
}

impl<'s> WritableSamples<'s> for Plane<'_> {
    type Writer = Self;

    fn sample_type(&self) -> SampleType {
        match self.depth {
            Depth::Float => SampleType::F32,
            Depth::Half => SampleType::F16,
        }
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&'s self, _: &Header) -> Self {
        *self
    }
}

impl SamplesWriter for Plane<'_> {
    fn extract_line(&self, line: LineRefMut) {
        let start = line.location.position.y() * self.width + line.location.position.x();
        let written = match (self.depth, self.values) {
            (Depth::Half, values) => line.write_samples(|i| f16::from_f32(values.at(start + i))),
            // What it is is asked once a line and not once a value.
            (Depth::Float, Values::Band(colours, 0)) => line.write_samples(|i| colours[start + i].x),
            (Depth::Float, Values::Band(colours, 1)) => line.write_samples(|i| colours[start + i].y),
            (Depth::Float, Values::All(all)) => line.write_samples(|i| all[start + i]),
            (Depth::Float, values) => line.write_samples(|i| values.at(start + i)),
        };
        written.expect("a line has room for its samples");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{read_first_flat_layer_from_file, read_first_rgba_layer_from_file};
    use std::io::Cursor;

    fn encode_exr(map: &Lightmap, depth: Depth, key: &str) -> Result<Vec<u8>, ExportError> {
        Ok(bytes(&Exr::lightmap(map, depth, key)?))
    }

    fn bytes(exr: &Exr) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        exr.write(&mut bytes).unwrap();
        bytes.into_inner()
    }

    /// Takes a number of bytes and fails then.
    struct Full(Cursor<Vec<u8>>, usize);

    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            if self.0.get_ref().len() > self.1 { Err(io::Error::other("disk full")) } else { Ok(()) }
        }
    }

    impl Seek for Full {
        fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    #[test]
    fn what_the_file_cannot_take_is_an_error_even_at_the_last_flush() {
        let map = map(1.0);
        let exr = Exr::lightmap(&map, Depth::Float, "k").unwrap();
        let length = bytes(&exr).len();
        exr.write(&mut Full(Cursor::default(), length)).unwrap();
        let error = exr.write(&mut Full(Cursor::default(), length - 1)).unwrap_err().to_string();
        assert!(error.contains("disk full"), "{error}");
        // A file that is too small fails in the middle, whatever the encoder still holds.
        let mut short = vec![0; length / 2];
        assert!(exr.write(&mut Cursor::new(&mut short[..])).is_err());
    }

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
        let map = map(1.0).with_buried([34, 3]).unwrap();
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
        assert!(Lightmap::new(1, 1, vec![Vec3::ONE], vec![1.0]).unwrap().with_buried([1]).is_err());
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
        let bytes = bytes(&Exr::bound(&bound, Depth::Float, "k").unwrap());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bound.exr");
        crate::write_atomic(&path, &bytes).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        assert_eq!(image.layer_data.channel_data.list.len(), 1);
        let read: Vec<f32> = image.layer_data.channel_data.list[0].sample_data.values_as_f32().collect();
        assert_eq!(read, [0.5, 2e5]);
    }
}
