//! The energy ledger of bakes, stage by stage: what is emitted is absorbed, has escaped, or is in flight.

mod support;

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::settings::{
    GatherMode, LightGroups, Preset, Settings, Voxels,
    value::{Samples, Texels},
};
use luxel::verify::checks;
use luxel_scene::{LightKind, Material, Scene, Sky, Texture, TextureRef, build::Builder};

fn quick() -> Settings {
    Settings { voxels: Voxels::Budget(20_000), ..support::medium(64) }
}

/// Prints the ledger of a bake stage by stage; the largest share that is surely amiss.
fn energy(name: &str, scene: &Scene, settings: &Settings) -> f64 {
    let lit = support::bake(scene, settings);
    let stages = lit.energy_stages();
    assert!(stages.len() >= 3 && stages.last().is_some_and(|s| s.name == "gather"), "{name}: {stages:?}");
    for s in stages {
        let sign = if s.imbalance.iter().sum::<f64>() < 0.0 { "made" } else { "lost" };
        let [share, error] = [s.share, s.share_error].map(|x| 100.0 * x);
        println!("{name}: {:<9} {share:.3} % {sign} (standard error {error:.3} %)", s.name);
        assert!(s.share_error < 0.005, "{name}: {s:?}");
    }
    stages.iter().map(|s| s.share).fold(0.0, f64::max)
}

#[test]
fn the_books_balance_after_every_stage() {
    let mut b = Builder::new("furnace");
    let glow = b.emitter(Vec3::splat(0.8), Vec3::ONE);
    b.cuboid("walls", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), glow, true);
    let furnace = b.build();
    let cornell = luxel_assets::cornell();
    let mut b = Builder::new("under the sky");
    let grey = b.matte(Vec3::new(0.6, 0.5, 0.4));
    b.quad("floor", Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0, grey);
    b.cuboid("block", Vec3::new(-0.5, 0.0, -0.5), Vec3::new(0.5, 1.0, 0.5), grey, false);
    let mut open = b.build();
    open.sky = Sky::Constant(Vec3::new(1.0, 1.5, 2.0));
    for (name, scene) in [("furnace", &furnace), ("cornell", &cornell), ("sky", &open)] {
        let share = energy(name, scene, &quick());
        assert!(share < luxel::verify::checks::LIMIT, "{name}: {share}");
    }
}

/// Where bounces were capped, a refresh neither adds what was not asked for, nor leaves the sweep's own rest in the books.
#[test]
fn capped_bounces_are_booked_once() {
    let rho = 0.5;
    let mut b = Builder::new("furnace");
    let glow = b.emitter(Vec3::splat(rho), Vec3::ONE);
    b.cuboid("walls", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), glow, true);
    let furnace = b.build();
    for bounces in [1, 2, 3] {
        let settings = Settings {
            bounces: Samples(bounces),
            gather: GatherMode::Lookup,
            voxels: Voxels::Budget(3000),
            size: Texels(32),
            ..quick()
        };
        assert!(settings.refresh.0 > 0);
        let share = energy(&format!("{bounces} bounces"), &furnace, &settings);
        assert!(share < checks::LIMIT, "{bounces}: {share}");
        let lit = support::bake(&furnace, &settings);
        // Of unit direct light, one bounce has ρ more, and the rest of the series is that of all.
        let expected = PI * if bounces == 1 { f64::from(1.0 + rho) } else { 1.0 / f64::from(1.0 - rho) };
        let found = support::mean(&lit, &support::valid_texels(&lit, |_| true));
        println!("{bounces} bounces: E = {found:.4}, by the series {expected:.4}");
        assert!((found / expected - 1.0).abs() < 0.005, "{bounces}: {found}, not {expected}");
        let refreshed = lit.energy_stages().iter().find(|s| s.name == "refresh").unwrap();
        let in_flight = refreshed.in_flight[0] / refreshed.emitted[0];
        let rest = if bounces == 1 { f64::from(rho * rho) } else { 0.0 };
        assert!((in_flight - rest).abs() < 0.005, "{bounces}: {refreshed:?}");
    }
}

/// A closed room with a textured floor, in which three lights of three groups shine in a band each: what they emit is known,
/// nothing escapes, and every band has to come to rest by itself.
#[test]
fn the_books_of_three_groups_balance_band_by_band() {
    let mut b = Builder::new("three lights");
    let white = b.matte(Vec3::splat(0.6));
    let texel = |i: u32| if i % 8 / 4 == i / 32 { [60, 60, 60, 255] } else { [210, 210, 210, 255] };
    let texels = (0..64).map(texel).collect();
    b.scene_mut().textures.push(Texture { name: "tiles".into(), width: 8, height: 8, srgb: false, texels });
    let tiles = b.material(Material {
        base_color: Vec3::ONE.extend(1.0),
        base_color_texture: Some(TextureRef::new(0)),
        ..Material::default()
    });
    let glow = b.emitter(Vec3::splat(0.5), Vec3::Z * 20.0);
    b.quad("floor", Vec3::Z, Vec3::X, Vec3::NEG_Z, tiles);
    b.quad("ceiling", Vec3::Y, Vec3::X, Vec3::Z, white);
    b.quad("back", Vec3::ZERO, Vec3::X, Vec3::Y, white);
    b.quad("front", Vec3::Z, Vec3::Y, Vec3::X, white);
    b.quad("left", Vec3::Z, Vec3::NEG_Z, Vec3::Y, white);
    b.quad("right", Vec3::X, Vec3::Z, Vec3::Y, white);
    b.quad("panel", Vec3::new(0.1, 0.96, 0.35), Vec3::X * 0.3, Vec3::Z * 0.3, glow);
    let bulb = LightKind::Point { position: DVec3::new(0.75, 0.55, 0.4), range: None, radius: 0.0 };
    b.light("bulb", bulb, Vec3::X * 2.0);
    let (inner, outer) = (0.3f64, 0.6f64);
    let spot = LightKind::Spot {
        position: DVec3::new(0.25, 0.8, 0.6),
        direction: DVec3::new(0.6, -0.8, 0.0),
        inner,
        outer,
        range: None,
        radius: 0.0,
    };
    b.light("spot", spot, Vec3::Y * 40.0);
    let scene = b.build();
    let cone = 2.0 * PI * ((inner.cos() - outer.cos()) / 3.0 + 1.0 - inner.cos());
    let emitted = [4.0 * PI * 2.0, cone * 40.0, PI * 20.0 * 0.09];
    let settings = Settings { size: Texels(64), voxels: Voxels::Budget(60_000), ..Settings::preset(Preset::Medium) };
    for light_groups in [LightGroups::Auto, LightGroups::One] {
        let settings = Settings { light_groups, ..settings.clone() };
        let lit = support::bake(&scene, &settings);
        for stage in lit.energy_stages() {
            let shares = [0, 1, 2].map(|i| stage.imbalance[i] / emitted[i]);
            let [x, y, z] = shares.map(|s| 100.0 * s);
            println!("{light_groups:?} {}: {x:+.3} % {y:+.3} % {z:+.3} %, escaped {:?}", stage.name, stage.escaped);
            for (i, share) in shares.iter().enumerate() {
                assert!((stage.emitted[i] / emitted[i] - 1.0).abs() < 1e-4, "{stage:?}, not {emitted:?}");
                assert!(stage.escaped[i] < 1e-3 * emitted[i], "{stage:?}");
                assert!(share.abs() < checks::LIMIT, "{light_groups:?}: {stage:?}");
            }
        }
        let last = &lit.energy_stages().last().unwrap();
        assert!([0, 1, 2].iter().all(|&i| last.in_flight[i].abs() < 0.01 * emitted[i]), "{last:?}");
    }
}

/// Sun and spot through stained glass and a grating, a textured screen and a sky, in four groups; sun and sky outdoors; two
/// hundred lamps.
#[test]
fn the_books_of_shipped_scenes_balance_after_every_stage() {
    let scenes = [(luxel_assets::textured_room(), 20_000), (luxel_assets::many_lamps(), 20_000)];
    // Bases stand on the ground and beams on capitals, face to face: the sweep gives such faces light that none of them
    // gets, less the finer the voxels are.
    let scenes = scenes.into_iter().chain([(luxel_assets::colonnade(), 100_000)]);
    for (scene, voxels) in scenes {
        let share = energy(&scene.name, &scene, &Settings { voxels: Voxels::Budget(voxels), ..quick() });
        assert!(share < checks::LIMIT, "{}: {share}", scene.name);
    }
}
