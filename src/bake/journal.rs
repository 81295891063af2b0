//! The course of a bake: which stages ran, how long, what they counted. Clocks are read here and nowhere below.

use std::collections::BTreeMap;
use std::time::Instant;

use luxel_export::report::{Stage as Entry, StageState};
use luxel_scene::Progress;

use crate::Error;
use crate::plan::{Plan, Stage};

/// What a stage counted, by name.
pub type Counters = BTreeMap<String, u64>;

/// Runs stages as the plan says and writes down what happened.
pub struct Journal<'a> {
    pub progress: &'a dyn Progress,
    pub entries: Vec<Entry>,
}

impl<'a> Journal<'a> {
    pub fn new(progress: &'a dyn Progress) -> Self {
        Self { progress, entries: Vec::new() }
    }

    /// Runs a stage that the plan wants; `None` for one that it leaves out. `total` is its amount of work in its own
    /// unit; a stage whose room announces its steps itself has none.
    pub fn run<T>(
        &mut self,
        plan: &Plan,
        stage: Stage,
        total: Option<u64>,
        work: impl FnOnce(&dyn Progress, &mut Counters) -> Result<T, Error>,
    ) -> Result<Option<T>, Error> {
        if !plan.runs(stage) {
            self.left_out(plan, stage);
            return Ok(None);
        }
        self.always(stage, plan.reason(stage), total, work).map(Some)
    }

    /// Runs a stage whatever the plan says.
    pub fn always<T>(
        &mut self,
        stage: Stage,
        reason: &str,
        total: Option<u64>,
        work: impl FnOnce(&dyn Progress, &mut Counters) -> Result<T, Error>,
    ) -> Result<T, Error> {
        self.progress.check()?;
        if let Some(total) = total {
            self.progress.begin(stage.name(), total);
        }
        let mut counters = Counters::new();
        let start = Instant::now();
        let result = work(self.progress, &mut counters)?;
        self.note(stage, StageState::Ran, reason, start.elapsed().as_secs_f64(), counters);
        Ok(result)
    }

    /// Writes a stage down.
    pub fn note(&mut self, stage: Stage, state: StageState, reason: &str, seconds: f64, counters: Counters) {
        let (name, reason) = (stage.name().to_owned(), reason.to_owned());
        self.entries.push(Entry { name, state, reason, seconds, counters });
    }

    /// A stage that the plan leaves out.
    pub fn left_out(&mut self, plan: &Plan, stage: Stage) {
        self.note(stage, StageState::LeftOut, plan.reason(stage), 0.0, Counters::new());
    }

    /// Gives the reason of a stage that ran before there was a plan.
    pub fn explain(&mut self, stage: Stage, reason: &str) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.name == stage.name()) {
            entry.reason = reason.into();
        }
    }

    /// What is written down of a stage so far.
    fn entry(&self, stage: Stage) -> Option<&Entry> {
        self.entries.iter().find(|e| e.name == stage.name())
    }

    /// Seconds that a stage took; 0 if it did not run.
    pub fn seconds(&self, stage: Stage) -> f64 {
        self.entry(stage).map_or(0.0, |e| e.seconds)
    }

    /// A counter of a stage, of one that was reused too; 0 if it was not counted.
    pub fn count(&self, stage: Stage, counter: &str) -> u64 {
        self.entry(stage).and_then(|e| e.counters.get(counter)).copied().unwrap_or_default()
    }

    /// A counter of a stage, if this very bake ran it.
    pub fn count_run(&self, stage: Stage, counter: &str) -> u64 {
        if self.state(stage) == Some(StageState::Ran) { self.count(stage, counter) } else { 0 }
    }

    /// What became of a stage so far.
    pub fn state(&self, stage: Stage) -> Option<StageState> {
        self.entry(stage).map(|e| e.state)
    }

    /// What a stage counted.
    pub fn counters(&self, stage: Stage) -> Counters {
        self.entry(stage).map(|e| e.counters.clone()).unwrap_or_default()
    }
}
