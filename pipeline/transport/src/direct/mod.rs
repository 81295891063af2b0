//! Direct light at receivers, without noise: closed-form irradiance times the visible share of every light.
//!
//! Receivers come in chart order. Each run of them is a tree of tiles (`tiles`); for every light, the shaft between
//! a tile and the light (`shaft`) collects the few triangles that can block anything (`occluders`), children
//! filter their parent's list, and a tile with an empty list needs no visibility at all. Otherwise each occluder's
//! shadow (`cone`) is taken out of 64 fixed points of the light (`target`), and the closed form ([`lambert`],
//! `punctual`) is weighted by what is left. Shadows come from the triangles themselves, so a bar thinner than the
//! distance of two points is found; only holes and veils are looked up by rays.
//!
//! What a receiver sees does not depend on the tile it is in: lists only leave out what blocks nothing, and the
//! segments that take over for long lists use the same shadow test.

mod area;
mod cone;
pub mod lambert;
mod occluders;
mod punctual;
mod shaft;
mod target;
mod tiles;
mod visibility;

use glam::DVec3;
use luxel_scene::{Cancelled, Progress, Silent};
use rayon::prelude::*;

use crate::{
    Rgb,
    gather::{Gather, Gathered, Receiver},
    lights::Emitters,
    rays::Rays,
};
use area::AreaTarget;
use occluders::Occluders;
use shaft::{HalfSpace, Outline, Shaft};
use target::Pattern;
use tiles::{Tile, Tiles};
use visibility::{Between, Sight};

/// Receivers that share a tree of tiles. Batches of whole chunks give the very bits of all receivers at once.
pub(crate) const CHUNK: usize = 2048;

/// Receivers between two questions whether their light is still wanted: one that almost touches a large lamp behind
/// fine geometry takes some milliseconds.
const BREATH: usize = 4;

/// How visibility is found out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Visibility {
    /// Shafts and shadow masks.
    #[default]
    Shafts,
    /// A shadow ray for every point of every light: for receivers that are few or far apart, and for comparison.
    Rays,
}

#[derive(Clone, Copy, Debug)]
pub struct DirectSettings {
    /// Points on each light for soft shadows; rounded up to a multiple of 64, but that rays may make do with 16.
    pub samples: u32,
    /// Occluders of a tile that are tested one by one; above it every point of the light is asked for by a segment.
    pub candidates: usize,
    pub visibility: Visibility,
}

impl Default for DirectSettings {
    fn default() -> Self {
        Self { samples: 64, candidates: 48, visibility: Visibility::Shafts }
    }
}

/// Gathers light straight from emitters, lamps and suns.
pub struct Direct<'a> {
    sight: Sight<'a>,
    lights: Vec<Target<'a>>,
    patterns: Vec<Pattern>,
    settings: DirectSettings,
}

/// A light as tiles and receivers see it.
enum Target<'a> {
    Area(AreaTarget<'a>),
    Lamp(&'a crate::lights::Lamp),
    Sun(&'a crate::lights::SunLight),
}

impl<'a> Direct<'a> {
    pub fn new(rays: &'a Rays<'a>, emitters: &'a Emitters, settings: DirectSettings) -> Self {
        match Self::build(rays, emitters, settings, &Silent) {
            Ok(direct) => direct,
            Err(Cancelled) => unreachable!("nobody cancels"),
        }
    }

    /// [`Direct::new`] that can be cancelled.
    pub fn build(
        rays: &'a Rays<'a>,
        emitters: &'a Emitters,
        settings: DirectSettings,
        progress: &dyn Progress,
    ) -> Result<Self, Cancelled> {
        let blocks = settings.samples.clamp(1, 1 << 16).div_ceil(target::LANES as u32);
        let patterns: Vec<_> = match settings.visibility {
            Visibility::Rays if settings.samples as usize <= target::FEW => vec![Pattern::few()],
            _ => (0..blocks).map(Pattern::new).collect(),
        };
        let areas = emitters.areas.iter().map(|l| Target::Area(AreaTarget::new(l, &patterns)));
        let lamps = emitters.lamps.iter().map(Target::Lamp);
        let lights = areas.chain(lamps).chain(emitters.suns.iter().map(Target::Sun)).collect();
        let occluders = match settings.visibility {
            Visibility::Shafts => Occluders::new(rays.geometry, progress)?,
            Visibility::Rays => Occluders::none(rays.geometry),
        };
        Ok(Self { sight: Sight { occluders, rays }, lights, patterns, settings })
    }

    /// Irradiance from every light at one receiver, by shadow rays to all points: the plain estimator that the
    /// tiles speed up.
    pub fn by_rays(&self, receiver: &Receiver) -> Rgb {
        let lights = self.lights.iter();
        lights
            .map(|l| l.irradiance(receiver, &self.sight, &self.patterns, Between::Unknown).0.as_dvec3())
            .sum::<DVec3>()
            .as_vec3()
    }

    fn chunk(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        let tiles = Tiles::new(receivers);
        let mut job = Job {
            direct: self,
            progress,
            receivers,
            tiles: &tiles,
            sums: vec![DVec3::ZERO; receivers.len()],
            rays: vec![0; receivers.len()],
            lists: Vec::new(),
        };
        for light in &self.lights {
            job.tile(light, 0, Known::Nothing)?;
        }
        progress.advance(receivers.len() as u64);
        let results = job.sums.iter().zip(&job.rays);
        Ok(results.map(|(sum, &rays)| Gathered { irradiance: sum.as_vec3(), rays, ..Gathered::default() }).collect())
    }
}

impl Gather for Direct<'_> {
    fn gather(&self, receivers: &[Receiver], progress: &dyn Progress) -> Result<Vec<Gathered>, Cancelled> {
        let chunks = receivers.par_chunks(CHUNK).map(|chunk| self.chunk(chunk, progress));
        let chunks = chunks.collect::<Result<Vec<_>, _>>()?;
        Ok(chunks.into_iter().flatten().collect())
    }
}

impl Target<'_> {
    /// No receiver of the tile sees the light, whatever is between.
    fn is_out(&self, tile: &Tile) -> bool {
        match self {
            Target::Area(light) => light.is_behind(tile),
            Target::Lamp(lamp) => punctual::is_lamp_out(lamp, tile),
            Target::Sun(sun) => punctual::is_sun_out(sun, tile),
        }
    }

    fn shaft(&self, tile: &Tile) -> Shaft {
        let (outline, front): (Outline, Option<HalfSpace>) = match self {
            Target::Area(light) => light.outline(tile),
            Target::Lamp(lamp) => (punctual::lamp_outline(lamp), None),
            Target::Sun(sun) => (punctual::sun_outline(sun, tile), None),
        };
        // Half an offset below the lowest point: the receivers' own plane stays out, rounding included.
        let floor = tile.plane.map(|(n, d)| HalfSpace { n, d: d - 0.5 * crate::rays::OFFSET });
        Shaft::new(tile.bounds, outline, front.into_iter().chain(floor))
    }

    fn irradiance(&self, r: &Receiver, sight: &Sight, patterns: &[Pattern], between: Between) -> (Rgb, u32) {
        match self {
            Target::Area(light) => light.irradiance(r, sight, patterns, between),
            Target::Lamp(lamp) => punctual::lamp(lamp, r, sight, patterns, between),
            Target::Sun(sun) => punctual::sun(sun, r, sight, patterns, between),
        }
    }
}

/// What an ancestor found out about its occluders.
#[derive(Clone, Copy)]
enum Known {
    Nothing,
    /// They are `lists[start..end]`.
    Listed(usize, usize),
}

/// One chunk of receivers and its sums.
struct Job<'j> {
    direct: &'j Direct<'j>,
    /// Asked before every few receivers: a chunk alone can take longer than anybody wants to wait.
    progress: &'j dyn Progress,
    receivers: &'j [Receiver],
    tiles: &'j Tiles,
    sums: Vec<DVec3>,
    rays: Vec<u32>,
    /// The lists of the tiles on the path from the root, one after another.
    lists: Vec<u32>,
}

impl Job<'_> {
    /// Longest list that children filter; above it they ask the tree anew.
    const LIST: usize = 2048;

    fn tile(&mut self, light: &Target, at: usize, known: Known) -> Result<(), Cancelled> {
        let tiles = self.tiles;
        let tile = &tiles.nodes[at];
        self.progress.check()?;
        if light.is_out(tile) {
            return Ok(());
        }
        if self.direct.settings.visibility == Visibility::Rays {
            return self.light(light, tile, None);
        }
        let start = self.lists.len();
        let shaft = light.shaft(tile);
        let known = match known {
            Known::Listed(from, to) => {
                for i in from..to {
                    let id = self.lists[i];
                    if !shaft.misses_triangle(self.direct.sight.occluders.corners(id)) {
                        self.lists.push(id);
                    }
                }
                Known::Listed(start, self.lists.len())
            }
            Known::Nothing => {
                let listed = self.direct.sight.occluders.query(&shaft, Self::LIST, &mut self.lists);
                if listed { Known::Listed(start, self.lists.len()) } else { Known::Nothing }
            }
        };
        match (tile.second, known) {
            (Some(second), known) if !matches!(known, Known::Listed(from, to) if from == to) => {
                self.tile(light, at + 1, known)?;
                self.tile(light, second, known)?;
            }
            (_, known) => self.light(light, tile, Some(known))?,
        }
        self.lists.truncate(start);
        Ok(())
    }

    /// Adds the light at every receiver of the tile; without `known`, by rays.
    fn light(&mut self, light: &Target, tile: &Tile, known: Option<Known>) -> Result<(), Cancelled> {
        let between = match known {
            None => Between::Unknown,
            Some(Known::Listed(from, to)) if from == to => Between::Nothing,
            Some(Known::Listed(from, to)) if to - from <= self.direct.settings.candidates => {
                Between::These(&self.lists[from..to])
            }
            Some(_) => Between::Many,
        };
        for some in self.tiles.order[tile.first..tile.first + tile.count].chunks(BREATH) {
            self.progress.check()?;
            for &i in some {
                let i = i as usize;
                let direct = self.direct;
                let (e, rays) = light.irradiance(&self.receivers[i], &direct.sight, &direct.patterns, between);
                self.sums[i] += e.as_dvec3();
                self.rays[i] = self.rays[i].saturating_add(rays);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
