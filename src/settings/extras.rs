//! Settings that a scene file carries itself: the object `extras.luxel` of its default scene, as Blender's custom
//! properties of a scene are exported.
//!
//! ```json
//! "scenes": [{ "nodes": [0], "extras": { "luxel": { "sky": [0.3, 0.5, 1.0] } } }]
//! ```

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use serde_json::Value as Json;

use super::{Layer, Origin, SettingsError};

/// Most JSON that is read for the extras [bytes]; a larger file's extras are refused by the import's own limit.
const MAX_JSON: u64 = 256 << 20;

/// The settings in the file's extras. A file that cannot be read or understood has none: the import, which reads it
/// next, says what is wrong with it.
pub fn read(path: &Path) -> Result<Option<Layer>, SettingsError> {
    let Some(json) = json_text(path).and_then(|text| serde_json::from_slice::<Json>(&text).ok()) else {
        return Ok(None);
    };
    let scene = json.get("scene").and_then(Json::as_u64).unwrap_or(0) as usize;
    let luxel = json.get("scenes").and_then(|s| s.get(scene)).and_then(|s| s.get("extras")?.get("luxel"));
    let Some(object) = luxel.and_then(Json::as_object) else { return Ok(None) };
    let mut layer = Layer::from_json(object, Origin::Extras(path.into()))?;
    layer.anchor(path.parent().unwrap_or(Path::new("")));
    Ok(Some(layer))
}

/// The JSON of a .gltf, or the first chunk of a .glb.
fn json_text(path: &Path) -> Option<Vec<u8>> {
    let mut file = File::open(path).ok()?;
    let mut head = [0u8; 20];
    let length = match file.read_exact(&mut head) {
        Ok(()) if head.starts_with(b"glTF") => u64::from(u32::from_le_bytes(head[12..16].try_into().ok()?)),
        _ => {
            file.seek(SeekFrom::Start(0)).ok()?;
            file.metadata().ok()?.len()
        }
    };
    if length > MAX_JSON {
        return None;
    }
    let mut text = Vec::new();
    file.take(length).read_to_end(&mut text).ok()?;
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::resolve;

    const SCENE: &str = r#"{"scene":1,"scenes":[{},{"extras":{"luxel":{"size":64}}}]}"#;

    #[test]
    fn both_containers_carry_settings() {
        let folder = tempfile::tempdir().unwrap();
        let gltf = folder.path().join("a.gltf");
        std::fs::write(&gltf, SCENE).unwrap();
        let glb = folder.path().join("a.glb");
        let mut bytes = b"glTF".to_vec();
        bytes.extend(2u32.to_le_bytes());
        bytes.extend((20 + SCENE.len() as u32).to_le_bytes());
        bytes.extend((SCENE.len() as u32).to_le_bytes());
        bytes.extend(b"JSON");
        bytes.extend(SCENE.as_bytes());
        std::fs::write(&glb, bytes).unwrap();
        for path in [gltf, glb] {
            let resolved = resolve(&[read(&path).unwrap().unwrap()]).unwrap();
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
    }
}
