//! What is current is not baked, and what is not current says why: counted by bakes, compared by bytes.

mod tool;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use luxel::current::{Outputs, Reason, State, check};
use luxel::settings::{Layer, Origin, for_scene};
use luxel::{Request, bake};
use luxel_export::{OutputSet, Report};
use luxel_scene::Silent;
use serde_json::{Value, json};
use tempfile::TempDir;
use tool::{Run, luxel};

/// A textured triangle under an image sky: its corners and its image are files of their own, a second image is not
/// there. `name` is that of its buffer.
fn gltf(name: &str) -> String {
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }],
        "materials": [{ "normalTexture": { "index": 1 }, "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
        "textures": [{ "source": 0 }, { "source": 1 }],
        "images": [{ "uri": "wall.png" }, { "uri": "bumps.png" }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "min": [0, 0, 0], "max": [9, 9, 9] }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "uri": format!("{name}.bin"), "byteLength": 36 }],
    })
    .to_string()
}

fn corners(width: f32) -> Vec<u8> {
    [0.0, 0.0, 0.0, width, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x: &f32| x.to_le_bytes()).collect()
}

fn image(path: &Path, red: u8) {
    image::RgbImage::from_pixel(2, 2, image::Rgb([red, 200, 200])).save(path).unwrap();
}

fn sky(path: &Path, radiance: f32) {
    exr::prelude::write_rgb_file(path, 8, 4, |_, _| (radiance, 1.0, 1.0)).unwrap();
}

const CONFIG: &str = "preset = \"draft\"\nsize = 32\nvoxels = 500\nsky_rays = 16\nsky = \"sky.exr\"\n";

fn furnish(folder: &Path, names: &[&str]) {
    fs::create_dir_all(folder).unwrap();
    for name in names {
        fs::write(folder.join(format!("{name}.gltf")), gltf(name)).unwrap();
        fs::write(folder.join(format!("{name}.bin")), corners(1.0)).unwrap();
    }
    image(&folder.join("wall.png"), 200);
    sky(&folder.join("sky.exr"), 2.0);
    fs::write(folder.join("luxel.toml"), CONFIG).unwrap();
}

fn levels(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    furnish(&folder.path().join("levels"), names);
    folder
}

/// Everything below a folder, hidden or not: its time and its content, none of folders.
fn listing(folder: &Path) -> BTreeMap<PathBuf, (SystemTime, Option<Vec<u8>>)> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let meta = fs::metadata(&path).unwrap();
        if meta.is_dir() {
            all.extend(listing(&path));
        }
        all.insert(path.clone(), (meta.modified().unwrap(), meta.is_file().then(|| fs::read(&path).unwrap())));
    }
    all
}

/// The scenes of which a run said this, sorted: those that are worked on at the same time may be told in any order.
fn told(run: &Run, event: &str) -> Vec<String> {
    let lines = run.stdout.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let scenes = lines.filter(|e| e["event"] == event).map(|e| e["scene"].as_str().unwrap_or_default().to_owned());
    let mut scenes: Vec<String> = scenes.collect();
    scenes.sort();
    scenes
}

/// The last event.
fn last(run: &Run) -> Value {
    serde_json::from_str(run.stdout.lines().last().unwrap()).unwrap()
}

/// One scene, baked in this process.
struct Level {
    folder: TempDir,
}

impl Level {
    fn new() -> Self {
        let level = Self { folder: tempfile::tempdir().unwrap() };
        furnish(level.folder.path(), &["s"]);
        level.bake();
        level
    }

    fn bake(&self) {
        let settings = for_scene(&self.at("s.gltf"), None, &Layer::new(Origin::CommandLine)).unwrap();
        bake(
            &Request {
                scene: self.at("s.gltf"),
                outputs: self.outputs(),
                settings,
                worker: None,
                store: Default::default(),
                kept: Default::default(),
            },
            &Silent,
        )
        .unwrap();
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn outputs(&self) -> OutputSet {
        OutputSet::new(&self.at("s.gltf"), None, None).unwrap()
    }

    /// A folder with the same content, to be spoilt.
    fn copy(&self) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (path, (_, content)) in listing(self.folder.path()) {
            let copy = folder.path().join(path.strip_prefix(self.folder.path()).unwrap());
            if let Some(bytes) = content {
                fs::create_dir_all(copy.parent().unwrap()).unwrap();
                fs::write(copy, bytes).unwrap();
            }
        }
        Self { folder }
    }

    fn state(&self) -> Result<State, luxel::Error> {
        let settings = for_scene(&self.at("s.gltf"), None, &Layer::new(Origin::CommandLine))?;
        check(&self.at("s.gltf"), &self.outputs(), &settings, &Silent)
    }

    fn current(&self) -> Outputs {
        match self.state().unwrap() {
            State::Current(outputs) => *outputs,
            State::Stale(reasons) => panic!("{reasons:?}"),
        }
    }

    fn stale(&self) -> Vec<Reason> {
        match self.state().unwrap() {
            State::Current(_) => panic!("it is current"),
            State::Stale(reasons) => reasons,
        }
    }

    /// Changes the report.
    fn edit(&self, change: impl FnOnce(&mut Value)) {
        let path = self.at("baked/s.bake.json");
        let mut report: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut report);
        fs::write(path, serde_json::to_vec_pretty(&report).unwrap()).unwrap();
    }
}

#[test]
fn a_current_scene_names_its_files() {
    let level = Level::new();
    let now = level.current();
    let names = |paths: Vec<&PathBuf>| -> Vec<String> {
        paths.iter().map(|p| p.strip_prefix(level.folder.path()).unwrap().display().to_string()).collect()
    };
    let mut inputs = names(now.inputs.iter().map(|i| &i.path).collect());
    inputs.sort();
    assert_eq!(inputs, ["s.bin", "s.gltf", "sky.exr", "wall.png"]);
    let outputs = names(now.files.iter().collect());
    let expected = ["baked/s.lightmap.exr", "baked/s.preview.png", "baked/s.glb", "baked/s.bake.json"];
    assert_eq!(outputs, expected);
    assert_eq!(now.report.scene.missing.map(|m| m.len()), Some(1), "bumps.png");
}

#[test]
fn everything_that_makes_outputs_stale_says_so() {
    let level = Level::new();
    type Edit = fn(&Level);
    let write = |level: &Level, name: &str, text: &str| fs::write(level.at(name), text).unwrap();
    let cases: [(&str, &str, Edit); 25] = [
        ("input-changed", "s.gltf has changed", |l| fs::write(l.at("s.gltf"), gltf("s") + " ").unwrap()),
        ("input-changed", "s.bin has changed", |l| fs::write(l.at("s.bin"), corners(2.0)).unwrap()),
        ("input-changed", "wall.png has changed", |l| image(&l.at("wall.png"), 100)),
        ("input-changed", "sky.exr has changed", |l| sky(&l.at("sky.exr"), 3.0)),
        ("input-gone", "s.bin was read and is not there", |l| fs::remove_file(l.at("s.bin")).unwrap()),
        ("input-gone", "sky.exr was read and is not there", |l| fs::remove_file(l.at("sky.exr")).unwrap()),
        ("input-new", "bumps.png can be read now", |l| image(&l.at("bumps.png"), 9)),
        ("setting-changed", "the setting size was 32 and is 64", |l| {
            fs::write(l.at("luxel.toml"), CONFIG.replace("32", "64")).unwrap();
        }),
        ("setting-changed", "the setting sky was ", |l| {
            fs::write(l.at("luxel.toml"), CONFIG.replace("\"sky.exr\"", "[1, 0.1, 2]")).unwrap();
        }),
        ("setting-changed", "the setting tolerance was 0.003 and is 0.007", |l| {
            fs::write(l.at("luxel.toml"), CONFIG.to_owned() + "tolerance = 0.007").unwrap();
        }),
        ("version-changed", "baked by luxel 0.0.9, and this is", |l| {
            l.edit(|r| r["versions"]["luxel"] = "0.0.9".into())
        }),
        ("version-changed", "gather has version", |l| l.edit(|r| r["versions"]["gather"] = "999".into())),
        ("version-changed", "and had none", |l| {
            l.edit(|r| drop(r["versions"].as_object_mut().unwrap().remove("unwrap")));
        }),
        ("output-missing", "s.glb is not there", |l| fs::remove_file(l.at("baked/s.glb")).unwrap()),
        ("output-missing", "s.lightmap.exr is not there", |l| fs::remove_file(l.at("baked/s.lightmap.exr")).unwrap()),
        ("output-changed", "s.preview.png is not as it was written", |l| image(&l.at("baked/s.preview.png"), 1)),
        ("output-changed", "s.lightmap.exr is not as it was written", |l| {
            // Of the same length.
            let mut bytes = fs::read(l.at("baked/s.lightmap.exr")).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::write(l.at("baked/s.lightmap.exr"), bytes).unwrap();
        }),
        ("output-left-over", "s.lightmap.3.exr was left over", |l| {
            fs::write(l.at("baked/s.lightmap.3.exr"), "").unwrap()
        }),
        ("not-baked", "has not been baked", |l| fs::remove_file(l.at("baked/s.bake.json")).unwrap()),
        ("not-baked", "has not been baked", |l| fs::remove_dir_all(l.at("baked")).unwrap()),
        ("report-unreadable", "not a regular file", |l| {
            fs::remove_file(l.at("baked/s.bake.json")).unwrap();
            fs::create_dir(l.at("baked/s.bake.json")).unwrap();
        }),
        ("report-unreadable", "more than 67108864 bytes", |l| {
            fs::File::create(l.at("baked/s.bake.json")).unwrap().set_len((64 << 20) + 1).unwrap();
        }),
        ("report-unreadable", "schema is 1", |l| l.edit(|r| r["schema"] = 1.into())),
        ("report-unreadable", "a scene with another name", |l| {
            l.edit(|r| r["scene"]["inputs"][0]["path"] = "other.gltf".into());
        }),
        ("report-unreadable", "which files were missing", |l| {
            l.edit(|r| drop(r["scene"].as_object_mut().unwrap().remove("missing")));
        }),
    ];
    for (code, words, edit) in cases {
        let level = level.copy();
        level.current();
        edit(&level);
        let reasons = level.stale();
        let [reason] = &reasons[..] else { panic!("{code}, {words}: {reasons:?}") };
        assert_eq!(reason.code(), code, "{reason}");
        assert!(reason.to_string().contains(words), "{reason}");
    }
    // Several at once are all told.
    let level = level.copy();
    write(&level, "luxel.toml", &CONFIG.replace("32", "64"));
    fs::write(level.at("s.bin"), corners(2.0)).unwrap();
    fs::remove_file(level.at("baked/s.glb")).unwrap();
    let codes: Vec<&str> = level.stale().iter().map(Reason::code).collect();
    assert_eq!(codes, ["setting-changed", "input-changed", "output-missing"]);
}

#[test]
fn what_does_not_decide_the_result_makes_nothing_stale() {
    let level = Level::new();
    let before = listing(&level.at("baked"));
    // Another time, another place of the same values, another number of threads, another copy of the sky.
    for name in ["s.gltf", "s.bin", "sky.exr", "wall.png"] {
        let file = fs::File::options().append(true).open(level.at(name)).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
    }
    fs::rename(level.at("sky.exr"), level.at("noon.exr")).unwrap();
    fs::write(level.at("luxel.toml"), CONFIG.replace("sky.exr", "noon.exr") + "threads = 1\nbounces = 64").unwrap();
    fs::write(level.at("unrelated.png"), "x").unwrap();
    level.current();
    // And a bake agrees: the same bytes but for the report.
    level.bake();
    for (path, (_, content)) in listing(&level.at("baked")) {
        if !path.ends_with("s.bake.json") && path.extension().is_some_and(|e| e != "octree") {
            assert!(before[&path].1 == content, "{}", path.display());
        }
    }
}

/// What of a report decides whether outputs are current.
fn essence(report: &Report) -> Value {
    let settings: Vec<_> = report.settings.iter().map(|s| (&s.name, &s.value)).collect();
    let inputs = &report.scene.inputs;
    json!([report.schema, inputs, report.scene.missing, report.versions, settings, report.outputs])
}

#[test]
fn a_torn_report_is_stale_and_a_spoilt_one_too_unless_nothing_follows_from_the_spot() {
    let level = Level::new();
    let path = level.at("baked/s.bake.json");
    let whole = fs::read(&path).unwrap();
    let truth = essence(&level.current().report);
    for length in (0..whole.len() - 2).step_by(50) {
        fs::write(&path, &whole[..length]).unwrap();
        let reasons = level.stale();
        assert!(matches!(&reasons[..], [Reason::Report { .. }]), "{length}: {reasons:?}");
    }
    // SplitMix64, seeded.
    let mut state = 7u64;
    let mut random = |below: usize| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % below as u64) as usize
    };
    let [mut spoilt, mut harmless] = [0, 0];
    for _ in 0..1500 {
        let mut bytes = whole.clone();
        let at = random(bytes.len());
        bytes[at] ^= 1 << random(8);
        fs::write(&path, &bytes).unwrap();
        match level.state().unwrap() {
            State::Stale(reasons) => {
                assert!(!reasons.is_empty());
                spoilt += 1;
            }
            // Times, counters, words: a person may want them, and nothing follows from them.
            State::Current(now) => {
                assert_eq!(essence(&now.report), truth, "byte {at} is another one, and nobody minds");
                harmless += 1;
            }
        }
    }
    assert!(spoilt > 300 && harmless > 50, "{spoilt} spoilt, {harmless} harmless");
}

#[test]
fn lists_of_outputs_that_no_bake_writes_are_refused() {
    let level = Level::new();
    let entry = |path: &str| json!({ "path": path, "bytes": 1, "blake3": "00" });
    let lists = [
        json!([]),
        json!([entry("s.glb"), entry("s.glb")]),
        json!([entry("../s.gltf"), entry("s.glb")]),
        json!([entry("/etc/hostname"), entry("s.glb")]),
        json!([entry("s.lightmap.1.exr"), entry("s.glb")]),
        json!([entry("s.lightmap.exr")]),
        json!([entry("s.lightmap.\u{0}"), entry("s.glb")]),
        Value::Array(vec![entry("s.lightmap.exr"); 10_000]),
    ];
    for list in lists {
        let level = level.copy();
        level.edit(|report| report["outputs"] = list);
        assert!(matches!(&level.stale()[..], [Reason::Report { what }] if what.contains("list of outputs")));
    }
}

#[test]
fn outputs_that_another_bake_is_just_replacing_are_not_current() {
    let old = Level::new();
    let new = old.copy();
    fs::write(new.at("luxel.toml"), CONFIG.to_owned() + "sky_strength = 2").unwrap();
    new.bake();
    let order = new.current().files;
    // Whoever looks has the old settings or the new ones.
    for (level, is_new) in [(&old, false), (&new, true)] {
        let mixed = level.copy();
        for name in order.iter().map(|f| f.file_name().unwrap()) {
            fs::copy(old.at("baked").join(name), mixed.at("baked").join(name)).unwrap();
        }
        for (written, name) in order.iter().map(|f| f.file_name().unwrap()).enumerate() {
            fs::copy(new.at("baked").join(name), mixed.at("baked").join(name)).unwrap();
            let is_whole = written + 1 == order.len();
            let is_current = matches!(mixed.state().unwrap(), State::Current(_));
            assert_eq!(is_current, is_whole && is_new, "{written} files are written");
        }
    }
}

#[test]
fn only_what_changed_is_baked() {
    let folder = levels(&["a", "b"]);
    let at = |name: &str| folder.path().join("levels").join(name);
    let run = |flags: &[&str]| luxel(&[&["bake", "levels", "--json"], flags].concat(), folder.path());
    let [a, b] = ["levels/a.gltf", "levels/b.gltf"];

    let first = run(&[]).ended(0);
    assert_eq!((told(&first, "baked"), told(&first, "stale")), (vec![a.into(), b.into()], vec![a.into(), b.into()]));
    let before = listing(folder.path());
    for path in before.keys().filter(|p| p.is_file()) {
        fs::File::options().append(true).open(path).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    }
    let before = listing(folder.path());
    let second = run(&[]).ended(0);
    assert_eq!((told(&second, "baked"), told(&second, "started")), (vec![], vec![]));
    assert_eq!(told(&second, "unchanged"), [a, b]);
    assert_eq!(last(&second), json!({ "event": "done", "scenes": 2, "failed": [], "unchanged": [a, b], "stale": [] }));
    assert!(listing(folder.path()) == before, "nothing is written");
    let spoken = luxel(&["bake", "levels/a.gltf"], folder.path()).ended(0);
    assert_eq!(spoken.stderr, "levels/a.gltf\n  unchanged\n");

    fs::write(at("b.bin"), corners(3.0)).unwrap();
    let third = run(&[]).ended(0);
    assert_eq!((told(&third, "baked"), told(&third, "unchanged")), (vec![b.into()], vec![a.into()]));
    for (path, content) in listing(&at("baked")) {
        // The store is not of one scene.
        if path.components().any(|part| part.as_os_str() == ".luxel") {
            continue;
        }
        let is_other = path.file_name().unwrap().to_str().unwrap().starts_with("a.");
        assert_eq!(is_other && path.is_file(), path.is_file() && before[&path] == content, "{}", path.display());
    }
    let other = run(&["--sky-strength", "2"]).ended(0);
    assert_eq!(told(&other, "baked").len(), 2);
    assert!(other.stdout.contains("the setting sky_strength was 1 and is 2"), "{}", other.stdout);
    assert_eq!(told(&run(&["--sky-strength", "2", "--threads", "1"]).ended(0), "baked").len(), 0);
    assert_eq!(told(&run(&["--sky-strength", "2", "--force"]).ended(0), "baked"), [a, b]);
}

#[test]
fn the_same_scene_by_another_name_is_current() {
    let folder = levels(&["a"]);
    luxel(&["bake", "levels/a.gltf"], folder.path()).ended(0);
    let whole = folder.path().join("levels/a.gltf").canonicalize().unwrap();
    luxel(&["bake", "--check", whole.to_str().unwrap()], folder.path()).ended(0);
    luxel(&["bake", "--check", "./levels"], folder.path()).ended(0);
    luxel(&["bake", "--check", "a.gltf"], &folder.path().join("levels")).ended(0);
    // A level moves with everything that belongs to it.
    fs::rename(folder.path().join("levels"), folder.path().join("rooms")).unwrap();
    luxel(&["bake", "--check", "rooms/a.gltf"], folder.path()).ended(0);
    luxel(&["bake", "--check", "rooms/a.gltf", "--out", "lit"], folder.path()).ended(3);
    assert!(!folder.path().join("lit").exists());
}

#[test]
fn a_gate_learns_what_is_stale_and_nothing_is_written() {
    let folder = levels(&["a", "b"]);
    let at = |name: &str| folder.path().join("levels").join(name);
    let gate = |flags: &[&str]| {
        let before = listing(folder.path());
        let run = luxel(&[&["bake", "--check", "levels"], flags].concat(), folder.path());
        assert!(listing(folder.path()) == before, "something is written: {}", run.stderr);
        run
    };
    let never = gate(&[]).ended(3);
    assert!(never.stderr.contains("stale: it has not been baked to this place yet"), "{}", never.stderr);
    luxel(&["bake", "levels"], folder.path()).ended(0);
    assert_eq!(gate(&["--quiet"]).ended(0).stderr, "");
    fs::remove_file(at("baked/b.preview.png")).unwrap();
    let one = gate(&[]).ended(3);
    assert!(one.stderr.contains("stale: the output levels/baked/b.preview.png is not there"), "{}", one.stderr);
    assert!(one.stderr.ends_with("1 of 2 scenes are stale:\n  levels/b.gltf\n"), "{}", one.stderr);
    assert_eq!(gate(&["--quiet"]).ended(3).stderr, "");
    let told_so = gate(&["--json"]).ended(3);
    let done = last(&told_so);
    let [a, b] = ["levels/a.gltf", "levels/b.gltf"];
    assert_eq!(done, json!({ "event": "done", "scenes": 2, "failed": [], "unchanged": [a], "stale": [b] }));
    let event: Value = told_so
        .stdout
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .find(|e: &Value| e["event"] == "stale")
        .unwrap();
    assert_eq!((&event["scene"], &event["reasons"][0]["code"]), (&b.into(), &"output-missing".into()));

    // A scene that no bake could open has failed, which counts more.
    fs::write(at("c.gltf"), "{ \"asset\"").unwrap();
    let broken = gate(&["--json"]).ended(1);
    assert_eq!(last(&broken)["failed"], json!(["levels/c.gltf"]));
    assert_eq!(last(&broken)["stale"], json!([b]));
    fs::remove_file(at("c.gltf")).unwrap();
    luxel(&["bake", "--check", "levels/a.gltf", "levels/none.gltf"], folder.path()).ended(1);
    luxel(&["bake", "--check", "--force", "levels"], folder.path()).ended(2);
    luxel(&["bake", "--check", "levels", "--size", "big"], folder.path()).ended(2);
    luxel(&["bake", "--check", "nowhere"], folder.path()).ended(2);
}

#[test]
fn a_plan_says_whether_there_is_anything_to_do() {
    let folder = levels(&["a"]);
    let plan = |flags: &[&str]| luxel(&[&["plan", "levels/a.gltf"], flags].concat(), folder.path()).ended(0);
    assert!(plan(&[]).stdout.contains("  stale      it has not been baked to this place yet\n"));
    luxel(&["bake", "levels"], folder.path()).ended(0);
    assert!(plan(&[]).stdout.starts_with("  unchanged  its outputs are current"));
    let changed = plan(&["--json", "--size", "64"]).stdout;
    let event: Value =
        changed.lines().map(|l| serde_json::from_str(l).unwrap()).find(|e: &Value| e["event"] == "plan").unwrap();
    assert_eq!(event["unchanged"], false);
    let reason = json!({ "code": "setting-changed", "message": "the setting size was 32 and is 64" });
    assert_eq!(event["stale"], json!([reason]));
}
