//! The normalised frame: every scene, 1 mm or 10 km wide and however far from the origin, is moved and scaled by a
//! power of two to a longest side in (2048, 4096], in f64 and back, so that absolute tolerances of f32 and of the ray
//! tracer lie far below a texel.

use glam::{DVec3, Vec3};

/// Longest side of the scene in frame units, at most.
pub const SIDE: f64 = 4096.0;

/// World ↔ frame. Directions and angles are the same in both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub center: DVec3,
    /// Frame units per scene unit; a power of two.
    pub scale: f64,
}

impl Frame {
    /// The frame of a world box; an empty or point-like box gets unit scale.
    pub fn new(lo: DVec3, hi: DVec3) -> Self {
        let center = lo + 0.5 * (hi - lo);
        let side = (hi - lo).max_element();
        let exponent = if side > 0.0 && side.is_finite() { libm::floor(libm::log2(SIDE / side)) } else { 0.0 };
        Self { center, scale: libm::exp2(exponent) }
    }

    pub fn point(&self, world: DVec3) -> Vec3 {
        ((world - self.center) * self.scale).as_vec3()
    }

    pub fn world(&self, frame: Vec3) -> DVec3 {
        frame.as_dvec3() / self.scale + self.center
    }

    /// Scene units → frame units.
    pub fn length(&self, world: f64) -> f32 {
        (world * self.scale) as f32
    }

    /// Intensity [cd] → the number that, divided by a squared frame distance, gives lux.
    pub fn intensity(&self, candela: f32) -> f32 {
        (f64::from(candela) * self.scale * self.scale) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_far_away_and_tiny_keeps_its_shape() {
        let lo = DVec3::splat(1e6);
        let frame = Frame::new(lo, lo + DVec3::new(1e-3, 5e-4, 1e-4));
        let p = frame.point(lo + DVec3::new(1e-3, 0.0, 0.0));
        let q = frame.point(lo);
        let side = f64::from((p - q).x);
        assert!(side > 2047.0 && side <= 4097.0, "{side}");
        assert!((frame.world(p) - lo - DVec3::new(1e-3, 0.0, 0.0)).length() < 1e-9);
    }
}
