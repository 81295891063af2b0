//! The settings for an error or for a time: the practical question.
//!
//! The rungs of the [`ladder`](super::ladder) are tried from below, each at a few hundred texels against the
//! reference: all light, in the groups that a bake has, on fronts, on a small atlas before its seams are stitched.
//! For an error, the first rung wins the upper end of whose 95 % interval is below it (each rung that is tried may
//! pass by chance, 2.5 % of them); that depends on scene and settings alone, so it can be stored and a bake with it
//! has the same bytes everywhere. For a time, the last rung wins that fits into it on this machine; what belongs to
//! texels counts as often as the lightmap has more of them than the trial.

use std::path::Path;

use luxel_scene::{Progress, Scene, Uncounted};
use serde::{Deserialize, Serialize};

use super::keys;
use super::ladder::{self, RUNGS};
use super::measure::Measure;
use super::series::{self, Series};
use super::small::{self, Small};
use super::truth::{self, Exactness};
use super::{Point, Score};
use crate::Error;
use crate::bake::artefact;
use crate::bake::digest::Digest;
use crate::bake::lab::{self, Lab};
use crate::bake::memory;
use crate::settings::{DoubleSided, FIELDS, Only, Origin, Resolved, Settings};
use crate::store::{Key, Kind, Reader, Store};

/// Side of the atlas on which rungs are tried, where it holds the scene: nodes stand no denser there than in a larger one.
pub const SIDE: u32 = 128;

/// How exact the reference of a trial has to be: below the noise of which a target is not told from another.
const TRUTH: Exactness = Exactness { texels: 400, noise: 0.004, paths: 65_536 };

/// The least error that can be promised: the noise of the reference.
pub const LEAST: f64 = 0.005;

/// What was found for a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    pub rung: u32,
    /// Of the trial.
    pub score: Score,
    /// Estimated time of the light of the whole lightmap, where and when it was tried [s].
    pub seconds: f64,
    /// The target is reached.
    pub is_reached: bool,
}

impl Choice {
    /// The settings that it stands for.
    pub fn settings(&self, question: &Question) -> Settings {
        ladder::rung_keeping(question.base, self.rung, question.fixed)
    }

    /// Names and values of what differs from the settings of the question, as flags.
    pub fn flags(&self, question: &Question) -> String {
        let (base, chosen) = (question.base, self.settings(question));
        let differ = FIELDS.iter().filter(|f| (f.get)(&chosen) != (f.get)(base));
        differ.map(|f| format!("--{} {}", f.flag(), (f.get)(&chosen))).collect::<Vec<_>>().join(" ")
    }
}

/// Of which scene settings are wanted, and what is already decided.
#[derive(Clone, Copy)]
pub struct Question<'a> {
    pub scene: &'a Scene,
    pub base: &'a Settings,
    /// Settings that somebody chose, which stay as they are.
    pub fixed: &'a [&'static str],
    pub store: Option<&'a Store>,
}

/// The lowest rung whose error is below `target` (a share of the mean irradiance).
///
/// # Errors
/// As a bake, and for a target below [`LEAST`].
pub fn for_error(question: &Question, target: f64, progress: &dyn Progress) -> Result<Choice, Error> {
    if target < LEAST {
        let what = format!(
            "an error of {} % cannot be promised: below {} % it is not told from the noise of the reference",
            100.0 * target,
            100.0 * LEAST
        );
        return Err(Error::Target { what });
    }
    if let Some(choice) = known(question, target) {
        return Ok(choice);
    }
    let choice = ascend(question, "", progress, |point, _| {
        // Where there is no light, nothing is wrong with it.
        let is_enough = point.score.rmse_high <= target || point.score.mean <= 0.0;
        if is_enough { Verdict::Enough } else { Verdict::Higher { will_do: false } }
    })?;
    if let Some(store) = question.store {
        store.put(Kind::Choice, &key(question, target), |out| artefact::put_value(out, &choice));
    }
    Ok(choice)
}

/// What [`for_error`] found for this question before; nothing is tried.
pub fn known(question: &Question, target: f64) -> Option<Choice> {
    let read = |body: &mut Reader| artefact::body::<Choice>(body);
    question.store.and_then(|store| store.get(Kind::Choice, &key(question, target), read))
}

/// The highest rung whose light takes at most so many seconds on this `machine`.
///
/// # Errors
/// As a bake.
pub fn for_time(question: &Question, seconds: f64, machine: &str, progress: &dyn Progress) -> Result<Choice, Error> {
    ascend(question, machine, progress, |_, estimate| {
        if estimate <= seconds { Verdict::Higher { will_do: true } } else { Verdict::TooMuch }
    })
}

/// The settings of a scene with those in their place that keep its RMSE below `target`; none where nothing may be tried
/// and they are not known. What somebody chose by name stays as it is.
///
/// # Errors
/// As a bake, and where no settings keep it.
pub fn settings_for(
    path: &Path,
    resolved: Resolved,
    target: f64,
    (store, may_try): (&Store, bool),
    progress: &dyn Progress,
) -> Result<Option<Resolved>, Error> {
    let base = &resolved.settings;
    let fixed = &resolved.chosen()[..];
    let chosen = lab::on_threads(base, || {
        let scene = &lab::load(path, base, progress)?;
        let question = Question { scene, base, fixed, store: Some(store) };
        let choice = match may_try {
            true => Some(for_error(&question, target, progress)?),
            false => known(&question, target),
        };
        match choice {
            Some(choice) if !choice.is_reached => Err(unreached(target, &choice)),
            choice => Ok(choice.map(|choice| choice.settings(&question))),
        }
    })?;
    let origin = Origin::Target(format!("{} %", 100.0 * target));
    Ok(chosen.map(|chosen| resolved.changed(chosen, &origin)))
}

/// What is said of an error that no rung reaches.
pub fn unreached(target: f64, choice: &Choice) -> Error {
    let [target, rmse, most] = [target, choice.score.rmse, choice.score.rmse_high].map(|e| 100.0 * e);
    Error::Target {
        what: format!(
            "an error of {target:.2} % cannot be promised; the finest settings come to {rmse:.2} % (95 % confidence: \
             at most {most:.2} %)"
        ),
    }
}

/// What a rung means for the climb.
#[derive(Clone, Copy, PartialEq)]
enum Verdict {
    /// It will do.
    Enough,
    /// A higher one is wanted, should there be one.
    Higher { will_do: bool },
    /// The one below is the last that will do.
    TooMuch,
}

/// The settings of the trials: all light, on fronts, which is what the reference has.
fn tried(base: &Settings) -> Settings {
    Settings { only: Only::All, double_sided: DoubleSided::Front, ..base.clone() }
}

/// Digest of what a choice follows from.
fn key(question: &Question, target: f64) -> Key {
    // The atlas of the trials follows from the smallest one.
    let smallest = small::sized(&tried(question.base), question.base.size.0.min(SIDE));
    let digest = keys::versions(Digest::new("choice").double(target).bytes(&lab::identity(question.scene, &smallest)));
    let digest = question.fixed.iter().fold(digest, |digest, name| digest.text(name));
    keys::lasting(digest, question.base).done()
}

fn ascend(
    question: &Question,
    machine: &str,
    progress: &dyn Progress,
    judge: impl Fn(&Point, f64) -> Verdict,
) -> Result<Choice, Error> {
    let Question { scene, base, fixed, store } = *question;
    let Small { settings, atlas, report } = small::lay_out(scene, &tried(base), (SIDE, base.size.0), store, progress)?;
    Lab::with(scene, &settings, None, progress, |lab| {
        let texels = truth::texels(lab, &atlas, TRUTH.texels);
        let truth = truth::truth(lab, texels, (&TRUTH, "target"), store, progress)?;
        let measure = Measure::new(lab, &atlas, &truth, store, machine);
        let series: Series = series::together(&settings, fixed);
        progress.begin("trials", u64::from(RUNGS));
        let mut last: Option<Choice> = None;
        for (rung, attempt) in (0..).zip(&series.attempts) {
            if let Err(error) = memory::check(&attempt.needs(scene)) {
                return last.filter(|below| below.is_reached).ok_or(error);
            }
            let point = measure.point(&series, attempt, &Uncounted(progress))?;
            progress.advance(1);
            let seconds = estimate(&point, base, (report.density, settings.size.0));
            let choice = |is_reached| Choice { rung, score: point.score, seconds, is_reached };
            match judge(&point, seconds) {
                Verdict::Enough => return Ok(choice(true)),
                Verdict::Higher { will_do } => last = Some(choice(will_do)),
                Verdict::TooMuch => return Ok(last.unwrap_or_else(|| choice(false))),
            }
        }
        // The highest rung still fits into a time, or is still not exact enough.
        last.ok_or(Error::Cancelled)
    })
}

/// The time of the whole lightmap's light: what belongs to texels grows with their number, surfels stay as they are.
/// The trial's atlas has `density` texels per scene unit and `side` along a side.
fn estimate(point: &Point, base: &Settings, (density, side): (f64, u32)) -> f64 {
    let finer = match base.texel_density.0 {
        Some(wanted) if density > 0.0 => f64::from(wanted) / density,
        _ => f64::from(base.size.0) / f64::from(side),
    };
    point.seconds + point.texel_seconds * (finer * finer - 1.0)
}
