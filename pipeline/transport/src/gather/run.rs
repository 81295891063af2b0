//! One function over all receivers, in parallel, each result in its own place.

use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{Gathered, Receiver};

/// Receivers that one thread takes at a time.
const CHUNK: usize = 64;

/// Receivers between two looks at the progress: a few milliseconds of the slowest mode.
const BREATH: usize = 8;

/// Applies `gather` to every receiver. Scratch memory belongs to the thread and never decides a value.
pub(super) fn each<S>(
    receivers: &[Receiver],
    progress: &dyn Progress,
    scratch: impl Fn() -> S + Sync + Send,
    gather: impl Fn(&mut S, &Receiver) -> Gathered + Sync + Send,
) -> Result<Vec<Gathered>, Cancelled> {
    let mut out = vec![Gathered::default(); receivers.len()];
    let chunks = receivers.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK));
    chunks.try_for_each_init(scratch, |scratch, (receivers, out)| {
        for (i, (receiver, out)) in receivers.iter().zip(out).enumerate() {
            if i.is_multiple_of(BREATH) {
                progress.check()?;
            }
            *out = gather(scratch, receiver);
            debug_assert!(out.irradiance.is_finite() && out.irradiance.min_element() >= 0.0);
        }
        progress.advance(receivers.len() as u64);
        Ok(())
    })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rgb;
    use glam::Vec3;
    use luxel_scene::Silent;
    use std::sync::atomic::{AtomicU64, Ordering};

    struct Counter(AtomicU64, bool);

    impl Progress for Counter {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, done: u64) {
            self.0.fetch_add(done, Ordering::Relaxed);
        }
        fn is_cancelled(&self) -> bool {
            self.1
        }
    }

    fn receivers(n: u64) -> Vec<Receiver> {
        let at =
            |seed| Receiver { position: Vec3::ZERO, normal: Vec3::Z, shading_normal: Vec3::Z, footprint: 1.0, seed };
        (0..n).map(at).collect()
    }

    fn echo(_: &mut (), r: &Receiver) -> Gathered {
        Gathered { irradiance: Rgb::splat(r.seed as f32), ..Gathered::default() }
    }

    #[test]
    fn results_keep_their_order_and_every_receiver_is_reported() {
        let counter = Counter(AtomicU64::new(0), false);
        let out = each(&receivers(1000), &counter, || (), echo).unwrap();
        assert!(out.iter().enumerate().all(|(i, g)| g.irradiance.x == i as f32));
        assert_eq!(counter.0.into_inner(), 1000);
        assert!(each(&[], &Silent, || (), echo).unwrap().is_empty());
    }

    #[test]
    fn cancelled_work_returns_nothing() {
        let counter = Counter(AtomicU64::new(0), true);
        assert!(each(&receivers(1000), &counter, || (), echo).is_err());
        assert_eq!(counter.0.into_inner(), 0);
    }
}
