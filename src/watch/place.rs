//! Where a file is looked for: the real folder behind its path, or the nearest one that exists.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

/// The name under which events speak of a path, and the folder to listen at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The real path of the folder, links followed, and the rest of the path.
    pub key: PathBuf,
    /// The nearest folder above the path that exists.
    pub folder: PathBuf,
}

impl Place {
    /// Of a file or folder that may not exist.
    pub fn of(path: &Path) -> Option<Self> {
        let path = std::path::absolute(path).ok()?;
        let mut rest: Vec<OsString> = Vec::new();
        let mut above = path.as_path();
        loop {
            rest.push(above.components().next_back().filter(|c| !matches!(c, Component::RootDir))?.as_os_str().into());
            above = above.parent()?;
            if let Some(folder) = above.canonicalize().ok().filter(|f| f.is_dir()) {
                let key = rest.iter().rev().fold(folder.clone(), |key, part| key.join(part));
                return Some(Self { key, folder });
            }
        }
    }

    /// Of a file and, where it is a link, of what it leads to.
    pub fn all(path: &Path) -> Vec<Self> {
        let own = Self::of(path);
        let target = path.canonicalize().ok().as_deref().and_then(Self::of).filter(|t| Some(t) != own.as_ref());
        own.into_iter().chain(target).collect()
    }
}

/// The path itself or something below it is in the set.
pub fn leads_to(path: &Path, set: &BTreeSet<PathBuf>) -> bool {
    // Paths sort by their parts, so what lies below a path follows it at once.
    set.range(path.to_path_buf()..).next().is_some_and(|p| p.starts_with(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_looked_for_where_it_would_appear() {
        let folder = tempfile::tempdir().unwrap();
        let real = folder.path().canonicalize().unwrap();
        let at = |path: &str| Place::of(&folder.path().join(path)).unwrap();
        assert_eq!(at("a.bin"), Place { key: real.join("a.bin"), folder: real.clone() });
        assert_eq!(at("b/c/a.bin"), Place { key: real.join("b/c/a.bin"), folder: real.clone() });
        std::fs::create_dir(folder.path().join("b")).unwrap();
        assert_eq!(at("b/c/a.bin").folder, real.join("b"));
        assert_eq!(at("b/../a.bin").key, real.join("a.bin"));
        assert_eq!(Place::of(Path::new("/")), None);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_looked_at_on_both_ends() {
        let folder = tempfile::tempdir().unwrap();
        let real = folder.path().canonicalize().unwrap();
        std::fs::create_dir(real.join("store")).unwrap();
        std::fs::write(real.join("store/a.png"), "x").unwrap();
        std::os::unix::fs::symlink(real.join("store/a.png"), real.join("a.png")).unwrap();
        let keys: Vec<_> = Place::all(&folder.path().join("a.png")).into_iter().map(|p| p.key).collect();
        assert_eq!(keys, [real.join("a.png"), real.join("store/a.png")]);
    }

    #[test]
    fn a_path_leads_to_what_lies_below_it() {
        let set = BTreeSet::from(["/a/b/c.bin".into(), "/a-b/d.bin".into()]);
        let leads = |path: &str| leads_to(Path::new(path), &set);
        assert!(leads("/a") && leads("/a/b") && leads("/a/b/c.bin") && leads("/a-b") && leads("/"));
        assert!(!leads("/a/b/c") && !leads("/a/b/c.bin/d") && !leads("/b"));
    }
}
