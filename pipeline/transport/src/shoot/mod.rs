//! First light on the surfels: what the lights send out, before any reflection.
//!
//! Two ways with the same result: [`exact`] evaluates the closed forms of [`crate::direct`] at a point of a real
//! triangle of every surfel, but for lamps that almost touch a surface ([`close`]); [`photons`] is the paper's own way (Piwowar & Malgouyres 2009, §3), photons by ray
//! tracing that stop at the first surface, and converges to it with the square root of their number.

pub mod close;
pub(crate) mod dome;
pub(crate) mod emission;
pub mod exact;
pub mod photons;

use glam::DVec3;

use crate::Rgb;

pub use close::close;
pub use exact::exact;
pub use photons::{PhotonSettings, photons};

/// Direct irradiance of every surfel, and what it took.
#[derive(Clone, Debug, Default)]
pub struct Shot {
    /// E [lux], in the order of the surfels.
    pub irradiance: Vec<Rgb>,
    /// Points on the lights from which photons started.
    pub primary_photons: u64,
    /// Photons that arrived on a surfel.
    pub arrived_photons: u64,
    /// Rays traced.
    pub rays: u64,
    pub ledger: Flux,
}

/// Where the luminous flux of the photons went [lm]; all zero for [`exact`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flux {
    pub emitted: DVec3,
    /// Arrived on surfels.
    pub deposited: DVec3,
    /// Left the scene.
    pub escaped: DVec3,
    /// Absorbed by the backs of single-sided surfaces, by veils, and by the distance windows of lamps.
    pub absorbed: DVec3,
    /// Arrived where no surfel was found.
    pub lost: DVec3,
}

impl Flux {
    /// Emitted less everything that is accounted for: rounding only.
    pub fn imbalance(&self) -> DVec3 {
        self.emitted - self.deposited - self.escaped - self.absorbed - self.lost
    }

    fn add(&mut self, other: &Flux) {
        self.emitted += other.emitted;
        self.deposited += other.deposited;
        self.escaped += other.escaped;
        self.absorbed += other.absorbed;
        self.lost += other.lost;
    }

    fn scaled(&self, by: f64) -> Self {
        Self {
            emitted: self.emitted * by,
            deposited: self.deposited * by,
            escaped: self.escaped * by,
            absorbed: self.absorbed * by,
            lost: self.lost * by,
        }
    }
}

#[cfg(test)]
mod tests;
