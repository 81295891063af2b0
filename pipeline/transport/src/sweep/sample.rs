//! What a line carries and a surfel gathers: radiosity and the weight of what is known.

use std::ops::{AddAssign, Mul};

use glam::{Vec2, Vec4};

use crate::Rgb;

/// A radiosity [lm/m²] of one or three bands with its weight behind it; sums of them are sums of both.
pub trait Sample: Copy + Default + Send + Sync + AddAssign + Mul<f32, Output = Self> {
    fn new(radiosity: Rgb, weight: f32) -> Self;

    /// Radiosity over weight; nothing where nothing is known.
    fn mean(self) -> Rgb;
}

/// Three bands.
impl Sample for Vec4 {
    fn new(radiosity: Rgb, weight: f32) -> Self {
        radiosity.extend(weight)
    }

    fn mean(self) -> Rgb {
        if self.w > 0.0 { self.truncate() / self.w } else { Rgb::ZERO }
    }
}

/// One band, for light without colour.
impl Sample for Vec2 {
    fn new(radiosity: Rgb, weight: f32) -> Self {
        Vec2::new(radiosity.x, weight)
    }

    fn mean(self) -> Rgb {
        if self.y > 0.0 { Rgb::splat(self.x / self.y) } else { Rgb::ZERO }
    }
}
