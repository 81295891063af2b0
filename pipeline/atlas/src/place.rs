//! Choosing the texel density and giving every block its place.
//!
//! Without a wanted density the scene fills one page: the largest density that packs is found by bisection. Charts
//! are at least one texel wide whatever the density, so very many of them may need further pages; all charts of
//! an instance stay on one page.

use luxel_scene::Progress;

use crate::AtlasError;
use crate::blocks::Block;
use crate::pack::{self, Spot};
use crate::settings::AtlasSettings;

/// Bisection steps for the density: 64^(1/2^10) is within half a percent of the best.
const STEPS: u32 = 10;
/// Ratio of the bracket in which the bisection looks first.
const BRACKET: f64 = 64.0;

/// A block's rectangle: lower corner on its page, padding left out, size before turning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub page: u32,
    pub x: u32,
    pub y: u32,
    pub size: [u32; 2],
    pub turn: u8,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Placement {
    /// One per block.
    pub places: Vec<Place>,
    pub pages: u32,
    /// Texels per scene unit.
    pub density: f64,
    /// Groups with blocks whose density had to be lowered to fit on a page, and to what.
    pub lowered: Vec<(u32, f64)>,
    /// Texels taken, padding included.
    pub occupied: u64,
}

/// `name` is what an instance is called in messages.
pub(crate) fn place(
    blocks: &[Block],
    settings: &AtlasSettings,
    name: &dyn Fn(u32) -> String,
    progress: &dyn Progress,
) -> Result<Placement, AtlasError> {
    let placer = Placer { blocks, settings, name, progress, groups: groups(blocks) };
    progress.begin("pack", u64::from(STEPS) + 2);
    if blocks.is_empty() {
        return Ok(Placement::default());
    }
    match settings.texel_density {
        Some(density) => placer.pages(density.into()),
        None => placer.fill(),
    }
}

/// Runs of blocks that belong to one group.
fn groups(blocks: &[Block]) -> Vec<std::ops::Range<usize>> {
    let mut at = 0;
    blocks
        .chunk_by(|a, b| a.group == b.group)
        .map(|run| {
            at += run.len();
            at - run.len()..at
        })
        .collect()
}

struct Placer<'a> {
    blocks: &'a [Block],
    settings: &'a AtlasSettings,
    name: &'a dyn Fn(u32) -> String,
    progress: &'a dyn Progress,
    groups: Vec<std::ops::Range<usize>>,
}

impl Placer<'_> {
    /// The largest density at which everything fits on as few pages as possible.
    fn fill(&self) -> Result<Placement, AtlasError> {
        let side = f64::from(self.settings.size);
        let area: f64 = self.blocks.iter().map(|b| b.size.element_product()).sum();
        // Density at which the bare charts would fill the page to the last texel.
        let full = side / area.sqrt();
        // Beyond this one every block would be as long as a page.
        let shortest = self.blocks.iter().map(|b| b.size.max_element()).fold(f64::INFINITY, f64::min);
        let full = full.min(f64::from(self.limit()) / shortest);
        let one = |density: f64| -> Result<Option<Placement>, AtlasError> {
            self.progress.check()?;
            self.progress.advance(1);
            Ok(self.one_page(density))
        };
        if !full.is_finite() {
            return Err(AtlasError::Extent);
        }
        let (mut good, mut bad) = (full / BRACKET, full);
        let mut best = match one(good)? {
            Some(placement) => placement,
            None => {
                bad = good;
                good = 0.0;
                match one(good)? {
                    Some(placement) => placement,
                    None => return self.fill_pages(bad),
                }
            }
        };
        for _ in 0..STEPS {
            let middle = if good > 0.0 { (good * bad).sqrt() } else { bad / BRACKET };
            match one(middle)? {
                Some(placement) => (good, best) = (middle, placement),
                None => bad = middle,
            }
        }
        Ok(best)
    }

    /// Several pages: as many as the smallest charts need, then the largest density that needs no more.
    fn fill_pages(&self, mut bad: f64) -> Result<Placement, AtlasError> {
        let mut best = self.pages(0.0)?;
        let mut good = bad / (BRACKET * BRACKET);
        for _ in 0..STEPS {
            let middle = (good * bad).sqrt();
            let found = self.pages(middle)?;
            if found.pages <= best.pages {
                (good, best) = (middle, found);
            } else {
                bad = middle;
            }
        }
        Ok(best)
    }

    fn one_page(&self, density: f64) -> Option<Placement> {
        let mut placement = Placement { pages: 1, density, ..Placement::default() };
        let spots = self.pack(0..self.blocks.len(), density)?;
        self.record(&mut placement, 0, 0..self.blocks.len(), density, &spots);
        Some(placement)
    }

    /// Fills page after page with groups in their order.
    fn pages(&self, density: f64) -> Result<Placement, AtlasError> {
        let mut placement = Placement { density, ..Placement::default() };
        let mut next = 0;
        while next < self.groups.len() {
            self.progress.check()?;
            if placement.pages == self.settings.max_pages {
                return Err(AtlasError::TooManyPages { limit: self.settings.max_pages });
            }
            let page = placement.pages;
            placement.pages += 1;
            match self.prefix(next, density)? {
                Some((end, spots)) => {
                    let blocks = self.groups[next].start..self.groups[end - 1].end;
                    self.record(&mut placement, page, blocks, density, &spots);
                    next = end;
                }
                None => {
                    let blocks = self.groups[next].clone();
                    let (lower, spots) = self.lowered(blocks.clone(), density)?;
                    placement.lowered.push((self.blocks[blocks.start].group, lower));
                    self.record(&mut placement, page, blocks, lower, &spots);
                    next += 1;
                }
            }
        }
        Ok(placement)
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
            match self.pack(blocks, density) {
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
    fn lowered(&self, blocks: std::ops::Range<usize>, density: f64) -> Result<(f64, Vec<Spot>), AtlasError> {
        let charts = blocks.len();
        let first = &self.blocks[blocks.start];
        let mut best = (
            0.0,
            self.pack(blocks.clone(), 0.0).ok_or_else(|| AtlasError::TooManyCharts {
                instance: (self.name)(first.instances[0]),
                charts,
                size: self.settings.size,
            })?,
        );
        let (mut good, mut bad) = (density / (BRACKET * BRACKET), density);
        for _ in 0..STEPS {
            self.progress.check()?;
            let middle = (good * bad).sqrt();
            match self.pack(blocks.clone(), middle) {
                Some(spots) => (good, best) = (middle, (middle, spots)),
                None => bad = middle,
            }
        }
        Ok(best)
    }

    fn texels(&self, block: usize, density: f64) -> [u32; 2] {
        self.blocks[block].texels(density, self.limit())
    }

    /// Longest side of a block that fits on a page with its padding.
    fn limit(&self) -> u32 {
        self.settings.size - 2 * self.settings.padding
    }

    fn pack(&self, blocks: std::ops::Range<usize>, density: f64) -> Option<Vec<Spot>> {
        let side = u64::from(self.settings.size);
        // Cheap to see before any outline is drawn.
        let least: u64 = blocks.clone().map(|b| self.least(b, density)).sum();
        if least > side * side {
            return None;
        }
        let shapes: Vec<_> =
            blocks.map(|b| self.blocks[b].shape(self.texels(b, density), self.settings.padding)).collect();
        pack::pack(&shapes, self.settings.size)
    }

    fn record(
        &self,
        placement: &mut Placement,
        page: u32,
        blocks: std::ops::Range<usize>,
        density: f64,
        spots: &[Spot],
    ) {
        let padding = self.settings.padding;
        for (block, spot) in blocks.zip(spots) {
            let size = self.texels(block, density);
            let longest = self.blocks[block].size.max_element();
            if longest * density > f64::from(self.limit()) + 0.5 {
                placement.lowered.push((self.blocks[block].group, f64::from(self.limit()) / longest));
            }
            placement.occupied += self.blocks[block].shape(size, padding).area();
            let (x, y) = (spot.x + padding, spot.y + padding);
            placement.places.push(Place { page, x, y, size, turn: spot.turn });
        }
    }
}
