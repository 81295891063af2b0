//! `luxel report` through the binary: what it writes, that it goes on where it stopped, and that the settings which it
//! finds for an error keep it.

mod tool;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;
use tool::{Outputs, Run, files, folder, luxel};

/// A bake that takes seconds.
const BAKE: [&str; 8] = ["--preset", "draft", "--gather", "lightcuts", "--size", "32", "--voxels", "2000"];

/// What makes a report quick.
const REPORT: [&str; 6] = ["--texels", "60", "--noise", "5%", "--paths", "2048"];

fn quick(args: &[&str], folder: &TempDir) -> Run {
    luxel(&[args, &BAKE, &REPORT].concat(), folder.path())
}

/// Settings are looked for from those of the scene alone.
const PLAIN: [&str; 2] = ["--size", "128"];

fn events(run: &Run, name: &str) -> Vec<Value> {
    let all = run.stdout.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    all.filter(|event| event["event"] == name).collect()
}

/// The rows of a table, by the names of its columns.
fn rows(path: &Path) -> Vec<BTreeMap<String, String>> {
    let mut table = csv::ReaderBuilder::new().comment(Some(b'#')).from_path(path).unwrap();
    table.deserialize().collect::<Result<_, _>>().unwrap()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column}: {:?}", row[column]))
}

#[test]
fn a_report_has_a_table_plots_and_advice_and_is_measured_once() {
    let folder = folder(&["cornell.glb"]);
    let args = ["report", "cornell.glb", "--json", "--sweep", "directions", "--no-together"];
    let first = quick(&args, &folder).ended(0);
    let points = events(&first, "point");
    let [report] = &events(&first, "report")[..] else { panic!("{}", first.stdout) };
    let place = folder.path().join("report");
    let written: Vec<String> = files(&place).into_keys().filter(|name| !name.starts_with(".luxel")).collect();
    let endings = ["front.svg", "maps.png", "report.csv", "report.json", "report.md", "sweeps.svg"];
    assert_eq!(written, endings.map(|ending| format!("cornell.{ending}")));

    let table = rows(&place.join("cornell.report.csv"));
    assert_eq!(table.len(), points.len());
    for row in &table {
        assert!(number(row, "cpu_seconds") > 0.0 && number(row, "mean_lux") > 0.0, "{row:?}");
        assert!(
            number(row, "rmse_low") < number(row, "rmse") && number(row, "rmse") < number(row, "rmse_high"),
            "{row:?}"
        );
    }
    let of = |series: &str| table.iter().filter(|r| r["series"] == series).collect::<Vec<_>>();
    let paths = of("path tracing");
    let [few, many] = [paths[0], paths[paths.len() - 1]].map(|row| number(row, "rmse"));
    assert!(few > 2.0 * many, "path tracing: {few} and {many}");
    let directions = of("directions");
    let rays: Vec<f64> = directions.iter().map(|row| number(row, "discrete_rays")).collect();
    assert!(rays.windows(2).all(|w| w[0] < w[1]), "{rays:?}");

    let findings = &report["findings"];
    let text = std::fs::read_to_string(place.join("cornell.report.md")).unwrap();
    for part in ["What limits the error", findings["verdict"].as_str().unwrap(), "Machine: ", "luxel report"] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    has_table1(findings["table1"].as_array().unwrap(), &text);

    // Every path is a ray at least, and every photon.
    for row in &paths {
        assert!(number(row, "continuous_rays") >= number(row, "texels") * number(row, "x"), "{row:?}");
    }
    for row in of("photon map") {
        assert!(number(row, "continuous_rays") >= number(row, "x"), "{row:?}");
    }

    // Nothing is measured twice: the same files, times included, and no stage finds light.
    let written = || -> BTreeMap<String, Vec<u8>> {
        files(&place).into_iter().filter(|(name, _)| !name.starts_with(".luxel")).collect()
    };
    let (before, started) = (written(), stages(&first));
    assert!(LIGHT.iter().all(|stage| started.contains(*stage)), "{started:?}");
    let again = quick(&args, &folder).ended(0);
    assert!(before == written());
    let started = stages(&again);
    assert!(LIGHT.iter().all(|stage| !started.contains(*stage)), "{started:?}");

    // What an interrupted report has not come to, it alone makes.
    for (kind, makes) in [("map", &LIGHT[1..]), ("figures", &LIGHT[1..]), ("reference", &LIGHT[..1])] {
        let folder_of_kind = place.join(".luxel").join(kind);
        let kept = files(&folder_of_kind);
        std::fs::remove_dir_all(&folder_of_kind).unwrap();
        let started = stages(&quick(&args, &folder).ended(0));
        assert!(LIGHT.iter().all(|stage| started.contains(*stage) == makes.contains(stage)), "{kind}: {started:?}");
        // Of the bakes that are measured as points too, the figures are not missed.
        let made = files(&folder_of_kind);
        assert!(!made.is_empty() && made.keys().all(|name| kept.contains_key(name)), "{kind}");
    }
}

/// Stages that find light at texels: the reference, and those of a bake.
const LIGHT: [&str; 5] = ["reference", "voxelize", "propagate", "direct", "gather"];

/// The stages that a run told of.
fn stages(run: &Run) -> BTreeSet<String> {
    events(run, "started").iter().filter_map(|event| event["stage"].as_str().map(String::from)).collect()
}

/// Ctrl-C loses the point at work; the next run takes what was measured, times and all, and goes on from there.
#[cfg(unix)]
#[test]
fn an_interrupted_report_goes_on_where_it_stopped() {
    use std::io::{BufRead, BufReader};
    let folder = folder(&["cornell.glb"]);
    let rest = ["--json", "--sweep", "directions", "--methods", "none", "--no-together", "--no-table", "--no-maps"];
    let args = [&["report", "cornell.glb"], &rest[..], &BAKE, &REPORT].concat();
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(&args)
        .current_dir(folder.path())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
    let (mut points, mut last) = (Vec::new(), Value::Null);
    for line in lines {
        last = serde_json::from_str(&line).unwrap();
        if last["event"] == "point" {
            points.push(last["point"].clone());
            if points.len() == 3 {
                let id = child.id().to_string();
                assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
            }
        }
    }
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(last["event"], "interrupted");
    let resumed = luxel(&args, folder.path()).ended(0);
    let all: Vec<Value> = events(&resumed, "point").iter().map(|event| event["point"].clone()).collect();
    assert!(points.len() >= 3 && all.len() == 8, "{} of {}", points.len(), all.len());
    assert_eq!(all[..points.len()], points[..]);
    assert!(!stages(&resumed).contains("reference"));
}

/// What cannot fit is refused before any of it is measured.
#[cfg(target_os = "linux")]
#[test]
fn a_report_that_does_not_fit_into_memory_is_refused() {
    let folder = folder(&["cornell.glb"]);
    let command = "ulimit -v 600000; exec \"$0\" report cornell.glb --preset draft --size 16384 --voxels 1000 --json";
    let mut shell = std::process::Command::new("sh");
    let output = shell.args(["-c", command, env!("CARGO_BIN_EXE_luxel")]).current_dir(folder.path()).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.code() == Some(1) && said.contains("the texels") && said.contains("--size"), "{said}");
    let started = said.lines().filter(|line| line.contains("\"started\""));
    assert!(started.into_iter().all(|line| line.contains("\"import\"")), "{said}");
    assert_eq!(files(folder.path()).into_keys().collect::<Vec<_>>(), ["cornell.glb"]);
}

/// Table 1: the two columns of the paper as they are printed there, and two of luxel's own whose ratios follow from their
/// counts and times; the text shows the same figures.
fn has_table1(columns: &[Value], text: &str) {
    let figure =
        |column: &Value, name: &str| column["figures"][name].as_f64().unwrap_or_else(|| panic!("{name}: {column}"));
    let row = |name: &str| -> Vec<String> {
        let line = text.lines().find(|line| line.split('|').nth(1).is_some_and(|cell| cell.trim() == name));
        let cells = line.unwrap_or_else(|| panic!("no row {name}: {text}")).split('|').skip(2);
        let mut cells: Vec<String> = cells.map(|cell| cell.trim().to_owned()).collect();
        cells.pop();
        cells
    };
    let printed = [(108_455.0, 87_913_202.0, 26_637_785.0, 5.2), (22_615.0, 184_834_570.0, 10_146_637.0, 1.96)];
    for (column, (voxels, continuous, discrete, seconds)) in columns.iter().zip(printed) {
        let found = ["voxels", "continuous_rays", "discrete_rays", "linear_method_seconds"].map(|f| figure(column, f));
        assert_eq!(found, [voxels, continuous, discrete, seconds], "{column}");
    }
    let ratio = |column: &Value| {
        let discrete = figure(column, "discrete_rays_per_second");
        let own = figure(column, "discrete_rays") / figure(column, "linear_method_seconds");
        assert!((discrete / own - 1.0).abs() < 0.01, "{column}");
        discrete / figure(column, "continuous_rays_per_second")
    };
    let ratios: Vec<String> = columns.iter().map(|column| format!("{:.2} %", 100.0 / ratio(column))).collect();
    assert_eq!(ratios[..2], ["2.75 %", "1.33 %"]);
    assert_eq!(row("continuous/discrete"), ratios);
    // The scene is the report's own, by the paper's settings and by those that were asked for.
    for column in &columns[2..] {
        assert_eq!(figure(column, "triangles"), 46.0, "{column}");
    }
    let voxels: Vec<f64> = columns[2..].iter().map(|column| figure(column, "voxels")).collect();
    assert!((voxels[0] / 108_455.0 - 1.0).abs() < 0.05 && (voxels[1] / 2000.0 - 1.0).abs() < 0.1, "{voxels:?}");
    assert_eq!(row("number of voxels"), columns.iter().map(|c| c["figures"]["voxels"].to_string()).collect::<Vec<_>>());
}

/// Nothing between the light at surfels and at texels hides where the error comes from: few voxels with many directions
/// are limited by voxels, and many with few by directions.
#[test]
fn what_limits_the_error_is_what_is_scarce() {
    let folder = folder(&["cornell.glb"]);
    let plain = ["--preset", "draft", "--gather", "lookup", "--refresh", "0", "--size", "32"];
    let order = ["--texels", "100", "--noise", "2%", "--paths", "2048", "--json", "--sweep", "voxels,directions"];
    let alone = ["--methods", "none", "--no-together", "--no-table", "--no-maps"];
    for (voxels, directions, scarce, about) in [
        ("2000", "1024", "voxels", "voxel size dominates"),
        ("12500", "8", "directions", "directions of the first bounce dominates"),
    ] {
        let own = ["--voxels", voxels, "--directions", directions];
        let run =
            luxel(&[&["report", "cornell.glb"], &plain[..], &order, &alone, &own].concat(), folder.path()).ended(0);
        let [report] = &events(&run, "report")[..] else { panic!("{}", run.stdout) };
        let findings = &report["findings"];
        println!("{}: {:#}", findings["verdict"], findings["advice"]);
        let first = &findings["advice"][0];
        assert!(first["setting"] == scarce && first["share"].as_f64().unwrap() > 0.8, "{findings}");
        assert!(findings["verdict"].as_str().unwrap().starts_with(about), "{findings}");
        let [now, doubled] = ["now", "doubled"].map(|field| first[field].as_f64().unwrap());
        assert!(doubled < 0.75 * now, "{findings}");
    }
}

#[test]
fn settings_for_an_error_keep_it() {
    let folder = folder(&["cornell.glb"]);
    let run = |args: &[&str]| luxel(&[args, &PLAIN].concat(), folder.path());
    let found = run(&["report", "cornell.glb", "--target-error", "1.2%", "--json"]).ended(0);
    let [target] = &events(&found, "target")[..] else { panic!("{}", found.stdout) };
    assert!(target["reached"] == true && target["rmse_most"].as_f64().unwrap() <= 0.012, "{target}");
    // The roughest settings do not do.
    assert!(target["rung"].as_u64().unwrap() > 0, "{target}");
    let flags: Vec<&str> = target["flags"].as_str().unwrap().split(' ').collect();
    let voxels = flags[flags.iter().position(|flag| *flag == "--voxels").unwrap() + 1];

    // A bake finds the same settings, says so, keeps the error, and finds them again without trials.
    let bake = ["bake", "cornell.glb", "--target-error", "1.2%", "--store", "report/.luxel"];
    let stale = run(&["bake", "cornell.glb", "--target-error", "3%", "--store", "report/.luxel", "--check"]).ended(3);
    assert!(stale.stderr.contains("not known yet"), "{}", stale.stderr);
    run(&[&bake[..], &["--max-error", "1.5%"]].concat()).ended(0);
    let baked = Outputs::read(&folder.path().join("baked"), "cornell");
    let settings = baked.report["settings"].as_array().unwrap();
    let chosen = settings.iter().find(|s| s["name"] == "voxels").unwrap();
    assert_eq!((chosen["value"].to_string().as_str(), &chosen["origin"]), (voxels, &"target error 1.2 %".into()));
    let again = run(&[&bake[..], &["--check"]].concat()).ended(0);
    assert!(again.stderr.contains("unchanged"), "{}", again.stderr);

    // What is chosen by name stays.
    let kept = run(&["report", "cornell.glb", "--target-error", "4%", "--json", "--directions", "300"]).ended(0);
    assert!(!kept.stdout.contains("--directions"), "{}", kept.stdout);

    let missed = run(&["report", "cornell.glb", "--target-error", "0.01%"]).ended(1);
    assert!(missed.stderr.contains("cannot be promised"), "{}", missed.stderr);
    // A time is kept by rungs that are quick enough; the highest takes longer than this anywhere.
    let timed = run(&["report", "cornell.glb", "--target-time", "5s", "--json"]).ended(0);
    let [target] = &events(&timed, "target")[..] else { panic!("{}", timed.stdout) };
    assert!(target["reached"] == true && target["seconds"].as_f64().unwrap() <= 5.0, "{target}");
    assert!(target["rung"].as_u64().unwrap() < 7 && target["flags"].as_str().unwrap().contains("--voxels"), "{target}");
    let missed = run(&["report", "cornell.glb", "--target-time", "0s"]).ended(1);
    assert!(missed.stderr.contains("roughest settings"), "{}", missed.stderr);
}

#[test]
fn what_cannot_be_swept_is_wrong_usage() {
    let folder = folder(&["cornell.glb"]);
    let run = quick(&["report", "cornell.glb", "--sweep", "colour"], &folder).ended(2);
    assert!(run.stderr.contains("colour") && run.stderr.contains("voxels"), "{}", run.stderr);
    let run = quick(&["report", "cornell.glb", "--methods", "radiosity"], &folder).ended(2);
    assert!(run.stderr.contains("radiosity") && run.stderr.contains("photons"), "{}", run.stderr);
    for wrong in [
        &["--target-error", "0"][..],
        &["--noise", "0"],
        &["--target-time", "soon"],
        &["--target-time", "5s", "--fresh"],
    ] {
        luxel(&[&["report", "cornell.glb"], wrong].concat(), folder.path()).ended(2);
    }
}
