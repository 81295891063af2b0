//! Lamps and suns (KHR_lights_punctual, given a size): what one sample of them sends to a vertex.
//!
//!   point, spot   E = I · window(d) · falloff · cos θ/d²                    [I] = cd, d in scene units
//!   radius r      the same I spread over a sphere: L = I · window · falloff/(π r²), sampled evenly over the cap under
//!                 which the sphere is seen: solid angle 2π(1 − √(1 − r²/d²))
//!   sun           E = E₀ cos θ; of half angle α: L = E₀/(π sin² α), over the cap of solid angle 2π(1 − cos α)

use glam::{DVec3, Vec3};
use luxel_scene::{
    Light, LightKind,
    light::{range_window, spot_falloff},
};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::path::Vertex;
use crate::{frame::Frame, sampling};

pub(super) struct Lamp {
    kind: Kind,
    /// [cd] of lamps, [lux] of suns.
    intensity: DVec3,
}

enum Kind {
    Near { position: Vec3, range: Option<f64>, radius: f64, beam: Option<Beam>, scale: f64 },
    Sun { towards: Vec3, half_angle: f64 },
}

/// The cone of a spot.
struct Beam {
    axis: DVec3,
    inner: f64,
    outer: f64,
}

/// Light along one direction.
pub(super) struct Shine {
    /// Unit, from the vertex.
    pub direction: Vec3,
    /// Where the lamp begins, frame units; shadow rays end there.
    pub distance: f32,
    /// Estimate of the unoccluded irradiance [lux].
    pub irradiance: DVec3,
}

impl Lamp {
    pub fn new(light: &Light, frame: &Frame) -> Self {
        let near = |position: DVec3, range, radius: f64, beam| Kind::Near {
            position: frame.point(position),
            range,
            radius,
            beam,
            scale: frame.scale,
        };
        let kind = match light.kind {
            LightKind::Point { position, range, radius } => near(position, range, radius, None),
            LightKind::Spot { position, direction, inner, outer, range, radius } => {
                near(position, range, radius, Some(Beam { axis: direction, inner, outer }))
            }
            LightKind::Sun { direction, angle } => {
                Kind::Sun { towards: (-direction).as_vec3(), half_angle: (0.5 * angle).clamp(0.0, FRAC_PI_2) }
            }
        };
        Self { kind, intensity: light.intensity.max(Vec3::ZERO).as_dvec3() }
    }

    /// A weight that is positive wherever the lamp may shine on the vertex: its unoccluded irradiance with the cosine
    /// at its centre, widened by its size.
    pub fn promise(&self, vertex: &Vertex) -> f64 {
        let mean = self.intensity.element_sum() / 3.0;
        match &self.kind {
            Kind::Near { radius, .. } => {
                let Some((direction, distance, share)) = self.centre(vertex) else { return mean };
                let reach = 1.5 * (radius / distance).min(1.0);
                let cosine = (f64::from(vertex.shading_normal.dot(direction)) + reach).clamp(0.0, 1.0);
                let squared = (distance * distance).max(radius * radius);
                mean * share * cosine / squared
            }
            Kind::Sun { towards, half_angle } => {
                let cosine = f64::from(vertex.shading_normal.dot(*towards)) + 1.5 * libm::sin(*half_angle);
                mean * cosine.clamp(0.0, 1.0)
            }
        }
    }

    /// One sample by two numbers in [0, 1); None where nothing arrives.
    pub fn sample(&self, vertex: &Vertex, [x, y]: [f64; 2]) -> Option<Shine> {
        match self.kind {
            Kind::Near { radius, scale, .. } => {
                let (axis, distance, share) = self.centre(vertex)?;
                let intensity = self.intensity * share;
                if radius <= 0.0 {
                    let irradiance = intensity * vertex.cosine(axis) / (distance * distance);
                    let distance = (distance * scale) as f32;
                    return Some(Shine { direction: axis, distance, irradiance }).filter(Shine::is_light);
                }
                let radiance = intensity / (PI * radius * radius);
                if distance <= radius {
                    // Inside the luminous sphere: light from everywhere, with nothing in between.
                    let direction = sampling::sphere(glam::Vec2::new(x as f32, y as f32));
                    let irradiance = radiance * vertex.cosine(direction) * (2.0 * TAU);
                    return Some(Shine { direction, distance: 0.0, irradiance }).filter(Shine::is_light);
                }
                let sine = radius / distance;
                let versine = sine * sine / (1.0 + (1.0 - sine * sine).sqrt());
                let (direction, off) = cap(axis, versine, [x, y]);
                let half_chord = (radius * radius - distance * distance * off.sine_squared).max(0.0).sqrt();
                let begins = (distance * off.cosine - half_chord).max(0.0);
                let irradiance = radiance * vertex.cosine(direction) * (TAU * versine);
                let distance = (begins * scale) as f32;
                Some(Shine { direction, distance, irradiance }).filter(Shine::is_light)
            }
            Kind::Sun { towards, half_angle } => {
                let sine = libm::sin(half_angle);
                let (direction, share) = if sine > 0.0 {
                    let versine = sine * sine / (1.0 + libm::cos(half_angle));
                    (cap(towards, versine, [x, y]).0, 2.0 * versine / (sine * sine))
                } else {
                    (towards, 1.0)
                };
                let irradiance = self.intensity * vertex.cosine(direction) * share;
                Some(Shine { direction, distance: f32::INFINITY, irradiance }).filter(Shine::is_light)
            }
        }
    }

    /// Unit direction to the lamp's centre, its distance in scene units, and the share of its intensity that goes to
    /// the vertex; None where the vertex is the centre.
    fn centre(&self, vertex: &Vertex) -> Option<(Vec3, f64, f64)> {
        let Kind::Near { position, range, beam, scale, .. } = &self.kind else { return None };
        let step = position.as_dvec3() - vertex.position.as_dvec3();
        let length = step.length();
        if length <= 0.0 {
            return None;
        }
        let (direction, distance) = (step / length, length / scale);
        let falloff = beam.as_ref().map_or(1.0, |b| spot_falloff(-b.axis.dot(direction), b.inner, b.outer));
        Some((direction.as_vec3(), distance, range_window(distance, *range) * falloff))
    }
}

impl Shine {
    fn is_light(&self) -> bool {
        self.irradiance.max_element() > 0.0
    }
}

/// How far a direction is off an axis.
struct Off {
    cosine: f64,
    sine_squared: f64,
}

/// A direction evenly within the cap about a unit axis whose half angle has the versine 1 − cos.
fn cap(axis: Vec3, versine: f64, [x, y]: [f64; 2]) -> (Vec3, Off) {
    let down = x * versine;
    let sine_squared = down * (2.0 - down);
    let (sine, phi) = (sine_squared.sqrt(), TAU * y);
    let local = DVec3::new(sine * libm::cos(phi), sine * libm::sin(phi), 1.0 - down);
    ((sampling::basis(axis) * local.as_vec3()).normalize(), Off { cosine: 1.0 - down, sine_squared })
}
