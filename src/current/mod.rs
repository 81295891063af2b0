//! Whether a scene's outputs are what a bake would write now, found out without one.
//!
//! A bake is a pure function of the bytes that it reads, of the settings and of luxel's own versions, and its report
//! lists all of them together with the hashes of what it wrote. So the outputs are current exactly where every entry of
//! the report still holds. That costs reading and hashing the inputs and the outputs; no scene is imported.
//!
//! | looked at | stale where |
//! |---|---|
//! | report | it is not there, cannot be read, is another scene's, contradicts itself, or is that of a draft |
//! | versions | luxel or one of its stages has another one |
//! | settings | one that decides the result has another value, wherever it comes from now |
//! | inputs | one has other bytes, cannot be read any more, or can be read now and could not then |
//! | outputs | one is not there or has other bytes, or an image of another bake lies beside them |
//!
//! A report is as untrusted as a scene: it is read up to a size, files are opened only where the scene itself or the
//! names of its outputs lead, and what cannot be understood is stale. Of its other content (times, counters, warnings)
//! nothing follows, so a change there goes unnoticed.

mod inputs;
mod reason;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use luxel_export::report::SCHEMA;
use luxel_export::{OutputSet, Report};
use luxel_scene::import::{Limits, container::json_of, document::Document, files::Files};
use luxel_scene::{InputFile, Progress};
use serde_json::Value as Json;

use crate::Error;
use crate::bake::{guarded, json_form, matters, versions};
use crate::settings::{FIELDS, Resolved};
use inputs::Inputs;
pub use reason::Reason;

/// No report is larger [bytes].
const MAX_REPORT: u64 = 64 << 20;

/// Reasons that are told at most: a report may list as many outputs as it likes.
const MOST_REASONS: usize = 64;

/// What was found out about a scene's outputs.
#[derive(Clone, Debug)]
pub enum State {
    /// A bake would write the same files again, but for the times in the report.
    Current(Box<Outputs>),
    /// Why not; never empty.
    Stale(Vec<Reason>),
}

/// Outputs that are current.
#[derive(Clone, Debug)]
pub struct Outputs {
    pub report: Report,
    /// The files that belong together, in the order in which they were written, the report last.
    pub files: Vec<PathBuf>,
    /// Every file that they were made from, as it is now.
    pub inputs: Vec<InputFile>,
}

/// Finds out whether the `outputs` of a scene are what a bake with these settings would write. Reads only.
///
/// # Errors
/// The scene cannot be read or understood at all, the folder of the outputs cannot be listed, or the check was
/// cancelled. Anything else that is amiss makes the outputs stale.
pub fn check(scene: &Path, outputs: &OutputSet, settings: &Resolved, progress: &dyn Progress) -> Result<State, Error> {
    guarded(|| {
        progress.check()?;
        let state = compare(scene, outputs, settings, progress)?;
        if matches!(state, State::Stale(_)) {
            understand(scene)?;
        }
        Ok(state)
    })
}

fn compare(scene: &Path, outputs: &OutputSet, settings: &Resolved, progress: &dyn Progress) -> Result<State, Error> {
    let report = match read(&outputs.report()) {
        Ok(report) => report,
        Err(reason) => return Ok(State::Stale(vec![reason])),
    };
    let inputs = match Inputs::new(scene, settings, &report, progress)? {
        Ok(inputs) => inputs,
        Err(reason) => return Ok(State::Stale(vec![reason])),
    };
    let mut reasons = if report.draft { vec![Reason::Draft] } else { Vec::new() };
    reasons.extend(version_reasons(&report));
    reasons.extend((!report.mix.is_empty()).then_some(Reason::Mixed));
    reasons.extend(setting_reasons(&report, settings, inputs.is_same_sky));
    reasons.extend(inputs.reasons);
    let files = match written(&report, outputs, &mut reasons, progress)? {
        Ok(files) => files,
        Err(reason) => return Ok(State::Stale(vec![reason])),
    };
    reasons.truncate(MOST_REASONS);
    if reasons.is_empty() {
        return Ok(State::Current(Box::new(Outputs { report, files, inputs: inputs.read })));
    }
    Ok(State::Stale(reasons))
}

/// Whether what lies at these outputs is a draft; none where no report says what does.
pub fn is_draft(outputs: &OutputSet) -> Option<bool> {
    read(&outputs.report()).ok().map(|report| report.draft)
}

/// A scene that no bake could open is no stale one, but one that fails.
fn understand(scene: &Path) -> Result<(), Error> {
    let limits = Limits::default();
    let json = json_of(&mut Files::beside(scene, &limits), scene, &limits);
    let document = json.and_then(|json| Document::parse(&json, &limits));
    document.map(drop).map_err(|fault| fault.in_file(scene).into())
}

/// The report of what was written to a place, whatever has become of the rest since.
///
/// # Errors
/// There is none ([`Reason::Unbaked`]), or none that can be read.
pub fn report(outputs: &OutputSet) -> Result<Report, Reason> {
    read(&outputs.report())
}

/// The report, as far as it can be believed.
fn read(path: &Path) -> Result<Report, Reason> {
    let refused = |what: String| Reason::Report { what };
    let is_file = match std::fs::metadata(path) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Err(Reason::Unbaked);
        }
        meta => meta.map_err(|e| refused(e.to_string()))?.is_file(),
    };
    // A pipe would block for ever.
    if !is_file {
        return Err(refused("it is not a regular file".into()));
    }
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|e| refused(e.to_string()))?;
    file.take(MAX_REPORT + 1).read_to_end(&mut bytes).map_err(|e| refused(e.to_string()))?;
    if bytes.len() as u64 > MAX_REPORT {
        return Err(refused(format!("it has more than {MAX_REPORT} bytes")));
    }
    let report: Report = serde_json::from_slice(&bytes).map_err(|e| refused(e.to_string()))?;
    if report.schema != SCHEMA {
        return Err(refused(format!("its schema is {} and not {SCHEMA}", report.schema)));
    }
    Ok(report)
}

fn version_reasons(report: &Report) -> Vec<Reason> {
    let now = versions();
    let names: BTreeSet<&String> = report.versions.keys().chain(now.keys()).collect();
    let differs = |name: &&String| report.versions.get(*name) != now.get(*name);
    let version = |of: &BTreeMap<String, String>, name: &String| of.get(name).cloned().unwrap_or_else(|| "none".into());
    let reason = |name: &String| Reason::Version {
        of: name.clone(),
        was: version(&report.versions, name),
        is: version(&now, name),
    };
    names.into_iter().filter(differs).map(reason).collect()
}

fn setting_reasons(report: &Report, settings: &Resolved, is_same_sky: bool) -> Vec<Reason> {
    let mut reasons = Vec::new();
    for (field, value, _) in settings.list() {
        let is = settled(json_form(&value));
        match report.settings.iter().find(|s| s.name == field.name) {
            None => reasons.push(Reason::Report { what: format!("the setting {} is not in it", field.name) }),
            Some(was) if was.value == is || !matters(field.name) || field.name == "sky" && is_same_sky => {}
            Some(was) => {
                reasons.push(Reason::Setting { name: field.name.into(), was: text(&was.value), is: text(&is) })
            }
        }
    }
    if report.settings.len() > FIELDS.len() {
        reasons.push(Reason::Report { what: "it has settings that this luxel has not".into() });
    }
    reasons
}

/// A value as it comes back from a file: the last digit of a number may be lost on the way, the same one every time.
fn settled(value: Json) -> Json {
    serde_json::from_str(&value.to_string()).unwrap_or(value)
}

/// A setting's value as it would be chosen.
fn text(value: &Json) -> String {
    match value {
        Json::String(text) => text.clone(),
        Json::Array(items) => items.iter().map(text).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

/// The files of the bake, whether they are what it wrote or not; `reasons` tells that. The inner error is a list of
/// outputs that no bake writes.
fn written(
    report: &Report,
    outputs: &OutputSet,
    reasons: &mut Vec<Reason>,
    progress: &dyn Progress,
) -> Result<Result<Vec<PathBuf>, Reason>, Error> {
    let Some(names) = names(report, outputs) else {
        let what = "its list of outputs is not one of this scene's bakes".into();
        return Ok(Err(Reason::Report { what }));
    };
    for (path, output) in names.iter().zip(&report.outputs) {
        progress.check()?;
        let path = path.clone();
        match std::fs::metadata(&path) {
            Err(_) => reasons.push(Reason::OutputMissing { path }),
            // Another length is another content, which need not be read.
            Ok(meta) if meta.is_file() && meta.len() == output.bytes && digest_is(&path, &output.blake3) => {}
            Ok(_) => reasons.push(Reason::OutputChanged { path }),
        }
    }
    let all: Vec<&PathBuf> = names.iter().collect();
    // Without a folder all of them are missing, which is said.
    reasons.extend(outputs.stale(&all)?.into_iter().map(|path| Reason::LeftOver { path }));
    let mut files = names;
    files.push(outputs.report());
    Ok(Ok(files))
}

fn digest_is(path: &Path, wanted: &str) -> bool {
    let mut hasher = blake3::Hasher::new();
    let read = File::open(path).and_then(|file| hasher.update_reader(file).map(|h| h.finalize()));
    read.is_ok_and(|digest| digest.to_hex().as_str() == wanted)
}

/// Where the outputs that the report lists lie: lightmaps of all pages, bounds of all or none, at most one picture, and
/// the .glb, in this order. None where they are anything else.
fn names(report: &Report, outputs: &OutputSet) -> Option<Vec<PathBuf>> {
    let listed: Vec<PathBuf> = report.outputs.iter().map(|o| outputs.folder().join(&o.path)).collect();
    let pages = report.outputs.iter().take_while(|o| is_lightmap(&o.path, outputs.stem())).count();
    let mut expected: Vec<PathBuf> = (0..pages).map(|page| outputs.lightmap(page, pages)).collect();
    if pages > 0 && listed.contains(&outputs.bound(0, pages)) {
        expected.extend((0..pages).map(|page| outputs.bound(page, pages)));
    }
    expected.extend(Some(outputs.preview()).filter(|preview| listed.contains(preview)));
    expected.push(outputs.glb());
    (listed == expected).then_some(expected)
}

fn is_lightmap(name: &str, stem: &str) -> bool {
    name.strip_prefix(stem).is_some_and(|rest| rest.starts_with(".lightmap."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_export::report::Output;

    fn listed(names: &[&str]) -> Option<usize> {
        let output = |name: &&str| Output { path: (*name).into(), bytes: 0, blake3: String::new() };
        let report = Report { outputs: names.iter().map(output).collect(), ..Report::default() };
        let outputs = OutputSet::new(Path::new("levels/a.glb"), None, None).unwrap();
        names_of(&report, &outputs)
    }

    fn names_of(report: &Report, outputs: &OutputSet) -> Option<usize> {
        let files = names(report, outputs)?;
        assert!(files.iter().all(|file| file.parent() == Some(outputs.folder())));
        Some(files.len())
    }

    #[test]
    fn outputs_are_whole_sets_in_the_order_of_writing() {
        assert_eq!(listed(&["a.glb"]), Some(1));
        assert_eq!(listed(&["a.lightmap.exr", "a.bound.exr", "a.preview.png", "a.glb"]), Some(4));
        let pages =
            ["a.lightmap.0.exr", "a.lightmap.1.exr", "a.bound.0.exr", "a.bound.1.exr", "a.preview.png", "a.glb"];
        assert_eq!(listed(&pages), Some(6));
        for left_out in [0, 1, 2, 3, 5] {
            let rest: Vec<&str> = pages.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, n)| *n).collect();
            assert_eq!(listed(&rest), None, "{rest:?}");
        }
        for wrong in [
            &["a.glb", "a.preview.png"][..],
            &["b.lightmap.exr", "a.glb"],
            &["a.bound.exr", "a.glb"],
            &["a.lightmap.exr", "/a.glb"],
            &["a.lightmap.exr", "../baked/a.glb"],
            &["a.glb", "a.glb"],
            &[],
        ] {
            assert_eq!(listed(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn values_are_compared_as_they_come_back_from_a_file() {
        for text in ["0.0003", "0.1", "1e-5", "16", "1,0.5,0.3333333", "auto", "true"] {
            let value = json_form(text);
            let file = serde_json::to_vec_pretty(&value).unwrap();
            assert_eq!(serde_json::from_slice::<Json>(&file).unwrap(), settled(value), "{text}");
        }
    }
}
