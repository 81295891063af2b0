//! `level.bake.json`: what a bake did, in a documented and stable form.
//!
//! `schema` is 2. Within one schema number fields are only ever added; a reader ignores what it does not know. Times
//! are seconds of wall clock, light is in SI photometric units, hashes are BLAKE3 as 64 hexadecimal digits. A field
//! that does not apply is absent; no field is ever null.
//!
//! In schema 1 the counter `direct_photons` was what is `arrived_photons` now, and so was `direct_photons` of `table1`.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::ExportError;

/// The number of the form described here.
pub const SCHEMA: u32 = 2;

/// The whole report of one baked scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Always [`SCHEMA`].
    pub schema: u32,
    /// The files are a draft: lit with coarse voxels at few texels, from the unwrap of the real bake, which `luxel watch`
    /// writes over them. There is no picture and no bound then, and `settings` are those of the bake that is to follow;
    /// what the draft did instead is in `stages`. Absent where it is false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub draft: bool,
    /// The scene file as it was named, and its name in messages.
    pub scene: SceneInfo,
    /// Versions of `luxel`, of every stage by its name, and of the `octree file`: what decides whether a stored artefact
    /// can be used again.
    pub versions: BTreeMap<String, String>,
    /// Every setting with its resolved value and where that came from, in the order of the settings' documentation.
    pub settings: Vec<Setting>,
    /// BLAKE3 digests of what the scene consists of, by words (`geometry`, `materials`, `lights`, `the sky`, `what
    /// receives light`): what differs between two reports has changed. Absent in reports of earlier versions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parts: BTreeMap<String, String>,
    /// The light groups, in the order in which they are summed. Absent in reports of earlier versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub light_groups: Vec<LightGroup>,
    /// Weights of the light groups, where they were exported with others than the scene's. Absent in a bake's report.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub mix: BTreeMap<String, f64>,
    /// Stages in the order in which they run.
    pub stages: Vec<Stage>,
    /// Counters of the scene and of what this bake itself computed: `triangles`, `texels`, `buried_texels`, `charts`,
    /// `surfels`, `primary_photons`, `arrived_photons`, `continuous_rays`, `discrete_rays`. What reused stages counted
    /// when they ran is in `stages`.
    pub counters: BTreeMap<String, u64>,
    /// The paper's Table 1 for this scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table1: Option<Table1>,
    /// Where the light went.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy: Option<EnergyLedger>,
    /// Figures by which the result's quality can be judged: `mean_irradiance_lux` and its parts `mean_direct_lux` and
    /// `mean_indirect_lux`; `mean_bound_lux` where a bound is asked for and stated;
    /// `mean_cut` and `longest_cut` (clusters) of lightcuts; `mean_row_sum`,
    /// `row_sum_defect` and `tail` of the propagation; `atlas_utilisation`, `texels_per_unit`.
    pub quality: BTreeMap<String, f64>,
    /// What a person should know, each once.
    pub warnings: Vec<Warning>,
    /// The files that belong to this report, in the order in which they were written.
    pub outputs: Vec<Output>,
    /// How far the lightmap is from the reference at some of its texels. Absent where nobody asked for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verification: Option<Verification>,
    /// What was checked of the lightmap together with that.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub checks: Vec<Check>,
}

/// Which scene was baked.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SceneInfo {
    pub name: String,
    /// Every file that was read, with the hash of its bytes: the scene's own first.
    pub inputs: Vec<Input>,
    /// Files that the scene names and that could not be read: once they can be, the scene is another one. Absent in
    /// reports from before it was told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<Vec<String>>,
}

/// Lights that are baked together, at unit power.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightGroup {
    pub name: String,
    /// What its light is multiplied by, by band: the strongest of its sources [cd, lux or cd/m²]. Where a scene's
    /// emissive surfaces are too many to be told apart it is 1.
    pub factor: [f32; 3],
    /// Lamps, suns and emissive objects in it, and the sky.
    pub sources: u64,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    pub path: String,
    pub blake3: String,
}

/// One resolved setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    pub name: String,
    /// A number, boolean, list of numbers, or word.
    pub value: Value,
    /// `default`, `preset medium`, a configuration file's name, `extras of` the scene's path, `command line`, or
    /// `caller` where a program that embeds luxel chose it.
    pub origin: String,
}

/// What happened to a stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StageState {
    #[default]
    #[serde(rename = "ran")]
    Ran,
    #[serde(rename = "reused")]
    Reused,
    #[serde(rename = "left out")]
    LeftOut,
}

/// One stage of the bake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    pub name: String,
    pub state: StageState,
    /// Why it ran, was reused or was left out, in words.
    pub reason: String,
    /// Wall-clock time; 0 for a stage that was reused or left out.
    pub seconds: f64,
    /// What the stage counted; of a reused one, what it counted when it ran.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub counters: BTreeMap<String, u64>,
}

/// The rows of the paper's Table 1 (Piwowar & Malgouyres 2009), for this scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table1 {
    /// Whether the light at surfels was made in this bake. Where it was reused, the counts are those of the bake that
    /// made it; times and rates are always this bake's own.
    #[serde(default)]
    pub state: StageState,
    /// "number of triangles", instances expanded.
    pub triangles: u64,
    /// "number of voxels": surfels, of which a voxel holds one per orientation.
    pub voxels: u64,
    /// "Light path length": bounces, the first one included.
    pub light_path_length: u64,
    /// "Voxel directions" of the first bounce.
    pub voxel_directions: u64,
    /// "Primary photons" shot from the lamps; 0 where direct light came without photons.
    pub primary_photons: u64,
    /// "Direct photons": those from each primary one; 0 where there are none.
    pub direct_photons: u64,
    /// "Continuous Rays": rays traced against triangles.
    pub continuous_rays: u64,
    /// "Discrete Rays": surfels × directions, summed over the bounces.
    pub discrete_rays: u64,
    /// "Rays/sec (continuous)".
    pub continuous_rays_per_second: f64,
    /// "Rays/sec (discrete)".
    pub discrete_rays_per_second: f64,
    /// "Propagation Time": voxels, shooting, propagation and refresh (s).
    pub propagation_seconds: f64,
    /// "Linear method Time": the discrete sweeps alone (s).
    pub linear_method_seconds: f64,
    /// "Reconstruction Time": the gather (s).
    pub reconstruction_seconds: f64,
    /// "Overall Time" (s).
    pub overall_seconds: f64,
    /// Discrete over continuous rays per second; the paper has 36 and 75.
    pub discrete_over_continuous: f64,
}

impl Table1 {
    /// Fills the three rates from counts and times; a rate without time is 0. `traced` continuous rays took
    /// `continuous_seconds`: fewer than there are in all where some of them are a stored bake's.
    pub fn with_rates(mut self, traced: u64, continuous_seconds: f64) -> Self {
        let rate = |count: u64, seconds: f64| if seconds > 0.0 { count as f64 / seconds } else { 0.0 };
        self.continuous_rays_per_second = rate(traced, continuous_seconds);
        self.discrete_rays_per_second = rate(self.discrete_rays, self.linear_method_seconds);
        self.discrete_over_continuous = if self.continuous_rays_per_second > 0.0 {
            self.discrete_rays_per_second / self.continuous_rays_per_second
        } else {
            0.0
        };
        self
    }
}

/// The energy balance of transport, in lumens (linear RGB). `emitted + from_sky = absorbed + escaped + remaining +
/// defect` in every band.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnergyLedger {
    /// Whether these are the books of this bake's propagation, or those of the stored light that was reused.
    #[serde(default)]
    pub state: StageState,
    /// Flux that lamps and emitters sent to surfaces.
    pub emitted: [f64; 3],
    /// Flux that the sky sent to surfaces: what the first sweep brought and let escape, less what surfaces sent into it,
    /// and not below 0. That sweep's own loss or gain is in it; where the sky reaches next to nothing, it is all of it.
    pub from_sky: [f64; 3],
    pub absorbed: [f64; 3],
    /// Flux that left the scene.
    pub escaped: [f64; 3],
    /// What surfaces reflected of all light, the estimated rest included, less what propagation sent on. A residual
    /// with a sign: one factor for all bands continues the bounces, so a band to which it gives too much is negative.
    pub remaining: [f64; 3],
    /// What is missing from the balance: the method's own loss.
    pub defect: [f64; 3],
    /// Where the light was after every stage: `shoot`, `bounce 1` and so on, `stiff` (what the solver for bright rooms
    /// added) or `tail` (the estimated rest of the bounces), `refresh`, `gather` (what the lightmap holds). Absent in
    /// reports of earlier versions. Here no term is found by the balance itself.
    #[serde(default)]
    pub stages: Vec<EnergyStage>,
}

/// Where the light is after a stage, in lumens (linear RGB), all stages before it included: `emitted + from_sky =
/// absorbed + escaped + in_flight + imbalance` in every band.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnergyStage {
    pub name: String,
    /// The lights' own flux; of suns the flux through the scene's silhouette.
    pub emitted: [f64; 3],
    /// The sky's flux to surfaces, by rays of its own.
    pub from_sky: [f64; 3],
    /// By surfaces, their backs, veils, and the distance windows of lamps.
    pub absorbed: [f64; 3],
    /// Left the scene.
    pub escaped: [f64; 3],
    /// Reflected and not propagated yet.
    pub in_flight: [f64; 3],
    /// Lost (positive) or made (negative).
    pub imbalance: [f64; 3],
    /// Standard error of what is estimated among these.
    pub error: [f64; 3],
    /// The imbalance as a share of `emitted + from_sky`, absolute values summed over the bands.
    pub share: f64,
    /// The standard error likewise.
    pub share_error: f64,
}

impl EnergyStage {
    /// Fills what follows from the other fields.
    pub fn closed(mut self) -> Self {
        for b in 0..3 {
            self.imbalance[b] =
                self.emitted[b] + self.from_sky[b] - self.absorbed[b] - self.escaped[b] - self.in_flight[b];
        }
        let all: f64 = self.emitted.iter().chain(&self.from_sky).sum();
        let share = |of: &[f64; 3]| if all > 0.0 { of.iter().map(|x| x.abs()).sum::<f64>() / all } else { 0.0 };
        (self.share, self.share_error) = (share(&self.imbalance), share(&self.error));
        self
    }
}

/// The error of a lightmap at some of its texels against the reference path tracer: shares of the mean irradiance, with
/// intervals that hold the value with 95 % confidence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verification {
    /// Why nothing was compared. Absent where something was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nothing: Option<String>,
    /// Texels that were asked for, and that could be: covered by half and not buried.
    pub asked: u64,
    pub available: u64,
    /// Texels that were drawn in proportion to their area, and the part of them that was compared: texels whose light is
    /// that of a place beside them, because something stands on them, are not.
    pub drawn: u64,
    pub texels: u64,
    /// Paths of the reference at each.
    pub paths: u64,
    /// Mean irradiance of the reference [lux].
    pub mean_lux: f64,
    /// Root mean square error, the reference's own noise taken off.
    pub rmse: f64,
    pub rmse_low: f64,
    pub rmse_high: f64,
    /// Mean error: positive where the lightmap is too bright.
    pub bias: f64,
    pub bias_low: f64,
    pub bias_high: f64,
    /// Percentiles of |ΔY| / max(Y, 1 % of the mean Y), Y the mean over the bands; the reference's noise is in them.
    pub median: f64,
    pub median_low: f64,
    pub median_high: f64,
    pub p95: f64,
    pub p95_low: f64,
    pub p95_high: f64,
    /// Mean of Δ²/(E² + (1 % of the mean)²) over texels and bands, the reference's noise taken off.
    pub rel_mse: f64,
    /// Root mean square of the reference's standard error.
    pub reference_noise: f64,
    /// Of light straight from lamps, suns and emissive surfaces, and of all other light. Absent where a texel holds
    /// the light of two sides, or one part alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direct: Option<PartError>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indirect: Option<PartError>,
    /// Texels that were looked at for leaks alone.
    pub probed: u64,
    /// The texels with the largest errors, the worst first.
    pub worst: Vec<Place>,
}

/// The error of a part of the light, as shares of the mean of all light, the reference's noise taken off.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartError {
    pub mean_lux: f64,
    pub rmse: f64,
    pub bias: f64,
}

/// A texel whose light is not what it should be.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Place {
    pub object: String,
    /// In scene units.
    pub position: [f64; 3],
    pub page: u64,
    /// Column and row on its page.
    pub texel: [u64; 2],
    /// Irradiance [lux] by the reference, and in the lightmap.
    pub expected: [f64; 3],
    pub found: [f64; 3],
}

/// Something that must hold of a lightmap.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// `uv-overlap`, `buried`, `leaks`, `energy`, `values`.
    pub name: String,
    pub passed: bool,
    pub value: f64,
    /// The largest value that passes.
    pub limit: f64,
    /// What the value is, and where it is not what it should be what to do.
    pub message: String,
}

/// Something a person should know.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// A stable word for machines.
    pub code: String,
    pub message: String,
}

/// A file of this bake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Relative to the report's folder.
    pub path: String,
    pub bytes: u64,
    pub blake3: String,
}

impl Report {
    pub fn new(scene: SceneInfo) -> Self {
        Self { schema: SCHEMA, scene, ..Self::default() }
    }

    /// The file's bytes: indented, one line feed at the end. A figure that is no number (a rate over zero seconds) is
    /// an error that names it, because JSON would turn it into null.
    pub fn to_json(&self) -> Result<Vec<u8>, ExportError> {
        let value = serde_json::to_value(self).map_err(|e| ExportError::encode("the report", e))?;
        if let Some(place) = null_in(&value) {
            return Err(ExportError::encode(
                "the report",
                format!("{place} is null: no number, or a setting without value"),
            ));
        }
        let mut bytes = serde_json::to_vec_pretty(&value).map_err(|e| ExportError::encode("the report", e))?;
        bytes.push(b'\n');
        Ok(bytes)
    }
}

impl From<&luxel_scene::Notice> for Warning {
    fn from(notice: &luxel_scene::Notice) -> Self {
        Self { code: notice.code.into(), message: notice.message.clone() }
    }
}

impl From<&luxel_scene::InputFile> for Input {
    fn from(file: &luxel_scene::InputFile) -> Self {
        Self { path: written(&file.path), blake3: blake3::Hash::from(file.digest).to_hex().to_string() }
    }
}

/// A path as reports write it: with slashes on every system.
pub fn written(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/")
}

/// Path of the first null, in the manner of `stages/2/seconds`.
fn null_in(value: &Value) -> Option<String> {
    let below = |name: String, value: &Value| {
        null_in(value).map(|rest| if rest.is_empty() { name.clone() } else { format!("{name}/{rest}") })
    };
    match value {
        Value::Null => Some(String::new()),
        Value::Array(items) => items.iter().enumerate().find_map(|(i, v)| below(i.to_string(), v)),
        Value::Object(map) => map.iter().find_map(|(k, v)| below(k.clone(), v)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Report {
        let mut report = Report::new(SceneInfo {
            name: "level.glb".into(),
            inputs: vec![Input { path: "level.glb".into(), blake3: "00".repeat(32) }],
            missing: Some(vec!["wall.png".into()]),
        });
        report.versions.insert("luxel".into(), "0.1.0".into());
        report.settings.push(Setting { name: "size".into(), value: 1024.into(), origin: "default".into() });
        let counters = BTreeMap::from([("surfels".into(), 7)]);
        report.stages.push(Stage {
            name: "voxelize".into(),
            state: StageState::Ran,
            reason: "needed".into(),
            seconds: 0.1,
            counters,
        });
        report.stages.push(Stage {
            name: "propagate".into(),
            state: StageState::LeftOut,
            reason: "every surface is black".into(),
            seconds: 0.0,
            counters: BTreeMap::new(),
        });
        report.table1 = Some(Table1 { continuous_rays: 100, ..Table1::default() }.with_rates(100, 2.0));
        report.energy = Some(EnergyLedger { emitted: [1.0; 3], ..EnergyLedger::default() });
        report.quality.insert("mean_row_sum".into(), 0.9996);
        report.warnings.push(Warning { code: "no-light".into(), message: "no light".into() });
        report.outputs.push(Output { path: "level.glb".into(), bytes: 3, blake3: "11".repeat(32) });
        report
    }

    #[test]
    fn a_report_comes_back_equal_and_its_words_are_stable() {
        let report = full();
        let bytes = report.to_json().unwrap();
        assert_eq!(serde_json::from_slice::<Report>(&bytes).unwrap(), report);
        let json: Value = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(json["schema"], SCHEMA);
        assert_eq!(json["stages"][0]["state"], "ran");
        assert_eq!(json["stages"][1]["state"], "left out");
        assert_eq!(json["table1"]["continuous_rays_per_second"], 50.0);
        let keys: Vec<_> = json.as_object().unwrap().keys().map(String::as_str).collect();
        let expected = [
            "schema", "scene", "versions", "settings", "stages", "counters", "table1", "energy", "quality", "warnings",
            "outputs",
        ];
        assert_eq!(keys, expected);
    }

    #[test]
    fn later_fields_do_not_disturb_a_reader() {
        let mut json: Value = serde_json::from_slice(&full().to_json().unwrap()).unwrap();
        json["a_field_of_the_future"] = 1.into();
        assert_eq!(serde_json::from_value::<Report>(json).unwrap(), full());
    }

    #[test]
    fn a_figure_that_is_no_number_is_named() {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut report = full();
            report.stages[1].seconds = bad;
            let error = report.to_json().unwrap_err().to_string();
            assert!(error.contains("stages/1/seconds"), "{error}");
        }
    }
}
