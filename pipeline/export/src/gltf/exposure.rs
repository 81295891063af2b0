//! Which picture of its page shows an instance.
//!
//! A byte tells 255 steps apart, and what the brightest texel of a page is to the others (a patch of sun in a room lit
//! by what it reflects) can be far more: a wall that is a hundredth as bright would be left with two steps. So a page
//! has as many pictures as it takes, all of the same layout, whose full bytes stand for less and less irradiance, and
//! an instance refers to the darkest one that still holds its light.

use luxel_atlas::Atlas;
use luxel_scene::{Cancelled, Progress, watched};
use rayon::prelude::*;

use crate::Lightmap;

/// Share of an instance's texels that must not be clipped.
const KEPT: f64 = 0.999;
/// An instance is at most this much darker than its picture can show: it has 32 steps at least.
const SPAN: f32 = 8.0;
/// Pictures of a page, at most; the last one takes all that is darker.
const MOST: usize = 4;

/// One picture of a page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Picture {
    pub page: u32,
    /// E (lux) that the byte 255 stands for.
    pub intensity: f32,
}

/// The pictures of all pages, and who is in which.
#[derive(Debug, Default)]
pub struct Pictures {
    /// By page, from the brightest on; each page has one at least.
    pub list: Vec<Picture>,
    /// For each instance of the scene its picture, where it has a place in the atlas.
    pub of: Vec<Option<usize>>,
    /// For each page the texels with a band that their instance's picture clips.
    pub clipped: Vec<usize>,
}

impl Pictures {
    /// `lightmaps` holds one image per page of the atlas.
    pub fn new(atlas: &Atlas, lightmaps: &[Lightmap], progress: &dyn Progress) -> Result<Self, Cancelled> {
        let peaks = peaks(atlas, lightmaps, progress)?;
        let mut pictures = Self { of: vec![None; atlas.placed.len()], ..Self::default() };
        for (page, map) in (0..).zip(lightmaps) {
            progress.check()?;
            let placed = atlas.placed.iter().enumerate();
            let on_page = placed.filter(|(_, placed)| placed.as_ref().is_some_and(|p| p.page == page));
            let instances: Vec<usize> = on_page.map(|(instance, _)| instance).collect();
            let clipped = pictures.add(page, map, &instances, &peaks);
            pictures.clipped.push(clipped);
        }
        Ok(pictures)
    }

    /// Adds the pictures of a page with these instances; returns how many texels they clip.
    fn add(&mut self, page: u32, map: &Lightmap, instances: &[usize], peaks: &[Vec<f32>]) -> usize {
        let mut by_range: Vec<(f32, usize)> = instances.iter().map(|i| (range(&peaks[*i]), *i)).collect();
        by_range.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        // An atlas may be no more than places; then the page speaks for all.
        let brightest = by_range.first().map_or(0.0, |(range, _)| *range);
        let first = self.list.len();
        self.list.push(Picture { page, intensity: full_byte(if brightest > 0.0 { brightest } else { whole(map) }) });
        let mut clipped = 0;
        for (range, instance) in by_range {
            let is_far_darker = self.list.last().is_some_and(|p| range > 0.0 && range * SPAN < p.intensity);
            if is_far_darker && self.list.len() - first < MOST {
                self.list.push(Picture { page, intensity: full_byte(range) });
            }
            let picture = self.list.len() - 1;
            self.of[instance] = Some(picture);
            clipped += peaks[instance].iter().filter(|p| **p > self.list[picture].intensity).count();
        }
        clipped
    }
}

/// For each instance the largest band of each of its texels, rising.
fn peaks(atlas: &Atlas, lightmaps: &[Lightmap], progress: &dyn Progress) -> Result<Vec<Vec<f32>>, Cancelled> {
    let mut counts = vec![0; atlas.placed.len()];
    for texel in watched(&atlas.texels, progress) {
        let texel = texel?;
        if let Some(count) = counts.get_mut(atlas.chart(texel).instance as usize) {
            *count += 1;
        }
    }
    // Nothing moves while they are filled.
    let mut peaks: Vec<Vec<f32>> = counts.into_iter().map(Vec::with_capacity).collect();
    for texel in watched(&atlas.texels, progress) {
        let texel = texel?;
        let chart = atlas.chart(texel);
        let map = lightmaps.get(chart.page as usize).filter(|map| u32::from(texel.x) < map.width());
        let at = |map: &Lightmap| usize::from(texel.y) * map.width() as usize + usize::from(texel.x);
        let light = map.and_then(|map| map.irradiance().get(at(map)));
        if let (Some(light), Some(peaks)) = (light, peaks.get_mut(chart.instance as usize)) {
            peaks.push(light.max_element());
        }
    }
    peaks.par_iter_mut().try_for_each(|peaks| {
        progress.check()?;
        peaks.sort_unstable_by(f32::total_cmp);
        Ok(())
    })?;
    Ok(peaks)
}

/// The same over all covered texels of a page.
fn whole(map: &Lightmap) -> f32 {
    let covered = map.irradiance().iter().zip(map.coverage()).filter(|(_, c)| **c > 0.0);
    let mut peaks: Vec<f32> = covered.map(|(e, _)| e.max_element()).collect();
    peaks.sort_unstable_by(f32::total_cmp);
    range(&peaks)
}

/// What must be told apart: the largest of rising values, unless a few (at most 0.1 %, close to a lamp as a rule) are
/// more than twice as bright as all others: then those are clipped, so that eight bits suffice for the rest.
fn range(peaks: &[f32]) -> f32 {
    let max = peaks.last().copied().unwrap_or(0.0);
    let kept = ((peaks.len() as f64 * KEPT) as usize).min(peaks.len().saturating_sub(1));
    let high = peaks.get(kept).copied().unwrap_or(0.0);
    if high > 0.0 && max > 2.0 * high { high } else { max }
}

/// What is dark (or so dark that its numbers are denormal) is black at intensity 1.
fn full_byte(range: f32) -> f32 {
    if range >= f32::MIN_POSITIVE { range } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_hot_spot_is_left_out() {
        let mut peaks = vec![1.0; 10_000];
        peaks[9_995..].fill(1e6);
        assert_eq!(range(&peaks), 1.0);
        peaks[9_000..].fill(1e6);
        assert_eq!(range(&peaks), 1e6);
        assert_eq!(range(&[]), 0.0);
    }

    #[test]
    fn padding_has_no_say_and_the_dark_is_black_at_one() {
        let mut e = vec![Vec3::ONE; 16];
        e[3] = Vec3::splat(9.0);
        let mut coverage = vec![1.0; 16];
        assert_eq!(whole(&Lightmap::new(4, 4, e.clone(), coverage.clone()).unwrap()), 9.0);
        coverage[3] = 0.0;
        assert_eq!(whole(&Lightmap::new(4, 4, e, coverage).unwrap()), 1.0);
        assert_eq!([0.0, 1e-44, f32::MIN_POSITIVE, f32::MAX].map(full_byte), [1.0, 1.0, f32::MIN_POSITIVE, f32::MAX]);
    }

    /// The pictures' intensities and the picture of each of some instances of one texel each.
    fn shown(ranges: &[f32]) -> (Vec<f32>, Vec<Option<usize>>) {
        let map = Lightmap::new(1, 1, vec![Vec3::ONE], vec![1.0]).unwrap();
        let peaks: Vec<Vec<f32>> = ranges.iter().map(|r| vec![*r]).collect();
        let mut pictures = Pictures { of: vec![None; ranges.len()], ..Pictures::default() };
        let instances: Vec<usize> = (0..ranges.len()).collect();
        assert_eq!(pictures.add(0, &map, &instances, &peaks), 0);
        (pictures.list.iter().map(|p| p.intensity).collect(), pictures.of)
    }

    #[test]
    fn what_is_far_darker_gets_a_picture_of_its_own() {
        assert_eq!(shown(&[10.0, 80.0, 9.0, 0.0]), (vec![80.0, 9.0], vec![Some(0), Some(0), Some(1), Some(1)]));
        let (intensities, of) = shown(&[1e4, 1e3, 1e2, 1e1, 1.0]);
        assert_eq!(intensities, [1e4, 1e3, 1e2, 1e1]);
        assert_eq!(of, [Some(0), Some(1), Some(2), Some(3), Some(3)]);
        assert_eq!(shown(&[0.0, 0.0]).0, [1.0], "without any texel that is lit the page speaks");
    }
}
