//! What a person, a log or a program sees of a running bake.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use luxel::text::{lines as clean, plain};
use luxel_scene::Progress;
use serde_json::json;

/// At most one progress event in this time.
const EVENT_PAUSE: Duration = Duration::from_millis(250);

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Not at all.
    Quiet,
    /// One line per stage, for logs.
    Lines,
    /// A bar with an estimate of the time left.
    Bar,
    /// JSON objects, one a line, on standard output.
    Json,
}

impl Style {
    pub fn choose(json: bool, quiet: bool) -> Self {
        match (json, quiet) {
            (true, _) => Self::Json,
            (_, true) => Self::Quiet,
            _ if std::io::stderr().is_terminal() => Self::Bar,
            _ => Self::Lines,
        }
    }
}

/// What people see of scenes that are worked on at the same time: a bar for each, above them lines. The lines of a scene
/// stay together, in the order of the scenes: those of the first one that is not over appear at once, those of later
/// ones when it is.
pub struct Screen {
    style: Style,
    bars: MultiProgress,
    lines: Mutex<Lines>,
}

#[derive(Default)]
struct Lines {
    /// The first scene that is not over.
    first: usize,
    over: BTreeSet<usize>,
    held: BTreeMap<usize, String>,
}

impl Screen {
    pub fn new(style: Style) -> Self {
        let bars = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10));
        Self { style, bars, lines: Mutex::default() }
    }

    fn say(&self, scene: usize, line: &str) {
        let (line, mut lines) = (clean(line), self.lock());
        if scene <= lines.first {
            return self.show(&format!("{line}\n"));
        }
        let held = lines.held.entry(scene).or_default();
        held.push_str(&line);
        held.push('\n');
    }

    /// Nothing more will be said of a scene.
    pub fn over(&self, scene: usize) {
        let mut lines = self.lock();
        lines.over.insert(scene);
        while let Some(first) = Some(lines.first).filter(|first| lines.over.contains(first)) {
            lines.first = first + 1;
            if let Some(text) = lines.held.remove(&(first + 1)) {
                self.show(&text);
            }
        }
    }

    /// Nothing more will be said at all: shows what was held back behind scenes that nobody ended.
    pub fn end(&self) {
        let held = std::mem::take(&mut self.lock().held);
        held.values().for_each(|text| self.show(text));
    }

    fn lock(&self) -> MutexGuard<'_, Lines> {
        self.lines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Shows whole lines.
    fn show(&self, text: &str) {
        let write = || drop(write!(std::io::stderr().lock(), "{text}"));
        if self.style == Style::Bar { self.bars.suspend(write) } else { write() }
    }
}

/// The screen of a reporter: one that it shares, or its own.
enum Shown<'s> {
    Shared(&'s Screen, usize),
    Own(Box<Screen>),
}

/// Shows the stages of one scene, and passes Ctrl-C on.
pub struct Reporter<'s> {
    shown: Shown<'s>,
    scene: String,
    cancelled: Arc<AtomicBool>,
    current: Mutex<Option<Current>>,
}

struct Current {
    stage: &'static str,
    total: u64,
    done: u64,
    since: Instant,
    told: Instant,
    bar: Option<ProgressBar>,
}

impl Reporter<'static> {
    /// Of a scene that is alone.
    pub fn new(style: Style, scene: &str, cancelled: Arc<AtomicBool>) -> Self {
        let shown = Shown::Own(Box::new(Screen::new(style)));
        Self { shown, scene: scene.into(), cancelled, current: Mutex::new(None) }
    }
}

impl<'s> Reporter<'s> {
    /// Of one scene among others, by its number.
    pub fn on(screen: &'s Screen, number: usize, scene: &str, cancelled: Arc<AtomicBool>) -> Self {
        Self { shown: Shown::Shared(screen, number), scene: scene.into(), cancelled, current: Mutex::new(None) }
    }

    fn screen(&self) -> (&Screen, usize) {
        match &self.shown {
            Shown::Shared(screen, number) => (screen, *number),
            Shown::Own(screen) => (screen, 0),
        }
    }

    pub fn style(&self) -> Style {
        self.screen().0.style
    }

    /// A line for a person, in the scene's place.
    pub fn say(&self, line: &str) {
        let (screen, number) = self.screen();
        screen.say(number, line);
    }

    /// The last stage is over.
    pub fn finish(&self) {
        let mut current = self.lock();
        self.end(&mut current);
    }

    fn bar(&self, stage: &'static str, total: u64) -> ProgressBar {
        match &self.shown {
            Shown::Shared(screen, _) => bar(&screen.bars, format!("{} {stage}", plain(&self.scene)), total),
            Shown::Own(screen) => bar(&screen.bars, stage.into(), total),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Current>> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self, current: &mut Option<Current>) {
        let Some(c) = current.take() else { return };
        let seconds = c.since.elapsed().as_secs_f64();
        if let Some(bar) = c.bar {
            bar.finish_and_clear();
        }
        match self.style() {
            Style::Quiet => {}
            Style::Lines | Style::Bar => self.say(&format!("  {:<12} {}", c.stage, duration(seconds))),
            Style::Json => {
                event(&json!({ "event": "finished", "scene": self.scene, "stage": c.stage, "seconds": seconds }));
            }
        }
    }
}

impl Progress for Reporter<'_> {
    fn begin(&self, stage: &'static str, total: u64) {
        let mut current = self.lock();
        // A stage may announce itself again, as voxels do on the way to their budget: it goes on.
        if let Some(c) = current.as_mut().filter(|c| c.stage == stage) {
            (c.total, c.done) = (total, 0);
            if let Some(bar) = &c.bar {
                bar.set_length(total);
                bar.set_position(0);
            }
            return;
        }
        self.end(&mut current);
        let now = Instant::now();
        let style = self.style();
        let bar = (style == Style::Bar).then(|| self.bar(stage, total));
        if style == Style::Json {
            event(&json!({ "event": "started", "scene": self.scene, "stage": stage, "total": total }));
        }
        *current = Some(Current { stage, total, done: 0, since: now, told: now, bar });
    }

    fn advance(&self, done: u64) {
        let mut current = self.lock();
        let Some(c) = current.as_mut() else { return };
        c.done += done;
        if let Some(bar) = &c.bar {
            bar.inc(done);
        }
        if self.style() == Style::Json && c.told.elapsed() >= EVENT_PAUSE {
            c.told = Instant::now();
            let (stage, done, total) = (c.stage, c.done, c.total);
            event(&json!({
                "event": "progress", "scene": self.scene, "stage": stage, "done": done, "total": total
            }));
        }
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}

/// A bar that tells share, time so far and time to go; a spinner where the amount of work is unknown.
fn bar(bars: &MultiProgress, name: String, total: u64) -> ProgressBar {
    let bar = bars.add(ProgressBar::new(total));
    let template = if total == 0 {
        "  {prefix:<12} {spinner} {elapsed}"
    } else {
        "  {prefix:<12} {bar:32} {percent:>3} %  {elapsed}, {eta} to go"
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(name);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// A JSON object on standard output. Nobody may be listening any more, which is no reason to stop a bake.
pub fn event(value: &serde_json::Value) {
    drop(writeln!(std::io::stdout().lock(), "{value}"));
}

/// Text on standard output.
pub fn out(text: &str) {
    drop(write!(std::io::stdout().lock(), "{}", clean(text)));
}

/// A line for a person.
pub fn say(line: &str) {
    drop(writeln!(std::io::stderr().lock(), "{}", clean(line)));
}

/// `3.2 s`, `4 min 5 s`, `1 h 2 min`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_well() {
        let said: Vec<String> = [0.04, 59.4, 61.0, 3725.0].map(duration).into();
        assert_eq!(said, ["0.0 s", "59.4 s", "1 min 1 s", "1 h 2 min"]);
    }

    #[test]
    fn lines_of_later_scenes_wait_for_those_of_earlier_ones() {
        let screen = Screen::new(Style::Lines);
        let held = || screen.lock().held.clone();
        screen.say(1, "b");
        screen.say(2, "c");
        screen.say(1, "  done");
        screen.say(0, "a");
        assert_eq!(held(), BTreeMap::from([(1, "b\n  done\n".to_owned()), (2, "c\n".to_owned())]));
        screen.over(1);
        assert_eq!(held().len(), 2, "the first is not over");
        screen.over(0);
        assert!(held().is_empty(), "what the third said so far appears too");
        screen.say(2, "  done");
        assert!(held().is_empty());
        screen.say(4, "e");
        screen.end();
        assert!(held().is_empty());
    }

    #[test]
    fn a_stage_that_begins_again_goes_on() {
        let reporter = Reporter::new(Style::Quiet, "a", Arc::default());
        reporter.begin("voxelize", 10);
        reporter.advance(7);
        let since = reporter.lock().as_ref().map(|c| c.since);
        reporter.begin("voxelize", 20);
        let state = reporter.lock().as_ref().map(|c| (c.total, c.done, c.since));
        assert_eq!(state, since.map(|since| (20, 0, since)));
        reporter.begin("shoot", 5);
        assert!(reporter.lock().as_ref().is_some_and(|c| c.stage == "shoot"));
    }

    #[test]
    fn a_cancelled_bake_learns_of_it() {
        let flag = Arc::new(AtomicBool::new(false));
        let reporter = Reporter::new(Style::Quiet, "a", flag.clone());
        reporter.begin("rays", 10);
        reporter.advance(5);
        assert!(reporter.check().is_ok());
        flag.store(true, Ordering::Relaxed);
        assert!(reporter.check().is_err());
        reporter.finish();
    }
}
