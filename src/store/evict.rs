//! What leaves a store: the least recently used artefacts, and what killed bakes left.
//!
//! A bake that ends evicts down to its cap, oldest use first, and spares
//! - what it has used itself, whatever that holds;
//! - what anybody has used within [`GRACE`], so that bakes that run at the same time do not take each other's artefacts
//!   away, as long as the store is below twice the cap: then the oldest of these go too, until it is below that.
//!
//! So two bakes whose artefacts fit twice the cap do not disturb each other, and a store never stays above twice the
//! cap plus what a running bake uses. [`Store::gc`] is asked for by a person and spares nothing of this.
//!
//! Temporary files are removed by their age alone: a younger one than [`LEFTOVER_AGE`] may be somebody's who is writing.

use std::cmp::Reverse;
use std::io;
use std::path::Path;
use std::time::{Duration, SystemTime};

use luxel_scene::Progress;

use super::list::{Held, Listing, StoreError};
use super::survey::{Bad, Usage, Verdict, judge};
use super::{Key, Kind, Store};

/// What was used within this time is spared, up to twice the cap.
pub const GRACE: Duration = Duration::from_secs(3600);

/// Temporary files that nobody has written to for this time were left by a bake that was killed.
pub const LEFTOVER_AGE: Duration = Duration::from_secs(3600);

/// What [`Store::gc`] has done.
#[derive(Debug, Default)]
pub struct Collected {
    /// Least recently used artefacts.
    pub evicted: Usage,
    /// Artefacts that did not verify.
    pub bad: Usage,
    /// Artefacts of earlier formats, and octrees of earlier versions of luxel.
    pub outdated: Usage,
    /// Temporary files of killed bakes.
    pub leftovers: Usage,
    /// What is left in the store, artefacts alone.
    pub left: Usage,
    /// What could not be removed, and why.
    pub failed: Vec<Bad>,
}

impl Collected {
    /// Removes a file and counts it; returns whether it is gone.
    fn remove(&mut self, held: &Held, count: impl FnOnce(&mut Self) -> &mut Usage) -> bool {
        match held.remove() {
            Ok(true) => count(self).add(held),
            Ok(false) => return false,
            Err(error) => {
                self.failed.push(Bad { path: held.path.clone(), why: error.to_string() });
                return false;
            }
        }
        true
    }
}

impl Store {
    /// Makes the store smaller than its cap where it is not, by the rule above, and removes what killed bakes left. What
    /// stands in the way is noted; nobody else's file that vanishes meanwhile is missed.
    pub fn evict(&self) {
        let evicted = Listing::new(&self.folder).map_err(|error| match error {
            StoreError::Folder { path, source } => format!("{}: {source}", path.display()),
            error => error.to_string(),
        });
        if let Err(why) = evicted.and_then(|listing| self.shrink(listing)) {
            self.note(|notes| notes.oversized(&self.folder, &why));
        }
    }

    fn shrink(&self, listing: Listing) -> Result<(), String> {
        let mut total: u64 = listing.artefacts.iter().map(|(_, _, held)| held.bytes).sum();
        if total <= self.cap && listing.leftovers.is_empty() {
            return Ok(());
        }
        let now = match clock(&self.folder) {
            // A store that may only be read is somebody else's to keep small, as long as it is.
            Err(_) if total <= self.cap => return Ok(()),
            now => now.map_err(|error| format!("nothing can be removed from it: {error}"))?,
        };
        let mut failure = None;
        for held in listing.leftovers.iter().filter(|held| held.age(now) > LEFTOVER_AGE) {
            failure = held.remove().err().or(failure);
        }
        let mut artefacts = listing.artefacts;
        artefacts.retain(|(kind, key, held)| !held.is_folder && !self.is_used(*kind, key));
        oldest_first(&mut artefacts, now);
        for (_, _, held) in artefacts {
            let is_recent = held.age(now) < GRACE;
            if total <= self.cap || (is_recent && total <= self.cap.saturating_mul(2)) {
                break;
            }
            match held.remove() {
                Ok(true) => total -= held.bytes,
                Ok(false) => {}
                Err(error) => failure = Some(error),
            }
        }
        failure.map_or(Ok(()), |error| Err(format!("nothing can be removed from it: {error}")))
    }

    /// Removes what is of no use any more: artefacts that do not verify or have an earlier format, those that nobody has
    /// used for the time `older`, the least recently used ones beyond `cap` [bytes], temporary files of killed bakes, and
    /// octrees of earlier versions. Artefacts of a later luxel's formats stay until their turn comes by age.
    ///
    /// # Errors
    /// The folder cannot be listed or written, or it was cancelled; what was removed by then is gone.
    pub fn gc(&self, cap: u64, older: Option<Duration>, progress: &dyn Progress) -> Result<Collected, StoreError> {
        let mut done = Collected::default();
        let Listing { mut artefacts, leftovers, old } = Listing::new(&self.folder)?;
        if artefacts.is_empty() && leftovers.is_empty() && old.is_empty() {
            return Ok(done);
        }
        let failed = |source| StoreError::Folder { path: self.folder.clone(), source };
        let now = clock(&self.folder).map_err(failed)?;
        for held in leftovers.iter().filter(|held| held.age(now) > LEFTOVER_AGE) {
            done.remove(held, |done| &mut done.leftovers);
        }
        for held in &old {
            done.remove(held, |done| &mut done.outdated);
        }
        oldest_first(&mut artefacts, now);
        if let Some(older) = older {
            artefacts.retain(|(_, _, held)| held.age(now) <= older || !done.remove(held, |done| &mut done.evicted));
        }
        artefacts = sound(artefacts, &mut done, progress)?;
        let mut total: u64 = artefacts.iter().map(|(_, _, held)| held.bytes).sum();
        for (_, _, held) in &artefacts {
            if total > cap && done.remove(held, |done| &mut done.evicted) {
                total -= held.bytes;
            } else {
                done.left.add(held);
            }
        }
        Ok(done)
    }
}

/// The artefacts that are worth keeping; the others are removed.
fn sound(
    artefacts: Vec<(Kind, Key, Held)>,
    done: &mut Collected,
    progress: &dyn Progress,
) -> Result<Vec<(Kind, Key, Held)>, StoreError> {
    progress.begin("verify", artefacts.iter().map(|(_, _, held)| held.bytes).sum());
    let mut kept = Vec::new();
    for (kind, key, held) in artefacts {
        progress.check()?;
        let is_gone = match judge(kind, &key, &held) {
            Verdict::Sound | Verdict::Later(_) => false,
            Verdict::Gone => true,
            Verdict::Earlier(_) => done.remove(&held, |done| &mut done.outdated),
            Verdict::Bad(_) => done.remove(&held, |done| &mut done.bad),
        };
        progress.advance(held.bytes);
        if !is_gone {
            kept.push((kind, key, held));
        }
    }
    Ok(kept)
}

/// In the order in which they go; where times are equal, by name.
fn oldest_first(artefacts: &mut [(Kind, Key, Held)], now: SystemTime) {
    artefacts.sort_by(|(_, _, a), (_, _, b)| (Reverse(a.age(now)), &a.path).cmp(&(Reverse(b.age(now)), &b.path)));
}

/// The time by the disk that holds a folder, as the times of its files are; an error where nothing can be changed there.
fn clock(folder: &Path) -> io::Result<SystemTime> {
    tempfile::tempfile_in(folder)?.metadata()?.modified()
}
