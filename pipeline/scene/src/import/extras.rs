//! What an artist can say in `extras` (custom properties, in Blender), per node or per mesh:
//!
//! | key | value | effect | children |
//! |---|---|---|---|
//! | `luxel_ignore` | bool | luxel treats the node as if it were not there | inherit it |
//! | `luxel_cast` | bool | blocks and bounces light (default true) | inherit it, unless they say otherwise |
//! | `luxel_receive` | bool | gets a place in the lightmap (default true) | inherit it, unless they say otherwise |
//! | `luxel_scale` | number > 0 | factor on the texel density (default 1) | inherit it, unless they say otherwise |
//! | `luxel_group` | text | the light group of the lamps and emissive surfaces (default: the name of their node) | inherit it, unless they say otherwise |
//! | `luxel_radius` | number ≥ 0 | radius of a point or spot light, in scene units | do not |
//! | `luxel_angle` | 0 ≤ number ≤ 180 | angular diameter of a directional light, in degrees | do not |
//!
//! `luxel_radius` and `luxel_angle` may stand on the node or on the light; the node wins, and where neither has one the
//! import options hold. Booleans may be written as
//! numbers, since some exporters do. What cannot be understood is reported and has no effect.

use std::sync::Arc;

use gltf_json::extras::Extras;
use serde_json::Value;

use super::notes::Notes;

const KNOWN: [&str; 7] =
    ["luxel_ignore", "luxel_cast", "luxel_receive", "luxel_scale", "luxel_group", "luxel_radius", "luxel_angle"];

/// Longest name of a light group [bytes].
const LONGEST_GROUP: usize = 100;

/// The light group that a name stands for: without blanks around it, which nobody sees or types; a blank one is none.
pub fn group_name(name: &str) -> Option<Arc<str>> {
    Some(name.trim()).filter(|name| !name.is_empty()).map(Arc::from)
}

/// What holds for a node, inherited values included.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeExtras {
    pub ignore: bool,
    pub cast: bool,
    pub receive: bool,
    pub scale: f32,
    pub group: Option<Arc<str>>,
}

impl Default for NodeExtras {
    fn default() -> Self {
        Self { ignore: false, cast: true, receive: true, scale: 1.0, group: None }
    }
}

impl NodeExtras {
    /// What holds below or on an object with these extras.
    pub fn with(self, extras: &Keys) -> Self {
        Self {
            ignore: self.ignore || extras.ignore.unwrap_or(false),
            cast: extras.cast.unwrap_or(self.cast),
            receive: extras.receive.unwrap_or(self.receive),
            scale: extras.scale.unwrap_or(self.scale),
            group: extras.group.clone().or(self.group),
        }
    }
}

/// luxel's keys on one object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Keys {
    pub ignore: Option<bool>,
    pub cast: Option<bool>,
    pub receive: Option<bool>,
    pub scale: Option<f32>,
    pub group: Option<Arc<str>>,
    pub radius: Option<f64>,
    pub angle: Option<f64>,
}

impl Keys {
    /// Reads the extras of the object at `place`.
    pub fn read(extras: &Extras, place: &str, notes: &mut Notes) -> Self {
        let Some(raw) = extras else { return Self::default() };
        // Most extras are other people's; looking for the name first spares parsing them.
        if !raw.get().contains("luxel_") {
            return Self::default();
        }
        match serde_json::from_str(raw.get()) {
            Ok(value) => Self::from_value(&value, place, notes),
            Err(_) => Self::default(),
        }
    }

    /// The same for extras that are at hand as a JSON value.
    pub fn from_value(value: &Value, place: &str, notes: &mut Notes) -> Self {
        let Some(map) = value.as_object() else { return Self::default() };
        for key in map.keys().filter(|k| k.starts_with("luxel_") && !KNOWN.contains(&k.as_str())) {
            let message = format!("{place}: the extra {key:?} is unknown; luxel reads {}", KNOWN.join(", "));
            notes.add("unknown-extra", message);
        }
        let mut wrong = |key: &str, value: &Value| {
            notes.add("invalid-extra", format!("{place}: the extra {key:?} cannot be {value}; it is ignored"));
        };
        let group = map.get("luxel_group").and_then(|value| {
            let name = value.as_str().filter(|name| !name.trim().is_empty() && name.len() <= LONGEST_GROUP);
            if name.is_none() {
                wrong("luxel_group", value);
            }
            name.map(|name| name.trim().into())
        });
        let mut flag = |key: &str| {
            let value = map.get(key)?;
            let flag = value.as_bool().or_else(|| value.as_f64().map(|n| n != 0.0));
            if flag.is_none() {
                wrong(key, value);
            }
            flag
        };
        let (ignore, cast, receive) = (flag("luxel_ignore"), flag("luxel_cast"), flag("luxel_receive"));
        let mut number = |key: &str, fits: fn(f64) -> bool| {
            let value = map.get(key)?;
            let number = value.as_f64().filter(|n| fits(*n));
            if number.is_none() {
                wrong(key, value);
            }
            number
        };
        Self {
            ignore,
            cast,
            receive,
            group,
            scale: number("luxel_scale", |n| n > 1e-6 && n < 1e6).map(|n| n as f32),
            radius: number("luxel_radius", |n| (0.0..1e18).contains(&n)),
            angle: number("luxel_angle", |n| (0.0..=180.0).contains(&n)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn keys(value: Value) -> (Keys, Vec<crate::Notice>) {
        let mut notes = Notes::default();
        let keys = Keys::from_value(&value, "node 1", &mut notes);
        (keys, notes.finish())
    }

    #[test]
    fn keys_are_read_and_inherited() {
        let (parent, notices) = keys(json!({"luxel_cast": false, "luxel_scale": 2, "other": [1]}));
        assert!(notices.is_empty());
        let above = NodeExtras::default().with(&parent);
        assert_eq!(above, NodeExtras { cast: false, scale: 2.0, ..NodeExtras::default() });
        let below = above.clone().with(&keys(json!({"luxel_cast": 1, "luxel_receive": 0.0})).0);
        assert_eq!(below, NodeExtras { cast: true, receive: false, scale: 2.0, ..NodeExtras::default() });
        let grouped = above.clone().with(&keys(json!({"luxel_group": " lamps "})).0);
        assert_eq!(grouped.clone().with(&Keys::default()).group.as_deref(), Some("lamps"));
        assert_eq!(grouped.with(&keys(json!({"luxel_group": "sun"})).0).group.as_deref(), Some("sun"));
        let ignored = above.with(&keys(json!({"luxel_ignore": true})).0);
        assert!(ignored.with(&keys(json!({"luxel_ignore": false})).0).ignore, "what is ignored stays so below");
    }

    #[test]
    fn nonsense_is_reported() {
        let (read, notices) =
            keys(json!({"luxel_scale": -1, "luxel_cast": "no", "luxel_bounce": 1, "luxel_group": " "}));
        assert_eq!(read, Keys::default());
        let codes: Vec<_> = notices.iter().map(|n| n.code).collect();
        assert_eq!(codes, ["unknown-extra", "invalid-extra", "invalid-extra", "invalid-extra"]);
        assert_eq!(keys(json!([1, 2])).0, Keys::default());
    }
}
