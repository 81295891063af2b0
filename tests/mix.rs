//! Light groups: what they are, and that their light can be weighed anew without a bake.

mod tool;

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::{DVec3, Vec3};
use luxel_scene::{LightKind, Scene, build::Builder};
use serde_json::Value;
use tempfile::TempDir;
use tool::{Outputs, Run, luxel};

/// A room with a panel, a lamp and a coloured lamp, of these strengths.
fn room(panel: f32, lamps: f32, spot: f32) -> Scene {
    let mut b = Builder::new("room");
    let (wall, red) = (b.matte(Vec3::splat(0.6)), b.matte(Vec3::new(0.7, 0.2, 0.1)));
    let glow = b.emitter(Vec3::ZERO, Vec3::new(8.0, 7.0, 5.0) * panel);
    b.cuboid("walls", Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), wall, true);
    b.cuboid("crate", Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 1.0, 2.0), red, false);
    b.quad("panel", Vec3::new(1.0, 2.9, 1.0), Vec3::X, Vec3::Z, glow);
    for (i, x) in [0.7, 3.1].into_iter().enumerate() {
        let kind = LightKind::Point { position: DVec3::new(x, 2.0, 4.0), range: None, radius: 0.0 };
        b.light(&format!("lamp {i}"), kind, Vec3::new(3.0, 3.0, 2.0) * lamps);
    }
    let kind = LightKind::Point { position: DVec3::new(3.0, 1.0, 3.0), range: None, radius: 0.0 };
    b.light("spot", kind, Vec3::new(0.0, 2.0, 4.0) * spot);
    b.build()
}

fn save(folder: &TempDir, scene: &Scene) {
    let bytes = luxel_assets::glb::write(scene).unwrap();
    std::fs::write(folder.path().join("room.glb"), bytes).unwrap();
}

fn quick(args: &[&str], folder: &TempDir) -> Run {
    const QUICK: [&str; 8] = ["--preset", "draft", "--gather", "lightcuts", "--size", "64", "--voxels", "2000"];
    luxel(&[args, &QUICK].concat(), folder.path())
}

fn lightmap(folder: &TempDir, at: &str) -> Vec<Vec3> {
    Outputs::read(&folder.path().join(at), "room").lightmaps[0].irradiance().to_vec()
}

fn bytes(folder: &TempDir, file: &str) -> Vec<u8> {
    std::fs::read(folder.path().join(file)).unwrap()
}

#[test]
fn a_mix_has_the_bytes_of_a_scene_whose_lamps_are_so_strong() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    quick(&["bake", "room.glb"], &folder).ended(0);
    let plan = quick(&["plan", "room.glb"], &folder).ended(0).stdout;
    assert!(plan.contains("groups     lamp 0, lamp 1, panel, spot"), "{plan}");

    let mix = ["export", "room.glb", "--mix", "panel=0.5,lamp 0=0", "--mix", "spot=2"];
    quick(&mix, &folder).ended(0);
    let report = Outputs::read(&folder.path().join("mixed"), "room");
    for stage in ["surfels", "shoot", "propagate", "clear", "direct", "gather"] {
        assert_eq!(report.stage(stage).0, "reused", "{stage}");
    }
    assert_eq!(report.report["mix"]["panel"], 0.5);
    assert_eq!(report.report["mix"]["lamp 1"], 1.0);

    // Halves and doubles of strengths are exact.
    let mut other = room(0.5, 1.0, 2.0);
    other.lights[0].intensity = Vec3::ZERO;
    let elsewhere = tempfile::tempdir().unwrap();
    save(&elsewhere, &other);
    quick(&["bake", "room.glb"], &elsewhere).ended(0);
    let bits = |map: Vec<Vec3>| map.into_iter().map(|e| e.to_array().map(f32::to_bits)).collect::<Vec<_>>();
    let mixed = bits(lightmap(&folder, "mixed"));
    assert!(mixed == bits(lightmap(&elsewhere, "baked")) && mixed != bits(lightmap(&folder, "baked")));
}

#[test]
fn a_mix_of_nothing_is_the_bake_and_the_dark() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    quick(&["bake", "room.glb"], &folder).ended(0);
    quick(&["export", "room.glb", "--mix", "spot=1", "--to", "same"], &folder).ended(0);
    for file in ["room.lightmap.exr", "room.glb", "room.preview.png"] {
        assert!(bytes(&folder, &format!("same/{file}")) == bytes(&folder, &format!("baked/{file}")), "{file}");
    }
    quick(&["export", "room.glb", "--mix", "spot=0,panel=0,lamp 0=0,lamp 1=0", "--to", "dark"], &folder).ended(0);
    assert!(lightmap(&folder, "dark").iter().all(|e| *e == Vec3::ZERO));
    // It is not taken for a bake.
    let said = quick(&["bake", "room.glb", "--check", "--out", "same"], &folder).ended(3).stderr;
    assert!(said.contains("weighed anew"), "{said}");
}

#[test]
fn groups_add_up_to_what_they_are_together() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    quick(&["bake", "room.glb"], &folder).ended(0);
    quick(&["bake", "room.glb", "--light-groups", "one", "--out", "one"], &folder).ended(0);
    let (apart, together) = (lightmap(&folder, "baked"), lightmap(&folder, "one"));
    let mean = |map: &[Vec3]| map.iter().map(|e| e.as_dvec3()).sum::<DVec3>() / map.len() as f64;
    let (a, b) = (mean(&apart), mean(&together));
    assert!((a - b).abs().max_element() < 0.01 * b.max_element(), "{a} {b}");
    let square = |i: usize| (apart[i] - together[i]).as_dvec3().length_squared();
    let rmse = ((0..apart.len()).map(square).sum::<f64>() / (3.0 * apart.len() as f64)).sqrt();
    assert!(rmse < 0.05 * b.element_sum() / 3.0, "{rmse} of {b}");
}

#[test]
fn groups_are_named_by_extras_and_the_rest_by_their_nodes() {
    let folder = tempfile::tempdir().unwrap();
    let mut scene = room(1.0, 1.0, 1.0);
    scene.lights[0].group = "lamps".into();
    scene.lights[1].group = "lamps".into();
    save(&folder, &scene);
    let groups = |flags: &[&str]| {
        let said = quick(&[&["plan", "room.glb"], flags].concat(), &folder).ended(0).stdout;
        said.lines().find_map(|l| Some(l.strip_prefix("  groups     ")?.to_owned())).unwrap()
    };
    assert_eq!(groups(&[]), "lamps, panel, spot");
    assert_eq!(groups(&["--sky", "1,1,1"]), "lamps, panel, sky, spot");
    assert_eq!(groups(&["--light-groups", "one"]), "all");
}

#[test]
fn what_cannot_be_mixed_is_told() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    quick(&["bake", "room.glb"], &folder).ended(0);
    let said = quick(&["export", "room.glb", "--mix", "moon=2"], &folder).ended(1).stderr;
    assert!(said.contains("\"moon\"") && said.contains("\"lamp 0\", \"lamp 1\", \"panel\", \"spot\""), "{said}");
    quick(&["export", "room.glb", "--mix", "spot=-1"], &folder).ended(2);
    quick(&["export", "room.glb"], &folder).ended(2);
    let said = quick(&["export", "room.glb", "--mix", "spot=3e38"], &folder).ended(1).stderr;
    assert!(said.contains("\"spot\"") && said.contains("at most"), "{said}");
    // Other settings are other light.
    quick(&["export", "room.glb", "--mix", "spot=2", "--bounces", "2"], &folder).ended(1);
    quick(&["export", "room.glb", "--mix", "spot=2"], &folder).ended(0);
}

/// Names and contents of everything below a folder, hidden ones too.
fn everything(folder: &TempDir) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut all, mut open) = (BTreeMap::new(), vec![folder.path().to_path_buf()]);
    while let Some(path) = open.pop() {
        for entry in std::fs::read_dir(path).unwrap() {
            let path = entry.unwrap().path();
            let is_folder = path.is_dir();
            all.insert(path.clone(), if is_folder { Vec::new() } else { std::fs::read(&path).unwrap() });
            open.extend(is_folder.then_some(path));
        }
    }
    all
}

#[test]
fn what_is_not_stored_is_seen_before_anything_is_made() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    let refused = |what: &str| {
        let before = everything(&folder);
        let run = quick(&["export", "room.glb", "--mix", "spot=2", "--json"], &folder).ended(1);
        let events: Vec<Value> = run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let stages: Vec<&Value> = events.iter().filter(|e| e["event"] == "started").map(|e| &e["stage"]).collect();
        assert_eq!(stages, ["import"], "{what}: {}", run.stdout);
        let said = events.iter().find(|e| e["event"] == "failed").unwrap()["error"].as_str().unwrap();
        assert!(said.contains(what) && said.contains("is not stored") && said.contains("luxel bake"), "{what}: {said}");
        assert!(everything(&folder) == before, "{what}");
    };
    refused("the light of the group \"lamp 0\"");
    quick(&["bake", "room.glb"], &folder).ended(0);
    // A stage at a time is missing; the rest of the store is as the bake left it.
    for (kind, what) in [
        ("gather", "the light of the group"),
        ("direct", "the light of the group"),
        ("clear", "(the stage clear)"),
        ("unwrap", "the unwrap of"),
        ("layout", "(the stage unwrap)"),
    ] {
        let (there, away) = (folder.path().join("baked/.luxel").join(kind), folder.path().join("away"));
        std::fs::rename(&there, &away).unwrap();
        refused(what);
        std::fs::rename(&away, &there).unwrap();
    }
    quick(&["export", "room.glb", "--mix", "spot=2"], &folder).ended(0);
}

#[test]
fn an_export_replaces_no_bake_however_its_place_is_spelt() {
    let folder = tempfile::tempdir().unwrap();
    save(&folder, &room(1.0, 1.0, 1.0));
    quick(&["bake", "room.glb"], &folder).ended(0);
    std::fs::create_dir(folder.path().join("other")).unwrap();
    std::fs::copy(folder.path().join("room.glb"), folder.path().join("other/room.glb")).unwrap();
    quick(&["bake", "other/room.glb", "--out", "lit"], &folder).ended(0);
    let before = everything(&folder);
    let absolute = folder.path().join("baked").to_str().unwrap().to_owned();
    for to in ["baked", "./baked", "other/../baked", "none/../baked", absolute.as_str(), "lit"] {
        let said = quick(&["export", "room.glb", "--mix", "spot=2", "--to", to], &folder).ended(1).stderr;
        assert!(said.contains("does not replace the bake of room") && said.contains("--to"), "{to}: {said}");
        assert!(everything(&folder) == before, "{to}");
    }
    let said = quick(&["export", "room.glb", "--mix", "spot=2", "--to", "."], &folder).ended(2).stderr;
    assert!(said.contains("--to") && !said.contains("--out"), "{said}");
    let both = ["export", "room.glb", "other/room.glb", "--mix", "spot=2", "--to", "both"];
    let said = quick(&both, &folder).ended(2).stderr;
    assert!(said.contains("would both write") && said.contains("--to"), "{said}");
    // What may be a bake is taken for one.
    std::fs::write(folder.path().join("lit/room.bake.json"), "{").unwrap();
    let said = quick(&["export", "room.glb", "--mix", "spot=2", "--to", "lit"], &folder).ended(1).stderr;
    assert!(said.contains("may be a bake"), "{said}");
    // A mix replaces a mix.
    for _ in 0..2 {
        quick(&["export", "room.glb", "--mix", "spot=2", "--to", "dusk"], &folder).ended(0);
    }
}

#[test]
fn a_group_is_named_without_the_blanks_around_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut document: Value = {
        save(&folder, &room(1.0, 1.0, 1.0));
        let bytes = bytes(&folder, "room.glb");
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        std::fs::write(folder.path().join("room.bin"), &bytes[28 + length..]).unwrap();
        serde_json::from_slice(&bytes[20..20 + length]).unwrap()
    };
    document["buffers"][0]["uri"] = "room.bin".into();
    for node in document["nodes"].as_array_mut().unwrap() {
        if ["spot", "panel"].contains(&node["name"].as_str().unwrap_or_default()) {
            node["name"] = format!("{} ", node["name"].as_str().unwrap()).into();
        }
    }
    std::fs::remove_file(folder.path().join("room.glb")).unwrap();
    std::fs::write(folder.path().join("room.gltf"), document.to_string()).unwrap();
    quick(&["bake", "room.gltf"], &folder).ended(0);
    quick(&["export", "room.gltf", "--mix", "spot=2,panel=0.5"], &folder).ended(0);
}
