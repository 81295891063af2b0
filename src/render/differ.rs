//! Which pixels want more samples: those where neighbours or their own samples differ.
//!
//! | what differs | more samples | their light |
//! |---|---|---|
//! | the surface: another object, side, plane or direction | yes | shared on every surface |
//! | the same surface, displayed otherwise in the same light (texture, sky) | yes | shared |
//! | the same surface in other light, by more than its noise (shadow edges) | yes | each its own |
//!
//! Displayed means after tone mapping, as sRGB bytes: that is where people see an edge.

use luxel_export::ToneMap;
use luxel_transport::Rgb;

use super::pixel::{Pixel, Sample, Shown};

/// Least difference of a band that counts, in sRGB bytes.
const STEP: u8 = 6;

/// Share by which all bands may differ without being looked at: by twice that, as the curve scales all bands by the
/// brightest, times 1/2.4, the largest power of sRGB, times 255 there are less than three steps.
const ALIKE: f32 = 0.01;

/// Standard errors, the largest around, by which light has to differ for it to be more than noise.
const NOISE: f32 = 5.0;

/// What more samples of a pixel are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Want {
    /// One of them shows all there is.
    Nothing,
    Coverage,
    Light,
}

/// What a pixel wants that has these neighbours.
pub fn want(pixel: &Pixel, neighbours: &[&Pixel], tone: &ToneMap) -> Want {
    let Some(first) = pixel.samples.first() else { return Want::Nothing };
    let own = (pixel, first);
    let around = || neighbours.iter().filter_map(|n| Some((*n, n.samples.first()?)));
    // An estimate of few values may be small by chance, of all of them it is not.
    let errors = around().chain([own]).flat_map(|(pixel, sample)| pixel.of(sample)).filter_map(|s| s.lit.error);
    let differ = Differ { tone, noise: NOISE * errors.fold(0.0, f32::max) };
    let within = pixel.samples[1..].iter().map(|other| (pixel, other));
    within.chain(around()).map(|other| differ.by(own, other)).max().unwrap_or(Want::Nothing)
}

struct Differ<'a> {
    tone: &'a ToneMap,
    /// Light that differs by no more than this is the same, for all that is known [lux].
    noise: f32,
}

impl Differ<'_> {
    fn by(&self, (pixel, sample): (&Pixel, &Sample), (other, there): (&Pixel, &Sample)) -> Want {
        let (own, theirs) = (pixel.of(sample), other.of(there));
        if own.len() != theirs.len() || own.iter().zip(theirs).any(|(a, b)| !a.continues(b)) {
            return Want::Coverage;
        }
        let lights = || own.iter().map(|s| s.lit.irradiance);
        let shown = radiance(sample, own, lights());
        let in_their_light = radiance(sample, own, theirs.iter().map(|s| s.lit.irradiance));
        let is_noise = own.iter().zip(theirs).all(|(a, b)| self.is_noise(a, b));
        if !is_noise && self.is_step(shown, in_their_light) {
            return Want::Light;
        }
        let of_their_stuff = radiance(there, theirs, lights());
        if self.is_step(shown, of_their_stuff) { Want::Coverage } else { Want::Nothing }
    }

    /// Two radiances are displayed differently.
    fn is_step(&self, a: Rgb, b: Rgb) -> bool {
        // The curve and sRGB only lessen ratios, so this is less than a step of any band, and spares the powers.
        if (a - b).abs().cmple(ALIKE * a.min(b)).all() {
            return false;
        }
        self.tone.encode(a).iter().zip(self.tone.encode(b)).any(|(a, b)| a.abs_diff(b) >= STEP)
    }

    fn is_noise(&self, a: &Shown, b: &Shown) -> bool {
        (a.lit.irradiance - b.lit.irradiance).element_sum().abs() / 3.0 <= self.noise
    }
}

fn radiance(sample: &Sample, shown: &[Shown], light: impl Iterator<Item = Rgb>) -> Rgb {
    sample.background + shown.iter().zip(light).map(|(s, e)| s.radiance(e)).sum::<Rgb>()
}
