//! Choosing the texel density and giving every block its place.
//!
//! Without a wanted density the scene fills its pages. The yardstick is the bare density, at which the charts alone
//! would cover p pages of side s to the last texel: d₀ = s √p / √A, with A the charts' area in the world. One page is
//! taken where the charts fit on it at a quarter of d₀, else one page more, and so on; at that number of pages the
//! largest density that packs is found by bisection. So the density lies between d₀/4 and d₀ and grows with the pages'
//! texels, whatever their number. Below that floor padding and the least size of one texel per chart take nearly the
//! whole page; it is undercut only where no further page can help.
//!
//! All charts of an instance stay on one page.

use std::cell::RefCell;
use std::ops::Range;

use luxel_scene::{Cancelled, Progress};
use serde::{Deserialize, Serialize};

use crate::AtlasError;
use crate::blocks::Block;
use crate::pack::{self, Spot};
use crate::settings::AtlasSettings;
use crate::shelves;

/// Ratio of the bracket of densities in which a bisection looks.
const BRACKET: f64 = 4.0;
/// Bisection steps for the density: 4^(1/2^9) is within a third of a percent of the best.
const STEPS: u32 = 9;

/// A block's rectangle: lower corner on its page, padding left out, size before turning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Place {
    pub page: u32,
    pub x: u32,
    pub y: u32,
    pub size: [u32; 2],
    pub turn: u8,
}

/// Where every chart of a scene lies: an artefact of its own, that of the search for the density.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// One per block.
    pub(crate) places: Vec<Place>,
    pub(crate) pages: u32,
    /// Texels per scene unit that every block has which is not lowered.
    pub(crate) density: f64,
    /// Groups with blocks whose density had to be lowered to fit on a page, and to what.
    pub(crate) lowered: Vec<(u32, f64)>,
    /// Texels taken, padding included.
    pub(crate) occupied: u64,
    /// Sums over the blocks: area in the world [scene units², times texel scale²], and texels by the block's density.
    area: f64,
    texels: f64,
}

impl Placement {
    /// Whether it is one of these blocks on pages of these settings: to be asked of what comes from a file. That no two
    /// places overlap is not looked at.
    pub(crate) fn fits(&self, blocks: &[Block], settings: &AtlasSettings) -> bool {
        let sound = [self.density, self.area, self.texels].iter().all(|x| x.is_finite() && *x >= 0.0);
        let inside = |place: &Place| {
            let [w, h] = if place.turn.is_multiple_of(2) { place.size } else { [place.size[1], place.size[0]] };
            let end = |at: u32, length: u32| u64::from(at) + u64::from(length) + u64::from(settings.padding);
            place.page < self.pages
                && place.turn < 4
                && place.x.min(place.y) >= settings.padding
                && w.min(h) > 0
                && end(place.x, w).max(end(place.y, h)) <= u64::from(settings.size)
        };
        // Where an object lies on two pages, its vertices would be those of one.
        let page = |i: usize| self.places[i].page;
        let together = |run: Range<usize>| run.clone().all(|i| page(i) == page(run.start));
        sound
            && self.places.len() == blocks.len()
            && self.pages <= settings.max_pages
            && self.places.iter().all(inside)
            && groups(blocks).into_iter().all(together)
            && self.lowered.iter().all(|(_, density)| density.is_finite() && *density > 0.0)
    }

    /// Texels per scene unit in the mean over the area.
    pub fn reached(&self) -> f64 {
        if self.lowered.is_empty() || self.area <= 0.0 { self.density } else { (self.texels / self.area).sqrt() }
    }
}

/// `name` is what an instance is called in messages.
pub(crate) fn place(
    blocks: &[Block],
    settings: &AtlasSettings,
    name: &dyn Fn(u32) -> String,
    progress: &dyn Progress,
) -> Result<Placement, AtlasError> {
    let groups = groups(blocks);
    let alone = RefCell::new(vec![None; groups.len()]);
    let placer = Placer { blocks, settings, name, progress, groups, alone };
    progress.begin("pack", u64::from(STEPS) + 1);
    if blocks.is_empty() {
        return Ok(Placement::default());
    }
    match settings.texel_density {
        Some(density) => {
            let pages = settings.max_pages;
            placer.fit(density.into(), pages)?.ok_or(AtlasError::TooManyPages { limit: pages })
        }
        None => placer.fill(),
    }
}

/// Side of a page that holds every lowered group at the wanted density, if any is lowered and such a page allowed.
pub(crate) fn enough(blocks: &[Block], placement: &Placement, settings: &AtlasSettings) -> Option<u32> {
    // What fills its pages is not wanted in texels: it grows with the page.
    let density = f64::from(settings.texel_density?);
    if placement.lowered.is_empty() {
        return None;
    }
    groups(blocks)
        .into_iter()
        .filter(|blocks_of| placement.lowered.iter().any(|(group, _)| *group == blocks[blocks_of.start].group))
        .map(|blocks_of| {
            let sides = blocks[blocks_of].iter().map(|block| block.size * density);
            shelves::side(sides, settings.padding)
        })
        .try_fold(0, |largest, side| Some(largest.max(side?)))
}

/// Runs of blocks that belong to one group.
fn groups(blocks: &[Block]) -> Vec<Range<usize>> {
    let mut at = 0;
    blocks
        .chunk_by(|a, b| a.group == b.group)
        .map(|run| {
            at += run.len();
            at - run.len()..at
        })
        .collect()
}

/// The largest density that fits, below `top` and not below `floor`, with what `attempt` made of it. None where not
/// even the floor fits.
fn densest<T>(
    top: f64,
    floor: f64,
    attempt: impl Fn(f64) -> Result<Option<T>, AtlasError>,
) -> Result<Option<(f64, T)>, AtlasError> {
    let mut good = top;
    let (mut best, mut bad) = loop {
        if good <= floor {
            return Ok(None);
        }
        let last = good;
        good = (good / BRACKET).max(floor);
        if let Some(found) = attempt(good)? {
            break (found, last);
        }
    };
    for _ in 0..STEPS {
        let middle = (good * bad).sqrt();
        match attempt(middle)? {
            Some(found) => (good, best) = (middle, found),
            None => bad = middle,
        }
    }
    Ok(Some((good, best)))
}

/// A density and the places that a group has at it.
type Packed = (f64, Vec<Spot>);

struct Placer<'a> {
    blocks: &'a [Block],
    settings: &'a AtlasSettings,
    name: &'a dyn Fn(u32) -> String,
    progress: &'a dyn Progress,
    groups: Vec<Range<usize>>,
    /// The densest packing of a group on a page of its own, where it was asked for.
    alone: RefCell<Vec<Option<Packed>>>,
}

impl Placer<'_> {
    /// The largest density on as few pages as the floor allows.
    fn fill(&self) -> Result<Placement, AtlasError> {
        // Each group takes part of one page at least.
        let most = self.settings.max_pages.min(u32::try_from(self.groups.len()).unwrap_or(u32::MAX));
        let everything = 0..self.blocks.len();
        let attempt = |density: f64, pages: u32| {
            self.progress.advance(1);
            self.fit(density, pages)
        };
        for pages in 1..=most {
            let top = self.bare(everything.clone(), pages)?;
            let floor = if pages < most { top / BRACKET } else { self.least_density(everything.clone()) };
            if pages < most && !self.may_fit(floor, pages) {
                continue;
            }
            self.progress.begin("pack", u64::from(STEPS) + 1);
            if let Some((_, placement)) = densest(top, floor, |density| attempt(density, pages))? {
                return Ok(placement);
            }
        }
        Err(if self.groups.len() == 1 {
            self.too_many(&self.groups[0])
        } else {
            AtlasError::TooManyPages { limit: most }
        })
    }

    /// Density at which some blocks alone would fill so many pages to the last texel, at most that at which every one
    /// of them would be as long as a page.
    fn bare(&self, blocks: Range<usize>, pages: u32) -> Result<f64, AtlasError> {
        let blocks = &self.blocks[blocks];
        let area: f64 = blocks.iter().map(|b| b.size.element_product()).sum();
        let shortest = blocks.iter().map(|b| b.size.max_element()).fold(f64::INFINITY, f64::min);
        let full = f64::from(self.settings.size) * f64::from(pages).sqrt() / area.sqrt();
        let full = full.min(f64::from(self.limit()) / shortest);
        if full.is_finite() && full > 0.0 { Ok(full) } else { Err(AtlasError::Extent) }
    }

    /// Density at which every one of some blocks is a single texel.
    fn least_density(&self, blocks: Range<usize>) -> f64 {
        0.49 / self.blocks[blocks].iter().map(|b| b.size.max_element()).fold(0.0, f64::max)
    }

    /// False where so many pages surely have too few texels.
    fn may_fit(&self, density: f64, pages: u32) -> bool {
        let page = u64::from(self.settings.size).pow(2);
        // A group that is more than a page is lowered to one.
        let group = |blocks: &Range<usize>| blocks.clone().map(|b| self.least(b, density)).sum::<u64>().min(page);
        self.groups.iter().map(group).sum::<u64>() <= page * u64::from(pages)
    }

    /// Fills page after page with groups in their order; None if they need more than so many pages.
    fn fit(&self, density: f64, pages: u32) -> Result<Option<Placement>, AtlasError> {
        self.progress.check()?;
        if !self.may_fit(density, pages) {
            return Ok(None);
        }
        let mut placement = Placement { density, ..Placement::default() };
        let mut next = 0;
        while next < self.groups.len() {
            self.progress.check()?;
            if placement.pages == pages {
                return Ok(None);
            }
            let page = placement.pages;
            placement.pages += 1;
            // On the last page there must be room for all that is left.
            let found = if placement.pages == pages { self.rest(next, density)? } else { self.prefix(next, density)? };
            match found {
                Some((end, spots)) => {
                    let blocks = self.groups[next].start..self.groups[end - 1].end;
                    self.record(&mut placement, page, blocks, density, &spots)?;
                    next = end;
                }
                // Filling one page with one group is a search for the density, which nothing limits from above.
                None if pages == 1 && self.settings.texel_density.is_none() => return Ok(None),
                None if placement.pages == pages && next + 1 < self.groups.len() => return Ok(None),
                None => {
                    let (lower, spots) = self.lowered(next, density)?;
                    let blocks = self.groups[next].clone();
                    placement.lowered.push((self.blocks[blocks.start].group, lower));
                    self.record(&mut placement, page, blocks, lower, &spots)?;
                    next += 1;
                }
            }
        }
        Ok(Some(placement))
    }

    /// All groups from `first` on, if they fit on one page.
    fn rest(&self, first: usize, density: f64) -> Result<Option<(usize, Vec<Spot>)>, Cancelled> {
        let spots = self.pack(self.groups[first].start..self.blocks.len(), density)?;
        Ok(spots.map(|spots| (self.groups.len(), spots)))
    }

    /// The most groups from `first` on that fit on one page, by bisection; None if not even the first one does.
    fn prefix(&self, first: usize, density: f64) -> Result<Option<(usize, Vec<Spot>)>, AtlasError> {
        let side = u64::from(self.settings.size);
        let mut room = side * side;
        let mut bad = first;
        while bad < self.groups.len() {
            let taken: u64 = self.groups[bad].clone().map(|b| self.least(b, density)).sum();
            if taken > room {
                break;
            }
            room -= taken;
            bad += 1;
        }
        bad += 1;
        let (mut good, mut best) = (first, None);
        // The likely end first: everything that is left.
        let mut middle = (bad - 1).min(self.groups.len());
        while bad - good > 1 {
            self.progress.check()?;
            middle = middle.clamp(good + 1, bad - 1);
            let blocks = self.groups[first].start..self.groups[middle - 1].end;
            match self.pack(blocks, density)? {
                Some(spots) => (good, best) = (middle, Some((middle, spots))),
                None => bad = middle,
            }
            middle = good.midpoint(bad);
        }
        Ok(best)
    }

    /// A lower bound of the texels that a block takes, padding included.
    fn least(&self, block: usize, density: f64) -> u64 {
        let [w, h] = self.texels(block, density);
        let padding = u64::from(2 * self.settings.padding);
        let covered = self.blocks[block].filled * f64::from(w) * f64::from(h);
        // The outline grows at least along its longer side, and past both ends.
        covered as u64 + padding * (u64::from(w.max(h)) + padding)
    }

    /// The largest density, below the wanted one, at which one group fits on a page of its own.
    fn lowered(&self, group: usize, density: f64) -> Result<Packed, AtlasError> {
        let known = self.alone.borrow()[group].clone();
        if let Some(packed) = known.filter(|(lower, _)| *lower <= density) {
            return Ok(packed);
        }
        let blocks = &self.groups[group];
        let attempt = |density: f64| Ok(self.pack(blocks.clone(), density)?);
        let top = self.bare(blocks.clone(), 1)?.min(density);
        let packed = densest(top, self.least_density(blocks.clone()), attempt)?.ok_or_else(|| self.too_many(blocks))?;
        self.alone.borrow_mut()[group] = Some(packed.clone());
        Ok(packed)
    }

    fn too_many(&self, group: &Range<usize>) -> AtlasError {
        AtlasError::TooManyCharts {
            instance: (self.name)(self.blocks[group.start].instances[0]),
            charts: group.len(),
            size: self.settings.size,
        }
    }

    fn texels(&self, block: usize, density: f64) -> [u32; 2] {
        self.blocks[block].texels(density, self.limit())
    }

    /// Longest side of a block that fits on a page with its padding.
    fn limit(&self) -> u32 {
        self.settings.size - 2 * self.settings.padding
    }

    fn pack(&self, blocks: Range<usize>, density: f64) -> Result<Option<Vec<Spot>>, Cancelled> {
        self.progress.check()?;
        let side = u64::from(self.settings.size);
        // Cheap to see before any outline is drawn.
        let least: u64 = blocks.clone().map(|b| self.least(b, density)).sum();
        if least > side * side {
            return Ok(None);
        }
        let shape = |b: usize| {
            self.progress.check()?;
            Ok(self.blocks[b].shape(self.texels(b, density), self.settings.padding))
        };
        let shapes = blocks.map(shape).collect::<Result<Vec<_>, Cancelled>>()?;
        pack::pack(&shapes, self.settings.size, self.progress)
    }

    fn record(
        &self,
        placement: &mut Placement,
        page: u32,
        blocks: Range<usize>,
        density: f64,
        spots: &[Spot],
    ) -> Result<(), Cancelled> {
        let padding = self.settings.padding;
        for (block, spot) in blocks.zip(spots) {
            self.progress.check()?;
            let size = self.texels(block, density);
            let own = &self.blocks[block];
            let most = f64::from(self.limit()) / own.size.max_element();
            let longer = own.size.max_element() * density > f64::from(self.limit()) + 0.5;
            if longer {
                placement.lowered.push((own.group, most));
            }
            let (area, reached) = (own.size.element_product() * own.filled, if longer { most } else { density });
            placement.area += area;
            placement.texels += area * reached * reached;
            placement.occupied += self.blocks[block].shape(size, padding).area();
            let (x, y) = (spot.x + padding, spot.y + padding);
            placement.places.push(Place { page, x, y, size, turn: spot.turn });
        }
        Ok(())
    }
}
