//! Reflected light by random sample voxels, everything straight exactly; with the error that the two sets show.
//!
//! Progressive by receivers of their own: passes of a picture have other points and seeds, and their means are blended.

use luxel_scene::{Cancelled, Progress};

use super::{Light, Method, Straight};
use crate::gather::{Receiver, VoxelSamples, voxel_samples::Tally};

/// Finds light by [`VoxelSamples`], with as many passes as those were made for.
pub struct RandomVoxels<'a> {
    pub straight: Straight<'a>,
    pub samples: &'a VoxelSamples<'a>,
}

impl Method for RandomVoxels<'_> {
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        self.drawn(receivers, self.samples.passes(), progress)
    }

    fn drawn(&self, receivers: &[Receiver], passes: u32, progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let reflected = |tally: &Tally| Light {
            indirect: tally.irradiance(),
            error: Some(tally.error()).filter(|error| error.is_finite()),
            rays: tally.rays(),
            ..Light::default()
        };
        let tallies = self.samples.tallies(receivers, passes, progress)?;
        let mut light: Vec<Light> = tallies.iter().map(reflected).collect();
        self.straight.add(&mut light, receivers, progress)?;
        Ok(light)
    }
}
