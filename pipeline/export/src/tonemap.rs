//! From radiance to a picture: exposure, curve, sRGB.
//!
//! Exposure and curve follow Reinhard, Stark, Shirley and Ferwerda, "Photographic Tone Reproduction for Digital
//! Images" (2002): the log-average luminance is laid on the key value 0.18 (their eq. 1, 2) and
//! L_d = L (1 + L / L_w²) / (1 + L) takes the white point L_w to 1 (eq. 4). The curve is applied to the brightest
//! band and the others are scaled along, so that hues stay.

use glam::Vec3;
use luxel_scene::texture::linear_to_srgb;
use luxel_scene::{Cancelled, Progress, watched};

use crate::png::Image8;

/// Where the log-average of a picture is put.
const KEY: f64 = 0.18;
/// Share of pixels at either end that has no say in the exposure: lamps in view, black cracks.
const TRIM: f64 = 0.02;
/// The luminance that this share of the pixels stays below is shown as white.
const WHITE: f64 = 0.995;

/// How radiance becomes display light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMap {
    /// Display units per cd/m².
    pub exposure: f32,
    /// Exposed value of the brightest band that becomes 1.
    pub white: f32,
}

/// Luminance Y of linear Rec. 709.
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

impl ToneMap {
    /// Exposes for a picture of radiances [cd/m²]. Black pixels (nothing there) have no say; a black picture gets
    /// exposure 1.
    pub fn auto(radiance: &[Vec3], progress: &dyn Progress) -> Result<Self, Cancelled> {
        let seen = |p: &Vec3| p.is_finite() && luminance(*p) > 0.0;
        let mut lit: Vec<f32> = radiance.iter().filter(|p| seen(p)).map(|p| luminance(*p)).collect();
        if lit.is_empty() {
            return Ok(Self { exposure: 1.0, white: 1.0 });
        }
        progress.check()?;
        lit.sort_by(f32::total_cmp);
        let at = |share: f64| ((lit.len() - 1) as f64 * share) as usize;
        let middle = &lit[at(TRIM)..=at(1.0 - TRIM)];
        let logs = watched(middle, progress).map(|l| Ok(libm::log(f64::from(*l?))));
        let mean = logs.sum::<Result<f64, Cancelled>>()? / middle.len() as f64;
        let exposure = (KEY / libm::exp(mean)).clamp(f64::from(f32::MIN_POSITIVE), f64::from(f32::MAX)) as f32;
        let white = (f64::from(lit[at(WHITE)]) * f64::from(exposure)).clamp(1.0, 1e6) as f32;
        Ok(Self { exposure, white })
    }

    /// Display light in [0, 1], linear; black for what is no light.
    pub fn apply(&self, radiance: Vec3) -> Vec3 {
        let max = f64::from(radiance.max_element()) * f64::from(self.exposure);
        if !radiance.is_finite() || max <= 0.0 {
            return Vec3::ZERO;
        }
        let white = f64::from(self.white);
        // Past the white point the curve would go on rising; display light ends there.
        let max_displayed = if max >= white { 1.0 } else { max * (1.0 + max / (white * white)) / (1.0 + max) };
        let scale = max_displayed / f64::from(radiance.max_element());
        let band = |x: f32| (f64::from(x) * scale).clamp(0.0, 1.0) as f32;
        Vec3::new(band(radiance.x), band(radiance.y), band(radiance.z))
    }

    /// Display light as sRGB bytes.
    pub fn encode(&self, radiance: Vec3) -> [u8; 3] {
        self.apply(radiance).to_array().map(|c| (linear_to_srgb(c) * 255.0 + 0.5) as u8)
    }

    /// A whole picture; `radiance` has `width × height` entries, row-major from the top.
    pub fn picture(
        &self,
        width: u32,
        height: u32,
        radiance: &[Vec3],
        progress: &dyn Progress,
    ) -> Result<Image8, Cancelled> {
        let texels = watched(radiance, progress).map(|p| Ok(self.encode(*p?)));
        Ok(Image8 { width, height, texels: texels.collect::<Result<_, Cancelled>>()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;
    use proptest::prelude::*;

    fn auto(radiance: &[Vec3]) -> ToneMap {
        ToneMap::auto(radiance, &Silent).unwrap()
    }

    #[test]
    fn an_even_wall_is_shown_as_middle_grey_at_any_scale() {
        for level in [1e-6, 1.0, 1e9] {
            let map = auto(&[Vec3::splat(level); 64]);
            let grey = map.apply(Vec3::splat(level)).x;
            // At the key, with white = 1: 0.18 · 1.18 / 1.18.
            assert!((grey - 0.18).abs() < 1e-4, "{level}: {grey}");
        }
    }

    #[test]
    fn a_lamp_in_view_and_a_black_sky_do_not_move_the_exposure() {
        let plain = auto(&[Vec3::ONE; 1000]);
        let mut picture = vec![Vec3::ONE; 1000];
        picture[..10].fill(Vec3::splat(1e6));
        picture.extend([Vec3::ZERO; 500]);
        let with_lamp = auto(&picture);
        assert!((plain.exposure / with_lamp.exposure - 1.0).abs() < 1e-6);
    }

    #[test]
    fn extremes_stay_in_range() {
        let map = auto(&[Vec3::splat(f32::MAX), Vec3::splat(f32::MIN_POSITIVE), Vec3::NAN]);
        for x in [f32::MAX, f32::MIN_POSITIVE, -1.0, f32::NAN, f32::INFINITY, 0.0] {
            let shown = map.apply(Vec3::splat(x));
            assert!(shown.is_finite() && shown.min_element() >= 0.0 && shown.max_element() <= 1.0, "{x}: {shown}");
        }
        assert_eq!(auto(&[]), ToneMap { exposure: 1.0, white: 1.0 });
        assert_eq!(map.encode(Vec3::NAN), [0; 3]);
    }

    #[test]
    fn white_is_white() {
        let map = ToneMap { exposure: 0.5, white: 4.0 };
        assert_eq!(map.encode(Vec3::splat(8.0)), [255; 3]);
        assert_eq!(map.encode(Vec3::ZERO), [0; 3]);
    }

    proptest! {
        #[test]
        fn more_light_is_never_shown_darker(a in 0.0f32..1e6, b in 0.0f32..1e6, white in 1.0f32..100.0) {
            let map = ToneMap { exposure: 0.01, white };
            let (lo, hi) = (a.min(b), a.max(b));
            let (lo, hi) = (map.encode(Vec3::new(lo, lo * 0.5, 0.0)), map.encode(Vec3::new(hi, hi * 0.5, 0.0)));
            prop_assert!(lo[0] <= hi[0] && lo[1] <= hi[1]);
        }

        #[test]
        fn hues_stay(r in 0.01f32..1e4, g in 0.01f32..1e4, b in 0.01f32..1e4) {
            let colour = Vec3::new(r, g, b);
            let shown = ToneMap { exposure: 0.1, white: 3.0 }.apply(colour);
            prop_assert!((shown / shown.max_element() - colour / colour.max_element()).abs().max_element() < 1e-5);
        }
    }
}
