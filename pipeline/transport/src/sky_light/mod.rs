//! Light of the sky at receivers.
//!
//!   E = ∫ L(ω) V(ω) cos θ dω  ≈  π/N Σ Lᵢ Vᵢ      ωᵢ cosine-distributed about the shading normal
//!
//! The directions are a rank-1 lattice shifted by the receiver's seed, so that a constant sky without anything in
//! its way gives πL exactly. An image with small bright spots (a sun in an HDRI) is split in two: what lies below a
//! multiple of the mean is sampled as above, the excess by its own distribution (`spots`); both estimates are
//! unbiased and neither has a spike.

mod spots;

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use luxel_scene::{Cancelled, Progress, Sky};
use rayon::prelude::*;

use crate::{
    Rgb,
    gather::{Gather, Gathered, Receiver},
    rays::{OFFSET, Rays},
    sampling,
};
use spots::Spots;

/// Receivers per unit of parallel work.
const CHUNK: usize = 64;

#[derive(Clone, Copy, Debug)]
pub struct SkySettings {
    /// Cosine-distributed rays per receiver.
    pub rays: u32,
    /// Rays per receiver towards the bright spots of an image, if it has any.
    pub spot_rays: u32,
}

impl Default for SkySettings {
    fn default() -> Self {
        Self { rays: 256, spot_rays: 64 }
    }
}

/// Gathers light straight from the sky.
pub struct SkyLight<'a> {
    rays: &'a Rays<'a>,
    sky: &'a Sky,
    spots: Option<Spots>,
    settings: SkySettings,
    /// Generator of the lattice of directions.
    generator: u32,
}

impl<'a> SkyLight<'a> {
    pub fn new(rays: &'a Rays<'a>, settings: SkySettings) -> Self {
        let sky = &rays.geometry.scene.sky;
        let settings = SkySettings { rays: settings.rays.clamp(1, 1 << 20), ..settings };
        let spots = match sky {
            Sky::Image(image) if settings.spot_rays > 0 => Spots::new(image),
            _ => None,
        };
        Self { rays, sky, spots, settings, generator: generator(settings.rays) }
    }

    /// The sky has bright spots that are gathered by themselves.
    pub fn has_spots(&self) -> bool {
        self.spots.is_some()
    }

    /// Irradiance at one receiver, and rays spent.
    pub fn irradiance(&self, r: &Receiver) -> (Rgb, u32) {
        if self.sky.is_dark() {
            return (Rgb::ZERO, 0);
        }
        let (smooth, a) = self.smooth(r);
        let (bright, b) = self.spots.as_ref().map_or((Rgb::ZERO, 0), |s| self.bright(s, r));
        let e = smooth + bright;
        debug_assert!(e.is_finite() && e.min_element() >= 0.0);
        (e, a + b)
    }

    /// The sky without its spots, by cosine-distributed rays.
    fn smooth(&self, r: &Receiver) -> (Rgb, u32) {
        let n = self.settings.rays;
        let basis = sampling::basis(r.shading_normal);
        let origin = r.position + r.normal * OFFSET;
        let shift = sampling::unit2(sampling::mix(r.seed));
        let (mut sum, mut rays) = (DVec3::ZERO, 0);
        for i in 0..n {
            let lattice = Vec2::new(i as f32 + 0.5, (u64::from(i) * u64::from(self.generator) % u64::from(n)) as f32);
            let p = lattice / n as f32 + shift;
            let direction = basis * sampling::cosine_hemisphere((p - p.floor()).min(Vec2::splat(1.0 - f32::EPSILON)));
            if r.normal.dot(direction) <= 0.0 {
                continue;
            }
            let radiance = self.sky.radiance(direction);
            let radiance = self.spots.as_ref().map_or(radiance, |s| radiance - s.excess(radiance));
            if radiance.max_element() > 0.0 {
                rays += 1;
                sum += (radiance * self.rays.transmittance(origin, direction, f32::INFINITY)).as_dvec3();
            }
        }
        ((sum * f64::from(PI) / f64::from(n)).as_vec3(), rays)
    }

    /// What the spots add.
    fn bright(&self, spots: &Spots, r: &Receiver) -> (Rgb, u32) {
        let n = self.settings.spot_rays;
        let origin = r.position + r.normal * OFFSET;
        let seed = sampling::combine(r.seed, 1);
        let (shift, jitter) = (sampling::unit2(seed), sampling::unit(sampling::mix(seed)));
        let (mut sum, mut rays) = (DVec3::ZERO, 0);
        for i in 0..n {
            let stratum = (i as f32 + jitter) / n as f32;
            let (direction, density) = spots.sample(stratum, sampling::r2(i, shift));
            let cosine = r.cosine(direction);
            let excess = spots.excess(self.sky.radiance(direction));
            if cosine > 0.0 && excess.max_element() > 0.0 {
                rays += 1;
                let pass = self.rays.transmittance(origin, direction, f32::INFINITY);
                sum += (excess * pass * cosine).as_dvec3() / density;
            }
        }
        ((sum / f64::from(n)).as_vec3(), rays)
    }
}

impl Gather for SkyLight<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        gather(receivers, progress, |r| self.irradiance(r))
    }
}

/// The smooth part of a sky: it varies slowly over surfaces, so that it may be gathered at nodes.
pub struct Smooth<'a>(pub &'a SkyLight<'a>);

impl Gather for Smooth<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        gather(receivers, progress, |r| if self.0.sky.is_dark() { (Rgb::ZERO, 0) } else { self.0.smooth(r) })
    }
}

/// The bright spots of a sky: they cast sharp shadows, so that they are gathered everywhere.
pub struct Bright<'a>(pub &'a SkyLight<'a>);

impl Gather for Bright<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        gather(receivers, progress, |r| self.0.spots.as_ref().map_or((Rgb::ZERO, 0), |spots| self.0.bright(spots, r)))
    }
}

fn gather(
    receivers: &[Receiver],
    progress: &dyn Progress,
    light: impl Fn(&Receiver) -> (Rgb, u32) + Sync,
) -> Result<Vec<Gathered>, Cancelled> {
    let chunks = receivers.par_chunks(CHUNK).map(|chunk| {
        progress.check()?;
        let gathered = chunk.iter().map(|r| {
            let (irradiance, rays) = light(r);
            Gathered { irradiance, rays, ..Gathered::default() }
        });
        let gathered: Vec<_> = gathered.collect();
        progress.advance(chunk.len() as u64);
        Ok(gathered)
    });
    Ok(chunks.collect::<Result<Vec<_>, Cancelled>>()?.into_iter().flatten().collect())
}

/// A generator near N divided by the golden ratio and prime to N: a lattice without long empty strips.
fn generator(n: u32) -> u32 {
    let gcd = |mut a: u32, mut b: u32| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let golden = (f64::from(n) * 0.618_033_988_749_895) as u32;
    (golden.max(1)..=n).find(|&g| gcd(g, n) == 1).unwrap_or(1)
}

/// Unit direction of the sky seen at continuous image coordinates, the inverse of the image's projection.
pub(crate) fn image_direction(uv: Vec2, rotation: f32) -> Vec3 {
    let azimuth = (uv.x - 0.5) * std::f32::consts::TAU - rotation;
    let polar = uv.y * PI;
    let s = libm::sinf(polar);
    Vec3::new(s * libm::sinf(azimuth), libm::cosf(polar), -s * libm::cosf(azimuth))
}

#[cfg(test)]
mod tests;
