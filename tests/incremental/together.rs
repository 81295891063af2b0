//! Bakes that share a store at the same time: right bytes, no torn file, nothing to complain of.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use luxel::store::Store;
use luxel_scene::Silent;
use serde_json::json;

use crate::baked::{Baked, Place, clean};
use crate::level::{Level, SCENE};

const ROUNDS: usize = 6;

fn start(folder: &Path, scene: &str, out: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(["bake", scene, "--out", out, "--store", "store", "--force", "--quiet"])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn ended_well(child: Child) {
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Every file of the store is what its name says, and no temporary one is left.
fn is_whole(folder: &Path) {
    let store = Store::new(folder.join("store"));
    let verified = store.verify(&Silent).unwrap();
    assert!(verified.bad.is_empty() && verified.outdated.is_empty() && verified.sound.files > 5, "{verified:?}");
    for entry in fs::read_dir(folder.join("store")).unwrap() {
        let kind = entry.unwrap().path();
        let temporary = |path: &Path| path.file_name().unwrap().as_encoded_bytes().starts_with(b".");
        let left: Vec<_> = fs::read_dir(kind).unwrap().map(|e| e.unwrap().path()).filter(|p| temporary(p)).collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

#[test]
fn two_bakes_of_one_scene_into_one_store() {
    let place = Place::new();
    let mut level = Level::new();
    for round in 0..ROUNDS {
        level.node("bulb")["translation"] = json!([0.1 * round as f64, 1.2, 0.5]);
        // Every other time the second finds what the first is just writing, else what it wrote before.
        if round % 2 == 0 {
            let _none = fs::remove_dir_all(place.at("store"));
        }
        let right = clean(&level.write(place.folder.path()));
        let both = ["a", "b"].map(|out| start(place.folder.path(), SCENE, out));
        both.into_iter().for_each(ended_well);
        for out in ["a", "b"] {
            let baked = Baked::read(&place.at(out));
            assert!(baked.files == right.files, "round {round}, {out}");
            assert_eq!(baked.warnings("store"), [""; 0]);
        }
        is_whole(place.folder.path());
    }
}

#[test]
fn bakes_of_two_scenes_into_one_store() {
    let place = Place::new();
    let mut levels = [Level::new(), Level::new()];
    levels[1].node("crate")["translation"] = json!([0.9, 0.4, 0.4]);
    for round in 0..ROUNDS {
        let _none = fs::remove_dir_all(place.at("store"));
        let right = [0, 1].map(|i| {
            // Once they agree in everything, once in part.
            levels[i].node("spot")["translation"] = json!([0.1 * (i * (round % 2)) as f64, 1.8, 0.6]);
            clean(&levels[i].write(&place.at(&format!("scene{i}"))))
        });
        let both = [0, 1].map(|i| start(place.folder.path(), &format!("scene{i}/{SCENE}"), &format!("lit{i}")));
        both.into_iter().for_each(ended_well);
        for (i, right) in right.iter().enumerate() {
            let baked = Baked::read(&place.at(&format!("lit{i}")));
            assert!(baked.files == right.files, "round {round}, scene {i}");
            assert_eq!(baked.warnings("store"), [""; 0]);
        }
        is_whole(place.folder.path());
    }
}
