//! Which folders are watched: those that hold what scenes were found in, read, or miss.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use super::batch::Hint;
use super::source::{Source, Watched};
use super::stamp::Identity;

/// Keeps a source at the folders that are wanted.
pub struct Folders {
    source: Box<dyn Source>,
    /// Which folder lay at each path when it was armed.
    armed: BTreeMap<PathBuf, Identity>,
    /// What was said of folders that are not watched as they should be, so that it is said once.
    said: BTreeMap<PathBuf, Watched>,
}

/// What became of the wish to watch some folders.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Armed {
    /// Watched from now on: what happened in them before was not told.
    pub new: BTreeSet<PathBuf>,
    /// Polled, or not watched at all, and not said before.
    pub news: Vec<(PathBuf, Watched)>,
}

impl Folders {
    pub fn new(source: Box<dyn Source>) -> Self {
        Self { source, armed: BTreeMap::new(), said: BTreeMap::new() }
    }

    /// Watches exactly the `wanted` folders, given by their real paths, from now on. Folders that were `lost` are
    /// armed again even where they seem to be the same ones.
    pub fn arm(&mut self, wanted: &BTreeSet<PathBuf>, lost: impl Fn(&Path) -> bool) -> Armed {
        let (source, mut armed) = (&mut self.source, Armed::default());
        self.armed.retain(|folder, _| {
            let keep = wanted.contains(folder);
            if !keep {
                source.unwatch(folder);
            }
            keep
        });
        for folder in wanted {
            let Some(identity) = Identity::of(folder) else {
                self.forget(folder);
                continue;
            };
            if self.armed.get(folder) == Some(&identity) && !lost(folder) {
                continue;
            }
            self.forget(folder);
            let watched = self.source.watch(folder);
            if watched == Watched::Gone {
                continue;
            }
            // Also one that cannot be watched, so that it is not tried all the time.
            self.armed.insert(folder.clone(), identity);
            armed.new.insert(folder.clone());
            if watched != Watched::Told && self.said.get(folder) != Some(&watched) {
                self.said.insert(folder.clone(), watched.clone());
                armed.news.push((folder.clone(), watched));
            }
        }
        armed
    }

    fn forget(&mut self, folder: &Path) {
        if self.armed.remove(folder).is_some() {
            self.source.unwatch(folder);
        }
    }

    /// Folders that are not the ones that were armed any more, whether or not anybody told: a disk that was taken out,
    /// a folder above that was renamed.
    pub fn lost(&self) -> Vec<Hint> {
        let lost = self.armed.iter().filter(|(folder, identity)| Identity::of(folder).as_ref() != Some(identity));
        lost.map(|(folder, _)| Hint::At { path: folder.clone(), gone: true }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    /// Writes down what it is asked for, and answers as it is told to.
    #[derive(Clone, Default)]
    struct Scribe {
        asked: Arc<Mutex<Vec<String>>>,
        answer: Arc<Mutex<Option<Watched>>>,
    }

    impl Source for Scribe {
        fn watch(&mut self, folder: &Path) -> Watched {
            let name = folder.file_name().unwrap().to_string_lossy();
            self.asked.lock().unwrap().push(format!("+{name}"));
            self.answer.lock().unwrap().clone().unwrap_or(Watched::Told)
        }

        fn unwatch(&mut self, folder: &Path) {
            let name = folder.file_name().unwrap().to_string_lossy();
            self.asked.lock().unwrap().push(format!("-{name}"));
        }
    }

    struct Case {
        outer: tempfile::TempDir,
        scribe: Scribe,
        folders: Folders,
    }

    impl Case {
        fn new(names: &[&str]) -> Self {
            let (outer, scribe) = (tempfile::tempdir().unwrap(), Scribe::default());
            names.iter().for_each(|n| std::fs::create_dir(outer.path().join(n)).unwrap());
            Self { outer, folders: Folders::new(Box::new(scribe.clone())), scribe }
        }

        /// Arms folders; returns what the source was asked for, and how many folders there was something to say of.
        fn arm(&mut self, names: &[&str], lost: bool) -> (Vec<String>, usize) {
            let wanted = names.iter().map(|n| self.outer.path().join(n)).collect();
            let armed = self.folders.arm(&wanted, |_| lost);
            let asked = std::mem::take(&mut *self.scribe.asked.lock().unwrap());
            assert_eq!(armed.new.len(), asked.iter().filter(|a| a.starts_with('+')).count());
            (asked, armed.news.len())
        }
    }

    #[test]
    fn only_what_has_changed_is_armed_anew() {
        let mut case = Case::new(&["a", "b", "c"]);
        assert_eq!(case.arm(&["a", "b", "none"], false).0, ["+a", "+b"]);
        assert_eq!(case.arm(&["a", "b"], false).0, [""; 0]);
        assert_eq!(case.arm(&["b", "c"], false).0, ["-a", "+c"]);
        assert_eq!(case.arm(&["b"], true).0, ["-c", "-b", "+b"]);
        assert_eq!(case.folders.lost(), []);
        let path = case.outer.path().join("b");
        std::fs::rename(&path, case.outer.path().join("d")).unwrap();
        assert_eq!(case.folders.lost(), [Hint::At { path: path.clone(), gone: true }]);
        std::fs::create_dir(&path).unwrap();
        assert_eq!(case.arm(&["b"], false).0, ["-b", "+b"], "another folder has its name");
        std::fs::remove_dir(&path).unwrap();
        assert_eq!(case.arm(&["b"], false).0, ["-b"]);
    }

    #[test]
    fn a_folder_that_is_polled_is_said_once() {
        let mut case = Case::new(&["a"]);
        *case.scribe.answer.lock().unwrap() = Some(Watched::Polled("nfs".into()));
        assert_eq!(case.arm(&["a"], false).1, 1);
        assert_eq!(case.arm(&["a"], true).1, 0);
        *case.scribe.answer.lock().unwrap() = Some(Watched::Not("no".into()));
        assert_eq!(case.arm(&["a"], true).1, 1);
    }
}
