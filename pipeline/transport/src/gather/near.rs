//! The near field of point lights that stand for patches: what a bounded kernel leaves out, by cosine rays (Kollig &
//! Keller 2004).
//!
//! ```text
//! E = Σⱼ Iⱼ·min(G, b)·V  +  (1/N) Σᵢ Bᵢ·wᵢ        G = cos θ cos θ′/r², b = 1/(3h)²
//!     lights, no spikes     rays with density cos θ/π,  wᵢ = max(0, 1 − b/Gᵢ) at their hits
//! ```
//!
//! The two parts of the kernel add up to G for any b, so the sum is as exact as lights (size h, I = B·A/π) and the
//! radiosity B at the hits are.

use glam::Vec3;

use super::{Receiver, hemisphere::Hemisphere, surfaces::Encounter};
use crate::{Rgb, rays::OFFSET};

/// Kernel bound in patch sizes: nearer than three of them a patch is no point light.
const NEAR: f32 = 3.0;

/// The bound b [1/squared frame units] of the kernel for patches of a size [frame units].
pub(super) fn cap(size: f32) -> f32 {
    1.0 / (NEAR * size * (NEAR * size))
}

/// Rays about receivers.
pub(super) struct NearField {
    hemisphere: Hemisphere,
}

/// One of them.
pub(super) struct NearRay {
    pub origin: Vec3,
    pub direction: Vec3,
    /// At the receiver's shading normal.
    cosine: f32,
}

/// What the near rays saw, as means over all of them.
#[derive(Default)]
pub(super) struct Near {
    /// Irradiance [lux] as rays alone would have it.
    pub irradiance: Rgb,
    /// Σ B·w, Σ w and Σ πLₑ·w, divided by the number of rays.
    pub reflected: Rgb,
    pub weight: Rgb,
    pub emitted: Rgb,
    /// Every ray ended on a solid surface that is known.
    pub covered: bool,
    pub rays: u32,
}

impl NearField {
    /// So many rays a receiver, at least one.
    pub fn new(rays: u32) -> Self {
        Self { hemisphere: Hemisphere::new(rays.max(1)) }
    }

    /// Means of what `ray` adds for every ray of a receiver above its horizon; `seed` turns the rays.
    pub fn look(&self, receiver: &Receiver, seed: u64, mut ray: impl FnMut(&mut Near, &NearRay)) -> Near {
        let origin = receiver.position + receiver.normal * OFFSET;
        let mut near = Near { covered: true, ..Near::default() };
        for direction in self.hemisphere.about(receiver.shading_normal, seed).directions() {
            if receiver.normal.dot(direction) <= 0.0 {
                continue;
            }
            ray(&mut near, &NearRay { origin, direction, cosine: receiver.shading_normal.dot(direction) });
        }
        let scale = 1.0 / self.hemisphere.len() as f32;
        near.irradiance *= scale;
        near.reflected *= scale;
        near.weight *= scale;
        near.emitted *= scale;
        near
    }
}

impl NearRay {
    /// The weights w of a surface for kernels with these bounds.
    pub fn excess<const N: usize>(&self, e: &Encounter, caps: [f32; N]) -> [f32; N] {
        let kernel = self.cosine * e.cosine / (e.distance * e.distance);
        caps.map(|cap| (1.0 - cap / kernel).max(0.0))
    }
}

impl Near {
    /// Adds the light that a surface reflects; returns the radiosity that is seen of it.
    pub fn reflect(&mut self, e: &Encounter, weight: f32) -> Rgb {
        let radiosity = e.share * e.radiosity;
        self.irradiance += radiosity;
        self.reflected += radiosity * weight;
        self.weight += e.share * weight;
        radiosity
    }

    /// Adds the light that a surface emits.
    pub fn emit(&mut self, e: &Encounter, weight: f32) {
        let emission = e.share * e.emission;
        self.irradiance += emission;
        self.emitted += emission * weight;
    }
}
