//! A page as an 8-bit picture for `MOZ_lightmap`: linear, E / intensity.
//!
//! Where light is a few steps of a byte, rounding would make it bands of wrong colour. So values are rounded up or down
//! with the odds of their fraction, by a threshold that differs from texel to texel: right on average, and the grain is
//! much finer than bands. Whole steps, 0 among them, stay what they are.

use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{Effort, ExportError, Image8, Lightmap, encode_png_with};

/// A page as a PNG. One byte is E / `intensity` (lux) within one step, intensity / 255; what is brighter is clipped.
/// Nothing is gamma-encoded.
pub fn png(map: &Lightmap, intensity: f32, effort: Effort, progress: &dyn Progress) -> Result<Vec<u8>, ExportError> {
    let byte = |e: f32, threshold: f64| (f64::from(e) / f64::from(intensity) * 255.0 + threshold) as u8;
    let mut texels = vec![[0; 3]; map.irradiance().len()];
    let width = map.width().max(1) as usize;
    let rows = texels.par_chunks_mut(width).zip(map.irradiance().par_chunks(width)).zip(0u32..map.height());
    rows.try_for_each(|((row, light), y)| {
        progress.check()?;
        for ((texel, e), x) in row.iter_mut().zip(light).zip(0u32..) {
            // The same for all bands, so that the grain has no colour of its own.
            let threshold = threshold(x, y);
            *texel = e.to_array().map(|e| byte(e, threshold));
        }
        Ok::<(), Cancelled>(())
    })?;
    encode_png_with(&Image8 { width: map.width(), height: map.height(), texels }, effort, progress)
}

/// Interleaved gradient noise (Jimenez 2014, "Next generation post processing in Call of Duty: Advanced Warfare"): any
/// 3 × 3 texels hold nearly evenly spread values of \[0, 1).
fn threshold(x: u32, y: u32) -> f64 {
    (52.9829189 * (0.06711056 * f64::from(x) + 0.00583715 * f64::from(y)).fract()).fract()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::Silent;

    fn decoded(png: &[u8], intensity: f32) -> Vec<f32> {
        let image = image::load_from_memory(png).unwrap().to_rgb8();
        image.as_raw().iter().map(|b| f32::from(*b) / 255.0 * intensity).collect()
    }

    #[test]
    fn a_furnace_is_exact() {
        let pi = std::f32::consts::PI;
        let map = Lightmap::new(4, 4, vec![Vec3::splat(pi); 16], vec![1.0; 16]).unwrap();
        assert!(decoded(&png(&map, pi, Effort::Small, &Silent).unwrap(), pi).iter().all(|e| *e == pi));
    }

    #[test]
    fn light_below_a_step_is_right_on_average() {
        for part in [0.1, 0.5, 0.73] {
            let (step, n) = (100.0 / 255.0, 64);
            let e = Vec3::new(part, 2.0 + part, 0.0) * step;
            let map = Lightmap::new(n, n, vec![e; (n * n) as usize], vec![1.0; (n * n) as usize]).unwrap();
            let found = decoded(&png(&map, 100.0, Effort::Small, &Silent).unwrap(), 100.0);
            for band in 0..3 {
                let mean = found.iter().skip(band).step_by(3).sum::<f32>() / (n * n) as f32;
                assert!((mean - e[band]).abs() < 0.02 * step, "{part}: {mean} {}", e[band]);
            }
        }
    }

    #[test]
    fn every_value_is_within_a_step_and_what_is_brighter_is_clipped() {
        let e: Vec<Vec3> = (0..400).map(|i| Vec3::new(i as f32, 0.5 * i as f32, 3.0)).collect();
        let map = Lightmap::new(20, 20, e.clone(), vec![1.0; 400]).unwrap();
        let flat: Vec<f32> = e.iter().flat_map(|e| e.to_array()).collect();
        for intensity in [399.0, 100.0] {
            for (d, e) in decoded(&png(&map, intensity, Effort::Small, &Silent).unwrap(), intensity).iter().zip(&flat) {
                assert!((d - e.min(intensity)).abs() <= intensity / 254.0, "{d} {e}");
            }
        }
    }

    #[test]
    fn extremes_stay_finite() {
        for e in [0.0, 1e-44, f32::MIN_POSITIVE, f32::MAX] {
            let map = Lightmap::new(1, 1, vec![Vec3::splat(e)], vec![1.0]).unwrap();
            for intensity in [f32::MIN_POSITIVE, 1.0, f32::MAX] {
                assert!(
                    decoded(&png(&map, intensity, Effort::Small, &Silent).unwrap(), intensity)
                        .iter()
                        .all(|d| d.is_finite())
                );
            }
        }
    }
}
