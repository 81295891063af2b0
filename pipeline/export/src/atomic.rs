//! Files that are either the old one or the new one, whole, whatever happens in between.

use std::{
    collections::BTreeSet,
    fs,
    io::{self, Seek, Write},
    path::{Path, PathBuf},
};

use luxel_scene::{Progress, Watched};

use crate::ExportError;

/// Replaces `path` by `bytes`: a temporary file in the same folder is written, flushed to the disk and renamed over
/// it. Missing folders are created. On any error the old file is untouched and the temporary one is gone.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    write_atomic_with(path, |file| file.write_all(bytes))
}

/// [`write_atomic`] of a content that `fill` writes to the temporary file, which stands at its beginning.
pub fn write_atomic_with(path: &Path, fill: impl FnOnce(&mut fs::File) -> io::Result<()>) -> Result<(), ExportError> {
    persist(vec![stage(path, fill)?])
}

/// A finished file under a temporary name, which goes when this is dropped.
pub(crate) struct Staged {
    file: tempfile::NamedTempFile,
    path: PathBuf,
}

impl Staged {
    /// What it is to become.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Length and hash of what was written, read back so that it need not be held.
    pub(crate) fn fingerprint(&mut self, progress: &dyn Progress) -> Result<(u64, blake3::Hash), ExportError> {
        let mut hash = || {
            let mut hasher = blake3::Hasher::new();
            let file = self.file.as_file_mut();
            file.rewind()?;
            hasher.update_reader(Watched::new(file, progress))?;
            Ok((hasher.count(), hasher.finalize()))
        };
        hash().map_err(|e| ExportError::io("read back", &self.path, e))
    }
}

/// The folder of a file.
fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Writes what is to become `path` beside it and flushes it to the disk. Refuses what a rename could not replace.
pub(crate) fn stage(path: &Path, fill: impl FnOnce(&mut fs::File) -> io::Result<()>) -> Result<Staged, ExportError> {
    let folder = folder(path);
    fs::create_dir_all(folder).map_err(|e| ExportError::io("create the folder", folder, e))?;
    if path.is_dir() {
        return Err(ExportError::io("write", path, io::ErrorKind::IsADirectory.into()));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".luxel-").suffix(".tmp");
    // A temporary file is private by default; an output is as readable as the umask says.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let filled = || {
        let mut file = builder.tempfile_in(folder)?;
        fill(file.as_file_mut())?;
        file.as_file().sync_all()?;
        Ok(file)
    };
    Ok(Staged { file: filled().map_err(|e| ExportError::io("write", path, e))?, path: path.into() })
}

/// Renames staged files to what they are to be, in their order. All that can be expected to fail (space, permission, a
/// name that is taken) has done so before: only a fault of the disk between two renames can part them.
pub(crate) fn persist(files: Vec<Staged>) -> Result<(), ExportError> {
    let mut folders = BTreeSet::new();
    for Staged { file, path } in files {
        file.persist(&path).map_err(|e| ExportError::io("write", &path, e.error))?;
        folders.insert(folder(&path).to_owned());
    }
    // The renames themselves reach the disk with the folder; only Unix can open one.
    #[cfg(unix)]
    for folder in folders {
        let flushed = fs::File::open(&folder).and_then(|f| f.sync_all());
        flushed.map_err(|e| ExportError::io("write the folder", &folder, e))?;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Names of the files in a folder, sorted.
    pub(crate) fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_created_with_its_folders_and_replaced_whole() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a/b/level.glb");
        write_atomic(&path, b"a first, longer content").unwrap();
        write_atomic(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(names(path.parent().unwrap()), ["level.glb"]);
    }

    #[test]
    fn an_error_in_the_middle_leaves_the_old_file_and_no_litter() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.glb");
        write_atomic(&path, b"old").unwrap();
        let failed = stage(&path, |file| {
            file.write_all(b"half of the n")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["level.glb"]);
    }

    #[test]
    fn what_cannot_be_replaced_is_an_error_that_names_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.glb");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("inside"), b"x").unwrap();
        let error = write_atomic(&path, b"new").unwrap_err().to_string();
        assert!(error.contains("level.glb"), "{error}");
        assert_eq!(names(dir.path()), ["level.glb"]);
        let under_a_file = dir.path().join("level.glb/inside/deeper.glb");
        assert!(write_atomic(&under_a_file, b"new").is_err());
        assert_eq!(fs::read(path.join("inside")).unwrap(), b"x");
    }

    #[cfg(unix)]
    #[test]
    fn a_read_only_folder_keeps_its_old_file() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("level.glb");
        write_atomic(&path, b"old").unwrap();
        fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o555)).unwrap();
        let probe = fs::write(dir.path().join("probe"), b"x");
        let written = write_atomic(&path, b"new");
        fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o755)).unwrap();
        if probe.is_ok() {
            println!("read-only folders do not bind this user: the refusal was not tested");
            assert_eq!(fs::read(&path).unwrap(), b"new");
            return;
        }
        assert!(written.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[cfg(unix)]
    #[test]
    fn outputs_are_readable_by_others_as_the_umask_allows() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (ours, plain) = (dir.path().join("ours"), dir.path().join("plain"));
        write_atomic(&ours, b"x").unwrap();
        fs::write(&plain, b"x").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }
}
