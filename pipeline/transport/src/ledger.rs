//! The energy ledger: where the light of a bake went, band by band, in f64.
//!
//!   shot + sky = absorbed + escaped + in flight + imbalance
//!
//! `shot` is what the lights deposit on surfels (direct irradiance × area), `sky` what the sky adds in the sweep,
//! `absorbed` the share 1 − ρ of all that arrived, `escaped` what was reflected into the sky, `in flight` what was
//! reflected last and not propagated any more. That is a residual with a sign: the tail continues all bands by one
//! factor, so a band that was dying away faster is given more than it sent, and its `in flight` is below 0. The sweep
//! adds the sky's light to that of surfels in one sum, so `sky` is known by the balance of the first sweep only (cut
//! off at 0): that sweep's own imbalance is in it, and is all of it where no surfel sees the sky. A gather that divides
//! by known weight is not exactly symmetric; what it gains or loses is the `imbalance`. All are fluxes:
//! irradiance [lux] × area, in lumens once the areas are in squared metres ([`Ledger::scaled`]).

use glam::DVec3;

use crate::{Rgb, surfel::Surfels};

/// Energy of one sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stage {
    /// What the surfels sent out.
    pub sent: DVec3,
    /// The part of it that left the scene.
    pub escaped: DVec3,
    /// What the sky added.
    pub sky: DVec3,
    /// What arrived at surfels.
    pub arrived: DVec3,
    /// The part of that which they reflect.
    pub reflected: DVec3,
}

impl Stage {
    /// Light that the sweep lost (positive) or made (negative).
    pub fn imbalance(&self) -> DVec3 {
        self.sent + self.sky - self.escaped - self.arrived
    }

    /// Every flux times a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            sent: self.sent * factor,
            escaped: self.escaped * factor,
            sky: self.sky * factor,
            arrived: self.arrived * factor,
            reflected: self.reflected * factor,
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ledger {
    pub shot: DVec3,
    pub sky: DVec3,
    pub absorbed: DVec3,
    pub escaped: DVec3,
    pub in_flight: DVec3,
    pub imbalance: DVec3,
    /// Sweep by sweep: the bounces, then the solver's own, or the tail that was added for the rest.
    pub stages: Vec<Stage>,
}

/// Σ A·E over all surfels.
pub fn flux(surfels: &Surfels, light: impl Fn(usize) -> Rgb) -> DVec3 {
    surfels.list.iter().enumerate().map(|(i, s)| f64::from(s.area) * light(i).as_dvec3()).sum()
}

impl Ledger {
    /// Closes the books: `direct` and `indirect` irradiance are all that ever arrived.
    pub fn close(stages: Vec<Stage>, surfels: &Surfels, direct: &[Rgb], indirect: &[Rgb]) -> Self {
        let total = |i: usize| direct[i] + indirect[i];
        let shot = flux(surfels, |i| direct[i]);
        let absorbed = flux(surfels, |i| (Rgb::ONE - surfels.list[i].albedo()) * total(i));
        let reflected = flux(surfels, |i| surfels.list[i].albedo() * total(i));
        let sum = |part: fn(&Stage) -> DVec3| stages.iter().map(part).sum::<DVec3>();
        let (sky, escaped) = (sum(|s| s.sky), sum(|s| s.escaped));
        let in_flight = reflected - sum(|s| s.sent);
        let imbalance = shot + sky - absorbed - escaped - in_flight;
        Self { shot, sky, absorbed, escaped, in_flight, imbalance, stages }
    }

    /// The same books in other units of area: the factor is `1 / frame.scale²` for squared scene units.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            shot: self.shot * factor,
            sky: self.sky * factor,
            absorbed: self.absorbed * factor,
            escaped: self.escaped * factor,
            in_flight: self.in_flight * factor,
            imbalance: self.imbalance * factor,
            stages: self.stages.iter().map(|stage| stage.scaled(factor)).collect(),
        }
    }
}
