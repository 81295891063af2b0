//! Which settings and methods are tried.

use luxel_scene::Scene;

use super::ladder;
use crate::bake::{lab::Technique, needs};
use crate::plan::Memory;
use crate::settings::{Field, Gatherer, Settings};

/// What is measured at a point.
#[derive(Clone, Debug, PartialEq)]
pub enum Trial {
    /// A bake.
    Bake(Box<Settings>),
    /// A method at every texel, with the cached solution of these settings where it wants one.
    Method(Technique, Box<Settings>),
}

/// One point of a series, before it is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Attempt {
    pub method: String,
    pub value: String,
    pub x: f64,
    pub trial: Trial,
}

impl Attempt {
    /// The memory that it takes.
    pub fn needs(&self, scene: &Scene) -> Memory {
        match &self.trial {
            Trial::Bake(settings) => needs::bake(scene, settings),
            Trial::Method(technique, settings) => needs::method(scene, settings, *technique),
        }
    }
}

/// Points that differ in one thing.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    pub name: String,
    /// What it is about, for titles of plots.
    pub about: String,
    pub attempts: Vec<Attempt>,
}

/// The name of luxel's own way in tables and plots.
pub const OWN: &str = "voxels + lightcuts";

/// A setting that is varied alone.
struct Swept {
    name: &'static str,
    about: &'static str,
    /// From rough to fine.
    values: &'static [&'static str],
    /// How a value becomes a number that grows with the work, of which the error is a falling power.
    axis: fn(f64) -> f64,
}

const SWEPT: [Swept; 11] = [
    // The edge of a voxel falls with the root of their number.
    Swept {
        name: "voxels",
        about: "voxels along a side",
        values: &["6250", "12500", "25000", "50000", "100000", "200000", "400000"],
        axis: f64::sqrt,
    },
    Swept {
        name: "directions",
        about: "directions of the first bounce",
        values: &["32", "64", "128", "256", "512", "1024", "2048"],
        axis: same,
    },
    Swept {
        name: "direction_decay",
        about: "decay of directions",
        values: &["8", "4", "2", "1.414", "1"],
        axis: inverse,
    },
    Swept { name: "bounces", about: "bounces", values: &["1", "2", "3", "4", "6", "64"], axis: same },
    Swept { name: "refresh", about: "rays of a refresh", values: &["0", "16", "64", "256"], axis: same },
    Swept {
        name: "photons",
        about: "photons instead of exact light at surfels",
        values: &["4096", "65536", "1048576", "0"],
        axis: same,
    },
    Swept {
        name: "cut_error",
        about: "cut error",
        values: &["0.2", "0.1", "0.05", "0.025", "0.017", "0.01", "0.005"],
        axis: inverse,
    },
    Swept { name: "near_rays", about: "near rays", values: &["4", "8", "16", "32", "64"], axis: same },
    Swept { name: "node_spacing", about: "node spacing", values: &["16", "8", "4", "2", "1"], axis: inverse },
    Swept { name: "shadow_samples", about: "shadow samples", values: &["64", "128", "256", "512"], axis: same },
    Swept { name: "sky_rays", about: "sky rays", values: &["64", "256", "1024", "2048", "4096"], axis: same },
];

fn same(x: f64) -> f64 {
    x
}

fn inverse(x: f64) -> f64 {
    1.0 / x
}

/// The number that a setting's value is on the axis of its series.
pub fn abscissa(setting: &str, value: &str) -> f64 {
    let scale = SWEPT.iter().find(|s| s.name == setting).map_or(same as fn(f64) -> f64, |s| s.axis);
    value.parse().map(scale).unwrap_or_default()
}

/// Series of one setting each about the settings `base`. The sky's is left out where there is none.
pub fn sweeps(base: &Settings, has_sky: bool) -> Vec<Series> {
    SWEPT.iter().filter(|s| s.name != "sky_rays" || has_sky).map(|swept| sweep(base, swept)).collect()
}

fn sweep(base: &Settings, Swept { name, about, values, axis: _ }: &Swept) -> Series {
    let attempt = |value: &&str| Attempt {
        method: OWN.into(),
        value: (*value).into(),
        x: abscissa(name, value),
        trial: Trial::Bake(Box::new(with(base, name, value))),
    };
    Series { name: (*name).into(), about: (*about).into(), attempts: values.iter().map(attempt).collect() }
}

/// The names of all settings that are swept.
pub fn names() -> impl Iterator<Item = &'static str> {
    SWEPT.iter().map(|swept| swept.name)
}

/// The settings as they are.
pub fn as_it_is(base: &Settings) -> Series {
    let trial = Trial::Bake(Box::new(base.clone()));
    let attempt = Attempt { method: OWN.into(), value: "as it is".into(), x: 0.0, trial };
    Series { name: "settings".into(), about: "the settings as they are".into(), attempts: vec![attempt] }
}

/// All parameters together, rung by rung, but for those that are `fixed`.
pub fn together(base: &Settings, fixed: &[&str]) -> Series {
    let rung = |rung: u32| Attempt {
        method: OWN.into(),
        value: rung.to_string(),
        x: ladder::work(rung),
        trial: Trial::Bake(Box::new(ladder::rung_keeping(base, rung, fixed))),
    };
    let attempts = (0..ladder::RUNGS).map(rung).collect();
    Series { name: "together".into(), about: "all settings together".into(), attempts }
}

/// The comparators of the paper's Figure 3, each with more and more work.
pub fn methods(base: &Settings) -> Vec<Series> {
    let series =
        |name: &str, about: &str, attempts: Vec<Attempt>| Series { name: name.into(), about: about.into(), attempts };
    let method = |name: &str, x: u32, technique: Technique, settings: &Settings| Attempt {
        method: name.into(),
        value: x.to_string(),
        x: f64::from(x),
        trial: Trial::Method(technique, Box::new(settings.clone())),
    };
    let paths = |n: u32| method("path tracing", n, Technique::PathTracing { paths: n }, base);
    let photons = |n: u32| method("photon map + lightcuts", n, Technique::PhotonMap { photons: n }, base);
    let passes = |n: u32| method("sample voxels", n, Technique::SampleVoxels { passes: n }, base);
    let voxels = method("voxels shown", 1, Technique::Voxels, base);
    let lookup = method("look-up", 1, Technique::Cached(Gatherer::Lookup), base);
    let gather = |n: u32| {
        let settings = with(base, "gather_rays", &n.to_string());
        method("final gather", n, Technique::Cached(Gatherer::Final), &settings)
    };
    vec![
        series("path tracing", "paths a texel", [4, 16, 64, 256, 1024].map(paths).into()),
        series("photon map", "photons", [1024, 4096, 16_384, 65_536].map(photons).into()),
        series("sample voxels", "passes of two sets", [1, 2, 4, 8].map(passes).into()),
        series("voxels shown", "the voxels themselves", vec![voxels]),
        series("look-up", "the cache, interpolated", vec![lookup]),
        series("final gather", "rays a texel", [16, 64, 256].map(gather).into()),
    ]
}

/// Settings with another value of one of them.
pub fn with(base: &Settings, name: &str, value: &str) -> Settings {
    let mut settings = base.clone();
    let is_known = Field::find(name).is_some_and(|field| field.assign(&mut settings, value));
    debug_assert!(is_known, "{name} = {value}");
    settings
}

/// Settings like those of the paper's Table 1: so many voxels and directions in integer steps, photons for direct light,
/// light paths of this length, no refresh; its visible-voxel rule lost a third of the light, so luxel's own is kept.
pub fn of_the_paper(base: &Settings, voxels: u32, directions: u32, photons: u32, length: u32) -> Settings {
    [
        ("voxels", voxels.to_string()),
        ("directions", directions.to_string()),
        ("direction_set", "integer".into()),
        ("photons", photons.to_string()),
        ("bounces", (length - 1).to_string()),
        ("refresh", "0".into()),
        ("node_spacing", "1".into()),
        ("cut_error", "0.02".into()),
    ]
    .iter()
    .fold(base.clone(), |settings, (name, value)| with(&settings, name, value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_of_a_sweep_is_one_of_its_setting_and_they_rise() {
        let base = Settings::default();
        for series in sweeps(&base, true) {
            // A value that its setting does not take would leave the base as it is.
            let values: std::collections::BTreeSet<_> =
                series.attempts.iter().map(|a| format!("{:?}", a.trial)).collect();
            assert_eq!(series.attempts.len(), values.len(), "{}", series.name);
            // No photons stands for exact light, and no refresh for the least.
            let rising = series.attempts.iter().filter(|a| a.value != "0").map(|a| a.x).collect::<Vec<_>>();
            assert!(rising.windows(2).all(|w| w[0] < w[1]), "{}: {rising:?}", series.name);
        }
    }

    #[test]
    fn a_scene_without_a_sky_needs_no_rays_to_it() {
        let names = |sky| sweeps(&Settings::default(), sky).into_iter().map(|s| s.name).collect::<Vec<_>>();
        assert_eq!(names(true).len(), names(false).len() + 1);
        assert!(!names(false).contains(&"sky_rays".to_owned()));
    }
}
