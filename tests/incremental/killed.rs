//! A bake that is killed, at any moment: every output is the old one or the new one, whole; the hashes in the report
//! tell whether they belong together; and the next bake does what a clean one does.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use luxel::current::{State, check};
use luxel::settings::{Layer, Origin, for_scene};
use luxel::store::{Kind, LEFTOVER_AGE, Store};
use luxel_export::OutputSet;
use luxel_scene::Silent;
use serde_json::{Value, json};

use crate::baked::{Baked, Place, clean, run};
use crate::edits::Random;
use crate::level::{Level, SCENE};

/// Kills at moments that are spread over a whole bake, and at moments after it began to write its outputs.
const SPREAD: u64 = 100;
const WRITING: u64 = 20;

/// A bake that takes a while in each of its stages.
fn level(variant: u64) -> Level {
    let mut level = Level::new();
    for (setting, value) in [("size", "64"), ("voxels", "2000"), ("directions", "64")] {
        level.set(setting, value);
    }
    level.set("gather", "\"lightcuts\"");
    level.node("bulb")["translation"] = json!([0.1 + variant as f64, 1.2, 0.5]);
    level
}

fn start(folder: &Path) -> Child {
    Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(["bake", SCENE, "--force", "--quiet"])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Temporary files in a folder, not below it.
fn temporary(folder: &Path) -> Vec<PathBuf> {
    let is_temporary = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap();
        name.starts_with(".luxel-") && name.ends_with(".tmp")
    };
    let entries = fs::read_dir(folder).map(|entries| entries.map(|e| e.unwrap().path()).filter(is_temporary).collect());
    entries.unwrap_or_default()
}

/// What every output may hold: its bytes in one of two bakes, but for the report, which tells times.
struct Sides {
    old: Baked,
    new: Baked,
}

/// Where a bake was when it was killed, by what it left.
fn phase(place: &Place, changed: usize, is_over: bool) -> String {
    let (out, store) = (place.at("baked"), place.at("baked/.luxel"));
    if is_over {
        return "z over before".into();
    } else if changed > 0 {
        return "y outputs take their places".into();
    } else if !temporary(&out).is_empty() {
        return "x outputs are written".into();
    }
    let has = |kind: &Kind| fs::read_dir(store.join(kind.name())).is_ok_and(|mut entries| entries.next().is_some());
    let order = [
        Kind::Finish,
        Kind::Gather,
        Kind::Solution,
        Kind::Shoot,
        Kind::Surfels,
        Kind::Direct,
        Kind::Clear,
        Kind::Layout,
        Kind::Unwrap,
    ];
    match order.iter().position(has) {
        Some(at) => format!("{} after {} began to be stored", (b'w' - at as u8) as char, order[at].name()),
        None => "a nothing stored".into(),
    }
}

impl Sides {
    /// Every file is of one side, whole; returns how many are new. The report counts as a file.
    fn are_whole(&self, out: &Path) -> usize {
        let found = crate::tool::files(out);
        let names: Vec<&String> = found.keys().collect();
        assert_eq!(names.len(), self.old.files.len() + 1, "{names:?}");
        let mut new = 0;
        let mut report = Value::Null;
        for (name, bytes) in &found {
            if name.ends_with(".bake.json") {
                report = serde_json::from_slice(bytes).unwrap_or_else(|e| panic!("{name} is torn: {e}"));
                continue;
            }
            let is_new = self.new.files[name] == *bytes;
            assert!(is_new || self.old.files[name] == *bytes, "{name} is neither old nor new");
            // Both may agree in a file.
            new += usize::from(is_new && self.old.files[name] != *bytes);
        }
        let hashes = |files: &BTreeMap<String, Vec<u8>>| -> BTreeMap<String, String> {
            files.iter().map(|(name, bytes)| (name.clone(), blake3::hash(bytes).to_hex().to_string())).collect()
        };
        let listed: BTreeMap<String, String> = report["outputs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|o| (o["path"].as_str().unwrap().to_owned(), o["blake3"].as_str().unwrap().to_owned()))
            .collect();
        let (old, is) =
            (hashes(&self.old.files), hashes(&found.into_iter().filter(|(n, _)| !n.ends_with(".json")).collect()));
        let is_new_report = listed == hashes(&self.new.files);
        assert!(is_new_report || listed == old, "the report is of neither bake");
        // The hashes tell a set that belongs together from one that does not.
        let different = self.new.files.iter().filter(|(name, bytes)| self.old.files[*name] != **bytes).count();
        let is_mixed = if is_new_report { new != different } else { new != 0 };
        assert_eq!(listed != is, is_mixed, "{new} of {different} are new");
        new + usize::from(is_new_report)
    }
}

fn is_current(place: &Place) -> bool {
    let scene = place.at(SCENE);
    let outputs = OutputSet::new(&scene, None, None).unwrap();
    let settings = for_scene(&scene, None, &Layer::new(Origin::CommandLine)).unwrap();
    matches!(check(&scene, &outputs, &settings, &Silent).unwrap(), State::Current(_))
}

#[test]
fn a_killed_bake_leaves_whole_files_and_the_next_one_is_as_a_clean_one() {
    let place = Place::new();
    let (out, store) = (place.at("baked"), place.at("baked/.luxel"));
    let right = [0, 1].map(|variant| clean(&level(variant).write(place.folder.path())));
    assert!(right[0].files["level.glb"] != right[1].files["level.glb"] || right[0].files != right[1].files);
    level(0).write(place.folder.path());
    let begin = Instant::now();
    assert!(start(place.folder.path()).wait().unwrap().success());
    let mut whole = begin.elapsed();
    let mut random = Random::new(9);
    let mut phases: BTreeMap<String, u32> = BTreeMap::new();
    let (mut side, mut kept, mut kills, mut tries) = (0, 0, 0, 0);
    while kills < SPREAD + WRITING {
        tries += 1;
        assert!(tries < 4 * (SPREAD + WRITING), "too few kills meet a bake: {phases:?}");
        let sides = Sides { old: right[side].clone(), new: right[1 - side].clone() };
        level(1 - side as u64).write(place.folder.path());
        fs::remove_dir_all(&store).unwrap();
        let mut bake = start(place.folder.path());
        let begin = Instant::now();
        if kills < SPREAD {
            let share = (kills as f64 + random.below(1000) as f64 / 1000.0) / SPREAD as f64;
            // The parts of a bake are as long as the whole is, which the machine's other work decides.
            std::thread::sleep(whole.mul_f64(share).saturating_sub(begin.elapsed()));
        } else {
            while temporary(&out).is_empty() && bake.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_micros(200));
            }
            std::thread::sleep(Duration::from_micros(random.below(12_000) as u64));
        }
        let over = bake.try_wait().unwrap();
        bake.kill().unwrap();
        let ended = bake.wait().unwrap();
        let is_over = over.is_some() || ended.success();
        if is_over {
            // Too late: another moment.
            whole = whole.mul_f64(0.95);
        } else {
            kills += 1;
        }
        let changed = sides.are_whole(&out);
        *phases.entry(phase(&place, changed, is_over)).or_default() += 1;
        // Nobody takes what does not belong together for current.
        let count = sides.new.files.iter().filter(|(name, bytes)| sides.old.files[*name] != **bytes).count() + 1;
        assert_eq!(is_current(&place), changed == count);
        let verified = Store::new(&store).verify(&Silent);
        if let Ok(verified) = verified {
            assert!(verified.bad.is_empty() && verified.outdated.is_empty(), "{verified:?}");
        }
        let next = run(&place.at(SCENE), &place.target());
        assert!(next.files == sides.new.files, "after {kills} kills");
        assert_eq!(next.warnings("store"), [""; 0]);
        kept += u32::from(next.stage("surfels")["state"] == "reused");
        side = 1 - side;
    }
    println!("{phases:#?}\n{kept} next bakes found surfels of the killed one; a whole bake: {whole:?}");
    assert!(phases.len() > 5, "the kills met too few phases: {phases:?}");
    left_is_harmless(&place);
}

/// What the killed ones left takes part in nothing, and goes when nobody can be writing it any more: by any bake.
fn left_is_harmless(place: &Place) {
    let (out, store) = (place.at("baked"), place.at("baked/.luxel"));
    assert!(is_current(place));
    println!("{} temporary files are left beside the outputs", temporary(&out).len());
    let young = out.join(".luxel-young.tmp");
    fs::write(&young, "half").unwrap();
    fs::write(store.join("gather/.luxel-killed.tmp"), "half").unwrap();
    let mine = out.join("mine.tmp");
    fs::write(&mine, "mine").unwrap();
    let old = SystemTime::now() - LEFTOVER_AGE - Duration::from_secs(60);
    let all = [temporary(&out), temporary(&store.join("gather")), vec![mine.clone()]].concat();
    for path in all.iter().filter(|path| **path != young) {
        fs::File::options().write(true).open(path).unwrap().set_modified(old).unwrap();
    }
    run(&place.at(SCENE), &place.target());
    assert_eq!((temporary(&out), temporary(&store.join("gather"))), (vec![young], vec![]));
    assert!(mine.exists());
}
