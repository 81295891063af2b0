//! Reading a scene from glTF 2.0, without trusting a byte of it.
//!
//! | module | what it does |
//! |---|---|
//! | `files` | reads the scene file, its buffers and images; paths, sizes, digests |
//! | `container` | takes a .glb apart |
//! | `opened` | the file, its document and its buffers together: what the exporter writes again is read here too |
//! | `document` | JSON within bounds; version, required extensions; the typed model |
//! | `references` | all indices of the document lead somewhere |
//! | `buffers`, `meshopt`, `accessors` | bytes, decompressed views, typed elements |
//! | `nodes`, `transform`, `extras` | the hierarchy: world transforms, what artists say about a node |
//! | `primitives`, `topology`, `pose`, `instancing` | meshes and where they are placed |
//! | `materials`, `images` | surfaces, and only the pixels that matter to them |
//! | `lights`, `power` | punctual lights; is there any light, and are its units plausible |
//! | `sky` | .hdr and .exr skies |
//!
//! The `gltf-json` crate gives the model of the document. Its companion's accessor readers are not used: they panic or
//! misread on files that are legal or damaged.
//!
//! A scene is read whole or refused with a message that names the file, the place, the fault and a remedy. What can be
//! repaired or left out without harm becomes a [`Notice`](crate::Notice) instead.

pub mod accessors;
pub mod buffers;
pub mod container;
pub mod document;
mod error;
pub mod extras;
pub mod files;
mod images;
mod instancing;
mod lights;
mod materials;
mod meshopt;
mod nodes;
mod notes;
mod opened;
mod options;
mod place;
mod pose;
pub mod power;
mod primitives;
mod references;
mod sky;
mod topology;
mod transform;

use std::path::Path;

pub use error::{Checked, Fault, FaultKind, ImportError, place};
pub use opened::{Opened, scene_extras};
pub use options::{ImportOptions, Limits};
pub use sky::LoadedSky;

use crate::{Progress, Scene, Silent};
use notes::Notes;
use place::Placer;

/// Reads the scene at `path` (.gltf or .glb, told apart by content).
///
/// # Errors
/// Whatever the specification forbids, luxel does not read, or a limit of the options excludes.
pub fn load(path: &Path, options: &ImportOptions) -> Result<Scene, ImportError> {
    load_with(path, options, &Silent)
}

/// [`load`] that can be cancelled. What nothing interrupts is the parsing of the JSON, the geometry of one primitive,
/// and the decoding of one JPEG or WebP image (PNG images are looked at while they are decoded).
///
/// # Errors
/// As [`load`]; one of the kind [`FaultKind::Cancelled`] when the scene is no longer wanted.
pub fn load_with(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Result<Scene, ImportError> {
    read(path, options, progress).map_err(|fault| fault.in_file(path))
}

/// Reads an equirectangular sky (.hdr or .exr) with notices and the digest of the file.
pub fn load_sky(path: &Path, limits: &Limits) -> Result<LoadedSky, ImportError> {
    load_sky_with(path, limits, &Silent)
}

/// [`load_sky`] that can be cancelled, as [`load_with`].
pub fn load_sky_with(path: &Path, limits: &Limits, progress: &dyn Progress) -> Result<LoadedSky, ImportError> {
    sky::load(path, limits, progress)
}

fn read(path: &Path, options: &ImportOptions, progress: &dyn Progress) -> Checked<Scene> {
    let mut notes = Notes::default();
    let Opened { buffers, mut files, .. } = Opened::read(path, &options.limits, progress)?;
    let visits = nodes::walk(buffers.document(), &mut notes)?;
    let mut placer = Placer::new(&buffers, options, progress);
    for visit in &visits {
        progress.check()?;
        placer.visit(visit, &mut notes)?;
    }
    let Placer { materials, mut scene, .. } = placer;
    scene.textures = materials.images.decode(&buffers, &mut files, &options.limits, progress)?;
    scene.materials = materials.list;
    progress.check()?;
    materials::note_clamped(&scene.materials, &scene.textures, &mut notes);
    progress.check()?;
    power::note(&scene, &mut notes);
    scene.name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    scene.notices = notes.finish();
    scene.inputs = files.into_inputs();
    Ok(scene)
}
