//! Results and failures, for people and for programs.

use std::path::{Path, PathBuf};

use luxel::current::{Reason, State};
use luxel::plan::Plan;
use luxel::text::{indented, plain, shown};
use luxel::verify::{Verified, gate};
use luxel::watch::event::{Done, Event};
use luxel_export::report::Warning;
use serde_json::{Value, json};

use crate::cli::progress::{Reporter, Style, duration, event, out, say};

/// Who shows a line to a person.
pub type Say<'s> = &'s dyn Fn(&str);

/// A path in an event; people are [`shown`] it. One that is not Unicode has no form in JSON: its other bytes are replaced.
pub fn written(path: &Path) -> String {
    path.display().to_string()
}

/// A finished scene: its files, and what a person should know.
pub fn baked(style: Style, scene: &Path, done: Done) {
    baked_by(style, &say, scene, done, None);
}

/// [`baked`] of one scene among others.
pub fn baked_on(reporter: &Reporter, scene: &Path, done: Done, verified: Option<Verified>) {
    baked_by(reporter.style(), &|line| reporter.say(line), scene, done, verified);
}

fn baked_by(style: Style, say: Say, scene: &Path, done: Done, verified: Option<Verified>) {
    match style {
        Style::Quiet => {}
        Style::Json => event(&with_verified(Event::Baked { scene: scene.into(), done }.to_json(), verified)),
        Style::Lines | Style::Bar => {
            notes(say, &done.warnings);
            verification(say, verified);
            for file in &done.outputs {
                say(&format!("  wrote {}", shown(file)));
            }
            say(&format!("  done in {}", duration(done.seconds)));
        }
    }
}

/// An event with what was verified.
fn with_verified(mut event: Value, verified: Option<Verified>) -> Value {
    if let Some(Verified { verification, checks }) = verified {
        event["verification"] = json!(verification);
        event["checks"] = json!(checks);
    }
    event
}

/// The error of a lightmap, and how many checks passed; those that failed are among the warnings.
fn verification(say: Say, verified: Option<Verified>) {
    if let Some(Verified { verification, checks }) = verified {
        say(&format!("  {}", gate::line(&verification)));
        let passed = checks.iter().filter(|check| check.passed).count();
        let names: Vec<_> = checks.iter().map(|check| plain(&check.name)).collect();
        say(&format!("  checks: {passed} of {} passed ({})", checks.len(), names.join(", ")));
    }
}

/// A scene that is left alone.
pub fn unchanged(reporter: &Reporter, scene: &Path, outputs: &[PathBuf], verified: Option<Verified>) {
    match reporter.style() {
        Style::Quiet => {}
        Style::Json => {
            let outputs: Vec<String> = outputs.iter().map(|path| written(path)).collect();
            let told = json!({ "event": "unchanged", "scene": written(scene), "outputs": outputs });
            event(&with_verified(told, verified));
        }
        Style::Lines | Style::Bar => {
            reporter.say("  unchanged");
            verification(&|line| reporter.say(line), verified);
        }
    }
}

/// A scene whose outputs are not current.
pub fn stale(reporter: &Reporter, scene: &Path, reasons: &[Reason]) {
    match reporter.style() {
        Style::Quiet => {}
        Style::Json => event(&json!({ "event": "stale", "scene": written(scene), "reasons": listed(reasons) })),
        Style::Lines | Style::Bar => {
            reasons.iter().for_each(|reason| reporter.say(&format!("  stale: {reason}")));
        }
    }
}

fn listed(reasons: &[Reason]) -> Vec<serde_json::Value> {
    reasons.iter().map(Reason::to_json).collect()
}

/// What a person should know, a line each.
pub fn notes(say: Say, warnings: &[Warning]) {
    for warning in warnings {
        say(&format!("  note: {}", plain(&warning.message)));
    }
}

/// A plan as a table, or as one JSON object; first of all, whether there is anything to do.
pub fn plan(style: Style, scene: &Path, plan: &Plan, state: &State) {
    let reasons = if let State::Stale(reasons) = state { &reasons[..] } else { &[] };
    if style == Style::Json {
        let (name, is_unchanged) = (written(scene), reasons.is_empty());
        let stale = listed(reasons);
        event(&json!({ "event": "plan", "scene": name, "plan": plan, "unchanged": is_unchanged, "stale": stale }));
        return;
    }
    let mut text = String::new();
    if reasons.is_empty() {
        text += "  unchanged  its outputs are current, so a bake leaves it alone; with --force:\n";
    }
    for reason in reasons {
        text += &format!("  stale      {reason}\n");
    }
    for step in &plan.steps {
        let state = match (step.runs, step.reused) {
            (true, true) => "reused",
            (true, false) => "run",
            (false, _) => "left out",
        };
        text += &format!("  {:<10} {state:<9} {}\n", step.stage.name(), plain(&step.reason));
    }
    if !plan.light_groups.is_empty() {
        let names: Vec<_> = plan.light_groups.iter().map(|name| plain(name)).collect();
        text += &format!("  groups     {}\n", names.join(", "));
    }
    let m = &plan.memory;
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    text += &format!(
        "  memory     about {} MiB beyond the scene: rays {}, surfels {}, texels {}, images {}, files {}\n",
        mib(m.total()),
        mib(m.rays),
        mib(m.surfels),
        mib(m.texels),
        mib(m.images),
        mib(m.files)
    );
    out(&text);
    if style != Style::Quiet {
        notes(&say, &plan.warnings);
    }
}

/// A scene that failed.
pub fn failed(style: Style, scene: &Path, error: &anyhow::Error) {
    failed_by(style, &say, scene, error, None);
}

/// [`failed`] of one scene among others.
pub fn failed_on(reporter: &Reporter, scene: &Path, error: &anyhow::Error, verified: Option<Verified>) {
    failed_by(reporter.style(), &|line| reporter.say(line), scene, error, verified);
}

fn failed_by(style: Style, say: Say, scene: &Path, error: &anyhow::Error, verified: Option<Verified>) {
    if style != Style::Json {
        return failure_by(say, Some(scene), error);
    }
    let (scene, text, causes) = (written(scene), error.to_string(), causes(error));
    event(&with_verified(json!({ "event": "failed", "scene": scene, "error": text, "causes": causes }), verified));
}

/// What an error says of its causes, from the nearest on.
fn causes(error: &anyhow::Error) -> Vec<String> {
    error.chain().skip(1).map(ToString::to_string).collect()
}

/// The end of a command line that could not be followed, for programs.
pub fn misused(error: &anyhow::Error) {
    event(&json!({ "event": "usage", "error": error.to_string(), "causes": causes(error) }));
}

/// An error with its causes, each on its own line.
pub fn failure(scene: Option<&Path>, error: &anyhow::Error) {
    failure_by(&say, scene, error);
}

fn failure_by(say: Say, scene: Option<&Path>, error: &anyhow::Error) {
    let name = scene.map(|scene| (written(scene), shown(scene)));
    let mut lines = error.chain().map(|message| match &name {
        // Messages name paths as they are; the scene's is the one that is known here.
        Some((raw, shown)) if raw != shown => indented(&message.to_string().replace(raw, shown)),
        _ => indented(&message.to_string()),
    });
    let first = lines.next().unwrap_or_default();
    // A message that already names the file does not need it twice.
    match name.as_ref().map(|(_, shown)| shown).filter(|shown| !first.contains(shown.as_str())) {
        Some(scene) => say(&format!("error: {scene}: {first}")),
        None => say(&format!("error: {first}")),
    }
    for cause in lines {
        say(&format!("  because: {cause}"));
    }
}
