//! Buffers and buffer views: every byte that geometry and embedded images come from, with checked ranges.

use std::cell::{Cell, OnceCell};
use std::ops::Range;

use serde_json::Value;

use super::document::Document;
use super::error::{Checked, Fault, place};
use super::files::Files;
use super::meshopt::Compression;
use super::options::Limits;

/// The two names of the same compression.
pub const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// A document with all its buffers loaded.
pub struct Buffers {
    document: Document,
    buffers: Vec<Option<Vec<u8>>>,
    /// Views decoded so far, by index.
    decoded: Vec<OnceCell<Vec<u32>>>,
    /// Bytes that may still be spent on decoded geometry.
    budget: Cell<u64>,
    budget_at_start: u64,
}

impl Buffers {
    /// Loads all buffers but those that only hold fallback data for a compression that is decoded anyway.
    pub fn load(document: Document, bin: Option<Vec<u8>>, files: &mut Files, limits: &Limits) -> Checked<Self> {
        let mut bin = bin;
        let mut buffers = Vec::with_capacity(document.root.buffers.len());
        for (index, buffer) in document.root.buffers.iter().enumerate() {
            let place = place("buffer", index, buffer.name.as_deref());
            let bytes = match &buffer.uri {
                _ if is_fallback(buffer) => None,
                Some(uri) => Some(files.fetch(uri, &place)?),
                // Only the first buffer may be the BIN chunk; others without a URI hold nothing.
                None if index == 0 => bin.take(),
                None => None,
            };
            let declared = buffer.byte_length.0;
            if let Some(bytes) = &bytes
                && (bytes.len() as u64) < declared
            {
                let what = format!("it has {} bytes, but claims {declared}", bytes.len());
                return Err(Fault::invalid(place, what));
            }
            buffers.push(bytes);
        }
        let budget = files.bytes_read().saturating_mul(limits.expansion).saturating_add(64 << 20);
        let budget = budget.min(limits.geometry_bytes);
        let decoded = (0..document.root.buffer_views.len()).map(|_| OnceCell::new()).collect();
        Ok(Self { document, buffers, decoded, budget: Cell::new(budget), budget_at_start: budget })
    }

    pub fn document(&self) -> &Document {
        &self.document
    }

    /// Takes `bytes` of decoded geometry from the budget, before they are allocated.
    pub fn spend(&self, bytes: Option<u64>, place: &str) -> Checked<()> {
        match bytes.and_then(|bytes| self.budget.get().checked_sub(bytes)) {
            Some(left) => {
                self.budget.set(left);
                Ok(())
            }
            None => {
                let limit = self.budget_at_start;
                Err(Fault::limit(place, "its decoded data take too many bytes", "geometry_bytes / expansion", limit))
            }
        }
    }

    /// The bytes of a buffer view, decompressed if need be.
    pub fn view(&self, index: usize) -> Checked<&[u8]> {
        let place = place("bufferView", index, None);
        let view = self.document.root.buffer_views.get(index);
        let view = view.ok_or_else(|| Fault::invalid(&place, "it does not exist"))?;
        let (offset, length) = (view.byte_offset.map_or(0, |o| o.0), view.byte_length.0);
        match compression(view) {
            Some(object) => {
                let compression = Compression::read(object, &place)?;
                let words = self.decompressed(index, &compression, &place)?;
                let bytes: &[u8] = bytemuck::cast_slice(words);
                let within = compression.decoded_bytes().filter(|&n| n >= length).and(usize::try_from(length).ok());
                within.and_then(|n| bytes.get(..n)).ok_or_else(|| {
                    Fault::invalid(&place, format!("it claims {length} bytes, more than its compressed data decode to"))
                })
            }
            None => self.slice(view.buffer.value(), offset, length, &place),
        }
    }

    /// Buffer and range of a view's bytes where they lie in the file as they are; none for a compressed view. Checked
    /// to lie within the buffer; a view without bytes lies at its start.
    pub fn range(&self, index: usize) -> Checked<Option<(usize, Range<usize>)>> {
        let bytes = self.view(index)?.len();
        let view = self.document.root.buffer_views.get(index).filter(|v| compression(v).is_none());
        Ok(view.map(|view| {
            // `view` has found this many bytes there.
            let start = if bytes == 0 { 0 } else { view.byte_offset.map_or(0, |o| o.0 as usize) };
            (view.buffer.value(), start..start + bytes)
        }))
    }

    /// All bytes of a buffer; none where it holds nothing.
    pub fn bytes(&self, buffer: usize) -> &[u8] {
        self.buffers.get(buffer).and_then(Option::as_deref).unwrap_or_default()
    }

    fn decompressed(&self, index: usize, compression: &Compression, place: &str) -> Checked<&[u32]> {
        let cell = self.decoded.get(index).ok_or_else(|| Fault::invalid(place, "it does not exist"))?;
        if cell.get().is_none() {
            let encoded = self.slice(compression.buffer, compression.offset, compression.length, place)?;
            self.spend(compression.decoded_bytes(), place)?;
            let words = compression.decode(encoded, place)?;
            // The cell was empty a moment ago and this type is not shared between threads.
            let _ = cell.set(words);
        }
        Ok(cell.get().map_or(&[], Vec::as_slice))
    }

    fn slice(&self, buffer: usize, offset: u64, length: u64, place: &str) -> Checked<&[u8]> {
        let bytes = self.buffers.get(buffer);
        let bytes = bytes.ok_or_else(|| Fault::invalid(place, format!("buffer {buffer} does not exist")))?;
        if length == 0 {
            return Ok(&[]);
        }
        let bytes = bytes.as_deref().ok_or_else(|| {
            Fault::invalid(place, format!("buffer {buffer} has no data: it has no URI and is no BIN chunk"))
        })?;
        let range = usize::try_from(offset).ok().zip(offset.checked_add(length).and_then(|e| usize::try_from(e).ok()));
        range.and_then(|(start, end)| bytes.get(start..end)).ok_or_else(|| {
            let what = format!("{length} bytes at {offset} are outside buffer {buffer} of {} bytes", bytes.len());
            Fault::invalid(place, what)
        })
    }
}

/// The compression object of a view.
pub fn compression(view: &gltf_json::buffer::View) -> Option<&Value> {
    let others = &view.extensions.as_ref()?.others;
    MESHOPT.iter().find_map(|name| others.get(*name))
}

/// A buffer that only stands in for compressed views.
fn is_fallback(buffer: &gltf_json::Buffer) -> bool {
    let others = buffer.extensions.as_ref().map(|e| &e.others);
    let flagged = |name: &str| others.and_then(|o| o.get(name)?.get("fallback")?.as_bool()) == Some(true);
    MESHOPT.iter().any(|name| flagged(name))
}
