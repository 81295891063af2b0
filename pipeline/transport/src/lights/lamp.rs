//! KHR_lights_punctual in frame units: points, spots and suns, with a size where the artist gave one.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use luxel_scene::{Light, LightKind};

use super::{BRIGHTEST, Source};
use crate::{Rgb, frame::Frame, rays::OFFSET};

/// A point or spot light; a luminous sphere where `radius` is not 0. It casts light, it is not geometry.
#[derive(Clone, Debug)]
pub struct Lamp {
    /// Frame position of the centre.
    pub position: Vec3,
    /// Intensity on the axis; divided by a squared frame distance it gives lux.
    pub intensity: Rgb,
    /// Radius of the luminous sphere, frame units.
    pub radius: f32,
    /// Where the distance window reaches zero, frame units.
    pub range: Option<f32>,
    pub spot: Option<Spot>,
    pub source: Source,
    /// Stable hash of the light's name: the seed of its photons.
    pub identity: u64,
}

/// The cone of a spot light, as KHR_lights_punctual's falloff wants it. In f64: at the rim the falloff is the square of
/// a difference that vanishes.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    /// Unit axis of the beam, away from the lamp.
    pub direction: DVec3,
    /// Cosine of the outer half angle: no light beyond it.
    pub cos_outer: f64,
    /// 1/(cos inner − cos outer), bounded.
    pub slope: f64,
}

impl Spot {
    /// Share of the axis' intensity at the cosine between axis and direction.
    pub fn falloff(&self, cosine: f64) -> f32 {
        let a = ((cosine - self.cos_outer) * self.slope).clamp(0.0, 1.0);
        (a * a) as f32
    }

    /// ∫ falloff dΩ [sr].
    fn solid_angle(&self) -> f64 {
        let (outer, slope) = (self.cos_outer, self.slope);
        let full = (outer + 1.0 / slope).min(1.0);
        TAU * (slope * slope * (full - outer).powi(3) / 3.0 + 1.0 - full)
    }
}

impl Lamp {
    /// None where the light is not a lamp or not at a finite place.
    pub(super) fn new(light: &Light, intensity: Rgb, frame: &Frame, source: Source, identity: u64) -> Option<Self> {
        let (position, range, radius, spot) = match light.kind {
            LightKind::Point { position, range, radius } => (position, range, radius, None),
            LightKind::Spot { position, direction, inner, outer, range, radius } => {
                let (cos_inner, cos_outer) = (libm::cos(inner), libm::cos(outer));
                let spot = Spot { direction, cos_outer, slope: 1.0 / (cos_inner - cos_outer).max(1e-3) };
                (position, range, radius, Some(spot))
            }
            LightKind::Sun { .. } => return None,
        };
        let position = frame.point(position);
        let intensity = Rgb::from_array(intensity.to_array().map(|i| frame.intensity(i).min(BRIGHTEST)));
        position.is_finite().then_some(Self {
            position,
            intensity,
            radius: frame.length(radius.max(0.0)),
            range: range.map(|r| frame.length(r)),
            spot,
            source,
            identity,
        })
    }

    /// Intensity towards `point`, after spot falloff and distance window (see [`Lamp::intensity`]).
    pub fn intensity_towards(&self, point: Vec3) -> Rgb {
        let to = point - self.position;
        let distance = to.length();
        let falloff = match &self.spot {
            Some(spot) if distance > 0.0 => spot.falloff(spot.direction.dot(to.as_dvec3().normalize())),
            _ => 1.0,
        };
        self.intensity * (falloff * self.window(distance))
    }

    /// KHR_lights_punctual's distance window at a frame distance.
    pub fn window(&self, distance: f32) -> f32 {
        self.range.map_or(1.0, |range| {
            let q = distance / range;
            (1.0 - q * q * q * q).clamp(0.0, 1.0)
        })
    }

    /// Squared distance, bounded from below by the lamp's own surface and by the ray offset, so that nothing at the
    /// lamp's place becomes infinite.
    pub fn squared_distance(&self, point: Vec3) -> f32 {
        let nearest = self.radius.max(OFFSET);
        (point - self.position).length_squared().max(nearest * nearest)
    }

    /// Luminous flux [lm], without the distance window.
    pub fn power(&self, scale: f64) -> DVec3 {
        let solid_angle = self.spot.as_ref().map_or(4.0 * PI, Spot::solid_angle);
        self.intensity.as_dvec3() * (solid_angle / (scale * scale))
    }
}

/// A light at infinity, a disc of uniform radiance where `half_angle` is not 0.
#[derive(Clone, Debug)]
pub struct SunLight {
    /// Unit vector towards the sun.
    pub direction: Vec3,
    /// Illuminance of a surface that faces the sun [lux].
    pub illuminance: Rgb,
    /// Half of the angular diameter [rad], below π/2.
    pub half_angle: f32,
    pub source: Source,
    pub identity: u64,
}

impl SunLight {
    /// None where the light is no sun or has no direction.
    pub(super) fn new(light: &Light, illuminance: Rgb, source: Source, identity: u64) -> Option<Self> {
        let LightKind::Sun { direction, angle } = light.kind else { return None };
        let direction = (-direction).try_normalize()?.as_vec3();
        let half_angle = (0.5 * angle).clamp(0.0, 0.49 * PI) as f32;
        Some(Self { direction, illuminance, half_angle, source, identity })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::light::{range_window, spot_falloff};

    fn lamp(kind: LightKind) -> Lamp {
        let light = Light { name: "l".into(), node: 0, group: "l".into(), kind, intensity: Vec3::ONE };
        let frame = Frame { center: DVec3::ZERO, scale: 4.0 };
        Lamp::new(&light, Vec3::ONE, &frame, Source::Light(0), 1).unwrap()
    }

    #[test]
    fn falloff_and_window_are_those_of_the_scene() {
        let (inner, outer) = (0.3, 0.8);
        let position = DVec3::ZERO;
        let lamp =
            lamp(LightKind::Spot { position, direction: DVec3::NEG_Y, inner, outer, range: Some(3.0), radius: 0.0 });
        for i in 0..100 {
            let angle = f64::from(i) * 0.01;
            let d = DVec3::new(libm::sin(angle), -libm::cos(angle), 0.0);
            for distance in [0.5, 1.5, 2.9, 3.5] {
                let expected = spot_falloff(libm::cos(angle), inner, outer) * range_window(distance, Some(3.0));
                let e = lamp.intensity_towards((d * distance * 4.0).as_vec3()).x / 16.0;
                assert!((f64::from(e) - expected).abs() < 1e-5, "{angle} {distance}: {e} {expected}");
            }
        }
    }

    #[test]
    fn the_power_of_a_spot_is_the_integral_of_its_falloff() {
        for (inner, outer) in [(0.0, 0.5), (0.4, 0.5), (0.499_999, 0.5), (0.2, 1.57)] {
            let (position, direction) = (DVec3::ZERO, DVec3::X);
            let lamp = lamp(LightKind::Spot { position, direction, inner, outer, range: None, radius: 0.0 });
            let n = 200_000;
            let sum: f64 =
                (0..n).map(|i| spot_falloff(1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n), inner, outer)).sum();
            let expected = 4.0 * PI * sum / f64::from(n);
            let power = lamp.power(4.0).x;
            assert!((power - expected).abs() < 1e-3 * expected, "{inner} {outer}: {power} {expected}");
        }
    }
}
