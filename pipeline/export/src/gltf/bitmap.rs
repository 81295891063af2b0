//! A page as an 8-bit picture for `MOZ_lightmap`: linear, E / intensity.

use crate::{ExportError, Image8, Lightmap, encode_png};

/// Share of the covered texels that must not be clipped.
const KEPT: f64 = 0.999;

/// A page in 8 bits.
pub struct Bitmap {
    pub png: Vec<u8>,
    /// E (lux) that the byte 255 stands for.
    pub intensity: f32,
    /// Covered texels with a band above the intensity.
    pub clipped: usize,
}

impl Bitmap {
    /// One byte is E / intensity, rounded: an error of at most intensity / 510. The intensity is the largest E, unless
    /// a few texels (at most 0.1 %, close to a lamp as a rule) are more than twice as bright as all others: then those
    /// are clipped, so that eight bits suffice for the rest. Nothing is dithered or gamma-encoded.
    pub fn new(map: &Lightmap) -> Result<Self, ExportError> {
        let covered = || map.irradiance().iter().zip(map.coverage()).filter(|(_, c)| **c > 0.0);
        let mut peaks: Vec<f32> = covered().map(|(e, _)| e.max_element()).collect();
        peaks.sort_by(f32::total_cmp);
        let max = peaks.last().copied().unwrap_or(0.0);
        let high = peaks.get(((peaks.len() as f64 * KEPT) as usize).min(peaks.len().saturating_sub(1)));
        let high = high.copied().unwrap_or(0.0);
        let intensity = if high > 0.0 && max > 2.0 * high { high } else { max };
        // A dark page (or one so dark that its numbers are denormal) is black at intensity 1.
        let intensity = if intensity >= f32::MIN_POSITIVE { intensity } else { 1.0 };
        let clipped = peaks.iter().filter(|p| **p > intensity).count();
        let byte = |e: f32| (f64::from(e) / f64::from(intensity) * 255.0 + 0.5) as u8;
        let texels = map.irradiance().iter().map(|e| e.to_array().map(byte)).collect();
        let png = encode_png(&Image8 { width: map.width(), height: map.height(), texels })?;
        Ok(Self { png, intensity, clipped })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn decoded(bitmap: &Bitmap) -> Vec<f32> {
        let image = image::load_from_memory(&bitmap.png).unwrap().to_rgb8();
        image.as_raw().iter().map(|b| f32::from(*b) / 255.0 * bitmap.intensity).collect()
    }

    #[test]
    fn a_furnace_is_exact() {
        let pi = std::f32::consts::PI;
        let map = Lightmap::new(4, 4, vec![Vec3::splat(pi); 16], vec![1.0; 16]).unwrap();
        let bitmap = Bitmap::new(&map).unwrap();
        assert_eq!((bitmap.intensity, bitmap.clipped), (pi, 0));
        assert!(decoded(&bitmap).iter().all(|e| *e == pi));
    }

    #[test]
    fn every_value_is_within_half_a_step() {
        let e: Vec<Vec3> = (0..400).map(|i| Vec3::new(i as f32, 0.5 * i as f32, 3.0)).collect();
        let map = Lightmap::new(20, 20, e.clone(), vec![1.0; 400]).unwrap();
        let bitmap = Bitmap::new(&map).unwrap();
        let flat: Vec<f32> = e.iter().flat_map(|e| e.to_array()).collect();
        for (d, e) in decoded(&bitmap).iter().zip(flat) {
            assert!((d - e).abs() <= bitmap.intensity / 509.0, "{d} {e}");
        }
    }

    #[test]
    fn a_hot_spot_is_clipped_and_counted_and_padding_has_no_say() {
        let mut e = vec![Vec3::ONE; 10_000];
        e[..5].fill(Vec3::splat(1e6));
        let mut coverage = vec![1.0; 10_000];
        let bitmap = Bitmap::new(&Lightmap::new(100, 100, e.clone(), coverage.clone()).unwrap()).unwrap();
        assert_eq!((bitmap.intensity, bitmap.clipped), (1.0, 5));
        coverage[..5].fill(0.0);
        let bitmap = Bitmap::new(&Lightmap::new(100, 100, e, coverage).unwrap()).unwrap();
        assert_eq!((bitmap.intensity, bitmap.clipped), (1.0, 0));
    }

    #[test]
    fn darkness_and_extremes_stay_finite() {
        for e in [0.0, 1e-44, f32::MIN_POSITIVE, f32::MAX] {
            let map = Lightmap::new(1, 1, vec![Vec3::splat(e)], vec![1.0]).unwrap();
            let bitmap = Bitmap::new(&map).unwrap();
            assert!(bitmap.intensity.is_finite() && bitmap.intensity > 0.0);
            assert!(decoded(&bitmap).iter().all(|d| d.is_finite()));
        }
    }
}
