//! Who sees whom on a discrete line: the surface rule.
//!
//! A line is a staircase of voxels; it runs along a wall for several voxels before it is through, and it passes
//! voxels that an edge merely touches. The state of a line tells these apart. It holds the emitter that the line
//! carries light from, the last receiver behind it, and the pair before that one:
//!
//! - a *run* of receivers shares the emitter, unless they are strictly layered (both plane tests say that one lies
//!   behind the other): a wall is one surface, not a stack of blinds;
//! - an emitter ends a run only if the line really comes out of it: its previous voxel must not lie in front of the
//!   emitter's plane, and the emitter must fill its voxel (a share φ of the lines, by a number per tube that front
//!   and back of an object agree on);
//! - a receiver *blocks* only if the next voxel of the line lies behind its plane: a line that leaves the voxels of
//!   a surface on the front side has not crossed it;
//! - a receiver right behind the plane of the emitter that the line carries has not seen it: it belongs to the other
//!   side of a thin wall and takes what the line carried before;
//! - what no rule can tell is *unknown*: it adds neither light nor weight. Sky is never unknown in an open scene.
//!
//! Lengths are in voxels. A cell has 16 bytes and holds indices only; values in the table were slower.

use super::{
    axis::{AxisCopy, SweepSurfel},
    lines::{Lines, Slice},
};
use crate::{Rgb, surfel::MAX_PER_VOXEL};

/// Emitters that are no surfel.
const SKY: u32 = u32::MAX;
const UNKNOWN: u32 = u32::MAX - 1;
/// The line has passed through a surface from its front and sees the black inside of it.
const BLACK: u32 = u32::MAX - 2;

/// No receiver yet.
const NONE: u32 = 0x7fff_ffff;
/// Set on a receiver: the line went through its surface.
const BLOCKED: u32 = 0x8000_0000;

/// Distance from a plane within which two surfels may belong to one surface, and the cosine that makes them coplanar.
const PLANE: f32 = 0.4;
const COPLANAR: f32 = 0.5;
/// A receiver this little in front of an emitter's plane lies behind it.
const BEHIND: f32 = 1e-4;

/// State of one line.
#[derive(Clone, Copy)]
pub struct Cell {
    emitter: u32,
    receiver: u32,
    /// The pair before.
    older_emitter: u32,
    older_receiver: u32,
}

/// Everything that a direction holds fixed.
struct Ray<'a> {
    surfels: &'a [SweepSurfel],
    radiosity: &'a [[f32; 3]],
    fill: &'a [u16],
    lines: &'a Lines,
    sky: [f32; 3],
    /// What is seen through the back of a surface: black, or unknown where nothing but fronts can be seen.
    inside: u32,
}

/// Adds one direction to the sums of radiosity and weight (SLOTS = BANDS + 1).
pub fn sweep<const BANDS: usize, const SLOTS: usize>(
    copy: &AxisCopy,
    lines: &Lines,
    sky: Rgb,
    closed: bool,
    table: &mut Vec<Cell>,
    sums: &mut [[f32; SLOTS]],
) {
    let start = if closed { UNKNOWN } else { SKY };
    table.clear();
    table.resize(lines.cells, Cell { emitter: start, receiver: NONE, older_emitter: UNKNOWN, older_receiver: NONE });
    let ray = Ray {
        surfels: &copy.surfels,
        radiosity: &copy.radiosity,
        fill: &copy.fill,
        lines,
        sky: sky.to_array(),
        inside: if closed { UNKNOWN } else { BLACK },
    };
    for x in lines.order() {
        let slice = &lines.slices[x];
        let (mut i, end) = (copy.slices[x] as usize, copy.slices[x + 1] as usize);
        while i < end {
            let s = &copy.surfels[i];
            let at = s.key() + slice.shift;
            let cell = &mut table[at as usize];
            if !s.shares_voxel() {
                ray.pass::<BANDS, SLOTS>(i, slice, at, cell, sums);
                i += 1;
            } else if !copy.surfels[i + 1].shares_voxel() {
                let (a, b) = if ray.depth(i + 1) < ray.depth(i) { (i + 1, i) } else { (i, i + 1) };
                ray.pass::<BANDS, SLOTS>(a, slice, at, cell, sums);
                ray.pass::<BANDS, SLOTS>(b, slice, at, cell, sums);
                i += 2;
            } else {
                let voxel = ray.by_depth(i);
                for &k in voxel.as_slice() {
                    ray.pass::<BANDS, SLOTS>(k as usize, slice, at, cell, sums);
                }
                i += voxel.len;
            }
        }
    }
}

/// The surfels of one voxel in the order in which the line meets them.
struct Voxel {
    surfels: [u32; MAX_PER_VOXEL],
    len: usize,
}

impl Voxel {
    fn as_slice(&self) -> &[u32] {
        &self.surfels[..self.len]
    }
}

impl Ray<'_> {
    /// Depth along σ; of equals (the faces of a sheet) the receiver comes first.
    #[inline(always)]
    fn depth(&self, i: usize) -> (f32, bool) {
        let (s, sigma) = (&self.surfels[i], &self.lines.sigma);
        let c = &s.centroid;
        (c[0] * sigma[0] + c[1] * sigma[1] + c[2] * sigma[2], s.along(sigma) > 0.0)
    }

    /// Sorts a voxel of three and more by depth.
    #[inline(never)]
    fn by_depth(&self, first: usize) -> Voxel {
        let mut voxel = Voxel { surfels: [0; MAX_PER_VOXEL], len: 0 };
        let mut keys = [(0.0f32, false); MAX_PER_VOXEL];
        for i in first..first + MAX_PER_VOXEL {
            let key = self.depth(i);
            let mut k = voxel.len;
            while k > 0 && key < keys[k - 1] {
                (keys[k], voxel.surfels[k]) = (keys[k - 1], voxel.surfels[k - 1]);
                k -= 1;
            }
            (keys[k], voxel.surfels[k]) = (key, i as u32);
            voxel.len += 1;
            if !self.surfels[i].shares_voxel() {
                break;
            }
        }
        voxel
    }

    #[inline(always)]
    fn pass<const BANDS: usize, const SLOTS: usize>(
        &self,
        i: usize,
        slice: &Slice,
        at: u32,
        cell: &mut Cell,
        sums: &mut [[f32; SLOTS]],
    ) {
        let s = &self.surfels[i];
        let d = s.along(&self.lines.sigma);
        if d > 0.0 {
            self.emit(i as u32, s, slice, at, cell);
        } else if d < 0.0 {
            let from = self.receive(i as u32, s, slice, at, cell);
            let w = -d * self.lines.weight;
            let light = match from {
                UNKNOWN => return,
                BLACK => &[0.0; 3],
                SKY => &self.sky,
                e => &self.radiosity[e as usize],
            };
            let sum = &mut sums[i];
            (0..BANDS).for_each(|b| sum[b] += w * light[b]);
            sum[BANDS] += w;
        }
    }

    /// Whether the surfel fills the tube of this line: the same answer for all surfels of a tube with equal fill.
    #[inline(always)]
    fn stops(&self, i: u32, s: &SweepSurfel, at: u32) -> bool {
        !s.is_partial() || self.partial_stops(i, at)
    }

    #[inline(never)]
    fn partial_stops(&self, i: u32, at: u32) -> bool {
        let mixed = (at ^ self.lines.seed).wrapping_mul(0x9e37_79b1);
        let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x85eb_ca77);
        ((mixed >> 16) as u16) < self.fill[i as usize]
    }

    /// The line leaves a surface on its front.
    #[inline(always)]
    fn emit(&self, i: u32, s: &SweepSurfel, slice: &Slice, at: u32, cell: &mut Cell) {
        let Cell { emitter, receiver, .. } = *cell;
        if receiver == NONE && slice.run.has(emitter) {
            let e = &self.surfels[emitter as usize];
            if e.height(&s.centroid).abs() < PLANE && e.along(&s.normal) > COPLANAR {
                // The same surface goes on.
                if self.stops(i, s, at) {
                    cell.emitter = i;
                }
                return;
            }
        }
        let crossed = receiver != NONE && receiver & BLOCKED != 0;
        if emitter != UNKNOWN && !crossed {
            let brushes = s.center_height + s.along(&slice.previous) > 0.0;
            if brushes || !self.stops(i, s, at) {
                return;
            }
        }
        *cell = Cell { emitter: i, receiver: NONE, older_emitter: emitter, older_receiver: receiver };
    }

    /// The line arrives at a surface on its front; returns where its light comes from.
    #[inline(always)]
    fn receive(&self, i: u32, s: &SweepSurfel, slice: &Slice, at: u32, cell: &mut Cell) -> u32 {
        let behind = s.center_height + s.along(&slice.next) < 0.0;
        let blocks = if behind && self.stops(i, s, at) { BLOCKED } else { 0 };
        if cell.receiver != NONE {
            let blocked = cell.receiver & BLOCKED;
            if self.shares(cell.receiver & !BLOCKED, s, slice) {
                cell.receiver = i | blocked | blocks;
                return cell.emitter;
            }
            let thin = slice.thin.has(cell.receiver & !BLOCKED);
            cell.receiver = i | blocks;
            if blocked == 0 {
                // The surface before ended before the line crossed it.
                return cell.emitter;
            }
            cell.emitter = UNKNOWN;
            return if thin { UNKNOWN } else { self.inside };
        }
        if slice.thin.has(cell.emitter) && self.surfels[cell.emitter as usize].height(&s.centroid) <= BEHIND {
            return self.look_through(i, s, slice, blocks, cell);
        }
        cell.receiver = i | blocks;
        cell.emitter
    }

    /// The receiver lies behind the emitter's plane: a thin wall or a convex edge, of which it is the near side. It
    /// takes what the line carried before; the emitter stays for those that come after.
    #[inline(always)]
    fn look_through(&self, i: u32, s: &SweepSurfel, slice: &Slice, blocks: u32, cell: &mut Cell) -> u32 {
        let older = cell.older_receiver;
        let blocked = if older == NONE { 0 } else { older & BLOCKED };
        let open = blocked == 0 || self.shares(older & !BLOCKED, s, slice);
        cell.older_receiver = i | blocked | blocks;
        if open { cell.older_emitter } else { UNKNOWN }
    }

    /// Two receivers of a line belong to one surface, or to surfaces that touch without hiding each other.
    #[inline(always)]
    fn shares(&self, last: u32, s: &SweepSurfel, slice: &Slice) -> bool {
        slice.run.has(last) && {
            let last = &self.surfels[last as usize];
            !(last.height(&s.centroid) < -PLANE && s.height(&last.centroid) > PLANE)
        }
    }
}
