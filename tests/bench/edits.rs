//! What an edit of a scene costs, beside the bake of all of it: the paper's Sponza with one lamp more.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use luxel::settings::{Preset, Resolved, Settings, value::Texels};
use luxel::store::StoreOptions;
use luxel::{Error, Request, current};
use luxel_export::OutputSet;
use luxel_scene::{Progress, Silent};
use serde_json::{Value, json};

use crate::{Goal, row, support};

/// The object that is moved.
const OBJECT: &str = "pillar_floor_0";

/// Measures all of it on atlases of this side.
pub fn measure(size: u32) {
    let Some(scenes) = support::scenes() else { return };
    let original = std::fs::read(scenes.join("sponza/sponza_dabrovic_area_light.glb")).expect("the scene");
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("sponza.glb");
    let save = |edit: &dyn Fn(&mut Value)| {
        let all = |json: &mut Value| {
            add_bulb(json);
            edit(json);
        };
        std::fs::write(&scene, edited(&original, &all)).expect("the scene is saved");
    };
    let settings = Settings { size: Texels(size), ..Settings::preset(Preset::Medium) };
    let request = Request {
        scene: scene.clone(),
        outputs: OutputSet::new(&scene, None, None).expect("a place"),
        settings: Resolved { settings, ..Resolved::default() },
        worker: Some(env!("CARGO_BIN_EXE_luxel").into()),
        store: StoreOptions::default(),
        kept: Default::default(),
    };
    save(&|_| {});
    // As a watch bakes what it has not seen: the draft, whose time does not count, leaves its surfels.
    let whole = luxel::bake_drafted(&request, &Silent, &mut |_| {}).expect("a bake").seconds;
    let name = |what: &str| format!("{what}, Sponza {size}²");
    row(&name("whole bake, import and unwrap included"), whole, "s", Goal::Information);
    let unchanged = seconds(|| {
        let state = current::check(&scene, &request.outputs, &request.settings, &Silent).expect("a check");
        assert!(matches!(state, current::State::Current(_)), "nothing has changed");
    });
    share(&name("unchanged"), unchanged, whole, 1e3, "ms", 50.0, 0.01);
    at_rest(&scene, size, &|| save(&|json| bulb(json)["color"] = json!([0.5, 0.7, 1.0])));
    save(&|json| bulb(json)["color"] = json!([1.0, 0.5, 0.2]));
    let colour = seconds(|| drop(luxel::bake(&request, &Silent).expect("a bake")));
    share(&name("lamp's colour"), colour, whole, 1.0, "s", f64::INFINITY, 0.1);
    save(&|json| node(json, "bulb")["translation"] = json!([1.0, 4.0, 0.5]));
    share(&name("draft after a lamp was moved"), draft(&request), whole, 1.0, "s", 0.5, 1.0);
    save(&|json| {
        let matrix = &mut node(json, OBJECT)["matrix"];
        matrix[12] = json!(matrix[12].as_f64().expect("a place") + 0.05);
    });
    share(&name("draft after an object was moved"), draft(&request), whole, 1.0, "s", 1.5, 1.0);
}

/// A time with what it may be, and the same as a share of the whole bake's.
fn share(what: &str, seconds: f64, whole: f64, units: f64, unit: &str, must: f64, most: f64) {
    let goal = if must.is_finite() { Goal::AtMost { must, aim: must } } else { Goal::Information };
    row(what, seconds * units, unit, goal);
    let goal = if most < 1.0 { Goal::AtMost { must: 100.0 * most, aim: 100.0 * most } } else { Goal::Information };
    row("  of the whole bake", 100.0 * seconds / whole, "%", goal);
}

fn seconds(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64()
}

/// Until the draft's files are there; what would follow is stopped.
fn draft(request: &Request) -> f64 {
    struct Flag(AtomicBool);
    impl Progress for Flag {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            self.0.load(Ordering::Relaxed)
        }
    }
    let (flag, start) = (Flag(AtomicBool::new(false)), Instant::now());
    let mut seconds = None;
    let result = luxel::bake_drafted(request, &flag, &mut |_| {
        seconds = Some(start.elapsed().as_secs_f64());
        flag.0.store(true, Ordering::Relaxed);
    });
    assert!(matches!(result, Err(Error::Cancelled)), "it was stopped");
    seconds.expect("a draft")
}

/// Memory of a watch that has nothing to do after it has baked an edit, without the bytes of its scene.
fn at_rest(scene: &Path, size: u32, edit: &dyn Fn()) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(["watch", "--json", "--size", &size.to_string()])
        .arg(scene)
        .stdout(Stdio::piped())
        .spawn()
        .expect("luxel starts");
    let lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().expect("a pipe")));
    let is_idle = |line: std::io::Result<String>| line.expect("a line").contains("\"idle\"");
    let mut rests = { lines }.map(is_idle).filter(|is_idle| *is_idle);
    assert_eq!(rests.next(), Some(true), "it comes to rest");
    edit();
    assert_eq!(rests.next(), Some(true), "it comes to rest again");
    let status = PathBuf::from(format!("/proc/{}/status", child.id()));
    let resident = std::fs::read_to_string(status).ok().and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?.trim().trim_end_matches("kB").trim();
        line.parse::<f64>().ok()
    });
    child.kill().and_then(|()| child.wait()).expect("luxel stops");
    let Some(resident) = resident else { return };
    let own = std::fs::metadata(scene).map_or(0.0, |meta| meta.len() as f64);
    let more = (resident * 1024.0 - own) / f64::from(1 << 20);
    row("watch at rest after an edit, beyond the scene's size", more, "MiB", Goal::AtMost { must: 200.0, aim: 100.0 });
}

fn node<'a>(json: &'a mut Value, name: &str) -> &'a mut Value {
    let nodes = json["nodes"].as_array_mut().expect("nodes");
    nodes.iter_mut().find(|node| node["name"] == name).expect("a node of this name")
}

fn bulb(json: &mut Value) -> &mut Value {
    &mut json["extensions"]["KHR_lights_punctual"]["lights"][0]
}

fn add_bulb(json: &mut Value) {
    json["extensions"]["KHR_lights_punctual"]["lights"] = json!([{ "type": "point", "intensity": 800.0 }]);
    let nodes = json["nodes"].as_array_mut().expect("nodes");
    let extension = json!({ "KHR_lights_punctual": { "light": 0 } });
    nodes.push(json!({ "name": "bulb", "translation": [0.0, 4.0, 0.0], "extensions": extension }));
    let number = nodes.len() - 1;
    json["scenes"][0]["nodes"].as_array_mut().expect("nodes").push(json!(number));
    if !json["extensionsUsed"].is_array() {
        json["extensionsUsed"] = json!([]);
    }
    json["extensionsUsed"].as_array_mut().expect("a list").push(json!("KHR_lights_punctual"));
}

/// A .glb with another document.
fn edited(glb: &[u8], edit: &dyn Fn(&mut Value)) -> Vec<u8> {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    let (document, rest) = glb[20..].split_at(word(12));
    let mut json: Value = serde_json::from_slice(document).expect("a document");
    edit(&mut json);
    let mut text = serde_json::to_vec(&json).expect("a document");
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    for word in [2, 20 + text.len() + rest.len(), text.len()] {
        bytes.extend((word as u32).to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend(rest);
    bytes
}
