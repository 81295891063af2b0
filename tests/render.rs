//! `luxel render`: pictures as files, what is told of them, and what is refused.

mod tool;

use std::collections::BTreeMap;
use std::path::Path;

use exr::prelude::read_first_rgba_layer_from_file;
use glam::Vec3;
use luxel_export::ToneMap;
use serde_json::Value;
use tool::*;

/// Settings with which a picture of a shipped scene is taken in a moment.
const SMALL: [&str; 6] = ["--voxels", "3000", "--directions", "64", "--width", "48"];

fn render(args: &[&str], folder: &Path) -> Run {
    luxel(&[&["render"], args, &SMALL].concat(), folder)
}

fn events(run: &Run) -> Vec<Value> {
    run.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn event(run: &Run, name: &str) -> Value {
    events(run).into_iter().find(|e| e["event"] == name).unwrap_or_else(|| panic!("no {name}: {}", run.stdout))
}

/// Width and radiances of an .exr, whose A is 1 everywhere.
fn radiance(path: &Path) -> (usize, Vec<Vec3>) {
    let image = read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![Vec3::ZERO; size.area()]),
        |(width, pixels): &mut (usize, Vec<Vec3>), at, (r, g, b, a): (f32, f32, f32, f32)| {
            assert_eq!(a, 1.0);
            pixels[at.y() * *width + at.x()] = Vec3::new(r, g, b);
        },
    );
    image.unwrap().layer_data.channel_data.pixels
}

#[test]
fn a_picture_is_two_files_that_show_the_same() {
    let folder = folder(&["cornell.glb"]);
    let run = render(&["cornell.glb", "--exposure", "4", "--json"], folder.path()).ended(0);
    let baked = folder.path().join("baked");
    let names: Vec<String> = files(&baked).into_keys().collect();
    assert_eq!(names, ["cornell.render.exr", "cornell.render.png"], "nothing of a bake");

    let (width, pixels) = radiance(&baked.join("cornell.render.exr"));
    let png = image::open(baked.join("cornell.render.png")).unwrap().to_rgb8();
    let rendered = event(&run, "rendered");
    assert_eq!(
        (&rendered["method"], &rendered["draws"], &rendered["error"]),
        (&"lightcuts".into(), &Value::Null, &Value::Null)
    );
    assert_eq!((rendered["width"].as_u64(), rendered["height"].as_u64()), (Some(48), Some(png.height().into())));
    assert_eq!((width, width * png.height() as usize), (48, pixels.len()));
    assert!((rendered["exposure"].as_f64().unwrap() - 4.0).abs() < 1e-6);
    let tone = ToneMap { exposure: 1.0 / (1.2 * 16.0), white: 4.0 };
    for (shown, pixel) in png.pixels().zip(&pixels) {
        assert_eq!(shown.0, tone.encode(*pixel));
    }
    let mean = pixels.iter().sum::<Vec3>() / pixels.len() as f32;
    assert!(mean.min_element() > 0.0 && pixels.iter().all(|p| p.is_finite() && p.min_element() >= 0.0), "{mean}");
    assert!(rendered["rays"].as_u64().unwrap() > 0 && rendered["points"].as_u64().unwrap() > 48 * 40);
    assert_eq!(events(&run).last().unwrap()["event"], "done");

    // What the first one left in the store is not made again, and makes the same picture.
    let before = files(&baked);
    let again = render(&["cornell.glb", "--exposure", "4", "--json", "--threads", "1"], folder.path()).ended(0);
    assert!(files(&baked) == before, "another number of threads");
    assert!(!again.stdout.contains("\"propagate\""), "{}", again.stdout);
}

#[test]
fn the_lightmap_of_a_bake_is_shown_without_another_bake() {
    let folder = folder(&["cornell.glb"]);
    let bake = ["--size", "64", "--voxels", "3000", "--directions", "64"];
    luxel(&[&["bake", "cornell.glb"], &bake[..]].concat(), folder.path()).ended(0);
    let before = files(&folder.path().join("baked"));
    let to = ["--method", "lightmap", "--to", "pictures/lit.png", "--width", "60", "--aa", "4", "--json"];
    let run = luxel(&[&["render", "cornell.glb"], &bake[..], &to].concat(), folder.path()).ended(0);
    assert!(!run.stdout.contains("\"gather\"") && !run.stdout.contains("\"propagate\""), "{}", run.stdout);
    assert!(files(&folder.path().join("baked")) == before);
    let pictures: Vec<String> = files(&folder.path().join("pictures")).into_keys().collect();
    assert_eq!(pictures, ["lit.exr", "lit.png"]);
}

/// All methods see the same picture within the noise that the reference states: its pixels' errors are independent, so the
/// mean over all of them is known better by the root of their number.
///
/// That holds whatever samples a pixel has. With `--aa 4` they are the same in all pictures. By default methods have 16
/// where they find edges, not all at the same pixels. Four instead of 16 at all of them are 8 % (RMS) of what this picture
/// reflects in the mean; methods disagree about few, so less than a third of that may come on top. More samples also are
/// more points that err each on its own, which leaves no less than four fifths.
#[test]
fn methods_side_by_side_agree_within_the_noise_of_the_reference() {
    let [four, usual] = [&["--aa", "4"][..], &[]].map(side_by_side);
    for (name, few, many) in four.iter().zip(&usual).map(|(a, b)| (a.0, a.1, b.1)) {
        println!("{name}: RMSE {few} of 4 samples, {many} by default");
        assert!(many > 0.8 * few && many < few.hypot(0.025), "{name}: {few} {many}");
    }
}

/// RMSE of methods that are not the reference, after a look at all that the comparison says.
fn side_by_side(samples: &[&str]) -> [(&'static str, f64); 3] {
    let folder = folder(&["cornell.glb"]);
    let compare = ["--compare", "lookup,lightcuts,photons,paths", "--paths", "64", "--map-photons", "20000"];
    let run = render(&[&["cornell.glb", "--json"], samples, &compare[..]].concat(), folder.path()).ended(0);
    let baked = folder.path().join("baked");
    assert_eq!(files(&baked).into_keys().collect::<Vec<_>>(), ["cornell.compare.png"]);
    assert!(!baked.join(".luxel").exists(), "a comparison takes nothing from a store and leaves nothing there");
    let compared = event(&run, "compared");
    let methods = compared["methods"].as_array().unwrap();
    let of = |name: &str| methods.iter().find(|m| m["method"] == name).unwrap();
    for method in methods {
        assert!(method["rays"].as_u64().unwrap() > 0, "{method}");
    }
    let number = |name: &str, field: &str| of(name)[field].as_f64().unwrap();
    assert_eq!((compared["against"].as_str(), of("paths")["draws"].as_u64()), (Some("paths"), Some(64)));
    assert_eq!((number("paths", "rmse"), number("paths", "bias")), (0.0, 0.0));
    let noise = number("paths", "error");
    let pixels = (compared["width"].as_f64().unwrap() * compared["height"].as_f64().unwrap()).sqrt();
    let sheet = image::open(baked.join("cornell.compare.png")).unwrap();
    assert!(sheet.width() > 4 * 48 && sheet.height() > 2 * 40);
    ["lookup", "lightcuts", "photons"].map(|name| {
        assert_eq!((of(name)["draws"].is_null(), &of(name)["error"]), (name != "photons", &Value::Null));
        let (rmse, bias) = (number(name, "rmse"), number(name, "bias"));
        println!("{name}: RMSE {rmse}, bias {bias}, noise {noise}");
        // Stated is the error of the mean of three bands; over single bands it is as large at least, and √3 times at most.
        // 3000 voxels add what they leave: 1 % of bias, 5 % about it.
        assert!(rmse > 0.9 * noise && rmse < (3.0f64.sqrt() * noise).hypot(0.05), "{name}: {rmse}, noise {noise}");
        assert!(bias.abs() < 4.0 * noise / pixels + 0.01, "{name}: {bias}, noise {noise}");
        (name, rmse)
    })
}

/// The error that a picture by paths states is that of the mean of a pixel's bands, which nothing but chance moves away
/// from what lightcuts find there.
#[test]
fn the_stated_error_of_paths_is_how_far_they_are_from_the_light() {
    let folder = folder(&["cornell.glb"]);
    let picture = |name: &str, args: &[&str]| {
        let to = format!("{name}.png");
        let run = render(&[&["cornell.glb", "--aa", "4", "--json", "--to", &to], args].concat(), folder.path());
        let (_, pixels) = radiance(&folder.path().join(format!("{name}.exr")));
        (event(&run.ended(0), "rendered")["error"].as_f64(), pixels)
    };
    let (none, light) = picture("light", &["--method", "lightcuts"]);
    assert_eq!(none, None);
    let off = |pixels: &[Vec3]| {
        let mean = |p: &Vec3| f64::from(p.element_sum()) / 3.0;
        let square = pixels.iter().zip(&light).map(|(a, b)| (mean(a) - mean(b)).powi(2)).sum::<f64>();
        (square / light.len() as f64).sqrt()
    };
    let [few, many] = ["16", "144"].map(|paths| {
        let (error, pixels) = picture(paths, &["--method", "paths", "--paths", paths]);
        (error.unwrap(), off(&pixels))
    });
    println!("16 paths: stated {}, found {}; 144: {} {}", few.0, few.1, many.0, many.1);
    // A stated error is a share of the mean reflected light, which is the same for both.
    let ratio = (few.1 / few.0) / (many.1 / many.0);
    assert!((few.0 / many.0 - 3.0).abs() < 0.5 && (ratio - 1.0).abs() < 0.15, "{few:?} {many:?}");
    let reflected = mean_reflected(folder.path());
    // Samples of a pixel on other surfaces have errors of their own, which the stated one adds up.
    for (error, found) in [few, many] {
        let share = found / reflected / error;
        assert!((0.75..1.1).contains(&share), "{share}");
    }
}

/// What surfaces reflect in the mean [cd/m²], as a comparison tells it.
fn mean_reflected(folder: &Path) -> f64 {
    let compare = ["cornell.glb", "--aa", "4", "--json", "--compare", "paths,lookup", "--paths", "2"];
    event(&render(&compare, folder).ended(0), "compared")["reflected"].as_f64().unwrap()
}

#[test]
fn a_progressive_picture_is_written_at_every_pass() {
    let folder = folder(&["cornell.glb"]);
    let args = ["cornell.glb", "--method", "paths", "--paths", "20", "--progressive", "--json"];
    let run = render(&args, folder.path()).ended(0);
    let passes: Vec<(u64, f64)> = events(&run)
        .iter()
        .filter(|e| e["event"] == "pass")
        .map(|e| (e["draws"].as_u64().unwrap(), e["error"].as_f64().unwrap()))
        .collect();
    assert_eq!(passes.iter().map(|p| p.0).collect::<Vec<_>>(), [4, 8, 16, 20]);
    assert!(passes[3].1 < passes[0].1, "{passes:?}");
    assert_eq!(event(&run, "rendered")["draws"], 20);
    let (_, first) = radiance(&folder.path().join("baked/cornell.render.exr"));
    render(&args, folder.path()).ended(0);
    assert!(radiance(&folder.path().join("baked/cornell.render.exr")).1 == first);
    // Time alone ends it, too.
    let timed = ["cornell.glb", "--method", "paths", "--time", "0.5", "--to", "timed.png"];
    let said = render(&timed, folder.path()).ended(0).stderr;
    assert!(said.contains("pass 1: 4 paths, noise") && said.contains("timed.png"), "{said}");
}

/// The picture of a few seconds that keeps improving: unasked, and by the error that its two sets of voxels show.
#[test]
fn sample_voxels_write_their_picture_pass_by_pass() {
    let folder = folder(&["cornell.glb"]);
    let run = render(&["cornell.glb", "--method", "samples", "--json"], folder.path()).ended(0);
    let passes: Vec<Value> = events(&run).into_iter().filter(|e| e["event"] == "pass").collect();
    let number = |field: &str| passes.iter().map(|e| e[field].as_f64().unwrap()).collect::<Vec<_>>();
    assert_eq!((number("draws"), number("pass")), (vec![1.0, 2.0, 4.0, 8.0], vec![0.0, 1.0, 2.0, 3.0]));
    // Of independent passes it falls with their root, to 0.35; points of a sequence leave less.
    let errors = number("error");
    println!("{errors:?}");
    assert!(errors.is_sorted_by(|a, b| a > b) && errors[3] < 0.5 * errors[0], "{errors:?}");
    let baked = folder.path().join("baked");
    assert!(passes.iter().all(|e| e["outputs"] == event(&run, "rendered")["outputs"]));
    let (names, rendered) = (["cornell.render.exr", "cornell.render.png"], event(&run, "rendered"));
    assert_eq!(files(&baked).into_keys().collect::<Vec<_>>(), names);
    assert_eq!((&rendered["method"], &rendered["draws"]), (&"samples".into(), &8.into()));
    // One pass alone is the first of the eight, and is written.
    let one = ["cornell.glb", "--method", "samples", "--samples", "1", "--to", "one.png", "--json"];
    let run = render(&one, folder.path()).ended(0);
    assert_eq!(event(&run, "pass")["error"].as_f64(), Some(errors[0]));
    assert!(radiance(&folder.path().join("one.exr")).1 != radiance(&baked.join(names[0])).1);
}

#[test]
fn what_cannot_be_pictured_is_told_before_anything_is_done() {
    let folder = folder(&["cornell.glb", "two_rooms.glb"]);
    for (args, expected) in [
        (vec!["--method", "cuts"], "there is no method"),
        (vec!["--eye", "0,0,0", "--target", "0,0,0"], "look somewhere"),
        (vec!["--eye", "0,0,nan", "--target", "0,0,0"], "three numbers"),
        (vec!["--eye", "0,0,1", "--target", "0,0,0", "--fov", "180"], "from 0.1 to 177"),
        (vec!["--eye", "0,0,1", "--target", "0,0,0", "--fov", "0"], "from 0.1 to 177"),
        (vec!["--eye", "0,0,1", "--target", "0,0,0", "--fov", "nan"], "from 0.1 to 177"),
        (vec!["--height", "0"], "--height"),
        (vec!["--height", "1000000"], "--height"),
        (vec!["--aa", "0"], "1 to 256"),
        (vec!["--time", "3"], "for the methods paths and samples"),
        (vec!["--compare", "paths,paths"], "compared to itself"),
        (vec!["--paths", "9"], "--paths is for the method paths"),
        (vec!["--method", "paths", "--samples", "9"], "--samples is for the method samples"),
        (vec!["--compare", "paths,lookup", "--map-photons", "9"], "--map-photons is for the method photons"),
        (vec!["--method", "paths", "--paths", "1"], "--paths has to be 2 at least"),
        (vec!["two_rooms.glb", "--to", "one.png"], "--to names one picture"),
        (vec!["--only", "direct"], "--method lightmap"),
        (vec!["--only", "indirect", "--compare", "lightmap,lightcuts"], "--only all"),
    ] {
        let run = luxel(&[vec!["render", "cornell.glb"], args.clone()].concat(), folder.path()).ended(2);
        assert!(run.stderr.contains(expected), "{args:?}: {}", run.stderr);
    }
    let big = ["render", "cornell.glb", "--width", "16000", "--height", "16000", "--json"];
    assert!(event(&luxel(&big, folder.path()).ended(2), "usage")["error"].as_str().unwrap().contains("too large"));
    // What only the scene can tell fails the scene.
    let run = render(&["cornell.glb", "--camera", "roof"], folder.path()).ended(1);
    assert!(run.stderr.contains("there is no camera \"roof\""), "{}", run.stderr);
    assert_eq!(files(folder.path()).into_keys().collect::<Vec<_>>(), ["cornell.glb", "two_rooms.glb"]);
}

/// Settings may come from a file, too, which bakes have reasons for.
#[test]
fn light_is_left_out_of_pictures_of_lightmaps_alone() {
    let folder = folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("luxel.toml"), "only = \"direct\"\nsize = 64\n").unwrap();
    let run = render(&["cornell.glb"], folder.path()).ended(1);
    assert!(run.stderr.contains("--method lightmap"), "{}", run.stderr);
    render(&["cornell.glb", "--method", "lightmap"], folder.path()).ended(0);
    render(&["cornell.glb", "--method", "lookup", "--only", "all"], folder.path()).ended(0);
}

#[test]
fn a_picture_replaces_nothing_that_its_scene_is_made_from() {
    let folder = folder(&["cornell.glb"]);
    let at = |name: &str| folder.path().join(name);
    render(&["cornell.glb", "--method", "voxels", "--to", "noon.png"], folder.path()).ended(0);
    let (sky, before) = (at("noon.exr"), files(folder.path()));
    for to in ["noon.png", "./baked/../noon.png"] {
        let args = ["cornell.glb", "--method", "voxels", "--sky", sky.to_str().unwrap(), "--to", to];
        let run = render(&args, folder.path()).ended(1);
        assert!(run.stderr.contains("noon.exr") && run.stderr.contains("--to"), "{}", run.stderr);
    }
    assert!(files(folder.path()) == before);
    // Beside them there is room, and a comparison writes no .exr.
    let lit = ["cornell.glb", "--sky", "noon.exr"];
    render(&[&lit[..], &["--method", "voxels", "--to", "dusk.png"]].concat(), folder.path()).ended(0);
    render(&[&lit[..], &["--compare", "voxels,lookup", "--to", "noon.png"]].concat(), folder.path()).ended(0);
}

/// What a method needs is refused before any work where it cannot fit; what another one needs is no reason.
#[test]
fn a_picture_that_does_not_fit_into_memory_is_refused() {
    let folder = folder(&["cornell.glb"]);
    let take = |args: &[&str]| luxel(&[&["render", "cornell.glb", "--width", "8"], args].concat(), folder.path());
    for (args, part, remedy) in [
        (vec!["--voxels", "edge:1e-9"], "the surfels", "--voxels"),
        (vec!["--voxels", "edge:1e-9", "--compare", "paths,lookup"], "the surfels", "--voxels"),
        (vec!["--method", "photons", "--map-photons", "4000000000"], "the photons", "--map-photons"),
    ] {
        let run = take(&[&args[..], &["--json"]].concat()).ended(1);
        let said = event(&run, "failed")["error"].to_string();
        assert!(said.contains("MiB") && said.contains(part) && said.contains(remedy), "{args:?}: {said}");
        let started: Vec<Value> = events(&run).into_iter().filter(|e| e["event"] == "started").collect();
        assert!(started.iter().all(|e| e["stage"] == "import"), "{started:?}");
    }
    assert_eq!(files(folder.path()).into_keys().collect::<Vec<_>>(), ["cornell.glb"]);
    take(&["--voxels", "edge:1e-9", "--method", "paths", "--paths", "2"]).ended(0);
}

#[test]
fn scenes_with_nothing_in_them_are_pictures_of_nothing() {
    let folder = folder(&[]);
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("empty.gltf", r#"{"asset":{"version":"2.0"}}"#);
    let run = render(&["empty.gltf", "--json"], folder.path()).ended(0);
    assert!(event(&run, "rendered")["outputs"].as_array().unwrap().len() == 2);
    let (_, pixels) = radiance(&folder.path().join("baked/empty.render.exr"));
    assert!(pixels.iter().all(|p| *p == Vec3::ZERO));
    // Under a sky, it is what is seen.
    render(&["empty.gltf", "--sky", "1,2,3", "--method", "paths", "--paths", "4"], folder.path()).ended(0);
    let (_, pixels) = radiance(&folder.path().join("baked/empty.render.exr"));
    assert!(pixels.iter().all(|p| *p == Vec3::new(1.0, 2.0, 3.0)));
}

/// Shares of no light are not 0, and not no number either.
#[test]
fn a_comparison_to_darkness_states_no_difference() {
    let folder = folder(&[]);
    std::fs::write(folder.path().join("empty.gltf"), r#"{"asset":{"version":"2.0"}}"#).unwrap();
    let run = render(&["empty.gltf", "--compare", "voxels,paths", "--json"], folder.path()).ended(0);
    let compared = event(&run, "compared");
    for method in compared["methods"].as_array().unwrap() {
        for field in ["rmse", "bias", "p95", "error"] {
            assert_eq!(method.get(field), Some(&Value::Null), "{field}: {method}");
        }
    }
}

#[test]
fn folders_are_searched_and_a_scene_that_fails_stops_no_other() {
    let folder = folder(&["cornell.glb"]);
    std::fs::write(folder.path().join("broken.glb"), b"glTF but not for long").unwrap();
    let run = render(&[".", "--method", "lookup", "--out", "pictures", "--aa", "off"], folder.path()).ended(1);
    assert!(run.stderr.contains("broken.glb") && run.stderr.contains("1 of 2 scenes failed"), "{}", run.stderr);
    let pictures: Vec<String> = files(&folder.path().join("pictures")).into_keys().collect();
    assert_eq!(pictures, ["cornell.render.exr", "cornell.render.png"]);
}

#[test]
fn every_event_and_field_is_in_the_help() {
    let folder = folder(&["cornell.glb"]);
    let help = luxel(&["render", "--help"], folder.path()).ended(0).stdout;
    let mut seen: BTreeMap<String, Value> = BTreeMap::new();
    let short = ["--method", "paths", "--paths", "4", "--progressive", "--json", "--height", "12"];
    for args in [&short[..], &["--compare", "paths,lookup", "--paths", "2", "--json", "--height", "12"]] {
        let run = render(&[&["cornell.glb"], args].concat(), folder.path()).ended(0);
        seen.extend(events(&run).into_iter().map(|e| (e["event"].as_str().unwrap().to_owned(), e)));
    }
    assert!(["pass", "rendered", "compared", "done"].iter().all(|name| seen.contains_key(*name)));
    let listed = help.split("Events of --json").nth(1).unwrap();
    for (name, event) in seen {
        assert!(listed.contains(&name), "{name}");
        let fields = event
            .as_object()
            .unwrap()
            .keys()
            .filter(|key| !["event", "stage", "total", "done"].contains(&key.as_str()));
        for field in fields {
            assert!(listed.contains(field.as_str()), "{name}: {field}");
        }
    }
}
