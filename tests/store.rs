//! The store of artefacts under every fault that a disk, a neighbour or a power cut can bring: what is read is right or
//! a miss, what is wrong is told once, nothing is lost.
//!
//! Some tests run themselves again as child processes, told by the environment what to do.

#[path = "tool/skip.rs"]
mod skip;

use std::ffi::OsString;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime};

use luxel::store::{Key, Kind, LEFTOVER_AGE, Reader, Store};
use luxel_scene::Silent;

const KIND: Kind = Kind::Solution;
const BODY: &[u8] = b"irradiance at every surfel";

fn bytes(body: &mut Reader) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    body.read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

fn get(store: &Store, key: &Key) -> Option<Vec<u8>> {
    store.get(KIND, key, bytes)
}

fn put(store: &Store, key: &Key, body: &[u8]) -> Option<u64> {
    store.put(KIND, key, |out| out.write_all(body))
}

fn key(number: u64) -> Key {
    *blake3::hash(&number.to_le_bytes()).as_bytes()
}

/// What is stored under a number: other bytes and another length for each.
fn body_of(number: u64) -> Vec<u8> {
    let mut bytes = vec![0; 20_000 + 7919 * (number as usize % 16)];
    blake3::Hasher::new().update(&number.to_le_bytes()).finalize_xof().fill(&mut bytes);
    bytes
}

/// The names below a store's folder that are neither artefacts nor folders.
fn litter(folder: &Path) -> Vec<PathBuf> {
    let mut names = Vec::new();
    for kind in fs::read_dir(folder).into_iter().flatten() {
        let kind = kind.unwrap().path();
        let files = fs::read_dir(&kind).into_iter().flatten().map(|entry| entry.unwrap().path());
        names.extend(files.filter(|path| path.file_name().unwrap().len() != 64));
        names.extend((!kind.is_dir()).then_some(kind));
    }
    names
}

/// A child that runs one test of this file again, in its role.
fn child(test: &str, folder: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args([test, "--exact", "--nocapture"]).env("LUXEL_STORE_FOLDER", folder);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// The folder of a child's role.
fn role() -> Option<OsString> {
    std::env::var_os("LUXEL_STORE_FOLDER")
}

/// Waits for a child that must end well; returns what it said.
fn ended_well(child: Child) -> String {
    let output = child.wait_with_output().unwrap();
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (said(&output.stdout), said(&output.stderr));
    assert!(output.status.success(), "{}\n{out}\n{err}", output.status);
    out
}

/// Spoils a stored artefact in one way, and sees that it is told once, read as a miss, and mended by the next put.
fn faulty(spoil: impl FnOnce(&Path), reason: &str) {
    let folder = tempfile::tempdir().unwrap();
    let (store, key) = (Store::new(folder.path()), key(1));
    put(&store, &key, BODY).unwrap();
    spoil(&store.path(KIND, &key));
    assert!(!store.has(KIND, &key), "{reason}");
    assert_eq!(store.take_notes(), [""; 0], "having a look tells nothing");
    for _ in 0..2 {
        assert_eq!(get(&store, &key), None, "{reason}");
    }
    let notes = store.take_notes();
    assert_eq!(notes.len(), 1, "{notes:?}");
    let name = store.path(KIND, &key).display().to_string();
    assert!(notes[0].contains(&name) && notes[0].contains("made anew") && notes[0].contains(reason), "{}", notes[0]);
    assert_eq!(put(&store, &key, BODY), Some(BODY.len() as u64));
    assert_eq!(get(&store, &key).unwrap(), BODY);
    assert_eq!(store.take_notes(), [""; 0]);
}

#[test]
fn every_flipped_byte_and_every_cut_is_a_miss_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let key = key(1);
    let path = Store::new(folder.path()).path(KIND, &key);
    put(&Store::new(folder.path()), &key, BODY).unwrap();
    let whole = fs::read(&path).unwrap();
    let flipped = (0..whole.len()).map(|at| {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        bytes
    });
    let cut = (0..whole.len()).map(|length| whole[..length].to_vec());
    let longer = std::iter::once([&whole[..], b"!"].concat());
    for (i, bytes) in flipped.chain(cut).chain(longer).enumerate() {
        fs::write(&path, bytes).unwrap();
        let store = Store::new(folder.path());
        assert!(!store.has(KIND, &key) && get(&store, &key).is_none(), "fault {i}");
        let notes = store.take_notes();
        assert!(notes.len() == 1 && notes[0].contains("made anew"), "fault {i}: {notes:?}");
    }
    let store = Store::new(folder.path());
    put(&store, &key, BODY).unwrap();
    assert_eq!(get(&store, &key).unwrap(), BODY);
    assert_eq!(fs::read(&path).unwrap(), whole);
}

#[test]
fn what_is_not_the_artefact_is_a_miss_that_is_told() {
    let patch = |at: usize, byte: u8| {
        move |path: &Path| {
            let mut bytes = fs::read(path).unwrap();
            bytes[at] = byte;
            fs::write(path, bytes).unwrap();
        }
    };
    let version = KIND.format().version as u8;
    faulty(patch(8, version - 1), &format!("format version {}", version - 1));
    faulty(patch(8, version + 1), &format!("format version {}", version + 1));
    faulty(|path| fs::write(path, "").unwrap(), "torn");
    faulty(|path| fs::write(path, [7; 500]).unwrap(), "no luxel file");
    let another = |kind: Kind, number: u64| {
        move |path: &Path| {
            let store = Store::new(path.ancestors().nth(2).unwrap());
            store.put(kind, &key(number), |out| out.write_all(BODY)).unwrap();
            fs::rename(store.path(kind, &key(number)), path).unwrap();
        }
    };
    faulty(another(KIND, 2), "other input");
    faulty(another(Kind::Sky, 1), "no luxel file of this kind");
}

#[test]
fn a_folder_in_the_place_of_an_artefact_costs_its_reuse_alone() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path());
    fs::create_dir_all(store.path(KIND, &key(1)).join("mine")).unwrap();
    assert_eq!(get(&store, &key(1)), None);
    assert_eq!(put(&store, &key(1), BODY), None);
    let notes = store.take_notes();
    assert!(notes.len() == 2 && notes[0].contains("a folder") && notes[1].contains("cannot be written"), "{notes:?}");
    assert!(put(&store, &key(2), BODY).is_some() && get(&store, &key(2)).is_some());
    store.evict();
    assert!(store.take_notes().is_empty() && store.path(KIND, &key(1)).join("mine").exists());
    assert_eq!(litter(folder.path()), Vec::<PathBuf>::new());
}

/// As in a read-only folder, but for every user.
#[test]
fn a_file_in_the_place_of_the_folder_costs_reuse_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join(".luxel");
    fs::write(&at, "mine").unwrap();
    let store = Store::new(&at);
    for number in 0..5 {
        assert!(!store.has(KIND, &key(number)));
        assert_eq!(get(&store, &key(number)), None);
        assert_eq!(put(&store, &key(number), BODY), None);
    }
    store.evict();
    let notes = store.take_notes();
    assert!(notes.len() == 1 && notes[0].ends_with("(4 more likewise)"), "{notes:?}");
    assert_eq!(fs::read(&at).unwrap(), b"mine");
}

#[cfg(unix)]
#[test]
fn a_read_only_store_is_read_and_nothing_else() {
    use std::os::unix::fs::PermissionsExt;
    let name = "a_read_only_store_is_read_and_nothing_else";
    if let Some(folder) = role() {
        return read_only(Path::new(&folder));
    }
    let folder = tempfile::tempdir().unwrap();
    put(&Store::new(folder.path()), &key(1), BODY).unwrap();
    let folders = [folder.path().join(KIND.name()), folder.path().into()];
    let set =
        |mode: u32| folders.iter().for_each(|f| fs::set_permissions(f, fs::Permissions::from_mode(mode)).unwrap());
    set(0o555);
    let binds = skip::is_bound(&folders[0]);
    // Root is bound by permissions once it has given up its privileges.
    let bound = if binds { Some(Command::new("env")) } else { skip::unprivileged() };
    let Some(mut bound) = bound else {
        set(0o755);
        return skip::skipped("read-only folders do not bind this user; a file in the folder's place stands for them");
    };
    bound.arg(std::env::current_exe().unwrap()).args([name, "--exact", "--nocapture"]);
    bound.env("LUXEL_STORE_FOLDER", folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let said = ended_well(bound.spawn().unwrap());
    set(0o755);
    assert!(said.contains("only read"), "{said}");
}

/// Uses a store that may only be read.
#[cfg(unix)]
fn read_only(folder: &Path) {
    assert!(fs::write(folder.join(KIND.name()).join("probe"), "x").is_err(), "permissions bind");
    let store = Store::new(folder).with_cap(u64::MAX);
    assert_eq!((get(&store, &key(1)).unwrap(), put(&store, &key(2), BODY)), (BODY.to_vec(), None));
    store.evict();
    let notes = store.take_notes();
    assert!(notes.len() == 1 && notes[0].contains("cannot be written"), "{notes:?}");
    let store = Store::new(folder).with_cap(1);
    assert!(store.keep_cap().is_err() && Store::new(folder).kept_cap().unwrap().is_none());
    store.evict();
    let notes = store.take_notes();
    assert!(notes.len() == 1 && notes[0].contains("cannot be kept below its cap"), "{notes:?}");
    println!("only read");
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_an_artefact_keeps_nobody_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path());
    let path = store.path(KIND, &key(1));
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    if !Command::new("mkfifo").arg(&path).status().is_ok_and(|status| status.success()) {
        return skip::skipped("no pipe can be made here");
    }
    assert!(!store.has(KIND, &key(1)) && get(&store, &key(1)).is_none());
    assert_eq!(store.verify(&Silent).unwrap().bad.len(), 1);
    assert_eq!(store.take_notes().len(), 1);
    assert!(put(&store, &key(1), BODY).is_some() && get(&store, &key(1)).unwrap() == BODY);
}

/// Fills a store until nothing more fits, and on: what was there stays, what is smaller still goes in.
fn fill_up(folder: &Path, large: usize) {
    let store = Store::new(folder);
    assert!(put(&store, &key(1), BODY).is_some() && put(&store, &key(2), BODY).is_some());
    for number in [2, 3] {
        assert_eq!(put(&store, &key(number), &vec![1; large]), None);
    }
    let notes = store.take_notes();
    assert!(notes.len() == 1 && notes[0].contains("cannot be written") && notes[0].contains("(1 more"), "{notes:?}");
    assert_eq!(litter(folder), Vec::<PathBuf>::new());
    assert!(put(&store, &key(4), BODY).is_some());
    for (number, is_there) in [(1, true), (2, true), (3, false), (4, true)] {
        assert_eq!(get(&store, &key(number)).as_deref(), is_there.then_some(BODY));
    }
    store.evict();
    assert_eq!(store.take_notes(), [""; 0]);
    println!("filled up");
}

#[cfg(unix)]
#[test]
fn a_limit_on_file_sizes_costs_reuse_alone() {
    use rustix::process::{Resource, Rlimit, Signal, setrlimit};
    const MOST: u64 = 100_000;
    if let Some(folder) = role() {
        let heard = std::sync::Arc::default();
        signal_hook::flag::register(Signal::XFSZ.as_raw(), heard).unwrap();
        setrlimit(Resource::Fsize, Rlimit { current: Some(MOST), maximum: Some(MOST) }).unwrap();
        return fill_up(Path::new(&folder), 2 * MOST as usize);
    }
    let folder = tempfile::tempdir().unwrap();
    let said = ended_well(child("a_limit_on_file_sizes_costs_reuse_alone", folder.path()).spawn().unwrap());
    assert!(said.contains("filled up"), "{said}");
}

/// On a disk of its own, which is mounted for the child alone and goes with it.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_costs_reuse_alone() {
    if let Some(folder) = role() {
        return fill_up(Path::new(&folder), 2 << 20);
    }
    let folder = tempfile::tempdir().unwrap();
    let mount = "mount -t tmpfs -o size=256k luxel \"$LUXEL_STORE_FOLDER\" || exit 77; exec \"$0\" \"$@\"";
    let Some(mut command) = skip::mounting() else { return skip::skipped("no file system can be mounted here") };
    command.args(["sh", "-c", mount]).arg(std::env::current_exe().unwrap());
    command.args(["a_full_disk_costs_reuse_alone", "--exact", "--nocapture"]);
    command.env("LUXEL_STORE_FOLDER", folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let said = ended_well(command.spawn().unwrap());
    assert!(said.contains("filled up"), "{said}");
}

/// Looks for artefacts and makes those that are missing, as bakes do; says how often which was so.
fn use_together(folder: &Path, rounds: u64, seed: u64) -> (u64, u64) {
    const KEYS: u64 = 24;
    let (mut hits, mut misses, mut state) = (0, 0, seed);
    for _ in 0..rounds {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let number = (state >> 33) % KEYS;
        let store = Store::new(folder);
        match get(&store, &key(number)) {
            Some(found) => {
                assert!(found == body_of(number), "the content of another key, or a mixture");
                hits += 1;
                // Now and then somebody writes what another one reads.
                if state >> 60 == 0 {
                    put(&store, &key(number), &body_of(number)).expect("room for it");
                }
            }
            None => {
                put(&store, &key(number), &body_of(number)).expect("room for it");
                misses += 1;
            }
        }
        assert_eq!(store.take_notes(), [""; 0], "nobody else's work is a fault");
    }
    (hits, misses)
}

#[test]
fn processes_and_threads_share_a_store_while_others_evict() {
    const ROUNDS: u64 = 2000;
    let name = "processes_and_threads_share_a_store_while_others_evict";
    if let Some(folder) = role() {
        let (hits, misses) = use_together(Path::new(&folder), ROUNDS, u64::from(std::process::id()));
        return println!("hits {hits} misses {misses} end");
    }
    let folder = tempfile::tempdir().unwrap();
    let children: Vec<Child> = (0..2).map(|_| child(name, folder.path()).spawn().unwrap()).collect();
    let mut evicted = 0;
    let sums: Vec<(u64, u64)> = std::thread::scope(|scope| {
        let at = folder.path();
        let threads = [1, 2].map(|seed| scope.spawn(move || use_together(at, ROUNDS, seed)));
        // About half of what the keys hold stays; every other time by a rule that spares nothing young.
        while !threads.iter().all(|thread| thread.is_finished()) {
            let store = Store::new(at).with_cap(500_000);
            store.evict();
            assert_eq!(store.take_notes(), [""; 0]);
            let done = store.gc(1_000_000, None, &Silent).unwrap();
            assert!(done.bad.files == 0 && done.failed.is_empty(), "{done:?}");
            evicted += done.evicted.files;
            std::thread::sleep(Duration::from_millis(2));
        }
        threads.map(|thread| thread.join().unwrap()).into()
    });
    let mut told = sums.iter().map(|(h, m)| format!("hits {h} misses {m}")).collect::<Vec<_>>();
    told.extend(children.into_iter().map(ended_well));
    println!("{told:?}, evicted by gc {evicted}");
    for (hits, misses) in sums {
        assert!(hits + misses == ROUNDS && hits > 20 && misses > 20, "{hits} hits, {misses} misses");
    }
    let verified = Store::new(folder.path()).verify(&Silent).unwrap();
    assert!(verified.bad.is_empty() && verified.sound.files > 0, "{verified:?}");
    assert_eq!(litter(folder.path()), Vec::<PathBuf>::new());
}

#[test]
fn killed_writers_leave_nothing_torn_and_what_they_leave_is_cleaned() {
    let name = "killed_writers_leave_nothing_torn_and_what_they_leave_is_cleaned";
    if let Some(folder) = role() {
        let store = Store::new(&folder);
        for round in 0.. {
            let body = body_of(round % 8);
            let slowly = |out: &mut luxel::store::Writer| body.chunks(100).try_for_each(|part| out.write_all(part));
            store.put(KIND, &key(round % 8), slowly).unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path());
    let (mut kills, mut state) = (0, 1u64);
    // Enough deaths, some of them in the middle of a file.
    while kills < 40 || (litter(folder.path()).len() < 2 && kills < 400) {
        let mut writer = child(name, folder.path()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(Duration::from_micros(2_000 + (state >> 33) % 20_000));
        writer.kill().unwrap();
        assert!(!writer.wait().unwrap().success());
        kills += 1;
        let verified = store.verify(&Silent).unwrap();
        assert!(verified.bad.is_empty() && verified.outdated.is_empty(), "{verified:?}");
    }
    let stored =
        (0..8).filter(|number| get(&store, &key(*number)).is_some_and(|body| body == body_of(*number))).count();
    assert_eq!(stored as u64, store.stat().unwrap().total.files);
    let left = litter(folder.path());
    println!("{kills} killed, {stored} artefacts whole, {} temporary files left", left.len());
    assert!(left.len() >= 2 && stored > 0);
    let old = SystemTime::now() - LEFTOVER_AGE - Duration::from_secs(60);
    for path in &left[1..] {
        fs::File::options().write(true).open(path).unwrap().set_modified(old).unwrap();
    }
    assert_eq!(store.gc(u64::MAX, None, &Silent).unwrap().leftovers.files, left.len() as u64 - 1);
    assert_eq!(litter(folder.path()), left[..1], "somebody may still be writing the young one");
    assert_eq!(store.stat().unwrap().total.files, stored as u64);
}

fn luxel(args: &[&str], at: &Path) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_luxel")).args(args).current_dir(at).output().unwrap();
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), said(&output.stdout), said(&output.stderr))
}

fn events(text: &str) -> Vec<serde_json::Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn the_tool_counts_verifies_and_cleans_stores() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("level.glb"), "").unwrap();
    let (code, out, err) = luxel(&["cache", "stat"], folder.path());
    assert!(code == Some(0) && out.is_empty() && err.contains("no store"), "{code:?} {out} {err}");
    let stores = [at("baked/.luxel"), at("more/baked/.luxel")].map(Store::new);
    for (i, store) in stores.iter().enumerate() {
        for number in 0..3 {
            put(store, &key(number), BODY).unwrap();
        }
        store.put(Kind::Sky, &key(i as u64), |out| out.write_all(b"blue")).unwrap();
    }
    let (code, out, _) = luxel(&["cache", "stat", "--json"], folder.path());
    let told = events(&out);
    let names: Vec<&str> = told.iter().filter_map(|event| event["event"].as_str()).collect();
    assert_eq!((code, &names[..]), (Some(0), &["stat", "stat", "done"][..]));
    assert_eq!((&told[0]["total"]["files"], &told[0]["kinds"]["solution"]["files"]), (&4.into(), &3.into()));
    assert!(told[0]["kinds"]["sky"]["newest"].as_u64().is_some());
    let (_, out, _) = luxel(&["cache", "stat", "level.glb"], folder.path());
    assert!(out.contains("solution") && out.contains("total") && !out.contains("more"), "{out}");

    assert_eq!(luxel(&["cache", "verify"], folder.path()).0, Some(0));
    fs::write(stores[1].path(KIND, &key(2)), "damage").unwrap();
    let (code, _, err) = luxel(&["cache", "verify"], folder.path());
    assert!(code == Some(1) && err.contains("torn") && err.contains("gc"), "{code:?} {err}");
    let (code, out, _) = luxel(&["cache", "verify", "--json"], folder.path());
    let told = events(&out);
    assert_eq!((code, &told[1]["event"], &told[2]["bad"]), (Some(1), &"bad".into(), &1.into()));
    assert_eq!(luxel(&["cache", "verify", "level.glb"], folder.path()).0, Some(0), "another store's damage");

    let (code, out, _) = luxel(&["cache", "gc", "--older", "1h", "--json"], folder.path());
    let told = events(&out);
    assert_eq!((code, &told[1]["bad"]["files"], &told[1]["left"]["files"]), (Some(0), &1.into(), &3.into()));
    assert_eq!(luxel(&["cache", "verify"], folder.path()).0, Some(0));
    let store = at("more/baked/.luxel");
    let (code, _, err) = luxel(&["cache", "gc", "--cap", "0", "--store", store.to_str().unwrap()], Path::new("/"));
    assert!(code == Some(0) && err.contains("removed 3 unused"), "{err}");
    assert_eq!(stores.map(|store| store.stat().unwrap().total.files), [4, 0]);

    for wrong in [
        &["cache"][..],
        &["cache", "gc", "--cap", "much"],
        &["cache", "stat", "nowhere"],
        &["cache", "gc", "--store", "nowhere"],
    ] {
        let (code, out, err) = luxel(wrong, folder.path());
        assert!(code == Some(2) && out.is_empty() && !err.is_empty(), "{wrong:?}: {code:?} {out} {err}");
    }
    let (code, out, _) = luxel(&["cache", "stat", "nowhere", "--json"], folder.path());
    assert_eq!((code, &events(&out)[0]["event"]), (Some(2), &"usage".into()));
}

#[test]
fn the_cap_belongs_to_the_store() {
    let folder = tempfile::tempdir().unwrap();
    let shared = folder.path().join("shared");
    for number in 0..4 {
        put(&Store::new(&shared), &key(number), BODY).unwrap();
        let path = Store::new(&shared).path(KIND, &key(number));
        let then = SystemTime::now() - Duration::from_secs(86_400);
        fs::File::options().write(true).open(path).unwrap().set_modified(then).unwrap();
    }
    let files = || Store::new(&shared).stat().unwrap().total.files;
    let stat = || events(&luxel(&["cache", "stat", "--store", "shared", "--json"], folder.path()).1).remove(0);
    assert_eq!((&stat()["cap"], &stat()["kept"]), (&luxel::store::DEFAULT_CAP.into(), &false.into()));
    // As somebody had it: the file is what is kept, and gc without a cap goes by it.
    fs::write(shared.join(luxel::store::CAP_FILE), "250\n").unwrap();
    assert_eq!((&stat()["cap"], &stat()["kept"]), (&250.into(), &true.into()));
    assert_eq!(luxel(&["cache", "gc", "--store", "shared"], folder.path()).0, Some(0));
    assert_eq!(files(), 2);
    assert_eq!(luxel(&["cache", "gc", "--store", "shared", "--cap", "50GiB"], folder.path()).0, Some(0));
    assert_eq!(stat()["cap"], 50u64 << 30);
    assert_eq!(luxel(&["cache", "gc", "--store", "shared", "--cap", "0"], folder.path()).0, Some(0));
    assert_eq!((files(), stat()["cap"].as_u64()), (0, Some(50 << 30)), "it was emptied and not closed");
    fs::write(shared.join(luxel::store::CAP_FILE), "much").unwrap();
    let (code, _, err) = luxel(&["cache", "gc", "--store", "shared"], folder.path());
    assert!(code == Some(1) && err.contains("cap") && err.contains("anew"), "{code:?} {err}");
    let (code, out, _) = luxel(&["cache", "stat", "--store", "shared"], folder.path());
    assert!(code == Some(1) && out.contains("total"), "{code:?} {out}");
}

#[test]
fn a_folder_that_gc_cannot_remove_is_told_once_and_an_empty_one_goes() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path().join("baked/.luxel"));
    fs::create_dir_all(store.path(KIND, &key(1)).join("mine")).unwrap();
    fs::create_dir_all(store.path(KIND, &key(2))).unwrap();
    let (code, _, err) = luxel(&["cache", "verify"], folder.path());
    assert!(code == Some(1) && err.matches("remove this folder yourself").count() == 1, "{err}");
    let (code, _, err) = luxel(&["cache", "gc", "--cap", "0"], folder.path());
    assert!(code == Some(1) && err.matches("remove this folder yourself").count() == 1, "{err}");
    assert!(!store.path(KIND, &key(2)).exists() && store.path(KIND, &key(1)).join("mine").exists());
    fs::remove_dir_all(store.path(KIND, &key(1))).unwrap();
    assert_eq!(luxel(&["cache", "gc", "--cap", "0"], folder.path()).0, Some(0));
}
