//! The binary as a person or a build uses it: on a temporary folder, by its files, its output and its exit code.

mod tool;

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tool::*;

fn names(folder: &Path) -> Vec<String> {
    files(folder).into_keys().collect()
}

#[test]
fn a_bake_leaves_four_files_that_belong_together() {
    let folder = folder(&["cornell.glb"]);
    quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    let baked = folder.path().join("baked");
    assert_eq!(names(&baked), ["cornell.bake.json", "cornell.glb", "cornell.lightmap.exr", "cornell.preview.png"]);

    let report: Value = serde_json::from_slice(&std::fs::read(baked.join("cornell.bake.json")).unwrap()).unwrap();
    assert_eq!(report["schema"], 2);
    for output in report["outputs"].as_array().unwrap() {
        let bytes = std::fs::read(baked.join(output["path"].as_str().unwrap())).unwrap();
        assert_eq!(output["blake3"], blake3::hash(&bytes).to_hex().as_str(), "{}", output["path"]);
    }
    let find =
        |list: &str, name: &str| report[list].as_array().unwrap().iter().find(|s| s["name"] == name).unwrap().clone();
    let size = find("settings", "size");
    assert_eq!((&size["value"], size["origin"].as_str()), (&64.into(), Some("command line")));
    let sky = find("stages", "sky");
    assert_eq!((sky["state"].as_str(), sky["reason"].as_str()), (Some("left out"), Some("there is no sky")));
    assert!(report["quality"]["mean_irradiance_lux"].as_f64().unwrap() > 0.0);
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let bake = |threads: &str| {
        let folder = folder(&["textured_room.glb"]);
        quick(&["bake", "textured_room.glb", "--threads", threads, "--gather", "lightcuts", "--bound"], folder.path())
            .ended(0);
        let mut files = files(&folder.path().join("baked"));
        // The report holds times.
        files.remove("textured_room.bake.json").unwrap();
        files
    };
    let one = bake("1");
    assert!(one.contains_key("textured_room.bound.exr"));
    for threads in ["2", "7"] {
        for (name, bytes) in bake(threads) {
            assert!(one[&name] == bytes, "{name} differs with {threads} threads");
        }
    }
}

#[test]
fn a_scene_that_fails_is_named_and_stops_no_other() {
    let folder = folder(&["cornell.glb"]);
    quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    let before = files(&folder.path().join("baked"));
    std::fs::write(folder.path().join("cornell.glb"), b"glTF but not for long").unwrap();
    std::fs::copy(asset("two_rooms.glb"), folder.path().join("z.glb")).unwrap();

    let output = quick(&["bake", "."], folder.path());
    assert_eq!(output.code, Some(1));
    let said = output.stderr;
    assert!(said.contains("1 of 2 scenes failed") && said.contains("cornell.glb"), "{said}");
    let after = files(&folder.path().join("baked"));
    assert!(after.contains_key("z.lightmap.exr"), "the other scene is baked");
    assert!(before.iter().all(|(name, bytes)| after[name] == *bytes), "the last good bake is still there");
}

#[test]
fn wrong_usage_is_told_before_anything_is_done() {
    let folder = folder(&["cornell.glb"]);
    for (args, expected) in [
        (vec!["bake", "cornell.glb", "--siez", "64"], "--size"),
        (vec!["bake", "cornell.glb", "--size", "-3"], "16 to 16384"),
        (vec!["bake", "corner.glb"], "no such file"),
        (vec!["bake"], "SCENE"),
        (vec!["bake", "cornell.glb", "--config", "none.toml"], "none.toml"),
        (vec!["bake", "cornell.glb", "--out", "."], "would replace the scene"),
    ] {
        let output = luxel(&args, folder.path());
        assert_eq!(output.code, Some(2), "{args:?}");
        assert!(output.stderr.contains(expected), "{args:?}: {}", output.stderr);
    }
    assert_eq!(names(folder.path()), ["cornell.glb"]);
}

#[test]
fn machines_learn_of_wrong_usage_too() {
    let folder = folder(&["cornell.glb"]);
    for (args, expected) in [
        (vec!["bake", "none.glb", "--json"], "no such file"),
        (vec!["bake", "cornell.glb", "--json", "--preset", "darft"], "did you mean `draft`"),
        (vec!["plan", "cornell.glb", "--json", "--config", "none.toml"], "may be read"),
        (vec!["bake", ".", "--json", "--sky", "none.hdr"], "no such sky image"),
    ] {
        let output = luxel(&args, folder.path());
        assert_eq!(output.code, Some(2), "{args:?}");
        let said = output.stdout;
        let events: Vec<Value> = said.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let [event] = &events[..] else { panic!("{args:?}: {said}") };
        assert_eq!(event["event"], "usage");
        assert!(event["error"].as_str().unwrap().contains(expected), "{event}");
    }
}

#[test]
fn a_scene_that_is_not_there_stops_no_other() {
    let folder = folder(&["cornell.glb"]);
    let output = quick(&["bake", "none.glb", "cornell.glb", "--json"], folder.path());
    assert_eq!(output.code, Some(1), "{}", output.stderr);
    let events: Vec<Value> = output.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!((&events[0]["event"], &events[0]["scene"]), (&"failed".into(), &"none.glb".into()));
    let done = events.last().unwrap();
    assert_eq!((&done["scenes"], &done["failed"]), (&2.into(), &serde_json::json!(["none.glb"])));
    assert!(folder.path().join("baked/cornell.glb").exists());
}

#[test]
fn a_wrong_key_beside_a_scene_fails_that_scene_with_a_suggestion() {
    let folder = folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("luxel.toml"), "sise = 64").unwrap();
    let output = luxel(&["bake", "cornell.glb"], folder.path());
    assert_eq!(output.code, Some(1));
    let said = output.stderr;
    assert!(said.contains("luxel.toml") && said.contains("did you mean `size`?"), "{said}");
}

#[test]
fn a_folder_is_mirrored_and_its_outputs_are_no_scenes() {
    let folder = folder(&[]);
    std::fs::create_dir_all(folder.path().join("levels/deep")).unwrap();
    std::fs::copy(asset("cornell.glb"), folder.path().join("levels/deep/a.glb")).unwrap();
    for _ in 0..2 {
        quick(&["bake", "levels", "--out", "levels/lit"], folder.path()).ended(0);
    }
    let lit = names(&folder.path().join("levels/lit"));
    assert!(lit.contains(&"deep/a.glb".to_owned()) && lit.iter().all(|n| n.starts_with("deep/a.")), "{lit:?}");
}

#[test]
fn machines_read_one_object_per_line_and_nothing_else() {
    let folder = folder(&["cornell.glb"]);
    let output = quick(&["bake", "cornell.glb", "--json"], folder.path()).ended(0);
    assert_eq!(output.stderr, "");
    let events: Vec<Value> = output.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(events.last().unwrap()["event"], "done");
    let baked = events.iter().find(|e| e["event"] == "baked").unwrap();
    assert_eq!(baked["outputs"].as_array().unwrap().len(), 4);
    assert!(events.iter().any(|e| e["event"] == "started" && e["stage"] == "unwrap"));
}

/// Ctrl-C while a bake runs: exit code 130, told in the form that was asked for, and nothing written.
#[cfg(unix)]
#[test]
fn an_interrupted_bake_says_so_and_leaves_nothing() {
    use std::io::{BufRead, BufReader};
    let folder = folder(&["cornell.glb"]);
    // Far more rays than anybody waits for.
    let slow = ["bake", "cornell.glb", "--json", "--preset", "final", "--size", "1024", "--sky-rays", "65536"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(slow)
        .current_dir(folder.path())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|l| l.contains("\"started\"") && l.contains("\"shoot\"")));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let last: Value = serde_json::from_str(&lines.last().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["scene"]), (&"interrupted".into(), &"cornell.glb".into()));
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(names(folder.path()), ["cornell.glb"]);
}

#[test]
fn quiet_is_quiet() {
    let folder = folder(&["cornell.glb"]);
    let output = quick(&["bake", "cornell.glb", "--quiet"], folder.path()).ended(0);
    assert!(output.stdout.is_empty() && output.stderr.is_empty(), "{}", output.stderr);
}

#[test]
fn the_plan_tells_every_stage_and_writes_nothing() {
    let folder = folder(&["colonnade.glb"]);
    let output = luxel(&["plan", "colonnade.glb"], folder.path()).ended(0);
    let said = output.stdout;
    for stage in luxel::plan::Stage::ALL {
        assert!(said.lines().any(|l| l.trim_start().starts_with(stage.name())), "{}: {said}", stage.name());
    }
    assert!(said.contains("1 sun") && said.contains("MiB"), "{said}");
    let output = luxel(&["plan", "colonnade.glb", "--json", "--sky", "none"], folder.path());
    let said = output.stdout;
    let event: Value = serde_json::from_str(said.lines().find(|l| l.contains("\"plan\"")).unwrap()).unwrap();
    let steps = event["plan"]["steps"].as_array().unwrap();
    let sky = steps.iter().find(|s| s["stage"] == "sky").unwrap();
    assert_eq!(sky["runs"], false, "the command line lies over the scene's extras");
    assert_eq!(names(folder.path()), ["colonnade.glb"]);
}

#[test]
fn the_plan_says_what_a_bake_would_say_of_the_scene() {
    let folder = folder(&[]);
    let mut document: Value = serde_json::json!({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}]});
    document["nodes"] = serde_json::json!([{"mesh": 0, "extras": {"luxel_scal": 2}}]);
    document["meshes"] = serde_json::json!([{"primitives": [{"attributes": {"POSITION": 0}}]}]);
    document["accessors"] = serde_json::json!([{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
        "min": [0, 0, 0], "max": [1, 1, 0]}]);
    document["bufferViews"] = serde_json::json!([{"buffer": 0, "byteLength": 36}]);
    document["buffers"] = serde_json::json!([{"byteLength": 36, "uri": "a.bin"}]);
    std::fs::write(folder.path().join("a.gltf"), document.to_string()).unwrap();
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::write(folder.path().join("a.bin"), bytes).unwrap();
    let output = quick(&["plan", "a.gltf"], folder.path()).ended(0);
    let said = output.stderr;
    assert!(said.contains("--sky") && said.contains("luxel_scal"), "{said}");
    let output = quick(&["plan", "a.gltf", "--json"], folder.path());
    let said = output.stdout;
    let event: Value = serde_json::from_str(said.lines().find(|l| l.contains("\"plan\"")).unwrap()).unwrap();
    let codes: Vec<_> = event["plan"]["warnings"].as_array().unwrap().iter().map(|w| w["code"].clone()).collect();
    assert!(codes.contains(&"no-light".into()) && codes.contains(&"unknown-extra".into()), "{codes:?}");
}

#[test]
fn the_plan_knows_what_is_stored() {
    let folder = folder(&["cornell.glb"]);
    let states = |flags: &[&str]| {
        let output = quick(&[&["plan", "cornell.glb", "--json"], flags].concat(), folder.path()).ended(0);
        let said = output.stdout;
        let event: Value = serde_json::from_str(said.lines().find(|l| l.contains("\"plan\"")).unwrap()).unwrap();
        let steps = event["plan"]["steps"].as_array().unwrap().clone();
        let reused = steps.iter().filter(|s| s["reused"] == true).map(|s| s["stage"].as_str().unwrap().to_owned());
        reused.collect::<Vec<_>>()
    };
    assert!(states(&[]).is_empty());
    quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    let made = ["unwrap", "surfels", "shoot", "propagate", "cache", "clear", "direct", "gather"];
    assert_eq!(states(&[]), [&made[..], &["finish"]].concat());
    assert_eq!(states(&["--emissive-scale", "2"]), made, "stronger light is another sum of the same");
    assert_eq!(states(&["--bounces", "2"]), ["unwrap", "surfels", "shoot", "clear", "direct"]);
    assert_eq!(states(&["--padding", "3"]), ["surfels", "shoot", "propagate", "cache"]);
    assert!(states(&["--out", "elsewhere"]).is_empty());
    let said = quick(&["plan", "cornell.glb"], folder.path()).stdout;
    assert!(said.lines().any(|l| l.contains("propagate") && l.contains("reused")), "{said}");
    assert!(!folder.path().join("elsewhere").exists());
}

#[test]
fn outputs_that_cannot_be_written_are_told_before_any_work() {
    let folder = folder(&["cornell.glb"]);
    // A folder within a file cannot be made, whoever runs this.
    let output = quick(&["bake", "cornell.glb", "--json", "--out", "cornell.glb/x"], folder.path());
    assert_eq!(output.code, Some(1));
    let events: Vec<Value> = output.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let started: Vec<_> = events.iter().filter(|e| e["event"] == "started").map(|e| e["stage"].clone()).collect();
    assert_eq!(started, ["import"]);
    let failed = events.iter().find(|e| e["event"] == "failed").unwrap();
    assert!(failed["error"].as_str().unwrap().contains("another one with --out"), "{failed}");
}

#[test]
fn names_that_are_taken_are_told_before_any_work() {
    let folder = folder(&["cornell.glb"]);
    std::fs::create_dir_all(folder.path().join("a/cornell.glb")).unwrap();
    std::fs::create_dir_all(folder.path().join("b/cornell.lightmap.3.exr")).unwrap();
    std::fs::create_dir(folder.path().join("c")).unwrap();
    std::fs::write(folder.path().join("c/.luxel"), b"").unwrap();
    for (out, taken) in [("a", "cornell.glb"), ("b", "cornell.lightmap.3.exr")] {
        let output = quick(&["bake", "cornell.glb", "--out", out], folder.path());
        assert_eq!(output.code, Some(1), "{out}");
        let said = output.stderr;
        assert!(said.contains(taken) && said.contains("--out") && !said.contains("unwrap"), "{said}");
    }
    // Where nothing can be stored, the bake is none the worse.
    let said = quick(&["bake", "cornell.glb", "--out", "c"], folder.path()).ended(0).stderr;
    assert!(said.contains(".luxel") && said.contains("cannot be written"), "{said}");
}

/// A bake that cannot fit is refused before any work; a plan says so too.
#[cfg(target_os = "linux")]
#[test]
fn a_bake_that_does_not_fit_into_memory_is_refused() {
    let folder = folder(&["cornell.glb"]);
    let limited = |task: &str| {
        let command =
            format!("ulimit -v 600000; exec \"$0\" {task} cornell.glb --preset draft --size 16384 --voxels 1000");
        let mut shell = Command::new("sh");
        shell.args(["-c", &command, env!("CARGO_BIN_EXE_luxel")]).current_dir(folder.path());
        let output = shell.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, said) = limited("bake");
    assert!(
        code == Some(1) && said.contains("MiB") && said.contains("the texels") && said.contains("--size"),
        "{said}"
    );
    assert_eq!(names(folder.path()), ["cornell.glb"]);
    let (code, said) = limited("render --method lightmap");
    assert!(code == Some(1) && said.contains("the texels") && said.contains("--size"), "{said}");
    assert_eq!(names(folder.path()), ["cornell.glb"]);
    let (code, said) = limited("plan");
    assert!(code == Some(0) && said.contains("note: ") && said.contains("--size"), "{said}");
}

/// Names that are no Unicode: below a folder everything works, as a scene's own name it costs that scene.
#[cfg(unix)]
#[test]
fn names_that_are_not_unicode_stop_nothing_else() {
    use std::os::unix::ffi::OsStrExt;
    let folder = folder(&[]);
    let odd = folder.path().join(std::ffi::OsStr::from_bytes(b"l\xff"));
    std::fs::create_dir(&odd).unwrap();
    std::fs::copy(asset("cornell.glb"), odd.join("a.glb")).unwrap();
    let bad = std::ffi::OsStr::from_bytes(b"b\xff.glb");
    let output = quick(&["bake", ".", "--json"], folder.path()).ended(0);
    let plan = quick(&["plan", ".", "--json"], folder.path()).ended(0);
    for line in [output.stdout, plan.stdout].concat().lines() {
        let event: Value = serde_json::from_str(line).unwrap();
        assert!(event["event"].is_string(), "{line}");
    }
    assert!(odd.join("baked/a.lightmap.exr").exists());

    std::fs::copy(asset("cornell.glb"), odd.join(bad)).unwrap();
    std::fs::remove_dir_all(odd.join("baked")).unwrap();
    let output = quick(&["bake", ".", "--json"], folder.path());
    assert_eq!(output.code, Some(1), "{}", output.stderr);
    let done: Value = serde_json::from_str(output.stdout.lines().last().unwrap()).unwrap();
    assert_eq!((&done["event"], &done["scenes"]), (&"done".into(), &2.into()));
    assert_eq!(done["failed"].as_array().unwrap().len(), 1);
    assert!(odd.join("baked/a.lightmap.exr").exists(), "the other scene is baked");

    let named = Command::new(env!("CARGO_BIN_EXE_luxel")).arg("bake").arg(odd.join(bad)).output().unwrap();
    assert_eq!(named.status.code(), Some(2), "{}", String::from_utf8_lossy(&named.stderr));
}

#[test]
fn a_scene_without_geometry_is_told_so_and_not_about_light() {
    let folder = folder(&[]);
    std::fs::write(folder.path().join("e.gltf"), r#"{"asset":{"version":"2.0"},"scenes":[{}]}"#).unwrap();
    quick(&["bake", "e.gltf"], folder.path()).ended(0);
    let report: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("baked/e.bake.json")).unwrap()).unwrap();
    let codes: Vec<_> = report["warnings"].as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect();
    assert_eq!(codes, ["no-geometry"]);
}

#[test]
fn the_defaults_can_be_had_as_a_file() {
    let folder = folder(&[]);
    let output = luxel(&["defaults"], folder.path()).ended(0);
    assert_eq!(output.stdout, std::fs::read_to_string(asset("luxel.toml")).unwrap());
}
