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
//!   side of a thin wall and takes what the line carried before; nor has it, where something is thin (`layers.rs`), seen
//!   an emitter that lies behind its own plane;
//! - the faces of a wall that divides its voxel (`layers.rs`) always end what comes to them: there is something on both
//!   sides, and the line goes from the one to the other;
//! - what no rule can tell is *unknown*: it adds neither light nor weight. Sky is never unknown in an open scene.
//!
//! Surfels of one plane need no plane tests: they would pass them. Lengths are in voxels.

use super::{
    kernel::{BLOCKED, Cell, Face, Ray, Stop, Table, dot},
    lines::Slice,
    sample::Sample,
};

/// Distance from a plane within which two surfels may belong to one surface, and the cosine that makes them coplanar.
const PLANE: f32 = 0.4;
const COPLANAR: f32 = 0.5;
/// A receiver this little in front of an emitter's plane lies behind it.
const BEHIND: f32 = 1e-4;
/// Beside something thin, an emitter that lies this much behind a receiver's plane is on the other side of it.
const HIDDEN: f32 = 0.02;

impl<S: Sample> Ray<'_, S> {
    /// Whether the surfel fills the tube of this line: the same answer for all surfels of a tube with equal fill.
    #[inline(always)]
    fn fills(&self, stop: Stop) -> bool {
        let i = stop.surfel as usize;
        !self.copy.is_partial(i) || self.number(stop.at) < self.copy.fill(i)
    }

    fn number(&self, line: u32) -> u16 {
        let mixed = (line ^ self.lines.seed).wrapping_mul(0x9e37_79b1);
        let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x85eb_ca77);
        (mixed >> 16) as u16
    }

    /// The line leaves a surface on its front.
    #[inline(never)]
    pub(super) fn emit(&self, stop: Stop, face: Face, slice: &Slice, table: &mut Table) {
        let cell = &mut table.cells[stop.at as usize];
        let Cell { emitter, receiver } = *cell;
        if receiver == self.none && self.goes_on(emitter, stop.surfel, face, slice) {
            // The same surface goes on.
            if self.fills(stop) {
                cell.emitter = stop.surfel;
            }
            return;
        }
        let crossed = receiver & BLOCKED != 0;
        if emitter != self.unknown && !crossed {
            let brushes = !stop.divides && stop.center_height + face.step > 0.0;
            if brushes || !self.fills(stop) {
                return;
            }
        }
        table.older[stop.at as usize] = *cell;
        *cell = Cell { emitter: stop.surfel, receiver: self.none };
    }

    #[inline(always)]
    fn goes_on(&self, emitter: u32, surfel: u32, face: Face, slice: &Slice) -> bool {
        slice.run.has(emitter)
            && (self.copy.planes[emitter as usize] == face.plane || self.is_coplanar(emitter, surfel, slice))
    }

    /// From the centroid of a surfel that the line has met, at most three slices ago, to that of one that it meets.
    #[inline(always)]
    fn way(&self, before: u32, here: u32, slice: &Slice) -> [f32; 3] {
        self.copy.between(before as usize, here as usize, slice.apart(before, self.lines.forward))
    }

    fn is_coplanar(&self, emitter: u32, other: u32, slice: &Slice) -> bool {
        let (e, o) = (self.copy.normal(emitter as usize), self.copy.normal(other as usize));
        dot(e, &self.way(emitter, other, slice)).abs() < PLANE && dot(e, o) > COPLANAR
    }

    /// The line arrives at a surface on its front; returns where its light comes from.
    #[inline(never)]
    pub(super) fn receive(&self, stop: Stop, face: Face, slice: &Slice, table: &mut Table) -> u32 {
        let behind = stop.divides || stop.center_height + face.step < 0.0;
        let blocks = if behind && self.fills(stop) { BLOCKED } else { 0 };
        let cell = &mut table.cells[stop.at as usize];
        let Cell { emitter, receiver } = *cell;
        if receiver == self.none {
            if slice.thin.has(emitter) && self.is_apart(emitter, stop.surfel, slice) {
                return self.look_through(stop, face, blocks, slice, &mut table.older[stop.at as usize]);
            }
            cell.receiver = stop.surfel | blocks;
            return emitter;
        }
        let (last, blocked) = (receiver & !BLOCKED, receiver & BLOCKED);
        if self.shares(last, stop.surfel, face, slice) {
            cell.receiver = stop.surfel | blocked | blocks;
            return emitter;
        }
        cell.receiver = stop.surfel | blocks;
        if blocked == 0 {
            // The surface before ended before the line crossed it.
            return emitter;
        }
        cell.emitter = self.unknown;
        if slice.thin.has(last) { self.unknown } else { self.inside }
    }

    /// The receiver lies behind the emitter's plane, or is in front of a wall behind which the emitter lies.
    fn is_apart(&self, emitter: u32, receiver: u32, slice: &Slice) -> bool {
        let way = self.way(emitter, receiver, slice);
        let along = |surfel: u32| dot(self.copy.normal(surfel as usize), &way);
        along(emitter) <= BEHIND || self.are_thin(emitter, receiver) && along(receiver) > HIDDEN
    }

    /// There is something thin where one of the two is.
    fn are_thin(&self, emitter: u32, receiver: u32) -> bool {
        [emitter, receiver].iter().any(|&i| self.copy.layer(i as usize).is_thin())
    }

    /// The receiver lies behind the emitter's plane: a thin wall or a convex edge, of which it is the near side. It
    /// takes what the line carried before; the emitter stays for those that come after.
    fn look_through(&self, stop: Stop, face: Face, blocks: u32, slice: &Slice, older: &mut Cell) -> u32 {
        let (last, blocked) = (older.receiver & !BLOCKED, older.receiver & BLOCKED);
        older.receiver = stop.surfel | blocked | blocks;
        let open = blocked == 0 || self.shares(last, stop.surfel, face, slice);
        let from = older.emitter;
        let thin = slice.thin.has(from) && self.are_thin(from, stop.surfel);
        let hidden = thin && self.is_apart(from, stop.surfel, slice);
        if open && !hidden { from } else { self.unknown }
    }

    /// Two receivers of a line belong to one surface, or to surfaces that touch without hiding each other.
    #[inline(always)]
    fn shares(&self, last: u32, next: u32, face: Face, slice: &Slice) -> bool {
        slice.run.has(last) && (self.copy.planes[last as usize] == face.plane || !self.is_layered(last, next, slice))
    }

    fn is_layered(&self, last: u32, next: u32, slice: &Slice) -> bool {
        let way = self.way(last, next, slice);
        let (l, n) = (self.copy.normal(last as usize), self.copy.normal(next as usize));
        dot(l, &way) < -PLANE && dot(n, &way) < -PLANE
    }
}
