//! The scene file as it was, with everything that it names read into memory.
//!
//! The importer's reader opens it, so that both see the same bytes under the same limits; what a .glb cannot count is
//! refused on top. Every file is read once, however often it is named. Compressed bufferViews are
//! decoded and images become bufferViews at once, so that the later steps know one kind of data only. No index changes
//! its meaning here: lists only grow at their ends.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use luxel_scene::import::{
    Checked, Fault, FaultKind, Limits, Opened,
    accessors::Elements,
    buffers::{Buffers, MESHOPT},
    files::{Files, media_type},
};
use luxel_scene::{Notice, Progress, Silent};
use serde_json::Value;

use super::json::{self, Object, item, item_mut, list, list_mut, place};
use crate::ExportError;

/// A .glb counts its bytes in 32 bits, so no more can go into one.
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
        Self::read_with(path, &Silent)
    }

    /// [`Original::read`] that can be cancelled.
    pub fn read_with(path: &Path, progress: &dyn Progress) -> Result<Self, ExportError> {
        Self::load(path, LARGEST, progress).map_err(|fault| fault.in_file(path).into())
    }

    /// Refuses more than `largest` bytes of buffers and images.
    fn load(path: &Path, largest: u64, progress: &dyn Progress) -> Checked<Self> {
        let Opened { json, buffers, files } = Opened::read(path, &Limits::default(), progress)?;
        progress.check()?;
        let root: Value = serde_json::from_slice(&json).map_err(|e| Fault::invalid("JSON", e.to_string()))?;
        let Value::Object(root) = root else { return Err(Fault::invalid("JSON", "it is not an object")) };
        let mut original = Self { path: path.into(), root, buffers, taken_in: Vec::new(), notices: Vec::new(), files };
        original.check_views(progress)?;
        check_size(original.bytes(), largest, "")?;
        original.load_images(largest, progress)?;
        Ok(original)
    }

    /// Bytes of all buffers and images.
    pub fn bytes(&self) -> u64 {
        let buffers = (0..self.buffers.document().root.buffers.len()).map(|i| self.buffers.bytes(i).len());
        buffers.chain(self.taken_in.iter().map(Vec::len)).map(|n| n as u64).sum()
    }

    /// Every file that was read, with the digest of its bytes: images too that no lightmap depends on.
    pub fn inputs(&self) -> &[luxel_scene::InputFile] {
        self.files.inputs()
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
    fn check_views(&mut self, progress: &dyn Progress) -> Checked<()> {
        for i in 0..self.views() {
            progress.check()?;
            self.buffers.view(i)?;
            let view = item_mut(&mut self.root, "bufferViews", i)?;
            MESHOPT.iter().for_each(|n| json::remove_extension(view, n));
        }
        MESHOPT.iter().for_each(|n| json::forget_extension(&mut self.root, n));
        Ok(())
    }

    /// Turns images with URIs into bufferViews, equal URIs into one. An image that cannot be had keeps its URI, with a
    /// notice: nothing of the lightmap depends on it.
    fn load_images(&mut self, largest: u64, progress: &dyn Progress) -> Checked<()> {
        // View and media type by URI.
        let mut known: BTreeMap<String, (usize, String)> = BTreeMap::new();
        let mut total = self.bytes();
        for i in 0..list(&self.root, "images").len() {
            let image = item(&self.root, "images", i)?;
            let Some(uri) = image.get("uri").and_then(Value::as_str).map(str::to_owned) else { continue };
            if !known.contains_key(&uri) {
                let at = place(&self.root, "images", i);
                match self.files.fetch_with(&uri, &at, progress) {
                    Ok(bytes) => {
                        total += bytes.len() as u64;
                        check_size(total, largest, &at)?;
                        known.insert(uri.clone(), self.take_in(bytes, &uri)?);
                    }
                    Err(fault) if fault.is_cancelled() => return Err(fault),
                    Err(fault) => {
                        let message = format!("{}: it is not embedded: {}", fault.place, fault.what);
                        self.notices.push(Notice { code: "image-left-out", message });
                    }
                }
            }
            let Some((view, kind)) = known.get(&uri).cloned() else { continue };
            let image = item_mut(&mut self.root, "images", i)?;
            image.shift_remove("uri");
            image.entry("mimeType").or_insert(kind.into());
            image.insert("bufferView".into(), view.into());
        }
        Ok(())
    }

    /// Makes a bufferView of an image; returns its index and the image's media type.
    fn take_in(&mut self, bytes: Vec<u8>, uri: &str) -> Checked<(usize, String)> {
        let kind = image_type(&bytes, uri).to_owned();
        let views = list_mut(&mut self.root, "bufferViews")?;
        views.push(serde_json::json!({ "buffer": 0, "byteLength": bytes.len() }));
        let view = views.len() - 1;
        self.taken_in.push(bytes);
        Ok((view, kind))
    }
}

/// Sees that the bytes that were read so far go into a .glb.
fn check_size(bytes: u64, largest: u64, place: &str) -> Checked<()> {
    if bytes <= largest {
        return Ok(());
    }
    let what = format!("buffers and images have {bytes} bytes so far, more than the {largest} of a .glb");
    let hint = "a .glb counts in 32 bits: bake the scene in several parts, or with smaller textures";
    Err(Fault::new(FaultKind::Limit, place, what, hint))
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A scene whose images are these URIs, beside `a.png` of 100 bytes.
    fn scene(uris: &[&str]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a.png"), [7; 100]).unwrap();
        let images: Vec<Value> = uris.iter().map(|uri| json!({ "uri": uri })).collect();
        let path = dir.path().join("level.gltf");
        std::fs::write(&path, json!({ "asset": { "version": "2.0" }, "images": images }).to_string()).unwrap();
        (dir, path)
    }

    #[test]
    fn an_image_that_is_named_often_is_held_once() {
        let (_dir, path) = scene(&["a.png"; 10_000]);
        let original = Original::read(&path).unwrap();
        assert_eq!((original.bytes(), original.views()), (100, 1));
        let images = list(&original.root, "images");
        assert!(images.len() == 10_000 && images.iter().all(|i| i["bufferView"] == 0 && i.get("uri").is_none()));
    }

    #[test]
    fn images_are_refused_once_they_are_too_many_for_a_glb() {
        let (_dir, path) = scene(&["a.png", "./a.png", "././a.png"]);
        assert_eq!(Original::load(&path, 300, &Silent).unwrap().bytes(), 300);
        let Err(fault) = Original::load(&path, 299, &Silent) else { panic!("300 bytes are more than 299") };
        assert!(fault.kind == FaultKind::Limit && fault.place == "image 2", "{fault}");
        assert!(fault.to_string().contains("32 bits"), "{fault}");
    }
}
