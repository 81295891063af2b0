//! Which of many boxes may meet one: what overlaps is looked for among few.

use std::time::Duration;

use glam::Vec3;
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};

/// Boxes under a tree.
pub(crate) struct Boxes(Bvh2);

impl Boxes {
    /// Each by its corners of least and largest coordinates.
    pub fn new(boxes: impl Iterator<Item = (Vec3, Vec3)>) -> Self {
        let boxes: Vec<Aabb> = boxes.map(|(lo, hi)| Aabb::new(lo.into(), hi.into())).collect();
        if boxes.is_empty() {
            return Self(Bvh2::default());
        }
        Self(build_bvh2(&boxes, BvhBuildParams::fast_build(), &mut Duration::default()))
    }

    /// Calls `f` with the numbers of boxes that a box meets, and maybe of some beside it, in no order, until it returns
    /// false.
    pub fn meeting(&self, (lo, hi): (Vec3, Vec3), mut f: impl FnMut(u32) -> bool) {
        self.0.aabb_traverse(Aabb::new(lo.into(), hi.into()), |tree, node| {
            let node = &tree.nodes[node as usize];
            let first = node.first_index as usize;
            tree.primitive_indices[first..first + node.prim_count as usize].iter().all(|&i| f(i))
        });
    }
}

/// The box of some points.
pub(crate) fn around(points: &[Vec3]) -> (Vec3, Vec3) {
    points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_plane_a_wall_of_boxes_lies_in_each_meets_its_neighbours_and_few_more() {
        let count = 50;
        for axis in 0..3 {
            let place = |i: i32| {
                let mut at = [0.0; 3];
                (at[(axis + 1) % 3], at[(axis + 2) % 3]) = ((i % count) as f32, (i / count) as f32);
                Vec3::from(at)
            };
            let of = |i: i32| (place(i), place(i) + place(count + 1));
            let boxes = Boxes::new((0..count * count).map(of));
            let mut visits = 0;
            for i in 0..count * count {
                let mut met = Vec::new();
                boxes.meeting(of(i), |j| {
                    met.push(j as i32);
                    true
                });
                visits += met.len();
                let (x, y) = (i % count, i / count);
                let neighbours =
                    (0..count * count).filter(|j| (j % count - x).abs() <= 1 && (j / count - y).abs() <= 1);
                assert!(neighbours.into_iter().all(|j| met.contains(&j)), "{i}: {met:?}");
            }
            assert!(visits < 32 * (count * count) as usize, "axis {axis}: {visits}");
        }
    }

    #[test]
    fn nothing_meets_no_boxes_and_a_visit_ends_when_it_is_told_to() {
        let all = (Vec3::NEG_ONE, Vec3::ONE);
        Boxes::new(std::iter::empty()).meeting(all, |i| panic!("{i}"));
        let mut count = 0;
        Boxes::new((0..9).map(|_| all)).meeting(all, |_| {
            count += 1;
            false
        });
        assert_eq!(count, 1);
    }
}
