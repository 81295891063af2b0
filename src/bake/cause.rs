//! Why stages need not run again: what has changed since the bake that wrote the outputs.
//!
//! Reports hold the digests of the parts that a scene consists of (see [`super::keys`]). Nothing is decided by them:
//! they give words to what the keys of artefacts decide.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;

use luxel_export::{OutputSet, Report};
use serde_json::Value as Json;

use super::keys::Keys;
use super::report::json_form;
use crate::settings::Resolved;

/// Longest report that is read [bytes].
const LONGEST: u64 = 16 << 20;

/// What has changed, in words: `only lights changed`.
pub fn of(outputs: &OutputSet, keys: &Keys, settings: &Resolved) -> String {
    let Some(last) = last(outputs) else { return "its input was seen before".into() };
    let was = |name: &str| last.parts.get(name).map(String::as_str);
    let mut changed: Vec<String> = keys
        .parts
        .iter()
        .filter(|(name, digest)| was(name) != Some(digest.as_str()))
        .map(|(name, _)| name.clone())
        .collect();
    let settings: BTreeMap<&str, Json> =
        settings.list().map(|(field, value, _)| (field.name, json_form(&value))).collect();
    let differs = |s: &&luxel_export::report::Setting| {
        // As it comes back from a file, where the last digit of a number may be lost.
        let settled = |now: &Json| serde_json::from_str::<Json>(&now.to_string()).ok();
        settings.get(s.name.as_str()).is_some_and(|now| settled(now).as_ref() != Some(&s.value))
    };
    let named = last.settings.iter().filter(differs).filter(|s| super::matters(&s.name));
    changed.extend(named.map(|s| format!("the setting {}", s.name)));
    match &changed[..] {
        [] => "nothing that it reads has changed".into(),
        [first @ .., last] if !first.is_empty() => format!("only {} and {last} changed", first.join(", ")),
        [only, ..] => format!("only {only} changed"),
    }
}

fn last(outputs: &OutputSet) -> Option<Report> {
    let path = outputs.report();
    if !std::fs::metadata(&path).is_ok_and(|meta| meta.is_file()) {
        return None;
    }
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(LONGEST).read_to_end(&mut bytes).ok()?;
    let report: Report = serde_json::from_slice(&bytes).ok()?;
    // A draft is of the scene as it is now, most likely: what has changed is not to be learnt from it.
    (!report.parts.is_empty() && !report.draft).then_some(report)
}
