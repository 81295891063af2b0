//! The error of a finished lightmap, measured at some of its texels against the reference path tracer.
//!
//! | step | module | what |
//! |---|---|---|
//! | draw | [`sample`] | texels in proportion to their area, by a fixed pattern |
//! | trace | [`sample`] | what the reference says of them; paths are doubled until its noise is small |
//! | measure | [`score`] | RMSE, bias, percentiles, with 95 % confidence intervals |
//! | check | [`checks`] | overlap of charts, buried texels, leaks, energy balance, values that are no light |
//! | judge | [`gate`] | whether that is good enough |
//!
//! What is compared is what is written: texels of the finished lightmap, after dilation and stitching. The reference's
//! paths are doubled from [`FIRST`] until its noise (root mean square of the standard errors) is at most half of the
//! RMSE, or a quarter of the limit, or a thousandth of the mean irradiance; [`MOST`] paths are the most. What is left
//! of the noise is taken off the RMSE, and is in the intervals.
//!
//! With a limit, the RMSE passes where the upper end of its interval is not above it. Where the limit lies within the
//! interval, as many texels again are drawn and traced, up to [`GROWTH`] times those that were asked for. That is three
//! looks at most, at intervals that hold the RMSE as often as [`score`] says: 91 % of those of 100 texels, not 95 %.

pub mod checks;
pub mod gate;
pub mod sample;
pub mod score;

use luxel_export::report::{Check, EnergyStage, PartError, Verification};
use luxel_scene::{Progress, Scene, Uncounted};
use luxel_transport::{
    Rgb,
    direct::Visibility,
    gather::Receiver,
    lights::Emitters,
    rays::Rays,
    reference::{Options, Reference},
};

use crate::Error;
use crate::bake::direct_light;
use crate::settings::{DoubleSided, Only, Settings};
use sample::{Baked, Drawn, Holds, Population, walk};
pub use score::{Interval, Measure, Sample, measure, part, y};

/// Texels that are compared where nobody says how many.
pub const TEXELS: u32 = 400;

/// Paths of the first look, and at most, at each texel.
pub const FIRST: u32 = 256;
pub const MOST: u32 = 32_768;

/// Times the texels that were asked for that may be drawn where the limit lies within the interval.
pub const GROWTH: u64 = 4;

/// Noise that is small, as a share of the mean irradiance.
const QUIET: f64 = 1e-3;

/// The name of the work, for progress.
const WORK: &str = "verify";

/// Places that are named.
const WORST: usize = 5;

/// Seed of the draws.
const SEED: u64 = 0x7e81_f1ed;

/// What is wanted of a verification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verify {
    /// Texels to compare.
    pub texels: u32,
    /// The largest RMSE over the mean irradiance that passes; then all checks have to pass as well.
    pub max_error: Option<f64>,
}

impl Verify {
    /// Texels of the first look.
    fn fewest(&self) -> u64 {
        self.texels.max(1).into()
    }
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verified {
    pub verification: Verification,
    pub checks: Vec<Check>,
}

/// Whether the reference's noise is small enough for a limit, if there is one; all as shares of the mean irradiance.
pub(crate) fn is_quiet(noise: f64, rmse: f64, limit: Option<f64>) -> bool {
    noise <= (0.5 * rmse).max(0.25 * limit.unwrap_or(0.0)).max(QUIET)
}

/// Verifies a lightmap of the scene that `rays` are of, whose lights have their own strength.
///
/// # Errors
/// It was cancelled.
pub fn verify(
    rays: &Rays,
    baked: Baked,
    settings: &Settings,
    energy: &[EnergyStage],
    ask: &Verify,
    progress: &dyn Progress,
) -> Result<Verified, Error> {
    let holds = Holds { double_sided: settings.double_sided, only: settings.only };
    let population = Population::new(baked.atlas, |texel| baked.is_buried(texel));
    progress.begin(WORK, 0);
    // How many texels and paths it takes is found out on the way.
    let uncounted = &Uncounted(progress);
    let reference = Reference::new(rays, Options::default());
    let trial = Trial { rays, baked, holds, population, reference, progress: uncounted };
    let (mut verification, leaks) = match trial.nothing() {
        Some(why) => (Verification { nothing: Some(why), ..Verification::default() }, None),
        None => {
            let (found, samples) = trial.sampled(ask)?;
            let mut verification = trial.told(&found, &samples);
            (verification.direct, verification.indirect) = trial.parts(settings, &found)?;
            let leaks = checks::leaks(&trial, ask, &found, verification.mean_lux)?;
            verification.probed = leaks.probed;
            (verification, Some(leaks))
        }
    };
    verification.asked = ask.texels.into();
    verification.available = trial.population.len() as u64;
    let scene = rays.geometry.scene;
    let mut list = vec![checks::uv_overlap(scene, &baked, progress)?, checks::buried(&baked)];
    list.extend(leaks.map(|leaks| leaks.check()));
    list.extend(checks::energy(energy));
    list.push(checks::values(&baked));
    Ok(Verified { verification, checks: list })
}

/// A lightmap before its reference.
pub(crate) struct Trial<'a> {
    rays: &'a Rays<'a>,
    baked: Baked<'a>,
    holds: Holds,
    population: Population,
    reference: Reference<'a>,
    progress: &'a dyn Progress,
}

/// Texels that were compared.
pub(crate) struct Found {
    drawn: Vec<Drawn>,
    /// Texels that were drawn, those that could not be compared included.
    asked: u64,
    paths: u32,
}

impl Trial<'_> {
    /// Why nothing can be compared.
    fn nothing(&self) -> Option<String> {
        let scene = self.rays.geometry.scene;
        // Where there are charts and no texel that can be compared, nothing is known of their light.
        if self.baked.atlas.charts.is_empty() {
            return Some("no surface has texels".into());
        }
        let is_dark = Emitters::new(self.rays.geometry).is_empty() && scene.sky.is_dark();
        is_dark.then(|| "the scene has no light".into())
    }

    /// Draws and traces texels until the request is answered.
    fn sampled(&self, ask: &Verify) -> Result<(Found, Vec<Sample>), Error> {
        let mut found = Found { drawn: Vec::new(), asked: 0, paths: 0 };
        self.draw(&mut found, ask.fewest())?;
        loop {
            let samples = self.samples(&found);
            let Measure { noise, rmse, .. } = measure(&samples);
            if !is_quiet(noise, rmse.value, ask.max_error) && found.paths < MOST {
                // As many again: the estimate of all of them is that of twice the paths.
                let paths = found.paths;
                self.trace(&mut found.drawn, paths, u64::from(paths))?;
                found.paths += paths;
                continue;
            }
            let is_open = ask.max_error.is_some_and(|limit| rmse.low <= limit && rmse.high > limit);
            let more = found.asked;
            let is_all = found.asked >= self.population.len() as u64;
            if !is_open || is_all || found.asked + more > GROWTH * ask.fewest() {
                return Ok((found, samples));
            }
            self.draw(&mut found, more)?;
        }
    }

    /// Draws texels and brings them to the paths that the others have.
    fn draw(&self, found: &mut Found, count: u64) -> Result<(), Error> {
        // Where all are drawn, those that were drawn before are among them.
        let all = self.population.len() as u64;
        let takes_all = found.asked + count >= all;
        if takes_all {
            found.drawn.clear();
            found.asked = 0;
        }
        let count = if takes_all { all } else { count };
        let texels = self.population.draw(count as usize, SEED + found.asked);
        let mut drawn = Drawn::all(self.baked.atlas, self.rays, texels, self.holds);
        self.trace(&mut drawn, found.paths.max(FIRST), SEED + found.asked)?;
        found.paths = found.paths.max(FIRST);
        found.asked += count;
        found.drawn.extend(drawn);
        Ok(())
    }

    fn trace(&self, drawn: &mut [Drawn], paths: u32, round: u64) -> Result<(), Error> {
        walk(&self.reference, drawn, (paths, round), self.progress)
    }

    fn samples(&self, found: &Found) -> Vec<Sample> {
        found.drawn.iter().map(|d| d.sample(&self.baked, self.holds)).collect()
    }

    /// The measure of the samples, for the report.
    fn told(&self, found: &Found, samples: &[Sample]) -> Verification {
        let m = measure(samples);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        let error = |i: &usize| (samples[*i].found - samples[*i].expected).length_squared();
        order.sort_by(|a, b| error(b).total_cmp(&error(a)));
        let place = |i: &usize| self.baked.place(self.rays.geometry.scene, found.drawn[*i].texel, samples[*i].expected);
        Verification {
            drawn: found.asked,
            texels: samples.len() as u64,
            paths: found.paths.into(),
            mean_lux: m.mean,
            rmse: m.rmse.value,
            rmse_low: m.rmse.low,
            rmse_high: m.rmse.high,
            bias: m.bias.value,
            bias_low: m.bias.low,
            bias_high: m.bias.high,
            median: m.median.value,
            median_low: m.median.low,
            median_high: m.median.high,
            p95: m.p95.value,
            p95_low: m.p95.low,
            p95_high: m.p95.high,
            rel_mse: m.rel_mse,
            reference_noise: m.noise,
            worst: order.iter().take(WORST).map(place).collect(),
            ..Verification::default()
        }
    }

    /// The error of direct light and of the rest: the bake's own direct light is computed again at the texels that were
    /// compared, and what else they hold is the rest, which so has what finishing changed.
    fn parts(&self, settings: &Settings, found: &Found) -> Result<(Option<PartError>, Option<PartError>), Error> {
        if self.holds != (Holds { double_sided: DoubleSided::Front, only: Only::All }) {
            return Ok((None, None));
        }
        let receivers: Vec<Receiver> = found.drawn.iter().map(|d| d.front).collect();
        let emitters = Emitters::new(self.rays.geometry);
        let direct: Vec<Rgb> = if emitters.is_empty() {
            vec![Rgb::ZERO; receivers.len()]
        } else {
            direct_light(self.rays, &emitters, settings, Visibility::Shafts, &Uncounted(self.progress), |direct| {
                Ok(direct.gather(&receivers, &Uncounted(self.progress))?)
            })?
            .into_iter()
            .map(|gathered| gathered.irradiance)
            .collect()
        };
        let mean = measure(&self.samples(found)).mean;
        let sample = |i: usize, is_direct: bool| {
            let (d, all) = (&found.drawn[i], self.baked.value(found.drawn[i].texel));
            let e = d.expected(self.holds);
            let (light, expected, error) = match is_direct {
                true => (direct[i], e.direct, e.direct_error),
                false => (all - direct[i], e.indirect, e.indirect_error),
            };
            Sample { found: light, expected, band_error: Rgb::splat(error), error, weight: d.weight }
        };
        let told = |is_direct: bool| {
            let samples: Vec<Sample> = (0..receivers.len()).map(|i| sample(i, is_direct)).collect();
            let ((rmse, bias), own) = (part(&samples, mean), measure(&samples).mean);
            PartError { mean_lux: own, rmse, bias }
        };
        Ok((Some(told(true)), Some(told(false))))
    }
}

/// Verifies a lightmap of a scene in memory, as it came from [`crate::bake_scene`].
///
/// # Errors
/// It was cancelled.
pub fn verify_lit(
    scene: &Scene,
    lit: &crate::Lit,
    settings: &Settings,
    ask: &Verify,
    progress: &dyn Progress,
) -> Result<Verified, Error> {
    let geometry = luxel_transport::geometry::Geometry::new(scene);
    let rays = Rays::build(&geometry, progress)?;
    let baked = Baked { atlas: &lit.atlas, lightmaps: &lit.lightmaps };
    verify(&rays, baked, settings, lit.energy_stages(), ask, progress)
}
