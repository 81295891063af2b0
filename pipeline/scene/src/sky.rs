//! Radiance that comes from outside the scene.

use glam::{Vec2, Vec3};

/// Sky radiance [cd/m²] by direction. +Y is up; an equirectangular image has its centre towards −Z and u grows
/// towards +X.
#[derive(Clone, Debug, Default)]
pub enum Sky {
    #[default]
    None,
    Constant(Vec3),
    /// Linear in the sine of the elevation, from `horizon` to `zenith` above and to `ground` below.
    Gradient {
        zenith: Vec3,
        horizon: Vec3,
        ground: Vec3,
    },
    Image(SkyImage),
}

/// An equirectangular radiance map.
#[derive(Clone, Debug)]
pub struct SkyImage {
    pub width: u32,
    pub height: u32,
    /// Row-major from the zenith down, linear RGB.
    pub texels: Vec<Vec3>,
    /// Turns the sky about +Y [rad], counter-clockwise seen from above.
    pub rotation: f32,
    pub strength: f32,
}

impl Sky {
    /// Radiance seen from inside when looking along the unit vector `direction`.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        match self {
            Sky::None => Vec3::ZERO,
            Sky::Constant(radiance) => *radiance,
            Sky::Gradient { zenith, horizon, ground } => {
                let end = if direction.y >= 0.0 { zenith } else { ground };
                horizon.lerp(*end, direction.y.abs().min(1.0))
            }
            Sky::Image(image) => image.radiance(direction),
        }
    }

    pub fn is_dark(&self) -> bool {
        match self {
            Sky::None => true,
            Sky::Constant(radiance) => radiance.max_element() <= 0.0,
            Sky::Gradient { zenith, horizon, ground } => zenith.max(*horizon).max(*ground).max_element() <= 0.0,
            Sky::Image(image) => image.strength <= 0.0 || image.texels.iter().all(|t| t.max_element() <= 0.0),
        }
    }
}

impl SkyImage {
    /// Continuous image coordinates in [0,1]² of a direction.
    pub fn project(&self, direction: Vec3) -> Vec2 {
        let azimuth = libm::atan2f(direction.x, -direction.z) + self.rotation;
        let u = azimuth / std::f32::consts::TAU + 0.5;
        let v = libm::acosf(direction.y.clamp(-1.0, 1.0)) / std::f32::consts::PI;
        Vec2::new(u - u.floor(), v)
    }

    fn radiance(&self, direction: Vec3) -> Vec3 {
        let uv = self.project(direction);
        let p = uv * Vec2::new(self.width as f32, self.height as f32) - 0.5;
        let (base, f) = (p.floor(), p - p.floor());
        let fetch = |dx: i64, dy: i64| {
            let x = (base.x as i64 + dx).rem_euclid(i64::from(self.width));
            let y = (base.y as i64 + dy).clamp(0, i64::from(self.height) - 1);
            self.texels[(y * i64::from(self.width) + x) as usize]
        };
        let top = fetch(0, 0).lerp(fetch(1, 0), f.x);
        let bottom = fetch(0, 1).lerp(fetch(1, 1), f.x);
        top.lerp(bottom, f.y) * self.strength
    }
}
