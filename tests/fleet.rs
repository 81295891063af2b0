//! Folders: several scenes at a time give what they give one by one, whoever fails is named and stops nobody, and all of
//! it is told in the order of the scenes.

mod tool;

use serde_json::{Value, json};
use tool::{files, folder, luxel, quick};

/// A folder with so many copies of a scene, each slightly another one.
fn levels(count: usize) -> tempfile::TempDir {
    let folder = folder(&[]);
    let (document, bin) = tool::parts("cornell.glb");
    for i in 0..count {
        let mut document = document.clone();
        document["nodes"][0]["translation"] = json!([0.01 * i as f64, 0, 0]);
        document["buffers"][0]["uri"] = format!("level{i}.bin").into();
        let below = folder.path().join(if i % 2 == 0 { "even" } else { "odd" });
        std::fs::create_dir_all(&below).unwrap();
        std::fs::write(below.join(format!("level{i}.bin")), &bin).unwrap();
        std::fs::write(below.join(format!("level{i}.gltf")), document.to_string()).unwrap();
    }
    folder
}

fn events(stdout: &str) -> Vec<Value> {
    stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A report without its times.
fn timeless(report: &[u8]) -> Value {
    let mut report: Value = serde_json::from_slice(report).unwrap();
    report["seconds"] = 0.into();
    for stage in report["stages"].as_array_mut().unwrap() {
        stage["seconds"] = 0.into();
    }
    report
}

#[test]
fn several_at_a_time_give_the_bytes_of_one_by_one() {
    let folder = levels(6);
    let path = folder.path();
    quick(&["bake", ".", "--out", "alone", "--jobs", "1", "--threads", "1"], path).ended(0);
    quick(&["bake", "even", "odd", "--out", "together", "--jobs", "6"], path).ended(0);
    let (alone, together) = (files(&path.join("alone")), files(&path.join("together")));
    // `.` mirrors the folders that were named in the other run.
    let alone: std::collections::BTreeMap<String, Vec<u8>> =
        alone.into_iter().map(|(name, bytes)| (name.rsplit('/').next().unwrap().to_owned(), bytes)).collect();
    assert_eq!(alone.keys().collect::<Vec<_>>(), together.keys().collect::<Vec<_>>());
    assert_eq!(alone.len(), 6 * 4);
    for (name, bytes) in &alone {
        if !name.ends_with(".bake.json") {
            assert!(*bytes == together[name], "{name}");
        } else {
            let [one, other] = [bytes, &together[name]].map(|report| timeless(report));
            assert_eq!((&one["outputs"], &one["quality"]), (&other["outputs"], &other["quality"]), "{name}");
        }
    }
    // Now there is nothing to do, however many look.
    let again = quick(&["bake", "even", "odd", "--out", "together", "--json"], path).ended(0);
    let again = events(&again.stdout);
    assert!(again.iter().all(|e| ["unchanged", "done"].contains(&e["event"].as_str().unwrap())), "{again:?}");
    assert_eq!(again.last().unwrap()["unchanged"].as_array().unwrap().len(), 6);
}

#[test]
fn who_fails_is_named_and_the_others_are_baked_in_order() {
    let folder = levels(5);
    let path = folder.path();
    std::fs::write(path.join("even/level2.bin"), b"short").unwrap();
    std::fs::write(path.join("odd/level3.gltf"), b"{\"asset\":").unwrap();
    let said = quick(&["bake", ".", "--jobs", "3"], path).ended(1).stderr;
    // Each scene's lines stand together below its name, in the order of the scenes.
    let names = ["./even/level0.gltf", "./even/level2.gltf", "./even/level4.gltf", "./odd/level1.gltf"];
    let places: Vec<usize> = names
        .iter()
        .map(|name| said.lines().position(|line| line == *name).unwrap_or_else(|| panic!("{said}")))
        .collect();
    assert!(places.is_sorted(), "{said}");
    let lines: Vec<&str> = said.lines().collect();
    let of = |i: usize| &lines[places[i]..places[i + 1]];
    assert!(of(0).iter().any(|l| l.contains("done in")) && of(2).iter().any(|l| l.contains("done in")), "{said}");
    assert!(of(1).iter().any(|l| l.starts_with("error: ")) && !of(1).iter().any(|l| l.contains("done in")), "{said}");
    let summary: Vec<&str> = lines[lines.len() - 3..].to_vec();
    assert_eq!(summary, ["2 of 5 scenes failed:", "  ./even/level2.gltf", "  ./odd/level3.gltf"]);

    let again = quick(&["bake", ".", "--jobs", "3", "--json"], path).ended(1);
    let again = events(&again.stdout);
    let done = again.last().unwrap();
    assert_eq!(done["failed"], json!(["./even/level2.gltf", "./odd/level3.gltf"]));
    assert_eq!(done["unchanged"], json!(["./even/level0.gltf", "./even/level4.gltf", "./odd/level1.gltf"]));
}

#[test]
fn every_event_tells_its_scene() {
    let folder = levels(3);
    let run = quick(&["bake", ".", "--jobs", "3", "--json"], folder.path()).ended(0);
    let events = events(&run.stdout);
    let (last, events) = events.split_last().unwrap();
    assert_eq!((&last["event"], &last["scenes"]), (&"done".into(), &3.into()));
    for scene in ["./even/level0.gltf", "./even/level2.gltf", "./odd/level1.gltf"] {
        let own: Vec<&str> =
            events.iter().filter(|e| e["scene"] == scene).map(|e| e["event"].as_str().unwrap()).collect();
        assert_eq!((own.first(), own.last()), (Some(&"stale"), Some(&"baked")), "{own:?}");
        let count = |which: &str| own.iter().filter(|event| **event == which).count();
        assert_eq!(count("started"), count("finished"), "{own:?}");
    }
    assert!(events.iter().all(|e| e["scene"].is_string()));
}

/// Ctrl-C stops all that run, begins no other, and leaves nothing.
#[cfg(unix)]
#[test]
fn an_interruption_stops_all_of_them() {
    use std::io::{BufRead, BufReader};
    let folder = levels(4);
    // Far more rays than anybody waits for.
    let slow = ["bake", ".", "--jobs", "2", "--json", "--preset", "final", "--size", "1024", "--sky-rays", "65536"];
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(slow)
        .current_dir(folder.path())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut started = std::collections::BTreeSet::new();
    while started.len() < 2 {
        let event: Value = serde_json::from_str(&lines.next().unwrap()).unwrap();
        if event["event"] == "started" && event["stage"] == "shoot" {
            started.insert(event["scene"].as_str().unwrap().to_owned());
        }
    }
    let killed = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let last: Value = serde_json::from_str(&lines.last().unwrap()).unwrap();
    assert_eq!(last["event"], "interrupted");
    let begun: Vec<&str> = last["scenes"].as_array().unwrap().iter().map(|s| s.as_str().unwrap()).collect();
    assert_eq!(begun, started.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(last["scene"], begun[0]);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(files(folder.path()).keys().all(|name| name.ends_with(".gltf") || name.ends_with(".bin")));
}

#[test]
fn no_scene_at_a_time_is_wrong_usage() {
    let folder = folder(&["cornell.glb"]);
    let said = luxel(&["bake", "cornell.glb", "--jobs", "0"], folder.path()).ended(2).stderr;
    assert!(said.contains("--jobs"), "{said}");
}

/// Below a folder, one whose path is too long for the system to list it, whoever asks.
#[cfg(target_os = "linux")]
fn unlistable(folder: &std::path::Path) {
    let chain = |above: &std::path::Path| (0..9).fold(above.to_path_buf(), |path, _| path.join("n".repeat(220)));
    let (inner, other) = (chain(folder), chain(&folder.join("other")));
    std::fs::create_dir_all(&inner).unwrap();
    std::fs::create_dir_all(other.join("m".repeat(220))).unwrap();
    std::fs::rename(folder.join("other"), inner.join("other")).unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_listed_fails_and_the_others_are_baked() {
    let folder = levels(2);
    unlistable(&folder.path().canonicalize().unwrap().join("deep"));
    let absolute = folder.path().canonicalize().unwrap();
    let run = quick(&["bake", absolute.to_str().unwrap(), "--json"], folder.path()).ended(1);
    let events = events(&run.stdout);
    let done = events.last().unwrap();
    let failed = done["failed"].as_array().unwrap();
    assert!(failed.len() == 1 && failed[0].as_str().unwrap().contains("deep"), "{done}");
    assert_eq!(events.iter().filter(|e| e["event"] == "baked").count(), 2, "{}", run.stdout);
    let told = events.iter().find(|e| e["event"] == "failed").unwrap();
    assert!(told["error"].as_str().unwrap().contains("cannot list the folder"), "{told}");
}

#[cfg(unix)]
#[test]
fn a_folder_that_is_named_twice_is_baked_once() {
    let folder = levels(1);
    std::os::unix::fs::symlink("even", folder.path().join("link")).unwrap();
    let run = quick(&["bake", "even", "./even", "link", "--json"], folder.path()).ended(0);
    let events = events(&run.stdout);
    let baked: Vec<&Value> = events.iter().filter(|e| e["event"] == "baked").map(|e| &e["scene"]).collect();
    assert_eq!((baked, &events.last().unwrap()["scenes"]), (vec![&json!("even/level0.gltf")], &1.into()));
}

/// Names are printed so that they can neither begin a line nor order the terminal about; programs get them as they are.
#[cfg(unix)]
#[test]
fn names_do_not_break_what_is_printed() {
    let folder = folder(&["cornell.glb"]);
    let name = "a\n\u{1b}[2Jerror: b.glb";
    std::fs::rename(folder.path().join("cornell.glb"), folder.path().join(name)).unwrap();
    std::fs::write(folder.path().join("x\n\u{1b}[2Jy.glb"), "no scene").unwrap();
    for style in [&[][..], &["--check"]] {
        let said = quick(&[&["bake", "."], style].concat(), folder.path());
        assert!(!said.stderr.contains('\u{1b}') && said.stderr.contains("\\u{1b}[2J"), "{}", said.stderr);
        assert!(!said.stderr.lines().any(|line| line.contains("error: b.glb") && !line.contains("a\\n")));
        assert!(!said.stderr.lines().any(|line| line.starts_with("y.glb")), "{}", said.stderr);
    }
    let plan = quick(&["plan", name], folder.path()).ended(0);
    assert!(!plan.stdout.contains('\u{1b}') && !plan.stderr.contains('\u{1b}'));
    let stat = luxel(&["cache", "stat", "."], folder.path()).ended(0);
    assert!(stat.stdout.contains("total"));
    let missing = luxel(&["bake", "no\n\u{1b}[2Jfile.glb"], folder.path()).ended(2).stderr;
    assert!(!missing.contains('\u{1b}') && !missing.lines().any(|line| line.starts_with("file.glb")), "{missing}");
    let events = events(&quick(&["bake", ".", "--json"], folder.path()).ended(1).stdout);
    // Scenes are baked side by side: any may be told of first.
    assert!(events.iter().any(|e| e["scene"].as_str().is_some_and(|scene| scene.trim_start_matches("./") == name)));
}
