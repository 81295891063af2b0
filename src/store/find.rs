//! Which stores are meant by scenes and folders.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use luxel_export::output::DEFAULT_FOLDER;

use super::FOLDER;
use crate::discover::DiscoverError;

/// The stores of these paths, each once: of a scene the one beside its outputs in their default place, of a folder all
/// below it, of a store itself. As for bakes, hidden folders and links to folders are not entered;
/// a link that is itself called as a store leads to one.
///
/// # Errors
/// A path that does not exist, or a folder that cannot be listed.
pub fn find(paths: &[PathBuf]) -> Result<Vec<PathBuf>, DiscoverError> {
    let (mut found, mut seen) = (Vec::new(), BTreeSet::new());
    for path in paths {
        for store in of(path)? {
            if seen.insert(store.canonicalize().unwrap_or_else(|_| store.clone())) {
                found.push(store);
            }
        }
    }
    Ok(found)
}

fn of(path: &Path) -> Result<Vec<PathBuf>, DiscoverError> {
    let is_there = |path: &Path| Ok(Vec::from_iter(path.is_dir().then(|| path.to_path_buf())));
    match std::fs::metadata(path) {
        Err(_) => Err(DiscoverError::Missing(path.into())),
        Ok(meta) if !meta.is_dir() => {
            is_there(&path.parent().unwrap_or(Path::new("")).join(DEFAULT_FOLDER).join(FOLDER))
        }
        Ok(_) if path.file_name().is_some_and(|name| name == FOLDER) => is_there(path),
        Ok(_) => below(path),
    }
}

/// The stores below a folder, sorted.
fn below(root: &Path) -> Result<Vec<PathBuf>, DiscoverError> {
    let mut stores = Vec::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let failed = |source| DiscoverError::List { path: folder.clone(), source };
        for entry in std::fs::read_dir(&folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name();
            // A store may lie elsewhere and be linked here; nothing is searched below it.
            if name == FOLDER && entry.path().is_dir() {
                stores.push(entry.path());
                continue;
            }
            // What has gone meanwhile is no folder any more.
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            if is_folder && !name.as_encoded_bytes().starts_with(b".") {
                folders.push(entry.path());
            }
        }
    }
    stores.sort();
    Ok(stores)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stores_are_found_below_folders_and_beside_the_outputs_of_scenes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["baked/.luxel/sky", "b/baked/.luxel", "lit/a/.luxel", ".trash/baked/.luxel", "c/baked"] {
            std::fs::create_dir_all(at(name)).unwrap();
        }
        for scene in ["a.glb", "c/c.glb"] {
            std::fs::write(at(scene), "").unwrap();
        }
        let root = folder.path().to_path_buf();
        let all = [at("b/baked/.luxel"), at("baked/.luxel"), at("lit/a/.luxel")];
        assert_eq!(find(std::slice::from_ref(&root)).unwrap(), all);
        assert_eq!(find(&[at("a.glb"), at("baked/.luxel"), at("baked")]).unwrap(), [at("baked/.luxel")]);
        assert!(find(&[at("c/c.glb"), at("c")]).unwrap().is_empty(), "no store yet");
        assert!(matches!(find(&[root, at("d.glb")]), Err(DiscoverError::Missing(path)) if path == at("d.glb")));
    }

    #[cfg(unix)]
    #[test]
    fn a_linked_store_is_found_once_and_links_lead_in_no_circle() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["elsewhere/store/sky", "a/baked", "b/baked", "c/baked"] {
            std::fs::create_dir_all(at(name)).unwrap();
        }
        for name in ["a", "b"] {
            symlink(at("elsewhere/store"), at(name).join("baked/.luxel")).unwrap();
        }
        symlink(at("nowhere"), at("c/baked/.luxel")).unwrap();
        symlink(folder.path(), at("a/back")).unwrap();
        assert_eq!(find(&[folder.path().into()]).unwrap(), [at("a/baked/.luxel")]);
        assert_eq!(find(&[at("b")]).unwrap(), [at("b/baked/.luxel")]);
    }
}
