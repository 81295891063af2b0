//! The light at texels: direct, from the sky, and indirect, each by its own gather.
//!
//! Receivers are made from texels when they are needed, a block at a time, so that a texel costs its results only:
//! irradiance direct and indirect, bound, and whether it is buried. At the end the two are added up.

use luxel_atlas::{Atlas, Chart, Texel};
use luxel_scene::{Cancelled, Progress, watched};
use luxel_transport::{
    gather::{
        Field, FinalGather, Gather, Gathered, Lightcuts, Lookup, Receiver, lightcuts,
        nodes::{Cell, NodeSettings, interpolate},
    },
    geometry::Geometry,
    rays::Rays,
    sampling::combine,
    sky_light::{self, SkyLight, SkySettings},
    validity::{self, Sides},
};
use rayon::prelude::*;

use super::direct;
use super::journal::{Counters, Journal};
use super::light::{Parts, Sums, TexelLight};
use super::transport::Transport;
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{DoubleSided, Gatherer, Settings};

/// Texels whose receivers exist at the same time.
const BLOCK: usize = 1 << 14;

/// Mixed into the seed of receivers on backs.
const BACK: u64 = 0xbac5;

/// Some texels, seen from one side of their surfaces.
struct Side<'a> {
    geometry: &'a Geometry<'a>,
    texels: &'a [Texel],
    charts: &'a [Chart],
    /// Which texels, in rising order; none: all.
    some: Option<Vec<u32>>,
    back: bool,
    /// Receivers that are not at their texel's point because that one is buried, by rising index.
    moved: Vec<(usize, Receiver)>,
    /// Texels of a front whose point is buried by something thin, with receivers on its far side, by rising index.
    beyond: Vec<(usize, Receiver)>,
    light: Parts,
}

impl<'a> Side<'a> {
    fn front(geometry: &'a Geometry<'a>, atlas: &'a Atlas, bound: bool) -> Self {
        let light = Parts::dark(atlas.texels.len(), bound);
        Self {
            geometry,
            texels: &atlas.texels,
            charts: &atlas.charts,
            some: None,
            back: false,
            moved: Vec::new(),
            beyond: Vec::new(),
            light,
        }
    }

    /// The backs of double-sided surfaces.
    fn back(geometry: &'a Geometry<'a>, atlas: &'a Atlas, bound: bool) -> Self {
        let is_double =
            |t: &Texel| geometry.material(geometry.triangle(atlas.chart(t).instance, t.triangle)).double_sided;
        let numbered = (0u32..).zip(&atlas.texels);
        let some: Vec<u32> = numbered.filter(|(_, t)| is_double(t)).map(|(i, _)| i).collect();
        let light = Parts::dark(some.len(), bound);
        Self {
            geometry,
            texels: &atlas.texels,
            charts: &atlas.charts,
            some: Some(some),
            back: true,
            moved: Vec::new(),
            beyond: Vec::new(),
            light,
        }
    }

    /// The texels of a front that stand for the far side of a thin wall too, over there.
    fn far(&self) -> Self {
        Self {
            // A front has all texels, so their place in it is their number.
            some: Some(self.beyond.iter().map(|(i, _)| *i as u32).collect()),
            moved: self.beyond.iter().map(|(_, receiver)| *receiver).enumerate().collect(),
            beyond: Vec::new(),
            light: Parts::dark(self.beyond.len(), !self.light.bound.is_empty()),
            ..*self
        }
    }

    fn len(&self) -> usize {
        self.light.direct.len()
    }

    fn texel(&self, at: usize) -> &'a Texel {
        &self.texels[self.some.as_ref().map_or(at, |some| some[at] as usize)]
    }

    fn receiver(&self, at: usize) -> Receiver {
        match self.moved.binary_search_by_key(&at, |(i, _)| *i) {
            Ok(found) => self.moved[found].1,
            Err(_) => self.original(at),
        }
    }

    fn original(&self, at: usize) -> Receiver {
        let t = self.texel(at);
        let chart = &self.charts[t.chart as usize];
        let triangle = self.geometry.triangle(chart.instance, t.triangle);
        let footprint = self.geometry.frame.length(f64::from(t.footprint()));
        let seed = chart.texel_seed(t.x, t.y);
        let [u, v] = t.barycentric();
        let front = Receiver::on_triangle(self.geometry, triangle, u, v, footprint, seed);
        if !self.back {
            return front;
        }
        let (normal, shading_normal) = (-front.normal, -front.shading_normal);
        Receiver { normal, shading_normal, seed: combine(seed, BACK), ..front }
    }

    /// Finds the texels that are buried, and moves those that need not be.
    fn clear(&mut self, rays: &Rays, progress: &dyn Progress) -> Result<(), Error> {
        for first in (0..self.len()).step_by(BLOCK) {
            progress.check()?;
            let block = first..self.len().min(first + BLOCK);
            let length = block.len();
            let found: Vec<(usize, Sides)> = block
                .into_par_iter()
                .filter_map(|i| {
                    // Nobody reads on once one of them was cancelled.
                    let receiver = (!progress.is_cancelled()).then(|| self.original(i))?;
                    validity::is_buried(rays, &receiver).then(|| (i, validity::sides(rays, &receiver)))
                })
                .collect();
            progress.check()?;
            for (i, sides) in found {
                match sides.larger {
                    Some(receiver) => self.moved.push((i, receiver)),
                    None => self.light.buried[i] = true,
                }
                // Only the far sides of a front are gathered.
                self.beyond.extend(sides.smaller.filter(|_| !self.back).map(|receiver| (i, receiver)));
            }
            progress.advance(length as u64);
        }
        Ok(())
    }

    /// Gathers at every receiver that is not buried, block by block, and hands each result to `put` with its index.
    /// With `nodes`, only some are gathered (all, where they stand at every texel), averaged with neighbours that agree,
    /// and the rest interpolated: their bounds are estimates. Returns how many were gathered.
    fn gather(
        &mut self,
        gatherer: &dyn Gather,
        nodes: Option<NodeSettings>,
        progress: &dyn Progress,
        mut put: impl FnMut(&mut Parts, usize, &Gathered),
    ) -> Result<u64, Error> {
        let mut gathered = 0;
        let mut first = 0;
        while first < self.len() {
            // Interpolation looks at whole charts; a gather at every texel need not.
            let end = if nodes.is_some() { self.block_end(first) } else { self.len().min(first + BLOCK) };
            let open: Vec<usize> = (first..end).filter(|i| !self.light.buried[*i]).collect();
            let receivers = watched(&open, progress).map(|i| Ok(self.receiver(*i?)));
            let receivers = receivers.collect::<Result<Vec<Receiver>, Cancelled>>()?;
            let light = match nodes {
                None => {
                    gathered += receivers.len() as u64;
                    gatherer.gather(&receivers, progress)?
                }
                Some(how) => {
                    progress.check()?;
                    let cells: Vec<Cell> = open.iter().map(|i| self.cell(*i)).collect();
                    let found = interpolate(gatherer, how, &receivers, &cells, progress)?;
                    gathered += found.nodes as u64;
                    found.light
                }
            };
            for item in watched(open.iter().zip(&light), progress) {
                let (i, g) = item?;
                put(&mut self.light, *i, g);
            }
            progress.advance((end - first - open.len()) as u64);
            first = end;
        }
        Ok(gathered)
    }

    /// The end of a block: at least [`BLOCK`] texels, and whole charts.
    fn block_end(&self, first: usize) -> usize {
        let mut end = self.len().min(first + BLOCK);
        while end < self.len() && self.texel(end).chart == self.texel(end - 1).chart {
            end += 1;
        }
        end
    }

    fn cell(&self, at: usize) -> Cell {
        let t = self.texel(at);
        let chart = &self.charts[t.chart as usize];
        Cell { chart: t.chart, x: u32::from(t.x) - chart.x, y: u32::from(t.y) - chart.y }
    }
}

/// Gathers all light that the plan wants at every texel; the sums tell its parts.
pub fn run(
    rays: &Rays,
    atlas: &Atlas,
    transport: &Transport,
    settings: &Settings,
    plan: &Plan,
    journal: &mut Journal,
) -> Result<(TexelLight, Sums), Error> {
    let geometry = rays.geometry;
    let bound = plan.states_bound(settings);
    let mut sides = vec![Side::front(geometry, atlas, bound)];
    if settings.double_sided != DoubleSided::Front {
        sides.push(Side::back(geometry, atlas, bound));
    }
    let work = sides.iter().map(|s| s.len() as u64).sum();
    let stride = settings.node_spacing.0;
    let nodes = Some(NodeSettings { stride, ..NodeSettings::default() });
    journal.run(plan, Stage::Clear, Some(work), |progress, counters| {
        for side in &mut sides {
            side.clear(rays, progress)?;
        }
        let count = |f: fn(&Side) -> usize| sides.iter().map(|s| f(s) as u64).sum::<u64>();
        counters.insert("moved_texels".into(), count(|s| s.moved.len()));
        counters.insert("two_sided_texels".into(), count(|s| s.beyond.len()));
        counters.insert("buried_texels".into(), count(|s| s.light.buried.iter().filter(|b| **b).count()));
        Ok(())
    })?;
    // After the front itself and before its backs.
    let far = sides[0].far();
    sides.insert(1, far);
    let work = sides.iter().map(|s| s.len() as u64).sum();

    journal.run(plan, Stage::Direct, Some(work), |progress, counters| {
        direct::with(rays, &transport.emitters, settings, progress, |direct| {
            gather(&mut sides, direct, Part::Direct, None, progress, counters)
        })
    })?;
    journal.run(plan, Stage::Sky, Some(work), |progress, counters| {
        let sky = SkyLight::new(rays, SkySettings { rays: settings.sky_rays.0, ..SkySettings::default() });
        if sky.has_spots() {
            gather(&mut sides, &sky_light::Bright(&sky), Part::Sky, None, progress, counters)?;
        }
        gather(&mut sides, &sky_light::Smooth(&sky), Part::Sky, nodes, progress, counters)
    })?;
    journal.run(plan, Stage::Gather, Some(work), |progress, counters| {
        let Some((surfels, solution)) = &transport.surfels else { return Ok(()) };
        let field = Field::build(rays, surfels, solution, progress)?;
        match settings.gatherer() {
            Gatherer::Lookup => gather(&mut sides, &Lookup::new(&field), Part::Bounced, None, progress, counters),
            Gatherer::Final => {
                let gatherer = FinalGather::new(&field, settings.gather_rays.0);
                gather(&mut sides, &gatherer, Part::Bounced, nodes, progress, counters)
            }
            Gatherer::Lightcuts => {
                let gatherer = Lightcuts::build(&field, lightcut_settings(settings), progress)?;
                gather(&mut sides, &gatherer, Part::Bounced, nodes, progress, counters)
            }
        }
    })?;
    Ok(combine_sides(sides, settings.double_sided).merged(atlas))
}

/// All gathering is left out.
pub fn skip(plan: &Plan, journal: &mut Journal) {
    for stage in [Stage::Clear, Stage::Direct, Stage::Sky, Stage::Gather] {
        journal.left_out(plan, stage);
    }
}

fn lightcut_settings(settings: &Settings) -> lightcuts::Settings {
    lightcuts::Settings {
        threshold: settings.cut_error.0,
        limit: settings.cut_limit.0,
        near_rays: settings.near_rays.0,
        ..lightcuts::Settings::default()
    }
}

/// Where a gather's result goes.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Direct,
    Sky,
    Bounced,
}

fn gather(
    sides: &mut [Side],
    gatherer: &dyn Gather,
    part: Part,
    nodes: Option<NodeSettings>,
    progress: &dyn Progress,
    counters: &mut Counters,
) -> Result<(), Error> {
    let (mut rays, mut cut, mut longest, mut gathered) = (0u64, 0u64, 0u32, 0u64);
    for side in sides {
        gathered += side.gather(gatherer, nodes, progress, |light, i, g| {
            match part {
                Part::Direct => light.direct[i] += g.irradiance,
                Part::Sky | Part::Bounced => light.indirect[i] += g.irradiance,
            }
            if part == Part::Bounced
                && let Some(bound) = light.bound.get_mut(i)
            {
                *bound += g.bound;
            }
            rays += u64::from(g.rays);
            cut += u64::from(g.cut);
            longest = longest.max(g.cut);
        })?;
    }
    *counters.entry("gathered_texels".into()).or_default() += gathered;
    *counters.entry("continuous_rays".into()).or_default() += rays;
    if cut > 0 {
        counters.insert("clusters".into(), cut);
        counters.insert("longest_cut".into(), u64::from(longest));
    }
    Ok(())
}

/// Lays the light of the far sides of walls over that of the fronts, then the backs' as the setting says.
///
/// A texel under a thin wall can hold the light of one side only, and is read on both. It takes the darker: too little
/// light in a bright place is lost over one texel, too much in a dark one is a line many times too bright.
fn combine_sides(sides: Vec<Side>, rule: DoubleSided) -> Parts {
    let mut sides = sides.into_iter();
    let mut out = sides.next().map(|s| s.light).unwrap_or_default();
    for side in sides {
        for (k, i) in side.some.iter().flatten().map(|i| *i as usize).enumerate() {
            let other = &side.light;
            let share = match rule {
                _ if !side.back => f32::from(other.total(k).element_sum() < out.total(i).element_sum()),
                // A side that lies within something has nothing to say.
                _ if other.buried[k] => 0.0,
                _ if out.buried[i] => 1.0,
                DoubleSided::Front => 0.0,
                DoubleSided::Average => 0.5,
                DoubleSided::Max => f32::from(other.total(k).element_sum() > out.total(i).element_sum()),
            };
            out.direct[i] = out.direct[i].lerp(other.direct[k], share);
            out.indirect[i] = out.indirect[i].lerp(other.indirect[k], share);
            if let Some(bound) = out.bound.get_mut(i) {
                *bound += (other.bound[k] - *bound) * share;
            }
            out.buried[i] &= other.buried[k];
        }
    }
    out
}
