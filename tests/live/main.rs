//! The live preview: what its server refuses and what it serves (`server`), the page in a headless browser (`browser`),
//! and both as a part of `luxel watch` (`watched`).

mod browser;
mod server;
#[path = "../tool/mod.rs"]
mod tool;
mod watched;

use std::path::{Path, PathBuf};

use luxel::live::{Bundle, Live, Options};
use luxel::settings::{Preset, Resolved, Settings, value::Texels};
use luxel::{Request, bake};
use luxel_export::OutputSet;
use luxel_scene::{Scene, Silent};

fn start(bundle: &Path) -> Live {
    Live::start(Options { port: 0, bundle: Bundle::Folder(bundle.into()) }).unwrap()
}

fn save(scene: &Scene, path: &Path) {
    std::fs::write(path, luxel_assets::glb::write(scene).unwrap()).unwrap();
}

/// Saves a scene and bakes it, quickly; returns the scene file and its report.
fn baked(scene: &Scene, folder: &Path, side: u32) -> (PathBuf, PathBuf) {
    let path = folder.join("level.glb");
    save(scene, &path);
    let outputs = OutputSet::new(&path, None, None).unwrap();
    let settings = Settings { size: Texels(side), ..Settings::preset(Preset::Draft) };
    let settings = Resolved { settings, ..Resolved::default() };
    let request = Request {
        scene: path.clone(),
        outputs,
        settings,
        worker: None,
        store: Default::default(),
        kept: Default::default(),
    };
    let done = bake(&request, &Silent).unwrap();
    (path, done.files.last().unwrap().clone())
}

/// The Cornell box under a lamp of another colour.
fn cornell(lamp: [f32; 3]) -> Scene {
    let mut scene = luxel_assets::cornell();
    scene.materials.iter_mut().find(|m| m.name == "light").expect("the box has a lamp").emission = lamp.into();
    scene
}
