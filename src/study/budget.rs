//! The settings for an error or for a time: the practical question.
//!
//! The rungs of the [`ladder`](super::ladder) are tried from below, each at a few hundred texels against the reference. For an
//! error, the first rung wins whose RMSE is below it with a certainty of 97.5 %; that depends on scene and settings
//! alone, so it can be stored and a bake with it has the same bytes everywhere. For a time, the last rung wins that
//! fits into it on this machine; what belongs to texels counts as often as the lightmap has more of them than the trial.

use std::path::Path;
use std::sync::Arc;

use luxel_atlas::Atlas;
use luxel_scene::{Progress, Scene, Uncounted};
use serde::{Deserialize, Serialize};

use super::ladder::{self, RUNGS};
use super::measure::Measure;
use super::series::{self, Series};
use super::truth::{self, Exactness, Truth};
use super::{Point, Score};
use crate::Error;
use crate::bake::artefact;
use crate::bake::digest::Digest;
use crate::bake::lab::{self, Lab};
use crate::plan::Stage;
use crate::settings::{FIELDS, LightGroups, Origin, Resolved, Settings, value::Texels};
use crate::store::{Kind, Reader, Store};

/// Side of the atlas on which rungs are tried: nodes stand no denser there than in a larger one.
const SIDE: u32 = 128;

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
    /// Estimated time of the light of the whole lightmap on this machine [s].
    pub seconds: f64,
    /// The target is reached.
    pub is_reached: bool,
}

impl Choice {
    /// The settings that it stands for.
    pub fn settings(&self, base: &Settings) -> Settings {
        ladder::rung(base, self.rung)
    }

    /// Names and values of what differs from `base`, as flags.
    pub fn flags(&self, base: &Settings) -> String {
        let chosen = self.settings(base);
        let differ = FIELDS.iter().filter(|f| (f.get)(&chosen) != (f.get)(base));
        differ.map(|f| format!("--{} {}", f.flag(), (f.get)(&chosen))).collect::<Vec<_>>().join(" ")
    }
}

/// The lowest rung whose error is below `target` (a share of the mean irradiance).
///
/// # Errors
/// As a bake, and for a target below [`LEAST`].
pub fn for_error(
    scene: &Scene,
    base: &Settings,
    target: f64,
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Choice, Error> {
    if target < LEAST {
        let what = format!(
            "an error of {} % cannot be promised: below {} % it is not told from the noise of the reference",
            100.0 * target,
            100.0 * LEAST
        );
        return Err(Error::Target { what });
    }
    climb(scene, base, (&format!("error {target}"), store), progress, |point, _| {
        if point.score.rmse_high <= target { Verdict::Enough } else { Verdict::Higher { will_do: false } }
    })
}

/// The highest rung whose light takes at most so many seconds here. Nothing of it is stored but measurements.
///
/// # Errors
/// As a bake.
pub fn for_time(
    scene: &Scene,
    base: &Settings,
    seconds: f64,
    store: Option<&Store>,
    progress: &dyn Progress,
) -> Result<Choice, Error> {
    climb(scene, base, ("", store), progress, |_, estimate| {
        if estimate <= seconds { Verdict::Higher { will_do: true } } else { Verdict::TooMuch }
    })
}

/// The settings of a scene with those in their place that keep its RMSE below `target`.
///
/// # Errors
/// As a bake, and where no settings keep it.
pub fn settings_for(
    path: &Path,
    resolved: Resolved,
    target: f64,
    store: &Store,
    progress: &dyn Progress,
) -> Result<Resolved, Error> {
    let base = &resolved.settings;
    let choice = lab::on_threads(base, || {
        let scene = lab::load(path, base, progress)?;
        for_error(&scene, base, target, Some(store), progress)
    })?;
    if !choice.is_reached {
        return Err(unreached(target, &choice));
    }
    let chosen = choice.settings(base);
    Ok(resolved.changed(chosen, &Origin::Target(format!("{} %", 100.0 * target))))
}

/// What is said of an error that no rung reaches.
pub fn unreached(target: f64, choice: &Choice) -> Error {
    let [target, rmse, most] = [target, choice.score.rmse, choice.score.rmse_high].map(|e| 100.0 * e);
    Error::Target {
        what: format!(
            "an error of {target:.2} % cannot be promised; the finest settings come to {rmse:.2} % (below {most:.2} % \
             with a certainty of 97.5 %)"
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

/// Tries rung after rung. Under a name that is not empty the choice is stored.
fn climb(
    scene: &Scene,
    base: &Settings,
    (name, store): (&str, Option<&Store>),
    progress: &dyn Progress,
    judge: impl Fn(&Point, f64) -> Verdict,
) -> Result<Choice, Error> {
    let small = Settings { size: Texels(base.size.0.min(SIDE)), light_groups: LightGroups::One, ..base.clone() };
    Lab::with(scene, &small, None, progress, |lab| {
        let digest = Digest::new("choice").number(super::VERSION).text(name).bytes(&lab.identity());
        let digest = Stage::ALL.into_iter().fold(digest, Digest::version);
        let told = FIELDS.iter().filter(|field| crate::bake::matters(field.name));
        let key = told.fold(digest, |digest, field| digest.setting(base, field.name)).done();
        let read = |body: &mut Reader| artefact::body::<Choice>(body);
        let kept = store.filter(|_| !name.is_empty());
        if let Some(choice) = kept.and_then(|store| store.get(Kind::Choice, &key, read)) {
            return Ok(choice);
        }
        let (atlas, _) = lab::lay_out(scene, &small, progress)?;
        let texels = truth::texels(lab, &atlas, TRUTH.texels);
        let truth = truth::truth(lab, &atlas, texels, &TRUTH, store, progress)?;
        let choice =
            ascend(&Trials { lab, atlas: &atlas, truth: &truth, store, small: &small, base }, progress, judge)?;
        if let Some(store) = kept {
            store.put(Kind::Choice, &key, |out| artefact::put_value(out, &choice));
        }
        Ok(choice)
    })
}

/// Where rungs are tried.
struct Trials<'a> {
    lab: &'a Lab<'a>,
    atlas: &'a Arc<Atlas>,
    truth: &'a Truth,
    store: Option<&'a Store>,
    small: &'a Settings,
    base: &'a Settings,
}

fn ascend(trials: &Trials, progress: &dyn Progress, judge: impl Fn(&Point, f64) -> Verdict) -> Result<Choice, Error> {
    let Trials { lab, atlas, truth, store, small, base } = trials;
    let measure = Measure { lab, atlas, truth, store: *store, fresh: false };
    let series: Series = series::together(small);
    progress.begin("trials", u64::from(RUNGS));
    let mut last: Option<Choice> = None;
    for (rung, attempt) in (0..).zip(&series.attempts) {
        let point = measure.point(&series, attempt, &Uncounted(progress))?;
        progress.advance(1);
        let seconds = estimate(&point, base, small);
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
fn estimate(point: &Point, base: &Settings, small: &Settings) -> f64 {
    let ratio = f64::from(base.size.0) / f64::from(small.size.0);
    point.seconds + point.texel_seconds * (ratio * ratio - 1.0).max(0.0)
}
