//! What lies in a store's folder.
//!
//! Only what bears a name that luxel gives is seen at all: a store may be a folder in which other things lie too, and
//! nothing else in it is ever counted, read or removed.

use std::fs::{self, DirEntry, File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::file::TEMPORARY;
use super::{Key, Kind, OCTREE};

/// The suffix of the one file per scene that earlier versions kept here.
const OLD_SUFFIX: &str = "octree";

/// Why a store could not be looked through.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("cannot look through the store's folder {path}")]
    Folder { path: PathBuf, source: io::Error },
    #[error("{path} does not say how much the store may hold ({why}), so nothing of it is evicted: give its cap anew")]
    Cap { path: PathBuf, why: String },
    #[error("the cap of the store cannot be kept in {path}")]
    KeepCap { path: PathBuf, source: io::Error },
    #[error("cancelled")]
    Cancelled(#[from] luxel_scene::Cancelled),
}

/// A file as it was when the folder was listed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    pub path: PathBuf,
    /// Its length, header included.
    pub bytes: u64,
    /// When it was last used or written.
    pub used: SystemTime,
    /// A folder in the place of a file.
    pub is_folder: bool,
}

impl Held {
    fn new(path: PathBuf, meta: &Metadata) -> io::Result<Self> {
        let is_folder = meta.is_dir();
        let bytes = if is_folder { 0 } else { meta.len() };
        Ok(Self { path, bytes, used: meta.modified()?, is_folder })
    }

    /// How long it has not been used. A time in the future is none of use, so it counts by its distance too.
    pub fn age(&self, now: SystemTime) -> Duration {
        now.duration_since(self.used).unwrap_or_else(|early| early.duration())
    }

    /// Removes it, unless somebody has used or replaced it since it was listed; returns whether it is gone. A folder goes
    /// only if it is empty: what lies in one is not luxel's.
    pub fn remove(&self) -> io::Result<bool> {
        let removed = fs::symlink_metadata(&self.path).and_then(|meta| {
            let is_same = Self::new(self.path.clone(), &meta)? == *self;
            match (is_same, self.is_folder) {
                (false, _) => Ok(false),
                (true, true) => remove_folder(&self.path).map(|()| true),
                (true, false) => fs::remove_file(&self.path).map(|()| true),
            }
        });
        match removed {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(true),
            removed => removed,
        }
    }
}

/// Removes an empty folder.
fn remove_folder(path: &Path) -> io::Result<()> {
    fs::remove_dir(path).map_err(|error| match error.kind() {
        io::ErrorKind::DirectoryNotEmpty => io::Error::new(error.kind(), FULL_FOLDER),
        _ => error,
    })
}

/// What stands in the way of removing a folder.
pub const FULL_FOLDER: &str = "it is a folder with something in it; remove this folder yourself";

/// The files of a store.
#[derive(Debug, Default)]
pub struct Listing {
    pub artefacts: Vec<(Kind, Key, Held)>,
    /// Files that are being written, or that killed writers left.
    pub leftovers: Vec<Held>,
    /// Of earlier versions of luxel, which kept one octree per scene.
    pub old: Vec<Held>,
}

impl Listing {
    /// Everything in a store; nothing where there is no such folder. What vanishes meanwhile is passed over.
    pub fn new(folder: &Path) -> Result<Self, StoreError> {
        let mut listing = Self::default();
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| StoreError::Folder { path, source }
        };
        each(folder, |held| listing.root(held)).map_err(failed(folder))?;
        for kind in Kind::ALL {
            let below = folder.join(kind.name());
            each(&below, |held| listing.artefact(kind, held)).map_err(failed(&below))?;
        }
        Ok(listing)
    }

    fn root(&mut self, held: Held) {
        if held.is_folder {
            return;
        }
        if is_temporary(&held.path) {
            self.leftovers.push(held);
        } else if held.path.extension().is_some_and(|e| e == OLD_SUFFIX) && is_old(&held.path) {
            self.old.push(held);
        }
    }

    fn artefact(&mut self, kind: Kind, held: Held) {
        if let Some(key) = key(&held.path) {
            self.artefacts.push((kind, key, held));
        } else if is_temporary(&held.path) && !held.is_folder {
            self.leftovers.push(held);
        }
    }
}

/// Looks at everything in a folder, if there is one.
fn each(folder: &Path, mut look: impl FnMut(Held)) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        // A file may lie where the folder would: then nothing is stored there.
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let held = entry.and_then(|entry: DirEntry| Held::new(entry.path(), &entry.metadata()?));
        match held {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            held => look(held?),
        }
    }
    Ok(())
}

/// The key that a file's name states.
fn key(path: &Path) -> Option<Key> {
    let name = path.file_name()?.to_str()?;
    // Upper case is read too but never written, and such a file would never be found.
    let hash = blake3::Hash::from_hex(name).ok()?;
    (hash.to_hex().as_str() == name).then_some(*hash.as_bytes())
}

fn is_temporary(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.starts_with(TEMPORARY.0) && name.ends_with(TEMPORARY.1))
}

/// Whether a file is an octree of an earlier version: others may end their names so too.
fn is_old(path: &Path) -> bool {
    let mut magic = [0; OCTREE.magic.len()];
    let is_file = fs::symlink_metadata(path).is_ok_and(|meta| meta.is_file());
    is_file && File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == OCTREE.magic
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use std::io::Write;

    #[test]
    fn only_what_luxel_names_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        assert!(Listing::new(&at("none")).unwrap().artefacts.is_empty());
        let store = Store::new(folder.path());
        store.put(Kind::Sky, &[1; 32], |out| out.write_all(b"blue")).unwrap();
        let hex = "ab".repeat(32);
        fs::create_dir_all(at("other")).unwrap();
        fs::create_dir_all(at("gather").join(&hex)).unwrap();
        for name in [
            "notes.txt",
            ".luxel-Ab12Cd.tmp",
            "sky/.luxel-x.tmp",
            "sky/readme",
            "a.octree",
            "b.octree",
            "c.tmp",
            "sky/c.tmp",
        ] {
            fs::write(at(name), "mine").unwrap();
        }
        fs::write(at("other").join(&hex), "mine").unwrap();
        fs::write(at("sky").join(hex.to_uppercase()), "mine").unwrap();
        fs::write(at("b.octree"), "luxelOct and more").unwrap();
        let Listing { artefacts, mut leftovers, old } = Listing::new(folder.path()).unwrap();
        let found: Vec<_> = artefacts.iter().map(|(kind, key, held)| (*kind, key[0], held.is_folder)).collect();
        assert_eq!(found, [(Kind::Sky, 1, false), (Kind::Gather, 0xab, true)]);
        leftovers.sort_by(|a, b| a.path.cmp(&b.path));
        let paths: Vec<_> = leftovers.into_iter().chain(old).map(|held| held.path).collect();
        assert_eq!(paths, [at(".luxel-Ab12Cd.tmp"), at("sky/.luxel-x.tmp"), at("b.octree")]);
    }

    #[test]
    fn the_names_of_leftovers_are_those_of_files_that_are_being_written() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path());
        store.put(Kind::Sky, &[1; 32], |out| {
            let listing = Listing::new(folder.path()).unwrap();
            assert_eq!((listing.artefacts.len(), listing.leftovers.len()), (0, 1));
            out.write_all(b"blue")
        });
        let listing = Listing::new(folder.path()).unwrap();
        assert_eq!((listing.artefacts.len(), listing.leftovers.len()), (1, 0));
    }

    #[test]
    fn a_file_that_was_used_since_it_was_listed_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "a").unwrap();
        let then = SystemTime::now() - Duration::from_secs(5);
        File::options().write(true).open(&path).unwrap().set_modified(then).unwrap();
        let listed = || Held::new(path.clone(), &fs::symlink_metadata(&path).unwrap()).unwrap();
        let held = listed();
        assert_eq!(held.age(then + Duration::from_secs(7)), Duration::from_secs(7));
        assert_eq!(held.age(then - Duration::from_secs(7)), Duration::from_secs(7));
        super::super::mark(&path);
        assert!(!held.remove().unwrap() && path.exists());
        assert!(listed().remove().unwrap() && !path.exists());
        assert!(held.remove().unwrap(), "another process was faster");
    }
}
