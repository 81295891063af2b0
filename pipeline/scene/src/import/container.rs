//! The two containers of glTF 2.0: a JSON file, or a binary file with a JSON and a BIN chunk (§4, GLB).

use std::path::Path;

use super::error::{Checked, Fault, FaultKind};
use super::files::Files;
use super::options::Limits;

const MAGIC: &[u8; 4] = b"glTF";
const CHUNK_JSON: u32 = u32::from_le_bytes(*b"JSON");
const CHUNK_BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// A scene file taken apart.
#[derive(Debug, PartialEq, Eq)]
pub struct Container {
    /// The JSON text, without byte-order mark and padding.
    pub json: Vec<u8>,
    /// The GLB's BIN chunk, which is buffer 0 when that has no URI.
    pub bin: Option<Vec<u8>>,
}

impl Container {
    /// Splits the bytes of a .gltf or .glb file, told apart by their content.
    pub fn parse(bytes: Vec<u8>) -> Checked<Self> {
        if bytes.starts_with(MAGIC) {
            return Self::parse_binary(bytes);
        }
        let json = trimmed(&bytes);
        if json.first() != Some(&b'{') {
            let what = "it is neither glTF JSON nor a binary glTF file";
            return Err(Fault::new(FaultKind::Invalid, "", what, "give a .gltf or .glb file"));
        }
        Ok(Self { json: json.to_vec(), bin: None })
    }

    fn parse_binary(bytes: Vec<u8>) -> Checked<Self> {
        let cut = |what: &str| {
            let hint = "the file looks truncated; copy or export it again";
            Fault::new(FaultKind::Invalid, "GLB container", what, hint)
        };
        let version = word(&bytes, 4).ok_or_else(|| cut("the header is cut short"))?;
        if version != 2 {
            let hint = "export the scene as glTF 2.0";
            return Err(Fault::unsupported("GLB container", format!("its version is {version}, not 2"), hint));
        }
        let total = word(&bytes, 8).ok_or_else(|| cut("the header is cut short"))? as usize;
        if total > bytes.len() {
            return Err(cut(&format!("the header promises {total} bytes, the file has {}", bytes.len())));
        }
        let (mut json, mut bin) = (None, None);
        let mut at = 12;
        // Chunks after the second belong to extensions and are skipped, as the specification asks.
        while at < total && bin.is_none() {
            let length = word(&bytes[..total], at).ok_or_else(|| cut("a chunk header is cut short"))? as usize;
            let kind = word(&bytes[..total], at + 4).ok_or_else(|| cut("a chunk header is cut short"))?;
            let start = at + 8;
            let end = start.checked_add(length).filter(|&end| end <= total);
            let end = end.ok_or_else(|| cut(&format!("a chunk of {length} bytes does not fit into the file")))?;
            match kind {
                CHUNK_JSON if json.is_none() => json = Some(trimmed(&bytes[start..end]).to_vec()),
                CHUNK_BIN if json.is_some() => bin = Some(start..end),
                _ if json.is_none() => return Err(Fault::invalid("GLB container", "the first chunk is not JSON")),
                _ => {}
            }
            at = end;
        }
        let json = json.ok_or_else(|| cut("it has no JSON chunk"))?;
        Ok(Self { json, bin: bin.map(|range| slice_in_place(bytes, range)) })
    }
}

/// The JSON text of the file at `path`, without byte-order mark and padding; of a .glb nothing behind its JSON chunk is
/// read.
pub fn json_of(files: &mut Files, path: &Path, limits: &Limits) -> Checked<Vec<u8>> {
    const HEAD: u64 = 20;
    let head = files.read_front(path, "", HEAD)?;
    let length = word(&head, 12).map(u64::from).filter(|n| *n <= limits.json_bytes);
    if head.starts_with(MAGIC)
        && word(&head, 4) == Some(2)
        && word(&head, 16) == Some(CHUNK_JSON)
        && let Some(length) = length
    {
        let front = files.read_front(path, "", HEAD + length)?;
        if front.len() as u64 == HEAD + length {
            return Ok(trimmed(&front[HEAD as usize..]).to_vec());
        }
    }
    // JSON as such, or a file with a fault that has to be told.
    Ok(Container::parse(files.read(path, "")?)?.json)
}

/// The part of a vector, without a second allocation: scenes of many gigabytes should not double.
fn slice_in_place(mut bytes: Vec<u8>, range: std::ops::Range<usize>) -> Vec<u8> {
    bytes.truncate(range.end);
    bytes.drain(..range.start);
    bytes
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let bytes = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}

/// Without a byte-order mark in front, and blanks or zeros (both are used as padding) behind.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let blank = |b: &u8| b.is_ascii_whitespace();
    let start = bytes.iter().position(|b| !blank(b)).unwrap_or(bytes.len());
    let end = bytes.iter().rposition(|b| !blank(b) && *b != 0).map_or(start, |i| i + 1);
    &bytes[start..end.max(start)]
}

#[cfg(test)]
#[path = "../../tests/support/glb.rs"]
pub mod writer;

#[cfg(test)]
mod tests {
    use super::writer::glb;
    use super::*;

    #[test]
    fn both_containers_are_read() {
        let file = Container::parse(glb("{\"a\":1}", &[1, 2, 3, 4])).unwrap();
        assert_eq!((file.json.as_slice(), file.bin.as_deref()), (&b"{\"a\":1}"[..], Some(&[1, 2, 3, 4][..])));
        let file = Container::parse(b"\xef\xbb\xbf {} \n".to_vec()).unwrap();
        assert_eq!((file.json.as_slice(), file.bin), (&b"{}"[..], None));
    }

    #[test]
    fn every_truncation_is_an_error() {
        let whole = glb("{\"a\":1}", &[1, 2, 3, 4]);
        for n in 0..whole.len() {
            assert!(Container::parse(whole[..n].to_vec()).is_err(), "{n}");
        }
    }

    #[test]
    fn lengths_are_not_believed() {
        let mut file = glb("{}", &[0; 8]);
        file[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(Container::parse(file).unwrap_err().what.contains("does not fit"));
        let mut file = glb("{}", &[0; 8]);
        file[4] = 1;
        assert_eq!(Container::parse(file).unwrap_err().kind, FaultKind::Unsupported);
        assert!(Container::parse(b"PK\x03\x04".to_vec()).is_err());
        assert!(Container::parse(Vec::new()).is_err());
    }
}
