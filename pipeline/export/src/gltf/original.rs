//! The scene file as it was, with everything that it names read into memory.
//!
//! The importer's reader opens it, so that both see the same bytes under the same limits. Compressed bufferViews are
//! decoded and images become bufferViews at once, so that the later steps know one kind of data only. No index changes
//! its meaning here: lists only grow at their ends.

use std::ops::Range;
use std::path::{Path, PathBuf};

use luxel_scene::Notice;
use luxel_scene::import::{
    Checked, Fault, Limits, Opened,
    accessors::Elements,
    buffers::{Buffers, MESHOPT},
    files::{Files, media_type},
};
use serde_json::Value;

use super::json::{self, Object, item, item_mut, list, list_mut, place};
use crate::ExportError;

/// A .glb counts its bytes in 32 bits, so no larger file can go into one.
const LARGEST: u64 = u32::MAX as u64;

/// Where the bytes of a bufferView are.
pub enum Blob<'a> {
    /// In a buffer of the file.
    Range { buffer: usize, range: Range<usize> },
    /// Decoded, or taken in from another file.
    Bytes(&'a [u8]),
}

/// A glTF document with its buffers and images.
pub struct Original {
    pub(super) path: PathBuf,
    pub(super) root: Object,
    pub(super) buffers: Buffers,
    /// The bufferViews behind those of the file.
    taken_in: Vec<Vec<u8>>,
    pub(super) notices: Vec<Notice>,
    files: Files,
}

impl Original {
    /// Reads a .gltf or .glb with all buffers and images. Errors name the file and the place in it.
    pub fn read(path: &Path) -> Result<Self, ExportError> {
        Self::load(path).map_err(|fault| fault.in_file(path).into())
    }

    fn load(path: &Path) -> Checked<Self> {
        let limits = Limits { file_bytes: LARGEST, ..Limits::default() };
        let Opened { json, buffers, files } = Opened::read(path, &limits)?;
        let root: Value = serde_json::from_slice(&json).map_err(|e| Fault::invalid("JSON", e.to_string()))?;
        let Value::Object(root) = root else { return Err(Fault::invalid("JSON", "it is not an object")) };
        let mut original = Self { path: path.into(), root, buffers, taken_in: Vec::new(), notices: Vec::new(), files };
        original.check_views()?;
        original.load_images()?;
        Ok(original)
    }

    /// Bytes of all buffers and images.
    pub fn bytes(&self) -> u64 {
        let buffers = (0..self.buffers.document().root.buffers.len()).map(|i| self.buffers.bytes(i).len());
        buffers.chain(self.taken_in.iter().map(Vec::len)).map(|n| n as u64).sum()
    }

    /// Files that the importer read too must have had the same bytes then.
    ///
    /// # Errors
    /// Names the first file that had others.
    pub fn check_unchanged(&self, inputs: &[luxel_scene::InputFile]) -> Result<(), ExportError> {
        let changed =
            |now: &&luxel_scene::InputFile| inputs.iter().any(|i| i.path == now.path && i.digest != now.digest);
        match self.files.inputs().iter().find(changed) {
            Some(file) => Err(ExportError::Changed { path: file.path.clone() }),
            None => Ok(()),
        }
    }

    /// Number of bufferViews.
    pub(super) fn views(&self) -> usize {
        self.buffers.document().root.buffer_views.len() + self.taken_in.len()
    }

    /// Where the bytes of a bufferView are.
    pub(super) fn blob(&self, i: usize) -> Checked<Blob<'_>> {
        match i.checked_sub(self.buffers.document().root.buffer_views.len()) {
            Some(k) => {
                let bytes = self.taken_in.get(k).map(Vec::as_slice);
                bytes
                    .map(Blob::Bytes)
                    .ok_or_else(|| Fault::invalid(place(&self.root, "bufferViews", i), "it does not exist"))
            }
            None => Ok(match self.buffers.range(i)? {
                Some((buffer, range)) => Blob::Range { buffer, range },
                None => Blob::Bytes(self.buffers.view(i)?),
            }),
        }
    }

    /// The elements of an accessor.
    pub(super) fn elements(&self, accessor: usize) -> Checked<Elements<'_>> {
        self.buffers.elements(accessor)
    }

    /// Every bufferView lies within its buffer, and compressed ones decode; they are plain ones from here on.
    fn check_views(&mut self) -> Checked<()> {
        for i in 0..self.views() {
            self.buffers.view(i)?;
            let view = item_mut(&mut self.root, "bufferViews", i)?;
            MESHOPT.iter().for_each(|n| json::remove_extension(view, n));
        }
        MESHOPT.iter().for_each(|n| json::forget_extension(&mut self.root, n));
        Ok(())
    }

    /// Turns images with URIs into bufferViews. An image that cannot be had keeps its URI, with a notice: nothing of
    /// the lightmap depends on it.
    fn load_images(&mut self) -> Checked<()> {
        for i in 0..list(&self.root, "images").len() {
            let image = item(&self.root, "images", i)?;
            let Some(uri) = image.get("uri").and_then(Value::as_str).map(str::to_owned) else { continue };
            let bytes = match self.files.fetch(&uri, &place(&self.root, "images", i)) {
                Ok(bytes) => bytes,
                Err(fault) => {
                    let message = format!("{}: it is not embedded: {}", fault.place, fault.what);
                    self.notices.push(Notice { code: "image-left-out", message });
                    continue;
                }
            };
            let kind = image_type(&bytes, &uri).to_owned();
            let views = list_mut(&mut self.root, "bufferViews")?;
            views.push(serde_json::json!({ "buffer": 0, "byteLength": bytes.len() }));
            let view = views.len() - 1;
            self.taken_in.push(bytes);
            let image = item_mut(&mut self.root, "images", i)?;
            image.shift_remove("uri");
            image.entry("mimeType").or_insert(kind.into());
            image.insert("bufferView".into(), view.into());
        }
        Ok(())
    }
}

#[cfg(test)]
impl Original {
    /// The bytes of a bufferView.
    pub(super) fn view(&self, i: usize) -> Checked<&[u8]> {
        Ok(match self.blob(i)? {
            Blob::Bytes(bytes) => bytes,
            Blob::Range { buffer, range } => &self.buffers.bytes(buffer)[range],
        })
    }
}

/// The media type of an image: by its first bytes, else as its data URI says.
fn image_type<'a>(image: &[u8], uri: &'a str) -> &'a str {
    let known: [(&[u8], usize, &str); 6] = [
        (b"\x89PNG", 0, "image/png"),
        (b"\xff\xd8\xff", 0, "image/jpeg"),
        (b"WEBP", 8, "image/webp"),
        (b"\xabKTX 20", 0, "image/ktx2"),
        (b"DDS ", 0, "image/vnd-ms.dds"),
        (b"ftypavif", 4, "image/avif"),
    ];
    let found = known.iter().find(|(magic, at, _)| image.get(*at..).is_some_and(|b| b.starts_with(magic)));
    match found {
        Some((_, _, kind)) => kind,
        None => media_type(uri).unwrap_or("application/octet-stream"),
    }
}
