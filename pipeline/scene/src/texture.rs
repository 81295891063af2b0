//! Decoded images in linear light.
//!
//! A sample is the image's average over a box of the wanted size, at least one texel wide (the average over one texel
//! around a point *is* bilinear interpolation). Large boxes are summed from the levels of a pyramid, whose texels are
//! a quarter to a half of the box, so the cost does not grow with the box.

use std::sync::LazyLock;

use glam::{Vec2, Vec4};

use crate::pyramid::{Averages, spans};

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

/// What alpha means where a texture is used, and so what averages of its colours are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaUse {
    /// Nothing: all texels count alike.
    Ignored,
    /// Coverage: what is transparent does not tint what is not.
    Coverage,
    /// Texels below this alpha are holes. An average over more than a few texels holds the share of texels that pass
    /// in its alpha, and their colour.
    Test(f32),
}

impl Texture {
    /// The value at `uv` ((0,0) is the upper left corner), linear RGBA, averaged over a square of side `footprint` in
    /// UV units, or of one texel where that is larger. `averages` belongs to this texture in this use of its alpha.
    pub fn sample(&self, averages: &Averages, alpha: AlphaUse, uv: Vec2, wrap: [Wrap; 2], footprint: f32) -> Vec4 {
        if self.texels.is_empty() || !uv.is_finite() {
            return Vec4::ONE;
        }
        let sides = self.sides(footprint);
        let level = self.level(sides);
        let columns = spans(reduced(uv.x, wrap[0]), sides[0], self.width, level, wrap[0]);
        let rows = spans(reduced(uv.y, wrap[1]), sides[1], self.height, level, wrap[1]);
        let pyramid = (level > 0).then(|| averages.get(self, alpha));
        let mut sum = Weighted::new(alpha);
        for &(y, wy) in rows.as_slice() {
            for &(x, wx) in columns.as_slice() {
                let value = pyramid.map_or_else(|| self.texel(x, y), |pyramid| pyramid.cell(level, x, y));
                sum.add(value, wx * wy);
            }
        }
        sum.mean()
    }

    /// Is a footprint of this size averaged with the alpha test already made (see [`AlphaUse::Test`])?
    pub fn is_tested(&self, footprint: f32) -> bool {
        !self.texels.is_empty() && self.level(self.sides(footprint)) > 0
    }

    /// The average of the whole image, linear RGBA.
    pub fn mean(&self, averages: &Averages, alpha: AlphaUse) -> Vec4 {
        self.sample(averages, alpha, Vec2::splat(0.5), [Wrap::Repeat; 2], 1.0)
    }

    /// Width and height of the box in texels: the whole image is as large as makes sense, however often it repeats.
    fn sides(&self, footprint: f32) -> [f32; 2] {
        [self.width, self.height].map(|n| (footprint * n as f32).min(n as f32).max(1.0))
    }

    /// The level whose texels are a quarter to a half of the box's shorter side, or larger ones when the longer side
    /// would take too many of them.
    fn level(&self, sides: [f32; 2]) -> usize {
        let log2 = |f: f32| (f as u32).max(1).ilog2() as usize;
        let fine = log2(sides[0].min(sides[1])).saturating_sub(1);
        let coarse = log2(sides[0].max(sides[1])).saturating_sub(3);
        fine.max(coarse)
    }

    /// One texel, linear.
    pub fn texel(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.texels[y as usize * self.width as usize + x as usize];
        let linear = |c: u8| if self.srgb { SRGB[usize::from(c)] } else { f32::from(c) / 255.0 };
        Vec4::new(linear(r), linear(g), linear(b), f32::from(a) / 255.0)
    }
}

/// A mean of colours, weighted by alpha where that means anything, and of alpha itself. Equal values come out exactly
/// as they went in, because only differences to the first one are summed.
#[derive(Clone, Copy)]
pub(crate) struct Weighted {
    by_alpha: bool,
    first: Vec4,
    weight: f32,
    alpha: f32,
    /// Differences of colour, weighted by alpha and by area alone.
    tinted: Vec4,
    plain: Vec4,
}

impl Weighted {
    pub(crate) fn new(alpha: AlphaUse) -> Self {
        let by_alpha = alpha != AlphaUse::Ignored;
        Self { by_alpha, first: Vec4::ZERO, weight: 0.0, alpha: 0.0, tinted: Vec4::ZERO, plain: Vec4::ZERO }
    }

    pub(crate) fn add(&mut self, value: Vec4, weight: f32) {
        if self.weight == 0.0 {
            self.first = value;
        }
        let difference = value - self.first;
        self.weight += weight;
        self.alpha += weight * value.w;
        self.tinted += difference * (weight * value.w);
        self.plain += difference * weight;
    }

    /// Where nothing is opaque at all the colour is the plain mean.
    pub(crate) fn mean(&self) -> Vec4 {
        if self.weight <= 0.0 {
            return self.first;
        }
        let color = self.first
            + if self.by_alpha && self.alpha > 0.0 { self.tinted / self.alpha } else { self.plain / self.weight };
        let alpha = self.first.w + self.plain.w / self.weight;
        color.truncate().max(glam::Vec3::ZERO).extend(alpha.clamp(0.0, 1.0))
    }
}

static SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|c| srgb_to_linear(c as f32 / 255.0)));

/// IEC 61966-2-1 decoding.
pub fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

/// IEC 61966-2-1 encoding.
pub fn linear_to_srgb(c: f32) -> f32 {
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * libm::powf(c, 1.0 / 2.4) - 0.055 }
}

/// The same place of the texture near the origin, where single precision resolves texels well.
fn reduced(u: f32, wrap: Wrap) -> f32 {
    match wrap {
        Wrap::Repeat => u - u.floor(),
        Wrap::Mirror => u - 2.0 * (0.5 * u).floor(),
        Wrap::Clamp => u.clamp(-1.0, 2.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples with averages of its own.
    fn sample(texture: &Texture, uv: Vec2, wrap: [Wrap; 2], footprint: f32) -> Vec4 {
        texture.sample(&Averages::default(), AlphaUse::Coverage, uv, wrap, footprint)
    }

    fn mean(texture: &Texture) -> Vec4 {
        texture.mean(&Averages::default(), AlphaUse::Coverage)
    }

    fn texture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Texture {
        let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| texel(x, y)).collect();
        Texture { width, height, texels, ..Texture::default() }
    }

    #[test]
    fn constant_images_are_exact_at_every_footprint() {
        let mut image = texture(37, 20, |_, _| [13, 200, 77, 91]);
        image.srgb = true;
        let value = image.texel(0, 0);
        for footprint in [0.0, 0.01, 0.1, 0.3, 1.0, 5.0] {
            for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                for u in [-3.7, 0.0, 0.21, 0.5, 0.999, 12.3] {
                    assert_eq!(sample(&image, Vec2::new(u, 1.0 - u), [wrap; 2], footprint), value, "{footprint} {u}");
                }
            }
        }
    }

    #[test]
    fn a_point_sample_is_bilinear() {
        let image = texture(4, 1, |x, _| [(x * 60) as u8, 0, 0, 255]);
        let at = |x: f32| sample(&image, Vec2::new(x / 4.0, 0.5), [Wrap::Clamp; 2], 0.0).x * 255.0;
        for (x, expected) in [(0.5, 0.0), (1.5, 60.0), (1.0, 30.0), (2.25, 105.0), (0.0, 0.0), (4.0, 180.0)] {
            assert!((at(x) - expected).abs() < 1e-3, "{x}: {} {expected}", at(x));
        }
        let repeat = sample(&image, Vec2::new(0.0, 0.5), [Wrap::Repeat; 2], 0.0).x * 255.0;
        assert!((repeat - 90.0).abs() < 1e-3, "first and last texel meet: {repeat}");
        let mirror = sample(&image, Vec2::new(-0.375, 0.5), [Wrap::Mirror; 2], 0.0).x * 255.0;
        assert!((mirror - 60.0).abs() < 1e-3, "{mirror}");
    }

    #[test]
    fn boxes_on_texel_borders_are_exact_means() {
        let image = texture(64, 64, |x, y| [(x * 3 + y) as u8, (x ^ y) as u8, 0, 255]);
        for (x, y, n) in [(0, 0, 8), (16, 32, 16), (32, 0, 32), (0, 0, 64)] {
            let center = Vec2::new(x as f32 + n as f32 / 2.0, y as f32 + n as f32 / 2.0) / 64.0;
            let got = sample(&image, center, [Wrap::Repeat; 2], n as f32 / 64.0);
            let mut sum = glam::DVec4::ZERO;
            for j in 0..n {
                for i in 0..n {
                    sum += image.texel(x + i, y + j).as_dvec4();
                }
            }
            let expected = sum / f64::from(n * n);
            assert!((got.as_dvec4() - expected).abs().max_element() < 1e-5, "{got} {expected}");
        }
    }

    #[test]
    fn the_average_is_taken_in_linear_light() {
        let mut image = texture(16, 16, |x, _| if x % 2 == 0 { [255, 255, 255, 255] } else { [0, 0, 0, 255] });
        image.srgb = true;
        let mean = mean(&image);
        assert!((mean.x - 0.5).abs() < 1e-6, "{mean}");
    }

    #[test]
    fn transparent_texels_do_not_tint() {
        let image = texture(8, 8, |x, _| if x < 4 { [200, 10, 10, 255] } else { [0, 255, 0, 0] });
        let plain = image.mean(&Averages::default(), AlphaUse::Ignored);
        assert!((plain.x - 100.0 / 255.0).abs() < 1e-6, "where alpha means nothing it does not weight: {plain}");
        let mean = mean(&image);
        assert!(
            (mean - Vec4::new(200.0 / 255.0, 10.0 / 255.0, 10.0 / 255.0, 0.5)).abs().max_element() < 1e-6,
            "{mean}"
        );
    }

    #[test]
    fn an_alpha_test_is_made_before_averaging() {
        // A quarter of the texels pass; the plain mean of alpha would say that everything does.
        let image = texture(32, 32, |x, y| [0, 0, 0, if x % 2 == 0 && y % 2 == 0 { 255 } else { 120 }]);
        let test = AlphaUse::Test(0.5);
        let tested = image.sample(&Averages::default(), test, Vec2::splat(0.5), [Wrap::Repeat; 2], 0.5);
        assert!(image.is_tested(0.5) && !image.is_tested(0.0));
        assert!((tested.w - 0.25).abs() < 1e-6);
    }

    #[test]
    fn odd_sizes_and_extreme_coordinates_stay_in_range() {
        let image = texture(7, 3, |x, y| [(x * 30) as u8, (y * 100) as u8, 5, 255]);
        let mean = mean(&image).x * 255.0;
        assert!((mean - 90.0).abs() < 1e-3, "{mean}");
        for u in [0.0, -1e30, 1e30, 1e-30, f32::MAX, f32::NAN, f32::INFINITY] {
            for footprint in [0.0, 1e-20, 0.5, 1e30, f32::INFINITY] {
                for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                    let v = sample(&image, Vec2::splat(u), [wrap; 2], footprint);
                    assert!(v.is_finite() && v.min_element() >= 0.0, "{u} {footprint} {v}");
                }
            }
        }
        assert_eq!(sample(&Texture::default(), Vec2::ZERO, [Wrap::Repeat; 2], 1.0), Vec4::ONE);
    }

    #[test]
    fn samples_vary_smoothly_with_the_footprint() {
        let image = texture(256, 256, |x, y| [((x * x + y * 3) % 251) as u8, (x % 256) as u8, 0, 255]);
        let at = |footprint: f32| sample(&image, Vec2::new(0.37, 0.61), [Wrap::Repeat; 2], footprint).x;
        let mut last = at(0.05);
        for i in 1..400 {
            let next = at(0.05 * (1.0 + 0.02 * i as f32));
            assert!((next - last).abs() < 0.03, "{i}: {last} {next}");
            last = next;
        }
    }

    #[test]
    fn srgb_round_trip() {
        for c in 0..=255u8 {
            let back = linear_to_srgb(srgb_to_linear(f32::from(c) / 255.0)) * 255.0;
            assert!((back - f32::from(c)).abs() < 1e-2, "{c} {back}");
        }
    }
}
