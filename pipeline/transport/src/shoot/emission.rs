//! Photons as lights send them out.
//!
//! Primary samples are dealt to the lights in proportion to their power Φ; each of N sends n photons of equal flux
//! Φ/(Nn) [lux × squared frame units] into
//!
//! ```text
//! a cosine distribution            surfaces       Φ = πL·A
//! its cone or sphere               lamps          Φ = ∫ I dω
//! its direction, from a disc       suns           Φ = E⊥·πR²
//! directions by radiance, a disc   sky            Φ = ∫ L dω · πR²
//! ```
//!
//! The discs, of radius R, cover a sphere around the whole scene. Points and directions are lattices seeded by the
//! light's identity.

use std::f64::consts::PI;

use glam::{DVec3, Mat3, Vec2, Vec3};

use super::dome::Dome;
use crate::{
    geometry::Geometry,
    lights::{AreaLight, Emitters, Lamp, SunLight},
    rays::OFFSET,
    sampling::{basis, cap, combine, cosine_hemisphere, mix, r2, sphere, unit2},
};

/// A photon on its way from a light.
pub(crate) struct Photon<'a> {
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// Lux × squared frame units.
    pub flux: DVec3,
    /// The lamp that sent it, if one did.
    lamp: Option<&'a Lamp>,
}

impl Photon<'_> {
    /// One that a surface has reflected.
    pub fn reflected(origin: Vec3, direction: Vec3, flux: DVec3) -> Self {
        Self { origin, direction, flux, lamp: None }
    }

    /// What a lamp's distance window leaves of the flux where it arrives, before anything has reflected it.
    pub fn window(&self, point: Vec3) -> f32 {
        self.lamp.map_or(1.0, |lamp| lamp.window(point.distance(lamp.position)))
    }
}

/// One side of a light with its share of the primary samples.
#[derive(Clone, Copy)]
pub(crate) struct Beam<'a> {
    light: Light<'a>,
    pub seed: u64,
    /// Flux, summed over the bands [lux × squared frame units].
    pub power: f64,
    pub primary: u32,
}

#[derive(Clone, Copy)]
enum Light<'a> {
    /// With the normal of the side that shines.
    Area(&'a AreaLight, Vec3),
    Lamp(&'a Lamp),
    Sun(&'a SunLight, Ball),
    Sky(&'a Dome<'a>, Ball),
}

/// A sphere around the scene.
#[derive(Clone, Copy)]
struct Ball {
    center: Vec3,
    radius: f32,
}

/// Deals `primary` samples to all lights, and to the sky where it is to shoot, by their power; at least one to each.
pub(crate) fn beams<'a>(
    geometry: &Geometry,
    emitters: &'a Emitters,
    sky: Option<&'a Dome<'a>>,
    primary: u32,
) -> Vec<Beam<'a>> {
    let ball = Ball::around(geometry);
    let mut beams = near(emitters);
    beams.extend(emitters.suns.iter().map(|l| Beam::sun(l, ball)));
    if let Some(dome) = sky {
        let power = dome.total().element_sum() * ball.disc();
        beams.push(Beam { light: Light::Sky(dome, ball), seed: Dome::IDENTITY, power, primary: 0 });
    }
    let total: f64 = beams.iter().map(|b| b.power).sum();
    let share = |power: f64| (power / total * f64::from(primary)).round().clamp(1.0, 1e9) as u32;
    beams.iter_mut().for_each(|beam| beam.primary = share(beam.power));
    beams
}

/// Surfaces and lamps, without samples.
pub(crate) fn near(emitters: &Emitters) -> Vec<Beam<'_>> {
    let mut beams = Vec::with_capacity(emitters.areas.len() + emitters.lamps.len());
    for l in &emitters.areas {
        for normal in [l.normal, -l.normal].into_iter().take(if l.two_sided { 2 } else { 1 }) {
            let sides = if l.two_sided { 0.5 } else { 1.0 };
            let seed = combine(l.identity, u64::from(normal != l.normal));
            let power = l.power(1.0).element_sum() * sides;
            beams.push(Beam { light: Light::Area(l, normal), seed, power, primary: 0 });
        }
    }
    beams.extend(emitters.lamps.iter().map(|l| Beam {
        light: Light::Lamp(l),
        seed: l.identity,
        power: l.power(1.0).element_sum(),
        primary: 0,
    }));
    beams
}

/// Suns, without samples.
pub(crate) fn far<'a>(geometry: &Geometry, emitters: &'a Emitters) -> Vec<Beam<'a>> {
    let ball = Ball::around(geometry);
    emitters.suns.iter().map(|l| Beam::sun(l, ball)).collect()
}

/// Deals so many photons to beams by their power, evenly and no more than those, however many the beams are: the number
/// of each beam that has any, with how many. A number in [0, 1) draws who has the fractions, so that in the mean
/// everybody has his share.
pub(crate) fn dealt(beams: &[Beam], photons: u32, draw: f32) -> Vec<(usize, u32)> {
    let total: f64 = beams.iter().map(|b| b.power).sum();
    let mut jobs = Vec::new();
    let (mut before, mut first) = (0.0, 0);
    for (number, beam) in beams.iter().enumerate() {
        before += beam.power;
        // Photon k stands at k + draw.
        let end = (before / total * f64::from(photons) - f64::from(draw)).ceil().clamp(0.0, f64::from(photons)) as u32;
        if end > first {
            jobs.push((number, end - first));
            first = end;
        }
    }
    jobs
}

impl<'a> Beam<'a> {
    fn sun(sun: &'a SunLight, ball: Ball) -> Self {
        let power = sun.illuminance.as_dvec3().element_sum() * ball.disc();
        Self { light: Light::Sun(sun, ball), seed: sun.identity, power, primary: 0 }
    }

    /// Photon `i` of `directions` from primary sample `k`.
    pub fn photon(&self, k: u32, i: u32, directions: u32) -> Photon<'a> {
        self.one_of(f64::from(self.primary) * f64::from(directions), (k, i, directions))
    }

    /// The same with the flux of one of `count` photons.
    pub fn one_of(&self, count: f64, (k, i, directions): (u32, u32, u32)) -> Photon<'a> {
        let place = r2(k, unit2(mix(self.seed)));
        // Each point turns the lattice of directions anew.
        let p = r2(i, unit2(combine(self.seed, u64::from(k) + 1)));
        // Parallel photons have places of their own on the disc: those of one point would all arrive together.
        let across = || r2(k.wrapping_mul(directions).wrapping_add(i), unit2(mix(self.seed)));
        match self.light {
            Light::Area(light, normal) => {
                let (point, radiance) = light.sample(place);
                let flux = radiance.as_dvec3() * (PI * f64::from(light.area) / count);
                let direction = basis(normal) * cosine_hemisphere(p);
                Photon { origin: point + normal * OFFSET, direction, flux, lamp: None }
            }
            Light::Lamp(lamp) => from_lamp(lamp, place, p, count),
            Light::Sun(sun, ball) => {
                let flux = sun.illuminance.as_dvec3() * (ball.disc() / count);
                ball.photon(cone_direction(sun, p), across(), flux)
            }
            Light::Sky(dome, ball) => {
                let (direction, share) = dome.sample(p);
                ball.photon(direction, across(), share * (ball.disc() / count))
            }
        }
    }
}

impl Ball {
    fn around(geometry: &Geometry) -> Self {
        let corners = geometry.triangles.iter().flat_map(|t| t.corners);
        let (lo, hi) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        if !lo.is_finite() {
            return Self { center: Vec3::ZERO, radius: 1.0 };
        }
        Self { center: 0.5 * (lo + hi), radius: 0.5 * (hi - lo).length() + 1.0 }
    }

    /// Area of its disc.
    fn disc(&self) -> f64 {
        PI * f64::from(self.radius) * f64::from(self.radius)
    }

    /// A photon that comes from `towards` through a point of the disc, given in the unit square.
    fn photon<'a>(&self, towards: Vec3, at: Vec2, flux: DVec3) -> Photon<'a> {
        let frame = basis(towards);
        let origin = self.center + frame.z_axis * self.radius + on_disc(&frame, self.radius, at);
        Photon { origin, direction: -frame.z_axis, flux, lamp: None }
    }
}

/// A point of the disc across the third axis of `frame`, even in area.
fn on_disc(frame: &Mat3, radius: f32, at: Vec2) -> Vec3 {
    let (r, phi) = (radius * at.x.sqrt(), std::f32::consts::TAU * at.y);
    frame.x_axis * (r * libm::cosf(phi)) + frame.y_axis * (r * libm::sinf(phi))
}

/// A direction towards the sun's disc, with density proportional to the cosine to its axis: E⊥ stays what it is.
fn cone_direction(sun: &SunLight, p: Vec2) -> Vec3 {
    let sine = libm::sinf(sun.half_angle);
    // sin² is uniform where the density is proportional to the cosine.
    let s = sine * p.x.sqrt();
    let phi = std::f32::consts::TAU * p.y;
    let local = Vec3::new(s * libm::cosf(phi), s * libm::sinf(phi), (1.0 - s * s).max(0.0).sqrt());
    basis(sun.direction) * local
}

/// A direction of a lamp's sphere or cone, evenly by a point of the unit square, and the solid angle of all of them
/// times the falloff along this one [sr].
pub(super) fn towards(lamp: &Lamp, p: Vec2) -> (Vec3, f64) {
    match &lamp.spot {
        None => (sphere(p), 4.0 * PI),
        Some(spot) => {
            let local = cap(p, spot.cos_outer as f32);
            let solid_angle = 2.0 * PI * (1.0 - spot.cos_outer);
            (basis(spot.direction.as_vec3()) * local, solid_angle * f64::from(spot.falloff(local.z.into())))
        }
    }
}

fn from_lamp(lamp: &Lamp, place: Vec2, p: Vec2, count: f64) -> Photon<'_> {
    let (direction, share) = towards(lamp, p);
    let flux = lamp.intensity.as_dvec3() * (share / count);
    // A luminous sphere: the photon crosses the disc that its direction sees, uniformly.
    let origin = lamp.position + on_disc(&basis(direction), lamp.radius, place);
    Photon { origin, direction, flux, lamp: Some(lamp) }
}
