//! Photons from the lights by ray tracing, first hits only (Piwowar & Malgouyres 2009, §3).
//!
//! Primary samples are dealt to the lights in proportion to their power; each sends n photons of equal energy Φ/(Nn)
//! into a cosine distribution (surfaces), its cone or sphere (lamps), or along its direction (suns, from a disc over
//! the whole scene). A photon that arrives on a surfel of area A adds Φᵢ/A to its irradiance. Points and directions
//! are lattices seeded by the light's identity; sums are in f64 and in a fixed order.

use std::f64::consts::PI;

use glam::{DVec3, IVec3, Vec2, Vec3};
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use super::{Flux, Shot};
use crate::{
    Rgb,
    lights::{AreaLight, Emitters, Lamp, SunLight},
    rays::{Hit, OFFSET, Rays},
    sampling::{basis, cap, combine, cosine_hemisphere, mix, r2, sphere, unit2},
    surfel::Surfels,
};

/// Primary samples per unit of parallel work.
const CHUNK: u32 = 256;

/// Veils that one photon passes at most; what is left then counts as absorbed.
const LAYERS: u32 = 64;

#[derive(Clone, Copy, Debug)]
pub struct PhotonSettings {
    /// Points on all lights together; every light has at least one.
    pub primary: u32,
    /// Photons from each point.
    pub directions: u32,
}

impl Default for PhotonSettings {
    fn default() -> Self {
        Self { primary: 4000, directions: 256 }
    }
}

/// Direct irradiance of every surfel by photons.
pub fn photons(
    rays: &Rays,
    emitters: &Emitters,
    surfels: &Surfels,
    settings: PhotonSettings,
    progress: &dyn Progress,
) -> Result<Shot, Cancelled> {
    let beams = beams(rays, emitters, settings);
    let mut jobs = Vec::new();
    for (i, beam) in beams.iter().enumerate() {
        jobs.extend((0..beam.primary).step_by(CHUNK as usize).map(|first| (i, first)));
    }
    let mut sums = vec![DVec3::ZERO; surfels.list.len()];
    let mut shot = Shot::default();
    // Groups of jobs run in parallel; their deposits are added in order, so the sums do not depend on threads.
    for group in jobs.chunks(64) {
        progress.check()?;
        let traced: Vec<_> = group
            .par_iter()
            .map(|&(i, first)| {
                let beam = &beams[i];
                let mut tracer = Tracer { rays, surfels, deposits: Vec::new(), flux: Flux::default(), traced: 0 };
                for k in first..(first + CHUNK).min(beam.primary) {
                    beam.shoot(k, settings.directions, &mut tracer);
                }
                (tracer.deposits, tracer.flux, tracer.traced)
            })
            .collect();
        for (deposits, flux, traced) in traced {
            shot.direct_photons += deposits.len() as u64;
            shot.rays += traced;
            shot.ledger.add(&flux);
            deposits.iter().for_each(|&(surfel, flux)| sums[surfel as usize] += flux);
        }
        progress.advance(group.len() as u64);
    }
    shot.primary_photons = beams.iter().map(|b| u64::from(b.primary)).sum();
    let per_area = |(sum, surfel): (&DVec3, &crate::surfel::Surfel)| match surfel.area {
        area if area > 0.0 => (*sum / f64::from(area)).as_vec3(),
        _ => Rgb::ZERO,
    };
    shot.irradiance = sums.iter().zip(&surfels.list).map(per_area).collect();
    // From lux times squared frame units to lumen.
    shot.ledger = shot.ledger.scaled(1.0 / (emitters.scale * emitters.scale));
    Ok(shot)
}

/// One side of a light with its share of the primary samples.
struct Beam<'a> {
    light: Light<'a>,
    seed: u64,
    primary: u32,
}

enum Light<'a> {
    /// With the normal of the side that shines.
    Area(&'a AreaLight, Vec3),
    Lamp(&'a Lamp),
    /// With the centre and radius of the scene's bounding sphere.
    Sun(&'a SunLight, Vec3, f32),
}

/// Deals the primary samples to all lights by their power.
fn beams<'a>(rays: &Rays, emitters: &'a Emitters, settings: PhotonSettings) -> Vec<Beam<'a>> {
    let corners = rays.geometry.triangles.iter().flat_map(|t| t.corners);
    let (lo, hi) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let (center, radius) =
        if lo.is_finite() { (0.5 * (lo + hi), 0.5 * (hi - lo).length() + 1.0) } else { (Vec3::ZERO, 1.0) };
    let mut beams = Vec::new();
    for l in &emitters.areas {
        for normal in [l.normal, -l.normal].into_iter().take(if l.two_sided { 2 } else { 1 }) {
            let sides = if l.two_sided { 0.5 } else { 1.0 };
            let seed = combine(l.identity, u64::from(normal != l.normal));
            beams.push((Light::Area(l, normal), seed, l.power(1.0).element_sum() * sides));
        }
    }
    for l in &emitters.lamps {
        beams.push((Light::Lamp(l), l.identity, l.power(1.0).element_sum()));
    }
    for l in &emitters.suns {
        let disc = PI * f64::from(radius) * f64::from(radius);
        let power = l.illuminance.as_dvec3().element_sum() * disc;
        beams.push((Light::Sun(l, center, radius), l.identity, power));
    }
    let total: f64 = beams.iter().map(|b| b.2).sum();
    let share = |power: f64| (power / total * f64::from(settings.primary)).round().clamp(1.0, 1e9) as u32;
    beams.into_iter().map(|(light, seed, power)| Beam { light, seed, primary: share(power) }).collect()
}

impl Beam<'_> {
    /// Sends the photons of primary sample `k`.
    fn shoot(&self, k: u32, directions: u32, tracer: &mut Tracer) {
        let place = r2(k, unit2(mix(self.seed)));
        // Each point turns the lattice of directions anew.
        let turn = unit2(combine(self.seed, u64::from(k) + 1));
        let count = f64::from(self.primary) * f64::from(directions);
        for i in 0..directions {
            let p = r2(i, turn);
            match self.light {
                Light::Area(light, normal) => {
                    let (point, radiance) = light.sample(place);
                    let flux = radiance.as_dvec3() * (PI * f64::from(light.area) / count);
                    let direction = basis(normal) * cosine_hemisphere(p);
                    tracer.trace(point + normal * OFFSET, direction, flux, &|_| 1.0);
                }
                Light::Lamp(lamp) => shoot_lamp(lamp, place, p, count, tracer),
                Light::Sun(sun, center, radius) => {
                    // Every photon has a place of its own on the disc: photons of one point would all arrive together.
                    let at = r2(k.wrapping_mul(directions).wrapping_add(i), unit2(mix(self.seed)));
                    let frame = basis(cone_direction(sun, p));
                    let (r, phi) = (radius * at.x.sqrt(), std::f32::consts::TAU * at.y);
                    let across = frame.x_axis * (r * libm::cosf(phi)) + frame.y_axis * (r * libm::sinf(phi));
                    let area = PI * f64::from(radius) * f64::from(radius);
                    let flux = sun.illuminance.as_dvec3() * (area / count);
                    tracer.trace(center + frame.z_axis * radius + across, -frame.z_axis, flux, &|_| 1.0);
                }
            }
        }
    }
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

fn shoot_lamp(lamp: &Lamp, place: Vec2, p: Vec2, count: f64, tracer: &mut Tracer) {
    let (direction, solid_angle, falloff) = match &lamp.spot {
        None => (sphere(p), 4.0 * PI, 1.0),
        Some(spot) => {
            let local = cap(p, spot.cos_outer as f32);
            let solid_angle = 2.0 * PI * (1.0 - spot.cos_outer);
            (basis(spot.direction.as_vec3()) * local, solid_angle, spot.falloff(local.z.into()))
        }
    };
    let flux = lamp.intensity.as_dvec3() * (f64::from(falloff) * solid_angle / count);
    // A luminous sphere: the photon crosses the disc that its direction sees, uniformly.
    let frame = basis(direction);
    let (r, phi) = (lamp.radius * place.x.sqrt(), std::f32::consts::TAU * place.y);
    let across = frame.x_axis * (r * libm::cosf(phi)) + frame.y_axis * (r * libm::sinf(phi));
    tracer.trace(lamp.position + across, direction, flux, &|point| lamp.window(point.distance(lamp.position)));
}

/// Follows photons and notes where they arrive.
struct Tracer<'t> {
    rays: &'t Rays<'t>,
    surfels: &'t Surfels,
    deposits: Vec<(u32, DVec3)>,
    /// In lux times squared frame units.
    flux: Flux,
    traced: u64,
}

impl Tracer<'_> {
    /// One photon; `window` dims it by the place where it arrives.
    fn trace(&mut self, origin: Vec3, direction: Vec3, flux: DVec3, window: &dyn Fn(Vec3) -> f32) {
        self.flux.emitted += flux;
        let (mut origin, mut left) = (origin, flux);
        for _ in 0..LAYERS {
            self.traced += 1;
            let Some(hit) = self.rays.closest(origin, direction, f32::INFINITY) else {
                self.flux.escaped += left;
                return;
            };
            let surface = self.rays.geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
            let point = origin + direction * hit.distance;
            let passed = left * surface.transmittance.as_dvec3();
            self.arrive(&hit, point, left, passed, surface.coverage, window(point));
            left = passed;
            if left.max_element() <= 1e-4 * flux.max_element() {
                self.flux.absorbed += left;
                return;
            }
            origin = point + direction * OFFSET;
        }
        self.flux.absorbed += left;
    }

    /// Deposits what a surface receives by its coverage; what neither arrives nor passes is absorbed.
    fn arrive(&mut self, hit: &Hit, point: Vec3, left: DVec3, passed: DVec3, coverage: f32, window: f32) {
        let geometry = self.rays.geometry;
        let stays = left - passed;
        let normal = geometry.triangles[hit.triangle as usize].normal;
        if hit.back && !geometry.material(hit.triangle).double_sided {
            self.flux.absorbed += stays;
            return;
        }
        match find(self.surfels, point, if hit.back { -normal } else { normal }) {
            None => self.flux.lost += stays,
            Some(surfel) => {
                // Glass receives light that it also lets through; only what stays is booked.
                self.deposits.push((surfel, left * f64::from(coverage * window)));
                let booked = stays.min(left * f64::from(coverage)) * f64::from(window);
                self.flux.deposited += booked;
                self.flux.absorbed += stays - booked;
            }
        }
    }
}

/// The surfel that holds a surface point with this normal: the best oriented one of its voxel, or, where rounding has
/// put the point next door, of a voxel within a hundredth of a voxel's edge.
fn find(surfels: &Surfels, point: Vec3, normal: Vec3) -> Option<u32> {
    let place = (point - surfels.grid.origin) / surfels.grid.edge;
    let voxel = |shift: Vec3| (place + shift * 0.01).floor().as_ivec3();
    find_in(surfels, voxel(Vec3::ZERO), normal).or_else(|| {
        let corners = (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0);
        corners.filter_map(|c| find_in(surfels, voxel(c), normal)).next()
    })
}

/// The surfel of a voxel that faces most nearly along `normal`, and not away from it.
fn find_in(surfels: &Surfels, voxel: IVec3, normal: Vec3) -> Option<u32> {
    let key = |v: IVec3| (v.x, v.y, v.z);
    let list = &surfels.list;
    let start = list.partition_point(|s| key(s.voxel()) < key(voxel));
    let mut best: Option<(u32, f32)> = None;
    for (i, s) in list[start..].iter().enumerate().take_while(|(_, s)| s.voxel() == voxel) {
        let cosine = s.normal.dot(normal);
        if cosine > best.map_or(0.0, |b| b.1) {
            best = Some(((start + i) as u32, cosine));
        }
    }
    best.map(|b| b.0)
}
