//! Directions that follow each other through the slices.
//!
//! All directions add to the same sums, and in floating point the order of addition matters. So each part of the sums
//! knows whose turn it is: direction k adds to a part after direction k − 1 has done so, and threads sweep several
//! directions at once, one behind the other. The sums do not depend on the number of threads, and more threads need no
//! sums of their own.

use std::{
    ops::Range,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering},
    },
    time::Duration,
};

use luxel_scene::Cancelled;

/// Looks at a part, some 20 µs, before a thread takes it that the one it waits for is not running, and naps. (Giving way
/// without a nap costs it a whole turn of the processor each time: with other work on all cores, seven times as slow.)
const LOOKS: u32 = 1000;
const NAP: Duration = Duration::from_micros(20);

/// Sums that directions add to in their order.
pub struct Turns<'a, S> {
    parts: Vec<Part<'a, S>>,
    /// The direction that is taken next.
    next: AtomicUsize,
    /// Somebody has given up: nobody must wait for him.
    broken: AtomicBool,
}

struct Part<'a, S> {
    /// The direction whose turn it is.
    turn: AtomicU32,
    /// Never contended: a thread locks it when it is its turn.
    sums: Mutex<&'a mut [S]>,
}

impl<'a, S> Turns<'a, S> {
    /// Parts of the given ranges, which follow each other.
    pub fn new(mut sums: &'a mut [S], parts: impl Iterator<Item = Range<usize>>) -> Self {
        let part = |range: Range<usize>| {
            let (mine, rest) = std::mem::take(&mut sums).split_at_mut(range.len());
            sums = rest;
            Part { turn: AtomicU32::new(0), sums: Mutex::new(mine) }
        };
        Self { parts: parts.map(part).collect(), next: AtomicUsize::new(0), broken: AtomicBool::new(false) }
    }

    /// Takes directions one after the other and hands them to `sweep`, until all are taken. Whoever takes a direction
    /// has to go through all parts and must not wait for anything but its turn.
    ///
    /// # Errors
    /// When a sweep fails, here or on another thread.
    pub fn take(
        &self,
        directions: usize,
        mut sweep: impl FnMut(Direction<'_, 'a, S>) -> Result<(), Cancelled>,
    ) -> Result<(), Cancelled> {
        // Also when a sweep panics.
        let broken = Broken(&self.broken);
        loop {
            let k = self.next.fetch_add(1, Ordering::Relaxed);
            if k >= directions {
                break;
            }
            sweep(Direction { turns: self, number: k })?;
        }
        std::mem::forget(broken);
        Ok(())
    }
}

/// A direction that somebody has taken.
pub struct Direction<'t, 'a, S> {
    turns: &'t Turns<'a, S>,
    pub number: usize,
}

impl<S> Direction<'_, '_, S> {
    /// Adds to a part, when it is this direction's turn.
    ///
    /// # Errors
    /// When another thread has failed: the turn would never come.
    pub fn add(&self, part: usize, add: impl FnOnce(&mut [S])) -> Result<(), Cancelled> {
        let part = &self.turns.parts[part];
        let mut looks = 0;
        while part.turn.load(Ordering::Acquire) as usize != self.number {
            if self.turns.broken.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            looks += 1;
            if looks < LOOKS {
                std::hint::spin_loop();
            } else {
                std::thread::sleep(NAP);
            }
        }
        add(&mut part.sums.lock().unwrap_or_else(PoisonError::into_inner));
        part.turn.fetch_add(1, Ordering::Release);
        Ok(())
    }
}

/// Tells all others that this thread will not go on.
struct Broken<'a>(&'a AtomicBool);

impl Drop for Broken<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: usize = 7;
    const DIRECTIONS: usize = 50;

    /// Directions write their numbers into the parts, on several threads, until one of them fails.
    fn write(threads: usize, fails: impl Fn(usize, usize) -> bool + Sync) -> Vec<Vec<usize>> {
        let mut sums = vec![Vec::new(); PARTS];
        let turns = Turns::new(&mut sums, (0..PARTS).map(|i| i..i + 1));
        let sweep = |direction: Direction<Vec<usize>>| {
            (0..PARTS).try_for_each(|part| {
                let k = direction.number;
                if fails(k, part) { Err(Cancelled) } else { direction.add(part, |sums| sums[0].push(k)) }
            })
        };
        std::thread::scope(|scope| {
            (0..threads).for_each(|_| {
                scope.spawn(|| turns.take(DIRECTIONS, sweep));
            });
        });
        sums
    }

    #[test]
    fn every_part_sees_the_directions_in_their_order() {
        for threads in [1, 2, 5] {
            assert_eq!(write(threads, |_, _| false), vec![(0..DIRECTIONS).collect::<Vec<_>>(); PARTS]);
        }
    }

    #[test]
    fn nobody_waits_for_a_direction_that_failed() {
        for threads in [1, 2, 5] {
            let sums = write(threads, |k, part| (k, part) == (20, 3));
            assert_eq!(sums[0][..20], (0..20).collect::<Vec<_>>());
            assert_eq!(sums[PARTS - 1], (0..20).collect::<Vec<_>>());
        }
    }
}
