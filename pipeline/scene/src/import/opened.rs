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
    pub fn read(path: &Path, limits: &Limits) -> Checked<Self> {
        let mut files = Files::beside(path, limits);
        let Container { json, bin } = Container::parse(files.read(path, "")?)?;
        let document = Document::parse(&json, limits)?;
        references::check(&document)?;
        let buffers = Buffers::load(document, bin, &mut files, limits)?;
        Ok(Self { json, buffers, files })
    }
}

/// The extras of the default scene (the first one if there is no default), integral numbers as integers. Reads the
/// JSON of the file only: neither a .glb's buffers nor any other file.
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
    Ok(scene.and_then(|s| s.extras.as_ref()).and_then(|raw| serde_json::from_str(raw.get()).ok()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = r#"{"asset":{"version":"2.0"},"scene":1,"scenes":[{},{"extras":{"luxel":{"size":64.0}}}]}"#;

    fn read(bytes: &[u8], limits: &Limits) -> Result<Option<Value>, ImportError> {
        let path = std::env::temp_dir().join(format!("luxel-extras-{}-{}", std::process::id(), bytes.len()));
        std::fs::write(&path, bytes).unwrap();
        let extras = scene_extras(&path, limits);
        std::fs::remove_file(&path).unwrap();
        extras
    }

    #[test]
    fn both_containers_byte_order_marks_and_padding() {
        let limits = Limits::default();
        let expected = Some(serde_json::json!({"luxel": {"size": 64}}));
        let marked = format!("\u{feff}{SCENE}\n");
        assert_eq!(read(SCENE.as_bytes(), &limits).unwrap(), expected);
        assert_eq!(read(marked.as_bytes(), &limits).unwrap(), expected);
        assert_eq!(read(&container::glb(&format!("{SCENE}\0"), &[0; 8]), &limits).unwrap(), expected);
        assert_eq!(read(&container::glb(&marked, &[0; 40]), &limits).unwrap(), expected);
        assert_eq!(read(br#"{"asset":{"version":"2.0"}}"#, &limits).unwrap(), None);
    }

    #[test]
    fn only_the_json_of_a_binary_file_is_read() {
        let limits = Limits::default();
        let whole = container::glb(SCENE, &[0; 4096]);
        let behind_json = whole.len() - 4096 - 8;
        for n in 0..behind_json {
            assert!(read(&whole[..n], &limits).is_err(), "{n}");
        }
        assert!(read(&whole[..behind_json], &limits).unwrap().is_some(), "whatever follows is not looked at");
        assert!(read(&whole, &Limits { json_bytes: 20, ..limits }).is_err());
    }
}
