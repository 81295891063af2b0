//! Tiles: neighbouring receivers that share their shafts, as a binary tree over a run of receivers.

use glam::Vec3;

use super::shaft::Bounds;
use crate::{gather::Receiver, rays::OFFSET};

/// Receivers of a leaf, at most.
const LEAF: usize = 32;

/// A node: receivers `first..first + count` of [`Tiles::order`].
#[derive(Clone, Debug)]
pub struct Tile {
    /// Of the points from which the receivers look.
    pub bounds: Bounds,
    pub first: usize,
    pub count: usize,
    /// The common normal and the least n·x of the points, where all face the same way.
    pub plane: Option<(Vec3, f32)>,
    /// The second child; the first one follows its parent.
    pub second: Option<usize>,
}

/// The tree; node 0 is the root.
#[derive(Debug)]
pub struct Tiles {
    pub nodes: Vec<Tile>,
    pub order: Vec<u32>,
}

/// The point from which a receiver looks: off its surface, so that the surface does not hide itself.
pub fn eye(receiver: &Receiver) -> Vec3 {
    receiver.position + receiver.normal * OFFSET
}

impl Tiles {
    pub fn new(receivers: &[Receiver]) -> Self {
        let mut tiles = Self { nodes: Vec::new(), order: (0..receivers.len() as u32).collect() };
        if !receivers.is_empty() {
            tiles.build(receivers, 0, receivers.len());
        }
        tiles
    }

    /// Halves the run at the median, so the depth is the logarithm of its length.
    fn build(&mut self, receivers: &[Receiver], first: usize, count: usize) -> usize {
        let run = &mut self.order[first..first + count];
        let at = |i: u32| &receivers[i as usize];
        let (mut bounds, mut facing) = (Bounds::EMPTY, Bounds::EMPTY);
        for &i in run.iter() {
            bounds.grow(eye(at(i)));
            facing.grow(at(i).normal);
        }
        let turn = facing.hi - facing.lo;
        let normal = at(run[0]).normal;
        let flat = turn.max_element() < 1e-5;
        let plane = flat.then(|| (normal, run.iter().map(|&i| normal.dot(eye(at(i)))).fold(f32::INFINITY, f32::min)));
        let node = self.nodes.len();
        self.nodes.push(Tile { bounds, first, count, plane, second: None });
        if count <= LEAF {
            return node;
        }
        // Different faces part first; receivers of one face part along their longest side.
        let by_normal = turn.max_element() > 0.2;
        let side = if by_normal { turn } else { bounds.hi - bounds.lo };
        let axis = (0..3).fold(0, |best, k| if side[k] > side[best] { k } else { best });
        let key = |i: u32| if by_normal { at(i).normal[axis] } else { at(i).position[axis] };
        let half = count / 2;
        run.select_nth_unstable_by(half, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
        self.build(receivers, first, half);
        let second = self.build(receivers, first + half, count - half);
        self.nodes[node].second = Some(second);
        node
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::{r2, sphere};

    #[test]
    fn every_receiver_is_in_exactly_one_leaf_within_its_bounds() {
        let receivers: Vec<_> = (0..500)
            .map(|i| {
                let normal = sphere(r2(i / 100, glam::Vec2::ZERO));
                let position = sphere(r2(i, glam::Vec2::splat(0.2))) * 100.0;
                Receiver { position, normal, shading_normal: normal, footprint: 1.0, seed: 0 }
            })
            .collect();
        let tiles = Tiles::new(&receivers);
        let mut seen = vec![0; receivers.len()];
        for tile in &tiles.nodes {
            for &i in &tiles.order[tile.first..tile.first + tile.count] {
                let p = eye(&receivers[i as usize]);
                assert!(p.cmpge(tile.bounds.lo).all() && p.cmple(tile.bounds.hi).all());
                seen[i as usize] += u32::from(tile.second.is_none());
            }
            assert!(tile.second.is_some() || tile.count <= LEAF);
        }
        assert!(seen.iter().all(|&s| s == 1));
    }
}
