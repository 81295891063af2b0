//! Decoded images in linear light.

use glam::{Vec2, Vec4};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Wrap {
    #[default]
    Repeat,
    Mirror,
    Clamp,
}

/// An 8-bit RGBA image; colours decode from sRGB to linear where `srgb` says so, alpha never does.
#[derive(Clone, Debug, Default)]
pub struct Texture {
    pub name: String,
    pub width: u32,
    pub height: u32,
    pub srgb: bool,
    /// Row-major from the top, `width × height` texels.
    pub texels: Vec<[u8; 4]>,
}

impl Texture {
    /// The bilinear value at `uv` ((0,0) is the upper left corner), linear RGBA, averaged over a square of side
    /// `footprint` in UV units.
    pub fn sample(&self, uv: Vec2, wrap: [Wrap; 2], footprint: f32) -> Vec4 {
        // Averaging over the footprint is done by regular point samples; a pyramid can take its place.
        let side = (footprint * self.width.max(self.height) as f32).ceil().clamp(1.0, 8.0) as u32;
        let mut sum = Vec4::ZERO;
        for j in 0..side {
            for i in 0..side {
                let d = Vec2::new(i as f32 + 0.5, j as f32 + 0.5) / side as f32 - 0.5;
                sum += self.bilinear(uv + d * footprint, wrap);
            }
        }
        sum / (side * side) as f32
    }

    fn bilinear(&self, uv: Vec2, wrap: [Wrap; 2]) -> Vec4 {
        if self.texels.is_empty() || !uv.is_finite() {
            return Vec4::ONE;
        }
        let p = uv * Vec2::new(self.width as f32, self.height as f32) - 0.5;
        let (base, f) = (p.floor(), p - p.floor());
        let fetch = |dx: f32, dy: f32| {
            let x = wrapped(base.x + dx, self.width, wrap[0]);
            let y = wrapped(base.y + dy, self.height, wrap[1]);
            self.texel(x, y)
        };
        let top = fetch(0.0, 0.0).lerp(fetch(1.0, 0.0), f.x);
        let bottom = fetch(0.0, 1.0).lerp(fetch(1.0, 1.0), f.x);
        top.lerp(bottom, f.y)
    }

    fn texel(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.texels[(y * self.width + x) as usize];
        let linear = |c: u8| if self.srgb { srgb_to_linear(f32::from(c) / 255.0) } else { f32::from(c) / 255.0 };
        Vec4::new(linear(r), linear(g), linear(b), f32::from(a) / 255.0)
    }
}

/// IEC 61966-2-1 decoding.
pub fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

/// IEC 61966-2-1 encoding.
pub fn linear_to_srgb(c: f32) -> f32 {
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * libm::powf(c, 1.0 / 2.4) - 0.055 }
}

fn wrapped(i: f32, size: u32, wrap: Wrap) -> u32 {
    let n = i64::from(size);
    // `as` saturates, so even an absurd coordinate stays in range.
    let i = i as i64;
    let i = match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Mirror => {
            let k = i.rem_euclid(2 * n);
            if k < n { k } else { 2 * n - 1 - k }
        }
    };
    i as u32
}
