//! The error of light at the texels of a [`Truth`], by the metrics of the whole house ([`crate::verify::score`]), in a
//! form that is stored.

use luxel_transport::{Rgb, methods::Light, reference::Estimate};
use serde::{Deserialize, Serialize};

use super::truth::{Known, Truth};
use crate::verify::{Sample, measure, part};

/// The error of some light. All but the mean are shares of the mean irradiance; intervals hold with 95 % confidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Mean of the reference [lux].
    pub mean: f64,
    /// Root mean square of the reference's standard error.
    pub noise: f64,
    /// Of all light, over all bands, the reference's noise taken off.
    pub rmse: f64,
    pub rmse_low: f64,
    pub rmse_high: f64,
    pub relmse: f64,
    pub bias: f64,
    pub bias_low: f64,
    pub bias_high: f64,
    /// Of the relative error, noise included.
    pub median: f64,
    pub p95: f64,
    /// Parts, over the mean of all light, noise taken off.
    pub direct_rmse: f64,
    pub direct_bias: f64,
    pub indirect_rmse: f64,
    pub indirect_bias: f64,
}

impl Score {
    /// The error of `light` at the texels of the truth, in their order.
    pub fn of(light: &[Light], truth: &Truth) -> Self {
        let samples = |found: fn(&Light) -> Rgb, known: fn(&Estimate) -> (Rgb, Rgb, f32)| -> Vec<Sample> {
            let sample = |(light, truth): (&Light, &Known)| {
                let (expected, band_error, error) = known(&truth.light);
                Sample { found: found(light), expected, band_error, error, weight: truth.weight }
            };
            light.iter().zip(&truth.points).map(sample).collect()
        };
        let whole = measure(&samples(Light::total, |e| (e.total, e.band_error, e.standard_error)));
        // The bands of a part have no errors of their own.
        let [direct, indirect] = [
            samples(|l| l.direct, |e| (e.direct, Rgb::splat(e.direct_error), e.direct_error)),
            samples(|l| l.indirect, |e| (e.indirect, Rgb::splat(e.indirect_error), e.indirect_error)),
        ]
        .map(|samples| part(&samples, whole.mean));
        Self {
            mean: whole.mean,
            noise: whole.noise,
            rmse: whole.rmse.value,
            rmse_low: whole.rmse.low,
            rmse_high: whole.rmse.high,
            relmse: whole.rel_mse,
            bias: whole.bias.value,
            bias_low: whole.bias.low,
            bias_high: whole.bias.high,
            median: whole.median.value,
            p95: whole.p95.value,
            direct_rmse: direct.0,
            direct_bias: direct.1,
            indirect_rmse: indirect.0,
            indirect_bias: indirect.1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_errors_of_their_own() {
        let known =
            Estimate { direct: Rgb::splat(3.0), indirect: Rgb::ONE, total: Rgb::splat(4.0), ..Estimate::default() };
        let point = Known { texel: 0, weight: 1.0, light: known };
        let truth = Truth { points: vec![point; 2], ..Truth::default() };
        let light = |direct: f32, indirect: f32| Light {
            direct: Rgb::splat(direct),
            indirect: Rgb::splat(indirect),
            ..Light::default()
        };
        let score = Score::of(&[light(3.0, 1.4), light(3.0, 0.6)], &truth);
        assert!((score.mean - 4.0).abs() < 1e-6 && score.direct_rmse.abs() < 1e-6, "{score:?}");
        assert!((score.rmse - 0.1).abs() < 1e-6 && (score.indirect_rmse - 0.1).abs() < 1e-6, "{score:?}");
        assert!(score.bias.abs() < 1e-6 && score.noise == 0.0, "{score:?}");
    }
}
