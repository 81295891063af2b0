//! What went wrong in a store, each thing once.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};

use super::Miss;

/// Most files that are named; the rest are counted. A store in which every file is damaged must not fill a report.
const MOST: usize = 8;

/// Notes that nobody has taken yet, and what has been said before.
#[derive(Debug, Default)]
pub struct Notes {
    lines: Vec<String>,
    told: BTreeSet<PathBuf>,
    /// Files of no use beyond the [`MOST`] that were named.
    more: usize,
    /// What could not be written: the first, and how many more. One full disk refuses them all.
    unwritten: Option<(String, usize)>,
    has_told_size: bool,
}

impl Notes {
    /// A file was there and of no use.
    pub fn missed(&mut self, path: &Path, miss: &Miss) {
        if !self.told.insert(path.into()) {
            return;
        }
        if self.told.len() > MOST {
            self.more += 1;
        } else {
            self.lines.push(format!("{} is of no use, so it is made anew: {miss}", path.display()));
        }
    }

    /// A file could not be written.
    pub fn unwritten(&mut self, path: &Path, error: &io::Error) {
        let first = || (format!("{} cannot be written, so the next bake makes it again: {error}", path.display()), 0);
        match &mut self.unwritten {
            Some((_, more)) => *more += 1,
            none => *none = Some(first()),
        }
    }

    /// The store could not be made smaller.
    pub fn oversized(&mut self, folder: &Path, why: &str) {
        if !std::mem::replace(&mut self.has_told_size, true) {
            self.lines.push(format!("the store {} cannot be kept below its cap: {why}", folder.display()));
        }
    }

    /// The cap that was asked for could not be kept.
    pub fn unkept(&mut self, folder: &Path, error: &io::Error) {
        let folder = folder.display();
        self.lines.push(format!("the cap of the store {folder} cannot be kept in it and holds this once: {error}"));
    }

    pub fn take(&mut self) -> Vec<String> {
        let mut lines = std::mem::take(&mut self.lines);
        match std::mem::take(&mut self.more) {
            0 => {}
            more => lines.push(format!("{more} more stored files are of no use; luxel cache verify lists them")),
        }
        if let Some((first, more)) = self.unwritten.take() {
            lines.push(if more == 0 { first } else { format!("{first} ({more} more likewise)") });
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_comes_once_and_a_full_disk_is_one_note() {
        let mut notes = Notes::default();
        notes.missed("a".as_ref(), &Miss::Damaged);
        notes.missed("a".as_ref(), &Miss::Damaged);
        notes.missed("b".as_ref(), &Miss::Foreign);
        for name in ["x", "y", "z"] {
            notes.unwritten(name.as_ref(), &io::ErrorKind::StorageFull.into());
        }
        let lines = notes.take();
        assert_eq!(lines.len(), 3, "{lines:?}");
        assert!(lines[0].starts_with("a is ") && lines[0].contains("checksum"), "{}", lines[0]);
        assert!(lines[2].starts_with("x cannot ") && lines[2].ends_with("(2 more likewise)"), "{}", lines[2]);
        notes.missed("a".as_ref(), &Miss::Damaged);
        assert!(notes.take().is_empty());
        for i in 0..MOST {
            notes.missed(i.to_string().as_ref(), &Miss::Damaged);
        }
        let lines = notes.take();
        assert!(lines.len() == MOST - 1 && lines[MOST - 2].starts_with("2 more"), "{lines:?}");
    }
}
