//! EXT_meshopt_compression (and its KHR twin): bufferViews that hold encoded vertices or indices.
//!
//! The decoder itself is safe for any bytes; what it asserts about counts and strides is checked here first.

use meshopt::ffi;

use super::{
    fault::{Checked, Fault},
    json::{Object, number},
};

/// The names under which the extension is known.
pub const NAMES: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// No stream of the codecs shrinks its data more than this; a header that promises more lies.
const MAX_RATIO: usize = 2048;

/// Decodes the view that `extension` describes; `encoded` is the range of the buffer that it names.
pub fn decode(place: &str, extension: &Object, encoded: &[u8]) -> Checked<Vec<u8>> {
    let fault = |what: &str| Fault::new(place, format!("meshopt compression: {what}"));
    let text = |key: &str| extension.get(key).and_then(|v| v.as_str());
    let count = number(extension, "count").ok_or_else(|| fault("has no count"))?;
    let stride = number(extension, "byteStride").ok_or_else(|| fault("has no byteStride"))?;
    let size = count.checked_mul(stride).filter(|s| *s <= encoded.len().saturating_mul(MAX_RATIO));
    let size = size.ok_or_else(|| fault("promises more than its bytes can hold"))?;
    let mode = text("mode").ok_or_else(|| fault("has no mode"))?;
    let filter = text("filter").unwrap_or("NONE");
    let valid = match mode {
        "ATTRIBUTES" => stride % 4 == 0 && (4..=256).contains(&stride),
        "TRIANGLES" => count % 3 == 0 && (stride == 2 || stride == 4) && filter == "NONE",
        "INDICES" => (stride == 2 || stride == 4) && filter == "NONE",
        _ => return Err(fault("has an unknown mode")),
    };
    let valid = valid
        && match filter {
            "NONE" => true,
            "OCTAHEDRAL" | "COLOR" => stride == 4 || stride == 8,
            "QUATERNION" => stride == 8,
            "EXPONENTIAL" => stride % 4 == 0,
            _ => return Err(fault("has an unknown filter")),
        };
    if !valid {
        return Err(fault("its count and byteStride do not fit its mode and filter"));
    }
    // Words, so that the filters meet aligned components.
    let mut words = vec![0u32; size.div_ceil(4)];
    if count > 0 {
        let code = decode_into(mode, &mut words, count, stride, encoded);
        if code != 0 {
            return Err(fault("the data is damaged"));
        }
        apply(filter, &mut words, count, stride);
    }
    let mut bytes = bytemuck::cast_slice::<u32, u8>(&words).to_vec();
    bytes.truncate(size);
    Ok(bytes)
}

fn decode_into(mode: &str, words: &mut [u32], count: usize, stride: usize, encoded: &[u8]) -> i32 {
    assert!(size_of_val(words) >= count * stride);
    let (to, from, len) = (words.as_mut_ptr().cast(), encoded.as_ptr(), encoded.len());
    // SAFETY: `to` has room for count × stride bytes (asserted above), `from` for `len`; the caller has checked what
    // the decoders require of count and stride.
    unsafe {
        match mode {
            "ATTRIBUTES" => ffi::meshopt_decodeVertexBuffer(to, count, stride, from, len),
            "TRIANGLES" => ffi::meshopt_decodeIndexBuffer(to, count, stride, from, len),
            _ => ffi::meshopt_decodeIndexSequence(to, count, stride, from, len),
        }
    }
}

fn apply(filter: &str, words: &mut [u32], count: usize, stride: usize) {
    assert!(size_of_val(words) >= count * stride);
    let data = words.as_mut_ptr().cast();
    // SAFETY: `data` holds count × stride bytes (asserted above); the caller has checked what the filters require of
    // the stride.
    unsafe {
        match filter {
            "OCTAHEDRAL" => ffi::meshopt_decodeFilterOct(data, count, stride),
            "QUATERNION" => ffi::meshopt_decodeFilterQuat(data, count, stride),
            "EXPONENTIAL" => ffi::meshopt_decodeFilterExp(data, count, stride),
            "COLOR" => ffi::meshopt_decodeFilterColor(data, count, stride),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn extension(value: serde_json::Value) -> Object {
        value.as_object().unwrap().clone()
    }

    #[test]
    fn vertices_and_indices_come_back() {
        let vertices: Vec<[u8; 12]> = (0..500u32).map(|i| std::array::from_fn(|k| (i * 7 + k as u32) as u8)).collect();
        let encoded = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let e = extension(json!({"mode": "ATTRIBUTES", "count": 500, "byteStride": 12}));
        assert_eq!(decode("v", &e, &encoded).ok().unwrap(), bytemuck::cast_slice::<_, u8>(&vertices));
        let indices: Vec<u32> = (0..300).map(|i| i % 100).collect();
        let encoded = meshopt::encode_index_sequence(&indices, 100).unwrap();
        let e = extension(json!({"mode": "INDICES", "count": 300, "byteStride": 2}));
        let short: Vec<u16> = indices.iter().map(|i| *i as u16).collect();
        assert_eq!(decode("v", &e, &encoded).ok().unwrap(), bytemuck::cast_slice::<_, u8>(&short));
    }

    #[test]
    fn lies_are_refused_before_anything_is_allocated() {
        for value in [
            json!({"mode": "ATTRIBUTES", "count": 1u64 << 40, "byteStride": 12}),
            json!({"mode": "ATTRIBUTES", "count": u64::MAX, "byteStride": 12}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 13}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 0}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 260}),
            json!({"mode": "TRIANGLES", "count": 4, "byteStride": 2}),
            json!({"mode": "INDICES", "count": 3, "byteStride": 3}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 12, "filter": "QUATERNION"}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 12, "filter": "SECRET"}),
            json!({"mode": "SECRET", "count": 4, "byteStride": 12}),
            json!({"mode": "ATTRIBUTES", "count": 4, "byteStride": 12}),
            json!({}),
        ] {
            assert!(decode("v", &extension(value.clone()), &[0xa0; 40]).is_err(), "{value}");
        }
    }
}
