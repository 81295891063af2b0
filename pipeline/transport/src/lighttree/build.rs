//! Building a light tree: median splits along the widest of seven axes: three of position, three of the normal (scaled
//! so that opposite normals lie as far apart as opposite ends of the scene), and one of radiosity, B/(B + mean B), whose
//! whole range is half a scene: lights of one cluster should shine alike. The last axis took the error of a 2 % cut from
//! 2.7, 2.3 and 1.7 to 2.0, 2.0 and 1.5 % in the scenes of the bench; twice its range was worse.
//!
//! Keys are whole steps of a fine grid over the scene. The surfels of one row of voxels differ in the other coordinates
//! by rounding only; with exact keys that rounding would decide which of them a median takes, and a copy of the scene at
//! another place or scale would have another tree and other noise.

use glam::Vec3;

use super::{Light, LightTree, Node, Seeded, VARIANTS, left_count, weight};
use crate::{
    Rgb,
    sampling::{combine, mix, unit},
};

/// Below this many lights a subtree is built by one thread.
const TASK: usize = 4096;

/// Steps of a key over half the scene's longest side: far finer than a voxel, far coarser than rounding.
const STEPS: f32 = 32768.0;

/// What is moved about while splitting.
#[derive(Clone, Copy)]
struct Item {
    key: [i32; 7],
    id: u32,
}

/// What a parent needs to know of its child.
#[derive(Clone, Copy)]
struct Summary {
    intensity: Rgb,
    area: f32,
    low: Rgb,
    high: Rgb,
    representatives: [u32; VARIANTS],
    weight: f32,
}

pub(super) fn build(mut lights: Vec<Seeded>, ambient: f32) -> LightTree {
    lights.retain(|l| l.light.intensity.max_element() > 0.0 || l.light.area > 0.0);
    if lights.is_empty() {
        return LightTree::default();
    }
    let (lo, hi) = bounds(lights.iter().map(|l| l.light.position));
    let scale = 0.5 * (hi - lo).max_element();
    let brightness = brightness(&lights);
    let step = if scale > 0.0 { STEPS / scale } else { 0.0 };
    let mut items: Vec<Item> = (0u32..)
        .zip(&lights)
        .map(|(id, l)| {
            let (p, n) = ((l.light.position - lo) * step, l.light.normal * STEPS);
            let key = [p.x, p.y, p.z, n.x, n.y, n.z, brightness(&l.light) * STEPS];
            Item { key: key.map(|k| k.round() as i32), id }
        })
        .collect();
    let mut nodes = vec![EMPTY; lights.len() - 1];
    split(&lights, ambient, &mut items, &mut nodes, 0);
    // From here on a light is known by its place in the tree.
    let mut place = vec![0; lights.len()];
    for (at, item) in (0u32..).zip(&items) {
        place[item.id as usize] = at;
    }
    for node in &mut nodes {
        node.representatives = node.representatives.map(|id| place[id as usize]);
    }
    LightTree { lights: items.iter().map(|i| lights[i.id as usize].light).collect(), nodes, ambient }
}

const EMPTY: Node = Node {
    lo: Vec3::ZERO,
    hi: Vec3::ZERO,
    axis: Vec3::Z,
    cos: -1.0,
    sin: 0.0,
    intensity: Rgb::ZERO,
    area: 0.0,
    low: Rgb::ZERO,
    high: Rgb::ZERO,
    representatives: [0; VARIANTS],
    first: 0,
    count: 0,
};

/// Builds the subtree over `items`, which stand at `first` in the tree's order; `nodes` holds exactly its inner nodes.
/// The depth of the recursion is the logarithm of the number of lights, since every split is a median.
fn split(lights: &[Seeded], ambient: f32, items: &mut [Item], nodes: &mut [Node], first: usize) -> Summary {
    if let [item] = items {
        return leaf(&lights[item.id as usize].light, ambient, item.id);
    }
    let count = items.len();
    let (mut least, mut most) = ([i32::MAX; 7], [i32::MIN; 7]);
    for item in items.iter() {
        for axis in 0..7 {
            least[axis] = least[axis].min(item.key[axis]);
            most[axis] = most[axis].max(item.key[axis]);
        }
    }
    let extent = |axis: usize| i64::from(most[axis]) - i64::from(least[axis]);
    let (lo, hi) = bounds(items.iter().map(|i| lights[i.id as usize].light.position));
    let widest = (1..7).fold(0, |best, axis| if extent(axis) > extent(best) { axis } else { best });
    let (axis, cos) = cone(lights, items);
    let middle = left_count(count);
    // Ties are broken by the place in the list, so that the halves do not depend on how the selection works.
    items.select_nth_unstable_by(middle, |a, b| a.key[widest].cmp(&b.key[widest]).then(a.id.cmp(&b.id)));
    let (left, right) = items.split_at_mut(middle);
    let Some((node, below)) = nodes.split_first_mut() else { unreachable!("n lights have n - 1 inner nodes") };
    let (left_nodes, right_nodes) = below.split_at_mut(middle - 1);
    let mut go_left = || split(lights, ambient, left, left_nodes, first);
    let mut go_right = || split(lights, ambient, right, right_nodes, first + middle);
    let (a, b) = if count > TASK { rayon::join(go_left, go_right) } else { (go_left(), go_right()) };
    let sum = join(lights, &a, &b);
    *node = Node {
        lo,
        hi,
        axis,
        cos,
        sin: (1.0 - cos * cos).max(0.0).sqrt(),
        intensity: sum.intensity,
        area: sum.area,
        low: sum.low,
        high: sum.high,
        representatives: sum.representatives,
        first: first as u32,
        count: count as u32,
    };
    sum
}

/// B/(B + mean B) of a light, from its band mean; 0 where nothing has an area.
fn brightness(lights: &[Seeded]) -> impl Fn(&Light) -> f32 + use<> {
    let intensity: f64 = lights.iter().map(|l| f64::from(mean(l.light.intensity))).sum();
    let area: f64 = lights.iter().map(|l| f64::from(l.light.area)).sum();
    let typical = if area > 0.0 { (intensity / area) as f32 } else { 0.0 };
    move |light| match light.area * typical + mean(light.intensity) {
        both if both > 0.0 && light.area > 0.0 => mean(light.intensity) / both,
        _ => 0.0,
    }
}

fn mean(rgb: Rgb) -> f32 {
    rgb.element_sum() / 3.0
}

fn leaf(light: &Light, ambient: f32, id: u32) -> Summary {
    // Lights without area bring no radiosity: an empty range, which leaves any union as it is.
    let (low, high) = if light.area > 0.0 {
        let b = light.intensity / light.area;
        (b, b)
    } else {
        (Rgb::INFINITY, Rgb::NEG_INFINITY)
    };
    let weight = weight(light.intensity, light.area, ambient);
    Summary { intensity: light.intensity, area: light.area, low, high, representatives: [id; VARIANTS], weight }
}

fn join(lights: &[Seeded], a: &Summary, b: &Summary) -> Summary {
    let seed = |s: &Summary| lights[s.representatives[0] as usize].seed;
    let draws = draws(combine(seed(a), seed(b)));
    let weight = a.weight + b.weight;
    // Where all is dark nobody's choice matters.
    let chosen = |v: usize| if draws[v] * weight < a.weight { a } else { b };
    Summary {
        intensity: a.intensity + b.intensity,
        area: a.area + b.area,
        low: a.low.min(b.low),
        high: a.high.max(b.high),
        representatives: std::array::from_fn(|v| chosen(v).representatives[v]),
        weight,
    }
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
fn cone(lights: &[Seeded], items: &[Item]) -> (Vec3, f32) {
    let normal = |item: &Item| lights[item.id as usize].light.normal;
    let mean: Vec3 = items.iter().map(normal).sum();
    let axis = mean.try_normalize().unwrap_or(Vec3::Z);
    let cos = items.iter().map(|i| normal(i).dot(axis)).fold(1.0f32, f32::min);
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
        lighttree::Cluster,
        sampling::{sphere, unit2},
    };

    fn cloud(n: u64) -> Vec<Seeded> {
        (0..n)
            .map(|i| {
                let h = mix(i);
                let p = sphere(unit2(h)) * 100.0 * unit(mix(h));
                let intensity = Rgb::new(unit(mix(h ^ 1)), unit(mix(h ^ 2)), unit(mix(h ^ 3)));
                let light = Light { position: p, normal: sphere(unit2(mix(h ^ 4))), target: p, intensity, area: 0.5 };
                Seeded { light, seed: h }
            })
            .collect()
    }

    /// The lights below a cluster, by walking the tree.
    fn below(tree: &LightTree, cluster: Cluster, out: &mut Vec<u32>) {
        match cluster {
            Cluster::Light(l) => out.push(l),
            Cluster::Node(n) => tree.children(n).into_iter().for_each(|c| below(tree, c, out)),
        }
    }

    #[test]
    fn every_node_contains_what_lies_below_it() {
        let tree = LightTree::new(cloud(777), 0.0);
        for (i, node) in tree.nodes.iter().enumerate() {
            let mut lights = Vec::new();
            below(&tree, Cluster::Node(i as u32), &mut lights);
            assert_eq!(lights.len(), node.count as usize);
            assert!(node.representatives.iter().all(|r| lights.contains(r)));
            let lights: Vec<&Light> = lights.iter().map(|&l| &tree.lights[l as usize]).collect();
            let sum: Rgb = lights.iter().map(|l| l.intensity).sum();
            assert!(sum.abs_diff_eq(node.intensity, 1e-4 * sum.max_element()));
            for l in lights {
                assert!(l.position.cmpge(node.lo).all() && l.position.cmple(node.hi).all());
                assert!(l.normal.dot(node.axis) >= node.cos);
                let b = l.intensity / l.area;
                assert!(b.cmpge(node.low).all() && b.cmple(node.high).all());
            }
        }
        let mut all = Vec::new();
        below(&tree, tree.root().unwrap(), &mut all);
        assert_eq!(all, (0..777).collect::<Vec<u32>>());
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
            tree.lights[tree.nodes[0].representatives[i as usize % VARIANTS] as usize].intensity.x > 2.0
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
            let (node, stand_in) = (&tree.nodes[0], tree.stand_in(0, run as usize % VARIANTS));
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
        assert_eq!((tree.lights.len(), tree.nodes.len()), (100, 99));
    }
}
