//! Which texels are compared, and what the lightmap and the reference say of them.
//!
//! Texels are drawn in proportion to their area, one from each of as many stretches of equal area as are drawn: the
//! atlas lists texels chart by chart and row by row, so neighbours share a stretch. The draw is a function of the atlas
//! alone. Texels that count are covered by half at least and not buried.

use glam::DVec3;
use luxel_atlas::{Atlas, Texel};
use luxel_export::{Lightmap, report::Place};
use luxel_scene::{Progress, Scene};
use luxel_transport::{
    Rgb,
    gather::Receiver,
    geometry::Geometry,
    rays::Rays,
    reference::{Estimate, Reference},
    sampling::{combine, unit},
    validity,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::score::{Sample, y};
use crate::Error;
use crate::bake::receivers::{own, turned};
use crate::settings::{DoubleSided, Only};

/// Share of a texel that its chart has to cover.
const COVERED: f32 = 0.5;

/// Mixed into the seeds of the reference, which must not share its noise with the bake.
const REFERENCE: u64 = 0x7e5f;

/// Paths between two looks at the progress.
const STEP: u32 = 4096;

/// A lightmap in memory, whoever baked it.
#[derive(Clone, Copy)]
pub struct Baked<'a> {
    pub atlas: &'a Atlas,
    pub lightmaps: &'a [Lightmap],
}

impl Baked<'_> {
    /// Where a texel is in its page, row-major.
    fn at(&self, texel: usize) -> (usize, usize) {
        let t = &self.atlas.texels[texel];
        let page = self.atlas.chart(t).page as usize;
        (page, usize::from(t.y) * self.atlas.pages[page].width as usize + usize::from(t.x))
    }

    /// What the lightmap holds [lux].
    pub fn value(&self, texel: usize) -> Rgb {
        let (page, at) = self.at(texel);
        self.lightmaps[page].irradiance()[at]
    }

    pub fn is_buried(&self, texel: usize) -> bool {
        let (page, at) = self.at(texel);
        self.lightmaps[page].buried().get(at).copied().unwrap_or(false)
    }

    /// World area of the covered part of a texel [scene units squared].
    pub fn area(&self, texel: usize) -> f64 {
        area(&self.atlas.texels[texel])
    }

    /// Covered by half at least.
    pub fn is_shown(&self, texel: usize) -> bool {
        is_shown(&self.atlas.texels[texel])
    }

    /// A texel as a receiver, at its own point.
    pub fn receiver(&self, geometry: &Geometry, texel: usize) -> Receiver {
        let t = &self.atlas.texels[texel];
        own(geometry, t, self.atlas.chart(t))
    }

    /// World position of a texel [scene units].
    pub fn position(&self, scene: &Scene, texel: usize) -> DVec3 {
        let t = &self.atlas.texels[texel];
        let instance = &scene.instances[self.atlas.chart(t).instance as usize];
        let [a, b, c] = scene.corners(instance.mesh, t.triangle as usize).map(|corner| corner.as_dvec3());
        let [u, v] = t.barycentric().map(f64::from);
        instance.transform.transform_point3(a + (b - a) * u + (c - a) * v)
    }

    /// A texel for a person.
    pub fn place(&self, scene: &Scene, texel: usize, expected: Rgb) -> Place {
        let t = &self.atlas.texels[texel];
        let chart = self.atlas.chart(t);
        Place {
            object: scene.instances[chart.instance as usize].name.clone(),
            position: self.position(scene, texel).to_array(),
            page: chart.page.into(),
            texel: [t.x.into(), t.y.into()],
            expected: expected.as_dvec3().to_array(),
            found: self.value(texel).as_dvec3().to_array(),
        }
    }
}

fn area(texel: &Texel) -> f64 {
    f64::from(texel.footprint()).powi(2) * f64::from(texel.coverage())
}

fn is_shown(texel: &Texel) -> bool {
    texel.coverage() >= COVERED
}

/// The texels that can be drawn, with the area that all up to each of them have.
pub struct Population {
    texels: Vec<u32>,
    ends: Vec<f64>,
}

impl Population {
    /// Those that are covered by half at least, and not known to be buried.
    pub fn new(atlas: &Atlas, is_buried: impl Fn(usize) -> bool) -> Self {
        let (mut texels, mut ends, mut sum) = (Vec::new(), Vec::new(), 0.0);
        for (number, texel) in atlas.texels.iter().enumerate() {
            if is_shown(texel) && !is_buried(number) && area(texel) > 0.0 {
                sum += area(texel);
                texels.push(number as u32);
                ends.push(sum);
            }
        }
        Self { texels, ends }
    }

    pub fn len(&self) -> usize {
        self.texels.len()
    }

    pub fn is_empty(&self) -> bool {
        self.texels.is_empty()
    }

    /// So many texels, each with the weight of its area: 1 where the draw follows area, and all texels with their areas
    /// where there are no more than are asked for.
    pub fn draw(&self, count: usize, seed: u64) -> Vec<(usize, f64)> {
        if count >= self.len() {
            let areas = (0..self.len()).map(|i| self.ends[i] - if i > 0 { self.ends[i - 1] } else { 0.0 });
            return self.texels.iter().map(|t| *t as usize).zip(areas).collect();
        }
        let stretch = self.ends.last().copied().unwrap_or_default() / count as f64;
        let drawn = |k: usize| {
            let at = (k as f64 + f64::from(unit(combine(seed, k as u64)))) * stretch;
            (self.texels[self.ends.partition_point(|end| *end <= at).min(self.len() - 1)] as usize, 1.0)
        };
        (0..count).map(drawn).collect()
    }
}

/// What of its two sides a texel holds, and which part of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holds {
    pub double_sided: DoubleSided,
    pub only: Only,
}

/// One drawn texel.
#[derive(Clone, Debug)]
pub struct Drawn {
    pub texel: usize,
    pub weight: f64,
    pub front: Receiver,
    /// The other side, where the texel holds its light too.
    back: Option<Receiver>,
    /// Sums of the reference at both.
    pub sums: [Sum; 2],
}

impl Drawn {
    /// The drawn texels whose light is that of their own point.
    pub fn all(atlas: &Atlas, rays: &Rays, drawn: Vec<(usize, f64)>, holds: Holds) -> Vec<Self> {
        let one = |(texel, weight): (usize, f64)| {
            let t = &atlas.texels[texel];
            let chart = atlas.chart(t);
            let front = own(rays.geometry, t, chart);
            if validity::is_buried(rays, &front) {
                return None;
            }
            let triangle = rays.geometry.triangle(chart.instance, t.triangle);
            let is_double = rays.geometry.material(triangle).double_sided;
            let turned = turned(&front);
            let has_back = is_double && holds.double_sided != DoubleSided::Front;
            let back = Some(turned).filter(|back| has_back && !validity::is_buried(rays, back));
            Some(Self { texel, weight, front, back, sums: [Sum::default(); 2] })
        };
        drawn.into_par_iter().filter_map(one).collect()
    }

    /// What the reference says so far of what the texel should hold.
    pub fn expected(&self, holds: Holds) -> Estimate {
        let front = self.sums[0].estimate();
        if self.back.is_none() {
            return front;
        }
        let back = self.sums[1].estimate();
        match holds.double_sided {
            DoubleSided::Front => front,
            DoubleSided::Max if y(back.total) > y(front.total) => back,
            DoubleSided::Max => front,
            DoubleSided::Average => Estimate {
                direct: 0.5 * (front.direct + back.direct),
                indirect: 0.5 * (front.indirect + back.indirect),
                total: 0.5 * (front.total + back.total),
                standard_error: 0.5 * front.standard_error.hypot(back.standard_error),
                band_error: 0.5
                    * (front.band_error * front.band_error + back.band_error * back.band_error).map(f32::sqrt),
                direct_error: 0.5 * front.direct_error.hypot(back.direct_error),
                indirect_error: 0.5 * front.indirect_error.hypot(back.indirect_error),
                rays: front.rays + back.rays,
            },
        }
    }

    /// How many paths the reference has walked at each side.
    pub fn paths(&self) -> f64 {
        self.sums[0].paths
    }

    /// The comparison of what the lightmap holds with it.
    pub fn sample(&self, baked: &Baked, holds: Holds) -> Sample {
        let expected = self.expected(holds);
        let (light, error) = match holds.only {
            Only::All => (expected.total, expected.standard_error),
            Only::Direct => (expected.direct, expected.direct_error),
            Only::Indirect => (expected.indirect, expected.indirect_error),
        };
        // Bands of a part have no errors of their own: where all light is of the part they are those of the whole.
        let band_error = if holds.only == Only::All { expected.band_error } else { Rgb::splat(error) };
        Sample { found: baked.value(self.texel), expected: light, band_error, error, weight: self.weight }
    }
}

/// Walks more paths at every texel. `round` seeds them: the rounds are independent estimates. Reports one unit of
/// progress per texel.
pub fn walk(
    reference: &Reference,
    drawn: &mut [Drawn],
    (paths, round): (u32, u64),
    progress: &dyn Progress,
) -> Result<(), Error> {
    for (side, number) in [(0, 0u64), (1, 1)] {
        let mut left = paths;
        let mut step = 0;
        while left > 0 {
            let now = left.min(STEP);
            let seed = combine(combine(REFERENCE + number, round), step);
            let one = |(which, d): (usize, &mut Drawn)| -> Result<(), Error> {
                progress.check()?;
                let receiver = if side == 0 { Some(d.front) } else { d.back };
                if let Some(receiver) = receiver {
                    // A texel that was drawn twice has two estimates.
                    let seed = combine(combine(receiver.seed, seed), which as u64);
                    d.sums[side].add(&reference.irradiance(&Receiver { seed, ..receiver }, now), now);
                }
                progress.advance(u64::from(side == 0 && left == now));
                Ok(())
            };
            drawn.par_iter_mut().enumerate().try_for_each(one)?;
            (left, step) = (left - now, step + 1);
        }
    }
    Ok(())
}

/// Independent estimates of one receiver, weighted by their paths.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Sum {
    paths: f64,
    rays: u64,
    direct: DVec3,
    indirect: DVec3,
    /// Variances times the squared number of paths.
    band: DVec3,
    total: f64,
    of_direct: f64,
    of_indirect: f64,
}

impl Sum {
    fn add(&mut self, e: &Estimate, paths: u32) {
        let n = f64::from(paths);
        let square = |error: f32| (n * f64::from(error)).powi(2);
        self.paths += n;
        self.rays += e.rays;
        self.direct += e.direct.as_dvec3() * n;
        self.indirect += e.indirect.as_dvec3() * n;
        self.band += e.band_error.as_dvec3() * e.band_error.as_dvec3() * (n * n);
        self.total += square(e.standard_error);
        self.of_direct += square(e.direct_error);
        self.of_indirect += square(e.indirect_error);
    }

    fn estimate(&self) -> Estimate {
        let n = self.paths.max(1.0);
        let root = |square: f64| (square.sqrt() / n) as f32;
        Estimate {
            direct: (self.direct / n).as_vec3(),
            indirect: (self.indirect / n).as_vec3(),
            total: ((self.direct + self.indirect) / n).as_vec3(),
            standard_error: root(self.total),
            band_error: (self.band.map(f64::sqrt) / n).as_vec3(),
            direct_error: root(self.of_direct),
            indirect_error: root(self.of_indirect),
            rays: self.rays,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_follow_area_and_all_texels_have_theirs() {
        // Four texels, the third as large as the others together.
        let population = Population { texels: vec![5, 6, 8, 9], ends: vec![1.0, 2.0, 5.0, 6.0] };
        assert_eq!(population.draw(9, 1), [(5, 1.0), (6, 1.0), (8, 3.0), (9, 1.0)]);
        let mut count = 0;
        for seed in 0..300 {
            let drawn = population.draw(3, seed);
            assert!(drawn.len() == 3 && drawn.windows(2).all(|w| w[0].0 <= w[1].0), "{drawn:?}");
            count += drawn.iter().filter(|(texel, _)| *texel == 8).count();
        }
        // Half of 900 draws; one of two stretches is sure to be it.
        assert!((420..=480).contains(&count), "{count}");
    }

    #[test]
    fn estimates_of_several_rounds_are_weighted_by_paths() {
        let one = |light: f32, error: f32| Estimate {
            direct: Rgb::splat(light),
            total: Rgb::splat(light),
            standard_error: error,
            band_error: Rgb::splat(error),
            ..Estimate::default()
        };
        let mut sum = Sum::default();
        sum.add(&one(1.0, 0.3), 100);
        sum.add(&one(2.0, 0.1), 300);
        let e = sum.estimate();
        assert!((e.total.x - 1.75).abs() < 1e-6, "{e:?}");
        assert!((e.standard_error - (30f32.hypot(30.0) / 400.0)).abs() < 1e-6, "{e:?}");
    }
}
