//! The octree irradiance cache: what a bake knows about light, independent of view, UVs and engine.
//!
//! A sparse octree over the voxels that hold surfels. Leaves hold the surfels with their direct and indirect
//! irradiance [lux] as f32 (f16 overflows); every node holds the aggregate of its leaves: power Σ A·B of the light that
//! leaves them, area, bounding box, cone of normals. Empty space has no nodes, chains of single children are skipped.
//!
//! It is the form in which this light is stored: the cache gives back the [`Surfels`] and the [`Solution`] it was made
//! from, bit by bit, so that a stored tree stands for voxelization and propagation. No stage of a bake reads light out
//! of the tree itself: the gather has structures of its own over what [`Octree::unpack`] returns.

mod codec;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::{
    Rgb,
    surfel::{Emission, Grid, Solution, Surfel, Surfels, morton},
};

pub use codec::OctreeError;

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

/// The cache. Its parts fit together; [`Octree::from_bytes`] sees to that for what comes from a disk.
#[derive(Clone, Debug, PartialEq)]
pub struct Octree {
    grid: Grid,
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// As in [`Surfels::emission`], in the order of the list.
    emission: Vec<Emission>,
}

impl Octree {
    /// The tree of a solution. Panics if the lengths differ.
    pub fn new(surfels: &Surfels, solution: &Solution) -> Self {
        assert_eq!(surfels.list.len(), solution.direct.len(), "a direct irradiance for every surfel");
        assert_eq!(surfels.list.len(), solution.indirect.len(), "an indirect irradiance for every surfel");
        let mut order: Vec<(u64, u32)> =
            surfels.list.iter().enumerate().map(|(i, s)| (morton(s.voxel()), i as u32)).collect();
        order.sort_unstable();
        let leaf = |&(_, i): &(u64, u32)| {
            let i = i as usize;
            Leaf { surfel: surfels.list[i], direct: solution.direct[i], indirect: solution.indirect[i] }
        };
        let leaves: Vec<Leaf> = order.iter().map(leaf).collect();
        let mut nodes = structure(&order);
        drop(order);
        nodes.iter_mut().for_each(|node| aggregate(node, &leaves));
        Self { grid: surfels.grid, nodes, leaves, emission: surfels.emission.clone() }
    }

    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Nodes, the root first; empty where there is no surfel.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    pub fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// Whether every leaf lies on one of so many triangles; a stored tree says nothing about the scene it meets.
    pub fn fits(&self, triangles: usize) -> bool {
        self.leaves.iter().all(|l| (l.surfel.triangle as usize) < triangles)
    }

    /// The surfels and the solution that the tree was made from.
    pub fn unpack(&self) -> (Surfels, Solution) {
        let mut order: Vec<u32> = (0..self.leaves.len() as u32).collect();
        let leaf = |i: &u32| &self.leaves[*i as usize];
        // Within a voxel the tree keeps the order of the list.
        order.sort_unstable_by_key(|i| (leaf(i).surfel.voxel().to_array(), *i));
        let list = order.iter().map(|i| leaf(i).surfel).collect();
        let direct = order.iter().map(|i| leaf(i).direct).collect();
        let indirect = order.iter().map(|i| leaf(i).indirect).collect();
        (Surfels { grid: self.grid, list, emission: self.emission.clone() }, Solution { direct, indirect })
    }
}

/// Nodes over surfels sorted by Morton code, breadth first so that the children of a node are neighbours. Aggregates
/// are empty.
fn structure(codes: &[(u64, u32)]) -> Vec<Node> {
    let empty = |first: usize, count: usize| Node { first: first as u32, count: count as u32, ..Node::zeroed() };
    let mut nodes = if codes.is_empty() { Vec::new() } else { vec![empty(0, codes.len())] };
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
                nodes.push(empty(start, part.len()));
                nodes[next].children += 1;
                start += part.len();
            }
        }
        next += 1;
    }
    nodes
}

fn aggregate(node: &mut Node, leaves: &[Leaf]) {
    let mine = &leaves[node.first as usize..(node.first + node.count) as usize];
    let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (mut power, mut area, mut axis) = (glam::DVec3::ZERO, 0.0f64, glam::DVec3::ZERO);
    for Leaf { surfel: s, direct, indirect } in mine {
        (lo, hi) = (lo.min(s.centroid), hi.max(s.centroid));
        let radiosity = s.albedo() * (*direct + *indirect);
        power += f64::from(s.area) * radiosity.as_dvec3();
        area += f64::from(s.area);
        axis += f64::from(s.area) * s.normal.as_dvec3();
    }
    let unit = axis.try_normalize().map(|a| a.as_vec3());
    let cosine = unit.map_or(-1.0, |a| mine.iter().fold(1.0f32, |m, l| m.min(a.dot(l.surfel.normal))));
    node.lo = lo.to_array();
    node.hi = hi.to_array();
    node.power = power.as_vec3().to_array();
    node.area = area as f32;
    node.axis = unit.unwrap_or(Vec3::Z).to_array();
    node.cosine = cosine.max(-1.0);
}

#[cfg(test)]
mod tests;
