//! How long work tells how far it is, and learns that it is no longer wanted.
//!
//! Work that is stopped has to stop within 100 ms, so nothing goes on for longer than about half of that without a look
//! ([`Progress::check`]). Loops look once in [`EVERY`] items ([`watched`]), and what passes through somebody else's
//! encoder or decoder is looked at where bytes go in or out ([`Watched`]).

use std::io::{self, BufRead, Read, Seek, SeekFrom, Write};

/// Items of a cheap loop between two looks: about a millisecond.
pub const EVERY: usize = 4096;

/// Bytes between two looks.
const PIECE: usize = 1 << 16;

/// The work was cancelled from outside; nothing was decided, nothing was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

impl Cancelled {
    /// An error of input or output came from a [`Watched`] whose work was cancelled.
    pub fn caused(error: &io::Error) -> bool {
        error.get_ref().is_some_and(|inner| inner.is::<Self>())
    }
}

impl From<Cancelled> for io::Error {
    fn from(cancelled: Cancelled) -> Self {
        Self::other(cancelled)
    }
}

/// A stage's view of whoever is waiting. Rooms report through this and know neither terminal nor clock.
pub trait Progress: Sync {
    /// A stage begins; `total` is its amount of work in its own unit, 0 where nobody knows it beforehand.
    fn begin(&self, stage: &'static str, total: u64);
    /// `done` more units of the current stage are finished.
    fn advance(&self, done: u64);
    fn is_cancelled(&self) -> bool {
        false
    }
    /// `Err(Cancelled)` once the work is no longer wanted; called often enough to stop within 100 ms.
    fn check(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

/// Nobody is waiting.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
}

/// Passes on that the work is no longer wanted, and nothing else: for a second pass over what counts once.
pub struct Uncounted<'a>(pub &'a dyn Progress);

impl Progress for Uncounted<'_> {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
    }
}

/// Who waited has gone before the work began: for the tests of what may be cancelled.
pub struct Unwanted;

impl Progress for Unwanted {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        true
    }
}

/// The items of a loop that looks at the progress before the first, and before every [`EVERY`]th one after it.
pub fn watched<I: IntoIterator>(
    items: I,
    progress: &dyn Progress,
) -> impl Iterator<Item = Result<I::Item, Cancelled>> + use<'_, I> {
    items.into_iter().enumerate().map(move |(i, item)| {
        if i.is_multiple_of(EVERY) {
            progress.check()?;
        }
        Ok(item)
    })
}

/// Bytes on their way in or out, with a look at the progress at every piece of them. Once the work is cancelled nothing
/// passes any more: the error is one that [`Cancelled::caused`] knows.
pub struct Watched<'p, T> {
    inner: T,
    progress: &'p dyn Progress,
}

impl<'p, T> Watched<'p, T> {
    pub fn new(inner: T, progress: &'p dyn Progress) -> Self {
        Self { inner, progress }
    }
}

impl<T: Read> Read for Watched<'_, T> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.progress.check()?;
        let most = bytes.len().min(PIECE);
        self.inner.read(&mut bytes[..most])
    }
}

impl<T: BufRead> BufRead for Watched<'_, T> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.progress.check()?;
        let bytes = self.inner.fill_buf()?;
        Ok(&bytes[..bytes.len().min(PIECE)])
    }

    fn consume(&mut self, amount: usize) {
        self.inner.consume(amount);
    }
}

impl<T: Write> Write for Watched<'_, T> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.progress.check()?;
        self.inner.write(&bytes[..bytes.len().min(PIECE)])
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl<T: Seek> Seek for Watched<'_, T> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Cancelled at a look.
    struct Until(AtomicU64, u64);

    impl Progress for Until {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            self.0.fetch_add(1, Ordering::Relaxed) >= self.1
        }
    }

    fn until(look: u64) -> Until {
        Until(AtomicU64::new(0), look)
    }

    #[test]
    fn a_loop_looks_at_every_so_many_items() {
        let sum = |progress: &Until, n: usize| watched(0..n, progress).sum::<Result<usize, Cancelled>>();
        let never = until(u64::MAX);
        assert_eq!(sum(&never, 2 * EVERY + 1), Ok(EVERY * (2 * EVERY + 1)));
        assert_eq!(never.0.into_inner(), 3);
        assert_eq!(sum(&until(2), 2 * EVERY), Ok(EVERY * (2 * EVERY - 1)));
        assert_eq!(sum(&until(2), 2 * EVERY + 1), Err(Cancelled));
    }

    #[test]
    fn bytes_pass_unchanged_until_the_work_is_cancelled() {
        let bytes: Vec<u8> = (0..3 * PIECE + 7).map(|i| (i % 251) as u8).collect();
        let (mut read, mut written) = (Vec::new(), Vec::new());
        let never = until(u64::MAX);
        Watched::new(&bytes[..], &never).read_to_end(&mut read).unwrap();
        Watched::new(&mut written, &never).write_all(&bytes).unwrap();
        assert!(read == bytes && written == bytes);
        let mut buffered = Vec::new();
        io::copy(&mut Watched::new(&bytes[..], &never), &mut buffered).unwrap();
        assert_eq!(buffered, bytes);
        for look in 0..4 {
            let mut written = Vec::new();
            let error = Watched::new(&mut written, &until(look)).write_all(&bytes).unwrap_err();
            assert!(Cancelled::caused(&error) && written == bytes[..look as usize * PIECE], "{look}: {error}");
            let error = Watched::new(&bytes[..], &until(look)).read_to_end(&mut Vec::new()).unwrap_err();
            assert!(Cancelled::caused(&error), "{look}: {error}");
        }
        assert!(!Cancelled::caused(&io::Error::other("cancelled")));
    }
}
