//! The sky as a light that shoots: directions by radiance.
//!
//! A direction ω has density p(ω) [1/sr] and brings the share L(ω)/p(ω), whose mean is ∫ L dω. p is constant under an
//! even sky, linear in the sine of the elevation under a gradient (as its band mean is), and that of the texels of an
//! image ([`SkyMap`]).

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec2, Vec3};
use luxel_scene::Sky;

use crate::{
    Rgb,
    reference::sky::SkyMap,
    sampling::{linear, r2, sphere},
};

/// Directions over which ∫ L dω is summed up; only what is dealt to the sky depends on it.
const PROBES: u32 = 4096;

/// A sky that is not dark.
pub(crate) struct Dome<'a> {
    sky: &'a Sky,
    by: By,
    total: DVec3,
}

/// How directions are chosen.
enum By {
    Evenly,
    /// Band means of horizon, zenith and ground.
    Elevation([f32; 3]),
    Texels(SkyMap),
}

impl<'a> Dome<'a> {
    /// The seed of its photons.
    pub const IDENTITY: u64 = 0x736b_7900;

    /// None where no light comes from the sky.
    pub fn new(sky: &'a Sky) -> Option<Self> {
        let by = match sky {
            _ if sky.is_dark() => return None,
            Sky::None | Sky::Constant(_) => By::Evenly,
            Sky::Gradient { zenith, horizon, ground } => {
                By::Elevation([horizon, zenith, ground].map(|l| l.max(Rgb::ZERO).element_sum() / 3.0))
            }
            Sky::Image(_) => By::Texels(SkyMap::new(sky)?),
        };
        let mut dome = Self { sky, by, total: DVec3::ZERO };
        dome.total = (0..PROBES).map(|i| dome.sample(r2(i, Vec2::splat(0.5))).1).sum::<DVec3>() / f64::from(PROBES);
        Some(dome)
    }

    /// ∫ L dω [lux, if all of it fell upright].
    pub fn total(&self) -> DVec3 {
        self.total
    }

    /// A unit direction towards the sky by a point of the unit square, and L/p [cd/m² · sr].
    pub fn sample(&self, p: Vec2) -> (Vec3, DVec3) {
        let (direction, density) = match &self.by {
            By::Evenly => (sphere(p), 0.25 / PI),
            By::Elevation(means) => by_elevation(*means, p),
            By::Texels(map) => match map.sample([f64::from(p.x), f64::from(p.y)]) {
                Some(found) => found,
                None => return (Vec3::Y, DVec3::ZERO),
            },
        };
        let radiance = self.sky.radiance(direction).max(Rgb::ZERO).as_dvec3();
        (direction, if density > 0.0 { radiance / density } else { DVec3::ZERO })
    }
}

/// A direction with density proportional to the band mean of a gradient, and that density.
fn by_elevation([horizon, zenith, ground]: [f32; 3], p: Vec2) -> (Vec3, f64) {
    let above = (horizon + zenith) / (2.0 * horizon + zenith + ground);
    let (end, x, sign) = match p.x < above {
        true => (zenith, p.x / above, 1.0),
        false => (ground, (p.x - above) / (1.0 - above), -1.0),
    };
    let sine = linear(horizon, end, x);
    let level = sphere(Vec2::new(0.5 * (1.0 - sign * sine), p.y));
    let mean = f64::from(horizon + (end - horizon) * sine);
    // Up is +Y here, and +Z there.
    (Vec3::new(level.x, level.z, level.y), mean / (TAU * 0.5 * f64::from(2.0 * horizon + zenith + ground)))
}

#[cfg(test)]
mod tests {
    use luxel_scene::sky::SkyImage;

    use super::*;

    fn skies() -> Vec<Sky> {
        let texels =
            (0..32 * 16).map(|i| if i == 100 { Vec3::splat(300.0) } else { Vec3::new(1.0, 2.0, 0.5) }).collect();
        vec![
            Sky::Constant(Vec3::new(1.0, 2.0, 3.0)),
            Sky::Gradient { zenith: Vec3::X * 5.0, horizon: Vec3::ONE, ground: Vec3::Z * 0.2 },
            Sky::Gradient { zenith: Vec3::ZERO, horizon: Vec3::ZERO, ground: Vec3::ONE },
            Sky::Image(SkyImage { width: 32, height: 16, texels, rotation: 0.4, strength: 2.0 }),
        ]
    }

    /// ∫ f L dω for a few test functions f, by even directions and by the dome's own.
    #[test]
    fn the_shares_of_directions_integrate_the_sky() {
        let tests: [fn(Vec3) -> f64; 3] = [|_| 1.0, |d| f64::from(d.y.max(0.0)), |d| f64::from((d.x * d.z).abs())];
        for sky in skies() {
            let dome = Dome::new(&sky).unwrap();
            let n = 400_000;
            for f in tests {
                let (mut even, mut own) = (DVec3::ZERO, DVec3::ZERO);
                for i in 0..n {
                    let p = r2(i, Vec2::splat(0.25));
                    let d = sphere(p);
                    even += sky.radiance(d).as_dvec3() * f(d) * (4.0 * PI / f64::from(n));
                    let (d, share) = dome.sample(p);
                    assert!((d.length() - 1.0).abs() < 1e-5 && share.min_element() >= 0.0);
                    own += share * f(d) / f64::from(n);
                }
                let scale = even.max_element().max(1e-3);
                assert!((even - own).abs().max_element() < 5e-3 * scale, "{sky:?}: {even} {own}");
            }
        }
        assert!(Dome::new(&Sky::None).is_none() && Dome::new(&Sky::Constant(Vec3::ZERO)).is_none());
    }

    /// Where bands are alike the share is the same for all directions: photons carry equal flux.
    #[test]
    fn photons_of_a_grey_gradient_are_equal() {
        let grey = |l| Vec3::splat(l);
        let sky = Sky::Gradient { zenith: grey(4.0), horizon: grey(1.0), ground: grey(0.5) };
        let dome = Dome::new(&sky).unwrap();
        for i in 0..1000 {
            let share = dome.sample(r2(i, Vec2::ZERO)).1.x;
            assert!((share / dome.total().x - 1.0).abs() < 1e-4, "{share} {}", dome.total());
        }
    }
}
