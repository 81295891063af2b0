//! `luxel report`: error against run time, and the settings for an error or a time.

use std::path::Path;

use luxel::Error;
use luxel::bake::lab;
use luxel::discover::Found;
use luxel::settings::{Origin, Resolved, Settings, for_scene, value::Texels};
use luxel::store::Store;
use luxel::study::{Order, Point, budget, budget::Question, run, series, study, truth::Exactness};
use luxel::text::shown;
use luxel_export::{ExportError, OutputSet};
use serde_json::json;

use super::args::{Bake, Report};
use super::progress::{Reporter, Style, event, out};
use super::{End, each, places_by, prepare, print};

/// The folder beside a scene in which reports are written.
const FOLDER: &str = "report";

/// What a report calls none at all.
const NONE: &str = "none";

/// Reports on every scene.
pub fn report(args: &Report) -> anyhow::Result<u8> {
    let Bake { common, out, storing } = &args.bake;
    let chosen = Chosen {
        sweeps: some_of("--sweep", "no setting that is swept", &args.sweep, &series::names().collect::<Vec<_>>())?,
        methods: some_of("--methods", "no method", &args.methods, &series::METHODS)?,
    };
    let mut task = prepare(common, out.as_deref())?;
    task.deed = "reported on";
    let places = places_by(&task.found, "--out", |found| target(found, out.as_deref()))?;
    each(&task, places, |found, outputs, reporter| {
        let resolved = for_scene(&found.scene, task.config.as_ref(), &common.settings.0)?;
        let store = storing.options().open(outputs.folder());
        let done = lab::on_threads(&resolved.settings, || match goal(args) {
            Some(goal) => settle(found, &resolved, goal, &store, reporter),
            None => whole(args, &chosen, found, &resolved, (&outputs, &store), reporter),
        });
        store.evict();
        done
    })
}

/// Where a scene's report goes: below the folder that is named, or beside the scene.
fn target(found: &Found, to: Option<&Path>) -> Result<OutputSet, ExportError> {
    let beside = found.scene.parent().unwrap_or(Path::new("")).join(FOLDER);
    let (to, root) = to.map_or((&*beside, None), |to| (to, found.root.as_deref()));
    OutputSet::new(&found.scene, Some(to), root)
}

/// What is measured, by its names; none: all of it.
struct Chosen {
    sweeps: Option<Vec<String>>,
    methods: Option<Vec<String>>,
}

/// The names that a flag lists, all of which have to be `known`.
fn some_of(
    flag: &str,
    otherwise: &str,
    list: &Option<Vec<String>>,
    known: &[&str],
) -> anyhow::Result<Option<Vec<String>>> {
    let Some(wanted) = list else { return Ok(None) };
    let wanted: Vec<String> = wanted.iter().map(|name| name.trim().replace('-', "_")).collect();
    if wanted == [NONE] {
        return Ok(Some(Vec::new()));
    }
    if let Some(name) = wanted.iter().find(|name| !known.contains(&name.as_str())) {
        anyhow::bail!("{flag}: {name} is {otherwise}; these are: {}, or {NONE}", known.join(", "));
    }
    Ok(Some(wanted))
}

/// What settings are wanted for.
#[derive(Clone, Copy)]
enum Goal {
    Error(f64),
    Seconds(f64),
}

fn goal(args: &Report) -> Option<Goal> {
    let seconds = args.target_time.map(|time| Goal::Seconds(time.as_secs_f64()));
    args.target_error.map(Goal::Error).or(seconds)
}

/// The whole report.
fn whole(
    args: &Report,
    chosen: &Chosen,
    found: &Found,
    resolved: &Resolved,
    (outputs, store): (&OutputSet, &Store),
    reporter: &Reporter,
) -> Result<End, Error> {
    let settings = &small(resolved);
    let scene = lab::load(&found.scene, settings, reporter)?;
    let order = Order {
        exactness: Exactness { texels: args.texels as usize, noise: args.noise, paths: args.paths },
        sweeps: chosen.sweeps.clone(),
        methods: chosen.methods.clone(),
        together: !args.no_together,
        table: !args.no_table,
        maps: !args.no_maps,
        fresh: args.fresh,
        machine: machine(),
        notes: notes(settings),
    };
    let name = print::written(&found.scene);
    let style = reporter.style();
    let mut tell = |point: &Point| match style {
        Style::Json => event(&json!({ "event": "point", "scene": name, "point": point })),
        Style::Quiet => {}
        Style::Lines | Style::Bar => reporter.say(&format!("  {}", run::line(point))),
    };
    let place = (outputs.folder(), outputs.stem());
    let findings = study(&scene, settings, &order, place, store, reporter, &mut tell)?;
    reporter.finish();
    match style {
        Style::Json => event(&json!({
            "event": "report", "scene": name, "findings": findings,
            "files": findings.files.iter().map(|file| print::written(file)).collect::<Vec<_>>(),
        })),
        Style::Quiet => {}
        Style::Lines | Style::Bar => {
            out(&format!("{}\n{}\n", run::points_table(&findings.points), run::conclusions(&findings)));
            if !findings.table1.is_empty() {
                out(&format!("\n{}", luxel::study::table::text(&findings.table1)));
            }
            print::notes(&|line: &str| reporter.say(line), &findings.warnings);
            findings.files.iter().for_each(|file| reporter.say(&format!("  {}", shown(file))));
        }
    }
    Ok(End::Done)
}

/// The settings of a report: those of the scene, on a small atlas unless somebody chose its size.
fn small(resolved: &Resolved) -> Settings {
    let is_chosen = |name: &str| resolved.list().any(|(field, _, from)| field.name == name && *from != Origin::Default);
    let mut settings = resolved.settings.clone();
    if !is_chosen("size") && !is_chosen("texel_density") {
        settings.size = Texels(luxel::study::budget::SIDE);
    }
    settings
}

/// How a report was made: the command, and on what it ran.
fn notes(settings: &Settings) -> Vec<String> {
    let command: Vec<String> = std::env::args_os().skip(1).map(|arg| named(&arg.to_string_lossy())).collect();
    vec![
        format!("Made by `luxel {}`, version {}.", command.join(" "), env!("CARGO_PKG_VERSION")),
        format!("Machine: {}. Atlas of {} texels a side.", machine(), settings.size.0),
    ]
}

/// An argument without the folders of this machine.
fn named(arg: &str) -> String {
    let (flag, value) = match arg.split_once('=') {
        Some((flag, value)) if flag.starts_with('-') => (format!("{flag}="), value),
        _ => (String::new(), arg),
    };
    let path = Path::new(value);
    let name = path.file_name().filter(|_| path.is_absolute()).map(|name| name.to_string_lossy().into_owned());
    luxel::text::plain(&format!("{flag}{}", name.as_deref().unwrap_or(value))).to_string()
}

/// Processors, memory and system of this machine, as far as the system tells.
fn machine() -> String {
    use sysinfo::{CpuRefreshKind, MemoryRefreshKind, RefreshKind, System};
    let system = format!("{} {}", std::env::consts::OS, std::env::consts::ARCH);
    let wanted =
        RefreshKind::nothing().with_cpu(CpuRefreshKind::nothing()).with_memory(MemoryRefreshKind::nothing().with_ram());
    let Ok(known) = System::new_with_specifics(wanted) else { return system };
    let brand = known.cpus().first().map(|cpu| cpu.brand().trim()).filter(|brand| !brand.is_empty());
    let processors = match brand {
        Some(brand) => format!("{} processors ({brand})", known.cpus().len()),
        None => format!("{} processors", known.cpus().len()),
    };
    format!("{processors}, {} GiB of memory, {system}", known.total_memory() >> 30)
}

/// Finds the settings for a goal.
fn settle(found: &Found, resolved: &Resolved, goal: Goal, store: &Store, reporter: &Reporter) -> Result<End, Error> {
    let (base, fixed) = (&resolved.settings, &resolved.chosen()[..]);
    let scene = &lab::load(&found.scene, base, reporter)?;
    let question = Question { scene, base, fixed, store: Some(store) };
    let choice = match goal {
        Goal::Error(error) => budget::for_error(&question, error, reporter)?,
        Goal::Seconds(seconds) => budget::for_time(&question, seconds, &machine(), reporter)?,
    };
    reporter.finish();
    let flags = choice.flags(&question);
    let [rmse, most] = [choice.score.rmse, choice.score.rmse_high];
    match reporter.style() {
        Style::Json => event(&json!({
            "event": "target", "scene": print::written(&found.scene), "rung": choice.rung, "flags": flags,
            "rmse": rmse, "rmse_most": most, "seconds": choice.seconds, "reached": choice.is_reached,
        })),
        Style::Quiet => {}
        Style::Lines | Style::Bar => out(&format!(
            "{}: RMSE {:.2} % (95 % confidence: at most {:.2} %), about {:.1} s of light at {}²\n{flags}\n",
            shown(&found.scene),
            100.0 * rmse,
            100.0 * most,
            choice.seconds,
            base.size.0
        )),
    }
    if choice.is_reached { Ok(End::Done) } else { Err(out_of_reach(goal, &choice)) }
}

/// What is said of a goal that no settings reach.
fn out_of_reach(goal: Goal, choice: &budget::Choice) -> Error {
    match goal {
        Goal::Error(target) => budget::unreached(target, choice),
        Goal::Seconds(seconds) => Error::Target {
            what: format!("the roughest settings take about {:.1} s, more than {seconds} s", choice.seconds),
        },
    }
}
