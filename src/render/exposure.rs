//! How bright a picture is shown.
//!
//! Automatic: the log-average of what is seen becomes middle grey ([`ToneMap::auto`]). Chosen: an exposure value EV₁₀₀,
//! as a camera's at ISO 100 (ISO 2720; 15 in sunlight, 5 to 8 in rooms, one more is half as bright), where the radiance
//! 1.2·2^EV cd/m² saturates a sensor and is exposed to 1.

use luxel_export::ToneMap;
use luxel_scene::{Cancelled, Progress, Uncounted};

use super::film::expose;
use super::light::Illumination;
use super::pixel::Screen;

/// Radiance that an exposure of 0 EV saturates [cd/m²].
const SATURATES: f64 = 1.2;

/// Exposed value that a chosen exposure shows as white: two stops above saturation, which the curve rolls off.
const WHITE: f32 = 4.0;

/// Exposure values that can be chosen.
pub const RANGE: std::ops::RangeInclusive<f64> = -60.0..=60.0;

/// Longest side of the picture by which the exposure is estimated beforehand.
const PROBE: u32 = 48;

/// The tone map of a chosen exposure.
pub fn chosen(ev: f64) -> ToneMap {
    let exposure = 1.0 / (SATURATES * libm::exp2(ev.clamp(*RANGE.start(), *RANGE.end())));
    ToneMap { exposure: exposure as f32, white: WHITE }
}

/// The exposure value of a tone map.
pub fn value(tone: &ToneMap) -> f64 {
    libm::log2(1.0 / (SATURATES * f64::from(tone.exposure)))
}

/// An estimate of the automatic exposure, by a small picture: for what has to be known while the picture is taken.
///
/// # Errors
/// When it is no longer wanted.
pub fn estimate(screen: &Screen, light: &dyn Illumination, progress: &dyn Progress) -> Result<ToneMap, Cancelled> {
    let longest = screen.width.max(screen.height).max(1);
    let side = |pixels: u32| (u64::from(pixels) * u64::from(PROBE.min(longest)) / u64::from(longest)).max(1) as u32;
    let (width, height) = (side(screen.width), side(screen.height));
    let small = Screen { width, height, samples: 1, ..*screen };
    let picture = expose(&small, light, &ToneMap { exposure: 1.0, white: 1.0 }, &Uncounted(progress))?;
    ToneMap::auto(&picture.radiance, progress)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn one_more_is_half_as_bright_and_values_come_back() {
        assert!((chosen(5.0).exposure / chosen(6.0).exposure - 2.0).abs() < 1e-6);
        assert!((chosen(0.0).exposure * 1.2 - 1.0).abs() < 1e-6);
        for ev in [-20.0, 0.0, 7.5] {
            assert!((value(&chosen(ev)) - ev).abs() < 1e-6);
        }
        let sun = chosen(15.0);
        assert_eq!(sun.encode(Vec3::splat(1.2 * 32768.0 * 4.0)), [255; 3]);
    }
}
