//! Bounces (Piwowar & Malgouyres 2009, §3): the light of bounce i is all that bounce i + 1 propagates.
//!
//! ```text
//! currentCache ← direct irradiance
//! for each iteration
//!     cachePlus ← T(ρ · currentCache)          with half the directions of the iteration before
//!     globalCache += cachePlus
//!     swap(cachePlus, currentCache); clear(cachePlus)
//! ```
//!
//! Light gets weaker and smoother from bounce to bounce, so 512, 256, …, 16 directions cost a fifth of 512 throughout
//! and lose next to nothing; the first bounce decides. The sky enters with the first sweep, on lines that come from
//! nowhere.
//!
//! With q the ratio of the last two increments, q/(1−q)·|ΔE| is what is still to come: the iteration stops when that
//! is below the tolerance (|ΔE| itself is too small by 1/(1−q)), and adds it as a geometric tail in the shape of the
//! last increment. Where q is large, Anderson's acceleration solves for the
//! rest on a fixed set of directions.
//!
//! Irradiances in lux. Everything is linear in the light but for the decision when to stop.

mod enclosure;
mod refine;
pub mod stiff;

use std::borrow::Cow;

use glam::DVec3;
use luxel_scene::{Cancelled, Progress};

use crate::{
    Rgb,
    directions::{Direction, DirectionSet},
    ledger::{Ledger, Stage, flux},
    surfel::{Solution, Surfel, Surfels},
    sweep::{Rule, SkyFn, Sweep},
};

pub use enclosure::is_closed;
pub use refine::refine;

/// How light is propagated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveSettings {
    /// Directions of the first bounce.
    pub directions: u32,
    /// Factor by which every bounce has fewer directions than the one before it; 1 keeps their number.
    pub decay: f32,
    /// Directions of late bounces, at least.
    pub floor: u32,
    pub set: DirectionSet,
    pub rule: Rule,
    /// Remaining share of the indirect light at which bounces stop.
    pub tolerance: f64,
    /// Bounces, at most.
    pub max_bounces: u32,
    /// Ratio of increments above which the rest is solved for on a fixed set of directions; below it, bounces of
    /// `floor` directions are cheaper.
    pub stiff: f64,
    /// Directions of that fixed set.
    pub stiff_directions: u32,
    /// Nothing escapes ([`is_closed`]): lines from nowhere are unknown, and rows of the operator sum to 1, or to 0 where
    /// all lines are unknown. [`Rule::Literal`] knows nothing of this.
    pub closed: bool,
    /// Emission of surfels rides in a sweep of its own and is added to the direct light, for callers that bring no
    /// direct light of emissive surfaces.
    pub emit_in_sweep: bool,
    /// Directions of the sweep that measures row sums and escapes; 0 leaves it out.
    pub quality_directions: u32,
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self {
            directions: 512,
            decay: 2.0,
            floor: 16,
            set: DirectionSet::Fibonacci,
            rule: Rule::Surface,
            tolerance: 3e-4,
            max_bounces: 64,
            stiff: 0.7,
            stiff_directions: 128,
            closed: false,
            emit_in_sweep: false,
            quality_directions: 64,
        }
    }
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    #[error("{found} values of direct light for {expected} surfels")]
    Length { expected: usize, found: usize },
    #[error("the direct light of surfel {surfel} is {light}, not a finite irradiance")]
    BadDirect { surfel: usize, light: Rgb },
    #[error("the sky's radiance towards {direction} is {radiance}, not a finite radiance")]
    BadSky { direction: glam::Vec3, radiance: Rgb },
}

/// One sweep of the solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounce {
    pub directions: u32,
    /// Discrete rays: surfels × directions.
    pub rays: u64,
    /// Σ A·E of what it added, mean over the bands [lux × squared frame units].
    pub increment: f64,
}

/// How well the operator keeps light: the quality figure of a voxelization.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowSums {
    /// Area-weighted mean of T·1; what is missing to 1 was sky or was lost.
    pub mean: f64,
    /// Area-weighted mean share of sky seen.
    pub sky: f64,
    /// Least sum of both over all surfels.
    pub least: f32,
}

impl RowSums {
    /// Share of the light that is lost on the way, neither received nor escaped.
    pub fn defect(&self) -> f64 {
        1.0 - self.mean - self.sky
    }
}

/// What the solver did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SolveReport {
    /// Bands that were solved: 1 when everything is grey, 0 when there was nothing to do.
    pub bands: u32,
    pub bounces: Vec<Bounce>,
    /// Operator applications of the stiff solver, after the bounces.
    pub stiff_steps: u32,
    /// All discrete rays, those of the quality sweep included.
    pub discrete_rays: u64,
    /// Ratio of the last two increments.
    pub q: f64,
    /// Remaining share of the indirect light when the bounces stopped (added as the tail).
    pub tail: f64,
    /// None where the sweep that measures it was left out.
    pub rows: Option<RowSums>,
    pub ledger: Ledger,
}

impl SolveReport {
    /// Length of the light paths, direct light included; what the stiff solver adds has no bounded length.
    pub fn path_length(&self) -> usize {
        1 + self.bounces.len()
    }
}

/// Propagates direct light (and the sky's) until it has come to rest.
///
/// `direct` is the irradiance [lux] that the lights deposit at every surfel. Surfels' emission is not propagated (its
/// direct light is in `direct`) unless [`SolveSettings::emit_in_sweep`] says so.
///
/// # Errors
/// When the work is cancelled, when the lengths differ, or when a light is not finite or negative.
pub fn solve(
    surfels: &Surfels,
    direct: &[Rgb],
    settings: &SolveSettings,
    sky: Option<SkyFn>,
    progress: &dyn Progress,
) -> Result<(Solution, SolveReport), SolveError> {
    check(surfels, direct, settings, sky)?;
    progress.begin("propagate", planned_rays(surfels, settings));
    let sweep = Sweep::new(surfels, settings.rule, settings.closed);
    let grey = is_grey(surfels, direct, settings, sky);
    let mut bounces = Bounces {
        settings,
        sky,
        progress,
        sweep,
        grey,
        sky_seen: Vec::new(),
        stages: Vec::new(),
        report: SolveReport::default(),
    };
    // Copied at the end, when the sweep's memory is free again, unless it has to be changed.
    let mut direct = Cow::Borrowed(direct);
    if settings.emit_in_sweep {
        bounces.add_emission(direct.to_mut())?;
    }
    let dark = surfels.list.iter().zip(direct.iter()).all(|(s, e)| s.albedo() * *e == Rgb::ZERO);
    let mut global_cache = vec![Rgb::ZERO; surfels.list.len()];
    if !dark || sky.is_some() {
        bounces.report.bands = if grey { 1 } else { 3 };
        bounces.measure_rows()?;
        bounces.run(&direct, &mut global_cache)?;
    }
    let Bounces { mut report, stages, sweep, .. } = bounces;
    drop(sweep);
    report.ledger = Ledger::close(stages, surfels, &direct, &global_cache);
    debug_assert!(global_cache.iter().all(|e| e.is_finite() && e.min_element() >= 0.0));
    Ok((Solution { direct: direct.into_owned(), indirect: global_cache }, report))
}

fn check(surfels: &Surfels, direct: &[Rgb], settings: &SolveSettings, sky: Option<SkyFn>) -> Result<(), SolveError> {
    if direct.len() != surfels.list.len() {
        return Err(SolveError::Length { expected: surfels.list.len(), found: direct.len() });
    }
    let bad = |l: &Rgb| !l.is_finite() || l.min_element() < 0.0;
    if let Some(surfel) = direct.iter().position(bad) {
        return Err(SolveError::BadDirect { surfel, light: direct[surfel] });
    }
    if let Some(sky) = sky {
        for d in settings.set.directions(settings.directions, 1) {
            let radiance = sky(-d.sigma);
            if bad(&radiance) {
                return Err(SolveError::BadSky { direction: -d.sigma, radiance });
            }
        }
    }
    Ok(())
}

/// Everything has equal bands: one is enough.
fn is_grey(surfels: &Surfels, direct: &[Rgb], settings: &SolveSettings, sky: Option<SkyFn>) -> bool {
    let grey = |c: Rgb| c.x == c.y && c.y == c.z;
    let sky_is_grey =
        sky.is_none_or(|sky| settings.set.directions(settings.directions, 1).iter().all(|d| grey(sky(-d.sigma))));
    let emission_is_grey = !settings.emit_in_sweep || surfels.emission.iter().all(|e| grey(e.radiance));
    sky_is_grey && emission_is_grey && direct.iter().all(|&l| grey(l)) && surfels.list.iter().all(Surfel::is_grey)
}

/// The discrete rays of the bounces until the directions reach their floor: the guess of the progress bar.
fn planned_rays(surfels: &Surfels, settings: &SolveSettings) -> u64 {
    let halved = (0..8).map(|k| u64::from(directions_of(settings, k + 1))).sum::<u64>();
    surfels.list.len() as u64 * (halved + u64::from(settings.quality_directions))
}

fn directions_of(settings: &SolveSettings, bounce: u32) -> u32 {
    // Repeated division is exact for the usual factor of two, and the same on every machine for all others.
    let fewer = (1..bounce).fold(f64::from(settings.directions), |left, _| left / f64::from(settings.decay.max(1.0)));
    (fewer as u32).max(settings.floor.min(settings.directions)).max(1)
}

/// Steps of a share of sky: the ledger sums thousands of them.
const SKY_STEPS: f32 = 65535.0;

/// State of the iteration.
struct Bounces<'a> {
    settings: &'a SolveSettings,
    sky: Option<SkyFn<'a>>,
    progress: &'a dyn Progress,
    sweep: Sweep<'a>,
    grey: bool,
    /// Share of sky that each surfel sees, in [`SKY_STEPS`]; empty where it was not measured.
    sky_seen: Vec<u16>,
    stages: Vec<Stage>,
    report: SolveReport,
}

impl Bounces<'_> {
    fn surfels(&self) -> &Surfels {
        self.sweep.surfels()
    }

    /// B = ρE of reflected light.
    fn radiosity(&self, irradiance: &[Rgb]) -> Vec<Rgb> {
        self.surfels().list.iter().zip(irradiance).map(|(s, &e)| s.albedo() * e).collect()
    }

    /// The same in the memory of the irradiance.
    fn reflected(&self, mut irradiance: Vec<Rgb>) -> Vec<Rgb> {
        self.surfels().list.iter().zip(&mut irradiance).for_each(|(s, e)| *e *= s.albedo());
        irradiance
    }

    fn apply(
        &mut self,
        directions: &[Direction],
        radiosity: Vec<Rgb>,
        sky: Option<SkyFn>,
    ) -> Result<Vec<Rgb>, Cancelled> {
        self.report.discrete_rays += directions.len() as u64 * radiosity.len() as u64;
        self.sweep.apply(directions, radiosity, sky, self.grey, self.progress)
    }

    fn energy(&self, irradiance: &[Rgb]) -> f64 {
        flux(self.surfels(), |i| irradiance[i]).element_sum() / 3.0
    }

    fn add_emission(&mut self, direct: &mut [Rgb]) -> Result<(), Cancelled> {
        if self.surfels().emission.is_empty() {
            return Ok(());
        }
        let mut emitted = vec![Rgb::ZERO; direct.len()];
        for e in &self.surfels().emission {
            if let Some(b) = emitted.get_mut(e.surfel as usize) {
                *b = e.radiance * std::f32::consts::PI;
            }
        }
        let directions = self.settings.set.directions(self.settings.directions, 0);
        let arrived = self.apply(&directions, emitted, None)?;
        direct.iter_mut().zip(arrived).for_each(|(d, e)| *d += e);
        Ok(())
    }

    /// T·1 with open lines, and the share of sky.
    fn measure_rows(&mut self) -> Result<(), Cancelled> {
        let count = self.surfels().list.len();
        if self.settings.quality_directions == 0 || count == 0 {
            return Ok(());
        }
        let directions = self.settings.set.directions(self.settings.quality_directions, u32::MAX);
        let rows = row_sums(&self.sweep.opened(), &directions, self.progress)?;
        self.report.discrete_rays += directions.len() as u64 * count as u64;
        self.report.rows = Some(summary(self.surfels(), &rows));
        if !self.settings.closed {
            self.sky_seen = rows.iter().map(|r| (r.y.min(1.0) * SKY_STEPS).round() as u16).collect();
        }
        Ok(())
    }

    /// What the surfels send, before it arrives anywhere.
    fn sent(&self, radiosity: &[Rgb]) -> Stage {
        let surfels = self.surfels();
        let escaped = |i: usize| radiosity[i] * (f32::from(self.sky_seen[i]) / SKY_STEPS);
        Stage {
            sent: flux(surfels, |i| radiosity[i]),
            escaped: if self.sky_seen.is_empty() { DVec3::ZERO } else { flux(surfels, escaped) },
            ..Stage::default()
        }
    }

    /// The stage with what has arrived.
    fn arrived(&self, stage: Stage, irradiance: &[Rgb], with_sky: bool) -> Stage {
        let arrived = flux(self.surfels(), |i| irradiance[i]);
        // What the sky brings is not separated from what the surfels send in the same sweep, but by the balance.
        let sky = if with_sky { (arrived + stage.escaped - stage.sent).max(DVec3::ZERO) } else { DVec3::ZERO };
        let reflected = flux(self.surfels(), |i| self.surfels().list[i].albedo() * irradiance[i]);
        Stage { sky, arrived, reflected, ..stage }
    }

    fn run(&mut self, direct: &[Rgb], global_cache: &mut [Rgb]) -> Result<(), Cancelled> {
        let brightest = self.surfels().list.iter().fold(0.0f32, |m, s| m.max(s.albedo().max_element()));
        // Keeps 1 − q away from zero, whatever the caller's albedos.
        let brightest = brightest.min(luxel_scene::material::MAX_ALBEDO);
        let mut current_cache = Vec::new();
        let mut q = f64::from(brightest);
        for bounce in 1..=self.settings.max_bounces {
            let radiosity =
                if bounce == 1 { self.radiosity(direct) } else { self.reflected(std::mem::take(&mut current_cache)) };
            let sky = if bounce == 1 { self.sky } else { None };
            if sky.is_none() && radiosity.iter().all(|b| *b == Rgb::ZERO) {
                return Ok(());
            }
            let directions = self.settings.set.directions(directions_of(self.settings, bounce), bounce);
            let stage = self.sent(&radiosity);
            let cache_plus = self.apply(&directions, radiosity, sky)?;
            global_cache.iter_mut().zip(&cache_plus).for_each(|(g, p)| *g += *p);
            self.stages.push(self.arrived(stage, &cache_plus, sky.is_some()));
            let increment = self.energy(&cache_plus);
            if let Some(last) = self.report.bounces.last() {
                q = if last.increment > 0.0 { (increment / last.increment).min(f64::from(brightest)) } else { 0.0 };
            }
            let rays = directions.len() as u64 * cache_plus.len() as u64;
            self.report.bounces.push(Bounce { directions: directions.len() as u32, rays, increment });
            self.report.q = q;
            current_cache = cache_plus;
            let total = self.energy(global_cache);
            let remaining = q / (1.0 - q) * increment;
            self.report.tail = if total > 0.0 { remaining / total } else { 0.0 };
            if remaining <= self.settings.tolerance * total {
                break;
            }
            if bounce >= 3 && q > self.settings.stiff {
                return self.solve_stiff(current_cache, total, global_cache);
            }
        }
        // One bounce says nothing about the ratio of the series: then what was asked for is all there is.
        if self.report.bounces.len() > 1 {
            self.add_tail(&current_cache, q, global_cache);
        }
        Ok(())
    }

    /// The rest of the geometric series, in the shape of the last increment.
    fn add_tail(&mut self, last: &[Rgb], q: f64, global_cache: &mut [Rgb]) {
        let factor = q / (1.0 - q);
        global_cache.iter_mut().zip(last).for_each(|(g, e)| *g += *e * factor as f32);
        if let Some(last) = self.stages.last().copied() {
            self.stages.push(last.scaled(factor));
        }
    }

    fn solve_stiff(&mut self, current: Vec<Rgb>, total: f64, global_cache: &mut [Rgb]) -> Result<(), Cancelled> {
        // A set of its own, the same for all steps: the operator must not change under the iteration.
        let directions = self.settings.set.directions(self.settings.stiff_directions, u32::MAX - 1);
        let source = self.reflected(current);
        let (sweep, grey, progress) = (&self.sweep, self.grey, self.progress);
        let operator = |radiosity: &[Rgb]| sweep.apply(&directions, radiosity.to_vec(), None, grey, progress);
        let surfels = self.sweep.surfels();
        let reflectance = |i: usize| surfels.list[i].albedo();
        let mut rows = operator(&vec![Rgb::ONE; source.len()])?;
        if self.settings.closed && self.settings.rule == Rule::Surface {
            // Known light has a weight of 1 in all; a surfel that only unknown lines reach has none.
            rows.iter_mut().for_each(|row| *row = if row.x > 0.5 { Rgb::ONE } else { Rgb::ZERO });
        }
        let rows = rows.iter().any(|row| *row != Rgb::ONE).then_some(rows);
        let equation = stiff::Equation { surfels, reflectance: &reflectance, source: &source, rows: rows.as_deref() };
        let rest = stiff::solve(&equation, total, self.settings.tolerance, operator)?;
        // And that of the rows.
        self.report.stiff_steps = rest.steps + 1;
        self.report.discrete_rays += u64::from(self.report.stiff_steps) * directions.len() as u64 * source.len() as u64;
        global_cache.iter_mut().zip(&rest.irradiance).for_each(|(g, e)| *g += *e);
        self.stages.push(self.arrived(self.sent(&rest.radiosity), &rest.irradiance, false));
        self.report.tail = if total > 0.0 { rest.remaining / (total + self.energy(&rest.irradiance)) } else { 0.0 };
        Ok(())
    }
}

/// T·1 in the first band, the share of sky in the second.
///
/// # Errors
/// When the work is cancelled.
pub fn row_sums(sweep: &Sweep, directions: &[Direction], progress: &dyn Progress) -> Result<Vec<Rgb>, Cancelled> {
    let ones = vec![Rgb::X; sweep.surfels().list.len()];
    // Divided by π, because a sky of radiance L stands for the radiosity πL.
    let sky = |_| Rgb::Y / std::f32::consts::PI;
    sweep.apply(directions, ones, Some(&sky), false, progress)
}

fn summary(surfels: &Surfels, rows: &[Rgb]) -> RowSums {
    let area = surfels.area().max(f64::MIN_POSITIVE);
    let sums = flux(surfels, |i| rows[i]) / area;
    RowSums { mean: sums.x, sky: sums.y, least: rows.iter().fold(f32::INFINITY, |m, r| m.min(r.x + r.y)) }
}

#[cfg(test)]
mod tests;
