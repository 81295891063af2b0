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
//!
//! Bodies may be large, so they are never in memory as bytes: the writer hashes what passes through and puts the header
//! in front afterwards; the reader lets a decoder see bytes that are *not verified yet*, and gives out what it made only
//! when the checksum of all of them fits. Decoders bound what they allocate by [`Reader::left`].

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::Path;

const HEADER: usize = 8 + 4 + 32 + 8 + 32;

/// Bytes in hand between file and content.
const BUFFER: usize = 1 << 16;

/// Begin and end of the names of files that are being written, or were when their writer was killed.
pub const TEMPORARY: (&str, &str) = (".luxel-", ".tmp");

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
    Unreadable(io::Error),
    #[error("{0} lies in its place")]
    NoFile(&'static str),
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
    /// The bytes are those that were written, but do not decode.
    #[error("{0}")]
    Content(String),
}

/// A file whose bytes are hashed on their way, below the buffer: bodies are read and written in small pieces, and
/// hashing is fast in large ones.
struct Hashed<F> {
    file: F,
    hasher: blake3::Hasher,
    length: u64,
    /// Longest body that is written [bytes].
    limit: u64,
}

impl<F> Hashed<F> {
    fn new(file: F, limit: u64) -> Self {
        Self { file, hasher: blake3::Hasher::new(), length: 0, limit }
    }

    fn pass(&mut self, bytes: &[u8]) {
        self.hasher.update(bytes);
        self.length += bytes.len() as u64;
    }
}

impl Write for Hashed<&mut File> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.length.saturating_add(bytes.len() as u64) > self.limit {
            return Err(io::Error::other(format!("it takes more than the {} bytes that luxel reads", self.limit)));
        }
        let count = self.file.write(bytes)?;
        self.pass(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Read for Hashed<File> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(bytes)?;
        self.pass(&bytes[..count]);
        Ok(count)
    }
}

/// The body of a file that is being written.
pub struct Writer<'a>(BufWriter<Hashed<&'a mut File>>);

impl Write for Writer<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Writes what `fill` makes under `key`, whole or not at all; returns its length [bytes].
///
/// The file is flushed to the disk before it is renamed. The folder is not: a name that a power cut takes back costs
/// reuse alone, and flushing it would double the time that a small file takes.
pub fn write(
    path: &Path,
    format: Format,
    key: &Key,
    fill: impl FnOnce(&mut Writer) -> io::Result<()>,
) -> io::Result<u64> {
    // Before anything is made for it in vain.
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY.0).suffix(TEMPORARY.1);
    // A temporary file is private by default; others may share a store, as far as the umask says.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    let length = write_to(file.as_file_mut(), format, key, fill)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|e| e.error)?;
    Ok(length)
}

fn write_to(
    file: &mut File,
    format: Format,
    key: &Key,
    fill: impl FnOnce(&mut Writer) -> io::Result<()>,
) -> io::Result<u64> {
    file.write_all(&[0; HEADER])?;
    let mut body = Writer(BufWriter::with_capacity(BUFFER, Hashed::new(file, format.limit)));
    fill(&mut body)?;
    let Hashed { file, hasher, length, .. } = body.0.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.rewind()?;
    file.write_all(&header(format, key, length, &hasher.finalize()))?;
    Ok(length)
}

/// The body of a file that is being read. Its bytes are not verified yet.
pub struct Reader {
    file: BufReader<Hashed<File>>,
    left: u64,
}

impl Reader {
    /// Bytes that follow.
    pub fn left(&self) -> u64 {
        self.left
    }
}

impl Read for Reader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let most = bytes.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let count = self.file.read(&mut bytes[..most])?;
        self.left -= count as u64;
        Ok(count)
    }
}

/// What `decode` makes of the body stored under `key`, verified. A decoder reads the body to its end.
pub fn read<T>(
    path: &Path,
    format: Format,
    key: &Key,
    decode: impl FnOnce(&mut Reader) -> Result<T, String>,
) -> Result<T, Miss> {
    let (file, stated, checksum) = open(path, format, key)?;
    let file = BufReader::with_capacity(BUFFER, Hashed::new(file, format.limit));
    let mut body = Reader { file, left: stated };
    let decoded = decode(&mut body);
    // Damage explains a content that does not decode, so the rest is hashed whatever became of it.
    let unread = io::copy(&mut body, &mut io::sink()).map_err(Miss::Unreadable)?;
    if body.left > 0 {
        return Err(Miss::Torn { stated, found: stated - body.left });
    }
    // What somebody appends meanwhile would pass the hasher too, and then it is damage.
    if *body.file.get_ref().hasher.finalize().as_bytes() != checksum {
        return Err(Miss::Damaged);
    }
    let decoded = decoded.map_err(Miss::Content)?;
    if unread > 0 {
        return Err(Miss::Content(format!("it holds {unread} bytes more than its content")));
    }
    Ok(decoded)
}

/// Whether a file is what it has to be, without decoding it; returns the length of its body [bytes].
pub fn verify(path: &Path, format: Format, key: &Key) -> Result<u64, Miss> {
    read(path, format, key, |body| io::copy(body, &mut io::sink()).map_err(|e| e.to_string()))
}

/// Opens a file at its body and checks the header; returns the length of the body and its checksum too.
fn open(path: &Path, format: Format, key: &Key) -> Result<(File, u64, [u8; 32]), Miss> {
    let missed = |e: io::Error| match e.kind() {
        // A file may lie where a folder of the path would.
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Miss::Absent,
        _ => Miss::Unreadable(e),
    };
    // Whoever opens a pipe waits for somebody at its other end.
    let meta = std::fs::metadata(path).map_err(missed)?;
    if !meta.is_file() {
        return Err(Miss::NoFile(if meta.is_dir() { "a folder" } else { "something that is no file" }));
    }
    let mut file = File::open(path).map_err(missed)?;
    let size = file.metadata().map_err(Miss::Unreadable)?.len();
    if size < HEADER as u64 {
        return Err(Miss::Torn { stated: HEADER as u64, found: size });
    }
    let (mut magic, mut version, mut stored_key) = ([0; 8], [0; 4], [0; 32]);
    let (mut length, mut checksum) = ([0; 8], [0; 32]);
    for part in [&mut magic[..], &mut version, &mut stored_key, &mut length, &mut checksum] {
        file.read_exact(part).map_err(Miss::Unreadable)?;
    }
    let (version, stated, found) = (u32::from_le_bytes(version), u64::from_le_bytes(length), size - HEADER as u64);
    if magic != format.magic {
        return Err(Miss::Foreign);
    }
    if version != format.version {
        return Err(Miss::Outdated { found: version, expected: format.version });
    }
    if stored_key != *key {
        return Err(Miss::OtherKey);
    }
    if stated != found {
        return Err(Miss::Torn { stated, found });
    }
    if stated > format.limit {
        return Err(Miss::TooLarge(stated));
    }
    Ok((file, stated, checksum))
}

fn header(format: Format, key: &Key, length: u64, checksum: &blake3::Hash) -> Vec<u8> {
    let mut head = Vec::with_capacity(HEADER);
    head.extend(format.magic);
    head.extend(format.version.to_le_bytes());
    head.extend(key);
    head.extend(length.to_le_bytes());
    head.extend(checksum.as_bytes());
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = [7; 32];
    const BODY: &[u8] = b"irradiance at every surfel";

    fn put(path: &Path, format: Format, body: &[u8]) -> io::Result<u64> {
        write(path, format, &KEY, |out| out.write_all(body))
    }

    fn get(path: &Path, format: Format, key: &Key) -> Result<Vec<u8>, Miss> {
        read(path, format, key, |body| {
            let mut bytes = Vec::new();
            body.read_to_end(&mut bytes).map_err(|e| e.to_string())?;
            Ok(bytes)
        })
    }

    fn stored() -> (tempfile::TempDir, std::path::PathBuf, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper/cache");
        put(&path, OCTREE, BODY).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        (folder, path, bytes)
    }

    #[test]
    fn what_was_written_is_read() {
        let (_folder, path, bytes) = stored();
        assert_eq!(get(&path, OCTREE, &KEY).unwrap(), BODY);
        assert_eq!(bytes.len(), HEADER + BODY.len());
        assert_eq!(put(&path, OCTREE, b"").unwrap(), 0);
        assert_eq!(get(&path, OCTREE, &KEY).unwrap(), b"");
        // In pieces of any size, beyond every buffer.
        let long: Vec<u8> = (0..5 * BUFFER + 3).map(|i| (i % 251) as u8).collect();
        write(&path, OCTREE, &KEY, |out| long.chunks(777).try_for_each(|part| out.write_all(part))).unwrap();
        assert_eq!(get(&path, OCTREE, &KEY).unwrap(), long);
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
                let miss = get(&path, OCTREE, &KEY).unwrap_err();
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
            assert!(matches!(get(&path, OCTREE, &KEY), Err(Miss::Torn { .. })), "cut to {length}");
        }
        std::fs::write(&path, [&bytes[..], b"x"].concat()).unwrap();
        assert!(matches!(get(&path, OCTREE, &KEY), Err(Miss::Torn { .. })));
    }

    #[test]
    fn an_absent_a_foreign_and_an_oversized_file_are_told_apart() {
        let (folder, path, _) = stored();
        assert!(matches!(get(&folder.path().join("none"), OCTREE, &KEY), Err(Miss::Absent)));
        assert!(matches!(get(&path, OCTREE, &[8; 32]), Err(Miss::OtherKey)));
        let small = Format { limit: 3, ..OCTREE };
        assert!(matches!(get(&path, small, &KEY), Err(Miss::TooLarge(_))));
        assert!(matches!(get(folder.path(), OCTREE, &KEY), Err(Miss::NoFile("a folder"))));
    }

    #[test]
    fn what_does_not_decode_is_told_apart_from_what_is_damaged() {
        let (_folder, path, mut bytes) = stored();
        let refuse = |body: &mut Reader| -> Result<(), String> {
            assert_eq!(body.left(), BODY.len() as u64);
            body.read_exact(&mut [0; 3]).unwrap();
            assert_eq!(body.left(), BODY.len() as u64 - 3);
            Err("no octree".into())
        };
        assert!(matches!(read(&path, OCTREE, &KEY, refuse), Err(Miss::Content(why)) if why == "no octree"));
        let satisfied = |body: &mut Reader| body.read_exact(&mut [0; 3]).map_err(|e| e.to_string());
        let rest = BODY.len() - 3;
        assert!(
            matches!(read(&path, OCTREE, &KEY, satisfied), Err(Miss::Content(why)) if why.contains(&rest.to_string()))
        );
        // A decoder that believed what it saw is not believed.
        if let Some(last) = bytes.last_mut() {
            *last ^= 1;
        }
        std::fs::write(&path, &bytes).unwrap();
        assert!(matches!(read(&path, OCTREE, &KEY, refuse), Err(Miss::Damaged)));
        assert!(matches!(read(&path, OCTREE, &KEY, satisfied), Err(Miss::Damaged)));
    }

    #[test]
    fn what_would_not_be_read_is_not_written_and_an_error_leaves_the_old_file() {
        let (_folder, path, bytes) = stored();
        let small = Format { limit: BODY.len() as u64 - 1, ..OCTREE };
        assert!(put(&path, small, BODY).unwrap_err().to_string().contains("more than"));
        let failed = write(&path, OCTREE, &KEY, |out| {
            out.write_all(BODY)?;
            Err(io::Error::other("out of luck"))
        });
        assert!(failed.unwrap_err().to_string().contains("out of luck"));
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }
}
