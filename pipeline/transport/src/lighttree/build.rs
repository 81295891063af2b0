//! Building a light tree: median splits along the widest of seven axes: three of position, three of the normal (scaled
//! so that opposite normals lie as far apart as opposite ends of the scene), and one of radiosity, B/(B + mean B), whose
//! whole range is half a scene: lights of one cluster should shine alike. The last axis took the error of a 2 % cut from
//! 2.7, 2.3 and 1.7 to 2.0, 2.0 and 1.5 % in the scenes of the bench; twice its range was worse.
//!
//! Keys are whole steps of a fine grid over the scene. The surfels of one row of voxels differ in the other coordinates
//! by rounding only; with exact keys that rounding would decide which of them a median takes, and a copy of the scene at
//! another place or scale would have another tree and other noise.

use glam::Vec3;
use luxel_scene::{Cancelled, Progress, watched};

use super::{Cluster, Light, LightTree, Lights, Node, VARIANTS, WIDE, left_count, stored_count, weight, wide_count};
use crate::{
    Rgb,
    sampling::{combine, mix, unit},
};

/// Below this many lights a subtree is built by one thread.
const TASK: usize = 4096;

/// Subtrees of at least so many lights look at the progress.
const LOOK: usize = 512;

/// Steps of a key over half the scene's longest side: far finer than a voxel, far coarser than rounding.
const STEPS: f32 = 32768.0;

/// What is moved about while splitting.
#[derive(Clone, Copy)]
struct Item {
    /// Along the axis of the split.
    key: i32,
    id: u32,
}

/// What a parent needs to know of its child.
#[derive(Clone, Copy)]
struct Summary {
    intensity: Rgb,
    area: f32,
    low: Rgb,
    high: Rgb,
    weight: f32,
    /// The identity of the light that stands for all in the first variant.
    seed: u64,
}

/// Everything that does not change on the way down.
struct Builder<'b> {
    lights: &'b Lights<'b>,
    ambient: f32,
    /// Least corner of all lights, and steps of a key per frame unit.
    lo: Vec3,
    step: f32,
    /// Mean B.
    typical: f32,
    progress: &'b dyn Progress,
}

pub(super) fn build<'a>(lights: Lights<'a>, ambient: f32, progress: &dyn Progress) -> Result<LightTree<'a>, Cancelled> {
    let counts = |id: &u32| {
        let light = lights.light(*id);
        light.intensity.max_element() > 0.0 || light.area > 0.0
    };
    let mut items: Vec<Item> = Vec::with_capacity(lights.len());
    for id in watched(0..lights.len() as u32, progress) {
        items.extend(Some(id?).filter(counts).map(|id| Item { key: 0, id }));
    }
    if items.is_empty() {
        return Ok(LightTree::default());
    }
    progress.check()?;
    let (lo, hi) = bounds(items.iter().map(|i| lights.place(i.id).0));
    let scale = 0.5 * (hi - lo).max_element();
    let step = if scale > 0.0 { STEPS / scale } else { 0.0 };
    let builder = Builder { lights: &lights, ambient, lo, step, typical: typical(&lights, &items), progress };
    let mut nodes = vec![EMPTY; stored_count(items.len())];
    let mut choices = vec![0; items.len() - 1];
    builder.split(&mut items, &mut nodes, &mut choices)?;
    // The memory of the items is used again, a half of it given back.
    let order: Vec<u32> = items.into_iter().map(|i| i.id).collect();
    let mut tree = LightTree { lights, order, nodes, choices, chosen: Vec::new(), ambient };
    tree.chosen = chosen(&tree, progress)?;
    Ok(tree)
}

/// The representatives of all wide nodes, in their order.
fn chosen(tree: &LightTree, progress: &dyn Progress) -> Result<Vec<[u32; VARIANTS]>, Cancelled> {
    let mut chosen = Vec::with_capacity(wide_count(tree.len()));
    let mut open: Vec<Cluster> = tree.root().into_iter().collect();
    while let Some(cluster) = open.pop() {
        if chosen.len().is_multiple_of(LOOK) {
            progress.check()?;
        }
        match cluster {
            Cluster::Node(branch) if branch.count as usize > WIDE => {
                chosen.push(std::array::from_fn(|variant| tree.follow(branch, variant)));
                let [left, right] = tree.children(branch);
                open.extend([right, left]);
            }
            _ => {}
        }
    }
    Ok(chosen)
}

const EMPTY: Node = Node {
    lo: Vec3::ZERO,
    hi: Vec3::ZERO,
    axis: Vec3::Z,
    cos: -1.0,
    intensity: Rgb::ZERO,
    area: 0.0,
    low: Rgb::ZERO,
    high: Rgb::ZERO,
};

/// The node of two lights, the left one first.
#[inline]
pub(super) fn pair(left: &Light, right: &Light) -> Node {
    let (lo, hi) = bounds([left.position, right.position].into_iter());
    let (axis, cos) = cone(|| [left.normal, right.normal].into_iter());
    let [(low_a, high_a), (low_b, high_b)] = [radiosity(left), radiosity(right)];
    Node {
        lo,
        hi,
        axis,
        cos,
        intensity: left.intensity + right.intensity,
        area: left.area + right.area,
        low: low_a.min(low_b),
        high: high_a.max(high_b),
    }
}

impl Builder<'_> {
    /// Sorts `items` into a subtree; `nodes` holds exactly its stored nodes, `choices` one for each of its inner nodes.
    /// The depth of the recursion is the logarithm of the number of lights, since every split is a median.
    fn split(&self, items: &mut [Item], nodes: &mut [Node], choices: &mut [u8]) -> Result<Summary, Cancelled> {
        if let [item] = items {
            return Ok(self.leaf(item.id));
        }
        let count = items.len();
        // The passes over many lights take a while each.
        let look = || if count >= LOOK { self.progress.check() } else { Ok(()) };
        look()?;
        let widest = self.widest(items);
        look()?;
        let enclosed = (count > 2).then(|| self.enclose(items));
        look()?;
        for item in items.iter_mut() {
            item.key = self.keys(item.id)[widest];
        }
        let middle = left_count(count);
        // Ties are broken by the place in the list, so that the halves do not depend on how the selection works.
        items.select_nth_unstable_by(middle, |a, b| a.key.cmp(&b.key).then(a.id.cmp(&b.id)));
        let (left, right) = items.split_at_mut(middle);
        let Some((choice, below)) = choices.split_first_mut() else { unreachable!("n lights have n - 1 inner nodes") };
        let (left_choices, right_choices) = below.split_at_mut(middle - 1);
        // A node of two lights is not stored, and has nothing below it.
        let (node, below) = match nodes.split_first_mut() {
            Some((node, below)) => (Some(node), below),
            None => (None, &mut [][..]),
        };
        let (left_nodes, right_nodes) = below.split_at_mut(stored_count(middle));
        let mut go_left = || self.split(left, left_nodes, left_choices);
        let mut go_right = || self.split(right, right_nodes, right_choices);
        let (a, b) = if count > TASK { rayon::join(go_left, go_right) } else { (go_left(), go_right()) };
        let sum;
        (sum, *choice) = join(&a?, &b?);
        if let (Some(node), Some(enclosed)) = (node, enclosed) {
            let Summary { intensity, area, low, high, .. } = sum;
            *node = Node { intensity, area, low, high, ..enclosed };
        }
        Ok(sum)
    }

    /// The first of the axes along which the items spread widest.
    fn widest(&self, items: &[Item]) -> usize {
        let (mut least, mut most) = ([i32::MAX; 7], [i32::MIN; 7]);
        for key in items.iter().map(|item| self.keys(item.id)) {
            for axis in 0..7 {
                least[axis] = least[axis].min(key[axis]);
                most[axis] = most[axis].max(key[axis]);
            }
        }
        let extent = |axis: usize| i64::from(most[axis]) - i64::from(least[axis]);
        (1..7).fold(0, |best, axis| if extent(axis) > extent(best) { axis } else { best })
    }

    /// Box and cone.
    fn enclose(&self, items: &[Item]) -> Node {
        let (lo, hi) = bounds(items.iter().map(|i| self.lights.place(i.id).0));
        let (axis, cos) = cone(|| items.iter().map(|i| self.lights.place(i.id).1));
        Node { lo, hi, axis, cos, ..EMPTY }
    }

    fn keys(&self, id: u32) -> [i32; 7] {
        let light = self.lights.light(id);
        let (p, n) = ((light.position - self.lo) * self.step, light.normal * STEPS);
        [p.x, p.y, p.z, n.x, n.y, n.z, self.brightness(&light) * STEPS].map(|k| k.round() as i32)
    }

    /// B/(B + mean B) of a light, from its band mean; 0 where nothing has an area.
    fn brightness(&self, light: &Light) -> f32 {
        match light.area * self.typical + mean(light.intensity) {
            both if both > 0.0 && light.area > 0.0 => mean(light.intensity) / both,
            _ => 0.0,
        }
    }

    fn leaf(&self, id: u32) -> Summary {
        let light = self.lights.light(id);
        let (low, high) = radiosity(&light);
        let weight = weight(light.intensity, light.area, self.ambient);
        Summary { intensity: light.intensity, area: light.area, low, high, weight, seed: self.lights.seed(id) }
    }
}

/// Mean B of all lights.
fn typical(lights: &Lights, items: &[Item]) -> f32 {
    let (mut intensity, mut area) = (0.0f64, 0.0f64);
    for light in items.iter().map(|i| lights.light(i.id)) {
        intensity += f64::from(mean(light.intensity));
        area += f64::from(light.area);
    }
    if area > 0.0 { (intensity / area) as f32 } else { 0.0 }
}

fn mean(rgb: Rgb) -> f32 {
    rgb.element_sum() / 3.0
}

/// Least and largest radiosity of one light: its own, twice.
fn radiosity(light: &Light) -> (Rgb, Rgb) {
    if light.area > 0.0 {
        let b = light.intensity / light.area;
        (b, b)
    } else {
        // Lights without area bring no radiosity: an empty range, which leaves any union as it is.
        (Rgb::INFINITY, Rgb::NEG_INFINITY)
    }
}

/// Both halves together, and the variants whose representative comes from the right one.
fn join(a: &Summary, b: &Summary) -> (Summary, u8) {
    let draws = draws(combine(a.seed, b.seed));
    let weight = a.weight + b.weight;
    // Where all is dark nobody's choice matters.
    let is_right = |v: usize| draws[v] * weight >= a.weight;
    let choice = (0..VARIANTS).filter(|v| is_right(*v)).fold(0, |bits, v| bits | 1 << v);
    let sum = Summary {
        intensity: a.intensity + b.intensity,
        area: a.area + b.area,
        low: a.low.min(b.low),
        high: a.high.max(b.high),
        weight,
        seed: if is_right(0) { b.seed } else { a.seed },
    };
    (sum, choice)
}

/// A number in [0, 1) for every variant: one in each of as many equal strata, in an order drawn by the seed.
fn draws(seed: u64) -> [f32; VARIANTS] {
    let mut order: [usize; VARIANTS] = std::array::from_fn(|v| v);
    let mut bits = mix(seed);
    for last in (1..VARIANTS).rev() {
        order.swap(last, ((bits & 0xff) as usize * (last + 1)) >> 8);
        bits >>= 8;
    }
    let jitter = unit(seed);
    order.map(|stratum| (stratum as f32 + jitter) * (1.0 / VARIANTS as f32))
}

/// The cone about the mean normal.
fn cone<I: Iterator<Item = Vec3>>(normals: impl Fn() -> I) -> (Vec3, f32) {
    let mean: Vec3 = normals().sum();
    let axis = mean.try_normalize().unwrap_or(Vec3::Z);
    let cos = normals().map(|n| n.dot(axis)).fold(1.0f32, f32::min);
    // A cosine that rounding took to just below 1 means that all normals agree.
    (axis, if cos > 1.0 - 1e-6 { 1.0 } else { (cos - 1e-6).max(-1.0) })
}

fn bounds(points: impl Iterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        lighttree::{Branch, Seeded},
        sampling::{sphere, unit2},
    };

    fn cloud(n: u64) -> Vec<Seeded> {
        (0..n)
            .map(|i| {
                let h = mix(i);
                let p = sphere(unit2(h)) * 100.0 * unit(mix(h));
                let intensity = Rgb::new(unit(mix(h ^ 1)), unit(mix(h ^ 2)), unit(mix(h ^ 3)));
                let light = Light { position: p, normal: sphere(unit2(mix(h ^ 4))), intensity, area: 0.5 };
                Seeded { light, seed: h }
            })
            .collect()
    }

    #[test]
    fn every_node_contains_what_lies_below_it() {
        for count in (2..70).chain([777]) {
            let tree = LightTree::new(cloud(count), 0.0);
            let branches = tree.branches();
            assert_eq!((tree.len() as u64, branches.len() as u64), (count, count - 1));
            assert!(branches.iter().zip(0u32..).all(|(branch, id)| branch.id == id));
            let stored = branches.iter().filter(|b| tree.below(**b).count() > 2);
            assert!(stored.clone().zip(0u32..).all(|(branch, slot)| branch.slot == slot));
            assert_eq!(stored.count(), tree.nodes.len());
            let wide = branches.iter().filter(|b| tree.below(**b).count() > WIDE);
            assert!(wide.clone().zip(0u32..).all(|(branch, number)| branch.wide == number));
            assert_eq!(wide.count(), tree.chosen.len());
            branches.into_iter().for_each(|branch| contains_its_lights(&tree, branch));
        }
    }

    fn contains_its_lights(tree: &LightTree, branch: Branch) {
        let node = tree.node(branch);
        let lights: Vec<(u32, Light)> = tree.below(branch).collect();
        for v in 0..VARIANTS {
            let chosen = tree.representative(branch, v);
            assert_eq!(chosen, tree.follow(branch, v));
            assert!(branch.holds(chosen) && lights.iter().any(|(place, _)| *place == chosen));
            // A node's representative stands for the half that it comes from.
            for child in tree.children(branch) {
                match child {
                    Cluster::Node(child) if child.holds(chosen) => assert_eq!(tree.representative(child, v), chosen),
                    _ => {}
                }
            }
        }
        let sum: Rgb = lights.iter().map(|(_, l)| l.intensity).sum();
        assert!(sum.abs_diff_eq(node.intensity, 1e-4 * sum.max_element()));
        for (_, l) in lights {
            assert!(l.position.cmpge(node.lo).all() && l.position.cmple(node.hi).all());
            assert!(l.normal.dot(node.axis) >= node.cos);
            let b = l.intensity / l.area;
            assert!(b.cmpge(node.low).all() && b.cmple(node.high).all());
        }
    }

    #[test]
    fn every_light_has_one_place() {
        let tree = LightTree::new(cloud(777), 0.0);
        let mut order = tree.order.clone();
        order.sort_unstable();
        assert_eq!(order, (0..777).collect::<Vec<u32>>());
    }

    #[test]
    fn representatives_are_chosen_in_proportion_to_intensity() {
        // One light of two shines with three quarters of the power; over many pairs it stands for three in four.
        let mut lights = cloud(2);
        lights[0].light.intensity = Rgb::splat(3.0);
        lights[1].light.intensity = Rgb::ONE;
        let pairs = 20_000;
        let bright = (0..pairs).filter(|&i| {
            let mut pair = lights.clone();
            pair[0].seed = mix(2 * i);
            pair[1].seed = mix(2 * i + 1);
            let tree = LightTree::new(pair, 0.0);
            tree.light(tree.representative(tree.branches()[0], i as usize % VARIANTS)).intensity.x > 2.0
        });
        let share = bright.count() as f64 / pairs as f64;
        // Five standard deviations of a binomial share.
        assert!((share - 0.75).abs() < 5.0 * (0.75 * 0.25 / pairs as f64).sqrt(), "{share}");
    }

    #[test]
    fn what_a_representative_stands_for_is_right_on_average() {
        let trees = 4000;
        let (mut intensity, mut area, mut square) = (0.0f64, 0.0f64, 0.0f64);
        for run in 0..trees {
            let mut lights = cloud(9);
            lights.iter_mut().for_each(|l| l.seed = mix(l.seed ^ mix(run)));
            let tree = LightTree::new(lights, 0.6);
            let root = tree.branches()[0];
            let node = tree.node(root);
            let stand_in = tree.stand_in(&node, tree.representative(root, run as usize % VARIANTS));
            intensity += f64::from(stand_in.0.x / node.intensity.x);
            square += f64::from(stand_in.0.x / node.intensity.x).powi(2);
            area += f64::from(stand_in.1 / node.area);
        }
        let n = trees as f64;
        let error = ((square / n - (intensity / n).powi(2)) / n).sqrt();
        assert!((intensity / n - 1.0).abs() < 5.0 * error, "{} with error {error}", intensity / n);
        assert!((area / n - 1.0).abs() < 5.0 * error, "{} with error {error}", area / n);
    }

    #[test]
    fn a_tree_of_nothing_or_of_one_light_is_sound() {
        assert!(LightTree::new(Vec::new(), 0.0).root().is_none());
        assert_eq!(LightTree::new(cloud(1), 0.0).root(), Some(Cluster::Light(0)));
        let mut dark = cloud(3);
        dark.iter_mut().for_each(|l| (l.light.intensity, l.light.area) = (Rgb::ZERO, 0.0));
        assert!(LightTree::new(dark, 0.0).is_empty());
        // Many lights at one point: nothing to split by but the order.
        let mut same = cloud(100);
        same.iter_mut().for_each(|l| (l.light.position, l.light.normal) = (Vec3::ONE, Vec3::X));
        let tree = LightTree::new(same, 0.0);
        assert_eq!((tree.len(), tree.branches().len()), (100, 99));
    }
}
