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

/// Standard errors by which light has to differ for it to be more than noise.
const NOISE: f32 = 4.0;

/// What more samples of a pixel are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Want {
    /// One of them shows all there is.
    Nothing,
    Coverage,
    Light,
}

/// What a pixel wants that has these neighbours.
pub fn want<'a>(pixel: &Pixel, neighbours: impl Iterator<Item = &'a Pixel>, tone: &ToneMap) -> Want {
    let Some(first) = pixel.samples.first() else { return Want::Nothing };
    let within = pixel.samples[1..].iter().map(|other| differ((pixel, first), (pixel, other), tone));
    let around = neighbours.map(|n| match n.samples.first() {
        Some(other) => differ((pixel, first), (n, other), tone),
        None => Want::Nothing,
    });
    within.chain(around).max().unwrap_or(Want::Nothing)
}

fn differ((pixel, sample): (&Pixel, &Sample), (other, there): (&Pixel, &Sample), tone: &ToneMap) -> Want {
    let (own, theirs) = (pixel.of(sample), other.of(there));
    if own.len() != theirs.len() || own.iter().zip(theirs).any(|(a, b)| !a.continues(b)) {
        return Want::Coverage;
    }
    let lights = || own.iter().map(|s| s.lit.irradiance);
    let shown = tone.encode(radiance(sample, own, lights()));
    let in_their_light = radiance(sample, own, theirs.iter().map(|s| s.lit.irradiance));
    let noisy = own.iter().zip(theirs).all(|(a, b)| is_noise(a, b));
    if !noisy && is_step(shown, tone.encode(in_their_light)) {
        return Want::Light;
    }
    let of_their_stuff = radiance(there, theirs, lights());
    if is_step(shown, tone.encode(of_their_stuff)) { Want::Coverage } else { Want::Nothing }
}

fn radiance(sample: &Sample, shown: &[Shown], light: impl Iterator<Item = Rgb>) -> Rgb {
    sample.background + shown.iter().zip(light).map(|(s, e)| s.radiance(e)).sum::<Rgb>()
}

/// The light of two layers differs by no more than their errors explain.
fn is_noise(a: &Shown, b: &Shown) -> bool {
    let apart = (a.lit.irradiance - b.lit.irradiance).element_sum().abs() / 3.0;
    match (a.lit.error, b.lit.error) {
        (None, None) => apart == 0.0,
        (x, y) => apart <= NOISE * x.unwrap_or_default().hypot(y.unwrap_or_default()),
    }
}

fn is_step(a: [u8; 3], b: [u8; 3]) -> bool {
    a.iter().zip(b).any(|(a, b)| a.abs_diff(b) >= STEP)
}
