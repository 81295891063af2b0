//! Which stages an edit costs, in which words, and that a plan foresees it: every bake here is planned before.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use luxel::current::{State, check};
use luxel::settings::{Layer, Origin, for_scene};
use luxel_export::OutputSet;
use luxel_scene::Silent;
use serde_json::{Value, json};

use crate::baked::{Baked, Place, Target, clean, plan, run};
use crate::level::{Level, SCENE, Shape, matte, object};
use crate::tool::{files, luxel};

/// What every bake does, whatever is stored.
const ALWAYS: [&str; 4] = ["import", "rays", "preview", "export"];

/// What finds light for a group that is new, without what it needs of geometry.
const GROUP: [&str; 5] = ["shoot", "propagate", "cache", "direct", "gather"];

/// An edit to a level that was baked, and what it costs.
struct Edited {
    before: Baked,
    after: Baked,
}

/// Bakes the level, edits it, plans and bakes again, and compares with a clean bake.
fn edited(edit: impl FnOnce(&mut Level)) -> Edited {
    edited_from(Level::new(), edit)
}

fn edited_from(mut level: Level, edit: impl FnOnce(&mut Level)) -> Edited {
    let place = Place::new();
    let before = place.bake_as_planned(&level);
    edit(&mut level);
    let after = place.bake_as_planned(&level);
    after.is_same(&clean(&place.at(SCENE))).unwrap();
    after.forgot_nothing().unwrap();
    Edited { before, after }
}

impl Edited {
    /// Exactly these stages ran besides those that always do.
    fn ran(self, stages: &[&str]) -> Self {
        let expected: Vec<&str> = self.after.report["stages"]
            .as_array()
            .unwrap()
            .iter()
            .map(|s| s["name"].as_str().unwrap())
            .filter(|name| ALWAYS.contains(name) || stages.contains(name))
            .collect();
        assert_eq!(self.after.ran(), expected, "{:#}", self.after.report["stages"]);
        self
    }

    /// All that was reused was so for this reason.
    fn because(self, reason: &str) -> Self {
        let reused = |s: &&Value| s["state"] == "reused";
        for stage in self.after.report["stages"].as_array().unwrap().iter().filter(reused) {
            assert_eq!(stage["reason"], reason, "{}", stage["name"]);
        }
        self
    }

    /// The stages ran for this reason; the first word is that of their own work, the last one of the groups.
    fn ran_because(self, stages: &[&str], reason: &str) -> Self {
        for stage in stages {
            let told = self.after.stage(stage)["reason"].as_str().unwrap();
            assert!(told.split("; ").nth(1) == Some(reason), "{stage}: {told}");
        }
        self
    }

    /// The stages ran for this group alone.
    fn for_group(self, group: &str, stages: &[&str]) -> Self {
        for stage in stages {
            let reason = self.after.stage(stage)["reason"].as_str().unwrap();
            assert!(reason.contains(&format!("; for {group}, stored for ")), "{stage}: {reason}");
        }
        self
    }

    /// The light is another one than before.
    fn changes_the_light(self) -> Self {
        assert!(self.before.light != self.after.light);
        self
    }
}

#[test]
fn a_touched_file_bakes_nothing() {
    let place = Place::new();
    let baked = place.bake_as_planned(&Level::new());
    for name in [SCENE, "level.bin", "image0.png", "luxel.toml"] {
        let file = fs::File::options().append(true).open(place.at(name)).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
    }
    let outputs = OutputSet::new(&place.at(SCENE), None, None).unwrap();
    let settings = for_scene(&place.at(SCENE), None, &Layer::new(Origin::CommandLine)).unwrap();
    let state = check(&place.at(SCENE), &outputs, &settings, &Silent).unwrap();
    assert!(matches!(state, State::Current(_)), "{state:?}");
    // And who bakes all the same computes nothing.
    let again = place.bake_as_planned(&Level::new());
    assert_eq!(again.ran(), ALWAYS);
    again.is_same(&baked).unwrap();
    assert_eq!(again.stage("gather")["reason"], "stored: nothing that it reads has changed");
}

#[test]
fn another_scene_that_changed_is_another_scene() {
    let (folder, mut level) = (tempfile::tempdir().unwrap(), Level::new());
    for name in ["a", "b"] {
        level.write(&folder.path().join("levels").join(name));
    }
    let bake = || {
        let run = luxel(&["bake", "levels", "--out", "lit", "--store", "store", "--json"], folder.path()).ended(0);
        let events = run.stdout.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        let mut done: Vec<(String, String)> = events
            .filter(|e| e["event"] == "baked" || e["event"] == "unchanged")
            .map(|e| (e["scene"].as_str().unwrap().to_owned(), e["event"].as_str().unwrap().to_owned()))
            .collect();
        // Several are baked at a time.
        done.sort();
        done
    };
    let told =
        |a: &str, b: &str| [("levels/a/level.gltf", a), ("levels/b/level.gltf", b)].map(|(s, e)| (s.into(), e.into()));
    assert_eq!(bake(), told("baked", "baked"));
    let first = Baked::read(&folder.path().join("lit/a"));
    level.node("bulb")["translation"] = json!([0.1, 1.1, 0.2]);
    level.write(&folder.path().join("levels/b"));
    assert_eq!(bake(), told("unchanged", "baked"));
    let again = Baked::read(&folder.path().join("lit/a"));
    assert!(again.report == first.report && again.files == first.files);
    let other = Baked::read(&folder.path().join("lit/b"));
    assert_eq!((other.stage("surfels")["state"].as_str(), other.warnings("store")), (Some("reused"), vec![]));
}

/// Both had the same content to begin with, so the second found all of the first's.
#[test]
fn scenes_of_one_content_share_a_store() {
    let (folder, level) = (tempfile::tempdir().unwrap(), Level::new());
    let bake = |name: &str| {
        let scene = level.write(&folder.path().join(name));
        run(&scene, &Target::at(folder.path().join("lit").join(name)).with_store(folder.path().join("store")))
    };
    let (first, second) = (bake("a"), bake("b"));
    assert_eq!(second.ran(), ALWAYS);
    assert!(first.files == second.files);
    assert_eq!(second.stage("gather")["reason"], "stored: its input was seen before");
}

#[test]
fn moving_a_lamp_runs_that_lamp_alone() {
    edited(|level| level.node("bulb")["translation"] = json!([-0.3, 1.4, 0.5]))
        .ran(&[&GROUP[..], &["finish"]].concat())
        .for_group("bulb", &GROUP)
        .because("stored: only lights changed")
        .ran_because(&GROUP, "lights changed")
        .ran_because(&["finish"], "lights changed")
        .changes_the_light();
}

#[test]
fn turning_a_spot_runs_that_spot_alone() {
    edited(|level| level.node("spot")["rotation"] = json!([-0.6, 0.0, 0.0, 0.8]))
        .ran(&[&GROUP[..], &["finish"]].concat())
        .for_group("spot", &GROUP)
        .because("stored: only lights changed")
        .changes_the_light();
}

#[test]
fn another_colour_or_strength_of_a_lamp_gathers_nothing() {
    for edit in [
        |level: &mut Level| level.lights[0]["color"] = json!([0.2, 0.3, 1.0]),
        |level: &mut Level| level.lights[1]["intensity"] = json!(7.5),
        |level: &mut Level| level.materials[2]["emissiveFactor"] = json!([0.1, 1.0, 0.1]),
        |level: &mut Level| level.set("light_scale", "3"),
        |level: &mut Level| level.set("emissive_scale", "0.5"),
    ] {
        let done = edited(edit).ran(&["finish"]).changes_the_light();
        assert!(done.after.stage("gather")["reason"].as_str().unwrap().starts_with("stored: only "));
    }
    edited(|level| level.lights[0]["color"] = json!([0.2, 0.3, 1.0])).because("stored: only lights changed");
}

#[test]
fn a_lamp_that_is_added_or_removed_leaves_the_others() {
    let add = |level: &mut Level| level.nodes.push(crate::level::lamp("third", 0, [1.2, 1.0, 1.0]));
    edited(add).ran(&[&GROUP[..], &["finish"]].concat()).for_group("third", &GROUP).changes_the_light();
    edited(|level| level.nodes.retain(|n| n["name"] != "bulb")).ran(&["finish"]).changes_the_light();
}

/// A lamp that lies in a wall shares voxels with it.
fn lamp_in_the_wall() -> Level {
    let mut level = Level::new();
    let panel = level.node("panel");
    panel["translation"] = json!([0.9, 1.0, -1.999]);
    panel["rotation"] = json!([0.0, 0.0, 0.0, 1.0]);
    level
}

#[test]
fn a_surface_that_is_switched_off_and_on_leaves_the_others() {
    let off = |level: &mut Level| level.materials[2]["emissiveFactor"] = json!([0.0, 0.0, 0.0]);
    edited_from(lamp_in_the_wall(), off)
        .ran(&["finish"])
        .because("stored: only lights changed")
        .ran_because(&["finish"], "lights changed")
        .changes_the_light();
    let mut dark = lamp_in_the_wall();
    off(&mut dark);
    edited_from(dark, |level| level.materials[2]["emissiveFactor"] = json!([1.0, 0.8, 0.5]))
        .ran(&[&GROUP[..], &["finish"]].concat())
        .for_group("panel", &GROUP)
        .because("stored: only lights changed")
        .changes_the_light();
}

#[test]
fn another_image_of_a_surfaces_light_leaves_the_others() {
    let image =
        |index: usize| move |level: &mut Level| level.materials[2]["emissiveTexture"] = json!({ "index": index });
    let mut before = lamp_in_the_wall();
    image(0)(&mut before);
    for level in [lamp_in_the_wall(), before] {
        edited_from(level, image(3))
            .ran(&[&GROUP[..], &["finish"]].concat())
            .for_group("panel", &GROUP)
            .because("stored: only lights changed")
            .changes_the_light();
    }
}

#[test]
fn the_name_of_a_lamp_matters_to_photons_alone() {
    edited(|level| level.lights[0]["name"] = json!("torch"))
        .ran(&[])
        .because("stored: nothing that it reads has changed");
    // The node's name is that of its group.
    edited(|level| level.node("bulb")["name"] = json!("lantern")).ran(&[]).because("stored: only lights changed");
    let mut level = Level::new();
    level.set("photons", "1000");
    edited_from(level, |level| level.lights[0]["name"] = json!("torch"))
        .ran(&["shoot", "propagate", "cache", "gather", "finish"])
        .ran_because(&["shoot", "gather"], "lights changed")
        .changes_the_light();
}

#[test]
fn a_sky_that_changes_runs_the_sky_alone() {
    let place = Place::new();
    let mut level = Level::new();
    level.set("sky", "\"1,1,1\"");
    level.set("gather", "\"lightcuts\"");
    place.bake_as_planned(&level);
    level.set("sky", "\"1,1,1/0.5,0.5,0.5/0.1,0.1,0.1\"");
    let other = place.bake_as_planned(&level);
    for stage in ["propagate", "cache", "gather"] {
        assert!(other.stage(stage)["reason"].as_str().unwrap().contains("; for sky, stored for bulb, panel, spot"));
    }
    for stage in ["surfels", "shoot", "clear", "direct", "unwrap"] {
        assert_eq!(other.stage(stage)["state"], "reused", "{stage}");
    }
    assert_eq!(other.stage("sky")["state"], "ran");
    other.is_same(&clean(&place.at(SCENE))).unwrap();
    level.set("sky_strength", "2.5");
    let stronger = place.bake_as_planned(&level);
    assert_eq!(stronger.ran(), ["import", "rays", "finish", "preview", "export"]);
    stronger.is_same(&clean(&place.at(SCENE))).unwrap();
}

#[test]
fn another_albedo_keeps_unwraps_and_direct_light() {
    edited(|level| level.materials[3] = matte([0.1, 0.5, 0.2]))
        .ran(&["surfels", "shoot", "propagate", "cache", "gather", "finish"])
        .because("stored: only materials changed")
        .ran_because(&["surfels", "shoot", "propagate", "cache", "gather", "finish"], "materials changed")
        .changes_the_light();
}

#[test]
fn another_texture_keeps_unwraps_and_direct_light() {
    edited(|level| level.images[0] = 77)
        .ran(&["surfels", "shoot", "propagate", "cache", "gather", "finish"])
        .because("stored: only materials changed");
}

#[test]
fn another_size_of_the_lightmap_keeps_the_octree_and_unwraps() {
    let done = edited(|level| level.set("size", "64"))
        .ran(&["unwrap", "clear", "direct", "gather", "finish"])
        .because("stored: only the setting size changed");
    assert_eq!(done.after.count("unwrap", "stored_unwraps"), done.after.count("unwrap", "unwrapped_meshes"));
    done.ran_because(&["unwrap", "clear", "direct", "gather"], "the setting size changed");
}

#[test]
fn settings_run_what_reads_them_and_what_follows() {
    for (setting, value, stages) in [
        ("voxels", "500", &["surfels", "shoot", "propagate", "cache", "gather", "finish"][..]),
        ("directions", "32", &["propagate", "cache", "gather", "finish"]),
        ("refresh", "4", &["propagate", "refresh", "cache", "gather", "finish"]),
        ("gather", "\"lightcuts\"", &["gather", "finish"]),
        ("shadow_samples", "8", &["shoot", "propagate", "cache", "direct", "gather", "finish"]),
        ("threads", "1", &[]),
        ("only", "\"direct\"", &["finish"]),
    ] {
        edited(|level| level.set(setting, value))
            .ran(stages)
            .ran_because(stages, &format!("the setting {setting} changed"));
    }
    edited(|level| level.set("sky_rays", "64")).ran(&[]).because("stored: only the setting sky_rays changed");
    let mut level = Level::new();
    level.set("sky", "\"1,1,2\"");
    level.set("gather", "\"lightcuts\"");
    let sky = ["sky", "finish"];
    edited_from(level, |level| level.set("sky_rays", "64")).ran(&sky).ran_because(&sky, "the setting sky_rays changed");
}

#[test]
fn another_target_gathers_nothing() {
    let place = Place::new();
    let scene = Level::new().write(place.folder.path());
    let to = |out: &str| Target::at(place.at(out)).with_store(place.at("store"));
    let first = run(&scene, &to("engine"));
    let planned = plan(&scene, &to("browser"));
    let second = run(&scene, &to("browser"));
    second.is_as(&planned).unwrap();
    assert_eq!(second.ran(), ALWAYS);
    second.is_same(&first).unwrap();
}

#[test]
fn one_mesh_that_changes_is_the_only_one_to_be_unwrapped() {
    let done = edited(|level| level.shapes[3].size = [0.5, 0.8, 0.4]);
    let [meshes, stored] = ["unwrapped_meshes", "stored_unwraps"].map(|c| done.after.count("unwrap", c));
    assert_eq!((meshes, stored), (4, 3));
    assert_eq!(done.after.stage("unwrap")["state"], "ran");
    let told = "; what receives light changed; meshes unwrapped now: 1, unwraps that were stored: 3, further instances \
                that share an unwrap: 1, meshes that keep their TEXCOORD_1: 0, charts placed anew";
    let reason = done.after.stage("unwrap")["reason"].as_str().unwrap();
    assert!(reason.ends_with(told), "{reason}");
}

#[test]
fn one_more_instance_of_a_mesh_unwraps_nothing() {
    let done = edited(|level| level.nodes.push(object("crate.002", 3, [1.2, 0.3, 0.9])));
    let [meshes, stored, shared] =
        ["unwrapped_meshes", "stored_unwraps", "shared_unwraps"].map(|c| done.after.count("unwrap", c));
    assert_eq!((meshes, stored, shared), (4, 4, 2));
}

#[test]
fn a_name_or_a_padding_places_charts_and_unwraps_nothing() {
    let edits: [fn(&mut Level); 2] =
        [|level| level.node("crate")["name"] = json!("box"), |level| level.set("padding", "4")];
    for edit in edits {
        let done = edited(edit);
        let unwrap = done.after.stage("unwrap");
        let reason = unwrap["reason"].as_str().unwrap();
        assert!(
            unwrap["state"] == "ran" && reason.contains("; meshes unwrapped now: 0, unwraps that were stored: 4, ")
        );
        assert!(reason.ends_with(", charts placed anew"), "{reason}");
    }
}

/// The artefacts that were used since everything was marked as old, and those that were not, by their kinds.
fn used(store: &Path, work: impl FnOnce()) -> [BTreeSet<String>; 2] {
    let all = || files(store).into_keys().map(|name| store.join(name));
    for path in all() {
        fs::File::options().append(true).open(path).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    }
    work();
    let is_used = |path: &PathBuf| fs::metadata(path).unwrap().modified().unwrap() > SystemTime::UNIX_EPOCH;
    let kind = |path: PathBuf| path.parent().unwrap().file_name().unwrap().to_str().unwrap().to_owned();
    let (used, left): (Vec<PathBuf>, Vec<PathBuf>) = all().partition(is_used);
    [used, left].map(|paths| paths.into_iter().map(kind).collect())
}

/// An octree of a level in which lamps are moved all day must not be the first to be evicted.
#[test]
fn what_was_made_from_an_artefact_that_is_used_is_used() {
    let mut level = Level::new();
    level.set("sky", "\"1,1,2\"");
    level.set("gather", "\"lightcuts\"");
    let place = Place::new();
    place.bake_as_planned(&level);
    let store = place.at("baked/.luxel");
    // The finished images serve.
    let [all, left] = used(&store, || assert_eq!(place.bake(&level).ran(), ALWAYS));
    assert_eq!(all.len(), 10, "{all:?}");
    assert!(left.is_empty(), "{left:?}");
    // They do not, the gathers do.
    level.lights[0]["color"] = json!([0.2, 0.3, 1.0]);
    let bake = |level: &Level| place.bake(level).ran().contains(&"gather");
    let [all, left] = used(&store, || assert!(!bake(&level)));
    assert!(all.len() == 10 && left.iter().eq(["finish"]), "{left:?}");
    // The octrees do.
    level.set("near_rays", "5");
    let [all, left] = used(&store, || assert!(bake(&level)));
    assert!(all.len() == 10 && left.iter().eq(["finish", "gather"]), "{left:?}");
    // The direct light at surfels does.
    level.set("bounces", "3");
    let [all, left] = used(&store, || assert!(bake(&level)));
    assert!(all.len() == 10 && left.iter().eq(["finish", "gather", "solution"]), "{left:?}");
}

#[test]
fn a_first_bake_and_one_whose_store_was_emptied_say_so() {
    let (place, level) = (Place::new(), Level::new());
    let first = place.bake_as_planned(&level);
    let stored = ["unwrap", "surfels", "shoot", "propagate", "cache", "clear", "direct", "gather", "finish"];
    let why = |baked: &Baked, stage: &str| {
        baked.stage(stage)["reason"].as_str().unwrap().split("; ").nth(1).unwrap_or_default().to_owned()
    };
    assert_eq!(stored.map(|stage| why(&first, stage)), ["nothing stored for it"; 9]);
    fs::remove_dir_all(place.at("baked/.luxel")).unwrap();
    let again = place.bake_as_planned(&level);
    assert_eq!(stored.map(|stage| why(&again, stage)), ["not stored any more"; 9]);
    let always = ALWAYS.map(|stage| (stage, why(&again, stage)));
    let said: Vec<_> = always.iter().filter(|(_, why)| !why.is_empty()).collect();
    assert!(
        said.iter().all(|(stage, why)| *stage == "rays" && why == "their tree is that of the last bake"),
        "{said:?}"
    );
    again.is_same(&first).unwrap();
}

#[test]
fn a_moved_object_unwraps_nothing() {
    let done = edited(|level| level.node("crate")["translation"] = json!([-0.2, 0.4, 0.3]));
    assert_eq!(done.after.count("unwrap", "stored_unwraps"), 4);
    done.because("stored: only geometry and what receives light changed").changes_the_light();
}

#[test]
fn an_edit_that_is_undone_runs_nothing() {
    let edits: [fn(&mut Level); 7] = [
        |level| level.node("bulb")["translation"] = json!([-0.3, 1.4, 0.5]),
        |level| level.lights[0]["intensity"] = json!(9.0),
        |level| level.materials[3] = matte([0.1, 0.5, 0.2]),
        |level| level.shapes[3].size = [0.5, 0.8, 0.4],
        |level| level.set("size", "64"),
        |level| level.nodes.push(object("crate.002", 3, [1.2, 0.3, 0.9])),
        |level| level.set("sky", "\"1,1,1\""),
    ];
    let place = Place::new();
    let level = Level::new();
    let first = place.bake_as_planned(&level);
    for edit in edits {
        let mut other = level.clone();
        edit(&mut other);
        let changed = place.bake_as_planned(&other);
        assert!(changed.light != first.light);
        let undone = place.bake_as_planned(&level);
        assert_eq!(undone.ran(), ALWAYS);
        undone.is_same(&first).unwrap();
    }
}

#[test]
fn what_light_does_not_see_runs_nothing() {
    let edits: [fn(&mut Level); 5] = [
        |level| level.camera = Some(json!({ "at": [0.5, 1.5, 9.0], "aspect": 10.0 })),
        |level| level.materials[0]["name"] = json!("plaster"),
        |level| level.node("bulb")["extras"] = json!({ "owner": "somebody" }),
        |level| level.materials[0]["extras"] = json!([1, 2]),
        |level| level.materials.push(matte([0.0, 1.0, 0.0])),
    ];
    for edit in edits {
        edited(edit).ran(&[]).because("stored: nothing that it reads has changed");
    }
}

#[test]
fn a_shape_that_nobody_uses_changes_nothing() {
    edited(|level| level.shapes.push(Shape::quad([1.0, 1.0], 0))).ran(&[]);
}

#[test]
fn the_tool_foresees_what_it_does() {
    let (folder, mut level) = (tempfile::tempdir().unwrap(), Level::new());
    level.write(folder.path());
    luxel(&["bake", SCENE], folder.path()).ended(0);
    level.node("bulb")["translation"] = json!([-0.3, 1.4, 0.5]);
    level.write(folder.path());
    let planned = luxel(&["plan", SCENE, "--json"], folder.path()).ended(0).stdout;
    let events: Vec<Value> = planned.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let plan = &events.iter().find(|e| e["event"] == "plan").unwrap()["plan"];
    luxel(&["bake", SCENE], folder.path()).ended(0);
    let baked = Baked::read(&folder.path().join("baked"));
    let steps = plan["steps"].as_array().unwrap();
    assert_eq!(steps.len(), baked.report["stages"].as_array().unwrap().len());
    for step in steps {
        let state = match (step["runs"].as_bool().unwrap(), step["reused"].as_bool().unwrap()) {
            (false, _) => "left out",
            (true, true) => "reused",
            (true, false) => "ran",
        };
        let stage = baked.stage(step["stage"].as_str().unwrap());
        assert_eq!(stage["state"], state, "{step}");
    }
    assert_eq!(baked.stage("surfels")["reason"], "stored: only lights changed");
    let said = luxel(&["plan", SCENE], folder.path()).ended(0).stdout;
    assert!(said.contains("stored: ") || said.contains("unchanged"), "{said}");
}
