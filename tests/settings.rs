//! Settings through the real binary: each has the physical consequence that it promises.

mod support;
mod tool;

use std::path::Path;

use glam::{DVec3, Vec3};
use luxel::settings::{
    GatherMode, Only, Settings, Voxels,
    value::{Samples, Tolerance},
};
use luxel_scene::{LightKind, Material, Scene, build::Builder};
use tempfile::TempDir;
use tool::{Outputs, asset, luxel};

/// A bake in a moment.
const QUICK: [&str; 8] = ["--preset", "draft", "--size", "32", "--voxels", "2000", "--directions", "64"];

/// A folder with the scene as `s.glb`.
fn folder(scene: &Scene) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("s.glb"), luxel_assets::glb::write(scene).unwrap()).unwrap();
    folder
}

fn bake_in(folder: &Path, flags: &[&str]) -> Outputs {
    luxel(&[&["bake", "s.glb"], &QUICK[..], flags].concat(), folder).ended(0);
    Outputs::read(&folder.join("baked"), "s")
}

fn bake(scene: &Scene, flags: &[&str]) -> Outputs {
    bake_in(folder(scene).path(), flags)
}

/// A mean over the texels that count [lux].
fn mean(outputs: &Outputs, which: &str) -> f64 {
    outputs.report["quality"][format!("mean_{which}_lux")].as_f64().unwrap()
}

fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!(expected > 0.0 && (found / expected - 1.0).abs() < tolerance, "{found}, not {expected}");
}

const BULB: LightKind = LightKind::Point { position: DVec3::new(0.2, 1.0, 0.1), range: None, radius: 0.0 };
const NOON: LightKind = LightKind::Sun { direction: DVec3::NEG_Y, angle: 0.0 };

/// A floor of 4 × 4 that faces up, under one light.
fn floor(light: Option<LightKind>, material: Material) -> Builder {
    let mut b = Builder::new("s");
    let material = b.material(material);
    b.quad("floor", Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, material);
    if let Some(kind) = light {
        b.light("light", kind, Vec3::splat(100.0));
    }
    b
}

/// The same with a small square above it that throws a shadow and receives none itself.
fn shaded(light: LightKind) -> Scene {
    let mut b = floor(Some(light), Material::default());
    let black = b.matte(Vec3::ZERO);
    let square = b.quad("square", Vec3::new(-0.4, 0.5, 0.4), Vec3::X * 0.8, Vec3::NEG_Z * 0.8, black);
    b.scene_mut().instances[square].receives = false;
    b.build()
}

/// The covered texels' irradiance, red.
fn covered(outputs: &Outputs) -> Vec<f32> {
    let map = &outputs.lightmaps[0];
    map.irradiance().iter().zip(map.coverage()).filter(|(_, c)| **c > 0.99).map(|(e, _)| e.x).collect()
}

#[test]
fn twice_the_light_scale_is_twice_the_light() {
    let scene = floor(Some(BULB), Material::default()).build();
    let [one, two] = ["1", "2"].map(|scale| bake(&scene, &["--light-scale", scale]));
    for (a, b) in one.lightmaps[0].irradiance().iter().zip(two.lightmaps[0].irradiance()) {
        assert!((*b - 2.0 * *a).abs().max_element() <= 1e-5 * b.max_element(), "{a} and {b}");
    }
    assert_near(mean(&two, "direct"), 2.0 * mean(&one, "direct"), 1e-5);
}

#[test]
fn lamps_with_a_radius_soften_shadows_by_extras_and_by_setting() {
    let scene = |radius| shaded(LightKind::Point { position: DVec3::new(0.0, 1.0, 0.0), range: None, radius });
    let flags = ["--only", "direct", "--shadow-samples", "64"];
    let with = |scene: &Scene, radius: &str| bake(scene, &[&flags[..], &["--lamp-radius", radius]].concat());
    let [hard, by_setting] = ["0", "0.3"].map(|radius| with(&scene(0.0), radius));
    // In extras the radius wins over the setting.
    let by_extras = with(&scene(0.3), "7");
    let umbra = |o: &Outputs| covered(o).iter().filter(|e| **e == 0.0).count();
    assert!(umbra(&hard) > 0 && umbra(&by_setting) < umbra(&hard), "{} and {}", umbra(&by_setting), umbra(&hard));
    assert!(by_extras.lightmaps == by_setting.lightmaps);
}

#[test]
fn a_sun_with_an_angle_has_penumbrae_by_extras_and_by_setting() {
    let scene = |degrees: f64| shaded(LightKind::Sun { direction: DVec3::NEG_Y, angle: degrees.to_radians() });
    let flags = ["--only", "direct", "--shadow-samples", "64"];
    let with = |scene: &Scene, angle: &str| bake(scene, &[&flags[..], &["--sun-angle", angle]].concat());
    let [hard, by_setting] = ["0", "40"].map(|angle| with(&scene(0.0), angle));
    let penumbra = |o: &Outputs| {
        let e = covered(o);
        let full = e.iter().copied().fold(0.0, f32::max);
        e.iter().filter(|e| **e > 0.1 * full && **e < 0.9 * full).count()
    };
    assert!(penumbra(&by_setting) > penumbra(&hard) + 20, "{} and {}", penumbra(&by_setting), penumbra(&hard));
    assert_near(mean(&by_setting, "direct"), mean(&hard, "direct"), 0.05);
    assert!(with(&scene(40.0), "0.5").lightmaps == by_setting.lightmaps, "the extras' angle wins");
}

#[test]
fn double_sided_surfaces_show_their_back_where_they_are_told_to() {
    // Seen from its front the floor is dark: the sun shines from below.
    let material = Material { double_sided: true, ..Material::default() };
    let scene = floor(Some(LightKind::Sun { direction: DVec3::Y, angle: 0.0 }), material).build();
    let folder = folder(&scene);
    let [front, max, average] =
        ["front", "max", "average"].map(|rule| bake_in(folder.path(), &["--only", "direct", "--double-sided", rule]));
    assert_eq!(mean(&front, "direct"), 0.0);
    assert_near(mean(&max, "direct"), 100.0, 1e-4);
    assert_near(mean(&average, "direct"), 50.0, 1e-4);
}

#[test]
fn a_sky_image_shines_as_its_pixels_say() {
    let scene = floor(None, Material::default()).build();
    let folder = folder(&scene);
    let radiance = [1.0f32, 2.0, 4.0];
    let mut hdr = Vec::new();
    let encoder = image::codecs::hdr::HdrEncoder::new(&mut hdr);
    encoder.encode(&[image::Rgb(radiance); 32 * 16], 32, 16).unwrap();
    std::fs::write(folder.path().join("sky.hdr"), hdr).unwrap();
    let [r, g, b] = radiance;
    exr::prelude::write_rgb_file(folder.path().join("sky.exr"), 32, 16, |_, _| (r, g, b)).unwrap();
    for (sky, factor) in [("sky.hdr", "1"), ("sky.exr", "1"), ("sky.exr", "3")] {
        let outputs = bake_in(folder.path(), &["--sky", sky, "--sky-strength", factor]);
        let map = &outputs.lightmaps[0];
        let middle = map.sample(glam::Vec2::splat(0.5)).to_array();
        for (e, l) in middle.into_iter().zip(radiance) {
            let expected = std::f64::consts::PI * f64::from(l) * factor.parse::<f64>().unwrap();
            assert_near(f64::from(e), expected, 0.01);
        }
    }
    // The same by a file beside the scene, which the command line overrides.
    std::fs::write(folder.path().join("luxel.toml"), "[sky]\nimage = \"sky.hdr\"\nstrength = 2").unwrap();
    let outputs = bake_in(folder.path(), &[]);
    assert_near(mean(&outputs, "irradiance"), 2.0 * std::f64::consts::PI * 7.0 / 3.0, 0.01);
}

#[test]
fn photons_and_the_final_gather_find_the_same_light() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(asset("cornell.glb"), folder.path().join("s.glb")).unwrap();
    let flags = |flags: &[&'static str]| [&["--only", "indirect", "--gather", "lightcuts"], flags].concat();
    let cuts = bake_in(folder.path(), &flags(&[]));
    let photons = bake_in(folder.path(), &flags(&["--photons", "400000"]));
    let gathered = bake_in(folder.path(), &["--only", "indirect", "--gather", "final", "--gather-rays", "128"]);
    assert_near(mean(&photons, "indirect"), mean(&cuts, "indirect"), 0.02);
    assert_near(mean(&gathered, "indirect"), mean(&cuts, "indirect"), 0.05);
    assert!(photons.lightmaps != cuts.lightmaps && gathered.lightmaps != cuts.lightmaps);
    let count = |o: &Outputs, counter: &str| o.report["counters"][counter].as_u64().unwrap();
    assert!(count(&photons, "arrived_photons") > 100_000);
    // The paper's names: so many points of lights, and so many photons from each of them.
    let table = |name: &str| photons.report["table1"][name].as_u64().unwrap();
    assert_eq!((table("direct_photons"), table("primary_photons")), (256, count(&photons, "primary_photons")));
    assert!(table("primary_photons") > 1000 && cuts.report["table1"]["direct_photons"] == 0);
}

/// A cut's bound is the sum over all its clusters: a certainty, of the light's own order of magnitude, that shrinks with
/// the threshold. What the bake states is that of the nodes, averaged and interpolated: an estimate, which the error
/// keeps to nearly everywhere.
#[test]
fn the_error_lies_within_the_stated_bound_and_the_bound_follows_the_threshold() {
    let scene = luxel_assets::cornell();
    let bake = |cut_error| {
        let settings = Settings {
            voxels: Voxels::Budget(10_000),
            gather: GatherMode::Lightcuts,
            cut_error: Tolerance(cut_error),
            cut_limit: Samples(4000),
            bound: true,
            // What the bound is stated of.
            only: Only::Indirect,
            ..support::medium(32)
        };
        support::bake(&scene, &settings)
    };
    let lit = bake(0.02);
    assert_eq!(lit.bounds.len(), 1);
    let texels = support::some_texels(&lit, 60, |_| true);
    let truth = support::reference(&scene, &lit, &texels, 2048);
    let band_mean = |e: Vec3| f64::from(e.element_sum()) / 3.0;
    let mut within = 0;
    for (&i, truth) in texels.iter().zip(&truth) {
        let bound = f64::from(lit.texels.bound[i]);
        assert!(bound > 0.0, "texel {i} states that it makes no error");
        let error = (band_mean(lit.texels.irradiance[i]) - band_mean(truth.indirect)).abs();
        // Twice the reference's standard error is its own.
        within += usize::from(error <= bound + 2.0 * f64::from(truth.indirect_error));
    }
    let sum = |lit: &luxel::Lit| texels.iter().map(|&i| f64::from(lit.texels.bound[i])).sum::<f64>();
    let (coarse, fine) = (sum(&lit), sum(&bake(0.005)));
    let light: f64 = truth.iter().map(|t| band_mean(t.indirect)).sum();
    println!("{within} of {} within a bound of {:.2} times the light", texels.len(), coarse / light);
    println!("at a quarter of the threshold: {:.2} times", fine / light);
    assert!(within * 20 >= texels.len() * 19, "{within} of {}", texels.len());
    assert!(fine < 0.8 * coarse, "{fine} and {coarse}");
}

#[test]
fn a_mode_without_a_bound_writes_none_and_says_so() {
    let scene = shaded(NOON);
    let folder = folder(&scene);
    for mode in ["lookup", "final"] {
        let outputs = bake_in(folder.path(), &["--bound", "--gather", mode, "--gather-rays", "4"]);
        let told = outputs.warnings("no-bound");
        assert!(told.len() == 1 && told[0].contains(mode), "{told:?}");
        assert!(!folder.path().join("baked/s.bound.exr").exists());
        assert!(outputs.report["quality"].get("mean_bound_lux").is_none());
    }
    let outputs = bake_in(folder.path(), &["--bound", "--gather", "lightcuts"]);
    assert!(outputs.warnings("no-bound").is_empty() && folder.path().join("baked/s.bound.exr").exists());
}
