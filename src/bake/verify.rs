//! The verification of a bake before its files are replaced: against the scene with its lights at their own strength,
//! which the bake has set to their units.

use luxel_export::report::EnergyStage;
use luxel_scene::{Scene, Sky};
use luxel_transport::{Rgb, geometry::Geometry, lights::Source, rays::Rays};

use super::groups::Lighting;
use super::journal::Journal;
use super::tracer::Tracer;
use super::{Baking, Lit};
use crate::Error;
use crate::plan::Stage;
use crate::verify::{Verified, Verify, sample::Baked, verify};

/// Compares a finished lightmap with the reference. With a limit, one that is not good enough is an error.
pub fn judge(
    baking: &Baking,
    tracer: &Tracer,
    lit: &Lit,
    ask: &Verify,
    journal: &mut Journal,
) -> Result<Verified, Error> {
    let progress = journal.progress;
    let scene = lit_scene(tracer.geometry.scene, baking.lighting);
    progress.check()?;
    let geometry = Geometry::new(&scene);
    progress.check()?;
    // The shape is that of the bake, so the tree is too; without any light there is none.
    let rays = match baking.plan.runs(Stage::Rays) {
        true => Rays::with(&geometry, tracer.rays(baking.plan, journal)?.tree().clone()),
        false => Rays::build(&geometry, progress)?,
    };
    let baked = Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps };
    let found = verify(&rays, baked, baking.settings, lit.energy_stages(), ask, progress)?;
    match ask.max_error.and_then(|limit| found.judge(limit)) {
        Some(refusal) => Err(Error::NotGoodEnough(Box::new(refusal))),
        None => Ok(found),
    }
}

impl Lit {
    /// The energy ledger stage by stage; empty where nothing was propagated.
    pub fn energy_stages(&self) -> &[EnergyStage] {
        self.transport.record.as_ref().map_or(&[], |record| &record.energy.stages)
    }
}

/// A scene whose lights were set to their units, as it was before.
fn lit_scene(unit: &Scene, lighting: &Lighting) -> Scene {
    let mut scene = unit.clone();
    for (material, coefficient) in scene.materials.iter_mut().zip(&lighting.emission) {
        if material.emits() {
            material.emission *= *coefficient;
        }
    }
    for group in &lighting.groups {
        for (source, weight) in &group.sources {
            if let Source::Light(i) = source {
                scene.lights[*i as usize].intensity *= group.factor * *weight;
            }
        }
    }
    strengthen(&mut scene.sky, lighting.sky);
    scene
}

fn strengthen(sky: &mut Sky, strength: Rgb) {
    match sky {
        Sky::None => {}
        Sky::Constant(radiance) => *radiance *= strength,
        Sky::Gradient { zenith, horizon, ground } => {
            [zenith, horizon, ground].into_iter().for_each(|radiance| *radiance *= strength);
        }
        Sky::Image(image) => image.strength *= strength.x,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Preset, Settings, Voxels, value::Texels};
    use crate::verify::verify_lit;
    use glam::{DVec3, Vec3};
    use luxel_scene::{LightKind, Silent, build::Builder};

    fn scene() -> Scene {
        let mut b = Builder::new("room");
        let wall = b.matte(Vec3::splat(0.5));
        let glow = b.emitter(Vec3::splat(0.1), Vec3::new(8.0, 4.0, 2.0));
        b.quad("floor", Vec3::ZERO, Vec3::Z, Vec3::X, wall);
        b.quad("panel", Vec3::new(0.2, 0.9, 0.2), Vec3::X * 0.3, Vec3::Z * 0.3, glow);
        for i in 0..2 {
            let kind =
                LightKind::Point { position: DVec3::new(0.5, 0.5, 0.3 * f64::from(i)), range: None, radius: 0.0 };
            b.light(&format!("lamp {i}"), kind, Vec3::new(1.0, 0.0, 3.0 + i as f32));
        }
        let mut scene = b.build();
        scene.lights.iter_mut().for_each(|l| l.group = "lamps".into());
        scene.sky = Sky::Gradient { zenith: Vec3::new(1.0, 2.0, 0.0), horizon: Vec3::ONE, ground: Vec3::ZERO };
        scene
    }

    #[test]
    fn lights_get_their_strength_back() {
        let whole = scene();
        for settings in
            [Settings::default(), Settings { light_groups: crate::settings::LightGroups::One, ..Settings::default() }]
        {
            let mut unit = whole.clone();
            let lighting = Lighting::part(&mut unit, &settings);
            let back = lit_scene(&unit, &lighting);
            let near = |a: Vec3, b: Vec3| (a - b).abs().max_element() < 1e-5;
            assert!(back.materials.iter().zip(&whole.materials).all(|(a, b)| near(a.emission, b.emission)));
            assert!(back.lights.iter().zip(&whole.lights).all(|(a, b)| near(a.intensity, b.intensity)));
            let up = |s: &Scene| s.sky.radiance(Vec3::new(0.6, 0.8, 0.0));
            assert!(near(up(&back), up(&whole)), "{} {}", up(&back), up(&whole));
        }
    }

    #[test]
    fn a_bake_in_memory_is_verified_and_a_spoilt_one_is_found() {
        let scene = scene();
        let settings = Settings { size: Texels(64), voxels: Voxels::Budget(3000), ..Settings::preset(Preset::Medium) };
        let mut lit = crate::bake_scene(&scene, &settings, &Silent).unwrap();
        let ask = Verify { texels: 100, max_error: None };
        let good = verify_lit(&scene, &lit, &settings, &ask, &Silent).unwrap();
        println!("{}", crate::verify::gate::line(&good.verification));
        good.checks.iter().for_each(|check| println!("{check:?}"));
        let v = &good.verification;
        assert!(v.rmse < 0.03 && v.rmse_low <= v.rmse && v.rmse <= v.rmse_high, "{v:?}");
        assert!(v.texels > 80 && v.worst.len() == 5 && v.worst[0].object == "floor", "{v:?}");
        let (direct, indirect) = (v.direct.as_ref().unwrap(), v.indirect.as_ref().unwrap());
        assert!((direct.mean_lux + indirect.mean_lux - v.mean_lux).abs() < 1e-4 * v.mean_lux, "{v:?}");
        assert!(good.checks.iter().all(|check| check.passed), "{:?}", good.checks);
        assert!(good.judge(0.05).is_none() && good.judge(1e-5).is_some());
        // Of no texel nothing is known, so one is looked at at least.
        let none = Verify { texels: 0, max_error: Some(1e-6) };
        let few = verify_lit(&scene, &lit, &settings, &none, &Silent).unwrap();
        assert!((1..=4).contains(&few.verification.drawn) && few.judge(1e-6).is_some(), "{:?}", few.verification);
        // A lightmap that is a tenth too bright.
        for map in &mut lit.lightmaps {
            let light = map.irradiance().iter().map(|e| *e * 1.1).collect();
            *map = luxel_export::Lightmap::new(map.width(), map.height(), light, map.coverage().to_vec()).unwrap();
        }
        let bad = verify_lit(&scene, &lit, &settings, &ask, &Silent).unwrap();
        assert!((bad.verification.bias - 0.1).abs() < 0.01 && bad.judge(0.05).is_some(), "{:?}", bad.verification);
    }
}
