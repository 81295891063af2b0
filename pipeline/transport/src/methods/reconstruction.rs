//! Reconstruction: reflected light by any gather, and exactly what comes straight from lights and sky.

use luxel_scene::{Cancelled, Progress, Uncounted};

use super::{Light, Method};
use crate::{
    gather::{Gather, Gathered, Receiver},
    sky_light::{Bright, SkyLight, Smooth},
};

/// Light that nothing has reflected: the same for all methods but path tracing, so that they differ in what they are
/// compared for.
#[derive(Clone, Copy, Default)]
pub struct Straight<'a> {
    /// From lamps, suns and emitters; none where there are none.
    pub lights: Option<&'a dyn Gather>,
    pub sky: Option<&'a SkyLight<'a>>,
}

impl Straight<'_> {
    /// Adds this light to that of every receiver.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn add(&self, light: &mut [Light], receivers: &[Receiver], progress: &dyn Progress) -> Result<(), Cancelled> {
        let uncounted = &Uncounted(progress);
        if let Some(lights) = self.lights {
            for (sum, found) in light.iter_mut().zip(lights.gather(receivers, uncounted)?) {
                sum.direct += found.irradiance;
                sum.rays = sum.rays.saturating_add(found.rays);
            }
        }
        let Some(sky) = self.sky else { return Ok(()) };
        let mut add = |found: Vec<Gathered>| {
            for (sum, found) in light.iter_mut().zip(found) {
                sum.indirect += found.irradiance;
                sum.rays = sum.rays.saturating_add(found.rays);
            }
        };
        add(Smooth(sky).gather(receivers, uncounted)?);
        if sky.has_spots() {
            add(Bright(sky).gather(receivers, uncounted)?);
        }
        Ok(())
    }
}

/// Reflected light by a gather that leaves out what comes straight from the sky, and everything straight exactly.
pub struct Reconstruction<'a> {
    pub straight: Straight<'a>,
    pub reflected: &'a dyn Gather,
}

impl Method for Reconstruction<'_> {
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let reflected = self.reflected.gather(receivers, progress)?;
        let part = |g: Gathered| Light { indirect: g.irradiance, rays: g.rays, ..Light::default() };
        let mut light: Vec<Light> = reflected.into_iter().map(part).collect();
        self.straight.add(&mut light, receivers, progress)?;
        Ok(light)
    }
}
