//! Folders that are looked at every so often: network drives, and systems that watch no more.
//!
//! A look lists a folder and reads nothing: two files are the same where their stamps are. After a change it looks again
//! every [`BUSY`] until all is still, so that a file which is being written is seen to change, as if the system told of
//! it. File systems with a coarse clock may give two writes one stamp, so a file that has been still for [`COARSE`] is
//! hinted at once more; whoever compares contents finds out. (The polling of `notify` reads every file at every look
//! where it is to compare contents, and takes times in whole seconds where it is not.)

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::batch::Hint;
use super::source::Teller;
use super::stamp::Stamp;

/// Pause between looks while something changes.
const BUSY: Duration = Duration::from_millis(50);

/// Looks without a change after which all is still.
const STILL: u32 = 4;

/// Longer than the coarsest clock of a file system: FAT counts two seconds.
const COARSE: Duration = Duration::from_millis(2500);

/// What a folder held when it was looked at last, by name; None when it was not there.
type Listing = Option<BTreeMap<OsString, Stamp>>;

/// Looks at folders on a thread of its own.
pub struct Poll {
    shared: Arc<Shared>,
    interval: Duration,
    teller: Teller,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    ended: Condvar,
}

#[derive(Default)]
struct State {
    folders: BTreeMap<PathBuf, Listing>,
    /// When files were seen to change that have not been hinted at again.
    young: BTreeMap<PathBuf, Duration>,
    ended: bool,
}

impl Poll {
    /// Looks every `interval`. There is no thread as long as there is no folder.
    pub fn new(interval: Duration, teller: Teller) -> Self {
        Self { shared: Arc::default(), interval, teller, thread: None }
    }

    /// Tells what changes in the folder from now on.
    ///
    /// # Errors
    /// It cannot be listed, or there is no thread to be had.
    pub fn watch(&mut self, folder: &Path) -> io::Result<()> {
        let listing = list(folder)?;
        self.shared.lock().folders.insert(folder.into(), Some(listing));
        if self.thread.is_none() {
            let (shared, teller, interval) = (self.shared.clone(), self.teller.clone(), self.interval);
            let work = move || shared.run(interval, &*teller);
            self.thread = Some(std::thread::Builder::new().name("luxel poll".into()).spawn(work)?);
        }
        Ok(())
    }

    pub fn unwatch(&mut self, folder: &Path) {
        self.shared.lock().folders.remove(folder);
    }
}

impl Drop for Poll {
    fn drop(&mut self) {
        self.shared.lock().ended = true;
        self.shared.ended.notify_all();
        if let Some(thread) = self.thread.take() {
            // It has no result, and panics only where the teller does.
            drop(thread.join());
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, interval: Duration, tell: &dyn Fn(Hint)) {
        let start = Instant::now();
        let mut still = STILL;
        loop {
            let pause = if still < STILL { BUSY.min(interval) } else { interval };
            let waited = self.ended.wait_timeout_while(self.lock(), pause, |s| !s.ended);
            let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
            if state.ended {
                return;
            }
            let folders: Vec<PathBuf> = state.folders.keys().cloned().collect();
            drop(state);
            // A network drive may be slow to answer, and nobody should wait for it.
            let listings: Vec<_> = folders.into_iter().map(|f| (list(&f).ok(), f)).collect();
            let hints = self.lock().compare(listings, start.elapsed());
            still = if hints.is_empty() { still.saturating_add(1) } else { 0 };
            hints.into_iter().for_each(tell);
        }
    }
}

impl State {
    /// What the new listings hint at.
    fn compare(&mut self, listings: Vec<(Listing, PathBuf)>, now: Duration) -> Vec<Hint> {
        let mut hints = Vec::new();
        for (listing, folder) in listings {
            // It may have been given up meanwhile.
            let Some(known) = self.folders.get_mut(&folder) else { continue };
            if known.is_some() != listing.is_some() {
                hints.push(Hint::At { path: folder.clone(), gone: true });
            }
            let before = std::mem::replace(known, listing).unwrap_or_default();
            let nothing = BTreeMap::new();
            let after = known.as_ref().unwrap_or(&nothing);
            let new = after.keys().filter(|n| !before.contains_key(*n));
            for name in before.keys().chain(new).filter(|n| before.get(*n) != after.get(*n)) {
                let (path, gone) = (folder.join(name), !after.contains_key(name));
                if !gone {
                    self.young.insert(path.clone(), now);
                }
                hints.push(Hint::At { path, gone });
            }
        }
        let grown = |since: &Duration| now.saturating_sub(*since) >= COARSE;
        let again = self.young.iter().filter(|(_, since)| grown(since)).map(|(path, _)| path.clone());
        hints.extend(again.map(Hint::Again));
        self.young.retain(|_, since| !grown(since));
        hints
    }
}

/// What a folder holds.
fn list(folder: &Path) -> io::Result<BTreeMap<OsString, Stamp>> {
    let mut listing = BTreeMap::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        // Links are followed: what they lead to is what is read. A file that vanishes meanwhile is not there.
        if let Ok(meta) = std::fs::metadata(entry.path()) {
            listing.insert(entry.file_name(), Stamp::new(&meta));
        }
    }
    Ok(listing)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(folder: &Path) -> State {
        State { folders: BTreeMap::from([(folder.into(), list(folder).ok())]), ..State::default() }
    }

    /// Paths that a look at `now` hints at, with whether they are gone.
    fn look(state: &mut State, folder: &Path, now: u64) -> Vec<(PathBuf, bool)> {
        let plain = |hint| if let Hint::At { path, gone } = hint { (path, gone) } else { panic!("{hint:?}") };
        hints(state, folder, now).into_iter().map(plain).collect()
    }

    fn hints(state: &mut State, folder: &Path, now: u64) -> Vec<Hint> {
        state.compare(vec![(list(folder).ok(), folder.into())], Duration::from_millis(now))
    }

    #[test]
    fn changes_are_seen_and_told_again_when_the_file_has_been_still() {
        let folder = tempfile::tempdir().unwrap();
        let (folder, at) = (folder.path(), |name: &str| folder.path().join(name));
        std::fs::write(at("a"), "1").unwrap();
        let mut state = state(folder);
        assert_eq!(look(&mut state, folder, 0), []);
        std::fs::write(at("a"), "12").unwrap();
        std::fs::write(at("b"), "1").unwrap();
        assert_eq!(look(&mut state, folder, 100), [(at("a"), false), (at("b"), false)]);
        std::fs::remove_file(at("b")).unwrap();
        std::fs::rename(at("a"), at("c")).unwrap();
        assert_eq!(look(&mut state, folder, 200), [(at("a"), true), (at("b"), true), (at("c"), false)]);
        assert_eq!(look(&mut state, folder, 2599), []);
        // Where one was replaced by a like one within a tick of the clock, this is how it comes out.
        assert_eq!(hints(&mut state, folder, 2700), ["a", "b", "c"].map(|name| Hint::Again(at(name))));
        assert_eq!(look(&mut state, folder, 9000), []);
    }

    #[test]
    fn a_folder_that_goes_and_comes_back_is_told() {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("levels");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("a"), "1").unwrap();
        let mut state = state(&folder);
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(look(&mut state, &folder, 0), [(folder.clone(), true), (folder.join("a"), true)]);
        assert_eq!(look(&mut state, &folder, 1), []);
        std::fs::create_dir(&folder).unwrap();
        assert_eq!(look(&mut state, &folder, 2), [(folder.clone(), true)]);
    }
}
