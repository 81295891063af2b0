//! The whole report of one scene.
//!
//! Every point is kept in the store as soon as it is measured, and the CSV is written anew after each: whoever interrupts
//! a long report loses the point at work and goes on from there the next time.

use std::path::{Path, PathBuf};

use luxel_export::{report::Warning, write_atomic};
use luxel_scene::{Progress, Scene, Uncounted};
use serde::Serialize;
use serde_json::json;

use super::advice::{self, Advice};
use super::fit::Fit;
use super::measure::Measure;
use super::point::csv;
use super::series::{self, Series};
use super::small::{self, Small};
use super::table::{self, Column};
use super::truth::{self, Exactness};
use super::{Point, Score, maps, plot};
use crate::Error;
use crate::bake::lab::{self, Lab};
use crate::bake::{memory, needs};
use crate::plan::Memory;
use crate::settings::{DoubleSided, LightGroups, Only, Settings};
use crate::store::Store;

/// What the reference of a report is for.
const REPORT: &str = "report";

/// What is wanted of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    pub exactness: Exactness,
    /// Settings that are swept; none: all of them.
    pub sweeps: Option<Vec<String>>,
    /// Other methods, by their names ([`series::METHODS`]); none: all of them.
    pub methods: Option<Vec<String>>,
    pub together: bool,
    pub table: bool,
    pub maps: bool,
    /// Measures anew what was measured before; the reference and the map have no times and stay.
    pub fresh: bool,
    /// On what it runs.
    pub machine: String,
    /// What the tables say about how they were made.
    pub notes: Vec<String>,
}

/// What was found out about a scene.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    pub scene: String,
    pub reference: Known,
    /// The bake with the settings as they are.
    pub base: Score,
    #[serde(skip)]
    pub points: Vec<Point>,
    /// Laws of all series that have one.
    pub fits: Vec<(String, Fit)>,
    pub advice: Vec<Advice>,
    /// In one sentence, which setting limits the error.
    pub verdict: String,
    pub table1: Vec<Column>,
    /// What a person should know of it.
    pub warnings: Vec<Warning>,
    /// What was written, where this is not told among it.
    #[serde(skip)]
    pub files: Vec<PathBuf>,
}

/// What the reference is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Known {
    pub texels: usize,
    pub paths: u32,
    /// [lux]
    pub mean: f64,
    pub noise: f64,
}

/// Measures a scene and writes `STEM.report.csv`, `.md`, `.json`, `.front.svg`, `.sweeps.svg`, `.maps.png` into a folder.
/// `tell` hears of every point.
///
/// # Errors
/// As a bake, and where a file cannot be written.
pub fn study(
    scene: &Scene,
    base: &Settings,
    order: &Order,
    (folder, stem): (&Path, &str),
    store: &Store,
    progress: &dyn Progress,
    tell: &mut (dyn FnMut(&Point) + Send),
) -> Result<Findings, Error> {
    let base = &whole_light(base);
    let sweeps: Vec<Series> = series::sweeps(base, !scene.sky.is_dark())
        .into_iter()
        .filter(|s| order.sweeps.as_ref().is_none_or(|wanted| wanted.contains(&s.name)))
        .collect();
    let mut all: Vec<Series> = vec![series::as_it_is(base)];
    all.extend(order.together.then(|| series::together(base, &[])));
    let is_wanted = |name: &str| order.methods.as_ref().is_none_or(|wanted| wanted.iter().any(|w| w == name));
    all.extend(series::methods(base, is_wanted));
    all.extend(sweeps.iter().cloned());
    let columns = if order.table { table::settings(base, scene.triangle_count()).into() } else { Vec::new() };
    let mapped = order.maps.then(|| small::sized(base, maps::side(base)));
    // What does not fit is told before the hours that the rest may take.
    let attempts = all.iter().flat_map(|s| &s.attempts).map(|attempt| attempt.needs(scene));
    let bakes = columns.iter().map(|(_, settings)| settings).chain(&mapped);
    let needs = attempts.chain(bakes.map(|settings| needs::bake(scene, settings)));
    let warnings = Vec::from_iter(memory::check(&needs.fold(Memory::default(), Memory::max))?);
    let map = order.maps.then(|| maps::lay_out(scene, base, store, progress)).transpose()?;
    Lab::with(scene, base, None, progress, |lab| {
        let (atlas, _) = lab::lay_out(scene, base, Some(store), progress)?;
        let texels = truth::texels(lab, &atlas, order.exactness.texels);
        let truth = truth::truth(lab, texels, (&order.exactness, REPORT), Some(store), progress)?;
        let measure = Measure::new(lab, &atlas, &truth, Some(store), &order.machine);
        let measure = if order.fresh { measure.anew() } else { measure };
        let mut book = Book { order, folder, stem, points: Vec::new(), files: Vec::new() };
        let count = all.iter().map(|s| s.attempts.len() as u64).sum();
        progress.begin("report", count);
        for series in &all {
            for attempt in &series.attempts {
                let point = measure.point(series, attempt, &Uncounted(progress))?;
                tell(&point);
                progress.advance(1);
                book.add(point)?;
            }
        }
        let advice = advice::advise(base, &sweeps, &book.points);
        let fits = all.iter().filter_map(|s| Some((s.name.clone(), law(s, &book.points)?))).collect();
        let mut table1: Vec<Column> = if order.table { table::printed().into() } else { Vec::new() };
        for (name, settings) in &columns {
            table1.push(Column { name: (*name).into(), figures: measure.table1(settings, progress)? });
        }
        let base_score = book.points.first().map(|p| p.score).unwrap_or_default();
        let reference =
            Known { texels: truth.points.len(), paths: truth.paths, mean: truth.mean(), noise: truth.noise() };
        let verdict = advice::verdict(&advice);
        let mut warnings = warnings;
        warnings.extend(noisy(&reference, &order.exactness));
        let mut findings = Findings {
            scene: scene.name.clone(),
            reference,
            base: base_score,
            points: Vec::new(),
            fits,
            advice,
            verdict,
            table1,
            warnings,
            files: Vec::new(),
        };
        book.close(&mut findings)?;
        if let Some(Small { settings, atlas, .. }) = &map {
            let png = maps::draw(&lab.tuned(settings), atlas, &order.exactness, Some(store), progress)?;
            let path = folder.join(format!("{stem}.maps.png"));
            write_atomic(&path, &png)?;
            findings.files.push(path);
        }
        Ok(findings)
    })
}

/// Says so where the paths came to their end before the reference was as exact as it should be.
fn noisy(known: &Known, wanted: &Exactness) -> Option<Warning> {
    (known.noise > wanted.noise).then(|| Warning {
        code: "noisy-reference".into(),
        message: format!(
            "the reference has {} of noise after {} paths a texel, not {}: more --paths would make it quieter",
            percent(known.noise),
            known.paths,
            percent(wanted.noise)
        ),
    })
}

/// The settings with which errors are measured: of all light together, on fronts, which is what the reference has.
pub(super) fn whole_light(base: &Settings) -> Settings {
    Settings { light_groups: LightGroups::One, only: Only::All, double_sided: DoubleSided::Front, ..base.clone() }
}

/// The law of a series.
fn law(series: &Series, points: &[Point]) -> Option<Fit> {
    Fit::of_series(&points.iter().filter(|p| p.series == series.name).collect::<Vec<_>>())
}

/// The files of a report as they grow.
struct Book<'a> {
    order: &'a Order,
    folder: &'a Path,
    stem: &'a str,
    points: Vec<Point>,
    files: Vec<PathBuf>,
}

impl Book<'_> {
    fn path(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}.{ending}", self.stem))
    }

    fn put(&mut self, ending: &str, bytes: &[u8]) -> Result<(), Error> {
        let path = self.path(ending);
        write_atomic(&path, bytes)?;
        if !self.files.contains(&path) {
            self.files.push(path);
        }
        Ok(())
    }

    fn add(&mut self, point: Point) -> Result<(), Error> {
        self.points.push(point);
        let bytes = csv(&self.points, &self.order.notes).map_err(|e| Error::Report { what: e.to_string() })?;
        self.put("report.csv", &bytes)
    }

    fn close(mut self, findings: &mut Findings) -> Result<(), Error> {
        let noise = findings.reference.noise;
        let told = |what| Error::Report { what };
        let title = format!("{}: error against run time", self.stem);
        let front = plot::front(&title, &self.points, noise).map_err(told)?;
        self.put("front.svg", front.as_bytes())?;
        let title = format!("{}: one setting at a time", self.stem);
        let sweeps = plot::sweeps(&title, &self.points, noise).map_err(told)?;
        self.put("sweeps.svg", sweeps.as_bytes())?;
        findings.points = std::mem::take(&mut self.points);
        let text = markdown(findings, &self.order.notes);
        self.put("report.md", text.as_bytes())?;
        let mut json = serde_json::to_vec_pretty(&json!({ "notes": self.order.notes, "findings": findings }))
            .map_err(|e| told(e.to_string()))?;
        json.push(b'\n');
        self.put("report.json", &json)?;
        findings.files = self.files;
        Ok(())
    }
}

/// A point in one line.
pub fn line(point: &Point) -> String {
    let Point { series, value, method, cpu_seconds, score, .. } = point;
    let rmse = percent(score.rmse);
    format!(
        "{series} {value} ({method}): RMSE {rmse}, bias {:+.2} %, {cpu_seconds:.1} s of processor",
        100.0 * score.bias
    )
}

/// A share in per cent.
fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

/// The table of all points for a terminal or a page.
pub fn points_table(points: &[Point]) -> String {
    let head = [
        "series",
        "method",
        "value",
        "CPU s",
        "RMSE",
        "bias",
        "p95",
        "direct",
        "indirect",
        "continuous rays",
        "discrete rays",
    ];
    let row = |p: &Point| {
        let s = &p.score;
        vec![
            p.series.clone(),
            p.method.clone(),
            p.value.clone(),
            format!("{:.2}", p.cpu_seconds),
            format!("{:.2} ({:.2}–{:.2}) %", 100.0 * s.rmse, 100.0 * s.rmse_low, 100.0 * s.rmse_high),
            format!("{:+.2} %", 100.0 * s.bias),
            format!("{:.1} %", 100.0 * s.p95),
            percent(s.direct_rmse),
            percent(s.indirect_rmse),
            p.continuous_rays.to_string(),
            p.discrete_rays.to_string(),
        ]
    };
    let lines: Vec<Vec<String>> =
        std::iter::once(head.map(String::from).to_vec()).chain(points.iter().map(row)).collect();
    table::grid(&lines)
}

/// What follows from the points: the laws, and what limits the error.
pub fn conclusions(findings: &Findings) -> String {
    let mut lines = vec![["setting", "value", "order", "floor", "now", "doubled"].map(String::from).to_vec()];
    for a in &findings.advice {
        let fitted = |get: fn(&Fit) -> String| a.fit.as_ref().map_or("-".into(), get);
        let known = |x: f64| if a.fit.is_some() { percent(x) } else { "-".into() };
        lines.push(vec![
            a.setting.clone(),
            a.value.clone(),
            fitted(|f| format!("{:.2}", f.order)),
            fitted(|f| percent(f.floor)),
            known(a.now),
            a.doubled.map_or("-".into(), percent),
        ]);
    }
    let together = findings.fits.iter().find(|(name, _)| name == series::TOGETHER).map(|(_, fit)| {
        format!(
            "All settings together: order {:.2} in voxels along a side, down to {}.\n",
            fit.order,
            percent(fit.floor)
        )
    });
    format!("{}\n{}\n{}", table::grid(&lines), together.unwrap_or_default(), findings.verdict)
}

fn markdown(findings: &Findings, notes: &[String]) -> String {
    let Known { texels, paths, mean, noise } = findings.reference;
    let mut text = format!("# {}: error against run time\n\n", findings.scene);
    for note in notes {
        text += &format!("{note}\n");
    }
    for warning in &findings.warnings {
        text += &format!("Warning: {}\n", warning.message);
    }
    text += &format!(
        "\nReference: path tracing, {texels} texels, {paths} paths each, mean irradiance {mean:.4e} lux, noise {}. RMSE \
         with that noise taken off and its 95 % confidence interval, p95 with that noise in it; shares of the mean \
         irradiance.\n\n{}\n## What limits the error\n\n{}\n",
        percent(noise),
        points_table(&findings.points),
        conclusions(findings)
    );
    if !findings.table1.is_empty() {
        text += &format!("\n## Table 1 of the paper\n\n{}", table::text(&findings.table1));
    }
    text
}
