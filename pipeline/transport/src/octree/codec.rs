//! The tree as bytes: bincode around three little-endian arrays. Header, key and checksum are the store's.
//!
//! Writing and reading go through the arrays block by block. Bytes from a disk are not trusted: nothing is allocated for
//! more than the input is long, and a tree whose ranges, numbers or order do not fit together is an error.

use std::io::{self, Read, Take, Write};

use bincode::{
    Decode,
    config::{Configuration, Limit},
    error::{DecodeError, EncodeError},
};
use bytemuck::Pod;
use glam::{IVec3, Vec3};

use super::{Leaf, Node, Octree, Span};
use crate::{
    Rgb,
    surfel::{Emission, Grid, MAX_SIDE, Solution, Surfels},
};

#[cfg(target_endian = "big")]
compile_error!("the octree's arrays are stored little-endian");

/// Most bytes of one number, and of the description of the grid.
const MAX_HEAD: usize = 64;

/// Bytes of an array that are in hand at a time.
const BLOCK: usize = 1 << 16;

fn config() -> Configuration<bincode::config::LittleEndian, bincode::config::Varint, Limit<MAX_HEAD>> {
    bincode::config::standard().with_limit::<MAX_HEAD>()
}

/// Origin, edge and size of the grid. Nodes, leaves and emission follow, each behind its length in bytes.
type Head = ([f32; 3], f32, [i32; 3]);

/// Why bytes are no octree.
#[derive(Debug, thiserror::Error)]
pub enum OctreeError {
    #[error("the octree cannot be read: {0}")]
    Read(#[from] io::Error),
    #[error("not an octree: {0}")]
    Decode(#[from] DecodeError),
    #[error("not an octree: {0}")]
    Invalid(&'static str),
}

impl Octree<'_> {
    /// Writes the tree.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let Grid { origin, edge, size } = *self.grid();
        let head: Head = (origin.to_array(), edge, size.to_array());
        bincode::encode_into_std_write(head, out, config()).map_err(unwritten)?;
        put_array(out, self.nodes())?;
        put_array(out, self.leaves())?;
        put_array(out, self.surfels.emission.iter().copied())
    }
}

fn unwritten(error: EncodeError) -> io::Error {
    match error {
        EncodeError::Io { inner, .. } => inner,
        error => io::Error::other(error),
    }
}

fn put_array<T: Pod>(out: &mut impl Write, items: impl ExactSizeIterator<Item = T>) -> io::Result<()> {
    let bytes = items.len() as u64 * size_of::<T>() as u64;
    bincode::encode_into_std_write(bytes, out, config()).map_err(unwritten)?;
    let mut block = Vec::with_capacity(BLOCK);
    for item in items {
        block.extend_from_slice(bytemuck::bytes_of(&item));
        if block.len() + size_of::<T>() > BLOCK {
            out.write_all(&block)?;
            block.clear();
        }
    }
    out.write_all(&block)
}

/// Reads a tree of exactly `length` bytes: the surfels and the solution that it was made from.
///
/// # Errors
/// When the bytes are cut off, go on after the tree's end, or do not make a tree.
pub fn read(input: &mut impl Read, length: u64) -> Result<(Surfels, Solution), OctreeError> {
    let mut input = input.take(length);
    let (origin, edge, size): Head = number(&mut input)?;
    let grid = Grid { origin: Vec3::from(origin), edge, size: IVec3::from(size) };
    check_grid(&grid)?;
    let count = length_of::<Node>(&mut input)?;
    let mut nodes = Vec::with_capacity(count);
    each(&mut input, count, |node: &Node| {
        nodes.push(Span { first: node.first, count: node.count, child: node.child, children: node.children });
        if is_sound_node(node) { Ok(()) } else { Err("a node is out of range") }
    })?;
    let (surfels, solution) = leaves(&mut input, grid, &nodes)?;
    Ok((with_emission(&mut input, surfels)?, solution))
}

/// The leaves, brought back into the order of the list.
fn leaves(input: &mut Take<impl Read>, grid: Grid, nodes: &[Span]) -> Result<(Surfels, Solution), OctreeError> {
    let count = length_of::<Leaf>(input)?;
    let mut list = Vec::with_capacity(count);
    let (mut direct, mut indirect) = (Vec::with_capacity(count), Vec::with_capacity(count));
    each(input, count, |leaf: &Leaf| {
        list.push(leaf.surfel);
        direct.push(leaf.direct);
        indirect.push(leaf.indirect);
        if is_sound(leaf, grid.size) { Ok(()) } else { Err("a surfel is out of range") }
    })?;
    check_structure(nodes, list.len()).map_err(OctreeError::Invalid)?;
    let mut order: Vec<u32> = (0..list.len() as u32).collect();
    // Within a voxel the tree keeps the order of the list.
    order.sort_unstable_by_key(|i| (list[*i as usize].voxel().to_array(), *i));
    permute(order, |a, b| {
        list.swap(a, b);
        direct.swap(a, b);
        indirect.swap(a, b);
    });
    Ok((Surfels::dark(grid, list), Solution { direct, indirect }))
}

fn with_emission(input: &mut Take<impl Read>, mut surfels: Surfels) -> Result<Surfels, OctreeError> {
    let known = surfels.list.len();
    let count = length_of::<Emission>(input)?;
    let mut emission: Vec<Emission> = Vec::with_capacity(count);
    each(input, count, |e: &Emission| {
        let sorted = emission.last().is_none_or(|last| last.surfel < e.surfel);
        emission.push(*e);
        let sound = sorted && (e.surfel as usize) < known && is_light(e.radiance);
        if sound { Ok(()) } else { Err("its emission makes no sense") }
    })?;
    if input.limit() > 0 {
        return Err(OctreeError::Invalid("there are bytes after its end"));
    }
    surfels.emission = emission;
    Ok(surfels)
}

fn number<T: Decode<()>>(input: &mut Take<impl Read>) -> Result<T, OctreeError> {
    Ok(bincode::decode_from_std_read(input, config())?)
}

/// The number of items in the array that follows, which the rest of the input can hold.
fn length_of<T: Pod>(input: &mut Take<impl Read>) -> Result<usize, OctreeError> {
    let bytes: u64 = number(input)?;
    if bytes > input.limit() || !bytes.is_multiple_of(size_of::<T>() as u64) {
        return Err(OctreeError::Invalid("an array is cut off"));
    }
    usize::try_from(bytes / size_of::<T>() as u64).map_err(|_| OctreeError::Invalid("an array is too long"))
}

/// Shows every item of an array.
fn each<T: Pod>(
    input: &mut impl Read,
    count: usize,
    mut item: impl FnMut(&T) -> Result<(), &'static str>,
) -> Result<(), OctreeError> {
    let mut left = count;
    let mut block = vec![T::zeroed(); left.min(BLOCK / size_of::<T>())];
    while left > 0 {
        let length = left.min(block.len());
        let now = &mut block[..length];
        input.read_exact(bytemuck::cast_slice_mut(now))?;
        now.iter().try_for_each(&mut item).map_err(OctreeError::Invalid)?;
        left -= length;
    }
    Ok(())
}

/// Puts what stands at `order[i]` at i, for every i, by swaps along the cycles of a permutation.
pub(super) fn permute(mut order: Vec<u32>, mut swap: impl FnMut(usize, usize)) {
    for start in 0..order.len() {
        let mut at = start;
        loop {
            // A place that is done names itself.
            let from = std::mem::replace(&mut order[at], at as u32) as usize;
            if from == start {
                break;
            }
            swap(at, from);
            at = from;
        }
    }
}

fn check_grid(grid: &Grid) -> Result<(), OctreeError> {
    // The shift of the grid adds a voxel to its longest side, rounding another one.
    let sound = grid.origin.is_finite() && grid.edge > 0.0 && grid.edge.is_finite();
    if !sound || grid.size.min_element() < 0 || grid.size.max_element() > MAX_SIDE as i32 + 2 {
        return Err(OctreeError::Invalid("its grid makes no sense"));
    }
    Ok(())
}

/// The root holds all leaves, and the children of a node hold its leaves in order.
fn check_structure(nodes: &[Span], leaves: usize) -> Result<(), &'static str> {
    let covered = nodes.first().map_or((0, 0), |root| (root.first, root.count as usize));
    if covered != (0, leaves) {
        return Err("its root does not hold all surfels");
    }
    let mut next_child = 1u64;
    for node in nodes {
        let end = u64::from(node.first) + u64::from(node.count);
        if node.count == 0 || end > leaves as u64 {
            return Err("a node is out of range");
        }
        if node.children == 0 {
            continue;
        }
        // Breadth-first order: the children of a node follow those of the node before.
        let children = u64::from(node.child)..u64::from(node.child) + u64::from(node.children);
        if children.start != next_child || children.end > nodes.len() as u64 || node.children > 8 {
            return Err("a node's children are out of order");
        }
        next_child = children.end;
        let mut first = u64::from(node.first);
        for child in &nodes[children.start as usize..children.end as usize] {
            if u64::from(child.first) != first {
                return Err("a node's children do not hold its surfels");
            }
            first += u64::from(child.count);
        }
        if first != end {
            return Err("a node's children do not hold its surfels");
        }
    }
    let reached = nodes.is_empty() || next_child == nodes.len() as u64;
    if reached { Ok(()) } else { Err("a node belongs to nobody") }
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
