//! How long work tells how far it is, and learns that it is no longer wanted.

/// The work was cancelled from outside; nothing was decided, nothing was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

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
