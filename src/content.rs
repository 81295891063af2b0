//! What files hold, and which files a scene is made from: what a bake, the check of its outputs and a watch have to agree
//! on.

use std::collections::BTreeSet;
use std::fs::{File, Metadata};
use std::path::{Path, PathBuf};

use luxel_scene::import::container::json_of;
use luxel_scene::import::{Limits, document::Document, files::Files};

use crate::settings::{Resolved, SkySetting};

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    Absent,
    /// BLAKE3 of its bytes.
    Digest([u8; 32]),
    /// It is a folder, a pipe, larger than any file that is read [bytes], or may not be read.
    Refused(u64),
}

impl Content {
    /// What the file holds now.
    pub fn of(path: &Path) -> Self {
        match std::fs::metadata(path) {
            Ok(meta) => Self::read(path, &meta),
            Err(error) => missing(&error, 0),
        }
    }

    /// What the file of this metadata holds.
    pub fn read(path: &Path, meta: &Metadata) -> Self {
        Self::read_by(path, meta, |path, _| {
            let mut hasher = blake3::Hasher::new();
            File::open(path).and_then(|file| hasher.update_reader(file).map(|h| *h.finalize().as_bytes()))
        })
    }

    /// The same, by who finds the BLAKE3 of the file of so many bytes.
    pub fn read_by(path: &Path, meta: &Metadata, digest: impl FnOnce(&Path, u64) -> std::io::Result<[u8; 32]>) -> Self {
        // A pipe would block for ever.
        if !meta.is_file() || meta.len() > Limits::default().file_bytes {
            return Self::Refused(meta.len());
        }
        digest(path, meta.len()).map_or_else(|error| missing(&error, meta.len()), Self::Digest)
    }

    /// Its bytes can be read.
    pub fn is_read(&self) -> bool {
        matches!(self, Self::Digest(_))
    }
}

/// The files that a scene names as it is now: itself, buffers, images. Only itself where it cannot be understood. A
/// parser may panic over what they hold.
pub fn named(scene: &Path) -> BTreeSet<PathBuf> {
    let limits = Limits::default();
    let mut files = Files::beside(scene, &limits);
    let mut read = || {
        let document = Document::parse(&json_of(&mut files, scene, &limits).ok()?, &limits).ok()?;
        let buffers = document.root.buffers.iter().filter_map(|b| b.uri.as_deref());
        let images = document.root.images.iter().filter_map(|i| i.uri.as_deref());
        Some(buffers.chain(images).filter_map(|uri| files.path_of(uri, "").ok()?).collect())
    };
    let mut named: BTreeSet<PathBuf> = read().unwrap_or_default();
    named.insert(scene.to_path_buf());
    named
}

/// The sky image that settings name.
pub fn sky(settings: &Resolved) -> Option<PathBuf> {
    if let SkySetting::Image(path) = &settings.settings.sky { Some(path.clone()) } else { None }
}

/// What to make of a file that cannot be read, of so many bytes.
pub fn missing(error: &std::io::Error, length: u64) -> Content {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    if matches!(error.kind(), NotFound | NotADirectory) { Content::Absent } else { Content::Refused(length) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"a%20b.bin","byteLength":4},
        {"uri":"data:;base64,AAAA","byteLength":3}],"images":[{"uri":"../wall.png"},{"uri":"https://x/y.png"}]}"#;

    #[test]
    fn a_scene_names_its_buffers_and_images_whether_they_are_there_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("s.gltf"), SCENE).unwrap();
        std::fs::write(at("broken.gltf"), "{\"asset\":").unwrap();
        assert_eq!(named(&at("s.gltf")), BTreeSet::from([at("s.gltf"), at("a b.bin"), at("../wall.png")]));
        assert_eq!(named(&at("broken.gltf")), BTreeSet::from([at("broken.gltf")]));
        assert_eq!(named(&at("none.glb")), BTreeSet::from([at("none.glb")]));
        // What it names may lie under another spelling, where exporters do not encode.
        std::fs::write(at("a%20b.bin"), "x").unwrap();
        assert!(named(&at("s.gltf")).contains(&at("a%20b.bin")));
    }
}
