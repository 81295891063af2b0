use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::{
    geometry::Geometry,
    sweep::tests::{room_with_block, tilted, voxelized},
};

/// A tree with a smooth irradiance field.
fn tree(n: u32) -> (Surfels, Solution, Octree) {
    let scene = tilted(room_with_block(Vec3::new(0.7, 0.5, 0.3)));
    let geometry = Geometry::new(&scene);
    let mut surfels = voxelized(&geometry, n);
    let glow = |surfel| Emission { surfel, radiance: Rgb::new(1.0, 2.0, 3.0) };
    surfels.emission = vec![glow(1), glow(surfels.list.len() as u32 - 1)];
    let field = |p: Vec3| Rgb::splat(2.0) + p / 3000.0;
    let direct = surfels.list.iter().map(|s| field(s.centroid)).collect();
    let indirect = surfels.list.iter().map(|s| 0.5 * field(-s.centroid)).collect();
    let solution = Solution { direct, indirect };
    let tree = Octree::new(&surfels, &solution);
    (surfels, solution, tree)
}

#[test]
fn the_tree_gives_back_what_it_was_made_from() {
    let (surfels, solution, tree) = tree(24);
    let (list, light) = tree.unpack();
    assert_eq!((&list.list, &list.emission), (&surfels.list, &surfels.emission));
    assert!(!list.emission.is_empty());
    assert_eq!(list.grid, surfels.grid);
    assert_eq!(light, solution);
}

#[test]
fn nodes_aggregate_their_leaves() {
    let (surfels, _, tree) = tree(24);
    let root = &tree.nodes()[0];
    assert!((f64::from(root.area) / surfels.area() - 1.0).abs() < 1e-5);
    for node in tree.nodes() {
        let children = &tree.nodes()[node.child as usize..(node.child + node.children) as usize];
        if !children.is_empty() {
            let area: f32 = children.iter().map(|c| c.area).sum();
            let power: Rgb = children.iter().map(|c| Rgb::from(c.power)).sum();
            assert!((area / node.area - 1.0).abs() < 1e-4);
            assert!((power / Rgb::from(node.power) - 1.0).abs().max_element() < 1e-4);
        }
        for l in &tree.leaves()[node.first as usize..(node.first + node.count) as usize] {
            let p = l.surfel.centroid;
            assert!(p.cmpge(node.lo.into()).all() && p.cmple(node.hi.into()).all());
            assert!(l.surfel.normal.dot(node.axis.into()) >= node.cosine - 1e-6);
        }
    }
    let groups = tree.nodes().iter().filter(|n| n.children == 0);
    let largest = groups.map(|n| n.count).max().unwrap();
    assert!(largest <= LEAF_SIZE.max(crate::surfel::MAX_PER_VOXEL as u32));
}

#[test]
fn bytes_round_trip() {
    let (_, _, tree) = tree(16);
    let bytes = tree.to_bytes().unwrap();
    let again = Octree::from_bytes(&bytes, bytes.len()).unwrap();
    assert_eq!(again, tree);
    assert_eq!(again.to_bytes().unwrap(), bytes);
    assert!(matches!(Octree::from_bytes(&bytes, bytes.len() - 1), Err(OctreeError::TooLarge { .. })));
    let surfels = Surfels::dark(*tree.grid(), Vec::new());
    let empty = Octree::new(&surfels, &Solution::default());
    let bytes = empty.to_bytes().unwrap();
    assert_eq!(Octree::from_bytes(&bytes, 1000).unwrap(), empty);
}

#[test]
fn every_cut_is_refused() {
    let (_, _, tree) = tree(4);
    let bytes = tree.to_bytes().unwrap();
    for n in 0..bytes.len() {
        assert!(Octree::from_bytes(&bytes[..n], usize::MAX).is_err(), "{n}");
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(Octree::from_bytes(&longer, usize::MAX).is_err());
}

#[test]
fn a_promise_of_endless_data_allocates_nothing() {
    // A grid of four floats and three small integers, then a length of 2⁶² bytes.
    let mut bytes = vec![0; 19];
    bytes.push(253);
    bytes.extend((1u64 << 62).to_le_bytes());
    assert!(matches!(Octree::from_bytes(&bytes, usize::MAX), Err(OctreeError::Decode(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_bytes_never_panic(at in 0usize..1 << 20, value: u8) {
        let (_, _, tree) = small();
        let mut bytes = tree.to_bytes().unwrap();
        let at = at % bytes.len();
        bytes[at] = value;
        if let Ok(tree) = Octree::from_bytes(&bytes, usize::MAX) {
            tree.unpack();
        }
    }

    #[test]
    fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = Octree::from_bytes(&bytes, usize::MAX);
    }
}

fn small() -> (Surfels, Solution, Octree) {
    tree(3)
}
