//! The bake's report: what ran, why, how long, and by which figures the result can be judged.

use luxel_export::report::{EnergyLedger, Input, Report, SceneInfo, Setting, Table1, Warning};
use luxel_scene::Scene;
use serde_json::Value as Json;

use super::Lit;
use super::journal::Journal;
use crate::plan::{Plan, Stage};
use crate::settings::Resolved;

/// The part that is known before the bake.
pub fn start(scene: &Scene, settings: &Resolved) -> Report {
    let inputs = scene.inputs.iter().map(Input::from).collect();
    let mut report = Report::new(SceneInfo { name: scene.name.clone(), inputs });
    report.versions.insert("luxel".into(), env!("CARGO_PKG_VERSION").into());
    report.settings = settings
        .list()
        .map(|(field, value, origin)| Setting {
            name: field.name.into(),
            value: json_form(&value),
            origin: origin.to_string(),
        })
        .collect();
    report.warnings = scene.notices.iter().map(Warning::from).collect();
    report
}

/// Numbers and booleans as such, everything else as text.
fn json_form(value: &str) -> Json {
    match serde_json::from_str(value) {
        Ok(json @ (Json::Number(_) | Json::Bool(_))) => json,
        _ => Json::String(value.into()),
    }
}

/// The part that the bake found out.
pub fn fill(report: &mut Report, scene: &Scene, plan: &Plan, lit: &Lit, journal: &Journal, seconds: f64) {
    report.stages = journal.entries.clone();
    let counted = |counter| Stage::ALL.iter().map(|s| journal.count(*s, counter)).sum::<u64>();
    for (name, count) in [
        ("triangles", plan.facts.triangles as u64),
        ("texels", lit.atlas.texels.len() as u64),
        ("buried_texels", lit.texels.buried.iter().filter(|b| **b).count() as u64),
        ("charts", lit.atlas.charts.len() as u64),
        ("surfels", lit.transport.surfels),
        ("continuous_rays", counted("continuous_rays")),
        ("discrete_rays", counted("discrete_rays")),
    ] {
        report.counters.insert(name.into(), count);
    }
    quality(report, lit);
    if let Some(miss) = &lit.transport.miss {
        warn(report, "cache-miss", miss.clone());
    }
    atlas_warnings(report, lit);
    if !scene.instances.is_empty() && plan.facts.receivers == 0 {
        warn(report, "nothing-receives", "nothing in the scene receives a lightmap");
    }
    if let Some(solve) = &lit.transport.solve {
        report.table1 = Some(table1(plan, lit, journal, solve, seconds));
        report.energy = Some(energy(lit, solve));
    }
}

fn warn(report: &mut Report, code: &str, message: impl Into<String>) {
    report.warnings.push(Warning { code: code.into(), message: message.into() });
}

/// Figures by which a result can be judged; sums in f64 in the order of texels.
fn quality(report: &mut Report, lit: &Lit) {
    let (mut area, mut direct, mut indirect, mut bound) = (0.0, 0.0, 0.0, 0.0);
    let light = &lit.texels;
    for (i, texel) in lit.atlas.texels.iter().enumerate() {
        if light.buried[i] || texel.coverage < 0.5 {
            continue;
        }
        let a = f64::from(texel.footprint) * f64::from(texel.footprint);
        area += a;
        direct += a * f64::from(light.direct[i].element_sum()) / 3.0;
        indirect += a * f64::from(light.indirect[i].element_sum()) / 3.0;
        bound += a * f64::from(light.bound[i]);
    }
    let mut put = |name: &str, value: f64| {
        report.quality.insert(name.into(), value);
    };
    if area > 0.0 {
        put("mean_irradiance_lux", (direct + indirect) / area);
        put("mean_direct_lux", direct / area);
        put("mean_indirect_lux", indirect / area);
        put("mean_bound_lux", bound / area);
    }
    put("atlas_utilisation", lit.atlas_report.utilisation);
    put("texels_per_unit", lit.atlas_report.density);
    if let Some(solve) = &lit.transport.solve {
        put("tail", solve.tail);
        if let Some(rows) = &solve.rows {
            put("mean_row_sum", rows.mean);
            put("row_sum_defect", rows.defect());
        }
    }
}

fn atlas_warnings(report: &mut Report, lit: &Lit) {
    let atlas = &lit.atlas_report;
    for (mesh, reason) in &atlas.unwrapped_anew {
        warn(report, "unwrapped-anew", format!("{mesh}: its TEXCOORD_1 is not used because {reason}"));
    }
    for (mesh, reason, triangles) in &atlas.fallbacks {
        warn(report, "projected", format!("{mesh}: {triangles} triangles were projected because {reason}"));
    }
    for (instance, density) in &atlas.lowered {
        let message = format!("{instance}: lowered to {density:.3} texels per unit to fit on a page");
        warn(report, "density-lowered", message);
    }
}

fn table1(
    plan: &Plan,
    lit: &Lit,
    journal: &Journal,
    solve: &luxel_transport::solve::SolveReport,
    seconds: f64,
) -> Table1 {
    let gathered = [Stage::Direct, Stage::Sky, Stage::Gather];
    let sum = |stages: &[Stage]| stages.iter().map(|s| journal.seconds(*s)).sum::<f64>();
    let tracing = [Stage::Shoot, Stage::Direct, Stage::Sky, Stage::Gather];
    Table1 {
        triangles: plan.facts.triangles as u64,
        voxels: lit.transport.surfels,
        light_path_length: solve.path_length() as u64,
        voxel_directions: solve.bounces.first().map_or(0, |b| u64::from(b.directions)),
        primary_photons: journal.count(Stage::Shoot, "primary_photons"),
        direct_photons: journal.count(Stage::Shoot, "direct_photons"),
        continuous_rays: tracing.iter().map(|s| journal.count(*s, "continuous_rays")).sum(),
        discrete_rays: solve.discrete_rays,
        propagation_seconds: sum(&[Stage::Surfels, Stage::Shoot, Stage::Propagate]),
        linear_method_seconds: journal.seconds(Stage::Propagate),
        reconstruction_seconds: sum(&gathered),
        overall_seconds: seconds,
        ..Table1::default()
    }
    .with_rates(sum(&tracing))
}

/// The solver's books, in lumens.
fn energy(lit: &Lit, solve: &luxel_transport::solve::SolveReport) -> EnergyLedger {
    let scale = lit.transport.scale;
    let ledger = solve.ledger.scaled(1.0 / (scale * scale));
    EnergyLedger {
        emitted: ledger.shot.to_array(),
        from_sky: ledger.sky.to_array(),
        absorbed: ledger.absorbed.to_array(),
        escaped: ledger.escaped.to_array(),
        remaining: ledger.in_flight.to_array(),
        defect: ledger.imbalance.to_array(),
    }
}
