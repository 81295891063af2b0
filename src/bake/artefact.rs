//! Artefacts as bytes: a small head of facts in bincode, then plain little-endian arrays behind their lengths.
//!
//! The store proves that the bytes are those that were written under a key; what they say is looked at all the same,
//! and nothing is allocated for more than the input is long.

use std::io::{self, Read, Write};

use bincode::error::EncodeError;
use bincode::serde::{decode_from_std_read, encode_into_std_write};
use bytemuck::{NoUninit, Pod};
use luxel_transport::Rgb;
use serde::{Serialize, de::DeserializeOwned};

use crate::store::Reader;

/// Most bytes that a head may take. A few hundred are usual.
const LARGEST: usize = 1 << 16;

/// Items that are read at a time.
const BLOCK: usize = 1 << 12;

/// Writes a structure: facts ahead of arrays, or a whole body.
pub fn put_value(out: &mut impl Write, head: &impl Serialize) -> io::Result<()> {
    match encode_into_std_write(head, out, bincode::config::standard()) {
        Ok(_) => Ok(()),
        Err(EncodeError::Io { inner, .. }) => Err(inner),
        Err(error) => Err(io::Error::other(error)),
    }
}

/// Reads facts, and nothing of what follows them.
pub fn head<T: DeserializeOwned>(input: &mut impl Read) -> Result<T, String> {
    decode_from_std_read(input, bincode::config::standard().with_limit::<LARGEST>()).map_err(|e| e.to_string())
}

/// Reads a structure of any size that fills the rest of the input.
pub fn body<T: DeserializeOwned>(input: &mut Reader) -> Result<T, String> {
    // In memory as bytes first, so that lengths in it can be compared with what is there.
    let mut bytes = Vec::new();
    input.read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    let (decoded, used) =
        bincode::serde::decode_from_slice(&bytes, bincode::config::standard()).map_err(|e| e.to_string())?;
    if used == bytes.len() { Ok(decoded) } else { Err(format!("{} bytes follow it", bytes.len() - used)) }
}

/// Writes an array.
pub fn put_slice<T: NoUninit>(out: &mut impl Write, items: &[T]) -> io::Result<()> {
    out.write_all(&(items.len() as u64).to_le_bytes())?;
    out.write_all(bytemuck::cast_slice(items))
}

/// Reads an array.
pub fn slice<T: Pod>(input: &mut Reader) -> Result<Vec<T>, String> {
    let mut length = [0; 8];
    input.read_exact(&mut length).map_err(|e| e.to_string())?;
    let length = u64::from_le_bytes(length);
    if length > input.left() / size_of::<T>() as u64 {
        return Err(format!("{length} items are more than the file holds"));
    }
    let length = length as usize;
    let mut items = Vec::with_capacity(length);
    while items.len() < length {
        let start = items.len();
        items.resize(length.min(start + BLOCK), T::zeroed());
        input.read_exact(bytemuck::cast_slice_mut(&mut items[start..])).map_err(|e| e.to_string())?;
    }
    Ok(items)
}

/// Reads irradiances [lux]: so many, none of them negative or not finite.
pub fn light(input: &mut Reader, count: usize) -> Result<Vec<Rgb>, String> {
    let items: Vec<Rgb> = slice(input)?;
    let sound = items.len() == count && items.iter().all(|e| e.is_finite() && e.min_element() >= 0.0);
    if sound { Ok(items) } else { Err(FOREIGN.into()) }
}

/// Reads the bounds of so many irradiances [lux].
pub fn bound(input: &mut Reader, count: usize) -> Result<Vec<f32>, String> {
    let items: Vec<f32> = slice(input)?;
    let sound = items.len() == count && items.iter().all(|x| x.is_finite() && *x >= 0.0);
    if sound { Ok(items) } else { Err(FOREIGN.into()) }
}

/// What cannot be unless somebody wrote it on purpose.
const FOREIGN: &str = "it is not the light of this scene";
