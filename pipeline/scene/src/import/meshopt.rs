//! EXT_meshopt_compression (and its KHR successor): buffer views whose bytes are decoded by meshoptimizer.
//!
//! The C decoder is made for untrusted data but asserts on its arguments, so mode, stride, count and filter are
//! checked against the extension's table before it is called.

use serde_json::Value;

use super::error::{Checked, Fault};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// A compressed buffer view's description, checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compression {
    pub buffer: usize,
    pub offset: u64,
    pub length: u64,
    pub stride: usize,
    pub count: u64,
    pub mode: Mode,
    pub filter: Filter,
}

impl Compression {
    /// Reads the extension's object of a buffer view.
    pub fn read(object: &Value, place: &str) -> Checked<Self> {
        let wrong = |what: String| Fault::invalid(place, format!("its meshopt compression {what}"));
        let number =
            |key: &str| object.get(key).and_then(Value::as_u64).ok_or_else(|| wrong(format!("has no proper {key}")));
        let text = |key: &str| object.get(key).and_then(Value::as_str);
        let mode = match text("mode") {
            Some("ATTRIBUTES") => Mode::Attributes,
            Some("TRIANGLES") => Mode::Triangles,
            Some("INDICES") => Mode::Indices,
            other => return Err(wrong(format!("has the unknown mode {other:?}"))),
        };
        let filter = match text("filter") {
            None | Some("NONE") => Filter::None,
            Some("OCTAHEDRAL") => Filter::Octahedral,
            Some("QUATERNION") => Filter::Quaternion,
            Some("EXPONENTIAL") => Filter::Exponential,
            Some("COLOR") => Filter::Color,
            other => return Err(wrong(format!("has the unknown filter {other:?}"))),
        };
        let out = Self {
            buffer: usize::try_from(number("buffer")?).unwrap_or(usize::MAX),
            offset: if object.get("byteOffset").is_some() { number("byteOffset")? } else { 0 },
            length: number("byteLength")?,
            stride: usize::try_from(number("byteStride")?).unwrap_or(usize::MAX),
            count: number("count")?,
            mode,
            filter,
        };
        out.check().map_err(wrong)?;
        Ok(out)
    }

    /// The extension's table of what goes together.
    fn check(&self) -> Result<(), String> {
        let stride = self.stride;
        let strides = match self.mode {
            Mode::Attributes => stride.is_multiple_of(4) && (4..=256).contains(&stride),
            Mode::Triangles | Mode::Indices => stride == 2 || stride == 4,
        };
        if !strides {
            return Err(format!("cannot have a stride of {stride}"));
        }
        if self.mode == Mode::Triangles && !self.count.is_multiple_of(3) {
            return Err(format!("has {} indices, which are no whole triangles", self.count));
        }
        let filters = match self.filter {
            Filter::None => true,
            _ if self.mode != Mode::Attributes => false,
            Filter::Octahedral | Filter::Color => stride == 4 || stride == 8,
            Filter::Quaternion => stride == 8,
            Filter::Exponential => true,
        };
        if !filters {
            return Err(format!("cannot have the filter {:?} at a stride of {stride}", self.filter));
        }
        Ok(())
    }

    /// Bytes after decoding.
    pub fn decoded_bytes(&self) -> Option<u64> {
        self.count.checked_mul(self.stride as u64)
    }

    /// Decodes `count × stride` bytes. They come as words because that is what the filters work on; the first
    /// `count × stride` bytes of their memory are the view.
    pub fn decode(&self, encoded: &[u8], place: &str) -> Checked<Vec<u32>> {
        let broken = |code: i32| Fault::invalid(place, format!("its meshopt data is damaged (code {code})"));
        let bytes = self.decoded_bytes().and_then(|n| usize::try_from(n).ok()).ok_or_else(|| broken(0))?;
        let count = bytes / self.stride;
        let mut words = vec![0u32; bytes.div_ceil(4)];
        let target = words.as_mut_ptr().cast();
        let (source, length) = (encoded.as_ptr(), encoded.len());
        // SAFETY: `target` points to at least count × stride writable bytes, `source` to `length` readable ones, and
        // both outlive the call; strides and counts satisfy the decoders' assertions (see `check`).
        let code = unsafe {
            match self.mode {
                Mode::Attributes => {
                    meshopt::ffi::meshopt_decodeVertexBuffer(target, count, self.stride, source, length)
                }
                Mode::Triangles => meshopt::ffi::meshopt_decodeIndexBuffer(target, count, self.stride, source, length),
                Mode::Indices => meshopt::ffi::meshopt_decodeIndexSequence(target, count, self.stride, source, length),
            }
        };
        if code != 0 {
            return Err(broken(code));
        }
        self.apply_filter(&mut words);
        Ok(words)
    }

    fn apply_filter(&self, words: &mut [u32]) {
        match (self.filter, self.stride) {
            (Filter::None, _) => {}
            (Filter::Octahedral, 4) => meshopt::encoding::decode_filter_oct::<i8>(bytemuck::cast_slice_mut(words)),
            (Filter::Octahedral, _) => meshopt::encoding::decode_filter_oct::<i16>(bytemuck::cast_slice_mut(words)),
            (Filter::Color, 4) => meshopt::encoding::decode_filter_color::<u8>(bytemuck::cast_slice_mut(words)),
            (Filter::Color, _) => meshopt::encoding::decode_filter_color::<u16>(bytemuck::cast_slice_mut(words)),
            (Filter::Quaternion, _) => meshopt::encoding::decode_filter_quat(bytemuck::cast_slice_mut(words)),
            (Filter::Exponential, _) => {
                meshopt::encoding::decode_filter_exp::<1>(bytemuck::cast_slice_mut(words));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn describe(mode: &str, filter: &str, stride: usize, count: usize, length: usize) -> Checked<Compression> {
        let object = json!({"buffer": 0, "byteLength": length, "byteStride": stride, "count": count,
                            "mode": mode, "filter": filter});
        Compression::read(&object, "bufferView 0")
    }

    #[test]
    fn attributes_and_indices_come_back() {
        let vertices: Vec<[u32; 3]> = (0..1000u32).map(|i| [i, i * i, 7]).collect();
        let encoded = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let view = describe("ATTRIBUTES", "NONE", 12, 1000, encoded.len()).unwrap();
        assert_eq!(view.decode(&encoded, "").unwrap(), bytemuck::cast_slice::<_, u32>(&vertices));

        let indices: Vec<u32> = (0..300).map(|i| i / 2).collect();
        let encoded = meshopt::encode_index_sequence(&indices, 150).unwrap();
        let view = describe("INDICES", "NONE", 4, 300, encoded.len()).unwrap();
        assert_eq!(view.decode(&encoded, "").unwrap(), indices);
        let narrow = describe("INDICES", "NONE", 2, 300, encoded.len()).unwrap().decode(&encoded, "").unwrap();
        let narrow: &[u16] = bytemuck::cast_slice(&narrow);
        assert!(narrow.iter().zip(&indices).all(|(a, b)| u32::from(*a) == *b));

        let encoded = meshopt::encode_index_buffer(&indices, 150).unwrap();
        let view = describe("TRIANGLES", "NONE", 4, 300, encoded.len()).unwrap();
        assert_eq!(view.decode(&encoded, "").unwrap().len(), 300);
    }

    #[test]
    fn filters_are_undone() {
        let normals = [[0.0, 0.0, 1.0, 0.0], [0.6, -0.8, 0.0, 0.0], [-0.48, 0.6, 0.64, 0.0]];
        let packed: Vec<[i16; 4]> = meshopt::encoding::encode_filter_oct(&normals, 12);
        let encoded = meshopt::encode_vertex_buffer(&packed).unwrap();
        let view = describe("ATTRIBUTES", "OCTAHEDRAL", 8, 3, encoded.len()).unwrap();
        let words = view.decode(&encoded, "").unwrap();
        let decoded: &[[i16; 4]] = bytemuck::cast_slice(&words);
        for (d, n) in decoded.iter().zip(&normals) {
            for k in 0..3 {
                assert!((f32::from(d[k]) / 32767.0 - n[k]).abs() < 2e-3);
            }
        }
        let data = [[1.5f32], [-0.001], [1e6]];
        let packed = meshopt::encoding::encode_filter_exp(&data, 20, meshopt::encoding::EncodeExpMode::Separate);
        let encoded = meshopt::encode_vertex_buffer(&packed).unwrap();
        let view = describe("ATTRIBUTES", "EXPONENTIAL", 4, 3, encoded.len()).unwrap();
        for (word, [f]) in view.decode(&encoded, "").unwrap().iter().zip(data) {
            assert!((f32::from_bits(*word) - f).abs() <= 1e-5 * f.abs());
        }
    }

    #[test]
    fn impossible_combinations_never_reach_the_decoder() {
        for (mode, filter, stride, count) in [
            ("ATTRIBUTES", "NONE", 0, 3),
            ("ATTRIBUTES", "NONE", 6, 3),
            ("ATTRIBUTES", "NONE", 260, 3),
            ("ATTRIBUTES", "OCTAHEDRAL", 12, 3),
            ("ATTRIBUTES", "QUATERNION", 4, 3),
            ("TRIANGLES", "NONE", 4, 4),
            ("TRIANGLES", "NONE", 1, 3),
            ("INDICES", "EXPONENTIAL", 4, 3),
            ("MESHLETS", "NONE", 4, 3),
            ("ATTRIBUTES", "SEPIA", 4, 3),
        ] {
            assert!(describe(mode, filter, stride, count, 100).is_err(), "{mode} {filter} {stride} {count}");
        }
    }

    #[test]
    fn damaged_data_is_an_error() {
        let vertices: Vec<[u32; 2]> = (0..100u32).map(|i| [i, !i]).collect();
        let encoded = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let view = describe("ATTRIBUTES", "NONE", 8, 100, encoded.len()).unwrap();
        for n in 0..encoded.len() {
            assert!(view.decode(&encoded[..n], "").is_err(), "{n}");
        }
    }
}
