//! Waits until a burst of changes is over.
//!
//! A save is many events: truncated, written in pieces, closed; or a temporary file, a rename, a removal. A batch is due
//! when nothing has come for [`QUIET`], and after [`LONGEST`] at the latest, so that a file which never rests is looked at
//! all the same. Time is whatever the caller says it is.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A burst is over when nothing has come for this time.
pub const QUIET: Duration = Duration::from_millis(100);

/// No burst is waited for longer.
pub const LONGEST: Duration = Duration::from_millis(500);

/// Most paths that one batch tells apart.
const MOST: usize = 4096;

/// That something may have changed. Nothing is believed of it but where to look.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Hint {
    /// At this path, or below it.
    At {
        path: PathBuf,
        /// It was removed or renamed: if it is a folder, it is watched no longer.
        gone: bool,
    },
    /// At this file, once more: its stamp may hide that its content is another one than when it was looked at. Nobody
    /// needs to hear that it is not.
    Again(PathBuf),
    /// Anywhere: events were lost.
    Everywhere,
}

/// The hints of one burst.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hints {
    /// Whether each was removed or renamed.
    pub paths: BTreeMap<PathBuf, bool>,
    /// Files that were hinted at once more.
    pub again: BTreeSet<PathBuf>,
    pub everywhere: bool,
}

impl Hints {
    fn add(&mut self, hint: Hint) {
        match hint {
            Hint::At { path, gone } if self.paths.len() < MOST || self.paths.contains_key(&path) => {
                *self.paths.entry(path).or_default() |= gone;
            }
            Hint::Again(path) if self.again.len() < MOST => drop(self.again.insert(path)),
            Hint::At { .. } | Hint::Again(_) | Hint::Everywhere => self.everywhere = true,
        }
    }

    /// The folder itself, or one above it, was removed or renamed.
    pub fn lost(&self, folder: &Path) -> bool {
        self.everywhere || folder.ancestors().any(|f| self.paths.get(f) == Some(&true))
    }
}

/// Collects hints until the burst is over.
#[derive(Debug, Default)]
pub struct Batch {
    hints: Hints,
    /// When the first and the last hint came.
    span: Option<(Duration, Duration)>,
}

impl Batch {
    /// Takes a hint that came at `now`.
    pub fn add(&mut self, now: Duration, hint: Hint) {
        self.hints.add(hint);
        self.span = Some(self.span.map_or((now, now), |(first, last)| (first, last.max(now))));
    }

    pub fn is_empty(&self) -> bool {
        self.span.is_none()
    }

    /// When the burst will be over if nothing more comes.
    pub fn due(&self) -> Option<Duration> {
        self.span.map(|(first, last)| (last + QUIET).min(first + LONGEST))
    }

    /// The hints of a burst that is over at `now`.
    pub fn take(&mut self, now: Duration) -> Option<Hints> {
        self.due().filter(|due| *due <= now)?;
        self.span = None;
        Some(std::mem::take(&mut self.hints))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    fn at(path: &str, gone: bool) -> Hint {
        Hint::At { path: path.into(), gone }
    }

    #[test]
    fn a_burst_is_over_when_it_is_quiet() {
        let mut batch = Batch::default();
        assert_eq!((batch.due(), batch.take(ms(1000))), (None, None));
        batch.add(ms(10), at("a", false));
        batch.add(ms(70), at("b", false));
        batch.add(ms(90), at("a", true));
        assert_eq!((batch.due(), batch.take(ms(189))), (Some(ms(190)), None));
        let hints = batch.take(ms(190)).unwrap();
        assert_eq!(hints.paths, BTreeMap::from([("a".into(), true), ("b".into(), false)]));
        assert!(!hints.everywhere && batch.is_empty() && batch.take(ms(500)).is_none());
    }

    #[test]
    fn what_never_rests_is_looked_at_all_the_same() {
        let mut batch = Batch::default();
        let mut taken = Vec::new();
        for now in (0..2000).step_by(20) {
            batch.add(ms(now), at("a", false));
            taken.extend(batch.take(ms(now)).map(|_| now));
        }
        assert_eq!(taken, [500, 1020, 1540]);
    }

    #[test]
    fn a_folder_is_lost_with_the_one_above() {
        let mut hints = Hints::default();
        hints.add(at("/a/b", true));
        hints.add(at("/c", false));
        let lost = |folder: &str| hints.lost(Path::new(folder));
        assert!(lost("/a/b") && lost("/a/b/d") && !lost("/a") && !lost("/a/bb") && !lost("/c"));
        hints.add(Hint::Everywhere);
        assert!(hints.lost(Path::new("/c")));
    }

    #[test]
    fn a_flood_of_names_becomes_one_hint() {
        let mut hints = Hints::default();
        (0..10_000).for_each(|i| hints.add(at(&format!("{i}"), false)));
        assert!(hints.everywhere && hints.paths.len() == MOST);
        let mut hints = Hints::default();
        (0..10_000).for_each(|i| hints.add(Hint::Again(format!("{i}").into())));
        assert!(hints.everywhere && hints.again.len() == MOST);
    }
}
