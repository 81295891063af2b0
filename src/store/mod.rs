//! The store: artefacts of stages under the key of everything that they follow from.
//!
//! `<folder>/<kind>/<64 hex digits of the key>` is one artefact, a checked file (see [`file`]). The folder is `.luxel`
//! beside the outputs, or one that many scenes, processes and machines share. `<folder>/cap` says how much it may hold.
//!
//! | module | what it does |
//! |---|---|
//! | [`file`] | one file that proves what it is before anything in it is believed |
//! | `kind` | the kinds of artefacts |
//! | `notes` | what went wrong, each once, for the report |
//! | `list` | what lies in the folder |
//! | `cap` | how much it may hold, which the store itself knows |
//! | `evict` | which of it goes: the least recently used, and what killed bakes left |
//! | `survey` | how much there is, and whether it verifies |
//! | `find` | the stores of scenes and folders |
//!
//! **A store never stands in the way of a bake.** Whatever does not verify is a miss, is noted once and made anew;
//! what cannot be written is noted and costs reuse alone.
//!
//! **Sharing.** There are no locks. A file is written under a name of its own, flushed to the disk and renamed, so a
//! reader sees the old one or the new one, and two writers of one key write the same content. One that is removed while
//! it is read stays readable to its reader or is a miss. Ages are counted by the clock of the disk that holds the store:
//! machines need not agree on the time.
//!
//! **Recency.** The modification time of a file is when it was last used: every hit sets it where it may be set.
//!
//! **Bodies are not compressed.** zstd at level 1 leaves 47 % of a level's octree and 72 % of irradiance at texels, packs
//! 0.2 GB/s and unpacks 0.6 to 0.9 GB/s on a core, where a plain body is read and verified at 1 to 2 GB/s. After an edit
//! somebody waits for that, and a store that is too large for its disk has its cap.
//!
//! **Trust.** A checksum tells damage, not malice. Decoders withstand any bytes, but whoever may write to a store may
//! change what light others bake from it.

mod cap;
mod evict;
pub mod file;
mod find;
mod kind;
mod list;
mod notes;
mod survey;

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

pub use cap::CAP_FILE;
pub use evict::{Collected, GRACE, LEFTOVER_AGE, sweep};
pub(crate) use file::TEMPORARY;
pub use file::{Format, Key, Miss, OCTREE, Reader, Writer, read, write};
pub use find::find;
pub use kind::Kind;
pub use list::StoreError;
pub use survey::{Bad, Stat, Usage, Verified};

use notes::Notes;

/// How much a store may hold for which nobody has ever asked for something else [bytes].
pub const DEFAULT_CAP: u64 = 4 << 30;

/// The name of a store's folder beside outputs.
pub const FOLDER: &str = ".luxel";

/// Which store a bake uses.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StoreOptions {
    /// One of its own instead of the one beside the outputs.
    pub folder: Option<PathBuf>,
    /// How much it may hold when the bake is over [bytes], which it keeps for later bakes; none: what was kept, or
    /// [`DEFAULT_CAP`].
    pub cap: Option<u64>,
}

impl StoreOptions {
    /// The store of a bake whose outputs go to the folder `outputs`.
    pub fn open(&self, outputs: &Path) -> Store {
        let store = Store::new(self.folder.clone().unwrap_or_else(|| outputs.join(FOLDER)));
        Store { cap: self.cap, ..store }
    }
}

/// A folder of artefacts. Nothing is created until something is put.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    /// What was asked for.
    cap: Option<u64>,
    notes: Mutex<Notes>,
    /// What was put, found or named through this object: not evicted by it.
    used: Mutex<BTreeSet<(Kind, Key)>>,
}

impl Store {
    /// The store in this folder, which need not exist, with the cap that it keeps.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), cap: None, notes: Mutex::default(), used: Mutex::default() }
    }

    /// With another cap [bytes], for as long as this object lives; [`Store::keep_cap`] keeps it.
    pub fn with_cap(self, cap: u64) -> Self {
        Self { cap: Some(cap), ..self }
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where an artefact lies.
    pub fn path(&self, kind: Kind, key: &Key) -> PathBuf {
        self.folder.join(kind.name()).join(blake3::Hash::from_bytes(*key).to_hex().as_str())
    }

    /// What `decode` makes of an artefact, verified; None is a miss.
    ///
    /// That there is none is silent. Anything torn, foreign, outdated, damaged or unreadable is noted once, with its
    /// file. The decoder sees bytes that are not verified yet, reads all of them, and bounds what it allocates by
    /// [`Reader::left`].
    pub fn get<T>(&self, kind: Kind, key: &Key, decode: impl FnOnce(&mut Reader) -> Result<T, String>) -> Option<T> {
        let path = self.path(kind, key);
        match file::read(&path, kind.format(), key, decode) {
            Ok(content) => {
                self.was_used(kind, key);
                mark(&path);
                Some(content)
            }
            Err(Miss::Absent) => None,
            Err(miss) => {
                self.note(|notes| notes.missed(&path, &miss));
                None
            }
        }
    }

    /// Whether there is such an artefact: reads and verifies the whole file, decodes and notes nothing, and leaves the
    /// time of its last use alone.
    pub fn has(&self, kind: Kind, key: &Key) -> bool {
        let is_there = file::verify(&self.path(kind, key), kind.format(), key).is_ok();
        if is_there {
            self.was_used(kind, key);
        }
        is_there
    }

    /// Says that an artefact is in use although it was not read, as those are from which a reused one was made: the next
    /// edit may need them. Nothing is read, and one that is not there is none.
    pub fn touch(&self, kind: Kind, key: &Key) {
        self.was_used(kind, key);
        mark(&self.path(kind, key));
    }

    /// Writes an artefact, whole or not at all; returns the length of its body [bytes], None where it could not be
    /// written, which is noted and costs nothing but reuse.
    pub fn put(&self, kind: Kind, key: &Key, fill: impl FnOnce(&mut Writer) -> io::Result<()>) -> Option<u64> {
        let path = self.path(kind, key);
        match file::write(&path, kind.format(), key, fill) {
            Ok(bytes) => {
                self.was_used(kind, key);
                Some(bytes)
            }
            Err(error) => {
                self.note(|notes| notes.unwritten(&path, &error));
                None
            }
        }
    }

    /// What went wrong since the last call, in words for a person that name the files.
    pub fn take_notes(&self) -> Vec<String> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn note(&self, say: impl FnOnce(&mut Notes)) {
        say(&mut self.notes.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn was_used(&self, kind: Kind, key: &Key) {
        self.used.lock().unwrap_or_else(PoisonError::into_inner).insert((kind, *key));
    }

    fn is_used(&self, kind: Kind, key: &Key) -> bool {
        self.used.lock().unwrap_or_else(PoisonError::into_inner).contains(&(kind, *key))
    }
}

/// Sets the time of a file's last use. In a store that may only be read nothing is recorded, and nothing lost by it.
#[cfg(unix)]
fn mark(path: &Path) {
    use rustix::fs::{AtFlags, CWD, Timespec, Timestamps, UTIME_NOW, utimensat};
    // The clock is that of the file system.
    let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
    let _not_recorded =
        utimensat(CWD, path, &Timestamps { last_access: now, last_modification: now }, AtFlags::empty());
}

/// Sets the time of a file's last use. In a store that may only be read nothing is recorded, and nothing lost by it.
#[cfg(not(unix))]
fn mark(path: &Path) {
    let opened = std::fs::File::options().write(true).open(path);
    drop(opened.and_then(|file| file.set_modified(std::time::SystemTime::now())));
}
