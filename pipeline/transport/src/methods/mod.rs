//! Ways to find the light at a point, side by side: the comparators of the paper's Figure 3.
//!
//! | method | module | light that surfaces reflect | its own error estimate |
//! |---|---|---|---|
//! | path tracing | [`path_tracing`] | walks from the receiver ([`crate::reference`]) | standard error |
//! | random sample voxels | [`random_voxels`] | two sets of surfels, drawn by chance (paper §4.1) | their difference |
//! | cached voxels | [`cached`] | the surfel of the receiver itself, nothing else | none |
//! | reconstruction | [`reconstruction`] | any [`Gather`](crate::gather::Gather) | none |
//!
//! Reconstruction stands for photon mapping ([`crate::gather::PhotonMap`]), for the voxel solution with lightcuts
//! ([`crate::gather::Lightcuts`]), and for the final gather. A [`crate::gather::Lookup`] already contains the sky: it goes
//! with a [`Straight`] that has none.
//!
//! All find the same two parts of the irradiance, as the reference defines them: *direct* light comes straight from
//! lamps, suns and emitters, *indirect* light has been reflected at least once, or comes from the sky.

pub mod cached;
pub mod path_tracing;
pub mod random_voxels;
pub mod reconstruction;

pub use cached::Cached;
pub use path_tracing::PathTracing;
pub use random_voxels::RandomVoxels;
pub use reconstruction::{Reconstruction, Straight};

use luxel_scene::{Cancelled, Progress};

use crate::{Rgb, gather::Receiver};

/// What a method finds at a receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// Irradiance straight from lamps, suns and emitters [lux].
    pub direct: Rgb,
    /// Irradiance after at least one reflection, and from the sky [lux].
    pub indirect: Rgb,
    /// Estimated standard error of the band mean of both together [lux]; none where the method states none.
    pub error: Option<f32>,
    /// Continuous rays spent on this receiver.
    pub rays: u32,
}

impl Light {
    /// All light [lux].
    pub fn total(&self) -> Rgb {
        self.direct + self.indirect
    }
}

/// A way to find the light at receivers. Implementations are pure: the same receivers give the same bits, on any number
/// of threads.
pub trait Method: Sync {
    /// The light at every receiver, in their order. Reports one unit of progress per receiver of a stage that the caller
    /// has begun.
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled>;

    /// The same with so many random draws for every receiver (walks, passes of sample voxels), whatever number the method
    /// was made for. Where nothing is drawn for a receiver, their number changes nothing.
    fn drawn(&self, receivers: &[Receiver], _draws: u32, progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        self.light(receivers, progress)
    }
}

#[cfg(test)]
mod tests;
