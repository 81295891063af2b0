//! The reference: irradiance by path tracing, with its standard error. Every approximation is measured against it.
//!
//! The irradiance of a receiver at x is
//!
//!   E(x) = ∫ L(x, ω) cos θ dω,   L = Σₖ T₁…T₍ₖ₋₁₎ cₖ [Lₑ + ρ E(y)/π]ₖ + T₁T₂… · L_sky
//!
//! over the surfaces k that a ray meets (T coloured transmittance, c coverage, Lₑ emitted radiance [cd/m²], ρ albedo).
//! It is estimated by random walks: at every vertex a direction in proportion to cos θ/π, and *next-event estimation*
//! of emitters, lamps and image skies, both weighted by the power heuristic where both can find the same light (Veach &
//! Guibas 1995). A walk goes on from one of the surfaces that its ray met, chosen in proportion to what they
//! reflect; Russian roulette ends it. Nothing is clipped or left out: the estimate is unbiased, except that shadow rays
//! take less than a millionth of the light for none.
//!
//! Conventions: *direct* light comes straight from lamps, suns and emitters, veils in between or not; *indirect* light
//! has been reflected at least once, or comes from the sky. Single-sided backs absorb. Lamps and suns are no geometry:
//! only next events find them.
//!
//! Error: a receiver's samples are split into [`BATCHES`] batches, each a randomly shifted lattice in the dimensions of
//! its first vertex, seeded by [`Receiver::seed`] alone. The batches are independent, so the standard error is that of
//! the mean of their means (Student's t with `BATCHES − 1` degrees of freedom). Sums are f64, in a fixed order.

mod emitters;
mod lamps;
mod noise;
mod overlap;
mod path;
pub(crate) mod sky;

use glam::DVec3;
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{Rgb, gather::Receiver, rays::Rays};
use emitters::Emitters;
use lamps::Lamp;
use noise::Noise;
use sky::SkyMap;

/// Independent estimates of each receiver; less where there are fewer samples.
pub const BATCHES: u32 = 32;

/// What the reference leaves out, for comparisons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Reflections after which light is no longer followed; None follows it to the end.
    pub bounces: Option<u32>,
    /// Aims at emitters and image skies; without it only random directions find them. Lamps are aimed at anyway.
    pub next_event: bool,
    /// Ends walks by Russian roulette; without it only [`Options::bounces`] and [`LONGEST`] do.
    pub roulette: bool,
}

/// Reflections of a walk that nothing else ends: what is left of albedo 0.999 is then a ten-thousandth.
pub const LONGEST: u32 = 9_000;

impl Default for Options {
    fn default() -> Self {
        Self { bounces: None, next_event: true, roulette: true }
    }
}

/// Estimated irradiance [lux] and its standard errors [lux].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Straight from lamps, suns and emitters.
    pub direct: Rgb,
    /// After at least one reflection, and from the sky.
    pub indirect: Rgb,
    /// `direct + indirect`.
    pub total: Rgb,
    /// Standard error of the band mean of `total`; infinite when there is but one sample.
    pub standard_error: f32,
    /// Standard error of every band of `total`.
    pub band_error: Rgb,
    /// Standard errors of the band means of the two parts.
    pub direct_error: f32,
    pub indirect_error: f32,
    /// Continuous rays spent: those of the walks, and those of next events.
    pub rays: u64,
}

/// The path tracer of a scene.
pub struct Reference<'a> {
    rays: &'a Rays<'a>,
    options: Options,
    emitters: Emitters,
    lamps: Vec<Lamp>,
    sky: Option<SkyMap>,
}

impl<'a> Reference<'a> {
    pub fn new(rays: &'a Rays<'a>, options: Options) -> Self {
        let scene = rays.geometry.scene;
        Self {
            rays,
            options,
            emitters: Emitters::new(rays.geometry),
            lamps: scene.lights.iter().map(|light| Lamp::new(light, &rays.geometry.frame)).collect(),
            sky: SkyMap::new(&scene.sky),
        }
    }

    /// Irradiance at a receiver by `samples` walks, at least one, dealt to the batches as evenly as it goes. A receiver without
    /// a place or a normal, as on a degenerate triangle, receives nothing.
    pub fn irradiance(&self, receiver: &Receiver, samples: u32) -> Estimate {
        let usable =
            receiver.position.is_finite() && receiver.normal.is_normalized() && receiver.shading_normal.is_normalized();
        if !usable {
            return Estimate::default();
        }
        let batches = BATCHES.min(samples).max(1);
        let length = |batch| (samples / batches + u32::from(batch < samples % batches)).max(1);
        let means: Vec<Light> = (0..batches).map(|batch| self.batch(receiver, batch, length(batch))).collect();
        Estimate::of(&means)
    }

    /// [`Reference::irradiance`] at many receivers, in their order, on all threads.
    pub fn irradiances(
        &self,
        receivers: &[Receiver],
        samples: u32,
        progress: &dyn Progress,
    ) -> Result<Vec<Estimate>, Cancelled> {
        progress.begin("reference", receivers.len() as u64);
        let one = |receiver| {
            progress.check()?;
            let estimate = self.irradiance(receiver, samples);
            progress.advance(1);
            Ok(estimate)
        };
        receivers.par_iter().map(one).collect()
    }

    /// The mean of one batch of walks.
    fn batch(&self, receiver: &Receiver, batch: u32, length: u32) -> Light {
        let mut noise = Noise::new(receiver.seed, batch);
        let mut scratch = Vec::new();
        let mut sum = Light::default();
        for i in 0..length {
            noise.start(i);
            let light = self.walk(receiver, &mut noise, &mut scratch);
            sum.direct += light.direct;
            sum.indirect += light.indirect;
            sum.rays += light.rays;
        }
        let scale = 1.0 / f64::from(length);
        Light { direct: sum.direct * scale, indirect: sum.indirect * scale, ..sum }
    }
}

/// Irradiance [lux] in its two parts, and the rays that it took.
#[derive(Clone, Copy, Debug, Default)]
struct Light {
    direct: DVec3,
    indirect: DVec3,
    rays: u64,
}

impl Estimate {
    fn of(means: &[Light]) -> Self {
        let direct = Statistic::of(means.iter().map(|m| m.direct));
        let indirect = Statistic::of(means.iter().map(|m| m.indirect));
        let total = Statistic::of(means.iter().map(|m| m.direct + m.indirect));
        Self {
            direct: direct.mean.as_vec3(),
            indirect: indirect.mean.as_vec3(),
            total: total.mean.as_vec3(),
            standard_error: total.error as f32,
            band_error: total.band_error.as_vec3(),
            direct_error: direct.error as f32,
            indirect_error: indirect.error as f32,
            rays: means.iter().map(|m| m.rays).sum(),
        }
    }
}

/// Mean of independent values, and the standard error of it: √(Σ(x − x̄)²/(n(n − 1))).
struct Statistic {
    mean: DVec3,
    band_error: DVec3,
    /// Of the mean over the bands.
    error: f64,
}

impl Statistic {
    fn of(values: impl Iterator<Item = DVec3> + Clone) -> Self {
        let n = values.clone().count() as f64;
        let mean = values.clone().sum::<DVec3>() / n;
        let (mut bands, mut all) = (DVec3::ZERO, 0.0);
        for d in values.map(|x| x - mean) {
            bands += d * d;
            all += (d.element_sum() / 3.0) * (d.element_sum() / 3.0);
        }
        // One value says nothing about its error.
        let scale = if n > 1.0 { 1.0 / (n * (n - 1.0)) } else { f64::INFINITY };
        let error = |sum: f64| if n > 1.0 { (sum * scale).sqrt() } else { f64::INFINITY };
        Self { mean, band_error: DVec3::new(error(bands.x), error(bands.y), error(bands.z)), error: error(all) }
    }
}

#[cfg(test)]
mod tests;
