//! Buffers and buffer views: every byte that geometry and embedded images come from, with checked ranges.

use std::cell::{Cell, OnceCell};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use serde_json::Value;

use super::document::Document;
use super::error::{Bound, Checked, Fault, place};
use super::files::Files;
use super::meshopt::Compression;
use super::options::Limits;
use crate::Progress;

/// The two names of the same compression.
pub const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// A document with all its buffers loaded.
pub struct Buffers {
    document: Document,
    /// Buffers of one file share its bytes.
    buffers: Vec<Option<Arc<Vec<u8>>>>,
    /// Views decoded so far, by index.
    decoded: Vec<OnceCell<Vec<u32>>>,
    /// Bytes that may still be spent on decoded geometry.
    budget: Cell<u64>,
    budget_at_start: u64,
    /// What set the budget.
    bound: Bound,
}

impl Buffers {
    /// Loads all buffers but those that only hold fallback data for a compression that is decoded anyway.
    pub fn load(
        document: Document,
        bin: Option<Vec<u8>>,
        files: &mut Files,
        limits: &Limits,
        progress: &dyn Progress,
    ) -> Checked<Self> {
        let mut bin = bin;
        let mut known = BTreeMap::new();
        let mut buffers = Vec::with_capacity(document.root.buffers.len());
        for (index, buffer) in document.root.buffers.iter().enumerate() {
            let place = place("buffer", index, buffer.name.as_deref());
            let bytes = match &buffer.uri {
                _ if is_fallback(buffer) => None,
                Some(uri) => Some(shared(uri, files, &mut known, &place, progress)?),
                // Only the first buffer may be the BIN chunk; others without a URI hold nothing.
                None if index == 0 => bin.take().map(Arc::new),
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
        let bound = if budget < limits.geometry_bytes { Bound::Expansion } else { Bound::GeometryBytes };
        let budget = budget.min(limits.geometry_bytes);
        let decoded = (0..document.root.buffer_views.len()).map(|_| OnceCell::new()).collect();
        Ok(Self { document, buffers, decoded, budget: Cell::new(budget), budget_at_start: budget, bound })
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
                Err(Fault::limit(place, "with it the decoded geometry has a size in bytes", self.bound, limit))
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
        self.buffers.get(buffer).and_then(Option::as_deref).map_or(&[], Vec::as_slice)
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

/// The bytes behind a buffer's URI; those of a file are read once, however many buffers name it.
fn shared(
    uri: &str,
    files: &mut Files,
    known: &mut BTreeMap<PathBuf, Arc<Vec<u8>>>,
    place: &str,
    progress: &dyn Progress,
) -> Checked<Arc<Vec<u8>>> {
    progress.check()?;
    let Some(path) = files.path_of(uri, place)? else { return Ok(Arc::new(files.fetch(uri, place)?)) };
    // A file has many names; one that cannot be resolved is about to be refused.
    let key = path.canonicalize().unwrap_or_else(|_| path.clone());
    if let Some(bytes) = known.get(&key) {
        return Ok(Arc::clone(bytes));
    }
    let bytes = Arc::new(files.read_with(&path, place, progress)?);
    known.insert(key, Arc::clone(&bytes));
    Ok(bytes)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Silent;
    use crate::import::FaultKind;
    use serde_json::json;

    /// Loads the buffers of a scene beside a file `geometry.bin` of 64 bytes.
    fn load(buffers: Value, limits: &Limits) -> Checked<(Buffers, u64)> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("geometry.bin"), [7; 64]).unwrap();
        std::fs::write(folder.path().join("other.bin"), [8; 64]).unwrap();
        let json = json!({"asset": {"version": "2.0"}, "buffers": buffers}).to_string();
        let document = Document::parse(json.as_bytes(), limits).unwrap();
        let mut files = Files::beside(&folder.path().join("scene.gltf"), limits);
        let buffers = Buffers::load(document, None, &mut files, limits, &Silent)?;
        Ok((buffers, files.bytes_read()))
    }

    #[test]
    fn a_file_is_read_once_by_whatever_name() {
        let names = ["geometry.bin", "./geometry.bin", "%67eometry.bin"];
        let one = |i: usize| json!({"byteLength": 64 - i % 2, "uri": names[i % 3]});
        let limits = Limits { input_bytes: 64, ..Limits::default() };
        let (buffers, read) = load((0..1000).map(one).collect(), &limits).unwrap();
        assert_eq!((read, buffers.bytes(0), buffers.bytes(999)), (64, &[7; 64][..], &[7; 64][..]));
        assert!(buffers.buffers.iter().flatten().all(|b| Arc::ptr_eq(b, buffers.buffers[0].as_ref().unwrap())));
        let missing = load(json!([{"byteLength": 64, "uri": "x.bin"}]), &limits).map(|_| ()).unwrap_err();
        assert_eq!(missing.kind, FaultKind::Unreadable, "{missing}");
    }

    #[test]
    fn all_files_together_are_bounded() {
        let two = json!([{"byteLength": 64, "uri": "geometry.bin"}, {"byteLength": 64, "uri": "other.bin"}]);
        assert_eq!(load(two.clone(), &Limits { input_bytes: 128, ..Limits::default() }).unwrap().1, 128);
        let fault = load(two, &Limits { input_bytes: 127, ..Limits::default() }).map(|_| ()).unwrap_err();
        assert!(fault.kind == FaultKind::Limit && fault.place == "buffer 1", "{fault}");
        assert!(fault.what.contains("128 bytes") && fault.what.contains("`input_bytes` of 127"), "{fault}");
    }
}
