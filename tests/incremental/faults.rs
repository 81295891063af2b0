//! Whatever is wrong in a store costs reuse alone: the bake ends well, its files have the right bytes, and the report
//! says what was made anew.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime};

use luxel::settings::{Layer, Origin, for_scene};
use luxel::store::{Kind, Store, StoreOptions};
use luxel::{Request, bake};
use luxel_export::OutputSet;
use luxel_scene::Progress;
use serde_json::json;

use crate::baked::{Baked, Place, Target, clean, run};
use crate::level::{Level, SCENE};
use crate::tool::{luxel, skip};

/// A level with an artefact of every kind, as small as it gets.
fn level() -> Level {
    let mut level = Level::new();
    level.nodes.retain(|n| n["name"] != "spot" && n["name"] != "panel");
    level.set("size", "16");
    level.set("voxels", "100");
    level.set("sky", "\"1,1,1\"");
    level.set("gather", "\"lightcuts\"");
    level
}

/// A baked level, the store that it left, and the smallest artefact of every kind in it.
struct Stored {
    place: Place,
    baked: Baked,
    smallest: Vec<(Kind, PathBuf)>,
}

impl Stored {
    fn new() -> Self {
        let place = Place::new();
        let baked = place.bake(&level());
        let store = place.at("baked/.luxel");
        let smallest: Vec<(Kind, PathBuf)> = Kind::BAKED
            .into_iter()
            .map(|kind| {
                let files = artefacts(&store.join(kind.name()));
                let smallest = files.into_iter().min_by_key(|path| (fs::metadata(path).unwrap().len(), path.clone()));
                (kind, smallest.unwrap_or_else(|| panic!("no artefact of {kind:?}")))
            })
            .collect();
        Self { place, baked, smallest }
    }

    /// Bakes with a store in which this file is the only one: it is asked for, and all others are missing. So whatever
    /// stands for later stages does not hide what is wrong with earlier ones.
    fn bake_alone(&self, path: &Path, spoil: impl FnOnce(&Path)) -> Baked {
        let store = self.place.at("alone");
        let _none = fs::remove_dir_all(&store);
        let copy = store.join(path.strip_prefix(self.place.at("baked/.luxel")).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::copy(path, &copy).unwrap();
        spoil(&copy);
        run(&self.place.at(SCENE), &Target::at(self.place.at("again")).with_store(&store))
    }
}

fn artefacts(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).map(|entries| entries.map(|e| e.unwrap().path()).collect());
    let mut files: Vec<PathBuf> = entries.unwrap_or_default();
    files.retain(|path| path.is_file() && !path.file_name().unwrap().as_encoded_bytes().starts_with(b"."));
    files.sort();
    files
}

/// Right bytes, one thing to complain of, and the file named.
fn is_told(found: &Baked, right: &Baked, what: &str, path: &Path) {
    assert!(found.files == right.files, "{what}: other bytes");
    let [warning] = found.warnings("store")[..] else { panic!("{what}: {:?}", found.warnings("store")) };
    let name = path.file_name().unwrap().to_str().unwrap();
    assert!(warning.contains(name), "{what}: {warning}");
}

/// Which artefacts of a kind stand for others is left to the bake: alone in a store each is asked for.
#[test]
fn every_kind_of_artefact_is_used_when_it_is_sound() {
    let stored = Stored::new();
    for (kind, path) in &stored.smallest {
        let baked = stored.bake_alone(path, |_| ());
        assert!(baked.files == stored.baked.files, "{kind:?}");
        assert_eq!(baked.warnings("store"), [""; 0], "{kind:?}");
    }
    assert_eq!(stored.smallest.len(), Kind::BAKED.len());
}

#[test]
fn flipped_bytes_are_noticed() {
    let stored = Stored::new();
    let mut flips = 0;
    for (kind, path) in &stored.smallest {
        let length = fs::metadata(path).unwrap().len() as usize;
        // Magic, version, length, checksum; then spots all over the body, its ends among them.
        let body = (1..=2).map(|i| 84 + (length - 85) * i / 2);
        for at in [0, 8, 44, 60, 84].into_iter().chain(body) {
            let baked = stored.bake_alone(path, |copy| {
                let mut bytes = fs::read(copy).unwrap();
                bytes[at] ^= 0x40;
                fs::write(copy, bytes).unwrap();
            });
            is_told(&baked, &stored.baked, &format!("{kind:?}, byte {at} of {length}"), path);
            flips += 1;
        }
    }
    println!("{flips} bytes flipped");
}

type Spoil = fn(&Path);

#[test]
fn torn_outdated_and_foreign_artefacts_are_noticed() {
    let stored = Stored::new();
    let cut = |path: &Path, length: usize| {
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..length.min(bytes.len() - 1)]).unwrap();
    };
    let folder: Spoil = |path| {
        fs::remove_file(path).unwrap();
        fs::create_dir_all(path.join("mine")).unwrap();
    };
    let outdated: Spoil = |path| {
        let mut bytes = fs::read(path).unwrap();
        bytes[8] = 0;
        fs::write(path, bytes).unwrap();
    };
    let longer: Spoil = |path| {
        let mut bytes = fs::read(path).unwrap();
        bytes.push(0);
        fs::write(path, bytes).unwrap();
    };
    for (kind, path) in &stored.smallest {
        for length in [0, 50, 84, usize::MAX] {
            let baked = stored.bake_alone(path, |copy| cut(copy, length));
            is_told(&baked, &stored.baked, &format!("{kind:?} cut to {length}"), path);
        }
        for (what, spoil) in [("of an older version", outdated), ("too long", longer)] {
            let baked = stored.bake_alone(path, spoil);
            is_told(&baked, &stored.baked, &format!("{kind:?} {what}"), path);
        }
        // A folder cannot be replaced by a file either, which is the second thing to say.
        let baked = stored.bake_alone(path, folder);
        assert!(baked.files == stored.baked.files, "{kind:?}");
        let said = baked.warnings("store");
        assert!(said.len() == 2 && said[0].contains("a folder") && said[1].contains("cannot be written"), "{said:?}");
    }
}

#[test]
fn an_artefact_under_another_key_is_noticed() {
    let stored = Stored::new();
    for (kind, path) in &stored.smallest {
        // Of the same kind where there are two, else of the next one: neither is what the name says.
        let own = path.parent().unwrap();
        let other = artefacts(own).into_iter().find(|other| other != path).unwrap_or_else(|| {
            let next = stored.smallest.iter().map(|(_, other)| other).find(|other| *other != path);
            next.unwrap().clone()
        });
        let baked = stored.bake_alone(path, |copy| assert!(fs::copy(&other, copy).unwrap() > 0));
        is_told(&baked, &stored.baked, &format!("{kind:?} from another key"), path);
    }
}

/// Nothing of what was spoilt stays so: the bake that noticed it has put the right thing in its place.
#[test]
fn what_was_spoilt_is_mended() {
    let place = Place::new();
    let first = place.bake(&level());
    let store = place.at("baked/.luxel");
    let mut spoilt = 0;
    for kind in Kind::BAKED {
        for path in artefacts(&store.join(kind.name())) {
            fs::write(path, "damage").unwrap();
            spoilt += 1;
        }
    }
    let second = place.bake(&level());
    assert!(second.files == first.files && !second.warnings("store").is_empty());
    let verified = Store::new(&store).verify(&luxel_scene::Silent).unwrap();
    assert!(verified.bad.is_empty() && verified.sound.files == spoilt, "{spoilt} spoilt: {verified:?}");
    let third = place.bake(&level());
    assert_eq!((third.ran().len(), third.warnings("store")), (4, vec![]));
}

/// The tool itself ends well, and tells it on the terminal too.
fn bakes_with(place: &Place, arguments: &[&str], right: &Baked, what: &str) {
    let run = luxel(&[&["bake", SCENE, "--out", "told"], arguments].concat(), place.folder.path()).ended(0);
    let baked = Baked::read(&place.at("told"));
    assert!(baked.files == right.files, "{what}");
    let [warning] = baked.warnings("store")[..] else { panic!("{what}: {:?}", baked.warnings("store")) };
    assert!(warning.contains("cannot be written"), "{what}: {warning}");
    assert!(run.stderr.contains("cannot be written"), "{what}: {}", run.stderr);
}

#[test]
fn a_file_in_the_place_of_the_store_costs_reuse_alone() {
    let place = Place::new();
    let right = clean(&level().write(place.folder.path()));
    fs::write(place.at("store"), "mine").unwrap();
    bakes_with(&place, &["--store", "store"], &right, "a file");
    assert_eq!(fs::read(place.at("store")).unwrap(), b"mine");
}

#[cfg(unix)]
#[test]
fn a_store_that_may_only_be_read_is_read_and_nothing_else() {
    use std::os::unix::fs::PermissionsExt;
    let place = Place::new();
    let scene = level().write(place.folder.path());
    let target = || Target::at(place.at("lit")).with_store(place.at("store"));
    let first = run(&scene, &target());
    let folders: Vec<PathBuf> =
        Kind::BAKED.iter().map(|k| place.at("store").join(k.name())).chain([place.at("store")]).collect();
    let set = |mode: u32| {
        folders.iter().for_each(|folder| fs::set_permissions(folder, fs::Permissions::from_mode(mode)).unwrap())
    };
    set(0o555);
    let binds = skip::is_bound(&place.at("store"));
    // Root is bound by permissions once it has given up its privileges.
    let bound = if binds { Some(Command::new("env")) } else { skip::unprivileged() };
    let Some(mut bound) = bound else {
        set(0o755);
        return skip::skipped("read-only folders do not bind this user; a file in the store's place stands for them");
    };
    bound.arg(env!("CARGO_BIN_EXE_luxel")).args(["bake", SCENE, "--out", "lit", "--store", "store", "--force"]);
    bound.current_dir(place.folder.path()).stdin(Stdio::null());
    let mut bake = || {
        let output = bound.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        Baked::read(&place.at("lit"))
    };
    let again = bake();
    let mut other = level();
    other.node("bulb")["translation"] = json!([0.0, 1.3, 0.2]);
    let right = clean(&other.write(place.folder.path()));
    let edited = bake();
    set(0o755);
    assert!(again.files == first.files && edited.files == right.files);
    assert_eq!(again.warnings("store"), [""; 0], "nothing had to be written");
    assert_eq!(edited.stage("surfels")["state"], "reused");
    let [warning] = edited.warnings("store")[..] else { panic!("{:?}", edited.warnings("store")) };
    assert!(warning.contains("cannot be written"), "{warning}");
}

/// On a disk of its own, which is mounted for the child alone and goes with it.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_costs_reuse_alone() {
    let place = Place::new();
    let right = clean(&level().write(place.folder.path()));
    fs::create_dir(place.at("disk")).unwrap();
    let Some(mut command) = skip::mounting() else { return skip::skipped("no file system can be mounted here") };
    // So small that some artefacts fit and some do not.
    let mount =
        "mount -t tmpfs -o size=24k luxel disk || exit 77; \"$0\" \"$@\"; code=$?; ls -R disk > left; exit $code";
    command.args(["sh", "-c", mount, env!("CARGO_BIN_EXE_luxel")]);
    command.args(["bake", SCENE, "--store", "disk/store"]).current_dir(place.folder.path());
    let output = command.stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let baked = Baked::read(&place.at("baked"));
    assert!(baked.files == right.files);
    let [warning] = baked.warnings("store")[..] else { panic!("{:?}", baked.warnings("store")) };
    assert!(warning.contains("cannot be written") && said.contains("cannot be written"), "{warning}\n{said}");
    let left = fs::read_to_string(place.at("left")).unwrap();
    assert!(left.contains("unwrap") && !left.contains(".tmp"), "{left}");
}

/// Stops a bake when a stage begins.
struct Until(&'static str, AtomicBool);

impl Progress for Until {
    fn begin(&self, stage: &'static str, _: u64) {
        self.1.fetch_or(stage == self.0, Ordering::Relaxed);
    }
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        self.1.load(Ordering::Relaxed)
    }
}

/// What is put into a store by a bake that does not end well is bounded by its cap too.
#[test]
fn a_bake_that_is_stopped_leaves_no_store_above_its_cap() {
    let place = Place::new();
    let scene = level().write(place.folder.path());
    let store = Store::new(place.at("store"));
    let used = |minutes: u64| SystemTime::now() - Duration::from_secs(60 * minutes);
    for number in 0..8 {
        store.put(Kind::Gather, &[number; 32], |out| out.write_all(&[number; 5000])).unwrap();
        let path = store.path(Kind::Gather, &[number; 32]);
        fs::File::options().write(true).open(path).unwrap().set_modified(used(600)).unwrap();
    }
    fs::create_dir(place.at("lit")).unwrap();
    fs::write(place.at("lit/.luxel-a.tmp"), "half a file").unwrap();
    let leftover = fs::File::options().write(true).open(place.at("lit/.luxel-a.tmp")).unwrap();
    leftover.set_modified(used(600)).unwrap();
    let request = Request {
        outputs: OutputSet::new(&scene, Some(&place.at("lit")), None).unwrap(),
        settings: for_scene(&scene, None, &Layer::new(Origin::CommandLine)).unwrap(),
        scene,
        worker: None,
        store: StoreOptions { folder: Some(place.at("store")), cap: Some(10_000) },
        kept: Default::default(),
    };
    let stopped = bake(&request, &Until("direct", AtomicBool::new(false)));
    assert!(matches!(stopped, Err(luxel::Error::Cancelled)), "{stopped:?}");
    let left = store.stat().unwrap();
    let old = (0..8).filter(|number| store.path(Kind::Gather, &[*number; 32]).exists()).count();
    assert!(old <= 2 && left.kinds.contains_key(&Kind::Layout), "{old} of {left:?}");
    assert!(!place.at("lit/.luxel-a.tmp").exists());
    assert_eq!(store.cap().unwrap(), 10_000, "the cap of a bake is that of its store");
}
