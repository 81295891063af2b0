//! The hierarchy of boxes that rays traverse: obvhs's compressed eight-wide one, made from a binary tree of ours.
//!
//! The tree is split from the top by the surface area heuristic over [`BINS`] bins per axis (Wald 2007, "On fast
//! construction of SAH-based bounding volume hierarchies"): the split that minimises A_left·n_left + A_right·n_right.
//! It takes O(n log n) for any input, where clustering from the bottom takes O(n²) for geometry nested around one
//! point; and rays among four balls of 60 000 triangles in a room meet 6 % fewer nodes and triangles than in the tree
//! that clustering makes. The traversal has a stack of 32 entries, one a level, and loses nodes without a word when a tree is deeper;
//! below [`MAX_BINARY_DEPTH`] the splits are medians, and if the eight-wide tree is too deep even so, all of them are.
//!
//! A subtree of n leaves has 2n − 1 nodes, so every subtree knows its place in the list of nodes beforehand: threads
//! fill disjoint parts and the tree does not depend on their number.

use glam::Vec3A;
use luxel_scene::{Cancelled, Progress};
use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node},
    cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh},
};

use crate::aside::aside;

/// Levels that the traversal's stack has room for.
const MAX_DEPTH: usize = 31;

/// Levels of the binary tree that may be out of balance. A node of the eight-wide tree takes about three of them.
const MAX_BINARY_DEPTH: usize = 56;

const BINS: usize = 16;

/// Subtrees of at least so many boxes are worth a task of their own.
const TASK: usize = 4096;
/// Subtrees of at least so many boxes look at the progress.
const LOOK: usize = 512;
/// Nodes whose conversion takes longer than a look can wait: nothing interrupts obvhs, and it takes 0.15 to 0.3 µs a
/// triangle, for which there are two nodes.
const LONG: usize = 1 << 18;

/// A hierarchy over boxes that is never too deep to traverse.
pub(super) fn build(boxes: &[Aabb], progress: &dyn Progress) -> Result<CwBvh, Cancelled> {
    if boxes.is_empty() {
        return Ok(CwBvh::default());
    }
    let bvh = converted(tree(boxes, MAX_BINARY_DEPTH, progress)?, LONG, progress)?;
    if depth(&bvh) <= MAX_DEPTH {
        return Ok(bvh);
    }
    converted(tree(boxes, 0, progress)?, LONG, progress)
}

/// The eight-wide tree of a binary one; aside, where that has `long` nodes at least.
fn converted(bvh: Bvh2, long: usize, progress: &dyn Progress) -> Result<CwBvh, Cancelled> {
    aside(bvh.nodes.len() >= long, progress, move || convert(&bvh))
}

fn convert(bvh: &Bvh2) -> CwBvh {
    bvh2_to_cwbvh(bvh, 3, true, false)
}

/// Levels of a hierarchy.
fn depth(bvh: &CwBvh) -> usize {
    let (mut deepest, mut open) = (0, vec![(0, 1)]);
    while let Some((at, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[at as usize];
        open.extend((0..8).filter(|&c| !node.is_leaf(c)).map(|c| (node.child_node_index(c), level + 1)));
    }
    deepest
}

/// A binary tree with one box a leaf, the upper `free` levels by the heuristic, the rest by medians.
fn tree(boxes: &[Aabb], free: usize, progress: &dyn Progress) -> Result<Bvh2, Cancelled> {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = vec![Bvh2Node::default(); 2 * boxes.len() - 1];
    let (root, below) = nodes.split_at_mut(1);
    root[0] = Subtree { boxes, order: &mut order, first: 0, nodes: below, base: 1, free, progress }.build()?;
    progress.check()?;
    Ok(Bvh2 { nodes, primitive_indices: order, children_are_ordered_after_parents: true, ..Bvh2::default() })
}

/// A part of the tree on its way.
struct Subtree<'a> {
    boxes: &'a [Aabb],
    /// Its boxes, and where they begin in the whole order.
    order: &'a mut [u32],
    first: usize,
    /// Room for its nodes without the root, and where it begins in the whole list.
    nodes: &'a mut [Bvh2Node],
    base: usize,
    /// Levels that may still be out of balance.
    free: usize,
    progress: &'a dyn Progress,
}

impl Subtree<'_> {
    /// Fills the nodes below the root and returns the root.
    fn build(self) -> Result<Bvh2Node, Cancelled> {
        let Self { boxes, order, first, nodes, base, free, progress } = self;
        // The passes over many boxes take a while each.
        let is_long = order.len() >= LOOK;
        let look = || if is_long { progress.check() } else { Ok(()) };
        look()?;
        let (whole, centers) = bounds(boxes, order);
        if order.len() == 1 {
            return Ok(Bvh2Node::new(whole, 1, first as u32));
        }
        look()?;
        let balanced = order.len().next_power_of_two().trailing_zeros() as usize;
        let cut = if free > balanced { best_split(boxes, order, &centers) } else { None };
        look()?;
        let middle = cut.map_or(0, |cut| partition(order, |&i| cut.is_left(&boxes[i as usize])));
        // Rounding may leave a side empty; then the median decides, as it does where all centres coincide.
        let middle = if middle == 0 || middle == order.len() { by_median(boxes, order, &centers) } else { middle };
        let (left, right) = order.split_at_mut(middle);
        let (children, below) = nodes.split_at_mut(2);
        let (below_left, below_right) = below.split_at_mut(2 * left.len() - 2);
        let (base_left, base_right) = (base + 2, base + 2 * left.len());
        let (first_right, free) = (first + middle, free.saturating_sub(1));
        let is_large = left.len().min(right.len()) >= TASK;
        let left = Subtree { boxes, order: left, first, nodes: below_left, base: base_left, free, progress };
        let right =
            Subtree { boxes, order: right, first: first_right, nodes: below_right, base: base_right, free, progress };
        let (left, right) =
            if is_large { rayon::join(|| left.build(), || right.build()) } else { (left.build(), right.build()) };
        children.copy_from_slice(&[left?, right?]);
        Ok(Bvh2Node::new(whole, 0, base as u32))
    }
}

/// The box of some boxes, and that of their centres.
fn bounds(boxes: &[Aabb], order: &[u32]) -> (Aabb, Aabb) {
    let (mut whole, mut centers) = (Aabb::empty(), Aabb::empty());
    for b in order.iter().map(|&i| &boxes[i as usize]) {
        whole = whole.union(b);
        centers.extend(b.center());
    }
    (whole, centers)
}

/// A plane between bins.
struct Cut {
    bins: Bins,
    axis: usize,
    /// The first bin on the right.
    bin: usize,
}

impl Cut {
    fn is_left(&self, b: &Aabb) -> bool {
        self.bins.of(b)[self.axis] < self.bin
    }
}

/// How centres fall into bins.
struct Bins {
    origin: Vec3A,
    scale: Vec3A,
}

impl Bins {
    fn new(centers: &Aabb) -> Self {
        let size = (centers.max - centers.min).max(Vec3A::splat(f32::MIN_POSITIVE));
        Self { origin: centers.min, scale: BINS as f32 / size }
    }

    fn of(&self, b: &Aabb) -> [usize; 3] {
        let at = (b.center() - self.origin) * self.scale;
        at.to_array().map(|x| (x as usize).min(BINS - 1))
    }
}

/// The cheapest plane by the heuristic; None where no plane separates anything.
fn best_split(boxes: &[Aabb], order: &[u32], centers: &Aabb) -> Option<Cut> {
    let bins = Bins::new(centers);
    let mut filled = [[(Aabb::empty(), 0u32); BINS]; 3];
    for b in order.iter().map(|&i| &boxes[i as usize]) {
        for (axis, bin) in bins.of(b).into_iter().enumerate() {
            let (whole, count) = &mut filled[axis][bin];
            *whole = whole.union(b);
            *count += 1;
        }
    }
    let mut best = (f32::INFINITY, 0, 0);
    for (axis, filled) in filled.iter().enumerate() {
        let mut right = [0.0; BINS];
        let (mut whole, mut count) = (Aabb::empty(), 0);
        for bin in (1..BINS).rev() {
            whole = whole.union(&filled[bin].0);
            count += filled[bin].1;
            right[bin] = if count == 0 { f32::INFINITY } else { whole.half_area() * count as f32 };
        }
        let (mut whole, mut count) = (Aabb::empty(), 0);
        for bin in 1..BINS {
            whole = whole.union(&filled[bin - 1].0);
            count += filled[bin - 1].1;
            let left = if count == 0 { f32::INFINITY } else { whole.half_area() * count as f32 };
            if left + right[bin] < best.0 {
                best = (left + right[bin], axis, bin);
            }
        }
    }
    (best.0 < f32::INFINITY).then_some(Cut { bins, axis: best.1, bin: best.2 })
}

/// Halves the boxes along the axis on which their centres spread most.
fn by_median(boxes: &[Aabb], order: &mut [u32], centers: &Aabb) -> usize {
    let spread = centers.max - centers.min;
    let axis = (0..3).fold(0, |best, axis| if spread[axis] > spread[best] { axis } else { best });
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        let along = |i: u32| boxes[i as usize].center()[axis];
        along(a).total_cmp(&along(b)).then(a.cmp(&b))
    });
    middle
}

/// Moves those that satisfy `is_left` to the front and returns how many they are.
fn partition(order: &mut [u32], is_left: impl Fn(&u32) -> bool) -> usize {
    let mut left = 0;
    for i in 0..order.len() {
        if is_left(&order[i]) {
            order.swap(left, i);
            left += 1;
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling;
    use luxel_scene::{Silent, Unwanted};

    fn onion(layers: u32, growth: f32) -> Vec<Aabb> {
        (0..layers).map(|i| Vec3A::splat(4096.0 / libm::powf(growth, i as f32))).map(|r| Aabb::new(-r, r)).collect()
    }

    fn is_whole(bvh: &CwBvh, count: u32) -> bool {
        let mut held = bvh.primitive_indices.clone();
        held.sort_unstable();
        held.into_iter().eq(0..count)
    }

    #[test]
    fn nested_and_coincident_boxes_make_no_deep_tree() {
        let same = vec![Aabb::new(Vec3A::ZERO, Vec3A::ONE); 50_000];
        // One half of the rest is beyond the first cut at every level.
        let halves = (0..120).map(|i| Vec3A::splat(libm::exp2f(-(i as f32)))).map(|p| Aabb::new(p, p)).collect();
        for boxes in [onion(50_000, 1.0002), onion(100, 2.0), same, halves] {
            let bvh = build(&boxes, &Silent).unwrap();
            assert!(depth(&bvh) <= MAX_DEPTH, "{} boxes: {}", boxes.len(), depth(&bvh));
            assert!(is_whole(&bvh, boxes.len() as u32));
        }
    }

    #[test]
    fn medians_alone_make_a_whole_and_balanced_tree() {
        let boxes = onion(5000, 1.002);
        let bvh = convert(&tree(&boxes, 0, &Silent).unwrap());
        assert!(depth(&bvh) <= 13 && is_whole(&bvh, 5000));
    }

    #[test]
    fn a_conversion_is_the_same_wherever_it_runs_and_can_be_left() {
        let tree = || tree(&onion(3000, 1.002), MAX_BINARY_DEPTH, &Silent).unwrap();
        let here = converted(tree(), usize::MAX, &Silent).unwrap();
        assert!(converted(tree(), 0, &Silent).unwrap() == here);
        assert!(converted(tree(), 0, &Unwanted).is_err() && converted(tree(), usize::MAX, &Unwanted).is_err());
    }

    #[test]
    fn the_tree_is_the_same_on_one_thread_and_on_two() {
        let boxes: Vec<Aabb> = (0..40_000u64)
            .map(|i| Vec3A::from(sampling::sphere(sampling::unit2(sampling::mix(i)))))
            .map(|p| Aabb::new(p, p + 0.01))
            .collect();
        let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let on = |threads| on(threads).install(|| build(&boxes, &Silent)).unwrap();
        assert!(on(1) == on(2));
    }
}
