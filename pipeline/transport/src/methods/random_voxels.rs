//! Reflected light by random sample voxels, everything straight exactly; with the error that the two sets show.
//!
//! Progressive: [`VoxelSamples::add`] continues the tallies of receivers by further passes, and [`RandomVoxels::finish`]
//! makes light of what they have.

use luxel_scene::{Cancelled, Progress};

use super::{Light, Method, Straight};
use crate::gather::{Receiver, VoxelSamples, voxel_samples::Tally};

/// Finds light by [`VoxelSamples`], with as many passes as those were made for.
pub struct RandomVoxels<'a> {
    pub straight: Straight<'a>,
    pub samples: &'a VoxelSamples<'a>,
}

impl RandomVoxels<'_> {
    /// The light of receivers whose reflected light is in these tallies.
    ///
    /// # Errors
    /// When the work is cancelled.
    pub fn finish(
        &self,
        receivers: &[Receiver],
        tallies: &[Tally],
        progress: &dyn Progress,
    ) -> Result<Vec<Light>, Cancelled> {
        let reflected = |tally: &Tally| Light {
            indirect: tally.irradiance(),
            error: Some(tally.error()).filter(|error| error.is_finite()),
            rays: tally.rays(),
            ..Light::default()
        };
        let mut light: Vec<Light> = tallies.iter().map(reflected).collect();
        self.straight.add(&mut light, receivers, progress)?;
        Ok(light)
    }
}

impl Method for RandomVoxels<'_> {
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let tallies = self.samples.tallies(receivers, progress)?;
        self.finish(receivers, &tallies, progress)
    }

    fn drawn(&self, receivers: &[Receiver], passes: u32, progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let mut tallies = vec![Tally::default(); receivers.len()];
        self.samples.add(receivers, &mut tallies, passes, progress)?;
        self.finish(receivers, &tallies, progress)
    }
}
