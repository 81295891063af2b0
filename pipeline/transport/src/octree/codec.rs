//! The tree as bytes: bincode around three little-endian arrays. Header, key and checksum are the store's.
//!
//! Bytes from a disk are not trusted: nothing is allocated before its length has been seen in the input, and a tree
//! whose ranges, numbers or order do not fit together is an error.

use bincode::config::{Configuration, Limit};
use bytemuck::Pod;
use glam::{IVec3, Vec3};

use super::{Leaf, Node, Octree};
use crate::{
    Rgb,
    surfel::{Grid, MAX_SIDE},
};

#[cfg(target_endian = "big")]
compile_error!("the octree's arrays are stored little-endian");

/// Largest tree that is read at all: every surfel that voxelization may make.
const MAX_BYTES: usize = 1 << 34;

type Config = Configuration<bincode::config::LittleEndian, bincode::config::Varint, Limit<MAX_BYTES>>;

fn config() -> Config {
    bincode::config::standard().with_limit::<MAX_BYTES>()
}

/// Origin, edge and size of the grid; nodes; leaves; emission.
type Stored<'a> = ([f32; 3], f32, [i32; 3], &'a [u8], &'a [u8], &'a [u8]);

/// Why bytes are no octree.
#[derive(Debug, thiserror::Error)]
pub enum OctreeError {
    #[error("{length} bytes are more than the limit of {limit}")]
    TooLarge { length: usize, limit: usize },
    #[error("not an octree: {0}")]
    Decode(#[from] bincode::error::DecodeError),
    #[error("the octree could not be written: {0}")]
    Encode(#[from] bincode::error::EncodeError),
    #[error("not an octree: {0}")]
    Invalid(&'static str),
}

impl Octree {
    /// # Errors
    /// When the tree is larger than what would be read again.
    pub fn to_bytes(&self) -> Result<Vec<u8>, OctreeError> {
        let Grid { origin, edge, size } = self.grid;
        let stored: Stored = (
            origin.to_array(),
            edge,
            size.to_array(),
            bytemuck::cast_slice(&self.nodes),
            bytemuck::cast_slice(&self.leaves),
            bytemuck::cast_slice(&self.emission),
        );
        Ok(bincode::encode_to_vec(stored, config())?)
    }

    /// Reads a tree of at most `limit` bytes.
    ///
    /// # Errors
    /// When the bytes are too many, cut off, followed by others, or do not make a tree.
    pub fn from_bytes(bytes: &[u8], limit: usize) -> Result<Self, OctreeError> {
        if bytes.len() > limit {
            return Err(OctreeError::TooLarge { length: bytes.len(), limit });
        }
        let (stored, used): (Stored, usize) = bincode::borrow_decode_from_slice(bytes, config())?;
        if used != bytes.len() {
            return Err(OctreeError::Invalid("there are bytes after its end"));
        }
        let (origin, edge, size, nodes, leaves, emission) = stored;
        let grid = Grid { origin: Vec3::from(origin), edge, size: IVec3::from(size) };
        let tree = Self { grid, nodes: array(nodes)?, leaves: array(leaves)?, emission: array(emission)? };
        tree.check().map_err(OctreeError::Invalid)?;
        Ok(tree)
    }

    fn check(&self) -> Result<(), &'static str> {
        let size = self.grid.size;
        // The shift of the grid adds a voxel to its longest side, rounding another one.
        let sound = self.grid.origin.is_finite() && self.grid.edge > 0.0 && self.grid.edge.is_finite();
        if !sound || size.min_element() < 0 || size.max_element() > MAX_SIDE as i32 + 2 {
            return Err("its grid makes no sense");
        }
        if !self.leaves.iter().all(|l| is_sound(l, size)) {
            return Err("a surfel is out of range");
        }
        self.check_emission()?;
        self.check_structure()
    }

    fn check_emission(&self) -> Result<(), &'static str> {
        let sorted = self.emission.is_sorted_by(|a, b| a.surfel < b.surfel);
        let known = self.emission.last().is_none_or(|e| (e.surfel as usize) < self.leaves.len());
        if sorted && known && self.emission.iter().all(|e| is_light(e.radiance)) {
            Ok(())
        } else {
            Err("its emission makes no sense")
        }
    }

    /// The root holds all leaves, and the children of a node hold its leaves in order.
    fn check_structure(&self) -> Result<(), &'static str> {
        let covered = self.nodes.first().map_or((0, 0), |root| (root.first, root.count as usize));
        if covered != (0, self.leaves.len()) {
            return Err("its root does not hold all surfels");
        }
        let mut next_child = 1u64;
        for node in &self.nodes {
            let end = u64::from(node.first) + u64::from(node.count);
            if node.count == 0 || end > self.leaves.len() as u64 || !is_sound_node(node) {
                return Err("a node is out of range");
            }
            if node.children == 0 {
                continue;
            }
            // Breadth-first order: the children of a node follow those of the node before.
            let children = u64::from(node.child)..u64::from(node.child) + u64::from(node.children);
            if children.start != next_child || children.end > self.nodes.len() as u64 || node.children > 8 {
                return Err("a node's children are out of order");
            }
            next_child = children.end;
            let mut first = u64::from(node.first);
            for child in &self.nodes[children.start as usize..children.end as usize] {
                if u64::from(child.first) != first {
                    return Err("a node's children do not hold its surfels");
                }
                first += u64::from(child.count);
            }
            if first != end {
                return Err("a node's children do not hold its surfels");
            }
        }
        let reached = self.nodes.is_empty() || next_child == self.nodes.len() as u64;
        if reached { Ok(()) } else { Err("a node belongs to nobody") }
    }
}

fn array<T: Pod>(bytes: &[u8]) -> Result<Vec<T>, OctreeError> {
    if !bytes.len().is_multiple_of(size_of::<T>()) {
        return Err(OctreeError::Invalid("an array is cut off"));
    }
    Ok(bytemuck::pod_collect_to_vec(bytes))
}

fn is_sound(l: &Leaf, size: IVec3) -> bool {
    l.surfel.is_sound(size) && is_light(l.direct) && is_light(l.indirect)
}

fn is_light(light: Rgb) -> bool {
    light.is_finite() && light.min_element() >= 0.0
}

fn is_sound_node(n: &Node) -> bool {
    let numbers = [n.lo, n.hi, n.power, n.axis];
    numbers.iter().flatten().chain([&n.area, &n.cosine]).all(|v| v.is_finite())
        && n.power.iter().all(|p| *p >= 0.0)
        && n.area >= 0.0
}
