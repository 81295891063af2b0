//! A bake that is no longer wanted: wherever it is, it stops as cancelled, touches no output and leaves nothing behind.
//! Not by the clock: the bake is cancelled at its N-th look at whether it is still wanted, for many N.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use luxel::settings::{
    GatherMode, Preset, Resolved, Settings, SkySetting,
    value::{Texels, Threads, Voxels},
};
use luxel::{Error, Request, bake};
use luxel_export::OutputSet;
use luxel_scene::Progress;

/// Counts looks, and is cancelled from one of them on.
struct Looks {
    made: AtomicU64,
    cancelled_at: u64,
}

impl Looks {
    fn until(look: u64) -> Self {
        Self { made: AtomicU64::new(0), cancelled_at: look }
    }
}

impl Progress for Looks {
    fn begin(&self, _: &'static str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn is_cancelled(&self) -> bool {
        self.made.fetch_add(1, Ordering::Relaxed) >= self.cancelled_at
    }
}

/// What lies below a folder.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(self::files(&path));
        } else {
            files.insert(path.file_name().unwrap().to_str().unwrap().to_owned(), std::fs::read(&path).unwrap());
        }
    }
    files
}

/// Outputs of an earlier bake, and one of them that this bake has not.
const OLD: [&str; 5] =
    ["level.bake.json", "level.glb", "level.lightmap.7.exr", "level.lightmap.exr", "level.preview.png"];

/// Bakes in a folder of its own, cancelled at a look. Returns how it ended, how often it looked, and what lies in the
/// folder of the outputs then.
fn run(scene: &[u8], settings: &Settings, look: u64) -> (Result<(), Error>, u64, BTreeMap<String, Vec<u8>>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("level.glb");
    std::fs::write(&path, scene).unwrap();
    let outputs = OutputSet::new(&path, None, None).unwrap();
    std::fs::create_dir(outputs.folder()).unwrap();
    for name in OLD {
        std::fs::write(outputs.folder().join(name), "old").unwrap();
    }
    let settings = Resolved { settings: settings.clone(), ..Resolved::default() };
    let looks = Looks::until(look);
    let request = Request {
        scene: path,
        outputs: outputs.clone(),
        settings,
        worker: None,
        store: Default::default(),
        kept: Default::default(),
    };
    let ended = bake(&request, &looks).map(drop);
    (ended, looks.made.into_inner(), files(outputs.folder()))
}

fn cancelled_everywhere(settings: &Settings) {
    // Textures, stained glass and a sun.
    let scene = luxel_assets::glb::write(&luxel_assets::textured_room()).unwrap();
    let (ended, looks, whole) = run(&scene, settings, u64::MAX);
    ended.unwrap();
    assert!(whole["level.bake.json"] != b"old" && !whole.contains_key("level.lightmap.7.exr"));
    // All of the first and last ones, where files are read and written, and some of those between.
    let edges = 12.min(looks / 2);
    let between = (edges..looks - edges).step_by((looks / 20).max(1) as usize);
    for look in (0..edges).chain(between).chain(looks - edges..looks) {
        let (ended, _, mut left) = run(&scene, settings, look);
        assert!(matches!(ended, Err(Error::Cancelled)), "look {look} of {looks}: {ended:?}");
        // Light that was stored before is kept: the next bake need not make it again.
        left.retain(|name, bytes| OLD.contains(&name.as_str()) || whole.get(name) != Some(bytes));
        let names: Vec<&String> = left.keys().collect();
        assert_eq!(names, OLD, "look {look} of {looks}");
        assert!(left.values().all(|bytes| bytes == b"old"), "look {look} of {looks}");
    }
}

fn small() -> Settings {
    Settings {
        size: Texels(32),
        voxels: Voxels::Budget(1000),
        sky: SkySetting::Constant(glam::Vec3::ONE),
        threads: Threads(1),
        ..Settings::preset(Preset::Draft)
    }
}

#[test]
fn a_bake_stops_wherever_it_is() {
    cancelled_everywhere(&small());
}

#[test]
fn so_does_one_by_lightcuts_on_two_threads() {
    cancelled_everywhere(&Settings { threads: Threads(2), bound: true, gather: GatherMode::Lightcuts, ..small() });
}
