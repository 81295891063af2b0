//! What a scene's bake follows from: the files that it names, those that its last bake really read, the settings.
//!
//! A [`Look`] is all of that as it is now, files by the digest of their content. Two equal looks give the same bake, so
//! a scene is current exactly where its look is the one that its outputs were made from: a file that was touched, or
//! changed and changed back, bakes nothing. Events only say when to look.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use luxel_export::OutputSet;

use super::digest::digest;
use super::event::Fault;
use super::stamp::Stamp;
use crate::bake::guarded;
use crate::content::{Content, missing, named};
use crate::settings::{FILE_NAME, Layer, Resolved, SettingsError, for_scene};

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

/// A scene's settings as the files are now, and the files that it names. Both read what anybody may have written: what
/// makes a parser panic is this scene's fault, and the watch of the others goes on.
pub fn read(scene: &Path, choices: &Choices) -> (Result<Resolved, Fault>, BTreeSet<PathBuf>) {
    guarded_read(scene, || (choices.settings(scene).map_err(|e| Fault::new(&e)), named(scene)))
}

/// What `work` read of a scene; where it panicked, that fault and the scene alone.
fn guarded_read<T>(
    scene: &Path,
    work: impl FnOnce() -> (Result<T, Fault>, BTreeSet<PathBuf>),
) -> (Result<T, Fault>, BTreeSet<PathBuf>) {
    guarded(|| Ok(work())).unwrap_or_else(|e| (Err(Fault::new(&e)), BTreeSet::from([scene.to_path_buf()])))
}

/// Digests of files, kept as long as their stamps stay.
#[derive(Debug, Default)]
pub struct Digests {
    known: BTreeMap<PathBuf, (Stamp, Content)>,
    /// Nothing is read any more, and what is found from then on is not to be believed.
    pub ending: Arc<AtomicBool>,
}

impl Digests {
    /// Nothing large is read any more once somebody asks for the end.
    pub fn until(ending: Arc<AtomicBool>) -> Self {
        Self { known: BTreeMap::new(), ending }
    }

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
        let content = Content::read_by(path, &meta, |path, length| digest(path, length, &self.ending));
        // A file that changed while it was read has another stamp now, and is read again.
        self.known.insert(path.to_path_buf(), (stamp, content));
        content
    }

    /// The file has another length than it had when it was read last: another content, which need not be read.
    pub fn is_of_other_length(&self, path: &Path) -> bool {
        let read = self.known.get(path).filter(|(_, content)| content.is_read());
        read.is_some_and(|(stamp, _)| std::fs::metadata(path).is_ok_and(|meta| meta.len() != stamp.length))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::sky;
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
    fn a_panic_is_the_fault_of_its_scene() {
        let folder = folder(&[("s.gltf", SCENE)]);
        let scene = folder.path().join("s.gltf");
        let choices = Choices { config: None, flags: Layer::new(Origin::CommandLine) };
        let (settings, files) = read(&scene, &choices);
        assert!(settings.is_ok() && files == named(&scene) && files.len() == 3);
        let empty: Vec<u8> = Vec::new();
        let (fault, files) = guarded_read(&scene, || (Ok(empty[scene.as_os_str().len()]), BTreeSet::new()));
        let error = fault.unwrap_err().error;
        assert!(error.contains("internal error") && files == BTreeSet::from([scene]), "{error}");
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
        assert!(digests.of(&path) == truth && !digests.is_of_other_length(&path));
        std::fs::write(&path, "two").unwrap();
        assert!(!digests.is_of_other_length(&path), "another content, perhaps");
        std::fs::write(&path, "three").unwrap();
        assert!(digests.is_of_other_length(&path));
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
