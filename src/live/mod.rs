//! A live page of baked levels: a small HTTP server on this machine, for a browser on this machine.
//!
//! Who bakes tells [`Live`] when files of a scene are in place; the page, which listens to server-sent events, fetches
//! what is new and shows it without being loaded again. The server knows nothing of baking and never writes.
//!
//! It listens at 127.0.0.1 alone, answers only who asks for that ([`http`]), and serves a fixed list: the page
//! ([`bundle`]) and the files that reports list ([`outputs`]). A dozen routes of GET need neither a framework nor an
//! async runtime: the standard library's sockets with a thread each, and `httparse` for what is easily got wrong.
//!
//! An event `scene` is a scene as it is now:
//!
//! | field | content |
//! |---|---|
//! | `scene` | its number in requests |
//! | `name`, `path` | of the scene file |
//! | `revision` | number of the change; higher is later |
//! | `status` | `state`: `waiting`, `baking`, `current`, `failed` (with `error` and `causes`), `removed` |
//! | `outputs` | null, or `glb` and `picture` (addresses), `lightmaps` \[{`page`, `texels`, `file`}\], `layout` and `content` (digests of the .glb, [`glb`]), `pending` (whether those are still to come) and `facts` from the report |
//!
//! An event `told` follows when everything that is known has been told.
//!
//! Whoever bakes waits for nothing here but the reading of a report. That there is a new lightmap is told first; the .glb
//! is looked into, and the lightmap decoded ([`decoded`]), on threads of their own meanwhile.

mod bundle;
mod decoded;
mod glb;
mod http;
mod outputs;
mod scenes;
mod server;
mod texels;

use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

use serde_json::{Value, json};

pub use bundle::{Bundle, NOT_BUILT};
use outputs::{Kind, Outputs};
use scenes::Shown;
use server::Shared;

use crate::watch::event::Event;

/// What a server is started with.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// 0: any that is free.
    pub port: u16,
    pub bundle: Bundle,
}

/// How a scene stands, beside its files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Status {
    /// Known, and nothing done yet.
    Waiting,
    Baking,
    /// The files show the scene as it is.
    Current,
    /// It cannot be baked as it is now; what is on show is the last that was baked of it, a draft perhaps.
    Failed {
        error: String,
        causes: Vec<String>,
    },
    /// The scene file has gone: nothing of it is served any more.
    Removed,
}

impl Status {
    fn to_json(&self) -> Value {
        match self {
            Self::Waiting => json!({ "state": "waiting" }),
            Self::Baking => json!({ "state": "baking" }),
            Self::Current => json!({ "state": "current" }),
            Self::Failed { error, causes } => json!({ "state": "failed", "error": error, "causes": causes }),
            Self::Removed => json!({ "state": "removed" }),
        }
    }
}

/// What can go wrong with a preview.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    #[error("cannot listen at 127.0.0.1:{port}; choose another --port, or 0 for any that is free")]
    Listen { port: u16, source: io::Error },
    #[error("cannot start the preview's server")]
    Start { source: io::Error },
    #[error("cannot show what a bake made: its report {path} cannot be read")]
    Report { path: PathBuf, source: io::Error },
}

/// A running server. Dropping it ends it.
#[derive(Debug)]
pub struct Live {
    address: SocketAddr,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
    digesting: Sender<Shown>,
    decoding: Sender<Shown>,
}

/// Decoded lightmaps are kept until nothing was written for so long.
const KEEP: Duration = Duration::from_secs(20);

impl Live {
    /// Listens at 127.0.0.1.
    ///
    /// # Errors
    /// The port is taken, or the system has no thread left.
    pub fn start(options: Options) -> Result<Self, LiveError> {
        let Options { port, bundle } = options;
        let failed = |source| LiveError::Listen { port, source };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let shared = Arc::new(Shared::new(address.port(), bundle));
        let own = Arc::clone(&shared);
        let accept = move || server::accept(&listener, &own);
        let accepting = std::thread::Builder::new().name("luxel preview".into()).spawn(accept);
        let accepting = Some(accepting.map_err(|source| LiveError::Start { source })?);
        let digesting = later(&shared, |shared, shown| {
            if shown.outputs.digests.is_none() {
                shared.scenes.digested(shown, shown.outputs.digest());
            }
        });
        let decoding = later(&shared, |shared, shown| {
            let lightmaps = shown.outputs.files.iter().filter(|f| matches!(f.kind, Kind::Lightmap(_)));
            for file in lightmaps.take_while(|_| shared.scenes.is_shown(shown)) {
                // What stands in the way is told to who asks for it.
                drop(shared.decoded.of(file));
            }
        });
        let failed = |source| LiveError::Start { source };
        Ok(Self {
            address,
            shared,
            accepting,
            digesting: digesting.map_err(failed)?,
            decoding: decoding.map_err(failed)?,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// What a person must do before there is anything to see; none where all is well.
    pub fn notice(&self) -> Option<&'static str> {
        (!self.shared.bundle.is_built()).then_some(NOT_BUILT)
    }

    /// All files of a bake of `scene` are in place, `report` among them (the last that a bake writes). Pages show them
    /// from now on. Also for outputs of an earlier run that are still current.
    ///
    /// # Errors
    /// The report cannot be read: pages go on showing what they show.
    pub fn changed(&self, scene: &Path, report: &Path) -> Result<(), LiveError> {
        self.show(scene, Outputs::read(report)?, Status::Current);
        Ok(())
    }

    /// Tells that these outputs are there, and makes ready what pages will ask for.
    fn show(&self, scene: &Path, outputs: Outputs, status: Status) {
        let shown = self.shared.scenes.show(scene, outputs, status);
        // Both threads stay as long as this server does.
        if shown.is_asked_for && self.shared.is_heard() {
            drop(self.decoding.send(shown.clone()));
        }
        drop(self.digesting.send(shown));
    }

    /// Shows what a watch tells of a scene; of other events nothing is to be seen.
    ///
    /// # Errors
    /// As [`Live::changed`].
    pub fn follow(&self, event: &Event) -> Result<(), LiveError> {
        match event {
            Event::Baked { scene, done } => self.done(scene, &done.outputs)?,
            Event::Current { scene, outputs } => self.done(scene, outputs)?,
            Event::Drafted { scene, done } => {
                // The bake goes on.
                if let Some(report) = done.outputs.last() {
                    self.show(scene, Outputs::read(report)?, Status::Baking);
                }
            }
            // An overtaken bake need not be followed by another one.
            Event::Found { scene } | Event::Overtaken { scene } => self.tell(scene, Status::Waiting),
            Event::Waiting { scene, outputs } => match outputs.last().map(|report| Outputs::read(report)) {
                Some(Ok(outputs)) if outputs.is_whole() => self.show(scene, outputs, Status::Waiting),
                // What an earlier run left behind is shown where it can be.
                _ => self.tell(scene, Status::Waiting),
            },
            Event::Baking { scene } => self.tell(scene, Status::Baking),
            Event::Idle { .. } => self.shared.scenes.rest(),
            Event::Removed { scene } => self.tell(scene, Status::Removed),
            Event::Failed { scene, fault, .. } => {
                self.tell(scene, Status::Failed { error: fault.error.clone(), causes: fault.causes.clone() });
            }
            // What follows from a change is told by the bake that it leads to.
            Event::Changed { .. }
            | Event::Moved { .. }
            | Event::Lost { .. }
            | Event::Unchanged { .. }
            | Event::Preview { .. }
            | Event::Watching { .. }
            | Event::Polling { .. }
            | Event::Unwatched { .. }
            | Event::Unshown { .. }
            | Event::Stopped { .. } => {}
        }
        Ok(())
    }

    /// A scene is what these outputs were made from; the last of them is the report.
    fn done(&self, scene: &Path, outputs: &[PathBuf]) -> Result<(), LiveError> {
        let shown = outputs.last().map(|report| self.changed(scene, report)).transpose();
        if !matches!(shown, Ok(Some(()))) {
            self.tell(scene, Status::Current);
        }
        shown.map(|_| ())
    }

    /// Something else about a scene is new.
    pub fn tell(&self, scene: &Path, status: Status) {
        self.shared.scenes.tell(scene, status);
    }
}

/// Does `work` with outputs that are sent, on a thread of its own, until nobody can send any more. Of a scene whose
/// outputs follow upon each other only the last ones count.
fn later(shared: &Arc<Shared>, work: fn(&Shared, &Shown)) -> io::Result<Sender<Shown>> {
    let (sender, receiver) = mpsc::channel::<Shown>();
    let shared = Arc::clone(shared);
    let go = move || {
        loop {
            let mut sent = BTreeMap::new();
            match receiver.recv_timeout(KEEP) {
                Ok(shown) => drop(sent.insert(shown.scene, shown)),
                Err(RecvTimeoutError::Timeout) => shared.decoded.forget(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
            sent.extend(receiver.try_iter().map(|shown| (shown.scene, shown)));
            sent.values().for_each(|shown| work(&shared, shown));
        }
    };
    std::thread::Builder::new().name("luxel preview".into()).spawn(go)?;
    Ok(sender)
}

impl Drop for Live {
    fn drop(&mut self) {
        self.shared.scenes.close();
        // The thread waits for a connection, so it gets one. Where none can be made it stays until the process ends.
        if TcpStream::connect_timeout(&self.address, Duration::from_secs(1)).is_ok()
            && let Some(accepting) = self.accepting.take()
        {
            // It has no result, and a panic of it was told when it happened.
            let _ = accepting.join();
        }
    }
}
