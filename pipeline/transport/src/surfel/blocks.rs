//! Blocks: the grid in slabs of slices (x), the slabs in strips of rows (y); what is in work at a time is small.
//!
//! Blocks are independent of each other. Fragments live as long as their block, surfels of a block until its slab is
//! put into order, and a wave of slabs knows only the triangles that it meets: beside the surfels themselves and
//! their copy into one list, memory is a few bytes a triangle. What a wave holds follows the number of threads, the
//! result does not.

use glam::IVec3;
use luxel_scene::Progress;
use rayon::prelude::*;

use super::{
    Emission, Grid, MAX_SURFELS, Surfel, SurfelError, Surfels, cluster,
    fragment::{Cutter, Fragment, corners},
    polygon::{Polygon, slice},
};
use crate::geometry::Geometry;

/// Slices of a slab and rows of a strip, at most.
const SLAB: usize = 8;
const STRIP: usize = 16;

/// Blocks in work for every thread: enough that none has to wait for the fullest one.
const PER_THREAD: usize = 8;

/// Surfels of a part of the grid; the emission counts from the part's first one.
#[derive(Default)]
struct Part {
    list: Vec<Surfel>,
    emission: Vec<Emission>,
}

impl Part {
    fn with_capacity(count: usize) -> Self {
        Self { list: Vec::with_capacity(count), emission: Vec::new() }
    }

    /// Adds a range of another part's surfels.
    fn extend(&mut self, from: &Self, range: std::ops::Range<usize>) {
        let shift = self.list.len() as u32;
        let first = from.emission.partition_point(|e| (e.surfel as usize) < range.start);
        let mine = from.emission[first..].iter().take_while(|e| (e.surfel as usize) < range.end);
        self.emission.extend(mine.map(|e| Emission { surfel: e.surfel - range.start as u32 + shift, ..*e }));
        self.list.extend_from_slice(&from.list[range]);
    }

    /// Parts one after the other; each is freed as soon as it has been copied.
    fn join(parts: Vec<Self>) -> Self {
        let mut all = Self::with_capacity(parts.iter().map(|p| p.list.len()).sum());
        for part in parts {
            all.extend(&part, 0..part.list.len());
        }
        all
    }
}

/// The slabs and strips that a triangle's bounding box meets.
struct Reach {
    triangle: u32,
    slabs: [u32; 2],
    strips: [u32; 2],
}

/// The grid in blocks.
struct Blocks<'a, 'g> {
    geometry: &'a Geometry<'g>,
    grid: &'a Grid,
    slabs: usize,
    strips: usize,
}

/// The surfels of the solid triangles.
pub fn surfels(
    geometry: &Geometry,
    grid: Grid,
    solid: &[u32],
    progress: &dyn Progress,
) -> Result<Surfels, SurfelError> {
    let [slabs, strips] = [grid.size.x as usize, grid.size.y as usize];
    let (slabs, strips) = (slabs.div_ceil(SLAB), strips.div_ceil(STRIP));
    let blocks = Blocks { geometry, grid: &grid, slabs, strips };
    let mut waiting: Vec<Reach> = solid.iter().map(|&t| blocks.reach(t)).collect();
    // The first ones last, so that they can be taken off the end.
    waiting.sort_unstable_by_key(|r| std::cmp::Reverse((r.slabs[0], r.triangle)));
    let mut active: Vec<Reach> = Vec::new();
    let mut parts = Vec::with_capacity(slabs);
    let mut count = 0;
    let wave = (PER_THREAD * rayon::current_num_threads()).div_ceil(strips);
    progress.begin("voxelize", slabs as u64);
    for start in (0..slabs).step_by(wave) {
        let end = (start + wave).min(slabs);
        active.retain(|r| r.slabs[1] as usize >= start);
        while waiting.last().is_some_and(|r| (r.slabs[0] as usize) < end) {
            active.extend(waiting.pop());
        }
        for part in blocks.wave(&active, start, end, progress)? {
            count += part.list.len();
            parts.push(part);
        }
        if count > MAX_SURFELS {
            return Err(SurfelError::TooMany);
        }
        progress.advance((end - start) as u64);
    }
    let Part { list, emission } = Part::join(parts);
    Ok(Surfels { grid, list, emission })
}

impl Blocks<'_, '_> {
    fn reach(&self, triangle: u32) -> Reach {
        let corners = corners(self.geometry, self.grid, triangle);
        let range = |axis: usize, width: usize, count: usize| {
            let at = corners.map(|p| (p[axis].max(0.0) as usize / width).min(count - 1) as u32);
            [at[0].min(at[1]).min(at[2]), at[0].max(at[1]).max(at[2])]
        };
        Reach { triangle, slabs: range(0, SLAB, self.slabs), strips: range(1, STRIP, self.strips) }
    }

    /// The surfels of the slabs from `start` to `end`, slab by slab in the order of the list.
    fn wave(
        &self,
        active: &[Reach],
        start: usize,
        end: usize,
        progress: &dyn Progress,
    ) -> Result<Vec<Part>, SurfelError> {
        let mut bins = vec![Vec::new(); (end - start) * self.strips];
        for r in active {
            for slab in start.max(r.slabs[0] as usize)..end.min(r.slabs[1] as usize + 1) {
                let row = (slab - start) * self.strips;
                let mine = row + r.strips[0] as usize..=row + r.strips[1] as usize;
                bins[mine].iter_mut().for_each(|bin| bin.push(r.triangle));
            }
        }
        let parts: Result<Vec<Part>, SurfelError> = bins
            .into_par_iter()
            .enumerate()
            .map(|(i, triangles)| {
                progress.check()?;
                Ok(self.block(&triangles, start + i / self.strips, i % self.strips))
            })
            .collect();
        Ok(parts?.chunks(self.strips).map(in_order).collect())
    }

    fn block(&self, triangles: &[u32], slab: usize, strip: usize) -> Part {
        let mut fragments = Vec::new();
        for &triangle in triangles {
            self.cut(triangle, slab, strip, &mut fragments);
        }
        fragments.sort_unstable_by_key(Fragment::key);
        let mut part = Part::default();
        for voxel in fragments.chunk_by(|a, b| a.voxel == b.voxel) {
            cluster::surfels(self.geometry, self.grid, voxel, |patch, radiance| {
                if radiance.max_element() > 0.0 {
                    part.emission.push(Emission { surfel: part.list.len() as u32, radiance });
                }
                part.list.push(Surfel::from(patch));
            });
        }
        part
    }

    /// The fragments of a triangle in a block.
    fn cut(&self, triangle: u32, slab: usize, strip: usize, out: &mut Vec<Fragment>) {
        let size = self.grid.size;
        let corners = corners(self.geometry, self.grid, triangle);
        let (x, y) = ([slab * SLAB, (slab + 1) * SLAB], [strip * STRIP, (strip + 1) * STRIP]);
        let part = within(Polygon::new(&corners), 0, x, size.x as usize);
        let Some(part) = part.and_then(|part| within(part, 1, y, size.y as usize)) else { return };
        let cutter = Cutter::new(self.geometry, triangle, corners);
        let last = |range: [usize; 2], size: i32| (range[1] as i32).min(size) - 1;
        slice(part, 0, x[0] as i32, last(x, size.x), |i, part| {
            slice(part, 1, y[0] as i32, last(y, size.y), |j, part| {
                slice(part, 2, 0, size.z - 1, |k, piece| {
                    out.extend(cutter.fragment(IVec3::new(i, j, k), &piece));
                });
            });
        });
    }
}

/// The part of a polygon between two planes of an axis; the first and the last range of the grid keep what rounding
/// puts beyond it.
fn within(polygon: Polygon, axis: usize, [start, end]: [usize; 2], size: usize) -> Option<Polygon> {
    let (lo, hi) = polygon.range(axis);
    let mut part = polygon;
    if start > 0 && lo < start as f64 {
        part = part.split(axis, start as f64).1;
    }
    if end < size && hi > end as f64 {
        part = part.split(axis, end as f64).0;
    }
    // A polygon in the plane between two ranges belongs to the upper one, as `floor` says.
    let in_upper_plane = end < size && lo >= end as f64;
    (part.corners().len() >= 3 && !in_upper_plane).then_some(part)
}

/// The strips of a slab, each sorted by voxel, as one part sorted by voxel: slice by slice, strip by strip.
fn in_order(strips: &[Part]) -> Part {
    let mut slab = Part::with_capacity(strips.iter().map(|s| s.list.len()).sum());
    let mut starts = vec![0; strips.len()];
    let next = |starts: &[usize]| {
        let heads = strips.iter().zip(starts).filter_map(|(s, &at)| s.list.get(at));
        heads.map(|s| s.voxel().x).min()
    };
    while let Some(x) = next(&starts) {
        for (strip, start) in strips.iter().zip(&mut starts) {
            let end = *start + strip.list[*start..].iter().take_while(|s| s.voxel().x == x).count();
            slab.extend(strip, *start..end);
            *start = end;
        }
    }
    slab
}
