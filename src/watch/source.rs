//! Who tells of changes in folders: the operating system, or somebody who looks every so often.
//!
//! Folders are watched and never single files: a file that is saved by renaming another one over it is another file,
//! of which nobody would hear again. Each folder is watched by itself and not what lies below it, since outputs and
//! hidden folders do.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use notify::event::{AccessKind, AccessMode, Event, EventKind, ModifyKind};
use notify::{ErrorKind, RecommendedWatcher, RecursiveMode, Watcher};

use super::batch::Hint;
use super::poll::Poll;

/// Receives hints, on whatever thread they come.
pub type Teller = Arc<dyn Fn(Hint) + Send + Sync>;

/// How a folder is watched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Watched {
    /// Changes are told.
    Told,
    /// It is looked at every so often, for this reason.
    Polled(String),
    /// It is not there any more.
    Gone,
    /// Not at all, for this reason.
    Not(String),
}

/// Tells of changes in folders.
pub trait Source: Send {
    /// From now on tells what happens directly in a folder, given by its real path.
    fn watch(&mut self, folder: &Path) -> Watched;
    /// Tells no more of it.
    fn unwatch(&mut self, folder: &Path);
}

/// How often folders are looked at that nobody tells about, where the user does not say.
pub const POLL: Duration = Duration::from_secs(2);

/// The operating system where it can, polling where it cannot.
pub struct System {
    /// None where the user wants polling alone, or the system has nothing to offer.
    native: Result<RecommendedWatcher, String>,
    poll: Poll,
    /// The user wants polling alone, and need not be told of it.
    is_asked: bool,
}

impl System {
    /// Tells `teller`; looks every `interval` where it has to, or everywhere if `poll` asks for it.
    pub fn new(poll: Option<Duration>, teller: Teller) -> Self {
        let native = match poll {
            Some(_) => Err(String::new()),
            None => {
                let teller = teller.clone();
                let watcher = notify::recommended_watcher(move |event| hints(event, &*teller));
                watcher.map_err(|e| format!("the system does not tell of changes: {e}"))
            }
        };
        Self { native, poll: Poll::new(poll.unwrap_or(POLL), teller), is_asked: poll.is_some() }
    }
}

impl Source for System {
    fn watch(&mut self, folder: &Path) -> Watched {
        let told = match &mut self.native {
            Err(reason) => Err(reason.clone()),
            Ok(native) => match native.watch(folder, RecursiveMode::NonRecursive) {
                Ok(()) => match network(folder) {
                    // What other machines change there is not told.
                    Some(kind) => Err(format!("it is on a network drive ({kind})")),
                    None => Ok(()),
                },
                Err(error) if matches!(error.kind, ErrorKind::PathNotFound) => return Watched::Gone,
                Err(error) if matches!(error.kind, ErrorKind::MaxFilesWatch) => {
                    Err("the system watches no more folders for this user (fs.inotify.max_user_watches)".into())
                }
                Err(error) => Err(format!("the system does not tell of changes in it: {error}")),
            },
        };
        match told {
            Ok(()) => Watched::Told,
            Err(reason) => match self.poll.watch(folder) {
                Ok(()) if self.is_asked => Watched::Told,
                Ok(()) => Watched::Polled(reason),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => Watched::Gone,
                Err(error) => Watched::Not(error.to_string()),
            },
        }
    }

    fn unwatch(&mut self, folder: &Path) {
        self.poll.unwatch(folder);
        if let Ok(native) = &mut self.native {
            // It may have ended by itself with the folder.
            drop(native.unwatch(folder));
        }
    }
}

/// What an event of the system hints at.
fn hints(event: notify::Result<Event>, tell: &(dyn Fn(Hint) + Send + Sync)) {
    let event = match event {
        Ok(event) if event.need_rescan() => return tell(Hint::Everywhere),
        Ok(event) => event,
        // Whatever it was, something may have gone unheard.
        Err(_) => return tell(Hint::Everywhere),
    };
    let gone = match event.kind {
        // To read a file changes nothing; and that it was closed after writing says that it is whole.
        EventKind::Access(AccessKind::Close(AccessMode::Write)) => false,
        EventKind::Access(_) => return,
        EventKind::Remove(_) | EventKind::Modify(ModifyKind::Name(_)) => true,
        EventKind::Any | EventKind::Create(_) | EventKind::Modify(_) | EventKind::Other => false,
    };
    for path in event.paths {
        tell(Hint::At { path, gone });
    }
}

/// The kind of network drive that a folder is on, if it is on one.
#[cfg(target_os = "linux")]
fn network(folder: &Path) -> Option<&'static str> {
    let kind = rustix::fs::statfs(folder).ok()?.f_type as u32;
    REMOTE.iter().find(|(magic, _)| *magic == kind).map(|(_, name)| *name)
}

#[cfg(not(target_os = "linux"))]
fn network(_: &Path) -> Option<&'static str> {
    None
}

/// File systems whose files other machines change (Linux, statfs(2)). FUSE carries sshfs and shared folders of virtual
/// machines, and some local disks, which are looked at in vain then.
#[cfg(target_os = "linux")]
const REMOTE: [(u32, &str); 10] = [
    (0x6969, "NFS"),
    (0x517b, "SMB"),
    (0xff53_4d42, "CIFS"),
    (0xfe53_4d42, "SMB 2"),
    (0x6573_5546, "FUSE"),
    (0x0102_1997, "9P"),
    (0x5346_414f, "AFS"),
    (0x7375_7245, "Coda"),
    (0x00c3_6400, "Ceph"),
    (0x786f_4256, "VirtualBox"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use notify::event::{CreateKind, DataChange, Flag, MetadataKind, RemoveKind, RenameMode};
    use std::sync::Mutex;

    fn hinted(event: notify::Result<Event>) -> Vec<Hint> {
        let list = Mutex::new(Vec::new());
        hints(event, &|hint| list.lock().unwrap().push(hint));
        list.into_inner().unwrap()
    }

    #[test]
    fn reading_is_no_change_and_every_other_event_is() {
        let of = |kind| hinted(Ok(Event::new(kind).add_path("/a".into())));
        let at = |gone| vec![Hint::At { path: "/a".into(), gone }];
        for quiet in [AccessKind::Open(AccessMode::Any), AccessKind::Read, AccessKind::Close(AccessMode::Read)] {
            assert_eq!(of(EventKind::Access(quiet)), []);
        }
        assert_eq!(of(EventKind::Access(AccessKind::Close(AccessMode::Write))), at(false));
        assert_eq!(of(EventKind::Create(CreateKind::Folder)), at(false));
        assert_eq!(of(EventKind::Modify(ModifyKind::Data(DataChange::Any))), at(false));
        assert_eq!(of(EventKind::Modify(ModifyKind::Metadata(MetadataKind::Any))), at(false));
        assert_eq!(of(EventKind::Modify(ModifyKind::Name(RenameMode::From))), at(true));
        assert_eq!(of(EventKind::Remove(RemoveKind::Other)), at(true));
    }

    #[test]
    fn lost_events_are_a_reason_to_look_everywhere() {
        assert_eq!(hinted(Ok(Event::new(EventKind::Other).set_flag(Flag::Rescan))), [Hint::Everywhere]);
        assert_eq!(hinted(Err(notify::Error::generic("x"))), [Hint::Everywhere]);
    }

    #[test]
    fn a_missing_folder_is_gone_and_polling_that_was_asked_for_is_not_news() {
        let folder = tempfile::tempdir().unwrap();
        let teller: Teller = Arc::new(|_| {});
        for poll in [None, Some(POLL)] {
            let mut system = System::new(poll, teller.clone());
            assert_eq!(system.watch(&folder.path().join("none")), Watched::Gone);
            assert_eq!(system.watch(folder.path()), Watched::Told);
            system.unwatch(folder.path());
        }
        // A system that tells nothing is a reason to be told.
        let native = Err("nobody tells".to_owned());
        let mut system = System { native, poll: Poll::new(POLL, teller), is_asked: false };
        assert_eq!(system.watch(folder.path()), Watched::Polled("nobody tells".into()));
    }
}
