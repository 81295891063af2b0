//! Several bakes at a time: which may go on, and with how many threads.
//!
//! How much memory a bake takes is known once its scene is open. It then waits for its turn: bakes go on in the order in
//! which they asked, each as soon as the estimates of those that run, the files of those that wait, and its own fit
//! together into the memory that was free at the start. Where nothing runs, the next one always goes on: alone it fits,
//! or it is refused. It gets its share of the threads that are left, so that there are never more of them than
//! processors because of several scenes, and the last ones have all. A result has the same bytes whatever the number.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use luxel_export::report::Warning;
use luxel_scene::Progress;

use super::memory::Budget;
use crate::Error;
use crate::plan::Memory;

/// Between two looks whether a bake that waits is still wanted.
const LOOK: Duration = Duration::from_millis(20);

/// Where a bake stops between opening its scene and everything else.
pub trait Gate: Sync {
    /// Threads for opening the scene; 0 for one per processor.
    fn opening(&self) -> u32;
    /// Returns once the bake may go on. `needs` is the least memory that it takes.
    ///
    /// # Errors
    /// It does not fit into memory at all, or was cancelled while it waited.
    fn enter(&self, needs: &Memory, progress: &dyn Progress) -> Result<Leave, Error>;
}

/// The right to go on.
#[derive(Clone, Debug, PartialEq)]
pub struct Leave {
    /// Threads for the rest of the bake; 0 for one per processor.
    pub threads: u32,
    /// What the report should tell of memory.
    pub warning: Option<Warning>,
}

/// The gate of a bake that runs alone, on so many threads.
pub struct Alone(pub u32);

impl Gate for Alone {
    fn opening(&self) -> u32 {
        self.0
    }

    fn enter(&self, needs: &Memory, _: &dyn Progress) -> Result<Leave, Error> {
        Ok(Leave { threads: self.0, warning: Budget::now().check(needs)? })
    }
}

/// The turns of several bakes.
pub struct Turns {
    budget: Budget,
    threads: u32,
    state: Mutex<State>,
    changed: Condvar,
}

/// A bake that runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Load {
    number: usize,
    bytes: u64,
    threads: u32,
}

/// A bake whose scene is open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Wish {
    number: usize,
    bytes: u64,
    /// What it holds while it waits.
    held: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct State {
    /// Bakes at a time, at most.
    jobs: usize,
    /// Bytes that all of them may take together; none where nobody tells.
    room: Option<u64>,
    running: Vec<Load>,
    /// In the order in which they asked.
    waiting: Vec<Wish>,
    /// Bakes that have not asked yet.
    coming: usize,
}

impl State {
    /// Whether a bake may run beside those that run; the others that wait keep what they hold.
    fn has_room(&self, wish: &Wish, running: &[Load]) -> bool {
        let taken = running.iter().map(|load| load.bytes);
        let held = self.waiting.iter().filter(|w| w.number != wish.number).map(|w| w.held);
        let all = taken.chain(held).fold(wish.bytes, u64::saturating_add);
        running.len() < self.jobs && self.room.is_none_or(|room| all <= room)
    }

    /// Whether it is the turn of a bake.
    fn may_run(&self, wish: &Wish) -> bool {
        let is_first = self.waiting.first().is_some_and(|w| w.number == wish.number);
        is_first && (self.running.is_empty() || self.has_room(wish, &self.running))
    }

    /// Its threads: an even share with those that may yet run beside it.
    fn share(&self, wish: &Wish, threads: u32) -> u32 {
        let used: u32 = self.running.iter().map(|load| load.threads).sum();
        let mut with_it = self.running.clone();
        with_it.push(Load { number: wish.number, bytes: wish.bytes, threads: 0 });
        let others = self.waiting.iter().filter(|w| w.number != wish.number);
        let beside = self.coming + others.filter(|w| self.has_room(w, &with_it)).count();
        let places = self.jobs.saturating_sub(with_it.len());
        let parts = u32::try_from(1 + beside.min(places)).unwrap_or(u32::MAX);
        (threads.saturating_sub(used) / parts).max(1)
    }
}

impl Turns {
    /// For so many bakes, at most `jobs` of them at a time, on so many threads together.
    pub fn new(bakes: usize, jobs: usize, threads: u32) -> Self {
        let budget = Budget::now();
        let state = State { jobs: jobs.max(1), room: budget.at_ease(), coming: bakes, ..State::default() };
        Self { budget, threads: threads.max(1), state: Mutex::new(state), changed: Condvar::new() }
    }

    /// The turn of a bake, by its number; `most` are the threads that its settings allow it, 0 for any number.
    pub fn turn(&self, number: usize, most: u32) -> Turn<'_> {
        Turn { turns: self, number, most }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A bake's place among the others; it is given back when this is dropped.
pub struct Turn<'t> {
    turns: &'t Turns,
    number: usize,
    most: u32,
}

impl Turn<'_> {
    fn at_most(&self, threads: u32) -> u32 {
        if self.most > 0 { threads.min(self.most) } else { threads }
    }
}

impl Gate for Turn<'_> {
    fn opening(&self) -> u32 {
        let jobs = u32::try_from(self.turns.lock().jobs).unwrap_or(u32::MAX);
        self.at_most((self.turns.threads / jobs).max(1))
    }

    fn enter(&self, needs: &Memory, progress: &dyn Progress) -> Result<Leave, Error> {
        let warning = self.turns.budget.check(needs)?;
        let wish = Wish { number: self.number, bytes: needs.total(), held: needs.files };
        let mut state = self.turns.lock();
        state.coming = state.coming.saturating_sub(1);
        state.waiting.push(wish);
        self.turns.changed.notify_all();
        while !state.may_run(&wish) {
            progress.check()?;
            let waited = self.turns.changed.wait_timeout(state, LOOK);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let threads = self.at_most(state.share(&wish, self.turns.threads));
        state.waiting.retain(|w| w.number != self.number);
        state.running.push(Load { number: self.number, bytes: wish.bytes, threads });
        self.turns.changed.notify_all();
        Ok(Leave { threads, warning })
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        let mut state = self.turns.lock();
        let known = state.running.len() + state.waiting.len();
        state.running.retain(|load| load.number != self.number);
        state.waiting.retain(|wish| wish.number != self.number);
        if state.running.len() + state.waiting.len() == known {
            // It ended before it asked.
            state.coming = state.coming.saturating_sub(1);
        }
        self.turns.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::{Silent, Unwanted};
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn wish(number: usize, bytes: u64) -> Wish {
        Wish { number, bytes, held: 0 }
    }

    fn load(number: usize, bytes: u64, threads: u32) -> Load {
        Load { number, bytes, threads }
    }

    #[test]
    fn as_many_run_as_fit_into_memory() {
        let first = wish(7, 40);
        let state = |room: Option<u64>, jobs: usize, running: &[u64]| State {
            jobs,
            room,
            running: running.iter().enumerate().map(|(i, bytes)| load(i, *bytes, 1)).collect(),
            waiting: vec![first],
            coming: 0,
        };
        assert!(state(Some(100), 4, &[30, 30]).may_run(&first));
        assert!(!state(Some(99), 4, &[30, 30]).may_run(&first));
        assert!(!state(Some(100), 2, &[30, 30]).may_run(&first), "there are places for two");
        assert!(state(None, 4, &[1 << 60, 1 << 60]).may_run(&first), "nobody tells how much there is");
        assert!(state(Some(10), 4, &[]).may_run(&first), "one always runs");
        assert!(!state(Some(10), 4, &[1]).may_run(&first));
        assert!(!state(Some(u64::MAX - 1), 4, &[u64::MAX, 1]).may_run(&wish(7, u64::MAX)), "sums saturate");
    }

    #[test]
    fn bakes_go_on_in_the_order_in_which_they_asked() {
        let (large, small) = (wish(0, 80), wish(1, 10));
        let mut state =
            State { jobs: 3, room: Some(100), running: vec![load(2, 50, 1)], waiting: vec![large, small], coming: 0 };
        assert!(!state.may_run(&large) && !state.may_run(&small), "the large one would wait for ever");
        state.running.clear();
        assert!(state.may_run(&large) && !state.may_run(&small));
    }

    #[test]
    fn the_files_of_those_that_wait_count() {
        let (first, second) = (wish(1, 40), Wish { number: 2, bytes: 40, held: 25 });
        let state =
            State { jobs: 3, room: Some(100), running: vec![load(0, 40, 1)], waiting: vec![first, second], coming: 0 };
        assert!(!state.may_run(&first));
        assert!(State { room: Some(105), ..state }.may_run(&first));
    }

    #[test]
    fn threads_are_shared_evenly_and_the_last_have_all() {
        let state = |running: &[(u64, u32)], waiting: &[u64], coming: usize| State {
            jobs: 4,
            room: Some(100),
            running: running.iter().enumerate().map(|(i, (bytes, threads))| load(100 + i, *bytes, *threads)).collect(),
            waiting: waiting.iter().enumerate().map(|(i, bytes)| wish(i, *bytes)).collect(),
            coming,
        };
        let share = |state: State, threads| state.share(&state.waiting[0], threads);
        assert_eq!(share(state(&[], &[10], 9), 8), 2);
        assert_eq!(share(state(&[(10, 2)], &[10], 8), 8), 2);
        assert_eq!(share(state(&[(10, 2), (10, 2), (10, 2)], &[10], 6), 8), 2);
        assert_eq!(share(state(&[], &[10], 0), 8), 8, "the last one");
        assert_eq!(share(state(&[(10, 4)], &[10], 0), 8), 4, "the last but one still runs");
        assert_eq!(share(state(&[], &[60, 60, 60], 0), 8), 8, "nothing fits beside it");
        assert_eq!(share(state(&[], &[60, 60, 30], 0), 8), 4);
        assert_eq!(share(state(&[(10, 2), (10, 2), (10, 2)], &[10], 6), 2), 1, "never none");
    }

    #[test]
    fn all_have_their_turn_and_never_too_many_at_once() {
        let (bakes, jobs) = (24, 3);
        let turns = Turns::new(bakes, jobs, 6);
        let (running, most, ended) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for number in 0..bakes {
                let (turns, running, most, ended) = (&turns, &running, &most, &ended);
                scope.spawn(move || {
                    let turn = turns.turn(number, 0);
                    // Some end before they ask.
                    if number % 5 > 0 {
                        let leave = turn.enter(&Memory::default(), &Silent).unwrap();
                        assert!((1..=6).contains(&leave.threads), "{leave:?}");
                        most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                        std::thread::yield_now();
                        running.fetch_sub(1, Ordering::SeqCst);
                    }
                    drop(turn);
                    ended.fetch_add(1, Ordering::SeqCst);
                });
            }
        });
        assert!(most.into_inner() <= jobs && ended.into_inner() == bakes);
        let state = turns.lock().clone();
        assert!(state.running.is_empty() && state.waiting.is_empty() && state.coming == 0, "{state:?}");
    }

    #[test]
    fn who_waits_can_be_cancelled() {
        let turns = Turns::new(3, 1, 2);
        let first = turns.turn(0, 0);
        first.enter(&Memory::default(), &Silent).unwrap();
        let second = turns.turn(1, 0);
        assert!(matches!(second.enter(&Memory::default(), &Unwanted), Err(Error::Cancelled)));
        drop(second);
        drop(first);
        // Nobody is in the way of the third.
        assert_eq!(turns.turn(2, 1).enter(&Memory::default(), &Silent).unwrap().threads, 1);
    }

    #[test]
    fn what_fits_nowhere_is_refused_and_not_waited_for() {
        let turns = Turns::new(1, 1, 2);
        let turn = turns.turn(0, 0);
        if turns.budget.at_ease().is_some() {
            let vast = Memory { texels: u64::MAX, ..Memory::default() };
            assert!(matches!(turn.enter(&vast, &Silent), Err(Error::Memory { .. })));
        }
    }
}
