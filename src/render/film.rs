//! Pictures with adaptive anti-aliasing, band by band.
//!
//! Rays from the eye are cheap, light is dear: every pixel starts with a few samples ([`FIRST`]), and asks for light once
//! on each surface that they see. Where [`differ`](super::differ) finds an edge, the pixel gets all its samples.
//! Whose light they take follows from what differs. A pixel's value does not depend on the band that it is in, so
//! memory is bounded by bands whatever the size of the picture.

use luxel_export::ToneMap;
use luxel_scene::{Cancelled, Progress, Uncounted};
use luxel_transport::Rgb;
use rayon::prelude::*;

use super::differ::{Want, want};
use super::light::{Illumination, Lit, Point};
use super::pixel::{Pixel, Screen, Seen, Source};

/// Samples of every pixel.
pub const FIRST: u32 = 4;

/// Pixels of a band, about.
const BAND: u32 = 1 << 14;

/// Width of the blocks in which a band's points are asked for, so that those in a row lie side by side.
const BLOCK: usize = 32;

/// A picture of radiances, row-major from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    /// [cd/m²]
    pub radiance: Vec<Rgb>,
    /// The part of it that surfaces reflect.
    pub reflected: Vec<Rgb>,
    /// Estimated standard error of the band mean of each pixel [cd/m²]; 0 where the method states none.
    pub error: Vec<f32>,
    pub spent: Spent,
}

/// What a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// Rays from the eye.
    pub samples: u64,
    /// Points whose light was asked for.
    pub points: u64,
    /// Continuous rays spent on their light, where the method counts them.
    pub rays: u64,
}

impl Picture {
    /// No light.
    pub fn black(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        let dark = vec![Rgb::ZERO; pixels];
        let (reflected, error) = (dark.clone(), vec![0.0; pixels]);
        Self { width, height, radiance: dark, reflected, error, spent: Spent::default() }
    }

    /// Weighs in another estimate of the same picture, `weight` being its share of both together.
    pub fn blend(&mut self, other: &Self, weight: f32) {
        let mix = |a: &mut Rgb, b: &Rgb| *a += (*b - *a) * weight;
        self.radiance.iter_mut().zip(&other.radiance).for_each(|(a, b)| mix(a, b));
        self.reflected.iter_mut().zip(&other.reflected).for_each(|(a, b)| mix(a, b));
        // Estimates of their own noise.
        let both = |a: &mut f32, b: &f32| *a = (*a * (1.0 - weight)).hypot(b * weight);
        self.error.iter_mut().zip(&other.error).for_each(|(a, b)| both(a, b));
        self.spent.samples += other.spent.samples;
        self.spent.points += other.spent.points;
        self.spent.rays += other.spent.rays;
    }

    /// Mean over the pixels of the band mean of the light that surfaces reflect [cd/m²].
    pub fn mean_reflected(&self) -> f64 {
        mean(self.reflected.iter().map(|l| f64::from(l.element_sum()) / 3.0))
    }

    /// Estimated standard error over all pixels, as a share of the mean reflected light; none where none is stated.
    pub fn relative_error(&self) -> Option<f64> {
        let square = mean(self.error.iter().map(|e| f64::from(*e) * f64::from(*e)));
        (square > 0.0).then(|| square.sqrt() / self.mean_reflected())
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// Takes the picture. Reports one unit of progress per pixel of a stage that the caller has begun.
///
/// # Errors
/// When it is no longer wanted.
pub fn expose(
    screen: &Screen,
    light: &dyn Illumination,
    tone: &ToneMap,
    progress: &dyn Progress,
) -> Result<Picture, Cancelled> {
    let Screen { width, height, .. } = *screen;
    let mut film = Film { screen, light, tone, progress, picture: Picture::black(width, height) };
    let rows = (BAND / width).max(1);
    let mut open = Open::default();
    for from in (0..height).step_by(rows as usize) {
        let to = (from + rows).min(height);
        open.rows.extend(film.begin(from, to)?);
        // The last row waits for its neighbour below.
        let done = if to == height { to } else { to - 1 };
        film.refine(&open, done)?;
        open.finish(done);
    }
    Ok(film.picture)
}

/// A picture that is being taken.
struct Film<'a> {
    screen: &'a Screen<'a>,
    light: &'a dyn Illumination,
    tone: &'a ToneMap,
    progress: &'a dyn Progress,
    picture: Picture,
}

/// The pixels of a row, from the left.
type Row = Vec<Pixel>;

/// Rows that have their first samples: the last one that is finished, and all after it.
#[derive(Default)]
struct Open {
    rows: Vec<Row>,
    /// Rows above this one are finished.
    next: u32,
}

impl Open {
    /// Number of the first row that is held.
    fn top(&self) -> u32 {
        self.next.saturating_sub(1)
    }

    fn at(&self, x: Option<u32>, y: Option<u32>) -> Option<&Pixel> {
        self.rows.get(y?.checked_sub(self.top())? as usize)?.get(x? as usize)
    }

    /// Rows above this one are finished; only the last of them is still a neighbour.
    fn finish(&mut self, next: u32) {
        let before = self.top();
        self.next = next;
        self.rows.drain(..(self.top() - before) as usize);
    }
}

impl Film<'_> {
    /// The first samples of rows, with their light.
    fn begin(&mut self, from: u32, to: u32) -> Result<Vec<Row>, Cancelled> {
        let screen = self.screen;
        let first = FIRST.min(screen.samples);
        let row = |y| {
            self.progress.check()?;
            let pixel = |x| {
                let mut pixel = Pixel::default();
                screen.trace(x, y, 0, first, &mut pixel);
                if !self.light.is_cheap() {
                    pixel.share(0);
                }
                pixel
            };
            Ok((0..screen.width).map(pixel).collect())
        };
        let mut rows: Vec<Row> = (from..to).into_par_iter().map(row).collect::<Result<_, Cancelled>>()?;
        let mut places = Vec::new();
        for x in (0..screen.width).step_by(BLOCK) {
            for y in from..to {
                places.extend((x..(x + BLOCK as u32).min(screen.width)).map(|x| (x, y)));
            }
        }
        let mut pixels: Vec<((u32, u32), &mut Pixel)> = Vec::with_capacity(places.len());
        let mut by_place: Vec<Vec<Option<&mut Pixel>>> =
            rows.iter_mut().map(|row| row.iter_mut().map(Some).collect()).collect();
        for (x, y) in places {
            if let Some(pixel) = by_place[(y - from) as usize][x as usize].take() {
                pixels.push(((x, y), pixel));
            }
        }
        self.ask(&mut pixels)?;
        Ok(rows)
    }

    /// Finishes rows up to `done`.
    fn refine(&mut self, open: &Open, done: u32) -> Result<(), Cancelled> {
        let screen = self.screen;
        let begin = open.next;
        let more = |y: u32| {
            self.progress.check()?;
            let row = (0..screen.width).map(|x| self.resampled(open, x, y));
            Ok(row.collect::<Vec<Option<Pixel>>>())
        };
        let mut more: Vec<Vec<Option<Pixel>>> =
            (begin..done).into_par_iter().map(more).collect::<Result<_, Cancelled>>()?;
        let mut pixels = Vec::new();
        for (y, row) in (begin..).zip(&mut more) {
            let refined = (0..).zip(row).filter_map(|(x, pixel)| Some(((x, y), pixel.as_mut()?)));
            pixels.extend(refined);
        }
        self.ask(&mut pixels)?;
        for (y, row) in (begin..).zip(&more) {
            for (x, refined) in row.iter().enumerate() {
                let pixel = refined.as_ref().unwrap_or(&open.rows[(y - open.top()) as usize][x]);
                self.picture.spent.samples += pixel.samples.len() as u64;
                let Seen { radiance, reflected, error } = pixel.mean();
                let at = y as usize * screen.width as usize + x;
                (self.picture.radiance[at], self.picture.reflected[at], self.picture.error[at]) =
                    (radiance, reflected, error);
            }
            self.progress.advance(u64::from(screen.width));
        }
        Ok(())
    }

    /// The pixel with all its samples, where it wants them.
    fn resampled(&self, open: &Open, x: u32, y: u32) -> Option<Pixel> {
        let screen = self.screen;
        let own = open.at(Some(x), Some(y))?;
        let from = own.samples.len() as u32;
        if from >= screen.samples {
            return None;
        }
        let (left, above) = (x.checked_sub(1), y.checked_sub(1));
        let (right, below) = (Some(x + 1), Some(y + 1));
        let (x_, y_) = (Some(x), Some(y));
        let beside = [open.at(left, y_), open.at(right, y_), open.at(x_, above), open.at(x_, below)];
        let want = want(own, beside.into_iter().flatten(), self.tone);
        if want == Want::Nothing {
            return None;
        }
        let mut pixel = own.clone();
        let known = pixel.shown.len();
        screen.trace(x, y, from, screen.samples, &mut pixel);
        if want == Want::Light {
            pixel.part();
        } else if !self.light.is_cheap() {
            for shown in &mut pixel.shown[known..] {
                let around = beside.into_iter().flatten().flat_map(|n| &n.shown);
                let same = own.shown.iter().chain(around).find(|s| s.source == Source::Known && s.continues(shown));
                if let (Source::Own, Some(same)) = (shown.source, same) {
                    (shown.lit, shown.source) = (Lit { rays: 0, ..same.lit }, Source::Known);
                }
            }
            pixel.share(known);
        }
        Some(pixel)
    }

    /// Asks for the light of all layers that have none yet, and hands it out.
    fn ask(&mut self, pixels: &mut [((u32, u32), &mut Pixel)]) -> Result<(), Cancelled> {
        let screen = self.screen;
        let mut points: Vec<Point> = Vec::new();
        let mut owners = Vec::new();
        for (i, ((x, y), pixel)) in pixels.iter().enumerate() {
            for layer in pixel.asking() {
                points.push(screen.point(*x, *y, pixel, layer));
                owners.push((i, layer));
            }
        }
        let light = self.light.light(&points, &Uncounted(self.progress))?;
        self.picture.spent.points += points.len() as u64;
        for ((pixel, layer), lit) in owners.into_iter().zip(light) {
            self.picture.spent.rays += u64::from(lit.rays);
            let shown = &mut pixels[pixel].1.shown[layer];
            (shown.lit, shown.source) = (lit, Source::Known);
        }
        pixels.par_iter_mut().for_each(|(_, pixel)| pixel.settle());
        Ok(())
    }
}
