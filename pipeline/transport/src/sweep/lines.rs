//! The partition of space into naive discrete lines along one direction (paper §2, any real slope).
//!
//! In turned axes with slopes m₁, m₂ ∈ [−1, 1] and phase μ the voxel (x, y, z) belongs to the line
//! (y − ⌊m₁x + μ₁⌋, z − ⌊m₂x + μ₂⌋): one integer shift per slice.
//!
//! A slice is passed by as many lines as it has voxels, so the table of lines has a cell for each voxel of a slice, no
//! more. It is a ring: the cell of a line that leaves the grid at one side passes on to a line that enters at the
//! other. A table of all lines would be four times as large and would not fit the processor's caches.

use glam::Vec3;

use super::axis::AxisCopy;
use crate::directions::Direction;

/// Slices between two surfels of one surface, at most.
const RUN_GAP: usize = 2;
/// Slices across which a wall is thin, at most.
const THIN_GAP: usize = 3;

/// What all voxels of a slice have in common.
#[derive(Clone, Copy)]
pub struct Slice {
    /// Cell of a voxel = its key + this, around the ring.
    pub shift: u32,
    /// By how many voxels lines have moved along the two minor axes since the slice before.
    moved: [i32; 2],
    /// From a voxel to the next and to the previous one on its line.
    pub next: [f32; 3],
    pub previous: [f32; 3],
    /// Surfels at most two and at most three slices behind. Surfels are sorted by slice, so what is near can be told
    /// from an index.
    pub run: Near,
    pub thin: Near,
    /// By how many voxels lines move from the slice that lies this many behind.
    apart: [[f32; 3]; THIN_GAP + 1],
    /// Surfels beyond these lie at least one, two and three slices behind.
    behind: [u32; THIN_GAP],
}

impl Slice {
    /// From the voxel of a surfel at most three slices behind to the voxel of its line in this slice.
    #[inline(always)]
    pub fn apart(&self, surfel: u32, forward: bool) -> &[f32; 3] {
        &self.apart[self.behind.iter().filter(|&&first| (surfel < first) == forward).count()]
    }
}

/// A range of surfels; no special index lies in it.
#[derive(Clone, Copy)]
pub struct Near {
    first: u32,
    count: u32,
}

impl Near {
    fn new(copy: &AxisCopy, x: usize, slices: usize, forward: bool) -> Self {
        let first = if forward { copy.slices[x.saturating_sub(slices)] } else { 0 };
        let end = if forward { copy.len() as u32 } else { copy.slices[(x + slices + 1).min(copy.slices.len() - 1)] };
        Self { first, count: end - first }
    }

    #[inline(always)]
    pub fn has(self, surfel: u32) -> bool {
        surfel.wrapping_sub(self.first) < self.count
    }
}

pub struct Lines {
    /// Unit direction of travel, turned.
    pub sigma: [f32; 3],
    pub weight: f32,
    pub seed: u32,
    /// Light travels towards growing x.
    pub forward: bool,
    pub slices: Vec<Slice>,
    /// Length of the ring.
    pub cells: u32,
    stride: u32,
    /// Voxels of a slice along the two minor axes.
    size: [i32; 2],
}

/// The axis along which a direction goes furthest; the first one of equals.
pub fn dominant(sigma: Vec3) -> usize {
    let a = sigma.abs();
    if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    }
}

impl Lines {
    pub fn new(copy: &AxisCopy, direction: &Direction) -> Self {
        let s = direction.sigma;
        let sigma = [s[copy.axis], s[(copy.axis + 1) % 3], s[(copy.axis + 2) % 3]];
        let slope = |k: usize| (f64::from(sigma[k]) / f64::from(sigma[0])).clamp(-1.0, 1.0);
        let floor = |k: usize, x: i32| (slope(k) * f64::from(x) + direction.phase[k - 1]).floor() as i32;
        let last = copy.size[0] - 1;
        let forward = sigma[0] >= 0.0;
        let ahead = if forward { 1 } else { -1 };
        let step = |x: i32, by: i32| {
            let d = |k| (floor(k, x + by) - floor(k, x)) as f32;
            [by as f32, d(1), d(2)]
        };
        let cells = copy.cells();
        let first = if forward { 0 } else { last };
        let shift = |x: i32| -i64::from(floor(1, x)) * i64::from(copy.stride) - i64::from(floor(2, x));
        let slice = |x: i32| Slice {
            shift: shift(x).rem_euclid(i64::from(cells.max(1))) as u32,
            moved: if x == first { [0; 2] } else { [1, 2].map(|k| floor(k, x) - floor(k, x - ahead)) },
            next: step(x, ahead),
            previous: step(x, -ahead),
            run: Near::new(copy, x as usize, RUN_GAP, forward),
            thin: Near::new(copy, x as usize, THIN_GAP, forward),
            apart: std::array::from_fn(|k| step(x, -ahead * k as i32).map(|d| 0.0 - d)),
            behind: std::array::from_fn(|k| {
                let first = if forward { x - k as i32 } else { x + 1 + k as i32 };
                copy.slices[first.clamp(0, copy.size[0]) as usize]
            }),
        };
        Self {
            sigma,
            weight: direction.weight,
            seed: direction.seed,
            forward,
            slices: (0..=last).map(slice).collect(),
            cells,
            stride: copy.stride,
            size: [copy.size[1], copy.size[2]],
        }
    }

    /// The cell of the line through a voxel.
    #[inline(always)]
    pub fn cell(&self, key: u32, slice: &Slice) -> u32 {
        let at = key + slice.shift;
        at.min(at.wrapping_sub(self.cells))
    }

    /// How many of these keys, in growing order, have cells on one side of the ring's seam, and their shift.
    #[inline(always)]
    pub fn straight(&self, keys: &[u32], slice: &Slice) -> (usize, u32) {
        let seam = self.cells - slice.shift;
        if keys[0] >= seam {
            (keys.len(), slice.shift.wrapping_sub(self.cells))
        } else if keys[keys.len() - 1] < seam {
            (keys.len(), slice.shift)
        } else {
            (keys.partition_point(|&key| key < seam), slice.shift)
        }
    }

    /// Gives the cells of lines that enter the grid in a slice their start.
    pub fn enter<T: Copy>(&self, slice: &Slice, table: &mut [T], start: T) {
        let [rows, columns] = [0, 1].map(|k| entered(slice.moved[k], self.size[k]));
        let all = |k: usize| 0..self.size[k];
        let mut set = |y: i32, z: i32| table[self.cell(y as u32 * self.stride + z as u32, slice) as usize] = start;
        rows.for_each(|y| all(1).for_each(|z| set(y, z)));
        columns.for_each(|z| all(0).for_each(|y| set(y, z)));
    }

    /// Numbers of the parts in the order in which light passes them, each with whether it is the first of its slice.
    pub fn order<'c>(&self, copy: &'c AxisCopy) -> impl Iterator<Item = (usize, bool)> + use<'c> {
        let parts = &copy.parts[..copy.parts.len() - 1];
        let (n, forward) = (parts.len(), self.forward);
        let at = move |i: usize| if forward { i } else { n - 1 - i };
        (0..n).map(move |i| (at(i), i == 0 || parts[at(i)].slice != parts[at(i - 1)].slice))
    }
}

/// Rows of a slice that lines come to from outside when they move by so many.
fn entered(moved: i32, size: i32) -> std::ops::Range<i32> {
    if moved > 0 { 0..moved.min(size) } else { (size + moved).max(0)..size }
}
