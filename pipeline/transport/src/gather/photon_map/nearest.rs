//! The nearest of many points: a balanced binary tree over them, split at medians along the widest axis (Bentley 1975),
//! stored as their order alone.
//!
//! A range of the order is a subtree: its middle is the root, what lies before it the half below, what lies behind the
//! half above. Points at equal distance are told apart by their numbers, so the answer does not depend on the layout.
//! A search leaves out subtrees that lie farther off than what it has found, or than any of their points reaches.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress};

/// Below so many points a subtree is built by one thread.
const TASK: usize = 8192;

/// A point that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    /// Squared distance, squared frame units.
    pub square: f32,
    pub point: u32,
}

impl Found {
    fn is_before(&self, other: &Self) -> bool {
        self.square.total_cmp(&other.square).then(self.point.cmp(&other.point)).is_lt()
    }
}

/// One point of the order with the axis that its subtree is split along.
#[derive(Clone, Copy)]
struct Place {
    at: Vec3,
    point: u32,
    axis: u8,
    /// Largest square reach of the points of its subtree.
    reach: f32,
}

/// The tree.
pub(super) struct Nearest {
    order: Vec<Place>,
}

impl Nearest {
    pub fn new(points: impl Iterator<Item = Vec3>, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let place = |(at, point)| Place { at: at + Vec3::ZERO, point, axis: 0, reach: f32::INFINITY };
        let mut order: Vec<Place> = points.zip(0..).map(place).collect();
        split(&mut order, progress)?;
        Ok(Self { order })
    }

    /// Says how far every point reaches, as a square distance: no search from beyond that may accept it.
    pub fn bound(&mut self, reach: impl Fn(u32) -> f32) {
        spread(&mut self.order, &reach);
    }

    /// The up to `count` nearest points within the square distance `reach` that `accept` takes, nearest first, in
    /// `found`.
    pub fn find(&self, from: Vec3, count: usize, reach: f32, accept: impl Fn(u32) -> bool, found: &mut Vec<Found>) {
        found.clear();
        if count > 0 {
            Search { from, count, reach, accept, found }.look(&self.order, Vec3::ZERO);
        }
    }
}

fn split(order: &mut [Place], progress: &dyn Progress) -> Result<(), Cancelled> {
    if order.len() < 2 {
        return Ok(());
    }
    if order.len() >= 512 {
        progress.check()?;
    }
    let (lo, hi) = order.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p.at), hi.max(p.at)));
    let axis = (hi - lo).max_position();
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |a, b| a.at[axis].total_cmp(&b.at[axis]).then(a.point.cmp(&b.point)));
    let (below, rest) = order.split_at_mut(middle);
    let Some((root, above)) = rest.split_first_mut() else { unreachable!("the middle of a list is in it") };
    root.axis = axis as u8;
    if below.len() > TASK {
        let (a, b) = rayon::join(|| split(below, progress), || split(above, progress));
        a.and(b)
    } else {
        split(below, progress)?;
        split(above, progress)
    }
}

/// Sets the reaches of a subtree; returns the largest.
fn spread(order: &mut [Place], reach: &impl Fn(u32) -> f32) -> f32 {
    let (below, rest) = order.split_at_mut(order.len() / 2);
    let Some((root, above)) = rest.split_first_mut() else { return 0.0 };
    root.reach = reach(root.point).max(spread(below, reach)).max(spread(above, reach));
    root.reach
}

struct Search<'s, A> {
    from: Vec3,
    count: usize,
    reach: f32,
    accept: A,
    found: &'s mut Vec<Found>,
}

impl<A: Fn(u32) -> bool> Search<'_, A> {
    /// Looks through a subtree that lies so far off along every axis, at least.
    fn look(&mut self, order: &[Place], off_axes: Vec3) {
        let middle = order.len() / 2;
        let Some(root) = order.get(middle) else { return };
        // Rounding is monotone, so this is no more than the distance that any of the points is found to have.
        if off_axes.length_squared() > self.limit().min(root.reach) {
            return;
        }
        let axis = usize::from(root.axis);
        let off = self.from[axis] - root.at[axis];
        let (near, far) =
            if off < 0.0 { (&order[..middle], &order[middle + 1..]) } else { (&order[middle + 1..], &order[..middle]) };
        self.look(near, off_axes);
        let candidate = Found { square: root.at.distance_squared(self.from), point: root.point };
        if candidate.square <= self.limit() && (self.accept)(root.point) {
            self.take(candidate);
        }
        let mut beyond = off_axes;
        beyond[axis] = off;
        self.look(far, beyond);
    }

    /// The square distance beyond which nothing is of use any more.
    fn limit(&self) -> f32 {
        match self.found.last() {
            Some(last) if self.found.len() == self.count => last.square,
            _ => self.reach,
        }
    }

    fn take(&mut self, candidate: Found) {
        let at = self.found.partition_point(|f| f.is_before(&candidate));
        if at < self.count {
            self.found.truncate(self.count - 1);
            self.found.insert(at, candidate);
        }
    }
}

#[cfg(test)]
mod tests {
    use luxel_scene::{Silent, Unwanted};

    use super::*;
    use crate::sampling::{mix, unit};

    fn cloud(n: u64) -> Vec<Vec3> {
        // Whole numbers, so that many distances are equal.
        let at = |i: u64, axis| (unit(mix(i ^ axis)) * 12.0).floor();
        (0..n).map(|i| Vec3::new(at(i, 1 << 40), at(i, 2 << 40), at(i, 3 << 40))).collect()
    }

    #[test]
    fn what_is_found_is_what_a_look_at_all_points_finds() {
        let points = cloud(3000);
        let tree = Nearest::new(points.iter().copied(), &Silent).unwrap();
        let mut found = Vec::new();
        for i in 0..200u64 {
            let from = Vec3::splat(12.0) * Vec3::new(unit(mix(i)), unit(mix(i + 500)), unit(mix(i + 900)));
            let accept = |p: u32| !(u64::from(p) + i).is_multiple_of(3);
            let (count, reach) = (1 + i as usize % 40, 0.5 + (i % 7) as f32);
            let square = |p: u32| points[p as usize].distance_squared(from);
            let mut all: Vec<Found> = (0..3000)
                .filter(|p| accept(*p) && square(*p) <= reach)
                .map(|p| Found { square: square(p), point: p })
                .collect();
            all.sort_by(|a, b| a.square.total_cmp(&b.square).then(a.point.cmp(&b.point)));
            all.truncate(count);
            tree.find(from, count, reach, accept, &mut found);
            assert_eq!(found, all);
        }
    }

    /// A point whose reach does not hold the place is no answer, and what is far from all that reach it is not looked at.
    #[test]
    fn points_that_reach_a_place_are_found_without_a_look_at_the_others() {
        let points = cloud(3000);
        let reach = |p: u32| 0.01 + (p % 5) as f32 * 0.3;
        let mut tree = Nearest::new(points.iter().copied(), &Silent).unwrap();
        tree.bound(reach);
        let mut found = Vec::new();
        for i in 0..200u64 {
            let from = Vec3::splat(16.0) * Vec3::new(unit(mix(i)), unit(mix(i + 500)), unit(mix(i + 900)));
            let square = |p: u32| points[p as usize].distance_squared(from);
            let holds = |p: u32| square(p) <= reach(p) && !p.is_multiple_of(3);
            let nearest = (0..3000).filter(|p| holds(*p)).map(|point| Found { square: square(point), point });
            let nearest = nearest.min_by(|a, b| a.square.total_cmp(&b.square).then(a.point.cmp(&b.point)));
            let asked = std::cell::Cell::new(0);
            let accept = |p: u32| {
                asked.set(asked.get() + 1);
                holds(p)
            };
            tree.find(from, 1, f32::INFINITY, accept, &mut found);
            assert_eq!(found.first().copied(), nearest);
            assert!(asked.get() < 300, "{} of 3000", asked.get());
        }
    }

    #[test]
    fn an_empty_tree_finds_nothing_and_a_cancelled_one_is_not_built() {
        let mut found = vec![Found { square: 0.0, point: 7 }];
        let tree = Nearest::new(std::iter::empty(), &Silent).unwrap();
        tree.find(Vec3::ZERO, 3, f32::INFINITY, |_| true, &mut found);
        assert!(found.is_empty());
        assert!(Nearest::new(cloud(1000).into_iter(), &Unwanted).is_err());
    }
}
