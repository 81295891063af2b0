//! Path tracing with a fixed number of walks a receiver: the left column of the paper's Figure 3.

use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{Light, Method};
use crate::{gather::Receiver, reference::Reference};

/// Finds light by walks.
pub struct PathTracing<'a> {
    tracer: &'a Reference<'a>,
    paths: u32,
}

impl<'a> PathTracing<'a> {
    /// So many walks a receiver.
    pub fn new(tracer: &'a Reference<'a>, paths: u32) -> Self {
        Self { tracer, paths }
    }

    fn at(&self, receiver: &Receiver, paths: u32) -> Light {
        let estimate = self.tracer.irradiance(receiver, paths);
        // One walk alone knows nothing about its error.
        let error = Some(estimate.standard_error).filter(|error| error.is_finite());
        let rays = u32::try_from(estimate.rays).unwrap_or(u32::MAX);
        Light { direct: estimate.direct, indirect: estimate.indirect, error, rays }
    }
}

impl Method for PathTracing<'_> {
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        self.drawn(receivers, self.paths, progress)
    }

    fn drawn(&self, receivers: &[Receiver], paths: u32, progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let one = |receiver| {
            progress.check()?;
            let light = self.at(receiver, paths);
            progress.advance(1);
            Ok(light)
        };
        receivers.par_iter().map(one).collect()
    }
}
