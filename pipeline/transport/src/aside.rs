//! Work that nothing interrupts, done aside: a thread of its own does it, and is left to itself when the result is not
//! wanted any more. It then goes on to its end, and nobody sees what it made.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use luxel_scene::{Cancelled, Progress};

/// Between two looks at the progress while somebody else works.
const WAIT: Duration = Duration::from_millis(20);

/// The result of `work`, which runs aside where it `is_long` and here otherwise. Aside it has as many threads as here.
pub(crate) fn aside<T: Send + 'static>(
    is_long: bool,
    progress: &dyn Progress,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Cancelled> {
    progress.check()?;
    let pool = || rayon::ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build().ok();
    // Where no further thread can be had, it is done here.
    let Some(pool) = is_long.then(pool).flatten() else { return Ok(work()) };
    let (sender, receiver) = channel();
    pool.spawn(move || {
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        // After a cancellation there is nobody to send it to.
        drop(sender.send(result));
    });
    loop {
        match receiver.recv_timeout(WAIT) {
            Ok(Ok(result)) => return Ok(result),
            Ok(Err(panic)) => std::panic::resume_unwind(panic),
            Err(RecvTimeoutError::Timeout) => progress.check()?,
            Err(RecvTimeoutError::Disconnected) => unreachable!("a result is sent whatever happens"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;
    use std::sync::atomic::{AtomicBool, Ordering};

    struct Flag(AtomicBool);

    impl Progress for Flag {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            // From the second look on.
            self.0.swap(true, Ordering::Relaxed)
        }
    }

    #[test]
    fn the_result_is_the_same_here_and_aside() {
        for is_long in [false, true] {
            assert_eq!(aside(is_long, &Silent, || (0..1000).sum::<u64>()), Ok(499_500));
        }
    }

    #[test]
    fn what_is_not_wanted_is_not_waited_for() {
        let (release, wait) = channel::<()>();
        // The work ends when this test has.
        let result = aside(true, &Flag(AtomicBool::new(false)), move || wait.recv().is_ok());
        assert_eq!(result, Err(Cancelled));
        drop(release);
    }

    #[test]
    fn a_panic_comes_through() {
        let work = || aside(true, &Silent, || -> u32 { panic!("burst") });
        let panic = std::panic::catch_unwind(work).unwrap_err();
        assert_eq!(panic.downcast_ref::<&str>(), Some(&"burst"));
    }
}
