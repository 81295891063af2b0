//! A scene file with its document and buffers, checked: the common ground of everyone who reads one.

use std::path::Path;

use serde_json::Value;

use super::buffers::Buffers;
use super::container::{self, Container};
use super::document::Document;
use super::error::{Checked, ImportError};
use super::files::Files;
use super::options::Limits;
use super::references;
use crate::Progress;

/// An opened scene file. No accessor has been read yet, and no image.
pub struct Opened {
    /// The JSON text as it stands in the file, without byte-order mark and padding.
    pub json: Vec<u8>,
    /// The document of that text, with its buffers.
    pub buffers: Buffers,
    /// Reads further files beside the scene; knows those that were read.
    pub files: Files,
}

impl Opened {
    /// Opens the .gltf or .glb at `path`.
    pub fn read(path: &Path, limits: &Limits, progress: &dyn Progress) -> Checked<Self> {
        let mut files = Files::beside(path, limits);
        let Container { json, bin } = Container::parse(files.read_with(path, "", progress)?)?;
        progress.check()?;
        let document = Document::parse(&json, limits)?;
        progress.check()?;
        references::check(&document)?;
        let buffers = Buffers::load(document, bin, &mut files, limits, progress)?;
        Ok(Self { json, buffers, files })
    }
}

/// The extras of the default scene (the first one if there is no default) over those of the document, key by key and
/// within objects of the same key too; integral numbers as integers. Exporters write what belongs to a scene to either.
/// Reads the JSON of the file only: neither a .glb's buffers nor any other file.
///
/// # Errors
/// Those of [`load`](super::load) that concern container and document.
pub fn scene_extras(path: &Path, limits: &Limits) -> Result<Option<Value>, ImportError> {
    extras(path, limits).map_err(|fault| fault.in_file(path))
}

fn extras(path: &Path, limits: &Limits) -> Checked<Option<Value>> {
    let json = container::json_of(&mut Files::beside(path, limits), path, limits)?;
    let root = Document::parse(&json, limits)?.root;
    let scene = root.scenes.get(root.scene.map_or(0, |s| s.value()));
    // The text of extras has been parsed once already, so it parses.
    let parsed = |raw: &gltf_json::Extras| raw.as_ref().and_then(|raw| serde_json::from_str(raw.get()).ok());
    let (own, whole) = (scene.and_then(|s| parsed(&s.extras)), parsed(&root.extras));
    Ok(match (own, whole) {
        (Some(own), Some(whole)) => Some(over(own, whole, 2)),
        (own, whole) => own.or(whole),
    })
}

/// The keys of two objects together, the first one's values where both have one; objects among them alike, so many
/// levels down. What is no object stands as it is.
fn over(first: Value, second: Value, levels: u32) -> Value {
    match (first, second) {
        (Value::Object(first), Value::Object(mut second)) if levels > 0 => {
            for (key, value) in first {
                let below = second.remove(&key).unwrap_or_default();
                let joined = if below.is_null() { value } else { over(value, below, levels - 1) };
                second.insert(key, joined);
            }
            Value::Object(second)
        }
        (first, _) => first,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::container::writer::glb;

    const SCENE: &str = r#"{"asset":{"version":"2.0"},"scene":1,"scenes":[{},{"extras":{"luxel":{"size":64.0}}}]}"#;

    fn read(bytes: &[u8], limits: &Limits) -> Result<Option<Value>, ImportError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene");
        std::fs::write(&path, bytes).unwrap();
        scene_extras(&path, limits)
    }

    #[test]
    fn both_containers_byte_order_marks_and_padding() {
        let limits = Limits::default();
        let expected = Some(serde_json::json!({"luxel": {"size": 64}}));
        let marked = format!("\u{feff}{SCENE}\n");
        assert_eq!(read(SCENE.as_bytes(), &limits).unwrap(), expected);
        assert_eq!(read(marked.as_bytes(), &limits).unwrap(), expected);
        assert_eq!(read(&glb(&format!("{SCENE}\0"), &[0; 8]), &limits).unwrap(), expected);
        assert_eq!(read(&glb(&marked, &[0; 40]), &limits).unwrap(), expected);
        assert_eq!(read(br#"{"asset":{"version":"2.0"}}"#, &limits).unwrap(), None);
    }

    #[test]
    fn the_extras_of_the_scene_hide_those_of_the_document() {
        let of = |document: &str, scene: &str| {
            let json =
                format!(r#"{{"asset":{{"version":"2.0"}},"extras":{document},"scenes":[{{"extras":{scene}}}]}}"#);
            read(json.as_bytes(), &Limits::default()).unwrap().unwrap()
        };
        let both = of(
            r#"{"luxel":{"size":32,"sky":{"a":1},"seed":3},"by":"x"}"#,
            r#"{"luxel":{"size":64,"sky":{"b":2}},"n":1}"#,
        );
        // Settings are joined; the value of a setting is taken whole.
        assert_eq!(both, serde_json::json!({"luxel": {"size": 64, "sky": {"b": 2}, "seed": 3}, "by": "x", "n": 1}));
        assert_eq!(of(r#"{"luxel":{"size":32.0}}"#, "{}"), serde_json::json!({"luxel": {"size": 32}}));
        assert_eq!(
            of(r#"{"luxel":{"size":32}}"#, r#"{"luxel":7}"#),
            serde_json::json!({"luxel": 7}),
            "a fault to tell"
        );
        assert_eq!(of("7", "{}"), serde_json::json!({}));
        let alone = br#"{"asset":{"version":"2.0"},"extras":{"luxel":{"size":32}}}"#;
        assert_eq!(read(alone, &Limits::default()).unwrap(), Some(serde_json::json!({"luxel": {"size": 32}})));
    }

    #[test]
    fn only_the_json_of_a_binary_file_is_read() {
        let limits = Limits::default();
        let whole = glb(SCENE, &[0; 4096]);
        let behind_json = whole.len() - 4096 - 8;
        for n in 0..behind_json {
            assert!(read(&whole[..n], &limits).is_err(), "{n}");
        }
        assert!(read(&whole[..behind_json], &limits).unwrap().is_some(), "whatever follows is not looked at");
        assert!(read(&whole, &Limits { json_bytes: 20, ..limits }).is_err());
    }
}
