//! What a surfel sends along lines and what it gathers from them.

use std::ops::AddAssign;

use glam::{Vec2, Vec4};

use crate::Rgb;

/// Radiosity [lm/m²] of one or three bands times weight, with the weight of what is known behind it; sums of them are
/// sums of both.
pub trait Sample: Copy + Default + Send + Sync + AddAssign {
    /// The radiosity that a surfel sends, without a weight.
    type Light: Copy + Default + Send + Sync;

    fn light(radiosity: Rgb) -> Self::Light;

    fn radiosity(light: Self::Light) -> Rgb;

    /// Light that arrives with a weight; `known` is that weight again, or nothing where the light is added to what has
    /// been counted or is unknown.
    fn arrived(light: Self::Light, weight: f32, known: f32) -> Self;

    /// Radiosity over weight; nothing where nothing is known.
    fn mean(self) -> Rgb;
}

/// Three bands.
impl Sample for Vec4 {
    type Light = [f32; 3];

    fn light(radiosity: Rgb) -> [f32; 3] {
        radiosity.to_array()
    }

    fn radiosity(light: [f32; 3]) -> Rgb {
        light.into()
    }

    #[inline(always)]
    fn arrived([r, g, b]: [f32; 3], weight: f32, known: f32) -> Self {
        Vec4::new(r * weight, g * weight, b * weight, known)
    }

    fn mean(self) -> Rgb {
        if self.w > 0.0 { self.truncate() / self.w } else { Rgb::ZERO }
    }
}

/// One band, for light without colour.
impl Sample for Vec2 {
    type Light = f32;

    fn light(radiosity: Rgb) -> f32 {
        radiosity.x
    }

    fn radiosity(light: f32) -> Rgb {
        Rgb::splat(light)
    }

    #[inline(always)]
    fn arrived(light: f32, weight: f32, known: f32) -> Self {
        Vec2::new(light * weight, known)
    }

    fn mean(self) -> Rgb {
        if self.y > 0.0 { Rgb::splat(self.x / self.y) } else { Rgb::ZERO }
    }
}
