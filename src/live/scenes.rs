//! What is known of the scenes, and who waits for news of them.
//!
//! Every change gets the next number. A listener remembers the last number that it has told and is woken to tell each
//! scene whose number is higher: so nothing queues up behind a slow page, and what it gets is always the latest.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Value, json};

use super::Status;
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
    pub fn show(&self, path: &Path, outputs: Outputs, status: Status) {
        self.edit(path, |scene| {
            scene.outputs = Some(Arc::new(outputs));
            scene.status = status;
        });
    }

    pub fn tell(&self, path: &Path, status: Status) {
        self.edit(path, |scene| scene.status = status);
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

    /// The outputs of the scene with this number.
    pub fn outputs(&self, scene: usize) -> Option<Arc<Outputs>> {
        self.lock().scenes.get(scene)?.outputs.clone()
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
        let changed = numbered.filter(|(_, scene)| told.is_none_or(|told| scene.revision > told));
        News::Changes(changed.map(|(number, scene)| scene.to_json(number)).collect(), state.revision)
    }

    fn edit(&self, path: &Path, change: impl FnOnce(&mut Scene)) {
        let mut state = self.lock();
        state.revision += 1;
        let revision = state.revision;
        let place = state.scenes.iter().position(|scene| scene.path == path).unwrap_or_else(|| {
            state.scenes.push(Scene { path: path.into(), revision, status: Status::Waiting, outputs: None });
            state.scenes.len() - 1
        });
        if let Some(scene) = state.scenes.get_mut(place) {
            change(scene);
            scene.revision = revision;
        }
        drop(state);
        self.news.notify_all();
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
