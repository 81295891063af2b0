//! The normalised frame: every scene, 1 mm or 10 km wide and however far from the origin, is moved and scaled by a
//! power of two to a longest side in (2048, 4096], in f64 and back, so that absolute tolerances of f32 and of the ray
//! tracer lie far below a texel.

use glam::{DVec3, Vec3};

/// Longest side of the scene in frame units, at most.
pub const SIDE: f64 = 4096.0;

/// No scene is blown up by more than 2⁵⁰⁰, so that squares of the scale are finite.
const MAX_EXPONENT: i32 = 500;

/// World ↔ frame. Directions and angles are the same in both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub center: DVec3,
    /// Frame units per scene unit; a power of two.
    pub scale: f64,
}

impl Frame {
    /// The frame of a world box; an empty, point-like or boundless box gets unit scale.
    pub fn new(lo: DVec3, hi: DVec3) -> Self {
        let center = lo + 0.5 * (hi - lo);
        let side = (hi - lo).max_element();
        if !(side > 0.0 && side.is_finite() && center.is_finite()) {
            return Self { center: if center.is_finite() { center } else { DVec3::ZERO }, scale: 1.0 };
        }
        // side / SIDE = m · 2ᵉ with m in [½, 1), so 2⁻ᵉ brings the side into [½, 1) · SIDE, exactly.
        let (m, e) = libm::frexp(side / SIDE);
        let e = if m == 0.5 { e - 1 } else { e };
        Self { center, scale: libm::ldexp(1.0, (-e).min(MAX_EXPONENT)) }
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
    fn the_longest_side_is_in_its_range_whatever_the_scene() {
        for e in -300..300 {
            for m in [1.0, 1.0 + f64::EPSILON, 1.5, 2.0 - 2.0 * f64::EPSILON] {
                let side = m * libm::ldexp(1.0, e);
                let scaled = side * Frame::new(DVec3::ZERO, DVec3::new(0.0, side, side / 3.0)).scale;
                assert!(scaled > 0.5 * SIDE && scaled <= SIDE, "{side}: {scaled}");
            }
        }
    }

    #[test]
    fn absurd_sizes_fit_too() {
        for side in [f64::MAX, 1e300, 1e-300, 5e-324] {
            let frame = Frame::new(DVec3::ZERO, DVec3::splat(side));
            assert!(frame.scale > 0.0 && (frame.scale * frame.scale).is_finite(), "{side}: {frame:?}");
            assert!(frame.point(DVec3::splat(side)).max_element() <= SIDE as f32, "{side}: {frame:?}");
        }
    }

    #[test]
    fn boxes_without_a_size_get_unit_scale() {
        for (lo, hi) in [(0.0, 0.0), (5.0, 5.0), (f64::NAN, 1.0), (-f64::MAX, f64::MAX), (f64::INFINITY, -1.0)] {
            let frame = Frame::new(DVec3::splat(lo), DVec3::splat(hi));
            assert!(frame.scale == 1.0 && frame.center.is_finite(), "{lo} {hi}: {frame:?}");
        }
    }

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
