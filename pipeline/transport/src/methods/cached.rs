//! The cached voxel solution shown directly, as the paper's display of its caches: the irradiance of the surfel in the
//! receiver's voxel that looks to the receiver's side, direct and indirect, as it is. No ray, no interpolation: what is
//! seen are the voxels.
//!
//! In a voxel without such a surfel (a sliver that carries no area) the nearest one of the neighbours that looks to the
//! same side answers; where there is none either, nothing does. [`Cached::count`] tells how often.

use luxel_scene::{Cancelled, Progress};

use super::{Light, Method};
use crate::gather::{Field, Receiver};

/// Receivers between two looks at the progress.
const BREATH: usize = 1024;

/// Reads the light of surfels.
pub struct Cached<'a> {
    field: &'a Field<'a>,
}

/// Whose light receivers got.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// That of the surfel in their own voxel.
    pub own: usize,
    /// That of one in a voxel next to it.
    pub neighbour: usize,
    /// Nobody's: they are dark.
    pub nobody: usize,
}

impl<'a> Cached<'a> {
    pub fn new(field: &'a Field<'a>) -> Self {
        Self { field }
    }

    /// How many receivers got the light of their own surfel, of a neighbour, and none.
    pub fn count(&self, receivers: &[Receiver]) -> Count {
        let mut count = Count::default();
        for receiver in receivers {
            let voxel = self.field.index.voxel(receiver.position);
            match self.find(receiver) {
                Some(surfel) if self.field.surfels.list[surfel].voxel() == voxel => count.own += 1,
                Some(_) => count.neighbour += 1,
                None => count.nobody += 1,
            }
        }
        count
    }

    fn find(&self, receiver: &Receiver) -> Option<usize> {
        self.field.index.find(receiver.position, receiver.normal)
    }

    fn at(&self, receiver: &Receiver) -> Light {
        let solution = self.field.solution;
        let light = |i: usize| Light { direct: solution.direct[i], indirect: solution.indirect[i], ..Light::default() };
        self.find(receiver).map_or(Light::default(), light)
    }
}

impl Method for Cached<'_> {
    fn light(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Light>, Cancelled> {
        let mut light = Vec::with_capacity(receivers.len());
        for part in receivers.chunks(BREATH) {
            progress.check()?;
            light.extend(part.iter().map(|receiver| self.at(receiver)));
            progress.advance(part.len() as u64);
        }
        Ok(light)
    }
}
