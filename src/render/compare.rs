//! Methods side by side, as in the paper's Figure 3: one labelled picture of all, and below each its difference to one
//! of them.
//!
//! Differences are of the radiance L that surfaces reflect, pixel by pixel, over its mean R in the picture that is compared
//! to: RMSE = √(mean of (L − L₀)² over pixels and bands)/R, bias = mean of (L − L₀)/R. The maps show the band mean of
//! (L − L₀)/R in signed false colour. Light straight from emitters and sky is no method's, and hundreds of times as bright:
//! as methods have edges elsewhere, pixels at the edge of a lamp have other samples, and hold other shares of it.

use luxel_export::{Image8, ToneMap};
use luxel_scene::{Cancelled, Progress};

use super::Picture;
use super::label::{self, LINE};

/// A picture with what is known of it.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The method, as in a label.
    pub name: String,
    pub picture: Picture,
    /// Wall-clock time of all that the method needs.
    pub seconds: f64,
}

/// How far a picture is from another one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// As shares of the mean reflected radiance of the other one.
    pub rmse: f64,
    pub bias: f64,
    /// 95th percentile over pixels of the band mean's absolute difference.
    pub p95: f64,
}

/// The difference of `picture` to `other`, which are of one size; none where `other` reflects no light, of which it would
/// be a share.
pub fn difference(picture: &Picture, other: &Picture) -> Option<Difference> {
    let mean = other.mean_reflected();
    if mean.is_nan() || mean <= 0.0 {
        return None;
    }
    let mut sizes: Vec<f32> = errors(picture, other, mean).map(f32::abs).collect();
    sizes.sort_by(f32::total_cmp);
    let (mut square, mut sum) = (0.0, 0.0);
    for (a, b) in picture.reflected.iter().zip(&other.reflected) {
        let d = a.as_dvec3() - b.as_dvec3();
        square += d.length_squared() / 3.0;
        sum += d.element_sum() / 3.0;
    }
    let n = picture.reflected.len().max(1) as f64;
    let p95 = sizes.get((sizes.len() as f64 * 0.95) as usize).copied().map_or(0.0, f64::from);
    Some(Difference { rmse: (square / n).sqrt() / mean, bias: sum / n / mean, p95 })
}

/// Difference of the band mean of what every pixel reflects, over `mean`.
fn errors<'a>(picture: &'a Picture, other: &'a Picture, mean: f64) -> impl Iterator<Item = f32> + 'a {
    let pairs = picture.reflected.iter().zip(&other.reflected);
    pairs.map(move |(a, b)| ((a.as_dvec3() - b.as_dvec3()).element_sum() / 3.0 / mean) as f32)
}

/// Space between the parts of a sheet [pixels].
const GAP: u32 = 8;
const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [20; 3];

/// Steps of false colour on either side of none: they are told apart by eye, and flat areas pack well.
const STEPS: f32 = 10.0;

/// All pictures at one exposure, and below each its difference to number `against`.
///
/// # Errors
/// When it is no longer wanted.
///
/// # Panics
/// When there is no such number, or when pictures differ in size.
pub fn sheet(trials: &[Trial], against: usize, tone: &ToneMap, progress: &dyn Progress) -> Result<Image8, Cancelled> {
    let reference = &trials[against].picture;
    assert!(trials.iter().all(|t| (t.picture.width, t.picture.height) == (reference.width, reference.height)));
    let differences: Vec<Option<Difference>> = trials.iter().map(|t| difference(&t.picture, reference)).collect();
    let scale = scale(&differences);
    let labels: Vec<[String; 3]> = trials
        .iter()
        .zip(&differences)
        .enumerate()
        .map(|(i, (t, d))| [t.name.clone(), effort(t), if i == against { noise(t) } else { figures(d) }])
        .collect();
    let widest = labels.iter().flatten().map(|l| label::width(l)).max().unwrap_or_default();
    let (column, picture) = (reference.width.max(widest), reference.height);
    let mut sheet = paper(GAP + trials.len() as u32 * (column + GAP), 4 * GAP + 3 * LINE + 2 * picture);
    for (i, (trial, [name, effort, figures])) in trials.iter().zip(&labels).enumerate() {
        let left = GAP + i as u32 * (column + GAP);
        let mut top = GAP;
        for line in [name, effort] {
            label::write(&mut sheet, (left, top), line, INK);
            top += LINE;
        }
        let Picture { width, height, radiance, .. } = &trial.picture;
        paste(&mut sheet, (left, top), &tone.picture(*width, *height, radiance, progress)?);
        top += picture + GAP;
        label::write(&mut sheet, (left, top), figures, INK);
        top += LINE;
        if i == against {
            legend(&mut sheet, (left, top), (column, picture), scale);
        } else {
            paste(&mut sheet, (left, top), &map(&trial.picture, reference, scale));
        }
    }
    Ok(sheet)
}

fn paper(width: u32, height: u32) -> Image8 {
    Image8 { width, height, texels: vec![PAPER; width as usize * height as usize] }
}

fn paste(sheet: &mut Image8, (left, top): (u32, u32), image: &Image8) {
    for (y, row) in (top..).zip(image.texels.chunks(image.width.max(1) as usize)) {
        let start = y as usize * sheet.width as usize + left as usize;
        sheet.texels[start..start + row.len()].copy_from_slice(row);
    }
}

fn effort(trial: &Trial) -> String {
    format!("{} s, {} M rays", digits(trial.seconds), digits(trial.picture.spent.rays as f64 * 1e-6))
}

fn noise(trial: &Trial) -> String {
    match trial.picture.relative_error() {
        Some(error) => format!("noise {} %", digits(100.0 * error)),
        None => "compared to this".into(),
    }
}

fn figures(difference: &Option<Difference>) -> String {
    let Some(Difference { rmse, bias, .. }) = difference else { return "RMSE -, bias -".into() };
    let sign = if *bias < 0.0 { '-' } else { '+' };
    format!("RMSE {} %, bias {sign}{} %", digits(100.0 * rmse), digits(100.0 * bias.abs()))
}

/// Three digits.
pub fn digits(value: f64) -> String {
    match value.abs() {
        a if a >= 99.95 => format!("{value:.0}"),
        a if a >= 9.995 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// What the strongest colours stand for: the largest 95th percentile, rounded up to 1, 2 or 5 times a power of ten but
/// for a hair.
fn scale(differences: &[Option<Difference>]) -> f32 {
    let largest = differences.iter().flatten().map(|d| d.p95).fold(1e-3, f64::max);
    let power = libm::exp10(libm::floor(libm::log10(largest)));
    let steps = [1.0, 2.0, 5.0, 10.0];
    (steps.into_iter().map(|s| s * power).find(|s| *s >= largest * (1.0 - 1e-4)).unwrap_or(largest)) as f32
}

/// How what two pictures reflect differs, in false colour.
fn map(picture: &Picture, other: &Picture, scale: f32) -> Image8 {
    let mean = other.mean_reflected();
    let mean = if mean > 0.0 { mean } else { f64::INFINITY };
    let texels = errors(picture, other, mean).map(|error| colour(error / scale)).collect();
    Image8 { width: picture.width, height: picture.height, texels }
}

/// Blue below 0, white at 0, red above, in steps; strongest at ±1 (ColorBrewer's RdBu: Brewer 2003).
fn colour(value: f32) -> [u8; 3] {
    const BLUE: [[f32; 3]; 3] = [[247.0, 247.0, 247.0], [67.0, 147.0, 195.0], [5.0, 48.0, 97.0]];
    const RED: [[f32; 3]; 3] = [[247.0, 247.0, 247.0], [214.0, 96.0, 77.0], [103.0, 0.0, 31.0]];
    let value = if value.is_finite() { (value.clamp(-1.0, 1.0) * STEPS).round() / STEPS } else { 1.0 };
    let (ramp, x) = (if value < 0.0 { BLUE } else { RED }, 2.0 * value.abs());
    let (from, t) = if x < 1.0 { (0, x) } else { (1, x - 1.0) };
    std::array::from_fn(|c| (ramp[from][c] + (ramp[from + 1][c] - ramp[from][c]) * t).round() as u8)
}

/// What the colours mean, in a cell of the sheet.
fn legend(sheet: &mut Image8, (left, top): (u32, u32), (width, height): (u32, u32), scale: f32) {
    let bar = Image8 { width: width.min(32), height: height.saturating_sub(3 * LINE + GAP).max(1), texels: Vec::new() };
    let level = |y: u32| 1.0 - 2.0 * (y as f32 + 0.5) / bar.height as f32;
    let texels = (0..bar.height).flat_map(|y| std::iter::repeat_n(colour(level(y)), bar.width as usize)).collect();
    let top = top + LINE / 2;
    paste(sheet, (left, top), &Image8 { texels, ..bar });
    let percent = 100.0 * f64::from(scale);
    let marks = [(0.0f64, "+"), (0.25, "+"), (0.5, ""), (0.75, "-"), (1.0, "-")];
    // In a low picture only every other one has room.
    for (share, sign) in marks.into_iter().step_by(if bar.height < 4 * LINE { 2 } else { 1 }) {
        // Round in decimal, as the scale was chosen.
        let value = (1e4 * percent * (1.0 - 2.0 * share).abs()).round() / 1e4;
        let y = top + (share * f64::from(bar.height)) as u32;
        label::write(sheet, (left + bar.width + GAP, y.saturating_sub(LINE / 2)), &format!("{sign}{value} %"), INK);
    }
    let below = top + bar.height + GAP;
    for (y, line) in [(below, "of the mean radiance"), (below + LINE, "that surfaces reflect")] {
        label::write(sheet, (left, y), line, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::Silent;
    use luxel_transport::Rgb;

    fn grey(level: f32) -> Trial {
        let mut picture = Picture::black(40, 30);
        picture.radiance.fill(Rgb::splat(level));
        picture.reflected.fill(Rgb::splat(level));
        Trial { name: "grey".into(), picture, seconds: 1.25 }
    }

    #[test]
    fn a_picture_does_not_differ_from_itself_and_a_constant_is_a_bias() {
        let (one, more) = (grey(2.0), grey(2.5));
        assert_eq!(difference(&one.picture, &one.picture), Some(Difference::default()));
        let found = difference(&more.picture, &one.picture).unwrap();
        for share in [found.rmse, found.bias, found.p95] {
            assert!((share - 0.25).abs() < 1e-6, "{found:?}");
        }
        assert!((difference(&grey(1.0).picture, &one.picture).unwrap().bias + 0.5).abs() < 1e-6);
        assert_eq!(difference(&one.picture, &grey(0.0).picture), None, "there is nothing to be a share of");
        assert_eq!(figures(&None), "RMSE -, bias -");
    }

    #[test]
    fn light_straight_from_lamps_and_sky_is_no_difference() {
        let (one, mut other) = (grey(2.0), grey(2.5));
        let without = difference(&other.picture, &one.picture);
        // Of a lamp's edge the other one has another share.
        other.picture.radiance[7] += 600.0;
        assert_eq!(difference(&other.picture, &one.picture), without);
        let tone = ToneMap { exposure: 0.1, white: 1.0 };
        let made = sheet(&[one.clone(), other], 0, &tone, &Silent).unwrap();
        let plain = sheet(&[one, grey(2.5)], 0, &tone, &Silent).unwrap();
        let changed = made.texels.iter().zip(&plain.texels).filter(|(a, b)| a != b).count();
        assert_eq!(changed, 1, "the pixel in the picture, not that in the map");
    }

    #[test]
    fn a_sheet_has_a_column_for_each_and_zero_is_white() {
        let trials = [grey(2.0), grey(2.0), grey(2.2)];
        let tone = ToneMap { exposure: 0.1, white: 1.0 };
        let made = sheet(&trials, 0, &tone, &Silent).unwrap();
        assert_eq!(made, sheet(&trials, 0, &tone, &Silent).unwrap());
        let column = (made.width - GAP) / 3;
        let texel = |i: u32, y: u32| made.texels[(y * made.width + GAP + i * column + 5) as usize];
        let shown = GAP + 2 * LINE + 5;
        assert_eq!(texel(1, shown), tone.encode(Rgb::splat(2.0)));
        let below = 2 * GAP + 3 * LINE + 30 + 5;
        assert_eq!(texel(1, below), [247; 3]);
        assert_eq!(texel(2, below), colour(1.0), "10 % of 10 %");
    }

    #[test]
    fn scales_are_round_and_colours_have_a_sign() {
        let of = |p95: f64| scale(&[None, Some(Difference { p95, ..Difference::default() })]);
        assert_eq!([of(0.0), of(0.011), of(0.05), of(0.3), of(0.7)], [1e-3, 0.02, 0.05, 0.5, 1.0]);
        assert_eq!(colour(0.0), [247; 3]);
        let (low, high) = (colour(-0.5), colour(0.5));
        assert!(low[2] > low[0] && high[0] > high[2]);
        assert_eq!(colour(f32::NAN), colour(1.0));
        assert_eq!(["123", "12.3", "1.23"], [123.4, 12.34, 1.234].map(digits)[..]);
    }
}
