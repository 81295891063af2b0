//! The files a scene consists of: relative paths, data URIs, size limits, digests.
//!
//! A glTF file names its buffers and images by URI (glTF 2.0 §2.8). A scene may come from anywhere, so a URI never
//! leads to the network, to an absolute path, or far above the scene's folder.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::error::{Bound, Checked, Fault, FaultKind, quoted};
use super::options::Limits;
use crate::{Cancelled, InputFile, Progress, Silent, Watched};

/// Bytes that are hashed between two looks at the progress: a millisecond or two.
const HASHED: usize = 1 << 22;

/// Padding is often left out in the wild; without it the length says the same.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// Reads files below (or near) one folder and remembers what it read.
pub struct Files {
    folder: PathBuf,
    limits: Limits,
    inputs: Vec<InputFile>,
    seen: BTreeSet<PathBuf>,
    bytes: u64,
}

impl Files {
    /// For the scene at `scene`.
    pub fn beside(scene: &Path, limits: &Limits) -> Self {
        let folder = scene.parent().map(Path::to_path_buf).unwrap_or_default();
        Self { folder, limits: limits.clone(), inputs: Vec::new(), seen: BTreeSet::new(), bytes: 0 }
    }

    /// Bytes read so far, data URIs included.
    pub fn bytes_read(&self) -> u64 {
        self.bytes
    }

    /// Every file that was read, with the digest of its bytes.
    pub fn inputs(&self) -> &[InputFile] {
        &self.inputs
    }

    pub fn into_inputs(self) -> Vec<InputFile> {
        self.inputs
    }

    /// Reads a whole regular file within the size limits and records its digest. `place` is what asked for it, empty
    /// when the file is the scene or the sky itself.
    pub fn read(&mut self, path: &Path, place: &str) -> Checked<Vec<u8>> {
        self.read_with(path, place, &Silent)
    }

    /// [`Files::read`] that can be cancelled.
    pub fn read_with(&mut self, path: &Path, place: &str, progress: &dyn Progress) -> Checked<Vec<u8>> {
        let limit = self.limits.file_bytes.min(self.limits.input_bytes.saturating_sub(self.bytes));
        let size = regular(path, place)?;
        let bytes = if size > limit { Vec::new() } else { front(path, place, limit.saturating_add(1), progress)? };
        // The file may have grown since its size was asked for.
        let size = size.max(bytes.len() as u64);
        if size > limit {
            return Err(self.too_large(path, place, size));
        }
        self.bytes = self.bytes.saturating_add(bytes.len() as u64);
        if self.seen.insert(path.to_path_buf()) {
            self.inputs.push(InputFile { path: path.to_path_buf(), digest: digest(&bytes, progress)? });
        }
        Ok(bytes)
    }

    /// The first `most` bytes of a regular file within the size limit, or all of it. Records nothing.
    pub fn read_front(&self, path: &Path, place: &str, most: u64) -> Checked<Vec<u8>> {
        let size = regular(path, place)?;
        if size > self.limits.file_bytes {
            return Err(self.too_large(path, place, size));
        }
        front(path, place, most, &Silent)
    }

    /// Too large for itself, or with all that was read before.
    fn too_large(&self, path: &Path, place: &str, bytes: u64) -> Fault {
        let (name, limits) = (subject(path, place), &self.limits);
        if bytes > limits.file_bytes {
            return Fault::limit(place, format!("{name} has {bytes} bytes"), Bound::FileBytes, limits.file_bytes);
        }
        let what = format!("with {name} the files of the scene have {} bytes", self.bytes.saturating_add(bytes));
        Fault::limit(place, what, Bound::InputBytes, limits.input_bytes)
    }

    /// Where the file of a URI is; None for a data URI.
    pub fn path_of(&self, uri: &str, place: &str) -> Checked<Option<PathBuf>> {
        if strip_scheme(uri, "data").is_some() { Ok(None) } else { self.locate(uri, place).map(Some) }
    }

    /// The bytes behind a URI of the glTF document.
    pub fn fetch(&mut self, uri: &str, place: &str) -> Checked<Vec<u8>> {
        self.fetch_with(uri, place, &Silent)
    }

    /// [`Files::fetch`] that can be cancelled.
    pub fn fetch_with(&mut self, uri: &str, place: &str, progress: &dyn Progress) -> Checked<Vec<u8>> {
        progress.check()?;
        if let Some(data) = strip_scheme(uri, "data") {
            let bytes = decode_data(data).map_err(|what| Fault::invalid(place, what))?;
            self.bytes = self.bytes.saturating_add(bytes.len() as u64);
            return Ok(bytes);
        }
        let path = self.locate(uri, place)?;
        self.read_with(&path, place, progress)
    }

    /// The path a relative URI means. Percent-encoding is undone as the specification says; names that were written
    /// without encoding them, or with backslashes, are found when the proper reading finds nothing.
    fn locate(&self, uri: &str, place: &str) -> Checked<PathBuf> {
        let decoded = percent_encoding::percent_decode_str(uri)
            .decode_utf8()
            .map_err(|_| Fault::invalid(place, format!("the URI {} is not UTF-8", quoted(uri))))?;
        let proper = self.checked_path(&decoded, uri, place)?;
        if proper.exists() {
            return Ok(proper);
        }
        for other in [uri.to_owned(), decoded.replace('\\', "/")] {
            if let Ok(path) = self.checked_path(&other, uri, place)
                && path.exists()
            {
                return Ok(path);
            }
        }
        Ok(proper)
    }

    fn checked_path(&self, relative: &str, uri: &str, place: &str) -> Checked<PathBuf> {
        let refuse = |why: &str| {
            let hint = "keep buffers and images beside the scene and name them by relative paths, or embed them";
            Fault::new(FaultKind::Unsupported, place, format!("the URI {} {why}", quoted(uri)), hint)
        };
        if relative.is_empty() || relative.contains('\0') {
            return Err(refuse("names no file"));
        }
        if scheme(relative).is_some() {
            return Err(refuse("is not a relative path"));
        }
        if relative.starts_with(['/', '\\']) || Path::new(relative).is_absolute() {
            return Err(refuse("is an absolute path"));
        }
        if levels_above(relative) > self.limits.parent_levels {
            return Err(refuse("leads too far above the scene's folder (limit `parent_levels`)"));
        }
        Ok(self.folder.join(relative))
    }
}

/// How a message calls a file: the scene and the sky, which nothing in a file asked for, are named by the whole message.
fn subject(path: &Path, place: &str) -> String {
    if place.is_empty() { "it".into() } else { path.display().to_string() }
}

fn unreadable(place: &str, what: String) -> Fault {
    Fault::new(FaultKind::Unreadable, place, what, "check that the file is there and may be read")
}

/// The size of a regular file.
fn regular(path: &Path, place: &str) -> Checked<u64> {
    let name = subject(path, place);
    let meta = std::fs::metadata(path).map_err(|e| unreadable(place, format!("{name} cannot be read ({e})")))?;
    // A pipe or a device could block for ever.
    if meta.is_file() { Ok(meta.len()) } else { Err(unreadable(place, format!("{name} is not a regular file"))) }
}

/// The first `most` bytes of a file, or all of it.
fn front(path: &Path, place: &str, most: u64, progress: &dyn Progress) -> Checked<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| Watched::new(file, progress).take(most).read_to_end(&mut bytes));
    match read {
        Ok(_) => Ok(bytes),
        Err(error) if Cancelled::caused(&error) => Err(Cancelled.into()),
        Err(error) => Err(unreadable(place, format!("{} cannot be read ({error})", subject(path, place)))),
    }
}

/// The hash of a file's content.
fn digest(bytes: &[u8], progress: &dyn Progress) -> Result<[u8; 32], Cancelled> {
    let mut hasher = blake3::Hasher::new();
    for piece in bytes.chunks(HASHED) {
        progress.check()?;
        hasher.update(piece);
    }
    Ok(*hasher.finalize().as_bytes())
}

/// The media type of a data URI, if it is one and states it.
pub fn media_type(uri: &str) -> Option<&str> {
    let (head, _) = strip_scheme(uri, "data")?.split_once(',')?;
    head.split(';').next().map(str::trim).filter(|m| m.contains('/'))
}

/// How many folders above its start a relative path climbs at most.
fn levels_above(path: &str) -> u32 {
    let (mut depth, mut lowest) = (0i64, 0i64);
    for part in path.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." => depth -= 1,
            _ => depth += 1,
        }
        lowest = lowest.min(depth);
    }
    u32::try_from(-lowest).unwrap_or(u32::MAX)
}

/// The scheme of a URI in RFC 3986's grammar.
fn scheme(uri: &str) -> Option<&str> {
    let (scheme, _) = uri.split_once(':')?;
    let mut chars = scheme.chars();
    let proper =
        chars.next()?.is_ascii_alphabetic() && chars.all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'));
    proper.then_some(scheme)
}

fn strip_scheme<'a>(uri: &'a str, wanted: &str) -> Option<&'a str> {
    scheme(uri).filter(|s| s.eq_ignore_ascii_case(wanted)).map(|s| &uri[s.len() + 1..])
}

/// The payload of `data:[media type][;base64],payload` (RFC 2397), without its `data:`.
fn decode_data(data: &str) -> Result<Vec<u8>, String> {
    let (head, payload) = data.split_once(',').ok_or("the data URI has no comma")?;
    if head.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64")) {
        let payload = payload.trim_end();
        if payload.contains('%') {
            let plain: Vec<u8> = percent_encoding::percent_decode_str(payload).collect();
            return BASE64.decode(plain).map_err(|e| format!("the data URI is not base64 ({e})"));
        }
        BASE64.decode(payload).map_err(|e| format!("the data URI is not base64 ({e})"))
    } else {
        Ok(percent_encoding::percent_decode_str(payload).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files() -> Files {
        Files::beside(Path::new("scenes/hall/level.gltf"), &Limits::default())
    }

    #[test]
    fn data_uris_decode() {
        let mut files = files();
        for uri in [
            "data:application/octet-stream;base64,AQID",
            "data:;base64,AQID",
            "DATA:image/png;BASE64,AQID",
            "data:,%01%02%03",
        ] {
            assert_eq!(files.fetch(uri, "buffer 0").unwrap(), [1, 2, 3], "{uri}");
        }
        assert_eq!(files.fetch("data:;base64,AQI", "buffer 0").unwrap(), [1, 2], "padding may be missing");
        assert!(files.fetch("data:;base64,A*ID", "buffer 0").is_err());
        assert!(files.fetch("data:;base64", "buffer 0").is_err());
        assert_eq!(files.bytes_read(), 14);
    }

    #[test]
    fn paths_stay_near_the_scene() {
        let files = files();
        let at = |uri: &str| files.locate(uri, "image 0").map(|p| p.to_string_lossy().replace('\\', "/"));
        assert_eq!(at("wall%20a.png").unwrap(), "scenes/hall/wall a.png");
        assert_eq!(at("../textures/wall.png").unwrap(), "scenes/hall/../textures/wall.png");
        for uri in [
            "/etc/hostname",
            "\\\\server\\share",
            "C:\\wall.png",
            "file:///etc/hostname",
            "https://example.org/wall.png",
            "../../../wall.png",
            "a/../../../../wall.png",
            "%2e%2e/%2e%2e/%2e%2e/wall.png",
            "",
            "a%00b",
            "%ff.png",
        ] {
            assert!(at(uri).is_err(), "{uri}");
        }
    }

    #[test]
    fn a_missing_file_and_a_folder_are_named() {
        let mut files = files();
        let missing = files.fetch("nowhere.bin", "buffer 2").unwrap_err().to_string();
        assert!(missing.starts_with("buffer 2: scenes/hall/nowhere.bin cannot be read ("), "{missing}");
        let folder = files.read(Path::new(env!("CARGO_MANIFEST_DIR")), "sky").unwrap_err().to_string();
        assert!(folder.contains("not a regular file"), "{folder}");
    }

    #[test]
    fn the_scene_itself_is_named_once() {
        let path = Path::new("nowhere/level.glb");
        let told = |fault: Fault| fault.in_file(path).to_string();
        let missing = told(Files::beside(path, &Limits::default()).read(path, "").unwrap_err());
        assert!(missing.starts_with("nowhere/level.glb: it cannot be read ("), "{missing}");
        assert_eq!(missing.matches("level.glb").count(), 1, "{missing}");
    }

    #[test]
    fn the_size_limit_holds() {
        let limits = Limits { file_bytes: 10, ..Limits::default() };
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        let fault = Files::beside(&manifest, &limits).read(&manifest, "").unwrap_err();
        assert!(fault.kind == FaultKind::Limit && fault.what.contains("file_bytes"), "{fault}");
    }
}
