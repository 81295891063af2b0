//! What a file system says of a file without its being read.

use std::fs::Metadata;
use std::path::Path;
use std::time::SystemTime;

/// Two equal stamps mean the same content, except where a file system's clock is coarse: FAT counts two seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    pub length: u64,
    modified: Option<SystemTime>,
    inode: Inode,
}

/// The identity of a file or folder behind its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Inode {
    device: u64,
    number: u64,
    /// When its owner, mode, length or content changed last, which no program can set back [s, ns].
    changed: [i64; 2],
}

impl Inode {
    #[cfg(unix)]
    fn new(meta: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self { device: meta.dev(), number: meta.ino(), changed: [meta.ctime(), meta.ctime_nsec()] }
    }

    #[cfg(not(unix))]
    fn new(_: &Metadata) -> Self {
        Self::default()
    }
}

impl Stamp {
    pub fn new(meta: &Metadata) -> Self {
        Self { length: meta.len(), modified: meta.modified().ok(), inode: Inode::new(meta) }
    }
}

/// Which folder lies at a path: another one that took its name is told apart, as far as the file system can.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    inode: Inode,
    created: Option<SystemTime>,
}

impl Identity {
    /// None where no folder is.
    pub fn of(folder: &Path) -> Option<Self> {
        let meta = std::fs::metadata(folder).ok().filter(Metadata::is_dir)?;
        // A folder changes whenever something in it does, and stays the same one.
        let inode = Inode { changed: [0; 2], ..Inode::new(&meta) };
        Some(Self { inode, created: meta.created().ok() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_folder_of_the_same_name_is_another_one() {
        let outer = tempfile::tempdir().unwrap();
        let folder = outer.path().join("levels");
        assert_eq!(Identity::of(&folder), None);
        std::fs::create_dir(&folder).unwrap();
        let first = Identity::of(&folder);
        std::fs::write(folder.join("a"), "x").unwrap();
        assert!(first.is_some() && Identity::of(&folder) == first);
        // Both exist at once, so that they cannot share a number.
        std::fs::rename(&folder, outer.path().join("old")).unwrap();
        std::fs::create_dir(&folder).unwrap();
        assert_ne!(Identity::of(&folder), first);
        assert_eq!(Identity::of(&folder.join("a")), None);
    }
}
