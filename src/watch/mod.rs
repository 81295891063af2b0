//! Bakes scenes again whenever what they follow from has changed.
//!
//! | module | what it does |
//! |---|---|
//! | `source` | tells that something may have changed: the operating system, or `poll`, which looks every so often |
//! | `batch` | waits until a burst of changes is over |
//! | `depend`, `digest` | what a bake follows from, by content: a `Look` |
//! | `book`, `item` | the scenes; which are to be baked follows from their looks |
//! | `folders` | which folders are watched |
//! | `place`, `stamp` | the real names of paths; what tells two files apart without reading them |
//! | `run` | the loop: one bake at a time, stopped when it is overtaken |
//! | [`event`] | what is told, in a documented form |
//!
//! Events of the file system are hints and nothing more: they say when to look, and what is seen decides. Folders are
//! armed before they are looked at, so what happens in between is hinted at. How a scene is baked is the [`Baker`]'s
//! affair: the tool's is [`crate::bake_drafted`], which writes a draft first where that is of use.

mod batch;
mod book;
mod depend;
mod digest;
pub mod event;
mod folders;
mod item;
mod place;
mod poll;
mod run;
mod source;
mod stamp;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::Duration;

use luxel_scene::InputFile;

use crate::store::StoreOptions;
use crate::{Baked, Error, Request};
pub use batch::Hint;
pub use depend::Choices;
use event::{Done, Event};
use source::System;
pub use source::{Source, Teller, Watched};

/// What to watch, and how its scenes are baked.
#[derive(Clone, Debug)]
pub struct Options {
    /// Scenes, and folders (true) to search for them.
    pub paths: Vec<(PathBuf, bool)>,
    /// Folder for the outputs, as for a bake.
    pub out: Option<PathBuf>,
    pub choices: Choices,
    /// As in a [`Request`].
    pub worker: Option<PathBuf>,
    /// As in a [`Request`].
    pub store: StoreOptions,
}

impl Options {
    /// Tells files from folders.
    ///
    /// # Errors
    /// A path that does not exist: what is to be watched has to be there once, so that it is known what it is.
    pub fn paths(paths: &[PathBuf]) -> Result<Vec<(PathBuf, bool)>, crate::discover::DiscoverError> {
        let kind = |path: &PathBuf| match std::fs::metadata(path) {
            Ok(meta) => Ok((path.clone(), meta.is_dir())),
            Err(_) => Err(crate::discover::DiscoverError::Missing(path.clone())),
        };
        paths.iter().map(kind).collect()
    }
}

/// One bake that a watch asks for.
pub struct Task<'a> {
    pub request: &'a Request,
    /// True once the bake is no longer wanted.
    pub cancelled: &'a Arc<AtomicBool>,
    /// To be told when a draft lies where the outputs go. From then on the scene counts as one that was never baked,
    /// until the bake ends well.
    pub drafted: &'a (dyn Fn(Done) + Sync),
}

/// A bake that ended well.
#[derive(Clone, Debug, Default)]
pub struct Finished {
    pub done: Done,
    /// Every file that was read, with the digest of its bytes: what the scene is watched by from then on.
    pub inputs: Vec<InputFile>,
}

impl From<Baked> for Finished {
    fn from(baked: Baked) -> Self {
        let inputs = baked.inputs.clone();
        Self { done: baked.into(), inputs }
    }
}

impl From<Baked> for Done {
    fn from(baked: Baked) -> Self {
        let Baked { report, files, seconds, .. } = baked;
        Self { seconds, outputs: files, quality: report.quality, warnings: report.warnings }
    }
}

/// Bakes a scene: any function of a task.
pub trait Baker: Sync {
    /// # Errors
    /// [`Error::Cancelled`] soon after the task was; whatever else stands in the way. The scene's outputs are then
    /// what they were, and no temporary file is left.
    fn bake(&self, task: &Task) -> Result<Finished, Error>;
}

impl<F: Fn(&Task) -> Result<Finished, Error> + Sync> Baker for F {
    fn bake(&self, task: &Task) -> Result<Finished, Error> {
        self(task)
    }
}

/// How a watch ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ending {
    /// Scenes that could not be baked as they were at the end.
    pub failed: Vec<PathBuf>,
}

enum Message {
    Hint(Hint),
    /// The running bake has written a draft.
    Drafted(Done),
    /// The running bake has ended.
    Ended(Result<Finished, Error>),
    Stop,
}

/// A watch that has not begun yet.
pub struct Watch {
    options: Options,
    /// Between looks at folders of which nobody tells.
    interval: Duration,
    source: Box<dyn Source>,
    sender: Sender<Message>,
    receiver: Receiver<Message>,
    /// Nothing large is read any more.
    ending: Arc<AtomicBool>,
}

/// Ends a watch, from any thread.
#[derive(Clone)]
pub struct Stopper(Sender<Message>, Arc<AtomicBool>);

impl Stopper {
    /// Stops the running bake, and then the watch.
    pub fn stop(&self) {
        // The watch may be reading a large file, and hears of nothing before it has.
        self.1.store(true, Ordering::Relaxed);
        // There is nobody to stop where nobody receives.
        drop(self.0.send(Message::Stop));
    }
}

impl Watch {
    /// Watches as the system can, or by looking every `poll`.
    pub fn new(options: Options, poll: Option<Duration>) -> Self {
        let interval = poll.unwrap_or(source::POLL);
        Self::with_source(options, interval, |teller| Box::new(System::new(poll, teller)))
    }

    /// Watches with a source of one's own, which may tell from any thread.
    pub fn with_source(options: Options, interval: Duration, source: impl FnOnce(Teller) -> Box<dyn Source>) -> Self {
        let (sender, receiver) = mpsc::channel();
        let told = sender.clone();
        // After the end there is nobody to tell.
        let source = source(Arc::new(move |hint| drop(told.send(Message::Hint(hint)))));
        Self { options, interval, source, sender, receiver, ending: Arc::default() }
    }

    pub fn stopper(&self) -> Stopper {
        Stopper(self.sender.clone(), self.ending.clone())
    }

    /// Bakes what is there, and again whatever changes, until it is stopped. `tell` hears everything, in order, on this
    /// thread.
    pub fn run(self, baker: &dyn Baker, tell: &mut dyn FnMut(Event)) -> Ending {
        run::run(self, baker, tell)
    }
}
