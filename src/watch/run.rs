//! The loop of a watch: hints in, bakes and events out.
//!
//! One bake runs at a time, on a thread of its own. A hint that concerns its scene is looked into at once, and the bake
//! is stopped where the content differs; the next one begins when the burst is over. An error is told when the scene has
//! been still for [`SETTLED`]: until then a file may be half written, or another one yet to come.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::thread::Scope;
use std::time::{Duration, Instant};

use luxel_scene::Progress;

use super::batch::{Batch, Hint, Hints};
use super::book::Book;
use super::depend::Look;
use super::event::{Done, Event, Fault};
use super::folders::Folders;
use super::source::Watched;
use super::{Baker, Ending, Finished, Message, Task, Watch};
use crate::current::{self, State};
use crate::store::StoreOptions;
use crate::{Error, Kept, Request};

/// An error that nothing has contradicted for this time is told.
const SETTLED: Duration = Duration::from_millis(400);

/// Between looks whether watched folders are still the same ones.
const BEAT: Duration = Duration::from_secs(2);

/// Most times that new folders lead to further ones before events are waited for again.
const ROUNDS: usize = 8;

pub fn run(watch: Watch, baker: &dyn Baker, tell: &mut dyn FnMut(Event)) -> Ending {
    let Watch { options, interval, source, sender, receiver, ending } = watch;
    let paths = options.paths.iter().map(|(path, _)| path.clone()).collect();
    let (worker, store) = (options.worker.clone(), options.store.clone());
    std::thread::scope(|scope| {
        let mut course = Course {
            scope,
            baker,
            sender,
            kept: Kept::default(),
            worker,
            store,
            interval,
            start: Instant::now(),
            book: Book::new(options, ending.clone()),
            ending,
            folders: Folders::new(source),
            batch: Batch::default(),
            running: None,
            untold: BTreeMap::new(),
            beat: BEAT,
            hasty: false,
            stopping: false,
            voice: Voice { tell, is_idle: false },
        };
        course.begin(paths);
        course.go(&receiver);
        let (scenes, failed, draft) = (course.book.scenes(), course.book.failed(), course.book.drafts());
        (course.voice.tell)(Event::Stopped { scenes, failed: failed.clone(), draft });
        Ending { failed }
    })
}

/// Tells, and knows whether it was said that there is nothing to do.
struct Voice<'t> {
    tell: &'t mut dyn FnMut(Event),
    is_idle: bool,
}

impl Voice<'_> {
    fn say(&mut self, event: Event) {
        use Event::{Polling, Unchanged, Unwatched, Watching};
        self.is_idle &= matches!(event, Polling { .. } | Unchanged { .. } | Unwatched { .. } | Watching { .. });
        (self.tell)(event);
    }
}

struct Running {
    scene: PathBuf,
    /// As it was when it began.
    look: Look,
    cancelled: Arc<AtomicBool>,
    overtaken: bool,
    /// Its files at which something has happened since, by the names that the scene knows.
    hinted: Vec<PathBuf>,
}

struct Course<'s, 'e, 't> {
    scope: &'s Scope<'s, 'e>,
    baker: &'e dyn Baker,
    sender: Sender<Message>,
    worker: Option<PathBuf>,
    store: StoreOptions,
    kept: Kept,
    interval: Duration,
    start: Instant,
    book: Book,
    folders: Folders,
    batch: Batch,
    running: Option<Running>,
    /// Broken scenes of which nothing has been said yet, and when it will be.
    untold: BTreeMap<PathBuf, Duration>,
    /// When the folders are checked next.
    beat: Duration,
    /// There may be more to do at once, after what has been heard meanwhile.
    hasty: bool,
    stopping: bool,
    /// Somebody has asked for the end, whether or not that was heard here.
    ending: Arc<AtomicBool>,
    voice: Voice<'t>,
}

/// Whoever asks for the end does not wait for what is being read.
struct Until<'a>(&'a AtomicBool);

impl Progress for Until<'_> {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl Course<'_, '_, '_> {
    fn now(&self) -> Duration {
        self.start.elapsed()
    }

    fn begin(&mut self, paths: Vec<PathBuf>) {
        let voice = &mut self.voice;
        self.book.survey(false, &mut |event| voice.say(event));
        voice.say(Event::Watching { paths, scenes: self.book.scenes() });
        for (scene, report) in self.book.reports() {
            voice.say(Event::Waiting { scene, outputs: report.into_iter().collect() });
        }
        self.arm(&Hints::default());
    }

    fn go(&mut self, receiver: &Receiver<Message>) {
        loop {
            match &self.running {
                _ if !self.stopping => self.work(),
                Some(running) => running.cancelled.store(true, Ordering::Relaxed),
                None => return,
            }
            // This course holds a sender itself, so nothing but time can run out.
            if let Ok(message) = receiver.recv_timeout(self.pause()) {
                self.take(message);
            }
            while let Ok(message) = receiver.try_recv() {
                self.take(message);
            }
        }
    }

    /// Does everything that can be done now.
    fn work(&mut self) {
        self.overtake();
        if self.now() >= self.beat {
            let now = self.now();
            self.folders.lost().into_iter().for_each(|hint| self.batch.add(now, hint));
            self.beat = now + BEAT;
        }
        if let Some(hints) = self.batch.take(self.now()) {
            self.attend(&hints);
        }
        self.tell_faults();
        self.hasty = false;
        if self.batch.is_empty() {
            while self.running.is_none() && !self.hasty && self.next() {}
        }
    }

    /// How long nothing has to be done if nobody says anything.
    fn pause(&self) -> Duration {
        if self.stopping {
            return BEAT;
        }
        if self.hasty {
            return Duration::ZERO;
        }
        // Errors wait until the burst is over.
        let untold = self.untold.values().min().copied().filter(|_| self.batch.is_empty());
        let due = [untold, self.batch.due()].into_iter().flatten().fold(self.beat, Duration::min);
        due.saturating_sub(self.now())
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Stop => self.stopping = true,
            Message::Drafted(done) => self.drafted(done),
            Message::Ended(result) => self.ended(result),
            Message::Hint(hint) => {
                let (Hint::At { path, .. } | Hint::Again(path)) = &hint else {
                    return self.batch.add(self.now(), hint);
                };
                if !self.book.concerns(path) {
                    return;
                }
                if let Some(running) = &mut self.running {
                    let own = self.book.depending(path).into_iter().filter(|(scene, _)| *scene == running.scene);
                    running.hinted.extend(own.map(|(_, file)| file));
                }
                self.batch.add(self.now(), hint);
            }
        }
    }

    /// Stops the running bake if something happened to its files that makes it vain.
    fn overtake(&mut self) {
        let Some(running) = self.running.as_mut().filter(|r| !r.overtaken && !r.hinted.is_empty()) else { return };
        let hinted = std::mem::take(&mut running.hinted);
        // A large file is not read where a look at its length will do: 100 ms are all there is.
        if self.book.are_others(&hinted)
            || self.book.glance_after(&running.scene, &hinted).is_some_and(|look| look != running.look)
        {
            running.overtaken = true;
            running.cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// A burst is over: looks at what it hinted at.
    fn attend(&mut self, hints: &Hints) {
        let (voice, untold) = (&mut self.voice, &mut self.untold);
        self.book.attend(hints, &mut |event| match &event {
            // What was not said need not be taken back.
            Event::Current { scene, .. } if untold.remove(scene).is_some() => {}
            _ => voice.say(event),
        });
        self.arm(hints);
        if let Some(running) = &mut self.running
            && self.book.item(&running.scene).is_none_or(|item| item.look != running.look)
        {
            running.overtaken = true;
            running.cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// Watches the folders that matter now. What happened in a new one before it was watched was not told, so it is
    /// looked at.
    fn arm(&mut self, hints: &Hints) {
        for round in 0..ROUNDS {
            let armed = self.folders.arm(&self.book.folders(), |folder| round == 0 && hints.lost(folder));
            for (folder, watched) in armed.news {
                self.voice.say(match watched {
                    Watched::Polled(reason) => Event::Polling { folder, reason, seconds: self.interval.as_secs_f64() },
                    Watched::Not(reason) => Event::Unwatched { path: folder, reason },
                    Watched::Told | Watched::Gone => continue,
                });
            }
            if armed.new.is_empty() {
                return;
            }
            let voice = &mut self.voice;
            let everywhere = Hints { everywhere: true, ..Hints::default() };
            self.book.attend(&everywhere, &mut |event| voice.say(event));
        }
        self.batch.add(self.now(), Hint::Everywhere);
    }

    /// Takes up the next scene, or says that there is none and returns false.
    fn next(&mut self) -> bool {
        // What has not been looked at to its end is not broken.
        if self.ending.load(Ordering::Relaxed) {
            return false;
        }
        let next = self.book.next().and_then(|scene| Some((scene.to_path_buf(), self.book.item(scene)?.look.clone())));
        let Some((scene, look)) = next else {
            if self.untold.is_empty() && !self.voice.is_idle {
                let (scenes, failed, draft) = (self.book.scenes(), self.book.failed(), self.book.drafts());
                self.voice.say(Event::Idle { scenes, failed, draft });
                self.voice.is_idle = true;
            }
            return false;
        };
        match (look.settings.clone(), look.outputs.clone()) {
            (Ok(settings), Ok(outputs)) => {
                let request = Request {
                    scene,
                    outputs,
                    settings,
                    worker: self.worker.clone(),
                    store: self.store.clone(),
                    kept: self.kept.clone(),
                };
                let is_current = self.adopt(&request, &look);
                if self.ending.load(Ordering::Relaxed) {
                    return false;
                }
                if !is_current {
                    self.bake(request, look);
                }
            }
            (Err(fault), _) | (_, Err(fault)) => self.failed(scene, look, fault, true),
        }
        true
    }

    /// Takes the outputs of an earlier run for the scene's own, where a bake would only write them again. What stands in
    /// the way of finding out stands in the way of the bake too, which tells it.
    fn adopt(&mut self, request: &Request, look: &Look) -> bool {
        let Request { scene, outputs, settings, .. } = request;
        if !self.book.is_fresh(scene) {
            return false;
        }
        let checked = current::check(scene, outputs, settings, &Until(&self.ending));
        let Ok(State::Current(now)) = checked else { return false };
        self.book.succeeded(scene, look, &now.inputs, now.files.clone());
        self.untold.remove(scene);
        self.voice.say(Event::Current { scene: scene.clone(), outputs: now.files });
        self.arm(&Hints::default());
        // Reading all files of a scene takes its time, and somebody may want to stop.
        self.hasty = true;
        true
    }

    /// Begins a bake of a scene as the look saw it.
    fn bake(&mut self, request: Request, look: Look) {
        let scene = request.scene.clone();
        self.voice.say(Event::Baking { scene: scene.clone() });
        let cancelled = Arc::new(AtomicBool::new(false));
        let (baker, sender, flag) = (self.baker, self.sender.clone(), cancelled.clone());
        self.running = Some(Running { scene, look, cancelled, overtaken: false, hinted: Vec::new() });
        let work = move || {
            // The receiver waits for the end of the bake.
            let drafted = |done| drop(sender.send(Message::Drafted(done)));
            let task = Task { request: &request, cancelled: &flag, drafted: &drafted };
            let result = std::panic::catch_unwind(AssertUnwindSafe(|| baker.bake(&task)));
            let broken = || Err(Error::Internal { what: "a panic outside of the bake".into() });
            // The receiver waits for it.
            drop(sender.send(Message::Ended(result.unwrap_or_else(|_| broken()))));
        };
        if let Err(error) = std::thread::Builder::new().name("luxel bake".into()).spawn_scoped(self.scope, work) {
            let fault = Fault { error: "cannot start a thread for the bake".into(), causes: vec![error.to_string()] };
            if let Some(running) = self.running.take() {
                self.failed(running.scene, running.look, fault, false);
            }
        }
    }

    fn drafted(&mut self, done: Done) {
        if let Some(Running { scene, .. }) = &self.running {
            let scene = scene.clone();
            self.book.drafted(&scene);
            self.voice.say(Event::Drafted { scene, done });
        }
    }

    fn ended(&mut self, result: Result<Finished, Error>) {
        let Some(Running { scene, look, overtaken, .. }) = self.running.take() else { return };
        match result {
            Ok(Finished { done, inputs }) => {
                self.book.succeeded(&scene, &look, &inputs, done.outputs.clone());
                self.untold.remove(&scene);
                self.voice.say(Event::Baked { scene: scene.clone(), done });
                let voice = &mut self.voice;
                self.book.look(&scene, &mut |event| voice.say(event));
                self.arm(&Hints::default());
            }
            // What an overtaken bake stumbles over is no more.
            Err(_) if overtaken => self.voice.say(Event::Overtaken { scene }),
            Err(Error::Cancelled) if self.stopping => {}
            Err(error) => {
                // Whatever else stands in the way lies outside of the scene's files, at least in part.
                let is_lasting = matches!(error, Error::Settings(_) | Error::Import(_));
                self.failed(scene, look, Fault::new(&error), is_lasting);
            }
        }
    }

    fn failed(&mut self, scene: PathBuf, look: Look, fault: Fault, is_lasting: bool) {
        self.untold.insert(scene.clone(), self.now() + SETTLED);
        self.book.failed_as(&scene, look, fault, is_lasting);
    }

    /// Tells the errors of scenes that have been still.
    fn tell_faults(&mut self) {
        if self.batch.is_empty() {
            let now = self.now();
            let due: Vec<PathBuf> = self.untold.iter().filter(|(_, at)| **at <= now).map(|(s, _)| s.clone()).collect();
            for scene in due {
                self.untold.remove(&scene);
                // It may have been mended meanwhile.
                if let Some(fault) = self.book.fault(&scene).cloned() {
                    let draft = self.book.kept(&scene);
                    self.voice.say(Event::Failed { scene, fault, draft });
                }
            }
        }
    }
}
