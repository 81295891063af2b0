//! The files that a scene is made from, as the report lists them and as they are now.
//!
//! A report writes paths as the command line named the scene then. The same scene may be named otherwise now, so files
//! are told apart by their names as seen from the scene's folder, and the sky image by the setting that names it. Only
//! files that the scene or the settings name now are opened, never those that a report claims.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use luxel_export::Report;
use luxel_export::report::written;
use luxel_scene::{InputFile, Progress};
use serde_json::Value as Json;

use super::Reason;
use crate::Error;
use crate::content::{Content, named, sky};
use crate::settings::Resolved;

/// What has become of the inputs.
#[derive(Debug, Default)]
pub struct Inputs {
    pub reasons: Vec<Reason>,
    /// Those that are as they were.
    pub read: Vec<InputFile>,
    /// The setting names the sky image of then, which may lie elsewhere now; of its content the reasons tell.
    pub is_same_sky: bool,
}

/// A digest as reports write it.
fn hex(content: &Content) -> Option<String> {
    if let Content::Digest(digest) = content { Some(blake3::Hash::from(*digest).to_hex().to_string()) } else { None }
}

/// A report's list of inputs, taken apart.
struct Listed<'a> {
    scene: &'a str,
    /// Its folder, with a last slash.
    folder: &'a str,
    /// Digests by the names that the scene gives its files.
    files: BTreeMap<&'a str, &'a str>,
    /// Names of files that could not be read.
    missing: Vec<&'a str>,
    /// Path and digest of the sky image.
    sky: Option<(&'a str, &'a str)>,
}

impl<'a> Listed<'a> {
    /// # Errors
    /// The report is not one of this scene.
    fn new(scene: &Path, report: &'a Report) -> Result<Self, Reason> {
        let refused = |what: &str| Reason::Report { what: what.into() };
        let (first, rest) = report.scene.inputs.split_first().ok_or_else(|| refused("it lists no input"))?;
        let (folder, name) = split(&first.path);
        if name != split(&written(scene)).1 {
            return Err(refused("it is the report of a scene with another name"));
        }
        let missing = report.scene.missing.as_ref();
        let missing = missing.ok_or_else(|| refused("it does not tell which files were missing"))?;
        let image = sky_of(report);
        let sky = rest.iter().rposition(|i| image.as_ref().is_some_and(|image| i.path == *image));
        let mut listed = Self {
            scene: &first.blake3,
            folder,
            files: BTreeMap::new(),
            missing: Vec::new(),
            sky: sky.and_then(|i| rest.get(i)).map(|input| (input.path.as_str(), input.blake3.as_str())),
        };
        let files = rest.iter().enumerate().filter(|(i, _)| Some(*i) != sky);
        listed.files = files.map(|(_, input)| (listed.own(&input.path), input.blake3.as_str())).collect();
        listed.missing = missing.iter().map(|path| listed.own(path)).collect();
        Ok(listed)
    }

    /// A path as seen from the scene's folder.
    fn own(&self, path: &'a str) -> &'a str {
        path.strip_prefix(self.folder).unwrap_or(path)
    }
}

/// The path of the sky image that the report's settings name, as a report writes paths.
fn sky_of(report: &Report) -> Option<String> {
    match &report.settings.iter().find(|s| s.name == "sky")?.value {
        Json::String(text) => Some(text.replace('\\', "/")),
        _ => None,
    }
}

/// The folder of a written path with its last slash, and the name in it.
fn split(path: &str) -> (&str, &str) {
    path.split_at(path.rfind('/').map_or(0, |slash| slash + 1))
}

impl Inputs {
    /// Reads every input. The inner error is a report that is not one of this scene.
    pub fn new(
        scene: &Path,
        settings: &Resolved,
        report: &Report,
        progress: &dyn Progress,
    ) -> Result<Result<Self, Reason>, Error> {
        let listed = match Listed::new(scene, report) {
            Ok(listed) => listed,
            Err(reason) => return Ok(Err(reason)),
        };
        let mut inputs = Self::default();
        let is_same = inputs.compare(scene, Content::of(scene), listed.scene);
        let own = written(scene);
        let folder = split(&own).0;
        let now: BTreeMap<String, PathBuf> = named(scene)
            .into_iter()
            .filter(|path| path != scene)
            .map(|path| (written(&path), path))
            .map(|(name, path)| (name.strip_prefix(folder).unwrap_or(&name).to_owned(), path))
            .collect();
        for (name, path) in &now {
            progress.check()?;
            if let Some(digest) = listed.files.get(name.as_str()) {
                inputs.compare(path, Content::of(path), digest);
            }
        }
        // Of a scene that has changed, other files than those that it named before say nothing.
        if is_same {
            inputs.lead_elsewhere(&listed, &now);
        }
        if let (Some(image), Some((path, was))) = (sky(settings), listed.sky) {
            let is = Content::of(&image);
            inputs.is_same_sky = hex(&is).as_deref() == Some(was);
            let (then, now) = (listed.own(path), written(&image));
            // Another image under another name is another setting, and is told as such.
            if inputs.is_same_sky || path == now || then == now.strip_prefix(folder).unwrap_or(&now) {
                inputs.is_same_sky = true;
                inputs.compare(&image, is, was);
            }
        }
        Ok(Ok(inputs))
    }

    /// Compares a file with its digest then; whether it is the same.
    fn compare(&mut self, path: &Path, is: Content, was: &str) -> bool {
        match is {
            Content::Digest(digest) if hex(&is).as_deref() == Some(was) => {
                self.read.push(InputFile { path: path.into(), digest });
                return true;
            }
            Content::Digest(_) => self.reasons.push(Reason::InputChanged { path: path.into() }),
            Content::Absent | Content::Refused(_) => self.reasons.push(Reason::InputGone { path: path.into() }),
        }
        false
    }

    /// The same scene leads to the same names unless files have come or gone: what was missing is there, or its name
    /// can be understood in another way by now.
    fn lead_elsewhere(&mut self, listed: &Listed, now: &BTreeMap<String, PathBuf>) {
        for name in &listed.missing {
            let path = now.get(*name).map_or_else(|| PathBuf::from(name), PathBuf::clone);
            if !now.contains_key(*name) || Content::of(&path).is_read() {
                self.reasons.push(Reason::InputNew { path });
            }
        }
        let gone = listed.files.keys().filter(|name| !now.contains_key(**name));
        self.reasons.extend(gone.map(|name| Reason::InputGone { path: name.into() }));
    }
}
