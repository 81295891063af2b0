//! The settings for an error or for a time: the practical question.
//!
//! The rungs of the [`ladder`](super::ladder) are tried from below, each at a few hundred texels against the reference: all
//! light, on fronts, on a small atlas before its seams are stitched. For an error, the first rung wins the upper end of
//! whose 95 % interval is below it (each rung that is tried may pass by chance, 2.5 % of them); that depends on scene and
//! settings alone, so it can be stored and a bake with it has the same bytes everywhere. For a time, the last rung wins
//! that fits into it on this machine; what belongs to texels counts as often as the lightmap has more of them than the
//! trial.

use std::path::Path;

use luxel_scene::{Progress, Scene, Uncounted};
use serde::{Deserialize, Serialize};

use super::keys;
use super::ladder::{self, RUNGS};
use super::measure::Measure;
use super::run::whole_light;
use super::series::{self, Series};
use super::truth::{self, Exactness};
use super::{Point, Score};
use crate::Error;
use crate::bake::artefact;
use crate::bake::digest::Digest;
use crate::bake::lab::{self, Lab};
use crate::bake::memory;
use crate::settings::{
    FIELDS, Origin, Resolved, Settings,
    value::{OrAuto, Texels},
};
use crate::store::{Key, Kind, Reader, Store};

/// Side of the atlas on which rungs are tried: nodes stand no denser there than in a larger one.
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
    trial(question, progress, |trials| {
        let (kept, key) = (question.store, key(trials, target));
        if let Some(choice) = kept.and_then(|store| store.get(Kind::Choice, &key, read)) {
            return Ok(choice);
        }
        let choice = ascend(trials, "", progress, |point, _| {
            if point.score.rmse_high <= target { Verdict::Enough } else { Verdict::Higher { will_do: false } }
        })?;
        if let Some(store) = kept {
            store.put(Kind::Choice, &key, |out| artefact::put_value(out, &choice));
        }
        Ok(choice)
    })
}

/// What [`for_error`] found for this question before; nothing is tried.
///
/// # Errors
/// When the work is cancelled.
pub fn known(question: &Question, target: f64, progress: &dyn Progress) -> Result<Option<Choice>, Error> {
    trial(question, progress, |trials| {
        Ok(question.store.and_then(|store| store.get(Kind::Choice, &key(trials, target), read)))
    })
}

fn read(body: &mut Reader) -> Result<Choice, String> {
    artefact::body(body)
}

/// The highest rung whose light takes at most so many seconds on this `machine`.
///
/// # Errors
/// As a bake.
pub fn for_time(question: &Question, seconds: f64, machine: &str, progress: &dyn Progress) -> Result<Choice, Error> {
    trial(question, progress, |trials| {
        ascend(trials, machine, progress, |_, estimate| {
            if estimate <= seconds { Verdict::Higher { will_do: true } } else { Verdict::TooMuch }
        })
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
            false => known(&question, target, progress)?,
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

/// Where rungs are tried.
struct Trials<'a> {
    question: &'a Question<'a>,
    lab: &'a Lab<'a>,
    /// The settings of the trials: all light, on a small atlas.
    small: &'a Settings,
}

fn trial<T>(
    question: &Question,
    progress: &dyn Progress,
    work: impl FnOnce(&Trials) -> Result<T, Error>,
) -> Result<T, Error> {
    let size = Texels(question.base.size.0.min(SIDE));
    let small = Settings { size, texel_density: OrAuto(None), ..whole_light(question.base) };
    Lab::with(question.scene, &small, None, progress, |lab| work(&Trials { question, lab, small: &small }))
}

/// Digest of what a choice follows from.
fn key(trials: &Trials, target: f64) -> Key {
    let digest = keys::versions(Digest::new("choice").double(target).bytes(&trials.lab.identity()));
    let digest = trials.question.fixed.iter().fold(digest, |digest, name| digest.text(name));
    keys::lasting(digest, trials.question.base).done()
}

fn ascend(
    trials: &Trials,
    machine: &str,
    progress: &dyn Progress,
    judge: impl Fn(&Point, f64) -> Verdict,
) -> Result<Choice, Error> {
    let Trials { question, lab, small } = trials;
    let (atlas, report) = lab::lay_out(question.scene, small, question.store, progress)?;
    let texels = truth::texels(lab, &atlas, TRUTH.texels);
    let truth = truth::truth(lab, texels, (&TRUTH, "target"), question.store, progress)?;
    let measure = Measure { lab, atlas: &atlas, truth: &truth, store: question.store, fresh: false, machine };
    let series: Series = series::together(small, question.fixed);
    progress.begin("trials", u64::from(RUNGS));
    let mut last: Option<Choice> = None;
    for (rung, attempt) in (0..).zip(&series.attempts) {
        memory::check(&attempt.needs(question.scene))?;
        let point = measure.point(&series, attempt, &Uncounted(progress))?;
        progress.advance(1);
        let seconds = estimate(&point, question.base, report.density);
        let choice = |is_reached| Choice { rung, score: point.score, seconds, is_reached };
        match judge(&point, seconds) {
            Verdict::Enough => return Ok(choice(true)),
            Verdict::Higher { will_do } => last = Some(choice(will_do)),
            Verdict::TooMuch => return Ok(last.unwrap_or_else(|| choice(false))),
        }
    }
    // The highest rung still fits into a time, or is still not exact enough.
    last.ok_or(Error::Cancelled)
}

/// The time of the whole lightmap's light: what belongs to texels grows with their number, surfels stay as they are.
/// `density` is that of the trial [texels per scene unit].
fn estimate(point: &Point, base: &Settings, density: f64) -> f64 {
    let finer = match base.texel_density.0 {
        Some(wanted) if density > 0.0 => f64::from(wanted) / density,
        _ => f64::from(base.size.0) / f64::from(base.size.0.min(SIDE)),
    };
    point.seconds + point.texel_seconds * (finer * finer - 1.0)
}
