//! A pixel on its way: its samples, the surfaces that they see, and whose light these share.

use luxel_transport::Rgb;

use super::lens::Lens;
use super::light::{Lit, Point};
use super::march::{Layer, Look};
use super::pattern;

/// Least cosine between the normals of points that share light.
const TURN: f32 = 0.95;

/// Where a layer's light comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// It reflects none that reaches the eye.
    None,
    /// It asks for itself.
    Own,
    /// It is that of another layer of the pixel.
    Of(u32),
    /// It is known.
    Known,
}

/// A surface that a sample sees, with its light.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    pub layer: Layer,
    /// Side of the pixel where it is [frame units].
    pub footprint: f32,
    pub source: Source,
    /// The light is another layer's.
    is_shared: bool,
    pub lit: Lit,
}

impl Shown {
    /// Radiance that reaches the eye under so much light [cd/m²].
    pub fn radiance(&self, irradiance: Rgb) -> Rgb {
        self.layer.weight * self.layer.emission + self.layer.reflects() * irradiance
    }

    /// The same side of the same smooth surface, so that light is shared.
    pub fn continues(&self, other: &Self) -> bool {
        let (a, b) = (&self.layer, &other.layer);
        let apart = (a.position - b.position).dot(a.normal).abs();
        a.instance == b.instance
            && a.back == b.back
            && a.shading_normal.dot(b.shading_normal) >= TURN
            && a.normal.dot(b.normal) >= TURN
            && apart <= 2.0 * self.footprint.max(other.footprint)
    }
}

/// One ray through a pixel: layers `first..end` of it, and what is beyond them.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub background: Rgb,
    first: u32,
    end: u32,
}

/// Samples of one pixel.
#[derive(Clone, Debug, Default)]
pub struct Pixel {
    pub samples: Vec<Sample>,
    pub shown: Vec<Shown>,
}

/// What of a picture is where.
#[derive(Clone, Copy)]
pub struct Screen<'a> {
    pub look: &'a Look<'a>,
    pub lens: &'a Lens,
    pub width: u32,
    pub height: u32,
    /// Most samples of a pixel.
    pub samples: u32,
    /// Number of the pass, where there are several: each has samples and noise of its own.
    pub pass: u32,
}

impl Screen<'_> {
    /// Traces samples `from..to` of a pixel.
    pub fn trace(&self, x: u32, y: u32, from: u32, to: u32, pixel: &mut Pixel) {
        let mut layers = Vec::new();
        for i in from..to {
            let p = pattern::point(i, self.samples, self.pass);
            let s = (x as f32 + p.x) / self.width as f32 * 2.0 - 1.0;
            let t = 1.0 - (y as f32 + p.y) / self.height as f32 * 2.0;
            layers.clear();
            let background = self.look.along(self.lens.eye, self.lens.direction(s, t), &mut layers);
            let first = pixel.shown.len() as u32;
            pixel.shown.extend(layers.iter().map(|&layer| {
                let source = if layer.reflects() == Rgb::ZERO { Source::None } else { Source::Own };
                let footprint = layer.distance * self.lens.pixel(self.height);
                Shown { layer, footprint, source, is_shared: false, lit: Lit::default() }
            }));
            pixel.samples.push(Sample { background, first, end: pixel.shown.len() as u32 });
        }
    }

    /// Who a layer's noise is seeded by: its pixel and place in it, and the pass.
    fn seed(&self, x: u32, y: u32, layer: u32) -> u64 {
        use luxel_transport::sampling::{combine, mix};
        combine(combine(mix(u64::from(y) << 32 | u64::from(x)), u64::from(layer)), u64::from(self.pass))
    }

    /// The point of a layer that asks for itself.
    pub fn point(&self, x: u32, y: u32, pixel: &Pixel, layer: usize) -> Point {
        let shown = &pixel.shown[layer];
        Point::new(&shown.layer, shown.footprint, self.seed(x, y, layer as u32))
    }
}

impl Pixel {
    /// The layers of a sample.
    pub fn of(&self, sample: &Sample) -> &[Shown] {
        &self.shown[sample.first as usize..sample.end as usize]
    }

    /// Layers from number `from` on that ask for themselves take the light of one before them that they continue.
    pub fn share(&mut self, from: usize) {
        for i in from..self.shown.len() {
            if self.shown[i].source == Source::Own {
                let asks = |s: &Shown| matches!(s.source, Source::Own | Source::Known);
                let other = self.shown[..i].iter().position(|s| asks(s) && s.continues(&self.shown[i]));
                if let Some(other) = other {
                    self.shown[i].source = Source::Of(other as u32);
                }
            }
        }
    }

    /// Numbers of the layers that ask for themselves.
    pub fn asking(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.shown.len()).filter(|&i| self.shown[i].source == Source::Own)
    }

    /// Hands light from layers that know it to those that share it.
    pub fn settle(&mut self) {
        for i in 0..self.shown.len() {
            if let Source::Of(other) = self.shown[i].source {
                // What is shared counts its rays once.
                self.shown[i].lit = Lit { rays: 0, ..self.shown[other as usize].lit };
                (self.shown[i].source, self.shown[i].is_shared) = (Source::Known, true);
            }
        }
    }

    /// Layers that share light ask for themselves again.
    pub fn part(&mut self) {
        for shown in self.shown.iter_mut().filter(|shown| shown.is_shared) {
            (shown.source, shown.is_shared) = (Source::Own, false);
        }
    }

    /// Means over its samples.
    pub fn mean(&self) -> Seen {
        let (mut radiance, mut reflected, mut error) = (glam::DVec3::ZERO, glam::DVec3::ZERO, 0.0f64);
        for sample in &self.samples {
            radiance += sample.background.as_dvec3();
            for shown in self.of(sample) {
                radiance += shown.radiance(shown.lit.irradiance).as_dvec3();
                reflected += (shown.layer.reflects() * shown.lit.irradiance).as_dvec3();
                // Samples of a pixel mostly share their light, so their errors add up.
                let share = f64::from(shown.layer.reflects().element_sum()) / 3.0;
                error += share * f64::from(shown.lit.error.unwrap_or_default());
            }
        }
        let n = self.samples.len().max(1) as f64;
        Seen { radiance: (radiance / n).as_vec3(), reflected: (reflected / n).as_vec3(), error: (error / n) as f32 }
    }
}

/// What a pixel shows [cd/m²].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    pub radiance: Rgb,
    /// The part of it that surfaces reflect.
    pub reflected: Rgb,
    /// Estimated standard error of the band mean, as far as the method states one.
    pub error: f32,
}
