//! How much a store may hold. The cap belongs to the store and not to who happens to use it: one that is asked for is
//! kept in the store, in a text file with a number of bytes, and holds for everybody from then on who asks for none.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::PathBuf;

use super::file::TEMPORARY;
use super::{DEFAULT_CAP, Store, StoreError};

/// The name of the file in the store's folder.
pub const CAP_FILE: &str = "cap";

/// A longer file is none of these [bytes].
const LONGEST: u64 = 64;

impl Store {
    /// How much it may hold after [`Store::evict`] [bytes]: what was asked for, else what is kept, else [`DEFAULT_CAP`].
    ///
    /// # Errors
    /// What is kept cannot be read.
    pub fn cap(&self) -> Result<u64, StoreError> {
        match self.cap {
            Some(cap) => Ok(cap),
            None => Ok(self.kept_cap()?.unwrap_or(DEFAULT_CAP)),
        }
    }

    /// The cap that is kept in the store [bytes], if one was ever asked for.
    ///
    /// # Errors
    /// There is something that cannot be read as a number.
    pub fn kept_cap(&self) -> Result<Option<u64>, StoreError> {
        let path = self.cap_file();
        let failed = |why: String| StoreError::Cap { path: path.clone(), why };
        let meta = match std::fs::metadata(&path) {
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                return Ok(None);
            }
            meta => meta.map_err(|error| failed(error.to_string()))?,
        };
        // Whoever opens a pipe waits for somebody at its other end.
        if !meta.is_file() {
            return Err(failed("it is no file".into()));
        }
        let mut text = String::new();
        let read = File::open(&path).and_then(|file| file.take(LONGEST).read_to_string(&mut text));
        read.map_err(|error| failed(error.to_string()))?;
        text.trim().parse().map(Some).map_err(|_| failed("it holds no number of bytes".into()))
    }

    /// Keeps the cap that was asked for, whole or not at all; nothing is written where none was, or where it is kept
    /// already. One of nothing at all empties a store once, and says nothing of how much it may hold.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn keep_cap(&self) -> Result<(), StoreError> {
        let Some(cap) = self.cap.filter(|cap| *cap > 0 && !self.kept_cap().is_ok_and(|kept| kept == Some(*cap))) else {
            return Ok(());
        };
        self.write_cap(cap).map_err(|source| StoreError::KeepCap { path: self.cap_file(), source })
    }

    /// [`Store::keep_cap`] of a bake, which nothing in a store stops: what stands in the way is noted.
    pub(crate) fn keep_cap_or_note(&self) {
        if let Err(StoreError::KeepCap { source, .. }) = self.keep_cap() {
            self.note(|notes| notes.unkept(&self.folder, &source));
        }
    }

    fn write_cap(&self, cap: u64) -> io::Result<()> {
        std::fs::create_dir_all(&self.folder)?;
        let mut builder = tempfile::Builder::new();
        builder.prefix(TEMPORARY.0).suffix(TEMPORARY.1);
        // As for artefacts: others may share the store.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = builder.tempfile_in(&self.folder)?;
        writeln!(file, "{cap}")?;
        file.as_file().sync_all()?;
        file.persist(self.cap_file()).map(drop).map_err(|error| error.error)
    }

    fn cap_file(&self) -> PathBuf {
        self.folder.join(CAP_FILE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Kind;
    use std::fs;

    #[test]
    fn a_cap_that_was_asked_for_holds_for_others() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("store");
        let cap = || Store::new(&at).cap().unwrap();
        assert_eq!((cap(), Store::new(&at).kept_cap().unwrap()), (DEFAULT_CAP, None));
        Store::new(&at).keep_cap().unwrap();
        assert!(!at.exists(), "nobody asked for anything");
        Store::new(&at).with_cap(50 << 30).keep_cap().unwrap();
        Store::new(&at).with_cap(0).keep_cap().unwrap();
        assert_eq!((cap(), Store::new(&at).with_cap(7).cap().unwrap()), (50 << 30, 7));
        Store::new(&at).keep_cap().unwrap();
        assert_eq!(cap(), 50 << 30);
        Store::new(&at).with_cap(3).keep_cap().unwrap();
        assert_eq!((cap(), fs::read_to_string(at.join(CAP_FILE)).unwrap()), (3, "3\n".into()));
        assert_eq!(fs::read_dir(&at).unwrap().count(), 1);
    }

    #[test]
    fn nothing_is_evicted_by_a_cap_that_nobody_can_read() {
        let folder = tempfile::tempdir().unwrap();
        let store = || Store::new(folder.path());
        store().put(Kind::Sky, &[1; 32], |out| out.write_all(b"blue")).unwrap();
        for wrong in ["", "50GiB", "-1", "99999999999999999999", &"1".repeat(100)] {
            fs::write(folder.path().join(CAP_FILE), wrong).unwrap();
            let asks = store();
            assert!(asks.cap().unwrap_err().to_string().contains("anew"), "{wrong}");
            asks.evict();
            let notes = asks.take_notes();
            assert!(notes.len() == 1 && notes[0].contains("cap"), "{notes:?}");
        }
        assert_eq!(store().stat().unwrap().total.files, 1);
        store().with_cap(5).keep_cap().unwrap();
        assert_eq!(store().cap().unwrap(), 5, "a cap that is given mends it");
    }

    #[test]
    fn the_kept_cap_is_what_eviction_goes_by() {
        let folder = tempfile::tempdir().unwrap();
        let store = || Store::new(folder.path());
        store().put(Kind::Sky, &[1; 32], |out| out.write_all(b"blue")).unwrap();
        store().with_cap(0).keep_cap().unwrap();
        assert_eq!(store().kept_cap().unwrap(), None, "to be emptied once is not to hold nothing");
        store().with_cap(1).keep_cap().unwrap();
        store().evict();
        assert_eq!(store().stat().unwrap().total.files, 0);
    }
}
