//! Bakes scenes, several at a time: first it is found out which have to be baked at all, then these share memory and
//! threads ([`luxel::bake::Turns`]). One that fails stops no other.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};

use luxel::bake::{Turns, bake_in_turn};
use luxel::current::{self, Reason, State};
use luxel::discover::Found;
use luxel::settings::{Resolved, for_scene};
use luxel::study::budget;
use luxel::text::shown;
use luxel::verify::{
    Verified,
    gate::{self, Answer},
};
use luxel::watch::Finished;
use luxel::{Error, Request, bake_verified};
use luxel_export::{OutputSet, Report};

use super::args::{Bake, Baking};
use super::progress::{Reporter, Screen, Style};
use super::{End, Fate, Job, Place, conclude, places, prepare, print};

/// `luxel bake`.
pub fn bake(args: &Baking) -> anyhow::Result<u8> {
    let Bake { common, out, .. } = &args.bake;
    let task = prepare(common, out.as_deref())?;
    let places = places(&task.found, out.as_deref())?;
    for (path, error) in &task.missing {
        print::failed(task.style, path, error);
    }
    let fleet = Fleet {
        task: &task,
        args,
        screen: Screen::new(task.style),
        worker: std::env::current_exe().ok(),
        trials: Mutex::default(),
    };
    let mut fates = vec![Fate::Waiting; task.found.len()];
    let mut stale = Vec::new();
    let seen = fleet.many(processors(), places.into_iter().enumerate().collect(), |(i, place)| fleet.look(i, place));
    for (i, seen) in seen.into_iter().enumerate() {
        match seen {
            None => {}
            Some(Ok(Seen::Stale(outputs, settings))) => stale.push((i, outputs, *settings)),
            Some(Ok(Seen::Over(end))) => fates[i] = Fate::Over(end),
            Some(Err(fate)) => fates[i] = fate,
        }
    }
    let turns = fleet.turns(&stale);
    let jobs = fleet.jobs(threads(&stale));
    let numbered = stale.into_iter().enumerate().collect();
    let baked = fleet
        .many(jobs, numbered, |(number, (i, outputs, settings))| (i, fleet.bake(&turns, number, i, outputs, settings)));
    for (i, fate) in baked.into_iter().flatten() {
        fates[i] = fate;
    }
    fleet.screen.end();
    Ok(conclude(&task, &fates))
}

/// What was seen of a scene before anything is baked.
enum Seen {
    Over(End),
    Stale(OutputSet, Box<Resolved>),
}

/// A scene that has to be baked: its number, where to, and how.
type Stale = (usize, OutputSet, Resolved);

struct Fleet<'t> {
    task: &'t Job,
    args: &'t Baking,
    screen: Screen,
    worker: Option<PathBuf>,
    /// Held by the scene whose settings are being found.
    trials: Mutex<()>,
}

impl Fleet<'_> {
    fn reporter(&self, scene: usize) -> (&Found, Reporter<'_>) {
        let found = &self.task.found[scene];
        let name = print::written(&found.scene);
        (found, Reporter::on(&self.screen, scene, &name, self.task.cancelled.clone()))
    }

    /// Finds out whether a scene has to be baked.
    fn look(&self, i: usize, place: Place) -> Result<Seen, Fate> {
        let (found, reporter) = self.reporter(i);
        if matches!(reporter.style(), Style::Lines | Style::Bar) {
            reporter.say(&shown(&found.scene));
        }
        let seen = place.map_err(Error::from).and_then(|outputs| self.state(&found.scene, outputs, &reporter));
        let seen = seen.map_err(|error| self.failed(&found.scene, error, &reporter));
        if !matches!(seen, Ok(Seen::Stale(..))) {
            self.screen.over(i);
        }
        seen
    }

    fn state(&self, scene: &Path, outputs: OutputSet, reporter: &Reporter) -> Result<Seen, Error> {
        let settings = for_scene(scene, self.task.config.as_ref(), &self.args.bake.common.settings.0)?;
        let settings = match self.args.target_error {
            None => settings,
            Some(target) => match self.settings_for(scene, settings, target, outputs.folder(), reporter)? {
                Some(settings) => settings,
                None => {
                    print::stale(reporter, scene, &[Reason::Untried]);
                    return Ok(Seen::Over(End::Stale));
                }
            },
        };
        if !self.args.force {
            match current::check(scene, &outputs, &settings, reporter)? {
                State::Current(now) => match self.answer(&now.report) {
                    Answer::Passed => {
                        print::unchanged(reporter, scene, &now.files, self.verified(&now.report));
                        return Ok(Seen::Over(End::Unchanged));
                    }
                    Answer::Refused(refusal) => return Err(Error::NotGoodEnough(refusal)),
                    Answer::Insufficient { texels } => {
                        print::stale(reporter, scene, &[Reason::Unverified { texels }]);
                    }
                },
                State::Stale(reasons) => print::stale(reporter, scene, &reasons),
            }
        }
        Ok(if self.args.check { Seen::Over(End::Stale) } else { Seen::Stale(outputs, Box::new(settings)) })
    }

    /// The settings that keep an error; none where `--check` forbids to find them. Trials take all threads and the memory
    /// of a small bake, so scenes take turns.
    fn settings_for(
        &self,
        scene: &Path,
        settings: Resolved,
        target: f64,
        outputs: &Path,
        reporter: &Reporter,
    ) -> Result<Option<Resolved>, Error> {
        let _turn = self.trials.lock().unwrap_or_else(PoisonError::into_inner);
        let store = self.args.bake.storing.options().open(outputs);
        budget::settings_for(scene, settings, target, (&store, !self.args.check), reporter)
    }

    /// What current outputs say to what is asked of their error.
    fn answer(&self, report: &Report) -> Answer {
        self.args.ask().map_or(Answer::Passed, |ask| gate::answer(report, &ask))
    }

    /// What is told of the error in a report.
    fn verified(&self, report: &Report) -> Option<Verified> {
        let verification = report.verification.clone().filter(|_| self.args.ask().is_some())?;
        Some(Verified { verification, checks: report.checks.clone() })
    }

    /// Bakes a scene when its turn comes.
    fn bake(&self, turns: &Turns, number: usize, i: usize, outputs: OutputSet, settings: Resolved) -> Fate {
        let (found, reporter) = self.reporter(i);
        let turn = turns.turn(number, settings.settings.threads.0);
        let store = self.args.bake.storing.options();
        let request = Request {
            scene: found.scene.clone(),
            outputs,
            settings,
            worker: self.worker.clone(),
            store,
            kept: Default::default(),
        };
        let baked = match self.args.ask() {
            Some(ask) => bake_verified(&request, &ask, &turn, &reporter),
            None => bake_in_turn(&request, &turn, &reporter),
        };
        drop(turn);
        reporter.finish();
        let fate = match baked {
            Ok(baked) => {
                let verified = self.verified(&baked.report);
                print::baked_on(&reporter, &found.scene, Finished::from(baked).done, verified);
                Fate::Over(End::Done)
            }
            Err(error) => self.failed(&found.scene, error, &reporter),
        };
        self.screen.over(i);
        fate
    }

    /// Tells an error of a scene.
    fn failed(&self, scene: &Path, error: Error, reporter: &Reporter) -> Fate {
        if matches!(error, Error::Cancelled) {
            return Fate::Interrupted;
        }
        let verified = match &error {
            Error::NotGoodEnough(refusal) => Some(refusal.verified.clone()),
            _ => None,
        };
        print::failed_on(reporter, scene, &anyhow::Error::new(error), verified);
        Fate::Failed
    }

    /// The turns of the scenes that have to be baked.
    fn turns(&self, stale: &[Stale]) -> Turns {
        let threads = threads(stale);
        let jobs = self.jobs(threads).min(stale.len().max(1));
        Turns::new(stale.len(), jobs, u32::try_from(threads).unwrap_or(u32::MAX))
    }

    /// Scenes at a time: as asked for, or one for every thread, so that the parts of a bake that one thread does alone
    /// run beside each other.
    fn jobs(&self, threads: usize) -> usize {
        self.args.jobs.map_or(threads, NonZeroUsize::get)
    }

    /// Works on all items, some at a time, in their order; those that nobody began when Ctrl-C came have no result. With
    /// `--jobs` there are at most so many at a time.
    fn many<I: Send, T: Send>(&self, workers: usize, items: Vec<I>, work: impl Fn(I) -> T + Sync) -> Vec<Option<T>> {
        let count = items.len();
        let workers = self.jobs(workers).min(count);
        let results: Mutex<Vec<Option<T>>> = Mutex::new((0..count).map(|_| None).collect());
        let queue = Mutex::new(items.into_iter().enumerate());
        let next = || {
            let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
            if self.task.cancelled.load(Ordering::Relaxed) { None } else { queue.next() }
        };
        let share = || {
            while let Some((i, item)) = next() {
                let result = work(item);
                results.lock().unwrap_or_else(PoisonError::into_inner)[i] = Some(result);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..workers {
                // Where no further thread can be had, those that are there do the work.
                if std::thread::Builder::new().name("luxel scene".into()).spawn_scoped(scope, share).is_err() {
                    break;
                }
            }
            share();
        });
        results.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, NonZeroUsize::get)
}

/// Threads of all bakes together: one per processor, or what the settings of a scene ask for if that is more.
fn threads(stale: &[Stale]) -> usize {
    let asked = |settings: &Resolved| match settings.settings.threads.0 {
        0 => processors(),
        threads => threads as usize,
    };
    stale.iter().map(|(_, _, settings)| asked(settings)).max().unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::{Cli, Task};
    use clap::Parser;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, AtomicUsize};

    fn with_fleet(line: &str, test: impl FnOnce(&Fleet, &Arc<AtomicBool>)) {
        let Task::Bake(args) = Cli::try_parse_from(line.split(' ')).unwrap().task else { panic!("{line}") };
        let cancelled = Arc::new(AtomicBool::new(false));
        let (found, missing) = (Vec::new(), Vec::new());
        let cancelled_too = cancelled.clone();
        let task = Job { found, missing, config: None, style: Style::Quiet, cancelled: cancelled_too, deed: "baked" };
        let screen = Screen::new(Style::Quiet);
        test(&Fleet { task: &task, args: &args, screen, worker: None, trials: Mutex::default() }, &cancelled);
    }

    #[test]
    fn all_items_are_worked_on_and_no_more_at_a_time_than_asked_for() {
        with_fleet("luxel bake a --jobs 3", |fleet, _| {
            let (now, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
            let results = fleet.many(64, (0..100).collect(), |i: usize| {
                most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                std::thread::yield_now();
                now.fetch_sub(1, Ordering::SeqCst);
                i * i
            });
            assert!(results.into_iter().enumerate().all(|(i, result)| result == Some(i * i)));
            assert!((1..=3).contains(&most.into_inner()));
        });
    }

    #[test]
    fn after_ctrl_c_nothing_new_is_begun() {
        with_fleet("luxel bake a --jobs 1", |fleet, cancelled| {
            let results = fleet.many(8, (0..10).collect(), |i: usize| {
                cancelled.store(i == 3, Ordering::Relaxed);
                i
            });
            let done: Vec<usize> = results.into_iter().flatten().collect();
            assert_eq!(done, [0, 1, 2, 3]);
        });
    }
}
