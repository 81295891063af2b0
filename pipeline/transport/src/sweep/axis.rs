//! The surfels in the order in which the directions of one dominant axis meet them, laid out for the sweep.
//!
//! The paper's lexicographic order matters from slice to slice; within a slice every line passes one voxel, and the
//! order is free but for the surfels that share a voxel. So each slice holds first its surfels that are alone in their
//! voxel, plane by plane, then the voxels of several.

use std::ops::Range;

use glam::Vec3;

use crate::surfel::{MAX_SIDE, Surfels};

use super::{layers::Layer, planes::Planes};

/// Flag in [`AxisCopy::keys`]: the next surfel lies in the same voxel.
const SHARES_VOXEL: u32 = 1 << 31;

/// First bit of the [`Layer`] in [`AxisCopy::keys`]. Below it lies the place: a slice has at most 2050 · 2072 cells.
const LAYER: u32 = 24;
const PLACE: u32 = (1 << LAYER) - 1;
const _: () = assert!(LAYER + Layer::BITS < 31 && (MAX_SIDE + 2) * (MAX_SIDE + 24) < PLACE);

/// No plane, or none in common.
pub const NOWHERE: u32 = u32::MAX >> 1;

/// Surfels of a patch, at least: for fewer, it is quicker to look at each by itself.
const LEAST: u32 = 4;

/// Surfels of a part, about, so that several threads find room in a slice that is one large wall.
const PART: u32 = 2048;

/// Steps of a voxel edge in which centroids are held.
const STEPS: f32 = 65535.0;

/// Surfels of one plane in one slice, each alone in its voxel.
#[derive(Clone, Copy)]
pub struct Patch {
    pub start: u32,
    /// [`NOWHERE`] if there are several.
    pub plane: u32,
    /// All of its surfels fill their plane, or none does.
    pub partial: bool,
}

/// Some of the surfels of a slice: the first one, the first patch, and the first one that shares its voxel.
#[derive(Clone, Copy, Default)]
pub struct Part {
    pub slice: u32,
    pub start: u32,
    pub patches: u32,
    pub shared: u32,
}

/// What decides about lines that pass a surfel, in [`STEPS`] of one.
#[derive(Clone, Copy)]
#[repr(align(8))]
struct Shape {
    /// From the corner of the voxel: near surfels of one line lie a known number of voxels apart, and the difference is
    /// exact wherever in the grid they are.
    centroid: [u16; 3],
    /// Share of the lines that it stops.
    fill: u16,
}

/// All surfels sorted by the dominant axis first. Lengths in voxel edges, axes turned so that x is the dominant one.
pub struct AxisCopy {
    pub axis: usize,
    /// Place y·stride + z in its slice, the layer of its voxel, and a flag.
    keys: Vec<u32>,
    /// n · (centre of the voxel − centroid).
    pub center_heights: Vec<f32>,
    /// Plane of each of them, and none for the three emitters that are no surfel.
    pub planes: Vec<u32>,
    shapes: Vec<Shape>,
    pub normals: Vec<[f32; 3]>,
    pub patches: Vec<Patch>,
    /// At least one of every slice, in the order of the surfels, and the end.
    pub parts: Vec<Part>,
    /// First surfel of every slice, and the end.
    pub slices: Vec<u32>,
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
    pub fn new(surfels: &Surfels, planes: &Planes, layers: &[Layer], axis: usize, order: &[u32]) -> Self {
        let turn = |v: Vec3| [v[axis], v[(axis + 1) % 3], v[(axis + 2) % 3]];
        let size = turn(surfels.grid.size.as_vec3()).map(|side| side as i32);
        // An odd number of cache lines of eight cells: those of a column do not fall into the same few places.
        let stride = (size[2] as u32).div_ceil(8) / 2 * 16 + 8;
        let count = order.len();
        let mut copy = Self {
            axis,
            keys: Vec::with_capacity(count),
            center_heights: Vec::with_capacity(count),
            planes: Vec::with_capacity(count + 3),
            shapes: Vec::with_capacity(count),
            normals: planes.normals.iter().map(|&n| turn(n)).collect(),
            patches: Vec::new(),
            parts: Vec::new(),
            slices: Vec::with_capacity(size[0] as usize + 1),
            size,
            stride,
        };
        for (k, &i) in order.iter().enumerate() {
            let s = &surfels.list[i as usize];
            let voxel = s.voxel();
            let [x, y, z] = [0, 1, 2].map(|turned| voxel[(axis + turned) % 3]);
            while copy.slices.len() <= x as usize {
                copy.slices.push(k as u32);
            }
            let shares = order.get(k + 1).is_some_and(|&next| surfels.list[next as usize].voxel() == voxel);
            let layer = layers.get(i as usize).map_or(0, |layer| layer.bits() << LAYER);
            copy.keys.push((y as u32 * stride + z as u32) | layer | if shares { SHARES_VOXEL } else { 0 });
            // Centroids lie in their voxels, but for rounding.
            let centroid = (surfels.grid.local(s.centroid) - voxel.as_vec3()).clamp(Vec3::ZERO, Vec3::ONE);
            let steps = turn(centroid).map(|c| (c * STEPS).round() as u16);
            copy.shapes.push(Shape { centroid: steps, fill: s.fill_steps() });
            let plane = planes.of[i as usize];
            copy.planes.push(plane);
            copy.center_heights.push(planes.normals[plane as usize].dot(0.5 - centroid));
        }
        copy.slices.resize(size[0] as usize + 1, count as u32);
        copy.planes.extend([NOWHERE; 3]);
        (0..size[0] as u32).for_each(|x| copy.divide(x));
        copy.begin_part(size[0] as u32, count as u32);
        copy
    }

    /// Divides a slice into parts, and its surfels that are alone in their voxels into patches.
    fn divide(&mut self, x: u32) {
        let (start, end) = (self.slices[x as usize], self.slices[x as usize + 1]);
        let shared = (start..end).find(|&i| self.shares_voxel(i as usize)).unwrap_or(end);
        let mut part = self.begin_part(x, start);
        let mut at = start;
        while at < shared {
            if at - self.parts[part].start >= PART {
                part = self.begin_part(x, at);
            }
            let kind = |i: u32| (self.planes[i as usize], self.is_partial(i as usize));
            let (plane, partial) = kind(at);
            let count = (at..shared.min(at + PART)).take_while(|&i| kind(i) == (plane, partial)).count() as u32;
            // Neighbouring patches of few surfels become one of no common plane.
            let plane = if count < LEAST { NOWHERE } else { plane };
            let continues = plane == NOWHERE
                && self.patches[self.parts[part].patches as usize..].last().is_some_and(|last| last.plane == NOWHERE);
            if !continues {
                self.patches.push(Patch { start: at, plane, partial });
            }
            at += count;
            self.parts[part].shared = at;
        }
        while at < end {
            if at - self.parts[part].start >= PART {
                part = self.begin_part(x, at);
            }
            at += (at..end).take_while(|&i| self.shares_voxel(i as usize)).count() as u32 + 1;
        }
    }

    fn begin_part(&mut self, slice: u32, start: u32) -> usize {
        self.parts.push(Part { slice, start, patches: self.patches.len() as u32, shared: start });
        self.parts.len() - 1
    }

    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Cells of the table of lines: one for every voxel of a slice.
    pub fn cells(&self) -> u32 {
        self.size[1] as u32 * self.stride
    }

    #[inline(always)]
    pub fn key(&self, i: usize) -> u32 {
        self.keys[i] & PLACE
    }

    pub fn layer(&self, i: usize) -> Layer {
        Layer::from_bits(self.keys[i] >> LAYER & ((1 << Layer::BITS) - 1))
    }

    /// Keys of surfels that are alone in their voxels.
    #[inline(always)]
    pub fn lone_keys(&self, range: Range<usize>) -> &[u32] {
        &self.keys[range]
    }

    /// The next surfel lies in the same voxel.
    #[inline(always)]
    pub fn shares_voxel(&self, i: usize) -> bool {
        self.keys[i] & SHARES_VOXEL != 0
    }

    /// The surfel does not stop all lines through its plane.
    #[inline(always)]
    pub fn is_partial(&self, i: usize) -> bool {
        self.shapes[i].fill != u16::MAX
    }

    /// Share of the lines that a surfel stops, of 65535.
    pub fn fill(&self, i: usize) -> u16 {
        self.shapes[i].fill
    }

    #[inline(always)]
    pub fn normal(&self, i: usize) -> &[f32; 3] {
        &self.normals[self.planes[i] as usize]
    }

    /// Centroid from the corner of its voxel.
    #[inline(always)]
    pub fn centroid(&self, i: usize) -> [f32; 3] {
        self.shapes[i].centroid.map(|steps| f32::from(steps) * (1.0 / STEPS))
    }

    /// From the centroid of a surfel to that of another one, whose voxel lies `apart` from the first one's.
    #[inline(always)]
    pub fn between(&self, from: usize, to: usize, apart: &[f32; 3]) -> [f32; 3] {
        let (a, b) = (&self.shapes[from].centroid, &self.shapes[to].centroid);
        [0, 1, 2].map(|k| apart[k] + (i32::from(b[k]) - i32::from(a[k])) as f32 * (1.0 / STEPS))
    }
}
