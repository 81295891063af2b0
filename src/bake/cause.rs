//! Why stages run, or need not: what has changed since the bake that wrote the outputs.
//!
//! Reports hold the digests of the parts that a scene consists of (see [`super::keys`]). Nothing is decided by them:
//! they give words to what the keys of artefacts decide.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;

use luxel_export::report::StageState;
use luxel_export::{OutputSet, Report};
use serde_json::Value as Json;

use super::keys::{self, GEOMETRY, Keys, LIGHTS, MATERIALS, RECEIVERS, SKY};
use super::report::{json_form, versions};
use crate::plan::Stage;
use crate::settings::Resolved;

/// Longest report that is read [bytes].
const LONGEST: u64 = 16 << 20;

/// What is known of the bake before this one.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Cause {
    /// Nothing is stored, so nobody asks.
    #[default]
    Unasked,
    /// There are no outputs of one.
    Unknown,
    Known(Changes),
}

/// What has changed since an earlier bake.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// Parts of the scene, by the words for them.
    parts: Vec<String>,
    settings: Vec<String>,
    is_other_version: bool,
    /// Stages that it left out, by their names.
    left_out: BTreeSet<String>,
}

impl Cause {
    /// Why what is stored serves: `only lights changed`.
    pub fn of_reuse(&self) -> String {
        match self {
            Self::Unasked | Self::Unknown => "its input was seen before".into(),
            Self::Known(changes) => match changes.words(None) {
                Some(words) => format!("only {words} changed"),
                None => "nothing that it reads has changed".into(),
            },
        }
    }

    /// Why a stage that stores what it makes runs: `lights changed`; none for one that stores nothing.
    pub fn of_run(&self, stage: Stage) -> Option<String> {
        let (parts, settings) = reads(stage)?;
        match self {
            Self::Unasked => None,
            Self::Unknown => Some("nothing stored for it".into()),
            Self::Known(changes) => {
                // One that was left out was so because of something that it does not read itself: that nothing shone.
                let is_new = changes.left_out.contains(stage.name());
                Some(match changes.words((!is_new).then_some((parts, &settings))) {
                    Some(words) => format!("{words} changed"),
                    None => "not stored any more".into(),
                })
            }
        }
    }
}

impl Changes {
    fn new(last: &Report, keys: &Keys, settings: &Resolved) -> Self {
        let was = |name: &str| last.parts.get(name).map(String::as_str);
        let differs = |(name, digest): &(&String, &String)| was(name) != Some(digest.as_str());
        let parts = keys.parts.iter().filter(differs).map(|(name, _)| name.clone()).collect();
        let settings: BTreeMap<&str, Json> =
            settings.list().map(|(field, value, _)| (field.name, json_form(&value))).collect();
        let differs = |s: &&luxel_export::report::Setting| {
            // As it comes back from a file, where the last digit of a number may be lost.
            let settled = |now: &Json| serde_json::from_str::<Json>(&now.to_string()).ok();
            settings.get(s.name.as_str()).is_some_and(|now| settled(now).as_ref() != Some(&s.value))
        };
        let named = last.settings.iter().filter(differs).filter(|s| super::matters(&s.name));
        let left_out = last.stages.iter().filter(|s| s.state == StageState::LeftOut);
        Self {
            parts,
            settings: named.map(|s| s.name.clone()).collect(),
            is_other_version: last.versions != versions(),
            left_out: left_out.map(|s| s.name.clone()).collect(),
        }
    }

    /// The changes in words; with what a stage reads, those of its input alone.
    fn words(&self, read: Option<(&[&str], &BTreeSet<&str>)>) -> Option<String> {
        let parts = self.parts.iter().filter(|part| read.is_none_or(|(parts, _)| parts.contains(&part.as_str())));
        let settings = self.settings.iter().filter(|s| read.is_none_or(|(_, settings)| settings.contains(s.as_str())));
        let version = self.is_other_version.then(|| "luxel itself".to_owned());
        let named = parts.cloned().chain(settings.map(|s| format!("the setting {s}"))).chain(version);
        match &named.collect::<Vec<_>>()[..] {
            [] => None,
            [first @ .., last] if !first.is_empty() => Some(format!("{} and {last}", first.join(", "))),
            [only, ..] => Some(only.clone()),
        }
    }
}

/// The parts of a scene and the settings that a stage's artefact follows from, as its key does; none for stages that
/// store nothing.
fn reads(stage: Stage) -> Option<(&'static [&'static str], BTreeSet<&'static str>)> {
    use Stage::*;
    let texels = [&keys::LAYOUT[..], &keys::CLEAR];
    let lights = [&keys::SHADOWS[..], &keys::CROWD];
    let surfels = [&keys::SURFELS[..]];
    let octree = [&keys::SURFELS[..], &keys::PHOTONS, &keys::SOLUTION, &lights.concat()].concat();
    let (parts, settings): (&[&str], Vec<&str>) = match stage {
        Import | Rays | Preview | Export => return None,
        Unwrap => (&[RECEIVERS], keys::LAYOUT.to_vec()),
        Clear => (&[GEOMETRY, MATERIALS, RECEIVERS], texels.concat()),
        Surfels => (&[GEOMETRY, MATERIALS], surfels.concat()),
        Shoot => (&[GEOMETRY, MATERIALS, LIGHTS], [&keys::SURFELS[..], &keys::PHOTONS, &lights.concat()].concat()),
        Propagate | Refresh | Cache => (&[GEOMETRY, MATERIALS, LIGHTS, SKY], octree),
        Direct => (&[GEOMETRY, MATERIALS, RECEIVERS, LIGHTS], [texels.concat(), lights.concat()].concat()),
        Sky => (&[GEOMETRY, MATERIALS, RECEIVERS, SKY], [texels.concat(), keys::SKY_LIGHT.to_vec()].concat()),
        Gather | Finish => {
            let gather = [&keys::GATHER[..], &keys::MODE, &keys::FINISH, &keys::SKY_LIGHT].concat();
            (&[GEOMETRY, MATERIALS, RECEIVERS, LIGHTS, SKY], [texels.concat(), octree, gather].concat())
        }
    };
    Some((parts, settings.into_iter().collect()))
}

/// What is known of the bake that wrote the outputs.
pub fn of(outputs: &OutputSet, keys: &Keys, settings: &Resolved) -> Cause {
    last(outputs).map_or(Cause::Unknown, |last| Cause::Known(Changes::new(&last, keys, settings)))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(parts: &[&str], settings: &[&str]) -> Changes {
        let own = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        Changes { parts: own(parts), settings: own(settings), ..Changes::default() }
    }

    #[test]
    fn a_stage_that_runs_tells_what_changed_of_its_input() {
        let run = |changes: &Changes, stage| Cause::Known(changes.clone()).of_run(stage).unwrap();
        let both = changes(&[LIGHTS, MATERIALS], &["size"]);
        assert_eq!(run(&both, Stage::Surfels), "materials changed");
        assert_eq!(run(&both, Stage::Shoot), "lights and materials changed");
        assert_eq!(run(&both, Stage::Clear), "materials and the setting size changed");
        assert_eq!(run(&both, Stage::Finish), "lights, materials and the setting size changed");
        assert_eq!(run(&both, Stage::Unwrap), "the setting size changed");
        let lights = changes(&[LIGHTS], &[]);
        assert_eq!(run(&lights, Stage::Surfels), "not stored any more");
        assert_eq!(run(&Changes { is_other_version: true, ..lights.clone() }, Stage::Surfels), "luxel itself changed");
        let left_out = BTreeSet::from(["surfels".to_owned()]);
        assert_eq!(run(&Changes { left_out, ..lights.clone() }, Stage::Surfels), "lights changed");
        assert_eq!(Cause::Known(lights.clone()).of_run(Stage::Import), None);
        assert_eq!(Cause::Unknown.of_run(Stage::Gather).as_deref(), Some("nothing stored for it"));
        assert_eq!(Cause::Unasked.of_run(Stage::Gather), None);
    }

    #[test]
    fn what_is_reused_tells_all_that_changed() {
        let reuse = |changes: Changes| Cause::Known(changes).of_reuse();
        assert_eq!(reuse(changes(&[LIGHTS], &["size"])), "only lights and the setting size changed");
        assert_eq!(reuse(changes(&[], &["rule"])), "only the setting rule changed");
        assert_eq!(reuse(changes(&[], &[])), "nothing that it reads has changed");
        assert_eq!(Cause::Unknown.of_reuse(), "its input was seen before");
    }
}
