//! The partition of space into naive discrete lines along one direction (paper §2, any real slope).
//!
//! In turned axes with slopes m₁, m₂ ∈ [−1, 1] and phase μ the voxel (x, y, z) belongs to the line
//! (y − ⌊m₁x + μ₁⌋, z − ⌊m₂x + μ₂⌋): one integer shift per slice.

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
    /// Cell of a voxel = its key + this.
    pub shift: u32,
    /// From a voxel to the next and to the previous one on its line.
    pub next: [f32; 3],
    pub previous: [f32; 3],
    /// Surfels at most two and at most three slices behind. Surfels are sorted by slice, so what is near can be told
    /// from an index.
    pub run: Near,
    pub thin: Near,
}

/// A range of surfels; no special index lies in it.
#[derive(Clone, Copy)]
pub struct Near {
    first: u32,
    count: u32,
}

impl Near {
    fn new(copy: &AxisCopy, x: usize, slices: usize, forward: bool) -> Self {
        let first = if forward { copy.slices[x.saturating_sub(slices)].start } else { 0 };
        let end =
            if forward { copy.len() as u32 } else { copy.slices[(x + slices + 1).min(copy.slices.len() - 1)].start };
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
    /// Cells in use.
    pub cells: usize,
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
        let most = [1, 2].map(|k| floor(k, 0).max(floor(k, last)));
        let least = [1, 2].map(|k| floor(k, 0).min(floor(k, last)));
        let forward = sigma[0] >= 0.0;
        let ahead = if forward { 1 } else { -1 };
        let step = |x: i32, by: i32| {
            let d = |k| (floor(k, x + by) - floor(k, x)) as f32;
            [by as f32, d(1), d(2)]
        };
        let slice = |x: i32| Slice {
            shift: (most[0] - floor(1, x)) as u32 * copy.stride + (most[1] - floor(2, x)) as u32,
            next: step(x, ahead),
            previous: step(x, -ahead),
            run: Near::new(copy, x as usize, RUN_GAP, forward),
            thin: Near::new(copy, x as usize, THIN_GAP, forward),
        };
        let rows = copy.size[1] + most[0] - least[0];
        Self {
            sigma,
            weight: direction.weight,
            seed: direction.seed,
            forward,
            slices: (0..=last).map(slice).collect(),
            cells: rows as usize * copy.stride as usize,
        }
    }

    /// Slices in the order in which light passes them.
    pub fn order(&self) -> impl Iterator<Item = usize> {
        let n = self.slices.len();
        let forward = self.forward;
        (0..n).map(move |i| if forward { i } else { n - 1 - i })
    }
}
