//! The error of light at texels against the reference, by the metrics of all reports: over texels that were drawn in
//! proportion to their area, over all three bands.
//!
//! ```text
//! RMSE    √(mean |ΔE|²) / Ē          bias  mean ΔY / Ē              p95, median  of |ΔY| / max(Y, Ē/100)
//! relMSE  mean |ΔE|² / (Y² + (Ē/100)²)                              Y  mean of the bands, Ē  mean of the true Y
//! ```
//!
//! The reference's own variance is known for every texel, so its part of a mean square is taken off:
//! `corrected = √max(0, RMSE² − noise²)`.

use luxel_transport::{Rgb, methods::Light};
use serde::{Deserialize, Serialize};

use super::truth::Truth;

/// The error of some light; shares of the mean irradiance, but for the mean itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean of the reference [lux].
    pub mean: f64,
    /// Of all light, the reference's noise included.
    pub rmse: f64,
    /// Root mean square of the reference's standard error.
    pub noise: f64,
    /// RMSE with the noise taken off.
    pub corrected: f64,
    /// Standard error of the corrected RMSE, by the spread of squares over texels.
    pub rmse_error: f64,
    pub relmse: f64,
    pub bias: f64,
    /// 95 % of the mean difference lies within so much of the bias.
    pub bias_error: f64,
    pub median: f64,
    pub p95: f64,
    /// Parts, over the mean of all light, noise taken off.
    pub direct_rmse: f64,
    pub direct_bias: f64,
    pub indirect_rmse: f64,
    pub indirect_bias: f64,
}

/// Normal quantile of a two-sided 95 % interval.
pub const Z95: f64 = 1.959_964;

impl Score {
    /// The error of `light` at the texels of the truth, in their order.
    pub fn of(light: &[Light], truth: &Truth) -> Self {
        let n = truth.points.len().max(1) as f64;
        let mean = truth.mean();
        let floor = 0.01 * mean;
        let over = |x: f64| if mean > 0.0 { x / mean } else { 0.0 };
        let pairs = || light.iter().zip(&truth.points);
        let squares: Vec<f64> = pairs().map(|(l, t)| square(l.total() - t.total())).collect();
        let noises: Vec<f64> = truth.points.iter().map(|t| t.variance).collect();
        let (square_mean, noise) = (average(&squares), average(&noises));
        let clean = (square_mean - noise).max(0.0);
        // The delta method: Var √m = Var m / 4m.
        let spread = squares.iter().zip(&noises).map(|(s, v)| (s - v - (square_mean - noise)).powi(2)).sum::<f64>();
        let deviation = (spread / (n * (n - 1.0).max(1.0))).sqrt();
        let rmse_error = if clean > 0.0 { 0.5 * deviation / clean.sqrt() } else { deviation.sqrt() };
        let differences: Vec<f64> = pairs().map(|(l, t)| band_mean(l.total() - t.total())).collect();
        let bias = average(&differences);
        let wander = differences.iter().map(|d| (d - bias).powi(2)).sum::<f64>() / (n * (n - 1.0).max(1.0));
        let mut relative: Vec<f64> =
            differences.iter().zip(&truth.points).map(|(d, t)| d.abs() / band_mean(t.total()).max(floor)).collect();
        relative.sort_by(f64::total_cmp);
        let percentile = |q: f64| relative.get(((n - 1.0) * q) as usize).copied().unwrap_or_default();
        let relmse: Vec<f64> = squares
            .iter()
            .zip(&truth.points)
            .map(|(s, t)| s / (band_mean(t.total()).powi(2) + floor * floor).max(f64::MIN_POSITIVE))
            .collect();
        let part = |get: fn(&Light) -> Rgb, of: fn(&super::truth::Known) -> (Rgb, f64)| {
            let d: Vec<f64> = pairs().map(|(l, t)| square(get(l) - of(t).0) - of(t).1).collect();
            let b: Vec<f64> = pairs().map(|(l, t)| band_mean(get(l) - of(t).0)).collect();
            (over(average(&d).max(0.0).sqrt()), over(average(&b)))
        };
        let (direct_rmse, direct_bias) = part(|l| l.direct, |t| (t.direct, t.direct_variance));
        let (indirect_rmse, indirect_bias) = part(|l| l.indirect, |t| (t.indirect, t.indirect_variance));
        Self {
            mean,
            rmse: over(square_mean.sqrt()),
            noise: over(noise.sqrt()),
            corrected: over(clean.sqrt()),
            rmse_error: over(rmse_error),
            relmse: average(&relmse),
            bias: over(bias),
            bias_error: over(Z95 * wander.sqrt()),
            median: percentile(0.5),
            p95: percentile(0.95),
            direct_rmse,
            direct_bias,
            indirect_rmse,
            indirect_bias,
        }
    }

    /// The corrected RMSE is below this with a certainty of 97.5 %.
    pub fn most(&self) -> f64 {
        self.corrected + Z95 * self.rmse_error
    }
}

/// Mean over the bands of the squares.
fn square(e: Rgb) -> f64 {
    e.as_dvec3().length_squared() / 3.0
}

fn band_mean(e: Rgb) -> f64 {
    e.as_dvec3().element_sum() / 3.0
}

fn average(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
