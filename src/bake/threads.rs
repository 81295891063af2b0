//! A pool of threads for every bake, and the boundary that a panic does not cross.

use std::panic::AssertUnwindSafe;

use crate::Error;
use crate::settings::Settings;

/// Runs `work` on as many threads as the settings say.
pub fn with_threads<T: Send>(settings: &Settings, work: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Error> {
    on_threads(settings.threads.0, work)
}

/// Runs `work` on a pool of its own, so that an embedding program keeps its threads.
pub fn on_threads<T: Send>(threads: u32, work: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Error> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build();
    let pool = pool.map_err(|source| Error::Threads { threads, source })?;
    guarded(|| pool.install(work))
}

/// The boundary of one scene: a panic within it, be it in a decoder that a file has upset, is that scene's error. What
/// `work` was about to make is lost; files are only ever replaced whole, so none is left half written.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    std::panic::catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().copied().or(panic.downcast_ref::<String>().map(String::as_str));
        Err(Error::Internal { what: text.unwrap_or("a panic without a message").into() })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::value::Threads;
    use rayon::prelude::*;

    #[test]
    fn a_panic_on_a_worker_thread_is_caught_too() {
        let settings = Settings { threads: Threads(2), ..Settings::default() };
        let all = || -> Result<Vec<u32>, Error> {
            Ok((0..1000u32).into_par_iter().map(|i| if i == 637 { panic!("number {i}") } else { i }).collect())
        };
        assert!(matches!(with_threads(&settings, all), Err(Error::Internal { what }) if what == "number 637"));
    }
}
