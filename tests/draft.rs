//! Drafts: they come first, show the light that is to come, and leave no trace in the bake that follows.

#[path = "tool/mod.rs"]
mod tool;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, Vec3};
use luxel::current::{self, Reason, State};
use luxel::settings::{GatherMode, Preset, Resolved, Settings, value::Texels};
use luxel::{Baked, Error, Request};
use luxel_export::OutputSet;
use luxel_scene::{Progress, Scene, Silent};
use luxel_transport::geometry::Geometry;
use tempfile::TempDir;
use tool::Outputs;

/// A scene in a folder of its own.
struct Level {
    request: Request,
    /// Goes last.
    _folder: TempDir,
}

impl Level {
    fn new(scene: &Scene, size: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("level.glb");
        let outputs = OutputSet::new(&path, None, None).unwrap();
        let settings = Settings { size: Texels(size), gather: GatherMode::Final, ..Settings::preset(Preset::Draft) };
        let settings = Resolved { settings, ..Resolved::default() };
        let request = Request {
            scene: path,
            outputs,
            settings,
            worker: None,
            store: Default::default(),
            kept: Default::default(),
        };
        let level = Self { request, _folder: folder };
        level.save(scene);
        level
    }

    fn save(&self, scene: &Scene) {
        std::fs::write(&self.request.scene, luxel_assets::glb::write(scene).unwrap()).unwrap();
    }

    /// Bakes; returns the draft that came first, if one did.
    fn bake(&self) -> (Option<Outputs>, Outputs) {
        let mut draft = None;
        luxel::bake_drafted(&self.request, &Silent, &mut |baked| draft = Some(self.drafted(&baked))).unwrap();
        let baked = self.outputs();
        assert!(baked.report.get("draft").is_none());
        (draft, baked)
    }

    /// What lies there when a draft does.
    fn drafted(&self, baked: &Baked) -> Outputs {
        let outputs = self.outputs();
        assert!(baked.report.draft && outputs.report["draft"] == true);
        assert!(!self.request.outputs.preview().exists(), "of an older bake");
        assert!(matches!(&self.state(), State::Stale(reasons) if reasons[..] == [Reason::Draft]));
        assert_eq!(baked.files.len(), 3);
        outputs
    }

    fn state(&self) -> State {
        let Request { scene, outputs, settings, .. } = &self.request;
        current::check(scene, outputs, settings, &Silent).unwrap()
    }

    fn outputs(&self) -> Outputs {
        Outputs::read(self.request.outputs.folder(), "level")
    }

    /// The images and the scene of the bake.
    fn files(&self) -> Vec<(String, Vec<u8>)> {
        let files = tool::files(self.request.outputs.folder()).into_iter();
        files.filter(|(name, _)| !name.ends_with(".json")).collect()
    }
}

/// A place on a surface, and how much of it that stands for.
struct Place {
    at: DVec3,
    area: f64,
    /// Light of both bakes there, over the bands.
    light: [f64; 2],
}

/// Places all over the surfaces of a scene that was baked twice.
fn places(a: &Outputs, b: &Outputs) -> Vec<Place> {
    let geometry = Geometry::new(&a.scene);
    let mut places = Vec::new();
    let side = 48u32;
    for t in &geometry.triangles {
        for (i, j) in (0..side).flat_map(|i| (0..side - i).map(move |j| (i, j))) {
            let [u, v] = [i, j].map(|k| (k as f32 + 0.33) / side as f32);
            let light = |o: &Outputs| Some(f64::from(o.at(t.instance as usize, t.index as usize, u, v)?.element_sum()));
            if let (Some(a), Some(b)) = (light(a), light(b)) {
                places.push(Place { at: geometry.frame.world(t.at(u, v)), area: t.area().into(), light: [a, b] });
            }
        }
    }
    places
}

/// Mean light of both over a region, by area.
fn means(places: &[Place], region: impl Fn(DVec3) -> bool) -> [f64; 2] {
    let some: Vec<_> = places.iter().filter(|place| region(place.at)).collect();
    assert!(some.len() > 100, "{}", some.len());
    let area: f64 = some.iter().map(|place| place.area).sum();
    [0, 1].map(|bake| some.iter().map(|place| place.area * place.light[bake]).sum::<f64>() / area)
}

fn assert_alike(what: &str, [draft, baked]: [f64; 2], most: f64) {
    let off = draft / baked - 1.0;
    println!("{what}: draft {:+.2} %", 100.0 * off);
    assert!(off.abs() <= most, "{what}: {draft} of {baked}");
}

#[test]
fn a_draft_comes_first_and_the_bake_is_that_of_a_clean_folder() {
    let scene = luxel_assets::cornell();
    let (level, clean) = (Level::new(&scene, 256), Level::new(&scene, 256));
    let (draft, baked) = level.bake();
    luxel::bake(&clean.request, &Silent).unwrap();
    assert!(level.files() == clean.files(), "a draft changes nothing of the bake");
    assert!(matches!(level.state(), State::Current(_)));
    let draft = draft.expect("nothing was stored");
    assert_eq!(draft.document["meshes"], baked.document["meshes"], "the same layout");
    let stage = |name: &str| draft.report["stages"].as_array().unwrap().iter().find(|s| s["name"] == name).unwrap();
    let nodes = stage("direct")["counters"]["gathered_texels"].as_u64().unwrap();
    assert!((1000..16_000).contains(&nodes) && draft.report["counters"]["texels"].as_u64().unwrap() > 3 * nodes);
    let places = places(&draft, &baked);
    assert_alike("Cornell", means(&places, |_| true), 0.05);
    let dark = places.iter().filter(|place| place.light[0] < 0.1 * place.light[1]).count();
    assert!(dark * 200 < places.len(), "{dark} of {} places are far too dark", places.len());
    // Now all is stored.
    std::fs::remove_file(level.request.outputs.report()).unwrap();
    assert!(level.bake().0.is_none());
}

#[test]
fn no_light_comes_through_walls() {
    let level = Level::new(&luxel_assets::two_rooms(), 256);
    let (draft, baked) = level.bake();
    let places = places(&draft.unwrap(), &baked);
    assert_alike("lit room", means(&places, |p| p.x < 0.99), 0.05);
    assert_alike("dark room", means(&places, |p| p.x > 1.02), 0.15);
    // Where the wall between stands, but not in the light of its door.
    let is_foot = |p: DVec3| p.x > 1.012 && p.x < 1.1 && (p.z < 0.2 || p.z > 0.8);
    assert_alike("foot of the wall", means(&places, is_foot), 0.3);
}

#[test]
fn a_lamp_that_moves_is_drafted_over_the_light_of_the_others() {
    let mut scene = luxel_assets::cornell();
    let bulb = |at: DVec3, intensity: Vec3| luxel_scene::Light {
        name: "bulb".into(),
        node: 0,
        group: "bulb".into(),
        kind: luxel_scene::LightKind::Point { position: at, range: None, radius: 0.0 },
        intensity,
    };
    scene.lights.push(bulb(DVec3::new(0.1, 0.5, 0.2), Vec3::splat(1.0)));
    let level = Level::new(&scene, 128);
    level.bake();
    // Another colour gathers nothing, so there is nothing that a draft would be sooner with.
    scene.lights[0].intensity = Vec3::new(2.0, 1.0, 0.5);
    level.save(&scene);
    let (draft, baked) = level.bake();
    assert!(draft.is_none());
    assert_eq!(baked.stage("gather").0, "reused");
    scene.lights[0] = bulb(DVec3::new(-0.2, 0.4, 0.1), Vec3::splat(1.0));
    level.save(&scene);
    let (draft, baked) = level.bake();
    let draft = draft.unwrap();
    assert_eq!((draft.stage("unwrap").0, draft.stage("clear").0), ("reused", "reused"));
    let (state, reason) = draft.stage("direct");
    assert!(state == "ran" && reason.contains("for bulb"), "{state}: {reason}");
    assert!(baked.stage("direct").1.contains("for bulb"), "the draft stored nothing of the bake");
    assert!(baked.stage("clear").1.contains("lights changed"), "the draft hides no reason: {}", baked.stage("clear").1);
    assert_alike("moved bulb", means(&places(&draft, &baked), |_| true), 0.05);
}

#[test]
fn an_object_that_moves_keeps_its_place_on_the_pages() {
    let mut scene = luxel_assets::cornell();
    let level = Level::new(&scene, 64);
    level.bake();
    // By no round number: no size may round otherwise elsewhere.
    scene.instances[1].transform.translation += DVec3::new(0.012_345_678_9, 0.001_3, -0.003_7);
    level.save(&scene);
    let (draft, baked) = level.bake();
    let draft = draft.unwrap();
    assert_eq!((draft.stage("unwrap").0, baked.stage("unwrap").0), ("reused", "reused"));
    assert_eq!(draft.stage("clear").0, "ran");
    let clean = Level::new(&scene, 64);
    luxel::bake(&clean.request, &Silent).unwrap();
    assert!(level.files() == clean.files());
    assert_alike("moved object", means(&places(&draft, &baked), |_| true), 0.05);
}

/// Not wanted any more when it has been asked so many times, or is told.
struct Until(AtomicU64);

impl Progress for Until {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        let left = self.0.load(Ordering::Relaxed);
        self.0.store(left.saturating_sub(1), Ordering::Relaxed);
        left == 0
    }
}

/// Everything below a folder but the store.
fn names(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| !path.ends_with(".luxel")).collect()
}

#[test]
fn a_draft_that_is_not_wanted_any_more_leaves_nothing() {
    let mut scene = luxel_assets::cornell();
    let level = Level::new(&scene, 64);
    level.bake();
    let before = level.files();
    scene.instances[1].transform.translation.x += 0.01;
    level.save(&scene);
    let (mut cancelled, mut asks) = (0, 1);
    loop {
        let progress = Until(AtomicU64::new(asks));
        let stop = |_| progress.0.store(0, Ordering::Relaxed);
        let mut came = false;
        let result = luxel::bake_drafted(&level.request, &progress, &mut |baked| {
            came = true;
            stop(baked);
        });
        assert!(matches!(result, Err(Error::Cancelled)), "{asks}");
        if came {
            break;
        }
        assert!(level.files() == before, "{asks}");
        assert_eq!(names(level.request.outputs.folder()).len(), 4, "{asks}");
        cancelled += 1;
        asks = asks * 3 / 2 + 1;
    }
    assert!(cancelled > 5, "{cancelled}");
    // The draft is whole, and says what it is.
    assert_eq!(level.outputs().report["draft"], true);
    assert!(matches!(level.state(), State::Stale(reasons) if reasons[..] == [Reason::Draft]));
    assert_eq!(names(level.request.outputs.folder()).len(), 3);
}
