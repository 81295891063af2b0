//! What a person can choose, each value described once.
//!
//! [`Settings`] holds the resolved values; [`FIELDS`] holds name, unit and effect of every one of them, from which
//! `--help`, `assets/luxel.toml` and the report are made. Values come from, each over the one before:
//! defaults < preset < `luxel.toml` beside the scene (or `--config`) < the scene's own `extras` < the command line;
//! [`resolve`](resolve::resolve) remembers which one won.

pub mod extras;
pub mod resolve;
pub mod value;

use std::path::Path;

pub use resolve::{Layer, Origin, Resolved, SettingsError, resolve};
use value::*;
pub use value::{
    Area, Closed, DirectionSet, DoubleSided, GatherMode, Gatherer, LightGroups, Only, Preset, Rule, SkySetting, Voxels,
};

/// Name of the settings file beside a scene.
pub const FILE_NAME: &str = "luxel.toml";

/// The settings of one scene: those of the named file `config`, or else of [`FILE_NAME`] beside the scene where there is
/// one; over them the scene's own extras; over them `flags`.
///
/// # Errors
/// What is wrong with a value, and in which of these places it stands.
pub fn for_scene(scene: &Path, config: Option<&Layer>, flags: &Layer) -> Result<Resolved, SettingsError> {
    let mut layers = Vec::new();
    match config {
        Some(layer) => layers.push(layer.clone()),
        None => {
            let beside = scene.with_file_name(FILE_NAME);
            if beside.is_file() {
                layers.push(Layer::from_file(&beside)?);
            }
        }
    }
    layers.extend(extras::read(scene)?);
    layers.push(flags.clone());
    resolve(&layers)
}

/// A setting: its name and how to read, write and explain it.
#[derive(Debug)]
pub struct Field {
    /// The name in files; on the command line with dashes.
    pub name: &'static str,
    /// Heading under which it is listed.
    pub group: &'static str,
    /// Unit, or what kind of value it is.
    pub unit: &'static str,
    doc: &'static [&'static str],
    /// A command-line flag that needs no value.
    pub is_switch: bool,
    /// What may be written.
    pub form: fn() -> String,
    pub get: fn(&Settings) -> String,
    set: fn(&mut Settings, &str) -> bool,
}

impl Field {
    /// What the setting does, in sentences.
    pub fn effect(&self) -> String {
        self.doc.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ")
    }

    /// `texel_density` as a flag: `texel-density`.
    pub fn flag(&self) -> String {
        self.name.replace('_', "-")
    }

    /// Sets the value from its written form; false where that says nothing.
    pub fn assign(&self, settings: &mut Settings, text: &str) -> bool {
        (self.set)(settings, text)
    }

    /// What may be written instead of `text`: of some words the one that is meant, most likely.
    pub fn expected(&self, text: &str) -> String {
        let form = (self.form)();
        let words = form.split(" | ").filter(|_| form.contains(" | "));
        match resolve::alike(text, words) {
            Some(word) => format!("{form}; did you mean `{word}`?"),
            None => form,
        }
    }

    pub fn find(name: &str) -> Option<&'static Field> {
        FIELDS.iter().find(|f| f.name == name)
    }
}

macro_rules! settings {
    ($( $group:literal { $( $(#[doc = $doc:literal])+ [$unit:literal] $name:ident: $type:ty = $default:expr; )+ } )+) => {
        /// Everything that a bake depends on besides the scene.
        #[derive(Clone, Debug, PartialEq)]
        pub struct Settings { $($( $(#[doc = $doc])+ pub $name: $type, )+)+ }

        impl Default for Settings {
            /// The preset `medium`.
            fn default() -> Self {
                Self { $($( $name: $default, )+)+ }
            }
        }

        /// Every setting, in the order of help and files.
        pub static FIELDS: &[Field] = &[$($( Field {
            name: stringify!($name),
            group: $group,
            unit: $unit,
            doc: &[$($doc),+],
            is_switch: <$type as Value>::IS_SWITCH,
            form: <$type as Value>::form,
            get: |s| s.$name.write(),
            set: |s, text| <$type as Value>::read(text).map(|v| s.$name = v).is_some(),
        }, )+)+];
    };
}

settings! {
    "Quality" {
        /// How good, and how long: sets the defaults of the other values of this list.
        ["preset"] preset: Preset = Preset::Medium;
    }
    "Lightmap" {
        /// Side of an atlas, which the scene fills. Where its charts and their padding do not fit at a quarter of the
        /// texel density that their area alone would have, further atlases of that side are added.
        ["texels"] size: Texels = Texels(1024);
        /// Texels per scene unit, instead of filling one atlas. The extra luxel_scale of a node multiplies it.
        ["texels per scene unit"] texel_density: OrAuto = OrAuto(None);
        /// Texels around every chart that are filled with its border values, so that no filter reaches a foreign one.
        ["texels"] padding: Padding = Padding(2);
        /// Which light the lightmap holds; the rest is left to real-time lights. Sky light counts as indirect.
        ["choice"] only: Only = Only::All;
        /// Which side's irradiance the texels of a double-sided material hold.
        ["choice"] double_sided: DoubleSided = DoubleSided::Front;
        /// Writes NAME.bound.exr too: the stated error bound of the light that lightcuts gather (all that surfaces
        /// reflect), in lux. Sky light straight to a texel and the direct light of very many lamps are not in it; the
        /// modes final and lookup state none.
        ["switch"] bound: bool = false;
    }
    "Light" {
        /// Radiance from outside in cd/m²: a colour, a gradient by elevation, or an equirectangular image. A file may
        /// hold a table [sky] instead: color, or zenith, horizon and ground, or image; rotation; strength.
        ["cd/m²"] sky: SkySetting = SkySetting::None;
        /// Turns an image sky about the vertical, counter-clockwise seen from above.
        ["degrees"] sky_rotation: Degrees = Degrees(0.0);
        /// Factor on the sky's radiance.
        ["factor"] sky_strength: Factor = Factor(1.0);
        /// Factor on point lights, spots and suns, for exporters with other units.
        ["factor"] light_scale: Factor = Factor(1.0);
        /// Factor on emissive surfaces, for exporters with other units.
        ["factor"] emissive_scale: Factor = Factor(1.0);
        /// Radius of point lights and spots without the extra luxel_radius, for soft shadows.
        ["scene units"] lamp_radius: Factor = Factor(0.0);
        /// Angular diameter of directional lights without the extra luxel_angle, for soft shadows; the sun has 0.53.
        ["degrees"] sun_angle: Diameter = Diameter(0.0);
        /// Lights of one name (of their node, or its extra luxel_group) are one group, up to eight groups, and each is
        /// baked for itself: after a change of one lamp only its own light is computed again, a change of colour or
        /// strength computes none, and `luxel export --mix` weighs them anew. Every group costs a propagation and a
        /// gather; one bakes all lights together.
        ["choice"] light_groups: LightGroups = LightGroups::Auto;
        /// Share of a fully rough metal's colour that counts as diffuse.
        ["share"] metal_diffuse: Share = Share(0.5);
        /// Bakes skinned, morphed and animated nodes in their rest pose instead of leaving them out.
        ["switch"] bake_animated: bool = false;
    }
    "Transport" {
        /// Size of the voxels through which light bounces. Smaller is finer, slower and takes more memory.
        ["voxel size"] voxels: Voxels = Voxels::Budget(100_000);
        /// Directions of the first bounce; every further one has fewer, down to 16.
        ["count"] directions: Samples = Samples(512);
        /// How many times fewer directions every bounce has than the one before it; 1 keeps their number.
        ["factor"] direction_decay: Decay = Decay(2.0);
        /// Bounces at most: 1 is one alone; from the second on, the rest of the geometric series is added to the last one.
        ["count"] bounces: Samples = Samples(64);
        /// Bouncing stops when the light still to come is a smaller share of all light than this.
        ["share"] tolerance: Tolerance = Tolerance(3e-4);
        /// Rays per surfel that gather its indirect light anew after the bounces, against the grain of the voxels; 0 is off.
        ["count"] refresh: Count = Count(64);
        /// Whether no ray can leave the scene: then what escapes between two voxels is put back.
        ["choice"] closed: Closed = Closed::Auto;
        /// Shoots the lights as this many photons, as the paper does, instead of computing their light at surfels
        /// exactly; 0 is off.
        ["count"] photons: Count = Count(0);
        /// Directions of the bounces: an even spiral, or the paper's integer vectors, for comparison.
        ["choice"] direction_set: DirectionSet = DirectionSet::Fibonacci;
        /// How voxels on a line see each other: by the surfaces in them, or the next one always, which is the paper's
        /// rule and loses light; for comparison.
        ["choice"] rule: Rule = Rule::Surface;
        /// Area of the surface in a voxel: of its clipped triangles, or by the paper's count of free faces, for
        /// comparison.
        ["choice"] area: Area = Area::Clipped;
    }
    "Gathering" {
        /// How indirect light is gathered at texels.
        ["choice"] gather: GatherMode = GatherMode::Auto;
        /// A light cluster is opened until its error bound is below this share of the texel's light.
        ["share"] cut_error: Tolerance = Tolerance(0.017);
        /// Clusters of a cut at most.
        ["count"] cut_limit: Samples = Samples(1000);
        /// Short rays per texel that see to the light of near surfaces.
        ["count"] near_rays: Samples = Samples(16);
        /// Rays per texel of the mode final.
        ["count"] gather_rays: Samples = Samples(256);
        /// Texels between the nodes at which sky and indirect light are gathered, finer where they change; 1 gathers at
        /// every texel. Nodes are averaged with neighbours that agree and interpolated between, so the bound stated there
        /// is an estimate.
        ["texels"] node_spacing: Spacing = Spacing(4);
        /// Samples on every lamp and emissive polygon: the smoothness of penumbrae.
        ["count"] shadow_samples: Samples = Samples(64);
        /// Rays per texel towards the sky.
        ["count"] sky_rays: Samples = Samples(2048);
    }
    "Machine" {
        /// Threads to work with; 0 takes all cores. The result has the same bytes whatever their number.
        ["count"] threads: Threads = Threads(0);
    }
}

impl Settings {
    /// The values of a preset.
    pub fn preset(preset: Preset) -> Self {
        let medium = Self::default();
        match preset {
            Preset::Medium => medium,
            Preset::Draft => Self {
                preset,
                voxels: Voxels::Budget(25_000),
                directions: Samples(256),
                tolerance: Tolerance(3e-3),
                refresh: Count(0),
                cut_error: Tolerance(0.05),
                near_rays: Samples(8),
                gather_rays: Samples(64),
                shadow_samples: Samples(16),
                sky_rays: Samples(256),
                ..medium
            },
            Preset::Final => Self {
                preset,
                voxels: Voxels::Budget(400_000),
                directions: Samples(1024),
                tolerance: Tolerance(1e-4),
                refresh: Count(256),
                cut_error: Tolerance(0.01),
                cut_limit: Samples(2000),
                near_rays: Samples(32),
                gather_rays: Samples(1024),
                shadow_samples: Samples(256),
                sky_rays: Samples(2048),
                node_spacing: Spacing(1),
                ..medium
            },
        }
    }

    /// The gather's mode states an error bound.
    pub fn states_bound(&self) -> bool {
        self.gatherer() == Gatherer::Lightcuts
    }

    /// `gather` with `auto` decided.
    pub fn gatherer(&self) -> Gatherer {
        match self.gather {
            GatherMode::Auto if self.preset == Preset::Draft => Gatherer::Lookup,
            GatherMode::Auto | GatherMode::Lightcuts => Gatherer::Lightcuts,
            GatherMode::Final => Gatherer::Final,
            GatherMode::Lookup => Gatherer::Lookup,
        }
    }
}

/// `assets/luxel.toml`: every setting with its effect, unit, forms and default, commented out.
pub fn documented_defaults() -> String {
    let mut text = String::from(
        "# The settings of luxel, with their defaults (the preset medium).\n\
         # Put a copy beside a scene as luxel.toml, or name it by --config, and uncomment what should differ.\n\
         # Order: defaults < preset < this file < the scene's extras < the command line.\n",
    );
    let defaults = Settings::default();
    let mut group = "";
    for field in FIELDS {
        if field.group != group {
            group = field.group;
            text += &format!("\n# ---- {group} ----\n");
        }
        text += &format!("\n# {}\n# [{}] {}\n", field.effect(), field.unit, (field.form)());
        text += &format!("#{} = {}\n", field.name, toml_form(&(field.get)(&defaults)));
    }
    text
}

/// The written form as TOML: numbers and booleans bare, the rest quoted.
fn toml_form(text: &str) -> String {
    if text.parse::<f64>().is_ok_and(f64::is_finite) || text.parse::<bool>().is_ok() {
        text.into()
    } else {
        format!("{text:?}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_defaults_are_the_codes_defaults() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/luxel.toml");
        let shipped = std::fs::read_to_string(path).unwrap();
        assert_eq!(shipped, documented_defaults(), "write settings::documented_defaults() to assets/luxel.toml");
        // With the values uncommented it resolves to the defaults, value by value.
        let values: String = shipped
            .lines()
            .filter_map(|l| l.strip_prefix('#').filter(|l| !l.starts_with(' ')))
            .map(|l| format!("{l}\n"))
            .collect();
        let layer = Layer::from_toml(&values, Origin::File("luxel.toml".into())).unwrap();
        assert_eq!(layer.len(), FIELDS.len());
        assert_eq!(resolve(&[layer]).unwrap().settings, Settings::default());
        // As it stands it changes nothing, so that a preset on the command line still rules.
        assert_eq!(Layer::from_toml(&shipped, Origin::File("luxel.toml".into())).unwrap().len(), 0);
    }

    #[test]
    fn every_value_reads_back_what_it_wrote() {
        for preset in [Preset::Draft, Preset::Medium, Preset::Final] {
            let from = Settings::preset(preset);
            let mut to = Settings::default();
            for field in FIELDS {
                assert!((field.set)(&mut to, &(field.get)(&from)), "{}", field.name);
            }
            assert_eq!(from, to);
        }
    }

    #[test]
    fn names_are_unique_and_explained() {
        for (i, field) in FIELDS.iter().enumerate() {
            assert!(FIELDS[..i].iter().all(|f| f.name != field.name), "{}", field.name);
            assert!(field.effect().ends_with('.'), "{}", field.name);
            assert!(!field.unit.is_empty() && !(field.form)().is_empty());
        }
    }
}
