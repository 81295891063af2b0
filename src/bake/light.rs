//! The light at texels, and what is read off it before its parts are added up.
//!
//! While light is found, what comes straight from its sources is kept apart from the rest ([`Parts`], 24 B a texel for
//! both): the sides of a surface are weighed by both together, and the report tells both means. Then one sum
//! ([`TexelLight`], 12 B) is all that images are made of.

use luxel_atlas::Atlas;
use luxel_transport::Rgb;
use serde::{Deserialize, Serialize};

/// Light at the texels of an atlas, in their order.
#[derive(Clone, Debug, Default)]
pub struct TexelLight {
    /// All light [lux].
    pub irradiance: Vec<Rgb>,
    /// Stated bound of the error of the band mean of the indirect light [lux]: the cuts' own at nodes, an estimate once
    /// those are averaged and interpolated. Empty where none is asked for or can be stated.
    pub bound: Vec<f32>,
    /// Inside or under other geometry: its value means nothing.
    pub buried: Vec<bool>,
}

/// The same with its parts apart.
#[derive(Clone, Debug, Default)]
pub struct Parts {
    /// Straight from lamps, suns and emissive surfaces [lux].
    pub direct: Vec<Rgb>,
    /// Reflected at least once, and from the sky [lux].
    pub indirect: Vec<Rgb>,
    /// As in [`TexelLight`].
    pub bound: Vec<f32>,
    pub buried: Vec<bool>,
}

/// Sums over the texels of an atlas, in f64 and in their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sums {
    /// Of texels that are not buried and covered by half at least [scene units squared].
    pub area: f64,
    /// Flux of the band mean through them [lux times the area's unit]: of direct and of indirect light, and of the
    /// stated bound.
    pub direct: f64,
    pub indirect: f64,
    pub bound: f64,
    /// Number of buried texels.
    pub buried: u64,
    /// Mean irradiance of the others, each counted alike [lux].
    pub mean: Rgb,
}

impl Parts {
    /// No light at so many texels.
    pub fn dark(texels: usize, bound: bool) -> Self {
        Self {
            direct: vec![Rgb::ZERO; texels],
            indirect: vec![Rgb::ZERO; texels],
            bound: if bound { vec![0.0; texels] } else { Vec::new() },
            buried: vec![false; texels],
        }
    }

    /// Direct and indirect light of a texel.
    pub fn total(&self, texel: usize) -> Rgb {
        self.direct[texel] + self.indirect[texel]
    }

    /// Whether no sum of sources is beyond what a number can hold.
    pub fn is_finite(&self) -> bool {
        let is_bounded = self.bound.iter().all(|bound| bound.is_finite());
        is_bounded && (0..self.direct.len()).all(|texel| self.total(texel).is_finite())
    }

    /// The light of stronger sources, by band. A bound is that of the band mean: the strongest band bounds it.
    pub fn scaled(mut self, factor: Rgb) -> Self {
        self.direct.iter_mut().chain(&mut self.indirect).for_each(|e| *e *= factor);
        self.bound.iter_mut().for_each(|bound| *bound *= factor.max_element());
        self
    }

    /// Adds the light of other sources at the same texels.
    pub fn add(&mut self, other: &Self) {
        self.direct.iter_mut().zip(&other.direct).for_each(|(sum, e)| *sum += *e);
        self.indirect.iter_mut().zip(&other.indirect).for_each(|(sum, e)| *sum += *e);
        self.bound.iter_mut().zip(&other.bound).for_each(|(sum, bound)| *sum += *bound);
    }

    /// Adds the parts up in the memory of the first; the light is that of all texels of `atlas`.
    pub fn merged(self, atlas: &Atlas) -> (TexelLight, Sums) {
        let mut sums = self.sums(atlas);
        let Self { direct: mut irradiance, indirect, bound, buried } = self;
        irradiance.iter_mut().zip(&indirect).for_each(|(sum, indirect)| *sum += *indirect);
        sums.mean = mean(&irradiance, &buried);
        (TexelLight { irradiance, bound, buried }, sums)
    }

    /// All but the mean.
    fn sums(&self, atlas: &Atlas) -> Sums {
        let buried = self.buried.iter().filter(|b| **b).count() as u64;
        let mut sums = Sums { buried, ..Sums::default() };
        for (i, texel) in atlas.texels.iter().enumerate() {
            if self.buried[i] || texel.coverage() < 0.5 {
                continue;
            }
            let area = f64::from(texel.footprint()) * f64::from(texel.footprint());
            sums.area += area;
            sums.direct += area * f64::from(self.direct[i].element_sum()) / 3.0;
            sums.indirect += area * f64::from(self.indirect[i].element_sum()) / 3.0;
            sums.bound += area * f64::from(self.bound.get(i).copied().unwrap_or_default());
        }
        sums
    }
}

fn mean(irradiance: &[Rgb], buried: &[bool]) -> Rgb {
    let (mut sum, mut count) = (glam::DVec3::ZERO, 0.0);
    for (e, _) in irradiance.iter().zip(buried).filter(|(_, buried)| !**buried) {
        sum += e.as_dvec3();
        count += 1.0;
    }
    if count > 0.0 { (sum / count).as_vec3() } else { Rgb::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_atlas::{AtlasSettings, InProcess, build};
    use luxel_scene::{Silent, build::Builder};

    #[test]
    fn parts_add_up_and_buried_texels_do_not_count() {
        let mut b = Builder::new("floor");
        let grey = b.matte(Rgb::splat(0.5));
        b.quad("floor", Rgb::ZERO, Rgb::Z * 2.0, Rgb::X * 3.0, grey);
        let settings = AtlasSettings { size: 32, ..AtlasSettings::default() };
        let (atlas, _) = build(&b.build(), &settings, &InProcess, &Silent).unwrap();
        let count = atlas.texels.len();
        let mut parts = Parts::dark(count, true);
        parts.direct.fill(Rgb::new(1.0, 2.0, 3.0));
        parts.indirect.fill(Rgb::new(0.1, 0.2, 0.6));
        parts.bound.fill(0.25);
        let hidden = (0..count).find(|i| atlas.texels[*i].coverage() == 1.0).unwrap();
        let spread: f64 =
            atlas.texels.iter().filter(|t| t.coverage() >= 0.5).map(|t| f64::from(t.footprint()).powi(2)).sum();
        let hole = f64::from(atlas.texels[hidden].footprint()).powi(2);
        parts.buried[hidden] = true;
        parts.direct[hidden] = Rgb::splat(1e9);
        let totals: Vec<Rgb> = (0..count).map(|i| parts.total(i)).collect();
        let (light, sums) = parts.merged(&atlas);
        assert_eq!(light.irradiance, totals);
        assert!((sums.area - (spread - hole)).abs() < 1e-9 * spread, "{sums:?}");
        for (found, expected) in [(sums.direct, 2.0), (sums.indirect, 0.3), (sums.bound, 0.25)] {
            assert!((found / sums.area - expected).abs() < 1e-6, "{sums:?}");
        }
        assert_eq!(sums.buried, 1);
        assert!((sums.mean - Rgb::new(1.1, 2.2, 3.6)).abs().max_element() < 1e-6, "{sums:?}");
        let (nothing, sums) = Parts::dark(0, false).merged(&Atlas::default());
        assert!(nothing.irradiance.is_empty() && sums == Sums::default());
    }
}
