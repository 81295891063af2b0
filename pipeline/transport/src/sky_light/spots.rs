//! The bright spots of an image sky: the radiance above a threshold, sampled where it is.
//!
//! The threshold T is a multiple of the mean luminance over the sphere. A radiance L of band maximum m > T splits
//! into L·T/m, which the cosine rays take, and the excess L·(1 − T/m). Texels are drawn in proportion to solid angle
//! times the largest excess among them and their neighbours, which covers bilinear filtering: wherever the excess
//! is not zero, neither is the density.

use std::f64::consts::PI;

use glam::{Vec2, Vec3};
use luxel_scene::sky::SkyImage;

use super::image_direction;
use crate::{Rgb, sampling::linear};

/// Multiple of the mean radiance from which on a sky counts as a spot.
const THRESHOLD: f64 = 4.0;

/// The place between four texel centres, and their excess (upper left, upper right, lower left, lower right).
struct Cell {
    x: u32,
    y: u32,
    corners: [f32; 4],
}

/// Cells that hold excess, and their cumulative distribution.
pub struct Spots {
    threshold: f32,
    width: u32,
    height: u32,
    rotation: f32,
    /// Column and row of each cell. Cell (x, y) lies right of the centre of column x and above the centre of row y;
    /// row 0 and row `height` are the half rows at the poles.
    cells: Vec<Cell>,
    /// Cumulative probability at the end of each cell; the last is 1.
    cumulative: Vec<f64>,
}

impl Spots {
    /// None where the image has no texel above the threshold, or none at all.
    pub fn new(image: &SkyImage) -> Option<Self> {
        let (w, h) = (image.width as usize, image.height as usize);
        if w == 0 || h == 0 || image.texels.len() != w * h {
            return None;
        }
        let value = |x: usize, y: usize| {
            let m = (image.texels[y * w + x] * image.strength).max_element();
            if m.is_finite() { m.max(0.0) } else { 0.0 }
        };
        let texel_row = |y: usize| solid_angle(y as f64 / h as f64, (y + 1) as f64 / h as f64, w);
        let rows = (0..h).map(|y| (0..w).map(|x| f64::from(value(x, y))).sum::<f64>() * texel_row(y));
        let mean = rows.sum::<f64>() / (4.0 * PI);
        let threshold = (THRESHOLD * mean) as f32;
        let (mut cells, mut cumulative, mut sum) = (Vec::new(), Vec::new(), 0.0);
        for y in 0..=h {
            let (top, bottom) = cell_rows(y, h);
            let solid = solid_angle(top, bottom, w);
            for x in 0..w {
                let (above, below, right) = (y.saturating_sub(1), y.min(h - 1), (x + 1) % w);
                let corners = [(x, above), (right, above), (x, below), (right, below)]
                    .map(|(x, y)| (value(x, y) - threshold).max(0.0));
                let mean = corners.iter().map(|&c| 0.25 * f64::from(c)).sum::<f64>();
                if mean > 0.0 {
                    sum += mean * solid;
                    cells.push(Cell { x: x as u32, y: y as u32, corners });
                    cumulative.push(sum);
                }
            }
        }
        cumulative.iter_mut().for_each(|c| *c /= sum);
        let (width, height, rotation) = (image.width, image.height, image.rotation);
        (!cells.is_empty()).then_some(Self { threshold, width, height, rotation, cells, cumulative })
    }

    /// The part of a radiance that belongs to a spot.
    pub fn excess(&self, radiance: Rgb) -> Rgb {
        let m = radiance.max_element();
        if m > self.threshold { radiance * (1.0 - self.threshold / m) } else { Rgb::ZERO }
    }

    /// A direction and its density [1/sr]; `choice` picks the cell, `within` the place in it.
    pub fn sample(&self, choice: f32, within: Vec2) -> (Vec3, f64) {
        let at = self.cumulative.partition_point(|&c| c <= f64::from(choice)).min(self.cells.len() - 1);
        let probability = self.cumulative[at] - if at > 0 { self.cumulative[at - 1] } else { 0.0 };
        let Cell { x, y, corners: [a, b, c, d] } = self.cells[at];
        let (top, bottom) = cell_rows(y as usize, self.height as usize);
        // Down by the marginal of the bilinear density, then across.
        let down = linear(a + b, c + d, within.y);
        let (left, right) = (a + (c - a) * down, b + (d - b) * down);
        let across = linear(left, right, within.x);
        let here = left + (right - left) * across;
        let relative = f64::from(here) / (0.25 * (f64::from(a) + f64::from(b) + f64::from(c) + f64::from(d)));
        let v = top + (bottom - top) * f64::from(down);
        let u = (x as f32 + 0.5 + across) / self.width as f32;
        let per_area = 2.0 * PI / f64::from(self.width) * PI * (bottom - top) * libm::sin(PI * v).max(1e-9);
        (image_direction(Vec2::new(u, v as f32), self.rotation), probability * relative.max(1e-9) / per_area)
    }
}

/// Upper and lower end of a row of cells, in [0, 1].
fn cell_rows(y: usize, h: usize) -> (f64, f64) {
    let end = |y: f64| (y / h as f64).clamp(0.0, 1.0);
    (end(y as f64 - 0.5), end(y as f64 + 0.5))
}

/// Solid angle [sr] of one of `w` columns between two heights of the image.
fn solid_angle(top: f64, bottom: f64, w: usize) -> f64 {
    2.0 * PI / w as f64 * (libm::cos(PI * top) - libm::cos(PI * bottom))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::r2;

    #[test]
    fn samples_integrate_the_excess_and_know_their_density() {
        let (width, height) = (64, 32);
        let mut texels = vec![Vec3::ONE; (width * height) as usize];
        texels[(9 * width + 63) as usize] = Vec3::new(4000.0, 3000.0, 100.0);
        texels[(20 * width + 5) as usize] = Vec3::splat(90.0);
        let image = SkyImage { width, height, texels, rotation: 0.7, strength: 2.0 };
        let spots = Spots::new(&image).unwrap();
        let sky = luxel_scene::Sky::Image(image);
        let n = 1_000_000;
        let whole: Rgb =
            (0..n).map(|i| spots.excess(sky.radiance(crate::sampling::sphere(r2(i, Vec2::ZERO))))).sum::<Rgb>()
                * (4.0 * std::f32::consts::PI / n as f32);
        let (mut sum, mut largest) = (glam::DVec3::ZERO, 0.0f64);
        let m = 20_000;
        for i in 0..m {
            let (d, density) = spots.sample((i as f32 + 0.5) / m as f32, r2(i, Vec2::ZERO));
            assert!((d.length() - 1.0).abs() < 1e-5);
            sum += spots.excess(sky.radiance(d)).as_dvec3() / density / f64::from(m);
            largest = largest.max(f64::from(spots.excess(sky.radiance(d)).x) / density);
        }
        assert!((sum.as_vec3() - whole).abs().max_element() < 0.01 * whole.max_element(), "{sum} {whole}");
        // The two are nearly proportional: no sample stands out.
        assert!(largest < 1.5 * sum.x, "{largest} {sum}");
    }

    #[test]
    fn directions_and_coordinates_are_inverse() {
        let image = SkyImage { width: 4, height: 2, texels: vec![Vec3::ONE; 8], rotation: 1.3, strength: 1.0 };
        for i in 0..200 {
            let d = crate::sampling::sphere(r2(i, Vec2::splat(0.4)));
            assert!((image_direction(image.project(d), 1.3) - d).length() < 2e-3, "{d}");
        }
        assert!(Spots::new(&image).is_none());
    }
}
