//! The bake as a gate: its error measured and judged, through the binary, by exit code, events, report and files.

mod support;
mod tool;

use std::path::Path;
use std::time::Instant;

use glam::{Vec2, Vec3};
use luxel::settings::{Preset, Settings, Voxels, value::Texels};
use luxel::verify::{Verify, checks, gate, measure, sample, verify_lit};
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

    let begun = Instant::now();
    let good = run(&[&["bake", "cornell.glb"], &GOOD], at).ended(0);
    let seconds = begun.elapsed().as_secs_f64();
    assert!(good.stderr.contains("verified: RMSE") && good.stderr.contains("5 of 5 passed"), "{}", good.stderr);
    let report = report(at, "cornell");
    // The verification is no part of the method and of its times; it is told to a tenth of a second.
    let overall = report["table1"]["overall_seconds"].as_f64().unwrap();
    let line = good.stderr.lines().find_map(|line| line.trim().strip_prefix("verify ")).unwrap();
    let verifying: f64 = line.trim().trim_end_matches(" s").parse().unwrap();
    println!("{overall} s of {seconds} s, {verifying} s of them to verify");
    assert!(verifying > 0.2 && overall <= seconds - verifying + 0.1, "{overall} and {verifying} of {seconds}");
    let v = &report["verification"];
    println!("{v:#}\n{:#}", report["checks"]);
    let number = |name: &str| v[name].as_f64().unwrap_or_else(|| panic!("{name}: {v}"));
    assert!(number("rmse_low") < number("rmse") && number("rmse") < number("rmse_high"), "{v}");
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

/// The paper's own rule does not keep light, and without a refresh nothing puts it right.
#[test]
fn books_that_do_not_balance_warn_and_fail_the_gate() {
    let folder = folder(&["cornell.glb"]);
    let (at, baked) = (folder.path(), folder.path().join("baked"));
    run(&[&["bake", "cornell.glb"], &GOOD[..4]], at).ended(0);
    let good = files(&baked);
    let literal: [&str; 8] = ["bake", "cornell.glb", "--rule", "literal", "--refresh", "0", "--verify", "32"];
    let gated = run(&[&literal, &GOOD[..4], &["--max-error", "90%"]], at).ended(1);
    println!("{}", gated.stderr);
    assert!(gated.stderr.contains("energy: ") && gated.stderr.contains("--directions"), "{}", gated.stderr);
    assert!(files(&baked) == good, "the last good lightmap stays byte for byte");
    let told = run(&[&literal, &GOOD[..4]], at).ended(0);
    assert!(told.stderr.contains("of the light is missing") || told.stderr.contains("is too much"), "{}", told.stderr);
    let report = report(at, "cornell");
    assert!(report["warnings"].as_array().unwrap().iter().any(|w| w["code"] == "energy"), "{report:#}");
    let others = report["checks"].as_array().unwrap().iter().filter(|check| check["name"] != "energy");
    assert!(check(&report, "energy")["passed"] == false && others.count() == 4, "{report:#}");
}

/// A floor within a solid block, which has no texels itself: of the light of what is shown nothing is known.
#[test]
fn where_no_texel_can_be_compared_the_gate_stays_shut() {
    let mut b = Builder::new("hidden");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("floor", Vec3::splat(0.5), Vec3::Z * 0.4, Vec3::X * 0.4, grey);
    b.cuboid("block", Vec3::ZERO, Vec3::splat(2.0), grey, false);
    let mut scene = b.build();
    scene.instances[1].receives = false;
    scene.sky = Sky::Constant(Vec3::ONE);
    let lit = support::bake(&scene, &rough());
    let ask = Verify { texels: 32, max_error: Some(0.5) };
    let found = verify_lit(&scene, &lit, &rough(), &ask, &Silent).unwrap();
    assert!(found.verification.nothing.is_none() && found.verification.texels == 0, "{found:?}");
    let refusal = found.judge(0.5).unwrap();
    assert!(refusal.to_string().contains("no texel can be compared"), "{refusal}");
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

/// Two closed boxes, the one at x < 1 with a lamp.
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
    assert!(good.passed && good.message.contains("and 256 more"), "{good:?}");
    // A share of the mean irradiance in the dark room: what is hardly seen, and what is seen.
    let mean = mean_irradiance(&lit);
    let atlas = lit.atlas.clone();
    let in_the_dark = |t: &&luxel_atlas::Texel| scene.instances[atlas.chart(t).instance as usize].name == "dark room";
    for (share, passes) in [(0.0015, true), (0.005, false)] {
        let map = &lit.lightmaps[0];
        let (width, height, mut light) = (map.width(), map.height(), map.irradiance().to_vec());
        for texel in atlas.texels.iter().filter(in_the_dark) {
            light[usize::from(texel.y) * width as usize + usize::from(texel.x)] = Vec3::splat(share * mean);
        }
        lit.lightmaps[0] = luxel_export::Lightmap::new(width, height, light, map.coverage().to_vec()).unwrap();
        let found = leaks(&lit);
        assert_eq!(found.passed, passes, "{share}: {found:?}");
        assert!(passes || found.value > 30.0 && found.message.contains("dark room"), "{found:?}");
    }
}

/// Two rooms with a hole of 16 cm in the thick wall between them, the one at x < 1 with a lamp. The other one has less than a
/// hundredth of its light, and hardly a path in a hundred finds it.
fn a_hole_in_a_wall() -> Scene {
    let mut b = Builder::new("a hole in a wall");
    let wall = b.matte(Vec3::splat(0.7));
    let lamp = b.emitter(Vec3::splat(0.7), Vec3::splat(50.0));
    b.cuboid("shell", Vec3::ZERO, Vec3::new(2.2, 1.2, 1.5), wall, true);
    for [lo, hi] in
        [[[0.0, 0.0], [0.6, 1.5]], [[0.76, 0.0], [1.2, 1.5]], [[0.6, 0.0], [0.76, 0.7]], [[0.6, 0.86], [0.76, 1.5]]]
    {
        b.cuboid("wall", Vec3::new(1.0, lo[0], lo[1]), Vec3::new(1.2, hi[0], hi[1]), wall, false);
    }
    b.cuboid("lamp", Vec3::new(0.4, 0.8, 0.6), Vec3::new(0.7, 0.9, 0.9), lamp, false);
    b.build()
}

#[test]
fn a_dim_room_that_few_paths_find_light_from_is_no_leak() {
    let (scene, settings) = (a_hole_in_a_wall(), quick());
    let lit = support::bake(&scene, &settings);
    let mean = mean_irradiance(&lit);
    let dim = support::valid_texels(&lit, |i| support::position(&scene, &lit, i).x > 1.3);
    let share = mean_of(&lit, &dim) / f64::from(mean);
    println!("the dim room holds {:.2} % of the mean irradiance", 100.0 * share);
    assert!((0.003..0.02).contains(&share), "{share}");
    let ask = Verify { texels: 64, max_error: Some(0.4) };
    let found = verify_lit(&scene, &lit, &settings, &ask, &Silent).unwrap();
    assert_eq!(found.verification.paths, 256);
    let leaks = found.checks.iter().find(|check| check.name == "leaks").unwrap();
    assert!(leaks.passed && leaks.message.contains("and 512 more"), "{leaks:?}");
}

/// The mean irradiance of what is shown.
fn mean_irradiance(lit: &luxel::Lit) -> f32 {
    let baked = sample::Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps };
    let shown: Vec<usize> = (0..lit.atlas.texels.len()).filter(|t| baked.is_shown(*t)).collect();
    mean_of(lit, &shown) as f32
}

/// The mean irradiance of some texels, by area.
fn mean_of(lit: &luxel::Lit, texels: &[usize]) -> f64 {
    let baked = sample::Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps };
    let area: f64 = texels.iter().map(|t| baked.area(*t)).sum();
    texels.iter().map(|t| baked.area(*t) * f64::from(baked.value(*t).element_sum()) / 3.0).sum::<f64>() / area
}

/// A slab of 2 m and 0.2 m with a block in it that reaches 0.1 m down and 0.4 m up, of `side` m: what lies inside, and all
/// surfaces there are [m²].
fn block_in_slab(side: f32) -> (Scene, f64, f64) {
    let mut b = Builder::new("block in slab");
    let grey = b.matte(Vec3::splat(0.5));
    b.cuboid("slab", Vec3::new(-1.0, -0.2, -1.0), Vec3::new(1.0, 0.0, 1.0), grey, false);
    let half = 0.5 * side;
    b.cuboid("block", Vec3::new(-half, -0.1, -half), Vec3::new(half, 0.4, half), grey, false);
    let mut scene = b.build();
    scene.sky = Sky::Constant(Vec3::ONE);
    let a = f64::from(side);
    (scene, 2.0 * a * a + 4.0 * a * 0.1, 9.6 + 2.0 * a * a + 4.0 * a * 0.5)
}

fn rough() -> Settings {
    Settings { size: Texels(128), voxels: Voxels::Budget(5_000), ..Settings::preset(Preset::Draft) }
}

fn buried(scene: &Scene) -> (luxel_export::report::Check, f64) {
    let lit = support::bake(scene, &rough());
    let footprint = lit.atlas.texels.iter().map(|t| f64::from(t.footprint())).fold(0.0, f64::max);
    let check = checks::buried(&sample::Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps });
    println!("{}: {check:?}, texels of {footprint}", scene.name);
    (check, footprint)
}

#[test]
fn what_lies_inside_geometry_is_measured_and_limited() {
    for (side, passes) in [(0.6, true), (0.8, false)] {
        let (scene, inside, all) = block_in_slab(side);
        let (check, footprint) = buried(&scene);
        // Texels on the line where the surfaces meet are lit by their free part: on the slab and on four faces.
        let line = 2.0 * 4.0 * f64::from(side) * footprint;
        assert!((check.value - inside / all).abs() < line / all, "{check:?}, not {}", inside / all);
        assert_eq!(check.passed, passes, "{check:?}");
        assert_eq!(check.message.contains("inside out"), !passes, "{check:?}");
    }
}

/// Of a room whose walls are turned inside out, what stands in it sees nothing but backs.
#[test]
fn a_room_that_is_turned_inside_out_is_noticed() {
    let mut scene = luxel_assets::cornell();
    assert!(buried(&scene).0.passed);
    let is_wall = |name: &str| !name.contains("block");
    for instance in scene.instances.iter().filter(|i| is_wall(&i.name)) {
        scene.meshes[instance.mesh].triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    scene.sky = Sky::Constant(Vec3::ONE);
    let (check, _) = buried(&scene);
    assert!(!check.passed, "{check:?}");
}

/// The limit leaves room for what stands on floors: no shipped scene comes near it.
#[test]
fn shipped_scenes_have_little_inside_geometry() {
    for scene in [luxel_assets::two_rooms(), luxel_assets::textured_room(), luxel_assets::colonnade()] {
        let (check, _) = buried(&scene);
        assert!(check.value < 0.75 * check.limit, "{}: {check:?}", scene.name);
    }
}

/// Two charts of one size in the atlas, the one moved onto the other by a share of its width.
#[test]
fn charts_that_lie_on_each_other_fail() {
    let mut b = Builder::new("two");
    let grey = b.matte(Vec3::splat(0.5));
    b.quad("one", Vec3::ZERO, Vec3::Z, Vec3::X, grey);
    b.quad("other", Vec3::X * 2.0, Vec3::Z, Vec3::X, grey);
    let mut scene = b.build();
    scene.sky = Sky::Constant(Vec3::ONE);
    let lit = support::bake(&scene, &rough());
    let check = |moved: Option<f32>| {
        let mut atlas = (*lit.atlas).clone();
        if let Some(share) = moved {
            let one = atlas.placed[0].clone().unwrap();
            let (lo, hi) = one.uvs.iter().fold((Vec2::MAX, Vec2::MIN), |(l, h), uv| (l.min(*uv), h.max(*uv)));
            let other = atlas.placed[1].as_mut().unwrap();
            (other.triangles, other.uvs, other.page) = (one.triangles, one.uvs, one.page);
            other.uvs.iter_mut().for_each(|uv| uv.x += (1.0 - share) * (hi.x - lo.x));
        }
        checks::uv_overlap(&scene, &sample::Baked { atlas: &atlas, lightmaps: &lit.lightmaps }, &Silent).unwrap()
    };
    assert!(check(None).passed && check(None).value == 0.0, "{:?}", check(None));
    // Of both charts' area half of that share lies on another one.
    let bad = check(Some(0.01));
    println!("{bad:?}");
    assert!(!bad.passed && (bad.value - 0.005).abs() < 2e-4, "{bad:?}");
    assert!(bad.message.contains("one") && bad.message.contains("other"), "{bad:?}");
    let good = check(Some(0.0016));
    assert!(good.value > 0.0 && (good.value - 0.0008).abs() < 1e-4 && good.passed, "{good:?}");
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
    // Intervals that hold everything say nothing.
    let width = |of: fn(&luxel::verify::Measure) -> luxel::verify::Interval| {
        found.iter().map(|m| of(m).high - of(m).low).sum::<f64>() / TRIALS as f64
    };
    let widths = [width(|m| m.rmse), width(|m| m.bias), width(|m| m.median), width(|m| m.p95)];
    println!("mean widths {widths:?}");
    assert!(widths.iter().zip([0.04, 0.02, 0.02, 0.15]).all(|(width, most)| *width < most), "{widths:?}");
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
