//! Which settings and methods are tried.

use luxel_scene::Scene;
use luxel_transport::directions::nearest_integer_set;

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

/// The series of the settings as they are.
pub const BASE: &str = "settings";

/// The series in which all settings grow together.
pub const TOGETHER: &str = "together";

/// What the light of the cached solution is called by how it is gathered, in tables and plots.
fn gathered(gatherer: Gatherer) -> &'static str {
    match gatherer {
        Gatherer::Lightcuts => "voxels + lightcuts",
        Gatherer::Final => "final gather",
        Gatherer::Lookup => "look-up",
    }
}

/// A bake with some settings.
pub fn bake(settings: Settings, value: String, x: f64) -> Attempt {
    let method = gathered(settings.gatherer()).into();
    Attempt { method, value, x, trial: Trial::Bake(Box::new(settings)) }
}

/// How the value of a setting becomes a number that grows with the work, of which the error is a falling power.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The number itself.
    Same,
    /// Its root: the edge of a voxel falls with the root of their number.
    Root,
    /// Its inverse.
    Inverse,
}

impl Axis {
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Same => value,
            Self::Root => value.sqrt(),
            Self::Inverse => 1.0 / value,
        }
    }

    /// The value at twice the number.
    fn doubled(self, value: f64) -> f64 {
        match self {
            Self::Same => 2.0 * value,
            Self::Root => 4.0 * value,
            Self::Inverse => 0.5 * value,
        }
    }
}

/// A setting that is varied alone.
struct Swept {
    name: &'static str,
    about: &'static str,
    /// From rough to fine.
    values: &'static [&'static str],
    axis: Axis,
}

const SWEPT: [Swept; 11] = [
    Swept {
        name: "voxels",
        about: "voxels along a side",
        values: &["6250", "12500", "25000", "50000", "100000", "200000", "400000"],
        axis: Axis::Root,
    },
    Swept {
        name: "directions",
        about: "directions of the first bounce",
        values: &["32", "64", "128", "256", "512", "1024", "2048"],
        axis: Axis::Same,
    },
    Swept {
        name: "direction_decay",
        about: "decay of directions",
        values: &["8", "4", "2", "1.414", "1"],
        axis: Axis::Inverse,
    },
    Swept { name: "bounces", about: "bounces", values: &["1", "2", "3", "4", "6", "64"], axis: Axis::Same },
    Swept { name: "refresh", about: "rays of a refresh", values: &["0", "16", "64", "256"], axis: Axis::Same },
    Swept {
        name: "photons",
        about: "photons instead of exact light at surfels",
        values: &["4096", "65536", "1048576", "0"],
        axis: Axis::Same,
    },
    Swept {
        name: "cut_error",
        about: "cut error",
        values: &["0.2", "0.1", "0.05", "0.025", "0.017", "0.01", "0.005"],
        axis: Axis::Inverse,
    },
    Swept { name: "near_rays", about: "near rays", values: &["4", "8", "16", "32", "64"], axis: Axis::Same },
    Swept { name: "node_spacing", about: "node spacing", values: &["16", "8", "4", "2", "1"], axis: Axis::Inverse },
    Swept { name: "shadow_samples", about: "shadow samples", values: &["64", "128", "256", "512"], axis: Axis::Same },
    Swept { name: "sky_rays", about: "sky rays", values: &["64", "256", "1024", "2048", "4096"], axis: Axis::Same },
];

/// The axis of a setting's series.
pub fn axis(setting: &str) -> Axis {
    SWEPT.iter().find(|s| s.name == setting).map_or(Axis::Same, |s| s.axis)
}

/// The number that a setting's value is on the axis of its series.
pub fn abscissa(setting: &str, value: &str) -> f64 {
    value.parse().map(|value| axis(setting).of(value)).unwrap_or_default()
}

/// The setting takes the value that stands for twice its number.
pub fn is_doubled(base: &Settings, field: &Field) -> bool {
    let takes = |value: f64| field.assign(&mut base.clone(), &value.to_string());
    // What is no number, as the edge of a voxel, has no end.
    (field.get)(base).parse().map_or(true, |value| {
        let doubled = axis(field.name).doubled(value);
        takes(doubled) || doubled >= 1.0 && doubled < value && takes(doubled.floor())
    })
}

/// Series of one setting each about the settings `base`. The sky's is left out where there is none.
pub fn sweeps(base: &Settings, has_sky: bool) -> Vec<Series> {
    SWEPT.iter().filter(|s| s.name != "sky_rays" || has_sky).map(|swept| sweep(base, swept)).collect()
}

fn sweep(base: &Settings, Swept { name, about, values, axis: _ }: &Swept) -> Series {
    let attempt = |value: &&str| bake(with(base, name, value), (*value).into(), abscissa(name, value));
    Series { name: (*name).into(), about: (*about).into(), attempts: values.iter().map(attempt).collect() }
}

/// The names of all settings that are swept.
pub fn names() -> impl Iterator<Item = &'static str> {
    SWEPT.iter().map(|swept| swept.name)
}

/// The settings as they are.
pub fn as_it_is(base: &Settings) -> Series {
    let attempt = bake(base.clone(), "as it is".into(), 0.0);
    Series { name: BASE.into(), about: "the settings as they are".into(), attempts: vec![attempt] }
}

/// All parameters together, rung by rung, but for those that are `fixed`.
pub fn together(base: &Settings, fixed: &[&str]) -> Series {
    let rung = |rung| bake(ladder::rung_keeping(base, rung, fixed), rung.to_string(), ladder::work(rung));
    let attempts = (0..ladder::RUNGS).map(rung).collect();
    Series { name: TOGETHER.into(), about: "all settings together".into(), attempts }
}

/// The names by which [`methods`] are chosen, which are those of pictures.
pub const METHODS: [&str; 7] = ["paths", "photons", "samples", "voxels", "lookup", "final", "lightcuts"];

/// The comparators of the paper's Figure 3, each with more and more work, those that are `wanted`.
pub fn methods(base: &Settings, wanted: impl Fn(&str) -> bool) -> Vec<Series> {
    METHODS.iter().zip(all_methods(base)).filter(|(name, _)| wanted(name)).map(|(_, series)| series).collect()
}

fn all_methods(base: &Settings) -> [Series; 7] {
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
    let gathered_by =
        |gatherer, n: u32, settings: &Settings| method(gathered(gatherer), n, Technique::Cached(gatherer), settings);
    let lookup = gathered_by(Gatherer::Lookup, 1, base);
    let gather = |n: u32| gathered_by(Gatherer::Final, n, &with(base, "gather_rays", &n.to_string()));
    let cut = |error: &str| {
        let attempt = gathered_by(Gatherer::Lightcuts, 1, &with(base, "cut_error", error));
        Attempt { value: error.into(), x: abscissa("cut_error", error), ..attempt }
    };
    [
        series("path tracing", "paths a texel", [4, 16, 64, 256, 1024].map(paths).into()),
        series("photon map", "photons", [1024, 4096, 16_384, 65_536].map(photons).into()),
        series("sample voxels", "passes of two sets", [1, 2, 4, 8].map(passes).into()),
        series("voxels shown", "the voxels themselves", vec![voxels]),
        series("look-up", "the cache, interpolated", vec![lookup]),
        series("final gather", "rays a texel", [16, 64, 256].map(gather).into()),
        series("lightcuts", "cut error, a cut at every texel", ["0.1", "0.03", "0.01"].map(cut).into()),
    ]
}

/// Settings with another value of one of them.
pub fn with(base: &Settings, name: &str, value: &str) -> Settings {
    let mut settings = base.clone();
    let is_known = Field::find(name).is_some_and(|field| field.assign(&mut settings, value));
    debug_assert!(is_known, "{name} = {value}");
    settings
}

/// Settings like those of the paper's Table 1: so many voxels, about so many directions in integer steps, photons for
/// direct light, light paths of this length, no refresh; its visible-voxel rule lost a third of the light, so luxel's
/// own is kept.
pub fn of_the_paper(base: &Settings, voxels: u32, directions: u32, photons: u32, length: u32) -> Settings {
    [
        ("voxels", voxels.to_string()),
        ("directions", nearest_integer_set(directions).to_string()),
        ("direction_set", "integer".into()),
        ("photons", photons.to_string()),
        ("bounces", (length - 1).to_string()),
        ("refresh", "0".into()),
        ("gather", "lightcuts".into()),
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
    fn the_paper_has_its_own_directions_or_the_nearest_there_are() {
        let directions = |n| of_the_paper(&Settings::default(), 1000, n, 1000, 4).directions.0;
        assert_eq!([146, 256].map(directions), [146, 266]);
        let draft = Settings { gather: crate::settings::GatherMode::Lookup, ..Settings::default() };
        assert_eq!(of_the_paper(&draft, 1000, 146, 1000, 4).gatherer(), Gatherer::Lightcuts);
    }

    #[test]
    fn methods_are_chosen_by_the_names_that_pictures_have() {
        let all = methods(&Settings::default(), |_| true);
        assert_eq!(all.len(), METHODS.len());
        let one = methods(&Settings::default(), |name| name == "lookup");
        assert!(one.len() == 1 && one[0].attempts[0].method == "look-up", "{one:?}");
        assert!(all.iter().all(|series| series.attempts.iter().all(|attempt| !attempt.method.is_empty())));
    }

    #[test]
    fn a_setting_at_its_end_is_not_doubled() {
        let doubled = |name: &str, value: &str| {
            let base = with(&Settings::default(), name, value);
            is_doubled(&base, Field::find(name).unwrap())
        };
        assert!(doubled("node_spacing", "4") && doubled("node_spacing", "3") && !doubled("node_spacing", "1"));
        assert!(doubled("direction_decay", "2") && !doubled("direction_decay", "1.5"));
        assert!(doubled("voxels", "side:64") && doubled("voxels", "100000") && doubled("cut_error", "0.017"));
    }

    #[test]
    fn a_scene_without_a_sky_needs_no_rays_to_it() {
        let names = |sky| sweeps(&Settings::default(), sky).into_iter().map(|s| s.name).collect::<Vec<_>>();
        assert_eq!(names(true).len(), names(false).len() + 1);
        assert!(!names(false).contains(&"sky_rays".to_owned()));
    }
}
