//! Files that prove what they are before anything in them is believed.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | magic `luxel` and what the file holds |
//! | 4 | format version, little endian |
//! | 32 | key: BLAKE3 of everything that the content follows from |
//! | 8 | length of the body, little endian |
//! | 32 | BLAKE3 of the body |
//! | … | body |
//!
//! A file is written whole under another name and then renamed, so that a reader sees the old one or the new one.
//! Whatever does not verify is a [`Miss`] with its reason: the caller tells it and makes the content anew.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use luxel_export::ExportError;

const HEADER: usize = 8 + 4 + 32 + 8 + 32;

/// Identity of what a stored file follows from.
pub type Key = [u8; 32];

/// What a stored file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    /// `luxel` and three letters of its own.
    pub magic: [u8; 8],
    /// Raised whenever the meaning of the body changes.
    pub version: u32,
    /// Longest body that is read [bytes].
    pub limit: u64,
}

/// The octree irradiance cache, behind the record of how it came about.
pub const OCTREE: Format = Format { magic: *b"luxelOct", version: 3, limit: 8 << 30 };

/// Why a stored file is of no use.
#[derive(Debug, thiserror::Error)]
pub enum Miss {
    #[error("there is none yet")]
    Absent,
    #[error("it cannot be read: {0}")]
    Unreadable(std::io::Error),
    #[error("it is no luxel file of this kind")]
    Foreign,
    #[error("it has format version {found}, this luxel writes {expected}")]
    Outdated { found: u32, expected: u32 },
    #[error("it belongs to other input or settings")]
    OtherKey,
    #[error("it is torn: {found} bytes of content where {stated} are stated")]
    Torn { stated: u64, found: u64 },
    #[error("it holds {0} bytes, more than this luxel reads")]
    TooLarge(u64),
    #[error("its content does not match its checksum")]
    Damaged,
}

/// Writes `body` under `key`, whole or not at all.
pub fn write(path: &Path, format: Format, key: &Key, body: &[u8]) -> std::io::Result<()> {
    luxel_export::write_atomic_parts(path, &[&header(format, key, body), body]).map_err(|error| match error {
        ExportError::Io { cause, .. } => cause,
        error => std::io::Error::other(error),
    })
}

/// The body stored under `key`, verified.
pub fn read(path: &Path, format: Format, key: &Key) -> Result<Vec<u8>, Miss> {
    let mut file = File::open(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Miss::Absent,
        _ => Miss::Unreadable(e),
    })?;
    let size = file.metadata().map_err(Miss::Unreadable)?.len();
    let found = size.saturating_sub(HEADER as u64);
    let mut head = [0u8; HEADER];
    if size < HEADER as u64 {
        return Err(Miss::Torn { stated: HEADER as u64, found: size });
    }
    file.read_exact(&mut head).map_err(Miss::Unreadable)?;
    let (magic, rest) = head.split_at(8);
    let (version, rest) = rest.split_at(4);
    let (stored_key, rest) = rest.split_at(32);
    let (length, checksum) = rest.split_at(8);
    let version = version.iter().rev().fold(0, |n, b| n << 8 | u32::from(*b));
    let stated = length.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b));
    if magic != format.magic {
        return Err(Miss::Foreign);
    }
    if version != format.version {
        return Err(Miss::Outdated { found: version, expected: format.version });
    }
    if stored_key != key {
        return Err(Miss::OtherKey);
    }
    if stated != found {
        return Err(Miss::Torn { stated, found });
    }
    if stated > format.limit {
        return Err(Miss::TooLarge(stated));
    }
    let mut body = Vec::new();
    file.take(stated).read_to_end(&mut body).map_err(Miss::Unreadable)?;
    if blake3::hash(&body).as_bytes() != checksum {
        return Err(Miss::Damaged);
    }
    Ok(body)
}

fn header(format: Format, key: &Key, body: &[u8]) -> Vec<u8> {
    let mut head = Vec::with_capacity(HEADER);
    head.extend(format.magic);
    head.extend(format.version.to_le_bytes());
    head.extend(key);
    head.extend((body.len() as u64).to_le_bytes());
    head.extend(blake3::hash(body).as_bytes());
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = [7; 32];
    const BODY: &[u8] = b"irradiance at every surfel";

    fn stored() -> (tempfile::TempDir, std::path::PathBuf, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper/cache");
        write(&path, OCTREE, &KEY, BODY).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        (folder, path, bytes)
    }

    #[test]
    fn what_was_written_is_read() {
        let (_folder, path, bytes) = stored();
        assert_eq!(read(&path, OCTREE, &KEY).unwrap(), BODY);
        assert_eq!(bytes.len(), HEADER + BODY.len());
        write(&path, OCTREE, &KEY, b"").unwrap();
        assert_eq!(read(&path, OCTREE, &KEY).unwrap(), b"");
    }

    #[cfg(unix)]
    #[test]
    fn a_stored_file_is_as_readable_as_any_other() {
        use std::os::unix::fs::PermissionsExt;
        let (folder, path, _) = stored();
        let plain = folder.path().join("plain");
        std::fs::write(&plain, b"x").unwrap();
        let mode = |p: &Path| std::fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&plain));
    }

    #[test]
    fn every_flipped_byte_is_noticed() {
        let (_folder, path, bytes) = stored();
        for at in 0..bytes.len() {
            for flip in [1, 0x80, 0xff] {
                let mut broken = bytes.clone();
                broken[at] ^= flip;
                std::fs::write(&path, &broken).unwrap();
                let miss = read(&path, OCTREE, &KEY).unwrap_err();
                let fits = match at {
                    0..8 => matches!(miss, Miss::Foreign),
                    8..12 => matches!(miss, Miss::Outdated { .. }),
                    12..44 => matches!(miss, Miss::OtherKey),
                    44..52 => matches!(miss, Miss::Torn { .. }),
                    _ => matches!(miss, Miss::Damaged),
                };
                assert!(fits, "byte {at}: {miss}");
            }
        }
    }

    #[test]
    fn every_cut_is_noticed_and_so_is_a_longer_file() {
        let (_folder, path, bytes) = stored();
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(matches!(read(&path, OCTREE, &KEY), Err(Miss::Torn { .. })), "cut to {length}");
        }
        std::fs::write(&path, [&bytes[..], b"x"].concat()).unwrap();
        assert!(matches!(read(&path, OCTREE, &KEY), Err(Miss::Torn { .. })));
    }

    #[test]
    fn an_absent_a_foreign_and_an_oversized_file_are_told_apart() {
        let (folder, path, _) = stored();
        assert!(matches!(read(&folder.path().join("none"), OCTREE, &KEY), Err(Miss::Absent)));
        assert!(matches!(read(&path, OCTREE, &[8; 32]), Err(Miss::OtherKey)));
        let small = Format { limit: 3, ..OCTREE };
        assert!(matches!(read(&path, small, &KEY), Err(Miss::TooLarge(_))));
        assert!(read(folder.path(), OCTREE, &KEY).is_err());
    }
}
