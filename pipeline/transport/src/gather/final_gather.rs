//! Final gather: cosine-distributed rays that look up the cache where they hit.
//!
//! ```text
//! E = ∫ L cos θ dω = (1/N) Σᵢ B(hitᵢ)      directions with density cos θ/π, L = B/π
//! ```
//!
//! Free of the voxels' own bias but for what the cache says at the hits; noise falls faster than 1/√N, since the
//! directions are a lattice. The cosine is the shading normal's; rays below the geometric horizon bring nothing.

use luxel_scene::{Cancelled, Progress};

use super::{Field, Gather, Gathered, Receiver, hemisphere::Hemisphere, run};
use crate::{Rgb, rays::OFFSET};

/// Gathers with a fixed number of rays a receiver.
pub struct FinalGather<'a> {
    field: &'a Field<'a>,
    hemisphere: Hemisphere,
}

impl<'a> FinalGather<'a> {
    /// `rays` a receiver, at least one; 64 to 1024 are sensible.
    pub fn new(field: &'a Field<'a>, rays: u32) -> Self {
        Self { field, hemisphere: Hemisphere::new(rays.max(1)) }
    }

    fn at(&self, receiver: &Receiver) -> Gathered {
        let (irradiance, _, rays) = collect(self.field, &self.hemisphere, receiver, |_| Rgb::ZERO);
        Gathered { irradiance, bound: 0.0, rays, cut: 0 }
    }
}

impl Gather for FinalGather<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        run::each(receivers, progress, || (), |(), receiver| self.at(receiver))
    }
}

/// Irradiance from surfaces, irradiance from `sky` (a radiance by direction), and the rays spent.
pub(super) fn collect(
    field: &Field,
    hemisphere: &Hemisphere,
    receiver: &Receiver,
    sky: impl Fn(glam::Vec3) -> Rgb,
) -> (Rgb, Rgb, u32) {
    let origin = receiver.position + receiver.normal * OFFSET;
    let (mut surfaces, mut beyond, mut rays) = (Rgb::ZERO, Rgb::ZERO, 0);
    for direction in hemisphere.about(receiver.shading_normal, receiver.seed).directions() {
        if receiver.normal.dot(direction) <= 0.0 {
            continue;
        }
        let (radiosity, open, spent) = field.radiosity(origin, direction);
        surfaces += radiosity;
        if open != Rgb::ZERO {
            beyond += open * sky(direction) * std::f32::consts::PI;
        }
        rays += spent;
    }
    let scale = 1.0 / hemisphere.len() as f32;
    (surfaces * scale, beyond * scale, rays)
}
