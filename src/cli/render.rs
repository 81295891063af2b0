//! `luxel render`: pictures of scenes.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::slice;
use std::time::{Duration, Instant};

use anyhow::{bail, ensure};
use luxel::Error;
use luxel::discover::Found;
use luxel::render::compare::{Difference, Trial, difference, digits, sheet};
use luxel::render::film::Picture;
use luxel::render::method::{Chosen, Entry, METHODS, Way, passes};
use luxel::render::view::USUAL_FIELD;
use luxel::render::{Order, Size, Studio, View, exposure, lens, output};
use luxel::settings::{Settings, for_scene, resolve, value::Only};
use luxel::text::shown;
use luxel_export::OutputSet;
use luxel_export::report::Warning;
use serde_json::{Value, json};

use super::args::{Bake, Render};
use super::progress::{Reporter, Style, duration, event};
use super::{End, each, places, prepare, print, real};

/// Takes the pictures of every scene.
pub fn render(args: &Render) -> anyhow::Result<u8> {
    let Bake { common, out, .. } = &args.bake;
    let wanted = wanted(args)?;
    let order = order(args, wanted.ways())?;
    shows_all(&resolve(slice::from_ref(&common.settings.0))?.settings, &wanted)?;
    let mut job = prepare(common, out.as_deref())?;
    job.deed = "rendered";
    ensure!(args.to.is_none() || job.scenes() == 1, "--to names one picture, and there are {} scenes", job.scenes());
    let places = places(&job.found, out.as_deref())?;
    each(&job, places, |found, outputs, reporter| {
        let settings = for_scene(&found.scene, job.config.as_ref(), &common.settings.0)?.settings;
        shows_all(&settings, &wanted)?;
        // What a method takes is measured where it has to make all that it needs.
        let store = (!wanted.is_comparison()).then(|| args.bake.storing.options().open(outputs.folder()));
        let files = Files::new(args, &outputs);
        let took = Studio::with(&found.scene, &settings, &order, store.as_ref(), reporter, |studio| {
            let read = studio.scene().inputs.iter().map(|input| input.path.as_path()).chain(common.config.as_deref());
            files.spare(read, wanted.is_comparison())?;
            let scene = Scene { args, found, studio, files: &files, reporter, order: &order };
            match &wanted {
                Wanted::One(chosen) => scene.one(*chosen),
                Wanted::Several(all, against) => scene.compare(all, *against),
            }
        });
        took.map(|()| End::Done)
    })
}

/// What all pictures have in common; every error here is one of usage.
fn order(args: &Render, ways: Vec<Way>) -> anyhow::Result<Order> {
    let view = match (&args.camera, args.eye, args.target) {
        (Some(name), ..) => View::Camera(name.clone()),
        (None, Some(eye), Some(target)) => {
            View::from(eye, target, args.fov.unwrap_or(USUAL_FIELD)).map_err(anyhow::Error::msg)?
        }
        _ => View::Scene,
    };
    let size = Size { width: args.width, height: args.height };
    if let (Some(width), Some(height)) = (args.width, args.height) {
        lens::bound(width, height)?;
    }
    Ok(Order { view, size, samples: args.aa, exposure: args.exposure, ways })
}

/// Which methods are wanted.
enum Wanted {
    One(Chosen),
    /// And the number of the one that others are compared to.
    Several(Vec<Chosen>, usize),
}

impl Wanted {
    fn is_comparison(&self) -> bool {
        matches!(self, Self::Several(..))
    }

    fn all(&self) -> &[Chosen] {
        match self {
            Self::One(chosen) => slice::from_ref(chosen),
            Self::Several(all, _) => all,
        }
    }

    fn ways(&self) -> Vec<Way> {
        self.all().iter().map(|chosen| chosen.way(chosen.draws)).collect()
    }
}

fn wanted(args: &Render) -> anyhow::Result<Wanted> {
    let wanted = methods(args)?;
    for option in counts(args) {
        option.fit(&wanted)?;
    }
    Ok(wanted)
}

fn methods(args: &Render) -> anyhow::Result<Wanted> {
    let chosen = |entry: &'static Entry| Chosen { entry, draws: draws(args, entry) };
    if args.compare.is_empty() {
        let chosen = chosen(args.method.unwrap_or(&METHODS[0]));
        let by = if args.time.is_some() { "--time" } else { "--progressive" };
        let wanted = args.progressive || args.time.is_some();
        let name = chosen.entry.name;
        ensure!(!wanted || chosen.first_pass().is_some(), "{by} is for the methods paths and samples, not for {name}");
        return Ok(Wanted::One(chosen));
    }
    let mut entries = args.compare.clone();
    for (i, entry) in entries.iter().enumerate() {
        ensure!(!entries[..i].iter().any(|e| e.name == entry.name), "{} is compared to itself", entry.name);
    }
    let against = args.against.or(entries.last().copied()).unwrap_or(&METHODS[0]);
    let number = entries.iter().position(|e| e.name == against.name).unwrap_or_else(|| {
        entries.push(against);
        entries.len() - 1
    });
    Ok(Wanted::Several(entries.into_iter().map(chosen).collect(), number))
}

/// Sees that no light is left out of what shows or is compared to all of it.
fn shows_all(settings: &Settings, wanted: &Wanted) -> Result<(), Error> {
    let is_lightmap = matches!(wanted, Wanted::One(chosen) if chosen.way(chosen.draws) == Way::Lightmap);
    if settings.only == Only::All || is_lightmap { Ok(()) } else { Err(Error::OnlyLightmap) }
}

/// An option that says how often a method may draw.
struct Count {
    option: &'static str,
    /// What is drawn.
    draws: &'static str,
    said: Option<u32>,
}

fn counts(args: &Render) -> [Count; 3] {
    let count = |option, draws, said: Option<NonZeroU32>| Count { option, draws, said: said.map(NonZeroU32::get) };
    [
        count("--paths", "paths", args.paths),
        count("--samples", "passes", args.samples),
        count("--map-photons", "photons", args.map_photons),
    ]
}

impl Count {
    fn is_of(&self, entry: &Entry) -> bool {
        entry.draws.is_some_and(|draws| draws.name == self.draws)
    }

    /// Sees that one of the methods draws that, and that it is enough for it.
    fn fit(&self, wanted: &Wanted) -> anyhow::Result<()> {
        let (Some(said), Self { option, draws, .. }) = (self.said, self) else { return Ok(()) };
        let Some(chosen) = wanted.all().iter().find(|chosen| self.is_of(chosen.entry)) else {
            let of = METHODS.iter().find(|entry| self.is_of(entry)).map_or("", |entry| entry.name);
            bail!("{option} is for the method {of}, and the picture is not by it");
        };
        let least = chosen.least();
        ensure!(said >= least, "{option} has to be {least} at least: of fewer {draws} no noise is known");
        Ok(())
    }
}

/// How often a method may draw.
fn draws(args: &Render, entry: &Entry) -> u32 {
    let Some(draws) = entry.draws else { return 0 };
    let said = counts(args).into_iter().find(|count| count.is_of(entry)).and_then(|count| count.said);
    // Where time is what bounds it, nothing else does.
    let usual = if args.time.is_some() && draws.first.is_some() { u32::MAX } else { draws.usual };
    said.unwrap_or(usual)
}

/// The names of a scene's pictures.
struct Files {
    picture: (PathBuf, PathBuf),
    sheet: PathBuf,
}

impl Files {
    fn new(args: &Render, outputs: &OutputSet) -> Self {
        match &args.to {
            Some(png) => Self { picture: (png.clone(), png.with_extension("exr")), sheet: png.clone() },
            None => Self { picture: outputs.render(), sheet: outputs.compare() },
        }
    }

    /// Sees that none of the files that will be written is one that was read.
    fn spare<'a>(&self, read: impl Iterator<Item = &'a Path>, is_comparison: bool) -> Result<(), Error> {
        let files = if is_comparison { vec![&self.sheet] } else { vec![&self.picture.0, &self.picture.1] };
        let read: Vec<PathBuf> = read.map(real).collect();
        let over = files.into_iter().find(|file| read.contains(&real(file)));
        over.map_or(Ok(()), |path| Err(Error::OverInput { path: path.clone() }))
    }
}

/// A scene before the camera.
struct Scene<'a> {
    args: &'a Render,
    found: &'a Found,
    studio: &'a Studio<'a>,
    files: &'a Files,
    reporter: &'a Reporter<'a>,
    order: &'a Order,
}

impl Scene<'_> {
    /// One picture, in one pass or in several.
    fn one(&self, chosen: Chosen) -> Result<(), Error> {
        let start = Instant::now();
        let always = chosen.entry.draws.is_some_and(|d| d.is_progressive);
        let wanted = always || self.args.progressive || self.args.time.is_some();
        let (picture, draws) = match (chosen.first_pass().filter(|_| wanted), chosen.way(chosen.draws)) {
            (Some(first), Way::Found(technique)) => {
                self.studio.passes(technique, self.reporter, |take| self.progressive(chosen, first, start, take))?
            }
            (_, way) => (self.studio.picture(way, self.reporter)?, chosen.draws),
        };
        let ev = self.write(&picture)?;
        self.reporter.finish();
        self.tell_picture(&Chosen { draws, ..chosen }, &picture, ev, start.elapsed());
        Ok(())
    }

    /// Passes, each written, until what may be drawn is spent or the time is over. Returns the sum of all and how often
    /// it has drawn.
    fn progressive(
        &self,
        chosen: Chosen,
        first: u32,
        start: Instant,
        take: &mut dyn FnMut(u32) -> Result<Picture, Error>,
    ) -> Result<(Picture, u32), Error> {
        let mut sum: Option<(Picture, u32)> = None;
        // How long the last pass took.
        let mut last = None;
        for (pass, draws) in (0..).zip(passes(first, chosen.least(), chosen.draws)) {
            let spent = sum.as_ref().map_or(0, |(_, spent)| *spent);
            let Some(draws) = self.affordable(draws, chosen.least(), start, last) else { break };
            let own = Instant::now();
            let picture = take(draws)?;
            last = Some((own.elapsed(), draws));
            let total = spent + draws;
            let blended = match sum.take() {
                None => picture,
                Some((mut before, _)) => {
                    before.blend(&picture, draws as f32 / total as f32);
                    before
                }
            };
            self.write(&blended)?;
            self.tell_pass(&chosen, pass, total, &blended, start.elapsed());
            sum = Some((blended, total));
        }
        Ok(sum.unwrap_or((Picture::black(self.studio.width, self.studio.height), 0)))
    }

    /// How often the next pass may draw, in the time that is left at the rate of the last one; none when that is less than
    /// a pass has at least.
    fn affordable(&self, draws: u32, least: u32, start: Instant, last: Option<(Duration, u32)>) -> Option<u32> {
        let (Some(time), Some((took, drawn))) = (self.args.time, last) else { return Some(draws) };
        let left = time.checked_sub(start.elapsed())?.as_secs_f64();
        let fit = left / took.as_secs_f64().max(1e-9) * f64::from(drawn);
        (fit >= f64::from(least)).then(|| draws.min(fit as u32))
    }

    /// Writes a picture; returns its exposure value.
    fn write(&self, picture: &Picture) -> Result<f64, Error> {
        let tone = self.studio.tone(picture, self.reporter)?;
        let (png, exr) = &self.files.picture;
        output::write(picture, &tone, (png, exr), self.reporter)?;
        Ok(exposure::value(&tone))
    }

    /// Pictures by several methods on one sheet.
    fn compare(&self, methods: &[Chosen], against: usize) -> Result<(), Error> {
        let mut trials = Vec::new();
        for chosen in methods {
            let way = chosen.way(chosen.draws);
            // The solution is made once, and counted for every method that needs it.
            let solution = if way.rests_on_solution() { self.studio.solve(self.reporter)? } else { 0.0 };
            let (picture, own) = timed(|| self.studio.picture(way, self.reporter))?;
            trials.push(Trial { name: chosen.label(), picture, seconds: solution + own });
        }
        let tone = self.studio.tone(&trials[against].picture, self.reporter)?;
        let image = sheet(&trials, against, &tone, self.reporter)?;
        output::write_image(&image, &self.files.sheet, self.reporter)?;
        self.reporter.finish();
        self.tell_comparison(methods, &trials, against, exposure::value(&tone));
        Ok(())
    }

    fn warnings(&self) -> Vec<Warning> {
        self.studio.scene().notices.iter().map(Warning::from).chain(self.studio.warnings.iter().cloned()).collect()
    }

    fn tell_pass(&self, chosen: &Chosen, pass: u32, draws: u32, picture: &Picture, took: Duration) {
        let error = picture.relative_error();
        match self.reporter.style() {
            Style::Quiet => {}
            Style::Json => event(&json!({
                "event": "pass", "scene": print::written(&self.found.scene), "method": chosen.entry.name,
                "pass": pass, "draws": draws, "seconds": took.as_secs_f64(), "error": error,
                "outputs": written(&[&self.files.picture.0, &self.files.picture.1]),
            })),
            Style::Lines | Style::Bar => {
                let label = Chosen { draws, ..*chosen }.label();
                self.reporter.say(&format!(
                    "  pass {}: {label}, noise {}, after {}",
                    pass + 1,
                    percent(error),
                    duration(took.as_secs_f64())
                ));
            }
        }
    }

    fn tell_picture(&self, chosen: &Chosen, picture: &Picture, ev: f64, took: Duration) {
        let (png, exr) = &self.files.picture;
        let Picture { width, height, spent, .. } = picture;
        match self.reporter.style() {
            Style::Quiet => {}
            Style::Json => {
                let mut told = figures(chosen, picture, took.as_secs_f64());
                told["event"] = "rendered".into();
                told["scene"] = print::written(&self.found.scene).into();
                (told["width"], told["height"], told["exposure"]) = ((*width).into(), (*height).into(), ev.into());
                told["outputs"] = json!(written(&[png, exr]));
                told["warnings"] = json!(self.warnings());
                event(&told);
            }
            Style::Lines | Style::Bar => {
                let say = |line: &str| self.reporter.say(line);
                print::notes(&say, &self.warnings());
                let per_pixel = spent.samples as f64 / picture.radiance.len() as f64;
                say(&format!(
                    "  {}: {width} × {height} pixels, {per_pixel:.2} samples each, light at {} points, {} M rays, {}EV {ev:.1}{}",
                    chosen.label(),
                    spent.points,
                    digits(spent.rays as f64 * 1e-6),
                    picture.relative_error().map_or(String::new(), |e| format!("noise {}, ", percent(Some(e)))),
                    if self.order.exposure.is_some() { "" } else { " chosen" },
                ));
                [png, exr].iter().for_each(|file| say(&format!("  wrote {}", shown(file))));
                say(&format!("  done in {}", duration(took.as_secs_f64())));
            }
        }
    }

    fn tell_comparison(&self, methods: &[Chosen], trials: &[Trial], against: usize, ev: f64) {
        let reference = &trials[against].picture;
        let rows = || methods.iter().zip(trials).map(|(m, t)| (m, t, difference(&t.picture, reference)));
        match self.reporter.style() {
            Style::Quiet => {}
            Style::Json => {
                let all: Vec<Value> = rows()
                    .map(|(method, trial, d)| {
                        let mut row = figures(method, &trial.picture, trial.seconds);
                        let of = |share: fn(Difference) -> f64| d.map(share).into();
                        (row["rmse"], row["bias"], row["p95"]) = (of(|d| d.rmse), of(|d| d.bias), of(|d| d.p95));
                        row
                    })
                    .collect();
                event(&json!({
                    "event": "compared", "scene": print::written(&self.found.scene),
                    "against": methods[against].entry.name, "width": reference.width, "height": reference.height,
                    "exposure": ev, "reflected": reference.mean_reflected(), "methods": all,
                    "outputs": written(&[&self.files.sheet]), "warnings": self.warnings(),
                }));
            }
            Style::Lines | Style::Bar => {
                let say = |line: &str| self.reporter.say(line);
                print::notes(&say, &self.warnings());
                say("  method                  seconds    M rays     RMSE     bias      p95    noise");
                for (i, (_, trial, d)) in rows().enumerate() {
                    let rays = trial.picture.spent.rays;
                    let rays = digits(rays as f64 * 1e-6);
                    let d = d.filter(|_| i != against);
                    let [rmse, bias, p95] = [d.map(|d| d.rmse), d.map(|d| d.bias), d.map(|d| d.p95)].map(percent);
                    say(&format!(
                        "  {:<22} {:>8} {rays:>9} {rmse:>8} {bias:>8} {p95:>8} {:>8}",
                        trial.name,
                        digits(trial.seconds),
                        percent(trial.picture.relative_error())
                    ));
                }
                say(&format!("  wrote {}", shown(&self.files.sheet)));
            }
        }
    }
}

/// What work gives, and how long it took [s].
fn timed<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<(T, f64), Error> {
    let start = Instant::now();
    Ok((work()?, start.elapsed().as_secs_f64()))
}

/// What programs learn of a picture.
fn figures(chosen: &Chosen, picture: &Picture, seconds: f64) -> Value {
    let spent = picture.spent;
    json!({
        "method": chosen.entry.name,
        "draws": chosen.entry.draws.map(|_| chosen.draws),
        "seconds": seconds,
        "samples": spent.samples,
        "points": spent.points,
        "rays": spent.rays,
        "error": picture.relative_error(),
    })
}

fn written(files: &[&PathBuf]) -> Vec<String> {
    files.iter().map(|file| print::written(file)).collect()
}

fn percent(share: Option<f64>) -> String {
    share.map_or("-".into(), |share| format!("{} %", digits(100.0 * share)))
}
