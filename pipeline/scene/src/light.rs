//! KHR_lights_punctual, given a size where the artist wants soft shadows.

use std::sync::Arc;

use glam::{DVec3, Vec3};

/// A light that is not geometry.
#[derive(Clone, Debug)]
pub struct Light {
    pub name: String,
    /// glTF node index.
    pub node: usize,
    /// Light group: the extra `luxel_group`, else the name of its node.
    pub group: Arc<str>,
    pub kind: LightKind,
    /// Linear RGB: luminous intensity [cd] of point and spot lights, illuminance [lux] of a sun.
    pub intensity: Vec3,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    Point {
        position: DVec3,
        /// Distance at which KHR_lights_punctual's window takes the light to zero [scene units].
        range: Option<f64>,
        /// Radius of the luminous sphere [scene units]; 0 is a point.
        radius: f64,
    },
    Spot {
        position: DVec3,
        /// Unit vector of the beam's axis, away from the lamp.
        direction: DVec3,
        /// Half angles of the cone [rad], 0 ≤ inner < outer ≤ π/2.
        inner: f64,
        outer: f64,
        range: Option<f64>,
        radius: f64,
    },
    Sun {
        /// Unit vector in which the light travels.
        direction: DVec3,
        /// Angular diameter [rad]; 0 is a point at infinity.
        angle: f64,
    },
}

/// KHR_lights_punctual's distance window: 1 near the lamp, 0 from `range` on, before division by the squared distance.
pub fn range_window(distance: f64, range: Option<f64>) -> f64 {
    range.map_or(1.0, |range| {
        let q = distance / range;
        (1.0 - q * q * q * q).clamp(0.0, 1.0)
    })
}

/// KHR_lights_punctual's angular falloff of a spot, by the cosine between its axis and the direction to the point.
pub fn spot_falloff(cosine: f64, inner: f64, outer: f64) -> f64 {
    let (cos_inner, cos_outer) = (libm::cos(inner), libm::cos(outer));
    let scale = 1.0 / (cos_inner - cos_outer).max(1e-3);
    let a = ((cosine - cos_outer) * scale).clamp(0.0, 1.0);
    a * a
}
