//! One walk: next events at every vertex, and a ray on to the next one.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::{DVec3, Vec2, Vec3};

use super::{
    LONGEST, Light, Reference,
    lamps::Shine,
    noise::{Noise, Use, pick, weight},
};
use crate::{
    Rgb,
    gather::Receiver,
    rays::{Hit, OFFSET, leave},
    sampling,
};

/// Up to so many lamps are all sampled at every vertex; of more, one is chosen.
const FEW: usize = 4;

/// Reflections before Russian roulette begins.
const SURE: u32 = 4;

/// A point that light is gathered at.
pub(super) struct Vertex {
    pub position: Vec3,
    /// Unit geometric normal of the side that gathers.
    pub normal: Vec3,
    /// Unit normal of the cosine.
    pub shading_normal: Vec3,
}

impl Vertex {
    /// As [`Receiver::cosine`].
    pub fn cosine(&self, direction: Vec3) -> f64 {
        if self.normal.dot(direction) <= 0.0 { 0.0 } else { f64::from(self.shading_normal.dot(direction)).max(0.0) }
    }
}

/// What a ray met and may go on from: the reservoir of one.
struct Next {
    hit: Hit,
    /// Transmittance × coverage × albedo.
    share: DVec3,
    /// Of this surface, and of all so far.
    weight: f64,
    total: f64,
}

impl Reference<'_> {
    /// One estimate of the irradiance at a receiver.
    pub(super) fn walk(&self, receiver: &Receiver, noise: &mut Noise, scratch: &mut Vec<f64>) -> Light {
        let mut vertex =
            Vertex { position: receiver.position, normal: receiver.normal, shading_normal: receiver.shading_normal };
        let mut light = Light::default();
        // What a lux at this vertex is worth at the receiver.
        let mut worth = DVec3::ONE;
        let longest = if self.options.roulette { u32::MAX } else { LONGEST };
        let last = self.options.bounces.map_or(longest, |bounces| bounces.min(longest));
        for depth in 0.. {
            let (straight, sky, next) = self.vertex(&vertex, depth, noise, scratch, &mut light.rays);
            if depth == 0 {
                light.direct += straight;
                light.indirect += sky;
            } else {
                light.indirect += worth * (straight + sky);
            }
            let Some(next) = next else { break };
            worth *= next.share * (next.total / next.weight);
            if depth >= last {
                break;
            }
            if depth >= SURE && self.options.roulette {
                let survival = worth.max_element().min(1.0);
                if !worth.is_finite() || noise.number() >= survival {
                    break;
                }
                worth /= survival;
            }
            let t = &self.rays.geometry.triangles[next.hit.triangle as usize];
            let normal = if next.hit.back { -t.normal } else { t.normal };
            vertex = Vertex { position: t.at(next.hit.u, next.hit.v), normal, shading_normal: normal };
        }
        light
    }

    /// Irradiance at a vertex straight from lamps and emitters, and from the sky [lux]; and a surface to go on from. Counts
    /// the rays.
    fn vertex(
        &self,
        vertex: &Vertex,
        depth: u32,
        noise: &mut Noise,
        scratch: &mut Vec<f64>,
        rays: &mut u64,
    ) -> (DVec3, DVec3, Option<Next>) {
        let geometry = self.rays.geometry;
        let mut straight = self.lamplight(vertex, depth, noise, scratch, rays);
        let mut from_sky = self.skylight(vertex, depth, noise, rays);
        let sums = self.emitters.weigh(vertex, scratch);
        straight += self.emitted(vertex, sums, depth, noise, rays);

        let [x, y] = noise.pair(depth, Use::Direction);
        let local = sampling::cosine_hemisphere(Vec2::new(x as f32, y as f32));
        let direction = (sampling::basis(vertex.shading_normal) * local).normalize();
        let cosine = vertex.cosine(direction);
        if cosine <= 0.0 {
            return (straight, from_sky, None);
        }
        let density = cosine * FRAC_1_PI;
        let mut next: Option<Next> = None;
        let origin = leave(vertex.position, vertex.normal, direction);
        *rays += 1;
        let rest = self.rays.walk(origin, direction, f32::INFINITY, 0.0, |hit, through| {
            let hit = &self.emitters.met(geometry, hit, direction);
            let surface = geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
            if hit.back && !geometry.material(hit.triangle).double_sided {
                return;
            }
            let seen = (through * surface.coverage).as_dvec3();
            let radiance = seen * surface.emission.max(Rgb::ZERO).as_dvec3();
            if radiance != DVec3::ZERO {
                let other = if self.options.next_event {
                    self.emitters.density(geometry, vertex, sums, hit, direction)
                } else {
                    0.0
                };
                straight += radiance * PI * heuristic(density, other);
            }
            let share = seen * surface.albedo.as_dvec3();
            let weight = share.element_sum();
            if weight > 0.0 {
                let total = weight + next.as_ref().map_or(0.0, |n| n.total);
                let chosen = next.is_none() || noise.number() * total < weight;
                match &mut next {
                    Some(n) if !chosen => n.total = total,
                    _ => next = Some(Next { hit: *hit, share, weight, total }),
                }
            }
        });
        if rest != Rgb::ZERO {
            let other = match &self.sky {
                Some(map) if self.options.next_event => map.density(direction),
                _ => 0.0,
            };
            let radiance = (rest * geometry.scene.sky.radiance(direction).max(Rgb::ZERO)).as_dvec3();
            from_sky += radiance * PI * heuristic(density, other);
        }
        (straight, from_sky, next)
    }

    /// Next event: a point of an emitter.
    fn emitted(&self, vertex: &Vertex, sums: &[f64], depth: u32, noise: &mut Noise, rays: &mut u64) -> DVec3 {
        if !self.options.next_event {
            return DVec3::ZERO;
        }
        let numbers = noise.pair(depth, Use::Emitter);
        let Some(target) = self.emitters.sample(self.rays.geometry, vertex, sums, numbers) else { return DVec3::ZERO };
        let cosine = vertex.cosine(target.direction);
        if cosine <= 0.0 || target.density <= 0.0 || target.radiance == DVec3::ZERO {
            return DVec3::ZERO;
        }
        *rays += 1;
        let pass = self.rays.between((vertex.position, vertex.normal), (target.position, target.normal));
        let share = heuristic(target.density, cosine * FRAC_1_PI) * cosine / target.density;
        target.radiance * pass.as_dvec3() * share
    }

    /// Next event: a direction of an image sky.
    fn skylight(&self, vertex: &Vertex, depth: u32, noise: &mut Noise, rays: &mut u64) -> DVec3 {
        let Some(map) = self.sky.as_ref().filter(|_| self.options.next_event) else { return DVec3::ZERO };
        let Some((direction, density)) = map.sample(noise.pair(depth, Use::Sky)) else { return DVec3::ZERO };
        let cosine = vertex.cosine(direction);
        if cosine <= 0.0 || density <= 0.0 {
            return DVec3::ZERO;
        }
        let radiance = self.rays.geometry.scene.sky.radiance(direction).max(Rgb::ZERO);
        let origin = leave(vertex.position, vertex.normal, direction);
        *rays += 1;
        let pass = self.rays.transmittance(origin, direction, f32::INFINITY);
        (pass * radiance).as_dvec3() * (heuristic(density, cosine * FRAC_1_PI) * cosine / density)
    }

    /// Next events: all lamps where there are few, else one.
    fn lamplight(
        &self,
        vertex: &Vertex,
        depth: u32,
        noise: &mut Noise,
        scratch: &mut Vec<f64>,
        rays: &mut u64,
    ) -> DVec3 {
        if self.lamps.len() <= FEW {
            let sample = |(i, lamp): (usize, &super::Lamp)| {
                let shine = lamp.sample(vertex, noise.pair(depth, Use::Lamp(i as u32)));
                shine.map_or(DVec3::ZERO, |shine| self.arriving(vertex, &shine, rays))
            };
            return self.lamps.iter().enumerate().map(sample).sum();
        }
        scratch.clear();
        let mut sum = 0.0;
        scratch.extend(self.lamps.iter().map(|lamp| {
            sum += lamp.promise(vertex);
            sum
        }));
        let [x, y] = noise.pair(depth, Use::Lamp(0));
        let Some((at, x)) = pick(scratch, x) else { return DVec3::ZERO };
        let share = sum / weight(scratch, at);
        self.lamps[at].sample(vertex, [x, y]).map_or(DVec3::ZERO, |shine| self.arriving(vertex, &shine, rays) * share)
    }

    /// What of a lamp's light is not held up on its way. The ray ends a little before the lamp, which may sit on a
    /// surface.
    fn arriving(&self, vertex: &Vertex, shine: &Shine, rays: &mut u64) -> DVec3 {
        *rays += 1;
        let origin = leave(vertex.position, vertex.normal, shine.direction);
        let pass = if shine.distance.is_finite() {
            let step = vertex.position + shine.direction * shine.distance - origin;
            let length = step.length().max(f32::MIN_POSITIVE);
            self.rays.transmittance(origin, step / length, (length - OFFSET).max(0.0))
        } else {
            self.rays.transmittance(origin, shine.direction, f32::INFINITY)
        };
        shine.irradiance * pass.as_dvec3()
    }
}

/// The power heuristic: the weight of a sample of density `own` (per steradian) that another technique would have found
/// with density `other`.
fn heuristic(own: f64, other: f64) -> f64 {
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_of_two_techniques_for_one_light_add_up_to_one() {
        for (a, b) in [(1.0, 1.0), (0.3, 20.0), (1e-9, 1e9), (5.0, 0.0)] {
            let other = if b > 0.0 { heuristic(b, a) } else { 0.0 };
            assert!((heuristic(a, b) + other - 1.0f64).abs() < 1e-12);
        }
        assert!(heuristic(2.0, 1.0) > heuristic(1.0, 1.0));
    }
}
