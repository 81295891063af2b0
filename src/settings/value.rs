//! Settings as text: every value has one written form, which is the same on the command line, in `luxel.toml`, in a
//! scene's extras and in the report.

use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use glam::Vec3;
use luxel_transport::surfel::MAX_SIDE;

/// A value that a person can write down.
pub trait Value: Sized {
    /// The flag needs no value on the command line: `--bound` means `--bound=true`.
    const IS_SWITCH: bool = false;
    /// What may stand here, for messages and help.
    fn form() -> String;
    /// Reads the written form; `None` where it is not one of [`Value::form`].
    fn read(text: &str) -> Option<Self>;
    /// The written form; `read(write(x)) == x`.
    fn write(&self) -> String;
}

/// A number with the range that it may lie in.
macro_rules! number {
    ($name:ident, $type:ty, $lo:expr, $hi:expr, $form:literal) => {
        #[doc = concat!("A number: ", $form, ".")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name(pub $type);

        impl Value for $name {
            fn form() -> String {
                $form.into()
            }
            fn read(text: &str) -> Option<Self> {
                // Comparisons with NaN are false, so only real numbers within the range pass.
                text.parse().ok().filter(|x: &$type| ($lo..=$hi).contains(x)).map(Self)
            }
            fn write(&self) -> String {
                self.0.to_string()
            }
        }
    };
}

number!(Texels, u32, 16, 16384, "a whole number of texels from 16 to 16384");
number!(Padding, u32, 2, 64, "a whole number of texels from 2 to 64");
number!(Count, u32, 0, 10_000_000, "a whole number from 0 to 10000000");
number!(Spacing, u32, 1, 64, "a whole number of texels from 1 to 64");
number!(Threads, u32, 0, 1024, "a whole number from 0 to 1024");
number!(Samples, u32, 1, 65536, "a whole number from 1 to 65536");
number!(Factor, f32, 0.0, 1e30, "a number from 0 upwards");
number!(Decay, f32, 1.0, 1024.0, "a number from 1 to 1024");
number!(Share, f32, 0.0, 1.0, "a number from 0 to 1");
number!(Tolerance, f32, 1e-7, 0.5, "a number from 1e-7 to 0.5");
number!(Diameter, f32, 0.0, 180.0, "an angle from 0 to 180 degrees");
number!(Degrees, f32, -36000.0, 36000.0, "an angle in degrees");

impl Value for bool {
    const IS_SWITCH: bool = true;
    fn form() -> String {
        "true or false".into()
    }
    fn read(text: &str) -> Option<Self> {
        text.parse().ok()
    }
    fn write(&self) -> String {
        self.to_string()
    }
}

/// One of a few words.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $( $(#[$item_doc:meta])* $item:ident = $word:literal ),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name { $( $(#[$item_doc])* $item, )+ }

        impl Value for $name {
            fn form() -> String {
                [$($word),+].join(" | ")
            }
            fn read(text: &str) -> Option<Self> {
                match text { $( $word => Some(Self::$item), )+ _ => None }
            }
            fn write(&self) -> String {
                match self { $( Self::$item => $word, )+ }.into()
            }
        }
    };
}

words! {
    /// How good, and how long.
    Preset {
        /// A first look.
        Draft = "draft",
        /// What most levels ship with.
        Medium = "medium",
        /// No visible error.
        Final = "final",
    }
}

words! {
    /// Which light the lightmap holds; the rest is left to real-time lights.
    Only {
        All = "all",
        /// Straight from lamps, sun and emissive surfaces.
        Direct = "direct",
        /// Everything reflected at least once, and the sky.
        Indirect = "indirect",
    }
}

words! {
    /// Whether lights are baked apart from each other.
    LightGroups {
        /// One group for every name of a node, or extra `luxel_group`, up to eight.
        Auto = "auto",
        /// All lights together.
        One = "one",
    }
}

words! {
    /// How indirect light is gathered at texels.
    GatherMode {
        /// What the preset holds best: lightcuts, or the look-up for a draft.
        Auto = "auto",
        /// A cut through the light tree, with a stated error bound.
        Lightcuts = "lightcuts",
        /// Cosine-distributed rays that look the cache up where they hit.
        Final = "final",
        /// The cache itself, interpolated.
        Lookup = "lookup",
    }
}

/// How indirect light is gathered at texels, decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gatherer {
    Lightcuts,
    Final,
    Lookup,
}

impl Gatherer {
    /// As the setting `gather` is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lightcuts => "lightcuts",
            Self::Final => "final",
            Self::Lookup => "lookup",
        }
    }
}

words! {
    /// Which side's irradiance the texels of a double-sided material hold.
    DoubleSided {
        Front = "front",
        Max = "max",
        Average = "average",
    }
}

words! {
    /// Whether no ray can leave the scene.
    Closed {
        /// Probe rays decide.
        Auto = "auto",
        Yes = "yes",
        No = "no",
    }
}

words! {
    /// Directions along which light bounces.
    DirectionSet {
        /// A rotated spiral, equal weights.
        Fibonacci = "fibonacci",
        /// The paper's integer vectors.
        Integer = "integer",
    }
}

words! {
    /// Which voxel of a line sees which.
    Rule {
        /// Voxels of one surface share what a line carries.
        Surface = "surface",
        /// The paper's: the next voxel is the visible one.
        Literal = "literal",
    }
}

words! {
    /// Area of a voxel's surface.
    Area {
        /// Of the triangles, clipped to the voxel.
        Clipped = "clipped",
        /// The paper's equation (1), from the voxel's free faces.
        Faces = "faces",
    }
}

/// A number, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrAuto(pub Option<f32>);

impl Value for OrAuto {
    fn form() -> String {
        "a number above 0, or auto".into()
    }
    fn read(text: &str) -> Option<Self> {
        if text == "auto" {
            return Some(Self(None));
        }
        text.parse().ok().filter(|x: &f32| *x > 0.0 && x.is_finite()).map(|x| Self(Some(x)))
    }
    fn write(&self) -> String {
        self.0.map_or("auto".into(), |x| x.to_string())
    }
}

/// Surfels that can be asked for.
const BUDGET: RangeInclusive<u32> = 100..=50_000_000;

/// Fewest voxels along the longest side.
const MIN_SIDE: u32 = 2;

/// How large a voxel is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Voxels {
    /// As small as about this many surfels allow.
    Budget(u32),
    /// This many voxels along the scene's longest side.
    Side(u32),
    /// Edge in scene units.
    Edge(f32),
}

impl Value for Voxels {
    fn form() -> String {
        format!(
            "a number of surfels from {} to {} (100000), side:N voxels along the longest side from {} to {MAX_SIDE} \
             (side:128), or edge:LENGTH (edge:0.1)",
            BUDGET.start(),
            BUDGET.end(),
            MIN_SIDE,
        )
    }
    fn read(text: &str) -> Option<Self> {
        if let Some(side) = text.strip_prefix("side:") {
            return side.parse().ok().filter(|n| (MIN_SIDE..=MAX_SIDE).contains(n)).map(Self::Side);
        }
        if let Some(edge) = text.strip_prefix("edge:") {
            return edge.parse().ok().filter(|e: &f32| *e > 0.0 && e.is_finite()).map(Self::Edge);
        }
        text.parse().ok().filter(|n| BUDGET.contains(n)).map(Self::Budget)
    }
    fn write(&self) -> String {
        match self {
            Self::Budget(n) => n.to_string(),
            Self::Side(n) => format!("side:{n}"),
            Self::Edge(e) => format!("edge:{e}"),
        }
    }
}

/// The light that comes from outside, as a setting. Radiances in cd/m², linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub enum SkySetting {
    None,
    Constant(Vec3),
    Gradient {
        zenith: Vec3,
        horizon: Vec3,
        ground: Vec3,
    },
    /// An equirectangular .hdr or .exr.
    Image(PathBuf),
}

impl Value for SkySetting {
    fn form() -> String {
        "none, R,G,B, a gradient ZENITH/HORIZON/GROUND of three R,G,B, or a .hdr or .exr file".into()
    }

    fn read(text: &str) -> Option<Self> {
        let text = text.trim();
        if text == "none" {
            return Some(Self::None);
        }
        if let Some(radiance) = triple(text) {
            return Some(Self::Constant(radiance));
        }
        if let [zenith, horizon, ground] = text.split('/').map(triple).collect::<Vec<_>>()[..]
            && let (Some(zenith), Some(horizon), Some(ground)) = (zenith, horizon, ground)
        {
            return Some(Self::Gradient { zenith, horizon, ground });
        }
        let path = PathBuf::from(text);
        let is_image = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("hdr") || e.eq_ignore_ascii_case("exr"));
        is_image.then_some(Self::Image(path))
    }

    fn write(&self) -> String {
        let rgb = |c: &Vec3| format!("{},{},{}", c.x, c.y, c.z);
        match self {
            Self::None => "none".into(),
            Self::Constant(c) => rgb(c),
            Self::Gradient { zenith, horizon, ground } => format!("{}/{}/{}", rgb(zenith), rgb(horizon), rgb(ground)),
            Self::Image(path) => path.display().to_string(),
        }
    }
}

/// Three non-negative finite numbers between commas.
fn triple(text: &str) -> Option<Vec3> {
    let parts: Vec<f32> = text.split(',').map(|p| p.trim().parse().ok()).collect::<Option<_>>()?;
    let [r, g, b] = parts[..] else { return None };
    parts.iter().all(|c| c.is_finite() && *c >= 0.0).then_some(Vec3::new(r, g, b))
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.write())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn same<T: Value + PartialEq + std::fmt::Debug>(text: &str, value: T) {
        assert_eq!(T::read(text).as_ref(), Some(&value), "{text}");
        assert_eq!(T::read(&value.write()), Some(value), "{text} written and read again");
    }

    #[test]
    fn every_form_reads_back_what_it_wrote() {
        same("none", SkySetting::None);
        same("1, 0.5,2", SkySetting::Constant(Vec3::new(1.0, 0.5, 2.0)));
        let gradient = SkySetting::Gradient { zenith: Vec3::Z, horizon: Vec3::ONE, ground: Vec3::ZERO };
        same("0,0,1/1,1,1/0,0,0", gradient);
        same("skies/noon.HDR", SkySetting::Image("skies/noon.HDR".into()));
        same("side:128", Voxels::Side(128));
        same("side:2048", Voxels::Side(MAX_SIDE));
        same("edge:0.25", Voxels::Edge(0.25));
        same("100000", Voxels::Budget(100_000));
        same("auto", OrAuto(None));
        same("12.5", OrAuto(Some(12.5)));
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        for text in ["1,2", "1,2,-3", "1,2,NaN", "noon.png", "", "inf,0,0", "0,0,1/1,1,1"] {
            assert_eq!(SkySetting::read(text), None, "{text}");
        }
        for text in ["side:1", "side:2049", "edge:0", "edge:-1", "edge:inf", "5", "-5", "many"] {
            assert_eq!(Voxels::read(text), None, "{text}");
        }
        assert_eq!(Factor::read("NaN"), None);
        assert_eq!(Factor::read("inf"), None);
        assert_eq!(Texels::read("1e3"), None);
        assert_eq!(Padding::read("1"), None);
    }
}
