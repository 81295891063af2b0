//! The bytes behind a scene: the container, and what its URIs name.
//!
//! A scene may come from anywhere: a URI never leads to the network, to an absolute path, or far above the scene's
//! folder, and no pipe or device is read.

use std::{
    fs::File,
    io::Read,
    path::{Path, PathBuf},
};

use base64::{
    Engine, alphabet,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use percent_encoding::percent_decode_str;

use super::fault::{Checked, Fault};

/// A .glb counts its bytes in 32 bits, so nothing larger can go into one.
const MAX_FILE: u64 = u32::MAX as u64;
/// How many folders above the scene's own a relative path may lead.
const MAX_PARENTS: i64 = 2;

/// Padding is often left out in the wild; without it the length says the same.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// A .gltf or .glb taken apart: the JSON text and the BIN chunk.
pub struct Container {
    pub json: Vec<u8>,
    pub bin: Option<Vec<u8>>,
}

impl Container {
    /// Tells the two containers apart by content; chunks after BIN belong to extensions and are dropped.
    pub fn parse(bytes: &[u8]) -> Checked<Self> {
        if !bytes.starts_with(b"glTF") {
            return Ok(Self { json: trimmed(bytes).to_vec(), bin: None });
        }
        let fault = |what: &str| Fault::new("GLB container", what);
        let word = |at: usize| {
            let bytes = bytes.get(at..at.checked_add(4)?)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?) as usize)
        };
        let total = word(8).filter(|t| *t <= bytes.len()).ok_or_else(|| fault("is cut short"))?;
        if word(4) != Some(2) {
            return Err(fault("is not version 2"));
        }
        let chunk = |at: usize, kind: &[u8; 4]| {
            let end = (at + 8).checked_add(word(at)?).filter(|end| *end <= total)?;
            (bytes.get(at + 4..at + 8)? == kind).then_some((&bytes[at + 8..end], end))
        };
        let (json, mut at) = chunk(12, b"JSON").ok_or_else(|| fault("has no whole JSON chunk"))?;
        let mut bin = None;
        while bin.is_none() && at < total {
            let length = word(at).ok_or_else(|| fault("is cut short"))?;
            bin = chunk(at, b"BIN\0").map(|(data, _)| data.to_vec());
            at = (at + 8).checked_add(length).filter(|end| *end <= total).ok_or_else(|| fault("is cut short"))?;
        }
        Ok(Self { json: trimmed(json).to_vec(), bin })
    }
}

/// Without byte-order mark in front and padding behind.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let end = bytes.iter().rposition(|b| !b.is_ascii_whitespace() && *b != 0).map_or(0, |i| i + 1);
    &bytes[..end]
}

/// Reads a whole regular file of at most 4 GiB.
pub fn read(path: &Path) -> Checked<Vec<u8>> {
    let fault = |what: String| Fault::new(path.display().to_string(), what);
    let meta = std::fs::metadata(path).map_err(|e| fault(format!("cannot be read ({e})")))?;
    if !meta.is_file() {
        return Err(fault("is not a regular file".into()));
    }
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|f| f.take(MAX_FILE + 1).read_to_end(&mut bytes))
        .map_err(|e| fault(format!("cannot be read ({e})")))?;
    if bytes.len() as u64 > MAX_FILE {
        return Err(fault("has more than 4 GiB, which no .glb can hold".into()));
    }
    Ok(bytes)
}

/// What a URI holds: the media type of a data URI, the path of a file, and the bytes.
pub struct Fetched {
    pub media_type: Option<String>,
    pub path: Option<PathBuf>,
    pub bytes: Vec<u8>,
}

/// The bytes behind a URI, relative to `folder`.
pub fn fetch(folder: &Path, uri: &str) -> Checked<Fetched> {
    if let Some((scheme, data)) = uri.split_once(':').filter(|(s, _)| is_scheme(s)) {
        if !scheme.eq_ignore_ascii_case("data") {
            return Err(Fault::new(shown(uri), "leads out of the file system"));
        }
        let (media_type, bytes) = decode_data(data).map_err(|what| Fault::new(shown(uri), what))?;
        return Ok(Fetched { media_type, path: None, bytes });
    }
    let path = locate(folder, uri)?;
    Ok(Fetched { media_type: None, bytes: read(&path)?, path: Some(path) })
}

/// Percent-encoding is undone as the specification says; names that were written without encoding them, or with
/// backslashes, are found when the proper reading finds nothing.
fn locate(folder: &Path, uri: &str) -> Checked<PathBuf> {
    let decoded = percent_decode_str(uri).decode_utf8().map_err(|_| Fault::new(shown(uri), "is not UTF-8"))?;
    let proper = checked_path(folder, &decoded)?;
    let others = [uri.to_owned(), decoded.replace('\\', "/")];
    let other = others.iter().filter_map(|o| checked_path(folder, o).ok()).find(|p| p.exists());
    Ok(if proper.exists() { proper } else { other.unwrap_or(proper) })
}

fn checked_path(folder: &Path, relative: &str) -> Checked<PathBuf> {
    let fault = |what: &str| Fault::new(shown(relative), what);
    if relative.is_empty() || relative.contains('\0') {
        return Err(fault("names no file"));
    }
    if relative.starts_with(['/', '\\']) || Path::new(relative).is_absolute() {
        return Err(fault("is an absolute path"));
    }
    let (mut depth, mut lowest) = (0, 0);
    for part in relative.split(['/', '\\']) {
        depth += match part {
            "" | "." => 0,
            ".." => -1,
            _ => 1,
        };
        lowest = depth.min(lowest);
    }
    if lowest < -MAX_PARENTS {
        return Err(fault("leads too far above the scene's folder"));
    }
    Ok(folder.join(relative))
}

/// RFC 3986's grammar of a scheme; a drive letter reads as one too and is refused with the rest.
fn is_scheme(s: &str) -> bool {
    let mut chars = s.chars();
    chars.next().is_some_and(|c| c.is_ascii_alphabetic())
        && chars.all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
}

/// Media type and payload of `[media type][;base64],payload` (RFC 2397).
fn decode_data(data: &str) -> Result<(Option<String>, Vec<u8>), String> {
    let (head, payload) = data.split_once(',').ok_or("the data URI has no comma")?;
    let media_type = head.split(';').next().filter(|m| m.contains('/')).map(str::to_owned);
    let plain: Vec<u8> = percent_decode_str(payload).collect();
    if !head.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64")) {
        return Ok((media_type, plain));
    }
    let bytes = BASE64.decode(plain.trim_ascii_end()).map_err(|e| format!("the data URI is not base64 ({e})"))?;
    Ok((media_type, bytes))
}

/// A URI in a message, cut when it is long.
fn shown(uri: &str) -> String {
    let head: String = uri.chars().take(80).collect();
    format!("{head:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_decode() {
        let folder = Path::new("");
        for uri in ["data:a/b;base64,AQID", "DATA:a/b;BASE64,AQID", "data:a/b,%01%02%03", "data:a/b;base64,AQI%44"] {
            let data = fetch(folder, uri).ok().unwrap();
            assert_eq!((data.bytes.as_slice(), data.media_type.as_deref()), (&[1, 2, 3][..], Some("a/b")), "{uri}");
        }
        assert_eq!(fetch(folder, "data:;base64,AQI").ok().unwrap().bytes, [1, 2]);
        assert!(fetch(folder, "data:;base64,A*ID").is_err());
        assert!(fetch(folder, "data:base64").is_err());
    }

    #[test]
    fn paths_stay_near_the_scene() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a b%20.bin"), b"x").unwrap();
        assert_eq!(fetch(dir.path(), "a%20b%2520.bin").ok().unwrap().bytes, b"x");
        assert_eq!(fetch(dir.path(), "a b%20.bin").ok().unwrap().bytes, b"x");
        for uri in ["/etc/hosts", "../../../x", "a/../../../../x", "https://x/y", "file:///etc/hosts", "c:/x", "", "."]
        {
            assert!(fetch(dir.path(), uri).is_err(), "{uri}");
        }
    }

    #[test]
    fn every_truncation_of_a_container_is_an_error() {
        let whole = super::super::glb_bytes(b"{\"a\":1} ".to_vec(), &[1, 2, 3, 4]).ok().unwrap();
        let parsed = Container::parse(&whole).ok().unwrap();
        assert_eq!((parsed.json.as_slice(), parsed.bin.as_deref()), (&b"{\"a\":1}"[..], Some(&[1, 2, 3, 4][..])));
        for n in 4..whole.len() {
            assert!(Container::parse(&whole[..n]).is_err(), "{n}");
        }
    }
}
