//! How much lies in a store, and whether it is what it says. Nothing is changed by looking.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use luxel_scene::Progress;

use super::list::{FULL_FOLDER, Held, Listing, StoreError};
use super::{Key, Kind, Miss, Store, file};

/// A number of files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    pub files: u64,
    /// Their lengths, headers included.
    pub bytes: u64,
    /// The longest unused one was used at this time.
    pub oldest: Option<SystemTime>,
    /// The last use of any.
    pub newest: Option<SystemTime>,
}

impl Usage {
    pub(super) fn add(&mut self, held: &Held) {
        self.files += 1;
        self.bytes += held.bytes;
        self.oldest = Some(self.oldest.map_or(held.used, |time| time.min(held.used)));
        self.newest = Some(self.newest.map_or(held.used, |time| time.max(held.used)));
    }

    pub(super) fn of<'a>(held: impl IntoIterator<Item = &'a Held>) -> Self {
        let mut usage = Self::default();
        held.into_iter().for_each(|held| usage.add(held));
        usage
    }
}

/// What a store holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stat {
    /// Artefacts of all kinds.
    pub total: Usage,
    /// Artefacts, by kinds of which there are any.
    pub kinds: BTreeMap<Kind, Usage>,
    /// Files that are being written, or were when their writer was killed.
    pub leftovers: Usage,
    /// Octrees of earlier versions of luxel.
    pub old: Usage,
}

/// A file, and what is wrong with it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bad {
    pub path: PathBuf,
    pub why: String,
}

/// What became of looking into every file.
#[derive(Debug, Default)]
pub struct Verified {
    /// Artefacts that are what they say.
    pub sound: Usage,
    /// Artefacts in the format of an earlier or later luxel: no fault, and of no use to this one.
    pub outdated: Vec<Bad>,
    /// Torn, damaged, foreign or unreadable ones.
    pub bad: Vec<Bad>,
}

/// What one artefact turns out to be.
pub(super) enum Verdict {
    Sound,
    Earlier(String),
    /// Of a format that is not known yet.
    Later(String),
    Bad(String),
    /// Removed since it was listed.
    Gone,
}

pub(super) fn judge(kind: Kind, key: &Key, held: &Held) -> Verdict {
    match file::verify(&held.path, kind.format(), key) {
        Ok(_) => Verdict::Sound,
        Err(Miss::Absent) if std::fs::symlink_metadata(&held.path).is_err() => Verdict::Gone,
        Err(miss @ Miss::Outdated { found, expected }) if found > expected => Verdict::Later(miss.to_string()),
        Err(miss @ Miss::Outdated { .. }) => Verdict::Earlier(miss.to_string()),
        Err(miss) if held.is_folder && has_content(&held.path) => Verdict::Bad(format!("{miss}: {FULL_FOLDER}")),
        Err(miss) => Verdict::Bad(miss.to_string()),
    }
}

/// Whether something lies in a folder, or may, where nobody can look into it.
fn has_content(folder: &Path) -> bool {
    std::fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_some())
}

impl Store {
    /// How much there is; nothing where there is no folder.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn stat(&self) -> Result<Stat, StoreError> {
        let Listing { artefacts, leftovers, old } = Listing::new(&self.folder)?;
        let mut stat = Stat { leftovers: Usage::of(&leftovers), old: Usage::of(&old), ..Stat::default() };
        for (kind, _, held) in &artefacts {
            stat.total.add(held);
            stat.kinds.entry(*kind).or_default().add(held);
        }
        Ok(stat)
    }

    /// Reads every artefact and says which are not what they should be. It removes nothing, so that it can be run on a
    /// store that others use or that may only be read; [`Store::gc`] removes what is bad.
    ///
    /// # Errors
    /// The folder cannot be listed, or it was cancelled.
    pub fn verify(&self, progress: &dyn Progress) -> Result<Verified, StoreError> {
        let mut artefacts = Listing::new(&self.folder)?.artefacts;
        artefacts.sort_by(|(_, _, a), (_, _, b)| a.path.cmp(&b.path));
        progress.begin("verify", artefacts.iter().map(|(_, _, held)| held.bytes).sum());
        let mut verified = Verified::default();
        for (kind, key, held) in artefacts {
            progress.check()?;
            let told = |why| Bad { path: held.path.clone(), why };
            match judge(kind, &key, &held) {
                Verdict::Sound => verified.sound.add(&held),
                Verdict::Earlier(why) | Verdict::Later(why) => verified.outdated.push(told(why)),
                Verdict::Bad(why) => verified.bad.push(told(why)),
                Verdict::Gone => {}
            }
            progress.advance(held.bytes);
        }
        Ok(verified)
    }
}
