//! What leaves a store: the least recently used artefacts, and what killed bakes left.
//!
//! A bake that ends, well or not, evicts down to the store's cap, oldest use first, and spares
//! - what it has used itself, whatever that holds;
//! - what anybody has used within [`GRACE`], so that bakes that run at the same time do not take each other's artefacts
//!   away, as long as the store is below twice the cap: then the oldest of these go too, until it is below that.
//!
//! So two bakes whose artefacts fit twice the cap do not disturb each other, and a store never stays above twice the
//! cap plus what a running bake uses. [`Store::gc`] is asked for by a person and spares nothing of this.
//!
//! Temporary files are removed by their age alone: a younger one than [`LEFTOVER_AGE`] may be somebody's who is writing.

use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
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

/// A collection that is under way.
#[derive(Default)]
struct Collector {
    done: Collected,
    /// What could not be removed once, and is not tried again.
    stuck: BTreeSet<PathBuf>,
}

impl Collector {
    /// Removes a file and counts it; returns whether it is gone.
    fn remove(&mut self, held: &Held, count: impl FnOnce(&mut Collected) -> &mut Usage) -> bool {
        if self.stuck.contains(&held.path) {
            return false;
        }
        match held.remove() {
            Ok(true) => count(&mut self.done).add(held),
            Ok(false) => return false,
            Err(error) => {
                self.stuck.insert(held.path.clone());
                self.done.failed.push(Bad { path: held.path.clone(), why: error.to_string() });
                return false;
            }
        }
        true
    }
}

/// Removes temporary files of killed bakes from a folder of outputs, where they have the same names as in a store. One
/// that cannot be removed stays: it takes part in nothing, and the next bake tries again.
pub fn sweep(folder: &Path) {
    let leftovers = Listing::new(folder).map(|listing| listing.leftovers).unwrap_or_default();
    if leftovers.is_empty() {
        return;
    }
    let Ok(now) = clock(folder) else { return };
    for held in leftovers.iter().filter(|held| held.age(now) > LEFTOVER_AGE) {
        let _stays = held.remove();
    }
}

impl Store {
    /// Makes the store smaller than its cap where it is not, by the rule above, and removes what killed bakes left. What
    /// stands in the way is noted; nobody else's file that vanishes meanwhile is missed.
    pub fn evict(&self) {
        let known = Listing::new(&self.folder).and_then(|listing| Ok((listing, self.cap()?)));
        let known = known.map_err(|error| match error {
            StoreError::Folder { path, source } => format!("{}: {source}", path.display()),
            error => error.to_string(),
        });
        if let Err(why) = known.and_then(|(listing, cap)| self.shrink(listing, cap)) {
            self.note(|notes| notes.oversized(&self.folder, &why));
        }
    }

    fn shrink(&self, listing: Listing, cap: u64) -> Result<(), String> {
        let mut total: u64 = listing.artefacts.iter().map(|(_, _, held)| held.bytes).sum();
        if total <= cap && listing.leftovers.is_empty() {
            return Ok(());
        }
        let now = match clock(&self.folder) {
            // A store that may only be read is somebody else's to keep small, as long as it is.
            Err(_) if total <= cap => return Ok(()),
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
            if total <= cap || (is_recent && total <= cap.saturating_mul(2)) {
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
        let mut done = Collector::default();
        let Listing { mut artefacts, leftovers, old } = Listing::new(&self.folder)?;
        if artefacts.is_empty() && leftovers.is_empty() && old.is_empty() {
            return Ok(done.done);
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
                done.done.left.add(held);
            }
        }
        Ok(done.done)
    }
}

/// The artefacts that are worth keeping; the others are removed.
fn sound(
    artefacts: Vec<(Kind, Key, Held)>,
    done: &mut Collector,
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

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::{Silent, Unwanted};
    use std::fs::{self, File};
    use std::io::Write;

    /// Length of the files of these tests, header included.
    const FILE: u64 = 1000;

    struct Bench {
        folder: tempfile::TempDir,
    }

    impl Bench {
        /// A store of artefacts that were last used so many minutes ago, under keys in this order.
        fn new(minutes: &[u64]) -> Self {
            let bench = Self { folder: tempfile::tempdir().unwrap() };
            let store = bench.store(u64::MAX);
            for (i, ago) in minutes.iter().enumerate() {
                store.put(Kind::Gather, &[i as u8; 32], |out| out.write_all(&[i as u8; FILE as usize - 84])).unwrap();
                set_age(&store.path(Kind::Gather, &[i as u8; 32]), *ago);
            }
            bench
        }

        /// As another process has it.
        fn store(&self, cap: u64) -> Store {
            Store::new(self.folder.path()).with_cap(cap)
        }

        fn left(&self) -> Vec<u8> {
            let mut keys: Vec<_> =
                Listing::new(self.folder.path()).unwrap().artefacts.iter().map(|(_, key, _)| key[0]).collect();
            keys.sort_unstable();
            keys
        }

        fn evicted(&self, cap: u64) -> Vec<u8> {
            let store = self.store(cap);
            store.evict();
            assert_eq!(store.take_notes(), [""; 0]);
            self.left()
        }
    }

    fn set_age(path: &Path, minutes: u64) {
        let then = SystemTime::now() - Duration::from_secs(60 * minutes);
        File::options().write(true).open(path).unwrap().set_modified(then).unwrap();
    }

    fn read(store: &Store, key: u8) -> bool {
        store
            .get(Kind::Gather, &[key; 32], |body| std::io::copy(body, &mut std::io::sink()).map_err(|e| e.to_string()))
            .is_some()
    }

    #[test]
    fn the_longest_unused_go_first_and_no_more_than_have_to() {
        let bench = Bench::new(&[300, 500, 100, 400, 200]);
        assert_eq!(bench.evicted(5 * FILE), [0, 1, 2, 3, 4]);
        assert_eq!(bench.evicted(5 * FILE - 1), [0, 2, 3, 4]);
        assert!(read(&bench.store(0), 3), "a use");
        assert_eq!(bench.evicted(2 * FILE + FILE / 2), [2, 3]);
    }

    #[test]
    fn what_anybody_has_used_within_the_hour_stays_below_twice_the_cap() {
        let bench = Bench::new(&[90, 50, 40, 30, 20, 10]);
        assert_eq!(bench.evicted(3 * FILE), [1, 2, 3, 4, 5]);
        assert_eq!(bench.evicted(2 * FILE), [2, 3, 4, 5]);
        assert_eq!(bench.evicted(0), [0u8; 0]);
    }

    #[test]
    fn what_a_store_has_used_itself_stays_whatever_it_holds() {
        let bench = Bench::new(&[500, 400, 300, 200]);
        let store = bench.store(0);
        assert!(read(&store, 1) && store.has(Kind::Gather, &[2; 32]));
        store.touch(Kind::Gather, &[0; 32]);
        store.put(Kind::Sky, &[9; 32], |out| out.write_all(b"blue")).unwrap();
        store.evict();
        assert_eq!(bench.left(), [0, 1, 2, 9]);
        // Looking whether something is there is no use of it, saying so is.
        assert_eq!(bench.evicted(3 * FILE), [0, 1, 9]);
        assert_eq!(bench.evicted(0), [0u8; 0]);
    }

    #[test]
    fn a_time_in_the_future_does_not_keep_a_file_for_ever() {
        let bench = Bench::new(&[100, 200, 300]);
        let far = SystemTime::now() + Duration::from_secs(1 << 20);
        let path = bench.store(0).path(Kind::Gather, &[1; 32]);
        File::options().write(true).open(path).unwrap().set_modified(far).unwrap();
        assert_eq!(bench.evicted(2 * FILE), [0, 2]);
    }

    #[test]
    fn only_old_leftovers_go() {
        let bench = Bench::new(&[0]);
        let at = |name: &str| bench.folder.path().join(name);
        for (name, ago) in [(".luxel-a.tmp", 61), ("gather/.luxel-b.tmp", 61), ("gather/.luxel-c.tmp", 58)] {
            fs::write(at(name), "half an arte").unwrap();
            set_age(&at(name), ago);
        }
        fs::write(at("gather/mine.tmp"), "mine").unwrap();
        set_age(&at("gather/mine.tmp"), 10_000);
        assert_eq!(bench.evicted(u64::MAX), [0]);
        let stays = |name: &str| at(name).exists();
        assert!(!stays(".luxel-a.tmp") && !stays("gather/.luxel-b.tmp"));
        assert!(stays("gather/.luxel-c.tmp") && stays("gather/mine.tmp"));
        let collected = bench.store(0).gc(u64::MAX, None, &Silent).unwrap();
        assert!(collected.leftovers.files == 0 && stays("gather/.luxel-c.tmp"));
        set_age(&at("gather/.luxel-c.tmp"), 61);
        let collected = bench.store(0).gc(u64::MAX, None, &Silent).unwrap();
        assert!(collected.leftovers.files == 1 && !stays("gather/.luxel-c.tmp") && stays("gather/mine.tmp"));
    }

    #[test]
    fn gc_removes_what_is_of_no_use_and_tells_why() {
        let bench = Bench::new(&[100, 90, 80, 70, 5000, 60, 50]);
        let store = bench.store(0);
        let path = |key: u8| store.path(Kind::Gather, &[key; 32]);
        let patch = |key: u8, at: usize, byte: u8| {
            let mut bytes = fs::read(path(key)).unwrap();
            bytes[at] = byte;
            fs::write(path(key), bytes).unwrap();
        };
        patch(0, 500, 77);
        patch(1, 8, 0);
        patch(2, 8, 255);
        fs::write(bench.folder.path().join("level.octree"), "luxelOct, and its tree").unwrap();
        let verified = store.verify(&Silent).unwrap();
        let names = |list: &[Bad]| list.iter().map(|bad| bad.path.clone()).collect::<Vec<_>>();
        assert_eq!((verified.sound.files, names(&verified.bad)), (4, vec![path(0)]));
        assert_eq!(names(&verified.outdated), [path(1), path(2)]);
        let stat = store.stat().unwrap();
        assert_eq!((stat.total.files, stat.total.bytes, stat.old.files), (7, 7 * FILE, 1));
        assert_eq!(stat.kinds.keys().collect::<Vec<_>>(), [&Kind::Gather]);

        let done = store.gc(3 * FILE, Some(Duration::from_secs(3600 * 24)), &Silent).unwrap();
        // Written anew, the file of a later format is the youngest.
        assert_eq!(bench.left(), [2, 5, 6]);
        let counted = [done.evicted, done.bad, done.outdated, done.leftovers, done.left].map(|usage| usage.files);
        assert_eq!((counted, done.failed.len()), ([2, 1, 2, 0, 3], 0));
        assert_eq!(store.gc(0, None, &Silent).unwrap().evicted.files, 3);
        assert!(bench.left().is_empty());
        assert!(store.gc(0, None, &Silent).unwrap().evicted.files == 0);
    }

    #[test]
    fn what_cannot_be_removed_is_told() {
        let bench = Bench::new(&[100]);
        let store = bench.store(0);
        fs::create_dir_all(store.path(Kind::Gather, &[5; 32]).join("mine")).unwrap();
        let [bad] = &store.verify(&Silent).unwrap().bad[..] else { panic!("one folder") };
        assert!(bad.why.contains("remove this folder yourself"), "{}", bad.why);
        let done = store.gc(u64::MAX, None, &Silent).unwrap();
        assert_eq!((done.failed.len(), done.left.files), (1, 2));
        assert_eq!(done.failed[0].path, store.path(Kind::Gather, &[5; 32]));
        assert!(done.failed[0].why.contains("remove this folder yourself"), "{}", done.failed[0].why);
        assert_eq!(bench.evicted(0), [5], "others go all the same");
        let done = store.gc(0, Some(Duration::ZERO), &Silent).unwrap();
        assert_eq!((done.failed.len(), done.left.files), (1, 1), "it is tried once and told once");
    }

    #[test]
    fn an_empty_folder_in_the_place_of_an_artefact_is_removed() {
        let bench = Bench::new(&[100]);
        let store = bench.store(0);
        fs::create_dir(store.path(Kind::Gather, &[5; 32])).unwrap();
        let [bad] = &store.verify(&Silent).unwrap().bad[..] else { panic!("one folder") };
        assert!(bad.why.contains("a folder") && !bad.why.contains("yourself"), "{}", bad.why);
        let done = store.gc(u64::MAX, None, &Silent).unwrap();
        assert_eq!((done.bad.files, done.failed.len(), done.left.files), (1, 0, 1));
        assert!(!store.path(Kind::Gather, &[5; 32]).exists());
    }

    #[test]
    fn a_store_that_does_not_exist_is_empty() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().join("none")).with_cap(0);
        store.evict();
        assert_eq!(store.stat().unwrap(), Default::default());
        assert_eq!(store.verify(&Silent).unwrap().sound.files, 0);
        assert_eq!(store.gc(0, None, &Silent).unwrap().left.files, 0);
        assert!(store.take_notes().is_empty() && !store.folder().exists());
    }

    #[test]
    fn a_cancelled_survey_stops() {
        let bench = Bench::new(&[1]);
        let store = bench.store(0);
        assert!(matches!(store.verify(&Unwanted), Err(StoreError::Cancelled(_))));
        assert!(matches!(store.gc(0, None, &Unwanted), Err(StoreError::Cancelled(_))));
        assert_eq!(bench.left(), [0]);
    }
}
