//! Settings that a scene file carries itself: the object `extras.luxel` of its default scene, as Blender's custom
//! properties of a scene are exported.
//!
//! ```json
//! "scenes": [{ "nodes": [0], "extras": { "luxel": { "sky": [0.3, 0.5, 1.0] } } }]
//! ```

use std::path::Path;

use luxel_scene::Limits;
use luxel_scene::import::scene_extras;
use serde_json::Value as Json;

use super::{Layer, Origin, SettingsError, resolve::kind};

/// The settings in the file's extras, read as the importer reads the file. A file that cannot be read or understood has
/// none: the import, which reads it next, says what is wrong with it.
pub fn read(path: &Path) -> Result<Option<Layer>, SettingsError> {
    let extras = scene_extras(path, &Limits::default()).ok().flatten();
    let origin = Origin::Extras(path.into());
    let object = match extras.as_ref().and_then(|e| e.get("luxel")) {
        None | Some(Json::Null) => return Ok(None),
        Some(Json::Object(object)) => object,
        Some(other) => {
            let (name, form) = ("luxel".into(), "a table of settings".into());
            return Err(SettingsError::Kind { origin, name, found: kind(other), form });
        }
    };
    let mut layer = Layer::from_json(object, origin)?;
    layer.anchor(path.parent().unwrap_or(Path::new("")));
    Ok(Some(layer))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::resolve;

    const SCENE: &str =
        r#"{"asset":{"version":"2.0"},"scene":1,"scenes":[{},{"extras":{"luxel":{"size":64.0,"sky":[1,2.0,3]}}}]}"#;

    #[test]
    fn a_scene_carries_settings_behind_a_byte_order_mark_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gltf");
        for text in [SCENE.to_owned(), format!("\u{feff}{SCENE}\n")] {
            std::fs::write(&path, text).unwrap();
            let resolved = resolve(&[read(&path).unwrap().unwrap()]).unwrap();
            // Exporters write whole numbers as floats.
            assert_eq!(resolved.settings.size.0, 64);
        }
    }

    #[test]
    fn a_broken_file_has_no_settings_and_a_wrong_key_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gltf");
        assert!(read(&path).unwrap().is_none());
        std::fs::write(&path, "{").unwrap();
        assert!(read(&path).unwrap().is_none());
        std::fs::write(&path, SCENE.replace("size", "siez")).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("`size`"));
        for (value, kind) in [("7", "number"), ("\"size=64\"", "text"), ("[64]", "list"), ("true", "switch")] {
            let scene = format!(r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"extras":{{"luxel":{value}}}}}]}}"#);
            std::fs::write(&path, scene).unwrap();
            let said = read(&path).unwrap_err().to_string();
            assert!(said.contains("`luxel`") && said.contains(kind) && said.contains("table"), "{said}");
        }
    }
}
