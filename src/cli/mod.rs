//! The command line: reads it, does what it says scene by scene, tells what happened, and ends with the exit code of the contract.

mod amount;
mod args;
mod cache;
mod export;
mod fleet;
mod help;
mod print;
mod progress;
mod render;
mod report;
mod watch;

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Parser;
use luxel::Error;
use luxel::current::{self, State};
use luxel::discover::{self, Found, Search};
use luxel::settings::{Layer, for_scene};
use luxel::text::shown;
use luxel_export::{ExportError, OutputSet};
use serde_json::json;

use args::{Bake, Baking, Cli, Common, Export, Render, Report, Task, Watch};
use progress::{Reporter, Screen, Style, event, say};

const DONE: u8 = 0;
const SOME_FAILED: u8 = 1;
const USAGE: u8 = 2;
/// `--check` has found outputs that are not current.
const STALE: u8 = 3;
const INTERRUPTED: u8 = 130;

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version are no errors, and go their own way.
        Err(error) => {
            if error.use_stderr() && std::env::args_os().any(|arg| arg == "--json") {
                print::misused(&anyhow::anyhow!(error.to_string().trim_end().to_owned()));
            }
            error.exit()
        }
    };
    let json = match &cli.task {
        Task::Bake(Baking { bake: args, .. })
        | Task::Plan(args)
        | Task::Watch(Watch { bake: args, .. })
        | Task::Export(Export { bake: args, .. })
        | Task::Report(Report { bake: args, .. })
        | Task::Render(Render { bake: args, .. }) => args.common.json,
        Task::Cache(args) => args.places().json,
        Task::Defaults | Task::UnwrapWorker => false,
    };
    let code = match cli.task {
        Task::Bake(args) => fleet::bake(&args),
        Task::Plan(args) => plan(&args),
        Task::Watch(args) => watch::watch(&args),
        Task::Export(args) => export::export(&args),
        Task::Report(args) => report::report(&args),
        Task::Render(args) => render::render(&args),
        Task::Cache(args) => cache::cache(&args),
        Task::Defaults => {
            progress::out(&luxel::settings::documented_defaults());
            Ok(DONE)
        }
        Task::UnwrapWorker => {
            return match luxel_atlas::worker_main(std::io::stdin().lock(), std::io::stdout().lock()) {
                Ok(()) => ExitCode::SUCCESS,
                Err(_) => ExitCode::FAILURE,
            };
        }
    };
    ExitCode::from(code.unwrap_or_else(|error| {
        print::failure(None, &error);
        if json {
            print::misused(&error);
        }
        USAGE
    }))
}

/// What a command line means before any scene is opened; every error here is one of usage.
struct Job {
    found: Vec<Found>,
    /// Names that mean no scene.
    missing: Vec<(PathBuf, anyhow::Error)>,
    /// The layer of `--config`.
    config: Option<Layer>,
    style: Style,
    cancelled: Arc<AtomicBool>,
    /// What is done to a scene.
    deed: &'static str,
}

impl Job {
    /// Scenes that were asked for.
    fn scenes(&self) -> usize {
        self.found.len() + self.missing.len()
    }
}

fn prepare(common: &Common, out: Option<&Path>) -> anyhow::Result<Job> {
    let config = config(common)?;
    let Search { found, missing } = discover::find(&common.scenes, out)?;
    let missing = missing.into_iter().map(|(path, error)| (path, error.into())).collect();
    let cancelled = Arc::new(AtomicBool::new(false));
    let flag = cancelled.clone();
    on_interrupt(move || flag.store(true, Ordering::Relaxed))?;
    Ok(Job { found, missing, config, style: Style::choose(common.json, common.quiet), cancelled, deed: "baked" })
}

/// The layer of `--config`. A sky image that is not there is said once, and not of every scene.
fn config(common: &Common) -> anyhow::Result<Option<Layer>> {
    let config = common.config.as_deref().map(Layer::from_file).transpose()?;
    for image in config.iter().chain([&common.settings.0]).filter_map(Layer::sky_image) {
        anyhow::ensure!(image.is_file(), "{}: there is no such sky image; check --sky and --config", image.display());
    }
    Ok(config)
}

/// Requests to end that come so soon after the first are the same one: a terminal and a supervisor may both send it.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// Does this on the first Ctrl-C or request to end. A second one is meant seriously.
fn on_interrupt(mut work: impl FnMut() + Send + 'static) -> anyhow::Result<()> {
    let mut first: Option<Instant> = None;
    listen(move || match first {
        None => {
            first = Some(Instant::now());
            work();
        }
        Some(first) if first.elapsed() < SAME_REQUEST => {}
        Some(_) => std::process::exit(i32::from(INTERRUPTED)),
    })
    .context("cannot listen for Ctrl-C")
}

/// Calls this at every Ctrl-C (SIGINT) and request to end (SIGTERM), on a thread of its own. A terminal that goes away
/// (SIGHUP) ends the process as it would any other, unless whoever started it said otherwise, as nohup does.
#[cfg(unix)]
fn listen(mut handler: impl FnMut() + Send + 'static) -> std::io::Result<()> {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM])?;
    let wait = move || signals.forever().for_each(|_| handler());
    std::thread::Builder::new().name("luxel signals".into()).spawn(wait).map(drop)
}

/// Calls this at every Ctrl-C and request to end, on a thread of its own.
#[cfg(not(unix))]
fn listen(handler: impl FnMut() + Send + 'static) -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(handler)
}

fn plan(args: &Bake) -> anyhow::Result<u8> {
    let common = &args.common;
    let task = prepare(common, args.out.as_deref())?;
    let places = places(&task.found, args.out.as_deref())?;
    let store = args.storing.options();
    each(&task, places, |found, outputs, reporter| {
        let settings = for_scene(&found.scene, task.config.as_ref(), &common.settings.0)?;
        let plan = luxel::plan_file(&found.scene, Some((&outputs, &store)), &settings, reporter)?;
        let state = current::check(&found.scene, &outputs, &settings, reporter)?;
        reporter.finish();
        print::plan(task.style, &found.scene, &plan, &state);
        Ok(match state {
            State::Current(_) => End::Unchanged,
            State::Stale(_) => End::Done,
        })
    })
}

/// What became of a scene that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Done,
    /// Its outputs are current, so there was nothing to do.
    Unchanged,
    /// Its outputs are not current, and that was the question.
    Stale,
}

/// What became of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// Nobody has begun with it.
    Waiting,
    Over(End),
    /// Its error has been told.
    Failed,
    /// Ctrl-C came meanwhile.
    Interrupted,
}

/// Where a scene's files go, if there is such a place.
type Place = Result<OutputSet, ExportError>;

/// Does `work` for every scene with its place, one after another, goes on after a failure, and names the failed ones at
/// the end.
fn each<P>(
    task: &Job,
    places: Vec<Result<P, ExportError>>,
    mut work: impl FnMut(&Found, P, &Reporter) -> Result<End, Error>,
) -> anyhow::Result<u8> {
    for (path, error) in &task.missing {
        print::failed(task.style, path, error);
    }
    let mut fates = vec![Fate::Waiting; task.found.len()];
    for ((found, place), fate) in task.found.iter().zip(places).zip(&mut fates) {
        let name = print::written(&found.scene);
        if matches!(task.style, Style::Lines | Style::Bar) {
            say(&shown(&found.scene));
        }
        let screen = Screen::new(task.style);
        let reporter = Reporter::on(&screen, 0, &name, task.cancelled.clone());
        let done = place.map_err(Error::from).and_then(|outputs| work(found, outputs, &reporter));
        reporter.finish();
        *fate = match done {
            Ok(end) => Fate::Over(end),
            Err(Error::Cancelled) => {
                *fate = Fate::Interrupted;
                break;
            }
            Err(error) => {
                print::failed(task.style, &found.scene, &anyhow::Error::new(error));
                Fate::Failed
            }
        };
    }
    Ok(conclude(task, &fates))
}

/// Says in the end what became of all scenes, in their order, and with which code the process ends.
fn conclude(task: &Job, fates: &[Fate]) -> u8 {
    let of = |which: Fate| task.found.iter().zip(fates).filter(move |(_, fate)| **fate == which).map(|(f, _)| &f.scene);
    let failed: Vec<&PathBuf> = task.missing.iter().map(|(path, _)| path).chain(of(Fate::Failed)).collect();
    let begun: Vec<&PathBuf> = of(Fate::Interrupted).collect();
    if let Some(first) = begun.first().copied().or_else(|| of(Fate::Waiting).next()) {
        interrupted(task, first, &begun, &failed);
        return INTERRUPTED;
    }
    let (unchanged, stale): (Vec<_>, Vec<_>) =
        (of(Fate::Over(End::Unchanged)).collect(), of(Fate::Over(End::Stale)).collect());
    if task.style == Style::Json {
        event(&json!({
            "event": "done",
            "scenes": task.scenes(),
            "failed": written(&failed),
            "unchanged": written(&unchanged),
            "stale": written(&stale),
        }));
    }
    if task.style != Style::Quiet {
        name_all(task, &stale, "are stale");
    }
    name_all(task, &failed, "failed");
    match (failed.is_empty(), stale.is_empty()) {
        (false, _) => SOME_FAILED,
        (true, false) => STALE,
        (true, true) => DONE,
    }
}

/// Ctrl-C came: the first scene that is not done for that, and all that were `begun`.
fn interrupted(task: &Job, first: &Path, begun: &[&PathBuf], failed: &[&PathBuf]) {
    match task.style {
        Style::Json => {
            let first = print::written(first);
            let (scenes, failed) = (written(begun), written(failed));
            event(&json!({ "event": "interrupted", "scene": first, "scenes": scenes, "failed": failed }));
        }
        // Who interrupts knows it, and the exit code tells others.
        Style::Quiet => {}
        Style::Lines | Style::Bar if begun.len() > 1 => {
            let names: Vec<String> = begun.iter().map(|scene| shown(scene)).collect();
            say(&format!("interrupted; not {}: {}", task.deed, names.join(", ")));
        }
        Style::Lines | Style::Bar => say(&format!("interrupted; {} is not {}", shown(first), task.deed)),
    }
    name_all(task, failed, "failed");
}

fn written(scenes: &[&PathBuf]) -> Vec<String> {
    scenes.iter().map(|scene| print::written(scene)).collect()
}

/// For a person, whose screen may have lost what was said when the scenes `fared` so.
fn name_all(task: &Job, scenes: &[&PathBuf], fared: &str) {
    if task.style != Style::Json && !scenes.is_empty() && task.scenes() > 1 {
        say(&format!("{} of {} scenes {fared}:", scenes.len(), task.scenes()));
        for scene in scenes {
            say(&format!("  {}", shown(scene)));
        }
    }
}

/// Where every scene's files go. Two scenes with the same place are an error of usage, and so is a named scene without
/// one; a scene that was found in a folder fails alone.
fn places(found: &[Found], out: Option<&Path>) -> anyhow::Result<Vec<Place>> {
    places_by(found, "--out", |f| OutputSet::new(&f.scene, out, f.root.as_deref()))
}

/// The same for places that another option chooses.
fn places_by(
    found: &[Found],
    option: &str,
    place: impl Fn(&Found) -> Result<OutputSet, ExportError>,
) -> anyhow::Result<Vec<Place>> {
    let mut places = Vec::new();
    let mut taken: BTreeMap<PathBuf, &Path> = BTreeMap::new();
    for f in found {
        let set = match place(f) {
            Ok(set) => set,
            Err(error) if f.root.is_some() => {
                places.push(Err(error));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        if let Some(other) = taken.insert(real(&set.glb()), &f.scene) {
            anyhow::bail!(
                "{} and {} would both write {}: give them different {option}",
                shown(other),
                shown(&f.scene),
                shown(&set.glb())
            );
        }
        places.push(Ok(set));
    }
    Ok(places)
}

/// The one path of a file that may not exist yet, however it is spelt: links and dots in front of what exists followed,
/// dots behind it taken by their word.
fn real(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let known = path.ancestors().find_map(|above| Some((above, above.canonicalize().ok()?)));
    let Some((above, mut real)) = known else { return path };
    for part in path.strip_prefix(above).into_iter().flat_map(Path::components) {
        match part {
            Component::ParentDir => drop(real.pop()),
            part => real.push(part),
        }
    }
    real
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel::settings::Origin;

    #[test]
    fn scenes_that_would_overwrite_each_other_are_refused() {
        let found = |path: &str| Found { scene: path.into(), root: None };
        let pair = [found("a/level.glb"), found("b/level.glb")];
        assert!(places(&pair, Some(Path::new("out"))).unwrap_err().to_string().contains("different --out"));
        // Whatever the spelling.
        let spelt = |f: &Found| OutputSet::new(&f.scene, Some(&f.scene.parent().unwrap().join("../out")), None);
        assert!(places_by(&pair, "--to", spelt).unwrap_err().to_string().contains("different --to"));
        assert_eq!(places(&pair, None).unwrap().len(), 2);
    }

    #[test]
    fn an_internal_error_fails_its_scene_and_the_others_go_on() {
        let found = |path: &str| Found { scene: path.into(), root: None };
        let task = Job {
            found: vec![found("a.glb"), found("b.glb"), found("c.glb")],
            missing: Vec::new(),
            config: None,
            style: Style::Quiet,
            cancelled: Arc::default(),
            deed: "baked",
        };
        let mut done = Vec::new();
        let code = each(&task, places(&task.found, None).unwrap(), |found, _, _| {
            done.push(found.scene.clone());
            if found.scene == Path::new("b.glb") {
                Err(Error::Internal { what: "burst".into() })
            } else {
                Ok(End::Done)
            }
        });
        assert_eq!((code.unwrap(), done.len()), (SOME_FAILED, 3));
    }

    #[test]
    fn a_file_beside_the_scene_counts_unless_another_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("a.gltf");
        std::fs::write(&scene, r#"{"asset":{"version":"2.0"},"scenes":[{"extras":{"luxel":{"padding":5}}}]}"#).unwrap();
        std::fs::write(folder.path().join("luxel.toml"), "size = 128\npadding = 3").unwrap();
        let none = Layer::new(Origin::CommandLine);
        let resolved = for_scene(&scene, None, &none).unwrap();
        assert_eq!((resolved.settings.size.0, resolved.settings.padding.0), (128, 5));
        let named = Layer::new(Origin::File("other.toml".into()));
        assert_eq!(for_scene(&scene, Some(&named), &none).unwrap().settings.size.0, 1024);
    }
}
