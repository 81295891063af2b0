//! Pictures with adaptive anti-aliasing, band by band.
//!
//! Rays from the eye are cheap, light is dear: every pixel starts with a few samples ([`FIRST`]), and asks for light once
//! on each surface that they see. Where [`differ`](super::differ) finds an edge, the pixel gets all its samples.
//! Whose light they take follows from what differs. A pixel's value does not depend on the band that it is in, so
//! memory is bounded by bands whatever the size of the picture; and as bands get their further samples slice by slice, it is
//! bounded whatever the number of those.

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
const BAND: u32 = 1 << 12;

/// Samples of the pixels that are refined together, at most; those of one pixel always are.
const SLICE: u32 = 1 << 16;

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
    /// Continuous rays spent on their light, those included that made the method ready.
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

    /// The same where so many rays were traced before any of its points asked for light.
    #[must_use]
    pub fn after(mut self, rays: u64) -> Self {
        self.spent.rays += rays;
        self
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
    let picture = Picture::black(screen.width, screen.height);
    by_bands((BAND / screen.width).max(1), screen, (light, tone), picture, progress)
}

/// The same without the part that surfaces reflect and without errors, which take more memory than the radiance.
///
/// # Errors
/// When it is no longer wanted.
pub fn glimpse(
    screen: &Screen,
    light: &dyn Illumination,
    tone: &ToneMap,
    progress: &dyn Progress,
) -> Result<Picture, Cancelled> {
    let mut picture = Picture::black(0, 0);
    (picture.width, picture.height) = (screen.width, screen.height);
    picture.radiance = vec![Rgb::ZERO; screen.width as usize * screen.height as usize];
    by_bands((BAND / screen.width).max(1), screen, (light, tone), picture, progress)
}

/// The same, so many rows at a time.
fn by_bands(
    rows: u32,
    screen: &Screen,
    (light, tone): (&dyn Illumination, &ToneMap),
    picture: Picture,
    progress: &dyn Progress,
) -> Result<Picture, Cancelled> {
    let height = screen.height;
    let mut film = Film { screen, light, tone, progress, picture };
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
        let row = |y| (0..screen.width).map(move |x| (x, y));
        let places: Vec<(u32, u32)> = (open.next..done).flat_map(row).collect();
        for slice in places.chunks((SLICE / screen.samples).max(1) as usize) {
            let more = |&(x, y): &(u32, u32)| {
                self.progress.check()?;
                Ok(self.resampled(open, x, y))
            };
            let mut more: Vec<Option<Pixel>> = slice.par_iter().map(more).collect::<Result<_, Cancelled>>()?;
            let refined = slice.iter().zip(&mut more).filter_map(|(place, pixel)| Some((*place, pixel.as_mut()?)));
            self.ask(&mut refined.collect::<Vec<_>>())?;
            for (&(x, y), refined) in slice.iter().zip(&more) {
                let pixel = refined.as_ref().unwrap_or(&open.rows[(y - open.top()) as usize][x as usize]);
                self.picture.spent.samples += pixel.samples.len() as u64;
                let Seen { radiance, reflected, error } = pixel.mean();
                let at = y as usize * screen.width as usize + x as usize;
                self.picture.radiance[at] = radiance;
                // A glimpse has no place for these.
                self.picture.reflected.get_mut(at).into_iter().for_each(|place| *place = reflected);
                self.picture.error.get_mut(at).into_iter().for_each(|place| *place = error);
            }
            self.progress.advance(slice.len() as u64);
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
        let beside: Vec<&Pixel> = beside.into_iter().flatten().collect();
        let want = want(own, &beside, self.tone);
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
                let around = beside.iter().flat_map(|n| &n.shown);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::lens::{Lens, camera};
    use crate::render::march::Look;
    use glam::{DVec3, Vec3};
    use luxel_scene::{Scene, Silent, Sky, build::Builder};
    use luxel_transport::{geometry::Geometry, rays::Rays};
    use std::sync::atomic::{AtomicU64, Ordering};

    const SIDE: u32 = 32;
    const TONE: ToneMap = ToneMap { exposure: 1.0, white: 4.0 };

    /// Light by place, and how often it was asked for.
    struct Lamp<F>(F, AtomicU64);

    impl<F: Fn(Vec3) -> f32 + Sync> Illumination for Lamp<F> {
        fn light(&self, points: &[Point], _: &dyn Progress) -> Result<Vec<Lit>, Cancelled> {
            self.1.fetch_add(points.len() as u64, Ordering::Relaxed);
            let lit = |p: &Point| Lit { irradiance: Rgb::splat((self.0)(p.receiver.position)), ..Lit::default() };
            Ok(points.iter().map(lit).collect())
        }
    }

    fn lamp<F: Fn(Vec3) -> f32 + Sync>(at: F) -> Lamp<F> {
        Lamp(at, AtomicU64::new(0))
    }

    /// Work with the screen of a camera at the origin, which sees x and y from −1 to 1 at z = −1.
    fn seen<T>(scene: &Scene, samples: u32, work: impl FnOnce(&Screen) -> T) -> T {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        let look = Look { rays: &rays, emission: None, sky: Rgb::ONE };
        let ahead = camera(DVec3::ZERO, DVec3::NEG_Z, std::f64::consts::FRAC_PI_2);
        let lens = Lens::new(&ahead, &geometry.frame, 1.0);
        work(&Screen { look: &look, lens: &lens, width: SIDE, height: SIDE, samples, pass: 0 })
    }

    fn show(scene: &Scene, samples: u32, light: &dyn Illumination) -> Picture {
        seen(scene, samples, |screen| expose(screen, light, &TONE, &Silent).unwrap())
    }

    /// A wall that shines, right of the line x = edge + slope·y at unit distance.
    fn half(edge: f32, slope: f32) -> Scene {
        let mut b = Builder::new("half");
        let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
        let up = Vec3::new(slope, 1.0, 0.0) * 4.0;
        b.quad("wall", Vec3::new(edge, 0.0, -1.0) - 0.5 * up, Vec3::X * 4.0, up, glow);
        b.build()
    }

    #[test]
    fn an_edge_shows_its_coverage_and_takes_samples_only_near_it() {
        let dark = lamp(|_| 0.0);
        for tenths in 0..10 {
            // So many tenths of a column are bare.
            let bare = tenths as f32 / 10.0;
            let picture = show(&half(2.0 * (bare / SIDE as f32), 0.0), 16, &dark);
            for row in picture.radiance.chunks(SIDE as usize) {
                assert!((row[16].x - (1.0 - bare)).abs() <= 0.5 / 16.0 + 1e-3, "{bare}: {}", row[16].x);
                assert!(row[..16].iter().all(|l| l.x == 0.0) && row[17..].iter().all(|l| l.x == 1.0));
            }
            let near = 3 * u64::from(SIDE);
            assert!(picture.spent.samples <= u64::from(SIDE * SIDE * FIRST) + 12 * near, "{:?}", picture.spent);
        }
        // A slanted one covers what it covers, and converges to it.
        let scene = half(0.03, 0.37);
        let exact = 0.5 * (1.0 - 0.03);
        let error = |samples| {
            let picture = show(&scene, samples, &dark);
            let mean = picture.radiance.iter().map(|l| f64::from(l.x)).sum::<f64>() / picture.radiance.len() as f64;
            (mean - exact).abs()
        };
        assert!(error(16) < 2e-3 && error(256) < 2e-4, "{} {}", error(16), error(256));
        assert!(error(1) > error(256));
    }

    #[test]
    fn a_shadow_edge_is_asked_about_at_every_sample_and_the_rest_once_a_pixel() {
        let mut b = Builder::new("floor");
        let white = b.matte(Vec3::splat(0.8));
        b.quad("floor", Vec3::new(-3.0, -3.0, -1.0), Vec3::X * 6.0, Vec3::Y * 6.0, white);
        let scene = b.build();
        // Seven tenths of a column right of the middle the shadow begins.
        let edge = Geometry::new(&scene).frame.length(2.0 * 0.7 / f64::from(SIDE));
        let lit = lamp(|p| if p.x < edge { 3.0 } else { 0.0 });
        let picture = show(&scene, 16, &lit);
        let light = 3.0 * 0.8 / std::f32::consts::PI;
        for row in picture.radiance.chunks(SIDE as usize) {
            assert!(row[..16].iter().all(|l| (l.x - light).abs() < 1e-5) && row[17..].iter().all(|l| l.x == 0.0));
            assert!((row[16].x / light - 0.7).abs() <= 0.5 / 16.0 + 1e-3, "{}", row[16].x / light);
        }
        let asked = lit.1.into_inner();
        assert_eq!(asked, picture.spent.points);
        assert!(asked < u64::from(SIDE * SIDE) + 16 * 3 * u64::from(SIDE), "{asked}");
        // Even light is asked for once a pixel.
        let even = lamp(|_| 1.0);
        assert_eq!(show(&scene, 16, &even).spent.points, u64::from(SIDE * SIDE));
    }

    #[test]
    fn bands_of_any_height_make_the_same_picture() {
        let mut scene = half(0.01, -0.6);
        scene.sky = Sky::Constant(Vec3::splat(0.25));
        let light = lamp(|p| (p.x * 0.01).sin().abs());
        seen(&scene, 8, |screen| {
            let dark = Picture::black(screen.width, screen.height);
            let by = |rows| by_bands(rows, screen, (&light, &TONE), dark.clone(), &Silent).unwrap();
            let whole = by(SIDE);
            for rows in [1, 2, 5, 31] {
                assert!(by(rows) == whole, "{rows}");
            }
        });
    }

    /// The most points that were asked for together, in light with edges everywhere.
    struct Crowd(AtomicU64);

    impl Illumination for Crowd {
        fn light(&self, points: &[Point], _: &dyn Progress) -> Result<Vec<Lit>, Cancelled> {
            self.0.fetch_max(points.len() as u64, Ordering::Relaxed);
            let lit = |p: &Point| if (p.receiver.position.x * 40.0).sin() > 0.0 { Rgb::ONE } else { Rgb::ZERO };
            Ok(points.iter().map(|p| Lit { irradiance: lit(p), ..Lit::default() }).collect())
        }
    }

    #[test]
    fn no_number_of_samples_makes_more_of_them_held_together() {
        let mut b = Builder::new("floor");
        let white = b.matte(Vec3::splat(0.8));
        b.quad("floor", Vec3::new(-3.0, -3.0, -1.0), Vec3::X * 6.0, Vec3::Y * 6.0, white);
        let scene = b.build();
        for samples in [64, 256] {
            let crowd = Crowd(AtomicU64::new(0));
            let spent = show(&scene, samples, &crowd).spent;
            assert!(spent.samples > u64::from(SIDE * SIDE * samples) * 3 / 4, "{spent:?}");
            let most = crowd.0.into_inner();
            assert!(most <= u64::from(SLICE) && (samples < 256 || most > u64::from(SLICE) / 2), "{samples}: {most}");
        }
    }

    #[test]
    fn the_background_is_exact_and_nothing_is_asked_for() {
        let mut scene = Scene { sky: Sky::Constant(Vec3::new(0.1, 0.2, 3.0)), ..Scene::default() };
        let light = lamp(|_| f32::NAN);
        let picture = show(&scene, 16, &light);
        assert!(picture.radiance.iter().all(|l| *l == Rgb::new(0.1, 0.2, 3.0)));
        assert_eq!((picture.spent.points, picture.spent.samples), (0, u64::from(SIDE * SIDE * FIRST)));
        scene.sky = Sky::None;
        assert!(show(&scene, 16, &light).radiance.iter().all(|l| *l == Rgb::ZERO));
        assert!(seen(&scene, 16, |screen| expose(screen, &light, &TONE, &luxel_scene::Unwanted)).is_err());
    }

    #[test]
    fn passes_blend_by_their_weights_and_their_errors_shrink() {
        let with = |level: f32, error: f32| {
            let mut picture = Picture::black(1, 1);
            (picture.radiance[0], picture.reflected[0], picture.error[0]) =
                (Rgb::splat(level), Rgb::splat(level), error);
            picture
        };
        let mut sum = with(1.0, 0.2);
        sum.blend(&with(3.0, 0.2), 0.5);
        assert_eq!(sum.radiance[0], Rgb::splat(2.0));
        assert!((sum.error[0] - 0.2 / 2.0f32.sqrt()).abs() < 1e-6);
        assert!((sum.relative_error().unwrap() - f64::from(sum.error[0]) / 2.0).abs() < 1e-6);
        assert_eq!(with(1.0, 0.0).relative_error(), None);
    }
}
