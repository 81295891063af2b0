//! Image skies as targets of next events: a texel in proportion to what it sends, a direction evenly within it.
//!
//! Texel (i, j) covers the solid angle Ω = 2π/w · (cos θⱼ − cos θⱼ₊₁). The radiance between texels is bilinear, so the
//! weight of one is Ω times the mean over its bilinear neighbourhood: positive wherever the sky shines.
//! Constant skies and gradients need none of this: directions in proportion to the cosine find them.

use glam::Vec3;
use luxel_scene::{Sky, sky::SkyImage};
use std::f64::consts::{PI, TAU};

use super::noise::{pick, weight};

pub(crate) struct SkyMap {
    image: SkyImage,
    /// Running sums of the weights of the rows.
    rows: Vec<f64>,
    /// Running sums of the weights within each row, row after row.
    columns: Vec<f64>,
}

impl SkyMap {
    /// None where directions in proportion to the cosine do as well, and for images that are not what they say.
    pub fn new(sky: &Sky) -> Option<Self> {
        let Sky::Image(image) = sky else { return None };
        let (w, h) = (image.width as usize, image.height as usize);
        if sky.is_dark() || w == 0 || w.checked_mul(h) != Some(image.texels.len()) {
            return None;
        }
        let shine = |x: usize, y: usize| f64::from(image.texels[y * w + x].max(Vec3::ZERO).element_sum());
        let (mut rows, mut columns) = (Vec::with_capacity(h), Vec::with_capacity(w * h));
        let mut all = 0.0;
        for y in 0..h {
            let near = [y.saturating_sub(1), y, (y + 1).min(h - 1)];
            let column = |x: usize| shine(x, near[0]) + 6.0 * shine(x, near[1]) + shine(x, near[2]);
            let mut sum = 0.0;
            for x in 0..w {
                let mean = (column((x + w - 1) % w) + 6.0 * column(x) + column((x + 1) % w)) / 64.0;
                sum += mean * solid_angle(w, h, y);
                columns.push(sum);
            }
            all += sum;
            rows.push(all);
        }
        (all > 0.0 && all.is_finite()).then(|| Self { image: image.clone(), rows, columns })
    }

    /// A unit direction and its density per steradian, by two numbers in [0, 1).
    pub fn sample(&self, [x, y]: [f64; 2]) -> Option<(Vec3, f64)> {
        let (w, h) = (self.image.width as usize, self.image.height as usize);
        let (row, y) = pick(&self.rows, y)?;
        let (column, x) = pick(self.row(row), x)?;
        let (top, bottom) = (libm::cos(PI * row as f64 / h as f64), libm::cos(PI * (row + 1) as f64 / h as f64));
        let cosine = (top + y * (bottom - top)).clamp(-1.0, 1.0);
        let sine = (1.0 - cosine * cosine).sqrt();
        let u = (column as f64 + x) / w as f64;
        let azimuth = (u - 0.5) * TAU - f64::from(self.image.rotation);
        let direction =
            Vec3::new((sine * libm::sin(azimuth)) as f32, cosine as f32, (-sine * libm::cos(azimuth)) as f32);
        Some((direction.normalize(), self.texel_density(row, column)))
    }

    /// The density per steradian of a unit direction.
    pub fn density(&self, direction: Vec3) -> f64 {
        let uv = self.image.project(direction);
        let column = ((uv.x * self.image.width as f32) as usize).min(self.image.width as usize - 1);
        let row = ((uv.y * self.image.height as f32) as usize).min(self.image.height as usize - 1);
        self.texel_density(row, column)
    }

    fn texel_density(&self, row: usize, column: usize) -> f64 {
        let total = self.rows.last().copied().unwrap_or(0.0);
        let share = weight(self.row(row), column) / total;
        share / solid_angle(self.image.width as usize, self.image.height as usize, row)
    }

    fn row(&self, row: usize) -> &[f64] {
        let w = self.image.width as usize;
        &self.columns[row * w..(row + 1) * w]
    }
}

/// Solid angle of a texel of row `y`.
fn solid_angle(w: usize, h: usize, y: usize) -> f64 {
    let (top, bottom) = (PI * y as f64 / h as f64, PI * (y + 1) as f64 / h as f64);
    TAU / w as f64 * (libm::cos(top) - libm::cos(bottom))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling;

    fn map() -> (Sky, SkyMap) {
        let (width, height) = (16, 8);
        let shine = |i: u32| if i % 37 == 5 { 90.0 } else { (i % 7) as f32 * 0.1 };
        let texels = (0..width * height).map(|i| Vec3::new(shine(i), shine(i + 3), 0.2)).collect();
        let sky = Sky::Image(SkyImage { width, height, texels, rotation: 1.1, strength: 2.0 });
        let map = SkyMap::new(&sky).unwrap();
        (sky, map)
    }

    #[test]
    fn the_density_of_a_sample_is_that_of_its_direction_and_integrates_to_one() {
        let (sky, map) = map();
        let n = 40_000;
        let (mut whole, mut light, mut sampled, mut differ) = (0.0, 0.0, 0.0, 0);
        for i in 0..n {
            let p = sampling::r2(i, glam::Vec2::ZERO);
            let even = sampling::sphere(p);
            whole += map.density(even) * 2.0 * TAU / f64::from(n);
            light += f64::from(sky.radiance(even).x) * 2.0 * TAU / f64::from(n);
            let (direction, density) = map.sample([f64::from(p.x), f64::from(p.y)]).unwrap();
            differ += u32::from((map.density(direction) - density).abs() > 1e-3 * density);
            sampled += f64::from(sky.radiance(direction).x) / density / f64::from(n);
        }
        assert!((whole - 1.0).abs() < 0.01, "{whole}");
        assert!((sampled / light - 1.0).abs() < 0.01, "{sampled} {light}");
        assert!(differ < n / 1000, "{differ} samples fell into another texel than they were meant for");
    }
}
