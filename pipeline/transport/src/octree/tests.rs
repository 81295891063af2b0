use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::{
    geometry::Geometry,
    surfel::Emission,
    sweep::tests::{room_with_block, tilted, voxelized},
};

/// Surfels with a smooth irradiance field.
fn lit(n: u32) -> (Surfels, Solution) {
    let scene = tilted(room_with_block(Vec3::new(0.7, 0.5, 0.3)));
    let geometry = Geometry::new(&scene);
    let mut surfels = voxelized(&geometry, n);
    let glow = |surfel| Emission { surfel, radiance: Rgb::new(1.0, 2.0, 3.0) };
    surfels.emission = vec![glow(1), glow(surfels.list.len() as u32 - 1)];
    let field = |p: Vec3| Rgb::splat(2.0) + p / 3000.0;
    let direct = surfels.list.iter().map(|s| field(s.centroid)).collect();
    let indirect = surfels.list.iter().map(|s| 0.5 * field(-s.centroid)).collect();
    (surfels, Solution { direct, indirect })
}

fn bytes(surfels: &Surfels, solution: &Solution) -> Vec<u8> {
    let mut bytes = Vec::new();
    Octree::new(surfels, solution).write(&mut bytes).unwrap();
    bytes
}

fn read_all(bytes: &[u8]) -> Result<(Surfels, Solution), OctreeError> {
    read(&mut &bytes[..], bytes.len() as u64)
}

#[test]
fn a_stored_tree_gives_back_what_it_was_made_from() {
    for n in [3, 24] {
        let (surfels, solution) = lit(n);
        let written = bytes(&surfels, &solution);
        let (list, light) = read_all(&written).unwrap();
        assert_eq!((&list.list, &list.emission), (&surfels.list, &surfels.emission));
        assert!(!list.emission.is_empty());
        assert_eq!(list.grid, surfels.grid);
        assert_eq!(light, solution);
        assert_eq!(bytes(&list, &light), written);
    }
    let nothing = Surfels::dark(lit(3).0.grid, Vec::new());
    let (list, light) = read_all(&bytes(&nothing, &Solution::default())).unwrap();
    assert!(list.list.is_empty() && list.emission.is_empty() && light == Solution::default());
}

#[test]
fn any_order_is_undone_by_its_swaps() {
    for n in 0..7u64 {
        // All permutations, counted by their Lehmer codes.
        for code in 0..(1..=n).product::<u64>() {
            let (mut rest, mut digits) = ((0..n as u32).collect::<Vec<_>>(), code);
            let order: Vec<u32> = (1..=n)
                .rev()
                .map(|base| {
                    let at = digits % base;
                    digits /= base;
                    rest.remove(at as usize)
                })
                .collect();
            let mut things: Vec<u32> = (0..n as u32).map(|i| 100 + i).collect();
            codec::permute(order.clone(), |a, b| things.swap(a, b));
            assert_eq!(things, order.iter().map(|i| 100 + i).collect::<Vec<_>>());
        }
    }
}

#[test]
fn nodes_aggregate_their_leaves() {
    let (surfels, solution) = lit(24);
    let tree = Octree::new(&surfels, &solution);
    let (nodes, leaves): (Vec<Node>, Vec<Leaf>) = (tree.nodes().collect(), tree.leaves().collect());
    let root = &nodes[0];
    assert!((f64::from(root.area) / surfels.area() - 1.0).abs() < 1e-5);
    for node in &nodes {
        let children = &nodes[node.child as usize..(node.child + node.children) as usize];
        if !children.is_empty() {
            let area: f32 = children.iter().map(|c| c.area).sum();
            let power: Rgb = children.iter().map(|c| Rgb::from(c.power)).sum();
            assert!((area / node.area - 1.0).abs() < 1e-4);
            assert!((power / Rgb::from(node.power) - 1.0).abs().max_element() < 1e-4);
        }
        for l in &leaves[node.first as usize..(node.first + node.count) as usize] {
            let p = l.surfel.centroid;
            assert!(p.cmpge(node.lo.into()).all() && p.cmple(node.hi.into()).all());
            assert!(l.surfel.normal.dot(node.axis.into()) >= node.cosine - 1e-6);
        }
    }
    let groups = nodes.iter().filter(|n| n.children == 0);
    let largest = groups.map(|n| n.count).max().unwrap();
    assert!(largest <= LEAF_SIZE.max(crate::surfel::MAX_PER_VOXEL as u32));
}

#[test]
fn every_cut_is_refused() {
    let (surfels, solution) = lit(4);
    let bytes = bytes(&surfels, &solution);
    for n in 0..bytes.len() {
        assert!(read_all(&bytes[..n]).is_err(), "{n}");
        // Where the input ends before the stated length, too.
        if n % 97 == 0 {
            assert!(read(&mut &bytes[..n], bytes.len() as u64).is_err(), "{n}");
        }
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(read_all(&longer).is_err());
    // What lies behind a tree is left alone.
    let mut rest = &longer[..];
    assert!(read(&mut rest, longer.len() as u64 - 1).is_ok());
    assert_eq!(rest, [0]);
}

#[test]
fn a_promise_of_endless_data_allocates_nothing() {
    // A grid of three zeros, an edge of 1 and three small integers, then a length of 2⁶² bytes.
    let mut bytes = vec![0; 12];
    bytes.extend(1f32.to_le_bytes());
    bytes.extend([0; 3]);
    bytes.push(253);
    bytes.extend((1u64 << 62).to_le_bytes());
    assert!(matches!(read_all(&bytes), Err(OctreeError::Invalid("an array is cut off"))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_bytes_never_panic(at in 0usize..1 << 20, value: u8) {
        let (surfels, solution) = lit(3);
        let mut bytes = bytes(&surfels, &solution);
        let at = at % bytes.len();
        bytes[at] = value;
        if let Ok((surfels, solution)) = read_all(&bytes) {
            prop_assert_eq!(surfels.list.len(), solution.direct.len());
            prop_assert_eq!(surfels.list.len(), solution.indirect.len());
        }
    }

    #[test]
    fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_all(&bytes);
    }
}
