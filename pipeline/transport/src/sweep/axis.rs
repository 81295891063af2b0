//! Copies of the surfels in the lexicographic order of a dominant axis, laid out for the sweep.

use glam::Vec3;

use crate::{Rgb, surfel::Surfels};

/// Flags in [`SweepSurfel::key`]: the next surfel lies in the same voxel; the surfel does not fill its plane.
const SHARES_VOXEL: u32 = 1 << 31;
const PARTIAL: u32 = 1 << 30;

/// A surfel as the sweep sees it: 32 bytes, half a cache line. Lengths in voxel edges, axes turned so that x is the
/// dominant one.
#[derive(Clone, Copy, Default)]
#[repr(C, align(32))]
pub struct SweepSurfel {
    pub normal: [f32; 3],
    pub centroid: [f32; 3],
    /// n · (centre of the voxel − centroid).
    pub center_height: f32,
    /// Line key y·stride + z before the shift of its slice, and flags.
    key: u32,
}

impl SweepSurfel {
    #[inline(always)]
    pub fn key(&self) -> u32 {
        self.key & !(SHARES_VOXEL | PARTIAL)
    }

    /// The next surfel lies in the same voxel.
    #[inline(always)]
    pub fn shares_voxel(&self) -> bool {
        self.key & SHARES_VOXEL != 0
    }

    #[inline(always)]
    pub fn is_partial(&self) -> bool {
        self.key & PARTIAL != 0
    }

    /// n · (p − c): how far a point lies in front of the surfel's plane.
    #[inline(always)]
    pub fn height(&self, p: &[f32; 3]) -> f32 {
        let (n, c) = (&self.normal, &self.centroid);
        n[0] * (p[0] - c[0]) + n[1] * (p[1] - c[1]) + n[2] * (p[2] - c[2])
    }

    #[inline(always)]
    pub fn along(&self, v: &[f32; 3]) -> f32 {
        self.normal[0] * v[0] + self.normal[1] * v[1] + self.normal[2] * v[2]
    }
}

/// All surfels sorted by the dominant axis first.
pub struct AxisCopy {
    pub axis: usize,
    pub surfels: Vec<SweepSurfel>,
    /// Radiosity B that leaves each of them.
    pub radiosity: Vec<[f32; 3]>,
    /// Share of the lines that each of them stops, of 65536; read for partial ones only.
    pub fill: Vec<u16>,
    /// First surfel of every slice, and the end.
    pub slices: Vec<u32>,
    /// Voxels along the turned axes.
    pub size: [i32; 3],
    /// Cells of the line table from one y to the next.
    pub stride: u32,
}

/// The lexicographic order (axis, axis+1, axis+2) of the list by stable counting sorts, axis 1 or 2; the list itself
/// is in the order (x, y, z).
pub fn order(surfels: &Surfels, axis: usize) -> Vec<u32> {
    let identity: Vec<u32> = (0..surfels.list.len() as u32).collect();
    // (z, x, y) needs z alone; (y, z, x) needs z, then y.
    let by_z = counting_sort(surfels, 2, &identity);
    if axis == 2 { by_z } else { counting_sort(surfels, 1, &by_z) }
}

fn counting_sort(surfels: &Surfels, axis: usize, from: &[u32]) -> Vec<u32> {
    let slice = |i: u32| surfels.list[i as usize].voxel()[axis] as usize;
    let mut starts = vec![0u32; surfels.grid.size[axis] as usize + 1];
    from.iter().for_each(|&i| starts[slice(i) + 1] += 1);
    (1..starts.len()).for_each(|k| starts[k] += starts[k - 1]);
    let mut order = vec![0; from.len()];
    for &i in from {
        let at = &mut starts[slice(i)];
        order[*at as usize] = i;
        *at += 1;
    }
    order
}

impl AxisCopy {
    /// `order` is None for axis 0, whose order is that of the list.
    pub fn new(surfels: &Surfels, axis: usize, order: Option<&[u32]>, radiosity: &[Rgb]) -> Self {
        let turn = |v: Vec3| [v[axis], v[(axis + 1) % 3], v[(axis + 2) % 3]];
        let g = surfels.grid.size;
        let size = [g[axis], g[(axis + 1) % 3], g[(axis + 2) % 3]];
        // Slopes are at most 1, so lines shift by at most the number of slices along a minor axis.
        let stride = (size[2] + size[0] + 2) as u32;
        let count = surfels.list.len();
        let at = |k: usize| order.map_or(k, |order| order[k] as usize);
        let mut sorted = Vec::with_capacity(count);
        let mut slices = vec![0u32; size[0] as usize + 1];
        for k in 0..count {
            let s = &surfels.list[at(k)];
            let more = k + 1 < count && surfels.list[at(k + 1)].voxel() == s.voxel();
            let voxel = s.voxel().to_array();
            let (x, y, z) = (voxel[axis], voxel[(axis + 1) % 3], voxel[(axis + 2) % 3]);
            let centroid = surfels.grid.local(s.centroid);
            let flags = if more { SHARES_VOXEL } else { 0 } | if s.fill() < 1.0 { PARTIAL } else { 0 };
            slices[x as usize + 1] += 1;
            sorted.push(SweepSurfel {
                normal: turn(s.normal),
                centroid: turn(centroid),
                center_height: s.normal.dot(s.voxel().as_vec3() + 0.5 - centroid),
                key: (y as u32 * stride + z as u32) | flags,
            });
        }
        let fill = (0..count).map(|k| surfels.list[at(k)].fill_steps()).collect();
        let radiosity = (0..count).map(|k| radiosity[at(k)].to_array()).collect();
        (1..slices.len()).for_each(|k| slices[k] += slices[k - 1]);
        Self { axis, surfels: sorted, radiosity, fill, slices, size, stride }
    }

    /// Adds sums in the sorted order to sums in the order of the list.
    pub fn scatter_add<const SLOTS: usize>(
        &self,
        order: Option<&[u32]>,
        sorted: &[[f32; SLOTS]],
        sums: &mut [[f32; SLOTS]],
    ) {
        for (k, part) in sorted.iter().enumerate() {
            let sum = &mut sums[order.map_or(k, |order| order[k] as usize)];
            (0..SLOTS).for_each(|b| sum[b] += part[b]);
        }
    }
}
