//! What a watch tells: an editor's plug-in, a preview, a person's terminal.
//!
//! As JSON, one object a line. Every object has `event` and the fields listed; paths are written as the command line
//! named them or the folder that was scanned continues them. Readers pass over events and fields that they do not know.
//!
//! | `event` | fields | when |
//! |---|---|---|
//! | `preview` | `url`, `notice` | with `--preview`, before all others: where the page is, and what has to be done before it shows anything, or null |
//! | `watching` | `paths` [text], `scenes` number | once, at the start |
//! | `waiting` | `scene`, `outputs` [text] | after `watching`, each scene; with the report of its last bake, where there is one, whether or not it is current |
//! | `polling` | `folder`, `reason`, `seconds` | a folder is looked at every so often, though nobody asked for it, because nobody tells of changes in it |
//! | `unwatched` | `path`, `reason` | a folder cannot be watched or read; luxel goes on with what it sees |
//! | `found` | `scene` | a scene has come |
//! | `changed` | `scene`, `files` [text] | files of a scene have other content than before; empty where its settings have changed alone |
//! | `moved` | `scene`, `glb` | its outputs have other names from now on, since a scene of its name has come beside it or has gone; those of the old names stay |
//! | `lost` | `scene`, `files` [text] | outputs of a scene that was current are not there any more: it is baked again |
//! | `unchanged` | `scene`, `files` [text] | files were touched, and hold what they held |
//! | `removed` | `scene` | a scene has gone; its outputs stay |
//! | `baking` | `scene` | a bake begins |
//! | `drafted` | `scene`, `seconds`, `outputs` [text], `quality` {name: number}, `warnings` [{`code`, `message`}] | a draft of what is being baked is in place of the scene's outputs, until the bake ends |
//! | `overtaken` | `scene` | a bake was stopped, because its files have changed meanwhile; another one follows unless they were changed back or removed |
//! | `baked` | `scene`, `seconds`, `outputs` [text], `quality` {name: number}, `warnings` [{`code`, `message`}] | a bake has ended well; all its files are in place |
//! | `failed` | `scene`, `error`, `causes` [text], `draft` | the scene cannot be baked as it is now; its last outputs stay: `draft` is true where they are a draft, false where they are a bake's, null where there are none; it is tried again when a file of it changes or, if the fault lies neither in its files nor in its settings, is touched |
//! | `current` | `scene`, `outputs` [text] | a scene is what its outputs were made from, when it is found or again after it was broken: nothing is baked |
//! | `unshown` | `scene`, `error`, `causes` [text] | the preview cannot show what was baked, and goes on showing what it shows |
//! | `idle` | `scenes` number, `failed` [text], `draft` [text] | everything is as current as it can be; `draft` names the scenes whose outputs are drafts |
//! | `stopped` | `scenes` number, `failed` [text], `draft` [text] | the last one: the watch was asked to end; `draft` as in `idle` |
//! | `usage` | `error`, `causes` [text] | the command line could not be followed: the last one, and as a rule the only one |
//!
//! Between `baking` and what ends it, a draft included, the tool also prints the events of its stages as `luxel bake --json` does
//! (`started`, `progress`, `finished`).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use luxel_export::report::Warning;
use serde_json::{Value, json};

/// Something that people or programs may want to know.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    Preview { url: String, notice: Option<String> },
    Watching { paths: Vec<PathBuf>, scenes: usize },
    Waiting { scene: PathBuf, outputs: Vec<PathBuf> },
    Polling { folder: PathBuf, reason: String, seconds: f64 },
    Unwatched { path: PathBuf, reason: String },
    Found { scene: PathBuf },
    Changed { scene: PathBuf, files: Vec<PathBuf> },
    Moved { scene: PathBuf, glb: PathBuf },
    Lost { scene: PathBuf, files: Vec<PathBuf> },
    Unchanged { scene: PathBuf, files: Vec<PathBuf> },
    Removed { scene: PathBuf },
    Baking { scene: PathBuf },
    Drafted { scene: PathBuf, done: Done },
    Overtaken { scene: PathBuf },
    Baked { scene: PathBuf, done: Done },
    Failed { scene: PathBuf, fault: Fault, draft: Option<bool> },
    Current { scene: PathBuf, outputs: Vec<PathBuf> },
    Unshown { scene: PathBuf, fault: Fault },
    Idle { scenes: usize, failed: Vec<PathBuf>, draft: Vec<PathBuf> },
    Stopped { scenes: usize, failed: Vec<PathBuf>, draft: Vec<PathBuf> },
}

/// What a bake that ended well tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Done {
    pub seconds: f64,
    /// In the order of writing.
    pub outputs: Vec<PathBuf>,
    pub quality: BTreeMap<String, f64>,
    pub warnings: Vec<Warning>,
}

/// Why a scene cannot be baked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fault {
    pub error: String,
    /// From the nearest on.
    pub causes: Vec<String>,
}

impl Fault {
    pub fn new(error: &dyn std::error::Error) -> Self {
        let causes = std::iter::successors(error.source(), |e| e.source()).map(ToString::to_string);
        Self { error: error.to_string(), causes: causes.collect() }
    }
}

impl Event {
    /// One line of the stream.
    pub fn to_json(&self) -> Value {
        match self {
            Self::Preview { url, notice } => json!({ "event": "preview", "url": url, "notice": notice }),
            Self::Watching { paths, scenes } => json!({ "event": "watching", "paths": texts(paths), "scenes": scenes }),
            Self::Polling { folder, reason, seconds } => {
                json!({ "event": "polling", "folder": text(folder), "reason": reason, "seconds": seconds })
            }
            Self::Unwatched { path, reason } => json!({ "event": "unwatched", "path": text(path), "reason": reason }),
            Self::Found { scene } => of("found", scene),
            Self::Changed { scene, files } => {
                json!({ "event": "changed", "scene": text(scene), "files": texts(files) })
            }
            Self::Moved { scene, glb } => json!({ "event": "moved", "scene": text(scene), "glb": text(glb) }),
            Self::Lost { scene, files } => json!({ "event": "lost", "scene": text(scene), "files": texts(files) }),
            Self::Unchanged { scene, files } => {
                json!({ "event": "unchanged", "scene": text(scene), "files": texts(files) })
            }
            Self::Removed { scene } => of("removed", scene),
            Self::Baking { scene } => of("baking", scene),
            Self::Overtaken { scene } => of("overtaken", scene),
            Self::Drafted { scene, done } => with_done("drafted", scene, done),
            Self::Baked { scene, done } => with_done("baked", scene, done),
            Self::Failed { scene, fault, draft } => {
                let mut json = with_fault("failed", scene, fault);
                json["draft"] = json!(draft);
                json
            }
            Self::Waiting { scene, outputs } => with_outputs("waiting", scene, outputs),
            Self::Current { scene, outputs } => with_outputs("current", scene, outputs),
            Self::Unshown { scene, fault } => with_fault("unshown", scene, fault),
            Self::Idle { scenes, failed, draft } => at_rest("idle", *scenes, failed, draft),
            Self::Stopped { scenes, failed, draft } => at_rest("stopped", *scenes, failed, draft),
        }
    }
}

fn of(event: &str, scene: &Path) -> Value {
    json!({ "event": event, "scene": text(scene) })
}

fn with_done(event: &str, scene: &Path, done: &Done) -> Value {
    json!({
        "event": event,
        "scene": text(scene),
        "seconds": done.seconds,
        "outputs": texts(&done.outputs),
        "quality": done.quality,
        "warnings": done.warnings,
    })
}

fn with_outputs(event: &str, scene: &Path, outputs: &[PathBuf]) -> Value {
    json!({ "event": event, "scene": text(scene), "outputs": texts(outputs) })
}

fn at_rest(event: &str, scenes: usize, failed: &[PathBuf], draft: &[PathBuf]) -> Value {
    json!({ "event": event, "scenes": scenes, "failed": texts(failed), "draft": texts(draft) })
}

fn with_fault(event: &str, scene: &Path, fault: &Fault) -> Value {
    json!({ "event": event, "scene": text(scene), "error": fault.error, "causes": fault.causes })
}

/// A path that is not Unicode has no form in JSON: its other bytes are replaced.
fn text(path: &Path) -> String {
    path.display().to_string()
}

fn texts(paths: &[PathBuf]) -> Vec<String> {
    paths.iter().map(|p| text(p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of the table above: an event's name and its fields.
    fn documented() -> BTreeMap<String, Vec<String>> {
        let rows = include_str!("event.rs").lines().filter_map(|line| line.strip_prefix("//! | `"));
        let names = |cell: &str| {
            // What stands in braces describes the value of a field.
            let plain = cell.split(['{', '}']).step_by(2).collect::<String>();
            plain.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>()
        };
        let row = |line: &str| {
            let mut cells = line.split(" | ");
            let event = cells.next()?.trim_end_matches('`').to_owned();
            Some((event, names(cells.next()?)))
        };
        rows.filter_map(row).filter(|(event, _)| event != "event").collect()
    }

    #[test]
    fn every_event_has_the_fields_that_are_documented() {
        let (scene, files) = (PathBuf::from("a.glb"), vec![PathBuf::from("a.bin")]);
        let fault = Fault::new(&crate::Error::Settings(
            crate::settings::Layer::from_file(Path::new("no/such.toml")).unwrap_err(),
        ));
        assert!(fault.error.contains("no/such.toml") && fault.causes.len() == 1, "{fault:?}");
        let all = [
            Event::Preview { url: "http://127.0.0.1:1/".into(), notice: None },
            Event::Watching { paths: files.clone(), scenes: 1 },
            Event::Waiting { scene: scene.clone(), outputs: files.clone() },
            Event::Polling { folder: scene.clone(), reason: "nfs".into(), seconds: 2.0 },
            Event::Unwatched { path: scene.clone(), reason: "no".into() },
            Event::Found { scene: scene.clone() },
            Event::Changed { scene: scene.clone(), files: files.clone() },
            Event::Moved { scene: scene.clone(), glb: scene.clone() },
            Event::Lost { scene: scene.clone(), files: files.clone() },
            Event::Unchanged { scene: scene.clone(), files: files.clone() },
            Event::Removed { scene: scene.clone() },
            Event::Baking { scene: scene.clone() },
            Event::Drafted { scene: scene.clone(), done: Done::default() },
            Event::Overtaken { scene: scene.clone() },
            Event::Baked { scene: scene.clone(), done: Done::default() },
            Event::Failed { scene: scene.clone(), fault: fault.clone(), draft: None },
            Event::Current { scene: scene.clone(), outputs: files.clone() },
            Event::Unshown { scene, fault },
            Event::Idle { scenes: 1, failed: files.clone(), draft: files.clone() },
            Event::Stopped { scenes: 1, failed: files, draft: Vec::new() },
        ];
        let mut documented = documented();
        for event in all {
            let json = event.to_json();
            let fields = documented.remove(json["event"].as_str().unwrap()).unwrap_or_else(|| panic!("{json}"));
            let own: Vec<&String> = json.as_object().unwrap().keys().filter(|k| *k != "event").collect();
            assert_eq!(own, fields.iter().collect::<Vec<_>>(), "{json}");
        }
        // The tool's own, told where no watch begins.
        assert!(documented.remove("usage").is_some());
        assert!(documented.is_empty(), "documented and never told: {documented:?}");
    }
}
