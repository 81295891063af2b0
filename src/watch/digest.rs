//! The digest of a file, on as many threads as help: a bake that is running must hear within 100 ms that its files are
//! others, and it has all cores at the time.
//!
//! BLAKE3 is a tree over chunks of 1 KiB, so parts of a power of two of them are digested apart and merged (BLAKE3
//! specification, §2.1). Files are read and not mapped into memory: one that is cut while it is mapped ends the process.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use blake3::Hasher;

/// What is read at once [bytes]; a power of two.
const PART: u64 = 1 << 20;

/// BLAKE3 of the file of so many bytes.
///
/// # Errors
/// It cannot be read; [`ErrorKind::Interrupted`] soon after `stop`.
pub fn digest(path: &Path, length: u64, stop: &AtomicBool) -> io::Result<[u8; 32]> {
    let file = File::open(path)?;
    #[cfg(unix)]
    if length > parts::LARGE {
        match parts::digest(&file, length, stop) {
            // It has become shorter, which reading from one end to the other does not mind.
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {}
            done => return done,
        }
    }
    one_by_one(file, length, stop)
}

fn one_by_one(mut file: File, length: u64, stop: &AtomicBool) -> io::Result<[u8; 32]> {
    let mut hasher = Hasher::new();
    let mut buffer = vec![0; length.clamp(1, PART) as usize];
    loop {
        check(stop)?;
        match file.read(&mut buffer) {
            Ok(0) => return Ok(*hasher.finalize().as_bytes()),
            Ok(count) => drop(hasher.update(&buffer[..count])),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

fn check(stop: &AtomicBool) -> io::Result<()> {
    if stop.load(Ordering::Relaxed) { Err(ErrorKind::Interrupted.into()) } else { Ok(()) }
}

#[cfg(unix)]
mod parts {
    use super::*;
    use blake3::hazmat::{ChainingValue, HasherExt, Mode, merge_subtrees_non_root, merge_subtrees_root};
    use std::os::unix::fs::FileExt;
    use std::sync::atomic::AtomicU64;
    use std::thread;

    /// Files up to this length [bytes], more than one part, are not worth further threads.
    pub const LARGE: u64 = 4 << 20;

    /// Threads at least, so that a bake on all cores does not get nearly all of the time, and at most.
    const THREADS: std::ops::RangeInclusive<usize> = 4..=16;

    type Values = Vec<(u64, ChainingValue)>;

    /// Of a file of more than one part.
    pub fn digest(file: &File, length: u64, stop: &AtomicBool) -> io::Result<[u8; 32]> {
        let next = AtomicU64::new(0);
        let work = || some(file, length, &next, stop);
        let threads = thread::available_parallelism().map_or(1, usize::from).clamp(*THREADS.start(), *THREADS.end());
        let mut values = thread::scope(|scope| {
            // Whatever others there are, this thread does what is left.
            let spawn = |_| thread::Builder::new().name("luxel digest".into()).spawn_scoped(scope, work).ok();
            let others: Vec<_> = (1..threads).filter_map(spawn).collect();
            let own = work();
            let joined = others.into_iter().map(|other| other.join().unwrap_or_else(|_| Err(ErrorKind::Other.into())));
            joined.chain([own]).collect::<io::Result<Vec<Values>>>().map(|lists| lists.concat())
        })?;
        values.sort_by_key(|(part, _)| *part);
        let values: Vec<ChainingValue> = values.into_iter().map(|(_, value)| value).collect();
        let (left, right) = halves(&values);
        Ok(*merge_subtrees_root(&merged(left), &merged(right), Mode::Hash).as_bytes())
    }

    /// The values of parts that nobody else has taken.
    fn some(file: &File, length: u64, next: &AtomicU64, stop: &AtomicBool) -> io::Result<Values> {
        let (mut values, mut buffer) = (Values::new(), vec![0; PART as usize]);
        loop {
            let part = next.fetch_add(1, Ordering::Relaxed);
            let start = part * PART;
            if start >= length {
                return Ok(values);
            }
            check(stop)?;
            let bytes = &mut buffer[..(length - start).min(PART) as usize];
            file.read_exact_at(bytes, start)?;
            values.push((part, Hasher::new().set_input_offset(start).update(bytes).finalize_non_root()));
        }
    }

    /// The left half holds the most parts, a power of two, that leave something to the right one.
    fn halves(values: &[ChainingValue]) -> (&[ChainingValue], &[ChainingValue]) {
        values.split_at(values.len().next_power_of_two() / 2)
    }

    /// Of one part or more. As deep as the logarithm of their number.
    fn merged(values: &[ChainingValue]) -> ChainingValue {
        match values {
            [one] => *one,
            many => {
                let (left, right) = halves(many);
                merge_subtrees_non_root(&merged(left), &merged(right), Mode::Hash)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_make_the_digest_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let bytes: Vec<u8> = (0..9 * PART as u32 + 5).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        for parts in [0, 1, 4, 5, 7, 8, 9] {
            for more in [0, 1, 5] {
                let bytes = &bytes[..parts * PART as usize + more];
                std::fs::write(&path, bytes).unwrap();
                let found = digest(&path, bytes.len() as u64, &AtomicBool::new(false)).unwrap();
                assert_eq!(found, *blake3::hash(bytes).as_bytes(), "{parts} parts and {more} bytes");
            }
        }
        // One that was cut meanwhile is what it is now; and who ends the watch does not wait.
        std::fs::write(&path, b"cut").unwrap();
        let cut = digest(&path, 9 * PART, &AtomicBool::new(false)).unwrap();
        assert_eq!(cut, *blake3::hash(b"cut").as_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let stopped = digest(&path, bytes.len() as u64, &AtomicBool::new(true)).unwrap_err();
        assert_eq!(stopped.kind(), ErrorKind::Interrupted);
    }
}
