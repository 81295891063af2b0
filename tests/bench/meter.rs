//! Clocks and scales: processor time of a thread and of the process, and bytes that are allocated at once.

use std::time::Instant;

use cpu_time::ThreadTime;

pub use crate::heap::{Counting, peak_bytes};

/// Processor seconds that the calling thread spends on the work.
pub fn thread_seconds(work: impl FnOnce()) -> f64 {
    let start = ThreadTime::now();
    work();
    start.elapsed().as_secs_f64()
}

/// Wall-clock seconds of the work.
pub fn wall_seconds(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64()
}

pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
