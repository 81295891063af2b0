//! A watch in this process, with a baker that counts, over real files in a temporary folder. Nothing waits for a time
//! to pass: every wait is for an event, and ends the test where it does not come.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use luxel::settings::{Layer, Origin};
use luxel::watch::event::{Done, Event};
use luxel::watch::{Choices, Ending, Finished, Options, Stopper, Task, Watch};
use luxel_scene::{ImportOptions, import};
use tempfile::TempDir;

/// Nothing that is waited for takes longer, on a machine that does something else too.
const LIMIT: Duration = Duration::from_secs(60);

/// What the baker has done, and whether it may go on.
#[derive(Default)]
struct Log {
    begun: usize,
    ended: usize,
    ended_well: usize,
    /// Bakes wait for it until they are cancelled.
    is_shut: bool,
    /// They do not heed that they were cancelled, as one that is about to end.
    is_deaf: bool,
    /// They write a draft first.
    drafts: bool,
    /// One has read its files and waits.
    is_held: bool,
}

pub struct Bench {
    pub folder: TempDir,
    log: Arc<(Mutex<Log>, Condvar)>,
    events: Receiver<Event>,
    stopper: Stopper,
    thread: JoinHandle<Ending>,
    /// Bakes that were told to begin.
    told: usize,
}

impl Bench {
    /// Watches `paths` of a temporary folder that `furnish` has filled, until everything there is baked.
    pub fn new(paths: &[&str], poll: Option<Duration>, furnish: impl FnOnce(&Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        furnish(folder.path());
        let paths: Vec<PathBuf> = paths.iter().map(|p| folder.path().join(p)).collect();
        let options = Options {
            paths: Options::paths(&paths).unwrap(),
            out: None,
            choices: Choices { config: None, flags: Layer::new(Origin::CommandLine) },
            worker: None,
            store: Default::default(),
        };
        let watch = Watch::new(options, poll);
        let (stopper, log) = (watch.stopper(), Arc::<(Mutex<Log>, Condvar)>::default());
        let (sender, events) = mpsc::channel();
        let shared = log.clone();
        let thread = std::thread::spawn(move || {
            watch.run(&|task: &Task| bake(&shared, task), &mut |event| drop(sender.send(event)))
        });
        let mut bench = Self { folder, log, events, stopper, thread, told: 0 };
        bench.idle();
        bench
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The next event that fits.
    pub fn wait(&mut self, what: &str, fits: impl Fn(&Event) -> bool) -> Event {
        self.hear(LIMIT, fits).unwrap_or_else(|passed| panic!("no event came that says {what}, but {passed:#?}"))
    }

    /// The same, with what came instead where there is silence for so long.
    fn hear(&mut self, silence: Duration, fits: impl Fn(&Event) -> bool) -> Result<Event, Vec<Event>> {
        let mut passed = Vec::new();
        loop {
            let Ok(event) = self.events.recv_timeout(silence) else { return Err(passed) };
            self.told += usize::from(matches!(event, Event::Baking { .. }));
            if fits(&event) {
                return Ok(event);
            }
            passed.push(event);
        }
    }

    /// Whatever is told within a time.
    pub fn within(&mut self, time: Duration) -> Vec<Event> {
        let until = Instant::now() + time;
        let next = || self.events.recv_timeout(until.saturating_duration_since(Instant::now())).ok();
        std::iter::from_fn(next).collect()
    }

    /// Waits until everything is current; returns the scenes that failed.
    pub fn idle(&mut self) -> Vec<PathBuf> {
        match self.wait("idle", |e| matches!(e, Event::Idle { .. })) {
            Event::Idle { failed, .. } => failed,
            other => panic!("{other:?}"),
        }
    }

    pub fn baked(&mut self, name: &str) {
        let wanted = self.at(name);
        self.wait("baked", |e| matches!(e, Event::Baked { scene, .. } if *scene == wanted));
    }

    /// Waits until all that has happened so far was looked at, and the bakes that follow from it have ended: a file is
    /// touched until it was told twice that it holds what it held.
    pub fn settle(&mut self, name: &str) {
        self.heed(name);
        let log = self.log.0.lock().unwrap();
        let (log, wait) = self.log.1.wait_timeout_while(log, LIMIT, |log| log.ended < self.told).unwrap();
        assert!(!wait.timed_out(), "{} of {} bakes have ended", log.ended, self.told);
    }

    /// Waits until all that has happened so far was looked at, and the first bake that follows from it has begun.
    pub fn heed(&mut self, name: &str) {
        let path = self.at(name);
        let begun = Instant::now();
        let mut times = 0;
        while times < 2 {
            assert!(begun.elapsed() < LIMIT, "nobody says that {name} was touched");
            touch(&path);
            // A touch together with a change of another file is no news, and one of a folder that is just being taken up
            // anew is not told.
            let is_news = |e: &Event| matches!(e, Event::Changed { .. } | Event::Found { .. });
            let is_touch = |e: &Event| matches!(e, Event::Unchanged { files, .. } if files.contains(&path));
            let heard = self.hear(Duration::from_secs(5), |e| is_news(e) || is_touch(e));
            times += usize::from(heard.is_ok_and(|event| is_touch(&event)));
        }
    }

    /// Bakes that have ended well so far.
    pub fn bakes(&self) -> usize {
        self.log.0.lock().unwrap().ended_well
    }

    /// Bakes that have begun so far.
    pub fn attempts(&self) -> usize {
        self.log.0.lock().unwrap().begun
    }

    /// Bakes wait from now on, or go on.
    pub fn shut(&self, shut: bool) {
        self.log.0.lock().unwrap().is_shut = shut;
        self.log.1.notify_all();
    }

    /// Bakes end well from now on even where they were cancelled.
    pub fn deafen(&self) {
        self.log.0.lock().unwrap().is_deaf = true;
    }

    /// Bakes write a draft first from now on.
    pub fn draft(&self) {
        self.log.0.lock().unwrap().drafts = true;
    }

    /// Waits until a bake has read its files and waits.
    pub fn held(&self) {
        let log = self.log.0.lock().unwrap();
        let (_log, wait) = self.log.1.wait_timeout_while(log, LIMIT, |log| !log.is_held).unwrap();
        assert!(!wait.timed_out(), "no bake has begun");
    }

    /// What lies in the outputs is what follows from the scene as it is.
    pub fn assert_current(&self, name: &str) {
        let scene = self.at(name);
        let output = scene.parent().unwrap().join("baked").join(scene.with_extension("glb").file_name().unwrap());
        let expected = light(&import::load(&scene, &ImportOptions::default()).unwrap());
        assert!(std::fs::read(output).unwrap() == expected, "the outputs of {name} are old");
    }

    /// Ends the watch; returns scenes that could not be baked, and the folder.
    pub fn end(self) -> (Vec<PathBuf>, TempDir) {
        self.stopper.stop();
        (self.thread.join().unwrap().failed, self.folder)
    }
}

/// Imports the scene as a bake does; its "light" is what was read.
fn bake(log: &(Mutex<Log>, Condvar), task: &Task) -> Result<Finished, luxel::Error> {
    log.0.lock().unwrap().begun += 1;
    let result = work(log, task);
    let mut state = log.0.lock().unwrap();
    state.ended += 1;
    state.ended_well += usize::from(result.is_ok());
    log.1.notify_all();
    result
}

fn work(log: &(Mutex<Log>, Condvar), task: &Task) -> Result<Finished, luxel::Error> {
    let scene = import::load(&task.request.scene, &ImportOptions::default())?;
    let mut state = log.0.lock().unwrap();
    if state.drafts {
        let glb = task.request.outputs.glb();
        luxel_export::write_atomic(&glb, b"draft")?;
        (task.drafted)(Done { outputs: vec![glb], ..Done::default() });
    }
    state.is_held = state.is_shut;
    log.1.notify_all();
    let is_cancelled = |log: &Log| !log.is_deaf && task.cancelled.load(Ordering::Relaxed);
    while state.is_shut && !is_cancelled(&state) {
        state = log.1.wait_timeout(state, Duration::from_millis(5)).unwrap().0;
    }
    state.is_held = false;
    if is_cancelled(&state) {
        return Err(luxel::Error::Cancelled);
    }
    drop(state);
    let glb = task.request.outputs.glb();
    luxel_export::write_atomic(&glb, &light(&scene))?;
    Ok(Finished { done: Done { outputs: vec![glb], ..Done::default() }, inputs: scene.inputs })
}

fn light(scene: &luxel_scene::Scene) -> Vec<u8> {
    scene.inputs.iter().flat_map(|i| i.digest).collect()
}

/// A new time, and the same content.
pub fn touch(path: &Path) {
    std::fs::File::options().append(true).open(path).unwrap().set_modified(std::time::SystemTime::now()).unwrap();
}

/// A triangle whose corners lie in `NAME.bin`, as text; `version` makes another file of it.
pub fn gltf(name: &str, version: usize) -> String {
    serde_json::json!({
        "asset": { "version": "2.0", "generator": format!("{version}") },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "min": [0, 0, 0], "max": [9, 9, 9] }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "uri": format!("{name}.bin"), "byteLength": 36 }],
    })
    .to_string()
}

/// The corners of that triangle.
pub fn corners(version: usize) -> Vec<u8> {
    [0.0, 0.0, 0.0, 1.0 + version as f32, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x: &f32| x.to_le_bytes()).collect()
}

/// Writes both files of a scene.
pub fn furnish(folder: &Path, name: &str) {
    let scene = folder.join(format!("{name}.gltf"));
    std::fs::create_dir_all(scene.parent().unwrap()).unwrap();
    let stem = Path::new(name).file_name().unwrap().to_str().unwrap();
    std::fs::write(scene.with_extension("bin"), corners(0)).unwrap();
    std::fs::write(scene, gltf(stem, 0)).unwrap();
}
