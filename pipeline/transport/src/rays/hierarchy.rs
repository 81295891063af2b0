//! The hierarchy of boxes that rays traverse: obvhs's compressed eight-wide one, built by clustering (PLOC).
//!
//! Its traversal has a stack of 32 entries, one a level, and loses nodes without a word when a tree is deeper. Greedy
//! clustering makes such trees of geometry that is nested around one point (an onion of 3000 squares: 429 levels), so
//! the depth is checked and a tree that is too deep is replaced by one of median splits, at most ⌈log₂ n⌉ levels deep.

use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node, reinsertion::ReinsertionOptimizer},
    cwbvh::{CwBvh, bvh2_to_cwbvh::bvh2_to_cwbvh},
    ploc::PlocBuilder,
};

/// Levels that the traversal's stack has room for.
const MAX_DEPTH: usize = 31;

/// Binary levels above which a tree is not even converted: the converter recurses.
const MAX_BINARY_DEPTH: usize = 1000;

/// A hierarchy over boxes that is never too deep to traverse.
pub(super) fn build(boxes: &[Aabb]) -> CwBvh {
    if boxes.is_empty() {
        return CwBvh::default();
    }
    greedy(boxes).filter(|bvh| depth(bvh) <= MAX_DEPTH).unwrap_or_else(|| convert(&by_medians(boxes)))
}

/// Clustering, improved by reinsertion; None where it makes a chain.
fn greedy(boxes: &[Aabb]) -> Option<CwBvh> {
    let settings = BvhBuildParams::medium_build();
    let order = (0..boxes.len() as u32).collect();
    let mut bvh = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        boxes,
        order,
        settings.sort_precision,
        settings.search_depth_threshold,
    );
    ReinsertionOptimizer::default().run(&mut bvh, settings.reinsertion_batch_ratio, None);
    (binary_depth(&bvh) <= MAX_BINARY_DEPTH).then(|| convert(&bvh))
}

fn convert(bvh: &Bvh2) -> CwBvh {
    bvh2_to_cwbvh(bvh, 3, true, false)
}

/// Levels of a binary tree.
fn binary_depth(bvh: &Bvh2) -> usize {
    let (mut deepest, mut open) = (0, vec![(0, 1)]);
    while let Some((at, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[at as usize];
        if !node.is_leaf() {
            open.extend([(node.first_index, level + 1), (node.first_index + 1, level + 1)]);
        }
    }
    deepest
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

/// A binary tree that halves the number of boxes at every level, along the axis on which their centres spread most.
fn by_medians(boxes: &[Aabb]) -> Bvh2 {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = vec![Bvh2Node::default()];
    let mut open = vec![(0, 0, boxes.len())];
    while let Some((node, from, to)) = open.pop() {
        let mut whole = Aabb::empty();
        let mut centers = Aabb::empty();
        for &i in &order[from..to] {
            whole = whole.union(&boxes[i as usize]);
            centers.extend(boxes[i as usize].center());
        }
        if to - from == 1 {
            nodes[node] = Bvh2Node::new(whole, 1, from as u32);
            continue;
        }
        let spread = centers.max - centers.min;
        let axis = (0..3).fold(0, |best, axis| if spread[axis] > spread[best] { axis } else { best });
        let middle = (to - from) / 2;
        order[from..to].select_nth_unstable_by(middle, |&a, &b| {
            let along = |i: u32| boxes[i as usize].center()[axis];
            along(a).total_cmp(&along(b)).then(a.cmp(&b))
        });
        let first = nodes.len();
        nodes[node] = Bvh2Node::new(whole, 0, first as u32);
        nodes.extend([Bvh2Node::default(); 2]);
        open.extend([(first, from, from + middle), (first + 1, from + middle, to)]);
    }
    Bvh2 { nodes, primitive_indices: order, children_are_ordered_after_parents: true, ..Bvh2::default() }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;

    fn onion(layers: usize) -> Vec<Aabb> {
        (0..layers).map(|i| Vec3A::splat(libm::powf(1.002, i as f32))).map(|r| Aabb::new(-r, r)).collect()
    }

    #[test]
    fn an_onion_is_not_too_deep() {
        let boxes = onion(6000);
        let greedy = greedy(&boxes).as_ref().map_or(usize::MAX, depth);
        assert!(greedy > MAX_DEPTH, "the test has lost its point: {greedy} levels");
        let bvh = build(&boxes);
        assert!(depth(&bvh) <= MAX_DEPTH);
        let mut held = bvh.primitive_indices.clone();
        held.sort_unstable();
        assert!(held.into_iter().eq(0..6000), "every box is in the hierarchy once");
    }
}
