//! The bake's report: what ran, why, how long, and by which figures the result can be judged.

use std::collections::BTreeMap;

use luxel_atlas::AtlasReport;
use luxel_export::report::{EnergyLedger, Input, LightGroup, Report, SceneInfo, Setting, Table1, Warning, written};
use luxel_scene::Scene;
use serde_json::Value as Json;

use super::energy;
use super::groups::Group;
use super::input::Inputs;
use super::journal::Journal;
use super::light::Sums;
use super::table::table1;
use super::{Baking, Lit};
use crate::plan::{Plan, Stage};
use crate::settings::{Resolved, Settings};
use crate::store::Kind;
use crate::verify::{Verified, gate};

/// The part that is known before the bake.
pub fn start(
    scene: &Scene,
    inputs: &Inputs,
    plan: &Plan,
    settings: &Resolved,
    parts: &BTreeMap<String, String>,
) -> Report {
    let mut report = Report::new(SceneInfo {
        name: scene.name.clone(),
        inputs: inputs.read.iter().map(Input::from).collect(),
        missing: Some(inputs.missing.iter().map(|path| written(path)).collect()),
    });
    report.versions = versions();
    report.settings = settings
        .list()
        .map(|(field, value, origin)| Setting {
            name: field.name.into(),
            value: json_form(&value),
            origin: origin.to_string(),
        })
        .collect();
    report.parts = parts.clone();
    report.warnings = plan.warnings.clone();
    report
}

/// The versions of everything that decides a result.
pub fn versions() -> BTreeMap<String, String> {
    let own =
        [("luxel", env!("CARGO_PKG_VERSION").into()), ("octree file", Kind::Solution.format().version.to_string())];
    let stages = Stage::ALL.iter().map(|stage| (stage.name(), stage.version().to_string()));
    own.into_iter().chain(stages).map(|(name, version)| (name.into(), version)).collect()
}

/// Numbers, booleans and lists of numbers as such, everything else as text.
pub fn json_form(value: &str) -> Json {
    let plain = |text: &str| match serde_json::from_str(text) {
        Ok(json @ (Json::Number(_) | Json::Bool(_))) => Some(json),
        _ => None,
    };
    let list = || value.contains(',').then(|| value.split(',').map(plain).collect::<Option<Vec<_>>>())?;
    plain(value).or_else(|| list().map(Json::Array)).unwrap_or_else(|| Json::String(value.into()))
}

/// The part that the bake found out.
pub fn fill(
    report: &mut Report,
    scene: &Scene,
    baking: &Baking,
    lit: &Lit,
    notes: Vec<String>,
    journal: Journal,
    seconds: f64,
) {
    let Baking { settings, plan, lighting, .. } = baking;
    report.light_groups = lighting.groups.iter().map(light_group).collect();
    let counted = |counter| Stage::ALL.iter().map(|s| journal.count_run(*s, counter)).sum::<u64>();
    for (name, count) in [
        ("triangles", plan.facts.triangles as u64),
        ("texels", lit.atlas.texels.len() as u64),
        ("buried_texels", lit.sums.buried),
        ("charts", lit.atlas.charts.len() as u64),
        ("surfels", lit.transport.surfels),
        ("primary_photons", counted("primary_photons")),
        ("arrived_photons", counted("arrived_photons")),
        ("continuous_rays", counted("continuous_rays")),
        ("discrete_rays", counted("discrete_rays")),
    ] {
        report.counters.insert(name.into(), count);
    }
    quality(report, plan, lit, settings, &journal);
    if settings.bound && !plan.states_bound(settings) {
        warn(report, "no-bound", no_bound(plan, settings));
    }
    if let Some(why) = &lighting.joined {
        warn(report, "one-light-group", format!("all lights are one group: {why}"));
    }
    for note in notes {
        warn(report, "store", note);
    }
    atlas_warnings(report, scene, lit);
    if scene.triangle_count() == 0 {
        warn(report, "no-geometry", "the scene has no triangles, so there is nothing to bake");
    } else if plan.facts.receivers == 0 {
        warn(report, "nothing-receives", "nothing in the scene receives a lightmap");
    }
    if let Some(record) = &lit.transport.record {
        let state = journal.state(Stage::Propagate).unwrap_or_default();
        let figures = table1(plan.facts.triangles, &lit.transport, &journal, seconds);
        report.table1 = Some(Table1 { state, ..figures });
        report.energy = Some(EnergyLedger { state, ..record.energy.clone() });
        report.warnings.extend(energy::warning(&record.energy.stages));
    }
    if let Some(Verified { verification, checks }) = &lit.verified {
        for check in checks.iter().filter(|check| !check.passed && check.name != "energy") {
            warn(report, "check", gate::told(check));
        }
        (report.verification, report.checks) = (Some(verification.clone()), checks.clone());
    }
    report.stages = journal.close();
}

fn light_group(group: &Group) -> LightGroup {
    let sources = group.sources.len() as u64 + u64::from(group.sky.is_some());
    LightGroup { name: group.name.clone(), factor: group.factor.to_array(), sources }
}

/// Why a map of stated bounds that is wanted is not written.
fn no_bound(plan: &Plan, settings: &Settings) -> String {
    if settings.states_bound() {
        let reason = plan.reason(Stage::Gather);
        return format!("no bound image is written: no light was gathered that a bound could be stated of ({reason})");
    }
    let mode = settings.gatherer().name();
    format!("the gather mode {mode} states no error bound, so no bound image is written; --gather lightcuts states one")
}

fn warn(report: &mut Report, code: &str, message: impl Into<String>) {
    report.warnings.push(Warning { code: code.into(), message: message.into() });
}

/// Figures by which a result can be judged.
fn quality(report: &mut Report, plan: &Plan, lit: &Lit, settings: &Settings, journal: &Journal) {
    let Sums { area, direct, indirect, bound, .. } = lit.sums;
    let mut put = |name: &str, value: f64| {
        report.quality.insert(name.into(), value);
    };
    if area > 0.0 {
        put("mean_irradiance_lux", (direct + indirect) / area);
        put("mean_direct_lux", direct / area);
        put("mean_indirect_lux", indirect / area);
        if plan.states_bound(settings) {
            put("mean_bound_lux", bound / area);
        }
    }
    put("atlas_utilisation", lit.atlas_report.utilisation);
    put("texels_per_unit", lit.atlas_report.density);
    let cuts = journal.count(Stage::Gather, "gathered_texels");
    if cuts > 0 && settings.states_bound() {
        put("mean_cut", journal.count(Stage::Gather, "clusters") as f64 / cuts as f64);
        put("longest_cut", journal.count(Stage::Gather, "longest_cut") as f64);
    }
    if let Some(record) = &lit.transport.record {
        put("tail", record.tail);
        if let Some([mean, defect]) = record.rows {
            put("mean_row_sum", mean);
            put("row_sum_defect", defect);
        }
    }
}

/// How the meshes came by their texels' layout, in words: `new` of them were unwrapped in this very bake, and the place
/// of their charts was stored or is found by it.
pub fn layouts(atlas: &AtlasReport, new: usize, is_placed: bool) -> String {
    format!(
        "meshes unwrapped now: {new}, unwraps that were stored: {}, further instances that share an unwrap: {}, meshes \
         that keep their TEXCOORD_1: {}, {}",
        (atlas.unwrapped as usize).saturating_sub(new),
        atlas.shared,
        atlas.kept.len(),
        if is_placed { "charts where they were" } else { "charts placed anew" }
    )
}

/// Names of things that are too many to be listed, in one line.
fn some<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    const SHOWN: usize = 3;
    let rest = names.len().saturating_sub(SHOWN);
    let list = names.take(SHOWN).collect::<Vec<_>>().join(", ");
    if rest > 0 { format!("{list} and {rest} more") } else { list }
}

/// A positive number with four significant digits.
fn figures(x: f64) -> String {
    let decimals = 3.0 - libm::log10(x).floor();
    if (-2.0..=6.0).contains(&decimals) { format!("{x:.*}", decimals.max(0.0) as usize) } else { format!("{x:.3e}") }
}

fn atlas_warnings(report: &mut Report, scene: &Scene, lit: &Lit) {
    let atlas = &lit.atlas_report;
    for (mesh, reason) in &atlas.unwrapped_anew {
        warn(report, "unwrapped-anew", format!("{mesh}: its TEXCOORD_1 is not used because {reason}"));
    }
    for (mesh, reason, triangles) in &atlas.fallbacks {
        warn(report, "projected", format!("{mesh}: {triangles} triangles were projected because {reason}"));
    }
    if let Some(least) = atlas.lowered.iter().map(|(_, density)| *density).min_by(f64::total_cmp) {
        let names = some(atlas.lowered.iter().map(|(name, _)| name.as_str()));
        let scaled = scene.instances.iter().any(|i| i.texel_scale != 1.0);
        let remedy = atlas.enough.map_or_else(
            || "ask for less with --texel-density, or split the object into smaller ones".into(),
            |side| format!("--size {side} keeps it"),
        );
        let message = format!(
            "{names}: wanted {} texels a unit{}, lowered to {} at least to fit on a page; {remedy}",
            figures(atlas.wanted),
            if scaled { " times luxel_scale" } else { "" },
            figures(least),
        );
        warn(report, "density-lowered", message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn lowered_objects_are_told_in_one_line_with_the_remedy() {
        let mut lit = Lit::default();
        lit.atlas_report.wanted = 64.0;
        lit.atlas_report.enough = Some(512);
        lit.atlas_report.lowered = (0..9).map(|i| (format!("wall {i}"), 20.0 - f64::from(i))).collect();
        let mut report = Report::default();
        atlas_warnings(&mut report, &Scene::default(), &lit);
        let [warning] = &report.warnings[..] else { panic!("{:?}", report.warnings) };
        let expected = "wall 0, wall 1, wall 2 and 6 more: wanted 64.00 texels a unit, lowered to 12.00 at least";
        assert!(warning.message.starts_with(expected), "{}", warning.message);
        assert!(warning.message.ends_with("; --size 512 keeps it"), "{}", warning.message);

        lit.atlas_report.wanted = 1e30;
        lit.atlas_report.enough = None;
        lit.atlas_report.lowered = vec![("hall".into(), 0.012_344)];
        let mut report = Report::default();
        atlas_warnings(&mut report, &Scene::default(), &lit);
        let expected = "hall: wanted 1.000e30 texels a unit, lowered to 0.01234 at least to fit on a page; \
                        ask for less with --texel-density, or split the object into smaller ones";
        assert_eq!(report.warnings[0].message, expected);
    }

    #[test]
    fn figures_are_four_digits() {
        for (x, text) in [(10.0, "10.00"), (0.002_560_4, "0.002560"), (123_456.0, "123456"), (2e-7, "2.000e-7")] {
            assert_eq!(figures(x), text);
        }
    }

    #[test]
    fn settings_keep_their_kind() {
        assert_eq!(json_form("64"), json!(64));
        assert_eq!(json_form("true"), json!(true));
        assert_eq!(json_form("1,0.5,2"), json!([1, 0.5, 2]));
        for text in ["side:128", "auto", "none", "1,1,1/2,2,2/3,3,3", "a,b.hdr", ""] {
            assert_eq!(json_form(text), json!(text));
        }
    }
}
