//! What `luxel watch` promises, by counting bakes and comparing what they wrote.

mod tool;
mod watching;

use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use luxel::settings::{Layer, Origin};
use luxel::watch::event::Event;
use luxel::watch::{Choices, Options, Task, Watch};
use tool::watcher::Tool;
use watching::*;

/// Makes these bytes the content of a file.
type Save = fn(&Path, &[u8]);

/// How editors save.
const PATTERNS: [(&str, Save); 6] = [
    ("truncate and write", |path, bytes| std::fs::write(path, bytes).unwrap()),
    ("truncate and write in pieces", |path, bytes| {
        let mut file = std::fs::File::create(path).unwrap();
        for piece in bytes.chunks(bytes.len() / 7) {
            // Seen piece by piece, but not waited for: a disk may take longer than a burst of changes lasts.
            file.write_all(piece).unwrap();
        }
    }),
    ("write another and rename it", |path, bytes| {
        let other = path.with_extension("tmp");
        std::fs::write(&other, bytes).unwrap();
        std::fs::rename(other, path).unwrap();
    }),
    ("write another elsewhere and rename it", |path, bytes| {
        let other = path.parent().unwrap().join(".saving");
        std::fs::create_dir_all(&other).unwrap();
        std::fs::write(other.join("x"), bytes).unwrap();
        std::fs::rename(other.join("x"), path).unwrap();
    }),
    ("delete and create", |path, bytes| {
        std::fs::remove_file(path).unwrap();
        std::fs::write(path, bytes).unwrap();
    }),
    ("rename to a backup, create, delete the backup", |path, bytes| {
        let backup = path.with_extension("gltf~");
        std::fs::rename(path, &backup).unwrap();
        std::fs::write(path, bytes).unwrap();
        std::fs::remove_file(backup).unwrap();
    }),
];

fn every_pattern(poll: Option<Duration>) {
    let mut bench = Bench::new(&["levels"], poll, |folder| furnish(folder, "levels/a"));
    for (n, (name, save)) in PATTERNS.iter().enumerate() {
        for file in ["levels/a.gltf", "levels/a.bin"] {
            let before = bench.bakes();
            let bytes = if file.ends_with("bin") { corners(n + 1) } else { gltf("a", n + 1).into_bytes() };
            save(&bench.at(file), &bytes);
            bench.baked("levels/a.gltf");
            bench.settle(file);
            assert_eq!(bench.bakes() - before, 1, "{name}, {file}");
            bench.assert_current("levels/a.gltf");
        }
    }
    assert!(bench.end().0.is_empty());
}

#[test]
fn every_way_of_saving_bakes_once() {
    every_pattern(None);
}

#[test]
fn every_way_of_saving_bakes_once_where_folders_are_polled() {
    every_pattern(Some(Duration::from_millis(50)));
}

#[test]
fn a_touched_or_equal_file_bakes_nothing() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    assert_eq!(bench.attempts(), 1);
    bench.settle("a.gltf");
    bench.settle("a.bin");
    for (_, save) in PATTERNS {
        save(&bench.at("a.gltf"), gltf("a", 0).as_bytes());
        bench.settle("a.gltf");
    }
    assert_eq!(bench.attempts(), 1);
    bench.end();
}

#[test]
fn of_a_burst_the_last_state_is_baked_and_at_most_two_bakes_end() {
    for poll in [None, Some(Duration::from_millis(50))] {
        let mut bench = Bench::new(&["."], poll, |folder| furnish(folder, "a"));
        bench.shut(true);
        for n in 1..=50 {
            PATTERNS[n % PATTERNS.len()].1(&bench.at("a.gltf"), gltf("a", n).as_bytes());
        }
        bench.shut(false);
        bench.baked("a.gltf");
        bench.settle("a.gltf");
        assert!((2..=3).contains(&bench.bakes()), "{} with the first one", bench.bakes());
        bench.assert_current("a.gltf");
        bench.end();
    }
}

#[test]
fn a_change_during_a_bake_stops_it_and_one_more_follows() {
    let mut bench = Bench::new(&["."], None, |folder| furnish(folder, "a"));
    bench.shut(true);
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.held();
    // A touch does not stop it.
    bench.heed("a.gltf");
    std::fs::write(bench.at("a.bin"), corners(2)).unwrap();
    bench.wait("overtaken", |e| matches!(e, Event::Overtaken { .. }));
    bench.held();
    bench.shut(false);
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!((bench.attempts(), bench.bakes()), (3, 2));
    bench.assert_current("a.gltf");
    bench.end();
}

#[test]
fn a_change_during_a_bake_that_ends_well_all_the_same_is_baked_too() {
    let mut bench = Bench::new(&["."], None, |folder| furnish(folder, "a"));
    bench.deafen();
    bench.shut(true);
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.held();
    std::fs::write(bench.at("a.bin"), corners(2)).unwrap();
    // Its hints are used up before the bake ends.
    bench.heed("a.gltf");
    bench.shut(false);
    bench.baked("a.gltf");
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), 3, "with the first one");
    bench.assert_current("a.gltf");
    // What was changed back when such a bake ends is baked anew, since its outputs are of what it has read.
    bench.shut(true);
    std::fs::write(bench.at("a.bin"), corners(3)).unwrap();
    bench.held();
    std::fs::write(bench.at("a.bin"), corners(2)).unwrap();
    bench.heed("a.gltf");
    bench.shut(false);
    bench.baked("a.gltf");
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), 5);
    bench.assert_current("a.gltf");
    bench.end();
}

#[test]
fn what_is_changed_back_during_a_bake_is_not_baked_again() {
    let mut bench = Bench::new(&["."], None, |folder| furnish(folder, "a"));
    bench.shut(true);
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.held();
    std::fs::write(bench.at("a.bin"), corners(0)).unwrap();
    bench.wait("overtaken", |e| matches!(e, Event::Overtaken { .. }));
    bench.shut(false);
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), 1);
    bench.assert_current("a.gltf");
    bench.end();
}

#[test]
fn what_is_changed_back_when_a_draft_lies_there_is_baked_again() {
    let mut bench = Bench::new(&["."], None, |folder| furnish(folder, "a"));
    bench.draft();
    bench.shut(true);
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.wait("drafted", |e| matches!(e, Event::Drafted { .. }));
    bench.held();
    std::fs::write(bench.at("a.bin"), corners(0)).unwrap();
    bench.wait("overtaken", |e| matches!(e, Event::Overtaken { .. }));
    bench.shut(false);
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), 2, "with the first one");
    bench.assert_current("a.gltf");
    bench.end();
}

#[test]
fn one_scene_leaves_the_others_and_what_changed_last_comes_first() {
    let names = ["a", "b/c", "b/d"];
    let mut bench = Bench::new(&["."], None, |folder| names.iter().for_each(|n| furnish(folder, n)));
    assert_eq!(bench.attempts(), 3);
    std::fs::write(bench.at("b/d.bin"), corners(1)).unwrap();
    bench.baked("b/d.gltf");
    bench.settle("b/d.bin");
    assert_eq!(bench.attempts(), 4);
    bench.shut(true);
    std::fs::write(bench.at("b/c.bin"), corners(1)).unwrap();
    bench.held();
    for name in ["a", "b/d"] {
        std::fs::write(bench.at(&format!("{name}.bin")), corners(2)).unwrap();
        bench.heed(&format!("{name}.gltf"));
    }
    bench.shut(false);
    for name in ["b/c", "b/d", "a"] {
        let wanted = bench.at(&format!("{name}.gltf"));
        let event = bench.wait("baked", |e| matches!(e, Event::Baked { .. }));
        assert!(matches!(&event, Event::Baked { scene, .. } if *scene == wanted), "{name}: {event:?}");
    }
    assert_eq!((bench.attempts(), bench.bakes()), (7, 7));
    bench.end();
}

#[test]
fn a_folder_that_goes_and_comes_back_is_watched_on() {
    for poll in [None, Some(Duration::from_millis(50))] {
        let mut bench = Bench::new(&["levels"], poll, |folder| furnish(folder, "levels/deep/a"));
        let (levels, away) = (bench.at("levels"), bench.at("away"));
        let is_removed = |e: &Event| matches!(e, Event::Removed { .. });
        let is_found = |e: &Event| matches!(e, Event::Found { .. });
        // With its outputs, and back as it was.
        std::fs::rename(&levels, &away).unwrap();
        bench.wait("removed", is_removed);
        std::fs::rename(&away, &levels).unwrap();
        bench.wait("found", is_found);
        bench.idle();
        bench.settle("levels/deep/a.bin");
        assert_eq!(bench.attempts(), 1);
        // And made anew.
        std::fs::remove_dir_all(&levels).unwrap();
        bench.wait("removed", is_removed);
        furnish(bench.folder.path(), "levels/deep/a");
        bench.baked("levels/deep/a.gltf");
        bench.settle("levels/deep/a.gltf");
        assert_eq!(bench.bakes(), 2);
        std::fs::write(bench.at("levels/deep/a.bin"), corners(1)).unwrap();
        bench.baked("levels/deep/a.gltf");
        bench.settle("levels/deep/a.bin");
        assert_eq!(bench.bakes(), 3);
        bench.assert_current("levels/deep/a.gltf");
        bench.end();
    }
}

#[test]
fn outputs_that_have_gone_are_baked_again() {
    for poll in [None, Some(Duration::from_millis(50))] {
        let mut bench = Bench::new(&["levels"], poll, |folder| furnish(folder, "levels/a"));
        // All within one burst, so that nobody sees the scene away.
        std::fs::remove_dir_all(bench.at("levels")).unwrap();
        furnish(bench.folder.path(), "levels/a");
        bench.baked("levels/a.gltf");
        bench.settle("levels/a.gltf");
        assert_eq!(bench.bakes(), 2, "{poll:?}");
        bench.assert_current("levels/a.gltf");
        // And alone: nobody listens there, but in the folder above.
        std::fs::remove_dir_all(bench.at("levels/baked")).unwrap();
        bench.wait("lost", |e| matches!(e, Event::Lost { files, .. } if files.len() == 1));
        bench.baked("levels/a.gltf");
        bench.settle("levels/a.bin");
        assert_eq!(bench.bakes(), 3, "{poll:?}");
        // One of them is missed when its scene is touched.
        std::fs::remove_file(bench.at("levels/baked/a.glb")).unwrap();
        touch(&bench.at("levels/a.bin"));
        bench.wait("lost", |e| matches!(e, Event::Lost { files, .. } if files.len() == 1));
        bench.baked("levels/a.gltf");
        bench.settle("levels/a.bin");
        assert_eq!(bench.bakes(), 4, "{poll:?}");
        bench.assert_current("levels/a.gltf");
        bench.end();
    }
}

#[cfg(unix)]
#[test]
fn a_scene_with_several_names_is_baked_once() {
    let mut bench = Bench::new(&["d", "d/a.gltf", "./d/a.gltf", "link"], None, |folder| {
        furnish(folder, "d/a");
        std::os::unix::fs::symlink(folder.join("d"), folder.join("link")).unwrap();
    });
    assert_eq!(bench.attempts(), 1);
    std::fs::write(bench.at("d/a.bin"), corners(1)).unwrap();
    bench.baked("d/a.gltf");
    bench.settle("d/a.gltf");
    assert_eq!(bench.attempts(), 2);
    bench.end();
}

#[cfg(unix)]
#[test]
fn two_scenes_do_not_write_into_one_folder_that_has_two_names() {
    let mut bench = Bench::new(&["c", "d"], None, |folder| {
        ["c/a", "d/a"].iter().for_each(|name| furnish(folder, name));
        std::fs::create_dir(folder.join("c/baked")).unwrap();
        std::os::unix::fs::symlink(folder.join("c/baked"), folder.join("d/baked")).unwrap();
    });
    assert_eq!(bench.attempts(), 1);
    touch(&bench.at("d/a.gltf"));
    bench.settle("d/a.gltf");
    let (failed, folder) = bench.end();
    assert_eq!(failed, [folder.path().join("d/a.gltf")]);
}

#[test]
fn a_scene_whose_outputs_get_other_names_says_so() {
    let mut bench = Bench::new(&["."], None, |folder| furnish(folder, "a"));
    std::fs::copy(bench.at("a.gltf"), bench.at("a.glb")).unwrap();
    let event = bench.wait("moved", |e| matches!(e, Event::Moved { .. } | Event::Changed { .. }));
    assert!(matches!(&event, Event::Moved { glb, .. } if glb.ends_with("baked/a.gltf.glb")), "{event:?}");
    bench.end();
}

#[test]
fn a_folder_that_becomes_a_file_holds_no_scene() {
    let mut bench = Bench::new(&["levels"], None, |folder| furnish(folder, "levels/a"));
    std::fs::rename(bench.at("levels"), bench.at("away")).unwrap();
    std::fs::write(bench.at("levels"), "a file").unwrap();
    let event = bench.wait("removed", |e| !matches!(e, Event::Unchanged { .. }));
    assert!(matches!(event, Event::Removed { .. }), "{event:?}");
    assert!(bench.end().0.is_empty());
}

#[test]
fn new_scenes_are_baked_and_deleted_ones_forgotten() {
    for poll in [None, Some(Duration::from_millis(50))] {
        // Nothing is there yet.
        let mut bench = Bench::new(&["levels"], poll, |folder| std::fs::create_dir(folder.join("levels")).unwrap());
        furnish(bench.folder.path(), "levels/new/deep/a");
        bench.baked("levels/new/deep/a.gltf");
        furnish(bench.folder.path(), "levels/b");
        bench.baked("levels/b.gltf");
        bench.settle("levels/b.gltf");
        bench.settle("levels/new/deep/a.bin");
        assert_eq!(bench.bakes(), 2);
        std::fs::remove_file(bench.at("levels/b.gltf")).unwrap();
        bench.wait("removed", |e| matches!(e, Event::Removed { .. }));
        assert!(bench.at("levels/baked/b.glb").exists(), "its outputs stay");
        // Its .gltf under another name is another scene.
        std::fs::rename(bench.at("levels/new/deep/a.gltf"), bench.at("levels/new/deep/c.gltf")).unwrap();
        bench.baked("levels/new/deep/c.gltf");
        bench.settle("levels/new/deep/c.gltf");
        assert_eq!(bench.bakes(), 3);
        bench.end();
    }
}

#[test]
fn a_broken_scene_says_so_keeps_its_light_and_is_picked_up_again() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    let good = std::fs::read(bench.at("baked/a.glb")).unwrap();
    let failed = |bench: &mut Bench, part: &str| match bench.wait("failed", |e| matches!(e, Event::Failed { .. })) {
        Event::Failed { fault, .. } => assert!(fault.error.contains(part), "{}", fault.error),
        other => panic!("{other:?}"),
    };
    std::fs::write(bench.at("a.gltf"), "{\"asset\":").unwrap();
    failed(&mut bench, "a.gltf");
    assert_eq!(bench.idle(), [bench.at("a.gltf")]);
    assert_eq!(std::fs::read(bench.at("baked/a.glb")).unwrap(), good);
    let attempts = bench.attempts();
    bench.settle("a.gltf");
    assert_eq!(bench.attempts(), attempts, "a touch tries nothing again");
    std::fs::write(bench.at("a.gltf"), gltf("a", 1)).unwrap();
    bench.baked("a.gltf");

    // Only a side file is missing, and comes back as it was, or as another one.
    let bakes = bench.bakes();
    std::fs::remove_file(bench.at("a.bin")).unwrap();
    failed(&mut bench, "a.bin");
    std::fs::write(bench.at("a.bin"), corners(0)).unwrap();
    bench.wait("current", |e| matches!(e, Event::Current { .. }));
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), bakes);
    std::fs::remove_file(bench.at("a.bin")).unwrap();
    failed(&mut bench, "a.bin");
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!(bench.bakes(), bakes + 1);
    bench.assert_current("a.gltf");

    // A scene that is broken when the watch ends is named.
    std::fs::write(bench.at("a.gltf"), "{").unwrap();
    failed(&mut bench, "a.gltf");
    let (failed, folder) = bench.end();
    assert_eq!(failed, [folder.path().join("a.gltf")]);
}

#[test]
fn what_failed_for_reasons_outside_of_its_files_is_tried_again_at_a_touch() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| {
        furnish(folder, "a");
        std::fs::write(folder.join("baked"), "in the way").unwrap();
    });
    assert_eq!((bench.attempts(), bench.bakes()), (1, 0));
    touch(&bench.at("a.bin"));
    bench.wait("failed", |e| matches!(e, Event::Failed { .. }));
    assert_eq!((bench.idle(), bench.attempts()), (vec![bench.at("a.gltf")], 2));
    std::fs::remove_file(bench.at("baked")).unwrap();
    touch(&bench.at("a.bin"));
    bench.baked("a.gltf");
    bench.settle("a.bin");
    assert_eq!((bench.attempts(), bench.bakes()), (3, 1));
    bench.assert_current("a.gltf");
    assert!(bench.end().0.is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_searched_is_told_and_hides_no_other() {
    let folder = tempfile::tempdir().unwrap();
    furnish(folder.path(), "levels/a");
    // Below this, a path is too long for the system to list it.
    let chain = |above: &Path| (0..9).fold(above.to_path_buf(), |path, _| path.join("n".repeat(220)));
    let (inner, other) = (chain(&folder.path().join("levels/deep")), chain(&folder.path().join("other")));
    std::fs::create_dir_all(&inner).unwrap();
    std::fs::create_dir_all(other.join("m".repeat(220))).unwrap();
    std::fs::rename(folder.path().join("other"), inner.join("other")).unwrap();
    let mut tool = Tool::new(folder.path(), &["levels"]);
    assert!(tool.wait("unwatched")["path"].as_str().unwrap().starts_with("levels/deep/"));
    assert_eq!(tool.wait("watching")["scenes"], 1);
    assert_eq!(tool.wait("baking")["scene"], "levels/a.gltf");
    tool.signal("-TERM");
    tool.wait("stopped");
    tool.end();
}

#[test]
fn a_buffer_may_come_after_its_scene_and_lie_in_a_folder_that_is_not_there_yet() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| {
        furnish(folder, "a");
        std::fs::write(folder.join("a.gltf"), gltf("parts/deep/a", 0)).unwrap();
    });
    assert_eq!(bench.bakes(), 0);
    std::fs::create_dir_all(bench.at("parts/deep")).unwrap();
    std::fs::rename(bench.at("a.bin"), bench.at("parts/deep/a.bin")).unwrap();
    bench.baked("a.gltf");
    bench.settle("parts/deep/a.bin");
    assert_eq!(bench.bakes(), 1);
    bench.assert_current("a.gltf");
    bench.end();
}

#[test]
fn settings_count_by_their_values() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    let settings = |bench: &Bench, text: &str| std::fs::write(bench.at("luxel.toml"), text).unwrap();
    settings(&bench, "padding = 3");
    bench.baked("a.gltf");
    settings(&bench, "# three texels\npadding = 3\n");
    bench.settle("luxel.toml");
    assert_eq!(bench.bakes(), 2);
    settings(&bench, "paddign = 3");
    bench.wait("failed", |e| matches!(e, Event::Failed { fault, .. } if fault.error.contains("padding")));
    assert_eq!(bench.attempts(), 2, "nothing is begun with settings that say nothing");
    settings(&bench, "padding = 4");
    bench.baked("a.gltf");
    std::fs::remove_file(bench.at("luxel.toml")).unwrap();
    bench.baked("a.gltf");
    bench.settle("a.gltf");
    assert_eq!(bench.bakes(), 4);
    bench.end();
}

#[test]
fn a_named_scene_that_was_away_is_found_when_it_is_back() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    for _ in 0..3 {
        std::fs::remove_file(bench.at("a.gltf")).unwrap();
        bench.wait("removed", |e| matches!(e, Event::Removed { .. }));
        bench.idle();
        std::fs::write(bench.at("a.gltf"), gltf("a", 0)).unwrap();
        bench.wait("found", |e| matches!(e, Event::Found { .. }));
        bench.settle("a.gltf");
    }
    assert_eq!(bench.bakes(), 1, "it is what it was");
    bench.end();
}

/// Bakes a scene as the tool does, before anybody watches it.
fn bake_before(scene: &Path) {
    let settings = luxel::settings::Layer::new(luxel::settings::Origin::CommandLine);
    let settings = luxel::settings::for_scene(scene, None, &settings).unwrap();
    let outputs = luxel_export::OutputSet::new(scene, None, None).unwrap();
    let request = luxel::Request {
        scene: scene.into(),
        outputs,
        settings,
        worker: None,
        store: Default::default(),
        kept: Default::default(),
    };
    luxel::bake(&request, &luxel_scene::Silent).unwrap();
}

#[test]
fn what_is_current_at_the_start_is_not_baked_and_what_is_not_is() {
    let names = ["levels/a", "levels/b", "levels/c"];
    let mut bench = Bench::new(&["levels"], None, |folder| {
        names.iter().for_each(|name| furnish(folder, name));
        std::fs::write(folder.join("levels/luxel.toml"), "size = 32").unwrap();
        names.iter().for_each(|name| bake_before(&folder.join(format!("{name}.gltf"))));
        std::fs::write(folder.join("levels/b.bin"), corners(5)).unwrap();
        std::fs::write(folder.join("levels/baked/c.lightmap.exr"), "torn").unwrap();
    });
    assert_eq!((bench.attempts(), bench.bakes()), (2, 2), "b and c");
    bench.settle("levels/a.gltf");
    bench.settle("levels/a.bin");
    assert_eq!(bench.attempts(), 2);
    // It is watched by what the report says that it was made from.
    std::fs::write(bench.at("levels/a.bin"), corners(1)).unwrap();
    bench.baked("levels/a.gltf");
    bench.settle("levels/a.bin");
    assert_eq!(bench.bakes(), 3);
    bench.end();
}

#[test]
fn a_scene_that_is_broken_at_the_start_and_then_what_was_baked_is_current() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| {
        furnish(folder, "a");
        std::fs::write(folder.join("luxel.toml"), "size = 32").unwrap();
        bake_before(&folder.join("a.gltf"));
        std::fs::write(folder.join("a.gltf"), "{ \"asset\"").unwrap();
    });
    assert_eq!((bench.attempts(), bench.bakes()), (1, 0));
    std::fs::write(bench.at("a.gltf"), gltf("a", 0)).unwrap();
    bench.wait("current", |e| matches!(e, Event::Current { .. }));
    assert!(bench.idle().is_empty());
    assert_eq!(bench.attempts(), 1);
    bench.end();
}

#[cfg(unix)]
#[test]
fn the_tool_writes_a_draft_first_and_says_so_when_it_is_killed() {
    let folder = tool::folder(&["cornell.glb"]);
    let mut tool = Tool::new(folder.path(), &["."]);
    let draft = tool.wait("drafted");
    assert_eq!((draft["scene"].as_str(), draft["outputs"].as_array().unwrap().len()), (Some("./cornell.glb"), 3));
    assert_eq!(tool.wait("baked")["outputs"].as_array().unwrap().len(), 4);
    tool.wait("idle");
    // A bake that would take minutes.
    std::fs::write(folder.path().join("luxel.toml"), "refresh = 100000").unwrap();
    tool.wait("drafted");
    tool.signal("-KILL");
    drop(tool);
    assert_eq!(tool::Outputs::read(&folder.path().join("baked"), "cornell").report["draft"], true);
    let said = tool::quick(&["bake", "cornell.glb", "--check"], folder.path()).ended(3);
    assert!(said.stderr.contains("stale: its outputs are a draft"), "{}", said.stderr);
    // Another luxel bakes over it.
    std::fs::remove_file(folder.path().join("luxel.toml")).unwrap();
    tool::quick(&["bake", "cornell.glb"], folder.path()).ended(0);
    tool::quick(&["bake", "cornell.glb", "--check"], folder.path()).ended(0);
}

#[cfg(unix)]
#[test]
fn a_draft_that_was_left_behind_is_told_as_one() {
    let folder = tool::folder(&["cornell.glb"]);
    let scene = folder.path().join("cornell.glb");
    let whole = std::fs::read(&scene).unwrap();
    // A bake that would take minutes.
    std::fs::write(folder.path().join("luxel.toml"), "refresh = 100000").unwrap();
    let mut tool = Tool::new(folder.path(), &["."]);
    tool.wait("drafted");
    std::fs::write(&scene, "glTF but not for long").unwrap();
    let failed = tool.wait("failed");
    assert_eq!((&failed["scene"], &failed["draft"]), (&"./cornell.glb".into(), &true.into()));
    assert_eq!(tool.wait("idle")["draft"], serde_json::json!(["./cornell.glb"]));
    std::fs::write(&scene, whole).unwrap();
    tool.wait("drafted");
    tool.signal("-INT");
    assert_eq!(tool.wait("stopped")["draft"], serde_json::json!(["./cornell.glb"]));
    assert_eq!(tool.end(), Some(0));
}

#[cfg(unix)]
#[test]
fn two_requests_to_end_at_once_are_one() {
    for _ in 0..4 {
        let folder = tool::folder(&["cornell.glb"]);
        let mut tool = Tool::new(folder.path(), &[".", "--no-draft"]);
        tool.wait("started");
        tool.signal("-INT");
        tool.signal("-TERM");
        tool.wait("stopped");
        assert_eq!(tool.end(), Some(0));
        assert_eq!(litter(folder.path()), [""; 0]);
    }
}

#[test]
fn what_polling_hints_at_once_more_is_no_news() {
    let mut bench = Bench::new(&["a.gltf"], Some(Duration::from_millis(50)), |folder| furnish(folder, "a"));
    std::fs::write(bench.at("a.bin"), corners(1)).unwrap();
    bench.baked("a.gltf");
    bench.idle();
    // Longer than a file is young.
    assert_eq!(bench.within(Duration::from_secs(4)), []);
    bench.end();
}

#[test]
fn of_a_scene_that_is_back_nothing_else_is_said() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    std::fs::remove_file(bench.at("a.gltf")).unwrap();
    bench.wait("removed", |e| matches!(e, Event::Removed { .. }));
    bench.idle();
    std::fs::write(bench.at("a.gltf"), gltf("a", 0)).unwrap();
    bench.wait("found", |e| matches!(e, Event::Found { .. }));
    let event = bench.wait("idle", |e| matches!(e, Event::Idle { .. } | Event::Unchanged { .. }));
    assert!(matches!(event, Event::Idle { .. }), "{event:?}");
    bench.end();
}

/// A picture of one colour, and a sky of one brightness.
fn paint(folder: &Path, red: u8, sky: f32) {
    image::RgbImage::from_pixel(2, 2, image::Rgb([red, 0, 0])).save(folder.join("wall.png")).unwrap();
    let file = std::fs::File::create(folder.join("noon.hdr")).unwrap();
    image::codecs::hdr::HdrEncoder::new(file).encode(&[image::Rgb([sky; 3]); 8], 4, 2).unwrap();
}

#[test]
fn images_and_skies_are_watched_as_well() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| {
        furnish(folder, "a");
        let mut scene: serde_json::Value = serde_json::from_str(&gltf("a", 0)).unwrap();
        scene["images"] = serde_json::json!([{ "uri": "wall.png" }]);
        scene["textures"] = serde_json::json!([{ "source": 0 }]);
        scene["materials"] = serde_json::json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
        scene["meshes"][0]["primitives"][0]["material"] = 0.into();
        std::fs::write(folder.join("a.gltf"), scene.to_string()).unwrap();
        std::fs::write(folder.join("luxel.toml"), "[sky]\nimage = \"noon.hdr\"").unwrap();
        paint(folder, 1, 1.0);
    });
    for (n, (red, sky, file)) in [(2, 1.0, "wall.png"), (2, 3.0, "noon.hdr")].into_iter().enumerate() {
        paint(bench.folder.path(), red, sky);
        let event = bench.wait("changed", |e| matches!(e, Event::Changed { .. }));
        assert!(matches!(&event, Event::Changed { files, .. } if *files == [bench.at(file)]), "{event:?}");
        bench.baked("a.gltf");
        bench.settle("a.gltf");
        assert_eq!(bench.bakes(), 2 + n, "{file}");
    }
    bench.end();
}

#[test]
fn a_save_that_pauses_half_way_is_baked_once_when_it_is_whole() {
    let mut bench = Bench::new(&["a.gltf"], None, |folder| furnish(folder, "a"));
    let text = gltf("a", 1);
    let (front, rest) = text.as_bytes().split_at(text.len() / 2);
    let mut file = std::fs::File::create(bench.at("a.gltf")).unwrap();
    file.write_all(front).unwrap();
    // Longer than a burst is waited for: the half is looked at, and found to be none.
    bench.wait("changed", |e| matches!(e, Event::Changed { .. }));
    file.write_all(rest).unwrap();
    drop(file);
    let event = bench.wait("baked", |e| matches!(e, Event::Baked { .. } | Event::Failed { .. }));
    assert!(matches!(event, Event::Baked { .. }), "{event:?}");
    bench.settle("a.gltf");
    assert_eq!(bench.bakes(), 2);
    bench.assert_current("a.gltf");
    bench.end();
}

/// A large file is told from another one of its length within the time that a bake has to stop.
#[test]
fn a_bake_hears_soon_that_a_large_file_is_another_one() {
    const LENGTH: usize = 128 << 20;
    let mut bench = Bench::new(&["."], None, |folder| {
        furnish(folder, "a");
        // Two of them, of which only the first part counts as corners.
        let mut large = corners(0);
        large.resize(LENGTH, 1);
        std::fs::write(folder.join("a.bin"), &large).unwrap();
        large[LENGTH - 1] = 2;
        std::fs::write(folder.join("other"), &large).unwrap();
        std::fs::write(folder.join("shorter"), &large[..LENGTH / 2]).unwrap();
    });
    for (n, name) in ["other", "shorter"].into_iter().enumerate() {
        bench.shut(true);
        std::fs::write(bench.at("a.gltf"), gltf("a", n + 1)).unwrap();
        bench.held();
        // Another link holds the old file, so that nobody waits until its pages are given back.
        std::fs::hard_link(bench.at("a.bin"), bench.at(&format!("before {name}"))).unwrap();
        let begin = std::time::Instant::now();
        std::fs::rename(bench.at(name), bench.at("a.bin")).unwrap();
        bench.wait("overtaken", |e| matches!(e, Event::Overtaken { .. }));
        eprintln!("{} MiB, {name}: overtaken after {:.0} ms", LENGTH >> 20, begin.elapsed().as_secs_f64() * 1e3);
        bench.shut(false);
        bench.baked("a.gltf");
        // Else the next save may be seen half done, and its bake overtaken for that.
        bench.settle("a.gltf");
    }
    assert_eq!(bench.bakes(), 3);
    bench.assert_current("a.gltf");
    bench.end();
}

/// Names of all files, hidden ones too, that no scene and no bake has.
fn litter(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && path.file_name().unwrap() != ".luxel" {
            found.extend(litter(&path));
        } else if path.extension().is_some_and(|e| e == "tmp") {
            found.push(path.display().to_string());
        }
    }
    found
}

#[cfg(unix)]
#[test]
fn the_tool_bakes_what_is_saved_and_ends_cleanly_in_the_middle_of_a_bake() {
    for signal in ["-INT", "-TERM"] {
        let folder = tool::folder(&["cornell.glb"]);
        let mut tool = Tool::new(folder.path(), &[".", "--no-draft"]);
        assert_eq!(tool.wait("watching")["scenes"], 1);
        let first = tool.wait("baked");
        assert_eq!((first["scene"].as_str(), first["outputs"].as_array().unwrap().len()), (Some("./cornell.glb"), 4));
        assert_eq!(tool.wait("idle")["failed"], serde_json::json!([]));
        let before = tool::Outputs::read(&folder.path().join("baked"), "cornell");

        std::fs::write(folder.path().join("luxel.toml"), "light_scale = 1.0\nemissive_scale = 2.0").unwrap();
        assert_eq!(tool.wait("changed")["files"], serde_json::json!([]));
        tool.wait("baked");
        let after = tool::Outputs::read(&folder.path().join("baked"), "cornell");
        let mean = |o: &tool::Outputs| o.report["quality"]["mean_irradiance_lux"].as_f64().unwrap();
        assert!((mean(&after) / mean(&before) - 2.0).abs() < 0.01, "twice the light");

        // A bake that would take minutes is interrupted.
        std::fs::write(folder.path().join("luxel.toml"), "refresh = 100000").unwrap();
        while tool.wait("started")["stage"] != "refresh" {}
        tool.signal(signal);
        assert_eq!(tool.wait("stopped")["failed"], serde_json::json!([]));
        assert_eq!(tool.end(), Some(0), "{signal}");
        assert_eq!(litter(folder.path()), [""; 0]);
        let last = tool::Outputs::read(&folder.path().join("baked"), "cornell");
        assert_eq!(last.report, after.report, "the last whole bake is what is there");
    }
}

#[cfg(unix)]
#[test]
fn a_terminal_that_goes_away_ends_nothing_where_its_signal_is_ignored() {
    let folder = tool::folder(&["cornell.glb"]);
    let mut command = Command::new("sh");
    // As nohup does it.
    command.args(["-c", r#"trap "" HUP; exec "$0" "$@""#, env!("CARGO_BIN_EXE_luxel")]);
    let mut tool = Tool::start(command, folder.path(), &["."]);
    tool.wait("idle");
    tool.signal("-HUP");
    std::fs::write(folder.path().join("luxel.toml"), "emissive_scale = 2.0").unwrap();
    tool.wait("baked");
    tool.wait("idle");
    tool.signal("-TERM");
    tool.wait("stopped");
    assert_eq!(tool.end(), Some(0));
}

#[cfg(unix)]
#[test]
fn the_tool_names_what_it_could_not_bake_and_refuses_what_it_cannot_watch() {
    let folder = tool::folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("broken.glb"), "glTF but not for long").unwrap();
    let mut tool = Tool::new(folder.path(), &["cornell.glb", "broken.glb", "--poll", "0.1"]);
    let failed = std::iter::repeat_with(|| tool.next()).find(|e| e["event"] == "failed" || e["event"] == "polling");
    let failed = failed.unwrap();
    assert_eq!((&failed["event"], &failed["scene"]), (&"failed".into(), &"broken.glb".into()), "polling is no news");
    assert_eq!(failed["draft"], serde_json::Value::Null, "there was never anything");
    tool.signal("-INT");
    assert_eq!(tool.wait("stopped")["failed"], serde_json::json!(["broken.glb"]));
    assert_eq!(tool.end(), Some(1));
    tool::luxel(&["watch", "nothing.glb"], folder.path()).ended(2);
    tool::luxel(&["watch", "cornell.glb", "--poll", "0"], folder.path()).ended(2);
}

#[test]
fn a_scene_that_nobody_had_time_to_look_at_is_not_broken() {
    let folder = tempfile::tempdir().unwrap();
    furnish(folder.path(), "a");
    let options = Options {
        paths: Options::paths(&[folder.path().to_path_buf()]).unwrap(),
        out: None,
        choices: Choices { config: None, flags: Layer::new(Origin::CommandLine) },
        worker: None,
        store: Default::default(),
    };
    let watch = Watch::new(options, None);
    watch.stopper().stop();
    let mut told = Vec::new();
    let ending = watch.run(&|_: &Task| panic!("nothing is baked any more"), &mut |event| told.push(event));
    assert!(ending.failed.is_empty(), "{ending:?}");
    assert!(matches!(told.last(), Some(Event::Stopped { failed, .. }) if failed.is_empty()), "{told:#?}");
}
