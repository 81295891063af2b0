//! Finding a cut: start at the roots, refine where the bound is largest.
//!
//! Clusters that the near rays' estimate of the total already shows to be too coarse are refined without a look at
//! them; only then are representatives evaluated and the cut is refined by its own running total. That saves the shadow
//! rays of all clusters near the root.

use std::{cmp::Ordering, collections::BinaryHeap};

use glam::{DVec3, Vec3};

use crate::{
    Rgb,
    lighttree::{Branch, Cluster, LightTree, Node, Vantage},
    rays::Rays,
};

/// How far a cut is refined.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Largest bound of a cluster, as a share of the total.
    pub threshold: f32,
    /// Most clusters.
    pub clusters: u32,
}

/// A tree as one receiver sees it.
pub(super) struct Source<'a> {
    pub tree: &'a LightTree<'a>,
    pub vantage: Vantage,
    /// B̄, the radiosity that is accounted for elsewhere.
    pub control: Rgb,
    /// The tree's variant, which names the representatives.
    pub variant: usize,
}

impl Source<'_> {
    /// What the K·V of a node's representative is multiplied by.
    fn stand_in(&self, node: &Node, representative: u32) -> Rgb {
        let (intensity, area) = self.tree.stand_in(node, representative);
        intensity - self.control * area
    }

    /// The light that stands for a node; `known` stands for a node above it.
    fn representative(&self, branch: Branch, known: Option<u32>) -> u32 {
        match known {
            Some(light) if branch.holds(light) => light,
            _ => self.tree.representative(branch, self.variant),
        }
    }
}

/// An inner node.
#[derive(Clone, Copy)]
struct Member {
    branch: Branch,
    /// Its representative.
    light: u32,
    /// What the representative's K·V is multiplied by.
    power: Rgb,
    /// K·V of the representative.
    weight: Rgb,
}

impl Member {
    fn contribution(&self) -> DVec3 {
        (self.power * self.weight).as_dvec3()
    }
}

/// An inner node in the cut as the heap moves it about.
#[derive(Clone, Copy)]
struct Entry {
    bound: f32,
    source: u8,
    node: u32,
    /// Number of the member.
    member: u32,
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        // Equal bounds are told apart by the tree's order, so that a heap's own order never decides.
        self.bound.total_cmp(&other.bound).then((other.source, other.node).cmp(&(self.source, self.node)))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Entry {}

/// The cut, with memory that is used again for the next receiver.
#[derive(Default)]
pub(super) struct Cut {
    heap: BinaryHeap<Entry>,
    /// All that were ever in the cut.
    members: Vec<Member>,
    /// Single lights in the cut that are not evaluated yet.
    lights: Vec<(u8, u32)>,
}

pub(super) struct Found {
    pub sum: DVec3,
    /// Sum of the bounds of all clusters left.
    pub bound: f32,
    pub clusters: u32,
    pub rays: u32,
}

/// Everything that one search needs.
struct Search<'a> {
    sources: &'a [Source<'a>],
    tracer: &'a Rays<'a>,
    origin: Vec3,
    total: DVec3,
    rays: u32,
    /// Single lights that are in the total.
    lights: u32,
}

impl Cut {
    /// Refines until every bound is below the threshold times the total, which starts with `offset`; `expected` is
    /// what the total is thought to become.
    pub fn find(
        &mut self,
        sources: &[Source],
        tracer: &Rays,
        origin: Vec3,
        offset: Rgb,
        expected: Rgb,
        limits: &Limits,
    ) -> Found {
        self.heap.clear();
        self.members.clear();
        self.lights.clear();
        let mut search = Search { sources, tracer, origin, total: offset.as_dvec3(), rays: 0, lights: 0 };
        for (source, Source { tree, .. }) in (0..).zip(sources) {
            if let Some(root) = tree.root() {
                self.push(&search, source, root, None);
            }
        }
        self.descend(&search, limits, mean(expected.as_dvec3()));
        self.evaluate(&mut search);
        self.refine(&mut search, limits);
        let bound: f64 = self.heap.iter().map(|m| f64::from(m.bound)).sum();
        let clusters = search.lights + self.heap.len() as u32;
        Found { sum: search.total, bound: bound as f32, clusters, rays: search.rays }
    }

    /// Adds a cluster that is not evaluated; one that can contribute nothing is dropped.
    fn push(&mut self, search: &Search, source: u8, cluster: Cluster, known: Option<u32>) {
        match cluster {
            Cluster::Light(light) => self.lights.push((source, light)),
            Cluster::Node(branch) => {
                if let Some((bound, member)) = search.member(source, branch, known) {
                    self.keep(bound, source, member);
                }
            }
        }
    }

    fn keep(&mut self, bound: f32, source: u8, member: Member) {
        self.heap.push(Entry { bound, source, node: member.branch.id, member: self.members.len() as u32 });
        self.members.push(member);
    }

    /// Refines what is too coarse for the expected total, without evaluating anything. Half of the limit is left for
    /// refining by the true total.
    fn descend(&mut self, search: &Search, limits: &Limits, expected: f64) {
        if expected <= 0.0 {
            return;
        }
        let target = f64::from(limits.threshold) * expected;
        while self.heap.len() + self.lights.len() < limits.clusters as usize / 2 {
            match self.heap.peek() {
                Some(top) if f64::from(top.bound) > target => {}
                _ => return,
            }
            let Some(top) = self.heap.pop() else { return };
            let Member { branch, light, .. } = self.members[top.member as usize];
            for child in search.sources[usize::from(top.source)].tree.children(branch) {
                self.push(search, top.source, child, Some(light));
            }
        }
    }

    /// Evaluates the representative of everything in the cut.
    fn evaluate(&mut self, search: &mut Search) {
        for &(source, light) in &self.lights {
            search.add_light(source, light, None);
        }
        let mut entries = std::mem::take(&mut self.heap).into_vec();
        // In the tree's order, so that the sum does not depend on how the heap is laid out.
        entries.sort_unstable_by_key(|e| (e.source, e.node));
        for entry in &entries {
            let member = &mut self.members[entry.member as usize];
            member.weight = search.weight(entry.source, member.light);
            search.total += member.contribution();
        }
        self.heap = entries.into();
    }

    /// Refines by the running total.
    fn refine(&mut self, search: &mut Search, limits: &Limits) {
        while search.lights as usize + self.heap.len() < limits.clusters as usize {
            let target = f64::from(limits.threshold) * mean(search.total).max(0.0);
            match self.heap.peek() {
                Some(top) if f64::from(top.bound) > target => {}
                _ => return,
            }
            let Some(top) = self.heap.pop() else { return };
            let parent = self.members[top.member as usize];
            search.total -= parent.contribution();
            for child in search.sources[usize::from(top.source)].tree.children(parent.branch) {
                match child {
                    Cluster::Light(light) => {
                        search.add_light(top.source, light, (light == parent.light).then_some(parent.weight));
                    }
                    Cluster::Node(branch) => {
                        let Some((bound, mut member)) = search.member(top.source, branch, Some(parent.light)) else {
                            continue;
                        };
                        member.weight = match member.light {
                            light if light == parent.light => parent.weight,
                            light => search.weight(top.source, light),
                        };
                        search.total += member.contribution();
                        self.keep(bound, top.source, member);
                    }
                }
            }
        }
    }
}

impl Search<'_> {
    /// The largest error that a node can bring in any band, and the node, not evaluated; none that can bring none.
    fn member(&self, source: u8, branch: Branch, known: Option<u32>) -> Option<(f32, Member)> {
        let from = &self.sources[usize::from(source)];
        let node = from.tree.node(branch);
        let light = from.representative(branch, known);
        let power = from.stand_in(&node, light);
        let deviation = deviation(&node, from.control, power);
        let bound = if deviation > 0.0 { deviation * from.vantage.bound(&node) } else { 0.0 };
        (bound > 0.0).then_some((bound, Member { branch, light, power, weight: Rgb::ZERO }))
    }

    /// K·V of a light.
    fn weight(&mut self, source: u8, light: u32) -> Rgb {
        let source = &self.sources[usize::from(source)];
        let kernel = source.vantage.kernel(&source.tree.light(light));
        if kernel <= 0.0 {
            return Rgb::ZERO;
        }
        let d = source.tree.target(light) - self.origin;
        let distance = d.length();
        if distance <= 0.0 {
            return Rgb::splat(kernel);
        }
        self.rays += 1;
        self.tracer.transmittance(self.origin, d / distance, distance) * kernel
    }

    /// Adds a single light; `known` is its K·V where it stood for its parent.
    fn add_light(&mut self, source: u8, light: u32, known: Option<Rgb>) {
        let sources = self.sources;
        let Source { tree, control, .. } = &sources[usize::from(source)];
        let l = tree.light(light);
        let power = l.intensity - *control * l.area;
        self.lights += 1;
        if power != Rgb::ZERO {
            let weight = known.unwrap_or_else(|| self.weight(source, light));
            self.total += (power * weight).as_dvec3();
        }
    }
}

/// Largest error of a node, in any band, for a kernel of 1: how far the light found, between 0 and the stand-in
/// `estimate`, can be from the truth, between −M and P.
fn deviation(node: &Node, control: Rgb, estimate: Rgb) -> f32 {
    let (above, below) = parts(node, control);
    (above - estimate.min(Rgb::ZERO)).max(below + estimate.max(Rgb::ZERO)).max_element()
}

/// Upper bounds of P and M, the sums of the positive and negative parts of (Bⱼ − B̄)·Aⱼ/π over a node's lights.
fn parts(node: &Node, control: Rgb) -> (Rgb, Rgb) {
    if node.area <= 0.0 {
        return (node.intensity, Rgb::ZERO);
    }
    let (low, high) = (node.low, node.high);
    let mean = (node.intensity / node.area).clamp(low, high);
    let inside = control.clamp(low, high);
    let width = high - low;
    // Where all lights are equal there is no chord and nothing to hide.
    let chord = Rgb::select(width.cmpgt(Rgb::ZERO), (mean - low) * (high - inside) / width, Rgb::ZERO);
    let above = chord + (low - control).max(Rgb::ZERO);
    let below = (above - (mean - control)).max(Rgb::ZERO);
    (above * node.area, below * node.area)
}

fn mean(rgb: DVec3) -> f64 {
    rgb.element_sum() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        gather::Receiver,
        lighttree::{Light, Seeded, VARIANTS},
        sampling::{mix, unit},
    };
    use proptest::prelude::*;

    fn light(i: usize, radiosity: Rgb, area: f32) -> Seeded {
        let position = Vec3::splat(unit(mix(i as u64)));
        let light = Light { position, normal: Vec3::Z, intensity: radiosity * area, area };
        Seeded { light, seed: i as u64 }
    }

    fn source<'a>(tree: &'a LightTree, control: Rgb, variant: usize) -> Source<'a> {
        let receiver =
            Receiver { position: Vec3::ZERO, normal: Vec3::Z, shading_normal: Vec3::Z, footprint: 1.0, seed: 0 };
        Source { tree, vantage: Vantage::new(&receiver, f32::INFINITY), control, variant }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        /// The promise: whatever kernel and visibility each light has, up to 1, the estimate is no further from the
        /// truth than the bound.
        #[test]
        fn no_estimate_is_further_off_than_its_bound(
            patches in prop::collection::vec((0.0f32..4.0, 0.01f32..2.0, any::<bool>(), 0.0f32..1.0), 2..12),
            control in prop_oneof![Just(0.0f32), 0.0f32..5.0],
            ambient in prop_oneof![Just(0.0f32), 0.1f32..3.0],
        ) {
            // Without an ambient part the tree is one for plain cuts.
            let control = if ambient > 0.0 { Rgb::new(control, 1.0, 0.0) } else { Rgb::ZERO };
            let lights = patches.iter().enumerate().map(|(i, p)| light(i, Rgb::new(p.0, 0.5 * p.0, 4.0 - p.0), p.1));
            let tree = LightTree::new(lights.collect(), ambient);
            let kernel = |l: &Light| {
                let i = (0..patches.len()).find(|&i| unit(mix(i as u64)) == l.position.x).unwrap();
                if patches[i].2 { 1.0 } else { patches[i].3 }
            };
            let root = tree.branches()[0];
            let node = tree.node(root);
            let truth: Rgb = tree.below(root).map(|(_, l)| (l.intensity - control * l.area) * kernel(&l)).sum();
            for variant in 0..VARIANTS {
                let source = source(&tree, control, variant);
                let representative = source.representative(root, None);
                let stand_in = source.stand_in(&node, representative);
                let estimate = stand_in * kernel(&tree.light(representative));
                let bound = deviation(&node, control, stand_in);
                let off = (estimate - truth).abs().max_element();
                prop_assert!(off <= bound * (1.0 + 1e-4) + 1e-4, "{off} above {bound}");
            }
        }
    }

    #[test]
    fn two_equal_groups_hide_exactly_what_the_chord_says() {
        let b = [1.0, 1.0, 3.0, 3.0];
        let lights = (0..4).map(|i| light(i, Rgb::splat(b[i]), 1.0)).collect();
        let tree = LightTree::new(lights, 0.0);
        let root = &tree.node(tree.branches()[0]);
        assert_eq!(parts(root, Rgb::splat(2.0)), (Rgb::splat(2.0), Rgb::splat(2.0)));
        assert_eq!(parts(root, Rgb::ZERO), (Rgb::splat(8.0), Rgb::ZERO));
        assert_eq!(parts(root, Rgb::splat(5.0)), (Rgb::ZERO, Rgb::splat(12.0)));
        // A plain cut: the estimate lies between nothing and everything, and so does the truth.
        assert_eq!(deviation(root, Rgb::ZERO, source(&tree, Rgb::ZERO, 0).stand_in(root, 0)), 8.0);
    }

    #[test]
    fn lights_that_are_all_alike_hide_nothing_behind_their_own_radiosity() {
        let tree = LightTree::new((0..9).map(|i| light(i, Rgb::splat(0.7), 0.5)).collect(), 0.7);
        let root = tree.branches()[0];
        let node = tree.node(root);
        for variant in 0..VARIANTS {
            let source = source(&tree, Rgb::splat(0.7), variant);
            let stand_in = source.stand_in(&node, source.representative(root, None));
            assert!(deviation(&node, Rgb::splat(0.7), stand_in) < 1e-5);
        }
    }
}
