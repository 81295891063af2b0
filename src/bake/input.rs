//! From files to a scene, and from settings to what the rooms ask for.

use std::path::{Path, PathBuf};

use luxel_export::Original;
use luxel_scene::{ImportOptions, InputFile, Limits, Progress, Scene, Sky, SkyImage, import};

use super::groups::Lighting;
use crate::Error;
use crate::content::{Content, named};
use crate::plan::{Plan, Stage};
use crate::settings::{FIELDS, Settings, SkySetting};
use crate::store::Key;

/// Reads the scene, what of its file the export will write again, and plans the bake.
///
/// The latter is read now because a fault in it must not come out after the bake, and kept because the file may be
/// another one by then: who saves a level while it is baked still gets the light of the level that was.
pub fn open(path: &Path, settings: &Settings, progress: &dyn Progress) -> Result<Opened, Error> {
    let mut scene = load(path, settings, progress)?;
    progress.advance(1);
    progress.check()?;
    let original = Original::read_with(path, progress)?;
    original.check_unchanged(&scene.inputs)?;
    let lighting = Lighting::part(&mut scene, settings);
    let mut plan = Plan::new(&scene, settings);
    plan.part(lighting.groups.iter().map(|g| g.name.clone()).collect(), settings);
    plan.weigh(original.bytes());
    progress.advance(1);
    Ok(Opened { scene, lighting, original, plan })
}

/// A scene that is ready to be baked.
pub struct Opened {
    /// With its lights at their units.
    pub scene: Scene,
    pub lighting: Lighting,
    pub original: Original,
    pub plan: Plan,
}

/// Steps of [`open`].
pub const STEPS: u64 = 2;

/// Reads the scene, and the sky that the settings name.
pub fn load(path: &Path, settings: &Settings, progress: &dyn Progress) -> Result<Scene, Error> {
    let options = ImportOptions {
        metal_diffuse: settings.metal_diffuse.0,
        light_scale: settings.light_scale.0,
        emissive_scale: settings.emissive_scale.0,
        lamp_radius: settings.lamp_radius.0.into(),
        sun_angle: settings.sun_angle.0.into(),
        bake_animated: settings.bake_animated,
        ..ImportOptions::default()
    };
    let mut scene = import::load_with(path, &options, progress)?;
    scene.sky = sky(&mut scene, settings, progress)?;
    if !scene.sky.is_dark() || scene.triangle_count() == 0 {
        // The importer does not know of the sky; and light is not what a scene without geometry lacks.
        scene.notices.retain(|n| n.code != "no-light");
    }
    Ok(scene)
}

fn sky(scene: &mut Scene, settings: &Settings, progress: &dyn Progress) -> Result<Sky, Error> {
    let strength = settings.sky_strength.0;
    Ok(match &settings.sky {
        SkySetting::None => Sky::None,
        SkySetting::Constant(c) => Sky::Constant(*c * strength),
        SkySetting::Gradient { zenith, horizon, ground } => {
            Sky::Gradient { zenith: *zenith * strength, horizon: *horizon * strength, ground: *ground * strength }
        }
        SkySetting::Image(path) => {
            let loaded = import::load_sky_with(path, &Limits::default(), progress)?;
            scene.notices.extend(loaded.notices);
            scene.inputs.push(loaded.input);
            let image = SkyImage {
                rotation: settings.sky_rotation.0.to_radians(),
                strength: loaded.image.strength * strength,
                ..loaded.image
            };
            Sky::Image(image)
        }
    })
}

/// The files of a bake.
pub struct Inputs {
    /// Those that were read, each once, the scene's own first.
    pub read: Vec<InputFile>,
    /// Those that the scene names and that cannot be read.
    pub missing: Vec<PathBuf>,
}

impl Inputs {
    pub fn new(path: &Path, scene: &Scene, original: &Original) -> Self {
        let mut read = scene.inputs.clone();
        read.extend(original.inputs().iter().filter(|i| !scene.inputs.contains(i)).cloned());
        let is_missing = |file: &PathBuf| !read.iter().any(|i| i.path == *file) && !Content::of(file).is_read();
        let missing = named(path).into_iter().filter(is_missing).collect();
        Self { read, missing }
    }
}

/// Identity of a result: luxel's version and those of its stages, all bytes that were read, and the settings that
/// matter.
pub fn key(scene: &Scene, settings: &Settings) -> Key {
    let mut hasher = blake3::Hasher::new();
    hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
    for stage in Stage::ALL {
        hasher.update(stage.name().as_bytes());
        hasher.update(&stage.version().to_le_bytes());
    }
    for input in &scene.inputs {
        hasher.update(&input.digest);
    }
    for field in FIELDS.iter().filter(|f| super::matters(f.name)) {
        let value = match &settings.sky {
            // Its bytes are among the inputs; by which path they were found makes no difference.
            SkySetting::Image(_) if field.name == "sky" => "image".into(),
            _ => (field.get)(settings),
        };
        for text in [field.name, &value] {
            hasher.update(&(text.len() as u64).to_le_bytes());
            hasher.update(text.as_bytes());
        }
    }
    *hasher.finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;

    #[test]
    fn the_same_sky_image_by_another_path_is_the_same_input() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("s.glb");
        std::fs::write(&scene, luxel_assets::glb::write(&luxel_assets::cornell()).unwrap()).unwrap();
        let key_of = |name: &str, radiance: f32| {
            let path = folder.path().join(name);
            exr::prelude::write_rgb_file(&path, 8, 4, |_, _| (radiance, 1.0, 1.0)).unwrap();
            let settings = Settings { sky: SkySetting::Image(path), ..Settings::default() };
            key(&load(&scene, &settings, &Silent).unwrap(), &settings)
        };
        let noon = key_of("noon.exr", 1.0);
        assert_eq!(key_of("twelve.exr", 1.0), noon);
        assert_ne!(key_of("noon.exr", 2.0), noon, "other light is another input");
        let none = Settings::default();
        assert_ne!(key(&load(&scene, &none, &Silent).unwrap(), &none), noon);
    }
}
