//! The course of a bake: which stages ran, how long, what they counted. Clocks are read here and nowhere below.

use std::collections::BTreeMap;
use std::time::Instant;

use luxel_export::report::{Stage as Entry, StageState};
use luxel_scene::Progress;

use super::cause::Cause;
use crate::Error;
use crate::plan::{Plan, Stage};

/// What a stage counted, by name.
pub type Counters = BTreeMap<String, u64>;

/// Counters of which several runs of a stage have the largest one, not the sum.
const LARGEST: [&str; 3] = ["surfels", "longest_cut", "closed"];

/// The counter of what this very bake wrote [bytes].
pub const WRITTEN: &str = "bytes";

/// Runs stages as the plan says and writes down what happened. A stage may run several times, once for each light
/// group, and be reused in between; it is one entry all the same.
#[derive(Clone)]
pub struct Journal<'a> {
    pub progress: &'a dyn Progress,
    pub entries: Vec<Entry>,
    /// What has changed since the last bake, as far as that is known: why stages run, or need not.
    pub cause: Cause,
    /// The light group at work, where there are several.
    pub group: Option<String>,
    /// What stages counted that ran in this very bake, and what in their last run.
    ran: BTreeMap<Stage, Counters>,
    last: BTreeMap<Stage, Counters>,
    /// Groups for which stages were reused, and for which they ran.
    by_group: BTreeMap<Stage, [Vec<String>; 2]>,
}

impl<'a> Journal<'a> {
    pub fn new(progress: &'a dyn Progress) -> Self {
        Self {
            progress,
            entries: Vec::new(),
            cause: Cause::default(),
            group: None,
            ran: BTreeMap::new(),
            last: BTreeMap::new(),
            by_group: BTreeMap::new(),
        }
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
        self.made(stage, reason, total, |progress, counters| Ok((work(progress, counters)?, StageState::Ran)))
    }

    /// Runs a stage that finds out by itself whether all that it needs is stored.
    pub fn made<T>(
        &mut self,
        stage: Stage,
        reason: &str,
        total: Option<u64>,
        work: impl FnOnce(&dyn Progress, &mut Counters) -> Result<(T, StageState), Error>,
    ) -> Result<T, Error> {
        self.progress.check()?;
        if let Some(total) = total {
            self.progress.begin(stage.name(), total);
        }
        let mut counters = Counters::new();
        let start = Instant::now();
        let (result, state) = work(self.progress, &mut counters)?;
        if state == StageState::Reused {
            let reason = format!("stored: {}", self.cause.of_reuse());
            self.note(stage, state, &reason, 0.0, counters);
            return Ok(result);
        }
        let reason = self.cause.of_run(stage).map_or_else(|| reason.to_owned(), |why| format!("{reason}; {why}"));
        add(self.ran.entry(stage).or_default(), &counters);
        self.last.insert(stage, counters.clone());
        self.note(stage, state, &reason, start.elapsed().as_secs_f64(), counters);
        Ok(result)
    }

    /// Writes a stage down: as another part of one that is written down already, if it is.
    fn note(&mut self, stage: Stage, state: StageState, reason: &str, seconds: f64, counters: Counters) {
        if let Some(group) = self.group.as_ref().filter(|_| state != StageState::LeftOut) {
            let lists = self.by_group.entry(stage).or_default();
            lists[usize::from(state == StageState::Ran)].push(group.clone());
        }
        let Some(entry) = self.entries.iter_mut().find(|e| e.name == stage.name()) else {
            let (name, reason) = (stage.name().to_owned(), reason.to_owned());
            self.entries.push(Entry { name, state, reason, seconds, counters });
            return;
        };
        entry.seconds += seconds;
        add(&mut entry.counters, &counters);
        if entry.state != StageState::Ran && state == StageState::Ran {
            entry.state = state;
            entry.reason = reason.into();
        }
    }

    /// A stage whose result was stored; `counters` are those of when it ran.
    pub fn reused(&mut self, plan: &Plan, stage: Stage, counters: Counters) {
        if plan.runs(stage) {
            let reason = format!("stored: {}", self.cause.of_reuse());
            self.note(stage, StageState::Reused, &reason, 0.0, counters);
        }
    }

    /// All entries, in the order of the chain, with the groups that a stage ran for where that was not for all.
    pub fn close(mut self) -> Vec<Entry> {
        for (stage, [reused, ran]) in &self.by_group {
            let both = !reused.is_empty() && !ran.is_empty();
            if let Some(entry) = self.entries.iter_mut().find(|e| both && e.name == stage.name()) {
                entry.reason += &format!("; for {}, stored for {}", ran.join(", "), reused.join(", "));
            }
        }
        let place = |entry: &Entry| Stage::ALL.iter().position(|stage| stage.name() == entry.name);
        self.entries.sort_by_key(place);
        self.entries
    }

    /// A stage that the plan leaves out.
    pub fn left_out(&mut self, plan: &Plan, stage: Stage) {
        self.note(stage, StageState::LeftOut, plan.reason(stage), 0.0, Counters::new());
    }

    /// The same, said once, and nothing of a stage that the plan runs: one that this part of the bake has no use for.
    pub fn left_out_unless_run(&mut self, plan: &Plan, stage: Stage) {
        if !plan.runs(stage) && self.entry(stage).is_none() {
            self.left_out(plan, stage);
        }
    }

    /// Gives the reason of a stage that ran before there was a plan.
    pub fn explain(&mut self, stage: Stage, reason: &str) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.name == stage.name()) {
            entry.reason = reason.into();
        }
    }

    /// Says more of a stage.
    pub fn add(&mut self, stage: Stage, words: &str) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.name == stage.name()) {
            entry.reason += &format!("; {words}");
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
        self.ran.get(&stage).and_then(|counters| counters.get(counter)).copied().unwrap_or_default()
    }

    /// What became of a stage so far.
    pub fn state(&self, stage: Stage) -> Option<StageState> {
        self.entry(stage).map(|e| e.state)
    }

    /// What a stage counted in its last run in this bake.
    pub fn last(&self, stage: Stage) -> Counters {
        self.last.get(&stage).cloned().unwrap_or_default()
    }

    /// What those of the stages counted that the plan runs, by their names: to be kept with what they made. It is the
    /// same whichever of them were reused.
    pub fn counted(&self, plan: &Plan, stages: &[Stage]) -> BTreeMap<String, Counters> {
        let lasting = |stage: &Stage| {
            let mut counters = self.entry(*stage).map(|e| e.counters.clone()).unwrap_or_default();
            counters.retain(|name, _| name != WRITTEN);
            (stage.name().to_owned(), counters)
        };
        stages.iter().filter(|stage| plan.runs(**stage)).map(lasting).collect()
    }
}

/// Adds the counters of another run.
fn add(to: &mut Counters, more: &Counters) {
    for (name, count) in more {
        let sum = to.entry(name.clone()).or_default();
        *sum = if LARGEST.contains(&name.as_str()) { (*sum).max(*count) } else { *sum + count };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use luxel_scene::Silent;

    fn plan() -> Plan {
        Plan::new(&luxel_assets::cornell(), &Settings::default())
    }

    #[test]
    fn a_stage_that_runs_for_several_groups_is_one_entry() {
        let (plan, mut journal) = (plan(), Journal::new(&Silent));
        let count = |n: u64| Counters::from([("rays".to_owned(), n), ("longest_cut".to_owned(), n)]);
        journal.run(&plan, Stage::Export, None, |_, _| Ok(())).unwrap();
        journal.group = Some("lamps".into());
        journal.reused(&plan, Stage::Gather, count(5));
        journal.group = Some("sun".into());
        let run = |_: &dyn Progress, counters: &mut Counters| {
            *counters = count(3);
            Ok(())
        };
        journal.run(&plan, Stage::Gather, None, run).unwrap();
        journal.group = None;
        journal.reused(&plan, Stage::Surfels, count(1));
        journal.reused(&plan, Stage::Sky, count(1));
        assert_eq!(journal.count(Stage::Gather, "rays"), 8);
        assert_eq!(journal.count(Stage::Gather, "longest_cut"), 5);
        assert_eq!(journal.count_run(Stage::Gather, "rays"), 3);
        let entries = journal.close();
        let names: Vec<&str> = entries.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, ["surfels", "gather", "export"], "a stage that the plan leaves out is not reused");
        assert_eq!((entries[0].state, entries[1].state), (StageState::Reused, StageState::Ran));
        assert_eq!(entries[0].reason, "stored: its input was seen before");
        assert!(entries[1].reason.ends_with("; for sun, stored for lamps"), "{}", entries[1].reason);
    }
}
