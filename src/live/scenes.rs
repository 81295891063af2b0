//! What is known of the scenes, and who waits for news of them.
//!
//! Every change gets the next number. A listener remembers the last number that it has told and is woken to tell each
//! scene whose number is higher: so nothing queues up behind a slow page, and what it gets is always the latest.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Value, json};

use super::Status;
use super::glb::Digests;
use super::outputs::Outputs;

/// All scenes, shared by everybody.
#[derive(Debug, Default)]
pub struct Scenes {
    state: Mutex<State>,
    news: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// Scenes keep their place for ever: it is what requests name them by.
    scenes: Vec<Scene>,
    revision: u64,
    closing: bool,
}

#[derive(Debug)]
struct Scene {
    path: PathBuf,
    /// Number of its last change.
    revision: u64,
    status: Status,
    outputs: Option<Arc<Outputs>>,
    /// Somebody has asked for its files.
    is_asked_for: bool,
}

/// Outputs that are on show from now on.
#[derive(Clone, Debug)]
pub struct Shown {
    pub scene: usize,
    pub outputs: Arc<Outputs>,
    /// Somebody has looked at this scene before.
    pub is_asked_for: bool,
}

/// What a listener is woken for.
#[derive(Debug, PartialEq)]
pub enum News {
    /// Scenes that changed, as JSON, and the number that is told with them.
    Changes(Vec<Value>, u64),
    /// Nothing for a while.
    Silence,
    Closing,
}

impl Scenes {
    /// Files of a scene are in place: all of a bake's, or a draft's while it goes on.
    pub fn show(&self, path: &Path, mut outputs: Outputs, status: Status) -> Shown {
        self.edit(path, |number, scene| {
            // The same files are looked into once.
            outputs.digests =
                scene.outputs.take().filter(|old| old.files == outputs.files).and_then(|old| old.digests.clone());
            let outputs = Arc::new(outputs);
            scene.outputs = Some(outputs.clone());
            scene.status = status;
            Shown { scene: number, outputs, is_asked_for: scene.is_asked_for }
        })
    }

    /// The .glb of these outputs was looked into. Nothing happens if others are on show by now.
    pub fn digested(&self, shown: &Shown, digests: Option<Digests>) {
        let mut state = self.lock();
        let revision = state.revision + 1;
        let Some(scene) = state.scenes.get_mut(shown.scene) else { return };
        if scene.outputs.as_ref().is_some_and(|now| Arc::ptr_eq(now, &shown.outputs)) {
            scene.outputs = Some(Arc::new(shown.outputs.digested(digests)));
            (scene.revision, state.revision) = (revision, revision);
            drop(state);
            self.news.notify_all();
        }
    }

    /// Of a scene that has gone nothing is served any more.
    pub fn tell(&self, path: &Path, status: Status) {
        self.edit(path, |_, scene| {
            scene.outputs.take_if(|_| status == Status::Removed);
            scene.status = status;
        });
    }

    /// Nothing is left to be done: what waits for a bake that does not come, or whose bake was stopped by a change that
    /// was taken back, is what its outputs show.
    pub fn rest(&self) {
        let mut state = self.lock();
        let revision = state.revision + 1;
        let pending = |scene: &&mut Scene| matches!(scene.status, Status::Waiting | Status::Baking);
        let mut rested = 0;
        for scene in state.scenes.iter_mut().filter(|s| s.outputs.is_some()).filter(pending) {
            (scene.status, scene.revision) = (Status::Current, revision);
            rested += 1;
        }
        if rested > 0 {
            state.revision = revision;
            drop(state);
            self.news.notify_all();
        }
    }

    pub fn close(&self) {
        self.lock().closing = true;
        self.news.notify_all();
    }

    pub fn is_closing(&self) -> bool {
        self.lock().closing
    }

    /// The outputs of the scene with this number, for who has asked for them.
    pub fn outputs(&self, scene: usize) -> Option<Arc<Outputs>> {
        let mut state = self.lock();
        let scene = state.scenes.get_mut(scene)?;
        scene.is_asked_for = true;
        scene.outputs.clone()
    }

    /// These outputs are on show.
    pub fn is_shown(&self, shown: &Shown) -> bool {
        let state = self.lock();
        let now = state.scenes.get(shown.scene).and_then(|scene| scene.outputs.as_ref());
        now.is_some_and(|now| now.files == shown.outputs.files)
    }

    /// Waits until something is newer than `told`; `None` has heard of nothing yet and is told at once how things are.
    pub fn wait(&self, told: Option<u64>, most: Duration) -> News {
        let is_old = |state: &mut State| told.is_some_and(|told| state.revision <= told) && !state.closing;
        let waited = self.news.wait_timeout_while(self.lock(), most, is_old);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if state.closing {
            return News::Closing;
        }
        if told.is_some_and(|told| state.revision <= told) {
            return News::Silence;
        }
        let numbered = state.scenes.iter().enumerate();
        // Who has heard of nothing need not hear of what has gone.
        let is_news = |scene: &Scene| match told {
            Some(told) => scene.revision > told,
            None => scene.status != Status::Removed,
        };
        let changed = numbered.filter(|(_, scene)| is_news(scene));
        News::Changes(changed.map(|(number, scene)| scene.to_json(number)).collect(), state.revision)
    }

    fn edit<T>(&self, path: &Path, change: impl FnOnce(usize, &mut Scene) -> T) -> T {
        let mut state = self.lock();
        state.revision += 1;
        let revision = state.revision;
        let place = state.scenes.iter().position(|scene| scene.path == path).unwrap_or_else(|| {
            let (path, status) = (path.into(), Status::Waiting);
            state.scenes.push(Scene { path, revision, status, outputs: None, is_asked_for: false });
            state.scenes.len() - 1
        });
        // It was just found or added.
        let scene = &mut state.scenes[place];
        let result = change(place, scene);
        scene.revision = revision;
        drop(state);
        self.news.notify_all();
        result
    }

    /// Every edit is whole before anything can panic, so a poisoned lock guards nothing broken.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Scene {
    fn to_json(&self, number: usize) -> Value {
        json!({
            "scene": number,
            "name": self.path.file_name().unwrap_or_default().to_string_lossy(),
            "path": self.path.display().to_string(),
            "revision": self.revision,
            "status": self.status.to_json(),
            "outputs": self.outputs.as_ref().map(|outputs| outputs.to_json(number)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_millis(20);

    #[test]
    fn a_listener_hears_the_latest_of_each_scene_once() {
        let scenes = Scenes::default();
        assert_eq!(scenes.wait(None, SHORT), News::Changes(Vec::new(), 0));
        assert_eq!(scenes.wait(Some(0), SHORT), News::Silence);
        let (a, b) = (Path::new("a.glb"), Path::new("b.glb"));
        scenes.tell(a, Status::Baking);
        scenes.tell(b, Status::Baking);
        scenes.tell(a, Status::Failed { error: "no".into(), causes: vec!["why".into()] });
        let News::Changes(changes, told) = scenes.wait(Some(0), SHORT) else { panic!() };
        let heard: Vec<_> = changes.iter().map(|c| (&c["scene"], &c["status"]["state"])).collect();
        assert_eq!(heard, [(&json!(0), &json!("failed")), (&json!(1), &json!("baking"))]);
        assert_eq!(scenes.wait(Some(told), SHORT), News::Silence);
        scenes.tell(b, Status::Current);
        let News::Changes(changes, _) = scenes.wait(Some(told), SHORT) else { panic!() };
        assert_eq!(changes.len(), 1);
        assert_eq!((&changes[0]["name"], &changes[0]["scene"]), (&json!("b.glb"), &json!(1)));
    }

    #[test]
    fn of_what_has_gone_only_those_hear_who_have_heard_of_it() {
        let scenes = Scenes::default();
        let (a, b) = (Path::new("a.glb"), Path::new("b.glb"));
        [a, b].iter().for_each(|scene| scenes.tell(scene, Status::Waiting));
        scenes.tell(a, Status::Removed);
        let states = |told: Option<u64>| match scenes.wait(told, SHORT) {
            News::Changes(changes, _) => changes.iter().map(|c| c["status"]["state"].to_string()).collect::<Vec<_>>(),
            other => panic!("{other:?}"),
        };
        assert_eq!(states(Some(2)), ["\"removed\""]);
        assert_eq!(states(None), ["\"waiting\""]);
    }

    #[test]
    fn who_waits_is_woken_by_a_change_and_by_the_end() {
        let scenes = Scenes::default();
        let long = Duration::from_secs(60);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| scenes.wait(Some(0), long));
            scenes.tell(Path::new("a.glb"), Status::Baking);
            assert!(matches!(waiting.join().unwrap(), News::Changes(_, 1)));
            let waiting = scope.spawn(|| scenes.wait(Some(1), long));
            scenes.close();
            assert_eq!(waiting.join().unwrap(), News::Closing);
        });
    }
}
