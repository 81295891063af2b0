//! Which scenes a command line means: files as they are named, and what lies below folders.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};

use luxel_export::output::DEFAULT_FOLDER;

/// A scene to bake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    pub scene: PathBuf,
    /// The folder that was searched, if one was: outputs mirror its subfolders.
    pub root: Option<PathBuf>,
}

/// What a command line means.
#[derive(Debug, Default)]
pub struct Search {
    pub found: Vec<Found>,
    /// Names that mean no scene, and folders that may hold some that were not found; why.
    pub missing: Vec<(PathBuf, DiscoverError)>,
}

#[derive(Debug, thiserror::Error)]
pub enum DiscoverError {
    #[error("{0}: there is no such file or folder; check the name")]
    Missing(PathBuf),
    #[error("{0}: no .gltf or .glb lies below this folder")]
    Empty(PathBuf),
    #[error("cannot list the folder {path}")]
    List { path: PathBuf, source: io::Error },
}

/// Expands files and folders, in the order of naming, folders sorted by path, no scene twice. Folders that hold outputs
/// (`baked`, and `out` itself), hidden ones and links to folders are not entered; a .glb whose report beside it says that
/// a bake wrote it is passed over wherever it lies. A name that means no scene stops no other, and neither does a folder
/// that cannot be listed: it is among the missing.
///
/// # Errors
/// No name means a scene: what is wrong with the first.
pub fn find(paths: &[PathBuf], out: Option<&Path>) -> Result<Search, DiscoverError> {
    let mut search = Search::default();
    let out = out.and_then(|o| o.canonicalize().ok());
    let (mut seen, mut told) = (BTreeSet::new(), BTreeSet::new());
    for path in paths {
        let (found, missing) = named(path, out.as_deref());
        search.found.extend(found.into_iter().filter(|found| seen.insert(place(&found.scene))));
        search.missing.extend(missing.into_iter().filter(|(path, _)| told.insert(place(path))));
    }
    if search.found.is_empty() && !search.missing.is_empty() {
        return Err(search.missing.swap_remove(0).1);
    }
    Ok(search)
}

/// Where a file or folder lies, however its folder is spelt: by this, two spellings of one scene are told from two
/// scenes. A link to a scene is a scene of its own, since its outputs have its name.
fn place(path: &Path) -> PathBuf {
    let parent = path.parent().map(|parent| if parent.as_os_str().is_empty() { Path::new(".") } else { parent });
    match (parent.and_then(|parent| parent.canonicalize().ok()), path.file_name()) {
        (Some(parent), Some(name)) => parent.join(name),
        _ => path.canonicalize().unwrap_or_else(|_| path.into()),
    }
}

/// The scenes of one name, and what stands in the way of finding more.
fn named(path: &Path, out: Option<&Path>) -> (Vec<Found>, Vec<(PathBuf, DiscoverError)>) {
    if !path.is_dir() {
        let found = Found { scene: path.into(), root: None };
        let missing = || (path.into(), DiscoverError::Missing(path.into()));
        return if path.exists() { (vec![found], Vec::new()) } else { (Vec::new(), vec![missing()]) };
    }
    let Below { scenes, closed, .. } = below(path, out);
    let listed = |(path, source): (PathBuf, io::Error)| (path.clone(), DiscoverError::List { path, source });
    let mut missing: Vec<_> = closed.into_iter().map(listed).collect();
    if scenes.is_empty() && missing.is_empty() {
        missing.push((path.into(), DiscoverError::Empty(path.into())));
    }
    (scenes.into_iter().map(|scene| Found { scene, root: Some(path.into()) }).collect(), missing)
}

/// What a folder holds.
#[derive(Debug, Default)]
pub struct Below {
    /// Sorted.
    pub scenes: Vec<PathBuf>,
    /// The folders that were searched, itself first.
    pub folders: Vec<PathBuf>,
    /// Folders that could not be listed, or not wholly, and why; what lies beside them was found all the same.
    pub closed: Vec<(PathBuf, io::Error)>,
}

/// The scenes below a folder, searched as [`find`] does; `out` is a real path, links followed. A folder below it that
/// vanishes meanwhile is passed over.
pub fn below(root: &Path, out: Option<&Path>) -> Below {
    let mut below = Below::default();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        match list(&folder, out, &mut below.scenes, &mut folders) {
            Err(error) if error.kind() == io::ErrorKind::NotFound && folder != root => {}
            Err(error) => below.closed.push((folder, error)),
            Ok(()) => below.folders.push(folder),
        }
    }
    below.scenes.sort();
    below
}

/// Adds the scenes of one folder and those of its folders that are searched.
fn list(folder: &Path, out: Option<&Path>, scenes: &mut Vec<PathBuf>, folders: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        let kind = match entry.file_type() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            kind => kind?,
        };
        if kind.is_dir() {
            if is_searched(&path, out) {
                folders.push(path);
            }
        } else if !is_hidden(&path) && is_scene(&path) && !luxel_export::is_output(&path) {
            scenes.push(path);
        }
    }
    Ok(())
}

/// Whether a search enters this folder.
pub fn is_searched(folder: &Path, out: Option<&Path>) -> bool {
    let is_out = out.is_some() && folder.canonicalize().ok().as_deref() == out;
    !is_hidden(folder) && folder.file_name().is_some_and(|name| name != DEFAULT_FOLDER) && !is_out
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

/// Whether the name is that of a scene.
pub fn is_scene(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gltf") || e.eq_ignore_ascii_case("glb"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_searched_and_outputs_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["b.glb", "a/c.GLTF", "a/d.txt", "baked/b.glb", "a/baked/c.glb", ".trash/x.glb", "out/b.glb"] {
            std::fs::create_dir_all(at(name).parent().unwrap()).unwrap();
            std::fs::write(at(name), "").unwrap();
        }
        let root = folder.path().to_path_buf();
        let found = find(&[root.clone(), at("b.glb")], Some(&at("out"))).unwrap().found;
        let scenes: Vec<_> = found.iter().map(|f| f.scene.clone()).collect();
        assert_eq!(scenes, [at("a/c.GLTF"), at("b.glb")]);
        assert!(found.iter().all(|f| f.root.as_ref() == Some(&root)));
        assert_eq!(find(&[at("baked/b.glb")], None).unwrap().found[0].root, None, "a named file is taken as it is");
    }

    #[test]
    fn what_a_bake_wrote_is_passed_over_wherever_it_lies() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("level.glb");
        std::fs::write(&scene, luxel_assets::glb::write(&luxel_assets::cornell()).unwrap()).unwrap();
        let out = folder.path().join("lit");
        let mut settings = crate::settings::Settings::preset(crate::settings::Preset::Draft);
        settings.size = crate::settings::value::Texels(32);
        let request = crate::Request {
            scene: scene.clone(),
            outputs: luxel_export::OutputSet::new(&scene, Some(&out), None).unwrap(),
            settings: crate::settings::Resolved { settings, ..Default::default() },
            worker: None,
            store: Default::default(),
            kept: Default::default(),
        };
        crate::bake(&request, &luxel_scene::Silent).unwrap();
        assert!(out.join("level.glb").exists());
        let found = find(&[folder.path().to_path_buf()], None).unwrap().found;
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].scene, scene);
    }

    /// Below a folder, one whose path is too long for the system to list it, whoever asks.
    #[cfg(target_os = "linux")]
    fn unlistable(folder: &Path) {
        let chain = |above: &Path| (0..9).fold(above.to_path_buf(), |path, _| path.join("n".repeat(220)));
        let (inner, other) = (chain(folder), chain(&folder.join("other")));
        std::fs::create_dir_all(&inner).unwrap();
        std::fs::create_dir_all(other.join("m".repeat(220))).unwrap();
        std::fs::rename(folder.join("other"), inner.join("other")).unwrap();
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_cannot_be_listed_hides_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().to_path_buf();
        for name in ["a/a.glb", "z/z.glb"] {
            std::fs::create_dir_all(root.join(name).parent().unwrap()).unwrap();
            std::fs::write(root.join(name), "").unwrap();
        }
        unlistable(&root.join("deep"));
        let found = below(&root, None);
        assert_eq!(found.scenes, [root.join("a/a.glb"), root.join("z/z.glb")]);
        assert!(found.closed.len() == 1 && found.closed[0].0.starts_with(root.join("deep")), "{:?}", found.closed);
        assert!(!found.folders.contains(&found.closed[0].0));
        // A bake goes on with what it knows, and says what it leaves out.
        let Search { found, missing } = find(&[root.clone(), root.join("deep")], None).unwrap();
        assert_eq!(found.len(), 2);
        assert!(matches!(&missing[..], [(_, DiscoverError::List { path, .. })] if path.starts_with(root.join("deep"))));
        let nothing_else = find(&[root.join("deep")], None);
        assert!(matches!(nothing_else, Err(DiscoverError::List { .. })), "{nothing_else:?}");
    }

    #[cfg(unix)]
    #[test]
    fn a_scene_is_found_once_however_it_is_spelt() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("w")).unwrap();
        std::fs::write(at("w/a.glb"), "").unwrap();
        std::os::unix::fs::symlink(at("w"), at("v")).unwrap();
        std::os::unix::fs::symlink(at("w/a.glb"), at("w/b.glb")).unwrap();
        let names = [at("w/a.glb"), at("w"), at("w/../w"), at("v"), at("v/a.glb")];
        let found = find(&names, None).unwrap().found;
        assert_eq!(found.len(), 2, "a link to a scene has outputs of its own: {found:?}");
        assert_eq!((&found[0].scene, &found[1].scene), (&at("w/a.glb"), &at("w/b.glb")));
        let twice = find(&[at("none.glb"), at("w/../none.glb"), at("w")], None).unwrap().missing;
        assert_eq!(twice.len(), 1, "{twice:?}");
    }

    #[test]
    fn what_is_not_there_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: PathBuf| find(&[path], None).unwrap_err().to_string();
        assert!(error(folder.path().into()).contains("no .gltf or .glb"));
        assert!(error(folder.path().join("x.glb")).contains("no such file"));
        let there = folder.path().join("y.glb");
        std::fs::write(&there, "").unwrap();
        let gone = folder.path().join("x.glb");
        let search = find(&[gone.clone(), there.clone(), gone.clone()], None).unwrap();
        assert!(search.found.len() == 1 && search.found[0].scene == there);
        assert!(search.missing.len() == 1 && search.missing[0].0 == gone);
    }
}
