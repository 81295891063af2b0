//! The octree irradiance cache: what a bake knows about light, independent of view, UVs and engine.
//!
//! A sparse octree over the voxels that hold surfels. Leaves hold the surfels with their direct and indirect
//! irradiance [lux] as f32 (f16 overflows); every node holds the aggregate of its leaves: power Σ A·B of the light that
//! leaves them, area, bounding box, cone of normals. Empty space has no nodes, chains of single children are skipped.
//!
//! The cache gives back the [`Surfels`] and the [`Solution`] it was made from, bit by bit, so that a stored tree
//! stands for voxelization and propagation; [`Octree::look_up`] interpolates irradiance at a point, the draft's gather.

mod codec;
mod look_up;

use bytemuck::{Pod, Zeroable};
use glam::{IVec3, Vec3};

use crate::{
    Rgb,
    surfel::{Grid, Solution, Surfel, Surfels},
};

pub use codec::OctreeError;
pub use look_up::Irradiance;

/// Surfels in a node that is not split further, as a rule; a voxel is never split.
const LEAF_SIZE: u32 = 8;

/// A surfel with its light. Lengths are in frame units.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Leaf {
    pub voxel: [i32; 3],
    pub position: [f32; 3],
    pub normal: [f32; 3],
    pub area: f32,
    pub albedo: [f32; 3],
    /// Emitted radiance [cd/m²].
    pub emission: [f32; 3],
    pub fill: f32,
    /// Irradiance [lux].
    pub direct: [f32; 3],
    pub indirect: [f32; 3],
    /// A point on a real triangle; `back` is 0 or 1.
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
    pub back: u32,
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
}

impl Octree {
    /// The tree of a solution. Panics if the lengths differ.
    pub fn new(surfels: &Surfels, solution: &Solution) -> Self {
        assert_eq!(surfels.list.len(), solution.direct.len(), "a direct irradiance for every surfel");
        assert_eq!(surfels.list.len(), solution.indirect.len(), "an indirect irradiance for every surfel");
        let mut order: Vec<(u64, u32)> =
            surfels.list.iter().enumerate().map(|(i, s)| (morton(s.voxel), i as u32)).collect();
        order.sort_unstable();
        let leaf = |&(_, i): &(u64, u32)| {
            let i = i as usize;
            leaf(&surfels.list[i], solution.direct[i], solution.indirect[i])
        };
        let leaves: Vec<Leaf> = order.iter().map(leaf).collect();
        let codes: Vec<u64> = order.iter().map(|(code, _)| *code).collect();
        let mut nodes = structure(&codes);
        nodes.iter_mut().for_each(|node| aggregate(node, &leaves));
        Self { grid: surfels.grid, nodes, leaves }
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
        self.leaves.iter().all(|l| (l.triangle as usize) < triangles)
    }

    /// The surfels and the solution that the tree was made from.
    pub fn unpack(&self) -> (Surfels, Solution) {
        let mut order: Vec<usize> = (0..self.leaves.len()).collect();
        // Stable: within a voxel the tree keeps the order of the list.
        order.sort_by_key(|&i| self.leaves[i].voxel);
        let list = order.iter().map(|&i| surfel(&self.leaves[i])).collect();
        let direct = order.iter().map(|&i| Rgb::from(self.leaves[i].direct)).collect();
        let indirect = order.iter().map(|&i| Rgb::from(self.leaves[i].indirect)).collect();
        (Surfels { grid: self.grid, list }, Solution { direct, indirect })
    }
}

fn leaf(s: &Surfel, direct: Rgb, indirect: Rgb) -> Leaf {
    Leaf {
        voxel: s.voxel.to_array(),
        position: s.centroid.to_array(),
        normal: s.normal.to_array(),
        area: s.area,
        albedo: s.albedo.to_array(),
        emission: s.emission.to_array(),
        fill: s.fill,
        direct: direct.to_array(),
        indirect: indirect.to_array(),
        triangle: s.triangle,
        u: s.u,
        v: s.v,
        back: u32::from(s.back),
    }
}

fn surfel(l: &Leaf) -> Surfel {
    Surfel {
        voxel: IVec3::from(l.voxel),
        centroid: l.position.into(),
        normal: l.normal.into(),
        area: l.area,
        albedo: l.albedo.into(),
        emission: l.emission.into(),
        fill: l.fill,
        triangle: l.triangle,
        u: l.u,
        v: l.v,
        back: l.back != 0,
    }
}

/// Interleaves the bits of a voxel's coordinates: the path from the root, three bits a level.
fn morton(voxel: IVec3) -> u64 {
    let spread = |v: i32| {
        let mut x = v as u64 & 0x1f_ffff;
        x = (x | x << 32) & 0x1f_0000_0000_ffff;
        x = (x | x << 16) & 0x1f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(voxel.x) << 2 | spread(voxel.y) << 1 | spread(voxel.z)
}

/// Nodes over sorted Morton codes, breadth first so that the children of a node are neighbours. Aggregates are empty.
fn structure(codes: &[u64]) -> Vec<Node> {
    let empty = |first: usize, count: usize| Node { first: first as u32, count: count as u32, ..Node::zeroed() };
    let mut nodes = if codes.is_empty() { Vec::new() } else { vec![empty(0, codes.len())] };
    let mut next = 0;
    while next < nodes.len() {
        let (first, count) = (nodes[next].first as usize, nodes[next].count as usize);
        let mine = &codes[first..first + count];
        let differing = mine[0] ^ mine[count - 1];
        if count > LEAF_SIZE as usize && differing != 0 {
            // The highest level on which the codes differ; levels above it would have a single child.
            let level = (63 - differing.leading_zeros()) / 3;
            nodes[next].child = nodes.len() as u32;
            let mut start = first;
            for part in mine.chunk_by(|a, b| a >> (3 * level) == b >> (3 * level)) {
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
    for l in mine {
        (lo, hi) = (lo.min(l.position.into()), hi.max(l.position.into()));
        let radiosity = Rgb::from(l.albedo) * (Rgb::from(l.direct) + Rgb::from(l.indirect));
        power += f64::from(l.area) * radiosity.as_dvec3();
        area += f64::from(l.area);
        axis += f64::from(l.area) * Vec3::from(l.normal).as_dvec3();
    }
    let unit = axis.try_normalize().map(|a| a.as_vec3());
    let cosine = unit.map_or(-1.0, |a| mine.iter().fold(1.0f32, |m, l| m.min(a.dot(l.normal.into()))));
    node.lo = lo.to_array();
    node.hi = hi.to_array();
    node.power = power.as_vec3().to_array();
    node.area = area as f32;
    node.axis = unit.unwrap_or(Vec3::Z).to_array();
    node.cosine = cosine.max(-1.0);
}

#[cfg(test)]
mod tests;
