//! From layers of chosen values to one set of settings that knows where each value came from.

use std::fmt;
use std::path::{Path, PathBuf};

use serde_json::Value as Json;

use super::{FIELDS, Field, Preset, Settings, SkySetting, value::Value};

/// Largest settings file that is read [bytes].
const MAX_FILE: u64 = 1 << 20;

/// Where a value came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    Default,
    /// The preset that was chosen.
    Preset(Preset),
    /// A settings file.
    File(PathBuf),
    /// The extras of the scene file.
    Extras(PathBuf),
    CommandLine,
    /// A search for the settings that keep an error, which is written here.
    Target(String),
    /// The program that embeds luxel.
    Caller,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::Preset(preset) => write!(f, "preset {}", preset.write()),
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Extras(path) => write!(f, "extras of {}", path.display()),
            Self::CommandLine => f.write_str("command line"),
            Self::Target(error) => write!(f, "target error {error}"),
            Self::Caller => f.write_str("caller"),
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    #[error("{origin}: there is no setting `{name}`{}", did_you_mean(.suggestion))]
    Unknown { origin: Origin, name: String, suggestion: Option<&'static str> },
    #[error("{origin}: `{name} = {text}` does not fit: expected {form}")]
    Value { origin: Origin, name: &'static str, text: String, form: String },
    #[error("{origin}: `{name}` holds {found}; expected {form}")]
    Kind { origin: Origin, name: String, found: &'static str, form: String },
    #[error("{origin}: `sky`: {what}")]
    Sky { origin: Origin, what: String },
    #[error("{path} is not valid TOML; `luxel defaults` prints a file to start from")]
    Toml { path: PathBuf, source: Box<toml::de::Error> },
    #[error("cannot read the settings in {path}; check that the file is there and may be read")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{path}: a settings file of {bytes} bytes is more than the {MAX_FILE} that are read")]
    TooLarge { path: PathBuf, bytes: u64 },
}

fn did_you_mean(suggestion: &Option<&'static str>) -> String {
    suggestion.map_or_else(|| "; `luxel bake --help` lists them all".into(), |name| format!("; did you mean `{name}`?"))
}

/// Values that one place chose.
#[derive(Clone, Debug)]
pub struct Layer {
    origin: Origin,
    values: Vec<(&'static Field, String)>,
}

impl Layer {
    pub fn new(origin: Origin) -> Self {
        Self { origin, values: Vec::new() }
    }

    pub fn len(&self) -> usize {
        self.values.len()
    }

    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Chooses a value by its written form.
    pub fn set(&mut self, name: &str, text: &str) -> Result<(), SettingsError> {
        let Some(field) = Field::find(name) else {
            return Err(SettingsError::Unknown {
                origin: self.origin.clone(),
                name: name.into(),
                suggestion: nearest(name),
            });
        };
        // Read once now, so that the message comes from the place that holds the fault.
        if !(field.set)(&mut Settings::default(), text) {
            return Err(SettingsError::Value {
                origin: self.origin.clone(),
                name: field.name,
                text: text.into(),
                form: field.expected(text),
            });
        }
        self.values.retain(|(f, _)| f.name != name);
        self.values.push((field, text.into()));
        Ok(())
    }

    /// The keys of a TOML text.
    pub fn from_toml(text: &str, origin: Origin) -> Result<Self, SettingsError> {
        // A date is no value of any setting, and becomes an object here; a number that is none becomes null.
        let table: serde_json::Map<String, Json> = toml::from_str(text).map_err(|e| SettingsError::Toml {
            path: match &origin {
                Origin::File(path) | Origin::Extras(path) => path.clone(),
                other => other.to_string().into(),
            },
            source: Box::new(e),
        })?;
        Self::from_json(&table, origin)
    }

    /// The keys of a JSON object, as scenes carry them in their extras. A table `sky` stands for the settings of the
    /// sky together.
    pub fn from_json(object: &serde_json::Map<String, Json>, origin: Origin) -> Result<Self, SettingsError> {
        let mut layer = Self::new(origin);
        for (name, value) in object {
            match value {
                Json::Object(table) if name == "sky" => layer.take_sky(table)?,
                value => layer.take(name, plain(value), kind(value))?,
            }
        }
        Ok(layer)
    }

    /// A settings file; a relative sky image is relative to the file.
    pub fn from_file(path: &Path) -> Result<Self, SettingsError> {
        let read = |source| SettingsError::Read { path: path.into(), source };
        let bytes = std::fs::metadata(path).map_err(read)?.len();
        if bytes > MAX_FILE {
            return Err(SettingsError::TooLarge { path: path.into(), bytes });
        }
        let text = std::fs::read_to_string(path).map_err(read)?;
        let mut layer = Self::from_toml(&text, Origin::File(path.into()))?;
        layer.anchor(path.parent().unwrap_or(Path::new("")));
        Ok(layer)
    }

    /// Makes a relative sky image relative to `folder`.
    pub fn anchor(&mut self, folder: &Path) {
        for (field, text) in &mut self.values {
            if field.name == "sky"
                && let Some(SkySetting::Image(path)) = SkySetting::read(text)
            {
                *text = SkySetting::Image(folder.join(path)).write();
            }
        }
    }

    /// `[sky]`: `color`, or `zenith`, `horizon` and `ground`, or `image`; `rotation`; `strength`.
    fn take_sky(&mut self, table: &serde_json::Map<String, Json>) -> Result<(), SettingsError> {
        let refused = |what: String| SettingsError::Sky { origin: self.origin.clone(), what };
        if let Some(key) = table.keys().find(|k| !SKY_KEYS.contains(&k.as_str())) {
            let near = alike(key, SKY_KEYS.into_iter());
            return Err(refused(format!("there is no key `{key}`{}", did_you_mean(&near))));
        }
        let text = |key: &str| {
            table.get(key).map(|v| plain(v).ok_or_else(|| refused(format!("`{key}` holds {}", kind(v))))).transpose()
        };
        let [color, zenith, horizon, ground, image, rotation, strength] = SKY_KEYS.map(text);
        let (rotation, strength) = (rotation?, strength?);
        let sky = match (color?, zenith?, horizon?, ground?, image?) {
            (Some(color), None, None, None, None) => Some(color),
            (None, Some(z), Some(h), Some(g), None) => Some(format!("{z}/{h}/{g}")),
            (None, None, None, None, Some(image)) => Some(image),
            (None, None, None, None, None) => None,
            _ => {
                let what = "one of `color`, `image`, or all of `zenith`, `horizon` and `ground` describe it";
                return Err(refused(what.into()));
            }
        };
        for (name, text) in [("sky", sky), ("sky_rotation", rotation), ("sky_strength", strength)] {
            text.map_or(Ok(()), |text| self.set(name, &text))?;
        }
        Ok(())
    }

    fn take(&mut self, name: &str, text: Option<String>, kind: &'static str) -> Result<(), SettingsError> {
        match (text, Field::find(name)) {
            (Some(text), _) => self.set(name, &text),
            (None, None) => self.set(name, ""),
            (None, Some(field)) => Err(SettingsError::Kind {
                origin: self.origin.clone(),
                name: name.into(),
                found: kind,
                form: (field.form)(),
            }),
        }
    }

    /// The image that it chose for a sky.
    pub fn sky_image(&self) -> Option<PathBuf> {
        let chosen = self.values.iter().find(|(f, _)| f.name == "sky").and_then(|(_, text)| SkySetting::read(text));
        if let Some(SkySetting::Image(path)) = chosen { Some(path) } else { None }
    }

    fn preset(&self) -> Option<Preset> {
        self.values.iter().find(|(f, _)| f.name == "preset").and_then(|(_, text)| Preset::read(text))
    }
}

/// The keys of the table `sky`.
const SKY_KEYS: [&str; 7] = ["color", "zenith", "horizon", "ground", "image", "rotation", "strength"];

/// The written form of a value of a file; none for one that has none.
fn plain(value: &Json) -> Option<String> {
    match value {
        Json::String(s) => Some(s.clone()),
        // 64.0 is written 64, as exporters mean it.
        Json::Number(n) if n.is_f64() => n.as_f64().map(|x| x.to_string()),
        Json::Number(n) => Some(n.to_string()),
        Json::Bool(b) => Some(b.to_string()),
        Json::Array(items) if items.iter().all(|i| !i.is_array()) => {
            items.iter().map(plain).collect::<Option<Vec<_>>>().map(|v| v.join(","))
        }
        _ => None,
    }
}

/// What a value is, for messages.
pub(super) fn kind(value: &Json) -> &'static str {
    match value {
        Json::Array(_) => "a list",
        Json::Object(_) => "a table",
        Json::String(_) => "a text",
        Json::Number(_) => "a number",
        Json::Bool(_) => "a switch",
        Json::Null => "no value (nan, inf and null are none)",
    }
}

/// The setting whose name is written most alike, if any is.
fn nearest(name: &str) -> Option<&'static str> {
    alike(&name.replace('-', "_").to_lowercase(), FIELDS.iter().map(|f| f.name))
}

pub(super) fn alike<'a>(wanted: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    names
        .map(|name| (strsim::jaro_winkler(wanted, name), name))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}

/// The settings of a bake, and where each came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    pub settings: Settings,
    /// In the order of [`FIELDS`].
    pub origins: Vec<Origin>,
}

impl Default for Resolved {
    fn default() -> Self {
        Self { settings: Settings::default(), origins: vec![Origin::Default; FIELDS.len()] }
    }
}

impl Resolved {
    /// Names of the settings that neither a default nor a preset decided.
    pub fn chosen(&self) -> Vec<&'static str> {
        let is_chosen = |origin: &Origin| !matches!(origin, Origin::Default | Origin::Preset(_));
        self.list().filter(|(_, _, origin)| is_chosen(origin)).map(|(field, _, _)| field.name).collect()
    }

    /// The same with other values, of which each that differs comes from `origin`.
    pub fn changed(self, settings: Settings, origin: &Origin) -> Self {
        let origins = FIELDS.iter().zip(self.origins);
        let of = |(field, old): (&Field, Origin)| {
            if (field.get)(&settings) == (field.get)(&self.settings) { old } else { origin.clone() }
        };
        Self { origins: origins.map(of).collect(), settings }
    }

    /// Name, written value and origin of every setting.
    pub fn list(&self) -> impl Iterator<Item = (&'static Field, String, &Origin)> {
        FIELDS.iter().zip(&self.origins).map(|(f, origin)| (f, (f.get)(&self.settings), origin))
    }
}

/// Lays the layers over each other, the last one on top. The topmost preset sets the ground.
pub fn resolve(layers: &[Layer]) -> Result<Resolved, SettingsError> {
    let preset = layers.iter().rev().find_map(Layer::preset);
    let mut resolved = Resolved::default();
    if let Some(preset) = preset {
        resolved.settings = Settings::preset(preset);
        let defaults = Settings::default();
        for (field, origin) in FIELDS.iter().zip(&mut resolved.origins) {
            if (field.get)(&resolved.settings) != (field.get)(&defaults) {
                *origin = Origin::Preset(preset);
            }
        }
    }
    for layer in layers {
        for (field, text) in &layer.values {
            if !(field.set)(&mut resolved.settings, text) {
                return Err(SettingsError::Value {
                    origin: layer.origin.clone(),
                    name: field.name,
                    text: text.clone(),
                    form: field.expected(text),
                });
            }
            if let Some(i) = FIELDS.iter().position(|f| f.name == field.name) {
                resolved.origins[i] = layer.origin.clone();
            }
        }
    }
    Ok(resolved)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> Result<Layer, SettingsError> {
        Layer::from_toml(text, Origin::File("luxel.toml".into()))
    }

    fn flag(name: &str, text: &str) -> Layer {
        let mut layer = Layer::new(Origin::CommandLine);
        layer.set(name, text).unwrap();
        layer
    }

    #[test]
    fn a_later_layer_wins_and_is_remembered() {
        let resolved = resolve(&[file("size = 256\npadding = 4").unwrap(), flag("size", "64")]).unwrap();
        assert_eq!((resolved.settings.size.0, resolved.settings.padding.0), (64, 4));
        let origin = |name| resolved.list().find(|(f, ..)| f.name == name).unwrap().2.clone();
        assert_eq!(origin("size"), Origin::CommandLine);
        assert_eq!(origin("padding"), Origin::File("luxel.toml".into()));
        assert_eq!(origin("directions"), Origin::Default);
    }

    #[test]
    fn a_preset_lies_under_every_single_value_wherever_it_was_chosen() {
        let resolved = resolve(&[file("sky_rays = 5").unwrap(), flag("preset", "final")]).unwrap();
        assert_eq!(resolved.settings.sky_rays.0, 5);
        assert_eq!(resolved.settings.directions, Settings::preset(Preset::Final).directions);
        let origin = |name| resolved.list().find(|(f, ..)| f.name == name).unwrap().2.clone();
        assert_eq!(origin("directions"), Origin::Preset(Preset::Final));
        assert_eq!(origin("directions").to_string(), "preset final");
        assert_eq!(origin("preset"), Origin::CommandLine);
    }

    #[test]
    fn an_unknown_key_is_an_error_that_suggests_the_nearest_name() {
        let message = file("texel_densty = 5").unwrap_err().to_string();
        assert_eq!(message, "luxel.toml: there is no setting `texel_densty`; did you mean `texel_density`?");
        assert!(file("zzzz = 5").unwrap_err().to_string().contains("--help"));
        assert!(file("[size]\na = 1").unwrap_err().to_string().contains("holds a table"));
        assert!(file("size = 1.5").unwrap_err().to_string().contains("does not fit"));
        assert!(file("size = [").is_err());
        for none in ["nan", "inf"] {
            let said = file(&format!("sky_strength = {none}")).unwrap_err().to_string();
            assert!(said.contains("`sky_strength` holds no value") && said.contains("expected a number"), "{said}");
        }
        let said = file("preset = \"darft\"").unwrap_err().to_string();
        assert!(said.ends_with("draft | medium | final; did you mean `draft`?"), "{said}");
    }

    #[test]
    fn lists_are_colours() {
        let resolved = resolve(&[file("sky = [1, 0.5, 2]").unwrap()]).unwrap();
        assert_eq!(resolved.settings.sky.write(), "1,0.5,2");
        let json = serde_json::json!({"sky": [1, 0.5, 2], "size": 64, "bound": true});
        let layer = Layer::from_json(json.as_object().unwrap(), Origin::Extras("a.glb".into())).unwrap();
        assert_eq!(resolve(&[layer]).unwrap().settings.sky.write(), "1,0.5,2");
    }

    #[test]
    fn a_table_describes_the_sky() {
        let sky = |text: &str| resolve(&[file(text)?]).map(|r| r.settings);
        let constant = sky("size = 64\n[sky]\ncolor = [1, 0.5, 2.0]\nrotation = 30\nstrength = 2.5").unwrap();
        assert_eq!(constant.sky.write(), "1,0.5,2");
        assert_eq!((constant.sky_rotation.0, constant.sky_strength.0), (30.0, 2.5));
        let gradient = sky("[sky]\nzenith = [0, 0, 3]\nhorizon = [1, 1, 1]\nground = [0, 0, 0]").unwrap();
        assert_eq!(gradient.sky.write(), "0,0,3/1,1,1/0,0,0");
        assert_eq!(sky("sky = { image = \"noon.hdr\" }").unwrap().sky, SkySetting::Image("noon.hdr".into()));
        assert_eq!(sky("[sky]\nstrength = 3").unwrap().sky, SkySetting::None, "the sky may come from another layer");
        for (text, expected) in [
            ("[sky]\nrotaton = 3", "did you mean `rotation`?"),
            ("[sky]\ncolor = [1, 1, 1]\nimage = \"a.hdr\"", "one of `color`"),
            ("[sky]\nzenith = [1, 1, 1]", "all of `zenith`"),
            ("[sky]\ncolor = [[1], 1, 1]", "`color` holds a list"),
            ("[sky]\ncolor = [1, 1]", "does not fit"),
            ("[sky]\nstrength = -1", "sky_strength"),
            ("sky = 1979-05-27", "`sky`"),
        ] {
            let message = sky(text).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("luxel.toml: "), "{text}: {message}");
        }
        let json = serde_json::json!({"sky": {"color": [1.0, 2, 3]}});
        let layer = Layer::from_json(json.as_object().unwrap(), Origin::Extras("a.glb".into())).unwrap();
        assert_eq!(resolve(&[layer]).unwrap().settings.sky.write(), "1,2,3");
    }

    #[test]
    fn a_sky_image_is_looked_for_beside_the_file_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("luxel.toml");
        std::fs::write(&path, "sky = \"noon.hdr\"").unwrap();
        let resolved = resolve(&[Layer::from_file(&path).unwrap()]).unwrap();
        assert_eq!(resolved.settings.sky, SkySetting::Image(folder.path().join("noon.hdr")));
    }
}
