//! The scene file as it was, with everything that it names read into memory.
//!
//! Compressed bufferViews are decoded and images become bufferViews at once, so that the later steps know one kind of
//! data only. No index changes its meaning here: lists only grow at their ends.

use std::path::{Path, PathBuf};

use luxel_scene::{InputFile, Notice};
use serde_json::Value;

use super::{
    fault::{Checked, Fault},
    files::{self, Container},
    json::{self, Object, item, item_mut, list, list_mut, number, place},
    meshopt,
};
use crate::ExportError;

/// Where the bytes of a bufferView are.
pub enum Blob {
    Range { buffer: usize, start: usize, end: usize },
    Owned(Vec<u8>),
}

/// A glTF document with its buffers and images.
pub struct Original {
    pub(super) path: PathBuf,
    pub(super) root: Object,
    pub(super) buffers: Vec<Vec<u8>>,
    /// One per bufferView.
    pub(super) blobs: Vec<Blob>,
    pub(super) notices: Vec<Notice>,
    pub(super) inputs: Vec<InputFile>,
}

impl Original {
    /// Reads a .gltf or .glb with all buffers and images. Errors name the file and the place in it.
    pub fn read(path: &Path) -> Result<Self, ExportError> {
        Self::load(path).map_err(|fault| fault.of(path))
    }

    fn load(path: &Path) -> Checked<Self> {
        let bytes = files::read(path)?;
        let inputs = vec![InputFile { path: path.to_path_buf(), digest: *blake3::hash(&bytes).as_bytes() }];
        let Container { json, bin } = Container::parse(&bytes)?;
        let root: Value = serde_json::from_slice(&json).map_err(|e| Fault::new("JSON", e.to_string()))?;
        let Value::Object(root) = root else { return Err(Fault::new("JSON", "is not an object")) };
        let mut original =
            Self { path: path.into(), root, buffers: Vec::new(), blobs: Vec::new(), notices: Vec::new(), inputs };
        let folder = path.parent().unwrap_or(Path::new(""));
        original.load_buffers(folder, bin)?;
        original.load_views()?;
        original.load_images(folder)?;
        Ok(original)
    }

    /// Every file that went into this, with the BLAKE3 digest of its bytes: more than the importer reads, which leaves
    /// out the images that light does not need.
    pub fn inputs(&self) -> &[InputFile] {
        &self.inputs
    }

    /// The bytes of a bufferView.
    pub(super) fn view(&self, i: usize) -> Checked<&[u8]> {
        match self.blobs.get(i) {
            Some(Blob::Owned(bytes)) => Ok(bytes),
            Some(Blob::Range { buffer, start, end }) => Ok(&self.buffers[*buffer][*start..*end]),
            None => Err(Fault::new(format!("bufferViews[{i}]"), "does not exist")),
        }
    }

    fn fetch(&mut self, folder: &Path, uri: &str) -> Checked<files::Fetched> {
        let fetched = files::fetch(folder, uri)?;
        if let Some(path) = &fetched.path {
            let digest = *blake3::hash(&fetched.bytes).as_bytes();
            self.inputs.push(InputFile { path: path.clone(), digest });
        }
        Ok(fetched)
    }

    fn load_buffers(&mut self, folder: &Path, mut bin: Option<Vec<u8>>) -> Checked<()> {
        for i in 0..list(&self.root, "buffers").len() {
            let buffer = item(&self.root, "buffers", i)?;
            let uri = buffer.get("uri").and_then(Value::as_str).map(str::to_owned);
            let bytes = match uri {
                Some(uri) => self.fetch(folder, &uri).map_err(|f| within(&format!("buffers[{i}]"), f))?.bytes,
                None if i == 0 => bin.take().unwrap_or_default(),
                // A buffer without data is the fallback of a compressed one; whoever uses it otherwise finds it short.
                None => Vec::new(),
            };
            self.buffers.push(bytes);
        }
        Ok(())
    }

    fn load_views(&mut self) -> Checked<()> {
        for i in 0..list(&self.root, "bufferViews").len() {
            let view = item(&self.root, "bufferViews", i)?;
            let name = place(&self.root, "bufferViews", i);
            let compressed = meshopt::NAMES.iter().find_map(|n| json::extension(view, n));
            let (buffer, start, end) = self.range(&name, compressed.unwrap_or(view))?;
            let blob = match compressed {
                None => Blob::Range { buffer, start, end },
                Some(extension) => {
                    let bytes = meshopt::decode(&name, extension, &self.buffers[buffer][start..end])?;
                    if number(view, "byteLength") != Some(bytes.len()) {
                        return Err(Fault::new(name, "has another length than its compressed data"));
                    }
                    Blob::Owned(bytes)
                }
            };
            let view = item_mut(&mut self.root, "bufferViews", i)?;
            meshopt::NAMES.iter().for_each(|n| json::remove_extension(view, n));
            self.blobs.push(blob);
        }
        meshopt::NAMES.iter().for_each(|n| json::forget_extension(&mut self.root, n));
        Ok(())
    }

    /// Buffer and byte range of a bufferView or of its compressed form.
    fn range(&self, name: &str, view: &Object) -> Checked<(usize, usize, usize)> {
        let buffer = number(view, "buffer").ok_or_else(|| Fault::new(name, "has no buffer"))?;
        let start = number(view, "byteOffset").unwrap_or(0);
        let length = number(view, "byteLength").ok_or_else(|| Fault::new(name, "has no byteLength"))?;
        let available = self.buffers.get(buffer).map_or(0, Vec::len);
        match start.checked_add(length) {
            Some(end) if end <= available => Ok((buffer, start, end)),
            _ => {
                let fault = format!("needs bytes {start} + {length} of buffer {buffer}, which has {available}");
                Err(Fault::new(name, fault))
            }
        }
    }

    /// Turns images with URIs into bufferViews. An image that cannot be had keeps its URI, with a notice: nothing of
    /// the lightmap depends on it.
    fn load_images(&mut self, folder: &Path) -> Checked<()> {
        for i in 0..list(&self.root, "images").len() {
            let image = item(&self.root, "images", i)?;
            let Some(uri) = image.get("uri").and_then(Value::as_str).map(str::to_owned) else { continue };
            let fetched = match self.fetch(folder, &uri) {
                Ok(fetched) => fetched,
                Err(f) => {
                    let name = place(&self.root, "images", i);
                    let message = format!("{name} is not embedded: {} {}", f.place, f.fault);
                    self.notices.push(Notice { code: "image-left-out", message });
                    continue;
                }
            };
            let kind = media_type(&fetched);
            let views = list_mut(&mut self.root, "bufferViews")?;
            views.push(serde_json::json!({ "buffer": 0, "byteLength": fetched.bytes.len() }));
            let view = views.len() - 1;
            self.blobs.push(Blob::Owned(fetched.bytes));
            let image = item_mut(&mut self.root, "images", i)?;
            image.shift_remove("uri");
            image.entry("mimeType").or_insert(kind.into());
            image.insert("bufferView".into(), view.into());
        }
        Ok(())
    }
}

fn within(place: &str, fault: Fault) -> Fault {
    Fault::new(place, format!("{} {}", fault.place, fault.fault))
}

/// The media type of an image: by its first bytes, else as its data URI said.
fn media_type(image: &files::Fetched) -> String {
    let known: [(&[u8], usize, &str); 6] = [
        (b"\x89PNG", 0, "image/png"),
        (b"\xff\xd8\xff", 0, "image/jpeg"),
        (b"WEBP", 8, "image/webp"),
        (b"\xabKTX 20", 0, "image/ktx2"),
        (b"DDS ", 0, "image/vnd-ms.dds"),
        (b"ftypavif", 4, "image/avif"),
    ];
    let found = known.iter().find(|(magic, at, _)| image.bytes.get(*at..).is_some_and(|b| b.starts_with(magic)));
    match found {
        Some((_, _, kind)) => (*kind).into(),
        None => image.media_type.clone().unwrap_or_else(|| "application/octet-stream".into()),
    }
}
