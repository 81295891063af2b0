//! One direction of a sweep: slice by slice, each surfel meets its line.
//!
//! What depends on a plane and the direction alone is worked out once for all surfels of the plane in a slice, and
//! most of them need no more than the plane of what their line met last; the few others go through the whole rule
//! (`rule.rs`). The table of lines holds indices only, 8 bytes a line (values in it were slower). The pairs before lie
//! in a table of their own, which is written where an emitter ends a run and read only behind such an emitter, so that
//! it never has to be cleared.

use std::ops::Range;

use luxel_scene::Cancelled;

use super::{
    axis::{AxisCopy, NOWHERE},
    lines::{Lines, Slice},
    sample::Sample,
    turns,
};
use crate::{Rgb, surfel::MAX_PER_VOXEL};

/// Emitters that are no surfel, counted from the number of surfels: the sky, what no rule can tell, and the black
/// inside of a surface that the line has passed from its front.
const SKY: u32 = 0;
const UNKNOWN: u32 = 1;
const BLACK: u32 = 2;

/// Set on a receiver: the line went through its surface.
pub(super) const BLOCKED: u32 = 0x8000_0000;

/// Depth between two layers of a voxel: more than the voxel has.
const APART: f32 = 4.0;

/// Surfels of a patch that are looked at in one go.
const CHUNK: usize = 64;

/// State of a line: the emitter that it carries light from and the last receiver behind it. Without a receiver, that
/// is the number of surfels.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
pub(super) struct Cell {
    pub(super) emitter: u32,
    pub(super) receiver: u32,
}

/// The state of all lines of a direction.
pub struct Table {
    pub(super) cells: Vec<Cell>,
    /// The pairs before.
    pub(super) older: Vec<Cell>,
    /// Surfels of a patch that were put off.
    late: [u32; CHUNK],
    /// Emitters that the surfels of a patch see.
    from: [u32; CHUNK],
    /// The surfels of a slice that share their voxels.
    faces: Vec<Placed>,
}

impl Default for Table {
    fn default() -> Self {
        Self { cells: Vec::new(), older: Vec::new(), late: [0; CHUNK], from: [0; CHUNK], faces: Vec::new() }
    }
}

impl Table {
    fn clear(&mut self, cells: usize, start: Cell) {
        self.cells.clear();
        self.cells.reserve_exact(cells);
        self.cells.resize(cells, start);
        if self.older.len() < cells {
            self.older = vec![start; cells];
        }
    }
}

/// What the surfels send, in the order of an axis, and behind them what [`SKY`], [`UNKNOWN`] and [`BLACK`] do, which is
/// nothing; the sky's own light is added apart.
pub fn light<S: Sample>(order: &[u32], radiosity: Vec<Rgb>) -> Vec<S::Light> {
    let mut light = Vec::with_capacity(order.len() + 3);
    light.extend(order.iter().map(|&i| S::light(radiosity[i as usize])));
    light.extend([S::light(Rgb::ZERO); 3]);
    light
}

/// Everything that a direction holds fixed.
pub(super) struct Ray<'a, S: Sample> {
    pub(super) copy: &'a AxisCopy,
    pub(super) light: &'a [S::Light],
    pub(super) lines: &'a Lines,
    pub(super) sky: Option<S::Light>,
    /// The number of surfels: no receiver.
    pub(super) none: u32,
    pub(super) unknown: u32,
    /// What is seen through the back of a surface: black, or unknown where nothing but fronts can be seen.
    pub(super) inside: u32,
}

/// A plane seen along a direction.
#[derive(Clone, Copy)]
pub(super) struct Face {
    pub(super) plane: u32,
    /// n · σ.
    pub(super) along: f32,
    /// n · step to the next voxel of the line, where the plane receives, or to the previous one, where it emits.
    pub(super) step: f32,
}

/// A surfel of a voxel of several, and its depth along σ.
#[derive(Clone, Copy)]
struct Placed {
    face: Face,
    depth: f32,
}

impl Placed {
    /// The line meets it first; of equals (the faces of a sheet) the receiver.
    #[inline(always)]
    fn is_before(&self, other: &Placed) -> bool {
        (self.depth, self.face.along > 0.0) < (other.depth, other.face.along > 0.0)
    }
}

/// One surfel on its line.
#[derive(Clone, Copy)]
pub(super) struct Stop {
    pub(super) surfel: u32,
    /// Cell of its line.
    pub(super) at: u32,
    pub(super) center_height: f32,
    /// It is a face of the wall that divides its voxel.
    pub(super) divides: bool,
}

/// Adds one direction to the sums, part by part, each when it is its turn.
///
/// # Errors
/// When another direction has failed.
pub fn sweep<S: Sample>(
    copy: &AxisCopy,
    light: &[S::Light],
    lines: &Lines,
    sky: Option<Rgb>,
    closed: bool,
    table: &mut Table,
    sums: &turns::Direction<S>,
) -> Result<(), Cancelled> {
    let count = copy.len() as u32;
    let start = Cell { emitter: count + if closed { UNKNOWN } else { SKY }, receiver: count };
    let ray = Ray {
        copy,
        light,
        lines,
        sky: sky.map(S::light),
        none: count,
        unknown: count + UNKNOWN,
        inside: count + if closed { UNKNOWN } else { BLACK },
    };
    table.clear(lines.cells as usize, start);
    for (part, first) in lines.order(copy) {
        let slice = &lines.slices[copy.parts[part].slice as usize];
        if first {
            lines.enter(slice, &mut table.cells, start);
        }
        sums.add(part, |sums| ray.part(part, slice, table, sums))?;
    }
    Ok(())
}

/// The surfels of one voxel in the order in which the line meets them.
struct Voxel {
    surfels: [u32; MAX_PER_VOXEL],
    len: usize,
}

impl<S: Sample> Ray<'_, S> {
    /// One part with its sums.
    fn part(&self, part: usize, slice: &Slice, table: &mut Table, sums: &mut [S]) {
        let (part, next) = (&self.copy.parts[part], &self.copy.parts[part + 1]);
        let base = part.start as usize;
        let patches = &self.copy.patches[part.patches as usize..next.patches as usize];
        for (k, patch) in patches.iter().enumerate() {
            let end = patches.get(k + 1).map_or(part.shared, |next| next.start);
            let range = patch.start as usize..end as usize;
            if patch.plane == NOWHERE {
                let face = |i: usize| self.face(self.copy.planes[i], slice);
                range.for_each(|i| self.pass(i, face(i), slice, table, &mut sums[i - base]));
                continue;
            }
            let face = self.face(patch.plane, slice);
            if patch.partial {
                range.for_each(|i| self.pass(i, face, slice, table, &mut sums[i - base]));
                continue;
            }
            let mut rest = range;
            while !rest.is_empty() {
                let keys = self.copy.lone_keys(rest.start..rest.end.min(rest.start + CHUNK));
                let (count, shift) = self.lines.straight(keys, slice);
                let chunk = rest.start..rest.start + count;
                rest.start = chunk.end;
                if face.along > 0.0 {
                    self.emit_all(chunk, shift, face, slice, table);
                } else if face.along < 0.0 {
                    self.receive_all(chunk.clone(), shift, face, slice, table);
                    let sums = &mut sums[chunk.start - base..chunk.end - base];
                    self.gather(&table.from, -face.along * self.lines.weight, sums);
                }
            }
        }
        let shared = part.shared as usize..next.start as usize;
        self.shared(shared.clone(), slice, table, &mut sums[shared.start - base..]);
    }

    #[inline(always)]
    fn face(&self, plane: u32, slice: &Slice) -> Face {
        let n = &self.copy.normals[plane as usize];
        let along = dot(n, &self.lines.sigma);
        let (next, previous) = (dot(n, &slice.next), dot(n, &slice.previous));
        let step = if along > 0.0 { previous } else { next };
        Face { plane, along, step: step + 0.0 }
    }

    /// Keys and centre heights of a patch.
    #[inline(always)]
    fn lone(&self, range: &Range<usize>) -> (&[u32], &[f32]) {
        let keys = self.copy.lone_keys(range.clone());
        (keys, &self.copy.center_heights[range.start..][..keys.len()])
    }

    /// A patch that lines leave. What cannot be told from planes alone is put off: every surfel of a patch has a line
    /// of its own, so that their order does not matter.
    #[inline(never)]
    fn emit_all(&self, range: Range<usize>, shift: u32, face: Face, slice: &Slice, table: &mut Table) {
        let (keys, heights) = self.lone(&range);
        let planes = &self.copy.planes[..];
        let (cells, older, late) = (&mut table.cells[..], &mut table.older[..], &mut table.late);
        let (first, run, none, unknown) = (range.start as u32, slice.run, self.none, self.unknown);
        let mut put_off = 0;
        for k in 0..keys.len() {
            let at = keys[k].wrapping_add(shift) as usize;
            let cell = &mut cells[at];
            let surfel = first + k as u32;
            if cell.receiver == none && run.has(cell.emitter) {
                if planes[cell.emitter as usize] == face.plane {
                    cell.emitter = surfel;
                } else {
                    late[put_off % CHUNK] = surfel;
                    put_off += 1;
                }
                continue;
            }
            let carries = (cell.emitter != unknown) & (cell.receiver & BLOCKED == 0);
            if !(carries & (heights[k] + face.step > 0.0)) {
                older[at] = *cell;
                *cell = Cell { emitter: surfel, receiver: none };
            }
        }
        for k in 0..put_off {
            self.emit(self.stop(table.late[k % CHUNK], slice), face, slice, table);
        }
    }

    /// A patch that lines arrive at. Where the light comes from is found first and the light is fetched afterwards,
    /// many surfels at once: each comes from somewhere else in memory.
    #[inline(never)]
    fn receive_all(&self, range: Range<usize>, shift: u32, face: Face, slice: &Slice, table: &mut Table) {
        let (keys, heights) = self.lone(&range);
        let planes = &self.copy.planes[..];
        let (cells, from, late) = (&mut table.cells[..], &mut table.from[..keys.len()], &mut table.late);
        let (first, run, thin) = (range.start as u32, slice.run, slice.thin);
        let mut put_off = 0;
        for k in 0..keys.len() {
            let cell = &mut cells[keys[k].wrapping_add(shift) as usize];
            let surfel = first + k as u32;
            let last = cell.receiver & !BLOCKED;
            let plane = planes[last as usize];
            let same = plane == face.plane && run.has(last);
            if !same && (plane != NOWHERE || thin.has(cell.emitter)) {
                late[put_off % CHUNK] = surfel;
                put_off += 1;
                continue;
            }
            // The sign of the sum, which is no negative zero because the step is none.
            let blocked = (cell.receiver | (heights[k] + face.step).to_bits()) & BLOCKED;
            cell.receiver = surfel | blocked;
            from[k] = cell.emitter;
        }
        for k in 0..put_off {
            let surfel = table.late[k % CHUNK];
            let from = self.receive(self.stop(surfel, slice), face, slice, table);
            table.from[(surfel - first) as usize] = from;
        }
    }

    /// Adds what the surfels of a patch see.
    #[inline(always)]
    fn gather(&self, from: &[u32; CHUNK], w: f32, sums: &mut [S]) {
        for (sum, &from) in sums.iter_mut().zip(from) {
            let known = if from == self.unknown { 0.0 } else { w };
            *sum += S::arrived(self.light[from as usize], w, known);
        }
        if let Some(sky) = self.sky {
            let seen = sums.iter_mut().zip(from).filter(|(_, from)| **from == self.copy.len() as u32 + SKY);
            seen.for_each(|(sum, _)| *sum += S::arrived(sky, w, 0.0));
        }
    }

    #[inline(always)]
    fn stop(&self, surfel: u32, slice: &Slice) -> Stop {
        let i = surfel as usize;
        let (at, center_height) = (self.lines.cell(self.copy.key(i), slice), self.copy.center_heights[i]);
        Stop { surfel, at, center_height, divides: self.copy.layer(i).is_face() }
    }

    /// The voxels of several surfels. What depends on a surfel and the direction alone is worked out first, without a
    /// branch.
    fn shared(&self, range: Range<usize>, slice: &Slice, table: &mut Table, sums: &mut [S]) {
        let start = range.start;
        let mut faces = std::mem::take(&mut table.faces);
        faces.clear();
        faces.extend(
            range.clone().map(|i| Placed { face: self.face(self.copy.planes[i], slice), depth: self.depth(i) }),
        );
        let mut i = 0;
        while i < faces.len() {
            if self.copy.shares_voxel(start + i + 1) {
                if self.copy.layer(start + i).is_divided() {
                    self.set_apart(start + i, &mut faces[i..]);
                }
                let voxel = self.by_depth(start + i, &faces[i..]);
                for &k in &voxel.surfels[..voxel.len] {
                    let at = i + k as usize;
                    self.pass(start + at, faces[at].face, slice, table, &mut sums[at]);
                }
                i += voxel.len;
            } else {
                let swap = usize::from(faces[i + 1].is_before(&faces[i]));
                let (a, b) = (i + swap, i + 1 - swap);
                self.pass(start + a, faces[a].face, slice, table, &mut sums[a]);
                self.pass(start + b, faces[b].face, slice, table, &mut sums[b]);
                i += 2;
            }
        }
        table.faces = faces;
    }

    #[inline(always)]
    fn depth(&self, i: usize) -> f32 {
        dot(&self.copy.centroid(i), &self.lines.sigma)
    }

    /// Moves the layers of a divided voxel apart, so that depth sorts them in the order in which the line meets them.
    #[cold]
    fn set_apart(&self, first: usize, placed: &mut [Placed]) {
        let count = 1 + (first..).take_while(|&i| self.copy.shares_voxel(i)).count();
        let layer = |k: usize| self.copy.layer(first + k);
        let along = (0..count).find(|&k| layer(k).is_wall()).map_or(0.0, |k| placed[k].face.along);
        for (k, placed) in placed[..count].iter_mut().enumerate() {
            placed.depth += (APART * f32::from(layer(k).number())).copysign(along);
        }
    }

    /// Sorts a voxel of three and more by depth.
    #[inline(never)]
    fn by_depth(&self, first: usize, placed: &[Placed]) -> Voxel {
        let mut voxel = Voxel { surfels: [0; MAX_PER_VOXEL], len: 0 };
        for (i, one) in placed.iter().enumerate().take(MAX_PER_VOXEL) {
            let mut k = voxel.len;
            while k > 0 && one.is_before(&placed[voxel.surfels[k - 1] as usize]) {
                voxel.surfels[k] = voxel.surfels[k - 1];
                k -= 1;
            }
            voxel.surfels[k] = i as u32;
            voxel.len += 1;
            if !self.copy.shares_voxel(first + i) {
                break;
            }
        }
        voxel
    }

    #[inline(always)]
    fn pass(&self, i: usize, face: Face, slice: &Slice, table: &mut Table, sum: &mut S) {
        let stop = self.stop(i as u32, slice);
        if face.along > 0.0 {
            self.emit(stop, face, slice, table);
        } else if face.along < 0.0 {
            table.from[0] = self.receive(stop, face, slice, table);
            self.gather(&table.from, -face.along * self.lines.weight, std::slice::from_mut(sum));
        }
    }
}

#[inline(always)]
pub(super) fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
