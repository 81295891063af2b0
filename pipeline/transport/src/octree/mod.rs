//! The octree irradiance cache: what a bake knows about light, independent of view, UVs and engine.
//!
//! A sparse octree over the voxels that hold surfels. Leaves hold the surfels with their direct and indirect
//! irradiance [lux] as f32 (f16 overflows); every node holds the aggregate of its leaves: power Σ A·B of the light that
//! leaves them, area, bounding box, cone of normals. Empty space has no nodes, chains of single children are skipped.
//!
//! It is the form in which this light is stored: a stored tree gives back the [`Surfels`] and the [`Solution`] it was
//! made from, bit by bit, so that it stands for voxelization and propagation. No stage of a bake reads light out of the
//! tree itself: the gather has structures of its own. So a tree never exists beside what it was made from: [`Octree`]
//! is an order of the surfels and the ranges of the nodes, about ten bytes a surfel, whose leaves and aggregates come
//! into being one by one as they are written, and [`read`] fills the lists directly.

mod codec;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::{
    Rgb,
    surfel::{Grid, Solution, Surfel, Surfels, morton},
};

pub use codec::{OctreeError, read};

/// Surfels in a node that is not split further, as a rule; a voxel is never split.
const LEAF_SIZE: u32 = 8;

/// A surfel with its light.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Leaf {
    pub surfel: Surfel,
    /// Irradiance [lux].
    pub direct: Rgb,
    pub indirect: Rgb,
}

/// A node with the aggregate of its leaves, or a group of leaves.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// Bounding box of the leaves' positions.
    pub lo: [f32; 3],
    pub hi: [f32; 3],
    /// Σ A·B, B = ρE: reflected light that leaves the surfels [lux × squared frame units].
    pub power: [f32; 3],
    pub area: f32,
    /// Cone around all normals: unit axis and cosine of the half angle (−1 where normals cancel).
    pub axis: [f32; 3],
    pub cosine: f32,
    /// Range of leaves.
    pub first: u32,
    pub count: u32,
    /// Range of child nodes; none for a group of leaves. Children come after their parent.
    pub child: u32,
    pub children: u32,
}

/// The tree over the surfels of a solution.
#[derive(Clone, Debug)]
pub struct Octree<'a> {
    surfels: &'a Surfels,
    solution: &'a Solution,
    /// The surfel at each place of the tree.
    order: Vec<u32>,
    nodes: Vec<Span>,
}

/// What a node holds, without the aggregate; as in [`Node`].
#[derive(Clone, Copy, Debug)]
struct Span {
    first: u32,
    count: u32,
    child: u32,
    children: u32,
}

impl<'a> Octree<'a> {
    /// The tree of a solution. Panics if the lengths differ.
    pub fn new(surfels: &'a Surfels, solution: &'a Solution) -> Self {
        assert_eq!(surfels.list.len(), solution.direct.len(), "a direct irradiance for every surfel");
        assert_eq!(surfels.list.len(), solution.indirect.len(), "an indirect irradiance for every surfel");
        let mut codes: Vec<(u64, u32)> =
            surfels.list.iter().enumerate().map(|(i, s)| (morton(s.voxel()), i as u32)).collect();
        codes.sort_unstable();
        let nodes = structure(&codes);
        Self { surfels, solution, order: codes.iter().map(|(_, i)| *i).collect(), nodes }
    }

    pub fn grid(&self) -> &Grid {
        &self.surfels.grid
    }

    /// Nodes, the root first; none where there is no surfel. Each is aggregated when it is asked for.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = Node> {
        self.nodes.iter().map(|span| self.aggregate(span))
    }

    /// The surfels with their light, in the tree's order.
    pub fn leaves(&self) -> impl ExactSizeIterator<Item = Leaf> {
        self.order.iter().map(|i| self.leaf(*i))
    }

    fn leaf(&self, surfel: u32) -> Leaf {
        let i = surfel as usize;
        Leaf { surfel: self.surfels.list[i], direct: self.solution.direct[i], indirect: self.solution.indirect[i] }
    }

    fn aggregate(&self, span: &Span) -> Node {
        let mine = &self.order[span.first as usize..(span.first + span.count) as usize];
        let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let (mut power, mut area, mut axis) = (glam::DVec3::ZERO, 0.0f64, glam::DVec3::ZERO);
        for Leaf { surfel: s, direct, indirect } in mine.iter().map(|i| self.leaf(*i)) {
            (lo, hi) = (lo.min(s.centroid), hi.max(s.centroid));
            let radiosity = s.albedo() * (direct + indirect);
            power += f64::from(s.area) * radiosity.as_dvec3();
            area += f64::from(s.area);
            axis += f64::from(s.area) * s.normal.as_dvec3();
        }
        let unit = axis.try_normalize().map(|a| a.as_vec3());
        let normal = |i: &u32| self.surfels.list[*i as usize].normal;
        let cosine = unit.map_or(-1.0, |a| mine.iter().fold(1.0f32, |m, i| m.min(a.dot(normal(i)))));
        // Of two zeros either may be the least, as the compiler likes: a sum with zero has no sign.
        Node {
            lo: (lo + Vec3::ZERO).to_array(),
            hi: (hi + Vec3::ZERO).to_array(),
            power: power.as_vec3().to_array(),
            area: area as f32,
            axis: unit.unwrap_or(Vec3::Z).to_array(),
            cosine: cosine.max(-1.0) + 0.0,
            first: span.first,
            count: span.count,
            child: span.child,
            children: span.children,
        }
    }
}

/// Nodes over surfels sorted by Morton code, breadth first so that the children of a node are neighbours.
fn structure(codes: &[(u64, u32)]) -> Vec<Span> {
    let group = |first: usize, count: usize| Span { first: first as u32, count: count as u32, child: 0, children: 0 };
    let mut nodes = if codes.is_empty() { Vec::new() } else { vec![group(0, codes.len())] };
    let mut next = 0;
    while next < nodes.len() {
        let (first, count) = (nodes[next].first as usize, nodes[next].count as usize);
        let mine = &codes[first..first + count];
        let differing = mine[0].0 ^ mine[count - 1].0;
        if count > LEAF_SIZE as usize && differing != 0 {
            // The highest level on which the codes differ; levels above it would have a single child.
            let level = (63 - differing.leading_zeros()) / 3;
            nodes[next].child = nodes.len() as u32;
            let mut start = first;
            for part in mine.chunk_by(|a, b| a.0 >> (3 * level) == b.0 >> (3 * level)) {
                nodes.push(group(start, part.len()));
                nodes[next].children += 1;
                start += part.len();
            }
        }
        next += 1;
    }
    nodes
}

#[cfg(test)]
mod tests;
