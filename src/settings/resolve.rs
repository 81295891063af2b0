//! From layers of chosen values to one set of settings that knows where each value came from.

use std::fmt;
use std::path::{Path, PathBuf};

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
    #[error("{origin}: `{name}` holds a {found}; expected {form}")]
    Kind { origin: Origin, name: String, found: &'static str, form: String },
    #[error("{path} is not valid TOML")]
    Toml { path: PathBuf, source: Box<toml::de::Error> },
    #[error("cannot read the settings in {path}")]
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
                form: (field.form)(),
            });
        }
        self.values.retain(|(f, _)| f.name != name);
        self.values.push((field, text.into()));
        Ok(())
    }

    /// The keys of a TOML text.
    pub fn from_toml(text: &str, origin: Origin) -> Result<Self, SettingsError> {
        let table: toml::Table = text.parse().map_err(|e| SettingsError::Toml {
            path: match &origin {
                Origin::File(path) | Origin::Extras(path) => path.clone(),
                other => other.to_string().into(),
            },
            source: Box::new(e),
        })?;
        let mut layer = Self::new(origin);
        for (name, value) in table {
            let text = match &value {
                toml::Value::Array(items) => items.iter().map(plain).collect::<Option<Vec<_>>>().map(|v| v.join(",")),
                value => plain(value),
            };
            layer.take(&name, text, value.type_str())?;
        }
        Ok(layer)
    }

    /// The keys of a JSON object, as scenes carry them in their extras.
    pub fn from_json(
        object: &serde_json::Map<String, serde_json::Value>,
        origin: Origin,
    ) -> Result<Self, SettingsError> {
        use serde_json::Value as Json;
        fn plain(value: &Json) -> Option<String> {
            match value {
                Json::String(s) => Some(s.clone()),
                Json::Number(n) => Some(n.to_string()),
                Json::Bool(b) => Some(b.to_string()),
                _ => None,
            }
        }
        let mut layer = Self::new(origin);
        for (name, value) in object {
            let (text, kind) = match value {
                Json::Array(items) => {
                    (items.iter().map(plain).collect::<Option<Vec<_>>>().map(|v| v.join(",")), "list")
                }
                Json::Object(_) => (None, "table"),
                value => (plain(value), "null"),
            };
            layer.take(name, text, kind)?;
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

    fn preset(&self) -> Option<Preset> {
        self.values.iter().find(|(f, _)| f.name == "preset").and_then(|(_, text)| Preset::read(text))
    }
}

fn plain(value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::String(s) => Some(s.clone()),
        toml::Value::Integer(i) => Some(i.to_string()),
        toml::Value::Float(x) => Some(x.to_string()),
        toml::Value::Boolean(b) => Some(b.to_string()),
        _ => None,
    }
}

/// The setting whose name is written most alike, if any is.
fn nearest(name: &str) -> Option<&'static str> {
    let wanted = name.replace('-', "_").to_lowercase();
    FIELDS
        .iter()
        .map(|f| (strsim::jaro_winkler(&wanted, f.name), f.name))
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
                    form: (field.form)(),
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
    fn a_sky_image_is_looked_for_beside_the_file_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("luxel.toml");
        std::fs::write(&path, "sky = \"noon.hdr\"").unwrap();
        let resolved = resolve(&[Layer::from_file(&path).unwrap()]).unwrap();
        assert_eq!(resolved.settings.sky, SkySetting::Image(folder.path().join("noon.hdr")));
    }
}
