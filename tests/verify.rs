//! The bake as a gate: its error measured and judged, through the binary, by exit code, events, report and files; and
//! the energy ledger stage by stage.

mod support;
mod tool;

use std::path::Path;

use glam::{Vec2, Vec3};
use luxel::settings::{Preset, Settings, Voxels, value::Texels};
use luxel::verify::{Verify, gate, measure, sample, verify_lit};
use luxel_scene::{Scene, Silent, Sky, build::Builder};
use luxel_transport::{
    geometry::Geometry,
    rays::Rays,
    sampling::{combine, mix},
    validity,
};
use serde_json::Value;
use tool::{Run, files, folder, luxel as tool_luxel};

/// A good bake within a moment.
const GOOD: [&str; 6] = ["--size", "64", "--voxels", "20000", "--verify", "64"];
/// As bad as can be had.
const BAD: [&str; 10] =
    ["--size", "64", "--voxels", "200", "--directions", "8", "--refresh", "0", "--gather", "lookup"];

fn run(args: &[&[&str]], folder: &Path) -> Run {
    tool_luxel(&args.concat(), folder)
}

fn report(folder: &Path, stem: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join(format!("baked/{stem}.bake.json"))).unwrap()).unwrap()
}

fn check<'r>(report: &'r Value, name: &str) -> &'r Value {
    let list = report["checks"].as_array().unwrap();
    list.iter().find(|check| check["name"] == name).unwrap_or_else(|| panic!("no check {name}: {report}"))
}

fn events(run: &Run) -> Vec<Value> {
    run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_good_bake_passes_and_a_bad_one_leaves_its_files() {
    let folder = folder(&["cornell.glb"]);
    let (at, baked) = (folder.path(), folder.path().join("baked"));
    // A plain bake first: what a verified one writes has its bytes.
    run(&[&["bake", "cornell.glb"], &GOOD[..4]], at).ended(0);
    let plain = files(&baked);
    let stale = run(&[&["bake", "cornell.glb", "--check", "--json"], &GOOD], at).ended(3);
    assert!(events(&stale).iter().any(|e| e["reasons"][0]["code"] == "not-verified"), "{}", stale.stdout);

    let good = run(&[&["bake", "cornell.glb"], &GOOD], at).ended(0);
    assert!(good.stderr.contains("verified: RMSE") && good.stderr.contains("5 of 5 passed"), "{}", good.stderr);
    let report = report(at, "cornell");
    let v = &report["verification"];
    println!("{v:#}\n{:#}", report["checks"]);
    let number = |name: &str| v[name].as_f64().unwrap_or_else(|| panic!("{name}: {v}"));
    assert!(number("rmse_low") <= number("rmse") && number("rmse") <= number("rmse_high"), "{v}");
    assert!(number("rmse_high") <= 0.05 && number("bias").abs() < 0.02, "{v}");
    assert!(number("texels") > 50.0 && number("drawn") == 64.0 && number("paths") >= 256.0, "{v}");
    assert!(v["worst"][0]["object"].is_string() && v["worst"][0]["position"][2].is_number(), "{v}");
    let names = ["uv-overlap", "buried", "leaks", "energy", "values"];
    assert!(names.iter().all(|name| check(&report, name)["passed"] == true), "{}", report["checks"]);
    let verified = files(&baked);
    for (name, bytes) in plain.iter().filter(|(name, _)| !name.ends_with(".json")) {
        assert!(verified[name] == *bytes, "{name} differs for having been verified");
    }

    // What is current is judged by its report, and nothing is written.
    let again = run(&[&["bake", "cornell.glb", "--max-error", "5%", "--json"], &GOOD], at).ended(0);
    let told = events(&again);
    let unchanged = told.iter().find(|e| e["event"] == "unchanged").unwrap();
    assert_eq!(unchanged["verification"], *v);
    let strict = run(&[&["bake", "cornell.glb", "--check", "--max-error", "0.1%"], &GOOD], at).ended(1);
    assert!(strict.stderr.contains("certainly above 0.10 %"), "{}", strict.stderr);
    assert!(files(&baked) == verified);

    // Other settings make a bad bake: it fails, says why, and replaces nothing.
    let bad = run(&[&["bake", "cornell.glb", "--max-error", "5%", "--verify", "100", "--json"], &BAD], at).ended(1);
    let told = events(&bad);
    let failed = told.iter().find(|e| e["event"] == "failed").unwrap();
    let said = failed["error"].as_str().unwrap();
    println!("{said}");
    assert!(said.contains("certainly above 5.00 %") && said.contains("worst: ") && said.contains("--voxels"), "{said}");
    assert!(failed["verification"]["rmse_low"].as_f64().unwrap() > 0.05, "{failed}");
    assert!(files(&baked) == verified, "the last good lightmap stays byte for byte");
    // Without a limit it is told and written.
    let told = run(&[&["bake", "cornell.glb", "--verify", "100"], &BAD], at).ended(0);
    assert!(told.stderr.contains("verified: RMSE"), "{}", told.stderr);
    assert!(files(&baked) != verified);
}

#[test]
fn in_a_folder_a_scene_that_is_not_good_enough_fails_alone() {
    let folder = folder(&["cornell.glb"]);
    // Without light there is nothing to compare, and nothing is wrong with it.
    let mut b = Builder::new("dark");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::ZERO, Vec3::Z, Vec3::X, grey);
    std::fs::write(folder.path().join("dark.glb"), luxel_assets::glb::write(&b.build()).unwrap()).unwrap();
    let both = run(&[&["bake", ".", "--max-error", "5%", "--verify", "64", "--json"], &BAD], folder.path()).ended(1);
    let done = events(&both).pop().unwrap();
    assert_eq!(done["failed"].as_array().unwrap().len(), 1, "{done}");
    assert!(done["failed"][0].as_str().unwrap().ends_with("cornell.glb"), "{done}");
    let dark = report(folder.path(), "dark");
    assert!(dark["verification"]["nothing"].as_str().unwrap().contains("no light"), "{dark:#}");
    assert!(!folder.path().join("baked/cornell.glb").exists());
    // And it is not baked again for it.
    run(&[&["bake", "dark.glb", "--check", "--max-error", "5%", "--verify", "64"], &BAD], folder.path()).ended(0);
}

#[test]
fn authored_charts_that_overlap_are_not_what_the_lightmap_has() {
    let folder = folder(&[]);
    let mut b = Builder::new("overlap");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::ZERO, Vec3::Z, Vec3::X, grey);
    b.cuboid("block", Vec3::new(0.3, 0.2, 0.3), Vec3::new(0.6, 0.5, 0.6), grey, false);
    let mut scene = b.build();
    for mesh in &mut scene.meshes {
        // Every face of the block lies on all others.
        let corner = |i: usize| [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y][i % 4];
        let uvs: Vec<Vec2> = (0..mesh.positions.len()).map(corner).collect();
        mesh.uvs = vec![uvs.clone(), uvs];
    }
    std::fs::write(folder.path().join("a.glb"), luxel_assets::glb::write(&scene).unwrap()).unwrap();
    let flags = ["--sky", "1,1,1", "--size", "64", "--voxels", "5000", "--max-error", "5%", "--verify", "64"];
    run(&[&["bake", "a.glb"], &flags], folder.path()).ended(0);
    let report = report(folder.path(), "a");
    let overlap = check(&report, "uv-overlap");
    assert!(overlap["passed"] == true && overlap["value"].as_f64().unwrap() < 1e-3, "{overlap}");
    let warned = report["warnings"].as_array().unwrap().iter().any(|w| w["code"] == "unwrapped-anew");
    assert!(warned, "{report:#}");
}

fn quick() -> Settings {
    Settings { size: Texels(64), voxels: Voxels::Budget(20_000), ..Settings::preset(Preset::Medium) }
}

/// Two closed boxes, the one at x < 1 with a lamp; a slit lets light out of it only where asked for.
fn two_boxes() -> Scene {
    let mut b = Builder::new("two boxes");
    let wall = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::splat(50.0));
    b.cuboid("lit room", Vec3::ZERO, Vec3::new(1.0, 1.2, 1.5), wall, true);
    b.cuboid("dark room", Vec3::new(1.2, 0.0, 0.0), Vec3::new(2.2, 1.2, 1.5), wall, true);
    b.cuboid("lamp", Vec3::new(0.4, 0.8, 0.6), Vec3::new(0.7, 0.9, 0.9), lamp, false);
    b.build()
}

#[test]
fn light_in_a_closed_dark_room_is_a_leak() {
    let (scene, settings) = (two_boxes(), quick());
    let mut lit = support::bake(&scene, &settings);
    // With a limit that far away a few paths tell enough.
    let ask = Verify { texels: 32, max_error: Some(0.4) };
    let leaks = |lit: &luxel::Lit| {
        let found = verify_lit(&scene, lit, &settings, &ask, &Silent).unwrap();
        println!("{:?}", found.checks);
        found.checks.into_iter().find(|check| check.name == "leaks").unwrap()
    };
    let good = leaks(&lit);
    assert!(good.passed && !good.message.starts_with("0 of 0"), "{good:?}");
    // Half a per cent of the mean in the dark room.
    let atlas = lit.atlas.clone();
    let (texels, mean) = (&atlas.texels, 0.005 * lit.lightmaps[0].irradiance().iter().map(|e| e.x).sum::<f32>());
    let mean = mean / texels.len() as f32;
    let (mut light, width) = (lit.lightmaps[0].irradiance().to_vec(), lit.lightmaps[0].width() as usize);
    for texel in texels.iter().filter(|t| scene.instances[atlas.chart(t).instance as usize].name == "dark room") {
        light[usize::from(texel.y) * width + usize::from(texel.x)] += Vec3::splat(mean);
    }
    let (map, height) = (&lit.lightmaps[0], lit.lightmaps[0].height());
    let coverage = map.coverage().to_vec();
    lit.lightmaps[0] = luxel_export::Lightmap::new(width as u32, height, light, coverage).unwrap();
    let bad = leaks(&lit);
    assert!(!bad.passed && bad.value > 30.0 && bad.message.contains("dark room"), "{bad:?}");
}

/// The interval of a small sample holds the error of all texels about as often as it says.
#[test]
fn intervals_hold_the_error_of_all_texels() {
    const SAMPLE: u64 = 100;
    const TRIALS: u64 = 200;
    let scene = luxel_assets::cornell();
    let settings = Settings { size: Texels(64), ..quick() };
    let lit = support::bake(&scene, &settings);
    let baked = sample::Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps };
    let geometry = Geometry::new(&scene);
    let rays = Rays::new(&geometry);
    let is_free = |texel| !validity::is_buried(&rays, &baked.receiver(&geometry, texel));
    let texels: Vec<usize> = support::valid_texels(&lit, is_free);
    let truth = support::reference(&scene, &lit, &texels, 512);
    let all: Vec<luxel::verify::Sample> = texels
        .iter()
        .zip(&truth)
        .map(|(texel, e)| luxel::verify::Sample {
            found: baked.value(*texel),
            expected: e.total,
            band_error: e.band_error,
            error: e.standard_error,
            weight: baked.area(*texel),
        })
        .collect();
    let whole = measure(&all);
    let mut ends = Vec::new();
    let mut area = 0.0;
    for sample in &all {
        area += sample.weight;
        ends.push(area);
    }
    let trial = |number: u64| {
        let pick = |k: u64| {
            let at = combine(mix(number), k) as f64 / u64::MAX as f64 * area;
            luxel::verify::Sample { weight: 1.0, ..all[ends.partition_point(|end| *end <= at).min(all.len() - 1)] }
        };
        measure(&(0..SAMPLE).map(pick).collect::<Vec<_>>())
    };
    let found: Vec<_> = (0..TRIALS).map(trial).collect();
    let held = |of: fn(&luxel::verify::Measure) -> luxel::verify::Interval| {
        let truth = of(&whole).value;
        found.iter().filter(|m| of(m).low <= truth && truth <= of(m).high).count() as f64 / TRIALS as f64
    };
    let shares = [held(|m| m.rmse), held(|m| m.bias), held(|m| m.median), held(|m| m.p95)];
    println!(
        "all {} texels: {whole:?}\nheld by {TRIALS} samples of {SAMPLE}: RMSE, bias, median, p95 {shares:?}",
        all.len()
    );
    // Three standard deviations of a count of 200 are 4.6 %.
    assert!(shares.iter().all(|share| (0.9..=1.0).contains(share)), "{shares:?}");
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
        let all = |x: [f64; 3]| x.iter().sum::<f64>();
        let books = all(s.absorbed) + all(s.escaped) + all(s.in_flight) + all(s.imbalance);
        assert!((books / (all(s.emitted) + all(s.from_sky)) - 1.0).abs() < 1e-9, "{name}: {s:?}");
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

#[test]
fn a_verified_bake_says_what_it_is_asked() {
    let folder = folder(&["cornell.glb"]);
    for (args, expected) in
        [(["--verify", "3"], "16..=1000000"), (["--max-error", "2"], "2%"), (["--max-error", "0%"], "2%")]
    {
        let wrong = run(&[&["bake", "cornell.glb"], &args], folder.path()).ended(2);
        assert!(wrong.stderr.contains(expected), "{}", wrong.stderr);
    }
    let help = run(&[&["bake", "--help"]], folder.path()).ended(0).stdout;
    assert!(help.contains("--verify <N>") && help.contains("--max-error <SHARE>"), "{help}");
    assert_eq!(gate::line(&Default::default()).matches("RMSE").count(), 1);
}

#[test]
fn figures_do_not_depend_on_threads_or_on_what_was_stored() {
    let folder = folder(&["two_rooms.glb"]);
    let (at, place) = (folder.path(), folder.path().join("baked/two_rooms.bake.json"));
    let flags = ["--size", "48", "--voxels", "6000", "--verify", "16"];
    let told = |more: &[&str]| {
        run(&[&["bake", "two_rooms.glb"], &flags, more], at).ended(0);
        let report = report(at, "two_rooms");
        (report["verification"].clone(), report["energy"]["stages"].clone(), report["checks"].clone())
    };
    let one = told(&["--threads", "1"]);
    assert!(one.1.as_array().is_some_and(|stages| stages[0]["name"] == "shoot" && stages.len() > 3), "{}", one.1);
    std::fs::remove_file(&place).unwrap();
    assert_eq!(told(&["--threads", "7"]), one, "all light is stored");
    let finished = folder.path().join("baked/.luxel/finish");
    std::fs::remove_dir_all(finished).unwrap();
    std::fs::remove_file(&place).unwrap();
    assert_eq!(told(&[]), one, "light at texels is stored");
    let clean = ["--threads", "7", "--store", "another", "--force"];
    assert_eq!(told(&clean), one, "nothing is stored");
}
