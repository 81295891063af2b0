//! The surfels in the order in which the directions of one dominant axis meet them, laid out for the sweep.
//!
//! The paper's lexicographic order matters from slice to slice; within a slice every line passes one voxel, and the
//! order is free but for the surfels that share a voxel. So each slice holds first its surfels that are alone in their
//! voxel, plane by plane, then the voxels of several.

use crate::surfel::Surfels;

use super::planes::Planes;

/// Flag in [`AxisCopy::keys`]: the next surfel lies in the same voxel.
const SHARES_VOXEL: u32 = 1 << 31;

/// No plane, or none in common.
pub const NOWHERE: u32 = u32::MAX >> 1;

/// Surfels of a patch, at least: for fewer, it is quicker to look at each by itself.
const LEAST: u32 = 4;

/// Surfels of one plane in one slice, each alone in its voxel.
#[derive(Clone, Copy)]
pub struct Patch {
    pub start: u32,
    /// [`NOWHERE`] if there are several.
    pub plane: u32,
    /// All of its surfels fill their plane, or none does.
    pub partial: bool,
}

/// First surfel, first patch, and first surfel that shares its voxel.
#[derive(Clone, Copy, Default)]
pub struct Contents {
    pub start: u32,
    pub patches: u32,
    pub shared: u32,
}

/// All surfels sorted by the dominant axis first. Lengths in voxel edges, axes turned so that x is the dominant one.
pub struct AxisCopy {
    pub axis: usize,
    /// Line key y·stride + z before the shift of its slice, and a flag.
    keys: Vec<u32>,
    /// n · (centre of the voxel − centroid).
    pub center_heights: Vec<f32>,
    /// Plane of each of them, and none for the three emitters that are no surfel.
    pub planes: Vec<u32>,
    pub centroids: Vec<[f32; 3]>,
    /// Share of the lines that each of them stops, of 65536.
    pub fill: Vec<u16>,
    pub normals: Vec<[f32; 3]>,
    pub patches: Vec<Patch>,
    /// Contents of every slice, and the end.
    pub slices: Vec<Contents>,
    /// Voxels along the turned axes.
    pub size: [i32; 3],
    /// Cells of the line table from one y to the next.
    pub stride: u32,
}

/// The order of the surfels along an axis, as indices into the list, by stable counting sorts.
pub fn order(surfels: &Surfels, planes: &Planes, axis: usize) -> Vec<u32> {
    let list = &surfels.list;
    // Surfels of a shared voxel have to stay together and in the list's order; the list is sorted by voxel.
    let shares = |i: usize| {
        let same = |j: usize| list.get(j).is_some_and(|other| other.voxel() == list[i].voxel());
        same(i + 1) || i > 0 && same(i - 1)
    };
    let count = planes.normals.len();
    let class = |i: u32| {
        let i = i as usize;
        if shares(i) {
            // By the plane of the voxel's first surfel: the voxels of an edge have the same planes.
            let first = (0..i).rev().take_while(|&j| list[j].voxel() == list[i].voxel()).last().unwrap_or(i);
            2 * count + planes.of[first] as usize
        } else {
            2 * planes.of[i] as usize + usize::from(list[i].fill() < 1.0)
        }
    };
    let along = |axis: usize| move |i: u32| list[i as usize].voxel()[axis] as usize;
    let size = surfels.grid.size;
    let mut order: Vec<u32> = (0..list.len() as u32).collect();
    // Neighbours in the table of lines are neighbours in a patch.
    for minor in [(axis + 2) % 3, (axis + 1) % 3] {
        order = counting_sort(&order, size[minor] as usize, along(minor));
    }
    order = counting_sort(&order, 3 * count + 1, class);
    counting_sort(&order, size[axis] as usize, along(axis))
}

fn counting_sort(from: &[u32], keys: usize, key: impl Fn(u32) -> usize) -> Vec<u32> {
    let mut starts = vec![0u32; keys + 1];
    from.iter().for_each(|&i| starts[key(i) + 1] += 1);
    (1..starts.len()).for_each(|k| starts[k] += starts[k - 1]);
    let mut order = vec![0; from.len()];
    for &i in from {
        let at = &mut starts[key(i)];
        order[*at as usize] = i;
        *at += 1;
    }
    order
}

impl AxisCopy {
    pub fn new(surfels: &Surfels, planes: &Planes, axis: usize, order: &[u32]) -> Self {
        let turn = |v: glam::Vec3| [v[axis], v[(axis + 1) % 3], v[(axis + 2) % 3]];
        let g = surfels.grid.size;
        let size = [g[axis], g[(axis + 1) % 3], g[(axis + 2) % 3]];
        // Slopes are at most 1, so lines shift by at most the number of slices along a minor axis.
        let stride = (size[2] + size[0] + 2) as u32;
        let count = order.len();
        let mut copy = Self {
            axis,
            keys: Vec::with_capacity(count),
            center_heights: Vec::with_capacity(count),
            planes: Vec::with_capacity(count + 3),
            centroids: Vec::with_capacity(count),
            fill: Vec::with_capacity(count),
            normals: planes.normals.iter().map(|&n| turn(n)).collect(),
            patches: Vec::new(),
            slices: Vec::with_capacity(size[0] as usize + 1),
            size,
            stride,
        };
        let mut shared_before = false;
        let mut begins = true;
        for (k, &i) in order.iter().enumerate() {
            let s = &surfels.list[i as usize];
            let voxel = s.voxel().to_array();
            let (x, y, z) = (voxel[axis], voxel[(axis + 1) % 3], voxel[(axis + 2) % 3]);
            while copy.slices.len() <= x as usize {
                copy.begin_slice();
                begins = true;
            }
            let shares = order.get(k + 1).is_some_and(|&next| surfels.list[next as usize].voxel() == s.voxel());
            let plane = planes.of[i as usize];
            if !shares && !shared_before {
                let partial = s.fill() < 1.0;
                let continues =
                    !begins && copy.patches.last().is_some_and(|p| (p.plane, p.partial) == (plane, partial));
                if !continues {
                    copy.patches.push(Patch { start: k as u32, plane, partial });
                }
                copy.slices[x as usize].shared = k as u32 + 1;
            }
            begins = false;
            shared_before = shares;
            let centroid = surfels.grid.local(s.centroid);
            let flag = if shares { SHARES_VOXEL } else { 0 };
            copy.keys.push((y as u32 * stride + z as u32) | flag);
            copy.center_heights.push(planes.normals[plane as usize].dot(s.voxel().as_vec3() + 0.5 - centroid));
            copy.planes.push(plane);
            copy.centroids.push(turn(centroid));
            copy.fill.push(s.fill_steps());
        }
        while copy.slices.len() <= size[0] as usize {
            copy.begin_slice();
        }
        copy.planes.extend([NOWHERE; 3]);
        copy.merge_small_patches();
        copy
    }

    /// Neighbouring patches of few surfels become one of no common plane.
    fn merge_small_patches(&mut self) {
        let patches = std::mem::take(&mut self.patches);
        for x in 0..self.slices.len() - 1 {
            let (first, last) = (self.slices[x].patches as usize, self.slices[x + 1].patches as usize);
            let begin = self.patches.len();
            for k in first..last {
                let end = if k + 1 < last { patches[k + 1].start } else { self.slices[x].shared };
                if end - patches[k].start >= LEAST {
                    self.patches.push(patches[k]);
                } else if self.patches.len() == begin || self.patches.last().is_some_and(|p| p.plane != NOWHERE) {
                    self.patches.push(Patch { plane: NOWHERE, ..patches[k] });
                }
            }
            self.slices[x].patches = begin as u32;
        }
        let end = self.slices.len() - 1;
        self.slices[end].patches = self.patches.len() as u32;
    }

    fn begin_slice(&mut self) {
        let start = self.keys.len() as u32;
        self.slices.push(Contents { start, patches: self.patches.len() as u32, shared: start });
    }

    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Cells of the table of lines, at most: lines shift by at most one row per slice.
    pub fn most_cells(&self) -> usize {
        (self.size[1] + self.size[0]) as usize * self.stride as usize
    }

    #[inline(always)]
    pub fn key(&self, i: usize) -> u32 {
        self.keys[i] & !SHARES_VOXEL
    }

    /// Keys of surfels that are alone in their voxels.
    #[inline(always)]
    pub fn lone_keys(&self, range: std::ops::Range<usize>) -> &[u32] {
        &self.keys[range]
    }

    /// The next surfel lies in the same voxel.
    #[inline(always)]
    pub fn shares_voxel(&self, i: usize) -> bool {
        self.keys[i] & SHARES_VOXEL != 0
    }

    #[inline(always)]
    pub fn normal(&self, i: usize) -> &[f32; 3] {
        &self.normals[self.planes[i] as usize]
    }

    /// n · (p − c): how far a point lies in front of a surfel's plane.
    #[inline(always)]
    pub fn height(&self, i: usize, p: &[f32; 3]) -> f32 {
        let (n, c) = (self.normal(i), &self.centroids[i]);
        n[0] * (p[0] - c[0]) + n[1] * (p[1] - c[1]) + n[2] * (p[2] - c[2])
    }
}
