//! What a scene's bake follows from: the files that it names, those that its last bake really read, the settings.
//!
//! A [`Look`] is all of that as it is now, files by the digest of their content. Two equal looks give the same bake, so
//! a scene is current exactly where its look is the one that its outputs were made from: a file that was touched, or
//! changed and changed back, bakes nothing. Events only say when to look.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};

use luxel_export::OutputSet;
use luxel_scene::import::container::json_of;
use luxel_scene::import::{Limits, document::Document, files::Files};

use super::event::Fault;
use super::stamp::Stamp;
use crate::settings::{FILE_NAME, Layer, Resolved, SettingsError, SkySetting, for_scene};

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    Absent,
    /// BLAKE3 of its bytes.
    Digest([u8; 32]),
    /// It is a folder, a pipe, larger than any file that is read [bytes], or may not be read.
    Refused(u64),
}

/// Everything that a scene's bake follows from, at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    pub files: BTreeMap<PathBuf, Content>,
    pub settings: Result<Resolved, Fault>,
    /// Where its outputs go.
    pub outputs: Result<OutputSet, Fault>,
}

impl Look {
    /// Files that differ between two looks, sorted.
    pub fn differences(&self, other: &Self) -> Vec<PathBuf> {
        let names: BTreeSet<&PathBuf> = self.files.keys().chain(other.files.keys()).collect();
        names.into_iter().filter(|f| self.files.get(*f) != other.files.get(*f)).cloned().collect()
    }

    /// Some file that the scene names is not there.
    pub fn lacks(&self) -> bool {
        self.files.values().any(|c| *c == Content::Absent)
    }
}

/// The settings that hold for every scene of a watch.
#[derive(Clone, Debug)]
pub struct Choices {
    /// A settings file instead of those beside the scenes; read anew whenever it changes.
    pub config: Option<PathBuf>,
    /// Over everything else.
    pub flags: Layer,
}

impl Choices {
    /// The settings of a scene as the files are now.
    pub fn settings(&self, scene: &Path) -> Result<Resolved, SettingsError> {
        let config = self.config.as_deref().map(Layer::from_file).transpose()?;
        for_scene(scene, config.as_ref(), &self.flags)
    }

    /// The file in which a scene's settings are looked for.
    pub fn file(&self, scene: &Path) -> PathBuf {
        self.config.clone().unwrap_or_else(|| scene.with_file_name(FILE_NAME))
    }
}

/// The files that a scene names as it is now: itself, buffers, images. Only itself where it cannot be understood.
pub fn named(scene: &Path) -> BTreeSet<PathBuf> {
    let limits = Limits::default();
    let mut files = Files::beside(scene, &limits);
    let mut read = || {
        let document = Document::parse(&json_of(&mut files, scene, &limits).ok()?, &limits).ok()?;
        let buffers = document.root.buffers.iter().filter_map(|b| b.uri.as_deref());
        let images = document.root.images.iter().filter_map(|i| i.uri.as_deref());
        Some(buffers.chain(images).filter_map(|uri| files.path_of(uri, "").ok()?).collect())
    };
    // What makes a parser panic comes out in the bake, as that scene's error; the watch of the others goes on.
    let named: Option<BTreeSet<PathBuf>> = std::panic::catch_unwind(AssertUnwindSafe(&mut read)).unwrap_or_default();
    let mut named = named.unwrap_or_default();
    named.insert(scene.to_path_buf());
    named
}

/// The sky image that settings name.
pub fn sky(settings: &Resolved) -> Option<PathBuf> {
    if let SkySetting::Image(path) = &settings.settings.sky { Some(path.clone()) } else { None }
}

/// Digests of files, kept as long as their stamps stay.
#[derive(Debug, Default)]
pub struct Digests {
    known: BTreeMap<PathBuf, (Stamp, Content)>,
}

impl Digests {
    /// What the file holds.
    pub fn of(&mut self, path: &Path) -> Content {
        let meta = match std::fs::metadata(path) {
            Ok(meta) => meta,
            Err(error) => {
                self.known.remove(path);
                return missing(&error, 0);
            }
        };
        let stamp = Stamp::new(&meta);
        if let Some((_, content)) = self.known.get(path).filter(|(s, _)| *s == stamp) {
            return *content;
        }
        // A pipe would block for ever.
        let readable = meta.is_file() && meta.len() <= Limits::default().file_bytes;
        let content = if readable { digest(path, meta.len()) } else { Content::Refused(meta.len()) };
        // A file that changed while it was read has another stamp now, and is read again.
        self.known.insert(path.to_path_buf(), (stamp, content));
        content
    }

    /// The file is to be read again whatever its stamp says.
    pub fn forget(&mut self, path: &Path) {
        self.known.remove(path);
    }

    /// Keeps only files that `wanted` names.
    pub fn retain(&mut self, wanted: impl Fn(&Path) -> bool) {
        self.known.retain(|path, _| wanted(path));
    }
}

fn digest(path: &Path, length: u64) -> Content {
    let mut hasher = blake3::Hasher::new();
    match File::open(path).and_then(|file| hasher.update_reader(file).map(|h| *h.finalize().as_bytes())) {
        Ok(digest) => Content::Digest(digest),
        Err(error) => missing(&error, length),
    }
}

fn missing(error: &std::io::Error, length: u64) -> Content {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    if matches!(error.kind(), NotFound | NotADirectory) { Content::Absent } else { Content::Refused(length) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Origin;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    const SCENE: &str = r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"a%20b.bin","byteLength":4},
        {"uri":"data:;base64,AAAA","byteLength":3}],"images":[{"uri":"../wall.png"},{"uri":"https://x/y.png"}]}"#;

    #[test]
    fn a_scene_names_its_buffers_and_images_whether_they_are_there_or_not() {
        let folder = folder(&[("s.gltf", SCENE), ("broken.gltf", "{\"asset\":")]);
        let at = |name: &str| folder.path().join(name);
        assert_eq!(named(&at("s.gltf")), BTreeSet::from([at("s.gltf"), at("a b.bin"), at("../wall.png")]));
        assert_eq!(named(&at("broken.gltf")), BTreeSet::from([at("broken.gltf")]));
        assert_eq!(named(&at("none.glb")), BTreeSet::from([at("none.glb")]));
        // What it names may lie under another spelling, where exporters do not encode.
        std::fs::write(at("a%20b.bin"), "x").unwrap();
        assert!(named(&at("s.gltf")).contains(&at("a%20b.bin")));
    }

    #[test]
    fn a_digest_follows_the_content_and_not_the_time() {
        let folder = folder(&[("a", "one")]);
        let path = folder.path().join("a");
        let mut digests = Digests::default();
        let first = digests.of(&path);
        assert_eq!(first, Content::Digest(*blake3::hash(b"one").as_bytes()));
        std::fs::File::open(&path).unwrap().set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
        assert_eq!(digests.of(&path), first);
        std::fs::write(&path, "three").unwrap();
        assert_eq!(digests.of(&path), Content::Digest(*blake3::hash(b"three").as_bytes()));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(digests.of(&path), Content::Absent);
        assert!(matches!(digests.of(folder.path()), Content::Refused(_)));
    }

    #[test]
    fn an_equal_stamp_is_believed_until_it_is_forgotten() {
        let folder = folder(&[("a", "one")]);
        let path = folder.path().join("a");
        let mut digests = Digests::default();
        let truth = digests.of(&path);
        digests.known.get_mut(&path).unwrap().1 = Content::Refused(7);
        assert_eq!(digests.of(&path), Content::Refused(7), "not read again");
        digests.forget(&path);
        assert_eq!(digests.of(&path), truth);
        digests.retain(|_| false);
        assert!(digests.known.is_empty());
    }

    #[test]
    fn settings_come_from_the_named_file_or_the_one_beside() {
        let folder = folder(&[("s.gltf", SCENE), ("luxel.toml", "size = 32"), ("other.toml", "sky = \"noon.hdr\"")]);
        let scene = folder.path().join("s.gltf");
        let beside = Choices { config: None, flags: Layer::new(Origin::CommandLine) };
        assert_eq!(beside.file(&scene), folder.path().join("luxel.toml"));
        assert_eq!(beside.settings(&scene).unwrap().settings.size.0, 32);
        let named = Choices { config: Some(folder.path().join("other.toml")), ..beside };
        assert_eq!(named.file(&scene), folder.path().join("other.toml"));
        assert_eq!(sky(&named.settings(&scene).unwrap()), Some(folder.path().join("noon.hdr")));
        let gone = Choices { config: Some(folder.path().join("gone.toml")), ..named };
        assert!(gone.settings(&scene).is_err());
    }
}
