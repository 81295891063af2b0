//! Where light is gathered: the receivers of all texels, moved out of what buries them.
//!
//! A receiver follows from its texel, so only those that are elsewhere are kept. That and who is buried is the
//! artefact of this stage; all light groups are gathered at the same receivers.

use std::io::{self, Write};

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use luxel_atlas::{Atlas, Chart, Texel};
use luxel_scene::{Cancelled, Progress, watched};
use luxel_transport::{
    gather::{
        Gather, Gathered, Receiver,
        nodes::{Cell, NodeSettings, interpolate},
    },
    geometry::Geometry,
    rays::Rays,
    sampling::combine,
    validity::{self, Sides},
};
use rayon::prelude::*;

use super::artefact::{head, put_slice, put_value, slice};
use super::journal::{Counters, Journal};
use super::tracer::Tracer;
use crate::Error;
use crate::plan::{Plan, Stage};
use crate::settings::{DoubleSided, Settings};
use crate::store::{Key, Kind, Reader, Store};

/// Texels whose receivers exist at the same time.
const BLOCK: usize = 1 << 14;

/// Mixed into the seed of receivers on backs.
const BACK: u64 = 0xbac5;

/// A texel as a receiver at its own point, on the front of its surface.
pub fn own(geometry: &Geometry, texel: &Texel, chart: &Chart) -> Receiver {
    let triangle = geometry.triangle(chart.instance, texel.triangle);
    let footprint = geometry.frame.length(f64::from(texel.footprint()));
    let [u, v] = texel.barycentric();
    Receiver::on_triangle(geometry, triangle, u, v, footprint, chart.texel_seed(texel.x, texel.y))
}

/// The receiver on the back of the surface that this one is on the front of.
pub fn turned(front: &Receiver) -> Receiver {
    let (normal, shading_normal) = (-front.normal, -front.shading_normal);
    Receiver { normal, shading_normal, seed: combine(front.seed, BACK), ..*front }
}

/// Some texels, seen from one side of their surfaces.
pub struct Side<'a> {
    geometry: &'a Geometry<'a>,
    texels: &'a [Texel],
    charts: &'a [Chart],
    /// Which texels, in rising order; none: all.
    some: Option<Vec<u32>>,
    pub back: bool,
    /// Receivers that are not at their texel's point because that one is buried, by rising index.
    moved: Vec<(usize, Receiver)>,
    /// Texels of a front whose point is buried by something thin, with receivers on its far side, by rising index.
    beyond: Vec<(usize, Receiver)>,
    /// Inside or under other geometry, with nowhere to go.
    pub buried: Vec<bool>,
}

impl<'a> Side<'a> {
    pub fn front(geometry: &'a Geometry<'a>, atlas: &'a Atlas) -> Self {
        let buried = vec![false; atlas.texels.len()];
        let (texels, charts) = (&atlas.texels[..], &atlas.charts[..]);
        Self { geometry, texels, charts, some: None, back: false, moved: Vec::new(), beyond: Vec::new(), buried }
    }

    /// The backs of double-sided surfaces.
    fn back(geometry: &'a Geometry<'a>, atlas: &'a Atlas) -> Self {
        let is_double =
            |t: &Texel| geometry.material(geometry.triangle(atlas.chart(t).instance, t.triangle)).double_sided;
        let numbered = (0u32..).zip(&atlas.texels);
        let some: Vec<u32> = numbered.filter(|(_, t)| is_double(t)).map(|(i, _)| i).collect();
        let buried = vec![false; some.len()];
        Self { some: Some(some), back: true, buried, ..Self::front(geometry, atlas) }
    }

    /// The texels of a front that stand for the far side of a thin wall too, over there.
    fn far(&self) -> Self {
        Self {
            // A front has all texels, so their place in it is their number.
            some: Some(self.beyond.iter().map(|(i, _)| *i as u32).collect()),
            moved: self.beyond.iter().map(|(_, receiver)| *receiver).enumerate().collect(),
            beyond: Vec::new(),
            buried: vec![false; self.beyond.len()],
            ..*self
        }
    }

    pub fn len(&self) -> usize {
        self.buried.len()
    }

    /// Numbers of the texels in the atlas, in their order.
    pub fn numbers(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).map(|at| self.some.as_ref().map_or(at, |some| some[at] as usize))
    }

    pub fn chart(&self, texel: &Texel) -> &Chart {
        &self.charts[texel.chart as usize]
    }

    pub fn texel(&self, at: usize) -> &'a Texel {
        &self.texels[self.some.as_ref().map_or(at, |some| some[at] as usize)]
    }

    /// The texels whose own points are not free, buried or moved, by rising index, with the receivers that they would be
    /// there.
    pub fn displaced(&self) -> impl Iterator<Item = (usize, Receiver)> {
        let is_displaced = |at: &usize| self.buried[*at] || self.moved.binary_search_by_key(at, |(i, _)| *i).is_ok();
        (0..self.len()).filter(is_displaced).map(|at| (at, self.original(at)))
    }

    pub fn receiver(&self, at: usize) -> Receiver {
        match self.moved.binary_search_by_key(&at, |(i, _)| *i) {
            Ok(found) => self.moved[found].1,
            Err(_) => self.original(at),
        }
    }

    fn original(&self, at: usize) -> Receiver {
        let t = self.texel(at);
        let front = own(self.geometry, t, &self.charts[t.chart as usize]);
        if self.back { turned(&front) } else { front }
    }

    /// The receiver of a texel of a side that nobody has cleared; none where it is buried and has nowhere to go.
    pub fn cleared(&self, rays: &Rays, at: usize) -> Option<Receiver> {
        let receiver = self.original(at);
        if validity::is_buried(rays, &receiver) { validity::sides(rays, &receiver).larger } else { Some(receiver) }
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
                    None => self.buried[i] = true,
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
    pub fn gather(
        &self,
        gatherer: &dyn Gather,
        nodes: Option<NodeSettings>,
        progress: &dyn Progress,
        mut put: impl FnMut(usize, &Gathered),
    ) -> Result<u64, Error> {
        let mut gathered = 0;
        let mut first = 0;
        while first < self.len() {
            // Interpolation looks at whole charts; a gather at every texel need not.
            let end = if nodes.is_some() { self.block_end(first) } else { self.len().min(first + BLOCK) };
            let open: Vec<usize> = (first..end).filter(|i| !self.buried[*i]).collect();
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
                put(*i, g);
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

    /// Where a texel lies in its chart.
    pub fn cell(&self, at: usize) -> Cell {
        let t = self.texel(at);
        let chart = &self.charts[t.chart as usize];
        Cell { chart: t.chart, x: u32::from(t.x) - chart.x, y: u32::from(t.y) - chart.y }
    }
}

/// The receivers of an atlas, side by side of its surfaces: fronts, far sides of thin walls, backs.
pub struct Receivers<'a> {
    pub sides: Vec<Side<'a>>,
}

impl<'a> Receivers<'a> {
    /// Clears all texels, or reads how they were cleared.
    pub fn new(
        tracer: &'a Tracer,
        atlas: &'a Atlas,
        settings: &Settings,
        plan: &Plan,
        store: Option<(&Store, &Key)>,
        journal: &mut Journal,
    ) -> Result<Self, Error> {
        if let Some(stored) = store.and_then(|store| Self::stored(tracer, atlas, settings, plan, store, journal)) {
            return Ok(stored);
        }
        let mut sides = Self::uncleared(tracer, atlas, settings);
        if !plan.runs(Stage::Clear) {
            journal.left_out(plan, Stage::Clear);
            return Ok(Self::of(sides));
        }
        let rays = tracer.rays(plan, journal)?;
        let work = sides.iter().map(|s| s.len() as u64).sum();
        journal.run(plan, Stage::Clear, Some(work), |progress, counters| {
            for side in &mut sides {
                side.clear(rays, progress)?;
            }
            let count = |f: fn(&Side) -> usize| sides.iter().map(|s| f(s) as u64).sum::<u64>();
            counters.insert("moved_texels".into(), count(|s| s.moved.len()));
            counters.insert("two_sided_texels".into(), count(|s| s.beyond.len()));
            counters.insert("buried_texels".into(), count(|s| s.buried.iter().filter(|b| **b).count()));
            if let Some((store, key)) = store {
                store.put(Kind::Clear, key, |out| write(out, &sides, counters));
            }
            Ok(())
        })?;
        Ok(Self::of(sides))
    }

    /// The same where it is stored how they were cleared.
    pub fn stored(
        tracer: &'a Tracer,
        atlas: &'a Atlas,
        settings: &Settings,
        plan: &Plan,
        (store, key): (&Store, &Key),
        journal: &mut Journal,
    ) -> Option<Self> {
        let mut sides = Self::uncleared(tracer, atlas, settings);
        let (counters, cleared) = store.get(Kind::Clear, key, |body| read(body, &sides))?;
        journal.reused(plan, Stage::Clear, counters);
        for (side, cleared) in sides.iter_mut().zip(cleared) {
            (side.moved, side.beyond, side.buried) = cleared;
        }
        Some(Self::of(sides))
    }

    /// Fronts, and backs where they matter.
    fn uncleared(tracer: &'a Tracer, atlas: &'a Atlas, settings: &Settings) -> Vec<Side<'a>> {
        let mut sides = vec![Side::front(tracer.geometry, atlas)];
        if settings.double_sided != DoubleSided::Front {
            sides.push(Side::back(tracer.geometry, atlas));
        }
        sides
    }

    fn of(mut sides: Vec<Side<'a>>) -> Self {
        // After the front itself and before its backs.
        let far = sides[0].far();
        sides.insert(1, far);
        Self { sides }
    }

    /// Receivers, buried ones included.
    pub fn len(&self) -> u64 {
        self.sides.iter().map(|s| s.len() as u64).sum()
    }
}

/// A receiver that is not at its texel's point.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Elsewhere {
    index: u32,
    position: Vec3,
    normal: Vec3,
    shading_normal: Vec3,
    footprint: f32,
    /// Low half first.
    seed: [u32; 2],
}

type Cleared = (Vec<(usize, Receiver)>, Vec<(usize, Receiver)>, Vec<bool>);

fn write(out: &mut impl Write, sides: &[Side], counters: &Counters) -> io::Result<()> {
    put_value(out, counters)?;
    for side in sides {
        for list in [&side.moved, &side.beyond] {
            let packed = |(i, r): &(usize, Receiver)| Elsewhere {
                index: *i as u32,
                position: r.position,
                normal: r.normal,
                shading_normal: r.shading_normal,
                footprint: r.footprint,
                seed: [r.seed as u32, (r.seed >> 32) as u32],
            };
            put_slice(out, &list.iter().map(packed).collect::<Vec<_>>())?;
        }
        put_slice(out, &side.buried.iter().map(|b| u8::from(*b)).collect::<Vec<_>>())?;
    }
    Ok(())
}

fn read(body: &mut Reader, sides: &[Side]) -> Result<(Counters, Vec<Cleared>), String> {
    let counters = head(body)?;
    let one = |side: &Side| -> Result<Cleared, String> {
        let (moved, beyond) = (elsewhere(body, side.len())?, elsewhere(body, side.len())?);
        let buried: Vec<u8> = slice(body)?;
        if buried.len() != side.len() {
            return Err("it has other texels".into());
        }
        Ok((moved, beyond, buried.into_iter().map(|b| b != 0).collect()))
    };
    let cleared = sides.iter().map(one).collect::<Result<_, _>>()?;
    Ok((counters, cleared))
}

fn elsewhere(body: &mut Reader, texels: usize) -> Result<Vec<(usize, Receiver)>, String> {
    let list: Vec<Elsewhere> = slice(body)?;
    let rising = list.windows(2).all(|w| w[0].index < w[1].index);
    let finite = |e: &Elsewhere| e.position.is_finite() && e.normal.is_normalized() && e.shading_normal.is_normalized();
    if !rising || !list.iter().all(|e| (e.index as usize) < texels && finite(e)) {
        return Err("its receivers make no sense".into());
    }
    let unpacked = |e: Elsewhere| {
        let seed = u64::from(e.seed[1]) << 32 | u64::from(e.seed[0]);
        let Elsewhere { position, normal, shading_normal, footprint, .. } = e;
        (e.index as usize, Receiver { position, normal, shading_normal, footprint, seed })
    };
    Ok(list.into_iter().map(unpacked).collect())
}
