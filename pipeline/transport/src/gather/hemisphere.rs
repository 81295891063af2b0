//! Cosine-distributed directions about a normal: a Fibonacci lattice on the unit disc, lifted to the hemisphere
//! (Nusselt), turned and shifted for each receiver by its seed.
//!
//! Point i of N has squared radius (i + ξ)/N and azimuth 2π(i/φ + ζ): one stratum of equal form factor each. The table
//! holds the azimuths, so that a direction costs two square roots and no transcendental function.

use std::f64::consts::TAU;

use glam::{Mat3, Vec2, Vec3};

use crate::sampling::{basis, mix, unit};

/// The lattice for one number of rays.
pub(super) struct Hemisphere {
    azimuths: Vec<Vec2>,
}

/// The lattice as one receiver sees it.
pub(super) struct Turned<'a> {
    azimuths: &'a [Vec2],
    turn: Vec2,
    shift: f32,
    frame: Mat3,
}

impl Hemisphere {
    pub fn new(rays: u32) -> Self {
        // 1/φ, the most irrational of all turns.
        let golden = 0.5 * (5.0f64.sqrt() - 1.0);
        let azimuth = |i: u32| {
            let turns = f64::from(i) * golden;
            let angle = TAU * (turns - turns.floor());
            Vec2::new(libm::cos(angle) as f32, libm::sin(angle) as f32)
        };
        Self { azimuths: (0..rays).map(azimuth).collect() }
    }

    pub fn len(&self) -> u32 {
        self.azimuths.len() as u32
    }

    /// The lattice about `normal`, turned and shifted by `seed`.
    pub fn about(&self, normal: Vec3, seed: u64) -> Turned<'_> {
        let angle = std::f32::consts::TAU * unit(mix(seed));
        let turn = Vec2::new(libm::cosf(angle), libm::sinf(angle));
        Turned { azimuths: &self.azimuths, turn, shift: unit(mix(seed ^ 0x5bd1_e995)), frame: basis(normal) }
    }
}

impl Turned<'_> {
    pub fn directions(&self) -> impl Iterator<Item = Vec3> + '_ {
        let scale = 1.0 / self.azimuths.len() as f32;
        self.azimuths.iter().enumerate().map(move |(i, azimuth)| {
            let square = ((i as f32 + self.shift) * scale).min(1.0 - f32::EPSILON);
            let disc = azimuth.rotate(self.turn) * square.sqrt();
            (self.frame * disc.extend((1.0 - square).sqrt())).normalize()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_integrates_polynomials_over_the_cosine() {
        let n = Vec3::new(1.0, -2.0, 0.5).normalize();
        let lattice = Hemisphere::new(1024);
        for seed in 0..20 {
            let d: Vec<Vec3> = lattice.about(n, seed).directions().collect();
            assert!(d.iter().all(|d| d.is_normalized() && d.dot(n) > 0.0));
            let mean = d.iter().sum::<Vec3>() / 1024.0;
            // The mean of cos θ under cos θ/π is 2/3; sideways everything cancels.
            assert!(mean.abs_diff_eq(n * (2.0 / 3.0), 2e-3), "{mean}");
            let square = d.iter().map(|d| d.dot(n).powi(2)).sum::<f32>() / 1024.0;
            assert!((square - 0.5).abs() < 1e-3, "{square}");
        }
    }

    #[test]
    fn a_half_space_holds_its_share_of_the_cosine() {
        // A plane tilted by γ from the tangent plane cuts (1 + cos γ)/2 out of the hemisphere's form factor.
        let lattice = Hemisphere::new(4096);
        for degrees in [10.0f32, 45.0, 80.0] {
            let gamma = degrees.to_radians();
            let horizon = Vec3::new(libm::sinf(gamma), 0.0, libm::cosf(gamma));
            let above = lattice.about(Vec3::Z, 5).directions().filter(|d| d.dot(horizon) > 0.0).count();
            let expected = 0.5 * (1.0 + libm::cosf(gamma));
            assert!((above as f32 / 4096.0 - expected).abs() < 3e-3, "{degrees}");
        }
    }
}
