//! Which files of a bake may be served: those that its report lists, by their place in a list.
//!
//! A report is a file like any other, so nothing in it is believed: only names that a bake gives to its outputs count,
//! all of them in the report's own folder, and a file is sent only while its content is what the report says
//! ([`File::open`]). So no request and no report can make the server read anything else, and a page never mixes the
//! files of two bakes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use luxel_export::Report;
use serde_json::{Value, json};

use super::LiveError;
use super::glb::{self, Digests};

/// No report is larger.
const MAX_REPORT: u64 = 64 << 20;
/// A larger .glb is loaded whole by the page whenever anything in it changes, instead of being looked into here.
const MAX_GLB: u64 = 1 << 30;
/// Ending of a report's name.
const REPORT: &str = ".bake.json";

/// What an output is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Glb,
    /// Irradiance of a page of the atlas, by its number.
    Lightmap(u32),
    /// Stated bound of a page.
    Bound(u32),
    Picture,
}

/// A file that may be served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    pub kind: Kind,
    path: PathBuf,
    length: u64,
    /// BLAKE3 of its content, hexadecimal.
    pub hash: String,
}

/// The outputs of one bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Outputs {
    pub files: Vec<File>,
    /// None until the .glb was looked into; the inner one is none where it cannot be.
    pub digests: Option<Option<Digests>>,
    /// Settings and figures that a page needs to show light in its units.
    facts: Value,
}

impl Outputs {
    /// Reads a report. What it lists may be large, and is not looked at yet.
    pub fn read(path: &Path) -> Result<Self, LiveError> {
        let failed = |source| LiveError::Report { path: path.into(), source };
        let bytes = small(path, MAX_REPORT).map_err(failed)?;
        let report: Report = serde_json::from_slice(&bytes).map_err(|e| failed(e.into()))?;
        let name = path.file_name().and_then(|n| n.to_str()).and_then(|n| n.strip_suffix(REPORT));
        let stem = name.ok_or_else(|| failed(io::Error::other("a report's name ends in .bake.json")))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let listed = report.outputs.iter().filter_map(|output| {
            let kind = kind(stem, &output.path)?;
            Some(File { kind, path: folder.join(&output.path), length: output.bytes, hash: output.blake3.clone() })
        });
        let mut files: Vec<File> = listed.collect();
        files.sort_by_key(|file| file.kind);
        Ok(Self { digests: None, facts: facts(&report), files })
    }

    /// Looks into the .glb: as slow as it is large.
    pub fn digest(&self) -> Option<Digests> {
        let glb = self.files.iter().find(|file| file.kind == Kind::Glb)?;
        glb::digests(&small(&glb.path, MAX_GLB).ok()?)
    }

    /// These outputs, once their .glb was looked into.
    pub fn digested(&self, digests: Option<Digests>) -> Self {
        Self { digests: Some(digests), ..self.clone() }
    }

    /// A .glb and all else that the report lists is there, by its lengths.
    pub fn is_whole(&self) -> bool {
        let is_there = |f: &File| fs::metadata(&f.path).is_ok_and(|meta| meta.is_file() && meta.len() == f.length);
        self.files.iter().any(|f| f.kind == Kind::Glb) && self.files.iter().all(is_there)
    }

    /// What a page learns about them; `scene` is the number under which they are asked for.
    pub fn to_json(&self, scene: usize) -> Value {
        let url = |what: &str, place: usize, hash: &str| format!("/scenes/{scene}/{what}/{place}?v={hash}");
        let numbered = || self.files.iter().enumerate();
        let of = |wanted: Kind| numbered().find(|(_, f)| f.kind == wanted).map(|(i, f)| url("files", i, &f.hash));
        let lightmaps: Vec<Value> = numbered()
            .filter_map(|(i, file)| {
                let Kind::Lightmap(page) = file.kind else { return None };
                Some(json!({
                    "page": page,
                    "texels": url("texels", i, &file.hash),
                    "file": url("files", i, &file.hash),
                }))
            })
            .collect();
        json!({
            "glb": of(Kind::Glb),
            "picture": of(Kind::Picture),
            "lightmaps": lightmaps,
            "pending": self.digests.is_none(),
            "layout": self.digests.as_ref().and_then(|d| Some(&d.as_ref()?.layout)),
            "content": self.digests.as_ref().and_then(|d| Some(&d.as_ref()?.content)),
            "facts": self.facts,
        })
    }
}

impl File {
    /// The file, at its beginning, and its length; none while it is not what the report says.
    pub fn open(&self) -> io::Result<Option<(fs::File, u64)>> {
        // A pipe would block for ever.
        if !fs::metadata(&self.path)?.is_file() {
            return Ok(None);
        }
        let mut file = fs::File::open(&self.path)?;
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(&mut file)?;
        let length = hasher.count();
        io::Seek::rewind(&mut file)?;
        Ok((hasher.finalize().to_hex().as_str() == self.hash).then_some((file, length)))
    }

    /// Its whole content, of so many bytes at most, which need not be what the report says.
    pub fn read(&self, most: u64) -> io::Result<Vec<u8>> {
        small(&self.path, most)
    }

    /// These bytes are what the report says.
    pub fn is(&self, bytes: &[u8]) -> bool {
        blake3::hash(bytes).to_hex().as_str() == self.hash
    }

    pub fn content_type(&self) -> &'static str {
        match self.kind {
            Kind::Glb => "model/gltf-binary",
            Kind::Lightmap(_) | Kind::Bound(_) => "image/x-exr",
            Kind::Picture => "image/png",
        }
    }
}

/// What an output with this name is; none for names that no bake gives.
fn kind(stem: &str, name: &str) -> Option<Kind> {
    let rest = name.strip_prefix(stem)?.strip_prefix('.')?;
    if let Some(image) = rest.strip_suffix("exr").and_then(|r| r.strip_suffix('.')) {
        let (what, page) = image.split_once('.').unwrap_or((image, "0"));
        let is_number = !page.is_empty() && page.len() <= 6 && page.bytes().all(|b| b.is_ascii_digit());
        let page = is_number.then(|| page.parse().ok())??;
        return match what {
            "lightmap" => Some(Kind::Lightmap(page)),
            "bound" => Some(Kind::Bound(page)),
            _ => None,
        };
    }
    match rest {
        "glb" => Some(Kind::Glb),
        "preview.png" => Some(Kind::Picture),
        _ => None,
    }
}

/// Settings and figures of a report that decide how its light is shown.
fn facts(report: &Report) -> Value {
    let setting = |name: &str| report.settings.iter().find(|s| s.name == name).map(|s| s.value.clone());
    let figure = |name: &str| report.quality.get(name).copied();
    json!({
        "preset": if report.draft { Some("draft".into()) } else { setting("preset") },
        "draft": report.draft,
        "metal_diffuse": setting("metal_diffuse"),
        "emissive_scale": setting("emissive_scale"),
        "only": setting("only"),
        "mean_irradiance_lux": figure("mean_irradiance_lux"),
        "texels_per_unit": figure("texels_per_unit"),
        "seconds": report.stages.iter().map(|s| s.seconds).sum::<f64>(),
        "warnings": report.warnings,
    })
}

fn small(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let meta = fs::metadata(path)?;
    if !meta.is_file() {
        return Err(io::Error::other("this is no file"));
    }
    if meta.len() > most {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    fs::read(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_export::report::{Output, SceneInfo};

    #[test]
    fn only_names_that_a_bake_gives_are_outputs() {
        let some = [
            ("a.glb", Kind::Glb),
            ("a.lightmap.exr", Kind::Lightmap(0)),
            ("a.lightmap.12.exr", Kind::Lightmap(12)),
            ("a.bound.exr", Kind::Bound(0)),
            ("a.preview.png", Kind::Picture),
        ];
        for (name, expected) in some {
            assert_eq!(kind("a", name), Some(expected), "{name}");
        }
        for name in [
            "b.glb",
            "a.gltf",
            "a.lightmap.x.exr",
            "a.lightmap..exr",
            "a.lightmap.1.2.exr",
            "a.lightmap.1/../../secret.exr",
            "a.exr",
            "a./../secret.glb",
            "/etc/passwd",
            "a",
            "a.",
            "aexr",
            "",
        ] {
            assert_eq!(kind("a", name), None, "{name}");
        }
    }

    #[test]
    fn a_file_is_opened_only_while_it_is_what_the_report_says() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let hash = |bytes: &[u8]| blake3::hash(bytes).to_hex().to_string();
        let mut report = Report::new(SceneInfo::default());
        let listed = |path: &str, content: &[u8]| Output { path: path.into(), bytes: 0, blake3: hash(content) };
        report.outputs = vec![listed("a.preview.png", b"png"), listed("../secret", b"secret")];
        std::fs::write(at("a.bake.json"), report.to_json().unwrap()).unwrap();
        let outputs = Outputs::read(&at("a.bake.json")).unwrap();
        let [file] = &outputs.files[..] else { panic!("{outputs:?}") };
        assert!(file.open().is_err(), "it is not there yet");
        std::fs::write(at("a.preview.png"), b"png").unwrap();
        assert_eq!(file.open().unwrap().unwrap().1, 3);
        assert!(file.read(3).unwrap() == b"png" && file.is(b"png"));
        assert_eq!(file.read(2).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        std::fs::write(at("a.preview.png"), b"other").unwrap();
        assert!(file.open().unwrap().is_none() && !file.is(&file.read(99).unwrap()));
        for bad in ["", "[]", "{\"schema\":1}"] {
            std::fs::write(at("a.bake.json"), bad).unwrap();
            assert!(matches!(Outputs::read(&at("a.bake.json")), Err(LiveError::Report { .. })));
        }
    }
}
